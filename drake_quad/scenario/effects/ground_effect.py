"""Ground effect in the scenario language."""

from typing import Annotated, ClassVar

from pydantic import Field

from drake_quad.scenario.effects.effect import EFFECTS, VehicleEffect
from drake_quad.scenario.plausible import not_in_millimetres
from drake_quad.scenario.quantities import Number, Positive, field_from_record
from drake_quad.vehicle.aerodynamics import GroundEffect

# Propellers of 20 kg quadrotors have a radius of 0.4 m.
_PLAUSIBLE_RADIUS = not_in_millimetres(upper=1.0)


@EFFECTS.register
class NearGroundEffect(VehicleEffect):
    """Increase of the thrust near the ground, by 1 / (1 - (R / 4z)²) (Cheeseman and Bennett 1955) but at most 4/3."""

    rotor_radius: Annotated[Positive, _PLAUSIBLE_RADIUS] = field_from_record(
        GroundEffect, "rotor_radius", "radius R of a rotor"
    )
    ground_height: Number = Field(default=0.0, description="z of the ground in W (m)")
    field: ClassVar = "ground_effect"
    description: ClassVar = "increase of the thrust near the ground; none if not given"
    record: ClassVar = GroundEffect
    is_nominal: ClassVar = False
    depends_on_time: ClassVar = False
    couples_axes: ClassVar = False
    belongs_to_airframe: ClassVar = True
