"""Rotor speeds that a trajectory asks for: the equations of motion read backwards.

The vehicle is differentially flat (`drake_quad.geometry.flatness`): position and yaw over time fix how the body turns,
and so the torques.
"""

from typing import NamedTuple

import numpy as np

from drake_quad.geometry.flatness import angular_accelerations, attitude_of, body_rates, in_heading, tilt_of
from drake_quad.geometry.kinematics import torque_of
from drake_quad.signals import Acceleration, Attitude, BodyRates, Jerk, Reference, RotorSpeed, Snap, Wrench
from drake_quad.vehicle.dynamics import rotor_action
from drake_quad.vehicle.parameters import QuadrotorParameters


class RotorDemand(NamedTuple):
    """What a trajectory asks of the vehicle; the rows are as those of the trajectory.

    Attributes:
        rotor_speed: zero where a rotor would have to pull down.
        attitude: of the body.
        body_rates: of the body.
        wrench: of the rotors.
    """

    rotor_speed: RotorSpeed
    attitude: Attitude
    body_rates: BodyRates
    wrench: Wrench


def rotor_demand(reference: Reference, jerk: Jerk, snap: Snap, parameters: QuadrotorParameters) -> RotorDemand:
    """Returns what the vehicle needs to follow a trajectory in still air without drag, rotors without lag.

    The gyroscopic torque of the rotors' residual speed is left out: it is that of the difference between four nearly
    equal speeds.

    Args:
        reference: numbers, or arrays of samples.
        jerk: of the reference.
        snap: of the reference.
        parameters: of one vehicle.
    """
    thrust = Acceleration(reference.a_x, reference.a_y, reference.a_z + parameters.gravity)
    specific_thrust, turned_jerk, turned_snap = (
        in_heading(vector, np.sin(reference.yaw), np.cos(reference.yaw)) for vector in (thrust, jerk, snap)
    )
    tilt = tilt_of(specific_thrust)
    rates = body_rates(tilt, turned_jerk, reference.yaw_rate)
    turning = angular_accelerations(tilt, rates, turned_jerk, turned_snap, reference.yaw_rate, snap.yaw)
    wrench = Wrench(parameters.mass * tilt.thrust, *torque_of(turning, rates, *parameters.inertia))
    squares = np.linalg.solve(_wrench_matrix(parameters), np.array(np.broadcast_arrays(*wrench)))
    roll, pitch = attitude_of(tilt)
    return RotorDemand(
        RotorSpeed(*np.sqrt(np.maximum(squares, 0.0))), Attitude(roll, pitch, reference.yaw), rates, wrench
    )


def _wrench_matrix(parameters: QuadrotorParameters) -> np.ndarray:
    """(4, 4) matrix of eq (5), from squared rotor speeds to the wrench."""
    return np.array([rotor_action(RotorSpeed(*column), parameters).wrench for column in np.eye(4)]).T
