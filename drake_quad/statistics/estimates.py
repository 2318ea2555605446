"""Confidence intervals of means, quantiles, shares and rank correlations.

The distributions are those of `scipy.special`, since `scipy.stats` takes half a second to load.
"""

import math
from typing import Any

import numpy as np
import scipy

from drake_quad.statistics.interval import CONFIDENCE, Interval

# Ranks are a linear combination of the given ranks, up to rounding errors, if their relative residual is below this.
_MIN_REMAINDER = 1e-9
_MAX_EXPONENT = 600.0  # larger exponents could overflow


def mean_interval(values: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Return the mean of values (n,) with Student's interval, whose ends are NaN for fewer than two values.

    The interval is too short for few values of a skewed metric. It is reliable for more than about 25 times the squared
    skewness of the values (W. G. Cochran, "Sampling Techniques", 1977).
    """
    if len(values) < 2:
        return Interval(float(values[0]) if len(values) else math.nan, math.nan, math.nan)
    mean, reach = float(np.mean(values)), float(_reach(np.std(values, ddof=1), len(values), confidence))
    return Interval(mean, mean - reach, mean + reach)


def positive(estimate: Interval) -> Interval:
    """Return an estimate of a nonnegative number without the negative part of its interval.

    The coverage of the interval does not change, since the number cannot be in that part.
    """
    return estimate._replace(low=max(estimate.low, 0.0))


def share_mean_interval(values: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Return the mean of values (n,) in [0, 1] with an interval within [0, 1].

    The interval is Student's for the log-odds of the mean, by the delta method. Like that of `mean_interval` it is too
    short for few skewed values: a 95 % interval contains the mean of the beta distribution (0.2, 8) in 91 % of studies
    with 30 samples. If all values are 0 or all are 1, their variance contains no information. The interval is then that
    of the share of other values (`share_interval`), which bounds the mean. Its ends are NaN for fewer than two values.
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


def quantile_interval(values: np.ndarray, probability: float, confidence: float = CONFIDENCE) -> Interval:
    """Return a quantile of values (n,), with the interval between order statistics, which holds for any distribution.

    An end of the interval is infinite if there are too few values.
    """
    if not len(values):
        return Interval(math.nan, math.nan, math.nan)
    ordered, n = np.sort(values), len(values)
    # The number of values below the quantile is binomial. Each end fails with at most half of the error probability.
    missed = 0.5 * (1.0 - confidence)
    first = _binomial_quantile(missed, n, probability)
    last = _binomial_quantile(1.0 - missed, n, probability) + 1
    return Interval(
        float(ordered[max(math.ceil(n * probability) - 1, 0)]),
        float(ordered[first - 1]) if first >= 1 else -math.inf,
        float(ordered[last - 1]) if last <= n else math.inf,
    )


def share_interval(count: int, total: int, confidence: float = CONFIDENCE) -> Interval:
    """Return an estimated probability with the exact interval of Clopper and Pearson.

    The ends of the interval are quantiles of beta distributions.

    Args:
        count: number of samples with the event.
        total: number of all samples.
        confidence: confidence of the interval.

    Returns:
        The probability, which is NaN with the interval [0, 1] if there are no samples.
    """
    if total == 0:
        return Interval(math.nan, 0.0, 1.0)
    missed, others = 0.5 * (1.0 - confidence), total - count
    low = scipy.special.betaincinv(count, others + 1, missed) if count else 0.0
    high = scipy.special.betaincinv(count + 1, others, 1.0 - missed) if others else 1.0
    return Interval(count / total, float(low), float(high))


def rank_correlation(x: np.ndarray, y: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Return Spearman's rank correlation of two variables with n values each.

    The correlation is NaN for fewer than four values, or if all values of a variable are equal. The interval is
    Fisher's with the variance (1 + ρ² / 2) / (n - 3) of the transformed correlation (D. G. Bonett and T. A. Wright,
    "Sample size requirements for estimating Pearson, Kendall and Spearman correlations", 2000).

    Args:
        x: (n,) values of the first variable.
        y: (n,) values of the second variable.
        confidence: confidence of the interval.
    """
    if len(x) < 4 or np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return Interval(math.nan, math.nan, math.nan)
    return _of_ranks(float(np.corrcoef(_ranks(x), _ranks(y))[0, 1]), len(x), confidence)


def partial_rank_correlation(
    x: np.ndarray, y: np.ndarray, given: np.ndarray, confidence: float = CONFIDENCE
) -> Interval:
    """Return the partial rank correlation of two variables, given k others.

    The interval is that of `rank_correlation` for n - k samples.

    Args:
        x: (n,) values of the first variable.
        y: (n,) values of the second variable.
        given: (k, n) values of the other variables.
        confidence: confidence of the interval.
    """
    if not len(given):
        return rank_correlation(x, y, confidence)
    if len(x) < 4 + len(given) or np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return Interval(math.nan, math.nan, math.nan)
    ranks, others = (np.array([_ranks(row) for row in rows]) for rows in ((x, y), given))
    ranks, others = (each - each.mean(axis=1, keepdims=True) for each in (ranks, others))
    rest = ranks.T - others.T @ np.linalg.lstsq(others.T, ranks.T, rcond=None)[0]
    left, before = np.linalg.norm(rest, axis=0), np.linalg.norm(ranks, axis=1)
    if np.any(left < _MIN_REMAINDER * before):
        return Interval(math.nan, math.nan, math.nan)
    return _of_ranks(float(rest[:, 0] @ rest[:, 1] / np.prod(left)), len(x) - len(given), confidence)


def two_sided_sign_test(count: int, total: int) -> float:
    """Return the p-value of the two-sided sign test for `count` of `total` signs; 1 if there are no signs."""
    return min(1.0, 2.0 * float(scipy.special.bdtr(min(count, total - count), total, 0.5))) if total else 1.0


def _binomial_quantile(share: float, total: int, probability: float) -> int:
    """Return the quantile of a binomial distribution: the smallest count whose cumulative probability reaches a share.

    Args:
        share: cumulative probability.
        total: number of trials.
        probability: probability of success in a trial.
    """
    if not total or probability in (0.0, 1.0):  # some versions of SciPy return NaN there
        return round(total * probability)
    count = math.ceil(scipy.special.bdtrik(share, total, probability))
    return count - 1 if count and scipy.special.bdtr(count - 1, total, probability) >= share else count


def _ranks(values: np.ndarray) -> np.ndarray:
    """Return the ranks (n,) of values (n,), from 1 on; equal values share the mean of their ranks."""
    _, places, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - 0.5 * (counts - 1))[places]


def _of_ranks(rho: float, count: int, confidence: float) -> Interval:
    """Return a rank correlation with its interval, see `rank_correlation`.

    Args:
        rho: rank correlation.
        count: number of pairs.
        confidence: confidence of the interval.
    """
    reach = scipy.special.ndtri(0.5 * (1.0 + confidence)) * math.sqrt((1.0 + 0.5 * rho * rho) / (count - 3))
    centre = math.atanh(max(min(rho, 1.0 - 1e-15), -1.0 + 1e-15))
    return Interval(rho, math.tanh(centre - reach), math.tanh(centre + reach))


def running_mean(values: np.ndarray, confidence: float = CONFIDENCE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the running mean (n,) of values, and the lower and upper ends (n,) of its Student's intervals."""
    count = np.arange(1, len(values) + 1)
    # Deviations from the total mean avoid cancellation.
    shift = values - (values.mean() if len(values) else 0.0)
    mean = np.cumsum(shift) / count
    with np.errstate(invalid="ignore", divide="ignore"):
        deviation = np.sqrt(np.maximum(np.cumsum(shift * shift) - count * mean * mean, 0.0) / (count - 1))
        reach = _reach(deviation, count, confidence)
    mean = mean + (values.mean() if len(values) else 0.0)
    return mean, mean - reach, mean + reach


def _reach(deviation: Any, count: Any, confidence: float) -> Any:
    """Return half of the width of Student's interval of a mean.

    Args:
        deviation: standard deviation of the values.
        count: number of values.
        confidence: confidence of the interval.
    """
    return scipy.special.stdtrit(count - 1, 0.5 * (1.0 + confidence)) * deviation / np.sqrt(count)
