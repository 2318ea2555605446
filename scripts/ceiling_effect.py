"""An effect of your own on the vehicle: rotors gain thrust below a ceiling.

Commands know it after `--import scripts/ceiling_effect.py`.
"""

from typing import Annotated, Any, ClassVar, NamedTuple

from pydantic import Field

from drake_quad.framework.elementary import maximum
from drake_quad.geometry.axes import Vector
from drake_quad.scenario.effects.effect import EFFECTS, AirLoadEffect
from drake_quad.scenario.quantities import NonNegative, Number
from drake_quad.signals import PositionW, Quantity, Row
from drake_quad.vehicle.aerodynamics import Flow, Load


class Ceiling(NamedTuple):
    """Ceiling above the rotors. The names of the numbers are those of the fields in the scenario language."""

    rotor_radius: Annotated[Row, Quantity("m")]
    height: PositionW

    def load(self, flow: Flow) -> Load:
        """Return the thrust that is gained, (R / 4d)² of the thrust at the distance d, which is at least R / 2."""
        ratio = 0.25 * self.rotor_radius / maximum(self.height - flow.height, 0.5 * self.rotor_radius)
        return Load(Vector(0.0, 0.0, ratio * ratio * flow.wrench.thrust), Vector(0.0, 0.0, 0.0))


@EFFECTS.member
class CeilingEffect(AirLoadEffect):
    """Thrust that rotors gain below a ceiling."""

    rotor_radius: NonNegative = Field(description="R (m)")
    height: Number = Field(default=2.0, description="z of the ceiling in W (m)")
    field: ClassVar = "ceiling"
    meaning: ClassVar = "above the vehicle, if any"
    record: ClassVar = Ceiling
    is_believed: ClassVar = False
    depends_on_time: ClassVar = True  # the vehicle rises, since its controller does not know the thrust
    couples_axes: ClassVar = False
    belongs_to_airframe: ClassVar = False

    def max_slope(self, vehicle: Any, airspeed: Row) -> Row:
        """Return 0, since the load depends on the height and not on the speed."""
        return 0.0
