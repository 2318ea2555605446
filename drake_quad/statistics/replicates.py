"""Estimates from samples that are independent, or that consist of independent replicates.

The samples of a replicate may depend on one another, for example to cover distributions evenly. The interval of a mean
is then Student's t interval over the replicates. It is reliable for randomised quasi-Monte Carlo with ten replicates or
more (P. L'Ecuyer, M. K. Nakayama, A. B. Owen and B. Tuffin, "Confidence intervals for randomized quasi-Monte Carlo
estimators", Winter Simulation Conference, 2023).
"""

import math
from typing import Any

import numpy as np
import scipy

from drake_quad.statistics.estimates import (
    bounded_mean_interval,
    log_odds_interval,
    mean_interval,
    proportion_interval,
    quantile_interval,
    running_mean,
)
from drake_quad.statistics.interval import CONFIDENCE, Interval
from drake_quad.statistics.ratios import linearized_ratio, ratio_of_means

MIN_REPLICATES = 16
"""Smallest number of replicates of a complete study. Student's factor is then 2.13, and 1.96 for many replicates."""
_NUM_RUNNING_MEANS = 60  # number of points at which the running mean of dependent samples is computed


class Replicates:
    """Assignment of samples to replicates, with estimates whose intervals allow for dependence within replicates.

    Args:
        indices: (n,) index of the replicate of each sample; None if all samples are independent.
    """

    def __init__(self, indices: np.ndarray | None = None) -> None:
        self.indices = indices

    def take(self, used: Any) -> "Replicates":
        """Return the replicates of some of the samples, given a mask, a slice or indices."""
        return self if self.indices is None else Replicates(self.indices[used])

    def mean(self, values: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
        """Return the mean of values (n,) with Student's t interval.

        Replicates may have different numbers of values, if some flights are left out. The mean is then the ratio of the
        mean sum to the mean number of values, and its interval follows by the delta method.
        """
        if self.indices is None or len(values) < 2 or not np.isfinite(values).all():
            return mean_interval(values, confidence)
        return mean_interval(linearized_ratio(self._sums(values), self._counts()), confidence)

    def fraction(self, values: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
        """Return the mean of values (n,) in [0, 1] with an interval within [0, 1]; see `bounded_mean_interval`."""
        if self.indices is None or len(values) < 2 or not 0.0 < np.mean(values) < 1.0:
            return bounded_mean_interval(values, confidence)
        return log_odds_interval(self.mean(values, confidence))

    def proportion(self, occurs: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
        """Return the probability of an event, given an array (n,) that is True for the samples in which it occurs.

        The interval is computed by the method of Clopper and Pearson for `effective_number` independent samples.
        """
        count, total = int(np.sum(occurs)), len(occurs)
        if self.indices is None or not 0 < count < total:
            return proportion_interval(count, total, confidence)
        number, share = self.effective_number(occurs, confidence), count / total
        return proportion_interval(share * number, number, confidence)._replace(value=share)

    def quantile(self, values: np.ndarray, probability: float, confidence: float = CONFIDENCE) -> Interval:
        """Return a quantile of values (n,), with an interval between two order statistics.

        The interval is computed as for independent samples. Their number is the `effective_number` for the event that a
        value is at most the quantile (R. S. Woodruff, "Confidence intervals for medians and other position measures",
        Journal of the American Statistical Association, 1952).
        """
        plain = quantile_interval(values, probability, confidence)
        if self.indices is None or not len(values):
            return plain
        number = self.effective_number(values <= plain.value, confidence)
        return quantile_interval(values, probability, confidence, effective_number=number)

    def ratio(self, values: np.ndarray, baseline: np.ndarray, confidence: float = CONFIDENCE) -> Interval:
        """Return the ratio of the means of two nonnegative metrics, see `ratio_of_means`."""
        if self.indices is None or not len(values):
            return ratio_of_means(values, baseline, confidence)
        return ratio_of_means(self._sums(values), self._sums(baseline), confidence)

    def running_mean(self, values: np.ndarray, confidence: float = CONFIDENCE) -> tuple[np.ndarray, ...]:
        """Return the mean of the first n values for several n: n, mean, lower end and upper end, four arrays (k,).

        If the samples are independent, the numbers are 1, 2, 3, ... up to the number of values.
        """
        if self.indices is None:
            return np.arange(1, len(values) + 1), *running_mean(values, confidence)
        stops = np.unique(np.geomspace(1, max(len(values), 1), _NUM_RUNNING_MEANS).astype(int))
        means = [self.take(slice(stop)).mean(values[:stop], confidence) for stop in stops]
        return stops, *(np.array(each) for each in zip(*means, strict=True))

    def effective_number(self, occurs: np.ndarray, confidence: float = CONFIDENCE) -> float:
        """Return the number of independent samples from which a probability is estimated with the same accuracy.

        The number follows from the spread of the replicates, and from Student's factor for the number of replicates (E.
        L. Korn and B. I. Graubard, "Confidence intervals for proportions with small expected number of positive counts
        estimated from survey data", Survey Methodology, 1998). The result is at most the number of samples, since the
        spread of few replicates or few events can be small by chance.

        Args:
            occurs: (n,) True for the samples in which the event occurs.
            confidence: confidence of the interval for which the number is used.
        """
        total, fraction = len(occurs), float(np.mean(occurs))
        if self.indices is None or not 0.0 < fraction < 1.0:
            return float(total)
        contributions = linearized_ratio(self._sums(occurs), self._counts())
        count = len(contributions)
        variance = float(np.var(contributions, ddof=1)) / count if count > 1 else math.inf
        factors = scipy.special.stdtrit([total - 1, max(count - 1, 1)], 0.5 * (1.0 + confidence))
        accuracy = fraction * (1.0 - fraction) * float(factors[0] / factors[1]) ** 2
        return max(accuracy / variance, 1.0) if accuracy < variance * total else float(total)

    def _sums(self, values: np.ndarray) -> np.ndarray:
        """Return the sum of the values (n,) of each replicate that has a value."""
        assert self.indices is not None
        _, members = np.unique(self.indices, return_inverse=True)
        return np.bincount(members, values)

    def _counts(self) -> np.ndarray:
        """Return the number of values of each replicate that has a value."""
        assert self.indices is not None
        return np.unique(self.indices, return_counts=True)[1]


INDEPENDENT = Replicates()
"""Independent samples."""
