"""Tests of yaw profiles with minimum acceleration, by comparison with closed forms and quadrature."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_quad.errors import InputError
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.reference.yaw import constant_yaw, yaw_along_path, yaw_through


def acceleration_cost(profile):
    """Return the integral of the squared yaw acceleration, by a quadrature that is exact for cubic profiles."""
    times = np.concatenate([np.linspace(a, b, 3) for a, b in zip(profile.times[:-1], profile.times[1:], strict=True)])
    values = evaluate(profile, np.clip(times, None, profile.times[-1]), 2)[0].reshape(-1, 3)
    # The acceleration is continuous at inner knots, so the values on both sides are equal.
    return float(np.sum(profile.durations * (values**2 @ [1.0, 4.0, 1.0]) / 6.0))


def rates_at_ends(profile):
    return evaluate(profile, profile.times[[0, -1]], 1)[0]


def test_a_constant_yaw_has_the_given_value_and_times():
    profile = constant_yaw(1.0, 4.0, 0.3)
    np.testing.assert_array_equal(evaluate(profile, [1.0, 2.0, 4.0])[0], 0.3)
    np.testing.assert_array_equal(evaluate(profile, [1.0, 2.0, 4.0], 1)[0], 0.0)


def test_a_rotation_between_two_yaws_is_a_cubic_with_the_known_cost():
    """From rest to rest, 3s² - 2s³ has the smallest integral of the squared acceleration, 12 Δψ² / T³."""
    profile = yaw_through([0.0, 2.0], [0.0, 1.0])
    s = np.linspace(0.0, 1.0, 9)
    np.testing.assert_allclose(evaluate(profile, 2.0 * s)[0], 3.0 * s**2 - 2.0 * s**3, atol=1e-14)
    assert acceleration_cost(profile) == pytest.approx(12.0 / 8.0)


@given(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=8), st.integers(0, 2**32 - 1))
@settings(max_examples=40, deadline=None)
def test_the_profile_takes_the_shorter_rotation_with_minimum_acceleration(yaws, seed):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(0.5, 2.0, len(yaws)))
    profile = yaw_through(times, yaws)
    actual = evaluate(profile, times)[0]
    np.testing.assert_allclose(np.cos(actual - yaws), 1.0, atol=1e-12)
    assert np.abs(np.diff(actual)).max() <= math.pi + 1e-9
    np.testing.assert_allclose(rates_at_ends(profile), 0.0, atol=1e-12)
    finer = np.sort(np.concatenate([times, 0.5 * (times[1:] + times[:-1])]))
    detour = evaluate(profile, finer)[0]
    detour[1::2] += 0.01 * rng.normal(size=len(times) - 1)
    assert acceleration_cost(yaw_through(finer, detour)) >= acceleration_cost(profile) * (1.0 - 1e-9)


def test_the_yaw_is_constant_before_the_first_and_after_the_last_given_yaw():
    profile = yaw_through([0.0, 1.0, 2.0, 3.0, 4.0], [math.nan, 0.5, math.nan, 1.5, math.nan])
    np.testing.assert_allclose(evaluate(profile, [0.0, 0.7, 1.0, 3.0, 3.5, 4.0])[0], [0.5] * 3 + [1.5] * 3)
    assert evaluate(profile, [2.0])[0, 0] == pytest.approx(1.0)


def test_a_single_given_yaw_is_kept_throughout():
    for yaws in ([0.4, math.nan, math.nan], [math.nan, 0.4, math.nan], [math.nan, math.nan, 0.4]):
        profile = yaw_through([1.0, 2.0, 4.0], yaws)
        np.testing.assert_array_equal(profile.times[[0, -1]], [1.0, 4.0])
        np.testing.assert_array_equal(evaluate(profile, np.linspace(1.0, 4.0, 7))[0], 0.4)


def test_invalid_yaws_are_rejected_with_the_reason():
    with pytest.raises(InputError, match="no waypoint has a yaw"):
        yaw_through([0.0, 1.0], [math.nan, math.nan])
    with pytest.raises(InputError, match="waypoints 1 and 2 are passed at the same time, but have different yaws"):
        yaw_through([0.0, 1.0, 1.0], [0.0, 1.0, 2.0])
    with pytest.raises(InputError, match="all waypoint times are equal"):
        yaw_through([1.0, 1.0], [0.0, 0.0])
    np.testing.assert_allclose(yaw_through([0.0, 1.0, 1.0], [0.0, 1.0, 1.0 + math.tau]).times, [0.0, 1.0])


def test_the_yaw_along_a_circle_continues_beyond_one_turn():
    angle = np.linspace(0.0, 3.0 * math.tau, 37)
    waypoints = np.column_stack([np.cos(angle), np.sin(angle), np.ones_like(angle)])
    path = minimum_snap(waypoints, np.linspace(0.0, 40.0, 37))
    profile = yaw_along_path(path)
    times = np.linspace(12.0, 28.0, 300)
    v_x, v_y, _ = evaluate(path, times, 1)
    direction = np.unwrap(np.arctan2(v_y, v_x))
    yaw = evaluate(profile, times)[0]
    np.testing.assert_allclose(yaw - direction, np.round((yaw - direction)[0] / math.tau) * math.tau, atol=2e-3)
    first, last = evaluate(profile, profile.times[[0, -1]])[0]
    assert last - first > 2.9 * math.tau
    np.testing.assert_allclose(rates_at_ends(profile), 0.0, atol=1e-12)


@pytest.mark.parametrize(("middle", "half"), [(2.0, 0.5), (5.0, 0.8), (8.0, 0.6), (4.0, 2.0), (6.5, 0.4)])
def test_the_yaw_along_a_path_minimises_its_cost(middle, half):
    """The derivative of ∫ ψ̈² + (ψ - direction)² (v / v_max)² / response⁴ dt with respect to a detour is zero."""
    response = 0.5
    path = minimum_snap(
        [[0.0, 0.0, 1.0], [2.0, 0.5, 1.3], [2.5, 2.5, 1.0], [0.5, 3.0, 0.7], [0.0, 1.0, 1.0]],
        [0.0, 2.0, 5.0, 7.0, 10.0],
    )
    profile = yaw_along_path(path, response=response)
    times = np.linspace(middle - half, middle + half, 20001)
    yaw, acceleration = evaluate(profile, times)[0], evaluate(profile, times, 2)[0]
    v_x, v_y, _ = evaluate(path, times, 1)
    top = np.hypot(*evaluate(path, np.linspace(0.0, 10.0, 20001), 1)[:2]).max()
    yaw_error = np.angle(np.exp(1j * (yaw - np.arctan2(v_y, v_x))))
    x = (times - middle) / half
    detour = (1.0 - x**2) ** 3
    bend = 6.0 * (1.0 - x**2) * (5.0 * x**2 - 1.0) / half**2
    costs = np.array([acceleration * bend, yaw_error * (np.hypot(v_x, v_y) / top) ** 2 / response**4 * detour])
    assert abs(costs.sum()) < 5e-3 * np.abs(costs).sum()


def test_the_yaw_is_smooth_at_a_stop_where_the_path_turns_back():
    path = minimum_snap([[0.0, 0.0, 1.0], [3.0, 0.2, 1.0], [0.0, 0.0, 1.0]], [0.0, 5.0, 10.0])
    profile = yaw_along_path(path)
    times = np.linspace(0.0, 10.0, 2001)
    yaw, rate = evaluate(profile, times)[0], evaluate(profile, times, 1)[0]
    assert abs(yaw[-1] - yaw[0]) == pytest.approx(math.pi, abs=0.3)
    assert np.abs(np.diff(yaw)).max() < 0.03
    assert np.abs(rate).max() < 4.0
    # The acceleration is finite, and continuous except at the ends.
    assert np.abs(np.diff(evaluate(profile, times, 2)[0])).max() < 1.0


def test_the_yaw_along_a_vertical_path_is_constant():
    path = minimum_snap([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]], [0.0, 4.0])
    np.testing.assert_array_equal(evaluate(yaw_along_path(path), [0.0, 1.0, 4.0])[0], 0.0)


def test_the_sideways_drift_of_a_climb_is_ignored():
    path = minimum_snap([[0.0, 0.0, 0.0], [1e-4, -2e-4, 2.0], [2e-4, 1e-4, 4.0]], [0.0, 4.0, 8.0])
    profile = yaw_along_path(path)
    assert np.abs(evaluate(profile, np.linspace(0.0, 8.0, 200))).max() == 0.0
    np.testing.assert_array_equal(profile.times[[0, -1]], [0.0, 8.0])


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_scaling_a_path_does_not_change_the_yaw_along_it(scale):
    waypoints, times = np.array([[0.0, 0.0, 0.0], [0.1, 0.3, 2.0], [0.5, 0.4, 1.0]]), [1.0, 3.0, 6.0]
    expected, actual = (yaw_along_path(minimum_snap(size * waypoints, times)) for size in (1.0, scale))
    np.testing.assert_allclose(actual.times, expected.times)
    np.testing.assert_allclose(actual.coefficients, expected.coefficients, atol=1e-9)
    assert np.ptp(evaluate(expected, expected.times)[0]) > 0.3


def test_the_yaw_hardly_follows_a_horizontal_motion_that_is_slow_compared_with_a_climb():
    """The direction has weight 1 if the horizontal speed is a tenth of the top speed, and 1/4 at half that speed."""
    costs = {}
    for fraction in (0.1, 0.05):
        waypoints = [[0.0, 0.0, 0.0], [10.0 * fraction, 0.0, 5.0], [10.0 * fraction, 10.0 * fraction, 10.0]]
        profile = yaw_along_path(minimum_snap(waypoints, [0.0, 5.0, 10.0]), response=2.0)
        costs[fraction] = acceleration_cost(profile)
    assert costs[0.05] < 0.9 * costs[0.1]


def test_the_yaw_at_the_end_of_a_climb_points_in_the_next_direction_of_flight():
    waypoints = [[0.0, 0.0, 0.0], [0.0, 0.0, 2.0], [0.0, 3.0, 2.0]]
    derivatives = np.full((3, 3, 3), np.nan)
    derivatives[:] = 0.0
    profile = yaw_along_path(minimum_snap(waypoints, [0.0, 4.0, 9.0], derivatives))
    np.testing.assert_allclose(evaluate(profile, [0.0, 2.0, 4.0, 6.0, 9.0])[0], math.pi / 2.0, atol=1e-6)
