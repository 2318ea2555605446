"""What the samples of a study say, and how sure that is: every estimate with its confidence interval.

A crashed vehicle has no error that could be averaged: means are those of the flights that went to the end, and say how
many these are. Quantiles are those of all samples, a crash being worse than any error.

Intervals of means are Student's. They contain the mean of a skewed metric less often than they say if there are few
samples: the mean of log-normal numbers with σ = 1 in 84 % of studies of 10 samples and in 88 % of studies of 30. Tables
are in docs/how_to/studies.md. The intervals of quantiles and probabilities hold for any metric and any number of
samples.
"""

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError, listed
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario import distributions_in
from drake_quad.scenario.correlation import correlated_groups
from drake_quad.studies.interval import CONFIDENCE, Interval
from drake_quad.studies.ratios import ratio_of_means
from drake_quad.studies.study import Study

# Ranks of which less than this share remains when others are given are determined by these, but for rounding errors.
_MIN_REMAINDER = 1e-9
_MAX_EXPONENT = 600.0  # its exponential is finite
# Default bins of a number over which the probability of a crash is estimated.
_MIN_BINS = 2
_MAX_BINS = 20


def mean_interval(values: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Return the mean of (n,) values with Student's interval, whose ends are NaN for fewer than two values.

    The interval is too short for few values of a skewed metric. It can be trusted from about 25 times the squared
    skewness of the values on (W. G. Cochran, "Sampling Techniques", 1977).
    """
    if len(values) < 2:
        return Interval(float(values[0]) if len(values) else math.nan, math.nan, math.nan)
    mean, reach = float(np.mean(values)), float(_reach(np.std(values, ddof=1), len(values), confidence))
    return Interval(mean, mean - reach, mean + reach)


def positive(estimate: Interval) -> Interval:
    """Return an estimate of a number that is not negative, without the negative part of its interval.

    The interval covers as often as the whole one, since the number is not in that part.
    """
    return estimate._replace(low=max(estimate.low, 0.0))


def share_mean_interval(values: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Return the mean of (n,) values from 0 to 1 with an interval within 0 and 1.

    The interval is Student's for the logarithm of the mean's odds, by its derivative. Like that of `mean_interval` it
    is too short for few skewed values: of the beta distribution (0.2, 8) it contains the mean in 91 % of studies of 30
    samples. Where all values are 0 or all are 1 the spread says nothing: then it is the interval of the share of values
    that are otherwise, `share_interval`, which the mean cannot leave. Its ends are NaN for fewer than two values.
    """
    found = mean_interval(values, confidence)
    if len(values) > 1 and found.value in (0.0, 1.0):
        return share_interval(int(found.value) * len(values), len(values), confidence)
    if not 0.0 < found.value < 1.0:
        return found
    odds = found.value / (1.0 - found.value)
    factor = math.exp(min((found.high - found.value) / (found.value * (1.0 - found.value)), _MAX_EXPONENT))
    low, high = odds / factor, odds * factor
    return Interval(found.value, low / (1.0 + low), high / (1.0 + high))


def metric_mean(metrics: Metrics, name: str, confidence: float = CONFIDENCE) -> Interval:
    """The mean of a metric of the flights that went to the end: by `share_mean_interval` of a share, else positive.

    Args:
        metrics: (n,) of the samples.
        name: of the metric, none of which is negative.
        confidence: of the interval.
    """
    values = of_survivors(metrics, name)
    if name == "saturation_share":
        return share_mean_interval(values, confidence)
    return positive(mean_interval(values, confidence))


def quantile_interval(values: np.ndarray, probability: float, confidence: float = CONFIDENCE) -> Interval:
    """A quantile of (n,) values, with the interval between order statistics, which holds for any distribution.

    Its ends are infinite if there are too few values for it.
    """
    if not len(values):
        return Interval(math.nan, math.nan, math.nan)
    ordered, n = np.sort(values), len(values)
    # The number of values below the quantile is binomial: each end leaves out at most half of what may be missed.
    missed = 0.5 * (1.0 - confidence)
    first = int(scipy.stats.binom.ppf(missed, n, probability))
    last = int(scipy.stats.binom.ppf(1.0 - missed, n, probability)) + 1
    return Interval(
        float(ordered[max(math.ceil(n * probability) - 1, 0)]),
        float(ordered[first - 1]) if first >= 1 else -math.inf,
        float(ordered[last - 1]) if last <= n else math.inf,
    )


def share_interval(count: int, total: int, confidence: float = CONFIDENCE) -> Interval:
    """A probability from so many of a total, with the exact interval of Clopper and Pearson: quantiles of beta laws."""
    if total == 0:
        return Interval(math.nan, 0.0, 1.0)
    missed, others = 0.5 * (1.0 - confidence), total - count
    low = scipy.special.betaincinv(count, others + 1, missed) if count else 0.0
    high = scipy.special.betaincinv(count + 1, others, 1.0 - missed) if others else 1.0
    return Interval(count / total, float(low), float(high))


def rank_correlation(x: np.ndarray, y: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Spearman's correlation of the ranks of (n,) numbers.

    The interval is Fisher's with the variance (1 + ρ² / 2) / (n - 3) of the transformed correlation (D. G. Bonett and
    T. A. Wright, "Sample size requirements for estimating Pearson, Kendall and Spearman correlations", 2000).
    """
    if len(x) < 4 or np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return Interval(math.nan, math.nan, math.nan)
    return _of_ranks(float(scipy.stats.spearmanr(x, y).statistic), len(x), confidence)


def partial_rank_correlation(
    x: np.ndarray, y: np.ndarray, given: np.ndarray, confidence: float = CONFIDENCE
) -> Interval:
    """The correlation of the ranks of (n,) numbers, less what the ranks of k others say of both.

    The interval is that of `rank_correlation` for k samples less.

    Args:
        x: (n,) numbers.
        y: (n,) numbers.
        given: (k, n) the others.
        confidence: of the interval.
    """
    if not len(given):
        return rank_correlation(x, y, confidence)
    if len(x) < 4 + len(given) or np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return Interval(math.nan, math.nan, math.nan)
    ranks, others = scipy.stats.rankdata([x, y], axis=1), scipy.stats.rankdata(given, axis=1)
    ranks, others = (each - each.mean(axis=1, keepdims=True) for each in (ranks, others))
    rest = ranks.T - others.T @ np.linalg.lstsq(others.T, ranks.T, rcond=None)[0]
    left, before = np.linalg.norm(rest, axis=0), np.linalg.norm(ranks, axis=1)
    if np.any(left < _MIN_REMAINDER * before):
        return Interval(math.nan, math.nan, math.nan)
    return _of_ranks(float(rest[:, 0] @ rest[:, 1] / np.prod(left)), len(x) - len(given), confidence)


def _of_ranks(rho: float, count: int, confidence: float) -> Interval:
    """The interval of a correlation of so many ranks, see `rank_correlation`."""
    reach = scipy.stats.norm.ppf(0.5 * (1.0 + confidence)) * math.sqrt((1.0 + 0.5 * rho * rho) / (count - 3))
    centre = math.atanh(max(min(rho, 1.0 - 1e-15), -1.0 + 1e-15))
    return Interval(rho, math.tanh(centre - reach), math.tanh(centre + reach))


def crash_probability(metrics: Metrics) -> Interval:
    """The probability of a crash."""
    return share_interval(int(np.sum(metrics.crashed)), len(metrics.crashed))


def of_survivors(metrics: Metrics, name: str) -> np.ndarray:
    """A metric of the flights that went to the end, where it could be measured."""
    values = getattr(metrics, name)[~metrics.crashed]
    found: np.ndarray = values[~np.isnan(values)]
    return found


def with_crashes(metrics: Metrics, name: str) -> np.ndarray:
    """(n,) values of a metric of all samples, infinite for those that crashed."""
    return np.where(metrics.crashed, math.inf, getattr(metrics, name))


def running_mean(values: np.ndarray, confidence: float = CONFIDENCE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(n,) arrays of the mean of the first values, up to each one, and of the ends of its interval, Student's."""
    count = np.arange(1, len(values) + 1)
    # About the whole mean, so that nothing cancels.
    shift = values - (values.mean() if len(values) else 0.0)
    mean = np.cumsum(shift) / count
    with np.errstate(invalid="ignore", divide="ignore"):
        deviation = np.sqrt(np.maximum(np.cumsum(shift * shift) - count * mean * mean, 0.0) / (count - 1))
        reach = _reach(deviation, count, confidence)
    mean = mean + (values.mean() if len(values) else 0.0)
    return mean, mean - reach, mean + reach


def _reach(deviation: Any, count: Any, confidence: float) -> Any:
    """Half of Student's interval of a mean."""
    return scipy.stats.t.ppf(0.5 * (1.0 + confidence), count - 1) * deviation / np.sqrt(count)


class Influence(NamedTuple):
    """How much a drawn number has to do with a metric.

    Attributes:
        path: of the field.
        correlation: of the ranks. Of a number that is correlated with others, it holds what comes with these.
        alone: of the ranks, less what the numbers say that are correlated with it; the same if there are none.
        low: mean of the metric over the tenth of the samples with the least numbers.
        high: over that with the largest.
    """

    path: str
    correlation: Interval
    alone: Interval
    low: Interval
    high: Interval


def influences(study: Study, name: str = "rmse") -> list[Influence]:
    """Which drawn numbers matter for a metric of the flights that went to the end, those that matter most first.

    Args:
        study: of the samples.
        name: of the metric; or "crashed", for what makes vehicles crash.
    """
    values = np.asarray(getattr(study.metrics, name), dtype=float)
    kept = ~np.isnan(values) & (~study.metrics.crashed | (name == "crashed"))
    values = values[kept]
    found = []
    groups = correlated_groups(distributions_in(study.scenario))
    for path, numbers in study.parameters.items():
        drawn = numbers[kept]
        if len(drawn):
            low, high = np.quantile(drawn, (0.1, 0.9))
            ends = (_level(values[tenth], name) for tenth in (drawn <= low, drawn >= high))
            others = [study.parameters[other][kept] for other in groups.get(path, ()) if other != path]
            alone = partial_rank_correlation(drawn, values, np.array(others))
            found.append(Influence(path, rank_correlation(drawn, values), alone, *ends))
    return sorted(found, key=lambda each: -abs(np.nan_to_num(each.correlation.value)))


def _level(values: np.ndarray, name: str) -> Interval:
    return share_interval(int(values.sum()), len(values)) if name == "crashed" else mean_interval(values)


class CrashLevel(NamedTuple):
    """The probability of a crash where a drawn number is in a range.

    Attributes:
        low: least number drawn there.
        high: largest.
        middle: their median.
        num_samples: how many.
        probability: of a crash.
    """

    low: float
    high: float
    middle: float
    num_samples: int
    probability: Interval


def crash_levels(study: Study, path: str, *, num_bins: int | None = None) -> list[CrashLevel]:
    """The probability of a crash over a drawn number, in bins of equally many samples.

    Samples with the same number are in the same bin, so that a choice of a few numbers has a bin for each.

    Args:
        study: of the samples.
        path: of the field.
        num_bins: how many, if there are as many different numbers; if not given the cube root of that of the samples,
            but 2 to 20, so that more samples make bins finer and their intervals shorter.

    Raises:
        InputError: the field holds no distribution, or the number of bins is less than 1.
    """
    if path not in study.parameters:
        raise InputError(f"{path} is not drawn in this study; drawn are {listed([*study.parameters]) or 'no numbers'}")
    if num_bins is not None and num_bins < 1:
        raise InputError(f"the number of bins is {num_bins}, but must be at least 1")
    numbers, crashed = study.parameters[path], study.metrics.crashed
    if not len(numbers):
        return []
    wanted = num_bins or min(max(round(len(numbers) ** (1.0 / 3.0)), _MIN_BINS), _MAX_BINS)
    different = np.unique(numbers)
    if len(different) <= wanted:
        first = different
    else:
        first = np.unique(np.sort(numbers)[np.arange(wanted) * len(numbers) // wanted])
    bins = np.searchsorted(first, numbers, side="right") - 1
    levels = []
    for own in (bins == i for i in range(len(first))):
        drawn, count = numbers[own], int(own.sum())
        probability = share_interval(int(crashed[own].sum()), count)
        levels.append(CrashLevel(drawn.min(), drawn.max(), float(np.median(drawn)), count, probability))
    return levels


def most_influential(studies: Iterable[Study], name: str = "crashed") -> str | None:
    """The drawn number with the largest rank correlation with a metric in any of some studies; None if there is none.

    Args:
        studies: in all of which the number is drawn.
        name: of the metric; or "crashed", for what makes vehicles crash.
    """
    studies = [*studies]
    found = [
        each
        for study in studies
        for each in influences(study, name)
        if all(each.path in other.parameters for other in studies)
    ]
    sizes = [np.nan_to_num(abs(each.correlation.value)) for each in found]
    return found[int(np.argmax(sizes))].path if found else None


class Comparison(NamedTuple):
    """Two controllers on the same samples.

    Difference and share are of the same two means, those over the pairs, so that a share above 1 goes with a difference
    above zero.

    Attributes:
        num_pairs: samples that both flew to the end.
        difference: mean of the metric less that of the baseline, in the metric's unit.
        share: ratio of the mean of the metric to that of the baseline, 1, see `ratio_of_means`.
        better: share of the pairs in which the metric is smaller, 1.
        crashed: samples on which only this one crashed.
        baseline_crashed: samples on which only the baseline crashed.
        crash_significance: p-value of McNemar's exact test that both crash as often.
    """

    num_pairs: int
    difference: Interval
    share: Interval
    better: Interval
    crashed: int
    baseline_crashed: int
    crash_significance: float


def compare(metrics: Metrics, baseline: Metrics, name: str = "rmse") -> Comparison:
    """Compares two controllers by a metric of which less is better.

    Args:
        metrics: (n,) of one controller.
        baseline: (n,) of another, on the same samples.
        name: of the metric.
    """
    value, reference = getattr(metrics, name), getattr(baseline, name)
    both = ~(metrics.crashed | baseline.crashed | np.isnan(value) | np.isnan(reference))
    value, reference = value[both], reference[both]
    only, baseline_only = (
        int(np.sum(crashed & ~other))
        for crashed, other in ((metrics.crashed, baseline.crashed), (baseline.crashed, metrics.crashed))
    )
    return Comparison(
        len(value),
        mean_interval(value - reference),
        ratio_of_means(value, reference),
        share_interval(int(np.sum(value < reference)), len(value)),
        only,
        baseline_only,
        float(scipy.stats.binomtest(only, only + baseline_only).pvalue) if only + baseline_only else 1.0,
    )


def compare_studies(study: Study, baseline: Study, name: str = "rmse") -> Comparison:
    """Compares two studies of the same seed, on the samples that both have; see `compare`."""
    _, ours, others = np.intersect1d(study.samples, baseline.samples, return_indices=True)
    return compare(study.metrics.taken(ours), baseline.metrics.taken(others), name)


def worst(study: Study, count: int = 5, name: str = "rmse") -> list[int]:
    """The numbers of the worst samples: those that crashed, the earliest first, then those with the largest metric."""
    metrics = study.metrics
    value = np.nan_to_num(getattr(metrics, name), nan=-math.inf)
    order = np.lexsort((-value, metrics.crash_time))
    return [int(sample) for sample in study.samples[order][:count]]
