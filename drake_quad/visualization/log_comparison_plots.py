"""Plot of a logged flight, together with the flights that a scenario predicts for the same reference."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drake_quad.identification.validation.comparison import INTERVAL_QUANTILES, LogComparison
from drake_quad.visualization.curves import quantiles_over_flights
from drake_quad.visualization.panels import new_panels
from drake_quad.visualization.style import BLUE, REFERENCE, VERMILION

_BAND_STYLE: dict[str, Any] = {"color": BLUE, "alpha": 0.25, "linewidth": 0}
# Time steps of the log that are longer than this multiple of the median step count as gaps.
_MIN_GAP_RATIO = 10.0


def plot_log_comparison(comparison: LogComparison) -> Figure:
    """Plot the logged position and error on each axis, with the median and the 95 % band of the predictions.

    Lines are broken at gaps of the log. A predicted flight contributes to median and band until it crashes.
    """
    time, target = comparison.time, comparison.target
    steps = np.diff(time)
    gaps = np.flatnonzero(steps > _MIN_GAP_RATIO * np.median(steps)) + 1
    with new_panels(10.0, 6.6, 3, 2, sharex=True) as (figure, grid):
        for i, (position_axes, error_axes) in enumerate(grid):
            band = quantiles_over_flights(
                comparison.predicted[:, :, i], (INTERVAL_QUANTILES[0], 0.5, INTERVAL_QUANTILES[1])
            )
            curves = np.vstack([time, target[:, i], comparison.logged_error[:, i], band])
            times, reference, logged, low, median, high = np.insert(curves, gaps, np.nan, axis=1)
            position_axes.plot(times, reference, **REFERENCE, label="reference", zorder=3)
            _draw(position_axes, times, reference - logged, reference - median, (reference - high, reference - low))
            _draw(error_axes, times, 100.0 * logged, 100.0 * median, (100.0 * low, 100.0 * high))
            position_axes.set_ylabel(f"{'xyz'[i]} (m)")
            error_axes.set_ylabel(f"error on {'XYZ'[i]} (cm)")
        for axes in grid[-1]:
            axes.set_xlabel("time of the log (s)")
        figure.legend(*grid[0, 0].get_legend_handles_labels(), loc="outside upper left", ncols=4)
        return figure


def _draw(
    axes: Axes, time: np.ndarray, logged: np.ndarray, median: np.ndarray, band: tuple[np.ndarray, np.ndarray]
) -> None:
    axes.fill_between(time, *band, **_BAND_STYLE, label="95 % of the predictions")
    axes.plot(time, median, color=BLUE, linewidth=1.0, label="predicted")
    axes.plot(time, logged, color=VERMILION, label="flown")
