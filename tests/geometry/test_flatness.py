"""Tests of the attitude that follows from a path, by comparison with Drake's rotations and finite differences."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RollPitchYaw

from drake_quad.geometry.flatness import (
    HeadingVector,
    angular_accelerations,
    attitude_from_tilt,
    body_rates,
    in_heading,
    tilt_from_thrust,
)
from drake_quad.signals import Acceleration

vectors = st.tuples(*[st.floats(-4.0, 4.0)] * 3).map(np.array)
rates = st.floats(-1.0, 1.0)
angles = st.floats(-math.pi, math.pi)
G = np.array([0.0, 0.0, 9.81])  # m/s², upwards


def turned(vector, yaw):
    return in_heading(Acceleration(*vector), math.sin(yaw), math.cos(yaw))


def tilt_at(thrust, yaw):
    return tilt_from_thrust(turned(thrust, yaw))


@given(vectors, angles, st.sampled_from([1.0, -1.0]))
def test_the_thrust_points_along_the_z_axis_of_the_body(acceleration, yaw, up):
    """The equation is f = F z_B with Drake's rotation matrix, at any yaw, even upside down."""
    thrust = up * (acceleration + G)
    tilt = tilt_at(thrust, yaw)
    z_B = RollPitchYaw(*attitude_from_tilt(tilt), yaw).ToRotationMatrix().matrix()[:, 2]
    np.testing.assert_allclose(tilt.thrust * z_B, thrust, atol=1e-12)


def test_the_attitude_at_zero_yaw_agrees_with_eq_7():
    u_x, u_y, u_z = 1.2, -0.7, 0.5
    mass = 0.68
    tilt = tilt_from_thrust(HeadingVector(u_x, u_y, u_z + 9.81))
    roll, pitch = attitude_from_tilt(tilt)
    assert mass * tilt.thrust == pytest.approx(mass * math.sqrt((u_z + 9.81) ** 2 + u_x**2 + u_y**2))
    assert pitch == pytest.approx(math.atan(u_x / (u_z + 9.81)))
    assert roll == pytest.approx(math.asin(-u_y / tilt.thrust))


@given(vectors, vectors, vectors, angles, rates, rates)
def test_body_rates_and_angular_accelerations_are_derivatives_of_the_attitude(
    acceleration, jerk, snap, yaw, yaw_rate, yaw_acceleration
):
    def motion(time):
        """Return attitude, body rates and angular accelerations on the path at a time."""
        thrust = acceleration + G + jerk * time + 0.5 * snap * time**2
        heading = yaw + yaw_rate * time + 0.5 * yaw_acceleration * time**2
        turning = yaw_rate + yaw_acceleration * time
        tilt = tilt_at(thrust, heading)
        resolved = [turned(vector, heading) for vector in (jerk + snap * time, snap)]
        p_q_r = body_rates(tilt, resolved[0], turning)
        return (
            np.array([*attitude_from_tilt(tilt), heading]),
            np.array(p_q_r),
            angular_accelerations(tilt, p_q_r, *resolved, turning, yaw_acceleration),
        )

    step = 1e-4
    (before, rates_before, _), (now, p_q_r, accelerations), (after, rates_after, _) = map(motion, (-step, 0.0, step))
    numeric = (after - before) / (2.0 * step)
    expected = RollPitchYaw(now).CalcAngularVelocityInChildFromRpyDt(numeric)
    np.testing.assert_allclose(p_q_r, expected, atol=1e-6)
    np.testing.assert_allclose(accelerations, (rates_after - rates_before) / (2.0 * step), atol=1e-6)
