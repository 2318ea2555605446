import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drake_quad.errors import InputError
from drake_quad.reference.minimum_snap import evaluate, minimum_snap
from drake_quad.reference.time_allocation import peak_norm, stretch_to_limits, trapezoid_times


def random_path(seed, segments=6):
    rng = np.random.default_rng(seed)
    waypoints = np.cumsum(rng.normal(size=(segments + 1, 3)), axis=0)
    return minimum_snap(waypoints, np.cumsum(rng.uniform(0.4, 2.0, segments + 1)))


@given(st.integers(0, 2**32 - 1), st.integers(1, 8), st.integers(0, 4))
@settings(max_examples=60, deadline=None)
def test_peak_norm_is_never_below_a_dense_sample_and_is_attained(seed, segments, order):
    path = random_path(seed, segments)
    times = np.linspace(path.times[0], path.times[-1], 40_001)
    sampled = np.linalg.norm(evaluate(path, times, order), axis=0).max()
    peak = peak_norm(path, order)
    assert peak >= sampled * (1.0 - 1e-12)
    assert peak == pytest.approx(sampled, rel=1e-5)


def test_peak_norm_agrees_with_the_roots_of_the_polynomial():
    for seed in range(20):
        path = random_path(seed)
        best = 0.0
        for coefficients, duration in zip(path.coefficients, path.durations, strict=True):
            velocity = [np.polynomial.Polynomial(axis).deriv() / duration for axis in coefficients.T]
            square = sum(v * v for v in velocity)
            roots = square.deriv().roots()
            inside = roots.real[(np.abs(roots.imag) < 1e-7) & (roots.real > 0.0) & (roots.real < 1.0)]
            best = max(best, *(square(s) for s in [0.0, 1.0, *inside]))
        assert peak_norm(path, 1) == pytest.approx(np.sqrt(best), rel=1e-11)


@given(st.integers(0, 2**32 - 1), st.floats(0.1, 10.0), st.floats(0.1, 10.0))
@settings(max_examples=40, deadline=None)
def test_a_stretched_path_attains_one_limit_and_keeps_the_other(seed, top_speed, top_acceleration):
    path = stretch_to_limits(random_path(seed), top_speed=top_speed, top_acceleration=top_acceleration)
    shares = peak_norm(path, 1) / top_speed, peak_norm(path, 2) / top_acceleration
    assert max(shares) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize(("limits", "name"), [((0.0, 1.0), "speed"), ((1.0, -1.0), "acceleration")])
def test_limits_must_be_positive(limits, name):
    with pytest.raises(InputError, match=f"top {name}"):
        stretch_to_limits(random_path(0), top_speed=limits[0], top_acceleration=limits[1])


def test_trapezoid_of_a_long_ride():
    """1 m/s and 0.5 m/s²: 2 s and 1 m to speed up, as much to slow down."""
    waypoints = np.array([[0.0], [0.25], [1.0], [5.0], [9.0], [10.0]])
    times = trapezoid_times(waypoints, speed=1.0, acceleration=0.5)
    np.testing.assert_allclose(times, [0.0, 1.0, 2.0, 6.0, 10.0, 12.0])


def test_trapezoid_of_a_short_ride_is_a_triangle():
    times = trapezoid_times(np.array([[0.0], [0.5], [1.0]]), speed=10.0, acceleration=1.0)
    np.testing.assert_allclose(times, [0.0, 1.0, 2.0])
