"""How the membership functions learn, which the paper names as future work.

The weights F follow the gradient of the cost s² / 2 of the signal s that is learned from, with W = ∂τ_f/∂F: a
correction that takes away more makes s larger, by a gain that is positive and that the rate stands for. Any other
number θ of the network follows the same gradient,

    θ̇ = -γ s ∂τ_f/∂θ

For a family of sets, upper or lower, with grades μ_ki of input k in its set i, shares μ̃_ki = μ_ki / Σ_i μ_ki and
τ = Σ F Π_k μ̃_k, the output is linear in the shares of each input: τ = Σ_i μ̃_ki M_ki, where M_ki is the output of the
rules of set i by themselves. So ∂τ/∂μ_ki = (M_ki - τ) / Σ_i μ_ki, and with v = |x - c| / d, by (11) and (12),

    ∂μ/∂v = -v^(a-1) (1 - v^a)^(1/a-1)                ∂v/∂c = -sign(x - c) / d,  ∂v/∂d = -v / d
    ∂μ/∂a = μ (-ln(1 - v^a) / a² - v^a ln v / (a (1 - v^a)))

(10) adds q times the lower to 1 - q times the upper, and ∂τ_f/∂q is their difference. ∂μ/∂v is infinite at the edge of
an upper set and at the centre of a lower one; it counts as -10 at most, ten times that of a triangle.

After every tick what has been learned is brought back to where the sets are valid. The outermost centres stay, since
they are the universe, or keep a circle in place; the others keep within a quarter of the gap to either neighbour that
there was at first, so that they stay in order. Widths are such that neighbours overlap by 2 % of their gap at least,
shared out as at first, and no larger than the universe, or than they were; 1.001 <= a₁ <= 10, 0.1 <= a₂ <= 0.999 and
0 <= q <= 1.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

from drake_quad.control.fuzzy.inference import Antecedents, Sets, elliptic_membership
from drake_quad.framework.elementary import exp, log, maximum, minimum, total, where
from drake_quad.signals import Row

Part = Literal["centres", "widths", "exponents"]

# The steepest slope that counts, and a distance from centre and edge, over the width, that keeps all powers finite.
_STEEPEST, _NEAR = -10.0, 1e-9
# Of a gap to the neighbour: how far a centre may go, and by how much sets overlap.
_REACH, _OVERLAP = 0.25, 1.02
_UPPER, _LOWER = (1.001, 10.0), (0.1, 0.999)


class AdaptationRates(NamedTuple):
    """Rates γ, s²/m² for the surface and s³/m² for the feedback.

    Attributes:
        centres: of the centres.
        widths: of the widths.
        exponents: of a₁, a₂ and q.
    """

    centres: Row = 0.0
    widths: Row = 0.0
    exponents: Row = 0.0


def membership_slopes(u: Row, exponent: Row) -> tuple[Row, Row]:
    """∂μ/∂v and ∂μ/∂a at a distance v = |u| from the centre, over the width; zero outside of the set."""
    distance = abs(u)
    within = minimum(maximum(distance, _NEAR), 1.0 - _NEAR)
    logarithm = log(within, normal=True)
    power = exp(exponent * logarithm)
    rest = 1.0 - power
    of_rest = log(rest, normal=True)
    grade = exp((1.0 / exponent) * of_rest)
    by_distance = maximum(-(power / within) * (grade / rest), _STEEPEST)
    by_exponent = -(grade / exponent) * (of_rest / exponent + power * logarithm / rest)
    return where(distance < 1.0, by_distance, 0.0 * u), where(distance < 1.0, by_exponent, 0.0 * u)


class _Family(NamedTuple):
    """What the upper or the lower sets make of the inputs.

    Attributes:
        output: τ.
        of_inputs: derivatives of τ with respect to the sets of each input; nothing is known of scales.
        exponent: derivative with respect to a.
    """

    output: Row
    of_inputs: list[Sets]
    exponent: Row


def _family(values: Sequence[Row], inputs: Sequence[Sets], exponent: Row, weights: Sequence[Row]) -> _Family:
    distances = [sets.distances(value) for value, sets in zip(values, inputs, strict=True)]
    grades = [[elliptic_membership(u, exponent) for u in each] for each in distances]
    factors = [1.0 / total(each) for each in grades]
    shares = [[factor * grade for grade in each] for factor, each in zip(factors, grades, strict=True)]
    choices = itertools.product(*shares)
    output = total([math.prod(choice, start=weight) for weight, choice in zip(weights, choices, strict=True)])
    of_inputs, of_exponent = [], []
    for k, (sets, each, factor) in enumerate(zip(inputs, distances, factors, strict=True)):
        alone = _alone(weights, shares, k)
        pulls = [(own - output) * factor for own in alone]
        slopes = [membership_slopes(u, exponent) for u in each]
        by_distance = [pull * slope for pull, (slope, _) in zip(pulls, slopes, strict=True)]
        signs = [where(u > 0.0, 1.0, where(u < 0.0, -1.0, 0.0 * u)) for u in each]
        of_inputs.append(
            type(sets)(
                0.0,
                tuple([-by * sign / d for by, sign, d in zip(by_distance, signs, sets.widths, strict=True)]),
                tuple([-by * abs(u) / d for by, u, d in zip(by_distance, each, sets.widths, strict=True)]),
            )
        )
        of_exponent += [pull * slope for pull, (_, slope) in zip(pulls, slopes, strict=True)]
    return _Family(output, of_inputs, total(of_exponent))


def _alone(weights: Sequence[Row], shares: Sequence[Sequence[Row]], k: int) -> list[Row]:
    """M_ki: the output of the rules of each set of input k, by themselves."""
    places = itertools.product(*(range(len(each)) for each in shares))
    of_sets: list[list[Row]] = [[] for _ in shares[k]]
    for place, weight, choice in zip(places, weights, itertools.product(*shares), strict=True):
        of_others = [share for other, share in enumerate(choice) if other != k]
        of_sets[place[k]].append(math.prod(of_others, start=weight))
    return [total(each) for each in of_sets]


def output_gradient(values: Sequence[Row], antecedents: Antecedents, weights: Sequence[Row]) -> Antecedents:
    """∂τ_f/∂θ of all numbers of the antecedents, in their places; zero for scales, which do not learn.

    Args:
        values: of the inputs, each in its unit.
        antecedents: of the rules.
        weights: F.
    """
    a1, a2, q, inputs = antecedents
    upper, lower = _family(values, inputs, a1, weights), _family(values, inputs, a2, weights)

    def mixed(of_upper: Row, of_lower: Row) -> Row:
        return (1.0 - q) * of_upper + q * of_lower

    return Antecedents(
        (1.0 - q) * upper.exponent,
        q * lower.exponent,
        lower.output - upper.output,
        tuple(
            [
                type(above)(
                    0.0,
                    tuple(map(mixed, above.centres, below.centres)),
                    tuple(map(mixed, above.widths, below.widths)),
                )
                for above, below in zip(upper.of_inputs, lower.of_inputs, strict=True)
            ]
        ),
    )


def adapted(
    antecedents: Antecedents,
    gradient: Antecedents,
    step: Row,
    rates: AdaptationRates,
    *,
    initial: Antecedents,
    parts: Sequence[Part],
) -> Antecedents:
    """The antecedents a step down a gradient, brought back to where they are valid.

    Args:
        antecedents: before.
        gradient: ∂τ_f/∂θ.
        step: the period times the signal that is learned from.
        rates: γ.
        initial: antecedents at the beginning.
        parts: that learn.
    """
    a1, a2, q, inputs = antecedents
    if "exponents" in parts:
        by = step * rates.exponents
        a1 = _held(a1 - by * gradient.a1, *_UPPER)
        a2 = _held(a2 - by * gradient.a2, *_LOWER)
        q = _held(q - by * gradient.q, 0.0, 1.0)
    if "centres" in parts:
        by = step * rates.centres
        inputs = tuple([_moved(*each, by) for each in zip(inputs, gradient.inputs, initial.inputs, strict=True)])
    if "widths" in parts:
        by = step * rates.widths
        inputs = tuple(
            [
                sets._replace(widths=tuple([d - by * of_d for d, of_d in zip(sets.widths, slopes.widths, strict=True)]))
                for sets, slopes in zip(inputs, gradient.inputs, strict=True)
            ]
        )
    if "centres" in parts or "widths" in parts:
        inputs = tuple([_overlapping(*each) for each in zip(inputs, initial.inputs, strict=True)])
    return Antecedents(a1, a2, q, inputs)


def _held(value: Row, least: Row, most: Row) -> Row:
    return maximum(minimum(value, most), least)


def _moved(sets: Sets, gradient: Sets, initial: Sets, by: Row) -> Sets:
    """The sets with their inner centres moved, as far as they may go."""
    _, *inner, _ = zip(sets.centres, gradient.centres, strict=True)
    first, *_, last = sets.centres
    moved = [
        _held(c - by * of_c, begun - _REACH * (begun - before), begun + _REACH * (after - begun))
        for (c, of_c), ((before, begun), (_, after)) in zip(
            inner, itertools.pairwise(itertools.pairwise(initial.centres)), strict=True
        )
    ]
    return sets._replace(centres=(first, *moved, last))


def _overlapping(sets: Sets, initial: Sets) -> Sets:
    """The sets with widths that are neither too small for their neighbours nor too large for the universe."""
    first, *_, last = sets.centres
    first_width, *_ = initial.widths
    # What each set needs of the gap after it, and the next one of the same gap; on a circle the first follows the last.
    after: list[Row] = []
    before: list[Row] = []
    for gap, (left, right) in zip(sets.gaps, itertools.pairwise((*initial.widths, first_width)), strict=False):
        share = _OVERLAP * gap / (left + right)
        after.append(share * left)
        before.append(share * right)
    if len(after) < len(sets.widths):
        after.append(0.0)
        before.append(0.0)
    *of_others, of_first = before
    widths = [
        _held(width, maximum(of_low, of_high), maximum(begun, last - first))
        for width, begun, of_low, of_high in zip(
            sets.widths, initial.widths, [of_first, *of_others], after, strict=True
        )
    ]
    return sets._replace(widths=tuple(widths))
