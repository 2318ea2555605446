"""How a body turns whose roll, pitch and yaw change: eq (2)."""

from drake_quad.framework.elementary import sin_cos
from drake_quad.signals import Attitude, BodyRates


def small_rotation(steps: Attitude, attitude: Attitude) -> BodyRates:
    """Return small rotations about the axes of B for small steps of roll, pitch and yaw at an attitude: eq (2), rad.

    For the rates of roll, pitch and yaw in place of steps they are the body rates, rad/s.
    """
    s_r, c_r = sin_cos(attitude.roll)
    s_p, c_p = sin_cos(attitude.pitch)
    level = c_p * steps.yaw
    return BodyRates(steps.roll - s_p * steps.yaw, c_r * steps.pitch + s_r * level, c_r * level - s_r * steps.pitch)


def angle_rates(body_rates: BodyRates, attitude: Attitude) -> Attitude:
    """Return the rates of roll, pitch and yaw (rad/s) for body rates: eq (2) inverted, infinite at a pitch of 90°."""
    p, q, r = body_rates
    sin_roll, cos_roll = sin_cos(attitude.roll)
    sin_pitch, cos_pitch = sin_cos(attitude.pitch)
    yaw_rate = (q * sin_roll + r * cos_roll) / cos_pitch
    return Attitude(p + sin_pitch * yaw_rate, q * cos_roll - r * sin_roll, yaw_rate)
