"""Information that flight windows contain about the parameters, and uncertainty of the estimates.

To first order around the estimate, a window with whitened errors e and derivatives J adds H_w = Jᵀ J to the information
and g_w = Jᵀ e to the score, the gradient of ½ eᵀ e. If model and noise were correct, the covariance of the estimate θ
would be H⁻¹ with H = Σ H_w. Model errors last for seconds, however, so the errors of neighbouring windows are
correlated. The covariance is therefore computed by the jackknife over blocks of adjacent windows,

    θ₋ᵦ - θ = (H - H_b)⁻¹ g_b,   P = (B - 1)/B Σ_b (θ₋ᵦ - θ)(θ₋ᵦ - θ)ᵀ,

where θ₋ᵦ is the estimate without block b, and H_b and g_b are the sums over the windows of block b. To first order, P
is the sandwich estimator CR3 of R. M. Bell and D. F. McCaffrey (Survey Methodology 28, 2002), which does not
underestimate the covariance if there are few blocks.

If each block ends in the state in which the next one starts, the scores of neighbouring blocks have a negative
correlation. The products of the shifts θ₋ᵦ - θ of neighbouring blocks are then added to the sum in P, with the Bartlett
weight ½ for a lag of one block (W. K. Newey and K. D. West, Econometrica 55, 1987).

A parameter that only a few blocks determine has few degrees of freedom. The degrees of freedom are the effective number
of blocks, (Σ c_b)² / Σ c_b², minus one, where c_b is the diagonal of H⁻¹ H_b H⁻¹.

By chance, all blocks may give nearly the same estimate. A confidence interval is therefore never narrower than the
interval for a correct model, which follows from the normal distribution with the covariance H⁻¹.
"""

from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.statistics.interval import CONFIDENCE

# Eigenvalues of the scaled information below this fraction of the largest one are treated as rounding errors.
_MIN_EIGENVALUE_RATIO = 1e-12


class Uncertainty(NamedTuple):
    """Uncertainty of estimated parameters.

    Attributes:
        covariance: (p, p) covariance of the errors.
        degrees_of_freedom: (p,) degrees of freedom of the Student's t-distribution that each error follows; infinite
            for the normal distribution.
        model_covariance: (p, p) covariance that the errors would have if the model and the noise were correct.
    """

    covariance: np.ndarray
    degrees_of_freedom: np.ndarray
    model_covariance: np.ndarray


class Evidence(NamedTuple):
    """Information of W windows about p parameters, to first order around the estimate.

    Attributes:
        names: (p,) names of the parameters.
        values: (p,) estimates from all windows.
        scales: (p,) standard deviations of the prior.
        information: (W, p, p) Jᵀ J of each window, in chronological order.
        scores: (W, p) Jᵀ e of each window.
        duration: duration of all windows together, s.
    """

    names: tuple[str, ...]
    values: np.ndarray
    scales: np.ndarray
    information: np.ndarray
    scores: np.ndarray
    duration: float


def jackknife(
    information: np.ndarray, scores: np.ndarray, *, prior: np.ndarray | None = None, adjacent: bool = False
) -> Uncertainty:
    """Return the uncertainty of p parameters, estimated by the jackknife over B blocks.

    If the 95 % interval of a parameter would be narrower than for a correct model, its variance is that in
    `Uncertainty.model_covariance`, and its error follows the normal distribution. Each parameter has at least one
    degree of freedom.

    Args:
        information: (B, p, p) information of the blocks.
        scores: (B, p) scores of the blocks.
        prior: (p,) information of the prior; None without a prior. The covariance includes the error of the prior mean.
        adjacent: True if each block ends in the state in which the next one starts.
    """
    num_blocks = len(scores)
    prior_information = np.zeros(information.shape[1]) if prior is None else prior
    total = information.sum(axis=0) + np.diag(prior_information)
    shifts = (pseudo_inverse(total - information, total) @ scores[:, :, None])[:, :, 0]
    inverse = pseudo_inverse(total, total)
    degrees_of_freedom = np.maximum(effective_blocks(information, inverse) - 1.0, 1.0)
    squares = shifts.T @ shifts
    if adjacent:
        neighbours = shifts[:-1].T @ shifts[1:]
        squares += 0.5 * (neighbours + neighbours.T)
    covariance = (num_blocks - 1) / num_blocks * squares + inverse @ np.diag(prior_information) @ inverse
    variances, model_variances = np.diag(covariance), np.diag(inverse)
    # With a single degree of freedom, the jackknife cannot show that the model is wrong. The quantile of Student's
    # distribution then remains.
    has_spread = degrees_of_freedom > 1.0
    quantiles = np.where(has_spread, quantile(degrees_of_freedom) / quantile(np.inf), 1.0)
    is_narrow = quantiles**2 * variances < model_variances
    factors = np.sqrt(np.where(is_narrow, ratio(model_variances, variances, 1.0), 1.0))
    covariance = np.where(np.eye(len(variances), dtype=bool) & (variances <= 0.0), model_variances, covariance)
    return Uncertainty(
        covariance * np.outer(factors, factors), np.where(is_narrow & has_spread, np.inf, degrees_of_freedom), inverse
    )


def quantile(degrees_of_freedom: np.ndarray | float) -> np.ndarray:
    """Return the half-width of the 95 % interval of Student's t-distribution, in standard deviations of the estimate.

    Args:
        degrees_of_freedom: degrees of freedom, of any shape; infinite for the normal distribution.
    """
    return np.asarray(scipy.stats.t.ppf(0.5 * (1.0 + CONFIDENCE), degrees_of_freedom))


def ratio(numerator: np.ndarray, denominator: np.ndarray, default: float) -> np.ndarray:
    """Return the ratio of two arrays, with a default where the denominator is not positive."""
    shape = np.broadcast_shapes(numerator.shape, denominator.shape)
    return np.divide(numerator, denominator, out=np.full(shape, default), where=denominator > 0.0)


def effective_blocks(information: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Return the effective number of blocks (p,) that determine each parameter, between 1 and B.

    The number is (Σ c_b)² / Σ c_b², where c_b is the diagonal of H⁻¹ H_b H⁻¹. The number is 1 for a parameter that
    influences no block. Such a parameter keeps its prior mean, and is reported as not identified.

    Args:
        information: (B, p, p) information H_b of the blocks.
        inverse: (p, p) inverse H⁻¹ of the total information, including the information of the prior.
    """
    fractions = np.einsum("ij,bjk,ki->bi", inverse, information, inverse)
    largest = fractions.max(axis=0)
    # The values c_b are divided by the largest one, so that squares of small numbers do not underflow.
    relative = ratio(fractions, largest, 1.0 / len(fractions))
    effective_number = relative.sum(axis=0) ** 2 / (relative**2).sum(axis=0)
    return np.where(largest > 0.0, effective_number, 1.0)


def pseudo_inverse(information: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Return the pseudo-inverse (..., p, p) of information, with zero rows for parameters without information.

    Args:
        information: (..., p, p) information.
        total: (p, p) total information, whose diagonal sets the scale of each parameter.
    """
    diagonal = np.diag(total)
    scales = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    scaling = np.outer(scales, scales)
    # The decomposition of a symmetric matrix takes a third of the time of `np.linalg.pinv`.
    values, vectors = np.linalg.eigh(information * scaling)
    is_known = values > _MIN_EIGENVALUE_RATIO * np.max(values, axis=-1, keepdims=True, initial=0.0)
    inverses = np.where(is_known, 1.0 / np.where(is_known, values, 1.0), 0.0)
    return np.asarray(scaling * ((vectors * inverses[..., None, :]) @ vectors.swapaxes(-1, -2)))


def sums_over_blocks(values: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """Return the sum (B, ...) of the values in each block of windows.

    Args:
        values: (W, ...) value of each window.
        blocks: (W,) block number of each window, from 0.
    """
    return np.stack([values[blocks == b].sum(axis=0) for b in range(int(blocks.max()) + 1)])
