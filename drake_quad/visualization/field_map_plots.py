"""Plot of a flight metric as a function of two scenario fields."""

import math
from collections.abc import Mapping

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, MaxNLocator

from drake_quad.design.field_map import FieldMap
from drake_quad.visualization.panels import new_panels

_MAX_COLUMNS = 4  # largest number of panels side by side
_CRASHED_COLOUR = "0.35"
_VIOLATED_COLOUR = "0.85"
# Small values are dark, so that they stand out from the light grey of violated requirements.
_COLOURS = ListedColormap(colormaps["Blues"](np.linspace(1.0, 0.25, 64)))


def plot_field_maps(
    maps: Mapping[str, FieldMap], metric: str, *, labels: tuple[str, str], units: tuple[str, str]
) -> Figure:
    """Plot a metric of the flights that satisfy all requirements as colours, with a panel for each controller.

    Args:
        maps: map of each controller, by its name. All have the same axes.
        metric: name of the metric.
        labels: labels of the horizontal and of the vertical axis, without units.
        units: units of the two fields. Angles are shown in degrees.
    """
    first = next(iter(maps.values()))
    definition = first.metrics.definitions[metric]
    unit, size = (definition.unit, 1.0) if definition.display is None else definition.display[:2]
    values = np.concatenate([getattr(each.metrics, metric)[each.satisfied] for each in maps.values()])
    finite = values[np.isfinite(values)] / size
    norm = Normalize(*((finite.min(), finite.max()) if len(finite) else (0.0, 1.0)))
    columns = min(len(maps), _MAX_COLUMNS)
    rows = math.ceil(len(maps) / columns)
    factors = [math.degrees(1.0) if each == "rad" else 1.0 for each in units]
    x, y = factors[0] * first.x, factors[1] * first.y
    edges = (*_ends(x), *_ends(y))
    with new_panels(1.2 + 2.1 * columns, 1.3 + 2.1 * rows, rows, columns, sharex=True, sharey=True) as (figure, grid):
        for i in range(len(maps), grid.size):
            grid.flat[i].set_visible(False)
            grid.flat[i - columns].tick_params(labelbottom=True)
        for axes, (name, each) in zip(grid.flat, maps.items(), strict=False):
            background = np.where(each.metrics.crashed, 1.0, 0.0)
            greys = ListedColormap([_VIOLATED_COLOUR, _CRASHED_COLOUR])
            options = {"origin": "lower", "extent": edges, "aspect": "auto"}
            axes.imshow(background, cmap=greys, vmin=0.0, vmax=1.0, **options)
            shown = np.where(each.satisfied, getattr(each.metrics, metric) / size, np.nan)
            axes.imshow(np.ma.masked_invalid(shown), cmap=_COLOURS, norm=norm, **options)
            axes.set_title(f"{name}: {100.0 * each.satisfied.mean():.0f} %")
            axes.grid(visible=False)
            for axis, each_unit in zip((axes.xaxis, axes.yaxis), units, strict=True):
                if each_unit == "rad":
                    axis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 1.5, 3, 4.5, 9, 10]))
        figure.supxlabel(f"{labels[0]} ({_shown_unit(units[0])})", fontsize=9.5)
        figure.supylabel(f"{labels[1]} ({_shown_unit(units[1])})", fontsize=9.5)
        bar = figure.colorbar(
            ScalarMappable(norm, _COLOURS), ax=grid, label=f"{definition.label} ({unit})", fraction=0.04, pad=0.02
        )
        bar.ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        handles = [Patch(color=_CRASHED_COLOUR, label="crashed")]
        if first.requirements:
            handles.append(Patch(color=_VIOLATED_COLOUR, label="a requirement is violated"))
        handles.append(Patch(color=_COLOURS(0.4), label="other flights (percentage in the titles)"))
        figure.legend(handles=handles, loc="outside upper center", ncols=3)
        return figure


def _ends(centres: np.ndarray) -> tuple[float, float]:
    """Return the ends of a map axis, given the centres of its cells."""
    half = 0.5 * (centres[1] - centres[0])
    return float(centres[0] - half), float(centres[-1] + half)


def _shown_unit(unit: str) -> str:
    return "°" if unit == "rad" else unit
