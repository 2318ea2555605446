"""Sinusoidal wind in the scenario language."""

from typing import ClassVar, Literal

from pydantic import Field

from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.wind.sine import SineParameters, SineWind
from drake_quad.scenario.quantities import Direction, Positive
from drake_quad.scenario.winds.source import WINDS, BlowingSource, WindSurroundings


@WINDS.register
class SineSource(BlowingSource):
    """A wind whose velocity is a sine of time, so that it reverses periodically."""

    kind: Literal["sine"]
    frequency: Positive = Field(description="angular frequency (rad/s)")
    phase: Direction = Field(default=0.0, description="phase at time zero (rad)")
    depends_on_position: ClassVar = False
    depends_on_time: ClassVar = True

    def recipe(self, surroundings: WindSurroundings) -> Recipe:
        """Return the recipe to build a `SineWind`."""
        parameters = SineParameters(self.full_velocity(), self.frequency, self.phase)
        return Recipe(SineWind, {"period": surroundings.period}, parameters)
