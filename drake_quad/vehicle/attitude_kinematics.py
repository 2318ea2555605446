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

from drake_quad.axes import BodyAxes, Tilt, Vector
from drake_quad.framework.elementary import sin_cos
from drake_quad.kinematics import angle_rates
from drake_quad.quaternion import NO_ROTATION, Quaternion
from drake_quad.signals import Attitude, BodyRates, Row


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


class RotationSince(NamedTuple):
    """Rotation since the beginning of a step.

    Attributes:
        beginning: the attitude there.
        tilt: its roll and pitch.
        sin_yaw: sine of its yaw ψ.
        cos_yaw: cosine of ψ.
    """

    beginning: Attitude
    tilt: Tilt
    sin_yaw: Row
    cos_yaw: Row

    @classmethod
    def of(cls, attitude: Attitude) -> "RotationSince":
        """Return the rotation since an attitude."""
        return cls(attitude, Tilt.of(attitude.roll, attitude.pitch), *sin_cos(attitude.yaw))

    @property
    def start(self) -> Quaternion:
        """No rotation."""
        return NO_ROTATION

    def axes(self, coordinates: Quaternion) -> BodyAxes:
        """Return the axes of B in W after a rotation."""
        if coordinates is NO_ROTATION:
            return BodyAxes.of(*self.beginning)
        return BodyAxes._make(self._in_world(self.tilt.in_heading(axis)) for axis in coordinates.axes())

    def rates(self, coordinates: Quaternion, body_rates: BodyRates) -> Quaternion:
        """Return the rates of the quaternion, per second."""
        return coordinates.rates(body_rates)

    def attitude(self, coordinates: Quaternion) -> Attitude:
        """Return roll, pitch and yaw after a rotation.

        The yaw changes by its angle from the heading at the beginning, so that a vehicle that does not turn keeps it to
        the bit.
        """
        angles = BodyAxes._make(self.tilt.in_heading(axis) for axis in coordinates.axes()).angles()
        return angles._replace(yaw=self.beginning.yaw + angles.yaw)

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
