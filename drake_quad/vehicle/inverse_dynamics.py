"""Rotor speeds that a trajectory asks for: the equations of motion read backwards.

With thrust along the body's z axis, the acceleration of a trajectory and its yaw fix the attitude, its jerk and snap
and the yaw's derivatives the body's rates and their derivatives, and so the torques (the vehicle is differentially
flat; D. Mellinger and V. Kumar, "Minimum snap trajectory generation and control for quadrotors", ICRA 2011).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

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
    force = acceleration + np.array([[0.0], [0.0], [parameters.gravity]])
    thrust = np.linalg.norm(force, axis=0)
    z_B = force / thrust
    # Level and to the left of the heading: eq (1) keeps the body's x axis perpendicular to it.
    left = np.array([-np.sin(heading), np.cos(heading), np.zeros_like(heading)])
    x_B = np.cross(left, z_B, axis=0)
    x_B = x_B / np.linalg.norm(x_B, axis=0)
    y_B = np.cross(z_B, x_B, axis=0)
    roll, pitch = np.arctan2(y_B[2], z_B[2]), np.arcsin(-x_B[2])

    # f = F z_B, so ḟ = Ḟ z_B + F (q x_B - p y_B); differentiated once more for the derivatives of p and q.
    thrust_rate = _dot(z_B, jerk)
    p, q = -_dot(y_B, jerk) / thrust, _dot(x_B, jerk) / thrust
    # Eq (2) solved for what is left: r, and the rates of roll and pitch.
    tan_roll, cos_roll, cos_pitch, sin_pitch = np.tan(roll), np.cos(roll), np.cos(pitch), np.sin(pitch)
    r = -q * tan_roll + yaw_rate * cos_pitch / cos_roll
    roll_rate = p + yaw_rate * sin_pitch
    pitch_rate = (q - yaw_rate * cos_pitch * np.sin(roll)) / cos_roll
    p_dot = q * r - (_dot(y_B, snap) + 2.0 * thrust_rate * p) / thrust
    q_dot = (_dot(x_B, snap) - 2.0 * thrust_rate * q) / thrust - p * r
    r_dot = (
        -q_dot * tan_roll
        - q * roll_rate / cos_roll**2
        + (yaw_acceleration * cos_pitch - yaw_rate * sin_pitch * pitch_rate) / cos_roll
        + yaw_rate * cos_pitch * tan_roll * roll_rate / cos_roll
    )

    i_xx, i_yy, i_zz = parameters.inertia
    wrench = np.array(
        [
            parameters.mass * thrust,
            i_xx * p_dot - (i_yy - i_zz) * q * r,
            i_yy * q_dot - (i_zz - i_xx) * p * r,
            i_zz * r_dot - (i_xx - i_yy) * p * q,
        ]
    )
    squares = np.linalg.solve(_wrench_matrix(parameters), wrench)
    return RotorDemand(
        np.sqrt(np.maximum(squares, 0.0)),
        np.array([roll, pitch, heading]),
        np.array([p, q, r]),
        wrench,
    )


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(np.sum(a * b, axis=0))


def _wrench_matrix(parameters: QuadrotorParameters) -> np.ndarray:
    """(4, 4) matrix of eq (5), from squared rotor speeds to the wrench."""
    unit = np.eye(4)
    return np.array([rotor_wrench(column, parameters) for column in unit]).T
