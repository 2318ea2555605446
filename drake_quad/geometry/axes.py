"""Vectors, and the body axes in the world frame. Equation numbers refer to Kayacan and Maslim (2016)."""

from typing import NamedTuple

from drake_quad.framework.elementary import arctan2, sin_cos, sqrt
from drake_quad.signals import Angle, Attitude, Row

# Added to squared lengths, to keep the derivative of the square root finite at zero. The number is too small to change
# the square of a length above 1e-92.
TINY = 1e-200
# Added to cosines, to make the yaw 0 and avoid 0 / 0 in derivatives at a pitch of ±90°. The number is too small to
# change a cosine above 1e-14.
TINY_COSINE = 1e-30


class Vector(NamedTuple):
    """Vector with components along the axes of W or B."""

    x: Row
    y: Row
    z: Row


class Tilt(NamedTuple):
    """Sine and cosine of roll φ and pitch θ."""

    sin_roll: Row
    cos_roll: Row
    sin_pitch: Row
    cos_pitch: Row

    @classmethod
    def of(cls, roll: Angle, pitch: Angle) -> "Tilt":
        """Return the tilt of a body with a given roll and pitch, rad."""
        return cls(*sin_cos(roll), *sin_cos(pitch))

    def in_heading(self, vector: Vector) -> Vector:
        """Return Ry(θ) Rx(φ) v: transform a vector from B to the heading frame, which is W rotated by the yaw."""
        x, y, z = vector
        upright = self.sin_roll * y + self.cos_roll * z
        return Vector(
            self.cos_pitch * x + self.sin_pitch * upright,
            self.cos_roll * y - self.sin_roll * z,
            self.cos_pitch * upright - self.sin_pitch * x,
        )


class BodyAxes(NamedTuple):
    """Axes of B in W, which are the columns of R_WB, eq (1) of the paper."""

    x: Vector
    y: Vector
    z: Vector

    @classmethod
    def of(cls, roll: Angle, pitch: Angle, yaw: Angle) -> "BodyAxes":
        """Return the axes of a body with a given roll, pitch and yaw, rad."""
        sin_roll, cos_roll = sin_cos(roll)
        sin_pitch, cos_pitch = sin_cos(pitch)
        sin_yaw, cos_yaw = sin_cos(yaw)
        sin_pitch_cos_roll, sin_pitch_sin_roll = sin_pitch * cos_roll, sin_pitch * sin_roll
        return cls(
            Vector(cos_yaw * cos_pitch, sin_yaw * cos_pitch, -sin_pitch),
            Vector(
                cos_yaw * sin_pitch_sin_roll - sin_yaw * cos_roll,
                sin_yaw * sin_pitch_sin_roll + cos_yaw * cos_roll,
                cos_pitch * sin_roll,
            ),
            Vector(
                sin_yaw * sin_roll + cos_yaw * sin_pitch_cos_roll,
                sin_yaw * sin_pitch_cos_roll - cos_yaw * sin_roll,
                cos_pitch * cos_roll,
            ),
        )

    def angles(self) -> Attitude:
        """Return roll, pitch and yaw, with the pitch in [-π/2, π/2] and roll and yaw in [-π, π].

        At a pitch of ±π/2 the axes determine only the sum or the difference of roll and yaw. The yaw is then arbitrary,
        and the roll follows from the axes and this yaw, so that the three angles reproduce the axes except for rounding
        errors.
        """
        ahead, left = self.x.x + TINY_COSINE, self.x.y
        return Attitude(
            arctan2(left * self.z.x - ahead * self.z.y, ahead * self.y.y - left * self.y.x),
            arctan2(0.0 - self.x.z, sqrt(ahead * ahead + left * left)),
            arctan2(left, ahead),
        )

    def in_body(self, vector: Vector) -> Vector:
        """Transform a vector from W to B."""
        return Vector(dot(self.x, vector), dot(self.y, vector), dot(self.z, vector))

    def in_world(self, vector: Vector) -> Vector:
        """Transform a vector from B to W."""
        x, y, z = vector
        return Vector._make(a * x + b * y + c * z for a, b, c in zip(*self, strict=True))


def plus(a: Vector, b: Vector) -> Vector:
    """Return a + b."""
    return Vector(a.x + b.x, a.y + b.y, a.z + b.z)


def minus(a: Vector, b: Vector) -> Vector:
    """Return a - b."""
    return Vector(a.x - b.x, a.y - b.y, a.z - b.z)


def times(factor: Row, a: Vector) -> Vector:
    """Return a vector times a number."""
    return Vector(factor * a.x, factor * a.y, factor * a.z)


def dot(a: Vector, b: Vector) -> Row:
    """Return a · b."""
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a: Vector, b: Vector) -> Vector:
    """Return a x b."""
    return Vector(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def length(a: Vector) -> Row:
    """Return |a|, with the derivative 0 for the zero vector."""
    return sqrt(dot(a, a) + TINY)
