"""Estimates of means, quantiles, probabilities and rank correlations, with confidence intervals.

Distributions are computed with `scipy.special`, since the import of `scipy.stats` takes half a second.
"""

import math
from typing import Any

import numpy as np
import scipy

from drake_quad.statistics.interval import CONFIDENCE, Interval

# Smallest residual, relative to the ranks, of a regression of the ranks of a variable on the ranks of the covariates. A
# smaller residual is a rounding error: the ranks are a linear combination of those of the covariates.
_MIN_RESIDUAL = 1e-9
_MAX_EXPONENT = 600.0  # largest exponent; exponentials of larger numbers could overflow


def mean_interval(values: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Return the mean of values (n,) with Student's t interval.

    The ends of the interval are NaN for fewer than two values, or if a value is infinite.

    The interval is too short for few values from a skewed distribution. It is reliable if the number of values is
    larger than about 25 times their squared skewness (W. G. Cochran, "Sampling Techniques", 1977).
    """
    if len(values) < 2 or not np.isfinite(values).all():
        with np.errstate(invalid="ignore"):  # the mean of values that are infinite with both signs is NaN
            return Interval(float(np.mean(values)) if len(values) else math.nan, math.nan, math.nan)
    mean, half_width = float(np.mean(values)), float(_half_width(np.std(values, ddof=1), len(values), confidence))
    return Interval(mean, mean - half_width, mean + half_width)


def without_negative_part(estimate: Interval) -> Interval:
    """Return an estimate of a nonnegative number, with its interval restricted to nonnegative numbers.

    The coverage of the interval does not change, since the true number is not negative.
    """
    return estimate._replace(low=max(estimate.low, 0.0))


def bounded_mean_interval(values: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Return the mean of values (n,) in [0, 1] with an interval within [0, 1].

    The interval is Student's t interval of the log-odds of the mean, by the delta method. Like the interval of
    `mean_interval`, it is too short for few values from a skewed distribution: for the beta distribution with
    parameters 0.2 and 8, a 95 % interval contains the mean in 91 % of studies with 30 samples. If all values are 0 or
    all are 1, their variance contains no information. The interval is then computed by `proportion_interval` for the
    fraction of nonzero values, which bounds the mean. The ends are NaN for fewer than two values.
    """
    mean = mean_interval(values, confidence)
    if len(values) > 1 and mean.value in (0.0, 1.0):
        return proportion_interval(int(mean.value) * len(values), len(values), confidence)
    return log_odds_interval(mean) if 0.0 < mean.value < 1.0 else mean


def log_odds_interval(mean: Interval) -> Interval:
    """Return a mean between 0 and 1 whose symmetric interval is replaced by the interval of its log-odds."""
    odds = mean.value / (1.0 - mean.value)
    factor = math.exp(min((mean.high - mean.value) / (mean.value * (1.0 - mean.value)), _MAX_EXPONENT))
    low, high = odds / factor, odds * factor
    return Interval(mean.value, low / (1.0 + low), high / (1.0 + high))


def quantile_interval(
    values: np.ndarray, probability: float, confidence: float = CONFIDENCE, *, effective_number: float | None = None
) -> Interval:
    """Return a quantile of values (n,), with an interval between two order statistics.

    The interval is valid for any distribution. An end is infinite if there are too few values.

    Args:
        values: (n,) values.
        probability: probability of the quantile.
        confidence: probability that the interval contains the true quantile.
        effective_number: number of independent values with the same information, at most n; n if not given.
    """
    if not len(values):
        return Interval(math.nan, math.nan, math.nan)
    ordered, n = np.sort(values), len(values)
    # The number of values below the quantile has a binomial distribution. The error probability is divided equally
    # between the two ends.
    tail, number = 0.5 * (1.0 - confidence), n if effective_number is None else math.floor(effective_number)
    # The ranks are determined for the effective number of values. They are scaled to ranks among all values and rounded
    # outwards.
    first = math.floor(_binomial_quantile(tail, number, probability) * n / number)
    last = math.ceil((_binomial_quantile(1.0 - tail, number, probability) + 1) * n / number)
    return Interval(
        float(ordered[max(math.ceil(n * probability) - 1, 0)]),
        float(ordered[first - 1]) if first >= 1 else -math.inf,
        float(ordered[last - 1]) if last <= n else math.inf,
    )


def proportion_interval(count: float, total: float, confidence: float = CONFIDENCE) -> Interval:
    """Return an estimated probability with the exact interval of Clopper and Pearson.

    The ends of the interval are quantiles of beta distributions.

    Args:
        count: number of samples in which the event occurred; not an integer if `total` is an effective number.
        total: number of all samples.
        confidence: probability that the interval contains the true value.

    Returns:
        The fraction of samples with the event; NaN with the interval [0, 1] if there are no samples.
    """
    if total == 0:
        return Interval(math.nan, 0.0, 1.0)
    tail, others = 0.5 * (1.0 - confidence), total - count
    low = scipy.special.betaincinv(count, others + 1, tail) if count else 0.0
    high = scipy.special.betaincinv(count + 1, others, 1.0 - tail) if others else 1.0
    return Interval(count / total, float(low), float(high))


def rank_correlation(x: np.ndarray, y: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Return Spearman's rank correlation of two variables with n values each.

    The correlation is NaN for fewer than four values, or if all values of a variable are equal. The interval follows
    from Fisher's transformation, with the variance (1 + ρ² / 2) / (n - 3) of the transformed correlation (D. G. Bonett
    and T. A. Wright, "Sample size requirements for estimating Pearson, Kendall and Spearman correlations", 2000).

    Args:
        x: (n,) values of the first variable.
        y: (n,) values of the second variable.
        confidence: probability that the interval contains the true value.
    """
    if len(x) < 4 or _is_constant(x) or _is_constant(y):
        return Interval(math.nan, math.nan, math.nan)
    return _correlation_interval(float(np.corrcoef(_ranks(x), _ranks(y))[0, 1]), len(x), confidence)


def partial_rank_correlation(
    x: np.ndarray, y: np.ndarray, covariates: np.ndarray, confidence: float = CONFIDENCE
) -> Interval:
    """Return the partial rank correlation of two variables, given k other variables.

    The interval is the interval of `rank_correlation` for n - k samples.

    Args:
        x: (n,) values of the first variable.
        y: (n,) values of the second variable.
        covariates: (k, n) values of the other variables.
        confidence: probability that the interval contains the true value.
    """
    if not len(covariates):
        return rank_correlation(x, y, confidence)
    if len(x) < 4 + len(covariates) or _is_constant(x) or _is_constant(y):
        return Interval(math.nan, math.nan, math.nan)
    ranks, others = (np.array([_ranks(row) for row in rows]) for rows in ((x, y), covariates))
    ranks, others = (each - each.mean(axis=1, keepdims=True) for each in (ranks, others))
    residuals = ranks.T - others.T @ np.linalg.lstsq(others.T, ranks.T, rcond=None)[0]
    norms, norms_before = np.linalg.norm(residuals, axis=0), np.linalg.norm(ranks, axis=1)
    if np.any(norms < _MIN_RESIDUAL * norms_before):
        return Interval(math.nan, math.nan, math.nan)
    return _correlation_interval(
        float(residuals[:, 0] @ residuals[:, 1] / np.prod(norms)), len(x) - len(covariates), confidence
    )


def two_sided_sign_test(count: int, total: int) -> float:
    """Return the p-value of the two-sided sign test for `count` positive signs of `total`; 1 if there are no signs."""
    return min(1.0, 2.0 * float(scipy.special.bdtr(min(count, total - count), total, 0.5))) if total else 1.0


def _binomial_quantile(fraction: float, total: int, probability: float) -> int:
    """Return the smallest count whose cumulative probability, under a binomial distribution, is at least `fraction`.

    Args:
        fraction: smallest cumulative probability.
        total: number of trials.
        probability: probability of success in a trial.
    """
    if not total or probability in (0.0, 1.0):  # some versions of SciPy return NaN in these cases
        return round(total * probability)
    count = math.ceil(scipy.special.bdtrik(fraction, total, probability))
    return count - 1 if count and scipy.special.bdtr(count - 1, total, probability) >= fraction else count


def _is_constant(values: np.ndarray) -> bool:
    """Return whether all values, which may be infinite, are equal."""
    return bool(np.all(values == values[0]))


def _ranks(values: np.ndarray) -> np.ndarray:
    """Return the ranks (n,) of values (n,), beginning with 1; equal values receive the mean of their ranks."""
    _, indices, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - 0.5 * (counts - 1))[indices]


def _correlation_interval(rho: float, count: int, confidence: float) -> Interval:
    """Return a rank correlation with the interval of `rank_correlation`.

    Args:
        rho: rank correlation.
        count: number of samples, minus the number of covariates.
        confidence: probability that the interval contains the true value.
    """
    half_width = scipy.special.ndtri(0.5 * (1.0 + confidence)) * math.sqrt((1.0 + 0.5 * rho * rho) / (count - 3))
    centre = math.atanh(max(min(rho, 1.0 - 1e-15), -1.0 + 1e-15))
    return Interval(rho, math.tanh(centre - half_width), math.tanh(centre + half_width))


def running_mean(values: np.ndarray, confidence: float = CONFIDENCE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the running mean (n,) of values, and the lower and upper ends (n,) of its Student's t intervals.

    From the first infinite value on, mean and ends are NaN.
    """
    count = np.arange(1, len(values) + 1)
    is_finite = np.isfinite(values)
    # The mean of the finite values is subtracted to avoid cancellation.
    offset = values[is_finite].mean() if is_finite.any() else 0.0
    centred = np.where(is_finite, values - offset, np.nan)
    mean = np.cumsum(centred) / count
    with np.errstate(invalid="ignore", divide="ignore"):
        deviation = np.sqrt(np.maximum(np.cumsum(centred * centred) - count * mean * mean, 0.0) / (count - 1))
        half_width = _half_width(deviation, count, confidence)
    mean = mean + offset
    return mean, mean - half_width, mean + half_width


def _half_width(deviation: Any, count: Any, confidence: float) -> Any:
    """Return half the width of Student's t interval of a mean.

    Args:
        deviation: standard deviation of the values.
        count: number of values.
        confidence: probability that the interval contains the true value.
    """
    return scipy.special.stdtrit(count - 1, 0.5 * (1.0 + confidence)) * deviation / np.sqrt(count)
