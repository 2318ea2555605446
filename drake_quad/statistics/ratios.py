"""Ratio of the mean of a metric in one study to its mean in another study with the same samples.

The estimated ratio is E[a] / E[b], not the mean E[a / b] of the ratios of single samples. The two differ if b varies.
Only E[a] / E[b] agrees with the difference of the means: it is above 1 if and only if E[a] - E[b] is positive.
"""

import math

import numpy as np
import scipy

from drake_quad.statistics.interval import CONFIDENCE, Interval


def ratio_of_means(values: np.ndarray, baseline: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Return the ratio of the means of two metrics, with Fieller's interval.

    The interval contains each ratio R for which Student's t interval of the mean of a - R b contains zero (E. C.
    Fieller, "Some problems in interval estimation", Journal of the Royal Statistical Society B, 1954). If the mean of b
    is not significantly different from zero, the set of these ratios is unbounded. Then the upper end is infinite, and
    the lower end is the smallest nonnegative ratio in the set.

    Args:
        values: (n,) nonnegative samples of the metric a.
        baseline: (n,) nonnegative values of the metric b on the same samples.
        confidence: probability that the interval contains the ratio.

    Returns:
        The ratio with its interval. The ratio is NaN if the mean of the baseline is zero or a value is infinite, and
        the ends of the interval are NaN for fewer than two samples.
    """
    n = len(values)
    mean = float(np.mean(baseline)) if n else 0.0
    if not (mean > 0.0 and np.isfinite(values).all() and np.isfinite(baseline).all()):
        return Interval(math.nan, math.nan, math.nan)
    ratio = float(np.mean(values)) / mean
    if n < 2:
        return Interval(ratio, math.nan, math.nan)
    # Let a be `values`, b the `baseline`, e = a - ratio b the residuals, whose mean is zero, and q the squared quantile
    # of Student's distribution divided by n. A ratio R is in Fieller's set if its difference d = R - ratio satisfies
    # (mean² - q var(b)) d² + 2 q cov(e, b) d - q var(e) <= 0.
    q = float(scipy.special.stdtrit(n - 1, 0.5 * (1.0 + confidence))) ** 2 / n
    (var_e, cov), (_, var_b) = np.cov(np.stack([values - ratio * baseline, baseline]))
    square, half = mean**2 - q * var_b, q * cov
    discriminant = half**2 + square * q * var_e
    if square > 0.0:
        root = math.sqrt(discriminant)
        return Interval(ratio, max(ratio - (half + root) / square, 0.0), ratio - (half - root) / square)
    if square == 0.0 or discriminant <= 0.0:
        return Interval(ratio, 0.0, math.inf)
    # The set consists of all ratios except those between the two roots.
    first, second = sorted(ratio - (half + sign * math.sqrt(discriminant)) / square for sign in (-1.0, 1.0))
    return Interval(ratio, min(second, ratio) if first < 0.0 < second else 0.0, math.inf)


def linearized_ratio(values: np.ndarray, baseline: np.ndarray) -> np.ndarray:
    """Return the linearised contribution of each sample to the ratio of the means of two metrics (delta method).

    The mean of the contributions is the ratio. To first order, the standard error of this mean is the standard error of
    the ratio. The difference of two ratios on the same samples is the mean of the differences of their contributions.

    Args:
        values: (n,) samples of one metric.
        baseline: (n,) values of the other metric on the same samples; the mean of these values must not be zero.

    Returns:
        (n,) contributions.
    """
    mean = np.mean(baseline)
    ratio = np.mean(values) / mean
    return ratio + (values - ratio * baseline) / mean
