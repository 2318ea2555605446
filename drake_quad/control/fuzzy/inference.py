"""Interval type-2 fuzzy inference with elliptic membership functions, numbered as in the paper.

    (11), (12) μ(x) = (1 - |u|^a)^(1/a) with u = (x - c) / d where |u| < 1, else 0: the upper membership for an exponent
               a = a1 > 1, the lower one for a = a2 < 1
    (13)       a1 = a2 = 1 is the triangle of type 1
    (9)        IF x₁ is A_1i AND x₂ is A_2j AND ... THEN τ_f = f_ij...
    (10)       τ_f = q Σ w̲_ij f_ij / Σ w̲_ij + (1 - q) Σ w̄_ij f_ij / Σ w̄_ij, with w_ij = μ_1i μ_2j

The paper has two inputs, e and ė; here there may be more, each with a number of sets of its own, and a rule for every
choice of a set on each. A product of memberships is normalised input by input: Σ_ij w_ij = Σ_i μ_1i Σ_j μ_2j. So with
μ̃ = μ / Σ μ the firing strengths are W_ij = q μ̲̃_1i μ̲̃_2j + (1 - q) μ̄̃_1i μ̄̃_2j, their sum is one, τ_f = Fᵀ W, and the
cost of the memberships grows with the sum of the sets, not with their product.

Outside all sets (10) is 0 / 0: inputs are clamped to the universe, from the first centre to the last. An input that
goes around a circle has no ends, and x - c is taken the short way around it.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

from drake_quad.framework.elementary import exp, log, maximum, minimum, nearest, total, where
from drake_quad.signals import Number, Row

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
    centres: tuple[Number, ...] = (-1.0, 0.0, 1.0)
    widths: tuple[Number, ...] = (1.0, 1.0, 1.0)

    def distances(self, value: Row) -> list[Row]:
        """The distances u of an input from all sets, with x held within the universe."""
        first, *_, last = self.centres
        x = minimum(maximum(self.scale * value, first), last)
        return [(x - c) * (1.0 / d) for c, d in zip(self.centres, self.widths, strict=True)]

    @property
    def gaps(self) -> list[Row]:
        """From each centre to the next."""
        return [high - low for low, high in itertools.pairwise(self.centres)]


class CircularSets(NamedTuple):
    """The sets of an input that goes around a circle: its values 0 and 1 are one place.

    Attributes:
        scale: that the input is multiplied with, and so the circumference of the circle of sets.
        centres: c of each set, ascending, less than a turn apart.
        widths: d of each set.
    """

    scale: Row = 1.0
    centres: tuple[Number, ...] = (0.0, 1.0 / 3.0, 2.0 / 3.0)
    widths: tuple[Number, ...] = (1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0)

    def distances(self, value: Row) -> list[Row]:
        """The distances u of an input from all sets, the short way around the circle."""
        turns = [value - c * (1.0 / self.scale) for c in self.centres]
        return [(turn - nearest(turn)) * (self.scale * (1.0 / d)) for turn, d in zip(turns, self.widths, strict=True)]

    @property
    def gaps(self) -> list[Row]:
        """From each centre to the next, and from the last to the first."""
        first, *_ = self.centres
        return [high - low for low, high in itertools.pairwise((*self.centres, first + self.scale))]


Sets = FuzzySets | CircularSets


class Antecedents(NamedTuple):
    """All that the firing strengths depend on.

    Attributes:
        a1: exponent of the upper memberships.
        a2: exponent of the lower memberships.
        q: share of the lower memberships.
        inputs: sets of each input, in the order in which the rules take them.
    """

    a1: Number = 1.2
    a2: Number = 0.8
    q: Number = 0.5
    inputs: tuple[Sets, ...] = (FuzzySets(), FuzzySets())

    @property
    def num_rules(self) -> int:
        """R, the product of the numbers of sets."""
        return math.prod(len(sets.centres) for sets in self.inputs)


def elliptic_membership(u: Row, exponent: Row) -> Row:
    """(11), (12): the membership at a distance |u| from the centre, over the width.

    It has no derivative at the centre, where there is none, and none outside.
    """
    distance = abs(u)
    within = minimum(maximum(distance, _TINY), _BELOW_ONE)
    rest = maximum(1.0 - exp(exponent * log(within, normal=True)), _TINY)
    # A triangle has no rounded powers.
    arc = where(exponent == 1.0, 1.0 - within, exp((1.0 / exponent) * log(rest, normal=True)))
    return where(distance < 1.0, arc, 0.0 * distance)


def firing_strengths(values: Sequence[Row], antecedents: Antecedents) -> tuple[Row, ...]:
    """W: the R normalised firing strengths; the set of the last input changes first from rule to rule.

    Args:
        values: of the inputs, each in its unit.
        antecedents: of the rules.
    """
    a1, a2, q, inputs = antecedents
    upper = [shares(value, sets, a1) for value, sets in zip(values, inputs, strict=True)]
    lower = [shares(value, sets, a2) for value, sets in zip(values, inputs, strict=True)]
    rules = zip(itertools.product(*upper), itertools.product(*lower), strict=True)
    return tuple([math.prod(of_upper, start=1.0 - q) + math.prod(of_lower, start=q) for of_upper, of_lower in rules])


def shares(value: Row, sets: Sets, exponent: Row) -> list[Row]:
    """The membership μ̃ of an input in each of its sets, over their sum."""
    values = [elliptic_membership(u, exponent) for u in sets.distances(value)]
    factor = 1.0 / total(values)
    return [factor * value for value in values]
