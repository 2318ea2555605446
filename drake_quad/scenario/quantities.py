"""Physical quantities of the scenario language: numbers with bounds, or distributions within them."""

import math
import operator
from collections.abc import Callable
from dataclasses import dataclass
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, PydanticUndefined

from drake_quad.control.integral import Integration
from drake_quad.scenario.distributions import Distribution, NumberOrDistribution, Real, refused
from drake_quad.scenario.limits import LARGEST, LONGEST, SHORTEST, SMALLEST
from drake_quad.scenario.plausible import PLAUSIBLE_DELAY, numbers_in


def _values_of(value: NumberOrDistribution) -> tuple[float, ...] | None:
    """Return all possible values of a quantity; None if there are infinitely many."""
    return value.values if isinstance(value, Distribution) else (value,)


def extremes(value: NumberOrDistribution) -> tuple[float | None, float | None]:
    """Return the smallest and the largest possible value of a quantity; None for a bound that does not exist."""
    if isinstance(value, float):
        return value, value
    return value.extremes()


def field_of(record: Any, name: str, text: str, *, rule: str = "") -> Any:
    """Return a field of a model with the default and the unit of a field of a record.

    Args:
        record: type of the record, or a record whose values are the defaults.
        name: name of the field in the record.
        text: description of the field without the unit.
        rule: text of the description after the unit.
    """
    kind = record if isinstance(record, type) else type(record)
    hint = get_type_hints(kind, include_extras=True)[name]
    if get_origin(hint) in (Union, UnionType):
        hint = get_args(hint)[0]
    if hasattr(hint, "_fields"):
        hint = next(iter(get_type_hints(hint, include_extras=True).values()))
    _, quantity = get_args(hint)
    defaults = kind._field_defaults if kind is record else record._asdict()
    return Field(default=defaults.get(name, PydanticUndefined), description=f"{text} ({quantity.unit}){rule}")


@dataclass(frozen=True)
class Rule:
    """Rule for the values of a field, as metadata of its annotation, by which pydantic validates.

    Attributes:
        check: function that returns a value that follows the rule, and raises a validation error for any other.
        lower: smallest number that follows the rule; None if there is no lower bound.
        upper: largest number that follows the rule; None if there is no upper bound.
        is_whole: whether numbers must be whole.
        is_of_numbers: whether the rule applies to the numbers as written, before pydantic converts them, rather than to
            all values of a distribution.
    """

    check: Callable[[Any], Any]
    lower: float | None
    upper: float | None
    is_whole: bool = False
    is_of_numbers: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return the schema that validates by the rule."""
        validator = BeforeValidator(self.check) if self.is_of_numbers else AfterValidator(self.check)
        return validator.__get_pydantic_core_schema__(source, handler)


def bounded(
    *,
    above: float | None = None,
    least: float | None = None,
    below: float | None = None,
    most: float | None = None,
    is_fraction: bool = False,
) -> Rule:
    """Return a rule that requires a number, or all values of a distribution, to be within bounds.

    Args:
        above: exclusive lower bound.
        least: inclusive lower bound.
        below: exclusive upper bound.
        most: inclusive upper bound.
        is_fraction: True if a number beyond the upper bound was probably given in percent, which the message mentions.
    """
    rules = (
        ("larger than", above, 0, operator.gt),
        ("at least", least, 0, operator.ge),
        ("smaller than", below, 1, operator.lt),
        ("at most", most, 1, operator.le),
    )
    bounds = [(words, bound, side, holds) for words, bound, side, holds in rules if bound is not None]

    def check(value: NumberOrDistribution) -> NumberOrDistribution:
        ends = extremes(value)
        if any((end := ends[side]) is None or not holds(end, bound) for _, bound, side, holds in bounds):
            percent = is_fraction and isinstance(value, float) and 1.0 <= value <= 100.0
            hint = f"; {value:g} % {'is' if value == 1.0 else 'are'} {0.01 * value:g}" if percent else ""
            raise refused("must be " + " and ".join(f"{words} {bound:g}" for words, bound, *_ in bounds) + hint)
        return value

    lower = least if above is None else math.nextafter(above, math.inf)
    upper = most if below is None else math.nextafter(below, -math.inf)
    return Rule(check, lower, upper)


def radians(most: float) -> Rule:
    """Return a rule that rejects angles that must have been given in degrees.

    Args:
        most: largest plausible magnitude of an angle, or of a parameter of its distribution, rad.
    """

    def check(value: Any) -> Any:
        large = next((number for number in numbers_in(value) if abs(number) > most), None)
        if large is not None:
            raise refused(radians_demand(large, most))
        return value

    return Rule(check, -most, most, is_of_numbers=True)


def radians_demand(degrees: float, most: float) -> str:
    """Return the error message for an angle that must have been given in degrees.

    Args:
        degrees: given number.
        most: largest plausible magnitude of the angle, rad.
    """
    return (
        f"must be in radians, at most {most:.4g} in magnitude; {degrees:g} degrees are {math.radians(degrees):.4g} rad"
    )


def whole(*, least: int, most: int) -> Rule:
    """Return a rule that requires a number, or all numbers of a choice, to be whole numbers within bounds."""

    def check(value: NumberOrDistribution) -> NumberOrDistribution:
        numbers = _values_of(value)
        if numbers is None or not all(number.is_integer() and least <= number <= most for number in numbers):
            raise refused(f"must be a whole number from {least} to {most}, or a choice of such numbers")
        return value

    return Rule(check, least, most, is_whole=True)


def can_differ_from_zero(value: NumberOrDistribution) -> bool:
    """Return whether a quantity is anything but the number zero, so that the diagram must model it."""
    return not isinstance(value, float | int) or value != 0.0


def any_nonzero(written: Any, flown: Any) -> bool:
    """Return whether a quantity or an item of it can differ from zero.

    Args:
        written: quantity, or tuple of quantities, of a scenario.
        flown: the same quantity of its `Batch.fleet_scenario`.
    """
    if isinstance(written, tuple):
        return any(map(any_nonzero, written, flown))
    return can_differ_from_zero(written) or bool(np.any(np.not_equal(flown, 0.0)))


def largest_ticks(written: Any, flown: Any) -> int:
    """Return the largest number of ticks that a delay can take; the arguments are as in `any_nonzero`."""
    _, largest = extremes(written)
    return int(max(largest or 0.0, np.max(flown)))


def excludes_zero(value: NumberOrDistribution) -> bool:
    """Return whether all values of a quantity have the same sign and at least the magnitude `SMALLEST`."""
    values = _values_of(value)
    if values is not None:
        return all(abs(number) >= SMALLEST for number in values)
    lowest, highest = extremes(value)
    return (lowest is not None and lowest >= SMALLEST) or (highest is not None and highest <= -SMALLEST)


def _no_shorter_step(step: float) -> float:
    if 0.0 < step < SHORTEST:
        raise refused(f"must be 0, or at least {SHORTEST}")
    return step


Number = NumberOrDistribution
Positive = Annotated[NumberOrDistribution, bounded(above=0.0), bounded(least=SMALLEST)]
NonNegative = Annotated[NumberOrDistribution, bounded(least=0.0)]
Probability = Annotated[NumberOrDistribution, bounded(least=0.0, most=1.0, is_fraction=True)]
# Relative error of a quantity. Above -1, so that the quantity does not change its sign.
Share = Annotated[NumberOrDistribution, bounded(above=-1.0)]
# Delay in whole periods. Fifty periods of the control link are one second by default.
Ticks = Annotated[NumberOrDistribution, whole(least=0, most=50), PLAUSIBLE_DELAY]
# Times and durations in a flight, s.
Moment = Annotated[NumberOrDistribution, bounded(least=0.0, most=LONGEST)]
Span = Annotated[NumberOrDistribution, bounded(above=0.0), bounded(least=SHORTEST, most=LONGEST)]
# Largest angles, rad. No direction needs more than two turns, and a body that tilts by more than 90° is upside down.
TWO_TURNS = 4.0 * math.pi
_UPRIGHT = 0.5 * math.pi
Direction = Annotated[NumberOrDistribution, radians(TWO_TURNS)]
_Misalignment = Annotated[NumberOrDistribution, radians(math.pi)]
Misalignment = Annotated[tuple[_Misalignment, _Misalignment, _Misalignment], Field(strict=False)]
AngleNoise = Annotated[NonNegative, radians(_UPRIGHT)]
Tilt = Annotated[NumberOrDistribution, bounded(above=0.0, below=_UPRIGHT), radians(_UPRIGHT)]
Position = Annotated[tuple[Number, Number, Number], Field(strict=False)]
Gains = Annotated[tuple[NonNegative, NonNegative, NonNegative], Field(strict=False)]
Positives = Annotated[tuple[Positive, Positive, Positive], Field(strict=False)]
Spans = Annotated[tuple[Span, Span, Span], Field(strict=False)]

# Types of the same quantities without distributions.
PlainPositive = Annotated[float, Field(ge=SMALLEST, le=LARGEST)]
PlainNonNegative = Annotated[float, Field(ge=0.0, le=LARGEST)]
PlainMoment = Annotated[float, Field(ge=0.0, le=LONGEST)]
PlainSpan = Annotated[float, Field(ge=SHORTEST, le=LONGEST)]
PlainPositives = Annotated[tuple[PlainPositive, PlainPositive, PlainPositive], Field(strict=False)]
PlainSpans = Annotated[tuple[PlainSpan, PlainSpan, PlainSpan], Field(strict=False)]
Point = Annotated[tuple[Real, Real, Real], Field(strict=False)]
PlainDirection = Annotated[Real, radians(TWO_TURNS)]
PlainDirections = Annotated[tuple[PlainDirection, PlainDirection, PlainDirection], Field(strict=False)]
PlainAngleNoise = Annotated[PlainPositive, radians(_UPRIGHT)]
PlainTilt = Annotated[float, Field(gt=0.0, lt=_UPRIGHT), radians(_UPRIGHT)]
HalfTurn = Annotated[float, Field(ge=-math.pi, le=math.pi), radians(math.pi)]
# Period of cameras, control or integration, s. No vehicle can be flown with less than one tick per second.
Period = Annotated[float, Field(ge=SHORTEST, le=1.0)]
Step = Annotated[float, Field(ge=0.0, le=1.0), AfterValidator(_no_shorter_step)]

IntegrationRule = Annotated[
    Integration,
    Field(
        description="whether the integral in the command of a tick excludes (forward_euler) or includes"
        " (backward_euler) the error of this tick"
    ),
]
