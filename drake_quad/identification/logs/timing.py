"""The clock of a log: what is wrong with it, what is done about that, and the parts between its gaps."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from drake_quad.identification.logs.record import FlightRecord

# A step that is so many times as long as the median is a gap: a sample late by one period is none.
GAP = 3.0
# Thirty thousand years, s: no clock shows it.
_LATEST = 1e12
# A standard deviation of the steps that is a larger share of the median is worth a remark.
_JITTER = 0.05


class Clock(NamedTuple):
    """What remains of a clock.

    Attributes:
        kept: (n,) True for the samples that stay: their times rise.
        remarks: sentences on what was wrong.
    """

    kept: np.ndarray
    remarks: tuple[str, ...]


class Gap(NamedTuple):
    """A step of a clock that is too long.

    Attributes:
        after: the number of the sample before it.
        start: s.
        length: s.
    """

    after: int
    start: float
    length: float


def rising(time: np.ndarray) -> Clock:
    """Chooses samples whose times rise, as many as the clock allows.

    A sample is left out whose time is no number, repeats that of the sample before, or is out of order. What is out of
    order is either late, after a later time, or early, before an earlier one: a clock that once runs ahead is early,
    one that is set back makes all that follows late until it has caught up. Of the two the choice falls on that which
    leaves out less.

    Args:
        time: (n,) as logged, s.
    """
    kept = np.abs(time) < _LATEST
    remarks = []
    if not kept.all():
        remarks.append(f"{_samples(~kept)} left out: their time is no number")
    numbers = np.flatnonzero(kept)
    t = time[numbers]
    repeated = np.zeros(len(t), dtype=bool)
    repeated[1:] = t[1:] == t[:-1]
    if repeated.any():
        remarks.append(f"{_samples(repeated)} left out: they repeat the time of the sample before")
    numbers, t = numbers[~repeated], t[~repeated]
    late, early = np.zeros(len(t), dtype=bool), np.zeros(len(t), dtype=bool)
    if len(t):
        late[1:] = t[1:] <= np.maximum.accumulate(t)[:-1]
        early[:-1] = t[:-1] >= np.minimum.accumulate(t[::-1])[::-1][1:]
    wrong = early if early.sum() < late.sum() else late
    if wrong.any():
        back = np.diff(t)
        worst = int(np.argmin(back))
        remarks.append(
            f"{_samples(wrong)} left out: the clock goes back {_times(int((back < 0.0).sum()))}, at most by"
            f" {-back[worst]:.4g} s at {t[worst] - t[0]:.4g} s"
        )
    chosen = np.zeros(len(time), dtype=bool)
    chosen[numbers[~wrong]] = True
    return Clock(chosen, tuple(remarks))


def gaps(time: np.ndarray) -> Iterator[Gap]:
    """The steps of a rising clock that are longer than three of its median.

    Args:
        time: (n,) s.
    """
    steps = np.diff(time)
    if len(steps):
        for after in np.flatnonzero(steps > GAP * np.median(steps)).tolist():
            yield Gap(after, float(time[after]), float(steps[after]))


def timing_remarks(time: np.ndarray) -> Iterator[str]:
    """Sentences on the gaps and the jitter of a rising clock.

    Args:
        time: (n,) s.
    """
    steps = np.diff(time)
    median = float(np.median(steps))
    found = list(gaps(time))
    if found:
        longest = max(found, key=lambda gap: gap.length)
        yield (
            f"{len(found)} gap{'s' if len(found) > 1 else ''} (steps of more than {GAP:.0f} times the median of"
            f" {median:.4g} s), {sum(gap.length for gap in found):.4g} s in all, the longest of {longest.length:.4g} s"
            f" at {longest.start - time[0]:.4g} s"
        )
    regular = steps[steps <= GAP * median]
    jitter = float(np.std(regular))
    if jitter > _JITTER * median:
        yield (
            f"the steps of the clock are uneven: {median:.4g} s in the median, with a standard deviation of"
            f" {jitter:.2g} s, from {regular.min():.4g} to {regular.max():.4g} s without the gaps"
        )


def pieces(record: FlightRecord, *, shortest: float = 0.0) -> list[FlightRecord]:
    """The parts of a record between the gaps of its clock, which goes on through them.

    Args:
        record: of a flight.
        shortest: a part that is shorter is left out, s; one of a single sample always is.
    """
    ends = [gap.after + 1 for gap in gaps(record.time)]
    bounds = zip([0, *ends], [*ends, len(record.time)], strict=True)
    return [
        record.part(slice(first, end))
        for first, end in bounds
        if end - first > 1 and record.time[end - 1] - record.time[first] >= shortest
    ]


def _samples(chosen: np.ndarray) -> str:
    count = int(chosen.sum())
    return f"{count:,} samples" if count > 1 else "1 sample"


def _times(count: int) -> str:
    return f"{count:,} times" if count > 1 else "once"
