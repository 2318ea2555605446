"""How the network learns: laws with one signature, numbered as in the paper.

    (14) τ = τ_c - τ_f, with τ_c the PD's command        (15) s_p = ė + λ e
    (16) Ḟ = -K_D P W s_p                                 (17) Ṗ = -P W Wᵀ P

At a tick W and s_p are sampled and held for the period h. Then (17) and (16) have an exact solution: with g = P W and
c = Wᵀ P W

    P⁺ = P - h g gᵀ / (1 + h c)        F⁺ = F - K_D s_p g ln(1 + h c) / c

so that P⁻¹ grows by h W Wᵀ and stays positive definite however large it was, where Euler's method fails as soon as h c
exceeds 1. It is least squares without forgetting: the covariance only shrinks and learning slows down for ever. The
variants in `CovarianceLaw` let it grow again.

A law is made of rows (numbers for all channels, or (n,) arrays), so that they can stand in a context. What it
remembers, its memory, is an (m, n) array. Arrays are changed in place.
"""

import functools
import math
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from drake_quad.elementary import Row

# Below so many channels NumPy's overhead counts, above the memory that is touched.
_FEW_CHANNELS = 48


class Law(Protocol):
    """What all laws have in common; they are NamedTuples of rows."""

    @property
    def memory_name(self) -> str:
        """Of the state group that holds the memory."""

    @property
    def learns_from(self) -> Literal["surface", "command"]:
        """What the signal is: s_p of eq (15), m/s, or the PD's command τ_c, m/s²."""

    def memory(self, num_rules: int) -> list[Row]:
        """The rows of the memory at the beginning."""

    def learn(self, weights: np.ndarray, memory: np.ndarray, firing: np.ndarray, signal: Row, period: float) -> None:
        """Learns for a period.

        Args:
            weights: F, (R, n), m/s².
            memory: (m, n).
            firing: W, (R, n).
            signal: that is learned from, (n,).
            period: h, s.
        """


class CovarianceLaw(NamedTuple):
    """The paper's law, (16) and (17), as least squares.

    With a forgetting factor μ < 1 a tick ends with P⁺ / μ', where μ' = 1 - (1 - μ) max(0, 1 - tr P / (R p₀)): as μ
    says while P is small, and no further than to the trace that it began with. This is bounded-gain forgetting (J.-J.
    E. Slotine and W. Li, "Applied Nonlinear Control", 1991, section 8.7), with the trace for the norm.

    The memory is P, symmetric, its upper triangle row by row.

    Attributes:
        gain: K_D, 1/s.
        initial_covariance: p₀ of P₀ = p₀ I, 1/s.
        forgetting: μ for a tick, in (0, 1]; 1 for the paper's.
    """

    gain: Row = 1.0
    initial_covariance: Row = 1.0
    forgetting: Row = 1.0

    @property
    def memory_name(self) -> str:
        """See `Law`."""
        return "covariance"

    @property
    def learns_from(self) -> Literal["surface", "command"]:
        """See `Law`."""
        return "surface"

    def memory(self, num_rules: int) -> list[Row]:
        """See `Law`."""
        on_diagonal = np.equal(*np.triu_indices(num_rules))
        return [self.initial_covariance if on else 0.0 for on in on_diagonal]

    def learn(self, weights: np.ndarray, memory: np.ndarray, firing: np.ndarray, signal: Row, period: float) -> None:
        """See `Law`."""
        information = covariance_times(memory, firing)
        variance = np.einsum("in,in->n", firing, information)
        growth = period * variance
        subtract_square(memory, information, period / (1.0 + growth))
        information *= self.gain * signal * _log_of_1_plus(growth) / variance
        weights -= information
        if not _is(self.forgetting, 1.0):
            share = trace(memory, len(weights)) / (len(weights) * self.initial_covariance)
            memory /= 1.0 - (1.0 - self.forgetting) * np.maximum(1.0 - share, 0.0)


class GradientLaw(NamedTuple):
    """(16) with a constant covariance: Ḟ = -γ W s_p.

    Attributes:
        rate: γ, 1/s².
    """

    rate: Row = 1.0

    @property
    def memory_name(self) -> str:
        """See `Law`."""
        return "nothing"

    @property
    def learns_from(self) -> Literal["surface", "command"]:
        """See `Law`."""
        return "surface"

    def memory(self, num_rules: int) -> list[Row]:
        """See `Law`: none."""
        return []

    def learn(self, weights: np.ndarray, memory: np.ndarray, firing: np.ndarray, signal: Row, period: float) -> None:
        """See `Law`."""
        weights -= firing * (period * self.rate * signal)


class SignLaw(NamedTuple):
    """The law of other works of the same group: Ḟ = -W / (WᵀW) α sign(τ_c), α̇ = 2 γ |τ_c|.

    The memory is α, m/s³.

    Attributes:
        rate: γ, 1/s².
        initial_slope: α₀, m/s³.
    """

    rate: Row = 1.0
    initial_slope: Row = 0.0

    @property
    def memory_name(self) -> str:
        """See `Law`."""
        return "slope"

    @property
    def learns_from(self) -> Literal["surface", "command"]:
        """See `Law`."""
        return "command"

    def memory(self, num_rules: int) -> list[Row]:
        """See `Law`."""
        return [self.initial_slope]

    def learn(self, weights: np.ndarray, memory: np.ndarray, firing: np.ndarray, signal: Row, period: float) -> None:
        """See `Law`."""
        size = np.add.reduce(firing * firing)
        weights -= firing * (period * memory[0] * np.sign(signal) / size)
        memory[0] += 2.0 * period * self.rate * np.abs(signal)


def _log_of_1_plus(x: np.ndarray) -> np.ndarray:
    return np.log1p(x) if x.dtype == float else np.log(1.0 + x)


def trace(memory: np.ndarray, size: int) -> np.ndarray:
    """Tr P, (n,).

    Args:
        memory: the upper triangles of P, row by row, (R (R + 1) / 2, n).
        size: R.
    """
    return np.add.reduce(memory[[row.start for row in _triangle(size).rows]])


def covariance_times(memory: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """P W, (R, n).

    Args:
        memory: the upper triangles of P, row by row, (R (R + 1) / 2, n).
        vector: W, (R, n).
    """
    size, n = vector.shape
    if n < _FEW_CHANNELS:
        square = memory.take(_triangle(size).square, axis=0).reshape(size, size, n)
        return np.einsum("ijn,jn->in", square, vector)
    product, room = np.zeros_like(vector), np.empty_like(vector)
    for i, row in enumerate(_triangle(size).rows):
        part = memory[row]
        product[i] += np.einsum("jn,jn->n", part, vector[i:])
        product[i + 1 :] += np.multiply(part[1:], vector[i], out=room[i + 1 :])
    return product


def subtract_square(memory: np.ndarray, vector: np.ndarray, factor: Row) -> None:
    """P - factor g gᵀ, in place.

    Args:
        memory: the upper triangles of P, row by row, (R (R + 1) / 2, n).
        vector: g, (R, n).
        factor: a number or (n,).
    """
    size, n = vector.shape
    scaled = factor * vector
    if n < _FEW_CHANNELS:
        memory -= vector.take(_triangle(size).first, axis=0) * scaled.take(_triangle(size).second, axis=0)
        return
    room = np.empty_like(vector)
    for i, row in enumerate(_triangle(size).rows):
        memory[row] -= np.multiply(vector[i:], scaled[i], out=room[i:])


class _Triangle(NamedTuple):
    """Where the upper triangle of a symmetric matrix is, row by row.

    Attributes:
        first: row of each element.
        second: column of each element.
        square: where each element of the whole matrix is.
        rows: where each row is, from its diagonal on.
    """

    first: np.ndarray
    second: np.ndarray
    square: np.ndarray
    rows: tuple[slice, ...]


@functools.lru_cache(maxsize=8)
def _triangle(size: int) -> _Triangle:
    first, second = np.triu_indices(size)
    square = np.empty((size, size), int)
    square[first, second] = square[second, first] = np.arange(len(first))
    ends = np.cumsum(np.arange(size, 0, -1)).tolist()
    rows = tuple(slice(end - length, end) for end, length in zip(ends, range(size, 0, -1), strict=True))
    return _Triangle(first, second, square.ravel(), rows)


class Limits(NamedTuple):
    """What keeps learning within bounds; each entry is a number or an (n,) array, and changes nothing by default.

    Attributes:
        weight: largest |F|, m/s².
        deadzone: below which the signal that is learned from counts as zero, in its units.
        leakage: rate at which F decays by itself, 1/s.
    """

    weight: Row = math.inf
    deadzone: Row = 0.0
    leakage: Row = 0.0


def learn(
    law: Law,
    limits: Limits,
    weights: np.ndarray,
    memory: np.ndarray,
    firing: np.ndarray,
    signal: Row,
    period: float,
) -> None:
    """Learns for a period within limits; arguments as for `Law.learn`."""
    if not _is(limits.deadzone, 0.0):
        signal = np.where(np.abs(signal) < limits.deadzone, 0.0, signal)
    if not _is(limits.leakage, 0.0):
        weights *= np.exp(-limits.leakage * period)
    law.learn(weights, memory, firing, signal, period)
    if not _is(limits.weight, math.inf):
        np.minimum(np.maximum(weights, -limits.weight), limits.weight, out=weights)


def _is(x: Any, value: float) -> bool:
    return x.__class__ is float and x == value
