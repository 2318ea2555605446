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

import functools
from typing import NamedTuple

import numpy as np

from drake_quad.elementary import Row, Rows, every, exp, log, maximum, minimum

# Powers of 0 and 1 take long in arrays: what is this small is none, and the largest float below one is one.
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


def elliptic_membership(u: Row, exponent: Row) -> Row:
    """(11), (12): the membership at a distance |u| from the centre, over the width.

    Scalars with derivatives have none at the centre, where there is none, and none at the edge.
    """
    if u.__class__ is float:
        return _arc(abs(u), exponent) if -1.0 < u < 1.0 else 0.0
    if not isinstance(u, np.ndarray):
        if not 0.0 < abs(u) < 1.0:
            return 0.0 * u + float(not abs(u) >= 1.0)
        return exp(log(1.0 - exp(exponent * log(abs(u)))) / exponent)
    if u.dtype != float:
        return np.array([elliptic_membership(*pair) for pair in np.broadcast(u, exponent)])
    distance = np.abs(u)
    return _arc(_within(distance), exponent) * (distance < 1.0)


def _within(distance: np.ndarray) -> np.ndarray:
    return np.minimum(np.maximum(distance, _TINY), _BELOW_ONE)


def _arc(distance: Row, exponent: Row) -> Row:
    if exponent.__class__ is float and exponent == 1.0:
        return 1.0 - distance
    return (1.0 - distance**exponent) ** (1.0 / exponent)


def firing_strengths(error: Row, rate: Row, antecedents: Antecedents) -> list[Row]:
    """W: the R normalised firing strengths, rule ij in place i J + j.

    Args:
        error: e, m.
        rate: ė, m/s.
        antecedents: of the rules.
    """
    a1, a2, q, error_sets, rate_sets = antecedents
    if a1.__class__ is float and a1 == 1.0 and a2.__class__ is float and a2 == 1.0:
        ((first,), (second,)) = _memberships(error, error_sets, [a1]), _memberships(rate, rate_sets, [a1])
        share = 1.0 / (sum(first) * sum(second))
        first = [share * a for a in first]
        return [a * b for a in first for b in second]
    upper_1, lower_1 = _memberships(error, error_sets, [a1, a2])
    upper_2, lower_2 = _memberships(rate, rate_sets, [a1, a2])
    upper, lower = (1.0 - q) / (sum(upper_1) * sum(upper_2)), q / (sum(lower_1) * sum(lower_2))
    upper_1, lower_1 = [upper * a for a in upper_1], [lower * a for a in lower_1]
    return [a * b + c * d for a, c in zip(upper_1, lower_1) for b, d in zip(upper_2, lower_2)]


def _memberships(x: Row, sets: FuzzySets, exponents: list[Row]) -> list[list[Row]]:
    """For each exponent the memberships of an input in all sets."""
    scale, centres, widths = sets
    clamped = minimum(maximum(scale * x, centres[0]), centres[-1])
    distances = [abs(clamped - c) / d for c, d in zip(centres, widths)]
    if clamped.__class__ is float:
        return [[_arc(u, exponent) if u < 1.0 else 0.0 for u in distances] for exponent in exponents]
    if not (_is_fast(clamped) and _alternate_sets_are_apart(sets)):
        return [[elliptic_membership(u, exponent) for u in distances] for exponent in exponents]
    # Of every second set an input is in one at most, whose membership stands for all of them: powers take long.
    nearest = [_within(functools.reduce(np.minimum, distances[first::2])) for first in (0, 1)]
    inside = [u < 1.0 for u in distances]
    result = []
    for exponent in exponents:
        alternate = [_arc(u, exponent) for u in nearest]
        result.append([alternate[i % 2] * within for i, within in enumerate(inside)])
    return result


def _is_fast(row: Row) -> bool:
    return isinstance(row, np.ndarray) and row.dtype == float


def _alternate_sets_are_apart(sets: FuzzySets) -> bool:
    """Whether no set reaches into the next but one."""
    ends = [(c - d, c + d) for c, d in zip(sets.centres, sets.widths)]
    return all(every(high <= low) for (_, high), (low, _) in zip(ends, ends[2:]))
