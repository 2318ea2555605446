"""Tests of minimum-snap paths with limits, corridors and regions, by comparison with independent optimisers."""

import logging

import numpy as np
import pytest
import scipy
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from pydrake.solvers import ClarabelSolver, SolutionResult

from drake_quad.reference import minimum_snap_program
from drake_quad.reference.minimum_snap import MinimumSnap, rest_at_ends, snap_cost
from drake_quad.reference.minimum_snap_program import (
    InfeasibleError,
    MinimumSnapProgram,
    RelaxedBounds,
    SolverError,
    constrained_minimum_snap,
)
from drake_quad.reference.path_problem import Box, PathLimits, PathProblem, Sphere
from drake_quad.reference.polynomial_path import evaluate, evaluate_at, peak_norm


def points(array):
    return [Box.point(point) for point in array]


def dense_samples(path, order=0, count=400):
    """Return dense samples (segments, count, axes) of a derivative of a path."""
    s = np.linspace(0.0, 1.0, count)
    every = np.repeat(np.arange(len(path.coefficients)), count)
    return evaluate_at(path, every, np.tile(s, len(path.coefficients)), order).reshape(
        -1, count, path.coefficients.shape[2]
    )


def jump(path, order):
    every = np.arange(len(path.coefficients))
    ends = [evaluate_at(path, every, np.full(len(every), s), order) for s in (1.0, 0.0)]
    return np.abs(ends[0][:-1] - ends[1][1:]).max()


def random_route(seed, segments):
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(size=(segments + 1, 3)), axis=0), rng.uniform(1.0, 2.5, segments)


@pytest.mark.long
@given(st.integers(0, 2**32 - 1), st.integers(2, 15), st.floats(0.8, 0.97))
@example(999999999, 9, 0.8623080172107366)  # infeasible, but the solver cannot prove it
@settings(max_examples=30, deadline=None)
def test_a_path_satisfies_the_limits_at_all_times_and_attains_one(seed, segments, fraction):
    waypoints, durations = random_route(seed, segments)
    free = MinimumSnap(waypoints, durations).path()
    peaks = {order: peak_norm(free, order) for order in (1, 2)}
    limits = PathLimits(speed=fraction * peaks[1], acceleration=fraction * peaks[2])
    try:
        path = constrained_minimum_snap(PathProblem(points(waypoints), limits=limits), durations)
    except InfeasibleError:
        assume(False)
    fractions = [
        np.linalg.norm(dense_samples(path, order), axis=2).max() / limit for order, limit in limits.by_order.items()
    ]
    assert max(fractions) <= 1.0 + 1e-6
    assert max(fractions) >= 0.999
    assert snap_cost(path).sum() >= snap_cost(free).sum()
    for order in (1, 2, 3):
        assert jump(path, order) <= 1e-8 * peak_norm(path, order)
    np.testing.assert_allclose(path.coefficients[:, 0], waypoints[:-1], atol=1e-12)


@pytest.mark.slow
def test_an_independent_optimiser_finds_the_same_constrained_path():
    """For one axis and two segments, SLSQP varies velocity, acceleration and jerk at the waypoint.

    SLSQP evaluates the constraints on a dense grid.
    """
    waypoints, durations, limit = np.array([[0.0], [1.0], [0.5]]), np.array([1.0, 1.0]), 5.0
    free = MinimumSnap(waypoints, durations).path()
    assert peak_norm(free, 2) > 1.05 * limit

    def path_of(x):
        derivatives = rest_at_ends(3, 1)
        derivatives[1, :, 0] = x
        return MinimumSnap(waypoints, durations, derivatives).path()

    def room(x):
        acceleration = dense_samples(path_of(x), 2, 600).ravel()
        return np.concatenate([limit - acceleration, limit + acceleration])

    start = np.array([evaluate(free, [1.0], order)[0, 0] for order in (1, 2, 3)])
    cost = snap_cost(free)[0]
    actual = scipy.optimize.minimize(
        lambda x: snap_cost(path_of(x))[0] / cost,
        start,
        method="SLSQP",
        constraints={"type": "ineq", "fun": room},
        options={"ftol": 1e-10, "maxiter": 300},
    )
    assert actual.success
    path = constrained_minimum_snap(PathProblem(points(waypoints), limits=PathLimits(acceleration=limit)), durations)
    # The path keeps a margin of 1e-4 below the limit, and the solution of SLSQP has no margin.
    assert snap_cost(path)[0] / cost == pytest.approx(actual.fun, rel=1e-3)


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.integers(2, 12), st.floats(0.05, 0.3))
@settings(max_examples=30, deadline=None)
def test_a_path_stays_in_its_corridors_at_all_times(seed, segments, margin):
    waypoints, durations = random_route(seed, segments)
    low = np.minimum(waypoints[:-1], waypoints[1:]) - margin
    high = np.maximum(waypoints[:-1], waypoints[1:]) + margin
    corridors = [Box(a, b) for a, b in zip(low, high, strict=True)]
    path = constrained_minimum_snap(PathProblem(points(waypoints), corridors=corridors), durations)
    positions = dense_samples(path)
    beyond = np.maximum(low[:, np.newaxis] - positions, positions - high[:, np.newaxis]).max(axis=(1, 2))
    assert (beyond <= 1e-6 * (high - low).max(axis=1)).all()
    free = MinimumSnap(waypoints, durations).path()
    positions = dense_samples(free)
    breach = np.maximum(low[:, np.newaxis] - positions, positions - high[:, np.newaxis]).max()
    if breach > 0.0:
        assert snap_cost(path).sum() >= snap_cost(free).sum()
    else:
        np.testing.assert_allclose(path.coefficients, free.coefficients, rtol=1e-10, atol=1e-10)


def test_a_path_in_a_corridor_of_zero_height_is_level():
    waypoints = np.array([[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [2.0, 2.0, 1.0], [0.0, 3.0, 2.0]])
    corridors = [Box([-1, -1, 1], [4, 4, 1]), Box([-1, -1, 1], [4, 4, 1]), None]
    path = constrained_minimum_snap(PathProblem(points(waypoints), corridors=corridors), np.ones(3))
    np.testing.assert_allclose(dense_samples(path)[:2, :, 2], 1.0, atol=1e-12)


def test_at_a_waypoint_on_a_wall_the_path_is_parallel_to_the_wall():
    waypoints = np.array([[0.0, 0.5], [1.0, 0.0], [2.0, 0.5]])
    corridor = Box([-1.0, 0.0], [3.0, 1.0])
    path = constrained_minimum_snap(PathProblem(points(waypoints), corridors=[corridor] * 2), np.array([1.0, 0.8]))
    assert dense_samples(path)[:, :, 1].min() >= -1e-6
    # The remaining excess beyond the wall, v² / 2a, is within the tolerance of the corridor.
    assert evaluate(path, [1.0], 1)[1, 0] == pytest.approx(0.0, abs=5e-3)


def test_boxes_and_spheres_are_passed_at_the_point_of_minimum_cost():
    ends = [Box.point([0.0, 0.0]), Box.point([4.0, 0.0])]
    sphere = Sphere([2.0, 1.0], 0.5)
    durations = np.array([2.0, 2.0])
    path = constrained_minimum_snap(PathProblem([ends[0], sphere, ends[1]]), durations)
    position = evaluate(path, [2.0])[:, 0]
    assert np.linalg.norm(position - sphere.centre) == pytest.approx(sphere.radius, rel=1e-6)
    # By symmetry, the point of minimum cost is the lowest point.
    np.testing.assert_allclose(position, [2.0, 0.5], atol=1e-6)
    box = Box([1.0, 0.75], [3.0, 2.0])
    position = evaluate(constrained_minimum_snap(PathProblem([ends[0], box, ends[1]]), durations), [2.0])[:, 0]
    np.testing.assert_allclose(position, [2.0, 0.75], atol=1e-6)
    region = Box([1.0, -1.0], [3.0, 2.0])
    path = constrained_minimum_snap(PathProblem([ends[0], region, ends[1]]), durations)
    direct = MinimumSnap(np.array([[0.0, 0.0], [4.0, 0.0]]), np.array([4.0])).cost
    assert snap_cost(path).sum() == pytest.approx(direct, rel=1e-6), (
        "a box that does not constrain the path must not increase the cost"
    )


@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_user_defined_constraint_can_be_added(order):
    waypoints, durations = np.array([[0.0], [1.0], [3.0]]), np.array([1.0, 1.3])
    planned = MinimumSnapProgram(PathProblem(points(waypoints)), durations)
    free = evaluate(planned.solve(), [1.0], order)[0, 0]
    change = -0.5 * free / planned.scales[1, order]
    planned.program.AddBoundingBoxConstraint(change, change, planned.variables[1, order, 0])
    changed = planned.solve()
    assert evaluate(changed, [1.0], order)[0, 0] == pytest.approx(0.5 * free, rel=1e-6)


@pytest.mark.parametrize(
    ("slack", "fraction"), [(None, 1.0), (RelaxedBounds.LIMITS, 1e-6), (RelaxedBounds.CORRIDORS, 1e-6)]
)
def test_variables_are_scaled_so_that_a_unit_change_costs_as_much_as_the_unconstrained_path(slack, fraction):
    """The coefficients of the program therefore have similar magnitudes for any durations."""
    waypoints, durations = np.array([[0.0, 0.0], [1.0, 3.0], [30.0, 2.0], [28.0, 1.0]]), np.array([0.3, 20.0, 2.0])
    regions = [points(waypoints)[0], Box([0.0, 2.0], [2.0, 4.0]), Sphere([30.0, 2.0], 1.0), points(waypoints)[3]]
    planned = MinimumSnapProgram(PathProblem(regions), durations, slack=slack)
    costs = dict.fromkeys((variable.get_id() for variable in planned.variables.ravel() if variable is not None), 0.0)
    for binding in planned.program.quadratic_costs():
        for variable, curvature in zip(binding.variables(), np.diag(binding.evaluator().Q()), strict=True):
            costs[variable.get_id()] += 0.5 * curvature
    assert len(costs) == 2 * 2 * 4
    np.testing.assert_allclose(list(costs.values()), fraction, rtol=1e-9)


def test_a_path_through_points_within_limits_needs_no_solver():
    waypoints, durations = random_route(5, 4)
    free = MinimumSnap(waypoints, durations).path()
    limits = PathLimits(speed=peak_norm(free, 1), acceleration=1.01 * peak_norm(free, 2))
    np.testing.assert_array_equal(
        constrained_minimum_snap(PathProblem(points(waypoints), limits=limits), durations).coefficients,
        free.coefficients,
    )


@pytest.mark.parametrize("order", [1, 2])
def test_a_single_violated_limit_requires_the_solver(order):
    waypoints, durations = random_route(5, 4)
    free = MinimumSnap(waypoints, durations).path()
    bounds = {1: 9.0 * peak_norm(free, 1), 2: 9.0 * peak_norm(free, 2)}
    bounds[order] /= 10.0
    path = constrained_minimum_snap(PathProblem(points(waypoints), limits=PathLimits(bounds[1], bounds[2])), durations)
    assert peak_norm(path, order) == pytest.approx(bounds[order], rel=1e-3)


def test_a_box_is_passed_at_its_nearest_face():
    ends, durations = points([[0.0, 0.0], [4.0, 0.0]]), np.array([2.0, 3.0])
    for low, high, face in ((0.75, 2.0, 0.75), (-2.0, -0.75, -0.75)):
        across = constrained_minimum_snap(PathProblem([ends[0], Box([1.0, low], [3.0, high]), ends[1]]), durations)
        assert across.waypoints[1, 1] == pytest.approx(face, abs=1e-6)
    for low, high, face in ((2.5, 3.0, 2.5), (0.5, 1.0, 1.0)):
        along = constrained_minimum_snap(PathProblem([ends[0], Box([low, 1.0], [high, 2.0]), ends[1]]), durations)
        np.testing.assert_allclose(along.waypoints[1], [face, 1.0], atol=1e-6)


def test_a_path_begins_at_the_best_point_of_a_sphere():
    regions = [Sphere([0.0, 0.0], 0.5), Box.point([4.0, 3.0])]
    np.testing.assert_allclose(
        constrained_minimum_snap(PathProblem(regions), np.array([2.0])).waypoints[0], [0.4, 0.3], atol=1e-6
    )


def test_a_corridor_of_zero_height_reduces_a_sphere_to_a_circle():
    """At a height of 1 m the intersection is a circle with a radius of 0.4 m."""
    flat = Box([-1.0, -3.0, 1.0], [5.0, 3.0, 1.0])
    regions = [Box.point([0.0, 0.0, 1.0]), Sphere([2.0, 1.0, 1.3], 0.5), Box.point([4.0, 0.0, 1.0])]
    path = constrained_minimum_snap(PathProblem(regions, corridors=[flat, None]), np.array([2.0, 2.0]))
    np.testing.assert_allclose(path.waypoints[1], [2.0, 0.6, 1.0], atol=1e-4)
    assert np.linalg.norm(path.waypoints[1] - regions[1].centre) == pytest.approx(0.5, abs=1e-7)
    point_corridor = Box([2.0, 0.9, 1.0], [2.0, 0.9, 1.0])
    path_without_motion = constrained_minimum_snap(
        PathProblem([regions[1], Box.point([2.0, 0.9, 1.0])], corridors=[point_corridor]), np.array([2.0])
    )
    np.testing.assert_array_equal(path_without_motion.waypoints, [[2.0, 0.9, 1.0]] * 2)


def test_a_path_may_change_its_height_after_a_corridor_of_zero_height():
    waypoints, durations = random_route(2, 4)
    waypoints[1, 2] = waypoints[0, 2]
    flat = Box(
        [*(waypoints.min(axis=0) - 9.0)[:2], waypoints[0, 2]], [*(waypoints.max(axis=0) + 9.0)[:2], waypoints[0, 2]]
    )
    path = constrained_minimum_snap(PathProblem(points(waypoints), corridors=[flat, None, None, None]), durations)
    derivatives = rest_at_ends(5, 1)
    derivatives[1] = 0.0
    heights = MinimumSnap(waypoints[:, 2:], durations, derivatives).path()
    np.testing.assert_allclose(path.coefficients[:, :, 2:], heights.coefficients, atol=1e-6)


def test_scaling_a_problem_with_corridors_scales_its_path():
    waypoints, durations = random_route(8, 5)
    low, high = np.minimum(waypoints[:-1], waypoints[1:]) - 0.1, np.maximum(waypoints[:-1], waypoints[1:]) + 0.1

    def within(scale):
        corridors = [Box(scale * a, scale * b) for a, b in zip(low, high, strict=True)]
        return constrained_minimum_snap(PathProblem(points(scale * waypoints), corridors=corridors), durations)

    expected = within(1.0).coefficients
    for scale in (1e-3, 1e3):
        np.testing.assert_allclose(within(scale).coefficients / scale, expected, atol=2e-5 * np.abs(expected).max())


@pytest.mark.parametrize("slack", list(RelaxedBounds))
def test_a_feasible_problem_with_slack_has_zero_slack_and_the_smoothest_path(slack):
    waypoints, durations = random_route(3, 4)
    free = MinimumSnap(waypoints, durations).path()
    limits = PathLimits(speed=3.0 * peak_norm(free, 1), acceleration=3.0 * peak_norm(free, 2))
    wide = [Box([-99.0] * 3, [99.0] * 3)] * 4
    planned = MinimumSnapProgram(PathProblem(points(waypoints), limits=limits, corridors=wide), durations, slack=slack)
    path = planned.solve()
    assert planned.excess == pytest.approx(0.0, abs=1e-6)
    assert snap_cost(path).sum() == pytest.approx(snap_cost(free).sum(), rel=1e-4)


def test_impossible_constraints_are_infeasible():
    single = PathProblem(points([[0.0], [1.0]]), limits=PathLimits(speed=1.0))
    assert peak_norm(constrained_minimum_snap(single, np.array([2.2])), 1) == pytest.approx(2.1875 / 2.2)
    with pytest.raises(InfeasibleError):
        constrained_minimum_snap(single, np.array([2.1]))
    double = PathProblem(points([[0.0], [1.0], [2.0]]), limits=PathLimits(speed=1.0))
    with pytest.raises(InfeasibleError):
        constrained_minimum_snap(double, np.array([0.9, 0.9]))


def test_a_program_is_infeasible_if_a_path_without_free_derivatives_violates_a_bound():
    """A rest-to-rest path with one segment has no free derivatives, and is in the middle at half time."""
    program = MinimumSnapProgram(PathProblem(points([[0.0, 1.0], [4.0, 3.0]])), np.array([2.0]))
    program.bound_position(0, 0.5, 0, 1.9, 2.1)
    program.bound_position(0, 0.5, 1, 1.9, 2.1)
    for axis, low, high in ((0, 2.1, 3.0), (0, 1.0, 1.9), (1, 2.1, 3.0), (1, 1.0, 1.9)):
        with pytest.raises(InfeasibleError):
            program.bound_position(0, 0.5, axis, low, high)


def test_a_program_is_infeasible_if_an_axis_without_free_variables_violates_a_bound():
    """In a corridor of zero height, the height is fixed although another axis is free."""
    waypoints, flat = [[0.0, 1.0], [2.0, 1.0], [3.0, 1.0]], Box([-9.0, 1.0], [9.0, 1.0])
    program = MinimumSnapProgram(PathProblem(points(waypoints), corridors=[flat] * 2), np.array([2.0, 1.0]))
    program.bound_position(0, 0.5, 1, 0.9, 1.1)
    assert not program.program.linear_constraints()
    program.bound_position(0, 0.5, 0, 0.9, 1.1)
    assert len(program.program.linear_constraints()) == 1
    for low, high in ((1.1, 2.0), (0.0, 0.9)):
        with pytest.raises(InfeasibleError):
            program.bound_position(0, 0.5, 1, low, high)


def test_a_speed_bound_below_a_given_speed_is_infeasible():
    program = MinimumSnapProgram(PathProblem(points([[0.0, 1.0], [3.0, 5.0]])), np.array([2.0]))
    fastest = 35.0 / 16.0 * 5.0 / 2.0
    program.bound_norm(0, 0.5, 1, 1.001 * fastest)
    with pytest.raises(InfeasibleError):
        program.bound_norm(0, 0.5, 1, 0.999 * fastest)


def test_an_infeasible_program_is_reported_as_infeasible():
    planned = MinimumSnapProgram(PathProblem(points([[0.0], [1.0], [2.0]])), np.array([1.0, 1.0]))
    planned.bound_position(0, 0.5, 0, 2.0, 3.0)
    planned.bound_position(0, 0.5, 0, 0.0, 1.0)
    with pytest.raises(InfeasibleError):
        planned.solve()


def test_the_solver_is_silently_called_again_with_a_larger_tolerance(monkeypatch):
    options_by_call, levels = [], []

    class Refusal:
        def get_solution_result(self):
            return SolutionResult.kSolverSpecificError

    class FailingOnce(ClarabelSolver):
        def Solve(self, program, guess, options):
            options_by_call.append(options.options[self.solver_id().name()])
            levels.append(logging.getLogger("drake").level)
            return Refusal() if len(options_by_call) < 3 else super().Solve(program, guess, options)

    monkeypatch.setattr(minimum_snap_program, "ClarabelSolver", FailingOnce)
    path = MinimumSnapProgram(PathProblem(points([[0.0], [1.0], [2.0]])), np.array([1.0, 1.0])).solve()
    assert snap_cost(path)[0] == pytest.approx(3150.0, rel=1e-4)
    names = ("tol_feas", "tol_gap_abs", "tol_gap_rel")
    assert options_by_call == [dict.fromkeys(names, tolerance) for tolerance in (1e-9, 1e-7, 1e-5)]
    assert levels == [logging.WARNING] * 3


def test_the_number_of_rounds_with_additional_bounds_is_limited(monkeypatch):
    monkeypatch.setattr(minimum_snap_program, "_MAX_ROUNDS", 1)
    waypoints, durations = random_route(5, 4)
    limits = PathLimits(speed=0.9 * peak_norm(MinimumSnap(waypoints, durations).path(), 1))
    with pytest.raises(SolverError, match="still violates a limit or corridor after 1 rounds"):
        MinimumSnapProgram(PathProblem(points(waypoints), limits=limits), durations).solve()


def test_the_log_level_of_drake_is_restored_after_a_solution():
    logger = logging.getLogger("drake")
    level = logger.level
    try:
        logger.setLevel(logging.INFO)
        limits = PathLimits(speed=0.9 * peak_norm(MinimumSnap(np.array([[0.0], [1.0], [3.0]]), np.ones(2)).path(), 1))
        constrained_minimum_snap(PathProblem(points([[0.0], [1.0], [3.0]]), limits=limits), np.array([1.0, 1.0]))
        assert logger.level == logging.INFO
    finally:
        logger.setLevel(level)


def test_the_excess_over_limits_is_the_smallest_possible():
    waypoints, durations = random_route(3, 6)
    free = MinimumSnap(waypoints, durations).path()
    limits = {"speed": 0.6 * peak_norm(free, 1), "acceleration": 0.6 * peak_norm(free, 2)}
    program = MinimumSnapProgram(
        PathProblem(points(waypoints), limits=PathLimits(**limits)), durations, slack=RelaxedBounds.LIMITS
    )
    program.solve()
    assert program.excess > 0.01

    def path(fraction):
        wider = PathLimits(**{name: (1.0 + fraction * program.excess) * limit for name, limit in limits.items()})
        return constrained_minimum_snap(PathProblem(points(waypoints), limits=wider), durations)

    assert path(1.01).duration == pytest.approx(durations.sum())
    with pytest.raises(InfeasibleError):
        path(0.97)


def test_a_failure_of_the_solver_raises_an_error(monkeypatch):
    """The solver fails because it may take only one step."""

    class OneStep(ClarabelSolver):
        def Solve(self, program, guess, options):
            options.SetOption(ClarabelSolver.id(), "max_iter", 1)
            return super().Solve(program, guess, options)

    monkeypatch.setattr(minimum_snap_program, "ClarabelSolver", OneStep)
    route = points(np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 0.0], [3.0, 0.0, 1.0]]))
    problem = PathProblem(route, derivatives=rest_at_ends(3, 3), limits=PathLimits(speed=2.0))
    with pytest.raises(SolverError, match="the minimum-snap program was not solved: k"):
        constrained_minimum_snap(problem, np.array([1.5, 1.5]))
