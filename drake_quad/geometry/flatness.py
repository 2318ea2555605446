"""Differential flatness: attitude, body rates and angular accelerations that a path requires.

The thrust acts along z_B, so the specific thrust f = F z_B of a path (acceleration plus gravity) determines roll φ and
pitch θ, eq (7) of Kayacan and Maslim (2016). Its derivatives, jerk j and snap s, determine the rotation of the body,
since ż_B is q x_B - p y_B:

    Ḟ = z_B·j        p = -y_B·j / F                          q = x_B·j / F
                     ṗ = q r - (y_B·s + 2 Ḟ p) / F           q̇ = (x_B·s - 2 Ḟ q) / F - p r

Eq (2) and the rate of the yaw ψ give r = (ψ̇ cos θ - q sin φ) / cos φ (D. Mellinger and V. Kumar, "Minimum snap
trajectory generation and control for quadrotors", ICRA 2011).

The yaw of a tilted body depends on a convention, the sequence of rotations from W to B:

    zyx    x_B lies in the vertical plane of the heading (cos ψ, sin ψ, 0): eq (1) of the paper, PX4
    zxy    y_B is perpendicular to the heading: y_B ∝ z_B x (cos ψ, sin ψ, 0) (T. Lee, M. Leok and N. H. McClamroch,
           "Geometric tracking control of a quadrotor UAV on SE(3)", CDC 2010; Mellinger and Kumar; the Crazyflie)

The two agree if roll or pitch is zero. Otherwise the headings differ by about the product of roll and pitch.

The functions of this module use zyx. The sequence zxy becomes zyx for axes that are rotated by π/2 about z_B: Rz(ψ)
Rx(φ) Ry(θ) Rz(π/2) = Rz(ψ + π/2) Ry(-φ) Rx(θ). Computing with zyx at the yaw ψ + π/2 therefore gives results for the
rotated axes. `attitude_from_quarter_turn`, `rates_from_quarter_turn` and `acceleration_from_quarter_turn` convert these
results to the axes of the body.
"""

from typing import Literal, NamedTuple

from drake_quad.framework.elementary import arcsin, arctan2, sqrt
from drake_quad.geometry.axes import Vector
from drake_quad.signals import Acceleration, AngularAcceleration, Attitude, BodyRates, Jerk, Row, Snap

EulerSequence = Literal["zyx", "zxy"]


class HeadingVector(NamedTuple):
    """Vector in the heading frame, which is W rotated by the yaw.

    Attributes:
        forward: component along the heading.
        left: horizontal component to the left of the heading.
        up: component along Z.
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
        cos_pitch: cosine of θ; negative if the thrust points down.
    """

    thrust: Row
    sin_roll: Row
    cos_roll: Row
    sin_pitch: Row
    cos_pitch: Row


def tilt_from_thrust(specific_thrust: HeadingVector) -> ThrustTilt:
    """Return the tilt for a specific thrust (m/s²), which must not point exactly to the left or right."""
    forward, left, up = specific_thrust
    sagittal_squared = forward * forward + up * up
    sagittal, thrust = sqrt(sagittal_squared), sqrt(sagittal_squared + left * left)
    return ThrustTilt(thrust, -left / thrust, sagittal / thrust, forward / sagittal, up / sagittal)


def attitude_from_tilt(tilt: ThrustTilt) -> tuple[Row, Row]:
    """Return roll and pitch (rad) by eq (7) of the paper; the pitch exceeds ±π/2 if the thrust points down."""
    return arcsin(tilt.sin_roll), arctan2(tilt.sin_pitch, tilt.cos_pitch)


def body_rates(tilt: ThrustTilt, jerk: HeadingVector, yaw_rate: Row) -> BodyRates:
    """Return the body rates p, q and r, rad/s.

    Args:
        tilt: tilt of the body.
        jerk: jerk of the path, m/s³.
        yaw_rate: rate of the yaw, rad/s.
    """
    x, y, _ = _in_body(tilt, jerk)
    q = x / tilt.thrust
    return BodyRates(-y / tilt.thrust, q, (yaw_rate * tilt.cos_pitch - q * tilt.sin_roll) / tilt.cos_roll)


def angular_accelerations(
    tilt: ThrustTilt, rates: BodyRates, jerk: HeadingVector, snap: HeadingVector, yaw_rate: Row, yaw_acceleration: Row
) -> AngularAcceleration:
    """Return the time derivatives of p, q and r, rad/s².

    Args:
        tilt: tilt of the body.
        rates: body rates for the same jerk and yaw rate, rad/s.
        jerk: jerk of the path, m/s³.
        snap: snap of the path, m/s⁴.
        yaw_rate: rate of the yaw, rad/s.
        yaw_acceleration: second time derivative of the yaw, rad/s².
    """
    p, q, r = rates
    thrust, sin_roll, cos_roll, sin_pitch, cos_pitch = tilt
    x, y, _ = _in_body(tilt, snap)
    _, _, thrust_rate = _in_body(tilt, jerk)
    coupling = 2.0 * thrust_rate
    p_dot, q_dot = q * r - (y + coupling * p) / thrust, (x - coupling * q) / thrust - p * r
    roll_rate = p + yaw_rate * sin_pitch
    pitch_rate = (q - yaw_rate * cos_pitch * sin_roll) / cos_roll
    # Time derivative of r cos φ = ψ̇ cos θ - q sin φ.
    derivative = yaw_acceleration * cos_pitch - yaw_rate * sin_pitch * pitch_rate - q_dot * sin_roll
    return AngularAcceleration(p_dot, q_dot, (derivative + (r * sin_roll - q * cos_roll) * roll_rate) / cos_roll)


def _in_body(tilt: ThrustTilt, vector: HeadingVector) -> tuple[Row, Row, Row]:
    """Return the components of a vector along x_B, y_B and z_B."""
    forward, left, up = vector
    _, sin_roll, cos_roll, sin_pitch, cos_pitch = tilt
    upright = forward * sin_pitch + up * cos_pitch
    return (
        forward * cos_pitch - up * sin_pitch,
        upright * sin_roll + left * cos_roll,
        upright * cos_roll - left * sin_roll,
    )


def in_heading(vector: Vector | Acceleration | Jerk | Snap, sin_yaw: Row, cos_yaw: Row) -> HeadingVector:
    """Transform a vector from W to the heading frame."""
    x, y = vector.x, vector.y
    return HeadingVector(x * cos_yaw + y * sin_yaw, y * cos_yaw - x * sin_yaw, vector.z)


def attitude_from_quarter_turn(tilt: ThrustTilt, yaw: Row) -> Attitude:
    """Return roll, pitch and yaw (zyx) of a body, given its yaw in the sequence zxy.

    Args:
        tilt: roll and pitch (zyx) of the turned axes, whose yaw is ψ + π/2. The turned axes result from a rotation of
            the body's axes by π/2 about z_B.
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
