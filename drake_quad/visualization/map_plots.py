"""The map of stable gains."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.ticker import NullLocator

from drake_quad.analysis.gain_design import PdGains
from drake_quad.analysis.stability_map import StabilityMap
from drake_quad.laboratory.metrics import Metrics
from drake_quad.visualization.style import BLACK, PLATE, SHADING, VERMILION, new_figure, styled

_DAMPINGS = (0.2, 0.4, 0.6, 0.8)
_DELAYS = tuple(0.02 * 2**i for i in range(9))


class MapPanel(NamedTuple):
    """A map and the flights over it.

    Attributes:
        title: of the case.
        linear: what the loop's linear model says.
        flown: metrics of the flights, (rows, columns).
    """

    title: str
    linear: StabilityMap
    flown: Metrics


def plot_map(panels: list[MapPanel], k_p: np.ndarray, k_d: np.ndarray, *, marked: PdGains, loop: str) -> Figure:
    """RMSE of the flights in colours, with lines of damping and delay margin over it, a panel a case.

    Args:
        panels: side by side, on one scale of colours.
        k_p: (rows,) 1/s².
        k_d: (columns,) 1/s.
        marked: gains of the scenario.
        loop: name of the loop.
    """
    # A tenth of a millimetre is no error, and where nothing flew to the end there is nothing to shade.
    errors = [np.where(panel.flown.crashed, np.nan, np.maximum(100.0 * panel.flown.rmse, 1e-2)) for panel in panels]
    seen = np.concatenate([error[np.isfinite(error)] for error in errors])
    low = float(seen.min()) if len(seen) else 1.0
    high = min(max(float(seen.max(initial=0.0)), 2.0 * low), 30.0 * low)
    norm = LogNorm(low, high)
    with styled():
        figure = new_figure(5.2 * len(panels) + 0.8, 4.8)
        row = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
        for axes, panel, error in zip(row, panels, errors, strict=True):
            shades = _draw(axes, panel, error, k_p, k_d, norm)
            if k_p[0] <= marked.k_p <= k_p[-1] and k_d[0] <= marked.k_d <= k_d[-1]:
                axes.plot(
                    marked.k_d, marked.k_p, "*", color=VERMILION, markersize=13, markeredgecolor="white", zorder=5
                )
            axes.set(xlabel="k_D (1/s)", title=panel.title)
        row[0].set_ylabel("k_P (1/s²)")
        label = "RMSE of the flight (cm)"
        bar = figure.colorbar(shades, ax=list(row), label=label, pad=0.02, fraction=0.05, extend="max")
        ticks = [number * 10.0**power for power in range(-2, 4) for number in (1.0, 2.0, 5.0)]
        bar.set_ticks([tick for tick in ticks if low <= tick <= high], minor=False)
        bar.ax.yaxis.set_major_formatter("{x:g}")
        bar.ax.yaxis.set_minor_locator(NullLocator())
        lines = "the linear model's edge of stability (thick), damping (thin), delay margin (dashed); star: scenario"
        figure.suptitle(f"Gains of the {loop} loop in flight (shades), and {lines}", fontsize=10)
        return figure


def _draw(axes: Axes, panel: MapPanel, error: np.ndarray, k_p: np.ndarray, k_d: np.ndarray, norm: LogNorm) -> AxesImage:
    half_p, half_d = 0.5 * (k_p[1] - k_p[0]), 0.5 * (k_d[1] - k_d[0])
    edges = (k_d[0] - half_d, k_d[-1] + half_d, k_p[0] - half_p, k_p[-1] + half_p)
    axes.set_facecolor("0.85")
    shades = axes.imshow(error, origin="lower", extent=edges, aspect="auto", cmap=SHADING, norm=norm)
    if not panel.linear.stable.all():
        axes.contour(k_d, k_p, panel.linear.size, [1.0], colors=BLACK, linewidths=2.2)
    damping = axes.contour(k_d, k_p, panel.linear.damping, _DAMPINGS, colors=BLACK, linewidths=0.9)
    axes.clabel(damping, fmt=lambda level: f"ζ {level:g}", fontsize=8)
    delay = axes.contour(k_d, k_p, panel.linear.delay, _DELAYS, colors=VERMILION, linewidths=0.9, linestyles="--")
    axes.clabel(delay, fmt=lambda level: f"{1e3 * level:.0f} ms", fontsize=8)
    if panel.flown.crashed.any():
        axes.annotate("grey: crashed", (0.02, 0.97), xycoords="axes fraction", va="top", fontsize=8.5, bbox=PLATE)
    axes.grid(visible=False)
    return shades
