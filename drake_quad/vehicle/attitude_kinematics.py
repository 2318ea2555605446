"""How body rates change the attitude, and how a step integrates the attitude.

Ports and states hold roll, pitch and yaw, whose rates are infinite at a pitch of 90°. A step therefore integrates the
quaternion ε of the rotation since its beginning, which has no singularity:

    R_WB(t) = R_WB(0) R(ε),    ε̇ = ½ ε ∘ (0, p, q, r),    ε(0) = 1

R(ε) divides by |ε|², which is 1 up to the error of the integration. The end of the step converts the rotation back to
angles:

- The pitch is between -90° and 90°, and the roll between -180° and 180°.
- The yaw is not wrapped: a step changes it by at most 180°, and a vehicle that flies round a circle keeps counting.
- At a pitch of ±90° the rotation determines only the sum or the difference of roll and yaw. The yaw is then arbitrary,
  and the roll follows from the rotation and that yaw, so that the three angles give the rotation back to rounding.

A vehicle that turns over thus has a roll and a yaw that jump by 180°, and a rotation that does not jump.

Eq (3) of the paper takes p, q, r for the rates of roll, pitch and yaw. With these small-angle kinematics nothing is
singular, and a step integrates the angles themselves.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from drake_quad.axes import TINY, BodyAxes, Vector
from drake_quad.framework.elementary import arctan2, sin_cos, sqrt
from drake_quad.kinematics import angle_rates
from drake_quad.signals import Angle, Attitude, BodyRates, Number, Row

# Added to the cosine of the pitch, it keeps the yaw where the nose points straight up or down, and 0 / 0 away from
# derivatives. It changes no cosine above 1e-14.
_LEAST_COSINE = 1e-30


class IntegratedAttitude(Protocol):
    """Attitude of a vehicle over a step, in coordinates that the step integrates."""

    @property
    def start(self) -> Any:
        """Coordinates at the beginning of the step, a record of rows."""

    def axes(self, coordinates: Any) -> BodyAxes:
        """Return the axes of B in W."""

    def rates(self, coordinates: Any, body_rates: BodyRates) -> Any:
        """Return the rates of the coordinates, per second."""

    def attitude(self, coordinates: Any) -> Attitude:
        """Return roll, pitch and yaw."""


class AttitudeKinematics(NamedTuple):
    """How body rates change the attitude.

    Attributes:
        angle_rates: the rates of roll, pitch and yaw (rad/s) for body rates at an attitude.
        integrated: the attitude over a step, for that at its beginning.
    """

    angle_rates: Callable[[BodyRates, Attitude], Attitude]
    integrated: Callable[[Attitude], IntegratedAttitude]


class Quaternion(NamedTuple):
    """Quaternion of a rotation, of any length but 0; or its rates, per second."""

    w: Number
    x: Number
    y: Number
    z: Number

    def axes(self) -> BodyAxes:
        """Return the columns of the rotation matrix."""
        w, x, y, z = self
        x_2, y_2, z_2 = x + x, y + y, z + z
        xx, yy, zz = x_2 * x, y_2 * y, z_2 * z
        xy, yz, zx = x_2 * y, y_2 * z, z_2 * x
        wx, wy, wz = w * x_2, w * y_2, w * z_2
        return BodyAxes(
            Vector(1.0 - (yy + zz), xy + wz, zx - wy),
            Vector(xy - wz, 1.0 - (zz + xx), yz + wx),
            Vector(zx + wy, yz - wx, 1.0 - (xx + yy)),
        )

    def rates(self, body_rates: BodyRates) -> "Quaternion":
        """Return ½ ε ∘ (0, p, q, r)."""
        w, x, y, z = self
        p, q, r = (0.5 * rate for rate in body_rates)
        if self is NO_ROTATION:
            return Quaternion(0.0, p, q, r)
        return Quaternion(
            -(x * p + y * q + z * r), w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p
        )


NO_ROTATION = Quaternion(1.0, 0.0, 0.0, 0.0)


class RotationSince(NamedTuple):
    """Rotation since the beginning of a step, at which the angles were these.

    Attributes:
        yaw: ψ.
        sin_yaw: sine of ψ.
        cos_yaw: cosine of ψ.
        sin_pitch: sine of the pitch θ.
        cos_pitch: cosine of θ.
        sin_roll: sine of the roll φ.
        cos_roll: cosine of φ.
    """

    yaw: Angle
    sin_yaw: Row
    cos_yaw: Row
    sin_pitch: Row
    cos_pitch: Row
    sin_roll: Row
    cos_roll: Row

    @classmethod
    def of(cls, attitude: Attitude) -> "RotationSince":
        """Return the rotation since an attitude."""
        roll, pitch, yaw = attitude
        return cls(yaw, *sin_cos(yaw), *sin_cos(pitch), *sin_cos(roll))

    @property
    def start(self) -> Quaternion:
        """No rotation."""
        return NO_ROTATION

    def axes(self, coordinates: Quaternion) -> BodyAxes:
        """Return the axes of B in W after a rotation since the beginning of the step."""
        if coordinates is NO_ROTATION:
            c_r, s_r, c_p, s_p = self.cos_roll, self.sin_roll, self.cos_pitch, self.sin_pitch
            tilted = BodyAxes(Vector(c_p, 0.0, -s_p), Vector(s_p*s_r, c_r, c_p*s_r), Vector(s_p*c_r, -s_r, c_p*c_r))
            return BodyAxes._make(self._in_world(axis) for axis in tilted)
        return BodyAxes._make(self._in_world(self._in_heading(axis)) for axis in coordinates.axes())

    def rates(self, coordinates: Quaternion, body_rates: BodyRates) -> Quaternion:
        """Return the rates of the quaternion, per second."""
        return coordinates.rates(body_rates)

    def attitude(self, coordinates: Quaternion) -> Attitude:
        """Return roll, pitch and yaw after a rotation since the beginning of the step.

        The axes of B are seen from the heading at the beginning, so that the yaw changes by the angle of x, and what
        does not turn keeps its yaw to the bit.
        """
        x, y, z = (self._in_heading(axis) for axis in coordinates.axes())
        ahead, left = x.x + _LEAST_COSINE, x.y
        return Attitude(
            arctan2(left * z.x - ahead * z.y, ahead * y.y - left * y.x),
            arctan2(-x.z, sqrt(ahead * ahead + left * left + TINY)),
            self.yaw + arctan2(left, ahead),
        )

    def _in_heading(self, vector: Vector) -> Vector:
        """Ry(θ) Rx(φ) v: a vector along the axes of B at the beginning, along those of the heading there."""
        x, y, z = vector
        upright = self.sin_roll * y + self.cos_roll * z
        return Vector(
            self.cos_pitch * x + self.sin_pitch * upright,
            self.cos_roll * y - self.sin_roll * z,
            self.cos_pitch * upright - self.sin_pitch * x,
        )

    def _in_world(self, vector: Vector) -> Vector:
        """Rz(ψ) v: a vector along the axes of the heading at the beginning, along those of W."""
        x, y, z = vector
        return Vector(self.cos_yaw * x - self.sin_yaw * y, self.sin_yaw * x + self.cos_yaw * y, z)


RIGID_KINEMATICS = AttitudeKinematics(angle_rates, RotationSince.of)
"""Eq (2)."""


class IntegratedAngles(NamedTuple):
    """Roll, pitch and yaw over a step, under small-angle kinematics.

    Attributes:
        start: the angles at the beginning.
    """

    start: Attitude

    def axes(self, coordinates: Attitude) -> BodyAxes:
        """Return the axes of B in W."""
        return BodyAxes.of(*coordinates)

    def rates(self, coordinates: Attitude, body_rates: BodyRates) -> Attitude:
        """Return the rates of the angles, rad/s."""
        return Attitude(*body_rates)

    def attitude(self, coordinates: Attitude) -> Attitude:
        """Return the angles."""
        return coordinates


def _same(body_rates: BodyRates, attitude: Attitude) -> Attitude:
    return Attitude(*body_rates)


SMALL_ANGLE_KINEMATICS = AttitudeKinematics(_same, IntegratedAngles)
"""What eq (3) takes for (2): p, q, r are the rates of roll, pitch and yaw."""
