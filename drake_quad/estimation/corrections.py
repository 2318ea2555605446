"""Measurement equations of an error-state Kalman filter, which convert readings of sensors to scalar measurements.

Each measurement equation compares a reading with an estimate. It returns the innovations, and the derivatives of the
predicted values with respect to the errors of the estimate. A rotation by the error δθ changes a vector a, which is
fixed to the body, by δθ × a. A quantity with the gradient g with respect to a therefore has the derivative a × g with
respect to δθ.

The equations apply to a sensor at the position of the inertial measurement unit, which is the estimated position.
`measurements_at` extends them to other positions on the vehicle.
"""

from collections.abc import Callable
from typing import Annotated, Any, NamedTuple

from drake_quad.estimation.covariance import ScalarMeasurement
from drake_quad.estimation.estimate import ErrorState, Estimate
from drake_quad.framework.elementary import arctan2, maximum, wrap_angle
from drake_quad.geometry.axes import TINY, Vector, cross, dot, length, minus, plus, times
from drake_quad.geometry.quaternion import Quaternion
from drake_quad.signals import Angle, Attitude, BodyRates, PositionW, Quantity, Row, State

_Length = Annotated[Row, Quantity("m", sign="positive")]
_Speed = Annotated[Row, Quantity("m/s", sign="positive")]
_AngleDeviation = Annotated[Row, Quantity("rad", sign="positive")]
# Smaller divisors are replaced by these values, to avoid a division by zero.
_MIN_COSINE = 0.1  # smallest divisor for the cosine of the tilt
_MIN_DISTANCE = 0.02  # m, smallest divisor for the distance to the ground

_NONE: Any = None
_NO_ERRORS = ErrorState(_NONE, _NONE, _NONE, _NONE, _NONE)
# Derivatives of each component of a vector with respect to the vector; None stands for zero.
_UNIT_VECTORS = Vector(1.0, _NONE, _NONE), Vector(_NONE, 1.0, _NONE), Vector(_NONE, _NONE, 1.0)


class PositionAiding(NamedTuple):
    """Standard deviations of a measured position along X, Y and Z of W."""

    x: _Length
    y: _Length
    z: _Length


class VelocityAiding(NamedTuple):
    """Standard deviations of a measured velocity along X, Y and Z of W."""

    x: _Speed
    y: _Speed
    z: _Speed


class FixAiding(NamedTuple):
    """Standard deviations of a measured position and velocity."""

    position: PositionAiding
    velocity: VelocityAiding


class HeightAiding(NamedTuple):
    """Standard deviation of a measured height."""

    height: _Length


class YawAiding(NamedTuple):
    """Standard deviation of a measured yaw."""

    yaw: _AngleDeviation


class AttitudeAiding(NamedTuple):
    """Standard deviation of the rotation about each axis of a measured attitude."""

    rotation: _AngleDeviation


class PoseAiding(NamedTuple):
    """Standard deviations of a position and an attitude that motion capture measures."""

    position: PositionAiding
    attitude: AttitudeAiding


class MagneticAiding(NamedTuple):
    """Parameters of the measurement equation of a magnetometer.

    Attributes:
        heading: standard deviation of the measured direction of the horizontal field.
        field: magnetic field of the earth in W, in any unit.
    """

    heading: _AngleDeviation
    field: Vector


class GroundAiding(NamedTuple):
    """Parameters of the measurement equation of a range finder that points along -z of the body.

    Attributes:
        distance: standard deviation of the measured distance.
        ground: height of the ground in W.
    """

    distance: _Length
    ground: PositionW


class AnchorAiding(NamedTuple):
    """Parameters of the measurement equation of the distance to an anchor.

    Attributes:
        distance: standard deviation of the measured distance.
        anchor: position of the anchor in W, m.
    """

    distance: _Length
    anchor: Vector


class FlowAiding(NamedTuple):
    """Parameters of the measurement equation of an optical flow sensor that looks along -z of the body.

    Attributes:
        flow: standard deviation of the measured flow on each axis.
        ground: height of the ground in W.
    """

    flow: Annotated[Row, Quantity("rad/s", sign="positive")]
    ground: PositionW


class PositionAndVelocity(NamedTuple):
    """Measured position and velocity in W, in the same order as in a reading of satellite navigation."""

    position: Vector
    velocity: Vector


class SingleReading(NamedTuple):
    """Reading that is a single number."""

    value: Row


class FlowReading(NamedTuple):
    """Angular velocity of the ground in the image along x and y of B."""

    x: Annotated[Row, Quantity("rad/s", "B")]
    y: Annotated[Row, Quantity("rad/s", "B")]


class AidingLaw(NamedTuple):
    """Measurement equation of a type of aiding sensor.

    Attributes:
        reading: type of the readings.
        aiding: type of the parameters.
        formula: function of an estimate, a reading, the parameters and a reading of the gyroscope. It returns a tuple
            of scalar measurements.
        num_scalars: number of scalar measurements.
    """

    reading: Any
    aiding: Any
    formula: Callable[[Estimate, Any, Any, BodyRates], tuple[ScalarMeasurement, ...]]
    num_scalars: int


def measurements_at(
    lever: Vector | None, law: AidingLaw, estimate: Estimate, reading: Any, aiding: Any, gyroscope: BodyRates
) -> tuple[ScalarMeasurement, ...]:
    """Return the scalar measurements of a sensor at any position on the vehicle.

    The position and velocity of the sensor are p + a and v + b with a = R l and b = R (ω × l). The errors of the
    estimate change a by δθ × a, and b by δθ × b - R (δb_g × l).

    Args:
        lever: position l of the sensor relative to the inertial measurement unit, along the axes of B, m; None if both
            are at the same position.
        law: measurement equation.
        estimate: estimate of the inertial measurement unit.
        reading: reading of the sensor.
        aiding: parameters of the measurement equation.
        gyroscope: reading of the gyroscope.
    """
    if lever is None:
        return law.formula(estimate, reading, aiding, gyroscope)
    axes, rates = estimate.attitude.axes(), minus(Vector(*gyroscope), estimate.gyroscope_bias)
    arm, turning = axes.in_world(lever), axes.in_world(cross(rates, lever))
    at_sensor = estimate._replace(position=plus(estimate.position, arm), velocity=plus(estimate.velocity, turning))
    measurements = []
    for measurement in law.formula(at_sensor, reading, aiding, gyroscope):
        derivatives = measurement.derivatives
        rotation, bias = derivatives.rotation, derivatives.gyroscope_bias
        if derivatives.position is not None:
            rotation = _sum(rotation, cross(arm, _dense(derivatives.position)))
        if derivatives.velocity is not None:
            velocity = _dense(derivatives.velocity)
            rotation = _sum(rotation, cross(turning, velocity))
            bias = _sum(bias, cross(axes.in_body(velocity), lever))
        measurements.append(
            measurement._replace(derivatives=derivatives._replace(rotation=rotation, gyroscope_bias=bias))
        )
    return tuple(measurements)


def _dense(derivatives: Vector) -> Vector:
    """Return derivatives with zeros in place of None."""
    return Vector._make(0.0 if each is None else each for each in derivatives)


def _sum(derivatives: Vector | None, others: Vector) -> Vector:
    return others if derivatives is None else plus(_dense(derivatives), others)


def position_measurements(
    estimate: Estimate, reading: Vector, aiding: PositionAiding, _: BodyRates
) -> tuple[ScalarMeasurement, ...]:
    """Return the measurements of a position in W, m."""
    rows = zip(minus(reading, estimate.position), _UNIT_VECTORS, aiding, strict=True)
    return tuple([ScalarMeasurement(each, _NO_ERRORS._replace(position=unit), size) for each, unit, size in rows])


def velocity_measurements(
    estimate: Estimate, reading: Vector, aiding: VelocityAiding, _: BodyRates
) -> tuple[ScalarMeasurement, ...]:
    """Return the measurements of a velocity in W, m/s."""
    rows = zip(minus(reading, estimate.velocity), _UNIT_VECTORS, aiding, strict=True)
    return tuple(
        [ScalarMeasurement(each, _NO_ERRORS._replace(velocity=unit), size, "velocity") for each, unit, size in rows]
    )


def fix_measurements(
    estimate: Estimate, reading: PositionAndVelocity, aiding: FixAiding, gyroscope: BodyRates
) -> tuple[ScalarMeasurement, ...]:
    """Return the measurements of a position and a velocity in W."""
    return (
        *position_measurements(estimate, reading.position, aiding.position, gyroscope),
        *velocity_measurements(estimate, reading.velocity, aiding.velocity, gyroscope),
    )


def height_measurements(
    estimate: Estimate, reading: SingleReading, aiding: HeightAiding, _: BodyRates
) -> tuple[ScalarMeasurement, ...]:
    """Return the measurement of a height in W, m."""
    derivatives = _NO_ERRORS._replace(position=_UNIT_VECTORS[2])
    return (ScalarMeasurement(reading.value - estimate.position.z, derivatives, aiding.height),)


def yaw_measurements(
    estimate: Estimate, reading: SingleReading, aiding: YawAiding, _: BodyRates
) -> tuple[ScalarMeasurement, ...]:
    """Return the measurement of a yaw, rad."""
    ahead = estimate.attitude.axes().x
    innovation = wrap_angle(reading.value - arctan2(ahead.y, ahead.x))
    return (
        ScalarMeasurement(
            innovation, _NO_ERRORS._replace(rotation=_heading_derivatives(ahead)), aiding.yaw, "rotation"
        ),
    )


def attitude_measurements(
    estimate: Estimate, reading: Attitude, aiding: AttitudeAiding, _: BodyRates
) -> tuple[ScalarMeasurement, ...]:
    """Return the measurements of an attitude."""
    rotation = estimate.attitude.relative_rotation_vector(Quaternion.of(*reading))
    rows = zip(estimate.attitude.axes().in_world(rotation), _UNIT_VECTORS, strict=True)
    return tuple(
        [
            ScalarMeasurement(each, _NO_ERRORS._replace(rotation=unit), aiding.rotation, "rotation")
            for each, unit in rows
        ]
    )


def pose_measurements(
    estimate: Estimate, reading: State, aiding: PoseAiding, gyroscope: BodyRates
) -> tuple[ScalarMeasurement, ...]:
    """Return the measurements of position and attitude of a measured state; its velocity and rates are not used."""
    position, attitude = Vector(reading.x, reading.y, reading.z), Attitude(reading.roll, reading.pitch, reading.yaw)
    return (
        *position_measurements(estimate, position, aiding.position, gyroscope),
        *attitude_measurements(estimate, attitude, aiding.attitude, gyroscope),
    )


def magnetic_measurements(
    estimate: Estimate, reading: Vector, aiding: MagneticAiding, _: BodyRates
) -> tuple[ScalarMeasurement, ...]:
    """Return the measurement of the direction of the horizontal magnetic field.

    The derivatives are computed from the known field of the earth and not from the reading. Otherwise, they would
    contain the same noise as the innovation, and this correlation would tilt the estimate.

    Args:
        estimate: estimate at the time of the reading.
        reading: reading of the magnetometer, along the axes of B.
        aiding: parameters of the measurement equation.
    """
    measured, field = estimate.attitude.axes().in_world(reading), aiding.field
    innovation = wrap_angle(arctan2(field.y, field.x) - arctan2(measured.y, measured.x))
    derivatives = _NO_ERRORS._replace(rotation=_heading_derivatives(field))
    return (ScalarMeasurement(innovation, derivatives, aiding.heading, "rotation"),)


def ground_measurements(
    estimate: Estimate, reading: SingleReading, aiding: GroundAiding, _: BodyRates
) -> tuple[ScalarMeasurement, ...]:
    """Return the measurement of the distance to a horizontal ground along -z of B, m."""
    distance, by_height, by_rotation = _distance_to_ground(estimate, aiding.ground)
    derivatives = _NO_ERRORS._replace(position=Vector(_NONE, _NONE, by_height), rotation=by_rotation._replace(z=_NONE))
    return (ScalarMeasurement(reading.value - distance, derivatives, aiding.distance),)


def anchor_measurements(
    estimate: Estimate, reading: SingleReading, aiding: AnchorAiding, _: BodyRates
) -> tuple[ScalarMeasurement, ...]:
    """Return the measurement of the distance to an anchor, m."""
    offset = minus(estimate.position, aiding.anchor)
    distance = length(offset)
    derivatives = _NO_ERRORS._replace(position=times(1.0 / distance, offset))
    return (ScalarMeasurement(reading.value - distance, derivatives, aiding.distance),)


def flow_measurements(
    estimate: Estimate, reading: FlowReading, aiding: FlowAiding, gyroscope: BodyRates
) -> tuple[ScalarMeasurement, ...]:
    """Return the measurements of the optical flow of a horizontal ground.

    The flow is v_x / d - q along x and v_y / d + p along y, with the velocity v along the axes of B, the distance d to
    the ground, and the body rates p and q. The noise of the gyroscope is neglected, because it is small compared with
    the noise of the flow.
    """
    axes = estimate.attitude.axes()
    distance, by_height, by_rotation = _distance_to_ground(estimate, aiding.ground)
    inverse = 1.0 / maximum(distance, _MIN_DISTANCE)
    rates = minus(Vector(*gyroscope), estimate.gyroscope_bias)
    measurements = []
    for flow, axis, turning, bias in (
        (reading.x, axes.x, -rates.y, Vector(_NONE, 1.0, _NONE)),
        (reading.y, axes.y, rates.x, Vector(-1.0, _NONE, _NONE)),
    ):
        translation = inverse * dot(axis, estimate.velocity)
        by_distance = -inverse * translation
        rotation = plus(times(inverse, cross(axis, estimate.velocity)), times(by_distance, by_rotation))
        derivatives = _NO_ERRORS._replace(
            position=Vector(_NONE, _NONE, by_distance * by_height),
            velocity=times(inverse, axis),
            rotation=rotation,
            gyroscope_bias=bias,
        )
        measurements.append(ScalarMeasurement(flow - (translation + turning), derivatives, aiding.flow, "velocity"))
    return tuple(measurements)


AIDING_LAWS = {
    "anchor_distance": AidingLaw(SingleReading, AnchorAiding, anchor_measurements, 1),
    "attitude": AidingLaw(Attitude, AttitudeAiding, attitude_measurements, 3),
    "fix": AidingLaw(PositionAndVelocity, FixAiding, fix_measurements, 6),
    "flow": AidingLaw(FlowReading, FlowAiding, flow_measurements, 2),
    "ground_distance": AidingLaw(SingleReading, GroundAiding, ground_measurements, 1),
    "height": AidingLaw(SingleReading, HeightAiding, height_measurements, 1),
    "magnetic_field": AidingLaw(Vector, MagneticAiding, magnetic_measurements, 1),
    "pose": AidingLaw(State, PoseAiding, pose_measurements, 6),
    "position": AidingLaw(Vector, PositionAiding, position_measurements, 3),
    "velocity": AidingLaw(Vector, VelocityAiding, velocity_measurements, 3),
    "yaw": AidingLaw(SingleReading, YawAiding, yaw_measurements, 1),
}
"""Measurement equations, keyed by the type of the reading."""


def _heading_derivatives(vector: Vector) -> Vector:
    """Return the derivatives, with respect to δθ, of the angle from X to the horizontal part of a vector in W."""
    x, y, z = vector
    slope = -z / (x * x + y * y + TINY)
    return Vector(slope * x, slope * y, 1.0)


def _distance_to_ground(estimate: Estimate, ground: PositionW) -> tuple[Row, Row, Vector]:
    """Return the distance to the ground along -z of B, and its derivatives with respect to height and rotation."""
    up = estimate.attitude.axes().z
    by_height = 1.0 / maximum(up.z, _MIN_COSINE)
    distance = (estimate.position.z - ground) * by_height
    slope = -distance * by_height
    return distance, by_height, Vector(slope * up.y, -slope * up.x, 0.0)


def attitude_from_accelerometer(accelerometer: Vector, yaw: Angle) -> Quaternion:
    """Return the attitude of a vehicle at rest with a given yaw, from a reading of its accelerometer."""
    x, y, z = accelerometer
    roll = arctan2(y, z)
    pitch = arctan2(0.0 - x, length(Vector(0.0, y, z)))
    return Quaternion.of(roll, pitch, yaw)
