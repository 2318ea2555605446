"""Checks of the clock of a log: rising times, gaps and jitter."""

from collections.abc import Iterator

import numpy as np

_GAP = 3.0  # median steps; a sample that is late by one period is no gap
_MAX_TIME = 1e12  # s, thirty thousand years
_MIN_JITTER = 0.05  # standard deviation of the steps relative to their median, from which a remark is made


def rising(time: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return a mask (n,) of samples whose times rise, and sentences on the samples that are left out.

    A sample is left out if its time is not a number, repeats that of the sample before, or is out of order. It is late
    if an earlier sample has a later time, and early if a later sample has an earlier time. A clock that jumps ahead
    once has an early sample, and a clock that is set back has late samples until it has caught up. Either the late or
    the early samples are left out, whichever are fewer.

    Args:
        time: (n,) logged times, s.
    """
    kept = np.abs(time) < _MAX_TIME
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
    return chosen, remarks


def gaps(time: np.ndarray) -> np.ndarray:
    """Return a mask (n - 1,) of the steps of a rising clock (n,) that are longer than three median steps."""
    steps = np.diff(time)
    return np.asarray(steps > _GAP * np.median(steps)) if len(steps) else np.zeros(0, dtype=bool)


def timing_remarks(time: np.ndarray) -> Iterator[str]:
    """Yield sentences on the gaps and the jitter of a rising clock (n,), s."""
    steps, is_gap = np.diff(time), gaps(time)
    median = float(np.median(steps))
    if is_gap.any():
        longest = int(np.argmax(steps))
        yield (
            f"{is_gap.sum()} gap{'s' if is_gap.sum() > 1 else ''} (steps of more than {_GAP:.0f} times the median of"
            f" {median:.4g} s), {steps[is_gap].sum():.4g} s in all, the longest of {steps[longest]:.4g} s at"
            f" {time[longest] - time[0]:.4g} s"
        )
    regular = steps[~is_gap]
    jitter = float(np.std(regular))
    if jitter > _MIN_JITTER * median:
        yield (
            f"the steps of the clock are uneven: {median:.4g} s in the median, with a standard deviation of"
            f" {jitter:.2g} s, from {regular.min():.4g} to {regular.max():.4g} s without the gaps"
        )


def _samples(chosen: np.ndarray) -> str:
    count = int(chosen.sum())
    return f"{count:,} samples" if count > 1 else "1 sample"


def _times(count: int) -> str:
    return f"{count:,} times" if count > 1 else "once"
