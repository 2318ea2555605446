"""Estimate of an error-state Kalman filter, and its prediction with an inertial measurement unit.

The filter stores an estimate, and the covariance of 15 small errors of this estimate. The estimate consists of the
position p, the velocity v, the attitude R, and the biases b_g and b_a of gyroscope and accelerometer. The error of the
attitude is a rotation vector δθ along the axes of W:

    p_true = p + δp,   v_true = v + δv,   R_true = exp([δθ]×) R,   b_true = b + δb

(J. Solà, "Quaternion kinematics for the error-state Kalman filter", arXiv 1711.02508, 2017, chapters 5 and 7; chapter 7
treats errors along the axes of W). With this choice, the transition matrix contains an identity block for the attitude,
and the yaw error of a hovering vehicle is a single component, δθ_z.
"""

from typing import Annotated, NamedTuple

from drake_quad.geometry.axes import BodyAxes, Vector, cross, minus, plus, times
from drake_quad.geometry.quaternion import NO_ROTATION, Quaternion
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


class InertialIncrement(NamedTuple):
    """Motion over successive samples of the inertial measurement unit, relative to the state at the first sample.

    The integrals exclude gravity, and are expressed along the axes that the body has at the first sample (C. Forster
    et al., "On-manifold preintegration", IEEE Transactions on Robotics 33, 2017, section VI). Only the biases of the
    estimate affect them.

    Attributes:
        duration: sum of the sampling periods.
        rotation: rotation from the axes of the body at the end to its axes at the beginning.
        velocity: integral of the specific force, m/s.
        position: integral of `velocity`, m.
        rotations: integral of the matrix of `rotation`, s.
        gyroscope_bias: bias that was subtracted from the readings of the gyroscope, rad/s.
        accelerometer_bias: bias that was subtracted from the readings of the accelerometer, m/s².
        first_rates: first reading of the gyroscope.
    """

    duration: Time
    rotation: Quaternion
    velocity: Vector
    position: Vector
    rotations: BodyAxes
    gyroscope_bias: Vector
    accelerometer_bias: Vector
    first_rates: BodyRates


_ZERO = Vector(0.0, 0.0, 0.0)
NO_INCREMENT = InertialIncrement(
    0.0, NO_ROTATION, _ZERO, _ZERO, BodyAxes(_ZERO, _ZERO, _ZERO), _ZERO, _ZERO, BodyRates(0.0, 0.0, 0.0)
)


def extend_increment(
    increment: InertialIncrement, gyroscope: BodyRates, accelerometer: Vector, period: float
) -> InertialIncrement:
    """Return an increment with one more sample of the inertial measurement unit.

    Body rates and specific force along the axes of B are assumed to be constant over a sample. The force is transformed
    with the attitude in the middle of the sample, since the attitude at its start would cause an error of first order
    in h.

    Args:
        increment: increment before the sample.
        gyroscope: reading of the gyroscope.
        accelerometer: reading of the accelerometer along the axes of B, m/s².
        period: sampling period h, s.
    """
    rates = minus(Vector(*gyroscope), increment.gyroscope_bias)
    half_turn = Quaternion.of_rotation(times(0.5 * period, rates))
    middle = increment.rotation.times(half_turn)
    axes = middle.axes()
    change = times(period, axes.in_world(minus(accelerometer, increment.accelerometer_bias)))
    velocity = plus(increment.velocity, change)
    sums = zip(increment.rotations, axes, strict=True)
    return increment._replace(
        duration=increment.duration + period,
        rotation=middle.times(half_turn).normalised(),
        velocity=velocity,
        position=plus(increment.position, times(0.5 * period, plus(increment.velocity, velocity))),
        rotations=BodyAxes._make(plus(integral, times(period, axis)) for integral, axis in sums),
    )


def correct_increment_biases(increment: InertialIncrement, estimate: Estimate) -> InertialIncrement:
    """Return an increment, corrected for the difference between its biases and those of an estimate.

    The correction is linear in this difference, like the propagation of the covariance.
    """
    turn = increment.rotations.in_world(minus(increment.gyroscope_bias, estimate.gyroscope_bias))
    force = increment.rotations.in_world(minus(increment.accelerometer_bias, estimate.accelerometer_bias))
    return increment._replace(
        rotation=Quaternion.of_rotation(turn).times(increment.rotation),
        velocity=plus(increment.velocity, force),
        gyroscope_bias=estimate.gyroscope_bias,
        accelerometer_bias=estimate.accelerometer_bias,
    )


def predict(estimate: Estimate, increment: InertialIncrement, gravity: Annotated[Row, Quantity("m/s²")]) -> Estimate:
    """Return the estimate at the end of an increment, given the estimate at its beginning."""
    axes, time = estimate.attitude.axes(), increment.duration
    change, way = axes.in_world(increment.velocity), axes.in_world(increment.position)
    fall = time * gravity
    way = plus(plus(way, times(time, estimate.velocity)), Vector(0.0, 0.0, -0.5 * time * fall))
    return estimate._replace(
        position=plus(estimate.position, way),
        velocity=plus(estimate.velocity, change._replace(z=change.z - fall)),
        attitude=estimate.attitude.times(increment.rotation).normalised(),
    )


def add_error(estimate: Estimate, error: ErrorState) -> Estimate:
    """Return an estimate after an estimated error has been added to it.

    The covariance is not changed, since its rotation by half of the error's angle (Solà, section 7.2) is an effect of
    second order.
    """
    return Estimate(
        plus(estimate.position, error.position),
        plus(estimate.velocity, error.velocity),
        Quaternion.of_rotation(error.rotation).times(estimate.attitude).normalised(),
        plus(estimate.gyroscope_bias, error.gyroscope_bias),
        plus(estimate.accelerometer_bias, error.accelerometer_bias),
    )


def state_of(estimate: Estimate, gyroscope: BodyRates, imu: Vector | None = None) -> State:
    """Return the estimated state of the vehicle. The body rates are a reading of the gyroscope minus its bias.

    Args:
        estimate: estimate of the inertial measurement unit.
        gyroscope: reading of the gyroscope.
        imu: position of the inertial measurement unit relative to the centre of mass, m; None if it is at the centre of
            mass.
    """
    axes, position, velocity = estimate.attitude.axes(), estimate.position, estimate.velocity
    rates = minus(Vector(*gyroscope), estimate.gyroscope_bias)
    if imu is not None:
        position = minus(position, axes.in_world(imu))
        velocity = minus(velocity, axes.in_world(cross(rates, imu)))
    return State(*position, *axes.angles(), *velocity, *rates)
