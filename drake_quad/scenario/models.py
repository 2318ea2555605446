"""The scenario language: what a YAML file may say, with units and bounds.

Any physical quantity may be a distribution; what fixes the structure of the diagram (periods, counts, choices) may
not.
"""

import math
from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator, model_validator
from pydantic_core import PydanticCustomError

from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import Gains, NonNegative, Number, Period, Positive, bounded
from drake_quad.scenario.routes import Route


class Vehicle(Model):
    """The aircraft; the defaults are the paper's Table I where it has them."""

    mass: Positive = Field(default=0.68, description="m (kg)")
    inertia: Annotated[tuple[Positive, Positive, Positive], Field(strict=False)] = Field(
        default=(0.007, 0.007, 0.012), description="I_xx, I_yy, I_zz (kg m²)"
    )
    rotor_inertia: NonNegative = Field(default=6.5e-5, description="J_r (kg m²)")
    thrust_factor: Positive = Field(default=4.13e-5, description="b (N s²)")
    drag_factor: Positive = Field(default=8.5e-7, description="d (N m s²)")
    arm_length: Positive = Field(default=0.17, description="l (m)")
    gravity: Positive = Field(default=9.81, description="g (m/s²)")
    linear_drag: NonNegative = Field(default=0.0, description="drag force over airspeed (N s/m)")
    quadratic_drag: NonNegative = Field(default=0.0, description="drag force over squared airspeed (N s²/m²)")
    rotor_time_constant: Positive = Field(default=0.05, description="lag of the rotor speed (s)")
    min_rotor_speed: NonNegative = Field(default=60.0, description="idle (rad/s)")
    max_rotor_speed: Positive = Field(default=300.0, description="top speed of the rotors (rad/s)")
    attitude_kinematics: Literal["exact", "small_angle"] = Field(
        default="exact", description="small_angle takes p, q, r for the rates of roll, pitch and yaw, as eq (3)"
    )
    time_step: Annotated[float, Field(ge=0.0)] = Field(
        default=0.01, description="step of the built-in integration (s); 0 for a continuous state"
    )

    @field_validator("max_rotor_speed")
    @classmethod
    def _above_idle(cls, top: Number, info: ValidationInfo) -> Number:
        idle = info.data.get("min_rotor_speed")
        if isinstance(top, float) and isinstance(idle, float) and not top > idle:
            raise PydanticCustomError("idle", "must be larger than min_rotor_speed, {idle}", {"idle": idle})
        return top


class MotionCapture(Model):
    """Cameras that see position and attitude; exact here."""

    period: Period = Field(default=0.01, description="time between frames (s); the paper's 100 Hz")


class CommandLink(Model):
    """Radio link that carries the wrench to the vehicle."""

    period: Period = Field(default=0.02, description="time between ticks of the control (s); the paper's 50 Hz")
    delay_ticks: Annotated[int, Field(ge=0, le=50)] = Field(
        default=1, description="whole ticks from sending to arrival"
    )


class Laboratory(Model):
    """What stands between the controllers and the vehicle."""

    motion_capture: MotionCapture = MotionCapture()
    command_link: CommandLink = CommandLink()


class PdPosition(Model):
    """PD on the position error, eq (8)."""

    kind: Literal["pd"]
    k_p: Gains = Field(description="k_P on X, Y, Z (1/s²)")
    k_d: Gains = Field(description="k_D on X, Y, Z (1/s)")
    derivative: Literal["tracking_error", "measurement"] = Field(
        default="tracking_error", description="what k_D multiplies: v_r - v, or -v"
    )
    feed_forward: Literal["none", "acceleration", "jerk"] = Field(
        default="none", description="up to which derivative of the reference is fed forward"
    )


class ThrustVectoring(Model):
    """Limits of what eq (7) may command."""

    max_tilt: Annotated[Number, bounded(above=0.0, below=math.pi / 2)] = Field(
        default=0.6, description="largest angle between thrust and vertical (rad)"
    )
    min_thrust: Annotated[Number, bounded(above=0.0, below=1.0)] = Field(
        default=0.3, description="least vertical thrust, as a share of the weight (1)"
    )
    max_thrust: Annotated[Number, bounded(above=1.0)] = Field(
        default=1.8, description="largest thrust, as a share of the weight (1)"
    )


class AttitudePd(Model):
    """PD on the attitude error."""

    k_p: Gains = Field(description="on roll, pitch, yaw (1/s²)")
    k_d: Gains = Field(description="on roll, pitch, yaw rate (1/s)")


class Control(Model):
    """The cascade: position, thrust vectoring, attitude."""

    position: PdPosition
    thrust_vectoring: ThrustVectoring = ThrustVectoring()
    attitude: AttitudePd


class Window(Model):
    """The part of a flight that counts for the metrics."""

    start: Annotated[float, Field(ge=0.0)] = Field(default=0.0, description="first time that counts (s)")
    end: Annotated[float, Field(gt=0.0)] | None = Field(
        default=None, description="last time that counts (s); the end of the flight if not given"
    )

    @field_validator("end")
    @classmethod
    def _after_start(cls, end: float | None, info: ValidationInfo) -> float | None:
        start = info.data.get("start")
        if end is not None and start is not None and not end > start:
            raise PydanticCustomError("window", "must be later than start, {start}", {"start": start})
        return end


class Crash(Model):
    """Limits beyond which a vehicle has crashed."""

    tilt: Annotated[float, Field(gt=0.0, lt=math.pi / 2)] = Field(
        default=math.radians(80.0), description="of roll or pitch (rad)"
    )
    position_error: Annotated[float, Field(gt=0.0)] = Field(default=5.0, description="Euclidean (m)")
    height: float = Field(default=-0.5, description="least height (m)")


class Journey(Model):
    """What flies where: all that a plan depends on."""

    name: str = Field(
        default="scenario",
        pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*$",
        description="what plots and folders are called after; letters, digits, '_', '.' and '-'",
    )
    route: Route
    vehicle: Vehicle = Vehicle()


class Scenario(Journey):
    """A closed loop: what flies where, under which control, for how long."""

    laboratory: Laboratory = Laboratory()
    control: Control
    duration: Annotated[float, Field(gt=0.0, le=86_400.0)] | None = Field(
        default=None, description="of the flight (s); that of the route if not given"
    )
    metrics: Window = Window()
    crash: Crash = Crash()
    seed: Annotated[int, Field(ge=0, lt=2**63)] = Field(default=0, description="of everything random")

    @model_validator(mode="after")
    def _grids_coincide(self) -> "Scenario":
        periods = {
            "laboratory.motion_capture.period": self.laboratory.motion_capture.period,
            "laboratory.command_link.period": self.laboratory.command_link.period,
        }
        if self.vehicle.time_step > 0.0:
            periods = {"vehicle.time_step": self.vehicle.time_step, **periods}
        base = min(periods.values())
        for field, period in periods.items():
            if math.frexp(period / base)[0] != 0.5 or base * (period / base) != period:
                raise PydanticCustomError(
                    "grid",
                    "must be the shortest period, {base}, times a power of two, so that all grids coincide",
                    {"field": field, "base": base},
                )
        return self
