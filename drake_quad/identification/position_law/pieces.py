"""Preparation of logs for the regression of a position law: stretches of flight with the output of the law."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError, short_repr
from drake_quad.identification.position_law.commands import (
    FORMS,
    Form,
    at_limit,
    in_heading,
    law_output,
    specific_thrust,
    unproduced_output,
)
from drake_quad.identification.prepared_logs import MAX_DELAY, MIN_BLOCKS
from drake_quad.identification.windows import airborne_mask, segment_numbers
from drake_quad.logs.record import FlightRecord
from drake_quad.scenario.models import Scenario

MIN_REFERENCE_SPEED = 0.01  # m/s; a reference counts as moving if its velocity has a larger standard deviation
_MIN_REFERENCE_RANGE = 0.02  # m; a reference counts as moving if its position has a larger range
_SMOOTHING_WEIGHTS = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0  # binomial weights of adjacent samples
_MIN_PIECE_DURATION = 2.0  # s, shortest stretch of flight that is used
_MIN_SAMPLES = 60  # smallest number of samples in a stretch, several per parameter
_BLOCK_DURATION = 2.0  # s, duration of a block, several times the correlation time of errors
_SLOPE_WINDOW = 0.1  # s; the derivatives of the reference are those of parabolas fitted to windows of this duration
_MAX_REFERENCE_ACCELERATION = 50.0  # m/s², about 5 g; a reference with a larger acceleration jumps


class Piece(NamedTuple):
    """Stretch of flight without a gap, with vectors along the axes of the law.

    Attributes:
        time: (m,) times of the samples, s.
        command: (m, 3) output of the law, m/s². If the form of the law is `tilt`, X and Y are in rad.
        error: (m, 3) position error p_r - p, m.
        velocity: (m, 3) measured velocity, m/s.
        reference_velocity: (m, 3) velocity of the reference, m/s.
        reference_acceleration: (m, 3) acceleration of the reference, m/s².
        travel: (m, 3) integral of the velocity, m.
        deviation: (m, 3) position error minus the integral of the velocity error, m. A controller that integrates the
            velocity error does not integrate the position noise in this difference. It is zero in forms that do not
            imply that the controller integrates the velocity error.
        anti_windup: (m, 3) integral of the output that the thrust does not produce (`unproduced_output` in
            `drake_quad.identification.position_law.commands`), m/s.
        evaluated: (m,) mask of the samples that the regression uses.
    """

    time: np.ndarray
    command: np.ndarray
    error: np.ndarray
    velocity: np.ndarray
    reference_velocity: np.ndarray
    reference_acceleration: np.ndarray
    travel: np.ndarray
    deviation: np.ndarray
    anti_windup: np.ndarray
    evaluated: np.ndarray


def prepared_pieces(
    record: FlightRecord, scenario: Scenario, remarks: list[str]
) -> tuple[dict[Form, list[Piece]], np.ndarray]:
    """Divide a record into stretches of flight without gaps.

    Args:
        record: record of a flight.
        scenario: scenario with the `nominal` vehicle that the controller assumes.
        remarks: list to which remarks on the record are appended.

    Returns:
        The pieces for each form in `FORMS`, which relates the output of the position law to the commands, and a mask
        over the samples in the air, True where a command is at a limit.

    Raises:
        InputError: if the log lacks a signal, its reference does not move, or it contains no stretch of flight that is
            long enough.
    """
    reference, position = record.of("reference_position"), record.of("position")
    if record.attitude_command is None:
        record.of("attitude")
        remarks.append(
            "no attitude command is logged; the measured attitude is used instead, and the delay includes its lag"
        )
    usable = airborne_mask(record)
    if not usable.any():
        raise InputError(f"the log {short_repr(record.name)} has no sample in the air")
    if np.all(np.ptp(reference[usable], axis=0) < _MIN_REFERENCE_RANGE):
        raise InputError(
            f"the reference of the log {short_repr(record.name)} does not move; use a log with a moving reference"
        )
    thrust, remark = specific_thrust(record, scenario, usable)
    if remark is not None:
        remarks.append(remark)
    limited = at_limit(record, thrust, usable)
    evaluated = usable & ~limited
    piece_number = segment_numbers(record)
    min_samples = max(_MIN_PIECE_DURATION / record.period, _MIN_SAMPLES)
    pieces: dict[Form, list[Piece]] = {form: [] for form in FORMS}
    for number in range(piece_number.max() + 1):
        in_piece = piece_number == number
        if evaluated[in_piece].sum() < min_samples:
            continue
        part = record.subset(in_piece)
        signals, is_used = _signals(part, reference[in_piece] - position[in_piece], evaluated[in_piece])
        if is_used.sum() < min_samples:
            continue
        for form in FORMS:
            pieces[form].append(_piece(part, thrust[in_piece], form, float(scenario.nominal.gravity), signals, is_used))
    if not pieces["tilt"]:
        raise InputError(
            f"the log {short_repr(record.name)} has no uninterrupted stretch of flight of at least"
            f" {_MIN_PIECE_DURATION:g} s and {_MIN_SAMPLES} samples; gaps, saturated commands and jumps of the"
            " reference are left out"
        )
    return pieces, limited[usable]


def _signals(record: FlightRecord, error: np.ndarray, evaluated: np.ndarray) -> tuple[list[np.ndarray], np.ndarray]:
    """Return error, velocity, reference velocity and reference acceleration (m, 3), and a mask of the samples to use.

    Derivatives that are not logged are calculated from smoothed signals.
    """
    reference, position = record.of("reference_position"), record.of("position")
    window = 2 * max(2, round(0.5 * _SLOPE_WINDOW / record.period)) + 1

    def slope(values: np.ndarray, order: int = 1) -> np.ndarray:
        """Return a derivative (m, 3) of local parabolas through the values."""
        return np.asarray(
            scipy.signal.savgol_filter(values, window, 2, deriv=order, delta=record.period, axis=0, mode="interp")
        )

    velocity = slope(position) if record.velocity is None else record.velocity
    if record.reference_velocity is None:
        reference_velocity, acceleration = slope(reference), slope(reference, 2)
    else:
        reference_velocity, acceleration = record.reference_velocity, slope(record.reference_velocity)
    if record.reference_acceleration is not None:
        acceleration = record.reference_acceleration
    # A reference has no derivatives where it jumps. Samples to which a jump contributes by smoothing or delay are left
    # out.
    jumps = np.abs(slope(reference, 2)).max(axis=1) > _MAX_REFERENCE_ACCELERATION
    is_near_jump = np.convolve(jumps, np.ones(1 + round(MAX_DELAY / record.period)))[: len(jumps)] > 0.5
    is_after_delay = record.time >= record.time[0] + MAX_DELAY
    is_usable = (
        np.convolve(evaluated & is_after_delay & ~is_near_jump, np.ones(len(_SMOOTHING_WEIGHTS)), "same")
        > len(_SMOOTHING_WEIGHTS) - 0.5
    )
    return [error, velocity, reference_velocity, acceleration], is_usable


def _piece(
    record: FlightRecord,
    thrust: np.ndarray,
    form: Form,
    gravity: float,
    signals: Sequence[np.ndarray],
    is_used: np.ndarray,
) -> Piece:
    """Return a stretch of flight with smoothed signals, along the axes of the law."""
    output = law_output(record, thrust, form, gravity)
    if form == "tilt":
        signals = [in_heading(record, each) for each in signals]
    lost_output = unproduced_output(output, form, gravity)
    # Delayed signals are interpolated between samples. Interpolation reduces white noise such as rounding errors, most
    # of all half-way between samples. This would bias the delay and the velocity gains if the signals were not
    # smoothed.
    command, error, velocity, reference_velocity, acceleration, lost_output = (
        scipy.ndimage.convolve1d(each, _SMOOTHING_WEIGHTS, axis=0, mode="nearest")
        for each in (output, *signals, lost_output)
    )

    def integral(values: np.ndarray) -> np.ndarray:
        return np.asarray(scipy.integrate.cumulative_trapezoid(values, record.time, axis=0, initial=0.0))

    return Piece(
        record.time,
        command,
        error,
        velocity,
        reference_velocity,
        acceleration,
        integral(velocity),
        error - integral(reference_velocity - velocity) if form == "decoupled" else np.zeros_like(error),
        integral(lost_output),
        is_used,
    )


def block_numbers(pieces: Sequence[Piece]) -> np.ndarray:
    """Return the block number (n,) of each sample that the regression uses. All blocks have nearly the same length."""
    count = sum(int(piece.evaluated.sum()) for piece in pieces)
    seconds = count * float(np.median(np.diff(pieces[0].time)))
    return np.arange(count) * max(MIN_BLOCKS, round(seconds / _BLOCK_DURATION)) // count
