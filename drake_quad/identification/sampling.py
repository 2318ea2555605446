"""Treatment of logs with a low sample rate or with two clocks.

A log with a lower rate than the control loop lacks commands between its samples. A log that was received over a radio
link has two clocks: that of the vehicle for commands and on-board sensors, and that of the motion capture system. Both
faults distort the fast part of the motion, from which lags and moments of inertia are identified.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.identification.evidence import Uncertainty
from drake_quad.identification.fit import NEGLIGIBLE_DISTURBANCE
from drake_quad.identification.parameters import Parameter
from drake_quad.identification.prediction_errors import PredictionNoise
from drake_quad.identification.windows import airborne_mask, downsample
from drake_quad.logs.consistency import clock_shifts
from drake_quad.logs.record import FlightRecord

_SPECTRUM_LENGTH = 256  # samples in each segment of a spectral estimate
# Commands count as fast if at least this fraction of their power is above half of the Nyquist frequency. The fraction
# is 0.5 for white noise.
_MIN_FAST_POWER_RATIO = 0.2
# A log lacks commands if the loop that computes them has less than this fraction of the log's period.
_MIN_LOGGED_FRACTION = 0.75
# Beginnings of the names of parameters that determine the response to fast commands. Their estimates are biased if
# commands between the samples of a log are missing. The bias of the estimated delay is negligible.
_FAST_PARAMETERS = ("inertia[", "rotor_time_constant")
# Two signals have the same clock if the standard deviation of the time shift between them, apart from its error due to
# noise, is at most this value, in s. It is 0.3 ms in most logs with one clock, up to 5 ms in noisy ones, and 12 to 26
# ms in radio logs with two clocks.
_MAX_CLOCK_SCATTER = 8e-3
_MIN_CLOCK_PARTS = 4  # smallest number of parts of a log from which the standard deviation of the shift is computed
# Sampling period to which on-board signals are averaged, s: half of the time constant of a small motor, and longer than
# the scatter of the time shift between two clocks.
_AVERAGING_PERIOD = 0.03
# If the body rates lead the attitude by at least this time, in s, the attitude is the output of an estimator.
_MIN_LEAD = 2e-3


class SynchronisedRecords(NamedTuple):
    """Records whose signals are synchronous.

    Attributes:
        records: records without the signals of another clock.
        attitude_is_estimated: True if the attitude is the output of an estimator, which lags the gyroscope.
        remarks: remarks on signals that were changed or left out.
    """

    records: Sequence[FlightRecord]
    attitude_is_estimated: bool
    remarks: list[str]


def synchronise(records: Sequence[FlightRecord]) -> SynchronisedRecords:
    """Return records without the signals that are not synchronous with the commands.

    Body rates that lead the attitude cannot be its derivative, so they come from a gyroscope, and the attitude comes
    from an estimator. The errors of such an attitude are not white noise, so the attitude is not predicted.

    If the time shift between attitude and body rates varies, the clock of the poses differs from the clock on board.
    The poses are then left out, since commands are logged on board. The times of the remaining signals are uncertain as
    well, so their samples are averaged. All signals are kept if the logs contain no gyroscope or accelerometer.
    """
    has_both = [{"attitude", "body_rates"} <= {*record.names} for record in records]
    shifts = [
        clock_shifts(dict(record.signals()), record.time)
        for record, both in zip(records, has_both, strict=True)
        if both
    ]
    shifts = [each for each in shifts if len(each.lags)]
    deviations = np.concatenate([np.zeros(0), *(each.lags - each.lags.mean() for each in shifts)])
    errors = np.concatenate([np.zeros(0), *(each.deviations for each in shifts)])
    if len(deviations) >= _MIN_CLOCK_PARTS:
        scatter = math.sqrt(max(0.0, float(np.mean(deviations**2) - np.mean(errors**2))))
        if scatter > _MAX_CLOCK_SCATTER:
            return _on_board(records, scatter)
    lead = -float(np.mean(np.concatenate([each.lags for each in shifts]))) if shifts else 0.0
    if lead < _MIN_LEAD or any(record.position is None and record.specific_force is None for record in records):
        return SynchronisedRecords(records, False, [])
    remark = (
        f"the attitude lags the body rates by {1e3 * lead:.0f} ms, so it comes from an estimator and is not predicted"
    )
    return SynchronisedRecords(records, True, [remark])


def _on_board(records: Sequence[FlightRecord], scatter: float) -> SynchronisedRecords:
    """Remove the poses, and add a remark: the time shift between attitude and body rates has the given scatter (s)."""
    finding = (
        f"the time shift between attitude and body rates varies by {1e3 * scatter:.0f} ms (standard deviation over"
        " parts of two seconds), so their clocks are not synchronised"
    )
    if any(record.body_rates is None or record.specific_force is None for record in records):
        return SynchronisedRecords(records, False, [finding])
    on_board_records = [
        downsample(
            replace(record, position=None, velocity=None, attitude=None),
            max(1, round(_AVERAGING_PERIOD / record.period)),
        )
        for record in records
    ]
    consequence = (
        f"position, velocity and attitude are left out, and the rest is averaged over {1e3 * _AVERAGING_PERIOD:.0f} ms"
    )
    return SynchronisedRecords(on_board_records, False, [f"{finding}; {consequence}"])


def fast_command_remarks(records: Sequence[FlightRecord]) -> list[str]:
    """Return a remark on each record that may lack commands between its samples."""
    return [
        f"{record.name}: {fraction:.0%} of the power of the commands is above half of the Nyquist frequency, so the log"
        " may lack commands between its samples"
        for record in records
        if (fraction := fast_command_fraction(record)) > _MIN_FAST_POWER_RATIO
    ]


def distorted_parameters(
    records: Sequence[FlightRecord],
    parameters: Sequence[Parameter],
    noise: PredictionNoise,
    loop_period: float | None = None,
) -> dict[str, str]:
    """Return a reason for each parameter whose estimate is distorted by missing commands.

    A sample of a noisy command differs from the mean of the command over the period. Such errors in the input
    attenuate the fitted response (W. A. Fuller, Measurement Error Models, 1987, section 1.1), and a disturbing torque
    explains the rest of the motion. If the log of a simulated flight contained only every fifth command, the estimated
    inertia was twice the true inertia, and the estimated time constant of the rotors was a third too long. If the fit
    needs no disturbing torque, no commands are missing, even if the commands are fast.
    """
    affected_logs = logs_without_fast_commands(records, noise, loop_period)
    reason = f"the log may lack commands between its samples ({', '.join(affected_logs)}), which distorts the response"
    fast = [parameter.name for parameter in parameters if parameter.name.startswith(_FAST_PARAMETERS)]
    return dict.fromkeys(fast, reason) if affected_logs else {}


def logs_without_fast_commands(
    records: Sequence[FlightRecord], noise: PredictionNoise, loop_period: float | None = None
) -> list[str]:
    """Return the names of logs that lack commands between their samples.

    Args:
        records: logs whose samples are not averages of faster logs.
        noise: noise of the fit.
        loop_period: period of the loop on board that commands the rotors, s; None if it is unknown.
    """
    if np.all(noise.torque < NEGLIGIBLE_DISTURBANCE):
        return []
    return [
        record.name
        for record in records
        if fast_command_fraction(record) > _MIN_FAST_POWER_RATIO
        or (
            loop_period is not None
            and record.rotor_speed_command is not None
            and loop_period < _MIN_LOGGED_FRACTION * record.period
        )
    ]


def fast_command_fraction(record: FlightRecord) -> float:
    """Return the fraction of the power of the rotor commands that is above half of the Nyquist frequency.

    Only commands in flight are used. The mean command of the rotors, which does not turn the vehicle, is removed. The
    fraction is 0 without rotor commands.
    """
    commands = record.motor_command if record.motor_command is not None else record.rotor_speed_command
    if commands is None:
        return 0.0
    differences = (commands - commands.mean(axis=1, keepdims=True))[airborne_mask(record)]
    if len(differences) < _SPECTRUM_LENGTH:
        return 0.0
    frequency, power = scipy.signal.welch(differences, nperseg=_SPECTRUM_LENGTH, axis=0, detrend="linear")
    total = float(power.sum())
    return float(power[frequency > 0.25].sum()) / total if total > 0.0 else 0.0


def with_averaging_error(
    uncertainty: Uncertainty, names: Sequence[str], values: np.ndarray, period: float
) -> Uncertainty:
    """Return the uncertainty, including the error of rotor time constants that averaged commands cause.

    A first-order lag with the time constant τ follows a ramp with a delay of τ. If the ramp is averaged over a period h
    and held, the mean delay is τ + h² / (12 τ). The difference is an error of the identified time constant. The error
    is smaller for commands that change faster, or that do not change.

    Args:
        uncertainty: uncertainty of p parameters.
        names: names of the parameters.
        values: (p,) estimates.
        period: period over which commands were averaged, s; 0 if they were not.
    """
    is_lag = np.array([name.startswith("rotor_time_constant") for name in names])
    error = np.where(is_lag, period**2 / (12.0 * np.where(is_lag, values, 1.0)), 0.0)
    factors = np.sqrt(1.0 + error**2 / np.diag(uncertainty.covariance))
    return uncertainty._replace(covariance=uncertainty.covariance * np.outer(factors, factors))
