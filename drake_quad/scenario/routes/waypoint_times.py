"""Choices of the times at which waypoints are passed."""

import itertools
from abc import abstractmethod
from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator

from drake_quad.reference import planner
from drake_quad.reference.planner import Timing
from drake_quad.scenario.distributions import Model, Real, refused
from drake_quad.scenario.limits import LONGEST, SHORTEST
from drake_quad.scenario.quantities import PlainSpan
from drake_quad.scenario.routes.route import KnownEnd


class WaypointTimes(Model):
    """Choice of the times at which waypoints are passed.

    Attributes:
        chooses_total: whether the total time is chosen, which needs a limit on the speed or on the acceleration.
    """

    chooses_total: ClassVar[bool] = False

    def known_end(self, laps: int) -> KnownEnd | None:
        """Return the field that determines the end of a number of laps, and this time, s; None if a plan does."""
        return None

    @abstractmethod
    def timing(self) -> Timing:
        """Return how the planner chooses the times."""


class Given(WaypointTimes):
    """When to pass each waypoint; a list of numbers alone is short for its times."""

    kind: Literal["given"]
    times: Annotated[tuple[Real, ...], Field(strict=False, min_length=1)] = Field(
        description="one for each waypoint, increasing (s)"
    )

    @field_validator("times")
    @classmethod
    def _increasing(cls, times: tuple[float, ...]) -> tuple[float, ...]:
        if times[0] < 0.0:
            raise refused("must start at 0 or later")
        for i, (now, then) in enumerate(itertools.pairwise(times)):
            if not then - now >= SHORTEST:
                raise refused(f"must increase, each time by {SHORTEST} s or more; time {i + 1} does not")
        if times[-1] > LONGEST:
            raise refused(f"must end by {LONGEST} s")
        return times

    def known_end(self, laps: int) -> KnownEnd | None:
        """Return the field of the times, and the time at which the last lap ends, s."""
        return ("route", "times"), self.times[0] + laps * (self.times[-1] - self.times[0])

    def timing(self) -> Timing:
        """Return how the planner chooses the times."""
        return planner.GivenTimes(self.times)


class HeuristicTimes(WaypointTimes):
    """Heuristic timing: the faster of a ride without stops and one that stops everywhere, stretched to the limits."""

    chooses_total: ClassVar = True
    kind: Literal["heuristic"]

    def timing(self) -> Timing:
        """Return how the planner chooses the times."""
        return planner.Heuristic()


class LeastSnapTimes(WaypointTimes):
    """The times with the least snap in a given total."""

    kind: Literal["least_snap"]
    duration: PlainSpan = Field(description="total (s)")

    def known_end(self, laps: int) -> KnownEnd | None:
        """Return the field of the duration, and the duration, s."""
        return ("route", "times", "duration"), self.duration

    def timing(self) -> Timing:
        """Return how the planner chooses the times."""
        return planner.LeastSnap(self.duration)


class ShortestTimes(WaypointTimes):
    """The least total time for which the minimum-snap path keeps to the limits, a local optimum."""

    chooses_total: ClassVar = True
    kind: Literal["shortest"]

    def timing(self) -> Timing:
        """Return how the planner chooses the times."""
        return planner.Shortest()


Times = Annotated[Given | HeuristicTimes | LeastSnapTimes | ShortestTimes, Field(discriminator="kind")]
