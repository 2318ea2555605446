"""Tests of least distance programming, by nonnegative least squares (Lawson and Hanson, 1974, algorithm LDP)."""

import numpy as np
import pytest
import scipy

from drake_quad.control.mpc.least_distance import LeastDistance


def by_nonnegative_least_squares(rows, bounds):
    """Return the vector v of smallest norm that satisfies G v <= h.

    The solution is -r / r_n, where r is the residual of the nonnegative least-squares problem E u = f with
    E = [-Gᵀ; -hᵀ] and f = e_n.
    """
    E = np.vstack([-rows.T, -bounds])
    f = np.append(np.zeros(rows.shape[1]), 1.0)
    u, _ = scipy.optimize.nnls(E, f)
    r = E @ u - f
    return -r[:-1] / r[-1]


@pytest.mark.parametrize("seed", range(12))
def test_the_nearest_point_matches_another_algorithm(seed):
    """The polyhedra do not contain the origin. One `LeastDistance` solves the problem for all bounds."""
    rng = np.random.default_rng(seed)
    rows, inside = rng.normal(size=(40, 6)), rng.normal(size=6)
    programme = LeastDistance(rows, group=4)
    for _ in range(3):
        bounds = rows @ inside + rng.uniform(0.0, 1.5, 40)
        point, binding = programme.solve(bounds)
        assert 0 < binding.sum() <= 6
        np.testing.assert_allclose(point, by_nonnegative_least_squares(rows, bounds), atol=1e-9)
        np.testing.assert_allclose(rows[binding] @ point, bounds[binding], atol=1e-9)


def test_the_origin_is_the_nearest_point_of_a_polyhedron_that_contains_it():
    point, binding = LeastDistance(np.eye(3), group=3).solve(np.array([0.0, 1.0, np.inf]))
    np.testing.assert_array_equal(point, np.zeros(3))
    assert not binding.any()


def test_violated_constraints_are_added_after_the_first_solution():
    """The nearest point on the first wall lies beyond the second wall."""
    rows = np.array([[-1.0, 0.0], [1.0, -1.0]])
    point, binding = LeastDistance(rows, group=1).solve(np.array([-1.0, 0.5]))
    np.testing.assert_allclose(point, [1.0, 0.5], atol=1e-12)
    assert binding.all()


@pytest.mark.parametrize("size", [1e-7, 1e-3, 1e6])
def test_the_nearest_point_is_found_for_violations_of_any_size(size):
    rng = np.random.default_rng(2)
    rows, inside = rng.normal(size=(12, 5)), rng.normal(size=5)
    bounds = rows @ inside + rng.uniform(0.0, 0.5, 12)
    programme = LeastDistance(rows, group=3)
    expected = by_nonnegative_least_squares(rows, bounds)
    np.testing.assert_allclose(programme.solve(size * bounds).point / size, expected, atol=1e-9)


def test_an_empty_polyhedron_has_no_nearest_point():
    assert LeastDistance(np.array([[1.0], [-1.0]]), group=1).solve(np.array([-1.0, -1.0])) is None
