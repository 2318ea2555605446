"""Plot of a stability map over two gains, with the errors of simulated flights."""

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

_STABILITY_EDGE_STYLE: dict[str, Any] = {"color": BLACK, "linewidth": 2.2, "linestyle": "-"}
_DAMPING_STYLE: dict[str, Any] = {"color": BLACK, "linewidth": 0.9, "linestyle": "-"}
_DELAY_STYLE: dict[str, Any] = {"color": VERMILION, "linewidth": 0.9, "linestyle": "--"}
_STAR_STYLE: dict[str, Any] = {
    "color": VERMILION,
    "marker": "*",
    "markersize": 13,
    "markeredgecolor": "white",
    "linestyle": "none",
    "zorder": 5,
}
_CRASHED_COLOUR = "0.85"
# Smallest distance of a contour label from borders, other lines and other labels, pixels.
_MIN_LABEL_DISTANCE = 24.0
_DAMPING_LEVELS = (0.2, 0.4, 0.6, 0.8)  # damping ratios of the contours
_DELAY_LEVELS = tuple(0.02 * 4**i for i in range(5))  # s, delay margins of the contours


class MapPanel(NamedTuple):
    """Stability margins and flight metrics of each pair of gains, for one scenario.

    Attributes:
        title: title of the panel.
        linear: stability of the linear model for each pair of gains.
        simulated: metrics of the simulated flight with each pair of gains, (rows, columns).
    """

    title: str
    linear: StabilityMap
    simulated: Metrics


def plot_map(
    panels: list[MapPanel],
    first: np.ndarray,
    second: np.ndarray,
    *,
    labels: tuple[str, str],
    marked: tuple[float, float],
    loop: str,
) -> Figure:
    """Plot the RMSE of the flights as colours, with contour lines of damping ratio and delay margin.

    Args:
        panels: panels to draw side by side, with a common colour scale.
        first: values of the gain on the vertical axis, (rows,).
        second: values of the gain on the horizontal axis, (columns,).
        labels: labels of both gains, with their units.
        marked: values of both gains in the scenario, which a star marks.
        loop: name of the loop, for the title.
    """
    # The logarithmic colour scale ends at 0.1 mm, since smaller errors do not matter.
    errors = [
        np.where(panel.simulated.crashed, np.nan, np.maximum(100.0 * panel.simulated.rmse, 1e-2)) for panel in panels
    ]
    finite_errors = np.concatenate([error[np.isfinite(error)] for error in errors])
    low = float(finite_errors.min()) if len(finite_errors) else 1.0
    high = min(max(float(finite_errors.max(initial=0.0)), 2.0 * low), 30.0 * low)
    norm = LogNorm(low, high)
    with new_panels(5.2 * len(panels) + 0.8, 4.8, 1, len(panels), sharey=True) as (figure, (row,)):
        for axes, panel, error in zip(row, panels, errors, strict=True):
            # The star is drawn before the contour lines, so that the contour labels avoid it.
            if first[0] <= marked[0] <= first[-1] and second[0] <= marked[1] <= second[-1]:
                axes.plot(marked[1], marked[0], **_STAR_STYLE)
            shades = _draw(axes, panel, error, first, second, norm)
            axes.set(xlabel=labels[1], title=panel.title)
        row[0].set_ylabel(labels[0])
        label = "RMSE of the flight (cm)"
        bar = figure.colorbar(shades, ax=list(row), label=label, pad=0.02, fraction=0.05, extend="max")
        ticks = [number * 10.0**power for power in range(-2, 4) for number in (1.0, 2.0, 5.0)]
        bar.set_ticks([tick for tick in ticks if low <= tick <= high], minor=False)
        bar.ax.yaxis.set_major_formatter("{x:g}")
        bar.ax.yaxis.set_minor_locator(NullLocator())
        figure.suptitle(f"Gains of the {loop} loop: simulated flights as colours, linear model as lines", fontsize=10)
        figure.legend(handles=_legend_handles(panels), loc="outside lower center", ncols=5)
        return figure


def _legend_handles(panels: list[MapPanel]) -> list[Line2D | Patch]:
    """Return the legend handles of the lines and marks in a map of gains."""
    crashed = any(panel.simulated.crashed.any() for panel in panels)
    return [
        Line2D([], [], **_STABILITY_EDGE_STYLE, label="stability limit"),
        Line2D([], [], **_DAMPING_STYLE, label="damping ratio ζ"),
        Line2D([], [], **_DELAY_STYLE, label="delay margin"),
        Line2D([], [], **_STAR_STYLE, label="gains of the scenario"),
        *([Patch(color=_CRASHED_COLOUR, label="crashed")] if crashed else []),
    ]


def _draw(
    axes: Axes, panel: MapPanel, error: np.ndarray, first: np.ndarray, second: np.ndarray, norm: LogNorm
) -> AxesImage:
    half_row, half_column = 0.5 * (first[1] - first[0]), 0.5 * (second[1] - second[0])
    edges = (second[0] - half_column, second[-1] + half_column, first[0] - half_row, first[-1] + half_row)
    axes.set_facecolor(_CRASHED_COLOUR)
    shades = axes.imshow(error, origin="lower", extent=edges, aspect="auto", cmap=shading(), norm=norm)
    if not panel.linear.stable.all():
        axes.contour(second, first, panel.linear.size, [1.0], **_contour_style(_STABILITY_EDGE_STYLE))
    damping = axes.contour(second, first, panel.linear.damping, _DAMPING_LEVELS, **_contour_style(_DAMPING_STYLE))
    delay = axes.contour(second, first, panel.linear.delay, _DELAY_LEVELS, **_contour_style(_DELAY_STYLE))
    label_positions = _label_positions(axes, [damping, delay])
    for lines, text in ((damping, lambda level: f"ζ {level:g}"), (delay, lambda level: f"{1e3 * level:.0f} ms")):
        axes.clabel(lines, fmt=text, fontsize=9, manual=label_positions[lines])
    axes.grid(visible=False)
    return shades


def _label_positions(axes: Axes, contours: list[ContourSet]) -> dict[ContourSet, list[tuple[float, float]]]:
    """Return positions of contour labels, in data coordinates, far from borders, other lines and other labels.

    Lines without space for a label are left out.
    """
    axes.figure.draw_without_rendering()  # type: ignore[union-attr]
    frame, to_pixels = axes.get_window_extent(), axes.transData
    lines = [
        (contour, np.vstack([to_pixels.transform(part) for part in path.to_polygons(closed_only=False)]))
        for contour in contours
        for path in contour.get_paths()
        if np.size(path.vertices) > 2
    ]
    occupied: list[np.ndarray] = [to_pixels.transform(line.get_xydata()) for line in axes.lines]
    positions: dict[ContourSet, list[tuple[float, float]]] = {contour: [] for contour in contours}
    for k, (contour, line) in enumerate(lines):
        free_distance = np.minimum.reduce([line - frame.min, frame.max - line]).min(axis=1)
        for others in [*(other for i, (_, other) in enumerate(lines) if i != k), *occupied]:
            distance = np.linalg.norm(line[:, np.newaxis] - others, axis=2).min(axis=1)
            free_distance = np.minimum(free_distance, distance)
        best = int(np.argmax(free_distance))
        if free_distance[best] > _MIN_LABEL_DISTANCE:
            occupied.append(line[best : best + 1])
            positions[contour].append(tuple(to_pixels.inverted().transform(line[best])))
    return positions


def _contour_style(line: dict[str, Any]) -> dict[str, Any]:
    """Return the style of a line as keyword arguments of `Axes.contour`."""
    return {"colors": line["color"], "linewidths": line["linewidth"], "linestyles": line["linestyle"]}
