"""Estimates with their confidence intervals: their arithmetic, and how they are written."""

import math
from typing import NamedTuple


class Interval(NamedTuple):
    """An estimate and its confidence interval; NaN or infinite where the samples do not bound it.

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

    def text(self, form: str, *, unit: str = "", size: float = 1.0, infinite: str = "–") -> str:
        """The estimate in words, as in `0.123 m [0.120, 0.126]`; without its interval if neither end is a number.

        Args:
            form: of the numbers, as Python's format has it.
            unit: that is written behind the value.
            size: of the unit in SI units.
            infinite: what stands for an infinite number.
        """

        def number(value: float) -> str:
            if math.isfinite(value):
                return f"{value / size:{form}}"
            return infinite if value > 0.0 else "–"

        if math.isnan(self.value):
            return "–"
        value = f"{number(self.value)} {unit}".rstrip()
        if not (math.isfinite(self.low) or math.isfinite(self.high)):
            return value
        return f"{value} [{number(self.low)}, {number(self.high)}]"

    def percent(self) -> str:
        """A share in per cent, with a second digit where the first would not tell the ends apart."""
        return self.text(".2f" if self.high - self.low < 1e-3 else ".1f", unit="%", size=0.01)

    def ratio(self) -> str:
        """A ratio."""
        return self.text(".2f")

    def metres(self) -> str:
        """A length."""
        return self.text(".3f", unit="m")

    def millimetres(self) -> str:
        """A difference of lengths."""
        return self.text("+.1f", unit="mm", size=1e-3)
