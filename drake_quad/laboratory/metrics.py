"""What a flight is worth: sums gathered tick by tick, and the metrics that follow from them.

For a tick k of n, with the position error e_k and the commanded acceleration u_k of each axis:

    RMSE of an axis        √(Σ e_k² / n)
    RMSE                   √(Σ |e_k|² / n), of the Euclidean error
    peak                   max |e_k|
    control effort         Σ u_k² / n, m²/s⁴
    total variation        Σ |u_k - u_{k-1}| / (duration of n - 1 ticks), m/s² per second
    saturation share       share of the ticks at which the rotors, as the ground believes them, cannot give the wrench

Ticks count within the scenario's window and until the vehicle crashes.
"""

import math
from typing import Annotated, Any, NamedTuple, get_args, get_type_hints

import numpy as np

from drake_quad.framework.elementary import maximum, minimum
from drake_quad.signals import Acceleration, PositionError, Quantity, Row

_Length = Annotated[Any, Quantity("m")]
_Effort = Annotated[Any, Quantity("m²/s⁴")]
_Variation = Annotated[Any, Quantity("m/s³")]


class PerAxis(NamedTuple):
    """A sum for each axis of W."""

    x: Row = 0.0
    y: Row = 0.0
    z: Row = 0.0


class Sums(NamedTuple):
    """What is gathered tick by tick; all zero at the beginning.

    Attributes:
        ticks: n.
        peak: max |e|², m².
        saturated: ticks at which the rotors cannot give the wrench.
        error: Σ e², m².
        effort: Σ u², m²/s⁴.
        variation: Σ |Δu|, m/s².
        last: u of the tick before, m/s².
    """

    ticks: Row = 0.0
    peak: Row = 0.0
    saturated: Row = 0.0
    error: PerAxis = PerAxis()
    effort: PerAxis = PerAxis()
    variation: PerAxis = PerAxis()
    last: PerAxis = PerAxis()


class Metrics(NamedTuple):
    """Metrics of a flight, or (N,) arrays of them for a fleet; NaN where no tick counted or nothing was commanded.

    Attributes:
        rmse: of the Euclidean position error.
        rmse_x: of the position error along X of W.
        rmse_y: along Y.
        rmse_z: along Z.
        peak_error: largest Euclidean position error.
        effort_x: control effort on X.
        effort_y: on Y.
        effort_z: on Z.
        variation_x: total variation of the commanded acceleration on X.
        variation_y: on Y.
        variation_z: on Z.
        saturation_share: between 0 and 1.
        crash_time: infinite for a vehicle that did not crash.
    """

    rmse: _Length
    rmse_x: _Length
    rmse_y: _Length
    rmse_z: _Length
    peak_error: _Length
    effort_x: _Effort
    effort_y: _Effort
    effort_z: _Effort
    variation_x: _Variation
    variation_y: _Variation
    variation_z: _Variation
    saturation_share: Annotated[Any, Quantity("1")]
    crash_time: Annotated[Any, Quantity("s")]

    @property
    def crashed(self) -> Any:
        """True if the vehicle crashed."""
        return self.crash_time < math.inf

    def taken(self, places: Any) -> "Metrics":
        """The metrics of some vehicles, given their places or a mask."""
        return Metrics._make(values[places] for values in self)


_HINTS = get_type_hints(Metrics, include_extras=True)
UNITS = {name: quantity.unit for name, (_, quantity) in zip(_HINTS, map(get_args, _HINTS.values()), strict=True)}
"""The unit of each metric."""


def add_tick(sums: Sums, error: PositionError, command: Acceleration, saturated: Row) -> Sums:
    """Returns the sums with one more tick.

    Args:
        sums: until now.
        error: reference minus true position.
        command: commanded acceleration.
        saturated: 1 where the rotors cannot give the commanded wrench, else 0.
    """
    e_x, e_y, e_z = (e * e for e in error)
    started = minimum(sums.ticks, 1.0)
    return Sums(
        ticks=sums.ticks + 1.0,
        peak=maximum(sums.peak, e_x + e_y + e_z),
        saturated=sums.saturated + saturated,
        error=PerAxis(sums.error.x + e_x, sums.error.y + e_y, sums.error.z + e_z),
        effort=PerAxis._make(total + u * u for total, u in zip(sums.effort, command, strict=True)),
        variation=PerAxis._make(
            total + started * abs(u - last) for total, u, last in zip(sums.variation, command, sums.last, strict=True)
        ),
        last=PerAxis(*command),
    )


def summarized(sums: Sums, crash_time: np.ndarray, period: float) -> Metrics:
    """Returns the metrics of each vehicle.

    Args:
        sums: of (N,) arrays.
        crash_time: (N,), s; infinite for a vehicle that did not crash.
        period: of the ticks, s.
    """
    ticks = np.where(sums.ticks > 0.0, sums.ticks, np.nan)
    time = np.where(sums.ticks > 1.0, sums.ticks - 1.0, np.nan) * period
    return Metrics(
        rmse=np.sqrt((sums.error.x + sums.error.y + sums.error.z) / ticks),
        rmse_x=np.sqrt(sums.error.x / ticks),
        rmse_y=np.sqrt(sums.error.y / ticks),
        rmse_z=np.sqrt(sums.error.z / ticks),
        peak_error=np.sqrt(sums.peak * np.where(sums.ticks > 0.0, 1.0, np.nan)),
        effort_x=sums.effort.x / ticks,
        effort_y=sums.effort.y / ticks,
        effort_z=sums.effort.z / ticks,
        variation_x=sums.variation.x / time,
        variation_y=sums.variation.y / time,
        variation_z=sums.variation.z / time,
        saturation_share=sums.saturated / ticks,
        crash_time=crash_time,
    )
