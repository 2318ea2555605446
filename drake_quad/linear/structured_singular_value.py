"""Upper bounds of the structured singular value, at one frequency and over all frequencies of a sampled system.

A matrix M is in feedback with uncertain blocks Δ = diag(Δ₁, Δ₂, ...). A real block is δ I with an unknown real number
δ, and a complex block is any complex matrix. The structured singular value μ(M) is the reciprocal of the size of the
smallest Δ for which I - M Δ is singular. The bound β follows from scalings that commute with Δ (M. Fan, A. Tits and J.
Doyle, "Robustness in the presence of mixed parametric uncertainty and unmodeled dynamics", 1991):

    μ(M) ≤ β    if    Mᴴ D M + j (G M - Mᴴ G) - β² D < 0,    D = Dᴴ > 0,    G = Gᴴ

For a real block of size r, D and G contain any Hermitian (r, r) matrices. For a complex block, D contains d I, and G is
zero. Any scalings prove a bound, and the best ones are found by the method of centers (S. Boyd and L. El Ghaoui,
"Method of centers for minimizing generalized eigenvalues", 1993).

The same scalings prove the bound at neighbouring frequencies. The ends of this interval of frequencies follow from the
eigenvalues of a matrix pencil, so that the whole unit circle can be covered without a grid (C. Lawrence, A. Tits and
P. Van Dooren, "A fast algorithm for the computation of an upper bound on the μ-norm", 2000).
"""

import functools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.process_settings import single_threaded_blas

_MAX_CENTERS = 60  # largest number of steps of the method of centers, which usually converges much earlier
_MAX_NEWTON_STEPS = 30  # largest number of Newton steps to a center
_CENTER_TOLERANCE = 0.05  # Newton decrement, squared, at which a center is accurate enough
_CENTER_WEIGHT = 0.05  # weight of the previous β² in the next one, so that the center remains strictly feasible
_MIN_BOUND = 1e-6  # smallest bound that is computed, in place of zero
# An eigenvalue that is closer to the unit circle than this is treated as the end of an interval of frequencies. An
# unnecessary division of an interval does no harm.
_CIRCLE_TOLERANCE = 1e-3
# Largest number of pole frequencies at which scalings are computed first.
_NUM_FIRST_FREQUENCIES = 24
# Largest number of further frequencies at which scalings D and G are computed. The computation ends earlier if the
# scalings prove the bound at all frequencies.
_MAX_FREQUENCIES = 400
_MIN_GAP = 1e-9  # rad; a narrower gap between two intervals of frequencies is a rounding error


class Block(NamedTuple):
    """Block of an uncertain matrix Δ.

    Attributes:
        size: number r of rows and columns.
        is_real: True for δ I with a real number δ, False for a full complex matrix.
    """

    size: int
    is_real: bool


@dataclass(frozen=True)
class MuBound:
    """Upper bound of the structured singular value of a matrix.

    Attributes:
        value: bound β.
        D: (r, r) scaling.
        G: (r, r) scaling.
    """

    value: float
    D: np.ndarray
    G: np.ndarray


def mu_bound(
    matrix: np.ndarray,
    blocks: Sequence[Block],
    *,
    tolerance: float = 1e-3,
    stop: float = 0.0,
    starts: Sequence[MuBound] = (),
) -> MuBound:
    """Return an upper bound of the structured singular value of a matrix.

    Args:
        matrix: (r, r) matrix.
        blocks: blocks of Δ, whose sizes sum to r.
        tolerance: relative accuracy with which the bound is minimised.
        stop: the minimisation ends as soon as the bound is at most this value.
        starts: bounds of similar matrices. The search starts from those scalings that prove the smallest bound.

    Raises:
        ValueError: if the sizes of the blocks do not match the matrix.
    """
    M = np.asarray(matrix, dtype=complex)
    r = len(M)
    if M.shape != (r, r) or sum(block.size for block in blocks) != r:
        raise ValueError(f"blocks of {sum(block.size for block in blocks)} rows do not match a matrix {M.shape}")
    if r == 0:
        return MuBound(_MIN_BOUND, np.zeros((0, 0)), np.zeros((0, 0)))
    basis = _basis(tuple(blocks))
    scalings = [(np.eye(r, dtype=complex), np.zeros((r, r), dtype=complex)), *((each.D, each.G) for each in starts)]
    squares = [_smallest_square(M, D, G) for D, G in scalings]
    square = min(squares)
    best = MuBound(_value(square), *scalings[squares.index(square)])
    x = np.concatenate([_coordinates(best.D, basis.D), _coordinates(best.G, basis.G)])
    lowest = max(stop, _MIN_BOUND) ** 2
    level = max(1.05 * square, lowest)
    for _ in range(_MAX_CENTERS):
        x = _center(x, M, basis, level)
        D, G = basis.scalings(x)
        square = _smallest_square(M, D, G)
        found = MuBound(_value(square), D, G)
        if level == lowest:
            # The search ends here, since no smaller bound is required. For `peak_mu_bound`, these scalings are better
            # than scalings with a smaller bound, since they prove the required bound in a wider frequency interval.
            return found
        gain = best.value - found.value
        best = found if gain > 0.0 else best
        if square > lowest and gain < 0.1 * tolerance * found.value:
            break
        level = max((1.0 - _CENTER_WEIGHT) * square + _CENTER_WEIGHT * level, lowest) if square > lowest else lowest
    return best


def _smallest_square(M: np.ndarray, D: np.ndarray, G: np.ndarray) -> float:
    """Return the square of the smallest bound β that the scalings D and G prove.

    The result is negative if the inequality of D and G holds for β = 0. The scalings then prove every bound.
    """
    return float(scipy.linalg.eigh(-_form(M, D, G, 0.0), D, eigvals_only=True)[-1])


def _form(M: np.ndarray, D: np.ndarray, G: np.ndarray, level: float) -> np.ndarray:
    """Return F = β² D - Mᴴ D M - j (G M - Mᴴ G) for the level β².

    If F is positive definite, β is a bound of the structured singular value of M.
    """
    GM = 1j * (G @ M)
    return level * D - M.conj().T @ D @ M - GM - GM.conj().T


def _value(square: float) -> float:
    return max(math.sqrt(max(square, 0.0)), _MIN_BOUND)


class _Terms(NamedTuple):
    """Terms of a basis of Hermitian matrices: each element of the basis is a sum of terms c E + (c E)ᴴ.

    A matrix E has a single entry 1 at (i, j). Derivatives of log det then need products of numbers instead of matrices.

    Attributes:
        i: (t,) rows of the entries.
        j: (t,) columns of the entries.
        c: (t,) coefficients.
        sums: (k, t) sparse matrix that adds the terms of each element.
    """

    i: np.ndarray
    j: np.ndarray
    c: np.ndarray
    sums: scipy.sparse.csr_matrix

    @staticmethod
    def of(elements: np.ndarray) -> "_Terms":
        """Return the terms c E + (c E)ᴴ of all elements of a basis.

        Args:
            elements: (k, r, r) Hermitian matrices, the elements of the basis.
        """
        owners, i, j = np.nonzero(np.triu(elements))
        count = len(owners)
        sums = scipy.sparse.csr_matrix((np.ones(count), (owners, range(count))), (len(elements), count))
        return _Terms(i, j, elements[owners, i, j] / np.where(i == j, 2.0, 1.0), sums)

    def derivatives(self, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return tr(Y B) (k,) and tr(Y B Y B') (k, k) for all elements B and B' of the basis.

        If Y is the inverse of a positive definite matrix, they are derivatives of the log det of this matrix.
        """
        left, right = Y.T[self.i] * self.c[:, np.newaxis], Y[self.j]
        products = (left[:, self.j] * self.c) * right[:, self.i] + (left[:, self.i] * self.c.conj()) * right[:, self.j]
        return 2.0 * (self.sums @ (self.c * Y[self.j, self.i]).real), 2.0 * (self.sums @ (self.sums @ products.real).T)


class _Basis(NamedTuple):
    """Basis of the scalings that commute with some blocks.

    Attributes:
        D: (m, r, r) basis of the Hermitian matrices D.
        G: (k, r, r) basis of the Hermitian matrices G.
        D_terms: terms of D.
        form_terms: terms of the matrices (2r, 2r) [-D, jG; -jG, D], which have the basis of D and then that of G.
    """

    D: np.ndarray
    G: np.ndarray
    D_terms: _Terms
    form_terms: _Terms

    def scalings(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the scalings D and G, given their coordinates in this basis.

        Args:
            x: (m + k,) coordinates of D, followed by those of G.

        Returns:
            D and G, (r, r) matrices.
        """
        m = len(self.D)
        return np.tensordot(x[:m], self.D, 1), np.tensordot(x[m:], self.G, 1)


@functools.cache
def _basis(blocks: tuple[Block, ...]) -> _Basis:
    """Return the basis of the scalings that commute with the blocks."""
    r = sum(block.size for block in blocks)
    D: list[np.ndarray] = []
    G: list[np.ndarray] = []
    first = 0
    for size, is_real in blocks:
        if not is_real:
            matrix = np.zeros((r, r), dtype=complex)
            matrix[range(first, first + size), range(first, first + size)] = 1.0
            D.append(matrix)
        for i in range(first, first + size) if is_real else ():
            for j in range(first, i + 1):
                for value in (1.0,) if i == j else (1.0, 1j):
                    matrix = np.zeros((r, r), dtype=complex)
                    matrix[i, j], matrix[j, i] = value, np.conj(value)
                    D.append(matrix)
                    G.append(matrix)
        first += size
    all_D, all_G = (np.array(each).reshape(-1, r, r) for each in (D, G))
    forms = np.zeros((len(D) + len(G), 2 * r, 2 * r), dtype=complex)
    forms[: len(D), :r, :r], forms[: len(D), r:, r:] = -all_D, all_D
    forms[len(D) :, :r, r:], forms[len(D) :, r:, :r] = 1j * all_G, -1j * all_G
    return _Basis(all_D, all_G, _Terms.of(all_D), _Terms.of(forms))


def _center(x: np.ndarray, M: np.ndarray, basis: _Basis, level: float) -> np.ndarray:
    """Return the analytic center of F > 0 and D > 0 with a given sum of the traces of D and F / level.

    F is the matrix of `_form`. With a given sum of the traces, G remains bounded even if F > 0 for every level.

    Args:
        x: (k,) coordinates of D and G with F > 0 and D > 0.
        M: (r, r) matrix.
        basis: basis of D and G.
        level: β², the weight of D in F.
    """
    m, k, r = len(basis.D), len(x), len(M)
    # F = Xᴴ [-D, jG / β; -jG / β, D] X with X = [M; β I]. The matrix in brackets is linear in the coordinates, and its
    # elements are those of `basis.form_terms`, so `derivatives` also returns the derivatives of log det F.
    X = np.vstack([M, math.sqrt(level) * np.eye(r)])
    weights = np.where(np.arange(k) < m, 1.0, 1.0 / math.sqrt(level))
    traces = weights * basis.form_terms.derivatives(X @ X.conj().T)[0] / level
    traces[:m] += basis.D_terms.derivatives(np.eye(r, dtype=complex))[0]
    x = x * (r / (traces @ x))

    def barrier(point: np.ndarray) -> float:
        D, G = basis.scalings(point)
        try:
            factors = [np.linalg.cholesky(_form(M, D, G, level)), np.linalg.cholesky(D)]
        except np.linalg.LinAlgError:
            return math.inf
        return -2.0 * float(sum(np.log(np.diag(factor).real).sum() for factor in factors))

    value = barrier(x)
    for _ in range(_MAX_NEWTON_STEPS):
        D, G = basis.scalings(x)
        Y = X @ np.linalg.solve(_form(M, D, G, level), X.conj().T)
        slopes, curvature = basis.form_terms.derivatives(Y)
        gradient, hessian = -weights * slopes, weights[:, np.newaxis] * curvature * weights
        slopes, curvature = basis.D_terms.derivatives(np.linalg.inv(D))
        gradient[:m] -= slopes
        hessian[:m, :m] += curvature
        # The equality constraint fixes the sum of the traces. A tiny regularisation makes the system regular even if
        # F and D do not depend on some combination of the coordinates.
        system = np.zeros((k + 1, k + 1))
        system[:k, :k] = hessian + 1e-12 * np.trace(hessian) / k * np.eye(k)
        system[k, :k] = system[:k, k] = traces
        step = np.linalg.solve(system, np.append(-gradient, 0.0))[:k]
        decrement = float(-gradient @ step)
        if not decrement > _CENTER_TOLERANCE:
            break
        length = 1.0 / (1.0 + math.sqrt(decrement)) if decrement > 0.25 else 1.0
        while (new := barrier(x + length * step)) > value and length > 1e-6:
            length *= 0.5
        if length <= 1e-6:
            break
        x, value = x + length * step, new
    return x


def _coordinates(matrix: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Return the coordinates (k,) of a matrix in an orthogonal basis (k, r, r)."""
    products = np.einsum("kij,ij->k", basis.conj(), matrix).real
    return products / np.einsum("kij,kij->k", basis.conj(), basis).real


class PeakBound(NamedTuple):
    """Upper bound of the structured singular value over all frequencies.

    Attributes:
        value: bound that holds at every frequency.
        frequency: frequency with the largest bound, rad per sample.
    """

    value: float
    frequency: float


def peak_mu_bound(
    A: np.ndarray,
    B: np.ndarray,
    C: np.ndarray,
    D: np.ndarray,
    blocks: Sequence[Block],
    *,
    tolerance: float = 0.01,
    stop: float = 0.0,
    limit: float = math.inf,
) -> PeakBound:
    """Return an upper bound of the structured singular value of C (zI - A)⁻¹ B + D on the whole unit circle.

    If the bound is β and A is stable, then the loop with Δ is stable for all blocks smaller than 1/β.

    Args:
        A: (n, n) stable system matrix.
        B: (n, r) input matrix.
        C: (r, n) output matrix.
        D: (r, r) feedthrough matrix.
        blocks: blocks of Δ, whose sizes sum to r.
        tolerance: relative accuracy.
        stop: the minimisation at a frequency ends as soon as the bound is at most this value.
        limit: largest bound of interest; if the bound is larger at any frequency, the result is infinite.

    Raises:
        ArithmeticError: if the bound cannot be proved between some frequencies, because a pole is on the unit circle.
    """
    if not len(D):
        return PeakBound(_MIN_BOUND, 0.0)
    slack = 1.0 + 0.5 * tolerance
    A, scales = scipy.linalg.matrix_balance(A, permute=False, separate=True)
    B, C = B / scales[0][:, np.newaxis], C * scales[0]
    # `level` is the bound to be proved. It increases until it holds at all frequencies. `gaps` are the intervals of
    # frequencies at which it is not proved yet.
    gaps = [(0.0, math.pi)]
    level, peak = max(stop, _MIN_BOUND), (0.0, 0.0)
    found: list[MuBound] = []

    def prove(omega: float) -> None:
        """Compute the bound at a frequency, and increase `level` if the bound is larger.

        Frequencies at which the new scalings prove `level` are removed from `gaps`.
        """
        nonlocal level, gaps, peak
        response = C @ np.linalg.solve(np.exp(1j * omega) * np.eye(len(A)) - A, B) + D
        bound = mu_bound(response, blocks, tolerance=0.25 * tolerance, stop=level / slack, starts=found)
        found.append(bound)
        level, peak = max(level, slack * bound.value), max(peak, (bound.value, omega))
        gaps = _without(gaps, _covered(A, B, C, D, bound, level))

    with single_threaded_blas():
        # The largest bounds occur near the poles. They are computed first, since the largest of them then holds at
        # most other frequencies.
        poles = np.linalg.eigvals(A)
        first = np.append(np.abs(np.angle(poles[np.abs(poles) > 0.2])), [0.0, math.pi])
        sizes = [np.linalg.norm(np.linalg.solve(np.exp(1j * w) * np.eye(len(A)) - A, B), 2) for w in first]
        for omega in first[np.argsort(sizes)[::-1]][:_NUM_FIRST_FREQUENCIES]:
            if level > limit:
                return PeakBound(math.inf, peak[1])
            if any(low - _MIN_GAP <= omega <= high + _MIN_GAP for low, high in gaps):
                prove(float(omega))
        for _ in range(_MAX_FREQUENCIES):
            if not gaps or level > limit:
                return PeakBound(level if level <= limit else math.inf, peak[1])
            before, (low, high) = gaps, max(gaps, key=lambda gap: gap[1] - gap[0])
            prove(0.5 * (low + high))
            if gaps == before:
                # With real blocks, the scalings at a frequency may prove `level` only in a very short interval around
                # this frequency. A larger level is proved in a longer interval.
                level *= 1.0 + 0.25 * tolerance
    raise ArithmeticError(f"no bound of the structured singular value was found at {gaps[0][0]:.4f} rad per sample")


def _covered(
    A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, bound: MuBound, level: float
) -> list[tuple[float, float]]:
    """Return the intervals of [0, π] in which the scalings of a bound prove that μ is below a level.

    M is the frequency response C (zI - A)⁻¹ B + D at z = exp(jω). At the end ω of an interval, the matrix
    Mᴴ S M + j (G M - Mᴴ G) - level² S is singular, where S and G are the scalings. Then z is a generalised eigenvalue
    of two matrices, which are formed from the equations of M and Mᴴ. Their unknowns are the state x of M, the state q
    of Mᴴ, and the input u.
    """
    n, r = B.shape
    # With the output y = C x + D u = M u, the quadratic form of the singular matrix is yᴴ v₁ + uᴴ v₂, where
    # v₁ = S y - j G u and v₂ = j G y - level² S u.
    S, jG = bound.D, 1j * bound.G
    v1 = np.hstack([S @ C, S @ D - jG])
    v2 = np.hstack([jG @ C, jG @ D - level**2 * S])
    left, right = np.zeros((2 * n + r, 2 * n + r), dtype=complex), np.zeros((2 * n + r, 2 * n + r), dtype=complex)
    x, q, u = slice(0, n), slice(n, 2 * n), slice(2 * n, 2 * n + r)
    xu = [*range(n), *range(2 * n, 2 * n + r)]
    left[x, x], left[x, u], right[x, x] = A, B, np.eye(n)
    left[q, q], right[q, q] = np.eye(n), A.T
    right[q, xu] = C.T @ v1
    left[u, q] = B.T
    left[u, xu] = D.T @ v1 + v2
    values = scipy.linalg.eig(left, right, right=False)
    values = values[np.isfinite(values)]
    on_circle = values[np.abs(np.abs(values) - 1.0) < _CIRCLE_TOLERANCE]
    angles = np.angle(on_circle)
    ends = np.unique(np.concatenate([[0.0, math.pi], angles[(angles > 0.0) & (angles < math.pi)]]))
    middles = 0.5 * (ends[:-1] + ends[1:])
    z = np.exp(1j * middles)[:, np.newaxis, np.newaxis]
    M = C @ np.linalg.solve(z * np.eye(n) - A, np.broadcast_to(B, (len(middles), n, r)).astype(complex)) + D
    MH = M.conj().transpose(0, 2, 1)
    forms = MH @ S @ M + jG @ M - MH @ jG - level**2 * S
    largest = np.linalg.eigvalsh(forms)[:, -1]
    return [(float(a), float(b)) for a, b, top in zip(ends[:-1], ends[1:], largest, strict=True) if top < 0.0]


def _without(gaps: list[tuple[float, float]], covered: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Return the parts of intervals that other intervals do not cover."""
    for low, high in covered:
        parts = [part for start, end in gaps for part in ((start, min(end, low)), (max(start, high), end))]
        gaps = [(start, end) for start, end in parts if end - start > _MIN_GAP]
    return gaps
