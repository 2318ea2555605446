"""Trim force."""

from typing import Any, ClassVar

from drake_quad.scenario.effects.effect import EFFECTS, AirLoadEffect, VehicleEffect
from drake_quad.scenario.quantities import Number, field_of
from drake_quad.signals import Row
from drake_quad.vehicle.trim_force import TrimForce


@EFFECTS.member
class TrimForceEffect(AirLoadEffect):
    """Constant force along the axes of the vehicle at its centre of mass, unknown to planner and controllers."""

    x: Number = field_of(TrimForce, "x", "along x of B")
    y: Number = field_of(TrimForce, "y", "along y of B")
    z: Number = field_of(TrimForce, "z", "along z of B")
    field: ClassVar = "trim_force"
    meaning: ClassVar = "constant force in the axes of B, if any"
    record: ClassVar = TrimForce
    is_believed: ClassVar = False
    depends_on_time: ClassVar = False
    couples_axes: ClassVar = False
    belongs_to_airframe: ClassVar = True

    def symmetric(self) -> VehicleEffect:
        """Return the part along z, under which the vehicle hovers level."""
        return self.model_copy(update={"x": 0.0, "y": 0.0})

    def max_slope(self, vehicle: Any, airspeed: Row) -> Row:
        """Return 0, since the force does not depend on the speed."""
        return 0.0
