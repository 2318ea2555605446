"""Interval type-2 fuzzy inference with elliptic membership functions.

Equation numbers refer to Kayacan and Maslim (2016), called "the paper" below:

    (11), (12) μ(x) = (1 - |u|^a)^(1/a) with u = (x - c) / d where |u| < 1, else 0: the upper membership for an exponent
               a = a1 > 1, the lower membership for a = a2 < 1
    (13)       a1 = a2 = 1 gives triangular sets of type 1
    (9)        IF x₁ is A_1i AND x₂ is A_2j AND ... THEN τ_f = f_ij...
    (10)       τ_f = q Σ w̲_ij f_ij / Σ w̲_ij + (1 - q) Σ w̄_ij f_ij / Σ w̄_ij, with w_ij = μ_1i μ_2j

The networks of the paper have two inputs, e and ė. This module supports any number of inputs, each with any number of
sets, and a rule for every combination of sets. The memberships are normalised for each input separately, which is
equivalent since Σ_ij w_ij = Σ_i μ_1i Σ_j μ_2j. With μ̃ = μ / Σ μ the firing strengths are
W_ij = q μ̲̃_1i μ̲̃_2j + (1 - q) μ̄̃_1i μ̄̃_2j, their sum is one, and τ_f = Fᵀ W. A membership is therefore computed once
for each set of each input, not once for each rule.

Outside all sets, (10) is 0 / 0. Inputs are therefore clamped to the universe, the range from the first centre to the
last. The universe of a circular input has no ends: x - c is then the shorter difference around the circle.
"""

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

from drake_quad.framework.elementary import exp, log, maximum, minimum, nearest, total, where
from drake_quad.signals import Number, Row

# Lower limit on the arguments of logarithms, which avoids an infinite logarithm of zero.
_MIN_LOG_ARGUMENT = 1e-250
# Largest double-precision number below 1.
_BELOW_ONE = 1.0 - 2.0**-53


class FuzzySets(NamedTuple):
    """Fuzzy sets of one input.

    Attributes:
        scale: factor by which the input is multiplied, in the inverse of the unit of the input.
        centres: centre c of each set, ascending.
        widths: width d of each set.
    """

    scale: Row = 1.0
    centres: tuple[Number, ...] = (-1.0, 0.0, 1.0)
    widths: tuple[Number, ...] = (1.0, 1.0, 1.0)

    def distances(self, value: Row) -> list[Row]:
        """Return the distance u of an input from the centre of each set, relative to the width of the set.

        The scaled input x is clamped to the range from the first centre to the last.
        """
        first, *_, last = self.centres
        x = minimum(maximum(self.scale * value, first), last)
        return [(x - c) * (1.0 / d) for c, d in zip(self.centres, self.widths, strict=True)]

    @property
    def gaps(self) -> list[Row]:
        """Distance from each centre to the next."""
        return [high - low for low, high in itertools.pairwise(self.centres)]


class CircularSets(NamedTuple):
    """Fuzzy sets of a circular input, whose values 0 and 1 are the same point.

    Attributes:
        scale: factor by which the input is multiplied. The input has the period 1, so the scaled input has the period
            `scale`, which is the circumference of the circle.
        centres: centre c of each set, ascending, all within one circumference.
        widths: width d of each set.
    """

    scale: Row = 1.0
    centres: tuple[Number, ...] = (0.0, 1.0 / 3.0, 2.0 / 3.0)
    widths: tuple[Number, ...] = (1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0)

    def distances(self, value: Row) -> list[Row]:
        """Return the distance u of an input from the centre of each set, relative to the width of the set.

        The distance is measured along the shorter arc of the circle.
        """
        differences = [value - c * (1.0 / self.scale) for c in self.centres]
        return [
            (difference - nearest(difference)) * (self.scale * (1.0 / d))
            for difference, d in zip(differences, self.widths, strict=True)
        ]

    @property
    def gaps(self) -> list[Row]:
        """Distance from each centre to the next, and from the last centre around the circle to the first."""
        first, *_ = self.centres
        return [high - low for low, high in itertools.pairwise((*self.centres, first + self.scale))]


Sets = FuzzySets | CircularSets


class Antecedents(NamedTuple):
    """All parameters that determine the firing strengths.

    Attributes:
        a1: exponent of the upper memberships.
        a2: exponent of the lower memberships.
        q: weight of the lower memberships.
        inputs: sets of each input, in the order of the rules.
    """

    a1: Number = 1.2
    a2: Number = 0.8
    q: Number = 0.5
    inputs: tuple[Sets, ...] = (FuzzySets(), FuzzySets())

    @property
    def num_rules(self) -> int:
        """Number of rules R, the product of the numbers of sets."""
        return math.prod(len(sets.centres) for sets in self.inputs)


def elliptic_membership(u: Row, exponent: Row) -> Row:
    """Return the membership (11), (12) at a distance |u| from the centre, relative to the width.

    The derivative is defined as zero at the centre, where the function is not differentiable, and outside the set.
    """
    distance = abs(u)
    limited = minimum(maximum(distance, _MIN_LOG_ARGUMENT), _BELOW_ONE)
    remainder = maximum(1.0 - exp(exponent * log(limited, normal=True)), _MIN_LOG_ARGUMENT)
    # The exact formula for a triangular set avoids the rounding errors of powers.
    arc = where(exponent == 1.0, 1.0 - limited, exp((1.0 / exponent) * log(remainder, normal=True)))
    return where(distance < 1.0, arc, 0.0 * distance)


def firing_strengths(values: Sequence[Row], antecedents: Antecedents) -> tuple[Row, ...]:
    """Return the normalised firing strengths W of the R rules.

    There is a rule for each combination of sets. In the order of the rules, the set of the last input varies fastest.

    Args:
        values: values of the inputs, each in its unit.
        antecedents: antecedents of the rules.
    """
    a1, a2, q, inputs = antecedents
    upper = [normalised_memberships(value, sets, a1) for value, sets in zip(values, inputs, strict=True)]
    lower = [normalised_memberships(value, sets, a2) for value, sets in zip(values, inputs, strict=True)]
    rules = zip(itertools.product(*upper), itertools.product(*lower), strict=True)
    return tuple([math.prod(of_upper, start=1.0 - q) + math.prod(of_lower, start=q) for of_upper, of_lower in rules])


def normalised_memberships(value: Row, sets: Sets, exponent: Row) -> list[Row]:
    """Return the normalised membership μ̃ of an input in each of its sets."""
    values = [elliptic_membership(u, exponent) for u in sets.distances(value)]
    factor = 1.0 / total(values)
    return [factor * value for value in values]
