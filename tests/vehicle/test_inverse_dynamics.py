"""Tests of the inverse dynamics: the attitude, body rates and rotor speeds that a trajectory requires."""

import numpy as np
import pytest
from rigid_body import rigid_body_derivative

from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.signals import Jerk, Reference, Snap, State, Wind, Wrench
from drake_quad.vehicle.attitude_kinematics import RIGID_KINEMATICS
from drake_quad.vehicle.dynamics import hover_rotor_speeds, rotor_action
from drake_quad.vehicle.inverse_dynamics import rotor_demand
from drake_quad.vehicle.parameters import QuadrotorParameters

PATH = minimum_snap([[0, 0, 0], [1, 2, 1], [3, 1, 2], [2, -1, 0]], [0.0, 1.5, 3.0, 4.2])


@pytest.mark.parametrize("with_changing_yaw", [False, True])
def test_the_demanded_rotor_speeds_reproduce_the_trajectory(with_changing_yaw, asymmetric_vehicle):
    parameters = asymmetric_vehicle._replace(rotor_inertia=0.0, linear_drag=0.0, quadratic_drag=0.0)
    times = np.linspace(0.0, 4.2, 8001)
    position, velocity, *higher_derivatives = (evaluate(PATH, times, order) for order in range(5))
    acceleration, jerk, snap = higher_derivatives
    yaw, yaw_rate, yaw_acceleration = 0.7, 0.0, 0.0
    if with_changing_yaw:
        yaw, yaw_rate = 0.7 + 0.4 * np.sin(2.0 * times), 0.8 * np.cos(2.0 * times)
        yaw_acceleration = -1.6 * np.sin(2.0 * times)
    reference = Reference(*position, *velocity, *acceleration, yaw, yaw_rate)
    demand = rotor_demand(reference, Jerk(*jerk), Snap(*snap, yaw_acceleration), parameters)
    state = State(*np.broadcast_arrays(*position, *demand.attitude, *velocity, *demand.body_rates))
    rotors = rotor_action(demand.rotor_speed, parameters)
    np.testing.assert_allclose(rotors.wrench, demand.wrench, atol=1e-12)
    slope = rigid_body_derivative(state, rotors, Wind(0.0, 0.0, 0.0), parameters, RIGID_KINEMATICS)
    np.testing.assert_allclose([slope.v_x, slope.v_y, slope.v_z], acceleration, atol=1e-12)
    numeric = State(*np.gradient(np.array(state), times[1], axis=1)[:, 2:-2])
    assert np.ptp(numeric.roll) > 1.0, "the attitude should change"
    np.testing.assert_allclose(np.array(slope)[:, 2:-2], numeric, atol=5e-4)


def test_a_hovering_trajectory_demands_hover_speeds():
    reference = Reference(*[0.0] * 9, yaw=1.0, yaw_rate=0.0)
    demand = rotor_demand(reference, Jerk(0.0, 0.0, 0.0), Snap(0.0, 0.0, 0.0, 0.0), QuadrotorParameters())
    np.testing.assert_allclose(demand.rotor_speed, hover_rotor_speeds(QuadrotorParameters()))
    np.testing.assert_allclose(demand.attitude, [0.0, 0.0, 1.0], atol=1e-15)


def test_the_demanded_speed_of_a_rotor_that_would_have_to_push_down_is_zero():
    """A snap along x requires more pitch torque than the other rotors produce with a stopped front rotor."""
    snap = Snap(3000.0, 0.0, 0.0, 0.0)
    demand = rotor_demand(Reference(*[0.0] * 11), Jerk(0.0, 0.0, 0.0), snap, QuadrotorParameters())
    torque = 0.007 * 3000.0 / 9.81
    np.testing.assert_allclose(demand.wrench, Wrench(0.68 * 9.81, 0.0, torque, 0.0), atol=1e-12)
    side_rotor = 0.68 * 9.81 / (4.0 * 4.13e-5)
    back_rotor = side_rotor + torque / (2.0 * 0.17 * 4.13e-5)
    np.testing.assert_allclose(np.square(demand.rotor_speed), [0.0, side_rotor, back_rotor, side_rotor], rtol=1e-12)
