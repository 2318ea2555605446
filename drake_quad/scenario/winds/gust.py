"""Discrete gust in the scenario language."""

import math
from collections.abc import Iterator
from typing import ClassVar, Literal

from pydantic import Field

from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.wind.gust import Gust, GustParameters
from drake_quad.scenario.inactive import FlightConditions, InactiveSetting, late_setting
from drake_quad.scenario.quantities import Moment, Span
from drake_quad.scenario.winds.source import WINDS, BlowingSource, WindSurroundings


@WINDS.register
class GustSource(BlowingSource):
    """A 1-cosine gust: it rises over the rise time, holds its peak, and falls over the same time."""

    kind: Literal["gust"]
    start: Moment = Field(description="time at which the gust begins (s)")
    rise_time: Span = Field(description="time from zero to the peak velocity (s)")
    hold_time: Moment | None = Field(
        default=None,
        description="time at the peak velocity (s); if not given, the gust never falls, as in MIL-F-8785C, and becomes"
        " a steady wind",
    )
    depends_on_position: ClassVar = False
    depends_on_time: ClassVar = True

    def recipe(self, surroundings: WindSurroundings) -> Recipe:
        """Return the recipe to build a `Gust`."""
        hold_time = math.inf if self.hold_time is None else self.hold_time
        parameters = GustParameters(self.full_velocity(), self.start, self.rise_time, hold_time)
        return Recipe(Gust, {"period": surroundings.period}, parameters)

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield settings without effect, such as a gust that begins after the flight."""
        yield from super().inactive_settings(flight, path)
        yield from late_setting(self, "start", flight, path)
