"""Panels of figures, and their common parts."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from drake_quad.statistics.interval import Interval
from drake_quad.visualization.style import new_figure, styled


@contextmanager
def new_panels(
    width: float, height: float, *grid: int, settings: Mapping[str, Any] = MappingProxyType({}), **options: Any
) -> Iterator[tuple[Figure, Any]]:
    """Open a context in which a figure is drawn in the style of the project.

    The context yields the figure and its axes: by default a single one, for a grid an array of rows and columns.

    Args:
        width: width of the figure, inches.
        height: height of the figure, inches.
        grid: number of rows and of columns of axes.
        settings: settings of Matplotlib in place of those of the style.
        options: options of `Figure.subplots`.
    """
    with styled(settings):
        figure = new_figure(width, height)
        yield figure, figure.subplots(*grid, squeeze=not grid, **options)


def legend_above(figure: Figure, axes: Axes, num_columns: int, **options: Any) -> None:
    """Draw the legend of the curves of some axes above the figure; the options are those of `Figure.legend`."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=num_columns, **options)


def name_rows(axes: Axes, names: Sequence[str]) -> None:
    """Name rows at the heights 0, 1, ... from the top to the bottom."""
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(max(len(names), 1) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")


def plot_intervals(axes: Axes, x: ArrayLike, intervals: Sequence[Interval] | np.ndarray, **options: Any) -> None:
    """Plot estimates with their confidence intervals; the options are those of `Axes.errorbar`."""
    value, low, high = np.transpose(intervals)
    axes.errorbar(x, value, (value - low, high - value), **options)
