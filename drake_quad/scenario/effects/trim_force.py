"""Trim force in the scenario language."""

from typing import Any, ClassVar

from drake_quad.scenario.effects.effect import EFFECTS, AirLoadEffect, VehicleEffect
from drake_quad.scenario.quantities import Number, field_from_record
from drake_quad.signals import Row
from drake_quad.vehicle.trim_force import TrimForce


@EFFECTS.register
class TrimForceEffect(AirLoadEffect):
    """Force at the centre of mass that is constant in body axes and unknown to planner and controllers."""

    x: Number = field_from_record(TrimForce, "x", "force along x of B")
    y: Number = field_from_record(TrimForce, "y", "force along y of B")
    z: Number = field_from_record(TrimForce, "z", "force along z of B")
    strength_fields: ClassVar = ("x", "y", "z")
    field: ClassVar = "trim_force"
    description: ClassVar = "force that is constant in the axes of B; none if not given"
    record: ClassVar = TrimForce
    is_nominal: ClassVar = False
    depends_on_time: ClassVar = False
    couples_axes: ClassVar = False
    belongs_to_airframe: ClassVar = True
    depends_on_wind: ClassVar = False

    def symmetric(self) -> VehicleEffect:
        """Return the force without its components along x and y, which would tilt the hovering vehicle."""
        return self.model_copy(update={"x": 0.0, "y": 0.0})

    def max_damping(self, vehicle: Any, airspeed: Row) -> Row:
        """Return 0, since the force does not depend on the speed."""
        return 0.0
