"""Errors of an on-board velocity estimate, and the drag that follows from it.

If the same estimator logs the position p̂ and the velocity v̂, the derivative of p̂ is not an independent measurement.
Position measurements correct p̂ in the long run, however, so the difference between the two is an error of v̂. Averaged
over 0.1 s, this difference is modelled as

    v̂ - dp̂/dt = s v + d

with a scale error s on axes along which the vehicle was flown, and a correlated error d. White position noise of 1 mm
adds 14 mm/s to the difference, and is not part of d. The variance of this noise follows from the scatter of
p̂ - ∫ v̂ dt within 20 ms.
"""

from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError
from drake_quad.identification.result import EstimatedValue
from drake_quad.logs.attitudes import rotation_matrices
from drake_quad.logs.record import FlightRecord
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.winds.source import steady_wind

_MEAN_WINDOW = 0.1  # s, long enough to average out single corrections of an estimator
_BLOCK_DURATION = 0.5  # s, duration of the blocks whose scatter gives standard deviations
_SETTLING_TIME = 0.5  # s, time at the start of a log in which an estimator may still settle
_MIN_FLOWN_SPEED = 0.15  # m/s; the vehicle moves along an axis if the standard deviation of its velocity is larger
_NOISE_STEP = 0.02  # s, two steps of a Crazyflie's estimator, during which the velocity error hardly changes
_MIN_BLOCKS = 2  # smallest number of blocks whose scatter gives a standard deviation
_DRAG_WINDOW = 0.1  # s, averaging time of force and air speed
_MIN_AIR_SPEED = 0.2  # m/s, smallest standard deviation of the air speed from which drag is estimated
# If the air speed along x or y varies by less than this fraction of its variation along the other axis, this axis gets
# the drag of the other axis.
_MIN_SPEED_RATIO = 0.3


class VelocityErrorEstimate(NamedTuple):
    """Error of an estimated velocity.

    Attributes:
        scale_error: scale error s along each axis. For an axis along which the vehicle did not move, it is 0, with the
            mean standard deviation of the other axes.
        drift: (3,) standard deviation of the correlated error d along each axis, in means over 0.1 s, m/s.
        correlation_time: correlation time of the correlated error, averaged over the axes, s.
    """

    scale_error: tuple[EstimatedValue, EstimatedValue, EstimatedValue]
    drift: np.ndarray
    correlation_time: float


def estimate_velocity_error(record: FlightRecord) -> VelocityErrorEstimate:
    """Estimate the error of a logged velocity that was estimated on board.

    Args:
        record: record of a vehicle in the air, with estimated position and velocity.

    Raises:
        InputError: if position or velocity is not logged, the log is too short, or the vehicle hovers.
    """
    position, velocity = record.of("position"), record.of("velocity")
    is_used = (record.time > record.time[0] + _SETTLING_TIME) & (record.time < record.time[-1] - _MEAN_WINDOW)
    ends, starts = record.time[is_used] + 0.5 * _MEAN_WINDOW, record.time[is_used] - 0.5 * _MEAN_WINDOW
    blocks = np.floor(record.time / _BLOCK_DURATION).astype(int)[is_used]
    if len(np.unique(blocks)) < _MIN_BLOCKS or len(blocks) <= 2 * _noise_steps(record):
        raise InputError(f"{record.name}: the log is too short to estimate the error of its velocity")
    scale_errors, drifts, correlation_times = [], [], []
    for axis in range(3):
        # Means are differences of integrals, because the samples of a log need not be equally spaced.
        integral = scipy.integrate.cumulative_trapezoid(velocity[:, axis], record.time, initial=0.0)
        actual, estimated = (
            (np.interp(ends, record.time, each) - np.interp(starts, record.time, each)) / _MEAN_WINDOW
            for each in (position[:, axis], integral)
        )
        error = estimated - actual
        scale_error = EstimatedValue(0.0, np.nan, "1")
        if actual.std() > _MIN_FLOWN_SPEED:
            scale_error = _slope(actual[:, None], error, blocks, "1")
        residual = error - scale_error.value * actual
        noise = (1.0 + scale_error.value) ** 2 * _noise((position[:, axis] - integral)[is_used], record, (starts, ends))
        scale_errors.append(scale_error)
        drifts.append(float(np.sqrt(max(0.0, residual.var() - noise))))
        correlation_times.append(_correlation_time(residual, noise) * record.period)
    if np.isnan([scale_error.deviation for scale_error in scale_errors]).all():
        raise InputError(
            f"{record.name}: the vehicle hovers; to estimate the velocity error, use a flight along at least one axis"
        )
    mean_deviation = float(np.nanmean([scale_error.deviation for scale_error in scale_errors]))
    complete = [
        scale_error if np.isfinite(scale_error.deviation) else scale_error._replace(deviation=mean_deviation)
        for scale_error in scale_errors
    ]
    return VelocityErrorEstimate(
        (complete[0], complete[1], complete[2]), np.array(drifts), float(np.mean(correlation_times))
    )


def linear_drag(record: FlightRecord, scenario: Scenario) -> tuple[EstimatedValue, EstimatedValue]:
    """Estimate the linear drag along x and y of the body, N s/m, for a flight too short to determine quadratic drag.

    The drag is the least-squares slope of the force over the air speed. Its standard deviation follows from the scatter
    of blocks. An axis with little air speed gets the drag of the other axis.

    Args:
        record: record with velocity and attitude.
        scenario: scenario with the mass, and with the steady wind if the record has none.

    Raises:
        InputError: if a signal is not logged, the log is too short, or the vehicle hovers.
    """
    to_body = rotation_matrices(record.of("attitude")).inv()
    velocity = record.of("velocity")
    wind = np.asarray(steady_wind(scenario.laboratory.wind), dtype=float) if record.wind is None else record.wind
    weight = np.array([0.0, 0.0, scenario.vehicle.gravity])
    force = to_body.apply(scenario.vehicle.mass * (np.gradient(velocity, record.time, axis=0) + weight))
    air_velocity = to_body.apply(wind - velocity)
    width = max(1, round(_DRAG_WINDOW / record.period))
    weights, inside = np.ones(width) / width, slice(2 * width, -2 * width)
    blocks = np.floor(record.time / _BLOCK_DURATION).astype(int)[inside]
    if len(np.unique(blocks)) < _MIN_BLOCKS:
        raise InputError(f"{record.name}: the log is too short to estimate the drag")
    if air_velocity[:, :2].std(axis=0).max() < _MIN_AIR_SPEED:
        raise InputError(
            f"{record.name}: the vehicle hovers; to estimate the drag, use a flight along x or y of the body"
        )
    air_speeds, drag_forces = (
        np.stack([np.convolve(column, weights, "same")[inside] for column in each[:, :2].T])
        for each in (air_velocity, force)
    )
    deviations = air_speeds.std(axis=1)
    source_axes = [
        axis if deviations[axis] > _MIN_SPEED_RATIO * deviations.max() else int(np.argmax(deviations))
        for axis in range(2)
    ]
    regressors = [np.column_stack([air_speeds[axis], np.ones_like(air_speeds[axis])]) for axis in source_axes]
    drag_x, drag_y = (
        _slope(columns, drag_forces[axis], blocks, "N s/m")
        for columns, axis in zip(regressors, source_axes, strict=True)
    )
    return drag_x, drag_y


def _slope(regressors: np.ndarray, values: np.ndarray, blocks: np.ndarray, unit: str) -> EstimatedValue:
    """Return the first least-squares coefficient, with the standard deviation from the scatter of blocks.

    Args:
        regressors: (n, k) regressors.
        values: (n,) values that are fitted.
        blocks: (n,) block number of each value.
        unit: unit of the coefficient.
    """
    inverse = np.linalg.inv(regressors.T @ regressors)
    coefficients = inverse @ regressors.T @ values
    gradients = regressors * (values - regressors @ coefficients)[:, None]
    scores = np.stack([gradients[blocks == block].sum(axis=0) for block in np.unique(blocks)])
    covariance = len(scores) / (len(scores) - 1) * inverse @ scores.T @ scores @ inverse
    return EstimatedValue(float(coefficients[0]), float(np.sqrt(covariance[0, 0])), unit, len(scores) - 1.0)


def _noise_steps(record: FlightRecord) -> int:
    """Return the number of sampling periods in `_NOISE_STEP`, at least one."""
    return max(1, round(_NOISE_STEP / record.period))


def _noise(samples: np.ndarray, record: FlightRecord, times: tuple[np.ndarray, np.ndarray]) -> float:
    """Return the variance that white noise of a signal adds to mean derivatives of the signal.

    Args:
        samples: (n,) consecutive samples of the signal. They must not include the time in which the estimator settles,
            since a jump would count as noise.
        record: record that contains the samples.
        times: times of the start and of the end of each mean, two arrays (n,), s.
    """
    step = _noise_steps(record)
    variance = float(np.mean((samples[2 * step :] - 2.0 * samples[step:-step] + samples[: -2 * step]) ** 2)) / 6.0
    fractions = [np.interp(time, record.time, np.arange(len(record.time))) % 1.0 for time in times]
    return (
        variance / _MEAN_WINDOW**2 * float(sum(np.mean(fraction**2 + (1.0 - fraction) ** 2) for fraction in fractions))
    )


def _correlation_time(residual: np.ndarray, noise: float) -> int:
    """Return the number of samples after which the autocorrelation, without the noise, has decreased to 1/e."""
    centred = residual - residual.mean()
    # The autocorrelation is computed by FFT, since direct summation takes seconds for a log of several minutes.
    correlation = scipy.signal.correlate(centred, centred, method="fft")[len(centred) - 1 :]
    variance = max(0.0, correlation[0] - len(centred) * noise)
    return max(1, int(np.argmax(correlation < variance / np.e)) or len(centred))
