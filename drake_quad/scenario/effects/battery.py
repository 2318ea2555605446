"""Battery."""

from typing import Annotated, ClassVar

from pydantic import Field, model_validator

from drake_quad.scenario.effects.effect import EFFECTS, VehicleEffect
from drake_quad.scenario.quantities import NonNegative, Number, Positive, bounded, extremes
from drake_quad.vehicle.battery import Battery


@EFFECTS.member
class BatteryEffect(VehicleEffect):
    """A battery that the rotors draw empty; its voltage sags under their current."""

    voltage: Positive = Field(description="of the full battery without current (V)")
    empty_voltage: Positive = Field(description="of the empty battery without current (V)")
    capacity: Positive = Field(description="charge between the two (A h)")
    resistance: NonNegative = Field(description="inside of the battery (Ω)")
    efficiency: Annotated[Number, bounded(least=0.01, most=1.0)] = Field(
        description="mechanical power of the rotors over electrical power (1)"
    )
    field: ClassVar = "battery"
    meaning: ClassVar = "that is drawn empty, if any; else the voltage is constant"
    record: ClassVar = Battery
    is_believed: ClassVar = False
    depends_on_time: ClassVar = True
    couples_axes: ClassVar = False
    belongs_to_airframe: ClassVar = True

    @model_validator(mode="after")
    def _falls(self) -> "BatteryEffect":
        least = extremes(self.voltage)[0] or 0.0
        most = extremes(self.empty_voltage)[1]
        if most is None or not least >= most:
            demand = "must not be larger than voltage, {voltage}"
            raise self.wrong("empty_voltage", kind="voltage", demand=demand, voltage=least)
        return self
