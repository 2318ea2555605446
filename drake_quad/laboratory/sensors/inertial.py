"""Errors of gyroscopes and accelerometers.

A sensor with three axes measures a vector y, an angular velocity or a specific force, at its position:

    reading = Q(clip((1 + s) R' y_f + v + b + d + w + c min(t / T, 1) + σ n))

- R is the orientation of the axes of the sensor in B, from the `misalignment`, and s the `scale_error` of each axis.
- y_f is y, filtered by the low pass ω_b / (s + ω_b) of the `bandwidth`. The filter is sampled exactly for a signal that
  changes linearly between two readings, so it delays a ramp by exactly 1 / ω_b.
- v is the `vibration` (`drake_quad.laboratory.sensors.vibration`), filtered in continuous time.
- b is the constant `bias`. Different values for each vehicle model the bias that varies between power-ups.
- d is the `bias_instability`, a stationary Gauss-Markov process on each axis.
- w is the `bias_random_walk`, which starts at zero and changes by K √h n in each period h.
- c is the change of the bias while the sensor warms up, linearly during the time T (`temperature_coefficient`).
- σ n is white noise. It is not filtered: σ is the standard deviation of the noise in a reading.
- The result is limited to the `full_scale` and rounded to a multiple of the `resolution`.

The Allan variance over the averaging time τ is (IEEE Std 952-1997, annex C)

    N² / τ                                                         white noise, N = σ √h
    2 B² T / τ (1 - T / 2τ (3 - 4 exp(-τ / T) + exp(-2τ / T)))     Gauss-Markov process with deviation B and time T
    K² τ / 3                                                       random walk
"""

import math
from typing import Any, NamedTuple

import numpy as np

from drake_quad.framework.elementary import maximum, minimum, nearest
from drake_quad.geometry.axes import BodyAxes, Vector, plus
from drake_quad.laboratory.sensors.gauss_markov import Correlation, stationary
from drake_quad.laboratory.sensors.vibration import RotorPhases, Vibration, first_phases, next_phases
from drake_quad.signals import Number, RotorSpeed, Row


class BiasInstability(NamedTuple):
    """Slowly varying part of the bias, a Gauss-Markov process.

    Attributes:
        deviation: standard deviation of the process on each axis, in the unit of the reading.
        correlation: correlation between successive readings.
    """

    deviation: Row
    correlation: Correlation


class WarmUp(NamedTuple):
    """Change of the bias while the sensor warms up.

    Attributes:
        change: change of the bias after the warm-up, in the unit of the reading.
        step: fraction of the warm-up that passes in a period.
    """

    change: Vector
    step: Number


class LowPass(NamedTuple):
    """Low-pass filter, sampled for a signal that changes linearly between two readings.

    Attributes:
        bandwidth: bandwidth ω_b, rad/s.
        decay: factor of the previous output.
        before: factor of the previous input.
        now: factor of the current input.
    """

    bandwidth: Row
    decay: Number
    before: Number
    now: Number

    @classmethod
    def of(cls, bandwidth: Row, period: float) -> "LowPass":
        """Return the filter for a bandwidth, rad/s, and a period, s; the bandwidth may be an array."""
        angle = bandwidth * period
        decay = np.exp(-angle)
        mean = -np.expm1(-angle) / angle
        return cls(bandwidth, decay, mean - decay, 1.0 - mean)


class InertialErrors(NamedTuple):
    """Errors that can be switched off; None for an error that is switched off.

    Attributes:
        scale_error: relative scale error of each axis.
        misalignment: orientation of the axes of the sensor in B.
        bandwidth: low-pass filter.
        bias_instability: Gauss-Markov process of the bias.
        bias_random_walk: standard deviation of the change of the bias in a period, in the unit of the reading.
        temperature_coefficient: change of the bias during warm-up.
        vibration: vibration of the rotors.
        full_scale: largest magnitude of a reading.
        resolution: smallest nonzero difference between two readings.
    """

    scale_error: Vector | None = None
    misalignment: BodyAxes | None = None
    bandwidth: LowPass | None = None
    bias_instability: BiasInstability | None = None
    bias_random_walk: Row | None = None
    temperature_coefficient: WarmUp | None = None
    vibration: Vibration | None = None
    full_scale: Row | None = None
    resolution: Row | None = None


class InertialNoise(NamedTuple):
    """Standard normal samples for a reading.

    Attributes:
        white: samples for the white noise.
        bias_instability: samples for the Gauss-Markov process.
        bias_random_walk: samples for the random walk.
    """

    white: Any
    bias_instability: Vector | None
    bias_random_walk: Vector | None


class FilterMemory(NamedTuple):
    """Input and output of a low-pass filter at a reading."""

    before: Vector
    output: Vector


class InertialMemory(NamedTuple):
    """Internal state of an inertial sensor; None for an error that is switched off.

    Attributes:
        bias_instability: value of the Gauss-Markov process.
        bias_random_walk: value of the random walk.
        warm_up: completed fraction of the warm-up.
        filter: input and output of the low-pass filter.
        phases: phases of the rotors.
    """

    bias_instability: Vector | None
    bias_random_walk: Vector | None
    warm_up: Number | None
    filter: FilterMemory | None
    phases: RotorPhases | None


_ZERO = Vector(0.0, 0.0, 0.0)


def inertial_noise(parameters: Any) -> InertialNoise:
    """Return a noise record of zeros for a reading; the fields of errors that are switched off are None."""
    errors = parameters.errors
    return InertialNoise(
        _ZERO,
        None if errors.bias_instability is None else _ZERO,
        None if errors.bias_random_walk is None else _ZERO,
    )


def first_memory(
    errors: InertialErrors, noise: InertialNoise | None, measured: Vector, rotor_speed: RotorSpeed | None
) -> InertialMemory:
    """Return the internal state of a sensor at its first reading; `measured` is the vector that the sensor measures."""
    drift = errors.bias_instability
    numbers = None if noise is None else noise.bias_instability
    return InertialMemory(
        None if drift is None or numbers is None else stationary([drift.deviation] * 3, numbers),
        None if errors.bias_random_walk is None else _ZERO,
        None if errors.temperature_coefficient is None else 0.0,
        None if errors.bandwidth is None else FilterMemory(measured, measured),
        None if errors.vibration is None or rotor_speed is None else first_phases(errors.vibration, rotor_speed),
    )


def next_memory(
    errors: InertialErrors,
    noise: InertialNoise | None,
    memory: InertialMemory,
    measured: Vector,
    rotor_speed: RotorSpeed | None,
) -> InertialMemory:
    """Return the internal state of a sensor at the next reading; `memory` is the state at the previous reading."""
    drift, walk, warm_up, filtered, phases = memory
    if errors.bias_instability is not None and noise is not None:
        deviation, correlation = errors.bias_instability
        drift = correlation.vector_step(drift, [deviation] * 3, noise.bias_instability)  # type: ignore[arg-type]
    if walk is not None and noise is not None:
        walk = Vector._make(
            value + errors.bias_random_walk * number  # type: ignore[operator]
            for value, number in zip(walk, noise.bias_random_walk, strict=True)  # type: ignore[arg-type]
        )
    if errors.temperature_coefficient is not None and warm_up is not None:
        warm_up = minimum(warm_up + errors.temperature_coefficient.step, 1.0)
    if errors.bandwidth is not None and filtered is not None:
        low_pass = errors.bandwidth
        filtered = FilterMemory(
            measured,
            Vector._make(
                low_pass.decay * output + low_pass.before * before + low_pass.now * now
                for output, before, now in zip(filtered.output, filtered.before, measured, strict=True)
            ),
        )
    if errors.vibration is not None and phases is not None and rotor_speed is not None:
        phases = next_phases(errors.vibration, phases, rotor_speed)
    return InertialMemory(drift, walk, warm_up, filtered, phases)


def with_inertial_errors(
    parameters: Any, noise: InertialNoise | None, memory: InertialMemory, measured: Vector, vibration: Vector | None
) -> Vector:
    """Return the reading for a measured vector.

    Args:
        parameters: parameters of the sensor, with the fields `bias`, `noise` and `errors`.
        noise: standard normal samples; None if there is no noise.
        memory: internal state of the sensor at the reading.
        measured: vector that the sensor measures, along the axes of B.
        vibration: vibration of the rotors; None if it is switched off.
    """
    errors: InertialErrors = parameters.errors
    value = measured if memory.filter is None else memory.filter.output
    if vibration is not None:
        value = plus(value, vibration)
    if errors.misalignment is not None:
        value = errors.misalignment.in_body(value)
    if errors.scale_error is not None:
        value = Vector._make((1.0 + error) * part for error, part in zip(errors.scale_error, value, strict=True))
    value = plus(value, Vector(*parameters.bias))
    for drift in (memory.bias_instability, memory.bias_random_walk):
        if drift is not None:
            value = plus(value, drift)
    if errors.temperature_coefficient is not None and memory.warm_up is not None:
        fraction = memory.warm_up
        value = Vector._make(
            part + change * fraction for part, change in zip(value, errors.temperature_coefficient.change, strict=True)
        )
    if noise is not None:
        value = Vector._make(part + parameters.noise * number for part, number in zip(value, noise.white, strict=True))
    return Vector._make(_digital(part, errors.full_scale, errors.resolution) for part in value)


def _digital(value: Row, full_scale: Row | None, resolution: Row | None) -> Row:
    """Return a value that is limited to the full scale and rounded to the resolution."""
    if full_scale is not None:
        value = maximum(minimum(value, full_scale), -full_scale)
    if resolution is not None:
        value = resolution * nearest(value / resolution)
    return value


def walk_step(density: Row, period: float) -> Row:
    """Return the standard deviation K √h of the change of a random walk in a period h (s), given K in unit/√s."""
    return density * math.sqrt(period)
