"""Tests of thrust vectoring: thrust and attitude for a commanded acceleration, and their limits."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydrake.autodiffutils import ExtractGradient, InitializeAutoDiff

from drake_quad.control.thrust_vectoring import ThrustLimits, ThrustVectoring, VectoringParameters, specific_thrust
from drake_quad.geometry.flatness import HeadingVector, in_heading
from drake_quad.signals import Acceleration

G = 9.81  # m/s²
MASS = 0.68  # kg
# Limits on the tilt (0.6 rad) and on the thrust (N).
LIMITS = ThrustLimits(tan_max_tilt=math.tan(0.6), min_thrust=0.3 * MASS * G, max_thrust=1.8 * MASS * G)
PARAMETERS = VectoringParameters(MASS, G, LIMITS)
accelerations = st.builds(Acceleration, *[st.floats(-30.0, 30.0)] * 3)
angles = st.floats(-math.pi, math.pi)


def limited_thrust(acceleration, yaw):
    forward_left_up = in_heading(acceleration, math.sin(yaw), math.cos(yaw))
    return specific_thrust(forward_left_up, mass=MASS, gravity=G, limits=LIMITS)


@given(st.builds(Acceleration, *[st.floats(-3.0, 3.0)] * 3), angles)
def test_a_thrust_within_limits_gives_the_commanded_acceleration(acceleration, yaw):
    forward_left_up = in_heading(acceleration, math.sin(yaw), math.cos(yaw))
    np.testing.assert_allclose(limited_thrust(acceleration, yaw), forward_left_up + np.array([0.0, 0.0, G]), atol=1e-12)


@given(accelerations, angles)
def test_thrust_and_tilt_limits_hold_for_any_command(acceleration, yaw):
    forward, left, up = limited_thrust(acceleration, yaw)
    thrust = math.sqrt(forward**2 + left**2 + up**2)
    assert MASS * up >= LIMITS.min_thrust * (1.0 - 1e-12)
    assert MASS * thrust <= LIMITS.max_thrust * (1.0 + 1e-12)
    assert math.hypot(forward, left) <= LIMITS.tan_max_tilt * up * (1.0 + 1e-12)
    # The limits shorten the horizontal force, but do not change its direction.
    commanded_forward, commanded_left, _ = in_heading(acceleration, math.sin(yaw), math.cos(yaw))
    assert forward * commanded_left == pytest.approx(left * commanded_forward, abs=1e-9)


def test_the_thrust_is_vertical_if_the_vertical_command_uses_the_whole_thrust():
    """The horizontal force is zero, and never NaN, for any mass and limit, in Python and in machine code."""
    rng = np.random.default_rng(0)
    n = 1000
    mass, fraction = rng.uniform(0.4, 1.2, n), rng.uniform(1.05, 2.5, n)
    limits = ThrustLimits(math.tan(0.6), 0.3 * mass * G, fraction * mass * G)
    law = ThrustVectoring(num_vehicles=n, parameters=VectoringParameters(mass, G, limits))
    context = law.CreateDefaultContext()
    for name, rows in (
        ("acceleration_command", [0.3, -0.2, 50.0]),
        ("measurement", [0.1] * 12),
        ("reference", [0.0] * 11),
    ):
        law.GetInputPort(name).FixValue(context, np.repeat(rows, n))
    thrust, roll, pitch = law.get_output_port().Eval(context).reshape(10, n)[:3]
    np.testing.assert_allclose(thrust, fraction * mass * G, rtol=1e-14)
    np.testing.assert_allclose([roll, pitch], 0.0, atol=1e-15)


def test_the_thrust_has_derivatives_at_the_limits():
    command = InitializeAutoDiff(np.array([0.3, -0.2, 50.0])).ravel()
    limited_thrust = specific_thrust(HeadingVector(*command), mass=MASS, gravity=G, limits=LIMITS)
    np.testing.assert_allclose(ExtractGradient(np.array(limited_thrust)), 0.0, atol=1e-15)


def test_unconnected_derivatives_of_the_reference_are_zero():
    law = ThrustVectoring(parameters=PARAMETERS)
    context = law.CreateDefaultContext()
    law.GetInputPort("acceleration_command").FixValue(context, [0.0, 0.0, 1.0])
    law.GetInputPort("measurement").FixValue(context, [0.0] * 12)
    law.GetInputPort("reference").FixValue(context, [0.0] * 9 + [0.4, 0.1])
    steady = [MASS * (G + 1.0), 0.0, 0.0, 0.4]
    np.testing.assert_allclose(law.get_output_port().Eval(context), [*steady, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0])
    law.GetInputPort("reference_jerk").FixValue(context, [1.0, 2.0, 0.0])
    p, q = -2.0 / (G + 1.0), 1.0 / (G + 1.0)
    np.testing.assert_allclose(law.get_output_port().Eval(context), [*steady, p, q, 0.1, 0.0, 0.0, 0.0])
    law.GetInputPort("reference_snap").FixValue(context, [3.0, 4.0, 0.0, 0.2])
    accelerations = [q * 0.1 - 4.0 / (G + 1.0), 3.0 / (G + 1.0) - p * 0.1, 0.2 - q * p]
    np.testing.assert_allclose(law.get_output_port().Eval(context), [*steady, p, q, 0.1, *accelerations])


def test_thrust_vectoring_agrees_for_fleets_and_single_vehicles():
    rng = np.random.default_rng(0)
    n, sizes = (
        20,
        {"acceleration_command": 3, "measurement": 12, "reference": 11, "reference_jerk": 3, "reference_snap": 4},
    )
    values = {name: 4.0 * rng.normal(size=(size, n)) for name, size in sizes.items()}

    def output(num_vehicles, columns):
        law = ThrustVectoring(num_vehicles=num_vehicles, parameters=PARAMETERS)
        context = law.CreateDefaultContext()
        for name, rows in values.items():
            law.GetInputPort(name).FixValue(context, rows[:, columns].ravel())
        return law.get_output_port().Eval(context).reshape(10, num_vehicles)

    fleet = output(n, slice(None))
    for i in range(n):
        np.testing.assert_allclose(fleet[:, i], output(1, slice(i, i + 1))[:, 0], rtol=1e-13, atol=1e-13)
