"""Accelerometer: measurement of the specific force at the position of the sensor.

The specific force is the sum of all forces on the vehicle except for its weight, divided by its mass:

    f = R_WBᵀ (a + g z) + ω̇ × r + ω × (ω × r) + b + σ n

with the acceleration a of the origin of B, the body rates ω, the position r of the sensor in B, a bias b, and standard
normal n (D. H. Titterton and J. L. Weston, "Strapdown Inertial Navigation Technology", 2nd edition, 2004, chapter 3).
The reading is g upwards at rest, and zero in free fall. At the centre of mass of a quadrotor without drag, it
contains only the thrust, at any tilt (P. Martin and E. Salaün, "The true role of accelerometer feedback in quadrotor
control", ICRA 2010).
"""

from typing import Annotated, NamedTuple

from drake_quad.geometry.axes import BodyAxes, Vector, cross, plus
from drake_quad.laboratory.sensors.sensor import SensorLaw
from drake_quad.signals import AccelerationB, Number, Quantity, Row, State, VehicleAcceleration


class SpecificForce(NamedTuple):
    """Specific force (all forces except for the weight, divided by the mass), or its measurement error."""

    x: AccelerationB
    y: AccelerationB
    z: AccelerationB


class SensorPosition(NamedTuple):
    """Position of a sensor relative to the centre of mass."""

    x: Annotated[Row, Quantity("m", "B")] = 0.0
    y: Annotated[Row, Quantity("m", "B")] = 0.0
    z: Annotated[Row, Quantity("m", "B")] = 0.0


class AccelerometerParameters(NamedTuple):
    """Position and errors of an accelerometer.

    Attributes:
        position: position of the sensor.
        gravity: gravitational acceleration g.
        bias: constant error of the readings.
        noise: standard deviation of the noise of a reading on each axis.
        latency_samples: latency, a whole number of periods.
    """

    position: SensorPosition = SensorPosition()
    gravity: Annotated[Row, Quantity("m/s²")] = 9.81
    bias: SpecificForce = SpecificForce(0.0, 0.0, 0.0)
    noise: Annotated[Row, Quantity("m/s²", sign="nonnegative")] = 0.0
    latency_samples: Number = 0.0


def specific_force(
    state: State, acceleration: VehicleAcceleration, sensor_position: SensorPosition, gravity: Row
) -> Vector:
    """Return the specific force at a point of the vehicle along the axes of B, m/s²."""
    axes, position = BodyAxes.of(state.roll, state.pitch, state.yaw), Vector(*sensor_position)
    rates = Vector(state.p, state.q, state.r)
    angular_acceleration = Vector(acceleration.p_rate, acceleration.q_rate, acceleration.r_rate)
    at_centre = axes.in_body(Vector(acceleration.a_x, acceleration.a_y, acceleration.a_z + gravity))
    return plus(at_centre, plus(cross(angular_acceleration, position), cross(rates, cross(rates, position))))


def accelerometer_reading(
    parameters: AccelerometerParameters, noise: SpecificForce | None, state: State, acceleration: VehicleAcceleration
) -> SpecificForce:
    """Return a reading of an accelerometer with bias, and with noise unless `noise` is None."""
    force = specific_force(state, acceleration, parameters.position, parameters.gravity)
    components = [true + bias for true, bias in zip(force, parameters.bias, strict=True)]
    if noise is not None:
        components = [value + parameters.noise * number for value, number in zip(components, noise, strict=True)]
    return SpecificForce(*components)


ACCELEROMETER = SensorLaw(SpecificForce, accelerometer_reading, ("state", "acceleration"))
"""Measurement equation of an accelerometer."""
