import numpy as np
import pytest

from drake_quad.linear.fractional_model import fit_fractional_model, fitting_points, spectral_radii


@pytest.fixture(scope="module")
def matrices():
    generator = np.random.default_rng(0)
    A = np.diag([0.9, 0.7, 0.5, 0.3]) + 0.1 * generator.standard_normal((4, 4))
    b, c, d, e = generator.standard_normal((4, 4)) * 0.6
    return A, np.outer(b, c), np.outer(d, e), np.outer(b, e)


def exact(matrices, points):
    A, first, second, both = matrices
    x, y = points.T[:, :, np.newaxis, np.newaxis]
    return A + x * first + (y + 0.2 * y**2) * second + x * y * both


def test_polynomials_of_second_degree_are_reproduced(matrices):
    points = fitting_points(2, np.random.default_rng(1))
    model = fit_fractional_model(points, exact(matrices, points))
    others = np.random.default_rng(2).uniform(-1.0, 1.0, (20, 2))
    assert model.loops(others) == pytest.approx(exact(matrices, others), abs=0.06)
    assert model.sizes[0] == 1


def test_no_loop_within_the_bound_is_unstable_and_one_just_beyond_it_is(matrices):
    points = fitting_points(2, np.random.default_rng(1))
    model = fit_fractional_model(points, exact(matrices, points))
    scale = 1.0 / model.bound(tolerance=1e-3).value
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-1.0, 1.0, 41)]), axis=-1).reshape(-1, 2)
    assert spectral_radii(exact(matrices, 0.99 * scale * grid)).max() < 1.0
    assert spectral_radii(exact(matrices, 1.1 * scale * grid)).max() > 1.0


def test_the_error_of_the_scale_is_that_of_a_shifted_loop():
    points = fitting_points(1, np.random.default_rng(1))
    loops = (0.5 + 0.6 * points)[:, :, np.newaxis]
    model = fit_fractional_model(points, loops)
    assert model.scale_error(points, loops) < 1e-6
    assert model.scale_error(points, loops + 0.06 * (points > 0.999)[:, :, np.newaxis]) == pytest.approx(0.1, rel=0.02)
    assert model.scale_error(points, loops + 5.0) == np.inf


def test_loops_without_an_equilibrium_count_as_unstable():
    assert spectral_radii(np.array([[[0.5]], [[np.nan]]])).tolist() == [0.5, np.inf]
