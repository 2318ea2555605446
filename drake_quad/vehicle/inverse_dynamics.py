"""Rotor speeds that a trajectory asks for: the equations of motion read backwards.

The vehicle is differentially flat (`drake_quad.flatness`): position and yaw over time fix how the body turns, and so
the torques.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from drake_quad.flatness import angular_accelerations, attitude_of, body_rates, in_heading, tilt_of
from drake_quad.vehicle.dynamics import rotor_wrench
from drake_quad.vehicle.parameters import QuadrotorParameters


class RotorDemand(NamedTuple):
    """What a trajectory asks of the vehicle, at each of its samples.

    Attributes:
        rotor_speed: (4, samples), rad/s; zero where a rotor would have to pull down.
        attitude: (3, samples) roll, pitch, yaw, rad.
        body_rates: (3, samples) p, q, r, rad/s.
        wrench: (4, samples) F_z (N) and torques (N m) in B.
    """

    rotor_speed: np.ndarray
    attitude: np.ndarray
    body_rates: np.ndarray
    wrench: np.ndarray


def rotor_demand(
    acceleration: np.ndarray, jerk: np.ndarray, snap: np.ndarray, parameters: QuadrotorParameters, *, yaw: ArrayLike
) -> RotorDemand:
    """Returns what the vehicle needs to follow a trajectory in still air without drag, rotors without lag.

    The gyroscopic torque of the rotors' residual speed is left out: it is that of the difference between four nearly
    equal speeds.

    Args:
        acceleration: (3, samples) in W, m/s².
        jerk: (3, samples), m/s³.
        snap: (3, samples), m/s⁴.
        parameters: of one vehicle.
        yaw: (3, samples) or (3,) yaw (rad), its rate (rad/s) and acceleration (rad/s²).
    """
    heading, yaw_rate, yaw_acceleration = np.broadcast_arrays(*np.asarray(yaw, dtype=float), acceleration[0])[:3]
    gravity = np.array([[0.0], [0.0], [parameters.gravity]])
    thrust, turned_jerk, turned_snap = (
        in_heading(vector, np.sin(heading), np.cos(heading)) for vector in (acceleration + gravity, jerk, snap)
    )
    tilt = tilt_of(thrust)
    p, q, r = rates = body_rates(tilt, turned_jerk, yaw_rate)
    p_dot, q_dot, r_dot = angular_accelerations(tilt, rates, turned_jerk, turned_snap, yaw_rate, yaw_acceleration)
    i_xx, i_yy, i_zz = parameters.inertia
    wrench = np.array(
        [
            parameters.mass * tilt.thrust,
            i_xx * p_dot - (i_yy - i_zz) * q * r,
            i_yy * q_dot - (i_zz - i_xx) * p * r,
            i_zz * r_dot - (i_xx - i_yy) * p * q,
        ]
    )
    squares = np.linalg.solve(_wrench_matrix(parameters), wrench)
    return RotorDemand(
        np.sqrt(np.maximum(squares, 0.0)),
        np.array([*attitude_of(tilt), heading]),
        np.array([p, q, r]),
        wrench,
    )


def _wrench_matrix(parameters: QuadrotorParameters) -> np.ndarray:
    """(4, 4) matrix of eq (5), from squared rotor speeds to the wrench."""
    unit = np.eye(4)
    return np.array([rotor_wrench(column, parameters) for column in unit]).T
