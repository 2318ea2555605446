"""Steady wind."""

from collections.abc import Sequence
from typing import ClassVar, Literal

import numpy as np

from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.wind.wind import SteadyWind
from drake_quad.scenario.winds.source import WINDS, BlowingSource, Surroundings, WindSource
from drake_quad.signals import VelocityW, Wind


@WINDS.member
class SteadySource(BlowingSource):
    """The same wind everywhere, always."""

    kind: Literal["steady"]
    depends_on_place: ClassVar = False
    depends_on_time: ClassVar = False

    def steady_wind(self) -> Wind:
        """Return all of the wind."""
        return self.full_velocity()

    def max_speed(self) -> VelocityW:
        """Return 0, since all of the wind is steady."""
        return 0.0

    @classmethod
    def recipes(cls, sources: Sequence[WindSource], surroundings: Surroundings) -> dict[str, Recipe]:
        """Return the recipe for one system, which makes the sum of all steady winds; none if the air is at rest."""
        wind = surroundings.steady_wind
        blows = any(isinstance(part, np.ndarray) or part != 0.0 for part in wind)
        return {"steady": Recipe(SteadyWind, {}, wind)} if blows else {}
