"""Add an effect on the vehicle to the scenario language: rotors gain thrust below a ceiling.

The option `--import scripts/ceiling_effect.py` makes the effect available in a command.
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
    """Ceiling above the rotors: rotor radius R, and height of the ceiling above the origin of W.

    The fields have the same names as in the scenario language.
    """

    rotor_radius: Annotated[Row, Quantity("m")]
    height: PositionW

    def load(self, flow: Flow) -> Load:
        """Return the additional thrust, (R / 4d)² times the thrust, for a distance d ≥ R / 2 to the ceiling."""
        ratio = 0.25 * self.rotor_radius / maximum(self.height - flow.height, 0.5 * self.rotor_radius)
        return Load(Vector(0.0, 0.0, ratio * ratio * flow.wrench.thrust), Vector(0.0, 0.0, 0.0))


@EFFECTS.register
class CeilingEffect(AirLoadEffect):
    """Additional thrust of rotors below a ceiling."""

    rotor_radius: NonNegative = Field(description="R (m)")
    height: Number = Field(default=2.0, description="z of the ceiling in W (m)")
    field: ClassVar = "ceiling"
    description: ClassVar = "above the vehicle, if any"
    record: ClassVar = Ceiling
    is_nominal: ClassVar = False
    depends_on_time: ClassVar = True  # the controller ignores the additional thrust, so the vehicle rises over time
    couples_axes: ClassVar = False
    belongs_to_airframe: ClassVar = False

    def max_damping(self, vehicle: Any, airspeed: Row) -> Row:
        """Return 0, since the load depends on the height and not on the speed."""
        return 0.0
