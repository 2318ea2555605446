"""From what a path must keep to, and a way to choose its times, to the path."""

import itertools
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from drake_quad.errors import InputError
from drake_quad.reference.infeasibility import explain
from drake_quad.reference.minimum_snap import Contact, snap_cost
from drake_quad.reference.minimum_snap_program import InfeasibleError, path_within
from drake_quad.reference.path_problem import Box, Limits, PathProblem
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate_at, turning_points
from drake_quad.reference.time_allocation import rest_to_rest_durations, stretch_factor, trapezoid_times
from drake_quad.reference.time_optimization import least_snap_durations, shortest_durations

# Without limits, times are shared out as with these; only their ratios count.
_ANY_LIMITS = Limits(acceleration=1.0)
# No segment gets less than this share of the longest one to begin with: less for a route of points, which is planned
# in closed form, than for one that needs the solver.
_LEAST_SHARE_OF_POINTS, _LEAST_SHARE = 1e-3, 1e-2
# Rounds of fitting times to where the path goes, if it may choose; and the gain in time for which one more is worth it.
_ROUNDS = 10
_LEAST_GAIN = 1e-3
# A path touches a corridor within this share of its largest extent, at least this far from the segment's ends.
_TOUCHING, _CONTACT_ROOM = 1e-4, 0.02
# How far the logarithms of the durations move in a round, at first and at least.
_FIRST_REACH, _LAST_REACH = 0.3, 0.02
_BISECTIONS = 6
# A flight that takes more than this share of one with stops everywhere is searched for from another start too.
_LITTLE_GAINED = 0.95
# Durations of a flight through given velocities that are tried, as factors of one with stops everywhere.
_TRIED = (0.7, 0.85, 1.0, 1.25, 1.6, 2.5)


@dataclass(frozen=True)
class GivenTimes:
    """The waypoints are passed when they are said to be.

    Attributes:
        times: (segments + 1,) increasing, s.
    """

    times: tuple[float, ...]


@dataclass(frozen=True)
class Heuristic:
    """By rule: the shorter of a ride without stops and a flight with stops everywhere, stretched to the limits."""


@dataclass(frozen=True)
class LeastSnap:
    """The times with the least snap in a given total.

    Attributes:
        duration: s.
    """

    duration: float


@dataclass(frozen=True)
class Shortest:
    """The least total time for which the minimum-snap path keeps to the limits."""


Timing = GivenTimes | Heuristic | LeastSnap | Shortest


def plan_path(problem: PathProblem, timing: Timing) -> PolynomialPath:
    """Returns the minimum-snap path that keeps to a problem's demands, with its times chosen.

    Waypoints that repeat the one before are one waypoint if the times are chosen here; if they are given, the vehicle
    stays there.

    Args:
        problem: what the path must keep to.
        timing: how its times are chosen.

    Raises:
        InputError: no such path exists; the message says why. Or times do not increase, limits that are needed are
            missing, or all waypoints are the same.
        RuntimeError: the solver failed.
    """
    match timing:
        case GivenTimes(times):
            return _at_given_times(problem, np.asarray(times, dtype=float))
        case LeastSnap(duration):
            if not 0.0 < duration < np.inf:
                raise InputError(f"the total duration is {duration:g} s, but must be positive")
            return _least_snap(merged(problem), duration)
    if not problem.limits.by_order:
        raise InputError("to choose the total time, a limit on the speed or the acceleration is needed")
    shorten = isinstance(timing, Shortest)
    problem = merged(problem)
    if not problem.stretchable:
        return _through_given_motion(problem, shorten=shorten)
    return _shortest(problem) if shorten else _heuristic(problem)


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
        [problem.places[i] for i in keep], derivatives=derivatives[keep], corridors=corridors, limits=problem.limits
    )


def passing_times(problem: PathProblem, path: PolynomialPath) -> np.ndarray:
    """Returns the (waypoints,) times at which a path planned for a problem passes its waypoints, s."""
    if len(path.times) == len(problem.places):
        return path.times
    new = [not _repeats(one, other) for one, other in itertools.pairwise(problem.places)]
    return np.asarray(path.times[np.cumsum([0, *new])])


def _repeats(one: object, other: object) -> bool:
    """Whether both are the same point."""
    if not (isinstance(one, Box) and isinstance(other, Box)):
        return False
    return bool((one.low == other.low).all() and (one.high == other.high).all() and (one.low == one.high).all())


def _at_given_times(problem: PathProblem, times: np.ndarray) -> PolynomialPath:
    if times.shape != (len(problem.places),):
        raise InputError(f"there are {times.size} times for {len(problem.places)} waypoints")
    late = np.flatnonzero(~(np.diff(times) > 0.0))
    if late.size or not np.isfinite(times).all():
        i = int(late[0]) if late.size else 0
        raise InputError(f"times must be finite and increase, but {times[i]:g} s is followed by {times[i + 1]:g} s")
    derivatives = problem.derivatives.copy()
    for i in range(problem.segments):
        if _repeats(problem.places[i], problem.places[i + 1]):
            pair = derivatives[i : i + 2]
            pair[np.isnan(pair)] = 0.0
    staying = PathProblem(problem.places, derivatives=derivatives, corridors=problem.corridors, limits=problem.limits)
    return _path_or_reason(staying, np.diff(times))._replace(times=times)


def _path_or_reason(problem: PathProblem, durations: np.ndarray) -> PolynomialPath:
    try:
        return path_within(problem, durations)
    except InfeasibleError:
        raise InputError(explain(problem, durations)) from None


def _heuristic(problem: PathProblem) -> PolynomialPath:
    candidates = [_stretched(_fitted(problem, rule), problem.limits) for rule in (_stops_everywhere, _ride)]
    return min(candidates, key=_duration)


def _stops_everywhere(problem: PathProblem, points: np.ndarray) -> np.ndarray:
    """(segments,) durations of a flight through points that stops at each; no stretch of it takes next to no time."""
    durations = rest_to_rest_durations(points, problem.limits if problem.limits.by_order else _ANY_LIMITS)
    return _none_too_short(problem, durations)


def _ride(problem: PathProblem, points: np.ndarray) -> np.ndarray:
    """(segments,) durations of a ride through points along the chords, likewise."""
    limits = problem.limits if problem.limits.by_order else _ANY_LIMITS
    return _none_too_short(
        problem, np.diff(trapezoid_times(points, speed=limits.speed, acceleration=limits.acceleration))
    )


def _none_too_short(problem: PathProblem, durations: np.ndarray) -> np.ndarray:
    share = _LEAST_SHARE_OF_POINTS if problem.passes_points else _LEAST_SHARE
    return np.maximum(durations, share * durations.max())


def _fitted(problem: PathProblem, rule: Callable[[PathProblem, np.ndarray], np.ndarray]) -> PolynomialPath:
    """The path by a rule for the durations, whatever its peaks; twice, if places leave it a choice of points."""
    unlimited = problem.without_limits()
    points = problem.representatives()
    for _ in range(1 if problem.passes_points else 2):
        path = _path_or_reason(unlimited, rule(problem, points))
        points = _waypoints(path)
    return path


def _stretched(path: PolynomialPath, limits: Limits) -> PolynomialPath:
    """The path as it is, but slower or faster, so that it attains a limit."""
    return path.stretched(stretch_factor(path, limits))


def _shortest(problem: PathProblem) -> PolynomialPath:
    heuristic = _heuristic(problem)
    best = _shortened(problem, heuristic, smooth=True)
    # Stopping everywhere always keeps to the limits; a route of very unequal steps may leave little to gain on it.
    stops = 1.001 * _stops_everywhere(problem, _waypoints(best))
    if _duration(best) > _LITTLE_GAINED * stops.sum():
        best = min(best, _shortened(problem, heuristic, smooth=False), key=_duration)
    return best if _duration(best) <= stops.sum() else _path_or_reason(problem, stops)


def _shortened(problem: PathProblem, path: PolynomialPath, *, smooth: bool) -> PolynomialPath:
    """The path with times that make it shorter, searched for from its own or from those of least snap."""
    unlimited = problem.without_limits()
    if problem.passes_points:
        points, durations = _waypoints(path), path.durations
        if smooth:
            durations = least_snap_durations(points, durations, problem.derivatives)
        durations = shortest_durations(points, durations, problem.limits, problem.derivatives)
        return min(path, _stretched(path_within(unlimited, durations), problem.limits), key=_duration)

    def shortened(path: PolynomialPath, reach: float) -> PolynomialPath:
        durations = shortest_durations(
            _waypoints(path),
            path.durations,
            problem.limits,
            problem.derivatives,
            contacts=_contacts(problem, path),
            reach=reach,
        )
        return _stretched(path_within(unlimited, durations), problem.limits)

    return _improved(path, shortened, _duration)


def _improved(
    path: PolynomialPath,
    change: Callable[[PolynomialPath, float], PolynomialPath],
    cost: Callable[[PolynomialPath], float],
) -> PolynomialPath:
    """The path after changes, each within a reach, for as long as the cost falls.

    A change is made as if the path kept touching its corridors, and passing its places, where it does now; so it is
    good as far as that holds, and the reach shrinks when it does not.
    """
    reach = _FIRST_REACH
    for _ in range(_ROUNDS):
        changed = change(path, reach)
        gain = 1.0 - cost(changed) / cost(path)
        if gain > 0.0:
            path = changed
        if gain < _LEAST_GAIN:
            if reach < _LAST_REACH:
                break
            reach /= 3.0
    return path


def _through_given_motion(problem: PathProblem, *, shorten: bool) -> PolynomialPath:
    """The path where a velocity, say, is given at a waypoint: flying slower need not help then, so times are tried."""
    stops = _stops_everywhere(problem, problem.representatives())
    found: list[PolynomialPath] = []
    for durations in _durations_to_try(problem, stops, shorten=shorten):
        with suppress(InfeasibleError):
            found.append(path_within(problem, durations))
    if not found:
        raise InputError(explain(problem, stops))
    return min(found, key=_duration)


def _durations_to_try(problem: PathProblem, stops: np.ndarray, *, shorten: bool) -> Iterator[np.ndarray]:
    """(segments,) durations of least snap in several sums, and those of least sum that are near them."""
    for factor in _TRIED:
        try:
            path = _smoothest(problem.without_limits(), factor * stops)
        except InfeasibleError:
            continue
        yield path.durations
        if shorten:
            yield shortest_durations(
                _waypoints(path), path.durations, problem.limits, problem.derivatives, contacts=_contacts(problem, path)
            )


def _smoothest(problem: PathProblem, durations: np.ndarray) -> PolynomialPath:
    """The path of least snap, with its times free but for their sum; limits are not looked at."""
    if problem.passes_points:
        durations = least_snap_durations(problem.representatives(), durations, problem.derivatives)
        return path_within(problem, durations)

    def smoothed(path: PolynomialPath, reach: float) -> PolynomialPath:
        points, contacts = _waypoints(path), _contacts(problem, path)
        return path_within(
            problem,
            least_snap_durations(points, path.durations, problem.derivatives, contacts=contacts, reach=reach),
        )

    return _improved(path_within(problem, durations), smoothed, lambda path: float(snap_cost(path).sum()))


def _least_snap(problem: PathProblem, total: float) -> PolynomialPath:
    start = _fitted(problem, _stops_everywhere).durations
    try:
        durations = _smoothest(problem.without_limits(), start * (total / start.sum())).durations
    except InfeasibleError:
        raise InputError(explain(problem, start * (total / start.sum()))) from None
    try:
        return path_within(problem, durations)
    except InfeasibleError:
        return _nearest_within_limits(problem, durations)


def _nearest_within_limits(problem: PathProblem, durations: np.ndarray) -> PolynomialPath:
    """The path with the durations nearest to those of least snap, on the way to the shortest, that keeps the limits."""
    total = float(durations.sum())
    shortest = _shortest(problem).durations
    shortest *= total / shortest.sum()
    best = _path_or_reason(problem, shortest)
    low, high = 0.0, 1.0
    for _ in range(_BISECTIONS):
        share = 0.5 * (low + high)
        between = durations ** (1.0 - share) * shortest**share
        try:
            best = path_within(problem, between * (total / between.sum()))
            high = share
        except InfeasibleError:
            low = share
    return best


def _contacts(problem: PathProblem, path: PolynomialPath) -> list[Contact]:
    """Where the path touches its corridors."""
    segments, axes, places = turning_points(path)
    positions = evaluate_at(path, segments, places)[np.arange(len(places)), axes]
    contacts = []
    for segment, axis, s, position in zip(segments, axes, places, positions, strict=True):
        corridor = problem.corridors[segment]
        if corridor is None or not _CONTACT_ROOM < s < 1.0 - _CONTACT_ROOM:
            continue
        room = min(position - corridor.low[axis], corridor.high[axis] - position)
        if room < _TOUCHING * float((corridor.high - corridor.low).max()):
            contacts.append(Contact(int(segment), float(s), int(axis), float(position)))
    return contacts


def _waypoints(path: PolynomialPath) -> np.ndarray:
    return np.vstack([path.coefficients[:, 0], path.coefficients[-1:].sum(axis=1)])


def _duration(path: PolynomialPath) -> float:
    return float(path.times[-1] - path.times[0])
