"""State estimation for a logged flight, by an error-state Kalman filter that processes the inertial sensors of a log.

The log contains measurements of inertial sensors, and position and attitude from motion capture, which serve as ground
truth. The filter uses the initial yaw, every n-th position, and optionally the attitude at the time of this position.
If the log also contains an on-board estimate, the errors of both estimates can be compared.

Signals that are received over a radio link lag behind motion capture. The lag of the inertial sensors is that of the
gyroscope behind the body rates from motion capture. This lag is removed before the filter runs. The lag of an on-board
estimate minimises its position error, so the comparison favours this estimate.
"""

from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.estimation.corrections import AttitudeAiding, PoseAiding, PositionAiding
from drake_quad.estimation.covariance import InertialNoise
from drake_quad.estimation.error_state_filter import Aiding, AidingParameters, ErrorStateKalmanFilter, FilterParameters
from drake_quad.logs.attitudes import rotation_matrices
from drake_quad.logs.consistency import clock_shifts
from drake_quad.logs.record import FlightRecord
from drake_quad.signals import EstimateDeviation

CRAZYFLIE_NOISE = InertialNoise(0.01, 0.05, 1e-4, 1e-3)
"""Noise of the inertial sensors that is assumed by default.

The white noise is that of the filter in the Crazyflie's firmware: 0.5 m/s² (procNoiseAcc_xy) and 0.1 rad/s
(measNoiseGyro_rollpitch), constant over each prediction of 0.01 s. The firmware estimates no biases of these sensors;
the random walks of the biases are rough choices, not fitted.
"""
CRAZYFLIE_POSITION_NOISE = 0.01
"""Standard deviation that the firmware assumes for an external position (extPosStdDev), m."""
CRAZYFLIE_ATTITUDE_NOISE = 0.0045
"""Standard deviation that the firmware assumes for an external attitude (extQuatStdDev), rad."""

_MAX_SQUARED_INNOVATION = 25.0  # limit of a squared normalised innovation (five standard deviations)
_RESET_TIME = 0.1  # s; if positions are rejected for this duration, the estimate is reset
# Initially, the position is unknown, the vehicle is at rest, and its yaw is known.
_INITIAL_DEVIATION = EstimateDeviation(*[10.0] * 3, *[0.1] * 3, *[0.05] * 3, *[0.01] * 3, *[0.2] * 3)
_MIN_HEIGHT = 0.1  # m, height above the start at which the vehicle counts as flying
_MAX_LAG = 0.1  # s, largest lag of an on-board estimate that is tried
_LAG_STEP = 0.002  # s, difference between two lags that are tried
_MIN_SAMPLES = 100
_REQUIRED_SIGNALS = "position", "attitude", "body_rates", "specific_force"
_PERIOD_RESOLUTION = 1e-4  # s; the sampling period is rounded to a multiple of this


class EstimateErrors(NamedTuple):
    """Errors of an estimate at n times.

    Attributes:
        position: (n, 3) error of the position in W, m.
        velocity: (n, 3) error of the velocity in W, m/s.
        tilt: (n,) angle between the estimated and the true z axis of the body, rad.
        yaw: (n,) error of the yaw, rad.
    """

    position: np.ndarray
    velocity: np.ndarray
    tilt: np.ndarray
    yaw: np.ndarray

    def root_mean_squares(self, mask: np.ndarray) -> tuple[float, float, float, float]:
        """Return the root-mean-square errors of position (m), velocity (m/s), tilt (rad) and yaw (rad).

        Args:
            mask: (n,) mask of the samples over which the errors are averaged.
        """
        distances = (np.linalg.norm(each, axis=1) for each in (self.position, self.velocity))
        position, velocity, tilt, yaw = (
            float(np.sqrt(np.square(each[mask]).mean())) for each in (*distances, self.tilt, self.yaw)
        )
        return position, velocity, tilt, yaw


class LoggedEstimate(NamedTuple):
    """Estimate for a logged flight.

    Attributes:
        time: (n,) times, s.
        is_flying: (n,) mask of the samples in which the vehicle flies.
        errors: errors of the filter.
        deviations: (n, 15) standard deviations of the errors according to the filter, in the order of
            `EstimateDeviation`.
        innovations: (n, m) latest normalised innovations: three of the position, and three of the attitude if the
            filter uses it.
        gyroscope_bias: (3,) bias of the gyroscope at the end, rad/s.
        accelerometer_bias: (3,) bias of the accelerometer at the end, m/s².
        lag: lag of the inertial sensors behind motion capture, which was removed, s.
        period: sampling period of the inertial sensors, s.
    """

    time: np.ndarray
    is_flying: np.ndarray
    errors: EstimateErrors
    deviations: np.ndarray
    innovations: np.ndarray
    gyroscope_bias: np.ndarray
    accelerometer_bias: np.ndarray
    lag: float
    period: float

    @property
    def mean_squared_innovation(self) -> float:
        """Mean squared normalised innovation in flight; 1 if the assumed noise is correct."""
        return float(np.square(self.innovations[self.is_flying]).mean())


class _Table(NamedTuple):
    """Signals of a flight, resampled at a constant period; all except the time have the shape (n, 3)."""

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray
    body_rates: np.ndarray
    specific_force: np.ndarray


def estimate_logged_flight(
    record: FlightRecord,
    *,
    num_skipped: int = 0,
    noise: InertialNoise = CRAZYFLIE_NOISE,
    position_noise: float = CRAZYFLIE_POSITION_NOISE,
    attitude_noise: float | None = None,
) -> LoggedEstimate:
    """Return the estimate of a filter that uses the inertial sensors and the positions of a log.

    Args:
        record: log with position, attitude, body rates and specific force.
        num_skipped: number of positions that the filter skips between two positions that it uses.
        noise: assumed noise of the inertial sensors.
        position_noise: assumed standard deviation of a position on each axis, m.
        attitude_noise: assumed standard deviation of an attitude about each axis, rad; None to use no attitudes.

    Raises:
        InputError: if the log lacks a signal, or is too short.
    """
    period = _period_of(record)
    table = _resampled(record, np.arange(record.time[0], record.time[-1], period))
    if len(table.time) < _MIN_SAMPLES:
        raise InputError(f"the log {record.name} has {len(table.time)} samples; an estimate needs {_MIN_SAMPLES}")
    lag, samples = _gyroscope_lag(record), num_skipped + 1
    aiding: Any = PositionAiding(position_noise, position_noise, position_noise)
    aiding_readings, kind = table.position, "position"
    if attitude_noise is not None:
        aiding, kind = PoseAiding(aiding, AttitudeAiding(attitude_noise)), "pose"
        aiding_readings = np.hstack([table.position, table.attitude, np.zeros((len(table.time), 6))])
    max_rejections = max(1.0, round(_RESET_TIME / (samples * period)))
    system = ErrorStateKalmanFilter(
        aiding=(Aiding("position", kind, samples),),
        period=period,
        block_samples=samples,
        parameters=FilterParameters(
            noise,
            _INITIAL_DEVIATION,
            (AidingParameters(aiding, _MAX_SQUARED_INNOVATION, max_rejections),),
            initial_yaw=float(table.attitude[0, 2]),
        ),
    )
    context = system.CreateDefaultContext()
    # The filter holds each reading for one period, so the reading is taken in the middle of the period.
    middle = table.time + 0.5 * period + lag
    gyroscope, accelerometer = (
        _interpolated(middle, table.time, each) for each in (table.body_rates, table.specific_force)
    )
    num_steps = len(table.time) - 1
    states, deviations, innovations = np.zeros((num_steps, 12)), np.zeros((num_steps, 15)), []
    for k in range(num_steps):
        for name, values in (("gyroscope", gyroscope), ("accelerometer", accelerometer), ("position", aiding_readings)):
            system.GetInputPort(name).FixValue(context, values[k])
        context.SetTime((k + 1) * period)
        context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context).Clone())
        states[k] = system.GetOutputPort("measurement").Eval(context)
        deviations[k] = system.GetOutputPort("estimate_deviation").Eval(context)
        innovations.append(system.GetOutputPort("innovation").Eval(context))
    estimate, truth = system.get_state(context, "estimate"), _Table(*(column[1:] for column in table))
    return LoggedEstimate(
        truth.time,
        _is_flying(truth),
        _errors(truth, states[:, 0:3], states[:, 6:9], states[:, 3:6]),
        deviations,
        np.array(innovations),
        np.array(estimate.gyroscope_bias),
        np.array(estimate.accelerometer_bias),
        lag,
        period,
    )


def errors_on_board(record: FlightRecord, on_board: FlightRecord) -> tuple[EstimateErrors, np.ndarray, float]:
    """Return the errors of an on-board estimate, a mask of the samples in flight, and the lag of the estimate, s.

    Args:
        record: log with the true position and attitude.
        on_board: the same log, with the on-board estimate in place of the true values.

    Raises:
        InputError: if a log lacks position or attitude.
    """
    for log in (record, on_board):
        _check(log, ("position", "attitude"))
    period = _period_of(record)
    table = _resampled(record, np.arange(record.time[0], record.time[-1], period))
    is_flying, best = _is_flying(table), None
    velocity = on_board.velocity
    if velocity is None:
        velocity = np.gradient(on_board.position, on_board.time, axis=0)  # type: ignore[arg-type]
    for lag in np.arange(0.0, _MAX_LAG, _LAG_STEP):
        times = table.time + lag
        position, speed = (_interpolated(times, on_board.time, each) for each in (on_board.position, velocity))
        errors = _errors(table, position, speed, _interpolated_angles(times, on_board.time, on_board.attitude))
        if best is None or errors.root_mean_squares(is_flying)[0] < best[0].root_mean_squares(is_flying)[0]:
            best = errors, is_flying, float(lag)
    assert best is not None
    return best


def _check(record: FlightRecord, names: tuple[str, ...]) -> None:
    missing = [name for name in names if getattr(record, name) is None]
    if missing:
        raise InputError(f"the log {record.name} does not contain {' and '.join(missing)}, which an estimate needs")


def _period_of(record: FlightRecord) -> float:
    """Return the median sampling period of a log, s, rounded to 0.1 ms."""
    median = float(np.median(np.diff(record.time)))
    return max(_PERIOD_RESOLUTION, _PERIOD_RESOLUTION * round(median / _PERIOD_RESOLUTION))


def _resampled(record: FlightRecord, time: np.ndarray) -> _Table:
    """Return the signals of a record at given times, s, by linear interpolation."""
    _check(record, _REQUIRED_SIGNALS)
    velocity = record.velocity
    if velocity is None:
        velocity = np.gradient(record.position, record.time, axis=0)  # type: ignore[arg-type]
    position, body_rates, force = (
        _interpolated(time, record.time, each) for each in (record.position, record.body_rates, record.specific_force)
    )
    attitude = _interpolated_angles(time, record.time, record.attitude)
    return _Table(time, position, _interpolated(time, record.time, velocity), attitude, body_rates, force)


def _gyroscope_lag(record: FlightRecord) -> float:
    """Return the median lag (s) of the gyroscope behind motion capture; 0 if it cannot be determined."""
    lags = clock_shifts(dict(record.signals()), record.time).lags
    return float(np.median(lags)) if len(lags) else 0.0


def _interpolated(times: np.ndarray, clock: np.ndarray, values: np.ndarray | None) -> np.ndarray:
    """Return a signal (n, 3) at given times by linear interpolation between the samples at the times `clock`."""
    assert values is not None
    return np.stack([np.interp(times, clock, column) for column in values.T], axis=1)


def _interpolated_angles(times: np.ndarray, clock: np.ndarray, angles: np.ndarray | None) -> np.ndarray:
    """Return angles (n, 3), which may wrap, at given times by linear interpolation."""
    assert angles is not None
    return _interpolated(times, clock, np.unwrap(angles, axis=0))


def _is_flying(table: _Table) -> np.ndarray:
    """Return a mask (n,) of the samples above the initial height, or of all samples if there are none."""
    mask = table.position[:, 2] > table.position[0, 2] + _MIN_HEIGHT
    return mask if mask.any() else np.ones_like(mask)


def _errors(table: _Table, position: np.ndarray, velocity: np.ndarray, attitude: np.ndarray) -> EstimateErrors:
    """Return the errors of estimated positions, velocities and attitudes, each of shape (n, 3)."""
    true, estimated = (rotation_matrices(each).as_matrix() for each in (table.attitude, attitude))
    cosine = np.clip((true[:, :, 2] * estimated[:, :, 2]).sum(axis=1), -1.0, 1.0)
    yaw = attitude[:, 2] - table.attitude[:, 2]
    return EstimateErrors(
        position - table.position,
        velocity - table.velocity,
        np.arccos(cosine),
        np.arctan2(np.sin(yaw), np.cos(yaw)),
    )
