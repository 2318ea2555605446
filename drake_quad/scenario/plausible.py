"""Plausible ranges of fields in the scenario language, and the unit in which an implausible number was probably given.

A number outside the plausible range is accepted with a remark, since the language also describes unusual vehicles. The
ranges cover vehicles from 20 g to 20 kg, with a margin. They are declared in the field annotations. A mapping that
checks whether several fields are plausible in combination extends the method `implausible_fields`.
`drake_quad.flight.remarks` collects the remarks.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

# Standard gravity, m/s².
_STANDARD_GRAVITY = 9.80665


@dataclass(frozen=True)
class Plausible:
    """Plausible range of the numbers of a field, as metadata of its annotation.

    Attributes:
        unit: unit of the field.
        given_unit: unit in which an implausible number was probably given.
        factor: factor from `given_unit` to `unit`.
        lower: smallest plausible magnitude of a plain number.
        upper: largest plausible magnitude of a plain number or a distribution parameter.
    """

    unit: str
    given_unit: str
    factor: float
    lower: float = 0.0
    upper: float = math.inf

    def explain_implausibility(self, value: Any, period: float) -> str:
        """Return a clause that explains why a number or distribution is implausible; empty if it is plausible.

        Args:
            value: number or distribution.
            period: tick period of the mapping that contains the field, s. Delays are counted in these ticks.
        """
        numbers = [*numbers_in(value)]
        # The lower limit does not apply to distributions, since their standard deviation may be small.
        small = [number for number in numbers if isinstance(value, float) and abs(number) < self.lower]
        wrong = [*small, *(number for number in numbers if abs(number) > self.upper)]
        return self._clause(wrong[0]) if wrong else ""

    def _clause(self, number: float) -> str:
        unit = f" {self.unit}" if self.unit else ""
        converted = f"{number:g} {self.given_unit} {'is' if number == 1.0 else 'are'} {number * self.factor:.4g}{unit}"
        return f"is {number:g}{unit}, which is implausible; {converted}"


@dataclass(frozen=True)
class PlausibleDelay:
    """Plausible range of a field that counts a delay in ticks. A longer delay was probably given in ms.

    The range is part of the field's type, as in `Annotated[Number, PlausibleDelay(upper=0.3)]`.

    Attributes:
        upper: largest plausible product of delay and tick period, s.
    """

    upper: float

    def explain_implausibility(self, value: Any, period: float) -> str:
        """Return a clause that explains why a number of ticks is implausible; empty if it is plausible."""
        ticks = max(numbers_in(value), default=0.0)
        if ticks * period <= self.upper:
            return ""
        return (
            f"is {ticks:g}, a delay of {ticks * period:g} s, which is implausible; it is counted in periods of"
            f" {period:g} s, so {ticks:g} ms would be {1e-3 * ticks / period:.2g}"
        )


def not_in_milliseconds(*, upper: float) -> Plausible:
    """Return the plausible range of a time in s. A larger number was probably given in ms."""
    return Plausible("s", "ms", 1e-3, upper=upper)


def not_in_millimetres(*, upper: float) -> Plausible:
    """Return the plausible range of a length in m. A larger number was probably given in mm."""
    return Plausible("m", "mm", 1e-3, upper=upper)


def not_in_grams(*, upper: float) -> Plausible:
    """Return the plausible range of a mass in kg. A larger number was probably given in g."""
    return Plausible("kg", "g", 1e-3, upper=upper)


def not_in_percent(*, upper: float) -> Plausible:
    """Return the plausible range of a fraction. A larger number was probably given in percent."""
    return Plausible("", "%", 1e-2, upper=upper)


def not_in_degrees(*, upper: float) -> Plausible:
    """Return the plausible range of an angle in rad. A larger number was probably given in degrees."""
    return Plausible("rad", "degrees", math.radians(1.0), upper=upper)


def not_in_degrees_per_second(*, upper: float) -> Plausible:
    """Return the plausible range of a rate in rad/s. A larger number was probably given in degrees per second."""
    return Plausible("rad/s", "°/s", math.radians(1.0), upper=upper)


def not_in_rpm(*, upper: float) -> Plausible:
    """Return the plausible range of a rotor speed in rad/s. A larger number was probably given in rpm."""
    return Plausible("rad/s", "rpm", math.tau / 60.0, upper=upper)


def not_in_g(*, lower: float = 0.0, upper: float = math.inf, prefix: str = "") -> Plausible:
    """Return the plausible range of an acceleration in m/s². Other numbers were probably given in g or mg.

    Args:
        lower: smallest plausible magnitude, m/s².
        upper: largest plausible magnitude, m/s².
        prefix: prefix of the unit g, "m" for thousandths.
    """
    return Plausible("m/s²", f"{prefix}g", _STANDARD_GRAVITY * (1e-3 if prefix else 1.0), lower, upper)


PLAUSIBLE_DELAY = PlausibleDelay(upper=0.3)
"""Range of delays. Mobile networks have delays of 0.1 s, and few vehicles are stable with 0.2 s."""
PLAUSIBLE_RELATIVE_ERROR = not_in_percent(upper=1.0)
"""Range of relative errors, up to 100 %."""
PLAUSIBLE_LAG = not_in_milliseconds(upper=2.0)
"""Range of the lags of rotors, thrust and attitude, up to 2 s. Rotors of 20 kg vehicles have lags of about 0.3 s."""
PLAUSIBLE_POSITION_NOISE = not_in_millimetres(upper=0.3)
"""Range of position noise. Motion capture has a noise of 1 mm, and corrected satellite navigation one of 20 mm."""
PLAUSIBLE_ATTITUDE_NOISE = not_in_degrees(upper=0.2)
"""Range of attitude noise. Even attitudes from magnetometers are accurate to a few degrees, about 0.1 rad."""
PLAUSIBLE_SIZE = not_in_millimetres(upper=3.0)
"""Range of distances within a vehicle. The arms of 20 kg quadrotors are shorter than 1 m."""
PLAUSIBLE_LOAD = not_in_grams(upper=30.0)
"""Range of the mass of a load. A vehicle of 20 kg carries about its own mass."""
PLAUSIBLE_MAX_RATES = not_in_degrees_per_second(upper=60.0)
"""Range of limits on body rates. The firmware of racing quadrotors allows at most 2,000 °/s, or 35 rad/s."""


def numbers_in(value: Any) -> Iterator[float]:
    """Yield the finite numbers in a quantity, which may be a number, a list or a distribution.

    Correlations of a normal distribution are omitted, since they do not have the unit of the quantity.
    """
    if hasattr(value, "model_dump"):
        value = value.model_dump()
    if isinstance(value, dict):
        value = [each for name, each in value.items() if name != "shared"]
    if isinstance(value, list | tuple):
        for each in value:
            yield from numbers_in(each)
    elif isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        yield value
