"""Battery."""

from typing import Annotated, ClassVar

from pydantic import model_validator

from drake_quad.scenario.effects.effect import EFFECTS, VehicleEffect
from drake_quad.scenario.quantities import NonNegative, Number, Positive, bounded, extremes, field_of
from drake_quad.vehicle.battery import Battery


@EFFECTS.member
class BatteryEffect(VehicleEffect):
    """A battery that the rotors draw empty; its voltage sags under their current."""

    voltage: Positive = field_of(Battery, "voltage", "of the full battery without current")
    empty_voltage: Positive = field_of(Battery, "empty_voltage", "of the empty battery without current")
    capacity: Positive = field_of(Battery, "capacity", "charge between the two")
    resistance: NonNegative = field_of(Battery, "resistance", "inside of the battery")
    efficiency: Annotated[Number, bounded(least=0.01, most=1.0)] = field_of(
        Battery, "efficiency", "mechanical power of the rotors over electrical power"
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
            raise self.wrong(f"must not be larger than voltage, {least}", "empty_voltage")
        return self
