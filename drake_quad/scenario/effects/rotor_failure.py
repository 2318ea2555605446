"""Rotor failure in the scenario language."""

from collections.abc import Iterator
from typing import Annotated, ClassVar

from pydantic import Field

from drake_quad.framework.elementary import where
from drake_quad.scenario.effects.effect import EFFECTS, VehicleEffect
from drake_quad.scenario.inactive import FlightConditions, InactiveSetting, late_setting
from drake_quad.scenario.quantities import Moment, Number, bounds, integer_bounds
from drake_quad.signals import Row
from drake_quad.vehicle.faults import RotorFaults, SpeedFactors


@EFFECTS.register
class RotorFailureEffect(VehicleEffect):
    """Sudden partial or total loss of speed of one rotor."""

    rotor: Annotated[Number, integer_bounds(ge=1, le=4)] = Field(description="number of the rotor, 1 to 4 (1)")
    time: Moment = Field(description="time of the failure (s)")
    speed_factor: Annotated[Number, bounds(ge=0.0, lt=1.0, is_fraction=True)] = Field(
        default=0.0, description="ratio of the speed after the failure to the commanded speed (1)"
    )
    field: ClassVar = "rotor_failure"
    description: ClassVar = "failure of one rotor; none if not given"
    record: ClassVar = RotorFaults
    is_nominal: ClassVar = False
    depends_on_time: ClassVar = True
    couples_axes: ClassVar = True
    belongs_to_airframe: ClassVar = False

    def parameters(self) -> RotorFaults:
        """Return the time of the failure and the speed factors of all rotors."""
        factors = [where(self.rotor == i + 1.0, self.speed_factor, 1.0) for i in range(len(SpeedFactors._fields))]
        return RotorFaults(failure_time=self.time, failure_factor=SpeedFactors._make(factors))

    def event_times(self) -> tuple[Row, ...]:
        """Return the time of the rotor failure, s."""
        return (self.time,)

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield settings without effect, such as an event after the flight."""
        yield from super().inactive_settings(flight, path)
        yield from late_setting(self, "time", flight, path)
