"""Estimates with confidence intervals, their arithmetic, and their formatting.

All estimates with an interval are printed by `Interval.text` or `plus_minus`. The width of the interval determines the
number of digits. Half of the width has two significant digits, and more if an end would otherwise be rounded to the
estimate or to a level such as zero. Ends are rounded outwards, so that the printed interval contains the exact one.
"""

import math
from collections.abc import Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Decimal
from typing import NamedTuple

CONFIDENCE = 0.95
"""Default confidence of all intervals."""

_WIDTH_DIGITS = 2  # significant digits of half of an interval's width
_LONE_DIGITS = 3  # significant digits of a number without an interval
_MAX_LEVEL_DIGITS = 3  # largest number of additional digits that distinguish an end from a level
_EXACT_DIGITS = 12  # significant digits that are free of rounding errors
_ROUNDING_TOLERANCE = 1e-9  # differences below this, relative to an interval's largest number, are rounding errors
# Numbers outside this range are written with an exponent.
_MIN_PLAIN_NUMBER = 1e-4
_MAX_PLAIN_NUMBER = 1e7


class Interval(NamedTuple):
    """Estimate and its confidence interval.

    An end is infinite if the samples do not bound the estimate on that side. The ends are NaN if there is no interval,
    as for the mean of a single sample.

    Attributes:
        value: estimate.
        low: lower end of the interval.
        high: upper end of the interval.
    """

    value: float
    low: float
    high: float

    def __neg__(self) -> "Interval":
        """Return the estimate of -x."""
        return Interval(-self.value, -self.high, -self.low)

    def plus(self, offset: float) -> "Interval":
        """Return the estimate of x + offset."""
        return Interval(self.value + offset, self.low + offset, self.high + offset)

    def is_above(self, level: float) -> bool | None:
        """Return whether the interval is above a level; None if the interval contains the level or is missing."""
        return True if self.low > level else False if self.high < level else None

    def text(
        self,
        *,
        unit: str = "",
        size: float = 1.0,
        signed: bool = False,
        infinite: str = "∞",
        levels: Sequence[float] = (0.0,),
    ) -> str:
        """Return the estimate and its interval as text, as in `0.123 m [0.120, 0.126]`.

        The interval determines the number of digits. An end that differs from the estimate only by rounding errors is
        printed like the estimate, and a number that is exactly zero as `0`. An estimate without an interval, or an
        infinite estimate without a finite end, is printed alone in three significant digits.

        Args:
            unit: unit that follows the estimate.
            size: size of the unit in SI units.
            signed: True to print a plus sign before positive numbers.
            infinite: text for an infinite number.
            levels: numbers to which an end is not rounded unless it is equal to one of them.
        """
        if math.isnan(self.value):
            return "–"
        scaled = Interval(*(number / size for number in self))
        decimals, exponent = _digits(scaled, [level / size for level in levels])
        value, low, high = _written(scaled, decimals, exponent, signed=signed, infinite=infinite)
        shown = f"{value} {unit}".rstrip()
        is_bounded = math.isfinite(self.low) or math.isfinite(self.high)
        is_unbounded = math.isfinite(self.value) and math.isinf(self.low) and math.isinf(self.high)
        return f"{shown} [{low}, {high}]" if is_bounded or is_unbounded else shown

    def alone(self) -> "Interval":
        """Return the estimate without its interval."""
        return Interval(self.value, math.nan, math.nan)

    def percent(self) -> str:
        """Return a share as text in per cent, with the levels 0 and 100 %; see `text`."""
        return self.text(unit="%", size=0.01, levels=(0.0, 1.0))

    def ratio(self) -> str:
        """Return a ratio as text, with the levels 0 and 1; see `text`."""
        return self.text(levels=(0.0, 1.0))

    def metres(self) -> str:
        """Return a length as text in m; see `text`."""
        return self.text(unit="m")

    def millimetres(self) -> str:
        """Return a difference of lengths as text in mm; see `text`."""
        return self.text(unit="mm", size=1e-3, signed=True)


def plus_minus(value: float, spread: float) -> str:
    """Return a number and its spread as text, as in `0.123 ± 0.003`, with the digits that the spread determines.

    Args:
        value: number.
        spread: half the width of a symmetric interval, or a standard deviation; it is rounded up.
    """
    decimals, exponent = _digits(Interval(value, value - spread, value + spread))
    number = _number(value, decimals, exponent, ROUND_HALF_EVEN)
    return f"{number} ± {_number(spread, decimals, exponent, ROUND_CEILING)}"


def spread_alone(spread: float) -> str:
    """Return a spread as text in two significant digits, as in `± 0.0032`."""
    return f"± {_number(spread, *_digits(Interval(0.0, -spread, spread)), ROUND_CEILING)}"


def _digits(interval: Interval, levels: Sequence[float] = (0.0,)) -> tuple[int, int]:
    """Return the number of decimals and the common exponent with which an interval is printed.

    The number of decimals is the smallest one that distinguishes the ends from the estimate and from the levels. The
    exponent is 0 for numbers that are printed without an exponent.
    """
    value, *ends = interval
    largest = max((abs(number) for number in interval if math.isfinite(number) and number), default=1.0)
    exponent = 0 if _MIN_PLAIN_NUMBER <= largest < _MAX_PLAIN_NUMBER else _magnitude(largest)
    bounds = [end for end in ends if math.isfinite(end) and not _is_close(end, value, largest)]
    if not (bounds and math.isfinite(value)):
        return max(_LONE_DIGITS - 1 - _magnitude(largest) + exponent, 0), exponent
    half = 0.5 * (bounds[1] - bounds[0]) if len(bounds) == 2 else abs(bounds[0] - value)
    decimals = max(_WIDTH_DIGITS - 1 - _magnitude(half) + exponent, 0)
    for further in range(_EXACT_DIGITS):
        written, low, high = _written(interval, decimals + further, exponent)
        shown = [float(low if end == interval.low else high) for end in bounds]
        is_moved = any(number in levels and end not in levels for number, end in zip(shown, bounds, strict=True))
        if float(written) not in shown and not (is_moved and further < _MAX_LEVEL_DIGITS):
            break
    return decimals + further, exponent


def _written(
    interval: Interval, decimals: int, exponent: int, *, signed: bool = False, infinite: str = "∞"
) -> tuple[str, str, str]:
    """Return the estimate, the lower and the upper end as text."""
    value, *ends = interval
    largest = max((abs(number) for number in interval if math.isfinite(number)), default=0.0)
    texts = [
        _number(number, decimals, exponent, rounding, signed=signed, infinite=infinite)
        for number, rounding in zip(interval, (ROUND_HALF_EVEN, ROUND_FLOOR, ROUND_CEILING), strict=True)
    ]
    low, high = (
        texts[0] if _is_close(end, value, largest) else text for end, text in zip(ends, texts[1:], strict=True)
    )
    return texts[0], low, high


def _number(
    number: float, decimals: int, exponent: int, rounding: str, *, signed: bool = False, infinite: str = "∞"
) -> str:
    """Return a number as text."""
    if math.isnan(number):
        return "–"
    if math.isinf(number):
        return infinite if number > 0.0 else "-∞"
    if number == 0.0:
        return "0"
    exact = Decimal(f"{number:.{_EXACT_DIGITS - 1}e}").scaleb(-exponent)
    rounded = exact.quantize(Decimal(1).scaleb(-decimals), rounding)
    # A rounded number that is zero must not have a minus sign.
    shown = f"{rounded or abs(rounded):{'+' if signed else ''}f}"
    return f"{shown}e{exponent:+03d}" if exponent else shown


def _magnitude(number: float) -> int:
    """Return the exponent of the first digit of a positive number."""
    return math.floor(math.log10(number))


def _is_close(end: float, value: float, largest: float) -> bool:
    """Return whether an end differs from the estimate only by rounding errors.

    Args:
        end: end of the interval.
        value: estimate.
        largest: largest absolute value of the numbers of the interval.
    """
    return end == value or abs(end - value) <= _ROUNDING_TOLERANCE * largest
