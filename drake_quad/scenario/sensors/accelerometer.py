"""Accelerometer of the scenario language."""

import math
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from drake_quad.framework.records import record_like
from drake_quad.laboratory.sensors.accelerometer import ACCELEROMETER, AccelerometerParameters
from drake_quad.scenario.plausible import PLAUSIBLE_SIZE, Plausible, not_in_g
from drake_quad.scenario.quantities import NonNegative, Position, field_from_record
from drake_quad.scenario.sensors.sensor import SENSORS, SensorSettings

# Uncalibrated accelerometers have a bias of up to 0.1 g (1 m/s²), and noise densities of 100 to 400 µg/√Hz.
_PLAUSIBLE_BIAS = not_in_g(upper=5.0, prefix="m")
_PLAUSIBLE_DENSITY = Plausible("m/s²/√Hz", "µg/√Hz", 9.80665e-6, upper=0.5)


@SENSORS.register
class AccelerometerSettings(SensorSettings):
    """Accelerometer, which measures the specific force (without gravity) at its position, in body axes B."""

    kind: Literal["accelerometer"]
    position: Annotated[Position, PLAUSIBLE_SIZE] = field_from_record(
        AccelerometerParameters, "position", "x, y and z in B relative to the origin of `layout`, like `centre_of_mass`"
    )
    bias: Annotated[Position, _PLAUSIBLE_BIAS] = field_from_record(
        AccelerometerParameters, "bias", "constant error along x, y and z"
    )
    noise_density: Annotated[NonNegative, _PLAUSIBLE_DENSITY] = Field(
        default=0.0,
        description="noise density on each axis (m/s²/√Hz); the standard deviation of a reading is this number over the"
        " square root of the period",
    )
    law: ClassVar = ACCELEROMETER
    noise: ClassVar = ("noise_density",)

    def parameters(self, vehicle: Any) -> AccelerometerParameters:
        """Return the accelerometer parameters, with the position relative to the centre of mass."""
        (x, y, z), (centre_x, centre_y) = self.position, vehicle.centre_of_mass
        return record_like(
            AccelerometerParameters,
            self,
            position=(x - centre_x, y - centre_y, z),
            gravity=vehicle.gravity,
            noise=self.noise_density / math.sqrt(self.period),
        )
