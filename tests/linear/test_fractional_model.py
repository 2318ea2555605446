import itertools

import numpy as np
import pytest

from drake_quad.linear.fractional_model import fit_fractional_model, fitting_points, spectral_radii


@pytest.fixture(scope="module")
def matrices():
    generator = np.random.default_rng(0)
    A = np.diag([0.9, 0.7, 0.5, 0.3]) + 0.1 * generator.standard_normal((4, 4))
    b, c, d, e = generator.standard_normal((4, 4)) * 0.6
    return A, np.outer(b, c), np.outer(d, e), np.outer(b, e)


def exact_matrices(matrices, points):
    A, first, second, cross_term = matrices
    x, y = points.T[:, :, np.newaxis, np.newaxis]
    return A + x * first + (y + 0.2 * y**2) * second + x * y * cross_term


def test_a_model_reproduces_loops_that_are_polynomials_of_second_degree(matrices):
    points = fitting_points(2, np.random.default_rng(1))
    model = fit_fractional_model(points, exact_matrices(matrices, points))
    test_points = np.random.default_rng(2).uniform(-1.0, 1.0, (20, 2))
    assert model.loops(test_points) == pytest.approx(exact_matrices(matrices, test_points), abs=0.06)
    assert model.sizes[0] == 1


def test_a_model_is_fitted_at_the_centre_on_the_axes_and_at_the_corners_of_the_box():
    points = fitting_points(3, np.random.default_rng(1))
    assert not points[0].any()
    assert np.abs(points).max() == 1.0
    for corner in itertools.product((-1.0, 1.0), repeat=3):
        assert (points == corner).all(axis=1).any()
    for vertex in np.vstack([np.eye(3), -np.eye(3)]):
        assert (points == vertex).all(axis=1).any()


def test_no_loop_within_the_bound_is_unstable_and_one_just_beyond_it_is(matrices):
    points = fitting_points(2, np.random.default_rng(1))
    model = fit_fractional_model(points, exact_matrices(matrices, points))
    scale = 1.0 / model.bound(tolerance=1e-3).value
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-1.0, 1.0, 41)]), axis=-1).reshape(-1, 2)
    assert spectral_radii(exact_matrices(matrices, 0.99 * scale * grid)).max() < 1.0
    assert spectral_radii(exact_matrices(matrices, 1.15 * scale * grid)).max() > 1.0


def test_the_exact_loops_are_the_model_plus_u_e_v_with_a_norm_of_e_of_at_most_one():
    points = fitting_points(1, np.random.default_rng(1))
    cubic = points[:, :, np.newaxis] ** 3 * np.array([[0.0, 0.3], [0.1, 0.2]])
    loops = 0.5 * np.eye(2) + 0.1 * points[:, :, np.newaxis] * np.ones((2, 2)) + cubic
    model = fit_fractional_model(points, loops)
    errors = loops - model.loops(points)
    assert np.abs(errors).max() > 0.02
    inner = np.linalg.pinv(model.U) @ errors @ np.linalg.pinv(model.V)
    assert model.U @ inner @ model.V == pytest.approx(errors, abs=1e-3)
    assert 0.6 < np.linalg.norm(inner, 2, axis=(1, 2)).max() <= 1.0


def test_a_model_that_fits_badly_has_a_large_bound():
    # The loop is stable up to a parameter of 0.9. There A changes by a step, which a quadratic model cannot follow.
    points = fitting_points(1, np.random.default_rng(1))
    loops = (0.5 + 0.8 * (points > 0.9))[:, :, np.newaxis]
    assert fit_fractional_model(points, loops).bound().value > 1.0 / 0.9


def test_loops_without_an_equilibrium_have_no_spectral_radius():
    assert spectral_radii(np.array([[[0.5]], [[np.nan]]])) == pytest.approx([0.5, np.nan], nan_ok=True)
