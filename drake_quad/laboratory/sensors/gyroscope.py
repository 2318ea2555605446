"""Gyroscope: measurement of the body rates.

    reading = ω + b + σ n

with the body rates ω, a bias b, and standard normal n. `drake_quad.laboratory.sensors.inertial` describes further
errors. The body is rigid, so a gyroscope measures the same rates at every position, even while the rotors make the body
vibrate.
"""

from typing import Annotated, NamedTuple

from drake_quad.geometry.axes import Vector
from drake_quad.laboratory.sensors.inertial import (
    InertialErrors,
    InertialMemory,
    InertialNoise,
    first_memory,
    inertial_noise,
    next_memory,
    with_inertial_errors,
)
from drake_quad.laboratory.sensors.sensor import SensorLaw, SensorMemory
from drake_quad.laboratory.sensors.vibration import vibration_rate
from drake_quad.signals import BodyRates, Number, Quantity, RotorSpeed, Row, State


class GyroscopeParameters(NamedTuple):
    """Errors of a gyroscope.

    Attributes:
        bias: constant error of the readings.
        noise: standard deviation of the noise of a reading on each axis.
        latency_samples: latency, a whole number of periods.
        errors: errors that can be switched off.
    """

    bias: BodyRates = BodyRates(0.0, 0.0, 0.0)
    noise: Annotated[Row, Quantity("rad/s", sign="nonnegative")] = 0.0
    latency_samples: Number = 0.0
    errors: InertialErrors = InertialErrors()


def _rates(state: State) -> Vector:
    return Vector(state.p, state.q, state.r)


def first_gyroscope_memory(
    parameters: GyroscopeParameters, noise: InertialNoise | None, state: State, rotor_speed: RotorSpeed | None
) -> InertialMemory:
    """Return the internal state of a gyroscope at its first reading."""
    return first_memory(parameters.errors, noise, _rates(state), rotor_speed)


def next_gyroscope_memory(
    parameters: GyroscopeParameters,
    noise: InertialNoise | None,
    memory: InertialMemory,
    state: State,
    rotor_speed: RotorSpeed | None,
) -> InertialMemory:
    """Return the internal state of the sensor at the next reading; `memory` is the state at the previous reading."""
    return next_memory(parameters.errors, noise, memory, _rates(state), rotor_speed)


def gyroscope_reading(
    parameters: GyroscopeParameters,
    noise: InertialNoise | None,
    memory: InertialMemory,
    state: State,
    rotor_speed: RotorSpeed | None,
) -> BodyRates:
    """Return a reading of a gyroscope, with noise unless `noise` is None."""
    vibration = None
    if parameters.errors.vibration is not None and memory.phases is not None:
        low_pass = parameters.errors.bandwidth
        bandwidth = None if low_pass is None else low_pass.bandwidth
        vibration = vibration_rate(parameters.errors.vibration, memory.phases, bandwidth)
    return BodyRates(*with_inertial_errors(parameters, noise, memory, _rates(state), vibration))


GYROSCOPE = SensorLaw(
    BodyRates,
    gyroscope_reading,
    ("state",),
    errors_that_read=(("vibration", "rotor_speed"),),
    memory=SensorMemory(first_gyroscope_memory, next_gyroscope_memory),
    noise=inertial_noise,
)
"""Measurement law of a gyroscope."""
