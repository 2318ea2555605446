"""Body drag in the scenario language."""

from functools import reduce
from typing import Annotated, Any, ClassVar

import numpy as np

from drake_quad.scenario.effects.effect import EFFECTS, NO_OFFSET, AirLoadEffect, PerAxis, VehicleEffect
from drake_quad.scenario.plausible import PLAUSIBLE_SIZE
from drake_quad.scenario.quantities import Position, field_from_record
from drake_quad.signals import Row
from drake_quad.vehicle.aerodynamics import BodyDrag


@EFFECTS.register
class BodyDragEffect(AirLoadEffect):
    """Drag of the body on each axis k: F_k = (c1_k + c2_k |u|) u_k, with the air velocity u relative to the body."""

    linear: PerAxis = field_from_record(BodyDrag, "linear", "c1, force over airspeed along x, y, z of B")
    quadratic: PerAxis = field_from_record(BodyDrag, "quadratic", "c2, force over squared airspeed along x, y, z of B")
    centre_of_pressure: Annotated[Position, PLAUSIBLE_SIZE] = field_from_record(
        BodyDrag, "centre_of_pressure", "point at which the drag acts, x, y, z in B relative to the centre of mass"
    )
    strength_fields: ClassVar = ("linear", "quadratic")
    field: ClassVar = "body_drag"
    description: ClassVar = "drag of the body on each axis, in addition to `linear_drag` and `quadratic_drag`"
    record: ClassVar = BodyDrag
    is_nominal: ClassVar = True
    depends_on_time: ClassVar = False
    couples_axes: ClassVar = True
    belongs_to_airframe: ClassVar = True

    def symmetric(self) -> VehicleEffect:
        """Return a drag with equal coefficients that acts at the centre of mass."""
        return self.model_copy(update={"centre_of_pressure": NO_OFFSET})

    def max_damping(self, vehicle: Any, airspeed: Row) -> Row:
        """Return the largest derivative of the drag along an axis with respect to the speed along it, N s/m."""
        pairs = zip(self.linear, self.quadratic, strict=True)
        return reduce(np.maximum, [linear + 2.0 * quadratic * airspeed for linear, quadratic in pairs])
