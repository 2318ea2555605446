"""Division of flight records into windows of equal length in which the vehicle is airborne.

The predictor starts some time before each window, so that the effect of its initial state has decayed when the window
starts. During the warm-up before this settling time, only the rotors are simulated, which follow their commands:

    |- rotors warm up -|- predictor settles -|- prediction errors are evaluated -|
    start - settle     start - settle        start                               start + length
    - warm_up
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError, short_repr
from drake_quad.logs.record import QUANTITIES, FlightRecord
from drake_quad.logs.timing import gaps

# A sample with a larger specific force along any axis, in m/s², counts as a collision.
_COLLISION_FORCE = 2.0 * 9.81
# Time before and after unusable samples that is excluded, s, since the vehicle may be crashing or in ground effect.
_EXCLUDED_TIME = 1.0
# Largest pitch of usable samples, rad. At 75°, the noise of roll and yaw is four times the noise in level flight.
_MAX_PITCH = np.radians(75.0)
_MIN_COMMAND_RATIO = 0.5  # mean command of an airborne vehicle, relative to the median of the positive commands
_PERIOD_TOLERANCE = 0.1  # relative difference of periods that count as equal


class LogWindow(NamedTuple):
    """Window of a record.

    Attributes:
        record: index of the record.
        start: index of the first sample whose prediction error is evaluated.
    """

    record: int
    start: int


class WindowSizes(NamedTuple):
    """Sizes of windows, in samples.

    Attributes:
        length: number of samples whose prediction errors are evaluated.
        settle: number of preceding samples in which the predictor settles.
        warm_up: number of samples before the settling time, in which the rotors follow their commands.
    """

    length: int
    settle: int
    warm_up: int


def common_period(records: Sequence[FlightRecord]) -> float:
    """Return the common time between the samples of all logs, s.

    Raises:
        InputError: if the logs have different sample rates.
    """
    period = float(np.median([record.period for record in records]))
    other = next((record for record in records if abs(record.period / period - 1.0) > _PERIOD_TOLERANCE), None)
    if other is not None:
        raise InputError(
            f"the log {short_repr(other.name)} has {1.0 / other.period:.0f} samples per second, but another log has"
            f" {1.0 / period:.0f}; identify from logs with the same sample rate"
        )
    return period


def segment_numbers(record: FlightRecord) -> np.ndarray:
    """Return the segment number (n,) of each sample. A new segment starts after each gap in the record."""
    return np.concatenate([[0], np.cumsum(gaps(record.time))])


def airborne_mask(record: FlightRecord) -> np.ndarray:
    """Return a mask (n,) of the samples in which the vehicle is airborne and its attitude is usable.

    The vehicle counts as airborne while the mean of its commands over one second is at least half of the median of the
    positive commands. The first and last second of each flight are excluded. Samples within a second of a collision, or
    of a pitch beyond 75°, are excluded as well. Beyond this pitch, roll and yaw are mostly noise.
    """
    command = commanded_effort(record)
    flying = np.ones(len(record.time), dtype=bool)
    num_margin_samples = min(max(1, round(_EXCLUDED_TIME / record.period)), len(record.time))
    if command is not None:
        positive = command > 0.0
        mean = np.convolve(command, np.ones(num_margin_samples) / num_margin_samples, "same")
        flying &= ~_near(
            mean < _MIN_COMMAND_RATIO * np.median(command[positive]) if positive.any() else ~positive,
            num_margin_samples,
        )
    if record.specific_force is not None:
        flying &= ~_near(np.abs(record.specific_force).max(axis=1) > _COLLISION_FORCE, num_margin_samples)
    return flying & ~_near(_steep_pitch_mask(record), num_margin_samples)


def steep_pitch_remarks(records: Sequence[FlightRecord]) -> list[str]:
    """Return a remark on each record with a pitch near ±90°."""
    return [
        f"the log {short_repr(record.name)} pitches beyond 75 degrees for"
        f" {np.sum(_steep_pitch_mask(record)) * record.period:.2g} s, which are left out with"
        f" {_EXCLUDED_TIME:g} s before and after, because roll and yaw are then mostly noise"
        for record in records
        if _steep_pitch_mask(record).any()
    ]


def downsample(record: FlightRecord, step: int) -> FlightRecord:
    """Return a record with a longer period, in which each sample is the mean of several original samples.

    Commands are averaged from one new sample to the next. Measurements are averaged over half a new period before and
    after each new sample, which removes vibration without a delay.

    Args:
        record: original record.
        step: number of original periods in a new period.
    """
    if step == 1:
        return record
    count = (len(record.time) - step) // step
    first = step * np.arange(count) + step // 2
    weights = np.ones(step + 1 - step % 2)
    if step % 2 == 0:
        weights[[0, -1]] = 0.5
    weights /= weights.sum()
    half_width = len(weights) // 2
    command_average = np.arange(step), np.full(step, 1.0 / step)
    measurement_average = np.arange(-half_width, half_width + 1), weights
    values = {}
    for name, signal in record.signals():
        columns, is_angle = signal.reshape(len(signal), -1), QUANTITIES[name].unit == "rad"
        if is_angle:
            columns = np.unwrap(columns, axis=0)
        average = zip(*(command_average if "command" in name else measurement_average), strict=True)
        mean = sum(weight * columns[first + offset] for offset, weight in average)
        if is_angle:
            mean = np.arctan2(np.sin(mean), np.cos(mean))
        values[name] = mean.reshape(count, *signal.shape[1:])
    return replace(record, time=record.time[first], **values)


def commanded_effort(record: FlightRecord) -> np.ndarray | None:
    """Return a signal (n,) that increases with the commanded thrust; None if no command is logged."""
    if record.motor_command is not None:
        return np.asarray(record.motor_command.mean(axis=1))
    if record.rotor_speed_command is not None:
        return np.asarray((record.rotor_speed_command**2).mean(axis=1))
    return record.thrust_command if record.thrust_command is not None else record.thrust_fraction


def _steep_pitch_mask(record: FlightRecord) -> np.ndarray:
    """Return a mask (n,) of the samples with a pitch near ±90°."""
    if record.attitude is None:
        return np.zeros(len(record.time), dtype=bool)
    return np.asarray(np.abs(record.attitude[:, 1]) > _MAX_PITCH)


def _near(mask: np.ndarray, samples: int) -> np.ndarray:
    """Return a mask (n,) of the samples that are at most `samples` samples away from a sample in the given mask."""
    total = np.concatenate([[0], np.cumsum(mask)])
    index = np.arange(len(mask))
    return np.asarray(
        total[np.minimum(index + samples + 1, len(mask))] > total[np.maximum(index - samples, 0)], dtype=bool
    )


def split_into_windows(
    records: Sequence[FlightRecord], flying: Sequence[np.ndarray], sizes: WindowSizes
) -> list[LogWindow]:
    """Return consecutive windows in the usable parts of records.

    Args:
        records: records of flights.
        flying: (n,) mask of the usable samples of each record.
        sizes: sizes of the windows.
    """
    windows = []
    for index, (record, usable) in enumerate(zip(records, flying, strict=True)):
        piece = segment_numbers(record)
        num_unusable = np.cumsum(~usable)
        start = sizes.settle
        while start + sizes.length < len(record.time):
            first, last = start - sizes.settle, start + sizes.length
            if piece[first] == piece[last] and usable[first] and num_unusable[first] == num_unusable[last]:
                windows.append(LogWindow(index, start))
                start += sizes.length
            else:
                # The next window starts after the last unusable sample, or the last gap, in this window.
                obstacles = np.flatnonzero(~usable[first : last + 1] | (piece[first : last + 1] != piece[last]))
                start = first + int(obstacles[-1]) + 1 + sizes.settle
    return windows


def wrapped_angles(angles: np.ndarray) -> np.ndarray:
    """Wrap angles to the interval from -π to π, rad."""
    return np.asarray(angles - 2.0 * np.pi * np.rint(angles / (2.0 * np.pi)))


def held_out_mask(flying: np.ndarray, fraction: float) -> np.ndarray:
    """Return a mask (n,) of the last airborne samples; `fraction` is their fraction of all airborne samples."""
    total = np.cumsum(flying)
    return np.asarray(flying & (total > (1.0 - fraction) * total[-1]), dtype=bool)
