"""Linear fractional model of the dependence of a loop on parameters, fitted to exact loops.

The system matrix of a loop depends on parameters ζ = (ζ₁, ..., ζ_k) nonlinearly: a mass enters as 1/m, and a time
constant as exp(-t/τ). A linear fractional model

    A(ζ) = A₀ + L (I - Z N)⁻¹ Z R,    Z = diag(ζ₁ I, ..., ζ_k I)

has the structure that bounds of the structured singular value need. For each parameter, L, R and the diagonal block of
N are a realisation of a polynomial of second degree (B. Ho and R. Kalman, 1966). The other blocks of N contain the
products of parameters. The model omits higher powers and small singular values. The resulting error is treated as a
further uncertain block. Its size is the largest error at the exact loops, multiplied by a safety factor.
"""

from itertools import combinations, pairwise, product
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.linear.structured_singular_value import Block, PeakBound, peak_mu_bound

# Smallest singular value that the realisation of a parameter contains, relative to the largest singular value of all
# parameters.
_RANK_TOLERANCE = 3e-4
_RIDGE = 1e-3  # regularisation of the fit of mixed terms, relative to the norm of its equations
# Smallest singular value of the errors that is modelled, relative to their largest singular value.
_ERROR_TOLERANCE = 1e-2
_MIN_ERROR = 1e-7  # smaller errors of balanced system matrices are rounding errors
_ERROR_FACTOR = 1.5  # safety factor on the errors at the fitted points, since errors between them may be larger
_MAX_CORNERS = 64  # largest number of corners of the parameter box [-1, 1]ᵏ to which a model is fitted
STEPS = (-1.0, -0.5, 0.5, 1.0)
"""Values of each parameter ζ at which a model is fitted while all other parameters are zero."""


class FractionalModel(NamedTuple):
    """Linear fractional model of the system matrix of a loop, as a function of k parameters ζ.

    The system matrix is

        A + L (I - Z N)⁻¹ Z R + U E V,    Z = diag(ζ₁ I, ..., ζ_k I)

    The unknown matrix E represents the error of the model. Its largest singular value is at most 1.

    Attributes:
        A: (n, n) system matrix at ζ = 0.
        L: (n, r) matrix L of the equation.
        N: (r, r) matrix N of the equation.
        R: (r, n) matrix R of the equation.
        sizes: sizes of the k blocks of Z, which sum to r.
        U: (n, e) matrix U of the equation.
        V: (e, n) matrix V of the equation.
    """

    A: np.ndarray
    L: np.ndarray
    N: np.ndarray
    R: np.ndarray
    sizes: tuple[int, ...]
    U: np.ndarray
    V: np.ndarray

    def loops(self, points: np.ndarray) -> np.ndarray:
        """Return the system matrices (K, n, n) at parameters (K, k)."""
        Z = np.repeat(points, self.sizes, axis=1)[:, :, np.newaxis]
        return self.A + self.L @ np.linalg.solve(np.eye(len(self.N)) - Z * self.N, Z * self.R)

    def bound(self, *, tolerance: float = 0.01, stop: float = 0.0, limit: float = np.inf) -> PeakBound:
        """Return the upper bound of the structured singular value on the unit circle.

        A bound β ≥ 1 proves that the loop is stable for all parameters with |ζ_i| < 1/β.

        Args:
            tolerance: relative accuracy.
            stop: the search ends as soon as the bound is at most this value.
            limit: largest bound of interest; if the bound is larger, the result is infinite.

        Raises:
            ArithmeticError: if no bound can be proved.
        """
        blocks = [Block(size, is_real=True) for size in self.sizes if size]
        num_errors = len(self.V)
        if num_errors:
            blocks.append(Block(num_errors, is_real=False))
        D = scipy.linalg.block_diag(self.N, np.zeros((num_errors, num_errors)))
        B, C = np.hstack([self.L, self.U]), np.vstack([self.R, self.V])
        return peak_mu_bound(self.A, B, C, D, blocks, tolerance=tolerance, stop=stop, limit=limit)

    def strengths(self, omega: float) -> np.ndarray:
        """Return the strength (k,) of each parameter's effect at ω (rad per sample).

        It is the norm of the frequency response, at ζ = 0, from the outputs of the parameter's block of Z to the inputs
        of this block.
        """
        response = self.R @ np.linalg.solve(np.exp(1j * omega) * np.eye(len(self.A)) - self.A, self.L) + self.N
        ends = np.cumsum([0, *self.sizes])
        return np.array([np.linalg.norm(response[low:high, low:high]) for low, high in pairwise(ends)])


def spectral_radii(loops: np.ndarray) -> np.ndarray:
    """Return the spectral radii (K,) of system matrices (K, n, n); NaN for a matrix with NaN."""
    finite = np.isfinite(loops).all(axis=(1, 2))
    radii = np.full(len(loops), np.nan)
    if finite.any():
        radii[finite] = np.abs(np.linalg.eigvals(loops[finite])).max(axis=1, initial=0.0)
    return radii


def fitting_points(num_parameters: int, generator: np.random.Generator) -> np.ndarray:
    """Return the parameters (K, k) between -1 and 1 at which `fit_fractional_model` needs the loops.

    They are the centre, points on the axes, corners of the planes of two axes, and corners and other points of the box.
    """
    k = num_parameters
    axes = [step * row for row in np.eye(k) for step in STEPS]
    planes = [a * np.eye(k)[i] + b * np.eye(k)[j] for i, j in combinations(range(k), 2) for a, b in _SIGNS]
    if 2**k <= _MAX_CORNERS:
        corners = np.array([*product((-1.0, 1.0), repeat=k)])
    else:
        corners = generator.choice([-1.0, 1.0], size=(_MAX_CORNERS, k))
    inside = generator.uniform(-1.0, 1.0, (_MAX_CORNERS // 4, k))
    return np.vstack([np.zeros((1, k)), np.array([*axes, *planes]).reshape(-1, k), corners, inside])


# Signs of two parameters at the four corners of their ranges. Opposite corners follow each other.
_SIGNS = ((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0))


def fit_fractional_model(points: np.ndarray, loops: np.ndarray) -> FractionalModel:
    """Return the linear fractional model of loops at the parameters of `fitting_points`.

    Args:
        points: (K, k) parameters.
        loops: (K, n, n) system matrices.
    """
    k, n = points.shape[1], loops.shape[1]
    _, scales = scipy.linalg.matrix_balance(loops[0], permute=False, separate=True)
    scales = scales[0]
    loops = loops * scales / scales[:, np.newaxis]
    centre, changes = loops[0], loops - loops[0]
    num_axes = len(STEPS) * k
    axes = changes[1 : 1 + num_axes].reshape(k, len(STEPS), n * n)
    # The fit has a linear and a quadratic term. Terms of higher order are part of the model error.
    vandermonde = np.array([[step, step * step] for step in STEPS])
    series = (np.linalg.pinv(vandermonde) @ axes).reshape(k, 2, n, n)
    decompositions = [np.linalg.svd(np.block([[c[0], c[1]], [c[1], np.zeros((n, n))]])) for c in series]
    largest = max((s[0] for _, s, _ in decompositions), default=0.0)
    lefts, diagonals, rights = [], [], []
    for c, (U, s, V) in zip(series, decompositions, strict=True):
        rank = int((s > _RANK_TOLERANCE * largest).sum()) if largest > 0.0 else 0
        root = np.sqrt(s[:rank])
        U, V = U[:, :rank], V[:rank]
        lefts.append(U[:n] * root)
        rights.append(root[:, np.newaxis] * V[:, :n])
        diagonals.append(U[:n].T @ c[1] @ V[:, :n].T / np.outer(root, root))
    sizes = [left.shape[1] for left in lefts]
    N = scipy.linalg.block_diag(*diagonals) if sizes else np.zeros((0, 0))
    ends = np.cumsum([0, *sizes])
    rows = [slice(low, high) for low, high in pairwise(ends)]
    planes = changes[1 + num_axes :]
    for number, (i, j) in enumerate(combinations(range(k), 2)):
        if sizes[i] and sizes[j]:
            same, opposite = planes[4 * number : 4 * number + 2], planes[4 * number + 2 : 4 * number + 4]
            mixed = (same.sum(axis=0) - opposite.sum(axis=0)) / 4.0
            N[rows[i], rows[j]], N[rows[j], rows[i]] = _mixed_blocks(
                mixed, (lefts[i], rights[i]), (lefts[j], rights[j])
            )
    L, R = np.hstack([np.zeros((n, 0)), *lefts]), np.vstack([np.zeros((0, n)), *rights])
    model = FractionalModel(centre, L, N, R, tuple(sizes), np.zeros((n, 0)), np.zeros((0, n)))
    U, V = _error_matrices(loops - model.loops(points))
    column = scales[:, np.newaxis]
    return FractionalModel(centre * column / scales, L * column, N, R / scales, tuple(sizes), U * column, V / scales)


def _error_matrices(errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return matrices U (n, e) and V (e, n) such that each error is U E V, where no singular value of E exceeds 1.

    Args:
        errors: (K, n, n) errors of the model at K points.
    """
    n = errors.shape[1]
    # The columns of U are left singular vectors of the matrix (n, K n) that contains all errors side by side. The rows
    # of V are right singular vectors of the matrix (K n, n) that contains all errors one below the other.
    squares, left = np.linalg.eigh(np.einsum("kij,klj->il", errors, errors))
    other_squares, right = np.linalg.eigh(np.einsum("kji,kjl->il", errors, errors))
    s, t = (np.sqrt(np.maximum(each[::-1], 0.0)) for each in (squares, other_squares))
    rank = int((s > _ERROR_TOLERANCE * max(s[0], _MIN_ERROR)).sum())
    if not rank:
        return np.zeros((n, 0)), np.zeros((0, n))
    U, V = left[:, : -rank - 1 : -1] * np.sqrt(s[:rank]), (right[:, : -rank - 1 : -1] * np.sqrt(t[:rank])).T
    sizes = np.linalg.norm(np.linalg.pinv(U) @ errors @ np.linalg.pinv(V), 2, axis=(1, 2))
    root = np.sqrt(_ERROR_FACTOR * sizes.max())
    return U * root, V * root


def _mixed_blocks(
    mixed: np.ndarray, first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the blocks of N that represent the product of two parameters ζ₁ and ζ₂.

    The blocks X and Y minimise the difference between L₁ X R₂ + L₂ Y R₁ and the coefficient of ζ₁ ζ₂.

    Args:
        mixed: (n, n) coefficient of ζ₁ ζ₂ in the system matrix.
        first: matrices L₁ and R₁ of the first parameter.
        second: matrices L₂ and R₂ of the second parameter.

    Returns:
        Block X in the rows of the first parameter, and block Y in the rows of the second parameter.
    """
    (L1, R1), (L2, R2) = first, second
    # The projection on orthonormal bases reduces the number of equations.
    left, right = np.linalg.qr(np.hstack([L1, L2]))[0], np.linalg.qr(np.vstack([R1, R2]).T)[0]
    equations = np.hstack([np.kron(left.T @ L1, (R2 @ right).T), np.kron(left.T @ L2, (R1 @ right).T)])
    target = (left.T @ mixed @ right).ravel()
    ridge = _RIDGE * np.linalg.norm(equations, 2)
    stacked = np.vstack([equations, ridge * np.eye(equations.shape[1])])
    x = np.linalg.lstsq(stacked, np.append(target, np.zeros(equations.shape[1])), rcond=None)[0]
    r1, r2 = L1.shape[1], L2.shape[1]
    return x[: r1 * r2].reshape(r1, r2), x[r1 * r2 :].reshape(r2, r1)
