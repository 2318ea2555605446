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
from typing import NamedTuple

import numpy as np

from drake_quad.compiled import formula
from drake_quad.elementary import Row, Rows, maximum, minimum

# Rows of the sums: ticks, max |e|², saturated ticks, Σ e² (3), Σ u² (3), Σ |Δu| (3), the last u (3).
NUM_SUMS = 15


class Metrics(NamedTuple):
    """Metrics of a flight, or (N,) arrays of them for a fleet; NaN where no tick counted or nothing was commanded.

    Attributes:
        rmse: of the Euclidean position error, m.
        rmse_x: of the position error along X of W, m; `rmse_y` and `rmse_z` likewise.
        peak_error: largest Euclidean position error, m.
        effort_x: control effort on X, m²/s⁴; `effort_y` and `effort_z` likewise.
        variation_x: total variation of the commanded acceleration on X, m/s³; `variation_y`, `variation_z` likewise.
        saturation_share: between 0 and 1.
        crash_time: s; infinite for a vehicle that did not crash.
    """

    rmse: Row
    rmse_x: Row
    rmse_y: Row
    rmse_z: Row
    peak_error: Row
    effort_x: Row
    effort_y: Row
    effort_z: Row
    variation_x: Row
    variation_y: Row
    variation_z: Row
    saturation_share: Row
    crash_time: Row

    @property
    def crashed(self) -> Row:
        """Whether the vehicle crashed."""
        return self.crash_time < math.inf


UNITS = {
    **dict.fromkeys(("rmse", "rmse_x", "rmse_y", "rmse_z", "peak_error"), "m"),
    **dict.fromkeys(("effort_x", "effort_y", "effort_z"), "m²/s⁴"),
    **dict.fromkeys(("variation_x", "variation_y", "variation_z"), "m/s³"),
    "saturation_share": "1",
    "crash_time": "s",
}


@formula
def add_tick(sums: Rows, error: Rows, command: Rows, saturated: Row) -> tuple[Row, ...]:
    """Returns the sums with one more tick.

    Args:
        sums: 15 rows, zero at the beginning.
        error: reference minus true position, 3 rows, m.
        command: commanded acceleration, 3 rows, m/s².
        saturated: 1 where the rotors cannot give the commanded wrench, else 0.
    """
    ticks, peak, saturated_ticks, ee_x, ee_y, ee_z, uu_x, uu_y, uu_z, du_x, du_y, du_z, last_x, last_y, last_z = sums
    e_x, e_y, e_z = error[0] * error[0], error[1] * error[1], error[2] * error[2]
    u_x, u_y, u_z = command
    started = minimum(ticks, 1.0)
    return (
        ticks + 1.0,
        maximum(peak, e_x + e_y + e_z),
        saturated_ticks + saturated,
        ee_x + e_x,
        ee_y + e_y,
        ee_z + e_z,
        uu_x + u_x * u_x,
        uu_y + u_y * u_y,
        uu_z + u_z * u_z,
        du_x + started * abs(u_x - last_x),
        du_y + started * abs(u_y - last_y),
        du_z + started * abs(u_z - last_z),
        u_x,
        u_y,
        u_z,
    )


def summarized(sums: np.ndarray, crash_time: np.ndarray, period: float) -> Metrics:
    """Returns the metrics of each vehicle.

    Args:
        sums: (15, N).
        crash_time: (N,), s; infinite for a vehicle that did not crash.
        period: of the ticks, s.
    """
    ticks = np.where(sums[0] > 0.0, sums[0], np.nan)
    time = np.where(sums[0] > 1.0, sums[0] - 1.0, np.nan) * period
    return Metrics._make(
        [
            np.sqrt(sums[3:6].sum(axis=0) / ticks),
            *np.sqrt(sums[3:6] / ticks),
            np.sqrt(sums[1] * np.where(sums[0] > 0.0, 1.0, np.nan)),
            *(sums[6:9] / ticks),
            *(sums[9:12] / time),
            sums[2] / ticks,
            crash_time,
        ]
    )
