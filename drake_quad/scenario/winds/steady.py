"""Steady wind in the scenario language."""

from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np

from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.wind.wind import SteadyWind
from drake_quad.scenario.winds.source import WINDS, BlowingSource, WindSource, WindSurroundings
from drake_quad.signals import VelocityW, Wind


@WINDS.register
class SteadySource(BlowingSource):
    """Wind that is independent of position and time. It blows at full speed from the start of the flight."""

    kind: Literal["steady"]
    depends_on_position: ClassVar = False
    depends_on_time: ClassVar = False

    def steady_wind(self) -> Wind:
        """Return the full wind velocity, m/s."""
        return self.full_velocity()

    def max_speed(self) -> VelocityW:
        """Return 0, since this wind has no part that varies."""
        return 0.0

    def recipe(self, surroundings: WindSurroundings) -> Recipe:
        """Return the recipe to build the sum of all steady winds."""
        return Recipe(SteadyWind, {}, surroundings.steady_wind)

    @classmethod
    def recipes(cls, sources: Sequence[WindSource], surroundings: WindSurroundings) -> dict[str, Recipe]:
        """Return the recipe to build one system that outputs the sum of all steady winds; empty if the sum is zero."""
        blows = any(isinstance(part, np.ndarray) or part != 0.0 for part in surroundings.steady_wind)
        return {"steady": sources[0].recipe(surroundings)} if blows else {}
