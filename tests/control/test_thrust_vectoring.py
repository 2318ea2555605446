import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.math import RollPitchYaw

from drake_quad.control.thrust_vectoring import (
    ThrustLimits,
    ThrustVectoring,
    body_rates,
    in_heading,
    specific_thrust,
    thrust_and_tilt,
    tilt_rates,
)

G, MASS = 9.81, 0.68
LIMITS = ThrustLimits(math.tan(0.6), 0.3 * MASS * G, 1.8 * MASS * G)
accelerations = st.tuples(*[st.floats(-30.0, 30.0)] * 3)
angles = st.floats(-math.pi, math.pi)


def limited(acceleration, yaw):
    forward_left_up = in_heading(acceleration, math.sin(yaw), math.cos(yaw))
    return specific_thrust(forward_left_up, mass=MASS, gravity=G, limits=LIMITS)


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3), angles)
def test_thrust_along_the_commanded_body_axis_gives_the_commanded_acceleration(acceleration, yaw):
    """At any yaw: R_WB (0, 0, F_z) / m - (0, 0, g) = u, with Drake's rotation matrix."""
    thrust, roll, pitch = thrust_and_tilt(*limited(acceleration, yaw))
    z_B = RollPitchYaw(roll, pitch, yaw).ToRotationMatrix().matrix()[:, 2]
    np.testing.assert_allclose(thrust * z_B - [0.0, 0.0, G], acceleration, atol=1e-12)


def test_is_eq_7_at_zero_yaw():
    u_x, u_y, u_z = 1.2, -0.7, 0.5
    thrust, roll, pitch = thrust_and_tilt(*limited((u_x, u_y, u_z), 0.0))
    assert MASS * thrust == pytest.approx(MASS * math.sqrt((u_z + G) ** 2 + u_x**2 + u_y**2))
    assert pitch == pytest.approx(math.atan(u_x / (u_z + G)))
    assert roll == pytest.approx(math.asin(-MASS * u_y / (MASS * thrust)))


@given(accelerations, angles)
def test_the_limits_hold_whatever_is_commanded(acceleration, yaw):
    forward, left, up = limited(acceleration, yaw)
    thrust = math.sqrt(forward**2 + left**2 + up**2)
    assert MASS * up >= LIMITS.min_thrust * (1.0 - 1e-12)
    assert MASS * thrust <= LIMITS.max_thrust * (1.0 + 1e-12)
    assert math.hypot(forward, left) <= LIMITS.slope * up * (1.0 + 1e-12)
    # What is left of the horizontal command points where it was to point.
    wanted_forward, wanted_left, _ = in_heading(acceleration, math.sin(yaw), math.cos(yaw))
    assert forward * wanted_left == pytest.approx(left * wanted_forward, abs=1e-9)


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3), st.tuples(*[st.floats(-5.0, 5.0)] * 3), angles, st.floats(-1.0, 1.0))
def test_tilt_rates_are_the_derivative_of_the_tilt(acceleration, jerk, yaw, yaw_rate):
    def tilt(time):
        moved = [a + j * time for a, j in zip(acceleration, jerk, strict=True)]
        return np.array(thrust_and_tilt(*limited(moved, yaw + yaw_rate * time))[1:])

    step = 1e-5
    numeric = (tilt(step) - tilt(-step)) / (2.0 * step)
    force = limited(acceleration, yaw)
    rates = tilt_rates(force, in_heading(jerk, math.sin(yaw), math.cos(yaw)), yaw_rate)
    np.testing.assert_allclose(rates, numeric, atol=1e-7)


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3), st.tuples(*[st.floats(-2.0, 2.0)] * 3))
def test_body_rates_are_those_of_the_turning_frame(acceleration, rates):
    """Against Drake's kinematics of roll, pitch and yaw."""
    force = limited(acceleration, 0.0)
    _, roll, pitch = thrust_and_tilt(*force)
    expected = RollPitchYaw(roll, pitch, 0.7).CalcAngularVelocityInChildFromRpyDt(rates)
    np.testing.assert_allclose(body_rates(force, *rates), expected, atol=1e-12)


def test_follows_the_reference_s_yaw_and_its_jerk_only_if_that_is_connected():
    law = ThrustVectoring(mass=MASS, gravity=G, limits=LIMITS)
    context = law.CreateDefaultContext()
    law.GetInputPort("acceleration_command").FixValue(context, [0.0, 0.0, 1.0])
    law.GetInputPort("measurement").FixValue(context, [0.0] * 12)
    law.GetInputPort("reference").FixValue(context, [0.0] * 9 + [0.4, 0.1])
    expected = [MASS * (G + 1.0), 0.0, 0.0, 0.4]
    np.testing.assert_allclose(law.get_output_port().Eval(context), [*expected, 0.0, 0.0, 0.1])
    law.GetInputPort("reference_jerk").FixValue(context, [1.0, 2.0, 0.0])
    rates = [-2.0 / (G + 1.0), 1.0 / (G + 1.0), 0.1]
    np.testing.assert_allclose(law.get_output_port().Eval(context), [*expected, *rates])


def test_fleet_and_single_vehicle_agree():
    rng = np.random.default_rng(0)
    n, sizes = 20, {"acceleration_command": 3, "measurement": 12, "reference": 11, "reference_jerk": 3}
    values = {name: 4.0 * rng.normal(size=(size, n)) for name, size in sizes.items()}

    def output(num_vehicles, columns):
        law = ThrustVectoring(num_vehicles=num_vehicles, mass=MASS, gravity=G, limits=LIMITS)
        context = law.CreateDefaultContext()
        for name, rows in values.items():
            law.GetInputPort(name).FixValue(context, rows[:, columns].ravel())
        return law.get_output_port().Eval(context).reshape(7, num_vehicles)

    fleet = output(n, slice(None))
    for i in range(n):
        np.testing.assert_allclose(fleet[:, i], output(1, slice(i, i + 1))[:, 0], rtol=1e-13, atol=1e-13)
