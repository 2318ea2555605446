"""Physical quantities in the scenario language: bounded numbers, or distributions within the bounds."""

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
from drake_quad.scenario.distributions import Distribution, NumberOrDistribution, Real, validation_error
from drake_quad.scenario.limits import MAX_DURATION, MAX_MAGNITUDE, MIN_DURATION, MIN_MAGNITUDE
from drake_quad.scenario.plausible import PLAUSIBLE_DELAY, numbers_in


def _values_of(value: NumberOrDistribution) -> tuple[float, ...] | None:
    """Return all possible values of a quantity; None if there are infinitely many."""
    return value.values if isinstance(value, Distribution) else (value,)


def extremes(value: NumberOrDistribution) -> tuple[float | None, float | None]:
    """Return the smallest and the largest possible value of a quantity; None for a bound that does not exist."""
    if isinstance(value, float):
        return value, value
    return value.extremes()


def field_from_record(record: Any, name: str, text: str, *, rule: str = "") -> Any:
    """Return a model field whose default and unit are copied from a field of a named tuple.

    Args:
        record: type of the named tuple, or an instance whose values are the defaults.
        name: name of the field in the named tuple.
        text: description of the field before the unit.
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
    """Validation rule for a field, as metadata of its annotation, which pydantic applies.

    Attributes:
        check: function that returns a valid value unchanged, and raises a validation error for any other value.
        lower: smallest valid number; None if there is no lower bound.
        upper: largest valid number; None if there is no upper bound.
        is_whole: whether numbers must be whole.
        applies_to_written_numbers: whether the rule applies to the numbers as written (such as distribution
            parameters), before pydantic converts them, instead of to all values of a distribution.
    """

    check: Callable[[Any], Any]
    lower: float | None
    upper: float | None
    is_whole: bool = False
    applies_to_written_numbers: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Return a pydantic schema that applies the rule."""
        validator = BeforeValidator(self.check) if self.applies_to_written_numbers else AfterValidator(self.check)
        return validator.__get_pydantic_core_schema__(source, handler)


def bounds(
    *,
    gt: float | None = None,
    ge: float | None = None,
    lt: float | None = None,
    le: float | None = None,
    is_fraction: bool = False,
) -> Rule:
    """Return a rule that requires a number, or all values of a distribution, to be within bounds.

    Args:
        gt: exclusive lower bound.
        ge: inclusive lower bound.
        lt: exclusive upper bound.
        le: inclusive upper bound.
        is_fraction: True to mention in the message that a number from 1 to 100 may have been given in percent.
    """
    rules = (
        ("larger than", gt, 0, operator.gt),
        ("at least", ge, 0, operator.ge),
        ("smaller than", lt, 1, operator.lt),
        ("at most", le, 1, operator.le),
    )
    bounds = [(words, bound, side, holds) for words, bound, side, holds in rules if bound is not None]

    def check(value: NumberOrDistribution) -> NumberOrDistribution:
        ends = extremes(value)
        if any((end := ends[side]) is None or not holds(end, bound) for _, bound, side, holds in bounds):
            percent = is_fraction and isinstance(value, float) and 1.0 <= value <= 100.0
            hint = f"; {value:g} % {'is' if value == 1.0 else 'are'} {0.01 * value:g}" if percent else ""
            raise validation_error(
                "must be " + " and ".join(f"{words} {bound:g}" for words, bound, *_ in bounds) + hint
            )
        return value

    lower = ge if gt is None else math.nextafter(gt, math.inf)
    upper = le if lt is None else math.nextafter(lt, -math.inf)
    return Rule(check, lower, upper)


def radians(max_angle: float) -> Rule:
    """Return a rule that rejects angles that must have been given in degrees.

    Args:
        max_angle: largest plausible magnitude of an angle or of a distribution parameter, rad.
    """

    def check(value: Any) -> Any:
        large = next((number for number in numbers_in(value) if abs(number) > max_angle), None)
        if large is not None:
            raise validation_error(radians_demand(large, max_angle))
        return value

    return Rule(check, -max_angle, max_angle, applies_to_written_numbers=True)


def radians_demand(degrees: float, max_angle: float) -> str:
    """Return the error message for an angle that must have been given in degrees.

    Args:
        degrees: number that was given, presumably in degrees.
        max_angle: largest plausible magnitude of the angle, rad.
    """
    return (
        f"must be in radians, at most {max_angle:.4g} in magnitude; {degrees:g} degrees are {math.radians(degrees):.4g}"
        " rad"
    )


def integer_bounds(*, ge: int, le: int) -> Rule:
    """Return a rule that requires a number, or all numbers of a choice, to be whole numbers within bounds."""

    def check(value: NumberOrDistribution) -> NumberOrDistribution:
        numbers = _values_of(value)
        if numbers is None or not all(number.is_integer() and ge <= number <= le for number in numbers):
            raise validation_error(f"must be a whole number from {ge} to {le}, or a choice of such numbers")
        return value

    return Rule(check, ge, le, is_whole=True)


def can_differ_from_zero(value: NumberOrDistribution) -> bool:
    """Return whether a quantity is a distribution or a nonzero number, so that the diagram must model it."""
    return not isinstance(value, float | int) or value != 0.0


def any_nonzero(settings: Any, drawn: Any) -> bool:
    """Return whether a quantity, or any item of a tuple, can differ from zero. A mapping counts as nonzero.

    Args:
        settings: quantity, tuple of quantities or mapping in a scenario; None if it is not given.
        drawn: the same quantity in `Batch.fleet_scenario`, in which random fields are arrays.
    """
    if settings is None:
        return False
    if isinstance(settings, tuple):
        return any(map(any_nonzero, settings, drawn))
    return can_differ_from_zero(settings) or bool(np.any(np.not_equal(drawn, 0.0)))


def max_ticks(settings: Any, drawn: Any) -> int:
    """Return the largest number of ticks that a delay can have. Arguments are as in `any_nonzero`."""
    _, largest = extremes(settings)
    return int(max(largest or 0.0, np.max(drawn)))


def excludes_zero(value: NumberOrDistribution) -> bool:
    """Return whether a quantity is certain to have a magnitude of at least `MIN_MAGNITUDE`."""
    values = _values_of(value)
    if values is not None:
        return all(abs(number) >= MIN_MAGNITUDE for number in values)
    lowest, highest = extremes(value)
    return (lowest is not None and lowest >= MIN_MAGNITUDE) or (highest is not None and highest <= -MIN_MAGNITUDE)


def _zero_or_min_duration(step: float) -> float:
    if 0.0 < step < MIN_DURATION:
        raise validation_error(f"must be 0, or at least {MIN_DURATION}")
    return step


Number = NumberOrDistribution
Positive = Annotated[NumberOrDistribution, bounds(gt=0.0), bounds(ge=MIN_MAGNITUDE)]
NonNegative = Annotated[NumberOrDistribution, bounds(ge=0.0)]
Probability = Annotated[NumberOrDistribution, bounds(ge=0.0, le=1.0, is_fraction=True)]
# Relative error of a quantity. It must be above -1, so that the quantity keeps its sign.
RelativeError = Annotated[NumberOrDistribution, bounds(gt=-1.0)]
# Delay in whole periods. With the default period of the command link, the upper bound is one second.
Ticks = Annotated[NumberOrDistribution, integer_bounds(ge=0, le=50), PLAUSIBLE_DELAY]
# Times and durations in a flight, s.
Moment = Annotated[NumberOrDistribution, bounds(ge=0.0, le=MAX_DURATION)]
Span = Annotated[NumberOrDistribution, bounds(gt=0.0), bounds(ge=MIN_DURATION, le=MAX_DURATION)]
# Largest magnitude of an angle that gives a direction, rad. A larger number was probably given in degrees.
TWO_TURNS = 4.0 * math.pi
# Upper bound for a tilt and for the standard deviation of an angle, rad. A body that tilts further is upside down.
_RIGHT_ANGLE = 0.5 * math.pi
Direction = Annotated[NumberOrDistribution, radians(TWO_TURNS)]
_Misalignment = Annotated[NumberOrDistribution, radians(math.pi)]
Misalignment = Annotated[tuple[_Misalignment, _Misalignment, _Misalignment], Field(strict=False)]
AngleNoise = Annotated[NonNegative, radians(_RIGHT_ANGLE)]
Tilt = Annotated[NumberOrDistribution, bounds(gt=0.0, lt=_RIGHT_ANGLE), radians(_RIGHT_ANGLE)]
Position = Annotated[tuple[Number, Number, Number], Field(strict=False)]
Gains = Annotated[tuple[NonNegative, NonNegative, NonNegative], Field(strict=False)]
Positives = Annotated[tuple[Positive, Positive, Positive], Field(strict=False)]
Spans = Annotated[tuple[Span, Span, Span], Field(strict=False)]

# The same quantities, without distributions.
FixedPositive = Annotated[float, Field(ge=MIN_MAGNITUDE, le=MAX_MAGNITUDE)]
FixedNonNegative = Annotated[float, Field(ge=0.0, le=MAX_MAGNITUDE)]
FixedMoment = Annotated[float, Field(ge=0.0, le=MAX_DURATION)]
FixedSpan = Annotated[float, Field(ge=MIN_DURATION, le=MAX_DURATION)]
FixedPositives = Annotated[tuple[FixedPositive, FixedPositive, FixedPositive], Field(strict=False)]
FixedSpans = Annotated[tuple[FixedSpan, FixedSpan, FixedSpan], Field(strict=False)]
Point = Annotated[tuple[Real, Real, Real], Field(strict=False)]
FixedDirection = Annotated[Real, radians(TWO_TURNS)]
FixedDirections = Annotated[tuple[FixedDirection, FixedDirection, FixedDirection], Field(strict=False)]
FixedAngleNoise = Annotated[FixedPositive, radians(_RIGHT_ANGLE)]
FixedTilt = Annotated[float, Field(gt=0.0, lt=_RIGHT_ANGLE), radians(_RIGHT_ANGLE)]
HalfTurn = Annotated[float, Field(ge=-math.pi, le=math.pi), radians(math.pi)]
# Period of cameras, control or integration, s. No vehicle can be flown with less than one tick per second.
Period = Annotated[float, Field(ge=MIN_DURATION, le=1.0)]
Step = Annotated[float, Field(ge=0.0, le=1.0), AfterValidator(_zero_or_min_duration)]

IntegrationRule = Annotated[
    Integration,
    Field(
        description="whether the integral in the command of a tick excludes (forward_euler) or includes"
        " (backward_euler) the error of this tick"
    ),
]
