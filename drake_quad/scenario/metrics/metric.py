"""The decorator `metric`, which defines an additional metric, and the registry `METRICS`.

A metric is a function of signals at one tick, and a rule that combines its values over time:

    @metric("rad", over_time="max")
    def largest_tilt(state):
        '''Largest angle between the thrust axis and the vertical.'''
        return elementary.acos(elementary.cos(state.roll) * elementary.cos(state.pitch))

The arguments are signals by the names of their ports, `time` (s) and `period` (s). The function is a formula: it is
compiled with the rest of the diagram, and computes the metric for all vehicles of a fleet. Keyword-only arguments are
settings of the metric in a scenario. They must be annotated with a type of `drake_quad.scenario.quantities`, and have a
default.

A metric that needs other sums than those of the rules in `REDUCTIONS` is given by the record of its sums before the
first tick, the formula that adds a tick, and the function that computes the metric from the final sums:

    class Distance(NamedTuple):
        x: float = 0.0
        length: float = 0.0

    @metric("m", initial=Distance(), value=lambda sums, ticks, period: sums.length)
    def distance_along_x(sums, state, ticks):
        '''Distance flown along X.'''
        step = where(ticks > 0.0, abs(state.x - sums.x), 0.0)
        return Distance(state.x, sums.length + step)
"""

import inspect
import math
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeVar, cast, get_type_hints

import numpy as np
from pydantic import create_model

from drake_quad.errors import listed
from drake_quad.framework.elementary import maximum, minimum, where
from drake_quad.laboratory.metrics import CENTIMETRES, Accumulator, Display, Metric, argument_names
from drake_quad.scenario.distributions import Model, Real
from drake_quad.scenario.unions import OpenUnion
from drake_quad.signals import Row

_Function = TypeVar("_Function", bound=Callable[..., Any])


class MetricSettings(Model):
    """Additional metric.

    Attributes:
        unit: unit of the metric, "1" for a fraction between 0 and 1.
        label: label in tables and plots; by default the name of the metric in the scenario.
        display: format in tables.
        differentiable: True if the metric is a differentiable function of the trajectory.
        larger_is_better: True if a larger metric is better.
        initial: record of the sums before the first tick.
        add: formula that adds a tick to the sums.
        arguments: names of the other arguments of this formula, see `drake_quad.laboratory.metrics.Accumulator`.
        value: function that computes the metric from the sums, see `drake_quad.laboratory.metrics.Metric`.
    """

    kind: str
    unit: ClassVar[str]
    label: ClassVar[str]
    display: ClassVar[Display]
    differentiable: ClassVar[bool]
    larger_is_better: ClassVar[bool]
    initial: ClassVar[Any]
    add: ClassVar[Callable[..., Any]]
    arguments: ClassVar[tuple[str, ...]]
    value: ClassVar[Callable[..., Any]]

    def constants(self, scenario: Any) -> dict[str, Any]:
        """Return the keyword arguments of the formula, given the scenario; by default the settings of the metric."""
        return {field: getattr(self, field) for field in type(self).model_fields if field != "kind"}

    def definition(self, name: str, scenario: Any) -> Metric:
        """Return the definition of the metric, given its name in a scenario."""
        constants = tuple(self.constants(scenario).items())
        accumulator = Accumulator(self.initial, type(self).add, self.arguments, constants)
        label = self.label or name.replace("_", " ")
        return Metric(
            self.unit,
            label,
            accumulator,
            type(self).value,
            self.display,
            self.differentiable,
            signed=True,
            larger_is_better=self.larger_is_better,
        )


METRICS = OpenUnion(MetricSettings)
"""Registry of the kinds of additional metrics."""

AnyMetric = Annotated[MetricSettings, METRICS]


class ValueSums(NamedTuple):
    """Value that a rule has computed so far from the values of a metric at the ticks."""

    value: Row


class Reduction(NamedTuple):
    """Rule that combines the values of a metric at the ticks of a flight.

    Attributes:
        initial: result before the first tick.
        add: formula that returns the result after a tick, given the result before, the value at the tick, and the
            duration of a tick, s.
        value: function that computes the metric from the final result and the number of ticks.
        differentiable: True if the metric is a differentiable function of the values.
    """

    initial: float
    add: Callable[[Row, Row, float], Row]
    value: Callable[[Any, Any], Any]
    differentiable: bool = True


def _if_any(result: Any, ticks: Any) -> Any:
    """Return the result, or NaN if there are no ticks."""
    return result * np.where(ticks > 0.0, 1.0, np.nan)


REDUCTIONS = {
    "mean": Reduction(0.0, lambda result, value, _: result + value, lambda result, ticks: result / ticks),
    "rms": Reduction(
        0.0, lambda result, value, _: result + value * value, lambda result, ticks: np.sqrt(result / ticks)
    ),
    "max": Reduction(-math.inf, lambda result, value, _: maximum(result, value), _if_any, differentiable=False),
    "min": Reduction(math.inf, lambda result, value, _: minimum(result, value), _if_any, differentiable=False),
    "last": Reduction(0.0, lambda _, value, __: value + 0.0, _if_any),
    "integral": Reduction(0.0, lambda result, value, period: result + value * period, _if_any),
    "share": Reduction(
        0.0,
        lambda result, value, _: result + where(value, 1.0, 0.0),  # type: ignore[arg-type]
        lambda result, ticks: result / ticks,
        differentiable=False,
    ),
}
"""Rules that combine values over time. `share` is the fraction of the ticks at which a condition holds."""

# Formats of metrics in tables, by unit.
_DISPLAYS = {"m": CENTIMETRES, "1": Display("%", 0.01, 1), "rad": Display("°", math.radians(1.0), 1)}


def metric(
    unit: str,
    *,
    over_time: str | None = None,
    initial: Any = None,
    value: Callable[[Any, Any, float], Any] | None = None,
    label: str = "",
    display: Display | None = None,
    larger_is_better: bool = False,
) -> Callable[[_Function], _Function]:
    """Return a decorator that registers a formula as a kind of metric, under the name of the function.

    Args:
        unit: unit of the metric; "1" for a fraction between 0 and 1.
        over_time: name of the rule in `REDUCTIONS` that combines the values of the formula.
        initial: record of the sums before the first tick, if no rule is given. The first argument of the formula is
            then the record of the sums.
        value: function that computes the metric from the final sums, the number of ticks, which is NaN instead of 0,
            and the duration of a tick, s; only with `initial`.
        label: label in tables and plots; by default the name of the metric in the scenario.
        larger_is_better: True if a larger metric is better.
        display: format in tables; by default in cm, degrees or per cent for a length, an angle or a fraction, else with
            three digits.

    Raises:
        TypeError: if neither a rule nor sums are given, or an argument of the function cannot be used.
    """
    if (over_time is None) == (initial is None) or (initial is None) != (value is None):
        raise TypeError("a metric needs either over_time, or initial and value")
    if over_time is not None and over_time not in REDUCTIONS:
        raise TypeError(f"over_time is {over_time!r}, but must be one of {listed([*REDUCTIONS])}")
    chosen_display = display or _DISPLAYS.get(unit, Display(unit, 1.0, 3))

    def register(function: _Function) -> _Function:
        members: dict[str, Any] = {"unit": unit, "label": label, "display": chosen_display}
        members["larger_is_better"] = larger_is_better
        if over_time is None:
            arguments = argument_names(function)[1:]
            members |= {
                "initial": initial,
                "add": staticmethod(function),
                "value": staticmethod(cast(Callable[..., Any], value)),
            }
            members |= {"arguments": arguments, "differentiable": False}
        else:
            members |= _reduced(function, REDUCTIONS[over_time])
        model = create_model(
            "".join(map(str.capitalize, function.__name__.split("_"))),
            __base__=MetricSettings,
            __module__=function.__module__,
            __doc__=inspect.getdoc(function),
            kind=(Literal[function.__name__], ...),  # type: ignore[arg-type]
            **_settings_of(function),
        )
        for name, member in members.items():
            setattr(model, name, member)
        # Pickle finds the class as an attribute of the function.
        model.__qualname__ = f"{function.__qualname__}.settings"
        function.settings = METRICS.member(model)  # type: ignore[attr-defined]
        return function

    return register


def _reduced(function: Callable[..., Any], rule: Reduction) -> dict[str, Any]:
    """Return the members of the class of a metric whose values are combined by a rule."""

    def add(sums: ValueSums, period: float, *signals: Any, **settings: Any) -> ValueSums:
        return ValueSums(rule.add(sums.value, function(*signals, **settings), period))

    def value(sums: ValueSums, ticks: Any, _: float) -> Any:
        return rule.value(sums.value, ticks)

    return {
        "initial": ValueSums(rule.initial),
        "add": staticmethod(add),
        "arguments": ("period", *argument_names(function)),
        "value": staticmethod(value),
        "differentiable": rule.differentiable,
    }


def _settings_of(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the fields of a metric in a scenario: type and default of each keyword-only argument of its function.

    Raises:
        TypeError: if an argument has no default, or another argument has a name that no argument may have.
    """
    fields: dict[str, Any] = {}
    hints = get_type_hints(function, include_extras=True)
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.kind == parameter.KEYWORD_ONLY:
            if parameter.default is parameter.empty:
                raise TypeError(f"the argument {name} of {function.__name__} must have a default")
            fields[name] = (hints.get(name, Real), parameter.default)
        elif parameter.kind != parameter.POSITIONAL_OR_KEYWORD:
            raise TypeError(f"{function.__name__} must name its signals, in place of *{name}")
    return fields
