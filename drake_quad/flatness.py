"""Differential flatness: the attitude, body rates and angular accelerations that a path asks for.

The thrust acts along z_B, so the specific thrust f = F z_B of a path (acceleration plus gravity) fixes roll φ and
pitch θ, eq (7). Its derivatives, jerk j and snap s, fix how the body turns, for ż_B is q x_B - p y_B:

    Ḟ = z_B·j        p = -y_B·j / F                          q = x_B·j / F
                     ṗ = q r - (y_B·s + 2 Ḟ p) / F           q̇ = (x_B·s - 2 Ḟ q) / F - p r

and eq (2), with the rate of the yaw ψ, leaves r = (ψ̇ cos θ - q sin φ) / cos φ (D. Mellinger and V. Kumar, "Minimum snap
trajectory generation and control for quadrotors", ICRA 2011).

All vectors are rows forward, left and up in the heading, numbers for one vehicle and arrays for many.
"""

from typing import NamedTuple

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, arcsin, arctan2, sqrt


class Tilt(NamedTuple):
    """How a specific thrust tilts the body.

    Attributes:
        thrust: F, m/s².
        sin_roll: sine of φ; the others likewise.
        cos_roll: of φ.
        sin_pitch: of θ.
        cos_pitch: of θ; negative for a thrust that points down.
    """

    thrust: Row
    sin_roll: Row
    cos_roll: Row
    sin_pitch: Row
    cos_pitch: Row


@formula
def tilt_of(specific_thrust: Rows) -> Tilt:
    """The tilt under which the rotors give a specific thrust (3 rows, m/s²), which may not be wholly sideways."""
    forward, left, up = specific_thrust
    sagittal_squared = forward * forward + up * up
    sagittal, thrust = sqrt(sagittal_squared), sqrt(sagittal_squared + left * left)
    return Tilt(thrust, -left / thrust, sagittal / thrust, forward / sagittal, up / sagittal)


@formula
def attitude_of(tilt: Tilt) -> tuple[Row, Row]:
    """Roll and pitch, eq (7), rad; the pitch is beyond a quarter turn for a thrust that points down."""
    return arcsin(tilt.sin_roll), arctan2(tilt.sin_pitch, tilt.cos_pitch)


@formula
def body_rates(tilt: Tilt, jerk: Rows, yaw_rate: Row) -> tuple[Row, Row, Row]:
    """p, q and r, rad/s.

    Args:
        tilt: of the body.
        jerk: 3 rows, m/s³.
        yaw_rate: rad/s.
    """
    x, y, _ = _in_body(tilt, jerk)
    q = x / tilt.thrust
    return -y / tilt.thrust, q, (yaw_rate * tilt.cos_pitch - q * tilt.sin_roll) / tilt.cos_roll


@formula
def angular_accelerations(
    tilt: Tilt, rates: Rows, jerk: Rows, snap: Rows, yaw_rate: Row, yaw_acceleration: Row
) -> tuple[Row, Row, Row]:
    """The rates of p, q and r, rad/s².

    Args:
        tilt: of the body.
        rates: p, q and r for the same jerk and yaw rate, rad/s.
        jerk: 3 rows, m/s³.
        snap: 3 rows, m/s⁴.
        yaw_rate: rad/s.
        yaw_acceleration: rad/s².
    """
    p, q, r = rates
    thrust, sin_roll, cos_roll, sin_pitch, cos_pitch = tilt
    x, y, _ = _in_body(tilt, snap)
    twice = 2.0 * _in_body(tilt, jerk)[2]
    p_dot, q_dot = q * r - (y + twice * p) / thrust, (x - twice * q) / thrust - p * r
    roll_rate = p + yaw_rate * sin_pitch
    pitch_rate = (q - yaw_rate * cos_pitch * sin_roll) / cos_roll
    # What r cos φ = ψ̇ cos θ - q sin φ is when differentiated.
    turning = yaw_acceleration * cos_pitch - yaw_rate * sin_pitch * pitch_rate - q_dot * sin_roll
    return p_dot, q_dot, (turning + (r * sin_roll - q * cos_roll) * roll_rate) / cos_roll


@formula
def _in_body(tilt: Tilt, vector: Rows) -> tuple[Row, Row, Row]:
    """The vector's parts along x_B, y_B and z_B."""
    forward, left, up = vector
    _, sin_roll, cos_roll, sin_pitch, cos_pitch = tilt
    upright = forward * sin_pitch + up * cos_pitch
    return (
        forward * cos_pitch - up * sin_pitch,
        upright * sin_roll + left * cos_roll,
        upright * cos_roll - left * sin_roll,
    )


@formula
def in_heading(vector: Rows, sin_yaw: Row, cos_yaw: Row) -> tuple[Row, Row, Row]:
    """Turns a vector in W by minus the yaw: its parts forward, left (both level) and up."""
    x, y, z = vector
    return x * cos_yaw + y * sin_yaw, y * cos_yaw - x * sin_yaw, z
