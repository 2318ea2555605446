"""What acts on the vehicle of a scenario beside the paper's equations; what is not written is switched off."""

from typing import Annotated, Literal

from pydantic import Field, field_validator, model_validator
from pydantic_core import PydanticCustomError

from drake_quad.scenario.distributions import Model, Real
from drake_quad.scenario.inertia import INERTIA_DEMAND, INERTIA_RULE, inertia_flaw
from drake_quad.scenario.limits import LARGEST, SMALLEST
from drake_quad.scenario.quantities import Moment, NonNegative, Number, Position, Positive, bounded, extremes

_PerAxis = Annotated[tuple[NonNegative, NonNegative, NonNegative], Field(strict=False)]
_Nowhere = (0.0, 0.0, 0.0)


class BodyDrag(Model):
    """Drag of the body, along each of its axes by itself: F_k = (c1_k + c2_k |u|) u_k, u the air relative to it."""

    linear: _PerAxis = Field(default=_Nowhere, description="c1, force over airspeed along x, y, z of B (N s/m)")
    quadratic: _PerAxis = Field(
        default=_Nowhere, description="c2, force over squared airspeed along x, y, z of B (N s²/m²)"
    )
    centre_of_pressure: Position = Field(
        default=_Nowhere, description="where it acts, x, y, z in B seen from the centre of mass (m)"
    )


class RotorAerodynamics(Model):
    """What the air that the rotors meet does to them; the paper has nothing of it."""

    lift: NonNegative = Field(
        default=0.0, description="thrust of all rotors over the squared speed across their discs (N s²/m²)"
    )
    climb: Number = Field(
        default=0.0,
        description="thrust that all rotors lose over the speed of climb through the air, along z of B (N s/m)",
    )
    drag: NonNegative = Field(
        default=0.0, description="force across z of B over airspeed and a rotor's speed in rad/s (N s²/m)"
    )
    inflow: NonNegative = Field(
        default=0.0, description="the same along z of B: thrust that a rotor loses in climb (N s²/m)"
    )


class GroundEffect(Model):
    """Thrust that rotors gain close above the ground: 1 / (1 - (R / 4z)²), Cheeseman and Bennett 1955; at most 4/3."""

    rotor_radius: Positive = Field(description="R (m)")
    ground_height: Number = Field(default=0.0, description="z of the ground in W (m)")


class SpeedMotors(Model):
    """Motors that are told the speed of their rotors."""

    kind: Literal["speed"]


class ThrottleMotors(Model):
    """Motors that are told a throttle u from 0 to 1; the thrust of a rotor is K0 + K1 u + K2 u²."""

    kind: Literal["throttle"]
    curve: Annotated[tuple[Number, Number, Number], Field(strict=False)] = Field(description="K0, K1, K2 (N)")


class BelievedThrottleMotors(ThrottleMotors):
    """The same as the autopilot believes it; the thrust must rise with the throttle."""

    curve: Annotated[tuple[Real, Real, Real], Field(strict=False)] = Field(description="K0, K1, K2 (N)")

    @field_validator("curve")
    @classmethod
    def _rises(cls, curve: tuple[float, float, float]) -> tuple[float, float, float]:
        k_0, k_1, k_2 = curve
        if k_0 < 0.0 or k_1 < 0.0 or k_1 + 2.0 * k_2 < 0.0 or not k_1 + k_2 >= SMALLEST:
            raise PydanticCustomError(
                "curve",
                "must rise from throttle 0 to 1, so that it can be inverted: K0, K1 and K1 + 2 K2 at least 0, and"
                " K1 + K2 above",
            )
        return curve


Motors = Annotated[SpeedMotors | ThrottleMotors, Field(discriminator="kind")]
BelievedMotors = Annotated[SpeedMotors | BelievedThrottleMotors, Field(discriminator="kind")]


class Payload(Model):
    """A mass that is fixed to the vehicle, and is picked up or dropped at a time."""

    mass: Positive = Field(description="of it (kg)")
    position: Position = Field(
        default=_Nowhere, description="of its centre of mass, x, y, z in B seen from that of the vehicle without it (m)"
    )
    inertia: _PerAxis = Field(
        default=_Nowhere,
        description=f"about its own centre of mass along x, y, z of B (kg m²), 0 for a point{INERTIA_RULE}",
    )
    time: Moment = Field(description="of the event (s)")
    event: Literal["picked_up", "dropped"] = Field(
        description="what happens at that time: before it is picked up and after it is dropped it is not there"
    )

    @model_validator(mode="after")
    def _is_rigid(self) -> "Payload":
        if flaw := inertia_flaw(self.inertia):
            raise self.wrong("inertia", kind="inertia", demand=INERTIA_DEMAND, flaw=flaw)
        return self


class Battery(Model):
    """A battery that the rotors draw empty; its voltage sags under their current."""

    voltage: Positive = Field(description="of the full battery without current (V)")
    empty_voltage: Positive = Field(description="of the empty battery without current (V)")
    capacity: Positive = Field(description="charge between the two (A h)")
    resistance: NonNegative = Field(description="inside of the battery (Ω)")
    efficiency: Annotated[Number, bounded(least=0.01, most=1.0)] = Field(
        description="mechanical power of the rotors over electrical power (1)"
    )

    @model_validator(mode="after")
    def _falls(self) -> "Battery":
        least = extremes(self.voltage)[0] or 0.0
        most = extremes(self.empty_voltage)[1]
        if most is None or not least >= most:
            demand = "must not be larger than voltage, {voltage}"
            raise self.wrong("empty_voltage", kind="voltage", demand=demand, voltage=least)
        return self


class SlungLoad(Model):
    """A point mass on a rod without mass, always taut, that hangs at the centre of mass of the vehicle."""

    mass: Positive = Field(description="of the load (kg)")
    length: Annotated[Number, bounded(least=0.01, most=LARGEST)] = Field(description="of the rod (m)")
