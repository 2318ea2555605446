"""Subset simulation, which estimates probabilities that are too small for plain sampling.

The probability is the product of conditional probabilities of about 0.1. Each factor is estimated from samples that
satisfy the preceding condition. Markov chains generate these samples (S.-K. Au and J. L. Beck, "Estimation of small
failure probabilities in high dimensions by subset simulation", Probabilistic Engineering Mechanics, 2001). The chains
use correlated proposals with an adapted correlation (I. Papaioannou, W. Betz, K. Zwirglmaier and D. Straub, "MCMC
algorithms for subset simulation", 2015).

The chains of one run are correlated, so a single run has no reliable interval. The interval follows from the spread of
independent runs.
"""

import math
from collections.abc import Callable, Generator, Sequence
from typing import NamedTuple

import numpy as np
import scipy.stats

from drake_quad.errors import InputError
from drake_quad.statistics.interval import CONFIDENCE, Interval

MIN_RUNS = 6
"""Smallest number of runs from which an interval is computed."""
MIN_SIZE = 500
"""Smallest number of samples in each step.

If a step has 200 samples, estimates of 1e-6 are 37 % too large, and their intervals are too short.
"""
NOISE_SEED_BOUND = 2**31
"""Upper bound (exclusive) on the integers that determine noise."""

_MAX_LEVELS = 15  # each level divides the probability by about ten, so estimates reach about 1e-15
_INITIAL_STEP = 0.6  # initial step of the proposals, whose correlation with the present samples is √(1 - step²)
_TARGET_ACCEPTANCE = 0.44  # acceptance rate at which the chains mix fastest, from Papaioannou et al.
# A rejected proposal repeats a sample, so several samples can have exactly the performance of the threshold. More
# samples than intended then reach the threshold. Up to this multiple of the intended number, the excess counts as
# repetition. Beyond it, different points have the same performance.
_MAX_REPETITION = 1.5
_MAX_FRACTION = 0.5  # if more than this fraction of the samples reach the threshold, it is raised
_MIN_SEEDS = 10  # smallest number of different samples from which chains start

Performance = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Function that returns the performance (n,) of samples, given (n, d) standard normal points and (n, b) integers.

The performance is a number that tells how close a sample is to the event. The event occurs if it is 0 or more.
"""


class SubsetRun(NamedTuple):
    """Run of subset simulation.

    Attributes:
        probability: estimated probability of the event; 0 if the event was not reached.
        levels: threshold on the performance after each step; the last threshold is 0 if the event was reached.
        fractions: fraction of the samples of each step that reach its threshold.
        equal_fraction: fraction of the samples of the last step that have the performance of the threshold, if the run
            ended without the event because too few samples exceed this performance; otherwise 0.
        points: (m, d) points of the last samples at which the event occurs.
        noise: (m, b) integers that determine the noise of these samples.
        performance: (m,) values of the performance at these samples.
        num_evaluations: number of evaluations of the performance.
        history: (steps, size) values of the performance at the samples of each step, in descending order.
    """

    probability: float
    levels: tuple[float, ...]
    fractions: tuple[float, ...]
    equal_fraction: float
    points: np.ndarray
    noise: np.ndarray
    performance: np.ndarray
    num_evaluations: int
    history: np.ndarray

    def exceedance(self, thresholds: np.ndarray) -> np.ndarray:
        """Return the estimated probabilities that the performance is at least each of the (k,) thresholds."""
        result = np.empty(len(thresholds))
        for i, threshold in enumerate(thresholds):
            step = sum(level <= threshold for level in self.levels[:-1])
            result[i] = math.prod(self.fractions[:step]) * np.mean(self.history[step] >= threshold)
        return result


SubsetSteps = Generator[tuple[np.ndarray, np.ndarray], np.ndarray, SubsetRun]
"""Generator that yields points and integers, is sent their values of the performance, and returns the finished run."""


def subset_simulation(
    performance: Performance,
    num_coordinates: int,
    num_noise: int,
    generator: np.random.Generator,
    *,
    size: int = 1000,
    fraction: float = 0.1,
) -> SubsetRun:
    """Run subset simulation once; see `subset_steps` for the arguments."""
    (run,) = run_together(
        performance, [subset_steps(num_coordinates, num_noise, generator, size=size, fraction=fraction)]
    )
    return run


def run_together(performance: Performance, runs: Sequence[SubsetSteps]) -> list[SubsetRun]:
    """Run several subset simulations simultaneously, and evaluate the samples of all runs together.

    Args:
        performance: function that returns the performance of each sample.
        runs: independent runs, see `subset_steps`.

    Returns:
        The finished runs, in the given order. They do not depend on one another.
    """
    finished: dict[int, SubsetRun] = {}
    waiting = {number: next(run) for number, run in enumerate(runs)}
    while waiting:
        points, noise = (np.concatenate(each) for each in zip(*waiting.values(), strict=True))
        ends = np.cumsum([len(points) for points, _ in waiting.values()])
        parts = np.split(performance(points, noise), ends[:-1])
        for number, values in zip([*waiting], parts, strict=True):
            try:
                waiting[number] = runs[number].send(values)
            except StopIteration as end:
                finished[number] = end.value
                del waiting[number]
    return [finished[number] for number in range(len(runs))]


def subset_steps(
    num_coordinates: int, num_noise: int, generator: np.random.Generator, *, size: int = 1000, fraction: float = 0.1
) -> SubsetSteps:
    """Run subset simulation as a generator that yields samples, and receives their performance by `send`.

    A proposal changes all coordinates a little, and draws some of the integers again. Both moves preserve the
    distribution of the samples. If most samples of a step have the same performance, only the samples that are closer
    to the event satisfy the condition of the next step. A run ends without an estimate if there are too few of them.

    Args:
        num_coordinates: number d of coordinates of a point.
        num_noise: number b of integers of a sample.
        generator: source of random numbers.
        size: number of samples in each step, a multiple of 1 / `fraction`.
        fraction: smallest fraction of the samples that satisfy the condition of the next step, unless most samples have
            the same performance.

    Returns:
        The finished run.
    """
    num_chains = round(fraction * size)
    points = generator.standard_normal((size, num_coordinates))
    noise = generator.integers(NOISE_SEED_BOUND, size=(size, num_noise))
    values = yield points, noise
    levels, fractions, history, num_evaluations, step = [], [], [], size, _INITIAL_STEP
    equal_fraction = 0.0
    for _ in range(_MAX_LEVELS):
        history.append(np.sort(values)[::-1])
        level = min(float(history[-1][num_chains - 1]), 0.0)
        if level < 0.0 and np.mean(values >= level) > _MAX_FRACTION:
            closer = values[values > level]
            if len(closer) < _MIN_SEEDS:
                equal_fraction = float(np.mean(values == level))
            else:
                level = 0.0 if np.all(closer >= 0.0) else float(np.nextafter(level, 0.0))
        levels.append(level)
        reaching = float(np.mean(values >= level))
        repeats = level < 0.0 and fraction <= reaching <= _MAX_REPETITION * fraction
        fractions.append(fraction if repeats else reaching)
        if level == 0.0 or equal_fraction:
            break
        chosen = np.argsort(-values, kind="stable")[:num_chains]
        chosen = np.resize(chosen[values[chosen] >= level], num_chains)
        chain = points[chosen], noise[chosen], values[chosen]
        states = [chain]
        for length in range(1, size // num_chains):
            moved = _proposal(*chain[:2], step, generator)
            moved_values = yield moved
            num_evaluations += num_chains
            is_accepted = moved_values >= level
            chain = (
                np.where(is_accepted[:, None], moved[0], chain[0]),
                np.where(is_accepted[:, None], moved[1], chain[1]),
                np.where(is_accepted, moved_values, chain[2]),
            )
            states.append(chain)
            step = min(1.0, step * math.exp((is_accepted.mean() - _TARGET_ACCEPTANCE) / math.sqrt(length)))
        points, noise, values = (np.concatenate(each) for each in zip(*states, strict=True))
    is_reached = levels[-1] == 0.0
    occurs = (values >= 0.0) & is_reached
    return SubsetRun(
        math.prod(fractions) if is_reached else 0.0,
        tuple(levels),
        tuple(fractions),
        equal_fraction,
        points[occurs],
        noise[occurs],
        values[occurs],
        num_evaluations,
        np.stack(history),
    )


def _proposal(
    points: np.ndarray, noise: np.ndarray, step: float, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Return proposals whose correlation with the present samples is √(1 - step²)."""
    correlation = math.sqrt(1.0 - step**2)
    moved = correlation * points + step * generator.standard_normal(points.shape)
    # Each integer of the noise is kept with a probability equal to the correlation, and drawn again otherwise.
    is_drawn = generator.random(noise.shape) < 1.0 - correlation
    return moved, np.where(is_drawn, generator.integers(NOISE_SEED_BOUND, size=noise.shape), noise)


def probability_of_runs(probabilities: Sequence[float], confidence: float = CONFIDENCE) -> Interval:
    """Return the mean of the estimates of independent runs, with an interval for the probability.

    The interval is Student's t-interval of the mean, on a logarithmic scale.

    Args:
        probabilities: estimates of at least `MIN_RUNS` runs.
        confidence: confidence of the interval.

    Raises:
        InputError: if there are too few runs, or a run has not reached the event.
    """
    values = np.asarray(probabilities, dtype=float)
    if len(values) < MIN_RUNS:
        raise InputError(f"an interval needs at least {MIN_RUNS} independent runs, but there are {len(values)}")
    if not np.all(values > 0.0):
        raise InputError(f"{int(np.sum(values == 0.0))} of {len(values)} runs did not reach the event")
    mean, count = float(values.mean()), len(values)
    deviation = float(values.std(ddof=1)) / (mean * math.sqrt(count))
    factor = math.exp(float(scipy.stats.t.ppf(0.5 + 0.5 * confidence, count - 1)) * deviation)
    return Interval(mean, mean / factor, min(mean * factor, 1.0))


def relative_half_width(interval: Interval) -> float:
    """Return half the width of an interval relative to the estimate."""
    return 0.5 * (interval.high - interval.low) / interval.value
