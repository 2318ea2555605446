"""How the network learns: laws with one signature, numbered as in the paper.

    (14) τ = τ_c - τ_f, with τ_c the PD's command        (15) s_p = ė + λ e
    (16) Ḟ = -K_D P W s_p                                 (17) Ṗ = -P W Wᵀ P

At a tick W and s_p are sampled and held for the period h. Then (17) and (16) have an exact solution: with g = P W and
c = Wᵀ P W

    P⁺ = P - h g gᵀ / (1 + h c)        F⁺ = F - K_D s_p g ln(1 + h c) / c

so that P⁻¹ grows by h W Wᵀ and stays positive definite however large it was, where Euler's method fails as soon as h c
exceeds 1. It is least squares without forgetting: the covariance only shrinks and learning slows down for ever. The
variants in `CovarianceLaw` let it grow again.

A law is made of rows (numbers for all vehicles, or (N,) arrays), so that they can stand in a context. What it
remembers, its memory, has m rows for each axis of each vehicle. `drake_quad.control.fuzzy.learning` learns by it.
"""

import math
from typing import Literal, NamedTuple, Protocol

import numpy as np

from drake_quad.elementary import Row


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
