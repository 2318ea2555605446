"""Accelerometer: measurement of the specific force at the position of the sensor.

The specific force is the sum of all forces on the vehicle except for its weight, divided by its mass:

    f = R_WBᵀ (a + g z) + ω̇ × r + ω × (ω × r) + b + σ n

with the acceleration a of the origin of B, the body rates ω, the position r of the sensor in B, a bias b, and standard
normal n (D. H. Titterton and J. L. Weston, "Strapdown Inertial Navigation Technology", 2nd edition, 2004, chapter 3).
The reading is g upwards at rest, and zero in free fall. At the centre of mass of a quadrotor without drag, it
contains only the thrust, at any tilt (P. Martin and E. Salaün, "The true role of accelerometer feedback in quadrotor
control", ICRA 2010). `drake_quad.laboratory.sensors.inertial` describes further errors.
"""

from typing import Annotated, NamedTuple

from drake_quad.geometry.axes import BodyAxes, Vector, cross, plus
from drake_quad.laboratory.sensors.inertial import (
    InertialErrors,
    InertialMemory,
    InertialNoise,
    first_memory,
    inertial_noise,
    next_memory,
    with_inertial_errors,
)
from drake_quad.laboratory.sensors.mounting import SensorPosition
from drake_quad.laboratory.sensors.sensor import SensorLaw, SensorMemory
from drake_quad.laboratory.sensors.vibration import vibration_force
from drake_quad.signals import AccelerationB, Number, Quantity, RotorSpeed, Row, State, VehicleAcceleration


class SpecificForce(NamedTuple):
    """Specific force (all forces except for the weight, divided by the mass), or its measurement error."""

    x: AccelerationB
    y: AccelerationB
    z: AccelerationB


class AccelerometerParameters(NamedTuple):
    """Position and errors of an accelerometer.

    Attributes:
        position: position of the sensor.
        gravity: gravitational acceleration g.
        bias: constant error of the readings.
        noise: standard deviation of the noise of a reading on each axis.
        latency_samples: latency, a whole number of periods.
        errors: errors that can be switched off.
    """

    position: SensorPosition = SensorPosition()
    gravity: Annotated[Row, Quantity("m/s²")] = 9.81
    bias: SpecificForce = SpecificForce(0.0, 0.0, 0.0)
    noise: Annotated[Row, Quantity("m/s²", sign="nonnegative")] = 0.0
    latency_samples: Number = 0.0
    errors: InertialErrors = InertialErrors()


def specific_force(
    state: State, acceleration: VehicleAcceleration, sensor_position: SensorPosition, gravity: Row
) -> Vector:
    """Return the specific force at a point of the vehicle along the axes of B, m/s²."""
    axes, position = BodyAxes.of(state.roll, state.pitch, state.yaw), Vector(*sensor_position)
    rates = Vector(state.p, state.q, state.r)
    angular_acceleration = Vector(acceleration.p_rate, acceleration.q_rate, acceleration.r_rate)
    at_centre = axes.in_body(Vector(acceleration.a_x, acceleration.a_y, acceleration.a_z + gravity))
    return plus(at_centre, plus(cross(angular_acceleration, position), cross(rates, cross(rates, position))))


def first_accelerometer_memory(
    parameters: AccelerometerParameters,
    noise: InertialNoise | None,
    state: State,
    acceleration: VehicleAcceleration,
    rotor_speed: RotorSpeed | None,
) -> InertialMemory:
    """Return the internal state of an accelerometer at its first reading."""
    force = specific_force(state, acceleration, parameters.position, parameters.gravity)
    return first_memory(parameters.errors, noise, force, rotor_speed)


def next_accelerometer_memory(
    parameters: AccelerometerParameters,
    noise: InertialNoise | None,
    memory: InertialMemory,
    state: State,
    acceleration: VehicleAcceleration,
    rotor_speed: RotorSpeed | None,
) -> InertialMemory:
    """Return the internal state of the sensor at the next reading; `memory` is the state at the previous reading."""
    force = specific_force(state, acceleration, parameters.position, parameters.gravity)
    return next_memory(parameters.errors, noise, memory, force, rotor_speed)


def accelerometer_reading(
    parameters: AccelerometerParameters,
    noise: InertialNoise | None,
    memory: InertialMemory,
    state: State,
    acceleration: VehicleAcceleration,
    rotor_speed: RotorSpeed | None,
) -> SpecificForce:
    """Return a reading of an accelerometer, with noise unless `noise` is None."""
    force = specific_force(state, acceleration, parameters.position, parameters.gravity)
    vibration = None
    if parameters.errors.vibration is not None and memory.phases is not None:
        low_pass = parameters.errors.bandwidth
        bandwidth = None if low_pass is None else low_pass.bandwidth
        vibration = vibration_force(parameters.errors.vibration, memory.phases, bandwidth)
    return SpecificForce(*with_inertial_errors(parameters, noise, memory, force, vibration))


ACCELEROMETER = SensorLaw(
    SpecificForce,
    accelerometer_reading,
    ("state", "acceleration"),
    errors_that_read=(("vibration", "rotor_speed"),),
    memory=SensorMemory(first_accelerometer_memory, next_accelerometer_memory),
    noise=inertial_noise,
)
"""Measurement law of an accelerometer."""
