"""Tests of polynomial paths: peaks, turning points, subdivision and scaling in time."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.polynomial_path import (
    NUM_CELLS,
    evaluate,
    evaluate_at,
    hermite_path,
    knots,
    peak_norm,
    subdivide,
    turning_points,
)


def random_path(seed, segments=6):
    rng = np.random.default_rng(seed)
    waypoints = np.cumsum(rng.normal(size=(segments + 1, 3)), axis=0)
    return minimum_snap(waypoints, np.cumsum(rng.uniform(0.4, 2.0, segments + 1)))


@pytest.mark.long
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


@given(st.integers(0, 2**32 - 1), st.integers(1, 8))
@example(479001600, 4)  # this path starts at rest and turns back in the first of the `NUM_CELLS` parts
@settings(max_examples=40, deadline=None)
def test_the_position_is_monotonic_between_turning_points(seed, segments):
    path = random_path(seed, segments)
    segment, axis, s = turning_points(path)
    dense = np.linspace(0.0, 1.0, 2001)
    cells = np.linspace(0.0, 1.0, NUM_CELLS + 1)
    for i in range(segments):
        values, slopes, thirds = (
            evaluate_at(path, np.full(len(each), i), each, order)
            for each, order in ((dense, 0), (cells, 1), (dense, 3))
        )
        for j in range(3):
            fractions = np.sort(s[(segment == i) & (axis == j)])
            extremes = evaluate_at(path, np.full(len(fractions) + 2, i), np.array([0.0, *fractions, 1.0]))[:, j]
            scale = np.abs(values[:, j]).max() + 1.0
            # This is the largest backward motion within a cell whose derivatives at both ends have the same sign.
            max_backward = np.abs(thirds[:, j]).max() * path.durations[i] ** 3 / NUM_CELLS**3 / 12.0
            for sign in (1.0, -1.0):
                cell = min(int(dense[np.argmax(sign * values[:, j])] * NUM_CELLS), NUM_CELLS - 1)
                turns = slopes[cell, j] * slopes[cell + 1, j] < 0.0
                tolerance = 1e-9 * scale if turns else max_backward
                assert (sign * extremes).max() >= (sign * values[:, j]).max() - tolerance


@given(st.integers(0, 2**32 - 1), st.lists(st.floats(-1.0, 20.0), min_size=1, max_size=12))
@settings(max_examples=40, deadline=None)
def test_subdividing_segments_does_not_change_the_path(seed, times):
    path = random_path(seed)
    finer = subdivide(path, np.array(sorted(set(times))))
    assert set(path.times) <= set(finer.times)
    samples = np.linspace(path.times[0], path.times[-1], 400)
    for order in range(5):
        expected = evaluate(path, samples, order)
        np.testing.assert_allclose(evaluate(finer, samples, order), expected, atol=1e-7 * np.abs(expected).max())


def test_subdividing_a_path_at_its_existing_knots_changes_nothing():
    path = random_path(3)
    finer = subdivide(path, path.times + 1e-14)
    np.testing.assert_array_equal(finer.times, path.times)
    np.testing.assert_array_equal(finer.coefficients, path.coefficients)


@given(st.integers(0, 2**32 - 1), st.integers(1, 8))
@settings(max_examples=40, deadline=None)
def test_the_knots_of_a_path_of_degree_7_determine_it(seed, segments):
    path = random_path(seed, segments)
    rebuilt = hermite_path(path.times, knots(path, 4))
    scale = np.abs(path.coefficients).max()
    np.testing.assert_allclose(rebuilt.coefficients, path.coefficients, rtol=0.0, atol=1e-11 * scale)


def test_a_path_scaled_in_time_passes_the_same_points_later():
    path = random_path(1)
    slower = path.scaled_in_time(2.0)
    assert slower.duration == pytest.approx(2.0 * path.duration)
    assert slower.times[0] == path.times[0] != 0.0
    np.testing.assert_allclose(slower.durations, 2.0 * path.durations)
    np.testing.assert_allclose(slower.waypoints, evaluate(path, path.times).T, atol=1e-12)
    later = slower.times[0] + 2.0 * 1.3
    np.testing.assert_allclose(evaluate(slower, [later]), evaluate(path, [path.times[0] + 1.3]), atol=1e-12)


def test_before_and_after_its_times_a_path_has_the_value_at_its_nearer_end():
    path = random_path(1)
    outside = evaluate(path, [path.times[0] - 1.0, path.times[-1] + 1.0])
    np.testing.assert_allclose(outside, evaluate(path, path.times[[0, -1]]))
    np.testing.assert_allclose(outside.T, path.waypoints[[0, -1]], atol=1e-12)


@pytest.mark.parametrize("factor", [1.0, 1e-4])
def test_a_path_can_be_subdivided_at_times_close_to_its_knots(factor):
    path = random_path(3).scaled_in_time(factor)
    time_near_knot = path.times[2] + 1e-6 * path.durations.min()
    finer = subdivide(path, np.array([path.times[0] - 1.0, time_near_knot, path.times[-1] + 1.0]))
    np.testing.assert_array_equal(finer.times, np.insert(path.times, 3, time_near_knot))
