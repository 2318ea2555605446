"""Accelerometer in the scenario language."""

from typing import Annotated, Any, ClassVar, Literal

from drake_quad.framework.records import record_like
from drake_quad.geometry.axes import Vector
from drake_quad.laboratory.sensors.accelerometer import ACCELEROMETER, AccelerometerParameters
from drake_quad.laboratory.sensors.mounting import SensorPosition
from drake_quad.scenario.plausible import PLAUSIBLE_SIZE, Plausible, not_in_g
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
from drake_quad.scenario.sensors.mounting import relative_to_centre
from drake_quad.scenario.sensors.sensor import SENSORS

# Uncalibrated accelerometers have a bias of up to 0.1 g (1 m/s²), and noise densities of 100 to 400 µg/√Hz.
_PLAUSIBLE_BIAS = not_in_g(upper=5.0, prefix="m")
_PLAUSIBLE_DENSITY = Plausible("m/s²/√Hz", "µg/√Hz", 9.80665e-6, upper=0.5)
# The range of accelerometers in flight controllers is 16 to 32 g, and data sheets give it in g.
_PLAUSIBLE_FULL_SCALE = not_in_g(lower=17.0, upper=2000.0)
_UNIT = "m/s²"


@SENSORS.register
class AccelerometerSettings(InertialSettings):
    """Accelerometer, which measures the specific force (without gravity) at its position, in body axes B."""

    kind: Literal["accelerometer"]
    position: Annotated[Position, PLAUSIBLE_SIZE] = field_from_record(
        AccelerometerParameters, "position", "x, y and z in B relative to the origin of `layout`, like `centre_of_mass`"
    )
    bias: Annotated[Position, _PLAUSIBLE_BIAS] = field_from_record(
        AccelerometerParameters, "bias", "constant error along x, y and z"
    )
    noise_density: Annotated[NonNegative, _PLAUSIBLE_DENSITY] = density_field(_UNIT)
    bias_instability: Annotated[NonNegative, _PLAUSIBLE_BIAS] = instability_field(_UNIT)
    bias_random_walk: NonNegative = walk_field(_UNIT)
    temperature_coefficient: Position = temperature_field(_UNIT)
    full_scale: Annotated[Positive | None, _PLAUSIBLE_FULL_SCALE] = full_scale_field(_UNIT)
    resolution: NonNegative = resolution_field(_UNIT)
    law: ClassVar = ACCELEROMETER

    def parameters(self, vehicle: Any) -> AccelerometerParameters:
        """Return the accelerometer parameters, with the position relative to the centre of mass."""
        position = relative_to_centre(self.position, vehicle)
        vibration = None
        if self.vibration is not None:
            vibration = self.vibration.of_accelerometer(vehicle, Vector(*position), self.period)
        return record_like(
            AccelerometerParameters,
            self,
            position=SensorPosition(*position),
            gravity=vehicle.gravity,
            noise=self.white_noise(),
            errors=self.inertial_errors(vibration),
        )
