"""Accelerometer of the scenario language."""

import math
from typing import Any, ClassVar, Literal

from pydantic import Field

from drake_quad.framework.records import record_like
from drake_quad.laboratory.sensors.accelerometer import ACCELEROMETER, AccelerometerNumbers
from drake_quad.scenario.quantities import NonNegative, Position, field_of
from drake_quad.scenario.sensors.sensor import SENSORS, SensorSettings


@SENSORS.member
class AccelerometerSettings(SensorSettings):
    """Accelerometer, which measures the specific force (without gravity) at its position, in the axes of B."""

    kind: Literal["accelerometer"]
    position: Position = field_of(
        AccelerometerNumbers, "position", "x, y and z in B relative to the origin of `layout`, like `centre_of_mass`"
    )
    bias: Position = field_of(AccelerometerNumbers, "bias", "constant error along x, y and z")
    noise_density: NonNegative = Field(
        default=0.0,
        description="noise density on each axis (m/s²/√Hz); the standard deviation of a reading is this number over the"
        " square root of the period",
    )
    law: ClassVar = ACCELEROMETER
    noise: ClassVar = ("noise_density",)

    def numbers(self, vehicle: Any) -> AccelerometerNumbers:
        """Return the numbers of the accelerometer, with its position relative to the centre of mass."""
        (x, y, z), (centre_x, centre_y) = self.position, vehicle.centre_of_mass
        return record_like(
            AccelerometerNumbers,
            self,
            position=(x - centre_x, y - centre_y, z),
            gravity=vehicle.gravity,
            noise=self.noise_density / math.sqrt(self.period),
        )
