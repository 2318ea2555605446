"""Tests of heuristic times, by comparison with trapezoidal and triangular profiles of the speed."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.path_problem import PathLimits
from drake_quad.reference.polynomial_path import peak_norm
from drake_quad.reference.time_allocation import rest_to_rest_durations, stretch_factor, trapezoid_times


def random_path(seed, segments=6):
    rng = np.random.default_rng(seed)
    waypoints = np.cumsum(rng.normal(size=(segments + 1, 3)), axis=0)
    return minimum_snap(waypoints, np.cumsum(rng.uniform(0.4, 2.0, segments + 1)))


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10.0), st.floats(0.1, 10.0))
@settings(max_examples=40, deadline=None)
def test_a_path_scaled_by_the_stretch_factor_attains_one_limit(seed, top_speed, top_acceleration):
    path = random_path(seed)
    path = path.scaled_in_time(stretch_factor(path, PathLimits(top_speed, top_acceleration)))
    fractions = peak_norm(path, 1) / top_speed, peak_norm(path, 2) / top_acceleration
    assert max(fractions) == pytest.approx(1.0, abs=1e-12)


@given(st.floats(0.01, 100.0), st.floats(0.1, 10.0) | st.just(math.inf), st.floats(0.1, 10.0) | st.just(math.inf))
def test_a_flight_with_stops_attains_the_limits(distance, speed, acceleration):
    if math.isinf(speed) and math.isinf(acceleration):
        return
    limits = PathLimits(speed, acceleration)
    points = np.array([[0.0], [distance]])
    path = minimum_snap(points, [0.0, *rest_to_rest_durations(points, limits)])
    fractions = peak_norm(path, 1) / speed, peak_norm(path, 2) / acceleration
    assert max(fractions) == pytest.approx(1.0, abs=1e-12)


def test_a_long_route_has_a_trapezoidal_profile():
    """At 1 m/s and 0.5 m/s², accelerating takes 2 s and 1 m, and so does braking."""
    waypoints = np.array([[0.0], [0.25], [0.81], [1.0], [5.0], [9.0], [9.19], [10.0]])
    times = trapezoid_times(waypoints, speed=1.0, acceleration=0.5)
    np.testing.assert_allclose(times, [0.0, 1.0, 1.8, 2.0, 6.0, 10.0, 10.2, 12.0])


def test_a_short_route_has_a_triangular_profile():
    times = trapezoid_times(np.array([[0.0], [0.5], [1.0]]), speed=10.0, acceleration=1.0)
    np.testing.assert_allclose(times, [0.0, 1.0, 2.0])
