"""What windows of flight say of parameters, and how far parameters are off by what blocks of windows say.

To first order around their estimate, a window adds H_w = Jᵀ J to the information on parameters and Jᵀ e to the score,
of whitened errors e with derivatives J. If model and noise were right, the covariance of θ would be H⁻¹ with H = Σ H_w.
They are not quite: what a model leaves out acts for seconds. So it is taken from how much θ moves as blocks of
consecutive windows are left out (the jackknife over blocks; to first order the sandwich CR3 of R. M. Bell and
D. F. McCaffrey, Survey Methodology 28, 2002, which does not come out too small where blocks are few)

    θ₋ᵦ - θ = (H - H_b)⁻¹ Σ_block Jᵀ e,   P = (B - 1)/B Σ_b (θ₋ᵦ - θ)(θ₋ᵦ - θ)ᵀ

Where each block ends in the state that the next begins with, what one has too much the next has too little: half of the
products of neighbours is added (Bartlett's weights with one lag: W. K. Newey and K. D. West, Econometrica 55, 1987).

A parameter that only a few of the blocks tell has as few degrees of freedom: with c_b the diagonal of H⁻¹ H_b H⁻¹, it
is the effective number of blocks, (Σ c_b)² / Σ c_b², less one.

Where a fit has other covariances of blocks, the sandwich CR2 of the same source is the choice, whose mean is right if
the model is: `bias_reduced`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

# Of the largest eigenvalue of information on numbers of unit size, less of which is rounding.
_NOTHING = 1e-12


class Uncertainty(NamedTuple):
    """How sure parameters are.

    Attributes:
        covariance: (p, p) of blocks.
        degrees_of_freedom: (p,) of Student's t.
        model: (p, p) the covariance if model and noise were right.
    """

    covariance: np.ndarray
    degrees_of_freedom: np.ndarray
    model: np.ndarray


class Evidence(NamedTuple):
    """What windows say of parameters, to first order around their estimate.

    Attributes:
        names: (p,) of the parameters.
        values: (p,) their estimate of all windows.
        scales: (p,) by how much they may well be off.
        information: (W, p, p) Jᵀ J of each window, in the order of flight.
        scores: (W, p) Jᵀ e.
        seconds: of all windows, s.
    """

    names: tuple[str, ...]
    values: np.ndarray
    scales: np.ndarray
    information: np.ndarray
    scores: np.ndarray
    seconds: float

    def given(self, names: Sequence[str]) -> "Evidence":
        """What windows say of some of the parameters, the others held at their values."""
        kept = [self.names.index(name) for name in names]
        return Evidence(
            tuple(names),
            self.values[kept],
            self.scales[kept],
            self.information[:, kept][:, :, kept],
            self.scores[:, kept],
            self.seconds,
        )


def jackknife(
    information: np.ndarray, scores: np.ndarray, *, prior: np.ndarray | None = None, adjoining: bool = False
) -> Uncertainty:
    """How sure parameters are.

    A number that a single block tells does not move as that is left out: it has one degree of freedom, the fewest.

    Args:
        information: (B, p, p) of blocks.
        scores: (B, p).
        prior: (p,) information of the prior, whose share of the uncertainty is added.
        adjoining: whether each ends in the state that the next begins with.
    """
    number = len(scores)
    beliefs = np.zeros(information.shape[1]) if prior is None else prior
    whole = information.sum(axis=0) + np.diag(beliefs)
    moves = (inverted(whole - information, whole) @ scores[:, :, None])[:, :, 0]
    inverse = inverted(whole, whole)
    freedom = effective_blocks(information, inverse) - 1.0
    squares = moves.T @ moves
    if adjoining:
        neighbours = moves[:-1].T @ moves[1:]
        squares += 0.5 * (neighbours + neighbours.T)
    covariance = (number - 1) / number * squares + inverse @ np.diag(beliefs) @ inverse
    own, expected = np.diag(covariance), np.diag(inverse)
    # Blocks that happen to agree do not make an estimate more certain than the model says.
    wider = np.sqrt(np.maximum(1.0, np.where(own > 0.0, expected / np.where(own > 0.0, own, 1.0), 1.0)))
    covariance = np.where(np.eye(len(own), dtype=bool) & (own <= 0.0), expected, covariance)
    return Uncertainty(covariance * np.outer(wider, wider), np.maximum(freedom, 1.0), inverse)


def effective_blocks(information: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Return the effective number of blocks (p,) that determine each parameter, between 1 and B.

    It is (Σ c_b)² / Σ c_b², with c_b the diagonal of H⁻¹ H_b H⁻¹. It is 1 for a parameter on which no block depends:
    such a parameter keeps its prior, and the caller reports it as not identified.

    Args:
        information: (B, p, p) of blocks, H_b.
        inverse: (p, p) H⁻¹.
    """
    shares = np.einsum("ij,bjk,ki->bi", inverse, information, inverse)
    largest = shares.max(axis=0)
    # Relative to the largest, so that the squares of small numbers do not underflow.
    relative = np.where(largest > 0.0, shares / np.where(largest > 0.0, largest, 1.0), 1.0 / len(shares))
    number = relative.sum(axis=0) ** 2 / (relative**2).sum(axis=0)
    return np.where(largest > 0.0, number, 1.0)


def explained_share(left: np.ndarray | float, whole: np.ndarray | float) -> np.ndarray:
    """Return the share of a sum of squares that a model explains, 1 - left / whole; NaN where nothing varies.

    Args:
        left: sums of the squares that the model leaves, of any shape.
        whole: sums of the squares without it, of the same shape.
    """
    whole = np.asarray(whole, dtype=float)
    return np.where(whole > 0.0, 1.0 - left / np.where(whole > 0.0, whole, 1.0), np.nan)


def inverted(information: np.ndarray, whole: np.ndarray) -> np.ndarray:
    """(..., p, p) inverse of information; of what it does not tell, zero (the pseudo-inverse).

    Args:
        information: (..., p, p).
        whole: (p, p) that it is part of, which says what is much of each number.
    """
    own = np.diag(whole)
    sizes = 1.0 / np.sqrt(np.where(own > 0.0, own, 1.0))
    units = np.outer(sizes, sizes)
    return np.asarray(units * np.linalg.pinv(information * units, rcond=_NOTHING, hermitian=True))


def bias_reduced(information: np.ndarray, scores: np.ndarray, inverse: np.ndarray, *, least: float) -> np.ndarray:
    """(p, p) covariance of parameters by how the scores of blocks scatter (CR2).

    With A Aᵀ = H⁻¹ it is Σ_b m_b m_bᵀ, m_b = A (1 - Aᵀ H_b A)^(-1/2) Aᵀ s_b: the middle makes up for what the fit takes
    away of a block that it follows.

    Args:
        information: (B, p, p) of blocks, H_b.
        scores: (B, p) s_b, at the solution.
        inverse: (p, p) H⁻¹, beliefs among it.
        least: what a block's own error leaves in the fit, at least, as a share.
    """
    root = np.linalg.cholesky(inverse)
    shares, directions = np.linalg.eigh(root.T @ information @ root)
    pulls = np.swapaxes(directions, 1, 2) @ (scores @ root)[:, :, None]
    pulls /= np.sqrt(np.maximum(1.0 - shares, least))[:, :, None]
    moves = (directions @ pulls)[:, :, 0] @ root.T
    return np.asarray(moves.T @ moves)


def of_blocks(values: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """(B, ...) sums of (W, ...) values over the windows of each block, of (W,) numbers of blocks from 0 on."""
    return np.stack([values[blocks == b].sum(axis=0) for b in range(int(blocks.max()) + 1)])
