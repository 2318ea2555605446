"""Variation of parameters from one stretch of flight to the next, beyond the errors of their estimates.

Model errors change during a flight: a battery discharges, sensors warm up, and each manoeuvre excites other effects.
Each stretch b therefore has its own parameters, whose variance about those of the vehicle is d² (random effects, as in
a meta-analysis: R. DerSimonian and N. Laird, Controlled Clinical Trials 7, 1986). The estimate θ_b of a stretch is one
Gauss-Newton step from the estimate of all windows. With v_b the variance of its error, d² is the solution of

    Σ_b (θ_b - μ)² / (v_b + d²) = B - 1,

where μ is the mean with weights 1 / (v_b + d²) (R. C. Paule and J. Mandel, J. Res. Nat. Bur. Stand. 87, 1982). If the
sum for d = 0 is not significant at a level of 10 %, d² is zero. This level is usual for the test, which has little
power (J. P. T. Higgins et al., BMJ 327, 2003).

The variance v_b is the diagonal of the inverse of the information H_b with a weak prior. It is increased if the windows
within stretches differ by more than model and noise explain. With fewer than two windows in each stretch, v_b is that
of the model. Then d² includes any further error, so that only the sum of the two variances is meaningful.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.identification.evidence import Evidence, Uncertainty, inverted, jackknife, sums_over_blocks

NUM_STRETCHES = 10
"""Number of stretches into which all flights are divided. Each of them is held out once."""
# Smallest number of windows per stretch with which errors are distinguished from variation.
_MIN_WINDOWS_PER_STRETCH = 2
_SIGNIFICANCE_LEVEL = 0.1
_NUM_BISECTIONS = 60


class Variation(NamedTuple):
    """Variation of p parameters from one stretch of flight to the next.

    Attributes:
        covariance: (p, p) covariance of the parameters of stretches. A variance is 0 if the parameter does not vary
            significantly, and NaN if its variation is unknown.
        degrees_of_freedom: degrees of freedom of Student's distribution of the variation.
        duration: duration of a stretch, s.
    """

    covariance: np.ndarray
    degrees_of_freedom: float
    duration: float

    def part(self, places: Sequence[int]) -> "Variation":
        """Return the variation of the parameters with the given indices, in this order."""
        return self._replace(covariance=self.covariance[np.ix_(places, places)])

    def with_unknown(self, count: int) -> "Variation":
        """Return the variation with further parameters at the end, whose variation is unknown."""
        unknown = np.diag(np.full(count, np.nan))
        return self._replace(covariance=scipy.linalg.block_diag(self.covariance, unknown))


class Stretches(NamedTuple):
    """Estimates of p parameters from each of B stretches of flight.

    Attributes:
        information: (B, p, p) information of each stretch.
        scores: (B, p) score of each stretch.
        estimates: (B, p) estimates from each stretch alone.
        variances: (B, p) variances of the errors of the estimates.
        degrees_of_freedom: degrees of freedom of the variances; infinite for variances of the model.
        duration: duration of a stretch, s.
    """

    information: np.ndarray
    scores: np.ndarray
    estimates: np.ndarray
    variances: np.ndarray
    degrees_of_freedom: float
    duration: float

    @classmethod
    def of(cls, evidence: Evidence) -> "Stretches":
        """Return stretches of consecutive windows, with at least one window in each."""
        windows, count = len(evidence.scores), NUM_STRETCHES
        blocks = np.arange(windows) * count // windows
        prior = np.diag(evidence.scales**-2.0)
        information = sums_over_blocks(evidence.information, blocks)
        scores = sums_over_blocks(evidence.scores, blocks)
        inverses = np.linalg.inv(information + prior)
        steps = -np.einsum("bij,bj->bi", inverses, scores)
        residual_scores = evidence.scores + np.einsum("wij,wj->wi", evidence.information, steps[blocks])
        number = np.bincount(blocks)
        weights = (number / np.maximum(number - 1, 1))[blocks]
        inverse = np.linalg.inv(information.sum(axis=0) + prior)
        sandwich = inverse @ ((weights[:, None] * residual_scores).T @ residual_scores) @ inverse
        freedom = float(windows - count) if windows >= _MIN_WINDOWS_PER_STRETCH * count else np.inf
        factor = np.maximum(1.0, np.diag(sandwich) / np.diag(inverse)) if np.isfinite(freedom) else 1.0
        variances = np.diagonal(inverses, axis1=1, axis2=2) * factor
        duration = evidence.duration / count
        return cls(information, scores, evidence.values + steps, variances, freedom, duration)

    def without(self, b: int) -> "Stretches":
        """Return all stretches except stretch b."""
        rest = np.arange(len(self.scores)) != b
        return self._replace(
            information=self.information[rest],
            scores=self.scores[rest],
            estimates=self.estimates[rest],
            variances=self.variances[rest],
        )

    def step(self) -> np.ndarray:
        """Return the Gauss-Newton step (p,) from the values of the evidence to the estimate of these stretches.

        It is zero for a parameter that no stretch determines.
        """
        whole = self.information.sum(axis=0)
        return -np.asarray(inverted(whole, whole) @ self.scores.sum(axis=0))

    def uncertainty(self) -> Uncertainty:
        """Return the uncertainty of the estimate of these stretches, by the jackknife."""
        return jackknife(self.information, self.scores + self.information @ self.step())

    def variance_between(self) -> np.ndarray:
        """Return the variance (p,) between stretches, d²."""
        count, size = len(self.scores), np.median(self.variances, axis=0)
        estimates, variances = self.estimates / np.sqrt(size), self.variances / size
        significant = self._p_value(_weighted_squares(estimates, variances, 0.0)) < _SIGNIFICANCE_LEVEL
        low, high = np.zeros(estimates.shape[1]), count * np.var(estimates, axis=0)
        for _ in range(_NUM_BISECTIONS):
            middle = 0.5 * (low + high)
            too_small = _weighted_squares(estimates, variances, middle) > count - 1
            low, high = np.where(too_small, middle, low), np.where(too_small, high, middle)
        return np.where(significant, size * high, 0.0)

    def _p_value(self, squares: np.ndarray) -> np.ndarray:
        """Return the p-values (p,) of sums of squares if nothing varies, by χ² if the variances are known."""
        count = len(self.scores)
        if not np.isfinite(self.degrees_of_freedom):
            return np.asarray(scipy.stats.chi2.sf(squares, count - 1))
        return np.asarray(scipy.stats.f.sf(squares / (count - 1), count - 1, self.degrees_of_freedom))

    def correlation(self, between: np.ndarray) -> np.ndarray:
        """Return the correlation (p, p) of the deviations of stretches, for variances d² (p,) between stretches.

        A parameter that is the same in all stretches is correlated with no other.
        """
        weights = 1.0 / (self.variances + between)
        mean = np.sum(weights * self.estimates, axis=0) / np.sum(weights, axis=0)
        deviations = (self.estimates - mean) * np.sqrt(weights)
        products = deviations.T @ deviations
        sizes = np.sqrt(np.diag(products))
        units = np.outer(sizes, sizes)
        return np.where(units > 0.0, products / np.where(units > 0.0, units, 1.0), np.eye(len(sizes)))


def _weighted_squares(estimates: np.ndarray, variances: np.ndarray, between: np.ndarray | float) -> np.ndarray:
    """Return the sums (p,) Σ (θ_b - μ)² / (v_b + d²)."""
    weights = 1.0 / (variances + between)
    mean = np.sum(weights * estimates, axis=0) / np.sum(weights, axis=0)
    return np.asarray(np.sum(weights * (estimates - mean) ** 2, axis=0))


def variation_of(evidence: Evidence) -> Variation | None:
    """Return the variation of parameters from stretch to stretch; None if there are too few windows."""
    if len(evidence.scores) < _MIN_WINDOWS_PER_STRETCH * NUM_STRETCHES:
        return None
    stretches = Stretches.of(evidence)
    between = stretches.variance_between()
    sizes = np.sqrt(between)
    covariance = np.outer(sizes, sizes) * stretches.correlation(between)
    return Variation(covariance, float(NUM_STRETCHES - 1), stretches.duration)


def uncertainty_of_mean(uncertainty: Uncertainty, evidence: Evidence, variation: Variation | None) -> Uncertainty:
    """Return the uncertainty of the mean of parameters that vary.

    A parameter that varies takes its variance from blocks as long as a stretch, if that is larger.

    Args:
        uncertainty: uncertainty from shorter blocks.
        evidence: evidence of all windows.
        variation: variation of the parameters; None if it is unknown.
    """
    if variation is None:
        return uncertainty
    long = Stretches.of(evidence).uncertainty()
    own = np.diag(uncertainty.covariance)
    # The jackknife gives no variance to a parameter that a single block determines.
    ratio = np.where(own > 0.0, np.diag(long.covariance) / np.where(own > 0.0, own, 1.0), 1.0)
    wider = (np.diag(variation.covariance) > 0.0) & (ratio > 1.0)
    sizes = np.where(wider, np.sqrt(np.maximum(ratio, 1.0)), 1.0)
    return Uncertainty(
        uncertainty.covariance * np.outer(sizes, sizes),
        np.where(wider, long.degrees_of_freedom, uncertainty.degrees_of_freedom),
        uncertainty.model,
    )
