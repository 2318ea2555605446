"""Tests of vectors, axes and quaternions by comparison with rotations of SciPy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_quad.geometry.axes import BodyAxes, Tilt, Vector, cross, dot, length, plus, times
from drake_quad.geometry.quaternion import NO_ROTATION, Quaternion
from drake_quad.signals import BodyRates

ATTITUDES = [(0.3, -0.4, 0.5), (-2.8, 1.2, 3.0), (1.7, -1.5, -2.2), (0.0, 0.0, 0.0)]  # roll, pitch, yaw (rad)
A, B = Vector(1.0, -2.0, 0.5), Vector(0.3, 0.7, -1.1)


def rotation(attitude):
    return Rotation.from_euler("ZYX", attitude[::-1])


def quaternion(turned):
    x, y, z, w = turned.as_quat()
    return Quaternion(w, x, y, z)


def test_vector_operations_agree_with_numpy():
    np.testing.assert_allclose(plus(A, B), np.add(A, B), rtol=1e-15)
    np.testing.assert_allclose(times(-3.0, A), np.multiply(-3.0, A), rtol=1e-15)
    np.testing.assert_allclose(dot(A, B), np.dot(A, B), rtol=1e-15)
    np.testing.assert_allclose(cross(A, B), np.cross(A, B), rtol=1e-15)


@pytest.mark.parametrize("scale", [1.0, 1e-9, 1e9])
def test_the_length_of_a_vector_of_any_size_is_exact(scale):
    assert length(Vector(2.0 * scale, -3.0 * scale, 6.0 * scale)) == pytest.approx(7.0 * scale, rel=1e-15)


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_axes_are_the_columns_of_the_rotation(attitude):
    axes, turned = BodyAxes.of(*attitude), rotation(attitude)
    np.testing.assert_allclose(np.array(axes).T, turned.as_matrix(), atol=1e-15)
    np.testing.assert_allclose(axes.in_world(A), turned.apply(A), atol=1e-15)
    np.testing.assert_allclose(axes.in_body(A), turned.inv().apply(A), atol=1e-15)
    np.testing.assert_allclose(axes.angles(), attitude, atol=1e-14)


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_the_heading_frame_differs_from_the_world_by_the_yaw(attitude):
    roll, pitch, _ = attitude
    np.testing.assert_allclose(Tilt.of(roll, pitch).in_heading(A), rotation((roll, pitch, 0.0)).apply(A), atol=1e-15)


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_a_quaternion_has_the_axes_of_its_attitude(attitude):
    q = Quaternion.of(*attitude)
    np.testing.assert_allclose(np.array(q.axes()), np.array(BodyAxes.of(*attitude)), atol=1e-15)
    np.testing.assert_allclose(np.outer(q, q), np.outer(*[quaternion(rotation(attitude))] * 2), atol=1e-15)


@pytest.mark.parametrize("attitude", ATTITUDES)
def test_the_derivative_of_a_quaternion_follows_from_the_body_rates(attitude):
    """The derivative is compared with a difference over 1 µs at body rates of about 1 rad/s."""
    rates, step = BodyRates(0.4, -0.7, 0.6), 1e-6
    turned = rotation(attitude)
    after, before = (quaternion(turned * Rotation.from_rotvec(side * step * np.array(rates))) for side in (0.5, -0.5))
    expected = (np.array(after) - np.array(before)) / step
    np.testing.assert_allclose(quaternion(turned).rates(rates), expected, atol=1e-9)
    np.testing.assert_array_equal(NO_ROTATION.rates(rates), Quaternion(*NO_ROTATION).rates(rates))


@pytest.mark.parametrize("first", ATTITUDES)
@pytest.mark.parametrize("second", ATTITUDES)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_rotation_to_another_attitude_is_the_shortest_one(first, second, sign):
    other = Quaternion(*(sign * part for part in Quaternion.of(*second)))
    expected = (rotation(first).inv() * rotation(second)).as_rotvec()
    np.testing.assert_allclose(Quaternion.of(*first).relative_rotation_vector(other), expected, atol=1e-13)


def test_rounding_errors_of_the_length_of_a_quaternion_are_removed():
    unit = quaternion(Rotation.from_rotvec([0.3, -0.8, 0.5]))
    np.testing.assert_allclose(Quaternion(*[1.0001 * each for each in unit]).normalised(), unit, atol=1e-7)
