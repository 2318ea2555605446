"""Planning of a minimum-snap path for given constraints, with several methods for the waypoint times."""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from drake_quad.errors import InputError
from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.reference.regions import Box, WaypointRegion
from drake_quad.reference.time_allocation import rest_to_rest_durations
from drake_quad.reference.timing_search import (
    heuristic_path,
    minimum_snap_path,
    minimum_time_path,
    path_or_reason,
    path_with_fixed_derivatives,
)

# Largest duration of a path, s (one day). Longer durations are probably mistakes.
_MAX_DURATION = 86_400.0


@dataclass(frozen=True)
class FixedTimes:
    """Timing with given times.

    Attributes:
        times: (segments + 1,) increasing times of the waypoints, s.
    """

    times: tuple[float, ...]


@dataclass(frozen=True)
class HeuristicTiming:
    """Heuristic timing: the faster of a non-stop and a stop-at-every-waypoint profile, scaled to the limits.

    If a nonzero derivative is given at a waypoint, scaling would change it. Several total durations are then tried, and
    the first feasible timing is used.
    """


@dataclass(frozen=True)
class MinimumSnapTiming:
    """Timing with the smallest integrated squared snap for a given total duration.

    Attributes:
        duration: total duration, s.
    """

    duration: float


@dataclass(frozen=True)
class MinimumTimeTiming:
    """Timing with the shortest total duration at which the minimum-snap path satisfies the limits.

    The duration is a local optimum. The times of a flight that stops at every waypoint are used if they are not slower.
    """


Timing = FixedTimes | HeuristicTiming | MinimumSnapTiming | MinimumTimeTiming
"""Method to choose the times of a path."""


def plan_path(problem: PathProblem, timing: Timing) -> PolynomialPath:
    """Return the minimum-snap path that satisfies the constraints of a problem.

    If the times are given, the vehicle stops at a repeated waypoint. Otherwise repeated waypoints are merged into one.

    Raises:
        InputError: if no such path exists or is found (the message gives the reason), times do not increase, necessary
            limits are missing, or all waypoints are equal.
    """
    match timing:
        case FixedTimes(times):
            return _at_given_times(problem, np.asarray(times, dtype=float))
        case MinimumSnapTiming(duration):
            if not 0.0 < duration <= _MAX_DURATION:
                raise InputError(
                    f"the total duration is {duration:g} s, but must be positive and at most {_MAX_DURATION:g} s"
                )
            return minimum_snap_path(without_repeats(problem), duration)
    if not isinstance(timing, HeuristicTiming | MinimumTimeTiming):
        raise TypeError(f"{timing!r} is not a FixedTimes, HeuristicTiming, MinimumSnapTiming or MinimumTimeTiming")
    if not problem.limits.by_order:
        raise InputError("the total time cannot be chosen without limits; give a limit on the speed or acceleration")
    shorten = isinstance(timing, MinimumTimeTiming)
    problem = without_repeats(problem)
    _check_duration(problem)
    if not problem.is_time_scalable:
        return path_with_fixed_derivatives(problem, shorten=shorten)
    return minimum_time_path(problem) if shorten else heuristic_path(problem)


def _check_duration(problem: PathProblem) -> None:
    """Raise InputError if the route takes too long within its limits."""
    duration = float(rest_to_rest_durations(problem.representatives(), problem.limits).sum())
    if duration > _MAX_DURATION:
        raise InputError(f"within the limits the route would take about {duration:g} s, more than {_MAX_DURATION:g} s")


def without_repeats(problem: PathProblem) -> PathProblem:
    """Return the problem with successive waypoints at the same point merged into one.

    Raises:
        InputError: if the derivatives given at repeated waypoints differ, or all waypoints are equal.
    """
    kept: list[int] = []
    derivatives = problem.derivatives.copy()
    for i, region in enumerate(problem.waypoints):
        if not (kept and _repeats(problem.waypoints[kept[-1]], region)):
            kept.append(i)
            continue
        kept_derivatives, repeated_derivatives = derivatives[kept[-1]], derivatives[i]
        if (
            (kept_derivatives != repeated_derivatives) & ~np.isnan(kept_derivatives) & ~np.isnan(repeated_derivatives)
        ).any():
            raise InputError(f"waypoint {i} repeats waypoint {i - 1}, but different derivatives are given at the two")
        derivatives[kept[-1]] = np.where(np.isnan(kept_derivatives), repeated_derivatives, kept_derivatives)
    if len(kept) < 2:
        raise InputError(f"all waypoints are the same point, {problem.waypoints[0]} m; there is nothing to fly")
    # Segment i - 1 leads to waypoint i, so its corridor is kept if waypoint i is kept.
    corridors = [problem.corridors[i - 1] for i in kept[1:]]
    return PathProblem(
        [problem.waypoints[i] for i in kept],
        derivatives=derivatives[kept],
        corridors=corridors,
        limits=problem.limits,
        start=None if problem.start is None else problem.start[kept],
    )


def passing_times(problem: PathProblem, path: PolynomialPath) -> np.ndarray:
    """Return the (waypoints,) times at which a path passes the waypoints of its problem, s."""
    if len(path.times) == len(problem.waypoints):
        return path.times
    is_new = [not _repeats(one, other) for one, other in itertools.pairwise(problem.waypoints)]
    return np.asarray(path.times[np.cumsum([0, *is_new])])


def _repeats(one: WaypointRegion, other: WaypointRegion) -> bool:
    """Return whether both regions are the same point."""
    return isinstance(one, Box) and isinstance(other, Box) and one.is_point and one.equals(other)


def _at_given_times(problem: PathProblem, times: np.ndarray) -> PolynomialPath:
    """Return the path for given times (waypoints,), s, with a stop where a waypoint is repeated."""
    if times.shape != (len(problem.waypoints),):
        raise InputError(f"there are {times.size} times for {len(problem.waypoints)} waypoints; give one for each")
    if not np.isfinite(times).all():
        raise InputError("times must be finite and increase")
    decreasing = np.flatnonzero(np.diff(times) <= 0.0)
    if times[-1] - times[0] > _MAX_DURATION:
        raise InputError(f"the times span {times[-1] - times[0]:g} s, more than {_MAX_DURATION:g} s")
    if decreasing.size:
        i = int(decreasing[0])
        raise InputError(f"times must be finite and increase, but {times[i]:g} s is followed by {times[i + 1]:g} s")
    derivatives = problem.derivatives.copy()
    for i in range(problem.segments):
        if _repeats(problem.waypoints[i], problem.waypoints[i + 1]):
            pair = derivatives[i : i + 2]
            pair[np.isnan(pair)] = 0.0
    with_stops = replace(problem, derivatives=derivatives)
    return path_or_reason(with_stops, np.diff(times))._replace(times=times)
