"""Logs whose samples or clocks limit what they identify.

A log that is slower than the control loop lacks commands between its samples, and a log that was received over a radio
link has two clocks: that of the vehicle, for its commands and sensors on board, and that of the motion capture system.
Both distort the fast part of the motion, from which lags and moments of inertia are identified.
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

_SPECTRUM = 256  # samples of a part of a spectrum
_FAST_COMMANDS = 0.2  # share of the power above half of the Nyquist frequency; white noise has 0.5
_DIFFERS = 2.0  # standard deviations by which estimates of two bandwidths differ
# s, standard deviation of the shift between two clocks. Logs from one clock have 0.3 ms, noisy ones up to 5 ms, and
# radio logs 12 to 26 ms.
_MAX_CLOCK_SCATTER = 8e-3
_MIN_CLOCK_PARTS = 4
_MIN_LEAD = 2e-3  # s


class SlowFit(NamedTuple):
    """Fit to the same logs at a longer period.

    Attributes:
        values: (p,) parameters.
        variances: (p,) variances of their errors.
        period: period, s.
    """

    values: np.ndarray
    variances: np.ndarray
    period: float


class Synchronised(NamedTuple):
    """Records whose signals are of the same time.

    Attributes:
        records: records.
        late_attitude: whether the attitude is that of an estimator with a gyroscope, and late.
        remarks: sentences on what was changed.
    """

    records: Sequence[FlightRecord]
    late_attitude: bool
    remarks: list[str]


def synchronised(records: Sequence[FlightRecord]) -> Synchronised:
    """Return records whose signals are of the same time.

    Body rates that lead the attitude cannot have been derived from it, so they are those of a gyroscope. The attitude
    is then that of an estimator, whose errors are not white noise, and it is not predicted.

    If the shift varies, poses are from another clock than the sensors on board. They are left out, since commands are
    logged on board. What is left has uncertain times as well, so its samples are averaged. Without gyroscope and
    accelerometer, all signals are kept.
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
    """Return the records without poses, given the standard deviation of their shift in s."""
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
        if (share := fast_command_share(record)) > _FAST_COMMANDS
    ]


def lack_commands(records: Sequence[FlightRecord]) -> bool:
    """Return whether logs may lack commands between their samples."""
    return any(fast_command_share(record) > _FAST_COMMANDS for record in records)


def fast_command_share(record: FlightRecord) -> float:
    """Return the share of the power of the commands above half of the Nyquist frequency of the log, in flight.

    It is that of the differences between rotors, which turn the vehicle; 0 if there are no commands for rotors.
    """
    commands = record.motor_command if record.motor_command is not None else record.rotor_speed_command
    if commands is None:
        return 0.0
    differences = (commands - commands.mean(axis=1, keepdims=True))[airborne(record)]
    if len(differences) < _SPECTRUM:
        return 0.0
    frequency, power = scipy.signal.welch(differences, nperseg=_SPECTRUM, axis=0, detrend="linear")
    total = float(power.sum())
    return float(power[frequency > 0.25].sum()) / total if total > 0.0 else 0.0


def slow_fit(logs: PreparedLogs, parameters: Sequence[Parameter], fitted: PredictionFit) -> SlowFit | None:
    """Return a fit to the logs at a longer period; None if they are slow or too short for that."""
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
    """Return the uncertainty with what parameters depend on the bandwidth of the logs, and remarks.

    Averages over a period h distort an estimate by about h². So a share h² / (H² - h²) of the difference to the
    estimate for a period H is added to its standard deviation (Richardson's extrapolation).

    If the model holds, the two differ besides by an error whose variance is the difference of the two variances (J. A.
    Hausman, Econometrica 46, 1978). Where logs lack commands between their samples, the interval of a parameter that
    differs by more contains both estimates.

    Args:
        uncertainty: uncertainty of the parameters.
        parameters: parameters.
        values: (p,) estimates.
        slow: estimates from slower logs.
        period: period of the logs, s.
        lacks_commands: whether commands between the samples may be missing.
    """
    squares = (values - slow.values) ** 2
    own = np.diag(uncertainty.covariance)
    differs = np.full(len(own), lacks_commands) & (squares > _DIFFERS**2 * (slow.variances + own))
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
