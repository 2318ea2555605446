"""Satellite navigation: position and velocity of the antenna.

    position = p + R_WB r + d + j + σ_p n        velocity = v + R_WB (ω × r) + σ_v n

with the position r of the antenna in B, and standard normal n. d is a stationary Gauss-Markov process on each axis, the
slowly varying error of the orbits, clocks and the atmosphere. j is an error by multipath, which jumps: in each period h
a new value of j is drawn with the probability 1 - exp(-h / T), so a value lasts for about T on average.
"""

from typing import Annotated, NamedTuple

import numpy as np
import scipy

from drake_quad.framework.elementary import where
from drake_quad.geometry.axes import Vector
from drake_quad.laboratory.sensors.gauss_markov import Correlation, stationary
from drake_quad.laboratory.sensors.mounting import SensorPosition, axes_of, lever_velocity, place
from drake_quad.laboratory.sensors.sensor import SensorLaw, SensorMemory
from drake_quad.signals import Number, PositionW, Quantity, Row, State, VelocityW


class Fix(NamedTuple):
    """Position and velocity of the antenna."""

    x: PositionW
    y: PositionW
    z: PositionW
    v_x: VelocityW
    v_y: VelocityW
    v_z: VelocityW


class PositionDeviation(NamedTuple):
    """Standard deviation of the position along the axes of W."""

    x: Annotated[Row, Quantity("m", "W", sign="nonnegative")] = 0.0
    y: Annotated[Row, Quantity("m", "W", sign="nonnegative")] = 0.0
    z: Annotated[Row, Quantity("m", "W", sign="nonnegative")] = 0.0


class VelocityDeviation(NamedTuple):
    """Standard deviation of the velocity along the axes of W."""

    x: Annotated[Row, Quantity("m/s", "W", sign="nonnegative")] = 0.0
    y: Annotated[Row, Quantity("m/s", "W", sign="nonnegative")] = 0.0
    z: Annotated[Row, Quantity("m/s", "W", sign="nonnegative")] = 0.0


class PositionDrift(NamedTuple):
    """Slowly varying error of the measured position, a Gauss-Markov process on each axis.

    Attributes:
        deviation: standard deviation on each axis.
        correlation: correlation between successive readings.
    """

    deviation: PositionDeviation
    correlation: Correlation


class Multipath(NamedTuple):
    """Error of the measured position by multipath propagation, which jumps to a new value at random times.

    Attributes:
        deviation: standard deviation of the values on each axis.
        threshold: the error jumps in a period if a standard normal sample is below this number.
    """

    deviation: PositionDeviation
    threshold: Number

    @classmethod
    def of(cls, deviation: PositionDeviation, time: Row, period: float) -> "Multipath":
        """Return the parameters for a mean time between jumps and a period, both in s; arguments may be arrays."""
        return cls(deviation, scipy.special.ndtri(-np.expm1(-period / time)))


class GnssErrors(NamedTuple):
    """Errors that can be switched off; None for an error that is switched off.

    Attributes:
        position_drift: slowly varying error of the measured position.
        multipath: error by multipath propagation.
    """

    position_drift: PositionDrift | None = None
    multipath: Multipath | None = None


class GnssParameters(NamedTuple):
    """Position of the antenna, and errors of satellite navigation.

    Attributes:
        position: position of the antenna.
        position_noise: standard deviation of the white noise of the position.
        velocity_noise: standard deviation of the white noise of the velocity.
        latency_samples: latency, a whole number of periods.
        errors: errors that can be switched off.
    """

    position: SensorPosition = SensorPosition()
    position_noise: PositionDeviation = PositionDeviation()
    velocity_noise: VelocityDeviation = VelocityDeviation()
    latency_samples: Number = 0.0
    errors: GnssErrors = GnssErrors()


class MultipathNoise(NamedTuple):
    """Standard normal samples that determine whether the multipath error jumps, and its value after the jump."""

    jump: Number
    value: Vector


class GnssNoise(NamedTuple):
    """Standard normal samples for a reading.

    Attributes:
        white: samples for the white noise.
        position_drift: samples for the slowly varying error.
        multipath: samples for the multipath error.
    """

    white: Fix
    position_drift: Vector | None
    multipath: MultipathNoise | None


class GnssMemory(NamedTuple):
    """Slowly varying error and multipath error at a reading; None for an error that is switched off."""

    position_drift: Vector | None
    multipath: Vector | None


_ZERO = Vector(0.0, 0.0, 0.0)


def gnss_noise(parameters: GnssParameters) -> GnssNoise:
    """Return a noise record of zeros for a reading; the fields of errors that are switched off are None."""
    return GnssNoise(
        Fix(*(0.0,) * 6),
        None if parameters.errors.position_drift is None else _ZERO,
        None if parameters.errors.multipath is None else MultipathNoise(0.0, _ZERO),
    )


def first_gnss_memory(parameters: GnssParameters, noise: GnssNoise | None, state: State) -> GnssMemory:
    """Return the slowly varying errors at the first reading, drawn from their stationary distribution."""
    if noise is None:
        return GnssMemory(None, None)
    drift, multipath = parameters.errors
    return GnssMemory(
        None if drift is None else stationary(drift.deviation, noise.position_drift),  # type: ignore[arg-type]
        None if multipath is None else stationary(multipath.deviation, noise.multipath.value),  # type: ignore[union-attr]
    )


def next_gnss_memory(
    parameters: GnssParameters, noise: GnssNoise | None, memory: GnssMemory, state: State
) -> GnssMemory:
    """Return the slowly varying errors at the next reading; `memory` contains the errors at the previous reading."""
    if noise is None:
        return memory
    drift, jumped = memory
    if parameters.errors.position_drift is not None and drift is not None and noise.position_drift is not None:
        deviation, correlation = parameters.errors.position_drift
        drift = correlation.vector_step(drift, deviation, noise.position_drift)
    if parameters.errors.multipath is not None and jumped is not None and noise.multipath is not None:
        has_jumped = noise.multipath.jump < parameters.errors.multipath.threshold
        after = stationary(parameters.errors.multipath.deviation, noise.multipath.value)
        jumped = where(has_jumped, after, jumped)
    return GnssMemory(drift, jumped)


def gnss_reading(parameters: GnssParameters, noise: GnssNoise | None, memory: GnssMemory, state: State) -> Fix:
    """Return position and velocity of the antenna, with noise unless `noise` is None."""
    axes = axes_of(state)
    relative = axes.in_world(lever_velocity(state, parameters.position))
    position = place(state, axes, parameters.position)
    for error in memory:
        if error is not None:
            position = Vector._make(part + each for part, each in zip(position, error, strict=True))
    fix = Fix(*position, state.v_x + relative.x, state.v_y + relative.y, state.v_z + relative.z)
    if noise is None:
        return fix
    deviations = *parameters.position_noise, *parameters.velocity_noise
    return Fix._make(
        part + deviation * number for part, deviation, number in zip(fix, deviations, noise.white, strict=True)
    )


GNSS = SensorLaw(
    Fix, gnss_reading, ("state",), memory=SensorMemory(first_gnss_memory, next_gnss_memory), noise=gnss_noise
)
"""Measurement law of satellite navigation."""
