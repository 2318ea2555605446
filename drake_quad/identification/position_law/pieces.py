"""Flight logs as the regression of a position law takes them: stretches of flight with the output of the law."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError, shown
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.position_law.commands import FORMS, Form, at_limit, commanded, specific_thrust
from drake_quad.identification.prepared_logs import MAX_DELAY, MIN_BLOCKS
from drake_quad.identification.windows import airborne
from drake_quad.identification.windows import pieces as piece_numbers
from drake_quad.scenario.models import Scenario

MIN_REFERENCE_SPEED = 0.01  # m/s, standard deviation of a reference that moves
_MIN_REFERENCE_RANGE = 0.02  # m, of a reference that moves
_BLOCK = 2.0  # s, several times the memory of filters and quantisation
_MIN_PIECE = 2.0  # s, shortest stretch of flight with a constant of its own
_SMOOTHING = 0.1  # s, of parabolas through the reference for its derivatives
_MAX_REFERENCE_ACCELERATION = 50.0  # m/s², 5 g; a reference with more jumps


class Piece(NamedTuple):
    """Stretch of flight without a gap, as the regression takes it.

    Attributes:
        time: (m,), s.
        command: (m, 3) output of the law.
        error: (m, 3) p_r - p, m.
        position: (m, 3), m.
        velocity: (m, 3), m/s.
        reference_velocity: (m, 3), m/s.
        reference_acceleration: (m, 3), m/s².
        counted: (m,) mask of the samples that are compared.
    """

    time: np.ndarray
    command: np.ndarray
    error: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    reference_velocity: np.ndarray
    reference_acceleration: np.ndarray
    counted: np.ndarray


def prepared_pieces(
    record: FlightRecord, scenario: Scenario, remarks: list[str]
) -> tuple[dict[Form, list[Piece]], np.ndarray]:
    """Return the pieces of a record for each form, and the mask of limited samples among those in the air."""
    reference, position = record.of("reference_position"), record.of("position")
    if record.attitude_command is None:
        record.of("attitude")
        remarks.append("no attitude command is logged; the measured attitude stands for it, and the delay has its lag")
    usable = airborne(record)
    if not usable.any():
        raise InputError(f"the log {shown(record.name)} has no sample in the air")
    if np.all(np.ptp(reference[usable], axis=0) < _MIN_REFERENCE_RANGE):
        raise InputError(
            f"the reference of the log {shown(record.name)} does not move; a hover does not identify a position law"
        )
    thrust, remark = specific_thrust(record, scenario, usable)
    if remark is not None:
        remarks.append(remark)
    limited = at_limit(record, thrust, usable)
    counted = usable & ~limited
    number = piece_numbers(record)
    found: dict[Form, list[Piece]] = {form: [] for form in FORMS}
    for each in range(number.max() + 1):
        here = number == each
        if counted[here].sum() * record.period < _MIN_PIECE:
            continue
        piece = _piece(record.part(here), reference[here] - position[here], counted[here])
        for form in FORMS:
            command = commanded(record.part(here), thrust[here], form, float(scenario.nominal.gravity))
            found[form].append(piece._replace(command=command))
    if not found["tilt"]:
        raise InputError(f"the log {shown(record.name)} has no stretch of {_MIN_PIECE:g} s in the air without a gap")
    return found, limited[usable]


def _piece(record: FlightRecord, error: np.ndarray, counted: np.ndarray) -> Piece:
    """Return a piece without its command; derivatives that are not logged are those of smoothed signals."""
    reference, position = record.of("reference_position"), record.of("position")
    window = 2 * max(2, round(0.5 * _SMOOTHING / record.period)) + 1

    def slope(values: np.ndarray, order: int = 1) -> np.ndarray:
        """Return a derivative of parabolas through the values."""
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
    # A reference that jumps has no derivatives, so the samples whose smoothed or delayed reference jumps are left out.
    jumps = np.abs(slope(reference, 2)).max(axis=1) > _MAX_REFERENCE_ACCELERATION
    near = np.convolve(jumps, np.ones(1 + round(MAX_DELAY / record.period)))[: len(jumps)] > 0.5
    late = record.time >= record.time[0] + MAX_DELAY
    early = record.time <= record.time[-1] - record.period
    compared = counted & late & early & ~near
    return Piece(record.time, error, error, position, velocity, reference_velocity, acceleration, compared)


def block_numbers(pieces: Sequence[Piece]) -> np.ndarray:
    """Return the number (n,) of the block of each counted sample of an axis."""
    count = sum(int(piece.counted.sum()) for piece in pieces)
    seconds = count * float(np.median(np.diff(pieces[0].time)))
    number = max(MIN_BLOCKS, round(seconds / _BLOCK))
    return np.arange(count) * number // count
