"""Models of a scenario: all fields of the scenario language, with units and bounds.

Any physical quantity of the vehicle, the laboratory, the control and most routes may be a distribution. Three groups of
fields must be fixed: those that determine the diagram structure (periods, counts, choices), the parameters of the
nominal vehicle, and the criteria by which a flight is evaluated.
"""

import math
import re
from collections.abc import Collection, Iterable, Iterator
from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from drake_quad.errors import InputError, join_names, shorten_text
from drake_quad.laboratory.metrics import METRICS as EVERY_METRIC
from drake_quad.laboratory.metrics import Metrics, metrics_type
from drake_quad.scenario.actions.action import ACTIONS
from drake_quad.scenario.attitude_controllers.controller import ATTITUDE_CONTROLLERS
from drake_quad.scenario.autopilots.autopilot import AUTOPILOTS, AnyAutopilot
from drake_quad.scenario.autopilots.none import NoAutopilot
from drake_quad.scenario.command_link import CommandLinkSettings
from drake_quad.scenario.controls.cascade import CascadeControl
from drake_quad.scenario.controls.control import CONTROLS, AnyControl
from drake_quad.scenario.correlation import shared_names
from drake_quad.scenario.distributions import Model, Real, omits_defaults, validation_error
from drake_quad.scenario.draws import DesignedDraws
from drake_quad.scenario.effects.effect import EFFECTS, VehicleEffect
from drake_quad.scenario.estimators.estimator import ESTIMATORS, AnyEstimator
from drake_quad.scenario.estimators.motion_capture import MotionCaptureEstimator
from drake_quad.scenario.inactive import FlightConditions, InactiveSetting, can_have_effect, late_setting, needs
from drake_quad.scenario.inertia import INERTIA_RULE, explain_invalid_inertia
from drake_quad.scenario.initial import InitialState
from drake_quad.scenario.layouts import LAYOUTS, Layout, PlusLayout, arm_length_range, rotors_of
from drake_quad.scenario.limits import MAX_SHARED, MAX_SOURCES, MAX_TICKS
from drake_quad.scenario.metrics.metric import METRICS, AnyMetric
from drake_quad.scenario.motion_capture import MotionCaptureSettings
from drake_quad.scenario.motors import Motors, NominalMotors, SpeedMotors
from drake_quad.scenario.paths import distributions_in, join_path, path_keys
from drake_quad.scenario.plausible import (
    PLAUSIBLE_LAG,
    PLAUSIBLE_RELATIVE_ERROR,
    PLAUSIBLE_SIZE,
    not_in_g,
    not_in_grams,
    not_in_millimetres,
    not_in_rpm,
)
from drake_quad.scenario.position_controllers.controller import POSITION_CONTROLLERS
from drake_quad.scenario.proportions import implausible_proportions
from drake_quad.scenario.quantities import (
    FixedMoment,
    FixedNonNegative,
    FixedPositive,
    FixedSpan,
    FixedTilt,
    NonNegative,
    Number,
    Positive,
    RelativeError,
    Span,
    Step,
    bounds,
    extremes,
    field_from_record,
)
from drake_quad.scenario.requirements import Requirement
from drake_quad.scenario.routes.route import ROUTES, AnyRoute
from drake_quad.scenario.sensors.sensor import SENSORS, AnySensor, SensorSettings
from drake_quad.scenario.space import SpaceSettings
from drake_quad.scenario.winds.source import WINDS, AnyWindSource
from drake_quad.signals import sensor_port_name, valid_signal
from drake_quad.space.space import Space
from drake_quad.vehicle.allocation import Priority
from drake_quad.vehicle.attitude_response import ATTITUDE_RESPONSE_EFFECTS
from drake_quad.vehicle.authority import explain_infeasible_hover, explain_missing_wrench
from drake_quad.vehicle.effects import Effects, ReactionTorque
from drake_quad.vehicle.motors import SpinDown
from drake_quad.vehicle.parameters import QuadrotorParameters

# Pattern for the name of a scenario, which is also used for folders and files.
NAME = r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$"


_PAPER_VEHICLE = QuadrotorParameters()
_PAPER_ROTOR = _PAPER_VEHICLE.rotors.rotor_1
# Largest relative difference between a given arm length and the arm lengths that follow from the distances of a layout.
# Data sheets give two or three digits.
_ARM_TOLERANCE = 0.01
# Largest plausible mass: 100 kg, five times the mass of the heaviest vehicles for which the language is intended.
_PLAUSIBLE_MASS = not_in_grams(upper=100.0)
# The smallest plausible gravity is that of the Moon, 1.62 m/s².
_PLAUSIBLE_GRAVITY = not_in_g(lower=1.5, upper=30.0)
# The 31 mm propellers of a 20 g vehicle reach 50,000 rpm (5,236 rad/s). Larger propellers are slower.
_PLAUSIBLE_ROTOR_SPEED = not_in_rpm(upper=6000.0)
# Largest plausible offset of the centre of mass. The arms of the largest vehicles are shorter than 1 m.
_PLAUSIBLE_OFFSET = not_in_millimetres(upper=0.5)
_Positive = TypeVar("_Positive")
_NonNegative = TypeVar("_NonNegative")


class Airframe(Model, Generic[_Positive, _NonNegative]):
    """Airframe of a vehicle. The defaults are from the paper's Table I where it gives a value."""

    mass: Annotated[_Positive, _PLAUSIBLE_MASS] = field_from_record(_PAPER_VEHICLE, "mass", "mass m")
    inertia: Annotated[tuple[_Positive, _Positive, _Positive], Field(strict=False)] = field_from_record(
        _PAPER_VEHICLE, "inertia", "moments of inertia I_xx, I_yy, I_zz", rule=INERTIA_RULE
    )
    rotor_inertia: _NonNegative = field_from_record(_PAPER_VEHICLE, "rotor_inertia", "moment of inertia J_r of a rotor")
    thrust_factor: _Positive = field_from_record(_PAPER_ROTOR, "thrust_factor", "thrust factor b of a rotor")
    drag_factor: _Positive = field_from_record(_PAPER_ROTOR, "drag_factor", "drag factor d of a rotor")
    arm_length: Annotated[_Positive, PLAUSIBLE_SIZE] = field_from_record(
        _PAPER_ROTOR, "x", "arm length l from the middle of a plus or an x to its rotors"
    )
    layout: Layout = Field(
        default=PlusLayout(kind="plus"), description="positions and directions of rotation of the rotors"
    )
    gravity: Annotated[_Positive, _PLAUSIBLE_GRAVITY] = field_from_record(
        _PAPER_VEHICLE, "gravity", "gravitational acceleration g"
    )
    min_rotor_speed: Annotated[_NonNegative, _PLAUSIBLE_ROTOR_SPEED] = field_from_record(
        _PAPER_VEHICLE, "min_rotor_speed", "idle speed of the rotors"
    )
    max_rotor_speed: Annotated[_Positive, _PLAUSIBLE_ROTOR_SPEED] = field_from_record(
        _PAPER_VEHICLE, "max_rotor_speed", "top speed of the rotors"
    )

    @model_serializer(mode="wrap")
    def _serialized(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Serialize the fields, without the arm length if it follows from distances in the layout."""
        fields: dict[str, Any] = write(self)
        return {name: value for name, value in fields.items() if name != "arm_length" or not self.layout.has_distances}

    def check_layout(self) -> None:
        """Raise an error if the arm length contradicts the layout, or the rotors cannot produce every torque."""
        self._check_arm()
        rotors = "layout", "thrust_factor", "drag_factor", "arm_length"
        if any(path.startswith(rotors) for path in distributions_in(self)):
            return
        if missing := explain_missing_wrench(rotors_of(self)):
            raise self.field_error(f"must produce thrust and all torques, but cannot produce {missing}", "layout")

    def check_inertia(self) -> None:
        """Raise a validation error if no draw of the moments of inertia is possible for a rigid body."""
        if flaw := explain_invalid_inertia(self.inertia):
            raise self.field_error(flaw, "inertia")

    def _check_arm(self) -> None:
        """Raise an error if the arm length contradicts the distances of the layout. The model uses the distances."""
        if "arm_length" not in self.model_fields_set or not self.layout.has_distances:
            return
        written: Any = self.arm_length
        if not isinstance(written, float):
            raise self.field_error("must be left out, since the distances in the layout determine it", "arm_length")
        # If the distances of a layout are random, no arm length can contradict them.
        if distributions_in(self.layout):
            return
        shortest, longest = arm_length_range(self)
        if not (1.0 - _ARM_TOLERANCE) * shortest <= written <= (1.0 + _ARM_TOLERANCE) * longest:
            arms = " to ".join(dict.fromkeys(f"{arm:.4g}" for arm in (shortest, longest)))
            raise self.field_error(
                f"must be {arms}, which follows from the distances in the layout, or be left out", "arm_length"
            )


class Nominal(Airframe[FixedPositive, FixedNonNegative]):
    """Vehicle that planner and controllers assume. Defaults are from the paper's Table I where it gives a value."""

    motors: NominalMotors = Field(
        default=SpeedMotors(kind="speed"), description="command of the motors: rotor speed or throttle"
    )

    @field_validator("layout")
    @classmethod
    def _layout_is_fixed(cls, layout: Layout) -> Layout:
        for path in distributions_in(layout):
            raise layout.field_error("must be a number, since planner and controllers use it", *path_keys(path))
        return layout

    @model_validator(mode="after")
    def _can_hover(self) -> "Nominal":
        if not self.max_rotor_speed > self.min_rotor_speed:
            raise self.field_error(f"must be larger than min_rotor_speed, {self.min_rotor_speed}", "max_rotor_speed")
        self.check_inertia()
        self.check_layout()
        flaw = explain_infeasible_hover(rotors_of(self), min_speed=self.min_rotor_speed, max_speed=self.max_rotor_speed)
        if flaw:
            raise self.field_error(f"must produce thrust without torque: {flaw}", "layout")
        return self

    def implausible_fields(self) -> Iterator[tuple[str, str]]:
        """Yield remarks on implausible ratios between mass, inertia, thrust and drag."""
        yield from implausible_proportions(self)


class Vehicle(Airframe[Positive, NonNegative]):
    """The real aircraft. A missing field takes its value from `nominal`, which planner and controllers assume."""

    thrust_factor_error: Annotated[
        tuple[RelativeError, RelativeError, RelativeError, RelativeError], Field(strict=False), PLAUSIBLE_RELATIVE_ERROR
    ] = Field(default=(0.0, 0.0, 0.0, 0.0), description="relative error of the thrust factor b of each rotor (1)")
    centre_of_mass: Annotated[tuple[Number, Number], Field(strict=False), _PLAUSIBLE_OFFSET] = Field(
        default=(0.0, 0.0),
        description="x and y in B relative to the origin of `layout` (m), which is the middle of a plus, an x or an h",
    )
    linear_drag: NonNegative = field_from_record(_PAPER_VEHICLE, "linear_drag", "drag force over airspeed")
    quadratic_drag: NonNegative = field_from_record(
        _PAPER_VEHICLE, "quadratic_drag", "drag force over squared airspeed"
    )
    rotor_time_constant: Annotated[Span, PLAUSIBLE_LAG] = field_from_record(
        _PAPER_VEHICLE, "rotor_time_constant", "time constant of the rotor speed"
    )
    rotor_time_constant_down: Annotated[Span | None, PLAUSIBLE_LAG] = Field(
        default=None,
        description="time constant of the speed of rotors that slow down (s); by default, `rotor_time_constant`",
    )
    motors: Motors = Field(
        default=SpeedMotors(kind="speed"),
        description="command of the motors: rotor speed or throttle; of the same kind as in `nominal`",
    )
    battery_sag: Annotated[Number, bounds(ge=0.0, lt=1.0, is_fraction=True)] = Field(
        default=0.0, description="fraction of the rotor speed lost by the end of the flight (1), growing linearly"
    )
    reaction_torque: Annotated[bool, needs("rotor_inertia")] = Field(
        default=False, description="whether accelerating rotors exert a reaction torque; the paper neglects it"
    )
    attitude_kinematics: Literal["exact", "small_angle"] = Field(
        default="exact", description="small_angle uses p, q, r as the rates of roll, pitch and yaw, as in eq (3)"
    )
    time_step: Step = Field(default=0.01, description="step of the built-in integration (s); 0 for a continuous state")

    @model_validator(mode="after")
    def _carries_one_load(self) -> "Vehicle":
        if {"payload", "slung_load"} <= self.effects().keys():
            demand = "must not be combined with a payload, which moves the centre of mass away from the attachment"
            raise self.field_error(demand, "slung_load")
        return self

    def effects(self) -> dict[str, VehicleEffect]:
        """Return the effects on the vehicle, by the name of their field."""
        fields = {name: getattr(self, name) for name in EFFECTS.members}
        return {name: effect for name, effect in fields.items() if effect is not None}

    def effect_parameters(self) -> Effects:
        """Return the parameters of all effects for the equations of motion."""
        numbers = {name: effect.parameters() for name, effect in self.effects().items() if name != "rotor_failure"}
        named = {name: record for name, record in numbers.items() if name in Effects._fields}
        down = self.rotor_time_constant_down
        return Effects(
            **named,
            reaction_torque=ReactionTorque(self.rotor_inertia) if self.reaction_torque else None,
            spin_down=None if down is None else SpinDown(down),
            thrust_curve=self.motors.thrust_curve(),
            loads=tuple([record for name, record in numbers.items() if name not in named]),
        )

    def explain_missing_wind_effect(self) -> str:
        """Return a clause that explains why wind does not change the forces on the vehicle; empty if it does."""
        effects = [name for name, effect in EFFECTS.members.items() if effect.depends_on_wind]
        names = ["linear_drag", "quadratic_drag", *effects]
        if can_have_effect(tuple([getattr(self, name) for name in names])):
            return ""
        return f"the vehicle has no drag: {join_names([f'vehicle.{name}' for name in names])} are zero or not given"

    def effects_unsupported_by_response(self) -> tuple[str, ...]:
        """Return the field names of effects that cannot be combined with an autopilot of kind `response`."""
        failure = [name for name in self.effects() if name == "rotor_failure"]
        return (*failure, *(name for name in self.effect_parameters().names if name not in ATTITUDE_RESPONSE_EFFECTS))


EFFECTS.extend(Vehicle)


class AllocationSettings(Model):
    """Onboard allocation: conversion of a wrench to rotor speeds within the limits of `nominal`."""

    priority: Priority = Field(
        default="roll_pitch",
        description="component of the wrench that is preserved first if rotors saturate: roll_pitch preserves roll and"
        " pitch torque before thrust, thrust preserves thrust before roll and pitch torque; yaw torque always comes"
        " last",
    )

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield settings without effect, such as the priority if the autopilot response includes the torques."""
        yield from super().inactive_settings(flight, path)
        if self.priority != "roll_pitch" and flight.scenario.laboratory.autopilot.models_vehicle:
            kind = flight.scenario.laboratory.autopilot.kind
            yield InactiveSetting(f"{path}.priority", f"laboratory.autopilot.kind is {kind}")


class Laboratory(Model):
    """Systems between the controllers and the vehicle."""

    motion_capture: MotionCaptureSettings = MotionCaptureSettings()
    command_link: CommandLinkSettings = CommandLinkSettings()
    autopilot: AnyAutopilot = Field(default=NoAutopilot(kind="none"), description="control loops on board")
    allocation: AllocationSettings = AllocationSettings()
    wind: Annotated[tuple[AnyWindSource, ...], Field(strict=False, max_length=MAX_SOURCES)] = Field(
        default=(), description="wind sources, whose velocities are added"
    )
    sensors: Annotated[tuple[AnySensor, ...], Field(strict=False, max_length=MAX_SOURCES)] = Field(
        default=(),
        description="sensors on board; the kind of a sensor is the name of its port and of its signal",
    )

    estimator: AnyEstimator = Field(
        default=MotionCaptureEstimator(kind="motion_capture"),
        description="source of the measurement, which the control and the autopilot use",
    )

    _serialized = omits_defaults("sensors", "estimator")

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield settings without effect, such as wind if the vehicle has no drag."""
        yield from super().inactive_settings(flight, path)
        if self.wind and (reason := flight.scenario.vehicle.explain_missing_wind_effect()):
            yield InactiveSetting(f"{path}.wind", reason)

    @property
    def named_sensors(self) -> dict[str, SensorSettings]:
        """Sensors by port name: the kind, and a number if there are several sensors of the same kind."""
        kinds = [sensor.kind for sensor in self.sensors]
        return {
            sensor_port_name(sensor.kind, kinds[: i + 1].count(sensor.kind)): sensor
            for i, sensor in enumerate(self.sensors)
        }

    @property
    def sensor_signals(self) -> list[str]:
        """Names of the signals of all sensors: readings, and validity flags if readings can be missing."""
        sensors = self.named_sensors
        return [*sensors, *(valid_signal(name) for name, sensor in sensors.items() if sensor.can_miss)]


# Pattern for the name of an additional metric.
_METRIC_NAME = re.compile(r"[a-z][a-z0-9_]{0,59}")
# Limits the time to draw a random number, which grows with the number of periods of `NoiseSamples`.
_MAX_NOISE_PERIODS = 1000
_RESERVED_COLUMN_NAMES = (*EVERY_METRIC, "sample", "crashed", "crash_time", "obstacle")


def _check_metric_names(names: Iterable[str], taken: Collection[str]) -> None:
    """Raise an error if a metric or requirement has a name that is not allowed.

    Args:
        names: metric and requirement names to check.
        taken: names of other columns in a study table, which a metric must not have.
    """
    for name in names:
        if not _METRIC_NAME.fullmatch(name):
            demand = "must have a name of small letters, digits and '_' that begins with a letter"
            raise validation_error(demand, path=(shorten_text(name),))
        if name in taken:
            raise validation_error(
                "must have another name, since a study has another column with this name", path=(name,)
            )


class MetricWindow(Model):
    """Metrics of a flight: the time window in which they are computed, and additional metrics."""

    start: FixedMoment = Field(default=0.0, description="start of the metric window (s)")
    first_lap: Annotated[int, Field(ge=1)] | None = Field(
        default=None,
        description="first lap of the window, in place of `start`; the window then ends with the last lap of the route,"
        " and a route without laps is one lap",
    )
    end: FixedMoment | None = Field(
        default=None, description="end of the metric window (s); by default, the end of the flight"
    )

    additional: dict[str, AnyMetric] = Field(
        default={},
        description="further metrics by name; if a metric does not give its kind, the name is the kind",
    )

    _serialized = omits_defaults("additional")

    @field_validator("additional", mode="before")
    @classmethod
    def _with_kinds(cls, additional: Any) -> Any:
        """Add the kind to each additional metric that omits it."""
        if not isinstance(additional, dict):
            return additional
        return {
            name: {"kind": name, **(settings or {})} if settings is None or isinstance(settings, dict) else settings
            for name, settings in additional.items()
        }

    @field_validator("additional")
    @classmethod
    def _names_are_allowed(cls, additional: dict[str, AnyMetric]) -> dict[str, AnyMetric]:
        _check_metric_names(additional, _RESERVED_COLUMN_NAMES)
        return additional

    @model_validator(mode="after")
    def _is_consistent(self) -> "MetricWindow":
        if self.first_lap is not None and self.start:
            raise self.field_error(f"must not be combined with a start, {self.start}", "first_lap")
        if self.end is not None and not self.end > self.start:
            raise self.field_error(f"must be later than start, {self.start}", "end")
        return self

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield settings without effect, such as an end of the time window after the end of the flight."""
        yield from super().inactive_settings(flight, path)
        yield from late_setting(self, "end", flight, path)


class Crash(Model):
    """Limits beyond which a vehicle counts as crashed."""

    tilt: FixedTilt | None = Field(
        default=math.radians(80.0),
        description="largest magnitude of roll or pitch (rad); null for a vehicle that may turn over",
    )
    position_error: FixedPositive = Field(default=5.0, description="largest distance from the reference (m)")
    height: Real = Field(default=-0.5, description="smallest height (m)")

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield settings without effect, such as a crash height too far below the reference to be reached."""
        yield from super().inactive_settings(flight, path)
        # A height below the default is not reported, since users choose it to disable this crash limit.
        is_strict = self.height > type(self).model_fields["height"].default
        if is_strict and self.height < flight.lowest_height - self.position_error:
            yield InactiveSetting(
                f"{path}.height", f"{path}.position_error ends a flight {self.position_error:g} m below its reference"
            )


class Mission(Model):
    """Nominal vehicle, route and space: the parts of a scenario that determine the plan."""

    name: str = Field(
        default="scenario",
        pattern=NAME,
        max_length=100,
        description="name of plots and folders; it consists of letters, digits, '_', '.' and '-'",
    )
    route: AnyRoute
    nominal: Nominal = Nominal()
    space: SpaceSettings | None = Field(default=None, description="obstacles; none if not given")

    _serialized = omits_defaults("space")

    def flight_space(self, *, tracking_error: float = 0.0) -> Space | None:
        """Return the obstacles with the clearances for the nominal vehicle, or None if there are no obstacles.

        Args:
            tracking_error: predicted RMS position error, m. It only affects the clearance that a plan keeps.
        """
        if self.space is None:
            return None
        # The nominal vehicle's centre of mass is at the origin of its rotor layout.
        farthest = max(math.sqrt(r.x**2 + r.y**2 + r.z**2) for r in rotors_of(self.nominal))
        return self.space.flight_space(farthest, tracking_error)

    def __repr__(self) -> str:
        """Return a short summary, such as the kinds of route, control and wind."""
        return f"<{type(self).__name__} {self.name}: {'; '.join(self._summary())}>"

    def _summary(self) -> list[str]:
        """Return the parts of the summary that `repr` shows."""
        return [f"route {self.route.kind}", f"nominal mass {self.nominal.mass:g} kg", *self._obstacle_summary()]

    def _obstacle_summary(self) -> list[str]:
        """Return a list with a text on the number of obstacles; empty if there are no obstacles."""
        count = 0 if self.space is None else len(self.space.obstacles)
        return [f"{count} obstacle{'' if count == 1 else 's'}"] if count else []


_SampleIndex = Annotated[int, Field(ge=0, lt=2**31)]


class NoiseSamples(Model):
    """Samples whose wind and noise are used in turn, each for one period, the last until the end of the flight."""

    period: FixedPositive = Field(default=1.0, description="period (s), a multiple of the control period")
    samples: Annotated[tuple[_SampleIndex, ...], Field(strict=False, min_length=1, max_length=_MAX_NOISE_PERIODS)] = (
        Field(description="index of the sample for each period")
    )


class Scenario(Mission):
    """A closed loop: vehicle, laboratory, control and route, with the duration and the metrics of the flight."""

    vehicle: Vehicle = Field(default_factory=Vehicle, json_schema_extra={"default": Vehicle().model_dump(mode="json")})
    laboratory: Laboratory = Laboratory()
    control: AnyControl
    duration: FixedSpan | None = Field(
        default=None, description="duration of the flight (s); by default, the duration of the route"
    )
    initial: InitialState = InitialState()
    metrics: MetricWindow = MetricWindow()
    requirements: dict[str, Requirement] = Field(
        default={}, description="requirements on a flight by name; their robustness is a metric"
    )
    crash: Crash = Crash()
    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(default=0, description="seed of all random numbers")
    sample: _SampleIndex | None = Field(
        default=None, description="index of the sample in a study, from 0; only needed if there are distributions"
    )
    noise: NoiseSamples | None = Field(
        default=None, description="samples whose wind and noise are used; by default, the sample in `sample`"
    )
    draws: DesignedDraws | None = Field(
        default=None, description="sampling design of a study; independent random samples if not given"
    )

    def _summary(self) -> list[str]:
        laboratory, count = self.laboratory, len(distributions_in(self))
        wind = ", ".join(source.kind for source in laboratory.wind)
        return [
            f"route {self.route.kind}" + ("" if self.duration is None else f", {self.duration:g} s"),
            f"vehicle of {self.vehicle.mass} kg",
            f"control {' + '.join(self.control.parts())}",
            *([f"autopilot {laboratory.autopilot.kind}"] if laboratory.autopilot.controls_attitude else []),
            f"wind: {wind}" if wind else "no wind",
            *self._obstacle_summary(),
            f"{count or 'no'} distribution{'' if count == 1 else 's'}",
        ]

    @field_validator("vehicle")
    @classmethod
    def _with_nominal_values(cls, vehicle: Vehicle, info: ValidationInfo) -> Vehicle:
        """Fill missing fields of the vehicle from `nominal`."""
        nominal = info.data.get("nominal")
        if nominal is None:
            return vehicle
        omitted = Nominal.model_fields.keys() - vehicle.model_fields_set
        numbers = {name: getattr(nominal if name in omitted else vehicle, name) for name in Vehicle.model_fields}
        whole_vehicle = Vehicle.model_construct(_fields_set=vehicle.model_fields_set, **numbers)
        idle, top = extremes(whole_vehicle.min_rotor_speed)[1], extremes(whole_vehicle.max_rotor_speed)[0]
        if idle is None or top is None or not top > idle:
            if "max_rotor_speed" not in omitted:
                raise whole_vehicle.field_error(f"must be larger than min_rotor_speed, {idle}", "max_rotor_speed")
            raise whole_vehicle.field_error(f"must be smaller than max_rotor_speed, {top}", "min_rotor_speed")
        whole_vehicle.check_inertia()
        whole_vehicle.check_layout()
        if whole_vehicle.motors.take_throttles != nominal.motors.take_throttles:
            demand = f"must be {nominal.motors.kind} as in nominal, since the autopilot commands motors of that kind"
            raise whole_vehicle.field_error(demand, "motors", "kind")
        return whole_vehicle

    @property
    def metrics_type(self) -> type[Metrics]:
        """Class of a flight's metrics, with a field for each additional metric."""
        definitions = {name: each.definition(name, self) for name, each in self.metrics.additional.items()}
        robustness = {name: each.definition(name) for name, each in self.requirements.items()}
        return metrics_type((*definitions.items(), *robustness.items()))

    @property
    def cascade(self) -> CascadeControl:
        """The control, if it is a cascade.

        Raises:
            InputError: if the control is of another kind.
        """
        cascade: CascadeControl | None = self.control.cascade()
        if cascade is None:
            raise InputError(
                f"control of {self.name} is of kind {self.control.kind}; select a scenario with control of kind"
                " cascade, or write `kind: cascade` with a position controller in its control"
            )
        return cascade

    @property
    def periods(self) -> dict[tuple[str | int, ...], float]:
        """Periods of integration, cameras, control, autopilot and sensors in s, by the path of their field."""
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

    _serialized = omits_defaults("space", "initial", "requirements")

    @field_validator("requirements")
    @classmethod
    def _names_are_allowed(cls, specified: dict[str, Requirement], info: ValidationInfo) -> dict[str, Requirement]:
        metrics = info.data.get("metrics")
        taken = (*_RESERVED_COLUMN_NAMES, *(() if metrics is None else metrics.additional))
        _check_metric_names(specified, taken)
        return specified

    @model_validator(mode="after")
    def _control_and_autopilot_fit(self) -> "Scenario":
        self.control.check_fits(self)
        self.laboratory.autopilot.check_fits(self)
        self.laboratory.estimator.check_fits(self)
        return self

    @model_validator(mode="after")
    def _shared_variables_are_within_limit(self) -> "Scenario":
        """Raise an error if the distributions use more than `MAX_SHARED` shared variables."""
        names: set[str] = set()
        for path, distribution in distributions_in(self).items():
            names.update(shared_names([distribution]))
            if len(names) > MAX_SHARED:
                demand = f"must not add a shared variable, since the scenario already has {MAX_SHARED}, the limit"
                raise validation_error(demand, path=(*path_keys(path), "normal", "shared"))
        return self

    @model_validator(mode="after")
    def _ticks_coincide(self) -> "Scenario":
        base, shortest = min((period, join_path(*path)) for path, period in self.periods.items())
        if self.vehicle.time_step > base:
            demand = f"must not be longer than the shortest period, {base} s of {shortest}"
            raise self.field_error(demand, "vehicle", "time_step")
        for path, period in self.periods.items():
            if math.frexp(period / base)[0] != 0.5 or base * (period / base) != period:
                demand = f"must be the shortest period, {base}, times a power of two, so that all ticks coincide"
                raise self.field_error(demand, *path)
        return self

    @model_validator(mode="after")
    def _ticks_are_within_limit(self) -> "Scenario":
        """Raise an error if the flight has more than `MAX_TICKS` ticks and its duration is known before planning."""
        longest = MAX_TICKS * min(self.periods.values())
        path, end = self.route.known_end_time() if self.duration is None else (("duration",), self.duration)
        if end is not None and end > longest:
            raise self.field_error(f"must be at most {longest:g} s, {MAX_TICKS:,} times the shortest period", *path)
        return self


UNIONS = (
    WINDS,
    SENSORS,
    ESTIMATORS,
    AUTOPILOTS,
    CONTROLS,
    POSITION_CONTROLLERS,
    ATTITUDE_CONTROLLERS,
    ACTIONS,
    ROUTES,
    LAYOUTS,
    METRICS,
)
"""Unions to which members can be added."""
REGISTRIES = *UNIONS, EFFECTS
"""Unions and open fields to which members can be added."""
WINDS.add_dependent_models(Laboratory)
SENSORS.add_dependent_models(Laboratory)
ESTIMATORS.add_dependent_models(Laboratory)
METRICS.add_dependent_models(MetricWindow)
AUTOPILOTS.add_dependent_models(Laboratory)
LAYOUTS.add_dependent_models(Nominal, Vehicle)
for union in (LAYOUTS, ROUTES, WINDS):
    union.add_dependent_models(Mission)
for registry in REGISTRIES:
    registry.add_dependent_models(Scenario)
