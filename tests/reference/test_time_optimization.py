"""Tests that optimised times are optimal, by comparison with searches without gradients."""

import numpy as np
import pytest
import scipy
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_quad.reference.minimum_snap import Contact, MinimumSnap, rest_at_ends
from drake_quad.reference.path_problem import PathLimits
from drake_quad.reference.polynomial_path import peak_norm
from drake_quad.reference.time_allocation import rest_to_rest_durations, stretch_factor
from drake_quad.reference.time_optimization import minimum_snap_durations, minimum_time_durations

LIMITS = PathLimits(speed=2.0, acceleration=0.7)  # m/s and m/s²


def random_points(seed, segments):
    return np.cumsum(np.random.default_rng(seed).normal(size=(segments + 1, 3)), axis=0)


def total_within_limits(points, durations):
    return durations.sum() * stretch_factor(MinimumSnap(points, durations).path(), LIMITS)


def test_the_optimal_times_through_0_1_and_3_in_3_seconds_equal_the_known_times():
    points = np.array([[0.0], [1.0], [3.0]])
    assert MinimumSnap(points, np.array([1.5, 1.5])).cost == pytest.approx(886.78, abs=5e-3)
    durations = minimum_snap_durations(points, np.array([1.0, 2.0]))
    np.testing.assert_allclose(durations, [1.2658, 3.0 - 1.2658], atol=5e-5)
    assert MinimumSnap(points, durations).cost == pytest.approx(414.81, abs=5e-3)


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.integers(2, 12))
@settings(max_examples=25, deadline=None)
def test_the_times_are_a_local_optimum_of_the_snap(seed, segments):
    rng = np.random.default_rng(seed)
    points = random_points(seed, segments)
    durations = minimum_snap_durations(points, rng.uniform(0.5, 2.0, segments))
    best = MinimumSnap(points, durations).cost
    for _ in range(10):
        changed = durations * np.exp(1e-3 * rng.normal(size=segments))
        changed *= durations.sum() / changed.sum()
        assert MinimumSnap(points, changed).cost >= best * (1.0 - 1e-9)


@pytest.mark.slow
@given(st.integers(0, 2**32 - 1), st.integers(1, 15))
@settings(max_examples=25, deadline=None)
def test_the_fastest_path_satisfies_the_limits_and_attains_one(seed, segments):
    points = random_points(seed, segments)
    start = rest_to_rest_durations(points, LIMITS)
    durations = minimum_time_durations(points, start, LIMITS)
    assert durations.sum() <= total_within_limits(points, start) * (1.0 + 1e-12)
    path = MinimumSnap(points, durations).path()
    fractions = peak_norm(path, 1) / LIMITS.speed, peak_norm(path, 2) / LIMITS.acceleration
    assert max(fractions) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_a_search_without_gradients_finds_no_shorter_path(seed):
    points = random_points(seed, 4)
    durations = minimum_time_durations(points, rest_to_rest_durations(points, LIMITS), LIMITS)

    def logarithm_of_total(logarithms):
        return np.log(total_within_limits(points, np.exp(logarithms)))

    options = {"maxfev": 800, "xatol": 1e-5, "fatol": 1e-7}
    actual = scipy.optimize.minimize(logarithm_of_total, np.log(durations), method="Nelder-Mead", options=options)
    assert durations.sum() <= np.exp(actual.fun) * (1.0 + 1e-3)


@pytest.mark.parametrize("limits", [PathLimits(speed=1.0), PathLimits(speed=0.5, acceleration=0.3)])
def test_changing_a_single_duration_does_not_shorten_the_total_time(limits):
    """The test changes a duration by 1 %, and then scales all durations so that a limit is attained."""
    points = random_points(2, 4)
    durations = minimum_time_durations(points, rest_to_rest_durations(points, limits), limits)
    path = MinimumSnap(points, durations).path()
    assert peak_norm(path, 1) == pytest.approx(limits.speed, rel=1e-9)
    for i in range(4):
        for factor in (0.99, 1.01):
            moved = durations.copy()
            moved[i] *= factor
            stretch = stretch_factor(MinimumSnap(points, moved).path(), limits)
            assert stretch * moved.sum() >= durations.sum() * (1.0 - 1e-4)


def test_durations_change_by_at_most_the_trust_radius():
    """The durations are 0.1 s and 2.9 s. The optimum has a much longer first duration."""
    points, start = np.array([[0.0], [1.0], [3.0]]), np.array([0.1, 2.9])
    for actual in (
        minimum_snap_durations(points, start, max_log_change=0.1),
        minimum_time_durations(points, start, LIMITS, max_log_change=0.1),
    ):
        moved = np.log(actual / start)
        assert moved[0] - moved[1] == pytest.approx(0.2, abs=1e-9)


def test_minimum_snap_times_keep_the_total_time_and_given_derivatives():
    points, derivatives = random_points(4, 3), rest_at_ends(4, 3)
    derivatives[1, 0] = [1.0, -0.5, 0.2]
    contact = Contact(2, 0.5, 1, points[2, 1] + 0.4)
    start = np.array([1.0, 2.0, 0.7])
    durations = minimum_snap_durations(points, start, derivatives, contacts=[contact])
    assert durations.sum() == pytest.approx(3.7, rel=1e-12)

    def cost(durations):
        return MinimumSnap(points, durations, derivatives, contacts=[contact]).cost

    best = cost(durations)
    assert best < 0.99 * cost(start)
    for change in ([1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 1.0, -1.0], [0.0, -1.0, 1.0]):
        assert cost(durations + 0.01 * np.array(change)) > best


@pytest.mark.slow
def test_all_initial_durations_lead_to_about_the_same_total_time():
    points = random_points(11, 10)
    rng = np.random.default_rng(0)
    totals = [minimum_time_durations(points, rng.uniform(0.5, 3.0, 10), LIMITS).sum() for _ in range(4)]
    assert max(totals) <= 1.01 * min(totals)


def test_a_given_velocity_is_kept_within_the_limits():
    points = np.array([[0.0, 0.0], [2.0, 0.0], [4.0, 0.0]])
    derivatives = rest_at_ends(3, 2)
    derivatives[1, 0] = [1.0, 0.0]
    durations = minimum_time_durations(points, np.array([3.0, 3.0]), LIMITS, derivatives)
    path = MinimumSnap(points, durations, derivatives).path()
    assert peak_norm(path, 2) <= 0.7 * (1.0 + 1e-3)
    assert durations.sum() < 6.0 * 1.5
    # If no limit is active initially, the duration decreases until one is active.
    later = minimum_time_durations(points, np.array([12.0, 11.0]), LIMITS, derivatives)
    assert later.sum() == pytest.approx(durations.sum(), rel=0.01)


def test_the_times_of_a_path_without_motion_are_kept():
    points = np.zeros((4, 3))
    np.testing.assert_array_equal(minimum_snap_durations(points, np.array([1.0, 2.0, 3.0])), [1.0, 2.0, 3.0])
