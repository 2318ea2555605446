"""Add a wind to the scenario language whose speed grows with height, by the power law over land.

The option `--import scripts/wind_shear.py` makes the wind available in a command.
"""

from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field

from drake_quad.framework.elementary import exp, log, maximum
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.quantities import NonNegative, Positive
from drake_quad.scenario.winds.source import WINDS, BlowingSource, WindSurroundings
from drake_quad.signals import Number, Quantity, State, VelocityW, Wind


class ShearParameters(NamedTuple):
    """Parameters of the power law: velocity at the reference height, reference height, and exponent."""

    velocity: Wind
    reference_height: Annotated[float, Quantity("m")]
    exponent: Number


def shear_wind(state: State, shear: ShearParameters) -> Wind:
    """Return the wind velocity v (z / h)^a at a vehicle, whose height is z."""
    factor = exp(shear.exponent * log(maximum(state.z, 0.01) / shear.reference_height))  # finite slope at 0 m
    return Wind._make(factor * part for part in shear.velocity)


@fleet_system(float, AutoDiffXd)
class ShearWind(FleetSystem):
    """Wind whose speed grows with height."""

    def declare(self, *, period: float = 0.01, parameters: ShearParameters) -> None:
        state, shear = self.input("state"), self.parameter("shear", lambda shear: shear)
        wind = self.state("wind", lambda _: Wind(0.0, 0.0, 0.0))
        self.initialize(shear_wind, state, shear, writes=[wind])
        self.update(period, shear_wind, state, shear, writes=[wind])
        self.state_output(wind)


@WINDS.register
class ShearSource(BlowingSource):
    """Wind that grows with height by a power law; `velocity` is the wind at the reference height."""

    kind: Literal["shear"]
    reference_height: Positive = Field(default=10.0, description="height at which the velocity is given (m)")
    exponent: NonNegative = Field(default=0.143, description="exponent of the power law (1); 1/7 over open land")
    depends_on_position: ClassVar = True
    depends_on_time: ClassVar = False

    def max_speed(self) -> VelocityW:
        """Return the wind speed at ten times the reference height, m/s, as an upper bound."""
        return super().max_speed() * 10.0**self.exponent

    def recipe(self, surroundings: WindSurroundings) -> Recipe:
        parameters = ShearParameters(self.full_velocity(), self.reference_height, self.exponent)
        return Recipe(ShearWind, {"period": surroundings.period}, parameters)
