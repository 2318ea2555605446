"""Class of an estimate with a confidence interval, and functions that format estimates.

All estimates with an interval are printed by `Interval.text` or `plus_minus`. The width of the interval determines the
number of digits: half the width has two significant digits, or more if an end would otherwise be rounded to the
estimate or to a level such as zero. Ends are rounded outwards, so that the printed interval contains the exact
interval.
"""

import math
from collections.abc import Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Decimal
from typing import NamedTuple

CONFIDENCE = 0.95
"""Default confidence of all intervals."""
INFINITIES = ("-∞", "∞")
"""Texts for negative and positive infinity."""

_WIDTH_DIGITS = 2  # significant digits of half an interval's width
_DIGITS_WITHOUT_INTERVAL = 3  # significant digits of an estimate without an interval
# Largest number of additional digits that are printed so that an end of a confidence interval is not rounded to a level
# such as zero; see `levels` in `Interval.text`.
_MAX_LEVEL_DIGITS = 3
_EXACT_DIGITS = 12  # number of significant digits that rounding errors do not affect
_ROUNDING_TOLERANCE = 1e-9  # largest rounding error, relative to the larger end of a confidence interval
_MIN_PLAIN_NUMBER = 1e-4  # smaller numbers are written with an exponent
_MAX_PLAIN_NUMBER = 1e7  # larger numbers are written with an exponent


class Interval(NamedTuple):
    """Estimate and its confidence interval.

    An end is infinite if the samples do not bound the estimate on that side. Both ends are NaN if there is no interval,
    as for the mean of a single sample.

    Attributes:
        value: estimated value.
        low: lower end of the interval.
        high: upper end of the interval.
    """

    value: float
    low: float
    high: float

    def __neg__(self) -> "Interval":
        """Return the estimate of -x, where x is the estimated number."""
        return Interval(-self.value, -self.high, -self.low)

    def plus(self, offset: float) -> "Interval":
        """Return the estimate of x + offset, where x is the estimated number."""
        return Interval(self.value + offset, self.low + offset, self.high + offset)

    def is_above(self, level: float) -> bool | None:
        """Return True if the interval is above a level, False if it is below, and None if neither can be concluded."""
        return True if self.low > level else False if self.high < level else None

    def text(
        self,
        *,
        unit: str = "",
        size: float = 1.0,
        signed: bool = False,
        infinities: tuple[str, str] = INFINITIES,
        levels: Sequence[float] = (0.0,),
    ) -> str:
        """Return the estimate and its interval as text, as in `0.123 m [0.120, 0.126]`.

        The interval determines the number of digits. An end that differs from the estimate only by rounding errors is
        printed like the estimate, and a number that is exactly zero is printed as `0`. An estimate without an interval,
        or an infinite estimate without a finite end, is printed without brackets in three significant digits.

        Args:
            unit: unit that follows the estimate.
            size: value of the unit in SI units, such as 0.01 for cm.
            signed: True to print a plus sign before positive numbers.
            infinities: texts for negative and positive infinity.
            levels: numbers, such as zero, to which an end must not be rounded unless it is equal to them.
        """
        if math.isnan(self.value):
            return "–"
        scaled = Interval(*(number / size for number in self))
        decimals, exponent = _digits(scaled, [level / size for level in levels])
        value, low, high = _rounded_texts(scaled, decimals, exponent, signed=signed, infinities=infinities)
        estimate = f"{value} {unit}".rstrip()
        is_bounded = math.isfinite(self.low) or math.isfinite(self.high)
        is_unbounded = math.isfinite(self.value) and math.isinf(self.low) and math.isinf(self.high)
        return f"{estimate} [{low}, {high}]" if is_bounded or is_unbounded else estimate

    def without_interval(self) -> "Interval":
        """Return the estimate without its confidence interval."""
        return Interval(self.value, math.nan, math.nan)

    def percent(self) -> str:
        """Return a fraction as text in per cent; see `text`, with 0 and 100 % as `levels`."""
        return self.text(unit="%", size=0.01, levels=(0.0, 1.0))

    def ratio(self) -> str:
        """Return the estimate of a ratio as text; see `text`, with 0 and 1 as `levels`."""
        return self.text(levels=(0.0, 1.0))

    def metres(self) -> str:
        """Return the estimate of a length (m) as text in m; see `text`."""
        return self.text(unit="m")

    def millimetres(self) -> str:
        """Return the estimate of a difference of lengths (m) as text in mm; see `text`."""
        return self.text(unit="mm", size=1e-3, signed=True)


def plus_minus(value: float, spread: float) -> str:
    """Return a number and its spread as text, as in `0.123 ± 0.003`; the spread determines the number of digits.

    Args:
        value: number.
        spread: half the width of a symmetric interval, or a standard deviation; it is rounded up.
    """
    decimals, exponent = _digits(Interval(value, value - spread, value + spread))
    number = _rounded_text(value, decimals, exponent, ROUND_HALF_EVEN)
    return f"{number} ± {_rounded_text(spread, decimals, exponent, ROUND_CEILING)}"


def spread_text(spread: float) -> str:
    """Return a spread as text in two significant digits, as in `± 0.0032`."""
    return f"± {_rounded_text(spread, *_digits(Interval(0.0, -spread, spread)), ROUND_CEILING)}"


def _digits(interval: Interval, levels: Sequence[float] = (0.0,)) -> tuple[int, int]:
    """Return the number of decimals and the common exponent with which an interval is printed.

    The number of decimals is the smallest number with which neither end is rounded to the estimate or to one of
    `levels`, such as zero. The exponent is 0 for numbers that are printed without an exponent.
    """
    value, *ends = interval
    largest = max((abs(number) for number in interval if math.isfinite(number) and number), default=1.0)
    exponent = 0 if _MIN_PLAIN_NUMBER <= largest < _MAX_PLAIN_NUMBER else _magnitude(largest)
    bounds = [end for end in ends if math.isfinite(end) and not _is_close(end, value, largest)]
    if not (bounds and math.isfinite(value)):
        return max(_DIGITS_WITHOUT_INTERVAL - 1 - _magnitude(largest) + exponent, 0), exponent
    half = 0.5 * (bounds[1] - bounds[0]) if len(bounds) == 2 else abs(bounds[0] - value)
    decimals = max(_WIDTH_DIGITS - 1 - _magnitude(half) + exponent, 0)
    for extra in range(_EXACT_DIGITS):
        estimate, low, high = _rounded_texts(interval, decimals + extra, exponent)
        rounded = [float(low if end == interval.low else high) for end in bounds]
        is_at_level = any(number in levels and end not in levels for number, end in zip(rounded, bounds, strict=True))
        if float(estimate) not in rounded and not (is_at_level and extra < _MAX_LEVEL_DIGITS):
            break
    return decimals + extra, exponent


def _rounded_texts(
    interval: Interval,
    decimals: int,
    exponent: int,
    *,
    signed: bool = False,
    infinities: tuple[str, str] = INFINITIES,
) -> tuple[str, str, str]:
    """Return the rounded estimate, lower end and upper end as text."""
    value, *ends = interval
    largest = max((abs(number) for number in interval if math.isfinite(number)), default=0.0)
    texts = [
        _rounded_text(number, decimals, exponent, rounding, signed=signed, infinities=infinities)
        for number, rounding in zip(interval, (ROUND_HALF_EVEN, ROUND_FLOOR, ROUND_CEILING), strict=True)
    ]
    low, high = (
        texts[0] if _is_close(end, value, largest) else text for end, text in zip(ends, texts[1:], strict=True)
    )
    return texts[0], low, high


def _rounded_text(
    number: float,
    decimals: int,
    exponent: int,
    rounding: str,
    *,
    signed: bool = False,
    infinities: tuple[str, str] = INFINITIES,
) -> str:
    """Return a number as text, rounded to a number of decimals."""
    if math.isnan(number):
        return "–"
    if math.isinf(number):
        return infinities[number > 0.0]
    if number == 0.0:
        return "0"
    exact = Decimal(f"{number:.{_EXACT_DIGITS - 1}e}").scaleb(-exponent)
    rounded = exact.quantize(Decimal(1).scaleb(-decimals), rounding)
    # The absolute value avoids the text "-0".
    text = f"{rounded or abs(rounded):{'+' if signed else ''}f}"
    return f"{text}e{exponent:+03d}" if exponent else text


def _magnitude(number: float) -> int:
    """Return the decimal exponent of the first digit of a positive number."""
    return math.floor(math.log10(number))


def _is_close(end: float, value: float, largest: float) -> bool:
    """Return whether an end differs from the estimate only by rounding errors.

    Args:
        end: end of the interval.
        value: estimated value.
        largest: largest absolute value among the estimate and both ends.
    """
    return end == value or abs(end - value) <= _ROUNDING_TOLERANCE * largest
