"""Ratios of the means of two metrics that were flown on the same samples.

The estimand is E[a] / E[b], not the mean E[a / b] of the ratios of single samples. The two differ wherever b varies,
and only the first is above 1 exactly where the difference E[a] - E[b] is above zero.
"""

import math

import numpy as np
import scipy

from drake_quad.studies.interval import CONFIDENCE, Interval


def ratio_of_means(values: np.ndarray, baseline: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
    """Return the ratio of the means of two metrics, with Fieller's interval.

    The interval contains each ratio R for which Student's interval of the mean of a - R b contains zero (E. C. Fieller,
    "Some problems in interval estimation", Journal of the Royal Statistical Society B, 1954). If the mean of b is not
    distinguishable from zero, Fieller's set is unbounded: then the upper end is infinite, and the lower end is the
    least ratio from zero on in the set.

    Args:
        values: (n,) of one metric a, not negative.
        baseline: (n,) of the other metric b on the same samples, not negative.
        confidence: of the interval.

    Returns:
        The ratio. It is NaN if the mean of the baseline is zero, and its ends are NaN for fewer than two samples.
    """
    n = len(values)
    mean = float(np.mean(baseline)) if n else 0.0
    if not mean > 0.0:
        return Interval(math.nan, math.nan, math.nan)
    ratio = float(np.mean(values)) / mean
    if n < 2:
        return Interval(ratio, math.nan, math.nan)
    # In the distance d of a ratio from the estimate, and with residuals e = a - ratio b, whose mean is zero, the set is
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
    # The set is all that does not lie between two roots.
    first, second = sorted(ratio - (half + sign * math.sqrt(discriminant)) / square for sign in (-1.0, 1.0))
    return Interval(ratio, min(second, ratio) if first < 0.0 < second else 0.0, math.inf)


def linearized_ratio(values: np.ndarray, baseline: np.ndarray) -> np.ndarray:
    """Return numbers whose mean is the ratio of the means of two metrics, and whose spread is its error to first order.

    Differences of ratios on the same samples are means of differences of these numbers (the delta method).

    Args:
        values: (n,) of one metric.
        baseline: (n,) of the other metric on the same samples, with a mean that is not zero.

    Returns:
        (n,) numbers.
    """
    mean = np.mean(baseline)
    ratio = np.mean(values) / mean
    numbers: np.ndarray = ratio + (values - ratio * baseline) / mean
    return numbers
