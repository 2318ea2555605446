"""Tests of the conditions on moments of inertia, and of the nearest moments that satisfy these conditions."""

import numpy as np
import pytest
import scipy

from drake_quad.vehicle.rigid_body import explain_invalid_inertia, nearest_rigid_inertia


@pytest.fixture(scope="module")
def moments_of_bodies():
    """Return (500, 3) moments of inertia of random bodies about their axes. Some bodies are flat and some are rods."""
    rng = np.random.default_rng(0)
    positions = rng.normal(size=(500, 20, 3)) * rng.choice([0.0, 0.1, 1.0], size=(500, 1, 3))
    squares = (positions - positions.mean(axis=1, keepdims=True)) ** 2
    return (squares.sum(axis=(1, 2))[:, None] - squares.sum(axis=1)) * 0.05


def test_moments_of_inertia_of_any_rigid_body_are_accepted(moments_of_bodies):
    assert all(explain_invalid_inertia(moments) == "" for moments in moments_of_bodies.tolist())
    # The moments of flat bodies and rods satisfy the conditions up to rounding errors.
    np.testing.assert_allclose(nearest_rigid_inertia(moments_of_bodies.T).T, moments_of_bodies, atol=1e-14)


def test_moments_may_violate_the_conditions_by_no_more_than_the_rounding_of_data_sheets():
    assert explain_invalid_inertia([0.0061, 0.0061, 0.0123]) == ""
    assert explain_invalid_inertia([0.007, 0.007, 0.03]) == "I_zz, 0.03, is larger than I_xx + I_yy, 0.014 kg m²"
    assert explain_invalid_inertia([1.0, 3.0, 1.5]) == "I_yy, 3, is larger than I_xx + I_zz, 2.5 kg m²"
    assert explain_invalid_inertia([3.0, 1.0, 1.5]) == "I_xx, 3, is larger than I_yy + I_zz, 2.5 kg m²"
    assert explain_invalid_inertia([0.0, 0.0, 0.0]) == ""


@pytest.mark.slow
def test_the_nearest_moments_are_the_solution_of_a_quadratic_programme():
    """Some samples have bounds that contain no possible moments of inertia."""
    rng = np.random.default_rng(1)
    triangle_inequalities = np.array([[1.0, 1.0, -1.0], [1.0, -1.0, 1.0], [-1.0, 1.0, 1.0]])
    for _ in range(100):
        moments = rng.lognormal(sigma=1.5, size=3)
        low = moments * rng.choice([1.0, 0.7, 0.0], size=3)
        high = moments * rng.choice([1.0, 1.5, 100.0], size=3)
        nearest = nearest_rigid_inertia(moments, low, high)
        assert ((nearest >= low) & (nearest <= high)).all()
        if (triangle_inequalities @ moments >= 0.0).all():
            np.testing.assert_array_equal(nearest, moments)
            continue
        largest = np.arange(3) == np.argmax(moments)
        # No body has moments within these bounds.
        if low[largest].sum() > high[~largest].sum():
            assert (triangle_inequalities @ nearest).min() < 0.0
            continue
        expected = scipy.optimize.minimize(
            lambda x, m=moments: ((x - m) ** 2).sum(),
            0.5 * (low + np.minimum(high, moments.max())),
            jac=lambda x, m=moments: 2.0 * (x - m),
            bounds=list(zip(low, high, strict=True)),
            constraints={
                "type": "ineq",
                "fun": lambda x: triangle_inequalities @ x,
                "jac": lambda x: triangle_inequalities,
            },
            method="SLSQP",
            options={"ftol": 1e-14, "maxiter": 500},
        ).x
        np.testing.assert_allclose(nearest, expected, atol=1e-5 * moments.max())


def test_moments_of_many_samples_agree_with_single_samples():
    rng = np.random.default_rng(2)
    moments = rng.lognormal(size=(3, 50))
    low = np.zeros(3)
    high = np.array([2.0, 3.0, np.inf])
    nearest = nearest_rigid_inertia(moments, low, high)
    for i in range(50):
        np.testing.assert_array_equal(nearest[:, i], nearest_rigid_inertia(moments[:, i], low, high))


def test_each_sample_can_have_its_own_bounds():
    moments = np.array([[1.0, 1.0], [1.0, 1.0], [3.0, 3.0]])
    high = np.array([[1.1, 2.0], [1.1, 2.0], [3.0, 3.0]])
    nearest = nearest_rigid_inertia(moments, np.zeros((3, 2)), high)
    assert nearest[:, 0] == pytest.approx([1.1, 1.1, 2.2])
    assert nearest[:, 1] == pytest.approx([4.0 / 3.0, 4.0 / 3.0, 8.0 / 3.0])
