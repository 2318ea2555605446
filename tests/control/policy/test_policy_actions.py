"""Tests of the commands that follow from the actions of a policy."""

import numpy as np
import pytest
from pydrake.math import RotationMatrix

from drake_quad.control.policy.actions import (
    AccelerationScale,
    AttitudeScale,
    PerRotor,
    RatesScale,
    SpeedScale,
    ThrustRange,
    commanded_acceleration,
    commanded_attitude,
    offboard_rate_command,
    onboard_rate_command,
    wrench_of_speeds,
)
from drake_quad.geometry.per_axis import PerAngle
from drake_quad.signals import BodyRates, Reference, State, Wrench

THRUST_RANGE = ThrustRange(min_thrust=2.0, max_thrust=12.0)  # N
RATES_SCALE = RatesScale(
    thrust=THRUST_RANGE,
    rates=BodyRates(5.0, 4.0, 2.0),
    gains=PerAngle(10.0, 9.0, 3.0),
    i_xx=0.006,
    i_yy=0.007,
    i_zz=0.011,
)
REFERENCE = Reference(*[0.0] * 9, 0.3, 0.0)  # at rest at the origin with a yaw of 0.3 rad
# Two actions with the same effect: the second one is saturated to the limit 1 of each of its four components.
SATURATED_ACTIONS = ((1.0, 1.0, 1.0, 1.0), (1.7, 1.0, 2.0, 9.0))


ACCELERATION_SCALE = AccelerationScale(5.0, 4.0, 3.0)  # m/s² along x, y and z


def test_an_acceleration_action_is_scaled_axis_by_axis():
    assert commanded_acceleration((0.5, -0.25, 1.0), None, None, ACCELERATION_SCALE, "world", 0.0) == (2.5, -1.0, 3.0)
    assert commanded_acceleration((-1.5, 2.0, 1.0), None, None, ACCELERATION_SCALE, "world", 0.0) == (-5.0, 4.0, 3.0)


@pytest.mark.parametrize("turn", [0.0, 0.6])
@pytest.mark.parametrize(("frame", "yaw"), [("heading", 1.1), ("reference_heading", REFERENCE.yaw)])
def test_an_acceleration_action_along_a_heading_is_rotated_into_the_world_frame(frame, yaw, turn):
    measured = State(*[0.0] * 3, 0.3, -0.2, 1.1, *[0.0] * 6)
    command = commanded_acceleration((0.5, -0.25, 1.0), measured, REFERENCE, ACCELERATION_SCALE, frame, turn)
    expected = RotationMatrix.MakeZRotation(yaw + turn) @ np.array([2.5, -1.0, 3.0])
    np.testing.assert_allclose(command, expected, atol=1e-14)


def test_the_thrust_of_an_action_ranges_from_the_smallest_to_the_largest():
    for action, thrust in ((-1.0, 2.0), (0.0, 7.0), (1.0, 12.0), (3.0, 12.0), (-3.0, 2.0)):
        assert onboard_rate_command((action, 0.0, 0.0, 0.0), RATES_SCALE).thrust == thrust
        assert offboard_rate_command((action, 0.0, 0.0, 0.0), State(*[0.0] * 12), RATES_SCALE).thrust == thrust
        assert commanded_attitude((action, 0.0, 0.0, 0.0), REFERENCE, AttitudeScale(THRUST_RANGE, 0.5, 0.2))[0] == (
            thrust,
        )


def test_the_yaw_of_an_action_is_relative_to_the_reference():
    scale = AttitudeScale(THRUST_RANGE, 0.5, 0.2)
    commanded = commanded_attitude((0.0, 0.5, -1.0, 0.5), REFERENCE, scale)
    np.testing.assert_allclose(commanded.attitude_command, [0.25, -0.5, 0.4])
    assert commanded.body_rate_command == commanded.angular_acceleration_command == (0.0, 0.0, 0.0)
    saturated, beyond = (commanded_attitude(action, REFERENCE, scale) for action in SATURATED_ACTIONS)
    assert saturated == beyond


def test_an_onboard_rate_command_contains_no_attitude():
    assert onboard_rate_command((0.0, 0.2, -0.5, 1.0), RATES_SCALE) == (7.0, 0.0, 0.0, 0.0, 1.0, -2.0, 2.0)
    assert onboard_rate_command(SATURATED_ACTIONS[0], RATES_SCALE) == onboard_rate_command(
        SATURATED_ACTIONS[1], RATES_SCALE
    )


def test_body_rates_follow_an_offboard_rate_loop_with_a_first_order_lag():
    """The torque follows from Euler's equations with ω̇ = k (ω_r - ω), for any present rates."""
    rates, inertia = np.array([0.7, -1.1, 0.4]), np.array(RATES_SCALE[3:])
    measured = State(*[0.0] * 9, *rates)
    wrench = offboard_rate_command((0.0, 0.2, -0.5, 1.0), measured, RATES_SCALE)
    slope = (np.array(wrench[1:]) - np.cross(rates, inertia * rates)) / inertia
    np.testing.assert_allclose(slope, np.array(RATES_SCALE.gains) * (np.array([1.0, -2.0, 2.0]) - rates))


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (2, 0, 3, 1)])
def test_the_wrench_of_rotor_speeds_is_the_sum_over_the_rotors(order):
    rng = np.random.default_rng(3)
    matrix = rng.normal(size=(4, 4))
    scale = SpeedScale(60.0, 300.0, PerRotor(*(Wrench(*row) for row in matrix)))
    action = rng.uniform(-1.0, 1.0, 4)
    speeds = 180.0 + 120.0 * action[list(order)]
    np.testing.assert_allclose(wrench_of_speeds(tuple(action), scale, order), speeds**2 @ matrix, rtol=1e-12)
    saturated, beyond = (wrench_of_speeds(each, scale, order) for each in SATURATED_ACTIONS)
    assert saturated == beyond
