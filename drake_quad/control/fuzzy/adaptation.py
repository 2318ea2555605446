"""Adaptation of the membership functions, which Kayacan and Maslim (2016), "the paper" below, name as future work.

The weights F descend the gradient of the cost s² / 2, where s is the learning signal and ∂τ_f/∂F = W. A larger
correction τ_f increases s; the positive gain from τ_f to s is part of the learning rate. Any other parameter θ of the
network descends the same gradient,

    θ̇ = -γ s ∂τ_f/∂θ

Consider a family of sets, upper or lower, with membership grades μ_ki of input k in its set i, normalised grades
μ̃_ki = μ_ki / Σ_i μ_ki and the output τ = Σ F Π_k μ̃_k. The output is linear in the normalised grades of each input:
τ = Σ_i μ̃_ki M_ki, where M_ki is the output of only those rules that contain set i of input k. Therefore
∂τ/∂μ_ki = (M_ki - τ) / Σ_i μ_ki. With v = |x - c| / d, eqs (11) and (12) of the paper give

    ∂μ/∂v = -v^(a-1) (1 - v^a)^(1/a-1)                ∂v/∂c = -sign(x - c) / d,  ∂v/∂d = -v / d
    ∂μ/∂a = μ (-ln(1 - v^a) / a² - v^a ln v / (a (1 - v^a)))

By eq (10), the output is q times the lower output plus 1 - q times the upper output, so that ∂τ_f/∂q is the lower minus
the upper output. ∂μ/∂v is minus infinity at the edge of an upper set and at the centre of a lower set. It is limited to
-10, ten times the derivative of a triangular set.

After every tick the parameters are projected onto valid sets:

* The first and the last centre are constant. They define the universe or, on a circle, prevent a rotation of all sets.
  Each other centre moves by at most a quarter of the initial gap to either neighbour, so that the order of the centres
  does not change.
* The sum of the widths of two neighbours is at least 1.02 times their gap, so that they overlap; the initial ratio of
  the two widths determines the lower limit of each. A width is at most the width of the universe or its initial value,
  whichever is larger.
* 1.001 <= a₁ <= 10, 0.1 <= a₂ <= 0.999 and 0 <= q <= 1.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

from drake_quad.control.fuzzy.inference import Antecedents, Sets, elliptic_membership
from drake_quad.framework.elementary import exp, log, maximum, minimum, total, where
from drake_quad.signals import Row

Part = Literal["centres", "widths", "exponents"]

# Smallest value of ∂μ/∂v; see the docstring of the module.
_MIN_SLOPE = -10.0
# Smallest distance from the centre and from the edge of a set, relative to its width, at which derivatives are
# evaluated. All powers are finite there.
_MIN_DISTANCE = 1e-9
# Largest displacement of a centre, relative to the initial gap to its neighbour.
_MAX_DISPLACEMENT = 0.25
# Smallest sum of the widths of two neighbouring sets, relative to the gap between their centres.
_MIN_OVERLAP = 1.02
_UPPER_EXPONENT_RANGE = (1.001, 10.0)  # range of the exponent a₁ of the upper memberships
_LOWER_EXPONENT_RANGE = (0.1, 0.999)  # range of the exponent a₂ of the lower memberships


class AdaptationRates(NamedTuple):
    """Learning rates γ, in s²/m² for the learning signal "surface" and in s³/m² for "feedback".

    Attributes:
        centres: rate of the centres.
        widths: rate of the widths.
        exponents: rate of a₁, a₂ and q.
    """

    centres: Row = 0.0
    widths: Row = 0.0
    exponents: Row = 0.0


def membership_derivatives(u: Row, exponent: Row) -> tuple[Row, Row]:
    """Return ∂μ/∂v and ∂μ/∂a at the distance v = |u| from the centre, relative to the width; zero outside the set."""
    distance = abs(u)
    limited = minimum(maximum(distance, _MIN_DISTANCE), 1.0 - _MIN_DISTANCE)
    logarithm = log(limited, normal=True)
    power = exp(exponent * logarithm)
    remainder = 1.0 - power
    log_rest = log(remainder, normal=True)
    grade = exp((1.0 / exponent) * log_rest)
    by_distance = maximum(-(power / limited) * (grade / remainder), _MIN_SLOPE)
    by_exponent = -(grade / exponent) * (log_rest / exponent + power * logarithm / remainder)
    return where(distance < 1.0, by_distance, 0.0 * u), where(distance < 1.0, by_exponent, 0.0 * u)


class _FamilyOutput(NamedTuple):
    """Output of the upper or of the lower sets, and its derivatives.

    Attributes:
        output: output τ.
        set_derivatives: derivatives of τ with respect to the parameters of the sets of each input; zero for the scales,
            which do not learn.
        exponent_derivative: derivative of τ with respect to the exponent a.
    """

    output: Row
    set_derivatives: list[Sets]
    exponent_derivative: Row


def _family_output(
    values: Sequence[Row], inputs: Sequence[Sets], exponent: Row, weights: Sequence[Row]
) -> _FamilyOutput:
    distances = [sets.distances(value) for value, sets in zip(values, inputs, strict=True)]
    grades = [[elliptic_membership(u, exponent) for u in row] for row in distances]
    inverse_sums = [1.0 / total(row) for row in grades]
    normalised_grades = [
        [inverse_sum * grade for grade in row] for inverse_sum, row in zip(inverse_sums, grades, strict=True)
    ]
    grades_of_rules = itertools.product(*normalised_grades)
    output = total([math.prod(row, start=weight) for weight, row in zip(weights, grades_of_rules, strict=True)])
    set_derivatives, exponent_derivatives = [], []
    for k, (sets, row, inverse_sum) in enumerate(zip(inputs, distances, inverse_sums, strict=True)):
        outputs = _outputs_of_single_sets(weights, normalised_grades, k)
        grade_derivatives = [(single - output) * inverse_sum for single in outputs]
        slopes = [membership_derivatives(u, exponent) for u in row]
        distance_derivatives = [
            derivative * by_distance for derivative, (by_distance, _) in zip(grade_derivatives, slopes, strict=True)
        ]
        signs = [where(u > 0.0, 1.0, where(u < 0.0, -1.0, 0.0 * u)) for u in row]
        set_derivatives.append(
            type(sets)(
                0.0,
                tuple(
                    [
                        -derivative * sign / d
                        for derivative, sign, d in zip(distance_derivatives, signs, sets.widths, strict=True)
                    ]
                ),
                tuple(
                    [
                        -derivative * abs(u) / d
                        for derivative, u, d in zip(distance_derivatives, row, sets.widths, strict=True)
                    ]
                ),
            )
        )
        exponent_derivatives += [
            derivative * by_exponent for derivative, (_, by_exponent) in zip(grade_derivatives, slopes, strict=True)
        ]
    return _FamilyOutput(output, set_derivatives, total(exponent_derivatives))


def _outputs_of_single_sets(weights: Sequence[Row], normalised_grades: Sequence[Sequence[Row]], k: int) -> list[Row]:
    """Return M_ki for each set i of input k, the output of only those rules that contain this set."""
    indices = itertools.product(*(range(len(row)) for row in normalised_grades))
    terms_of_sets: list[list[Row]] = [[] for _ in normalised_grades[k]]
    for index, weight, rule_grades in zip(indices, weights, itertools.product(*normalised_grades), strict=True):
        other_grades = [grade for number, grade in enumerate(rule_grades) if number != k]
        terms_of_sets[index[k]].append(math.prod(other_grades, start=weight))
    return [total(terms) for terms in terms_of_sets]


def output_gradient(values: Sequence[Row], antecedents: Antecedents, weights: Sequence[Row]) -> Antecedents:
    """Return the gradient ∂τ_f/∂θ as an `Antecedents`; zero for the scales, which do not learn.

    Args:
        values: values of the inputs, each in its unit.
        antecedents: antecedents of the rules.
        weights: weights F of the rules.
    """
    a1, a2, q, inputs = antecedents
    upper = _family_output(values, inputs, a1, weights)
    lower = _family_output(values, inputs, a2, weights)

    def mixed(of_upper: Row, of_lower: Row) -> Row:
        return (1.0 - q) * of_upper + q * of_lower

    return Antecedents(
        (1.0 - q) * upper.exponent_derivative,
        q * lower.exponent_derivative,
        lower.output - upper.output,
        tuple(
            [
                type(upper_sets)(
                    0.0,
                    tuple(map(mixed, upper_sets.centres, lower_sets.centres)),
                    tuple(map(mixed, upper_sets.widths, lower_sets.widths)),
                )
                for upper_sets, lower_sets in zip(upper.set_derivatives, lower.set_derivatives, strict=True)
            ]
        ),
    )


def adapt_antecedents(
    antecedents: Antecedents,
    gradient: Antecedents,
    step: Row,
    rates: AdaptationRates,
    *,
    initial: Antecedents,
    parts: Sequence[Part],
) -> Antecedents:
    """Return the antecedents after a gradient step, projected onto valid sets.

    Args:
        antecedents: antecedents before the step.
        gradient: gradient ∂τ_f/∂θ.
        step: tick period times the learning signal.
        rates: learning rates γ.
        initial: initial antecedents.
        parts: parts of the antecedents that learn.
    """
    a1, a2, q, inputs = antecedents
    if "exponents" in parts:
        scaled_step = step * rates.exponents
        a1 = _clipped(a1 - scaled_step * gradient.a1, *_UPPER_EXPONENT_RANGE)
        a2 = _clipped(a2 - scaled_step * gradient.a2, *_LOWER_EXPONENT_RANGE)
        q = _clipped(q - scaled_step * gradient.q, 0.0, 1.0)
    if "centres" in parts:
        scaled_step = step * rates.centres
        inputs = tuple(
            [
                _with_moved_centres(*each, scaled_step)
                for each in zip(inputs, gradient.inputs, initial.inputs, strict=True)
            ]
        )
    if "widths" in parts:
        scaled_step = step * rates.widths
        inputs = tuple(
            [
                sets._replace(
                    widths=tuple(
                        [d - scaled_step * slope for d, slope in zip(sets.widths, gradients.widths, strict=True)]
                    )
                )
                for sets, gradients in zip(inputs, gradient.inputs, strict=True)
            ]
        )
    if "centres" in parts or "widths" in parts:
        inputs = tuple([_with_valid_widths(*each) for each in zip(inputs, initial.inputs, strict=True)])
    return Antecedents(a1, a2, q, inputs)


def _clipped(value: Row, lower: Row, upper: Row) -> Row:
    return maximum(minimum(value, upper), lower)


def _with_moved_centres(sets: Sets, gradient: Sets, initial: Sets, scaled_step: Row) -> Sets:
    """Return the sets after a gradient step of the inner centres, whose displacements are limited."""
    _, *inner, _ = zip(sets.centres, gradient.centres, strict=True)
    first, *_, last = sets.centres
    moved_centres = [
        _clipped(
            c - scaled_step * slope,
            initial_centre - _MAX_DISPLACEMENT * (initial_centre - before),
            initial_centre + _MAX_DISPLACEMENT * (after - initial_centre),
        )
        for (c, slope), ((before, initial_centre), (_, after)) in zip(
            inner, itertools.pairwise(itertools.pairwise(initial.centres)), strict=True
        )
    ]
    return sets._replace(centres=(first, *moved_centres, last))


def _with_valid_widths(sets: Sets, initial: Sets) -> Sets:
    """Return the sets with their widths clipped such that neighbours overlap and no set is too wide."""
    first, *_, last = sets.centres
    first_width, *_ = initial.widths
    # Each gap requires a minimum width of the set before it and of the set after it. On a circle, the last gap is
    # followed by the first set.
    minima_by_next_gap: list[Row] = []
    minima_by_previous_gap: list[Row] = []
    for gap, (left_width, right_width) in zip(
        sets.gaps, itertools.pairwise((*initial.widths, first_width)), strict=False
    ):
        fraction = _MIN_OVERLAP * gap / (left_width + right_width)
        minima_by_next_gap.append(fraction * left_width)
        minima_by_previous_gap.append(fraction * right_width)
    if len(minima_by_next_gap) < len(sets.widths):
        minima_by_next_gap.append(0.0)
        minima_by_previous_gap.append(0.0)
    *others, first_minimum = minima_by_previous_gap
    widths = [
        _clipped(width, maximum(previous_minimum, next_minimum), maximum(initial_width, last - first))
        for width, initial_width, previous_minimum, next_minimum in zip(
            sets.widths, initial.widths, [first_minimum, *others], minima_by_next_gap, strict=True
        )
    ]
    return sets._replace(widths=tuple(widths))
