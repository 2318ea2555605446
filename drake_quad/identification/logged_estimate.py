"""Estimation of a logged flight: an error-state Kalman filter on the inertial sensors and positions of a log.

The log contains inertial sensors, and position and attitude from motion capture, which count as the truth. The filter
uses the initial yaw, every n-th position, and optionally the attitude at the time of this position. If the log also
contains the estimate of a filter that flew on board, the errors of both filters can be compared.

Signals that arrive over a radio are late. The lag of the inertial sensors is estimated and removed: it is the lag of
the gyroscope behind the rotation of motion capture, with the smallest mean squared difference. The lag of an estimate
from on board is the one with the smallest error of the position, so that the comparison favours this estimate.
"""

from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.estimation.corrections import AttitudeAiding, PoseAiding, PositionAiding
from drake_quad.estimation.covariance import InertialNoise
from drake_quad.estimation.error_state_filter import Aiding, AidingParameters, ErrorStateKalmanFilter, FilterParameters
from drake_quad.logs.attitudes import rotation_matrices
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

_INNOVATION_LIMIT = 25.0  # squared
_RESET_TIME = 0.1  # s, after which rejected positions reset the estimate
# Initial deviations: the position is unknown, and the vehicle rests with a known yaw.
_INITIAL = EstimateDeviation(*[10.0] * 3, *[0.1] * 3, *[0.05] * 3, *[0.01] * 3, *[0.2] * 3)
_MIN_HEIGHT = 0.1  # m, height above the start at which the vehicle counts as flying
_MAX_LAG = 0.1  # s
_LAG_STEP = 0.002  # s
_MIN_SAMPLES = 100
_REQUIRED = "position", "attitude", "body_rates", "specific_force"
_PERIOD_STEP = 1e-4  # s, to which the sampling period is rounded


class EstimateErrors(NamedTuple):
    """Errors of an estimate over time.

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
            mask: (n,) True for the samples over which the means are taken.
        """
        distances = (np.linalg.norm(each, axis=1) for each in (self.position, self.velocity))
        position, velocity, tilt, yaw = (
            float(np.sqrt(np.square(each[mask]).mean())) for each in (*distances, self.tilt, self.yaw)
        )
        return position, velocity, tilt, yaw


class LoggedEstimate(NamedTuple):
    """Estimate of a logged flight.

    Attributes:
        time: (n,) times, s.
        is_flying: (n,) True while the vehicle is above its initial height.
        errors: errors of the filter.
        deviations: (n, 15) standard deviations that the filter estimates, in the order of `EstimateDeviation`.
        innovations: (n, m) latest normalised innovations: three of the position, and three of the attitude if the
            filter uses it.
        gyroscope_bias: (3,) bias of the gyroscope at the end, rad/s.
        accelerometer_bias: (3,) bias of the accelerometer at the end, m/s².
        lag: lag of the inertial sensors that was removed, s.
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


class _Table(NamedTuple):
    """Signals of a flight at a constant period; arrays have the shape (n, 3)."""

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
        num_skipped: number of positions that are left out between two that are used.
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
    lag, samples = _gyroscope_lag(table, period), num_skipped + 1
    aiding: Any = PositionAiding(position_noise, position_noise, position_noise)
    readings, kind = table.position, "position"
    if attitude_noise is not None:
        aiding, kind = PoseAiding(aiding, AttitudeAiding(attitude_noise)), "pose"
        readings = np.hstack([table.position, table.attitude, np.zeros((len(table.time), 6))])
    max_rejections = max(1.0, round(_RESET_TIME / (samples * period)))
    system = ErrorStateKalmanFilter(
        aiding=(Aiding("position", kind, samples),),
        period=period,
        block_samples=samples,
        parameters=FilterParameters(
            noise,
            _INITIAL,
            (AidingParameters(aiding, _INNOVATION_LIMIT, max_rejections),),
            initial_yaw=float(table.attitude[0, 2]),
        ),
    )
    context = system.CreateDefaultContext()
    # A reading acts until the next sample, so it is taken in the middle.
    middle = table.time + 0.5 * period + lag
    gyroscope, accelerometer = (_shifted(middle, table.time, each) for each in (table.body_rates, table.specific_force))
    num_steps = len(table.time) - 1
    states, deviations, innovations = np.zeros((num_steps, 12)), np.zeros((num_steps, 15)), []
    for k in range(num_steps):
        for name, values in (("gyroscope", gyroscope), ("accelerometer", accelerometer), ("position", readings)):
            system.GetInputPort(name).FixValue(context, values[k])
        context.SetTime((k + 1) * period)
        context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context).Clone())
        states[k] = system.GetOutputPort("measurement").Eval(context)
        deviations[k] = system.GetOutputPort("estimate_deviation").Eval(context)
        innovations.append(system.GetOutputPort("innovation").Eval(context))
    estimate, later = system.get_state(context, "estimate"), _Table(*(column[1:] for column in table))
    return LoggedEstimate(
        later.time,
        _is_flying(later),
        _errors(later, states[:, 0:3], states[:, 6:9], states[:, 3:6]),
        deviations,
        np.array(innovations),
        np.array(estimate.gyroscope_bias),
        np.array(estimate.accelerometer_bias),
        lag,
        period,
    )


def errors_on_board(record: FlightRecord, on_board: FlightRecord) -> tuple[EstimateErrors, np.ndarray, float]:
    """Return the errors of an estimate from on board, whether the vehicle flies, and the lag of the estimate, s.

    Args:
        record: log with the true position and attitude.
        on_board: the same log, with the estimate from on board in place of the truth.

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
        position, speed = (_shifted(times, on_board.time, each) for each in (on_board.position, velocity))
        errors = _errors(table, position, speed, _shifted_angles(times, on_board.time, on_board.attitude))
        if best is None or errors.root_mean_squares(is_flying)[0] < best[0].root_mean_squares(is_flying)[0]:
            best = errors, is_flying, float(lag)
    assert best is not None
    return best


def _check(record: FlightRecord, names: tuple[str, ...]) -> None:
    missing = [name for name in names if getattr(record, name) is None]
    if missing:
        raise InputError(f"the log {record.name} does not contain {' and '.join(missing)}, which an estimate needs")


def _period_of(record: FlightRecord) -> float:
    """Return the median sampling period of a log, s."""
    return max(_PERIOD_STEP, _PERIOD_STEP * round(float(np.median(np.diff(record.time))) / _PERIOD_STEP))


def _resampled(record: FlightRecord, time: np.ndarray) -> _Table:
    """Return the signals of a record at given times, s."""
    _check(record, _REQUIRED)
    velocity = record.velocity
    if velocity is None:
        velocity = np.gradient(record.position, record.time, axis=0)  # type: ignore[arg-type]
    position, body_rates, force = (
        _shifted(time, record.time, each) for each in (record.position, record.body_rates, record.specific_force)
    )
    attitude = _shifted_angles(time, record.time, record.attitude)
    return _Table(time, position, _shifted(time, record.time, velocity), attitude, body_rates, force)


def _gyroscope_lag(table: _Table, period: float) -> float:
    """Return the lag (s) of the gyroscope behind the rotation of motion capture."""
    rotations = rotation_matrices(table.attitude)
    rates = (rotations[:-2].inv() * rotations[2:]).as_rotvec() / (2.0 * period)
    lags, times = np.arange(-_MAX_LAG, _MAX_LAG, _LAG_STEP), table.time[1:-1]
    errors = [np.square(rates - _shifted(times + lag, table.time, table.body_rates)).mean() for lag in lags]
    return float(lags[int(np.argmin(errors))])


def _shifted(times: np.ndarray, clock: np.ndarray, values: np.ndarray | None) -> np.ndarray:
    """Return linearly interpolated columns (n, 3) of a signal."""
    assert values is not None
    return np.stack([np.interp(times, clock, column) for column in values.T], axis=1)


def _shifted_angles(times: np.ndarray, clock: np.ndarray, angles: np.ndarray | None) -> np.ndarray:
    """Return linearly interpolated angles (n, 3), which may wrap."""
    assert angles is not None
    return _shifted(times, clock, np.unwrap(angles, axis=0))


def _is_flying(table: _Table) -> np.ndarray:
    """Return the mask (n,) of the samples above the initial height; of all samples if there are none."""
    mask = table.position[:, 2] > table.position[0, 2] + _MIN_HEIGHT
    return mask if mask.any() else np.ones_like(mask)


def _errors(table: _Table, position: np.ndarray, velocity: np.ndarray, attitude: np.ndarray) -> EstimateErrors:
    """Return the errors of an estimate, whose arrays have the shape (n, 3)."""
    true, estimated = (rotation_matrices(each).as_matrix() for each in (table.attitude, attitude))
    cosine = np.clip((true[:, :, 2] * estimated[:, :, 2]).sum(axis=1), -1.0, 1.0)
    yaw = attitude[:, 2] - table.attitude[:, 2]
    return EstimateErrors(
        position - table.position,
        velocity - table.velocity,
        np.arccos(cosine),
        np.arctan2(np.sin(yaw), np.cos(yaw)),
    )
