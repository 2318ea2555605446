"""Rotations as quaternions."""

from typing import NamedTuple

from drake_quad.framework.elementary import arctan2, sin_cos, sqrt, where
from drake_quad.geometry.axes import TINY, BodyAxes, Vector, length, times
from drake_quad.signals import Angle, BodyRates, Number


class Quaternion(NamedTuple):
    """Unit quaternion of the rotation from B to W, or its time derivative in 1/s."""

    w: Number
    x: Number
    y: Number
    z: Number

    @classmethod
    def of(cls, roll: Angle, pitch: Angle, yaw: Angle) -> "Quaternion":
        """Return the rotation by the yaw about z, then the pitch about the new y, then the roll about the new x."""
        (s_r, c_r), (s_p, c_p), (s_y, c_y) = (sin_cos(0.5 * angle) for angle in (roll, pitch, yaw))
        return cls(
            c_r * c_p * c_y + s_r * s_p * s_y,
            s_r * c_p * c_y - c_r * s_p * s_y,
            c_r * s_p * c_y + s_r * c_p * s_y,
            c_r * c_p * s_y - s_r * s_p * c_y,
        )

    @classmethod
    def of_rotation(cls, vector: Vector) -> "Quaternion":
        """Return the quaternion of the rotation that a rotation vector (rad) describes."""
        angle = length(vector)
        sine, cosine = sin_cos(0.5 * angle)
        return cls(cosine, *times(sine / angle, vector))

    def times(self, other: "Quaternion") -> "Quaternion":
        """Return the product, which is the rotation by `other` followed by this rotation."""
        w, x, y, z = self
        return Quaternion(
            w * other.w - x * other.x - y * other.y - z * other.z,
            w * other.x + x * other.w + y * other.z - z * other.y,
            w * other.y - x * other.z + y * other.w + z * other.x,
            w * other.z + x * other.y - y * other.x + z * other.w,
        )

    def normalised(self) -> "Quaternion":
        """Return a unit quaternion, given a quaternion whose length deviates from 1 by rounding errors."""
        w, x, y, z = self
        # This is one step of Newton's method for the inverse length. It squares the relative error.
        factor = 1.5 - 0.5 * (w * w + x * x + y * y + z * z)
        return Quaternion(factor * w, factor * x, factor * y, factor * z)

    def axes(self) -> BodyAxes:
        """Return the axes of B in W, which are the columns of the rotation matrix."""
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
        """Return the time derivative, which is half of the quaternion times (0, p, q, r), in 1/s."""
        w, x, y, z = self
        p, q, r = (0.5 * rate for rate in body_rates)
        if self is NO_ROTATION:
            return Quaternion(0.0, p, q, r)
        return Quaternion(-(x * p + y * q + z * r), w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p)

    def relative_quaternion(self, other: "Quaternion") -> "Quaternion":
        """Return the rotation from this attitude to another as a quaternion, with components along the axes of B."""
        w, x, y, z = self
        return Quaternion(
            w * other.w + x * other.x + y * other.y + z * other.z,
            w * other.x - x * other.w - y * other.z + z * other.y,
            w * other.y - y * other.w - z * other.x + x * other.z,
            w * other.z - z * other.w - x * other.y + y * other.x,
        )

    def relative_rotation_vector(self, other: "Quaternion") -> Vector:
        """Return the rotation vector from this attitude to another, along the axes of B, of length at most π, rad."""
        cosine, x, y, z = self.relative_quaternion(other)
        sine = sqrt(x * x + y * y + z * z + TINY)
        # A quaternion and its negative represent the same rotation; the shorter rotation vector is returned.
        factor = 2.0 / sine * where(cosine < 0.0, -arctan2(sine, -cosine), arctan2(sine, cosine))
        return Vector(factor * x, factor * y, factor * z)


NO_ROTATION = Quaternion(1.0, 0.0, 0.0, 0.0)
