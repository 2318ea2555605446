"""Division of flight records into windows of equal length in which the vehicle is airborne.

A predictor starts some time before each window, in which it forgets its initial state. The rotors follow their commands
for a further time before that:

    |- rotors follow -|- the predictor settles -|- predictions count -|
    start - settle - warm-up   start - settle   start                 start + length
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError, shown
from drake_quad.identification.logs.record import QUANTITIES, FlightRecord
from drake_quad.identification.logs.timing import gaps

# Specific force of a collision, m/s². Rotors give up to three times the weight along z, and little along x and y.
_COLLISION_FORCE = 2.0 * 9.81
# Time that is excluded around unusable samples, s, since the vehicle may be about to crash, or in ground effect.
_MARGIN = 1.0
# Largest pitch of usable samples, rad. At 75° the noise of roll and yaw is four times that in level flight.
_MAX_PITCH = np.radians(75.0)
_IDLE_RATIO = 0.5  # command relative to its median; the rotors do not carry the vehicle with less
_PERIOD_TOLERANCE = 0.1  # relative difference of the periods of logs of the same rate


class LogWindow(NamedTuple):
    """Window of a record.

    Attributes:
        record: index of the record.
        start: index of the first sample whose prediction counts.
    """

    record: int
    start: int


class WindowSizes(NamedTuple):
    """Sizes of windows, in samples.

    Attributes:
        length: number of samples whose prediction counts.
        settle: number of samples before them in which the predictor settles.
        warm_up: number of samples before those in which the rotors follow their commands.
    """

    length: int
    settle: int
    warm_up: int


def common_period(records: Sequence[FlightRecord]) -> float:
    """Return the time between the samples of logs of the same rate, s.

    Raises:
        InputError: if the logs have different rates.
    """
    period = float(np.median([record.period for record in records]))
    odd = next((record for record in records if abs(record.period / period - 1.0) > _PERIOD_TOLERANCE), None)
    if odd is not None:
        raise InputError(
            f"the log {shown(odd.name)} has {1.0 / odd.period:.0f} samples a second, and others {1.0 / period:.0f};"
            " identify from logs of one rate, one after another"
        )
    return period


def pieces(record: FlightRecord) -> np.ndarray:
    """Return the piece number (n,) of each sample. A new piece starts after each gap."""
    return np.concatenate([[0], np.cumsum(gaps(record.time))])


def airborne(record: FlightRecord) -> np.ndarray:
    """Return a mask (n,) of the samples in which the vehicle is airborne and its attitude is usable.

    The vehicle counts as airborne while the mean of its commands over one second is at least half of their median. The
    first and the last second of each flight are excluded. So are samples within a second of a collision, or of a pitch
    beyond 75°, where roll and yaw are mostly noise.
    """
    command = effort(record)
    flying = np.ones(len(record.time), dtype=bool)
    around = min(max(1, round(_MARGIN / record.period)), len(record.time))
    if command is not None:
        working = command > 0.0
        mean = np.convolve(command, np.ones(around) / around, "same")
        flying &= ~_near(mean < _IDLE_RATIO * np.median(command[working]) if working.any() else ~working, around)
    if record.specific_force is not None:
        flying &= ~_near(np.abs(record.specific_force).max(axis=1) > _COLLISION_FORCE, around)
    return flying & ~_near(_steep(record), around)


def steep_remarks(records: Sequence[FlightRecord]) -> list[str]:
    """Return a sentence on each record with a pitch near ±90°."""
    return [
        f"the log {shown(record.name)} pitches beyond 75 degrees for {np.sum(_steep(record)) * record.period:.2g} s,"
        f" which are left out with {_MARGIN:g} s around them: roll and yaw are mostly noise there"
        for record in records
        if _steep(record).any()
    ]


def coarser(record: FlightRecord, step: int) -> FlightRecord:
    """Return a record with a longer period, in which each sample is the mean of several original samples.

    Commands are averaged from one new sample to the next. Measurements are averaged over half a new period on both
    sides, which removes vibration without a delay.

    Args:
        record: original record.
        step: number of original periods in a new period.
    """
    if step == 1:
        return record
    count = (len(record.time) - step) // step
    first = step * np.arange(count) + step // 2
    around = np.ones(step + 1 - step % 2)
    if step % 2 == 0:
        around[[0, -1]] = 0.5
    around /= around.sum()
    reach = len(around) // 2
    held = np.arange(step), np.full(step, 1.0 / step)
    centred = np.arange(-reach, reach + 1), around
    values = {}
    for name, signal in record.signals():
        columns, angles = signal.reshape(len(signal), -1), QUANTITIES[name].unit == "rad"
        if angles:
            columns = np.unwrap(columns, axis=0)
        pairs = zip(*(held if "command" in name else centred), strict=True)
        mean = sum(weight * columns[first + offset] for offset, weight in pairs)
        if angles:
            mean = np.arctan2(np.sin(mean), np.cos(mean))
        values[name] = mean.reshape(count, *signal.shape[1:])
    return replace(record, time=record.time[first], **values)


def effort(record: FlightRecord) -> np.ndarray | None:
    """Return a signal (n,) that rises with the commanded thrust; None if no command is logged."""
    if record.motor_command is not None:
        return np.asarray(record.motor_command.mean(axis=1))
    if record.rotor_speed_command is not None:
        return np.asarray((record.rotor_speed_command**2).mean(axis=1))
    return record.thrust_command if record.thrust_command is not None else record.thrust_share


def _steep(record: FlightRecord) -> np.ndarray:
    """Return a mask (n,) of the samples with a pitch near ±90°."""
    if record.attitude is None:
        return np.zeros(len(record.time), dtype=bool)
    return np.asarray(np.abs(record.attitude[:, 1]) > _MAX_PITCH)


def _near(found: np.ndarray, samples: int) -> np.ndarray:
    """Return a mask (n,) of the samples that are at most a number of samples away from those in a mask."""
    total = np.concatenate([[0], np.cumsum(found)])
    index = np.arange(len(found))
    return np.asarray(
        total[np.minimum(index + samples + 1, len(found))] > total[np.maximum(index - samples, 0)], dtype=bool
    )


def cut(records: Sequence[FlightRecord], flying: Sequence[np.ndarray], sizes: WindowSizes) -> list[LogWindow]:
    """Divide records into consecutive windows.

    Args:
        records: records of flights.
        flying: (n,) mask of the usable samples of each record.
        sizes: sizes of the windows.
    """
    found = []
    for number, (record, usable) in enumerate(zip(records, flying, strict=True)):
        piece = pieces(record)
        broken = np.cumsum(~usable)
        start = sizes.settle
        while start + sizes.length < len(record.time):
            first, last = start - sizes.settle, start + sizes.length
            if piece[first] == piece[last] and usable[first] and broken[first] == broken[last]:
                found.append(LogWindow(number, start))
                start += sizes.length
            else:
                # The next window can start only after the last unusable sample or gap.
                bad = np.flatnonzero(~usable[first : last + 1] | (piece[first : last + 1] != piece[last]))
                start = first + int(bad[-1]) + 1 + sizes.settle
    return found


def within_half_a_turn(angles: np.ndarray) -> np.ndarray:
    """Wrap angles to the interval from -π to π, rad."""
    return np.asarray(angles - 2.0 * np.pi * np.rint(angles / (2.0 * np.pi)))


def held_out(flying: np.ndarray, share: float) -> np.ndarray:
    """Return a mask (n,) of the last airborne samples, which make up a share of all airborne samples."""
    total = np.cumsum(flying)
    return np.asarray(flying & (total > (1.0 - share) * total[-1]), dtype=bool)
