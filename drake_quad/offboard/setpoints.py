"""Conversion between signals of this library and fields of MAVLink messages.

MAVLink's local frame points north, east and down, and its body frame forward, right and down. Each differs from the
corresponding frame of this library by a rotation of 180° about x.
"""

import math
from typing import Any

from drake_quad.geometry.quaternion import Quaternion
from drake_quad.signals import AttitudeTarget, BodyRates, Reference, State


def measured_state(local_position: Any, attitude: Any) -> State:
    """Return the state of the vehicle from the messages LOCAL_POSITION_NED and ATTITUDE."""
    return State(
        local_position.x,
        -local_position.y,
        -local_position.z,
        attitude.roll,
        -attitude.pitch,
        -attitude.yaw,
        local_position.vx,
        -local_position.vy,
        -local_position.vz,
        attitude.rollspeed,
        -attitude.pitchspeed,
        -attitude.yawspeed,
    )


def position_fields(reference: Reference) -> tuple[float, ...]:
    """Return the eleven numbers of SET_POSITION_TARGET_LOCAL_NED, from x to the yaw rate."""
    x, y, z, v_x, v_y, v_z, a_x, a_y, a_z, yaw, yaw_rate = reference
    return x, -y, -z, v_x, -v_y, -v_z, a_x, -a_y, -a_z, -_wrapped(yaw), -yaw_rate


def attitude_fields(target: AttitudeTarget) -> tuple[float, float, float, float]:
    """Return the quaternion of SET_ATTITUDE_TARGET."""
    w, x, y, z = Quaternion.of(target.roll, target.pitch, target.yaw)
    return w, x, -y, -z


def rate_fields(rates: BodyRates) -> tuple[float, float, float]:
    """Return the body rates of SET_ATTITUDE_TARGET."""
    return rates.p, -rates.q, -rates.r


def _wrapped(angle: float) -> float:
    return math.remainder(angle, 2.0 * math.pi)
