"""Search for waypoint times of a path with corridors, waypoint regions and given derivatives."""

from collections.abc import Callable, Iterator
from contextlib import suppress
from operator import attrgetter

import numpy as np

from drake_quad.errors import InputError
from drake_quad.reference.infeasibility import explain_infeasibility
from drake_quad.reference.minimum_snap import Contact, snap_cost
from drake_quad.reference.minimum_snap_program import PLANNING_ERRORS, constrained_minimum_snap
from drake_quad.reference.path_problem import PathLimits, PathProblem
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.reference.time_allocation import rest_to_rest_durations, stretch_factor, trapezoid_times
from drake_quad.reference.time_optimization import minimum_snap_durations, minimum_time_durations
from drake_quad.reference.walls import wall_approaches

# Key function for the comparison of paths by duration.
_DURATION = attrgetter("duration")
# Arbitrary limits that determine the ratios between durations if a problem has no limits.
_ANY_LIMITS = PathLimits(acceleration=1.0)
# Smallest initial duration of a segment, relative to the longest duration of a segment, for routes of points, which
# have a closed-form plan.
_MIN_CLOSED_FORM_DURATION_RATIO = 1e-3
# Smallest initial duration of a segment, relative to the longest duration of a segment, for routes that require the
# solver.
_MIN_SOLVER_DURATION_RATIO = 1e-2
# Largest number of rounds of the search. In each round, the times are adapted to the path, and then the path to the
# times.
_MAX_ROUNDS = 10
# The search ends after a round in which the cost decreases by less than this fraction.
_MIN_GAIN = 1e-3
# Distance from a wall at which a path counts as touching it, relative to the largest extent of the corridor.
_CONTACT_TOLERANCE = 1e-4
# Distance from the ends of a segment, in unit time, within which contacts of the path with walls are ignored.
_CONTACT_END_MARGIN = 0.02
# Largest change of the logarithm of a duration in the first round.
_INITIAL_LOG_CHANGE = 0.3
# The search ends when the largest allowed change falls below this value.
_MIN_LOG_CHANGE = 0.02
_NUM_BISECTIONS = 6  # number of bisections between the times with the smallest snap and feasible times
# Total duration below which any motion of a path is a rounding error, s.
_MIN_TOTAL_DURATION = 1e-3
# If the first search finds a path that takes more than this fraction of the duration of a flight with a stop at every
# waypoint, a second search follows.
_MAX_FRACTION_OF_STOPPING = 0.95
# Total durations that are tried if derivatives are given at waypoints, relative to the duration of a flight that stops
# at every waypoint.
_TRIED_FACTORS = (0.7, 0.85, 1.0, 1.25, 1.6, 2.5)


def path_or_reason(problem: PathProblem, durations: np.ndarray) -> PolynomialPath:
    """Return the path for the given durations, (segments,) in s.

    Raises:
        InputError: if there is no path; the message gives the reason.
    """
    try:
        return constrained_minimum_snap(problem, durations)
    except PLANNING_ERRORS:
        raise InputError(explain_infeasibility(problem, durations)) from None


def heuristic_path(problem: PathProblem) -> PolynomialPath:
    """Return the faster of a non-stop and a stop-at-every-waypoint flight, scaled to the limits.

    Args:
        problem: problem with at least one limit. It must not have repeated waypoints, or waypoints with given nonzero
            derivatives.
    """
    # The flight with stops is computed first, since it reveals whether the vehicle must move at all.
    candidates = [
        _scaled_to_limits(_path_by_rule(problem, rule), problem.limits)
        for rule in (_stopping_durations, _trapezoid_durations)
    ]
    return min(candidates, key=_DURATION)


def _stopping_durations(problem: PathProblem, points: np.ndarray) -> np.ndarray:
    """Return the segment durations, (segments,) in s, of a flight that stops at each of the given points."""
    durations = rest_to_rest_durations(points, problem.limits if problem.limits.by_order else _ANY_LIMITS)
    return _with_min_durations(problem, durations)


def _trapezoid_durations(problem: PathProblem, points: np.ndarray) -> np.ndarray:
    """Return the segment durations, (segments,) in s, of a trapezoidal speed profile at the limits."""
    times = trapezoid_times(points, speed=problem.limits.speed, acceleration=problem.limits.acceleration)
    return _with_min_durations(problem, np.diff(times))


def _with_min_durations(problem: PathProblem, durations: np.ndarray) -> np.ndarray:
    """Raise durations that are much shorter than the longest one; return 1 s for each segment if there is no motion."""
    if durations.max() < _MIN_TOTAL_DURATION:
        return np.ones_like(durations)
    fraction = _MIN_CLOSED_FORM_DURATION_RATIO if problem.has_closed_form_path else _MIN_SOLVER_DURATION_RATIO
    return np.maximum(durations, fraction * durations.max())


def _path_by_rule(problem: PathProblem, rule: Callable[[PathProblem, np.ndarray], np.ndarray]) -> PolynomialPath:
    """Return the minimum-snap path without limits whose durations are computed by `rule` from the waypoints.

    The rule is applied twice, since the durations affect where the path passes through the waypoint regions.
    """
    unlimited = problem.without_limits()
    points = problem.representatives()
    for _ in range(2):
        path = path_or_reason(unlimited, rule(problem, points))
        points = path.waypoints
    return path


def _scaled_to_limits(path: PolynomialPath, limits: PathLimits) -> PolynomialPath:
    """Scale all durations by the smallest factor with which the path satisfies its speed and acceleration limits."""
    factor = stretch_factor(path, limits)
    if factor * path.duration < _MIN_TOTAL_DURATION:
        raise InputError("one point lies in the regions of all waypoints, so the vehicle need not move; give the times")
    return path.scaled_in_time(factor)


def minimum_time_path(problem: PathProblem) -> PolynomialPath:
    """Return the minimum-snap path with the (locally) shortest total time within the limits.

    Args:
        problem: problem with at least one limit. It must not have repeated waypoints, or waypoints with given nonzero
            derivatives.
    """
    heuristic = heuristic_path(problem)
    best = _local_minimum_time_path(problem, heuristic, smooth=True)
    # A flight that stops at every waypoint satisfies the limits; the factor 1.001 keeps its peaks slightly below them.
    # If segments are very unequal, this flight can be as fast as the optimum.
    stopping = 1.001 * _stopping_durations(problem, best.waypoints)
    # The local optimum can depend on the initial path, for example on whether the path touches a wall.
    if not problem.has_closed_form_path or best.duration > _MAX_FRACTION_OF_STOPPING * stopping.sum():
        best = min(best, _local_minimum_time_path(problem, heuristic, smooth=False), key=_DURATION)
    return best if best.duration <= stopping.sum() else path_or_reason(problem, stopping)


def _local_minimum_time_path(problem: PathProblem, path: PolynomialPath, *, smooth: bool) -> PolynomialPath:
    """Return a path with locally optimal times.

    Args:
        problem: problem with at least one limit. It must not have waypoints with given nonzero derivatives.
        path: initial path.
        smooth: True to start the search from the times with the smallest snap. False to start it from the times of
            `path`; the result is then never slower than `path`.
    """
    unlimited = problem.without_limits()
    start = (
        _scaled_to_limits(_minimum_snap_with_same_duration(unlimited, path.durations), problem.limits)
        if smooth
        else path
    )

    def shortened(path: PolynomialPath, max_log_change: float) -> PolynomialPath:
        durations = minimum_time_durations(
            path.waypoints,
            path.durations,
            problem.limits,
            problem.derivatives,
            contacts=_contacts(problem, path),
            max_log_change=max_log_change,
        )
        return _scaled_to_limits(constrained_minimum_snap(unlimited, durations), problem.limits)

    if problem.has_closed_form_path:
        return min(path, shortened(start, np.inf), key=_DURATION)
    return improve_repeatedly(start, shortened, _DURATION)


def improve_repeatedly(
    path: PolynomialPath,
    change: Callable[[PolynomialPath, float], PolynomialPath],
    cost: Callable[[PolynomialPath], float],
) -> PolynomialPath:
    """Apply changes to a path until the cost no longer decreases, and return the best path.

    A change assumes that the path keeps its present contacts with corridors and its points in the waypoint regions. If
    the cost increases because this assumption is violated, smaller changes are tried.

    Args:
        path: initial path.
        change: function of a path and a reach that returns a new path. The reach is the largest permitted change of the
            logarithm of a duration.
        cost: function that returns the cost of a path.
    """
    max_log_change = _INITIAL_LOG_CHANGE
    for _ in range(_MAX_ROUNDS):
        try:
            changed = change(path, max_log_change)
        except PLANNING_ERRORS:
            break
        gain = 1.0 - cost(changed) / cost(path)
        if gain > 0.0:
            path = changed
        if abs(gain) < _MIN_GAIN or max_log_change < _MIN_LOG_CHANGE:
            break
        if gain < 0.0:
            max_log_change /= 3.0
    return path


def path_with_fixed_derivatives(problem: PathProblem, *, shorten: bool) -> PolynomialPath:
    """Return the fastest path that is found for a problem with nonzero derivatives given at waypoints.

    Such a path cannot simply be slowed down to satisfy the limits. The search therefore tries several total durations,
    each with the times of the smallest snap and with the shortest times near them.

    Args:
        problem: problem with at least one limit, and without repeated waypoints.
        shorten: True to minimise the total time; False to return the first feasible path.

    Raises:
        InputError: if no path is found; the message gives the reason.
    """
    stopping = _stopping_durations(problem, problem.representatives())
    paths: list[PolynomialPath] = []
    for durations in _durations_to_try(problem, stopping, shorten=shorten):
        with suppress(*PLANNING_ERRORS):
            paths.append(constrained_minimum_snap(problem, durations))
        if paths and not shorten:
            break
    if not paths:
        raise InputError(
            "no times were found; for a flight that stops at every waypoint,"
            f" {explain_infeasibility(problem, stopping)}"
        )
    return min(paths, key=_DURATION)


def _durations_to_try(problem: PathProblem, stopping: np.ndarray, *, shorten: bool) -> Iterator[np.ndarray]:
    """Yield durations, (segments,) in s: for several totals those with the smallest snap, then shortened ones."""
    for factor in _TRIED_FACTORS:
        try:
            path = _minimum_snap_with_same_duration(problem.without_limits(), factor * stopping)
        except PLANNING_ERRORS:
            continue
        yield path.durations
        if shorten:
            yield minimum_time_durations(
                path.waypoints, path.durations, problem.limits, problem.derivatives, contacts=_contacts(problem, path)
            )


def _minimum_snap_with_same_duration(problem: PathProblem, durations: np.ndarray) -> PolynomialPath:
    """Return the path with the smallest snap for the same total duration, without limits."""
    if problem.has_closed_form_path:
        durations = minimum_snap_durations(problem.representatives(), durations, problem.derivatives)
        return constrained_minimum_snap(problem, durations)

    def smoothed(path: PolynomialPath, max_log_change: float) -> PolynomialPath:
        points, contacts = path.waypoints, _contacts(problem, path)
        return constrained_minimum_snap(
            problem,
            minimum_snap_durations(
                points, path.durations, problem.derivatives, contacts=contacts, max_log_change=max_log_change
            ),
        )

    return improve_repeatedly(
        constrained_minimum_snap(problem, durations), smoothed, lambda path: float(snap_cost(path).sum())
    )


def minimum_snap_path(problem: PathProblem, total: float) -> PolynomialPath:
    """Return the path with the smallest snap for a total time, within the limits.

    If the times with the smallest snap violate the limits, they are moved towards the times of the fastest path until
    the path satisfies the limits.

    Args:
        problem: problem without repeated waypoints.
        total: total time, s.

    Raises:
        InputError: if there is no such path; the message gives the reason.
    """
    start = _path_by_rule(problem, _stopping_durations).durations
    try:
        durations = _minimum_snap_with_same_duration(problem.without_limits(), start * (total / start.sum())).durations
    except PLANNING_ERRORS:
        raise InputError(explain_infeasibility(problem, start * (total / start.sum()))) from None
    try:
        return constrained_minimum_snap(problem, durations)
    except PLANNING_ERRORS:
        if not problem.is_time_scalable:
            raise InputError(explain_infeasibility(problem, durations)) from None
        return _nearest_within_limits(problem, durations)


def _nearest_within_limits(problem: PathProblem, durations: np.ndarray) -> PolynomialPath:
    """Return a path within the limits whose durations differ as little as possible from the given durations.

    The durations are interpolated between the given durations and the durations of the fastest path.

    Args:
        problem: problem with limits.
        durations: (segments,) durations with the smallest snap, s.
    """
    total = float(durations.sum())
    shortest = minimum_time_path(problem).durations
    shortest *= total / shortest.sum()
    best = path_or_reason(problem, shortest)
    low, high = 0.0, 1.0
    for _ in range(_NUM_BISECTIONS):
        fraction = 0.5 * (low + high)
        between = durations ** (1.0 - fraction) * shortest**fraction
        try:
            best = constrained_minimum_snap(problem, between * (total / between.sum()))
            high = fraction
        except PLANNING_ERRORS:
            low = fraction
    return best


def _contacts(problem: PathProblem, path: PolynomialPath) -> list[Contact]:
    """Return the points at which a path touches the walls of its corridors."""
    return [
        Contact(approach.segment, approach.s, approach.direction, approach.position)
        for approach in wall_approaches(path, problem.corridors)
        if approach.clearance < _CONTACT_TOLERANCE * approach.size
        and _CONTACT_END_MARGIN < approach.s < 1.0 - _CONTACT_END_MARGIN
    ]
