"""How the network learns: laws with one signature, numbered as in the paper.

    (14) τ = τ_c - τ_f, with τ_c the PD's command        (15) s_p = ė + λ e
    (16) Ḟ = -K_D P W s_p                                 (17) Ṗ = -P W Wᵀ P

At a tick W and s_p are sampled and held for the period h. Then (17) and (16) have an exact solution: with g = P W and
c = Wᵀ P W

    P⁺ = P - h g gᵀ / (1 + h c)        F⁺ = F - K_D s_p g ln(1 + h c) / c

so that P⁻¹ grows by h W Wᵀ and stays positive definite however large it was, where Euler's method fails as soon as h c
exceeds 1. It is least squares without forgetting: the covariance only shrinks and learning slows down for ever. The
variants in `CovarianceLaw` let it grow again.

A law learns on one axis. What it remembers is its memory, a tuple of rows.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple, Protocol

from drake_quad.framework.elementary import dot, log1p, maximum, total, where
from drake_quad.signals import Number, Row

Rows = tuple[Row, ...]


class LearningLaw(Protocol):
    """What all laws have in common; they are records of rows.

    The signal that a law learns from is s_p of eq (15), m/s, or the feedback τ_c, m/s²; units of gains are those for
    the former, but for the sign law, whose are for the latter.
    """

    @property
    def memory_name(self) -> str:
        """Of the state group that holds the memory."""

    def memory(self, num_rules: int) -> Rows:
        """The memory at the beginning."""

    def learned(self, weights: Rows, memory: Rows, firing: Rows, signal: Row, period: float) -> tuple[Rows, Rows]:
        """Weights and memory a period later.

        Args:
            weights: F of the R rules, m/s².
            memory: of the law.
            firing: W of the R rules.
            signal: that is learned from.
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
    forgetting: Number = 1.0

    @property
    def memory_name(self) -> str:
        """See `LearningLaw`."""
        return "covariance"

    def memory(self, num_rules: int) -> Rows:
        """See `LearningLaw`."""
        return tuple([self.initial_covariance if i == j else 0.0 for i, j in _upper_triangle(num_rules)])

    def learned(self, weights: Rows, memory: Rows, firing: Rows, signal: Row, period: float) -> tuple[Rows, Rows]:
        """Eqs (16) and (17); see `LearningLaw`."""
        size = len(weights)
        covariance = dict(zip(_upper_triangle(size), memory, strict=True))
        information = [
            dot([covariance[min(i, j), max(i, j)] for j in range(size)], firing) for i in range(size)
        ]  # g = P W
        variance = dot(firing, information)  # c
        factor = period / (1.0 + period * variance)
        left = tuple([memory_ij - factor * information[i] * information[j] for (i, j), memory_ij in covariance.items()])
        step = self.gain * signal * log1p(period * variance) / variance
        after = tuple([f - step * g for f, g in zip(weights, information, strict=True)])
        filled = maximum(1.0 - trace(left) / (size * self.initial_covariance), 0.0)
        growth = 1.0 / (1.0 - (1.0 - self.forgetting) * filled)
        return after, tuple([growth * row for row in left])


class GradientLaw(NamedTuple):
    """(16) with a constant covariance: Ḟ = -γ W s_p.

    Attributes:
        rate: γ, 1/s².
    """

    rate: Row = 1.0

    @property
    def memory_name(self) -> str:
        """See `LearningLaw`."""
        return "nothing"

    def memory(self, num_rules: int) -> Rows:
        """See `LearningLaw`: none."""
        return ()

    def learned(self, weights: Rows, memory: Rows, firing: Rows, signal: Row, period: float) -> tuple[Rows, Rows]:
        """See `LearningLaw`."""
        step = period * self.rate * signal
        return tuple([f - step * w for f, w in zip(weights, firing, strict=True)]), memory


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
        """See `LearningLaw`."""
        return "slope"

    def memory(self, num_rules: int) -> Rows:
        """See `LearningLaw`."""
        return (self.initial_slope,)

    def learned(self, weights: Rows, memory: Rows, firing: Rows, signal: Row, period: float) -> tuple[Rows, Rows]:
        """See `LearningLaw`."""
        (slope,) = memory
        sign = where(signal > 0.0, 1.0, where(signal < 0.0, -1.0, 0.0))
        step = period * slope * sign / dot(firing, firing)
        after = tuple([f - w * step for f, w in zip(weights, firing, strict=True)])
        return after, (slope + 2.0 * period * self.rate * abs(signal),)


class LearningLimits(NamedTuple):
    """What keeps learning within bounds; nothing does by default.

    Attributes:
        weight: largest |F|, m/s².
        deadzone: below which the signal that is learned from counts as zero, in its units.
        leakage: rate at which F decays by itself, 1/s.
    """

    weight: Row = math.inf
    deadzone: Row = 0.0
    leakage: Row = 0.0


def trace(triangle: Rows) -> Row:
    """The trace of a symmetric matrix, given its upper triangle, row by row."""
    size = math.isqrt(2 * len(triangle))
    return total([row for (i, j), row in zip(_upper_triangle(size), triangle, strict=True) if i == j])


def _upper_triangle(size: int) -> Iterator[tuple[int, int]]:
    """The places in the upper triangle of a matrix, row by row."""
    return ((i, j) for i in range(size) for j in range(i, size))
