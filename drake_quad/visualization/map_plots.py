"""Plot of a map of gains, with the stability of the loop and the errors of simulated flights."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import NullLocator

from drake_quad.design.stability_map import StabilityMap
from drake_quad.laboratory.metrics import Metrics
from drake_quad.visualization.panels import new_panels
from drake_quad.visualization.style import BLACK, VERMILION, shading

_EDGE: dict[str, Any] = {"color": BLACK, "linewidth": 2.2, "linestyle": "-"}
_DAMPING: dict[str, Any] = {"color": BLACK, "linewidth": 0.9, "linestyle": "-"}
_DELAY: dict[str, Any] = {"color": VERMILION, "linewidth": 0.9, "linestyle": "--"}
_STAR: dict[str, Any] = {
    "color": VERMILION,
    "marker": "*",
    "markersize": 13,
    "markeredgecolor": "white",
    "linestyle": "none",
    "zorder": 5,
}
_CRASHED = "0.85"
# Free distance that the label of a line needs on each side, pixels.
_LABEL = 24.0
_DAMPINGS = (0.2, 0.4, 0.6, 0.8)
_DELAYS = tuple(0.02 * 4**i for i in range(5))


class MapPanel(NamedTuple):
    """Stability and flights of each pair of gains in one case.

    Attributes:
        title: title of the panel.
        linear: stability of the linear model with each pair.
        flown: metrics of the flight with each pair, (rows, columns).
    """

    title: str
    linear: StabilityMap
    flown: Metrics


def plot_map(
    panels: list[MapPanel],
    first: np.ndarray,
    second: np.ndarray,
    *,
    labels: tuple[str, str],
    marked: tuple[float, float],
    loop: str,
) -> Figure:
    """Plot the RMSE of the flights as colours, with contour lines of damping and delay margin.

    Args:
        panels: panels, drawn side by side with a common colour scale.
        first: gains along the vertical axis, (rows,).
        second: gains along the horizontal axis, (columns,).
        labels: labels of both gains, with their units.
        marked: both gains of the scenario, marked by a star.
        loop: name of the loop, for the title.
    """
    # The logarithmic scale ends at a tenth of a millimetre, since smaller errors do not matter.
    errors = [np.where(panel.flown.crashed, np.nan, np.maximum(100.0 * panel.flown.rmse, 1e-2)) for panel in panels]
    seen = np.concatenate([error[np.isfinite(error)] for error in errors])
    low = float(seen.min()) if len(seen) else 1.0
    high = min(max(float(seen.max(initial=0.0)), 2.0 * low), 30.0 * low)
    norm = LogNorm(low, high)
    with new_panels(5.2 * len(panels) + 0.8, 4.8, 1, len(panels), sharey=True) as (figure, (row,)):
        for axes, panel, error in zip(row, panels, errors, strict=True):
            # The star is drawn before the contour lines, so that their labels avoid it.
            if first[0] <= marked[0] <= first[-1] and second[0] <= marked[1] <= second[-1]:
                axes.plot(marked[1], marked[0], **_STAR)
            shades = _draw(axes, panel, error, first, second, norm)
            axes.set(xlabel=labels[1], title=panel.title)
        row[0].set_ylabel(labels[0])
        label = "RMSE of the flight (cm)"
        bar = figure.colorbar(shades, ax=list(row), label=label, pad=0.02, fraction=0.05, extend="max")
        ticks = [number * 10.0**power for power in range(-2, 4) for number in (1.0, 2.0, 5.0)]
        bar.set_ticks([tick for tick in ticks if low <= tick <= high], minor=False)
        bar.ax.yaxis.set_major_formatter("{x:g}")
        bar.ax.yaxis.set_minor_locator(NullLocator())
        figure.suptitle(f"Gains of the {loop} loop: flights in shades, the linear model in lines", fontsize=10)
        figure.legend(handles=_key(panels), loc="outside lower center", ncols=5)
        return figure


def _key(panels: list[MapPanel]) -> list[Line2D | Patch]:
    """Return the handles of the legend."""
    crashed = any(panel.flown.crashed.any() for panel in panels)
    return [
        Line2D([], [], **_EDGE, label="edge of stability"),
        Line2D([], [], **_DAMPING, label="damping ζ"),
        Line2D([], [], **_DELAY, label="delay margin"),
        Line2D([], [], **_STAR, label="scenario"),
        *([Patch(color=_CRASHED, label="crashed")] if crashed else []),
    ]


def _draw(
    axes: Axes, panel: MapPanel, error: np.ndarray, first: np.ndarray, second: np.ndarray, norm: LogNorm
) -> AxesImage:
    up, aside = 0.5 * (first[1] - first[0]), 0.5 * (second[1] - second[0])
    edges = (second[0] - aside, second[-1] + aside, first[0] - up, first[-1] + up)
    axes.set_facecolor(_CRASHED)
    shades = axes.imshow(error, origin="lower", extent=edges, aspect="auto", cmap=shading(), norm=norm)
    if not panel.linear.stable.all():
        axes.contour(second, first, panel.linear.size, [1.0], **_contour(_EDGE))
    damping = axes.contour(second, first, panel.linear.damping, _DAMPINGS, **_contour(_DAMPING))
    delay = axes.contour(second, first, panel.linear.delay, _DELAYS, **_contour(_DELAY))
    where = _free_places(axes, [damping, delay])
    for lines, text in ((damping, lambda level: f"ζ {level:g}"), (delay, lambda level: f"{1e3 * level:.0f} ms")):
        axes.clabel(lines, fmt=text, fontsize=9, manual=where[lines])
    axes.grid(visible=False)
    return shades


def _free_places(axes: Axes, contours: list[ContourSet]) -> dict[ContourSet, list[tuple[float, float]]]:
    """Return the places of the labels of contour lines, far from borders, other lines and other labels.

    A line without room for a label has no place.
    """
    axes.figure.draw_without_rendering()  # type: ignore[union-attr]
    inside, there = axes.get_window_extent(), axes.transData
    lines = [
        (found, np.vstack([there.transform(part) for part in path.to_polygons(closed_only=False)]))
        for found in contours
        for path in found.get_paths()
        if np.size(path.vertices) > 2
    ]
    written: list[np.ndarray] = [there.transform(line.get_xydata()) for line in axes.lines]
    places: dict[ContourSet, list[tuple[float, float]]] = {found: [] for found in contours}
    for k, (found, line) in enumerate(lines):
        room = np.minimum.reduce([line - inside.min, inside.max - line]).min(axis=1)
        for others in [*(other for i, (_, other) in enumerate(lines) if i != k), *written]:
            apart = np.linalg.norm(line[:, np.newaxis] - others, axis=2).min(axis=1)
            room = np.minimum(room, apart)
        best = int(np.argmax(room))
        if room[best] > _LABEL:
            written.append(line[best : best + 1])
            places[found].append(tuple(there.inverted().transform(line[best])))
    return places


def _contour(line: dict[str, Any]) -> dict[str, Any]:
    """Return the style of a line as arguments of `contour`."""
    return {"colors": line["color"], "linewidths": line["linewidth"], "linestyles": line["linestyle"]}
