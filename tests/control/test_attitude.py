"""Tests of the PD law of the attitude."""

import math

import numpy as np
import pytest

from drake_quad.control.attitude import AttitudeController, AttitudeParameters
from drake_quad.geometry.per_axis import PerAngle
from drake_quad.signals import State, Torque

INERTIA = (0.007, 0.008, 0.012)  # kg m²
# Gains k_P in 1/s² and k_D in 1/s, and moments of inertia in kg m².
PARAMETERS = AttitudeParameters(PerAngle(10.0, 20.0, 30.0), PerAngle(1.0, 2.0, 3.0), *INERTIA)


def torque(attitude=(0.0, 0.0, 0.0), rates=(0.0, 0.0, 0.0), command=(0.0, 0.0, 0.0), rate_command=(0.0, 0.0, 0.0)):
    controller = AttitudeController(parameters=PARAMETERS)
    context = controller.CreateDefaultContext()
    measurement = State(0.0, 0.0, 0.0, *attitude, 0.0, 0.0, 0.0, *rates)
    controller.GetInputPort("measurement").FixValue(context, measurement)
    controller.GetInputPort("attitude_command").FixValue(context, command)
    controller.GetInputPort("body_rate_command").FixValue(context, rate_command)
    return Torque(*controller.get_output_port().Eval(context))


def test_commanded_angular_accelerations_are_added_to_the_pd_law():
    controller = AttitudeController(parameters=PARAMETERS)
    context = controller.CreateDefaultContext()
    for name, size in (("measurement", 12), ("attitude_command", 3), ("body_rate_command", 3)):
        controller.GetInputPort(name).FixValue(context, [0.0] * size)
    np.testing.assert_array_equal(controller.get_output_port().Eval(context), 0.0)
    controller.GetInputPort("angular_acceleration_command").FixValue(context, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(controller.get_output_port().Eval(context), np.array(INERTIA) * [1.0, 2.0, 3.0])


def test_each_attitude_angle_behaves_like_a_double_integrator_with_its_gains():
    rates = np.array([1.0, 1.1, 1.2])
    result = torque((0.1, 0.2, 0.3), (0.4, 0.5, 0.6), (0.3, 0.1, 0.0), rates)
    acceleration = [10.0 * 0.2 + 0.6, 20.0 * -0.1 + 2.0 * 0.6, 30.0 * -0.3 + 3.0 * 0.6]
    np.testing.assert_allclose(result, INERTIA * np.array(acceleration) + np.cross(rates, INERTIA * rates))


@pytest.mark.parametrize(
    ("yaw", "command", "error"),
    [(3.0, -3.0, math.tau - 6.0), (-3.0, 3.0, 6.0 - math.tau), (0.1, 12.7, 12.6 - 2 * math.tau)],
)
def test_the_yaw_error_is_wrapped(yaw, command, error):
    assert torque((0.0, 0.0, yaw), command=(0.0, 0.0, command)).tau_z == pytest.approx(0.012 * 30.0 * error)
