"""How far numbers vary from one stretch of flight to the next, beyond the errors of their estimates.

What a model leaves out is not the same all the time: a battery empties, sensors warm up, one manoeuvre excites what
another does not. So each stretch b has numbers of its own, whose variance about those of the vehicle is d² (random
effects, as where studies are taken together: R. DerSimonian and N. Laird, Controlled Clinical Trials 7, 1986). Its
estimate θ_b, one step of Gauss and Newton from that of all windows, is off by a variance v_b more, and d² is what makes

    Σ_b (θ_b - μ)² / (v_b + d²) = B - 1

where μ is the mean with weights 1 / (v_b + d²) (R. C. Paule and J. Mandel, J. Res. Nat. Bur. Stand. 87, 1982). It is
zero where the sum with d = 0 is one that comes by chance in one of ten cases: the level that is usual for this test,
which has little power (J. P. T. Higgins et al., BMJ 327, 2003).

v_b is the diagonal of H_b⁻¹, with a belief as wide as a number may well be off, times what the windows within stretches
differ by more than if model and noise were right. Where there are fewer than two windows in a stretch, the model is
believed and d² has the rest, too: then the two are good for their sum alone, and what varies is not known.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.identification.evidence import Evidence, Uncertainty, inverted, jackknife, of_blocks

# Stretches that all flights are cut into: as many as are held out, one after another.
STRETCHES = 10
# Windows in each, at least, by which errors are told from what varies.
_WINDOWS = 2
# Cases in which numbers that do not vary are said to.
_CHANCE = 0.1
# Of the bisection; each halves what is left of d².
_HALVINGS = 60


class Variation(NamedTuple):
    """What numbers vary by from one stretch of flight to the next.

    Attributes:
        covariance: (p, p) of it; 0 for a number that is the same in all, as far as can be told, and a variance of NaN
            for one that was not looked at.
        degrees_of_freedom: of Student's distribution of it.
        seconds: that a stretch lasts, s.
    """

    covariance: np.ndarray
    degrees_of_freedom: float
    seconds: float

    def part(self, places: Sequence[int]) -> "Variation":
        """That of some of the numbers, by their places, in this order."""
        return self._replace(covariance=self.covariance[np.ix_(places, places)])

    def beside(self, others: int) -> "Variation":
        """With so many more numbers at the end that were not looked at."""
        unknown = np.diag(np.full(others, np.nan))
        return self._replace(covariance=scipy.linalg.block_diag(self.covariance, unknown))


class Stretches(NamedTuple):
    """What B stretches of flight say of parameters.

    Attributes:
        information: (B, p, p).
        scores: (B, p).
        estimates: (B, p) of each by itself.
        variances: (B, p) of their errors.
        degrees_of_freedom: of the variances; infinite if they are the model's.
        seconds: that one lasts, s.
    """

    information: np.ndarray
    scores: np.ndarray
    estimates: np.ndarray
    variances: np.ndarray
    degrees_of_freedom: float
    seconds: float

    @classmethod
    def of(cls, evidence: Evidence, count: int = STRETCHES) -> "Stretches":
        """Consecutive stretches; at least a window to each."""
        windows = len(evidence.scores)
        blocks = np.arange(windows) * count // windows
        own, pulls = of_blocks(evidence.information, blocks), of_blocks(evidence.scores, blocks)
        inverses = np.linalg.inv(own + np.diag(evidence.scales**-2.0))
        moves = -np.einsum("bij,bj->bi", inverses, pulls)
        left = evidence.scores + np.einsum("wij,wj->wi", evidence.information, moves[blocks])
        number = np.bincount(blocks)
        weights = np.where(number > 1, number / np.maximum(number - 1, 1), 0.0)[blocks]
        inverse = np.linalg.inv(own.sum(axis=0) + np.diag(evidence.scales**-2.0))
        sandwich = inverse @ ((weights[:, None] * left).T @ left) @ inverse
        freedom = float(windows - count) if windows >= _WINDOWS * count else np.inf
        wider = np.maximum(1.0, np.diag(sandwich) / np.diag(inverse)) if np.isfinite(freedom) else 1.0
        variances = np.diagonal(inverses, axis1=1, axis2=2) * wider
        return cls(own, pulls, evidence.values + moves, variances, freedom, evidence.seconds / count)

    def without(self, b: int) -> "Stretches":
        """All but one."""
        rest = np.arange(len(self.scores)) != b
        return self._replace(
            information=self.information[rest],
            scores=self.scores[rest],
            estimates=self.estimates[rest],
            variances=self.variances[rest],
        )

    def move(self) -> np.ndarray:
        """(p,) by how much the estimate of these stretches is below the values that the evidence is around.

        A number that none of them tells stays there.
        """
        whole = self.information.sum(axis=0)
        return np.asarray(inverted(whole, whole) @ self.scores.sum(axis=0))

    def mean(self) -> Uncertainty:
        """How sure the estimate of these stretches is."""
        return jackknife(self.information, self.scores - self.information @ self.move())

    def between(self) -> np.ndarray:
        """(p,) d² of each parameter."""
        count, size = len(self.scores), np.median(self.variances, axis=0)
        off, spread = self.estimates / np.sqrt(size), self.variances / size
        told = self._chance(_excess(off, spread, 0.0)) < _CHANCE
        low, high = np.zeros(off.shape[1]), count * np.var(off, axis=0)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            more = _excess(off, spread, middle) > count - 1
            low, high = np.where(more, middle, low), np.where(more, high, middle)
        return np.where(told, size * high, 0.0)

    def _chance(self, excess: np.ndarray) -> np.ndarray:
        """(p,) probability of as much if numbers do not vary; where variances are the model's, by χ²."""
        count = len(self.scores)
        if not np.isfinite(self.degrees_of_freedom):
            return np.asarray(scipy.stats.chi2.sf(excess, count - 1))
        return np.asarray(scipy.stats.f.sf(excess / (count - 1), count - 1, self.degrees_of_freedom))

    def correlation(self, between: np.ndarray) -> np.ndarray:
        """Return the (p, p) correlation of the deviations of stretches, for (p,) d².

        A parameter that is the same in all stretches is correlated with no other.
        """
        weights = 1.0 / (self.variances + between)
        off = (self.estimates - np.sum(weights * self.estimates, axis=0) / np.sum(weights, axis=0)) * np.sqrt(weights)
        products = off.T @ off
        sizes = np.sqrt(np.diag(products))
        units = np.outer(sizes, sizes)
        return np.where(units > 0.0, products / np.where(units > 0.0, units, 1.0), np.eye(len(sizes)))


def _excess(estimates: np.ndarray, variances: np.ndarray, between: np.ndarray | float) -> np.ndarray:
    """(p,) Σ (θ_b - μ)² / (v_b + d²)."""
    weights = 1.0 / (variances + between)
    mean = np.sum(weights * estimates, axis=0) / np.sum(weights, axis=0)
    return np.asarray(np.sum(weights * (estimates - mean) ** 2, axis=0))


def variation_of(evidence: Evidence) -> Variation | None:
    """What parameters vary by from stretch to stretch; None if there are too few windows to say."""
    if len(evidence.scores) < _WINDOWS * STRETCHES:
        return None
    stretches = Stretches.of(evidence)
    between = stretches.between()
    sizes = np.sqrt(between)
    covariance = np.outer(sizes, sizes) * stretches.correlation(between)
    return Variation(covariance, float(STRETCHES - 1), stretches.seconds)


def of_the_mean(uncertainty: Uncertainty, evidence: Evidence, variation: Variation | None) -> Uncertainty:
    """How sure the mean is of parameters that vary: blocks as long as stretches count where they say more.

    Args:
        uncertainty: by shorter blocks.
        evidence: of all windows.
        variation: of the parameters.
    """
    if variation is None:
        return uncertainty
    long = Stretches.of(evidence).mean()
    own = np.diag(uncertainty.covariance)
    # The jackknife gives no variance to a parameter that a single block tells; one degree of freedom says so.
    ratio = np.where(own > 0.0, np.diag(long.covariance) / np.where(own > 0.0, own, 1.0), 1.0)
    wider = (np.diag(variation.covariance) > 0.0) & (ratio > 1.0)
    sizes = np.where(wider, np.sqrt(np.maximum(ratio, 1.0)), 1.0)
    return Uncertainty(
        uncertainty.covariance * np.outer(sizes, sizes),
        np.where(wider, long.degrees_of_freedom, uncertainty.degrees_of_freedom),
        uncertainty.model,
    )
