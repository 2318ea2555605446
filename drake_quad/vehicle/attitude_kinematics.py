"""Attitude kinematics: rates of the attitude angles, and integration of the attitude over a time step.

Ports and states contain roll, pitch and yaw, whose rates are infinite at a pitch of 90°. A time step therefore
integrates a quaternion ε without singularity, the rotation relative to the start of the step:

    R_WB(t) = R_WB(0) R(ε),    ε̇ = ½ ε ∘ (0, p, q, r),    ε(0) = 1

R(ε) omits the division by |ε|², which is 1 up to the integration error. At the end of the step, the rotation is
converted back to angles:

- The pitch is between -90° and 90°. The roll is between -180° and 180° if it was in this range at the start.
- The yaw is not wrapped: a step changes the yaw by at most 180°, and the yaw of a vehicle that flies in circles grows
  beyond 180°.
- At a pitch of ±90° the rotation determines only the sum or the difference of roll and yaw. The yaw is then arbitrary,
  and the roll is chosen such that the three angles reproduce the rotation up to rounding.

When a vehicle pitches over, roll and yaw jump by 180°, but the rotation is continuous.

Eq (3) of the paper replaces the rates of roll, pitch and yaw by p, q, r. These small-angle kinematics have no
singularity, and a step integrates the angles themselves.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

from drake_quad.framework.elementary import arcsin, arctan, lazy_where
from drake_quad.geometry.axes import TINY_COSINE, BodyAxes, Tilt
from drake_quad.geometry.kinematics import angle_rates
from drake_quad.geometry.quaternion import NO_ROTATION, Quaternion
from drake_quad.signals import Attitude, BodyRates, Row


class IntegratedAttitude(Protocol):
    """Attitude of a vehicle over a time step, in the coordinates that the step integrates."""

    @property
    def start(self) -> Any:
        """Record of the attitude's coordinates at the start of an integration step."""

    def axes(self, coordinates: Any) -> BodyAxes:
        """Return the axes of B in W for the given attitude coordinates."""

    def rates(self, coordinates: Any, body_rates: BodyRates) -> Any:
        """Return the time derivatives of the attitude's coordinates, 1/s."""

    def attitude(self, coordinates: Any) -> Attitude:
        """Return roll, pitch and yaw for the given attitude coordinates, rad."""


class AttitudeKinematics(NamedTuple):
    """Kinematics of the attitude.

    Attributes:
        angle_rates: function that returns the rates of roll, pitch and yaw (rad/s), given the body rates and the
            attitude.
        integrated: function that returns the attitude over a step, given the attitude at the start of the step.
    """

    angle_rates: Callable[[BodyRates, Attitude], Attitude]
    integrated: Callable[[Attitude], IntegratedAttitude]


_MAX_TANGENT = 0.125  # largest argument for which the polynomial of `arctan(small=True)` is accurate
_MAX_SINE = 0.5  # largest argument for which the polynomial of `arcsin(small=True)` is accurate


class IntegratedQuaternion(NamedTuple):
    """Attitude over a time step, as the rotation relative to the start of the step.

    Attributes:
        initial_attitude: attitude at the start of the step.
        tilt: sines and cosines of roll and pitch at the start of the step.
        initial_axes: axes of B in W at the start of the step.
    """

    initial_attitude: Attitude
    tilt: Tilt
    initial_axes: BodyAxes

    @classmethod
    def of(cls, attitude: Attitude) -> "IntegratedQuaternion":
        """Return the attitude over a step that starts at the given attitude."""
        return cls(attitude, Tilt.of(attitude.roll, attitude.pitch), BodyAxes.of(*attitude))

    @property
    def start(self) -> Quaternion:
        """Quaternion of the identity rotation."""
        return NO_ROTATION

    def axes(self, coordinates: Quaternion) -> BodyAxes:
        """Return the axes of B in W, given the rotation since the start of the integration step."""
        if coordinates is NO_ROTATION:
            return self.initial_axes
        return BodyAxes._make(self.initial_axes.in_world(axis) for axis in coordinates.axes())

    def rates(self, coordinates: Quaternion, body_rates: BodyRates) -> Quaternion:
        """Return the time derivative of the quaternion, 1/s."""
        return coordinates.rates(body_rates)

    def attitude(self, coordinates: Quaternion) -> Attitude:
        """Return roll, pitch and yaw after a rotation from the start of the step.

        The yaw is the sum of the yaw at the start and the change of heading, so that the yaw of a vehicle that does not
        turn remains exactly constant. If the roll changes by less than 7°, as is usual, the roll is also computed as a
        sum of initial value and change. If in addition the pitch is below 30°, polynomials replace the costlier
        functions for arbitrary angles; the results agree up to rounding.
        """
        tilt, before = self.tilt, self.initial_attitude
        x, y, z = (tilt.in_heading(axis) for axis in coordinates.axes())
        sin_pitch = 0.0 - x.z
        # The sine and cosine of the change of roll are both multiplied by the cosine of the pitch.
        sine = tilt.cos_roll * y.z - tilt.sin_roll * z.z
        cosine = tilt.cos_roll * z.z + tilt.sin_roll * y.z
        usual = Attitude(
            before.roll + arctan(sine / (cosine + TINY_COSINE), small=True),
            arcsin(sin_pitch, small=True),
            arctan(x.y / (x.x + TINY_COSINE), small=True),
        )
        upside_down = z.z < 0.0  # the roll of such a vehicle may pass 180°
        large = upside_down | (abs(sine) > _MAX_TANGENT * cosine) | (abs(x.y) > _MAX_TANGENT * x.x)
        unusual = large | (abs(sin_pitch) > _MAX_SINE)
        in_heading = lazy_where(unusual, _angles_in_heading, (*tilt, *coordinates), usual)
        return in_heading._replace(yaw=before.yaw + in_heading.yaw)


def _angles_in_heading(
    sin_roll: Row, cos_roll: Row, sin_pitch: Row, cos_pitch: Row, w: Row, x: Row, y: Row, z: Row
) -> Attitude:
    """Return the angles in the heading frame after a rotation, given the initial tilt and the quaternion."""
    tilt = Tilt(sin_roll, cos_roll, sin_pitch, cos_pitch)
    return BodyAxes._make(tilt.in_heading(axis) for axis in Quaternion(w, x, y, z).axes()).angles()


RIGID_KINEMATICS = AttitudeKinematics(angle_rates, IntegratedQuaternion.of)
"""Kinematics of a rigid body, eq (2) of the paper."""


class IntegratedAngles(NamedTuple):
    """Attitude over a time step, as roll, pitch and yaw under small-angle kinematics.

    Attributes:
        start: angles at the start of the step.
    """

    start: Attitude

    def axes(self, coordinates: Attitude) -> BodyAxes:
        """Return the axes of B in W for the given attitude coordinates."""
        return BodyAxes.of(*coordinates)

    def rates(self, coordinates: Attitude, body_rates: BodyRates) -> Attitude:
        """Return the rates of roll, pitch and yaw, rad/s."""
        return Attitude(*body_rates)

    def attitude(self, coordinates: Attitude) -> Attitude:
        """Return roll, pitch and yaw, which are the coordinates themselves, rad."""
        return coordinates


def _angle_rates_of(body_rates: BodyRates, attitude: Attitude) -> Attitude:
    """Return the body rates as rates of roll, pitch and yaw, which is accurate for small angles."""
    return Attitude(*body_rates)


SMALL_ANGLE_KINEMATICS = AttitudeKinematics(_angle_rates_of, IntegratedAngles)
"""Small-angle kinematics of eq (3) of the paper, in which p, q, r are the rates of roll, pitch and yaw."""
