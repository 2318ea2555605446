"""Battery in the scenario language."""

from typing import Annotated, ClassVar

from pydantic import model_validator

from drake_quad.scenario.effects.effect import EFFECTS, VehicleEffect
from drake_quad.scenario.plausible import Plausible
from drake_quad.scenario.quantities import NonNegative, Number, Positive, bounds, extremes, field_from_record
from drake_quad.vehicle.battery import Battery

# Vehicles of 20 kg have at most 14 cells in series (59 V) and 100 A h. The single cell of a 20 g vehicle has an
# internal resistance of 0.3 Ω.
_PLAUSIBLE_VOLTAGE = Plausible("V", "mV", 1e-3, upper=120.0)
_PLAUSIBLE_CAPACITY = Plausible("A h", "mA h", 1e-3, upper=200.0)
_PLAUSIBLE_RESISTANCE = Plausible("Ω", "mΩ", 1e-3, upper=2.0)


@EFFECTS.register
class BatteryEffect(VehicleEffect):
    """A battery that the rotors discharge. Its voltage falls as the charge decreases, and with increasing current."""

    voltage: Annotated[Positive, _PLAUSIBLE_VOLTAGE] = field_from_record(
        Battery, "voltage", "open-circuit voltage of the full battery"
    )
    empty_voltage: Annotated[Positive, _PLAUSIBLE_VOLTAGE] = field_from_record(
        Battery, "empty_voltage", "open-circuit voltage of the empty battery"
    )
    capacity: Annotated[Positive, _PLAUSIBLE_CAPACITY] = field_from_record(
        Battery, "capacity", "charge of the full battery"
    )
    resistance: Annotated[NonNegative, _PLAUSIBLE_RESISTANCE] = field_from_record(
        Battery, "resistance", "internal resistance"
    )
    efficiency: Annotated[Number, bounds(ge=0.01, le=1.0, is_fraction=True)] = field_from_record(
        Battery, "efficiency", "mechanical power of the rotors over electrical power"
    )
    field: ClassVar = "battery"
    description: ClassVar = "battery that the rotors discharge; the voltage is constant if not given"
    record: ClassVar = Battery
    is_nominal: ClassVar = False
    depends_on_time: ClassVar = True
    couples_axes: ClassVar = False
    belongs_to_airframe: ClassVar = True

    @model_validator(mode="after")
    def _voltage_falls(self) -> "BatteryEffect":
        lowest = extremes(self.voltage)[0] or 0.0
        highest_empty = extremes(self.empty_voltage)[1]
        if highest_empty is None or not lowest >= highest_empty:
            raise self.field_error(f"must not be larger than voltage, {lowest}", "empty_voltage")
        return self
