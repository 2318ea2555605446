"""Checks of logged times: order, gaps and jitter."""

from collections.abc import Iterator

import numpy as np

_GAP_RATIO = 3.0  # shortest gap, in median steps of the clock; a single lost sample does not count as a gap
_MAX_TIME = 1e12  # s, thirty thousand years; larger times are damaged data
_MIN_JITTER = 0.05  # smallest reported standard deviation of the steps, relative to their median


def increasing_samples(time: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return a mask (n,) of samples with increasing times, and remarks on the samples that are left out.

    A sample is left out if its time is not a number, repeats the time of the preceding sample, or is out of order. A
    sample is late if an earlier sample has a later time, and early if a later sample has an earlier time. If the clock
    jumps ahead for one sample, this sample is early. If the clock is set back, samples are late until it has caught up.
    Either the late or the early samples are left out, whichever are fewer.

    Args:
        time: (n,) logged times, s.
    """
    is_number = np.abs(time) < _MAX_TIME
    remarks = []
    if not is_number.all():
        remarks.append(f"{_sample_count(~is_number)} left out: their time is not a number")
    indices = np.flatnonzero(is_number)
    times = time[indices]
    is_repeated = np.zeros(len(times), dtype=bool)
    is_repeated[1:] = times[1:] == times[:-1]
    if is_repeated.any():
        remarks.append(f"{_sample_count(is_repeated)} left out: they repeat the time of the preceding sample")
    indices, times = indices[~is_repeated], times[~is_repeated]
    is_late, is_early = np.zeros(len(times), dtype=bool), np.zeros(len(times), dtype=bool)
    if len(times):
        is_late[1:] = times[1:] <= np.maximum.accumulate(times)[:-1]
        is_early[:-1] = times[:-1] >= np.minimum.accumulate(times[::-1])[::-1][1:]
    is_wrong = is_early if is_early.sum() < is_late.sum() else is_late
    if is_wrong.any():
        steps = np.diff(times)
        worst = int(np.argmin(steps))
        remarks.append(
            f"{_sample_count(is_wrong)} left out: the clock goes back {_count_text(int((steps < 0.0).sum()))}, by up"
            f" to {-steps[worst]:.4g} s at {times[worst] - times[0]:.4g} s"
        )
    is_increasing = np.zeros(len(time), dtype=bool)
    is_increasing[indices[~is_wrong]] = True
    return is_increasing, remarks


def gaps(time: np.ndarray) -> np.ndarray:
    """Return a mask (n - 1,) of the time steps that are longer than three median steps, for increasing times (n,)."""
    steps = np.diff(time)
    return np.asarray(steps > _GAP_RATIO * np.median(steps)) if len(steps) else np.zeros(0, dtype=bool)


def timing_remarks(time: np.ndarray) -> Iterator[str]:
    """Yield remarks on the gaps and the jitter of increasing times (n,), s."""
    steps, is_gap = np.diff(time), gaps(time)
    median = float(np.median(steps))
    if is_gap.any():
        longest = int(np.argmax(steps))
        yield (
            f"{is_gap.sum()} gap{'s' if is_gap.sum() > 1 else ''} (steps of more than {_GAP_RATIO:.0f} times the median"
            f" of {median:.4g} s), {steps[is_gap].sum():.4g} s in total; the longest lasts {steps[longest]:.4g} s, from"
            f" {time[longest] - time[0]:.4g} s on"
        )
    regular = steps[~is_gap]
    jitter = float(np.std(regular))
    if jitter > _MIN_JITTER * median:
        yield (
            f"the time steps are uneven: the median is {median:.4g} s, the standard deviation {jitter:.2g} s, and the"
            f" range {regular.min():.4g} to {regular.max():.4g} s (without gaps)"
        )


def _sample_count(chosen: np.ndarray) -> str:
    count = int(chosen.sum())
    return f"{count:,} samples" if count > 1 else "1 sample"


def _count_text(count: int) -> str:
    return f"{count:,} times" if count > 1 else "once"
