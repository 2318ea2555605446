"""Tests of the planner with all timings, on random routes and by comparison with independent searches."""

import itertools
import os
import re

import numpy as np
import pytest

from drake_quad.errors import InputError
from drake_quad.reference.active_constraints import active_constraints
from drake_quad.reference.minimum_snap import MinimumSnap, rest_at_ends, snap_cost
from drake_quad.reference.path_problem import Box, PathLimits, PathProblem, Sphere
from drake_quad.reference.planner import (
    FixedTimes,
    HeuristicTiming,
    MinimumSnapTiming,
    MinimumTimeTiming,
    passing_times,
    plan_path,
    without_repeats,
)
from drake_quad.reference.polynomial_path import evaluate, evaluate_at, peak_norm
from drake_quad.reference.time_allocation import rest_to_rest_durations

LIMITS = PathLimits(speed=2.0, acceleration=0.7)  # m/s and m/s²
SQUARE_WAYPOINTS = np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0], [0, 0, 1]], dtype=float)  # m
CORRIDORS_AROUND_SQUARE = [
    Box(np.minimum(a, b) - 0.1, np.maximum(a, b) + 0.1) for a, b in itertools.pairwise(SQUARE_WAYPOINTS)
]
# The environment variable ROUTES sets the number of random routes. A thousand routes take some minutes.
NUM_ROUTES = int(os.environ.get("ROUTES", "15"))


def problem(points=SQUARE_WAYPOINTS, **options):
    return PathProblem([Box.point(point) for point in points], **{"limits": LIMITS, **options})


def total(path):
    return path.times[-1] - path.times[0]


def fractions(path, limits=LIMITS):
    """Return largest speed and acceleration, relative to their limits, over dense samples of the path."""
    every = np.repeat(np.arange(len(path.coefficients)), 500)
    s = np.tile(np.linspace(0.0, 1.0, 500), len(path.coefficients))
    return [
        np.linalg.norm(evaluate_at(path, every, s, order), axis=1).max() / limit
        for order, limit in limits.by_order.items()
    ]


def random_points(seed):
    """Return 2 to 60 waypoints with equal or random steps of 1 cm to 100 m, sharp turns and repetitions."""
    rng = np.random.default_rng(seed)
    count, kind = int(rng.integers(1, 60)), int(rng.integers(4))
    steps = 10.0 ** rng.uniform(-2.0, 2.0, count) if kind < 2 else np.full(count, 10.0 ** rng.uniform(-2.0, 2.0))
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, np.newaxis]
    if kind % 2:
        for i in range(1, count):
            number = rng.random()
            if number < 0.2:
                directions[i] = directions[i - 1]
            elif number < 0.3:
                directions[i] = -directions[i - 1]
            elif number < 0.4:
                steps[i] = 0.0
    return np.vstack([np.zeros(3), np.cumsum(directions * steps[:, np.newaxis], axis=0)])


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(NUM_ROUTES))
def test_random_routes_are_planned_within_the_limits(seed):
    points = random_points(seed)
    path_problem = problem(points)
    path = plan_path(path_problem, MinimumTimeTiming())
    used_fractions = fractions(path)
    assert max(used_fractions) <= 1.0 + 1e-6
    assert max(used_fractions) >= 0.999
    distinct = points[np.append(True, (np.diff(points, axis=0) != 0.0).any(axis=1))]
    extent = np.abs(points).max()
    np.testing.assert_allclose(evaluate(path, path.times).T, distinct, atol=1e-9 * extent)
    np.testing.assert_allclose(evaluate(path, passing_times(path_problem, path)).T, points, atol=1e-9 * extent)
    every = np.arange(len(path.coefficients))
    for order in (1, 2, 3):
        before, after = (evaluate_at(path, every, np.full(len(every), s), order) for s in (1.0, 0.0))
        assert np.abs(before[:-1] - after[1:]).max(initial=0.0) <= 1e-6 * peak_norm(path, order)
        np.testing.assert_allclose([after[0], before[-1]], 0.0, atol=1e-6 * peak_norm(path, order))
    assert total(path) <= 1.0011 * rest_to_rest_durations(distinct, LIMITS).sum()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))
def test_the_shortest_timing_is_not_slower_than_the_heuristic(seed):
    path_problem = problem(np.cumsum(np.random.default_rng(seed).normal(size=(8, 3)), axis=0))
    heuristic, shortest = (plan_path(path_problem, timing) for timing in (HeuristicTiming(), MinimumTimeTiming()))
    assert 0.999 <= max(fractions(heuristic)) <= 1.0 + 1e-6
    assert total(shortest) < total(heuristic)


@pytest.mark.long
def test_every_timing_satisfies_corridors_boxes_and_spheres():
    regions = [
        Box.point(SQUARE_WAYPOINTS[0]),
        Box([1.9, -0.1, -0.1], [2.1, 0.1, 0.1]),
        Sphere([2.0, 2.0, 0.0], 0.1),
        Box.point(SQUARE_WAYPOINTS[3]),
        Box.point(SQUARE_WAYPOINTS[4]),
    ]
    path_problem = PathProblem(regions, corridors=CORRIDORS_AROUND_SQUARE, limits=LIMITS)
    totals = {}
    for timing in (
        FixedTimes((0.0, 5.0, 9.0, 13.0, 18.0)),
        HeuristicTiming(),
        MinimumSnapTiming(17.0),
        MinimumTimeTiming(),
    ):
        path = plan_path(path_problem, timing)
        assert max(fractions(path)) <= 1.0 + 1e-6
        passing_points = evaluate(path, path.times).T
        for region, position in zip(regions, passing_points, strict=True):
            assert np.linalg.norm(region.nearest(position) - position) <= 1e-7
        for i, corridor in enumerate(CORRIDORS_AROUND_SQUARE):
            positions = evaluate(path, np.linspace(path.times[i], path.times[i + 1], 500)).T
            assert (positions >= corridor.low - 1e-6).all()
            assert (positions <= corridor.high + 1e-6).all()
        totals[type(timing)] = total(path)
    assert totals[FixedTimes] == 18.0
    assert totals[MinimumSnapTiming] == pytest.approx(17.0)
    assert totals[MinimumTimeTiming] < totals[HeuristicTiming]
    touched = {
        binding.quantity
        for binding in active_constraints(plan_path(path_problem, MinimumTimeTiming()), LIMITS, path_problem.corridors)
    }
    assert touched == {"acceleration", "corridor"}


@pytest.mark.slow
def test_the_shortest_time_in_a_corridor_agrees_with_an_independent_search():
    """A Nelder-Mead search over the durations of the constrained program yields 14.930 s from two initial points."""
    assert total(plan_path(problem(corridors=CORRIDORS_AROUND_SQUARE), MinimumTimeTiming())) <= 1.002 * 14.930


@pytest.mark.slow
def test_the_minimum_snap_in_a_corridor_is_near_that_of_an_independent_search():
    """For a path of 14 s, a Nelder-Mead search over the durations of the segments found a cost of 13.210 m²/s⁷."""
    path = plan_path(problem(corridors=CORRIDORS_AROUND_SQUARE, limits=PathLimits()), MinimumSnapTiming(14.0))
    assert snap_cost(path).sum() <= 1.002 * 13.210


def test_limits_take_precedence_over_minimum_snap():
    path_problem = problem()
    shortest = plan_path(path_problem, MinimumTimeTiming())
    free = plan_path(problem(limits=PathLimits()), MinimumSnapTiming(total(shortest)))
    within = plan_path(path_problem, MinimumSnapTiming(total(shortest)))
    assert max(fractions(free)) > 1.001
    assert max(fractions(within)) <= 1.0 + 1e-6
    assert snap_cost(free).sum() <= snap_cost(within).sum() <= snap_cost(shortest).sum() * (1.0 + 1e-6)
    slow_path = plan_path(path_problem, MinimumSnapTiming(30.0))
    assert MinimumSnap(SQUARE_WAYPOINTS, slow_path.durations).cost == pytest.approx(snap_cost(slow_path).sum())


@pytest.mark.parametrize("timing", [HeuristicTiming(), MinimumTimeTiming()])
def test_a_centimetre_is_flown_in_a_fraction_of_a_second(timing):
    """With at most 0.7 m/s², a flight of 1 cm from rest to rest takes at least 2 √(0.01 / 0.7) s."""
    duration = total(plan_path(problem(np.array([[0.0, 0.0, 0.0], [0.01, 0.0, 0.0]])), timing))
    assert 2.0 * np.sqrt(0.01 / 0.7) < duration < 0.4


@pytest.mark.slow
def test_a_path_has_the_velocity_that_is_given_at_a_waypoint():
    derivatives = rest_at_ends(5, 3)
    derivatives[2, 0] = [-1.0, 0.5, 0.0]
    for timing in (
        HeuristicTiming(),
        MinimumTimeTiming(),
        MinimumSnapTiming(18.0),
        FixedTimes((0.0, 5.0, 10.0, 14.0, 20.0)),
    ):
        path = plan_path(problem(derivatives=derivatives), timing)
        np.testing.assert_allclose(evaluate(path, path.times[2:3], 1)[:, 0], [-1.0, 0.5, 0.0], atol=1e-9)
        assert max(fractions(path)) <= 1.0 + 1e-6


def test_repeated_waypoints_are_merged_unless_times_are_given():
    points = SQUARE_WAYPOINTS[[0, 1, 1, 1, 2]]
    merged_path = plan_path(problem(points), MinimumTimeTiming())
    assert len(merged_path.times) == 3
    np.testing.assert_array_equal(passing_times(problem(points), merged_path), merged_path.times[[0, 1, 1, 1, 2]])
    path_with_stay = plan_path(problem(points), FixedTimes((0.0, 5.0, 6.0, 8.0, 13.0)))
    stay_times = np.linspace(5.0, 8.0, 50)
    np.testing.assert_allclose(evaluate(path_with_stay, stay_times).T, np.tile(points[1], (50, 1)), atol=1e-12)


def test_repeated_waypoints_keep_their_given_derivatives():
    derivatives = rest_at_ends(3, 3)
    derivatives[1] = 0.0
    merged = without_repeats(problem(SQUARE_WAYPOINTS[[0, 0, 1]], derivatives=np.full((3, 3, 3), np.nan)))
    assert np.isnan(merged.derivatives).all()
    merged = without_repeats(
        problem(SQUARE_WAYPOINTS[[0, 1, 1, 2]], derivatives=np.concatenate([derivatives, derivatives[-1:]]))
    )
    np.testing.assert_array_equal(merged.derivatives[1], 0.0)
    moving = rest_at_ends(4, 3)
    moving[1, 0], moving[2, 0] = [1.0, 0.0, 0.0], [0.5, 0.0, 0.0]
    with pytest.raises(InputError, match="waypoint 2 repeats waypoint 1, but different derivatives"):
        without_repeats(problem(SQUARE_WAYPOINTS[[0, 1, 1, 2]], derivatives=moving))


def test_times_may_begin_at_any_instant_and_span_a_day():
    times = np.array([0.0, 20.0, 50.0, 80.0, 86_400.0])
    expected = plan_path(problem(), FixedTimes(tuple(times)))
    later = plan_path(problem(), FixedTimes(tuple(1e5 + times)))
    np.testing.assert_array_equal(later.times, 1e5 + times)
    np.testing.assert_allclose(
        later.coefficients, expected.coefficients, atol=1e-9 * np.abs(expected.coefficients).max()
    )


@pytest.mark.parametrize("total", [1e-3, 86_400.0])
def test_the_total_time_of_minimum_snap_timing_may_be_a_millisecond_or_a_day(total):
    assert plan_path(problem(limits=PathLimits()), MinimumSnapTiming(total)).duration == pytest.approx(total, rel=1e-9)


def test_a_path_after_a_repeated_waypoint_equals_a_path_that_starts_there():
    points = SQUARE_WAYPOINTS[[0, 0, 1, 2]]
    path_with_stay = plan_path(problem(points), FixedTimes((0.0, 3.0, 7.0, 12.0)))
    path_without_stay = MinimumSnap(SQUARE_WAYPOINTS[:3], np.array([4.0, 5.0])).path()
    np.testing.assert_allclose(path_with_stay.coefficients[1:], path_without_stay.coefficients, atol=1e-12)


def test_merged_waypoints_keep_their_corridors_and_derivatives():
    derivatives = np.full((5, 3, 3), np.nan)
    derivatives[1, 0], derivatives[2, 1] = [0.5, 0.0, 0.0], [0.0, 0.1, 0.0]
    boxes = [Box([-size] * 3, [3.0 + size] * 3) for size in (1.0, 2.0, 3.0, 4.0)]
    merged = without_repeats(problem(SQUARE_WAYPOINTS[[0, 1, 1, 2, 2]], derivatives=derivatives, corridors=boxes))
    assert merged.corridors == (boxes[0], boxes[2])
    assert merged.limits == LIMITS
    np.testing.assert_array_equal([waypoint.centre for waypoint in merged.waypoints], SQUARE_WAYPOINTS[:3])
    np.testing.assert_array_equal(merged.derivatives[1, :2], [[0.5, 0.0, 0.0], [0.0, 0.1, 0.0]])
    assert np.isnan(merged.derivatives[1, 2]).all()
    same = without_repeats(problem(SQUARE_WAYPOINTS[[0, 1, 1, 2]], derivatives=derivatives[[0, 1, 1, 3]]))
    np.testing.assert_array_equal(same.derivatives[1, 0], [0.5, 0.0, 0.0])


@pytest.mark.long
def test_a_too_short_time_is_reported_with_a_remedy_that_works():
    times = np.array([0.0, 2.0, 4.0, 6.0, 8.0])
    with pytest.raises(InputError) as error:
        plan_path(problem(), FixedTimes(tuple(times)))
    words = re.fullmatch(
        r"the acceleration limit of 0.7 m/s² cannot be kept on segment (\d): at these times at least ([\d.]+) m/s² is "
        r"needed; the flight is feasible if all durations are multiplied by ([\d.]+)",
        str(error.value),
    )
    assert 0 <= int(words[1]) <= 3
    needed, slower = float(words[2]), float(words[3])
    # The acceleration decreases with the square of the duration.
    assert slower == pytest.approx(np.sqrt(needed / 0.7), rel=0.01)
    path = plan_path(problem(), FixedTimes(tuple(slower * times)))
    assert max(fractions(path)) <= 1.0 + 1e-6
    with pytest.raises(InputError, match="cannot be kept"):
        plan_path(problem(), FixedTimes(tuple(0.98 * slower * times)))
    with pytest.raises(
        InputError, match=r"the speed limit of 1 m/s .* at least 2.19 m/s is needed; the flight .* multiplied by 2.19"
    ):
        plan_path(problem(SQUARE_WAYPOINTS[:2], limits=PathLimits(speed=1.0)), FixedTimes((0.0, 2.0)))
    with pytest.raises(InputError, match=r"the acceleration limit .* multiplied by 1\.\d+"):
        plan_path(problem(), MinimumSnapTiming(9.0))


@pytest.mark.slow
@pytest.mark.parametrize(
    "times", [(0.0, 0.01, 3.0, 9.0, 10.0), (0.0, 1e-9, 2e-9, 3e-9, 4e-9), (0.0, 1e-3, 2.0, 3.0, 4.0)]
)
def test_a_far_too_short_time_is_reported_with_the_violated_limit_and_a_working_remedy(times):
    with pytest.raises(InputError, match="the (speed|acceleration) limit .* cannot be kept on segment") as error:
        plan_path(problem(), FixedTimes(times))
    slower = float(
        re.search(r"the flight is feasible if all durations are multiplied by ([\d.e+]+)", str(error.value))[1]
    )
    path = plan_path(problem(), FixedTimes(tuple(slower * np.array(times))))
    assert max(fractions(path)) <= 1.0 + 1e-6


def test_an_object_of_another_type_than_a_timing_is_rejected():
    with pytest.raises(TypeError, match="is not a FixedTimes, HeuristicTiming, MinimumSnapTiming or MinimumTimeTiming"):
        plan_path(problem(), MinimumTimeTiming)


def test_a_path_that_turns_back_is_not_slower_than_a_path_with_a_stop():
    points = np.array([[0.0, 0.0, 1.0], [4.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    path = plan_path(problem(points), MinimumTimeTiming())
    assert total(path) <= 1.0011 * rest_to_rest_durations(points, LIMITS).sum()


def test_a_velocity_that_leads_out_of_its_corridor_is_reported():
    derivatives = rest_at_ends(5, 3)
    derivatives[2, 0] = [1.5, 0.0, 0.0]
    with pytest.raises(InputError, match=r"the path cannot stay in the corridor of segment \d .* [\d.]+ m wider"):
        plan_path(
            problem(derivatives=derivatives, corridors=CORRIDORS_AROUND_SQUARE), FixedTimes((0.0, 4.0, 8.0, 12.0, 16.0))
        )


@pytest.mark.parametrize(
    ("path_problem", "timing", "words"),
    [
        (problem(), FixedTimes((0.0, 1.0)), "2 times for 5 waypoints"),
        (problem(), FixedTimes((0.0, 1.0, 1.0, 2.0, 3.0)), "must be finite and increase, but 1 s is followed by 1 s"),
        (problem(), FixedTimes((0.0, 1.0, np.nan, 2.0, 3.0)), "times must be finite and increase$"),
        (problem(), FixedTimes((0.0, 1.0, 2.0, np.inf, np.inf)), "times must be finite and increase$"),
        (problem(), FixedTimes((0.0, 1.0, 2.0, 3.0, 1e9)), "the times span 1e\\+09 s, more than 86400 s"),
        (problem(), MinimumSnapTiming(0.0), "total duration is 0 s, but must be positive"),
        (problem(), MinimumSnapTiming(1e6), "total duration is 1e\\+06 s, but must be positive and at most 86400 s"),
        (problem(limits=PathLimits(speed=1e-9)), MinimumTimeTiming(), "would take about .* s, more than 86400 s"),
        (problem(limits=PathLimits(speed=1e-300)), HeuristicTiming(), "would take about .* s, more than 86400 s"),
        (PathProblem([Box([0, 0], [1, 1])] * 2, limits=LIMITS), MinimumTimeTiming(), "need not move; give the times"),
        (
            PathProblem([Sphere([0, 0], 1.0), Sphere([0.1, 0], 1.0), Sphere([0, 0.1], 1.0)], limits=LIMITS),
            MinimumTimeTiming(),
            "the vehicle need not move; give the times",
        ),
        (problem(limits=PathLimits()), MinimumTimeTiming(), "give a limit on the speed or acceleration"),
        (problem(SQUARE_WAYPOINTS[[0, 0]]), MinimumTimeTiming(), r"all waypoints are the same point, \(0, 0, 0\) m"),
    ],
)
def test_invalid_input_is_rejected_with_the_reason(path_problem, timing, words):
    with pytest.raises(InputError, match=words):
        plan_path(path_problem, timing)
