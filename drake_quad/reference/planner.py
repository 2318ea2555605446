"""From what a path must keep to, and a way to choose its times, to the path."""

import itertools
from dataclasses import dataclass, replace

import numpy as np

from drake_quad.errors import InputError
from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.reference.regions import Box, Place
from drake_quad.reference.time_allocation import rest_to_rest_durations
from drake_quad.reference.timing_search import (
    heuristic_path,
    least_snap_path,
    path_or_reason,
    path_through_given_motion,
    shortest_path,
)

# Nothing flies for longer than a day, s.
_LONGEST = 86_400.0


@dataclass(frozen=True)
class GivenTimes:
    """The waypoints are passed when they are said to be.

    Attributes:
        times: (segments + 1,) increasing, s.
    """

    times: tuple[float, ...]


@dataclass(frozen=True)
class Heuristic:
    """By rule: the shorter of a ride without stops and a flight with stops everywhere, stretched to the limits.

    Where a velocity, say, is given at a waypoint, no stretch keeps it: then the first feasible one of several totals.
    """


@dataclass(frozen=True)
class LeastSnap:
    """The times with the least snap in a given total.

    Attributes:
        duration: s.
    """

    duration: float


@dataclass(frozen=True)
class Shortest:
    """The least total time for which the minimum-snap path keeps to the limits, a local optimum.

    Where stopping at every waypoint takes no longer, with the times of that.
    """


Timing = GivenTimes | Heuristic | LeastSnap | Shortest


def plan_path(problem: PathProblem, timing: Timing) -> PolynomialPath:
    """Returns the minimum-snap path that keeps to a problem's demands, with its times chosen.

    Waypoints that repeat the one before are one waypoint if the times are chosen here; if they are given, the vehicle
    stays there.

    Args:
        problem: what the path must keep to.
        timing: how its times are chosen.

    Raises:
        InputError: there is no such path, or none is found; the message says why. Or times do not increase, limits that
            are needed are missing, or all waypoints are the same.
    """
    match timing:
        case GivenTimes(times):
            return _at_given_times(problem, np.asarray(times, dtype=float))
        case LeastSnap(duration):
            if not 0.0 < duration <= _LONGEST:
                raise InputError(
                    f"the total duration is {duration:g} s, but must be positive, and {_LONGEST:g} at most"
                )
            return least_snap_path(merged(problem), duration)
    if not isinstance(timing, Heuristic | Shortest):
        raise TypeError(f"{timing!r} is not a way to choose times")
    if not problem.limits.by_order:
        raise InputError("to choose the total time, a limit on the speed or the acceleration is needed")
    shorten = isinstance(timing, Shortest)
    problem = merged(problem)
    _check_duration(problem)
    if not problem.stretchable:
        return path_through_given_motion(problem, shorten=shorten)
    return shortest_path(problem) if shorten else heuristic_path(problem)


def _check_duration(problem: PathProblem) -> None:
    """Raises InputError if the route is too long."""
    duration = float(rest_to_rest_durations(problem.representatives(), problem.limits).sum())
    if duration > _LONGEST:
        raise InputError(f"within the limits the route would take about {duration:g} s, more than {_LONGEST:g} s")


def merged(problem: PathProblem) -> PathProblem:
    """Returns the problem with each run of waypoints that repeat one point as one waypoint.

    Raises:
        InputError: what is given at repeats contradicts itself, or nothing is left to fly.
    """
    keep: list[int] = []
    derivatives = problem.derivatives.copy()
    for i, place in enumerate(problem.places):
        if not (keep and _repeats(problem.places[keep[-1]], place)):
            keep.append(i)
            continue
        here, there = derivatives[keep[-1]], derivatives[i]
        if ((here != there) & ~np.isnan(here) & ~np.isnan(there)).any():
            raise InputError(f"waypoint {i} repeats waypoint {i - 1}, but another derivative is given there")
        derivatives[keep[-1]] = np.where(np.isnan(here), there, here)
    if len(keep) < 2:
        raise InputError(f"all waypoints are the same point, {problem.places[0]} m; there is nothing to fly")
    # The segments that are left are those that lead to the waypoints that are left.
    corridors = [problem.corridors[i - 1] for i in keep[1:]]
    return PathProblem(
        [problem.places[i] for i in keep],
        derivatives=derivatives[keep],
        corridors=corridors,
        limits=problem.limits,
        start=None if problem.start is None else problem.start[keep],
    )


def passing_times(problem: PathProblem, path: PolynomialPath) -> np.ndarray:
    """Returns the (waypoints,) times at which a path planned for a problem passes its waypoints, s."""
    if len(path.times) == len(problem.places):
        return path.times
    new = [not _repeats(one, other) for one, other in itertools.pairwise(problem.places)]
    return np.asarray(path.times[np.cumsum([0, *new])])


def _repeats(one: Place, other: Place) -> bool:
    """True if both are the same point."""
    return isinstance(one, Box) and isinstance(other, Box) and one.is_point and one.equals(other)


def _at_given_times(problem: PathProblem, times: np.ndarray) -> PolynomialPath:
    if times.shape != (len(problem.places),):
        raise InputError(f"there are {times.size} times for {len(problem.places)} waypoints")
    if not np.isfinite(times).all():
        raise InputError("times must be finite and increase")
    late = np.flatnonzero(np.diff(times) <= 0.0)
    if times[-1] - times[0] > _LONGEST:
        raise InputError(f"the times span {times[-1] - times[0]:g} s, more than {_LONGEST:g} s")
    if late.size:
        i = int(late[0])
        raise InputError(f"times must be finite and increase, but {times[i]:g} s is followed by {times[i + 1]:g} s")
    derivatives = problem.derivatives.copy()
    for i in range(problem.segments):
        if _repeats(problem.places[i], problem.places[i + 1]):
            pair = derivatives[i : i + 2]
            pair[np.isnan(pair)] = 0.0
    staying = replace(problem, derivatives=derivatives)
    return path_or_reason(staying, np.diff(times))._replace(times=times)
