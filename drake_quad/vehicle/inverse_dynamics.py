"""Inverse dynamics: rotor speeds that are required to follow a trajectory.

The vehicle is differentially flat (`drake_quad.geometry.flatness`): position and yaw as functions of time determine the
attitude, the body rates and the torques.
"""

from typing import NamedTuple

import numpy as np

from drake_quad.geometry.flatness import (
    angular_accelerations,
    attitude_from_tilt,
    body_rates,
    in_heading,
    tilt_from_thrust,
)
from drake_quad.geometry.kinematics import euler_torque
from drake_quad.signals import Acceleration, Attitude, BodyRates, Jerk, Reference, RotorSpeed, Snap, Wrench
from drake_quad.vehicle.dynamics import rotor_action
from drake_quad.vehicle.parameters import QuadrotorParameters


class RotorDemand(NamedTuple):
    """State and wrench that are required to follow a trajectory; values have the same shape as in the reference.

    Attributes:
        rotor_speed: rotor speeds; zero for a rotor that would have to push the vehicle down.
        attitude: attitude of the vehicle.
        body_rates: body rates of the vehicle.
        wrench: wrench of the rotors.
    """

    rotor_speed: RotorSpeed
    attitude: Attitude
    body_rates: BodyRates
    wrench: Wrench


def rotor_demand(reference: Reference, jerk: Jerk, snap: Snap, parameters: QuadrotorParameters) -> RotorDemand:
    """Return the rotor speeds, attitude, body rates and wrench with which a vehicle follows a trajectory exactly.

    The air is still. Drag, the lag of the rotors, and the gyroscopic torque of the rotors are neglected. The gyroscopic
    torque is small, since the rotors turn in opposite directions at nearly equal speeds.

    Args:
        reference: reference at one instant (numbers) or at several instants (arrays).
        jerk: jerk of the reference.
        snap: snap of the reference, and second derivative of its yaw.
        parameters: parameters of one vehicle.
    """
    thrust = Acceleration(reference.a_x, reference.a_y, reference.a_z + parameters.gravity)
    specific_thrust, turned_jerk, turned_snap = (
        in_heading(vector, np.sin(reference.yaw), np.cos(reference.yaw)) for vector in (thrust, jerk, snap)
    )
    tilt = tilt_from_thrust(specific_thrust)
    rates = body_rates(tilt, turned_jerk, reference.yaw_rate)
    angular_acceleration = angular_accelerations(tilt, rates, turned_jerk, turned_snap, reference.yaw_rate, snap.yaw)
    wrench = Wrench(parameters.mass * tilt.thrust, *euler_torque(angular_acceleration, rates, *parameters.inertia))
    squares = np.linalg.solve(_wrench_matrix(parameters), np.array(np.broadcast_arrays(*wrench)))
    roll, pitch = attitude_from_tilt(tilt)
    return RotorDemand(
        RotorSpeed(*np.sqrt(np.maximum(squares, 0.0))), Attitude(roll, pitch, reference.yaw), rates, wrench
    )


def _wrench_matrix(parameters: QuadrotorParameters) -> np.ndarray:
    """Return the (4, 4) matrix of eq (5) of the paper, which maps squared rotor speeds to the wrench."""
    return np.array([rotor_action(RotorSpeed(*column), parameters).wrench for column in np.eye(4)]).T
