"""Learning laws for the weights of a network, all with the same interface.

Equation numbers refer to Kayacan and Maslim (2016), called "the paper" below:

    (14) τ = τ_c - τ_f, with the PD command τ_c           (15) s_p = ė + λ e
    (16) Ḟ = -K_D P W s_p                                 (17) Ṗ = -P W Wᵀ P

W and s_p are sampled at each tick and held for the period h. Then (17) and (16) have an exact solution: with g = P W
and c = Wᵀ P W

    P⁺ = P - h g gᵀ / (1 + h c)        F⁺ = F - K_D s_p g ln(1 + h c) / c

P⁻¹ increases by h W Wᵀ, so that P remains positive definite for any P and h. Euler's method fails if h c exceeds 1. The
law is least squares without forgetting: the covariance only decreases, and learning becomes slower and slower. With a
forgetting factor, the covariance of a `CovarianceLaw` can increase again.

A law applies to one axis. Its memory is a tuple of rows.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple, Protocol

from drake_quad.framework.elementary import dot, log1p, maximum, total, where
from drake_quad.signals import Number, Row

Rows = tuple[Row, ...]


class LearningLaw(Protocol):
    """Interface of all learning laws. A law is a named tuple of its parameters.

    A law learns from one of two signals: s_p of eq (15) in m/s, or the feedback in m/s² (τ_c minus the estimated
    disturbance). The units of gains are documented for s_p, except in `SignLaw`, which learns from the feedback.
    """

    @property
    def memory_name(self) -> str:
        """Name of the state of `WeightLearning` that holds the memory of the law."""

    def memory(self, num_rules: int) -> Rows:
        """Return the initial memory of the law, for a number of rules."""

    def step(self, weights: Rows, memory: Rows, firing: Rows, signal: Row, period: float) -> tuple[Rows, Rows]:
        """Return weights and memory at the next tick.

        Args:
            weights: weights F of the R rules, m/s².
            memory: memory of the law.
            firing: firing strengths W of the R rules.
            signal: learning signal.
            period: tick period h, s.
        """


class CovarianceLaw(NamedTuple):
    """The paper's law, (16) and (17), as least squares.

    With a forgetting factor μ < 1, P⁺ is divided at each tick by μ' = 1 - (1 - μ) max(0, 1 - tr P / (R p₀)). While P is
    small, μ' is close to μ. The trace cannot exceed its initial value. This is bounded-gain forgetting (J.-J. E.
    Slotine and W. Li, "Applied Nonlinear Control", 1991, section 8.7), with the trace as the norm.

    The memory is the upper triangle of the symmetric P, row by row.

    Attributes:
        gain: gain K_D, 1/s.
        initial_covariance: p₀ of P₀ = p₀ I, 1/s.
        forgetting: forgetting factor μ per tick, in (0, 1]; 1 for the paper's law.
    """

    gain: Row = 1.0
    initial_covariance: Row = 1.0
    forgetting: Number = 1.0

    @property
    def memory_name(self) -> str:
        """Name of the state that holds the covariance P."""
        return "covariance"

    def memory(self, num_rules: int) -> Rows:
        """Return the initial memory: the upper triangle of the initial covariance P₀, row by row."""
        return tuple([self.initial_covariance if i == j else 0.0 for i, j in _upper_triangle(num_rules)])

    def step(self, weights: Rows, memory: Rows, firing: Rows, signal: Row, period: float) -> tuple[Rows, Rows]:
        """Return weights and covariance after eqs (16) and (17) of the paper; see `LearningLaw`."""
        size = len(weights)
        covariance = dict(zip(_upper_triangle(size), memory, strict=True))
        information = [
            dot([covariance[min(i, j), max(i, j)] for j in range(size)], firing) for i in range(size)
        ]  # g = P W
        variance = dot(firing, information)  # Wᵀ P W
        factor = period / (1.0 + period * variance)
        reduced = tuple(
            [memory_ij - factor * information[i] * information[j] for (i, j), memory_ij in covariance.items()]
        )
        step = self.gain * signal * log1p(period * variance) / variance
        after = tuple([f - step * g for f, g in zip(weights, information, strict=True)])
        relative_decrease = maximum(1.0 - trace(reduced) / (size * self.initial_covariance), 0.0)
        growth = 1.0 / (1.0 - (1.0 - self.forgetting) * relative_decrease)
        return after, tuple([growth * row for row in reduced])


class GradientLaw(NamedTuple):
    """Eq (16) with a constant covariance: Ḟ = -γ W s_p.

    Attributes:
        rate: learning rate γ, 1/s².
    """

    rate: Row = 1.0

    @property
    def memory_name(self) -> str:
        """Unused name, since the law has no memory."""
        return "nothing"

    def memory(self, num_rules: int) -> Rows:
        """Return an empty tuple, since the law has no memory."""
        return ()

    def step(self, weights: Rows, memory: Rows, firing: Rows, signal: Row, period: float) -> tuple[Rows, Rows]:
        """Return the weights after a gradient step; see `LearningLaw`."""
        step = period * self.rate * signal
        return tuple([f - step * w for f, w in zip(weights, firing, strict=True)]), memory


class SignLaw(NamedTuple):
    """Sliding-mode law from other papers by Kayacan's group: Ḟ = -W / (WᵀW) α sign(τ_c), α̇ = 2 γ |τ_c|.

    The memory is α, m/s³.

    Attributes:
        rate: learning rate γ, 1/s².
        initial_slope: initial value α₀ of the adaptive gain α, m/s³.
    """

    rate: Row = 1.0
    initial_slope: Row = 0.0

    @property
    def memory_name(self) -> str:
        """Name of the state that holds α."""
        return "slope"

    def memory(self, num_rules: int) -> Rows:
        """Return the initial memory, which is the initial value α₀ of the adaptive gain."""
        return (self.initial_slope,)

    def step(self, weights: Rows, memory: Rows, firing: Rows, signal: Row, period: float) -> tuple[Rows, Rows]:
        """Return weights and α at the next tick; see `LearningLaw`."""
        (slope,) = memory
        sign = where(signal > 0.0, 1.0, where(signal < 0.0, -1.0, 0.0))
        step = period * slope * sign / dot(firing, firing)
        after = tuple([f - w * step for f, w in zip(weights, firing, strict=True)])
        return after, (slope + 2.0 * period * self.rate * abs(signal),)


class LearningLimits(NamedTuple):
    """Limits of learning, all switched off by default.

    Attributes:
        weight: largest |F|, m/s².
        deadzone: smallest absolute value of the learning signal that has an effect, in the unit of the signal.
        leakage: rate at which F decays, 1/s.
    """

    weight: Row = math.inf
    deadzone: Row = 0.0
    leakage: Row = 0.0


def trace(triangle: Rows) -> Row:
    """Return the trace of a symmetric matrix, given its upper triangle row by row."""
    size = math.isqrt(2 * len(triangle))
    return total([row for (i, j), row in zip(_upper_triangle(size), triangle, strict=True) if i == j])


def _upper_triangle(size: int) -> Iterator[tuple[int, int]]:
    """Return the indices of the upper triangle of a matrix, row by row."""
    return ((i, j) for i in range(size) for j in range(i, size))
