"""Estimates with their confidence intervals: their arithmetic, and how they are written.

Every estimate with an interval that the package prints goes through `Interval.text` or `plus_minus`. The digits follow
the interval: half of its width has two significant digits, and more where an end would otherwise look like the estimate
or like a level, as zero. Ends are rounded outwards, so that the printed interval contains the interval.
"""

import math
from collections.abc import Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, ROUND_HALF_EVEN, Decimal
from typing import NamedTuple

CONFIDENCE = 0.95
"""Confidence of all intervals unless another one is asked for."""

_WIDTH_DIGITS = 2  # significant digits of half of an interval's width
_LONE_DIGITS = 3  # significant digits of a number without an interval
_MAX_LEVEL_DIGITS = 3  # further digits for an end near a level, so that it is not written as if it were the level
_EXACT_DIGITS = 12  # significant digits in which rounding errors do not show
# Numbers that differ by less than this share of the largest number of an interval differ by rounding errors only.
_ROUNDING = 1e-9
# Numbers outside of this range are written with an exponent.
_MIN_PLAIN, _MAX_PLAIN = 1e-4, 1e7


class Interval(NamedTuple):
    """An estimate and its confidence interval.

    An end is infinite where the samples do not bound the estimate on that side, and NaN where there is no interval, as
    for the mean of a single sample.

    Attributes:
        value: estimated.
        low: lower end.
        high: upper end.
    """

    value: float
    low: float
    high: float

    def __neg__(self) -> "Interval":
        """The estimate of -x."""
        return Interval(-self.value, -self.high, -self.low)

    def plus(self, offset: float) -> "Interval":
        """The estimate of x + offset."""
        return Interval(self.value + offset, self.low + offset, self.high + offset)

    def is_above(self, level: float) -> bool | None:
        """Is the number above a level? None if the interval leaves that open."""
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
        """Return the estimate as it is printed, as in `0.123 m [0.120, 0.126]`, with digits that follow the interval.

        An end that differs from the estimate by rounding errors only is written as the estimate is, and a number that
        is exactly zero as `0`. Without an interval the estimate stands alone, in three significant digits; so does an
        infinite estimate without a finite end.

        Args:
            unit: that is written behind the estimate.
            size: of the unit in SI units.
            signed: whether positive numbers have a sign.
            infinite: what stands for a number that is infinite.
            levels: numbers that an end is compared with; one that is not quite there has further digits, which show it.
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
        """The estimate without its interval."""
        return Interval(self.value, math.nan, math.nan)

    def percent(self) -> str:
        """Return a share as it is printed in per cent, with 0 and 100 % as levels; see `text`."""
        return self.text(unit="%", size=0.01, levels=(0.0, 1.0))

    def ratio(self) -> str:
        """Return a ratio as it is printed, with 0 and 1 as levels; see `text`."""
        return self.text(levels=(0.0, 1.0))

    def metres(self) -> str:
        """Return a length as it is printed in m; see `text`."""
        return self.text(unit="m")

    def millimetres(self) -> str:
        """Return a difference of lengths as it is printed in mm; see `text`."""
        return self.text(unit="mm", size=1e-3, signed=True)


def plus_minus(value: float, spread: float) -> str:
    """Return a number and its spread as they are printed, as in `0.123 ± 0.003`, with digits that follow the spread.

    Args:
        value: of the number.
        spread: half of a symmetric interval, or a standard deviation; it is rounded upwards.
    """
    decimals, exponent = _digits(Interval(value, value - spread, value + spread))
    number = _number(value, decimals, exponent, ROUND_HALF_EVEN)
    return f"{number} ± {_number(spread, decimals, exponent, ROUND_CEILING)}"


def spread_alone(spread: float) -> str:
    """Return a spread as it is printed without its number, as in `± 0.0032`, in two significant digits."""
    return f"± {_number(spread, *_digits(Interval(0.0, -spread, spread)), ROUND_CEILING)}"


def _digits(interval: Interval, levels: Sequence[float] = (0.0,)) -> tuple[int, int]:
    """The fewest decimals that tell the ends of an interval from the estimate and from levels, and a power of ten.

    The power of ten, by which the numbers are divided, is 0 if they are written without an exponent.
    """
    value, *ends = interval
    largest = max((abs(number) for number in interval if math.isfinite(number) and number), default=1.0)
    exponent = 0 if _MIN_PLAIN <= largest < _MAX_PLAIN else _magnitude(largest)
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
    """Estimate, lower and upper end in words."""
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
    """A number in words."""
    if math.isnan(number):
        return "–"
    if math.isinf(number):
        return infinite if number > 0.0 else "-∞"
    if number == 0.0:
        return "0"
    exact = Decimal(f"{number:.{_EXACT_DIGITS - 1}e}").scaleb(-exponent)
    rounded = exact.quantize(Decimal(1).scaleb(-decimals), rounding)
    # There is no negative zero.
    shown = f"{rounded or abs(rounded):{'+' if signed else ''}f}"
    return f"{shown}e{exponent:+03d}" if exponent else shown


def _magnitude(number: float) -> int:
    """The power of ten of the first digit of a positive number."""
    return math.floor(math.log10(number))


def _is_close(end: float, value: float, largest: float) -> bool:
    """Whether an end differs from the estimate by rounding errors only, given the largest number of the interval."""
    return end == value or abs(end - value) <= _ROUNDING * largest
