"""The search for a path's times: where the algebra of `time_optimization` meets corridors, places and given motion."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from operator import attrgetter

import numpy as np

from drake_quad.errors import InputError
from drake_quad.reference.infeasibility import explain
from drake_quad.reference.minimum_snap import Contact, snap_cost
from drake_quad.reference.minimum_snap_program import NO_PATH, path_within
from drake_quad.reference.path_problem import PathLimits, PathProblem
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.reference.time_allocation import rest_to_rest_durations, stretch_factor, trapezoid_times
from drake_quad.reference.time_optimization import least_snap_durations, shortest_durations
from drake_quad.reference.walls import turns

# What the search makes small.
_DURATION = attrgetter("duration")
# Without limits, times are shared out as with these; only their ratios count.
_ANY_LIMITS = PathLimits(acceleration=1.0)
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
# What takes less is no motion but rounding errors, s.
_NO_TIME = 1e-3
# A flight that takes more than this share of one with stops everywhere is searched for from another start too.
_LITTLE_GAINED = 0.95
# Durations of a flight through given velocities that are tried, as factors of one with stops everywhere.
_TRIED = (0.7, 0.85, 1.0, 1.25, 1.6, 2.5)


def path_or_reason(problem: PathProblem, durations: np.ndarray) -> PolynomialPath:
    """Returns the path at these durations (segments,), s, or raises InputError that says why there is none."""
    try:
        return path_within(problem, durations)
    except NO_PATH:
        raise InputError(explain(problem, durations)) from None


def heuristic_path(problem: PathProblem) -> PolynomialPath:
    """Returns the shorter of a ride without stops and a flight with stops everywhere, stretched to the limits.

    Args:
        problem: with a limit, without given motion and without repeats.
    """
    # Stops come first: these times tell where nothing has to move.
    candidates = [_stretched(_fitted(problem, rule), problem.limits) for rule in (_stops_everywhere, _ride)]
    return min(candidates, key=_DURATION)


def _stops_everywhere(problem: PathProblem, points: np.ndarray) -> np.ndarray:
    """(segments,) durations of a flight through points that stops at each; no stretch of it takes next to no time."""
    durations = rest_to_rest_durations(points, problem.limits if problem.limits.by_order else _ANY_LIMITS)
    return _none_too_short(problem, durations)


def _ride(problem: PathProblem, points: np.ndarray) -> np.ndarray:
    """(segments,) durations of a ride through points along the chords at the limits."""
    times = trapezoid_times(points, speed=problem.limits.speed, acceleration=problem.limits.acceleration)
    return _none_too_short(problem, np.diff(times))


def _none_too_short(problem: PathProblem, durations: np.ndarray) -> np.ndarray:
    if durations.max() < _NO_TIME:
        return np.ones_like(durations)
    share = _LEAST_SHARE_OF_POINTS if problem.passes_points else _LEAST_SHARE
    return np.maximum(durations, share * durations.max())


def _fitted(problem: PathProblem, rule: Callable[[PathProblem, np.ndarray], np.ndarray]) -> PolynomialPath:
    """The path by a rule for the durations, whatever its peaks; twice, as places may leave it a choice of points."""
    unlimited = problem.without_limits()
    points = problem.representatives()
    for _ in range(2):
        path = path_or_reason(unlimited, rule(problem, points))
        points = path.waypoints
    return path


def _stretched(path: PolynomialPath, limits: PathLimits) -> PolynomialPath:
    """The path as it is, but slower or faster, so that it attains a limit."""
    factor = stretch_factor(path, limits)
    if factor * path.duration < _NO_TIME:
        raise InputError("one point lies in all the waypoints' places: nothing has to move, so give the times")
    return path.stretched(factor)


def shortest_path(problem: PathProblem) -> PolynomialPath:
    """Returns the minimum-snap path with the least total time that keeps it within the limits: a local optimum.

    Args:
        problem: with a limit, without given motion and without repeats.
    """
    heuristic = heuristic_path(problem)
    best = _shortened(problem, heuristic, smooth=True)
    # Stopping everywhere always keeps to the limits; a route of very unequal steps may leave little to gain on it.
    stops = 1.001 * _stops_everywhere(problem, best.waypoints)
    # Touching a wall or not makes two optima of one.
    if not problem.passes_points or best.duration > _LITTLE_GAINED * stops.sum():
        best = min(best, _shortened(problem, heuristic, smooth=False), key=_DURATION)
    return best if best.duration <= stops.sum() else path_or_reason(problem, stops)


def _shortened(problem: PathProblem, path: PolynomialPath, *, smooth: bool) -> PolynomialPath:
    """The path with times that make it shorter, searched for from its own or from those of least snap.

    From its own it is never longer than the path.
    """
    unlimited = problem.without_limits()
    start = _stretched(_smoothest(unlimited, path.durations), problem.limits) if smooth else path

    def shortened(path: PolynomialPath, reach: float) -> PolynomialPath:
        durations = shortest_durations(
            path.waypoints,
            path.durations,
            problem.limits,
            problem.derivatives,
            contacts=_contacts(problem, path),
            reach=reach,
        )
        return _stretched(path_within(unlimited, durations), problem.limits)

    if problem.passes_points:
        return min(path, shortened(start, np.inf), key=_DURATION)
    return improved(start, shortened, _DURATION)


def improved(
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
        try:
            changed = change(path, reach)
        except NO_PATH:
            break
        gain = 1.0 - cost(changed) / cost(path)
        if gain > 0.0:
            path = changed
        if abs(gain) < _LEAST_GAIN or reach < _LAST_REACH:
            break
        if gain < 0.0:
            reach /= 3.0
    return path


def path_through_given_motion(problem: PathProblem, *, shorten: bool) -> PolynomialPath:
    """Returns the shortest path that is found where a velocity, say, is given at a waypoint.

    Flying slower need not help then, so that times are tried: those of least snap in several sums, and those to which
    they shrink.

    Args:
        problem: with a limit, and without repeats.
        shorten: whether to shrink the times; if not, the first that are feasible will do.

    Raises:
        InputError: no path is found; the message says why.
    """
    stops = _stops_everywhere(problem, problem.representatives())
    found: list[PolynomialPath] = []
    for durations in _durations_to_try(problem, stops, shorten=shorten):
        with suppress(*NO_PATH):
            found.append(path_within(problem, durations))
        if found and not shorten:
            break
    if not found:
        raise InputError(f"no times were found; if it stopped everywhere, {explain(problem, stops)}")
    return min(found, key=_DURATION)


def _durations_to_try(problem: PathProblem, stops: np.ndarray, *, shorten: bool) -> Iterator[np.ndarray]:
    """(segments,) durations of least snap in several sums, and those of least sum near them."""
    for factor in _TRIED:
        try:
            path = _smoothest(problem.without_limits(), factor * stops)
        except NO_PATH:
            continue
        yield path.durations
        if shorten:
            yield shortest_durations(
                path.waypoints, path.durations, problem.limits, problem.derivatives, contacts=_contacts(problem, path)
            )


def _smoothest(problem: PathProblem, durations: np.ndarray) -> PolynomialPath:
    """The path of least snap, with its times free but for their sum; limits are not looked at."""
    if problem.passes_points:
        durations = least_snap_durations(problem.representatives(), durations, problem.derivatives)
        return path_within(problem, durations)

    def smoothed(path: PolynomialPath, reach: float) -> PolynomialPath:
        points, contacts = path.waypoints, _contacts(problem, path)
        return path_within(
            problem,
            least_snap_durations(points, path.durations, problem.derivatives, contacts=contacts, reach=reach),
        )

    return improved(path_within(problem, durations), smoothed, lambda path: float(snap_cost(path).sum()))


def least_snap_path(problem: PathProblem, total: float) -> PolynomialPath:
    """Returns the path of least snap in a total time (s), at the times of least snap if the limits let it.

    If they do not, the times move towards those of the shortest path until they do.

    Args:
        problem: without repeats.
        total: s.

    Raises:
        InputError: there is no such path; the message says why.
    """
    start = _fitted(problem, _stops_everywhere).durations
    try:
        durations = _smoothest(problem.without_limits(), start * (total / start.sum())).durations
    except NO_PATH:
        raise InputError(explain(problem, start * (total / start.sum()))) from None
    try:
        return path_within(problem, durations)
    except NO_PATH:
        if not problem.stretchable:
            raise InputError(explain(problem, durations)) from None
        return _nearest_within_limits(problem, durations)


def _nearest_within_limits(problem: PathProblem, durations: np.ndarray) -> PolynomialPath:
    """The path with the durations nearest to those of least snap, on the way to the shortest, that keeps the limits."""
    total = float(durations.sum())
    shortest = shortest_path(problem).durations
    shortest *= total / shortest.sum()
    best = path_or_reason(problem, shortest)
    low, high = 0.0, 1.0
    for _ in range(_BISECTIONS):
        share = 0.5 * (low + high)
        between = durations ** (1.0 - share) * shortest**share
        try:
            best = path_within(problem, between * (total / between.sum()))
            high = share
        except NO_PATH:
            low = share
    return best


def _contacts(problem: PathProblem, path: PolynomialPath) -> list[Contact]:
    """Where the path touches its corridors."""
    return [
        Contact(turn.segment, turn.s, turn.direction, turn.position)
        for turn in turns(path, problem.corridors)
        if turn.room < _TOUCHING * turn.size and _CONTACT_ROOM < turn.s < 1.0 - _CONTACT_ROOM
    ]
