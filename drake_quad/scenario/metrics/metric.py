"""The decorator `metric`, which defines an additional metric, and the registry `METRICS`.

A metric is a function of signals at one tick, and a rule that combines its values over time:

    @metric("m", over_time="max")
    def height_loss(state, reference, *, tolerance: float = 0.0):
        '''Largest height below the reference, beyond a tolerance.'''
        return reference.z - state.z - tolerance

The arguments are signals, named after their ports, and `ticks` (number of earlier ticks), `time` (s) and `period` (s),
the duration of a tick. The function is a formula: it is
compiled with the rest of the diagram, and computes the metric for all vehicles of a fleet. Keyword-only arguments are
settings of the metric in a scenario. They must have a default, and are finite numbers unless their annotation is
another type, such as a type of `drake_quad.scenario.quantities`.

Each rule is also a kind of metric for scalar signals (`drake_quad.laboratory.derived_signals`), as in
`{kind: max, of: state.z}`.

A metric that no rule in `REDUCTIONS` can compute has three parts: a named tuple with its sums before the first tick, a
formula that adds a tick to the sums, and a function that computes the metric from the final sums:

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
from abc import abstractmethod
from collections.abc import Callable
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, cast, get_args, get_type_hints

import numpy as np
from pydantic import create_model

from drake_quad.errors import join_names
from drake_quad.framework.elementary import maximum, minimum
from drake_quad.laboratory.metrics import CENTIMETRES, Accumulator, Display, Metric, ValueRange, argument_names
from drake_quad.scenario.distributions import Model, Real
from drake_quad.scenario.unions import OpenUnion
from drake_quad.signals import Row

_Function = TypeVar("_Function", bound=Callable[..., Any])


class MetricSettings(Model):
    """Additional metric."""

    kind: str

    @abstractmethod
    def definition(self, name: str, scenario: Any) -> Metric:
        """Return the definition of the metric, given its name in a scenario."""


METRICS = OpenUnion(MetricSettings)
"""Registry of the kinds of additional metrics."""

AnyMetric = Annotated[MetricSettings, METRICS]


class ValueSums(NamedTuple):
    """Intermediate result of a `Reduction`, such as the sum of the values up to a tick."""

    value: Row


class Reduction(NamedTuple):
    """Rule that combines the values at the ticks of a flight.

    Attributes:
        initial: intermediate result before the first tick.
        add: formula that returns the intermediate result after a tick, given the result before the tick, the value at
            the tick, and the tick duration, s.
        value: function that computes the metric, given the final result and the number of ticks.
        differentiable: True if the metric is a differentiable function of the values.
        is_nonnegative: True if the metric cannot be negative, even for negative values.
        can_exceed_values: True if the metric can exceed the largest value.
    """

    initial: float
    add: Callable[[Row, Row, float], Row]
    value: Callable[[Any, Any], Any]
    differentiable: bool = True
    is_nonnegative: bool = False
    can_exceed_values: bool = False

    def value_range_of(self, values: ValueRange) -> ValueRange:
        """Return the range of the metric, given the range of the values."""
        if (self.is_nonnegative and values == "real") or (self.can_exceed_values and values == "fraction"):
            return "nonnegative"
        return values


def _nan_without_ticks(result: Any, ticks: Any) -> Any:
    """Return the final result, or NaN if there are no ticks."""
    return result * np.where(ticks > 0.0, 1.0, np.nan)


REDUCTIONS = {
    "mean": Reduction(0.0, lambda result, value, _: result + value, lambda result, ticks: result / ticks),
    "rms": Reduction(
        0.0,
        lambda result, value, _: result + value * value,
        lambda result, ticks: np.sqrt(result / ticks),
        is_nonnegative=True,
    ),
    "max": Reduction(
        -math.inf, lambda result, value, _: maximum(result, value), _nan_without_ticks, differentiable=False
    ),
    "min": Reduction(
        math.inf, lambda result, value, _: minimum(result, value), _nan_without_ticks, differentiable=False
    ),
    "last": Reduction(0.0, lambda _, value, __: value + 0.0, _nan_without_ticks),
    "integral": Reduction(
        0.0, lambda result, value, period: result + value * period, _nan_without_ticks, can_exceed_values=True
    ),
}
"""Rules that combine the values at the ticks of a flight."""


def add_reduced(
    sums: ValueSums,
    period: float,
    *signals: Any,
    formula: Callable[..., Row],
    rule: str,
    settings: tuple[Any, ...],
) -> ValueSums:
    """Return the intermediate result of a rule after a tick.

    Args:
        sums: intermediate result before the tick.
        period: duration of a tick, s.
        signals: signals at the tick.
        formula: formula that computes a value from the signals.
        rule: name of the rule in `REDUCTIONS`.
        settings: keyword arguments of the formula, as pairs of name and value.
    """
    return ValueSums(REDUCTIONS[rule].add(sums.value, formula(*signals, **dict(settings)), period))


def _value_of(rule: str) -> Callable[[ValueSums, Any, float], Any]:
    """Return the function that computes a metric from the final result of a rule."""
    return lambda sums, ticks, _: REDUCTIONS[rule].value(sums.value, ticks)


_VALUE_FUNCTIONS = {rule: _value_of(rule) for rule in REDUCTIONS}
# Default table format of a metric, by unit.
_DEFAULT_DISPLAYS = {"m": CENTIMETRES, "1": Display("%", 0.01, 1), "rad": Display("°", math.radians(1.0), 1)}


class Appearance(NamedTuple):
    """Properties of a metric that do not affect its value.

    Attributes:
        unit: unit of the metric; "1" for a dimensionless metric, which is shown in per cent.
        label: label in tables and plots; by default the name of the metric in the scenario.
        display: format in tables. By default, a length is shown in cm, an angle in degrees, a fraction in per cent, and
            any other metric with three digits.
        larger_is_better: True if a larger metric is better.
        value_range: range of the metric.
    """

    unit: str
    label: str = ""
    display: Display | None = None
    larger_is_better: bool = False
    value_range: ValueRange = "real"

    def metric(
        self,
        name: str,
        accumulator: Accumulator | None,
        value: Callable[..., Any],
        *,
        differentiable: bool = False,
    ) -> Metric:
        """Return the definition of the metric, given its name in the scenario."""
        return Metric(
            self.unit,
            self.label or name.replace("_", " "),
            accumulator,
            value,
            self.display or _DEFAULT_DISPLAYS.get(self.unit, Display(self.unit, 1.0, 3)),
            differentiable=differentiable,
            larger_is_better=self.larger_is_better,
            value_range=self.value_range,
        )


def reduced_metric(
    name: str,
    rule: str,
    formula: Callable[..., Row],
    arguments: tuple[str, ...],
    appearance: Appearance,
    settings: tuple[tuple[str, Any], ...] = (),
) -> Metric:
    """Return the definition of a metric that combines the values of a formula at the ticks.

    Args:
        name: name of the metric in the scenario.
        rule: name of the rule in `REDUCTIONS`.
        formula: formula that computes the value at a tick.
        arguments: names of the arguments of the formula.
        appearance: unit and label of the metric.
        settings: keyword arguments of the formula, as pairs of name and value.
    """
    constants = ("formula", formula), ("rule", rule), ("settings", settings)
    reduction = REDUCTIONS[rule]
    appearance = appearance._replace(value_range=reduction.value_range_of(appearance.value_range))
    accumulator = Accumulator(ValueSums(reduction.initial), add_reduced, ("period", *arguments), constants)
    return appearance.metric(name, accumulator, _VALUE_FUNCTIONS[rule], differentiable=reduction.differentiable)


def metric(
    unit: str,
    *,
    over_time: str | None = None,
    initial: Any = None,
    value: Callable[[Any, Any, float], Any] | None = None,
    label: str = "",
    display: Display | None = None,
    larger_is_better: bool = False,
    value_range: ValueRange = "real",
) -> Callable[[_Function], _Function]:
    """Return a decorator that registers a formula as a kind of metric, named after the function.

    Args:
        unit: unit of the metric; "1" for a dimensionless metric, which is shown in per cent.
        over_time: name of the rule in `REDUCTIONS` that combines the values of the formula.
        initial: named tuple of sums before the first tick, if no rule is given. The first argument of the formula is
            then this named tuple.
        value: function that computes the metric, given the final sums, the number of ticks (NaN if there are none),
            and the duration of a tick, s. It requires `initial`.
        label: label in tables and plots; by default the name of the metric in the scenario.
        display: format in tables; see `Appearance`.
        larger_is_better: True if a larger metric is better.
        value_range: range of the metric: "nonnegative" or "fraction" (between 0 and 1) if it cannot be any number.
            Confidence intervals do not extend beyond the range. Comparisons report ratios only of metrics that cannot
            be negative.

    Raises:
        TypeError: if neither a rule nor sums are given, the range is unknown, or an argument of the function cannot be
            used.
    """
    if (over_time is None) == (initial is None) or (initial is None) != (value is None):
        raise TypeError("a metric needs either over_time, or initial and value")
    if over_time is not None and over_time not in REDUCTIONS:
        raise TypeError(f"over_time is {over_time!r}, but must be one of {join_names([*REDUCTIONS])}")
    appearance = _checked_appearance(unit, label, display, larger_is_better, value_range)

    def register(function: _Function) -> _Function:
        names = argument_names(function, after_sums=over_time is None)

        def definition(self: MetricSettings, name: str, _scenario: Any) -> Metric:
            settings = _settings_values(self)
            if over_time is not None:
                return reduced_metric(name, over_time, function, names, appearance, settings)
            accumulator = Accumulator(initial, function, names, settings)
            return appearance.metric(name, accumulator, cast(Callable[..., Any], value))

        return _registered(function, definition)

    return register


def flight_metric(
    unit: str,
    *,
    label: str = "",
    display: Display | None = None,
    larger_is_better: bool = False,
    value_range: ValueRange = "real",
) -> Callable[[_Function], _Function]:
    """Return a decorator that registers a function of a recorded flight as a kind of metric.

    The function receives a `drake_quad.Flight` and returns a number. Keyword-only arguments are settings, as for
    `metric`. A study must record signals for such a metric, so it needs more time and memory than with a formula.

    Args:
        unit: unit of the metric; "1" for a dimensionless metric, which is shown in per cent.
        label: label in tables and plots; by default the name of the metric in the scenario.
        display: format in tables; see `Appearance`.
        larger_is_better: True if a larger metric is better.
        value_range: range of the metric; see `metric`.

    Raises:
        TypeError: if the range is unknown, or an argument of the function cannot be used.
    """
    appearance = _checked_appearance(unit, label, display, larger_is_better, value_range)

    def register(function: _Function) -> _Function:
        def definition(self: MetricSettings, name: str, _scenario: Any) -> Metric:
            value = cast(Callable[..., Any], FlightFunction(function, _settings_values(self)))
            return appearance.metric(name, None, value)

        return _registered(function, definition)

    return register


def _checked_appearance(
    unit: str, label: str, display: Display | None, larger_is_better: bool, value_range: ValueRange
) -> Appearance:
    """Return the appearance of a metric, such as its unit and its label.

    Raises:
        TypeError: if the range is unknown.
    """
    if value_range not in get_args(ValueRange):
        raise TypeError(f"value_range is {value_range!r}, but must be one of {join_names([*get_args(ValueRange)])}")
    return Appearance(unit, label, display, larger_is_better, value_range)


class FlightFunction(NamedTuple):
    """Function of a flight, together with its settings.

    Attributes:
        function: function that computes a number from a flight.
        settings: keyword arguments of the function, as pairs of name and value.
    """

    function: Callable[..., Any]
    settings: tuple[tuple[str, Any], ...]

    def __call__(self, flight: Any) -> Any:
        """Call the function with a flight."""
        return self.function(flight, **dict(self.settings))


def _settings_values(settings: MetricSettings) -> tuple[tuple[str, Any], ...]:
    """Return the settings that a scenario gives for a metric, as pairs of name and value."""
    return tuple((field, getattr(settings, field)) for field in type(settings).model_fields if field != "kind")


def _registered(function: _Function, definition: Callable[..., Metric]) -> _Function:
    """Register a kind of metric, named after a function, and return the function."""
    model = create_model(
        "".join(map(str.capitalize, function.__name__.split("_"))),
        __base__=_base_class_with(definition),
        __module__=function.__module__,
        __doc__=inspect.getdoc(function),
        kind=(Literal[function.__name__], ...),  # type: ignore[arg-type]
        **_setting_fields(function),
    )
    # Pickle looks the class up as an attribute of the function.
    model.__qualname__ = f"{function.__qualname__}.settings"
    function.settings = METRICS.register(model)  # type: ignore[attr-defined, type-var]
    return function


def _base_class_with(definition: Callable[..., Metric]) -> type[MetricSettings]:
    """Return a subclass of `MetricSettings` with the given method `definition`."""
    return type("FormulaMetric", (MetricSettings,), {"definition": definition, "__module__": __name__})


def _setting_fields(function: Callable[..., Any]) -> dict[str, Any]:
    """Return the fields of a metric's settings: type and default of each keyword-only argument of its function.

    Raises:
        TypeError: if a keyword-only argument has no default, or the function has positional-only or variadic arguments.
    """
    fields: dict[str, Any] = {}
    hints = get_type_hints(function, include_extras=True)
    for name, parameter in inspect.signature(function).parameters.items():
        if parameter.kind == parameter.KEYWORD_ONLY:
            if parameter.default is parameter.empty:
                raise TypeError(f"the argument {name} of {function.__name__} must have a default")
            fields[name] = (hints.get(name, Real), parameter.default)
        elif parameter.kind != parameter.POSITIONAL_OR_KEYWORD:
            raise TypeError(f"{function.__name__} must name its signals instead of using *{name}")
    return fields
