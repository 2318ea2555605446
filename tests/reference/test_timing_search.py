"""Tests of the searches for the shortest times and for the minimum-snap times within limits."""

import itertools

import numpy as np
import pytest

from drake_quad.errors import InputError
from drake_quad.reference.infeasibility import explain_infeasibility
from drake_quad.reference.minimum_snap import MinimumSnap, rest_at_ends, snap_cost
from drake_quad.reference.minimum_snap_program import PLANNING_ERRORS, InfeasibleError, constrained_minimum_snap
from drake_quad.reference.path_problem import Box, PathLimits, PathProblem
from drake_quad.reference.time_allocation import rest_to_rest_durations, stretch_factor, trapezoid_times
from drake_quad.reference.time_optimization import minimum_snap_durations
from drake_quad.reference.timing_search import (
    heuristic_path,
    improve_repeatedly,
    minimum_snap_path,
    minimum_time_path,
    path_with_fixed_derivatives,
)

LIMITS = PathLimits(speed=2.0, acceleration=1.0)  # m/s and m/s²
STRAIGHT_ROUTE = np.array([[0.0, 0.0], [1.0, 0.0], [5.0, 0.2], [9.0, 0.0]])  # m
REVERSING_ROUTE = np.array([[0.0, 0.0], [2.0, 0.0], [0.0, 0.1], [2.0, 0.0]])  # m
# The route has one long step, and two short steps in other directions.
UNEVEN_ROUTE = np.array([[0.0, 0.0, 0.0], [-24.41, -6.75, 12.05], [-24.29, -6.47, 12.26], [-24.34, -6.44, 12.24]])


def problem(points, velocity=None, **options):
    derivatives = rest_at_ends(len(points), len(points[0]))
    if velocity is not None:
        derivatives[1, 0] = velocity
    return PathProblem([Box.point(point) for point in points], derivatives=derivatives, **{"limits": LIMITS, **options})


def stretched(points, durations, limits=LIMITS):
    """Return the path with the minimum-snap times, scaled so that a limit is attained."""
    return durations * stretch_factor(MinimumSnap(points, durations).path(), limits)


@pytest.mark.parametrize(("points", "has_stops"), [(STRAIGHT_ROUTE, False), (REVERSING_ROUTE, True)])
def test_the_heuristic_is_the_faster_of_a_trapezoidal_profile_and_a_flight_with_stops(points, has_stops):
    without_stops = stretched(points, np.diff(trapezoid_times(points, speed=2.0, acceleration=1.0)))
    with_stops = stretched(points, rest_to_rest_durations(points, LIMITS))
    assert (with_stops.sum() < without_stops.sum()) == has_stops
    actual = heuristic_path(problem(points))
    np.testing.assert_allclose(actual.durations, with_stops if has_stops else without_stops, rtol=1e-12)


def test_heuristic_times_use_the_points_at_which_the_path_passes_the_regions():
    """The path passes a box at its edge. The second time allocation uses the point where the first path passes it."""
    regions = [Box.point([0.0, 0.0]), Box([1.0, 2.0], [5.0, 6.0]), Box.point([4.0, 0.0])]
    path_problem = PathProblem(regions, limits=LIMITS)
    actual = heuristic_path(path_problem)

    def paths_of_both_profiles(points):
        trapezoid_durations = np.diff(trapezoid_times(points, speed=2.0, acceleration=1.0))
        return [
            constrained_minimum_snap(path_problem.without_limits(), times)
            for times in (trapezoid_durations, rest_to_rest_durations(points, LIMITS))
        ]

    second_paths = [
        paths_of_both_profiles(path.waypoints)[i]
        for i, path in enumerate(paths_of_both_profiles(path_problem.representatives()))
    ]
    totals = [path.duration * stretch_factor(path, LIMITS) for path in second_paths]
    best = second_paths[int(np.argmin(totals))]
    assert actual.duration == pytest.approx(min(totals), rel=1e-6)
    np.testing.assert_allclose(actual.durations / actual.duration, best.durations / best.duration, rtol=1e-6)
    assert abs(paths_of_both_profiles(path_problem.representatives())[0].waypoints[1, 1] - 4.0) > 1.0


@pytest.mark.parametrize(("corridor", "fraction"), [(None, 1e-3), (Box([-1.0, -1.0], [60.0, 1.0]), 1e-2)])
def test_initial_durations_are_not_much_shorter_than_the_longest_one(corridor, fraction):
    """At constant speed, half a millimetre would take 1e-5 of the time of 50 m."""
    points = np.array([[0.0, 0.0], [50.0, 0.0], [50.0, 0.0005], [1.0, 0.0]])
    durations = heuristic_path(
        problem(points, limits=PathLimits(speed=2.0), corridors=[corridor, None, None])
    ).durations
    assert durations.min() / durations.max() == pytest.approx(fraction)


def test_a_route_with_very_unequal_steps_is_flown_with_stops():
    stops = rest_to_rest_durations(UNEVEN_ROUTE, LIMITS)
    assert stretched(UNEVEN_ROUTE, stops).sum() > 1.2 * stops.sum()
    np.testing.assert_allclose(minimum_time_path(problem(UNEVEN_ROUTE)).durations, 1.001 * stops, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("points", "room", "duration"),
    [
        ([[-1.3, 2.8], [-1.4, 5.0], [3.9, 8.7], [5.3, 8.3]], 0.21, 9.457),
        ([[-2.6, 1.3], [-5.0, 3.4], [-8.1, 2.0], [-9.3, -2.2]], 0.2, 10.033),
    ],
)
def test_two_searches_find_faster_paths_in_corridors_than_one(points, room, duration):
    """On the first route the better search starts from the minimum-snap times, on the second from the heuristic times.

    The better search gives a time about 7 % shorter than the other one. A Nelder-Mead search over the durations yields
    the same times from two initial points.
    """
    points = np.array(points)
    halls = [Box(np.minimum(a, b) - room, np.maximum(a, b) + room) for a, b in itertools.pairwise(points)]
    actual = minimum_time_path(problem(points, corridors=halls))
    assert actual.duration <= 1.002 * duration
    assert stretch_factor(actual, LIMITS) <= 1.0 + 1e-6


@pytest.mark.slow
def test_times_in_corridors_are_optimised_again_after_the_path_has_changed():
    """A Nelder-Mead search yields 14.175 s from three initial points. A single optimisation yields 14.308 s."""
    points = np.array([[-1.1, 1.2], [-1.0, -2.0], [1.0, -2.2], [2.2, 1.5], [2.7, -0.6]])
    halls = [Box(np.minimum(a, b) - 0.3, np.maximum(a, b) + 0.3) for a, b in itertools.pairwise(points)]
    actual = minimum_time_path(problem(points, corridors=halls))
    assert actual.duration <= 1.002 * 14.175
    assert stretch_factor(actual, LIMITS) <= 1.0 + 1e-6


def test_a_path_hardly_faster_than_a_flight_with_stops_causes_a_second_search():
    """A Nelder-Mead search yields 10.291 s from two initial points. A single search of the planner yields 10.335 s."""
    points = np.array([[0.0, 0.0], [-0.04, -0.01], [0.71, 0.18], [0.74, 0.04], [-2.88, 3.49], [-2.85, 3.46]])
    assert 0.95 * rest_to_rest_durations(points, LIMITS).sum() < 1.001 * 10.291
    assert minimum_time_path(problem(points)).duration <= 1.001 * 10.291


@pytest.mark.parametrize("points", [STRAIGHT_ROUTE, REVERSING_ROUTE])
def test_minimum_time_paths_attain_a_limit_and_are_faster_than_the_heuristic(points):
    best = minimum_time_path(problem(points))
    assert best.duration < 0.999 * heuristic_path(problem(points)).duration
    assert stretch_factor(best, LIMITS) == pytest.approx(1.0, rel=1e-6)


def test_a_path_with_a_given_velocity_uses_the_first_feasible_total_time():
    """The planner tries 0.7, 0.85, 1, 1.25, 1.6 and 2.5 times the duration of a flight that stops at all waypoints."""
    for step, velocity, factor in (
        (4, 1.8, 0.7),
        (4, 0.8, 0.85),
        (4, 0.3, 1.0),
        (4, -0.3, 1.25),
        (4, -0.8, 1.6),
        (1, -1, 2.5),
    ):
        path_problem = problem(step * np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]), [velocity, 0.0])
        stop_durations = rest_to_rest_durations(path_problem.representatives(), LIMITS)
        actual = path_with_fixed_derivatives(path_problem, shorten=False)
        assert actual.duration == pytest.approx(factor * stop_durations.sum(), rel=1e-9)
        smoothest = minimum_snap_durations(
            path_problem.representatives(), factor * stop_durations, path_problem.derivatives
        )
        np.testing.assert_allclose(actual.durations, smoothest, rtol=1e-9)


@pytest.mark.slow
def test_a_grid_search_finds_no_better_times_for_a_given_velocity():
    path_problem = problem(np.array([[0.0, 0.0], [4.0, 0.0], [8.0, 1.0]]), [1.5, 0.0])
    actual = path_with_fixed_derivatives(path_problem, shorten=True)
    assert actual.duration < 0.97 * path_with_fixed_derivatives(path_problem, shorten=False).duration
    assert stretch_factor(actual, LIMITS) <= 1.0 + 1e-6
    totals = []
    for first in np.linspace(3.5, 4.5, 16):
        for second in np.linspace(3.5, 4.5, 16):
            path = MinimumSnap(
                path_problem.representatives(), np.array([first, second]), path_problem.derivatives
            ).path()
            if stretch_factor(path, LIMITS) <= 1.0:
                totals.append(first + second)
    assert actual.duration <= 1.01 * min(totals)


def test_a_given_velocity_that_is_infeasible_for_all_durations_is_reported():
    """A metre is too short to brake from 1.9 m/s at 1 m/s²."""
    path_problem = problem(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]), [1.9, 0.0])
    with pytest.raises(
        InputError,
        match=r"^no times were found; for a flight that stops at every waypoint, the acceleration limit of 1 m/s² "
        r"cannot be kept on segment \d: at these times at least 2.15 m/s² is needed; the flight is "
        r"feasible if all durations are multiplied by 2.75$",
    ):
        path_with_fixed_derivatives(path_problem, shorten=False)


@pytest.mark.slow
@pytest.mark.parametrize("longer", [1.0, 1.02, 1.05, 1.1])
def test_minimum_snap_times_move_towards_the_fastest_times_until_limits_are_satisfied(longer):
    path_problem = problem(STRAIGHT_ROUTE)
    shortest = minimum_time_path(path_problem)
    total = longer * shortest.duration
    smoothest = minimum_snap_path(path_problem.without_limits(), total).durations
    with pytest.raises(InfeasibleError):
        constrained_minimum_snap(path_problem, smoothest)
    actual = minimum_snap_path(path_problem, total)
    assert actual.duration == pytest.approx(total, rel=1e-12)

    def between(fraction):
        durations = smoothest ** (1.0 - fraction) * shortest.durations**fraction
        return durations * (total / durations.sum())

    fractions = np.linspace(0.0, 1.0, 65)
    distances = [np.abs(actual.durations - between(fraction)).max() for fraction in fractions]
    nearest = int(np.argmin(distances))
    assert distances[nearest] <= 1e-6 * total
    constrained_minimum_snap(path_problem, between(fractions[nearest]))
    with pytest.raises(PLANNING_ERRORS):
        constrained_minimum_snap(path_problem, between(fractions[nearest - 1]))


def test_minimum_snap_times_need_no_limits_and_do_not_depend_on_units():
    free = minimum_snap_path(problem(STRAIGHT_ROUTE, limits=PathLimits()), 9.0)
    limited = minimum_snap_path(problem(STRAIGHT_ROUTE, limits=PathLimits(speed=50.0)), 9.0)
    np.testing.assert_allclose(free.durations, limited.durations, rtol=1e-3)
    assert snap_cost(free).sum() == pytest.approx(snap_cost(limited).sum(), rel=1e-6)


@pytest.mark.slow
def test_the_reason_for_a_missing_minimum_snap_path_is_reported():
    points = np.array([[0.0, 0.0], [4.0, 0.0], [7.0, 0.0]])
    with pytest.raises(InputError) as error:
        minimum_snap_path(problem(points, [1.5, 0.0]), 6.0)
    smoothest = minimum_snap_path(problem(points, [1.5, 0.0], limits=PathLimits()), 6.0)
    assert str(error.value) == explain_infeasibility(problem(points, [1.5, 0.0]), smoothest.durations)
    halls = [Box([0.0, -1.0], [4.0, 1.0]), Box([4.0, -1.0], [8.0, 1.0])]
    with pytest.raises(
        InputError,
        match=r"^the path cannot stay in the corridor of segment \d at these times with the derivatives given",
    ):
        minimum_snap_path(problem(points, [-1.5, 0.0], corridors=halls), 12.0)


def test_a_total_time_too_long_for_a_given_velocity_in_corridors_is_reported():
    points = np.array([[0.0, 0.0], [4.0, 0.0], [7.0, 0.0]])
    corridors = [Box([0.0, -1.0], [4.0, 1.0]), Box([4.0, -1.0], [7.0, 1.0])]
    path_problem = problem(points, [1.5, 0.0], corridors=corridors)
    minimum_snap_path(path_problem.without_limits(), 8.0)
    with pytest.raises(
        InputError,
        match=r"^the path cannot stay in the corridor of segment \d at these times with the derivatives given",
    ):
        minimum_snap_path(path_problem, 60.0)


def test_a_velocity_that_leads_out_of_a_corridor_is_reported_by_the_time_search():
    points = np.array([[0.0, 0.0], [4.0, 0.0], [7.0, 0.0]])
    halls = [Box([0.0, -1.0], [4.0, 1.0]), Box([4.0, -1.0], [7.0, 1.0])]
    for shorten in (False, True):
        with pytest.raises(
            InputError, match="^no times were found; for a flight that stops at every waypoint, the path cannot stay"
        ):
            path_with_fixed_derivatives(problem(points, [-1.5, 0.0], corridors=halls), shorten=shorten)


def test_the_search_repeats_changes_that_lower_the_cost_and_reduces_changes_that_raise_the_cost():
    """In this example, each change decreases a number that starts at 1, and the cost is smallest at 0.5."""
    log_changes = []

    def change(x, max_log_change):
        log_changes.append(max_log_change)
        return x - max_log_change

    assert improve_repeatedly(1.0, change, lambda x: 1.0 + abs(x - 0.5)) == pytest.approx(0.4)
    np.testing.assert_allclose(log_changes, [0.3, 0.3, 0.3, 0.1, 0.1 / 3.0, 0.1 / 9.0])


def test_the_search_ends_if_the_gain_is_negligible_or_there_is_no_path():
    assert improve_repeatedly(1.0, lambda x, max_log_change: 0.9995 * x, float) == 0.9995
    assert improve_repeatedly(1.0, lambda x, max_log_change: 1.0005 * x, float) == 1.0

    def change(x, max_log_change):
        if x < 0.5:
            raise InfeasibleError
        return 0.6 * x

    assert improve_repeatedly(1.0, change, float) == 0.36
    assert improve_repeatedly(0.4, change, float) == 0.4
