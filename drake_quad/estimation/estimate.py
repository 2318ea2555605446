"""Estimate of an error-state Kalman filter, and its prediction with an inertial measurement unit.

The filter stores an estimate of position p, velocity v, attitude R and of the biases b_g and b_a of gyroscope and
accelerometer, and the covariance of 15 small errors of this estimate. The error of the attitude is a rotation vector δθ
along the axes of W:

    p_true = p + δp,   v_true = v + δv,   R_true = exp([δθ]×) R,   b_true = b + δb

(J. Solà, "Quaternion kinematics for the error-state Kalman filter", arXiv 1711.02508, 2017, chapters 5 and 7; chapter 7
is on errors along the axes of W). With these errors, the transition matrix contains an identity block for the attitude,
and an error of the yaw of a hovering vehicle is a single component, δθ_z.
"""

from typing import Annotated, NamedTuple

from drake_quad.geometry.axes import BodyAxes, Vector, minus, plus, times
from drake_quad.geometry.quaternion import Quaternion
from drake_quad.signals import BodyRates, Quantity, Row, State, Time


class Estimate(NamedTuple):
    """Estimated state of the vehicle and of its inertial measurement unit.

    Attributes:
        position: position in W, m.
        velocity: velocity in W, m/s.
        attitude: rotation from B to W.
        gyroscope_bias: constant error of the gyroscope along the axes of B, rad/s.
        accelerometer_bias: constant error of the accelerometer along the axes of B, m/s².
    """

    position: Vector
    velocity: Vector
    attitude: Quaternion
    gyroscope_bias: Vector
    accelerometer_bias: Vector


class ErrorState(NamedTuple):
    """Errors of an estimate, or derivatives of a quantity with respect to these errors.

    Attributes:
        position: error of the position in W, m.
        velocity: error of the velocity in W, m/s.
        rotation: error of the attitude as a rotation vector along the axes of W, rad.
        gyroscope_bias: error of the estimated bias of the gyroscope, rad/s.
        accelerometer_bias: error of the estimated bias of the accelerometer, m/s².
    """

    position: Vector
    velocity: Vector
    rotation: Vector
    gyroscope_bias: Vector
    accelerometer_bias: Vector


class Motion(NamedTuple):
    """Sums over the samples of the inertial measurement unit since the last propagation of the covariance.

    Attributes:
        duration: sum of the sampling periods.
        velocity_change: integral of the specific force in W, m/s.
        rotations: integral of the rotation matrix R_WB, s.
    """

    duration: Time
    velocity_change: Vector
    rotations: BodyAxes


_ZERO = Vector(0.0, 0.0, 0.0)
NO_MOTION = Motion(0.0, _ZERO, BodyAxes(_ZERO, _ZERO, _ZERO))


def predicted(
    estimate: Estimate,
    motion: Motion,
    gyroscope: BodyRates,
    accelerometer: Vector,
    gravity: Annotated[Row, Quantity("m/s²")],
    period: float,
) -> tuple[Estimate, Motion]:
    """Return the estimate one sample later, and the sums of the samples.

    Body rates and specific force along the axes of B are constant over a sample. The force is transformed to W with the
    attitude in the middle of the sample, because the error of the attitude at the start is of first order in h.

    Args:
        estimate: estimate at the time of the reading.
        motion: sums over earlier samples.
        gyroscope: reading of the gyroscope.
        accelerometer: reading of the accelerometer along the axes of B, m/s².
        gravity: gravitational acceleration.
        period: sampling period h, s.
    """
    rates = minus(Vector(*gyroscope), estimate.gyroscope_bias)
    half_turn = Quaternion.of_rotation(times(0.5 * period, rates))
    middle = estimate.attitude.times(half_turn)
    axes = middle.axes()
    change = times(period, axes.in_world(minus(accelerometer, estimate.accelerometer_bias)))
    velocity = plus(estimate.velocity, change._replace(z=change.z - period * gravity))
    position = plus(estimate.position, times(0.5 * period, plus(estimate.velocity, velocity)))
    sums = Motion(
        motion.duration + period,
        plus(motion.velocity_change, change),
        BodyAxes._make(plus(total, times(period, axis)) for total, axis in zip(motion.rotations, axes, strict=True)),
    )
    attitude = middle.times(half_turn).normalised()
    return estimate._replace(position=position, velocity=velocity, attitude=attitude), sums


def with_error(estimate: Estimate, error: ErrorState) -> Estimate:
    """Return an estimate to which an estimated error is added.

    The covariance is left unchanged: its rotation by half of the angle of the error (Solà, section 7.2) is of second
    order.
    """
    return Estimate(
        plus(estimate.position, error.position),
        plus(estimate.velocity, error.velocity),
        Quaternion.of_rotation(error.rotation).times(estimate.attitude).normalised(),
        plus(estimate.gyroscope_bias, error.gyroscope_bias),
        plus(estimate.accelerometer_bias, error.accelerometer_bias),
    )


def state_of(estimate: Estimate, gyroscope: BodyRates) -> State:
    """Return the estimated state of the vehicle, with the body rates of a reading of the gyroscope without its bias."""
    angles = estimate.attitude.axes().angles()
    rates = minus(Vector(*gyroscope), estimate.gyroscope_bias)
    return State(*estimate.position, *angles, *estimate.velocity, *rates)
