"""Gyroscope in the scenario language."""

from typing import Annotated, Any, ClassVar, Literal

from drake_quad.framework.records import record_like
from drake_quad.laboratory.sensors.gyroscope import GYROSCOPE, GyroscopeParameters
from drake_quad.scenario.plausible import Plausible, not_in_degrees_per_second
from drake_quad.scenario.quantities import NonNegative, Position, Positive, field_from_record
from drake_quad.scenario.sensors.inertial import (
    InertialSettings,
    density_field,
    full_scale_field,
    instability_field,
    resolution_field,
    temperature_field,
    walk_field,
)
from drake_quad.scenario.sensors.sensor import SENSORS

# Uncalibrated gyroscopes have a bias of up to 3 °/s (0.05 rad/s), and noise densities of up to 0.02 °/s/√Hz (0.00035).
_PLAUSIBLE_BIAS = not_in_degrees_per_second(upper=0.2)
_PLAUSIBLE_DENSITY = Plausible("rad/s/√Hz", "°/s/√Hz", 0.017453292519943295, upper=0.002)
_PLAUSIBLE_FULL_SCALE = not_in_degrees_per_second(upper=100.0)
_UNIT = "rad/s"


@SENSORS.register
class GyroscopeSettings(InertialSettings):
    """Gyroscope, which measures the body rates."""

    kind: Literal["gyroscope"]
    bias: Annotated[Position, _PLAUSIBLE_BIAS] = field_from_record(
        GyroscopeParameters, "bias", "constant error along x, y and z"
    )
    noise_density: Annotated[NonNegative, _PLAUSIBLE_DENSITY] = density_field(_UNIT)
    bias_instability: Annotated[NonNegative, _PLAUSIBLE_BIAS] = instability_field(_UNIT)
    bias_random_walk: NonNegative = walk_field(_UNIT)
    temperature_coefficient: Position = temperature_field(_UNIT)
    full_scale: Annotated[Positive | None, _PLAUSIBLE_FULL_SCALE] = full_scale_field(_UNIT)
    resolution: NonNegative = resolution_field(_UNIT)
    law: ClassVar = GYROSCOPE

    def parameters(self, vehicle: Any) -> GyroscopeParameters:
        """Return the gyroscope parameters."""
        vibration = None if self.vibration is None else self.vibration.of_gyroscope(vehicle, self.period)
        return record_like(GyroscopeParameters, self, noise=self.white_noise(), errors=self.inertial_errors(vibration))
