"""Arithmetic and formatting of estimates with their intervals."""

from collections.abc import Iterable

from drake_quad.studies.statistics import Interval


def negative(estimate: Interval) -> Interval:
    """-x."""
    return Interval(-estimate.value, -estimate.high, -estimate.low)


def increase(ratio: Interval) -> Interval:
    """The share by which something grows to a ratio: x - 1."""
    return Interval(*(end - 1.0 for end in ratio))


def reduction(ratio: Interval) -> Interval:
    """The share by which something shrinks to a ratio: 1 - x."""
    return negative(increase(ratio))


def is_above(estimate: Interval, level: float) -> bool | None:
    """Is a number above a level? None if its interval leaves that open."""
    return True if estimate.low > level else False if estimate.high < level else None


def extremes(estimates: Iterable[Interval]) -> tuple[Interval, Interval]:
    """The smallest and the largest estimate."""
    ordered = sorted(estimates)
    return ordered[0], ordered[-1]


def percent(share: Interval) -> str:
    """A share and its interval in per cent, with a second digit where the first would not tell the ends apart."""
    digits = 1 if not share.high - share.low < 1e-3 else 2
    value, low, high = (f"{100.0 * each:.{digits}f}" for each in share)
    return f"{value} % [{low}, {high}]"


def percent_range(shares: Iterable[Interval]) -> str:
    """The smallest and the largest share, in per cent."""
    low, high = extremes(shares)
    return f"{percent(low)} to {percent(high)}"


def metres(length: Interval) -> str:
    """A length and its interval."""
    value, low, high = (f"{each:.3f}" for each in length)
    return f"{value} m [{low}, {high}]"


def millimetres(length: Interval) -> str:
    """A difference of lengths (m) and its interval, with signs."""
    value, low, high = (f"{1e3 * each:+.1f}" for each in length)
    return f"{value} mm [{low}, {high}]"


def bounded(estimate: Interval, digits: int) -> str:
    """A number and its interval."""
    value, low, high = (f"{each:.{digits}f}" for each in estimate)
    return f"{value} [{low}, {high}]"


def ratio(share: Interval) -> str:
    """A ratio and its interval."""
    return bounded(share, 2)
