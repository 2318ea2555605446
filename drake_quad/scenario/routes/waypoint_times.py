"""Methods that choose the waypoint times, in the scenario language."""

import itertools
from abc import abstractmethod
from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator

from drake_quad.reference import planner
from drake_quad.reference.planner import Timing
from drake_quad.scenario.distributions import Model, Real, validation_error
from drake_quad.scenario.limits import MAX_DURATION, MIN_DURATION
from drake_quad.scenario.quantities import FixedSpan
from drake_quad.scenario.routes.route import KnownEnd


class WaypointTimes(Model):
    """Method that chooses the times at which the reference passes the waypoints.

    Attributes:
        chooses_total: True if the method chooses the total time, which requires a limit on speed or acceleration.
    """

    chooses_total: ClassVar[bool] = False

    def known_end_time(self, laps: int) -> KnownEnd | None:
        """Return the field that sets the end time of the last lap, and this time (s), or None if it must be planned."""
        return None

    @abstractmethod
    def timing(self) -> Timing:
        """Return the object that represents this method in the planner."""


class FixedWaypointTimes(WaypointTimes):
    """Given times for all waypoints. A plain list of times is an abbreviation of this mapping."""

    kind: Literal["fixed"]
    times: Annotated[tuple[Real, ...], Field(strict=False, min_length=1)] = Field(
        description="time of each waypoint, increasing (s)"
    )

    @field_validator("times")
    @classmethod
    def _times_increase(cls, times: tuple[float, ...]) -> tuple[float, ...]:
        if times[0] < 0.0:
            raise validation_error("must not be negative")
        for now, then in itertools.pairwise(times):
            if not then - now >= MIN_DURATION:
                raise validation_error(
                    f"must increase by at least {MIN_DURATION} s from one to the next, but {now} s is followed by"
                    f" {then} s"
                )
        if times[-1] > MAX_DURATION:
            raise validation_error(f"must not exceed {MAX_DURATION} s")
        return times

    def known_end_time(self, laps: int) -> KnownEnd | None:
        """Return the field that contains the times, and the time at which the last lap ends, s."""
        return ("route", "times"), self.times[0] + laps * (self.times[-1] - self.times[0])

    def timing(self) -> Timing:
        """Return the object that represents this method in the planner."""
        return planner.FixedTimes(self.times)


class HeuristicTimes(WaypointTimes):
    """Heuristic timing: the faster of a non-stop and a stop-at-every-waypoint profile, scaled to the limits."""

    chooses_total: ClassVar = True
    kind: Literal["heuristic"]

    def timing(self) -> Timing:
        """Return the object that represents this method in the planner."""
        return planner.HeuristicTiming()


class MinimumSnapTimes(WaypointTimes):
    """Times that minimise the snap of the path for a given total time."""

    kind: Literal["minimum_snap"]
    duration: FixedSpan = Field(description="total time (s)")

    def known_end_time(self, laps: int) -> KnownEnd | None:
        """Return the field that contains the duration, and the duration, s."""
        return ("route", "times", "duration"), self.duration

    def timing(self) -> Timing:
        """Return the object that represents this method in the planner."""
        return planner.MinimumSnapTiming(self.duration)


class MinimumTimes(WaypointTimes):
    """Times with the (locally) shortest total for which the minimum-snap path satisfies the limits."""

    chooses_total: ClassVar = True
    kind: Literal["minimum_time"]

    def timing(self) -> Timing:
        """Return the object that represents this method in the planner."""
        return planner.MinimumTimeTiming()


Times = Annotated[FixedWaypointTimes | HeuristicTimes | MinimumSnapTimes | MinimumTimes, Field(discriminator="kind")]
