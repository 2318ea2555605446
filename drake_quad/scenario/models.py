"""The scenario language: what a YAML file may say, with units and bounds.

Any physical quantity of the vehicle, the laboratory, the control and most routes may be a distribution. What fixes the
structure of the diagram (periods, counts, choices), what the ground believes, and what a flight is judged by may not.
"""

import math
from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from drake_quad.errors import InputError
from drake_quad.scenario.actions.action import ACTIONS
from drake_quad.scenario.attitude_controllers.controller import ATTITUDE_CONTROLLERS
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS, AnyAutopilot
from drake_quad.scenario.autopilots.none import NoAutopilot
from drake_quad.scenario.command_link import CommandLinkSettings
from drake_quad.scenario.controls.cascade import CascadeControl
from drake_quad.scenario.controls.control import CONTROLS, AnyControl
from drake_quad.scenario.correlation import shared_names
from drake_quad.scenario.distributions import Model, Real, omits_defaults, refused
from drake_quad.scenario.effects.effect import EFFECTS, VehicleEffect
from drake_quad.scenario.inertia import INERTIA_RULE, inertia_flaw
from drake_quad.scenario.layouts import LAYOUTS, Layout, PlusLayout, arms_of, rotors_of
from drake_quad.scenario.limits import MOST_SHARED, MOST_SOURCES, MOST_TICKS
from drake_quad.scenario.motion_capture import MotionCaptureSettings
from drake_quad.scenario.motors import BelievedMotors, Motors, SpeedMotors
from drake_quad.scenario.paths import distributions_in, joined, keys_of
from drake_quad.scenario.position_controllers.controller import POSITION_CONTROLLERS
from drake_quad.scenario.quantities import (
    NonNegative,
    Number,
    PlainMoment,
    PlainNonNegative,
    PlainPositive,
    PlainSpan,
    PlainTilt,
    Positive,
    Share,
    Span,
    Step,
    bounded,
    extremes,
    field_of,
)
from drake_quad.scenario.routes.route import ROUTES, AnyRoute
from drake_quad.scenario.sensors.sensor import SENSORS, AnySensor, SensorSettings
from drake_quad.scenario.space import SpaceSettings
from drake_quad.scenario.winds.source import WINDS, AnyWindSource
from drake_quad.signals import numbered
from drake_quad.vehicle.allocation import Priority
from drake_quad.vehicle.authority import hover_flaw, missing_direction
from drake_quad.vehicle.effects import Effects, ReactionTorque
from drake_quad.vehicle.motors import SpinDown
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.responding import RESPONDING_EFFECTS

# Pattern of the name of a scenario, which is also used for folders and files.
NAME = r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$"


_PAPER = QuadrotorParameters()
_ROTOR = _PAPER.rotors.rotor_1
# Relative difference that is allowed between an arm length and the distances of a layout. Data sheets give two or three
# digits.
_ROUNDING = 0.01
_Positive = TypeVar("_Positive")
_NonNegative = TypeVar("_NonNegative")


class Airframe(Model, Generic[_Positive, _NonNegative]):
    """Airframe of a vehicle; the defaults are from the paper's Table I as far as it has them."""

    mass: _Positive = field_of(_PAPER, "mass", "m")
    inertia: Annotated[tuple[_Positive, _Positive, _Positive], Field(strict=False)] = field_of(
        _PAPER, "inertia", "I_xx, I_yy, I_zz", rule=INERTIA_RULE
    )
    rotor_inertia: _NonNegative = field_of(_PAPER, "rotor_inertia", "J_r")
    thrust_factor: _Positive = field_of(_ROTOR, "thrust_factor", "b")
    drag_factor: _Positive = field_of(_ROTOR, "drag_factor", "d")
    arm_length: _Positive = field_of(_ROTOR, "x", "l, from the middle of a plus or an x to its rotors")
    layout: Layout = Field(default=PlusLayout(kind="plus"), description="where the rotors are and which way they turn")
    gravity: _Positive = field_of(_PAPER, "gravity", "g")
    min_rotor_speed: _NonNegative = field_of(_PAPER, "min_rotor_speed", "idle")
    max_rotor_speed: _Positive = field_of(_PAPER, "max_rotor_speed", "top speed of the rotors")

    @model_serializer(mode="wrap")
    def _written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Without an arm length where distances say it: its default would contradict them."""
        fields: dict[str, Any] = write(self)
        return {name: value for name, value in fields.items() if name != "arm_length" or not self.layout.has_distances}

    def check_layout(self) -> None:
        """Raise an error if the arm length is not that of the layout, or some part of a wrench cannot be given."""
        self._check_arm()
        rotors = "layout", "thrust_factor", "drag_factor", "arm_length"
        if any(path.startswith(rotors) for path in distributions_in(self)):
            return
        if missing := missing_direction(rotors_of(self)):
            raise self.wrong(f"must give thrust and all torques: it has no {missing}", "layout")

    def check_inertia(self) -> None:
        """Raise a validation error if no draw of the moments of inertia belongs to a rigid body."""
        if flaw := inertia_flaw(self.inertia):
            raise self.wrong(flaw, "inertia")

    def _check_arm(self) -> None:
        """Raise an error if the arm length contradicts the layout: such a mistake would go unnoticed otherwise."""
        if "arm_length" not in self.model_fields_set or not self.layout.has_distances:
            return
        written: Any = self.arm_length
        if not isinstance(written, float):
            raise self.wrong("must be left out, since the layout has distances", "arm_length")
        if distributions_in(self.layout):
            return
        shortest, longest = arms_of(self)
        if not (1.0 - _ROUNDING) * shortest <= written <= (1.0 + _ROUNDING) * longest:
            arms = " to ".join(dict.fromkeys(f"{arm:.4g}" for arm in (shortest, longest)))
            raise self.wrong(f"must be {arms}, as the distances in the layout imply, or be left out", "arm_length")


class Nominal(Airframe[PlainPositive, PlainNonNegative]):
    """Vehicle that planner and controllers assume; the defaults are from the paper's Table I as far as it has them."""

    motors: BelievedMotors = Field(default=SpeedMotors(kind="speed"), description="what the motors are told")

    @field_validator("layout")
    @classmethod
    def _believed(cls, layout: Layout) -> Layout:
        for path in distributions_in(layout):
            raise layout.wrong("must be a number, since planner and controllers use it", *keys_of(path))
        return layout

    @model_validator(mode="after")
    def _can_fly(self) -> "Nominal":
        if not self.max_rotor_speed > self.min_rotor_speed:
            raise self.wrong(f"must be larger than min_rotor_speed, {self.min_rotor_speed}", "max_rotor_speed")
        self.check_inertia()
        self.check_layout()
        flaw = hover_flaw(rotors_of(self), min_speed=self.min_rotor_speed, max_speed=self.max_rotor_speed)
        if flaw:
            raise self.wrong(f"must give thrust without torque: {flaw}", "layout")
        return self


class Vehicle(Airframe[Positive, NonNegative]):
    """The aircraft as it is; what is not given is as in `nominal`, and nobody on the ground knows the difference."""

    thrust_factor_error: Annotated[tuple[Share, Share, Share, Share], Field(strict=False)] = Field(
        default=(0.0, 0.0, 0.0, 0.0), description="by which each rotor's thrust factor is off, as a share of b (1)"
    )
    centre_of_mass: Annotated[tuple[Number, Number], Field(strict=False)] = Field(
        default=(0.0, 0.0),
        description="x and y in B, seen from the origin of `layout`, the middle of a plus, an x or an h (m)",
    )
    linear_drag: NonNegative = field_of(_PAPER, "linear_drag", "drag force over airspeed")
    quadratic_drag: NonNegative = field_of(_PAPER, "quadratic_drag", "drag force over squared airspeed")
    rotor_time_constant: Span = field_of(_PAPER, "rotor_time_constant", "lag of the rotor speed")
    rotor_time_constant_down: Span | None = Field(
        default=None, description="lag of rotors that slow down (s); if not given, as of those that speed up"
    )
    motors: Motors = Field(
        default=SpeedMotors(kind="speed"), description="what the motors are told; of the same kind as in `nominal`"
    )
    battery_sag: Annotated[Number, bounded(least=0.0, below=1.0)] = Field(
        default=0.0, description="share of the rotor speed that is lost by the end of the flight, evenly over it (1)"
    )
    reaction_torque: bool = Field(
        default=False, description="whether rotors that accelerate turn the body; the paper leaves it out"
    )
    attitude_kinematics: Literal["exact", "small_angle"] = Field(
        default="exact", description="small_angle takes p, q, r for the rates of roll, pitch and yaw, as eq (3)"
    )
    time_step: Step = Field(default=0.01, description="step of the built-in integration (s); 0 for a continuous state")

    @model_validator(mode="after")
    def _one_load(self) -> "Vehicle":
        if {"payload", "slung_load"} <= self.effects().keys():
            demand = "must not stand beside a payload, which moves the centre of mass away from where it hangs"
            raise self.wrong(demand, "slung_load")
        return self

    def effects(self) -> dict[str, VehicleEffect]:
        """Return the effects that are switched on, by the names of their fields."""
        fields = {name: getattr(self, name) for name in EFFECTS.members}
        return {name: effect for name, effect in fields.items() if effect is not None}

    def effect_numbers(self) -> Effects:
        """Return the numbers of the effects for the formulas of the motion."""
        numbers = {name: effect.numbers() for name, effect in self.effects().items() if name != "rotor_failure"}
        own = {name: record for name, record in numbers.items() if name in Effects._fields}
        down = self.rotor_time_constant_down
        return Effects(
            **own,
            reaction_torque=ReactionTorque(self.rotor_inertia) if self.reaction_torque else None,
            spin_down=None if down is None else SpinDown(down),
            thrust_curve=self.motors.thrust_curve(),
            loads=tuple([record for name, record in numbers.items() if name not in own]),
        )

    def without_response(self) -> tuple[str, ...]:
        """Return the fields of effects that an autopilot of kind response cannot be combined with."""
        failure = [name for name in self.effects() if name == "rotor_failure"]
        return (*failure, *(name for name in self.effect_numbers().names if name not in RESPONDING_EFFECTS))


EFFECTS.extend(Vehicle)


class AllocationSettings(Model):
    """On board: from a wrench to rotor speeds within the limits of `nominal`."""

    priority: Priority = Field(
        default="roll_pitch",
        description="what is kept first where the rotors cannot give the whole wrench: roll_pitch keeps roll and pitch"
        " torque first and then thrust, thrust keeps thrust first and then roll and pitch torque; yaw torque is last",
    )


class Laboratory(Model):
    """Systems between the controllers and the vehicle."""

    motion_capture: MotionCaptureSettings = MotionCaptureSettings()
    command_link: CommandLinkSettings = CommandLinkSettings()
    autopilot: AnyAutopilot = Field(default=NoAutopilot(kind="none"), description="what runs on board")
    allocation: AllocationSettings = AllocationSettings()
    wind: Annotated[tuple[AnyWindSource, ...], Field(strict=False, max_length=MOST_SOURCES)] = Field(
        default=(), description="sources; they add up"
    )
    sensors: Annotated[tuple[AnySensor, ...], Field(strict=False, max_length=MOST_SOURCES)] = Field(
        default=(),
        description="on board, beside motion capture: each has a port and a signal that are called after its kind",
    )

    _written = omits_defaults("sensors")

    @property
    def named_sensors(self) -> dict[str, SensorSettings]:
        """Sensors by the names of their ports: the kind, with a number from the second of a kind on."""
        kinds = [sensor.kind for sensor in self.sensors]
        return {
            numbered(sensor.kind, kinds[: i + 1].count(sensor.kind)): sensor for i, sensor in enumerate(self.sensors)
        }


class MetricWindow(Model):
    """The part of a flight that counts for the metrics."""

    start: PlainMoment = Field(default=0.0, description="first time that counts (s)")
    first_lap: Annotated[int, Field(ge=1)] | None = Field(
        default=None,
        description="first lap that counts, in place of `start`; the last lap that counts is the last of the route,"
        " and a route without laps is one lap",
    )
    end: PlainMoment | None = Field(
        default=None, description="last time that counts (s); the end of the flight if not given"
    )

    @model_validator(mode="after")
    def _begins_once_and_ends_later(self) -> "MetricWindow":
        if self.first_lap is not None and self.start:
            raise self.wrong(f"must not stand beside a start, {self.start}", "first_lap")
        if self.end is not None and not self.end > self.start:
            raise self.wrong(f"must be later than start, {self.start}", "end")
        return self


class Crash(Model):
    """Limits beyond which a vehicle has crashed."""

    tilt: PlainTilt | None = Field(
        default=math.radians(80.0), description="of roll or pitch (rad); null for a vehicle that may turn over"
    )
    position_error: PlainPositive = Field(default=5.0, description="Euclidean (m)")
    height: Real = Field(default=-0.5, description="least height (m)")


class Mission(Model):
    """Vehicle, route and space: all that a plan depends on."""

    name: str = Field(
        default="scenario",
        pattern=NAME,
        max_length=100,
        description="what plots and folders are called after; letters, digits, '_', '.' and '-'",
    )
    route: AnyRoute
    nominal: Nominal = Nominal()
    space: SpaceSettings | None = Field(default=None, description="obstacles, if any")

    _written = omits_defaults("space")

    def __repr__(self) -> str:
        """Return a line of text: what flies where."""
        return f"<{type(self).__name__} {self.name}: {'; '.join(self._words())}>"

    def _words(self) -> list[str]:
        """Return the parts of the line that `repr` shows."""
        return [f"route {self.route.kind}", f"nominal mass {self.nominal.mass:g} kg", *self._obstructed()]

    def _obstructed(self) -> list[str]:
        """Return the number of obstacles in words, if there are any."""
        count = 0 if self.space is None else len(self.space.obstacles)
        return [f"{count} obstacle{'' if count == 1 else 's'}"] if count else []


class Scenario(Mission):
    """A closed loop: what flies where, under which control, for how long."""

    vehicle: Vehicle = Field(default_factory=Vehicle, json_schema_extra={"default": Vehicle().model_dump(mode="json")})
    laboratory: Laboratory = Laboratory()
    control: AnyControl
    duration: PlainSpan | None = Field(default=None, description="of the flight (s); that of the route if not given")
    metrics: MetricWindow = MetricWindow()
    crash: Crash = Crash()
    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(default=0, description="of everything random")
    sample: Annotated[int, Field(ge=0, lt=2**31)] | None = Field(
        default=None, description="which of the study's samples this is; without distributions it may be left open"
    )

    def _words(self) -> list[str]:
        laboratory, count = self.laboratory, len(distributions_in(self))
        wind = ", ".join(source.kind for source in laboratory.wind)
        return [
            f"route {self.route.kind}" + ("" if self.duration is None else f", {self.duration:g} s"),
            f"vehicle of {self.vehicle.mass} kg",
            f"control {' + '.join(self.control.parts())}",
            *([f"autopilot {laboratory.autopilot.kind}"] if laboratory.autopilot.controls_attitude else []),
            f"wind: {wind}" if wind else "no wind",
            *self._obstructed(),
            f"{count or 'no'} distribution{'' if count == 1 else 's'}",
        ]

    @field_validator("vehicle")
    @classmethod
    def _as_nominal(cls, vehicle: Vehicle, info: ValidationInfo) -> Vehicle:
        """Return the vehicle with missing fields taken from `nominal`."""
        nominal = info.data.get("nominal")
        if nominal is None:
            return vehicle
        silent = Nominal.model_fields.keys() - vehicle.model_fields_set
        numbers = {name: getattr(nominal if name in silent else vehicle, name) for name in Vehicle.model_fields}
        whole_vehicle = Vehicle.model_construct(_fields_set=vehicle.model_fields_set, **numbers)
        idle, top = extremes(whole_vehicle.min_rotor_speed)[1], extremes(whole_vehicle.max_rotor_speed)[0]
        if idle is None or top is None or not top > idle:
            if "max_rotor_speed" not in silent:
                raise whole_vehicle.wrong(f"must be larger than min_rotor_speed, {idle}", "max_rotor_speed")
            raise whole_vehicle.wrong(f"must be smaller than max_rotor_speed, {top}", "min_rotor_speed")
        whole_vehicle.check_inertia()
        whole_vehicle.check_layout()
        if whole_vehicle.motors.take_throttles != nominal.motors.take_throttles:
            demand = f"must be {nominal.motors.kind}, as in nominal, since the autopilot commands them"
            raise whole_vehicle.wrong(demand, "motors", "kind")
        return whole_vehicle

    @property
    def cascade(self) -> CascadeControl:
        """The control, if it is a cascade.

        Raises:
            InputError: if the control is of another kind.
        """
        cascade: CascadeControl | None = self.control.cascade()
        if cascade is None:
            raise InputError(f"control of {self.name} is of kind {self.control.kind}, but must be a cascade for this")
        return cascade

    @property
    def periods(self) -> dict[tuple[str | int, ...], float]:
        """The periods of integration, cameras, control, autopilot and sensors (s), by the path of their field."""
        periods: dict[tuple[str | int, ...], float] = {
            ("vehicle", "time_step"): self.vehicle.time_step,
            ("laboratory", "motion_capture", "period"): self.laboratory.motion_capture.period,
            ("laboratory", "command_link", "period"): self.laboratory.command_link.period,
        }
        if self.laboratory.autopilot.period is not None:
            periods[("laboratory", "autopilot", "period")] = self.laboratory.autopilot.period
        for i, sensor in enumerate(self.laboratory.sensors):
            periods[("laboratory", "sensors", i, "period")] = sensor.period
        return {path: period for path, period in periods.items() if period > 0.0}

    @model_validator(mode="after")
    def _control_and_autopilot_fit(self) -> "Scenario":
        self.control.check_fits(self)
        self.laboratory.autopilot.check_fits(self)
        return self

    @model_validator(mode="after")
    def _few_are_shared(self) -> "Scenario":
        """No more normal variables are shared than can be looked over."""
        names: set[str] = set()
        for path, distribution in distributions_in(self).items():
            names.update(shared_names([distribution]))
            if len(names) > MOST_SHARED:
                demand = f"must share none but the {MOST_SHARED} normal variables that a scenario may have"
                raise refused(demand, path=(*keys_of(path), "normal", "shared"))
        return self

    @model_validator(mode="after")
    def _grids_coincide(self) -> "Scenario":
        base, shortest = min((period, joined(*path)) for path, period in self.periods.items())
        if self.vehicle.time_step > base:
            demand = f"must not be longer than the shortest period, {base} s of {shortest}"
            raise self.wrong(demand, "vehicle", "time_step")
        for path, period in self.periods.items():
            if math.frexp(period / base)[0] != 0.5 or base * (period / base) != period:
                demand = f"must be the shortest period, {base}, times a power of two, so that all grids coincide"
                raise self.wrong(demand, *path)
        return self

    @model_validator(mode="after")
    def _ends(self) -> "Scenario":
        """A flight has no more ticks than can be flown, as far as its duration is known without a plan."""
        longest = MOST_TICKS * min(self.periods.values())
        path, end = self.route.known_end() if self.duration is None else (("duration",), self.duration)
        if end is not None and end > longest:
            raise self.wrong(f"must be at most {longest:g} s, {MOST_TICKS:,} times the shortest period", *path)
        return self


UNIONS = WINDS, SENSORS, AUTOPILOTS, CONTROLS, POSITION_CONTROLLERS, ATTITUDE_CONTROLLERS, ACTIONS, ROUTES, LAYOUTS
"""Unions to which members can be added."""
REGISTRIES = *UNIONS, EFFECTS
"""Unions and open fields to which members can be added."""
WINDS.rebuild(Laboratory)
SENSORS.rebuild(Laboratory)
AUTOPILOTS.rebuild(Laboratory)
LAYOUTS.rebuild(Nominal, Vehicle)
for union in (LAYOUTS, ROUTES, WINDS):
    union.rebuild(Mission)
for registry in REGISTRIES:
    registry.rebuild(Scenario)
