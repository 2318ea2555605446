"""Motors in the scenario language."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator

from drake_quad.scenario.distributions import Model, Real, validation_error
from drake_quad.scenario.limits import MIN_MAGNITUDE
from drake_quad.scenario.plausible import Plausible
from drake_quad.scenario.quantities import Number
from drake_quad.vehicle.motors import ThrustCurve


class SpeedMotors(Model):
    """Motors commanded by a rotor speed."""

    kind: Literal["speed"]
    take_throttles: ClassVar = False

    def thrust_curve(self) -> ThrustCurve | None:
        """Return None, since the commands are rotor speeds instead of throttles."""
        return None


class ThrottleMotors(Model):
    """Motors that are commanded by a throttle u from 0 to 1. A rotor's thrust is K0 + K1 u + K2 u²."""

    kind: Literal["throttle"]
    curve: Annotated[tuple[Number, Number, Number], Field(strict=False)] = Field(
        description="coefficients K0, K1, K2 of the thrust (N)"
    )
    voltage: Annotated[Annotated[float, Field(gt=0.0)] | None, Plausible("V", "mV", 1e-3, upper=120.0)] = Field(
        default=None,
        description="battery voltage at which the curve is valid (V); only the evaluation of logs uses it",
    )
    take_throttles: ClassVar = True

    def thrust_curve(self) -> ThrustCurve | None:
        """Return the thrust as a function of the throttle."""
        return ThrustCurve(*self.curve)


class NominalThrottleMotors(ThrottleMotors):
    """Throttle model that the autopilot assumes. The thrust must increase with the throttle."""

    curve: Annotated[tuple[Real, Real, Real], Field(strict=False)] = Field(
        description="coefficients K0, K1, K2 of the thrust (N)"
    )

    @field_validator("curve")
    @classmethod
    def _thrust_increases(cls, curve: tuple[float, float, float]) -> tuple[float, float, float]:
        k_0, k_1, k_2 = curve
        if k_0 < 0.0 or k_1 < 0.0 or k_1 + 2.0 * k_2 < 0.0 or not k_1 + k_2 >= MIN_MAGNITUDE:
            raise validation_error(
                "must increase from throttle 0 to 1, so that it can be inverted: K0, K1 and K1 + 2 K2 must be at least"
                " 0, and K1 + K2 positive"
            )
        return curve


Motors = Annotated[SpeedMotors | ThrottleMotors, Field(discriminator="kind")]
NominalMotors = Annotated[SpeedMotors | NominalThrottleMotors, Field(discriminator="kind")]
