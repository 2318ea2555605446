"""Vectors, and the axes of the body in which they are taken apart."""

from typing import NamedTuple

from drake_quad.framework.elementary import sin_cos, sqrt
from drake_quad.signals import Angle, Row

# A vector of no length must not make the derivative of the square root infinite; 1e-200 changes no float above 1e-92.
TINY = 1e-200


class Vector(NamedTuple):
    """Three components along the axes of W or B."""

    x: Row
    y: Row
    z: Row


class BodyAxes(NamedTuple):
    """The axes of B, in W: the columns of R_WB, eq (1)."""

    x: Vector
    y: Vector
    z: Vector

    @classmethod
    def of(cls, roll: Angle, pitch: Angle, yaw: Angle) -> "BodyAxes":
        """The axes of a body of this attitude."""
        sin_roll, cos_roll = sin_cos(roll)
        sin_pitch, cos_pitch = sin_cos(pitch)
        sin_yaw, cos_yaw = sin_cos(yaw)
        forward, aside = sin_pitch * cos_roll, sin_pitch * sin_roll
        return cls(
            Vector(cos_yaw * cos_pitch, sin_yaw * cos_pitch, -sin_pitch),
            Vector(cos_yaw * aside - sin_yaw * cos_roll, sin_yaw * aside + cos_yaw * cos_roll, cos_pitch * sin_roll),
            Vector(
                sin_yaw * sin_roll + cos_yaw * forward, sin_yaw * forward - cos_yaw * sin_roll, cos_pitch * cos_roll
            ),
        )

    def in_body(self, vector: Vector) -> Vector:
        """A vector in W, along the axes of B."""
        return Vector(dot(self.x, vector), dot(self.y, vector), dot(self.z, vector))

    def in_world(self, vector: Vector) -> Vector:
        """A vector in B, along the axes of W."""
        x, y, z = vector
        return Vector._make(a * x + b * y + c * z for a, b, c in zip(*self, strict=True))


def plus(a: Vector, b: Vector) -> Vector:
    """A + b."""
    return Vector(a.x + b.x, a.y + b.y, a.z + b.z)


def times(factor: Row, a: Vector) -> Vector:
    """A vector times a number."""
    return Vector(factor * a.x, factor * a.y, factor * a.z)


def dot(a: Vector, b: Vector) -> Row:
    """A · b."""
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a: Vector, b: Vector) -> Vector:
    """A x b."""
    return Vector(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def length(a: Vector) -> Row:
    """|a|, whose derivative is 0 where the vector is."""
    return sqrt(dot(a, a) + TINY)
