"""Slung load in the scenario language."""

from typing import Annotated, Any, ClassVar

import numpy as np

from drake_quad.scenario.effects.effect import EFFECTS, VehicleEffect
from drake_quad.scenario.limits import MAX_MAGNITUDE
from drake_quad.scenario.plausible import PLAUSIBLE_LOAD, not_in_millimetres
from drake_quad.scenario.quantities import Number, Positive, bounds, field_from_record
from drake_quad.signals import Row
from drake_quad.vehicle.slung_load import SlungLoad

# Cables are at most tens of metres long.
_PLAUSIBLE_LENGTH = not_in_millimetres(upper=100.0)


@EFFECTS.register
class SlungLoadEffect(VehicleEffect):
    """A point mass on a massless rod that is hinged at the centre of mass of the vehicle."""

    mass: Annotated[Positive, PLAUSIBLE_LOAD] = field_from_record(SlungLoad, "mass", "mass of the load")
    length: Annotated[Number, bounds(ge=0.01, le=MAX_MAGNITUDE), _PLAUSIBLE_LENGTH] = field_from_record(
        SlungLoad, "length", "length of the rod"
    )
    field: ClassVar = "slung_load"
    description: ClassVar = "load on a cable; none if not given; cannot be combined with a payload"
    record: ClassVar = SlungLoad
    is_nominal: ClassVar = False
    depends_on_time: ClassVar = False
    couples_axes: ClassVar = False
    belongs_to_airframe: ClassVar = False

    def natural_frequency(self, vehicle: Any) -> Row:
        """Return the angular frequency of small oscillations below a hovering vehicle, rad/s."""
        return np.sqrt(vehicle.gravity * (1.0 + self.mass / vehicle.mass) / self.length)
