"""Metrics of a flight, and the sums over its ticks from which they are computed.

For a tick k of n, with the position error e_k and the commanded acceleration u_k of each axis:

    RMSE of an axis        √(Σ e_k² / n)
    RMSE                   √(Σ |e_k|² / n), of the Euclidean error
    peak                   max |e_k|
    control effort         Σ u_k² / n, m²/s⁴
    total variation        Σ |u_k - u_{k-1}| / (duration of n - 1 ticks), m/s² per second
    saturated fraction     fraction of the ticks at which the rotors of the nominal model cannot produce the wrench

The sums include the ticks in the metric window of the scenario, up to a crash.

A metric has two parts: an `Accumulator`, whose formula adds a tick to a record of sums, and a function that computes
the metric from the final sums. Metrics that are computed from the same sums share an accumulator.
"""

import functools
import inspect
import math
from collections import namedtuple
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Annotated, Any, Literal, NamedTuple, get_args, get_type_hints

import numpy as np

from drake_quad.errors import InputError
from drake_quad.framework.elementary import maximum, minimum, where
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.signals import Acceleration, Quantity, Reference, Row, State, Wrench

ValueRange = Literal["real", "nonnegative", "fraction"]
"""Numbers that a metric or a signal can be: all real numbers, those from 0 on, or those from 0 to 1."""

_LIMITS_OF_RANGES: dict[ValueRange, tuple[float, float]] = {
    "real": (-math.inf, math.inf),
    "nonnegative": (0.0, math.inf),
    "fraction": (0.0, 1.0),
}
_ROUNDING_TOLERANCE = 1e-9  # a value beyond its limits by less than this is attributed to rounding

TIME_ARGUMENTS = ("ticks", "time", "period")
"""Arguments of an accumulator that are not signals: number of earlier ticks, time (s), and duration of a tick (s)."""


class Accumulator(NamedTuple):
    """Sums over the ticks of a flight.

    Attributes:
        initial: record of the sums before the first tick.
        add: formula that returns the sums after a further tick. Its first argument is the record of the sums. The other
            arguments have the names of signals, or the names in `TIME_ARGUMENTS`.
        arguments: names of these other arguments.
        constants: keyword arguments of the formula, as pairs of name and value.
        whole_flight: True to add all ticks, False to add the ticks in the metric window.
    """

    initial: Any
    add: Callable[..., Any]
    arguments: tuple[str, ...]
    constants: tuple[tuple[str, Any], ...] = ()
    whole_flight: bool = False

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals that the formula reads."""
        return tuple(name for name in self.arguments if name not in TIME_ARGUMENTS)


def argument_names(formula: Callable[..., Any], *, after_sums: bool = False) -> tuple[str, ...]:
    """Return the argument names of a formula, without its keyword-only arguments.

    Args:
        formula: formula.
        after_sums: True to omit the first argument, which is the record of the sums.
    """
    first, *others = inspect.signature(formula).parameters.values()
    parameters = others if after_sums else [first, *others]
    return tuple(parameter.name for parameter in parameters if parameter.kind != parameter.KEYWORD_ONLY)


def _accumulator(initial: Any, add: Callable[..., Any]) -> Accumulator:
    return Accumulator(initial, add, argument_names(add, after_sums=True))


class Sums(NamedTuple):
    """Sums over the ticks of a flight.

    Attributes:
        ticks: number of ticks.
        records: record of the sums of each accumulator.
    """

    ticks: Row
    records: tuple[Any, ...]

    @classmethod
    def before(cls, accumulators: Sequence[Accumulator]) -> "Sums":
        """Return the sums before the first tick."""
        return cls(0.0, tuple([accumulator.initial for accumulator in accumulators]))


def add_tick(
    sums: Sums, accumulators: Sequence[Accumulator], values: Mapping[str, Any], flies: bool, counts: bool
) -> Sums:
    """Return the sums after one more tick.

    Args:
        sums: sums before the tick.
        accumulators: accumulator of each record in `sums`, in the same order.
        values: records of the signals, time and period, by name.
        flies: True if the vehicle has not crashed.
        counts: True if the tick is in the metric window.
    """
    values_by_name, counts = {**values, "ticks": sums.ticks}, flies & counts
    records = []
    for accumulator, record in zip(accumulators, sums.records, strict=True):
        arguments = [values_by_name[name] for name in accumulator.arguments]
        after = accumulator.add(record, *arguments, **dict(accumulator.constants))
        records.append(where(flies if accumulator.whole_flight else counts, after, record))
    return Sums(where(counts, sums.ticks + 1.0, sums.ticks), tuple(records))


class Display(NamedTuple):
    """Format of a metric in tables.

    Attributes:
        unit: unit that is printed.
        size: size of the printed unit, expressed in the metric's unit; for example 0.01 if a length in m is printed in
            cm.
        digits: number of digits after the decimal point, for one flight.
    """

    unit: str
    size: float
    digits: int


class Metric(NamedTuple):
    """Definition of a metric.

    Attributes:
        unit: unit; "1" for a dimensionless metric.
        label: label in tables and plots.
        accumulator: sums from which the metric is computed; None for a metric of a recorded flight.
        value: function that returns the (N,) values of the metric. Its arguments are the record of the sums with (N,)
            values, the (N,) numbers of ticks, which are NaN instead of 0, and the duration of a tick, s. For a metric
            of a recorded flight, the function returns the metric of a flight.
        display: format in tables; None if tables omit the metric.
        differentiable: True if the metric is a differentiable function of the trajectory.
        value_range: range of the metric. Intervals do not extend beyond it, and only metrics that cannot be negative
            have ratios and logarithmic axes.
        larger_is_better: True if a larger metric is better. A crash counts as worse than any value.
    """

    unit: str
    label: str
    accumulator: Accumulator | None
    value: Callable[..., Any]
    display: Display | None = None
    differentiable: bool = True
    value_range: ValueRange = "real"
    larger_is_better: bool = False

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals whose sums determine the metric."""
        return () if self.accumulator is None else self.accumulator.signals

    @property
    def is_nonnegative(self) -> bool:
        """True if the metric cannot be negative."""
        return self.value_range != "real"

    @property
    def value_of_crash(self) -> float:
        """Infinite value that replaces the metric of a crashed flight in quantiles and comparisons."""
        return -math.inf if self.larger_is_better else math.inf

    @property
    def infinities_with_crash(self) -> tuple[str, str]:
        """Texts that replace negative and positive infinity if only a crash can cause an infinite value."""
        return ("crash", "∞") if self.larger_is_better else ("-∞", "crash")


_ZERO_ON_EACH_AXIS = PerAxis(0.0, 0.0, 0.0)


class ErrorSums(NamedTuple):
    """Largest and summed squares of the position error.

    Attributes:
        peak: max |e|², m².
        squares: Σ e², m².
    """

    peak: Row = 0.0
    squares: PerAxis = _ZERO_ON_EACH_AXIS


def add_error(sums: ErrorSums, state: State, reference: Reference) -> ErrorSums:
    """Return the sums after the position error of a tick has been added."""
    e_x, e_y, e_z = reference.x - state.x, reference.y - state.y, reference.z - state.z
    x, y, z = e_x * e_x, e_y * e_y, e_z * e_z
    squares = sums.squares
    return ErrorSums(maximum(sums.peak, x + y + z), PerAxis(squares.x + x, squares.y + y, squares.z + z))


class CommandSums(NamedTuple):
    """Sums of the commanded acceleration.

    Attributes:
        effort: Σ u², m²/s⁴.
        variation: Σ |Δu|, m/s².
        last: u of the previous tick, m/s².
    """

    effort: PerAxis = _ZERO_ON_EACH_AXIS
    variation: PerAxis = _ZERO_ON_EACH_AXIS
    last: PerAxis = _ZERO_ON_EACH_AXIS


def add_command(sums: CommandSums, acceleration_command: Acceleration, ticks: Row) -> CommandSums:
    """Add the command of a tick. The change of the command is zero at the first tick."""
    started = minimum(ticks, 1.0)
    changes = [started * abs(u - last) for u, last in zip(acceleration_command, sums.last, strict=True)]
    return CommandSums(
        PerAxis._make(total + u * u for total, u in zip(sums.effort, acceleration_command, strict=True)),
        PerAxis._make(total + change for total, change in zip(sums.variation, changes, strict=True)),
        PerAxis(*acceleration_command),
    )


class SaturationSums(NamedTuple):
    """Number of ticks at which the rotors cannot produce the wrench."""

    saturated: Row = 0.0


def add_shortfall(sums: SaturationSums, shortfall: Wrench) -> SaturationSums:
    """Count a tick as saturated if `shortfall`, the part of the wrench that the rotors cannot produce, is not zero."""
    complete = True
    for part in shortfall:
        complete = complete & (part == 0.0)
    return SaturationSums(sums.saturated + where(complete, 0.0, 1.0))


_ERROR_ACCUMULATOR = _accumulator(ErrorSums(), add_error)
_COMMAND_ACCUMULATOR = _accumulator(CommandSums(), add_command)
_SATURATION_ACCUMULATOR = _accumulator(SaturationSums(), add_shortfall)
CENTIMETRES = Display("cm", 0.01, 2)
"""Format of metrics in m."""


def _rms(axis: str) -> Metric:
    """Return the definition of the RMSE on an axis."""

    def value(sums: ErrorSums, ticks: Any, _: float) -> Any:
        return np.sqrt(getattr(sums.squares, axis) / ticks)

    return Metric("m", f"RMSE on {axis.upper()}", _ERROR_ACCUMULATOR, value, CENTIMETRES, value_range="nonnegative")


def _effort(axis: str) -> Metric:
    """Return the definition of the control effort on an axis."""

    def value(sums: CommandSums, ticks: Any, _: float) -> Any:
        return getattr(sums.effort, axis) / ticks

    label, display = f"control effort on {axis.upper()}", Display("m²/s⁴", 1.0, 4)
    return Metric("m²/s⁴", label, _COMMAND_ACCUMULATOR, value, display, value_range="nonnegative")


def _variation(axis: str) -> Metric:
    """Return the definition of the total variation of the command on an axis."""

    def value(sums: CommandSums, ticks: Any, period: float) -> Any:
        return getattr(sums.variation, axis) / (np.where(ticks > 1.0, ticks - 1.0, np.nan) * period)

    label = f"total variation of the command on {axis.upper()}"
    return Metric("m/s³", label, _COMMAND_ACCUMULATOR, value, value_range="nonnegative")


def _total_rms(sums: ErrorSums, ticks: Any, _: float) -> Any:
    return np.sqrt((sums.squares.x + sums.squares.y + sums.squares.z) / ticks)


def _peak(sums: ErrorSums, ticks: Any, _: float) -> Any:
    return np.sqrt(sums.peak * np.where(ticks > 0.0, 1.0, np.nan))


_SATURATION_METRIC = Metric(
    "1",
    "ticks with saturated rotors",
    _SATURATION_ACCUMULATOR,
    lambda sums, ticks, _: sums.saturated / ticks,
    Display("%", 0.01, 1),
    differentiable=False,
    value_range="fraction",
)
_RMSE_METRIC = Metric("m", "RMSE", _ERROR_ACCUMULATOR, _total_rms, CENTIMETRES, value_range="nonnegative")
_PEAK_METRIC = Metric("m", "peak error", _ERROR_ACCUMULATOR, _peak, CENTIMETRES, value_range="nonnegative")


class Metrics(NamedTuple):
    """Metrics of a flight, or (N,) arrays of them for a fleet.

    The definition of each metric is in its annotation. A metric is NaN if no tick is in the metric window, or if the
    input from which it is computed is not connected. The metrics of a scenario with additional metrics are an instance
    of a class with further fields, see `metrics_type`.

    Attributes:
        rmse: root mean square of the Euclidean position error.
        rmse_x: root mean square of the position error along X of W.
        rmse_y: root mean square of the position error along Y of W.
        rmse_z: root mean square of the position error along Z of W.
        peak_error: largest Euclidean position error.
        effort_x: control effort on X.
        effort_y: control effort on Y.
        effort_z: control effort on Z.
        variation_x: total variation of the commanded acceleration on X.
        variation_y: total variation of the commanded acceleration on Y.
        variation_z: total variation of the commanded acceleration on Z.
        saturated_fraction: fraction of the ticks at which the rotors cannot produce the wrench.
        crash_time: time of the crash; infinite for a vehicle that did not crash.
    """

    rmse: Annotated[Any, _RMSE_METRIC]
    rmse_x: Annotated[Any, _rms("x")]
    rmse_y: Annotated[Any, _rms("y")]
    rmse_z: Annotated[Any, _rms("z")]
    peak_error: Annotated[Any, _PEAK_METRIC]
    effort_x: Annotated[Any, _effort("x")]
    effort_y: Annotated[Any, _effort("y")]
    effort_z: Annotated[Any, _effort("z")]
    variation_x: Annotated[Any, _variation("x")]
    variation_y: Annotated[Any, _variation("y")]
    variation_z: Annotated[Any, _variation("z")]
    saturated_fraction: Annotated[Any, _SATURATION_METRIC]
    crash_time: Annotated[Any, Quantity("s")]

    @property
    def crashed(self) -> Any:
        """True for each vehicle that crashed."""
        return self.crash_time < math.inf

    @property
    def definitions(self) -> "Mapping[str, Metric]":
        """Definition of each metric by name, without the crash time, which is not a metric."""
        return metric_definitions(type(self))

    def take(self, indices: Any) -> "Metrics":
        """Return the metrics of some vehicles, given their indices or a mask."""
        return self.with_values(values[indices] for values in self)

    def with_values(self, values: Iterable[Any]) -> "Metrics":
        """Return metrics of the same class, given their values in the order of the fields."""
        return type(self)(*values)


_ANNOTATIONS = get_type_hints(Metrics, include_extras=True)
_DEFINITIONS = {name: definition for name, hint in _ANNOTATIONS.items() for _, definition in [get_args(hint)]}
METRICS: dict[str, Metric] = {name: metric for name, metric in _DEFINITIONS.items() if isinstance(metric, Metric)}
"""Definition of each metric that every flight has, by name. The crash time is not a metric and not included."""


@functools.cache
def metrics_type(additional: tuple[tuple[str, Metric], ...] = ()) -> type[Metrics]:
    """Return a scenario's metrics class: `Metrics` with a field for each additional metric.

    Args:
        additional: names and definitions of the additional metrics.
    """
    if not additional:
        return Metrics
    fields = namedtuple("Metrics", [*METRICS, *dict(additional), "crash_time"])  # type: ignore[misc]
    members = {name: vars(Metrics)[name] for name in ("crashed", "definitions", "take", "with_values", "__doc__")}
    return type("Metrics", (fields,), {**members, "_additional": dict(additional), "__slots__": ()})


def metric_definitions(kind: type[Metrics]) -> Mapping[str, Metric]:
    """Return the definitions of all metrics of a class from `metrics_type`, by name. The crash time is not included."""
    return {**METRICS, **getattr(kind, "_additional", {})}


def metric_accumulators(kind: type[Metrics]) -> tuple[Accumulator, ...]:
    """Return the accumulators of all metrics of a class from `metrics_type`. Shared accumulators are included once."""
    accumulators = (metric.accumulator for metric in metric_definitions(kind).values())
    return tuple(dict.fromkeys(each for each in accumulators if each is not None))


def recorded_metrics(kind: type[Metrics]) -> dict[str, Metric]:
    """Return the metrics, by name, that require a recorded flight because they have no accumulator.

    Args:
        kind: class from `metrics_type`.
    """
    return {name: metric for name, metric in metric_definitions(kind).items() if metric.accumulator is None}


def metric_unit(kind: type[Metrics], name: str) -> str:
    """Return the unit of a metric or of the crash time."""
    return "s" if name == "crash_time" else metric_definitions(kind)[name].unit


def check_range(name: str, metric: Metric, values: Any) -> None:
    """Check that the values of a metric, a number or (N,) numbers, are in the range that its definition states.

    Raises:
        InputError: if a value is outside this range.
    """
    low, high = _LIMITS_OF_RANGES[metric.value_range]
    wrong = (values < low - _ROUNDING_TOLERANCE) | (values > high + _ROUNDING_TOLERANCE)
    if np.any(wrong):
        value, *_ = np.ravel(values)[np.ravel(wrong)]
        limits = "not negative" if high == math.inf else f"between {low:g} and {high:g}"
        raise InputError(f"the metric {name} is {value:g}, but its value_range {metric.value_range} states {limits}")


def compute_metrics(
    sums: Sums, crash_time: np.ndarray, period: float, kind: type[Metrics] = Metrics, connected: Any = None
) -> Metrics:
    """Return the metrics of each vehicle. Metrics that are computed from a recorded flight are NaN.

    Args:
        sums: sums over the ticks of each vehicle, with (N,) arrays as values.
        crash_time: (N,) crash times, s; infinite for a vehicle that did not crash.
        period: duration of a tick, s.
        kind: class of the metrics, from `metrics_type`.
        connected: function that returns True if the signal of a given name is available; by default all signals are
            available. A metric is NaN if it depends on an unavailable signal.

    Raises:
        InputError: if a metric is outside the range that its definition states.
    """
    computable = [
        name
        for name, metric in metric_definitions(kind).items()
        if metric.accumulator is not None and (connected is None or all(map(connected, metric.signals)))
    ]
    undefined = dict.fromkeys(metric_definitions(kind), np.full_like(crash_time, np.nan))
    return kind(**{**undefined, **metric_values(computable, sums, period, kind)}, crash_time=crash_time)


def metric_values(names: Iterable[str], sums: Sums, period: float, kind: type[Metrics]) -> dict[str, np.ndarray]:
    """Return the (N,) values of some metrics, by name.

    Args:
        names: names of metrics that are not computed from a recorded flight.
        sums: sums over the ticks of each vehicle, with (N,) arrays as values.
        period: duration of a tick, s.
        kind: class of the metrics, from `metrics_type`.

    Raises:
        InputError: if a metric is outside the range that its definition states.
    """
    ticks: Any = np.where(sums.ticks > 0.0, sums.ticks, np.nan)
    records = dict(zip(metric_accumulators(kind), sums.records, strict=True))
    values = {}
    for name in names:
        metric = metric_definitions(kind)[name]
        assert metric.accumulator is not None
        values[name] = metric.value(records[metric.accumulator], ticks, period)
        check_range(name, metric, values[name])
    return values
