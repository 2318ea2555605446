"""Relation between body rates and rates of roll, pitch and yaw. Equation numbers: Kayacan and Maslim (2016)."""

from drake_quad.framework.elementary import sin_cos
from drake_quad.signals import AngularAcceleration, Attitude, BodyRates, Row, Torque


def small_rotation(changes: Attitude, attitude: Attitude) -> BodyRates:
    """Return the small rotation (rad) about the axes of B for small changes of roll, pitch and yaw (rad).

    The rotation follows from eq (2) of the paper. For rates of roll, pitch and yaw instead of changes, the result is
    the body rates, rad/s.
    """
    s_r, c_r = sin_cos(attitude.roll)
    s_p, c_p = sin_cos(attitude.pitch)
    level = c_p * changes.yaw
    return BodyRates(
        changes.roll - s_p * changes.yaw, c_r * changes.pitch + s_r * level, c_r * level - s_r * changes.pitch
    )


def angular_acceleration(accelerations: Attitude, rates: Attitude, attitude: Attitude) -> AngularAcceleration:
    """Return the angular acceleration along the axes of B (rad/s²), the time derivative of eq (2) of the paper.

    Args:
        accelerations: second derivatives of roll, pitch and yaw, rad/s².
        rates: rates of roll, pitch and yaw, rad/s.
        attitude: roll, pitch and yaw, rad.
    """
    sin_roll, cos_roll = sin_cos(attitude.roll)
    sin_pitch, cos_pitch = sin_cos(attitude.pitch)
    linear_part, body_rates = small_rotation(accelerations, attitude), small_rotation(rates, attitude)
    coupling = rates.pitch * rates.yaw
    return AngularAcceleration(
        linear_part.p - cos_pitch * coupling,
        linear_part.q + rates.roll * body_rates.r - sin_pitch * sin_roll * coupling,
        linear_part.r - rates.roll * body_rates.q - sin_pitch * cos_roll * coupling,
    )


def angle_rates(body_rates: BodyRates, attitude: Attitude) -> Attitude:
    """Return the rates of roll, pitch and yaw (rad/s) for given body rates (rad/s), the inverse of the paper's eq (2).

    The rates are infinite at a pitch of ±90°.
    """
    p, q, r = body_rates
    sin_roll, cos_roll = sin_cos(attitude.roll)
    sin_pitch, cos_pitch = sin_cos(attitude.pitch)
    yaw_rate = (q * sin_roll + r * cos_roll) / cos_pitch
    return Attitude(p + sin_pitch * yaw_rate, q * cos_roll - r * sin_roll, yaw_rate)


def euler_torque(acceleration: AngularAcceleration, rates: BodyRates, i_xx: Row, i_yy: Row, i_zz: Row) -> Torque:
    """Return the torque of Euler's equation, τ = I ω̇ + ω × I ω, with principal moments of inertia (kg m²)."""
    p, q, r = rates
    return Torque(
        i_xx * acceleration.p + (i_zz - i_yy) * q * r,
        i_yy * acceleration.q + (i_xx - i_zz) * p * r,
        i_zz * acceleration.r + (i_yy - i_xx) * p * q,
    )
