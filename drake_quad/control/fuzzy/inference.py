"""Interval type-2 fuzzy inference with elliptic membership functions, numbered as in the paper.

    (11), (12) μ(x) = (1 - |u|^a)^(1/a) with u = (x - c) / d where |u| < 1, else 0: the upper membership for an exponent
               a = a1 > 1, the lower one for a = a2 < 1
    (13)       a1 = a2 = 1 is the triangle of type 1
    (9)        IF x₁ is A_1i AND x₂ is A_2j THEN τ_f = f_ij
    (10)       τ_f = q Σ w̲_ij f_ij / Σ w̲_ij + (1 - q) Σ w̄_ij f_ij / Σ w̄_ij, with w_ij = μ_1i μ_2j

A product of memberships is normalised input by input: Σ_ij w_ij = Σ_i μ_1i Σ_j μ_2j. So with μ̃ = μ / Σ μ the firing
strengths are W_ij = q μ̲̃_1i μ̲̃_2j + (1 - q) μ̄̃_1i μ̄̃_2j, their sum is one, and τ_f = Fᵀ W.

Outside all sets (10) is 0 / 0: inputs are clamped to the universe, from the first centre to the last.
"""

from typing import NamedTuple

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, exp, log, maximum, minimum, where

# Logarithms are of nothing smaller, and of nothing between this and one.
_TINY, _BELOW_ONE = 1e-250, 1.0 - 2.0**-53


class FuzzySets(NamedTuple):
    """The sets of one input.

    Attributes:
        scale: that the input is multiplied with, 1 over its unit.
        centres: c of each set, ascending.
        widths: d of each set.
    """

    scale: Row = 1.0
    centres: Rows = (-1.0, 0.0, 1.0)
    widths: Rows = (1.0, 1.0, 1.0)


class Antecedents(NamedTuple):
    """All that the firing strengths depend on.

    Attributes:
        a1: exponent of the upper memberships.
        a2: exponent of the lower memberships.
        q: share of the lower memberships.
        error: sets of e, I of them.
        rate: sets of ė, J of them.
    """

    a1: Row = 1.2
    a2: Row = 0.8
    q: Row = 0.5
    error: FuzzySets = FuzzySets()
    rate: FuzzySets = FuzzySets()

    @property
    def num_rules(self) -> int:
        """R = I J."""
        return len(self.error.centres) * len(self.rate.centres)

    def to_rows(self) -> tuple[tuple[Row, ...], tuple[Row, ...], tuple[Row, ...]]:
        """A1, a2, q and the scales of error and rate; centre and width of each set of the error; and of the rate."""
        pairs = [
            tuple(row for pair in zip(sets.centres, sets.widths, strict=True) for row in pair)
            for sets in (self.error, self.rate)
        ]
        return (self.a1, self.a2, self.q, self.error.scale, self.rate.scale), pairs[0], pairs[1]


@formula
def elliptic_membership(u: Row, exponent: Row) -> Row:
    """(11), (12): the membership at a distance |u| from the centre, over the width.

    It has no derivative at the centre, where there is none, and none outside.
    """
    distance = abs(u)
    within = minimum(maximum(distance, _TINY), _BELOW_ONE)
    rest = maximum(1.0 - exp(exponent * log(within)), _TINY)
    # A triangle has no rounded powers.
    arc = where(exponent == 1.0, 1.0 - within, exp((1.0 / exponent) * log(rest)))
    return where(distance < 1.0, arc, 0.0 * distance)


def firing_strengths(error: Row, rate: Row, antecedents: Antecedents) -> tuple[Row, ...]:
    """W: the R normalised firing strengths, rule ij in place i J + j.

    Args:
        error: e, m.
        rate: ė, m/s.
        antecedents: of the rules.
    """
    numbers, error_sets, rate_sets = antecedents.to_rows()
    (firing,) = firing_on_axes((error,), (rate,), numbers, error_sets, rate_sets)
    return firing


@formula
def firing_on_axes(error: Rows, rate: Rows, numbers: Rows, error_sets: Rows, rate_sets: Rows) -> tuple[Rows, ...]:
    """The firing strengths on each axis of a network, R rows each.

    Args:
        error: e on each axis, m.
        rate: ė on each axis, m/s.
        numbers: of `Antecedents.to_rows`.
        error_sets: likewise.
        rate_sets: likewise.
    """
    if len(error) == 0:
        return ()
    a1, a2, q, error_scale, rate_scale = numbers
    x_1, x_2 = _clamped(error_scale * error[0], error_sets), _clamped(rate_scale * rate[0], rate_sets)
    upper_1, upper_2 = shares(memberships(x_1, error_sets, a1)), shares(memberships(x_2, rate_sets, a1))
    lower_1, lower_2 = shares(memberships(x_1, error_sets, a2)), shares(memberships(x_2, rate_sets, a2))
    firing = summed(products(scaled(1.0 - q, upper_1), upper_2), products(scaled(q, lower_1), lower_2))
    return (firing, *firing_on_axes(error[1:], rate[1:], numbers, error_sets, rate_sets))


@formula
def _clamped(x: Row, sets: Rows) -> Row:
    """An input within the universe: from the first centre to the last."""
    return minimum(maximum(x, sets[0]), sets[-2])


@formula
def memberships(x: Row, sets: Rows, exponent: Row) -> tuple[Row, ...]:
    """The membership of an input in each set, given by centre and width, one set after another."""
    if len(sets) == 0:
        return ()
    return (elliptic_membership((x - sets[0]) / sets[1], exponent), *memberships(x, sets[2:], exponent))


@formula
def shares(values: Rows) -> tuple[Row, ...]:
    """Values over their sum."""
    return scaled(1.0 / total(values), values)


@formula
def total(values: Rows) -> Row:
    """The sum of at least one value."""
    return values[0] if len(values) == 1 else values[0] + total(values[1:])


@formula
def scaled(factor: Row, values: Rows) -> tuple[Row, ...]:
    """Each value times a factor."""
    return () if len(values) == 0 else (factor * values[0], *scaled(factor, values[1:]))


@formula
def summed(first: Rows, second: Rows) -> tuple[Row, ...]:
    """The sums of values in the same places."""
    return () if len(first) == 0 else (first[0] + second[0], *summed(first[1:], second[1:]))


@formula
def products(first: Rows, second: Rows) -> tuple[Row, ...]:
    """Each value of the first times each of the second, the second running faster."""
    return () if len(first) == 0 else (*scaled(first[0], second), *products(first[1:], second))
