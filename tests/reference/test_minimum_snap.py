"""Tests of minimum-snap paths in closed form, by comparison with exact costs, splines and other planners."""

import math

import minsnap_trajectories as other
import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_quad.errors import InputError
from drake_quad.reference.minimum_snap import (
    BOUNDARY_FORM,
    Contact,
    MinimumSnap,
    minimum_snap,
    rest_at_ends,
    snap_cost,
    waypoint_units,
)
from drake_quad.reference.minimum_snap_program import MinimumSnapProgram
from drake_quad.reference.path_problem import Box, PathProblem
from drake_quad.reference.plan import to_piecewise_polynomial
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate, evaluate_at
from drake_quad.reference.time_optimization import minimum_snap_durations

# Waypoints (m), times (s) and exact cost (m²/s⁷) of one-dimensional paths.
EXACT_COSTS = [
    ([0, 1.7], [0, 1.3], 100800 * 1.7**2 / 1.3**7),
    ([0, 1, 0], [0, 1, 2], 32256),
    ([0, 1, 2], [0, 1, 2], 3150),
    ([0, 1, 0], [0, 1, 3], 137781 / 32),
    ([0, 1, 0, 1], [0, 1, 2, 3], 15095360 / 629),
    ([0, 1, 3, 2], [0, 1, 2, 3], 2920013600 / 313871),
    ([0, 0.5, 1], [0, 0.5, 1], 100800),
]


def program(waypoints, times):
    problem = PathProblem([Box.point(point) for point in waypoints])
    return MinimumSnapProgram(problem, np.diff(times)).solve()._replace(times=np.array(times))


PLANNERS = {"closed form": minimum_snap, "program": program}
planners = pytest.mark.parametrize("plan", PLANNERS.values(), ids=PLANNERS.keys())


def jumps(path: PolynomialPath, order: int) -> tuple[float, float]:
    """Return the largest jump of a time derivative at the waypoints, and the largest value of this derivative there."""
    every = np.arange(len(path.coefficients))
    ends = [evaluate_at(path, every, np.full(len(every), s), order) for s in (1.0, 0.0)]
    return np.abs(ends[0][:-1] - ends[1][1:]).max(initial=0.0), np.abs(ends).max()


@planners
@pytest.mark.parametrize(("waypoints", "times", "cost"), EXACT_COSTS)
def test_minimum_snap_costs_equal_exact_values(plan, waypoints, times, cost):
    path = plan(np.array(waypoints)[:, np.newaxis], times)
    assert snap_cost(path)[0] == pytest.approx(cost, rel=1e-8)


def test_a_rest_to_rest_segment_is_the_known_polynomial_with_known_peaks():
    path = minimum_snap([[0.0], [2.0]], [1.0, 4.0])
    np.testing.assert_allclose(path.coefficients[0, :, 0] / 2.0, [0, 0, 0, 0, 35, -84, 70, -20], atol=1e-12)
    times = np.linspace(1.0, 4.0, 100_001)
    for order, peak in ((1, 2.1875), (2, 7.51319), (3, 52.5), (4, 840.0)):
        assert np.abs(evaluate(path, times, order)).max() == pytest.approx(peak * 2.0 / 3.0**order, rel=1e-6)


@given(st.integers(1, 12), st.integers(0, 2**32 - 1))
@settings(max_examples=50, deadline=None)
def test_the_path_is_the_clamped_interpolating_spline_of_degree_7(segments, seed):
    rng = np.random.default_rng(seed)
    waypoints = rng.normal(size=(segments + 1, 3))
    times = np.cumsum(rng.uniform(0.5, 2.0, segments + 1))
    rest = [(order, np.zeros(3)) for order in (1, 2, 3)]
    spline = scipy.interpolate.make_interp_spline(times, waypoints, k=7, bc_type=(rest, rest))
    path = minimum_snap(waypoints, times)
    samples = np.linspace(times[0], times[-1], 60)
    for order in range(5):
        expected = spline(samples, nu=order).T
        np.testing.assert_allclose(
            evaluate(path, samples, order), expected, rtol=0.0, atol=1e-9 * max(1.0, np.abs(expected).max())
        )


@planners
@pytest.mark.parametrize(
    "durations",
    [[0.2, 20.0], [20.0, 0.2, 20.0], [0.2, 20.0, 0.2], [20.0, 20.0, 0.2, 20.0, 0.2, 0.2, 20.0], [0.2, 0.2, 20.0, 0.2]],
)
def test_short_segments_next_to_long_ones_are_accurate(plan, durations):
    rng = np.random.default_rng(7)
    # The distances correspond to a speed of about 1 m/s.
    steps = rng.normal(size=(len(durations), 3)) * np.array(durations)[:, np.newaxis]
    waypoints = np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])
    path = plan(waypoints, np.concatenate([[0.0], np.cumsum(durations)]))
    np.testing.assert_allclose(path.coefficients[:, 0], waypoints[:-1], atol=1e-9)
    np.testing.assert_allclose(path.coefficients.sum(axis=1), waypoints[1:], atol=1e-9)
    for order in range(1, 6):
        jump, peak = jumps(path, order)
        assert jump <= 1e-8 * max(1.0, peak)
    jump, peak = jumps(path, 6)
    assert jump <= 1e-4 * peak


@given(st.integers(1, 10), st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_the_closed_form_and_the_program_give_the_same_path(segments, seed):
    rng = np.random.default_rng(seed)
    waypoints = rng.normal(size=(segments + 1, 2))
    times = np.cumsum(rng.uniform(0.3, 3.0, segments + 1))
    fast, solved = (plan(waypoints, times) for plan in PLANNERS.values())
    np.testing.assert_allclose(snap_cost(solved), snap_cost(fast), rtol=1e-8)
    scale = np.abs(fast.coefficients).max()
    np.testing.assert_allclose(solved.coefficients, fast.coefficients, rtol=0.0, atol=1e-7 * scale)


def test_doubling_all_times_divides_the_cost_by_128():
    waypoints, times = np.random.default_rng(3).normal(size=(6, 3)), np.array([0.0, 1.0, 1.5, 3.0, 4.0, 4.7])
    ratio = snap_cost(minimum_snap(waypoints, times)) / snap_cost(minimum_snap(waypoints, 2.0 * times))
    np.testing.assert_allclose(ratio, 128.0, rtol=1e-12)


def test_the_path_has_the_minimum_cost_of_all_paths_through_the_waypoints():
    """Random smooth detours increase the cost. They vanish at the waypoints, as do their first three derivatives."""
    rng = np.random.default_rng(5)
    waypoints, times = rng.normal(size=(4, 1)), [0.0, 1.0, 2.5, 3.0]
    best = minimum_snap(waypoints, times)
    for _ in range(20):
        # The detour s⁴ (1 - s)⁴ has degree 8, since no polynomial of degree 7 vanishes at both ends with three
        # derivatives.
        detour = rng.normal(size=3) * 1e-2
        bump = np.array([math.comb(4, k) * (-1.0) ** k for k in range(5)])
        coefficients = np.zeros((3, 9, 1))
        coefficients[:, :8] = best.coefficients
        coefficients[:, 4:, 0] += detour[:, np.newaxis] * bump
        snap = coefficients[:, 4:, 0] * [math.perm(k, 4) for k in range(4, 9)]
        forms = 1.0 / (np.add.outer(np.arange(5), np.arange(5)) + 1.0)
        cost = np.sum(np.einsum("nk,kl,nl->n", snap, forms, snap) * best.durations**-7.0)
        assert cost > snap_cost(best)[0]


def test_a_path_can_be_converted_to_a_drake_trajectory():
    waypoints, times = np.random.default_rng(1).normal(size=(7, 3)), np.array([1.0, 2.0, 2.2, 4.0, 5.0, 8.0, 8.5])
    path = minimum_snap(waypoints, times)
    trajectory = to_piecewise_polynomial(path)
    assert (trajectory.start_time(), trajectory.end_time()) == (1.0, 8.5)
    for time, waypoint in zip(times, waypoints, strict=True):
        np.testing.assert_allclose(trajectory.value(time)[:, 0], waypoint, atol=1e-9)
    samples = np.linspace(1.0, 8.5, 101)
    for order in range(5):
        path_values = evaluate(path, samples, order)
        trajectory_values = np.array([trajectory.EvalDerivative(t, order)[:, 0] for t in samples]).T
        np.testing.assert_allclose(
            path_values, trajectory_values, rtol=0.0, atol=1e-9 * max(1.0, np.abs(path_values).max())
        )


@pytest.mark.parametrize(
    ("waypoints", "times", "words"),
    [
        ([[0.0]], [0.0], "two or more waypoints"),
        ([[0.0], [1.0]], [0.0], "one time for each"),
        ([[0.0], [1.0]], [1.0, 1.0], "times must increase"),
        ([[0.0], [math.nan]], [0.0, 1.0], "finite"),
        ([[0.0], [1.0]], [0.0, math.inf], "finite"),
        ([0.0, 1.0], [0.0, 1.0], "as rows"),
        ([[0.0], [1.0], [2.0], [3.0]], [0.0, 2.0, 1.0, 0.5], "waypoint 1 is passed at 2 s and waypoint 2 at 1 s"),
    ],
)
def test_invalid_waypoints_are_rejected_with_the_reason(waypoints, times, words):
    with pytest.raises(InputError, match=words):
        minimum_snap(waypoints, times)


@pytest.mark.parametrize(
    ("derivatives", "words"),
    [
        (np.zeros((2, 3)), "have the shape"),
        (np.zeros((2, 2, 2)), "have the shape"),
        (np.zeros((2, 3, 1)), "have the shape"),
        (np.stack([np.zeros((3, 2)), [[0.0, math.nan], [0.0, 0.0], [0.0, 0.0]]]), "on all axes or on none"),
    ],
)
def test_invalid_derivatives_are_rejected_with_the_reason(derivatives, words):
    with pytest.raises(InputError, match=words):
        minimum_snap([[0.0, 0.0], [1.0, 1.0]], [0.0, 1.0], derivatives)


def test_the_cost_matrix_consists_of_integers_and_a_path_at_rest_has_no_cost():
    np.testing.assert_array_equal(BOUNDARY_FORM % 1.0, 0.0)
    np.testing.assert_array_equal(BOUNDARY_FORM @ [1, 0, 0, 0, 1, 0, 0, 0], 0.0)
    assert BOUNDARY_FORM[0, 0] == 100_800.0


def test_the_unit_of_time_of_a_waypoint_is_the_duration_of_the_shorter_adjacent_segment():
    np.testing.assert_array_equal(waypoint_units(np.array([3.0, 0.2, 20.0])), [3.0, 0.2, 0.2, 20.0])


def test_prescribing_the_same_position_twice_does_not_change_the_path():
    rng = np.random.default_rng(8)
    points, durations = rng.normal(size=(4, 2)), rng.uniform(0.5, 2.0, 3)
    contact = Contact(1, 0.4, 1, 0.7)
    with_one_contact, with_two_contacts = (
        MinimumSnap(points, durations, contacts=[contact] * count) for count in (1, 2)
    )
    np.testing.assert_allclose(with_two_contacts.boundary, with_one_contact.boundary, atol=1e-9)
    np.testing.assert_allclose(with_two_contacts.cost_gradient(), with_one_contact.cost_gradient(), rtol=1e-9)


@pytest.mark.long
@given(st.integers(2, 12), st.integers(0, 2**32 - 1), st.booleans(), st.integers(0, 3))
@settings(max_examples=40, deadline=None)
def test_gradients_agree_with_finite_differences(segments, seed, given_motion, touched):
    """The gradients are those of the cost and of the complete path with respect to the durations."""
    rng = np.random.default_rng(seed)
    points, durations = rng.normal(size=(segments + 1, 3)), rng.uniform(0.3, 3.0, segments)
    derivatives = rest_at_ends(segments + 1, 3)
    if given_motion:
        derivatives[segments // 2, 0] = rng.normal(size=3)
        derivatives[rng.integers(segments + 1)] = 0.0
    # At most one position is prescribed for each segment and axis, so the prescribed positions cannot contradict each
    # other.
    contact_numbers = rng.choice(segments * 3, size=min(touched, segments), replace=False)
    contacts = [Contact(int(i) // 3, rng.uniform(0.2, 0.8), int(i) % 3, rng.normal()) for i in contact_numbers]
    if given_motion:
        contacts = contacts[:1]

    def planned(durations):
        return MinimumSnap(points, durations, derivatives, contacts=contacts)

    solution = planned(durations)
    step = 1e-4
    costs, boundaries = [], []
    for i in range(segments):
        factors = np.ones((4, segments))
        factors[:, i] = np.exp(step * np.array([-2.0, -1.0, 1.0, 2.0]))
        moved = [planned(durations * factor) for factor in factors]
        for results, values in ((costs, [m.cost for m in moved]), (boundaries, [m.boundary for m in moved])):
            results.append((values[0] - 8.0 * values[1] + 8.0 * values[2] - values[3]) / (12.0 * step))
    gradient = solution.cost_gradient() * durations
    np.testing.assert_allclose(gradient, costs, rtol=1e-6, atol=1e-6 * np.abs(gradient).max())
    boundary_gradient = solution.boundary_gradient()
    scale = max(np.abs(boundary_gradient).max(), np.abs(solution.boundary).max())
    np.testing.assert_allclose(boundary_gradient, np.stack(boundaries, axis=-1), rtol=0.0, atol=1e-6 * scale)


def test_prescribed_positions_do_not_change_a_path_without_free_derivatives():
    """A prescribed position (`Contact`) does not change the derivatives of the cost either."""
    rng = np.random.default_rng(9)
    points, durations, derivatives = rng.normal(size=(4, 2)), rng.uniform(0.5, 2.0, 3), rng.normal(size=(4, 3, 2))
    without_contacts, with_contacts = (
        MinimumSnap(points, durations, derivatives, contacts=contacts) for contacts in ([], [Contact(1, 0.4, 1, 0.7)])
    )
    np.testing.assert_array_equal(with_contacts.boundary, without_contacts.boundary)
    np.testing.assert_array_equal(with_contacts.cost_gradient(), without_contacts.cost_gradient())
    np.testing.assert_array_equal(with_contacts.boundary_gradient(), without_contacts.boundary_gradient())


def test_a_path_attains_prescribed_positions_at_minimum_cost():
    rng = np.random.default_rng(6)
    points, durations = rng.normal(size=(6, 3)), rng.uniform(0.5, 2.0, 5)
    contacts = [Contact(0, 0.5, 0, 0.3), Contact(3, 0.3, 2, -0.4), Contact(3, 0.7, 2, 0.2)]
    with_contacts = MinimumSnap(points, durations, contacts=contacts)
    for contact in contacts:
        position = evaluate_at(with_contacts.path(), np.array([contact.segment]), np.array([contact.s]))
        assert position[0, contact.direction] == pytest.approx(contact.position, abs=1e-12)
    # The expected path is the solution of the program with the prescribed positions as equality constraints.
    planned = MinimumSnapProgram(PathProblem([Box.point(point) for point in points]), durations)
    for contact in contacts:
        planned.bound_position(contact.segment, contact.s, contact.direction, contact.position, contact.position)
    solved = planned.solve()
    assert snap_cost(solved).sum() == pytest.approx(with_contacts.cost, rel=1e-6)
    scale = np.abs(with_contacts.path().coefficients).max()
    np.testing.assert_allclose(solved.coefficients, with_contacts.path().coefficients, atol=1e-5 * scale)


def test_the_cost_from_boundary_derivatives_equals_the_cost_from_polynomial_coefficients():
    rng = np.random.default_rng(4)
    solution = MinimumSnap(rng.normal(size=(9, 3)), rng.uniform(0.3, 3.0, 8))
    assert solution.cost == pytest.approx(snap_cost(solution.path()).sum(), rel=1e-12)


def test_given_derivatives_are_kept_and_free_ones_are_optimal():
    rng = np.random.default_rng(2)
    derivatives = rest_at_ends(6, 3)
    derivatives[2, 0] = [1.0, -2.0, 0.5]
    derivatives[5] = [[0.3, 0.0, 0.0], [0.0, 0.1, 0.0], [np.nan] * 3]
    path = minimum_snap(rng.normal(size=(6, 3)), [0.0, 1.0, 1.5, 3.0, 4.0, 4.7], derivatives)
    velocity, acceleration = (evaluate(path, path.times, order).T for order in (1, 2))
    np.testing.assert_allclose(velocity[[0, 2, 5]], [[0, 0, 0], [1, -2, 0.5], [0.3, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(acceleration[[0, 5]], [[0, 0, 0], [0, 0.1, 0]], atol=1e-12)
    # If the derivative of order k is free at a waypoint, the derivative of order 7 - k is continuous there, or zero at
    # an end.
    every = np.arange(5)
    for order, free in ((4, [1, 2, 3, 4]), (5, [1, 2, 3, 4]), (6, [1, 3, 4])):
        before = evaluate_at(path, every, np.ones(5), order)[:-1]
        after = evaluate_at(path, every, np.zeros(5), order)[1:]
        inner = np.array(free) - 1
        np.testing.assert_allclose(before[inner], after[inner], atol=1e-8 * np.abs(before).max())
    np.testing.assert_allclose(evaluate_at(path, every[-1:], np.ones(1), 4), 0.0, atol=1e-9)


def test_stops_divide_the_path_into_independent_paths():
    waypoints = np.random.default_rng(8).normal(size=(6, 3))
    times = np.array([0.0, 1.0, 2.5, 3.0, 4.2, 5.0])
    derivatives = rest_at_ends(6, 3)
    derivatives[2] = 0.0
    full_path = minimum_snap(waypoints, times, derivatives)
    parts = minimum_snap(waypoints[:3], times[:3]), minimum_snap(waypoints[2:], times[2:])
    expected = np.concatenate([part.coefficients for part in parts])
    np.testing.assert_allclose(full_path.coefficients, expected, atol=1e-11)


def test_a_derivative_must_be_given_on_all_axes_or_on_none():
    derivatives = rest_at_ends(3, 3)
    derivatives[1, 0, 0] = 1.0
    with pytest.raises(InputError, match="on all axes or on none"):
        minimum_snap(np.eye(3), [0.0, 1.0, 2.0], derivatives)


def other_plan(waypoints, times):
    """Plan a path with the package minsnap_trajectories, with zero jerk at both ends as in this library."""
    rest = {"velocity": np.zeros(3), "acceleration": np.zeros(3), "jerk": np.zeros(3)}
    last = len(times) - 1
    references = [
        other.Waypoint(time=time, position=point, **(rest if i in (0, last) else {}))
        for i, (time, point) in enumerate(zip(times, waypoints, strict=True))
    ]
    return other.generate_trajectory(references, degree=7, idx_minimized_orders=4, num_continuous_orders=4)


def other_cost(trajectory, times):
    """Return the cost of a plan of `other_plan` by Gauss-Legendre quadrature, exact for the square of a cubic."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    half = 0.5 * np.diff(times)
    instants = times[:-1, np.newaxis] + half[:, np.newaxis] * (nodes + 1.0)
    snap = other.compute_trajectory_derivatives(trajectory, instants.ravel(), 5)[4].reshape(len(half), 4, 3)
    return np.einsum("n,w,nwa,nwa->", half, weights, snap, snap)


@pytest.mark.long
def test_another_planner_finds_the_same_path_and_optimised_times_reduce_its_cost():
    for seed in range(100):
        rng = np.random.default_rng(seed)
        segments = int(rng.integers(1, 9))
        waypoints = rng.normal(size=(segments + 1, 3))
        durations = rng.uniform(0.5, 2.0, segments)
        times = np.concatenate([[0.0], np.cumsum(durations)])
        other_trajectory = other_plan(waypoints, times)
        cost = other_cost(other_trajectory, times)
        path = minimum_snap(waypoints, times)
        assert snap_cost(path).sum() == pytest.approx(cost, rel=1e-9)
        samples = np.linspace(0.0, times[-1], 50)
        desired = other.compute_trajectory_derivatives(other_trajectory, samples, 5)
        for order in range(5):
            scale = np.abs(desired[order]).max()
            np.testing.assert_allclose(evaluate(path, samples, order).T, desired[order], atol=1e-7 * scale)
        better = minimum_snap_durations(waypoints, durations)
        assert better.sum() == pytest.approx(durations.sum(), rel=1e-12)
        assert MinimumSnap(waypoints, better).cost <= cost * (1.0 + 1e-9)
