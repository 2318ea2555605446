"""Metrics of a flight, and the sums over its ticks from which they are computed.

For a tick k of n, with the position error e_k and the commanded acceleration u_k of each axis:

    RMSE of an axis        √(Σ e_k² / n)
    RMSE                   √(Σ |e_k|² / n), of the Euclidean error
    peak                   max |e_k|
    control effort         Σ u_k² / n, m²/s⁴
    total variation        Σ |u_k - u_{k-1}| / (duration of n - 1 ticks), m/s² per second
    saturation share       fraction of the ticks at which the rotors of the nominal model cannot produce the wrench

The sums include the ticks in the metric window of the scenario, up to a crash.
"""

import math
from collections.abc import Callable
from typing import Annotated, Any, NamedTuple, get_args, get_type_hints

import numpy as np

from drake_quad.framework.elementary import maximum, minimum
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.signals import Acceleration, PositionError, Quantity, Row


class TickValues(NamedTuple):
    """Values of one tick from which metrics are computed.

    Attributes:
        error: position of the reference minus true position.
        command: commanded acceleration.
        saturated: 1 if the rotors cannot produce the commanded wrench, else 0.
    """

    error: PositionError
    command: Acceleration
    saturated: Row


_ZEROS = PerAxis(0.0, 0.0, 0.0)


class Sums(NamedTuple):
    """Sums over the ticks of a flight, initially zero.

    Attributes:
        ticks: number n of ticks.
        peak: max |e|², m².
        saturated: number of ticks at which the rotors cannot produce the wrench.
        error: Σ e², m².
        effort: Σ u², m²/s⁴.
        variation: Σ |Δu|, m/s².
        last: u of the previous tick, m/s².
    """

    ticks: Row = 0.0
    peak: Row = 0.0
    saturated: Row = 0.0
    error: PerAxis = _ZEROS
    effort: PerAxis = _ZEROS
    variation: PerAxis = _ZEROS
    last: PerAxis = _ZEROS


SUMS_OF_PORTS = {"acceleration_command": ("effort", "variation"), "shortfall": ("saturated",)}
"""Sums that are unknown if an optional input port of the flight monitor is not connected."""


def add_tick(sums: Sums, tick: TickValues) -> Sums:
    """Return the sums after one more tick."""
    e_x, e_y, e_z = (e * e for e in tick.error)
    started = minimum(sums.ticks, 1.0)
    changes = [started * abs(command - last) for command, last in zip(tick.command, sums.last, strict=True)]
    return Sums(
        ticks=sums.ticks + 1.0,
        peak=maximum(sums.peak, e_x + e_y + e_z),
        saturated=sums.saturated + tick.saturated,
        error=PerAxis(sums.error.x + e_x, sums.error.y + e_y, sums.error.z + e_z),
        effort=PerAxis._make(total + u * u for total, u in zip(sums.effort, tick.command, strict=True)),
        variation=PerAxis._make(total + change for total, change in zip(sums.variation, changes, strict=True)),
        last=PerAxis(*tick.command),
    )


class Display(NamedTuple):
    """Format of a metric in tables.

    Attributes:
        unit: unit that is printed.
        size: size of the printed unit in the unit of the metric, for example 0.01 for a length that is printed in cm.
        digits: number of digits after the decimal point, for one flight.
    """

    unit: str
    size: float
    digits: int


class Metric(NamedTuple):
    """Definition of a metric.

    Attributes:
        unit: unit; "1" for a fraction between 0 and 1.
        label: label in tables and plots.
        value: function that returns the (N,) metric, given the (N,) sums, in which a zero number of ticks is replaced
            with NaN, and the duration of a tick, s.
        display: format in tables; None if tables omit the metric.
        differentiable: True if the metric is a differentiable function of the trajectory.
    """

    unit: str
    label: str
    value: Callable[[Sums, float], Any]
    display: Display | None = None
    differentiable: bool = True


def _rms(axis: str) -> Metric:
    """Return the definition of the RMSE on an axis."""
    return Metric("m", f"RMSE on {axis.upper()}", lambda s, _: np.sqrt(getattr(s.error, axis) / s.ticks), _CENTIMETRES)


def _effort(axis: str) -> Metric:
    """Return the definition of the control effort on an axis."""
    label = f"control effort on {axis.upper()}"
    return Metric("m²/s⁴", label, lambda s, _: getattr(s.effort, axis) / s.ticks, Display("m²/s⁴", 1.0, 4))


def _variation(axis: str) -> Metric:
    """Return the definition of the total variation of the command on an axis."""

    def value(sums: Sums, period: float) -> Any:
        return getattr(sums.variation, axis) / (np.where(sums.ticks > 1.0, sums.ticks - 1.0, np.nan) * period)

    return Metric("m/s³", f"total variation of the command on {axis.upper()}", value)


_CENTIMETRES = Display("cm", 0.01, 2)  # format of metrics in m

_SATURATION = Metric(
    "1",
    "share of ticks with saturated rotors",
    lambda s, _: s.saturated / s.ticks,
    Display("%", 0.01, 1),
    differentiable=False,
)


class Metrics(NamedTuple):
    """Metrics of a flight, or (N,) arrays of them for a fleet.

    The definition of each metric is in its annotation. A metric is NaN if no tick is in the metric window, or if the
    input from which it is computed is not connected.

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
        saturation_share: fraction of the ticks at which the rotors cannot produce the wrench.
        crash_time: time of the crash; infinite for a vehicle that did not crash.
    """

    rmse: Annotated[
        Any,
        Metric("m", "RMSE", lambda s, _: np.sqrt((s.error.x + s.error.y + s.error.z) / s.ticks), _CENTIMETRES),
    ]
    rmse_x: Annotated[Any, _rms("x")]
    rmse_y: Annotated[Any, _rms("y")]
    rmse_z: Annotated[Any, _rms("z")]
    peak_error: Annotated[
        Any,
        Metric("m", "peak error", lambda s, _: np.sqrt(s.peak * np.where(s.ticks > 0.0, 1.0, np.nan)), _CENTIMETRES),
    ]
    effort_x: Annotated[Any, _effort("x")]
    effort_y: Annotated[Any, _effort("y")]
    effort_z: Annotated[Any, _effort("z")]
    variation_x: Annotated[Any, _variation("x")]
    variation_y: Annotated[Any, _variation("y")]
    variation_z: Annotated[Any, _variation("z")]
    saturation_share: Annotated[Any, _SATURATION]
    crash_time: Annotated[Any, Quantity("s")]

    @property
    def crashed(self) -> Any:
        """True if the vehicle crashed."""
        return self.crash_time < math.inf

    def take(self, indices: Any) -> "Metrics":
        """Return the metrics of some vehicles, given their indices or a mask."""
        return Metrics._make(values[indices] for values in self)


_HINTS = get_type_hints(Metrics, include_extras=True)
_DEFINITIONS = {name: definition for name, hint in _HINTS.items() for _, definition in [get_args(hint)]}
METRICS: dict[str, Metric] = {name: metric for name, metric in _DEFINITIONS.items() if isinstance(metric, Metric)}
"""Definition of each metric, without the crash time."""
UNITS = {name: definition.unit for name, definition in _DEFINITIONS.items()}
"""Unit of each metric and of the crash time."""


def summarized(sums: Sums, crash_time: np.ndarray, period: float) -> Metrics:
    """Return the metrics of each vehicle.

    Args:
        sums: sums over the ticks of each vehicle, (N,) arrays.
        crash_time: (N,) crash times, s; infinite for a vehicle that did not crash.
        period: duration of a tick, s.
    """
    ticks: Any = np.where(sums.ticks > 0.0, sums.ticks, np.nan)
    counted = sums._replace(ticks=ticks)
    return Metrics(**{name: metric.value(counted, period) for name, metric in METRICS.items()}, crash_time=crash_time)
