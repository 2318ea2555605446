"""Variation of parameters from one stretch of flight to the next, beyond the errors of their estimates.

Model errors change during a flight: a battery discharges, sensors warm up, and different manoeuvres excite different
effects. The parameters of each stretch b are therefore modelled as random, with variance d² around the parameters of
the vehicle (random effects, as in a meta-analysis: R. DerSimonian and N. Laird, Controlled Clinical Trials 7, 1986).
The estimate θ_b of a stretch is one Gauss-Newton step from the estimate of all windows. If the error of θ_b has the
variance v_b, d² is the solution of

    Σ_b (θ_b - μ)² / (v_b + d²) = B - 1,

where μ is the mean of θ_b with weights 1 / (v_b + d²) (R. C. Paule and J. Mandel, J. Res. Nat. Bur. Stand. 87, 1982).
If the sum for d = 0 is not significant at a level of 10 %, d² is zero. This level is usual, because the test has little
power (J. P. T. Higgins et al., BMJ 327, 2003).

The variances v_b follow from the inverse of the information of the stretch, to which a weak prior is added. They are
increased if the windows within stretches differ by more than model and noise explain. This comparison is impossible if
each stretch has fewer than two windows. In this case d² also includes the unexplained errors, and only the sum v_b + d²
is meaningful.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.identification.evidence import Evidence, Uncertainty, jackknife, pseudo_inverse, ratio, sums_over_blocks

NUM_SEGMENTS = 10
"""Number of stretches into which the total flight time is divided. Each of them is held out once."""
# Smallest number of windows per stretch from which estimation errors can be distinguished from variation.
_MIN_WINDOWS_PER_SEGMENT = 2
_SIGNIFICANCE_LEVEL = 0.1  # a parameter varies if its p-value is below this
_NUM_BISECTIONS = 40  # number of bisections in the search for the variance between stretches


class Variation(NamedTuple):
    """Variation of p parameters from one stretch of flight to the next.

    Attributes:
        covariance: (p, p) covariance of the parameters between stretches. A variance is 0 if the parameter does not
            vary significantly, and NaN if its variation is unknown.
        degrees_of_freedom: degrees of freedom of the variation, which follows Student's t-distribution.
        duration: duration of a stretch, s.
    """

    covariance: np.ndarray
    degrees_of_freedom: float
    duration: float

    def subset(self, indices: Sequence[int]) -> "Variation":
        """Return the variation of the parameters with the given indices, in this order."""
        return self._replace(covariance=self.covariance[np.ix_(indices, indices)])

    def with_unknown_parameters(self, count: int) -> "Variation":
        """Append further parameters, whose variation is unknown. Return the variation of all parameters."""
        unknown = np.diag(np.full(count, np.nan))
        return self._replace(covariance=scipy.linalg.block_diag(self.covariance, unknown))


class FlightSegments(NamedTuple):
    """Estimates of p parameters from each of B stretches of flight.

    Attributes:
        information: (B, p, p) information of each stretch.
        scores: (B, p) score of each stretch.
        estimates: (B, p) estimates, each from a single stretch.
        variances: (B, p) variances of the estimation errors.
        degrees_of_freedom: degrees of freedom of the variances; infinite if model and noise explain all errors.
        duration: duration of a stretch, s.
    """

    information: np.ndarray
    scores: np.ndarray
    estimates: np.ndarray
    variances: np.ndarray
    degrees_of_freedom: float
    duration: float

    @classmethod
    def of(cls, evidence: Evidence) -> "FlightSegments":
        """Divide the windows of a log into consecutive stretches of at least one window."""
        windows, count = len(evidence.scores), NUM_SEGMENTS
        blocks = np.arange(windows) * count // windows
        prior = np.diag(evidence.scales**-2.0)
        information = sums_over_blocks(evidence.information, blocks)
        scores = sums_over_blocks(evidence.scores, blocks)
        inverses = np.linalg.inv(information + prior)
        steps = -np.einsum("bij,bj->bi", inverses, scores)
        residual_scores = evidence.scores + np.einsum("wij,wj->wi", evidence.information, steps[blocks])
        num_windows = np.bincount(blocks)
        weights = (num_windows / np.maximum(num_windows - 1, 1))[blocks]
        inverse = np.linalg.inv(information.sum(axis=0) + prior)
        sandwich = inverse @ ((weights[:, None] * residual_scores).T @ residual_scores) @ inverse
        freedom = float(windows - count) if windows >= _MIN_WINDOWS_PER_SEGMENT * count else np.inf
        factor = np.maximum(1.0, np.diag(sandwich) / np.diag(inverse)) if np.isfinite(freedom) else 1.0
        variances = np.diagonal(inverses, axis1=1, axis2=2) * factor
        duration = evidence.duration / count
        return cls(information, scores, evidence.values + steps, variances, freedom, duration)

    def without(self, b: int) -> "FlightSegments":
        """Return the stretches of flight without stretch b."""
        others = np.arange(len(self.scores)) != b
        return self._replace(
            information=self.information[others],
            scores=self.scores[others],
            estimates=self.estimates[others],
            variances=self.variances[others],
        )

    def step(self) -> np.ndarray:
        """Return the Gauss-Newton step (p,) from the estimate of all windows to the estimate from these stretches.

        The step is zero for a parameter that no stretch determines.
        """
        total = self.information.sum(axis=0)
        return -np.asarray(pseudo_inverse(total, total) @ self.scores.sum(axis=0))

    def uncertainty(self) -> Uncertainty:
        """Return the jackknife uncertainty of the estimate from these stretches."""
        return jackknife(self.information, self.scores + self.information @ self.step())

    def variance_between(self) -> np.ndarray:
        """Return the variances d² (p,) of the p parameters between the stretches of flight."""
        count, scale = len(self.scores), np.median(self.variances, axis=0)
        estimates, variances = self.estimates / np.sqrt(scale), self.variances / scale
        significant = self._p_value(_weighted_squares(estimates, variances, 0.0)) < _SIGNIFICANCE_LEVEL
        low, high = np.zeros(estimates.shape[1]), count * np.var(estimates, axis=0)
        for _ in range(_NUM_BISECTIONS):
            middle = 0.5 * (low + high)
            is_too_small = _weighted_squares(estimates, variances, middle) > count - 1
            low, high = np.where(is_too_small, middle, low), np.where(is_too_small, high, middle)
        return np.where(significant, scale * high, 0.0)

    def _p_value(self, squares: np.ndarray) -> np.ndarray:
        """Return the p-values (p,) of weighted sums of squares, for the hypothesis that the parameters do not vary."""
        count = len(self.scores)
        if not np.isfinite(self.degrees_of_freedom):
            return np.asarray(scipy.stats.chi2.sf(squares, count - 1))
        return np.asarray(scipy.stats.f.sf(squares / (count - 1), count - 1, self.degrees_of_freedom))

    def correlation(self, between: np.ndarray) -> np.ndarray:
        """Return the correlations (p, p) of the parameters between stretches, given their variances d² (p,).

        A parameter that is the same in all stretches has zero correlation with all other parameters.
        """
        weights = 1.0 / (self.variances + between)
        mean = np.sum(weights * self.estimates, axis=0) / np.sum(weights, axis=0)
        deviations = (self.estimates - mean) * np.sqrt(weights)
        products = deviations.T @ deviations
        norms = np.sqrt(np.diag(products))
        scaling = np.outer(norms, norms)
        return np.where(scaling > 0.0, ratio(products, scaling, 0.0), np.eye(len(norms)))


def _weighted_squares(estimates: np.ndarray, variances: np.ndarray, between: np.ndarray | float) -> np.ndarray:
    """Return the sums (p,) Σ_b (θ_b - μ)² / (v_b + d²)."""
    weights = 1.0 / (variances + between)
    mean = np.sum(weights * estimates, axis=0) / np.sum(weights, axis=0)
    return np.asarray(np.sum(weights * (estimates - mean) ** 2, axis=0))


def estimate_variation(evidence: Evidence) -> Variation | None:
    """Return the variation of parameters from stretch to stretch; None if there are too few windows."""
    if len(evidence.scores) < _MIN_WINDOWS_PER_SEGMENT * NUM_SEGMENTS:
        return None
    stretches = FlightSegments.of(evidence)
    between = stretches.variance_between()
    deviations = np.sqrt(between)
    covariance = np.outer(deviations, deviations) * stretches.correlation(between)
    return Variation(covariance, float(NUM_SEGMENTS - 1), stretches.duration)


def uncertainty_of_mean(uncertainty: Uncertainty, evidence: Evidence, variation: Variation | None) -> Uncertainty:
    """Return the uncertainty of the mean value of each parameter over stretches of flight.

    If a parameter varies between stretches, its variance is the larger of two jackknife estimates: one over the short
    blocks of `uncertainty`, and one over whole stretches.

    Args:
        uncertainty: uncertainty by the jackknife over blocks that are shorter than a stretch.
        evidence: evidence of all windows.
        variation: variation of the parameters; None if it is unknown.
    """
    if variation is None:
        return uncertainty
    long_blocks = FlightSegments.of(evidence).uncertainty()
    variances = np.diag(uncertainty.covariance)
    # The ratio is 1 if the jackknife variance is zero, because a single block determines the parameter.
    increase = ratio(np.diag(long_blocks.covariance), variances, 1.0)
    varies = (np.diag(variation.covariance) > 0.0) & (increase > 1.0)
    factors = np.where(varies, np.sqrt(np.maximum(increase, 1.0)), 1.0)
    return Uncertainty(
        uncertainty.covariance * np.outer(factors, factors),
        np.where(varies, long_blocks.degrees_of_freedom, uncertainty.degrees_of_freedom),
        uncertainty.model_covariance,
    )
