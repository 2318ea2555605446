"""Discrete gust."""

import math
from typing import ClassVar, Literal

from pydantic import Field

from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.wind.gust import Gust, GustNumbers
from drake_quad.scenario.quantities import Moment, Span
from drake_quad.scenario.winds.source import WINDS, BlowingSource, WindSurroundings


@WINDS.member
class GustSource(BlowingSource):
    """A 1-cosine gust: it comes over the rise time, stays, and goes as it came."""

    kind: Literal["gust"]
    start: Moment = Field(description="when it begins (s)")
    rise_time: Span = Field(description="from nothing to full height (s)")
    hold_time: Moment | None = Field(
        default=None, description="at full height (s); for good if not given, as in MIL-F-8785C"
    )
    depends_on_place: ClassVar = False
    depends_on_time: ClassVar = True

    def recipe(self, surroundings: WindSurroundings) -> Recipe:
        """Return the recipe for a `Gust`."""
        hold_time = math.inf if self.hold_time is None else self.hold_time
        numbers = GustNumbers(self.full_velocity(), self.start, self.rise_time, hold_time)
        return Recipe(Gust, {"period": surroundings.period}, numbers)
