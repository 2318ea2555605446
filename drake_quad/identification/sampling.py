"""Treatment of logs with a low sample rate or with two clocks.

A log that is slower than the control loop lacks commands between its samples. A log that was received over a radio link
has two clocks: the clock of the vehicle for commands and on-board sensors, and the clock of the motion capture system.
Both problems distort the fast part of the motion, from which lags and moments of inertia are identified.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError
from drake_quad.identification.evidence import Uncertainty
from drake_quad.identification.fit import PredictionFit, fit
from drake_quad.identification.logs.consistency import clock_shifts
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.parameters import Parameter, names_of
from drake_quad.identification.prepared_logs import SLOW_PERIOD, PreparedLogs, window_blocks
from drake_quad.identification.windows import airborne, coarser

_SPECTRUM_LENGTH = 256  # samples in each segment of a spectral estimate
_MIN_FAST_SHARE = 0.2  # power above half of the Nyquist frequency, relative to the total power; white noise has 0.5
_DIFFERENCE_SIGMA = 2.0  # standard deviations from which estimates at two bandwidths count as different
# Standard deviation of the shift between two clocks, s. It is 0.3 ms in logs with one clock, up to 5 ms in noisy ones,
# and 12 to 26 ms in radio logs.
_MAX_CLOCK_SCATTER = 8e-3
_MIN_CLOCK_PARTS = 4
_MIN_LEAD = 2e-3  # s


class SlowFit(NamedTuple):
    """Fit to the same logs at a longer period.

    Attributes:
        values: (p,) estimates of the parameters.
        variances: (p,) variances of the errors of the estimates.
        period: period of the samples, s.
    """

    values: np.ndarray
    variances: np.ndarray
    period: float


class Synchronised(NamedTuple):
    """Records whose signals are synchronous.

    Attributes:
        records: records, without the signals of another clock.
        late_attitude: True if the attitude is that of an estimator, and lags the gyroscope.
        remarks: sentences on signals that were changed or left out.
    """

    records: Sequence[FlightRecord]
    late_attitude: bool
    remarks: list[str]


def synchronised(records: Sequence[FlightRecord]) -> Synchronised:
    """Return records without the signals that are not synchronous with the commands.

    Body rates that lead the attitude cannot be derived from it, so they are those of a gyroscope. The attitude is then
    that of an estimator, whose errors are not white noise, and it is not predicted.

    If the shift varies, the poses have another clock than the on-board sensors. They are left out, since commands are
    logged on board. The times of the remaining signals are uncertain as well, so their samples are averaged. Without
    gyroscope and accelerometer, all signals are kept.
    """
    has = [{"attitude", "body_rates"} <= {*record.names} for record in records]
    shifts = [
        clock_shifts(dict(record.signals()), record.time) if both else np.zeros(0)
        for record, both in zip(records, has, strict=True)
    ]
    deviations = np.concatenate([each - each.mean() for each in shifts if len(each)] or [np.zeros(0)])
    if len(deviations) >= _MIN_CLOCK_PARTS and np.std(deviations) > _MAX_CLOCK_SCATTER:
        return _on_board(records, float(np.std(deviations)))
    lead = -float(np.mean(np.concatenate(shifts))) if len(deviations) else 0.0
    if lead < _MIN_LEAD or any(record.position is None and record.specific_force is None for record in records):
        return Synchronised(records, False, [])
    remark = (
        f"the attitude lags the body rates by {1e3 * lead:.0f} ms, as that of an estimator does; it is not predicted"
    )
    return Synchronised(records, True, [remark])


def _on_board(records: Sequence[FlightRecord], scatter: float) -> Synchronised:
    """Return the records without poses, given the standard deviation of the shift of the poses in s."""
    doubt = (
        f"attitude and body rates are shifted against each other by {1e3 * scatter:.0f} ms (standard deviation over"
        " parts of two seconds), so their clocks are not synchronised"
    )
    if any(record.body_rates is None or record.specific_force is None for record in records):
        return Synchronised(records, False, [doubt])
    kept = [
        coarser(
            replace(record, position=None, velocity=None, attitude=None), max(1, round(SLOW_PERIOD / record.period))
        )
        for record in records
    ]
    what = f"position, velocity and attitude are left out, and the rest is averaged over {1e3 * SLOW_PERIOD:.0f} ms"
    return Synchronised(kept, False, [f"{doubt}; {what}"])


def fast_command_remarks(records: Sequence[FlightRecord]) -> list[str]:
    """Return a sentence on each record that may lack commands between its samples."""
    return [
        f"{record.name}: {share:.0%} of the power of the commands lies above half of the Nyquist frequency, so that the"
        " log may lack commands between its samples"
        for record in records
        if (share := fast_command_share(record)) > _MIN_FAST_SHARE
    ]


def lack_commands(records: Sequence[FlightRecord]) -> bool:
    """Return whether some of the logs may lack commands between their samples."""
    return any(fast_command_share(record) > _MIN_FAST_SHARE for record in records)


def fast_command_share(record: FlightRecord) -> float:
    """Return the share of the power of the commands above half of the Nyquist frequency of the log, in flight.

    The commands are the differences between rotors, which turn the vehicle. The share is 0 without rotor commands.
    """
    commands = record.motor_command if record.motor_command is not None else record.rotor_speed_command
    if commands is None:
        return 0.0
    differences = (commands - commands.mean(axis=1, keepdims=True))[airborne(record)]
    if len(differences) < _SPECTRUM_LENGTH:
        return 0.0
    frequency, power = scipy.signal.welch(differences, nperseg=_SPECTRUM_LENGTH, axis=0, detrend="linear")
    total = float(power.sum())
    return float(power[frequency > 0.25].sum()) / total if total > 0.0 else 0.0


def slow_fit(logs: PreparedLogs, parameters: Sequence[Parameter], fitted: PredictionFit) -> SlowFit | None:
    """Fit the logs at a longer period; return None if they are already slow, or too short."""
    slow = logs.coarser()
    if slow is None:
        return None
    try:
        predictor = slow.predictor(names_of(parameters), slow.flying)
        found = fit(predictor, parameters, fitted.noise, fitted.values)
    except InputError:
        return None
    covariance = found.uncertainty(window_blocks(predictor)).covariance
    return SlowFit(found.values, np.diag(covariance), slow.period)


def with_bandwidth(
    uncertainty: Uncertainty,
    parameters: Sequence[Parameter],
    values: np.ndarray,
    slow: SlowFit,
    period: float,
    *,
    lacks_commands: bool,
) -> tuple[Uncertainty, list[str]]:
    """Return the uncertainty including the dependence of the parameters on the bandwidth of the logs, and remarks.

    Averaging over a period h distorts an estimate in proportion to h². The variance of the estimate is therefore
    increased by the square of h² / (H² - h²) times the difference from the estimate at a period H (Richardson's
    extrapolation).

    If the model is correct, the two estimates also differ by an error whose variance is the difference of the two
    variances (J. A. Hausman, Econometrica 46, 1978). If logs lack commands between their samples, the interval of a
    parameter that differs by more is widened to contain both estimates.

    Args:
        uncertainty: uncertainty of the parameters.
        parameters: p parameters.
        values: (p,) estimates.
        slow: fit to the same logs at a longer period.
        period: period of the logs, s.
        lacks_commands: True if commands between the samples may be missing.
    """
    squares = (values - slow.values) ** 2
    own = np.diag(uncertainty.covariance)
    differs = np.full(len(own), lacks_commands) & (squares > _DIFFERENCE_SIGMA**2 * (slow.variances + own))
    excess = np.maximum(squares - np.maximum(slow.variances - own, 0.0), 0.0)
    distortion = squares * (period**2 / (slow.period**2 - period**2)) ** 2
    wider = np.sqrt(1.0 + (np.where(differs, excess, 0.0) + distortion) / own)
    remarks = [
        f"{parameter.name} depends on the bandwidth of the log: it is {value:.3g} at samples of {1e3 * period:.0f} ms,"
        f" and {other:.3g} at {1e3 * slow.period:.0f} ms; the interval contains both"
        for parameter, value, other, changed in zip(parameters, values, slow.values, differs, strict=True)
        if changed
    ]
    return uncertainty._replace(covariance=uncertainty.covariance * np.outer(wider, wider)), remarks
