"""Requirements on a flight in signal temporal logic, with their robustness.

A condition holds while a scalar signal is below or above a bound. Its margin μ(t) is the distance of the signal from
the bound, positive while the condition holds. The margin of several conditions is the smallest margin if all must hold,
and the largest if one is sufficient. The robustness of a requirement over the times a ≤ t ≤ b is

    always φ           min μ(t)
    eventually φ       max μ(t)
    φ until ψ          max over t of min(μ_ψ(t), min of μ_φ(t') over the times 0 ≤ t' < t)

(A. Donzé and O. Maler, "Robust satisfaction of temporal logic over real-valued signals", FORMATS 2010). A requirement
is satisfied if its robustness is at least 0. If all signals change by less than the magnitude of the robustness, the
verdict remains the same. Times are control ticks.
"""

import math
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from drake_quad.framework.elementary import maximum, minimum, where
from drake_quad.laboratory.metrics import Accumulator
from drake_quad.signals import Row


class Bound(NamedTuple):
    """Condition that a scalar signal is within bounds.

    Attributes:
        formula: formula of the scalar signal.
        arguments: names of the arguments of the formula.
        lower: lower bound; negative infinity for none.
        upper: upper bound; infinity for none.
    """

    formula: Callable[..., Row]
    arguments: tuple[str, ...]
    lower: float
    upper: float

    def margin(self, values: dict[str, Any]) -> Row:
        """Return the distance of the signal from the nearest bound, negative if the bound is exceeded."""
        value = self.formula(*[values[name] for name in self.arguments])
        if self.lower == -math.inf:
            return self.upper - value
        if self.upper == math.inf:
            return value - self.lower
        return minimum(self.upper - value, value - self.lower)


class Combination(NamedTuple):
    """Combination of conditions.

    Attributes:
        rule: "all" if all conditions must hold, "any" if one is sufficient.
        conditions: conditions.
    """

    rule: Literal["all", "any"]
    conditions: tuple["Condition", ...]

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arguments of all formulas."""
        return tuple(dict.fromkeys(name for each in self.conditions for name in each.arguments))

    def margin(self, values: dict[str, Any]) -> Row:
        """Return the margin of the combination, which follows from the margins of its conditions."""
        first, *others = [each.margin(values) for each in self.conditions]
        for other in others:
            first = minimum(first, other) if self.rule == "all" else maximum(first, other)
        return first


Condition = Bound | Combination


class RobustnessSums(NamedTuple):
    """Robustness of a requirement so far.

    Attributes:
        value: robustness; infinite before the first tick of the time window.
        held: for `until`, the smallest margin so far of the condition that must hold until the other one holds.
    """

    value: Row
    held: Row = math.inf


def add_always(
    sums: RobustnessSums,
    time: Row,
    *signals: Any,
    condition: Condition,
    names: tuple[str, ...],
    start: float,
    end: float,
) -> RobustnessSums:
    """Return the robustness of `always` after a tick.

    Args:
        sums: robustness before the tick.
        time: time of the tick, s.
        signals: signals at the tick.
        condition: condition that must hold.
        names: names of the signals.
        start: start of the time window, s.
        end: end of the time window, s.
    """
    margin = condition.margin(dict(zip(names, signals, strict=True)))
    return RobustnessSums(where(_is_within(time, start, end), minimum(sums.value, margin), sums.value), sums.held)


def add_eventually(
    sums: RobustnessSums,
    time: Row,
    *signals: Any,
    condition: Condition,
    names: tuple[str, ...],
    start: float,
    end: float,
) -> RobustnessSums:
    """Return the robustness of `eventually` after a tick; the arguments are as in `add_always`."""
    margin = condition.margin(dict(zip(names, signals, strict=True)))
    return RobustnessSums(where(_is_within(time, start, end), maximum(sums.value, margin), sums.value), sums.held)


def add_until(
    sums: RobustnessSums,
    time: Row,
    *signals: Any,
    condition: Condition,
    until: Condition,
    names: tuple[str, ...],
    start: float,
    end: float,
) -> RobustnessSums:
    """Return the robustness of `until` after a tick; the arguments are as in `add_always`."""
    values = dict(zip(names, signals, strict=True))
    reached = maximum(sums.value, minimum(sums.held, until.margin(values)))
    held = minimum(sums.held, condition.margin(values))
    return RobustnessSums(where(_is_within(time, start, end), reached, sums.value), held)


def _is_within(time: Row, start: float, end: float) -> bool:
    return (time >= start) & (time <= end)


def robustness(sums: RobustnessSums, ticks: Any, _: float) -> Any:
    """Return the robustness of a requirement; NaN if no tick was in its time window."""
    return np.where((sums.value == math.inf) | (sums.value == -math.inf), np.nan, sums.value)


def always(condition: Condition, start: float, end: float) -> Accumulator:
    """Return the accumulator for the robustness of an `always` requirement."""
    return _accumulator(math.inf, add_always, start, end, condition=condition)


def eventually(condition: Condition, start: float, end: float) -> Accumulator:
    """Return the accumulator for the robustness of an `eventually` requirement."""
    return _accumulator(-math.inf, add_eventually, start, end, condition=condition)


def holds_until(condition: Condition, until: Condition, start: float, end: float) -> Accumulator:
    """Return the accumulator for an `until` requirement: a condition must hold until another condition holds."""
    return _accumulator(-math.inf, add_until, start, end, condition=condition, until=until)


def _accumulator(
    initial: float, add: Callable[..., Any], start: float, end: float, **conditions: Condition
) -> Accumulator:
    names = tuple(dict.fromkeys(name for condition in conditions.values() for name in condition.arguments))
    constants = {**conditions, "names": names, "start": start, "end": end}
    return Accumulator(RobustnessSums(initial), add, ("time", *names), tuple(constants.items()), whole_flight=True)
