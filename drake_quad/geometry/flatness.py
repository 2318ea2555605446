"""Differential flatness: attitude, body rates and angular accelerations that a path demands.

The thrust acts along z_B, so the specific thrust f = F z_B of a path (acceleration plus gravity) determines roll φ and
pitch θ, eq (7). Its derivatives, jerk j and snap s, determine the rotation of the body, since ż_B is q x_B - p y_B:

    Ḟ = z_B·j        p = -y_B·j / F                          q = x_B·j / F
                     ṗ = q r - (y_B·s + 2 Ḟ p) / F           q̇ = (x_B·s - 2 Ḟ q) / F - p r

From eq (2) and the rate of the yaw ψ follows r = (ψ̇ cos θ - q sin φ) / cos φ (D. Mellinger and V. Kumar, "Minimum snap
trajectory generation and control for quadrotors", ICRA 2011).

The yaw of a tilted body depends on a convention, the sequence of rotations from W to B:

    zyx    x_B lies in the vertical plane of the heading (cos ψ, sin ψ, 0): eq (1) of the paper, PX4
    zxy    y_B is perpendicular to the heading: y_B ∝ z_B x (cos ψ, sin ψ, 0) (T. Lee, M. Leok and N. H. McClamroch,
           "Geometric tracking control of a quadrotor UAV on SE(3)", CDC 2010; Mellinger and Kumar; the Crazyflie)

The two agree if roll or pitch is zero. Otherwise their headings differ by about the product of roll and pitch.

The functions of this module use zyx. The sequence zxy becomes zyx for axes that are rotated by π/2 about z_B:
Rz(ψ) Rx(φ) Ry(θ) Rz(π/2) = Rz(ψ + π/2) Ry(-φ) Rx(θ). Computing with zyx at the yaw ψ + π/2 therefore gives results for
the rotated axes. `attitude_from_quarter_turn` and the two functions after it convert them to the axes of the body.
"""

from typing import Literal, NamedTuple

from drake_quad.framework.elementary import arcsin, arctan2, sqrt
from drake_quad.geometry.axes import Vector
from drake_quad.signals import Acceleration, AngularAcceleration, Attitude, BodyRates, Jerk, Row, Snap

EulerSequence = Literal["zyx", "zxy"]


class HeadingVector(NamedTuple):
    """A vector along the axes of the heading.

    Attributes:
        forward: level, where the vehicle looks.
        left: level.
        up: along Z.
    """

    forward: Row
    left: Row
    up: Row


class ThrustTilt(NamedTuple):
    """Tilt of a body under a specific thrust.

    Attributes:
        thrust: F, m/s².
        sin_roll: sine of φ.
        cos_roll: cosine of φ.
        sin_pitch: sine of θ.
        cos_pitch: cosine of θ; negative for a thrust that points down.
    """

    thrust: Row
    sin_roll: Row
    cos_roll: Row
    sin_pitch: Row
    cos_pitch: Row


def tilt_of(specific_thrust: HeadingVector) -> ThrustTilt:
    """Return the tilt under which the rotors give a specific thrust (m/s²), which may not be wholly sideways."""
    forward, left, up = specific_thrust
    sagittal_squared = forward * forward + up * up
    sagittal, thrust = sqrt(sagittal_squared), sqrt(sagittal_squared + left * left)
    return ThrustTilt(thrust, -left / thrust, sagittal / thrust, forward / sagittal, up / sagittal)


def attitude_of(tilt: ThrustTilt) -> tuple[Row, Row]:
    """Roll and pitch, eq (7), rad; the pitch is beyond a quarter turn for a thrust that points down."""
    return arcsin(tilt.sin_roll), arctan2(tilt.sin_pitch, tilt.cos_pitch)


def body_rates(tilt: ThrustTilt, jerk: HeadingVector, yaw_rate: Row) -> BodyRates:
    """p, q and r.

    Args:
        tilt: of the body.
        jerk: of the path, m/s³.
        yaw_rate: rad/s.
    """
    x, y, _ = _in_body(tilt, jerk)
    q = x / tilt.thrust
    return BodyRates(-y / tilt.thrust, q, (yaw_rate * tilt.cos_pitch - q * tilt.sin_roll) / tilt.cos_roll)


def angular_accelerations(
    tilt: ThrustTilt, rates: BodyRates, jerk: HeadingVector, snap: HeadingVector, yaw_rate: Row, yaw_acceleration: Row
) -> AngularAcceleration:
    """Return the rates of p, q and r.

    Args:
        tilt: of the body.
        rates: p, q and r for the same jerk and yaw rate.
        jerk: of the path, m/s³.
        snap: of the path, m/s⁴.
        yaw_rate: rad/s.
        yaw_acceleration: rad/s².
    """
    p, q, r = rates
    thrust, sin_roll, cos_roll, sin_pitch, cos_pitch = tilt
    x, y, _ = _in_body(tilt, snap)
    _, _, growth = _in_body(tilt, jerk)
    twice = 2.0 * growth
    p_dot, q_dot = q * r - (y + twice * p) / thrust, (x - twice * q) / thrust - p * r
    roll_rate = p + yaw_rate * sin_pitch
    pitch_rate = (q - yaw_rate * cos_pitch * sin_roll) / cos_roll
    # This is the derivative of r cos φ = ψ̇ cos θ - q sin φ.
    turning = yaw_acceleration * cos_pitch - yaw_rate * sin_pitch * pitch_rate - q_dot * sin_roll
    return AngularAcceleration(p_dot, q_dot, (turning + (r * sin_roll - q * cos_roll) * roll_rate) / cos_roll)


def _in_body(tilt: ThrustTilt, vector: HeadingVector) -> tuple[Row, Row, Row]:
    """Return the vector's parts along x_B, y_B and z_B."""
    forward, left, up = vector
    _, sin_roll, cos_roll, sin_pitch, cos_pitch = tilt
    upright = forward * sin_pitch + up * cos_pitch
    return (
        forward * cos_pitch - up * sin_pitch,
        upright * sin_roll + left * cos_roll,
        upright * cos_roll - left * sin_roll,
    )


def in_heading(vector: Vector | Acceleration | Jerk | Snap, sin_yaw: Row, cos_yaw: Row) -> HeadingVector:
    """Turn a vector in W by minus the yaw."""
    x, y = vector.x, vector.y
    return HeadingVector(x * cos_yaw + y * sin_yaw, y * cos_yaw - x * sin_yaw, vector.z)


def attitude_from_quarter_turn(tilt: ThrustTilt, yaw: Row) -> Attitude:
    """Return roll, pitch and yaw (zyx) of a body whose yaw is given in the sequence zxy.

    Args:
        tilt: roll and pitch (zyx) of the axes that are rotated by π/2 about z_B, at the yaw ψ + π/2.
        yaw: yaw ψ in the sequence zxy, rad.
    """
    _, sin_roll, cos_roll, sin_pitch, cos_pitch = tilt
    return Attitude(
        arctan2(-sin_pitch, cos_pitch * cos_roll),
        arcsin(cos_pitch * sin_roll),
        yaw - arctan2(sin_pitch * sin_roll, cos_roll),
    )


def rates_from_quarter_turn(rates: BodyRates) -> BodyRates:
    """Convert body rates from axes that are rotated by π/2 about z_B to the axes of the body."""
    return BodyRates(-rates.q, rates.p, rates.r)


def acceleration_from_quarter_turn(acceleration: AngularAcceleration) -> AngularAcceleration:
    """Convert an angular acceleration from axes that are rotated by π/2 about z_B to the axes of the body."""
    return AngularAcceleration(-acceleration.q, acceleration.p, acceleration.r)
