"""Figures with one or several panels, and elements that several figures share."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import MappingProxyType
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from drake_quad.statistics.interval import Interval
from drake_quad.visualization.style import new_figure, use_style


@contextmanager
def new_panels(
    width: float, height: float, *grid: int, settings: Mapping[str, Any] = MappingProxyType({}), **options: Any
) -> Iterator[tuple[Figure, Any]]:
    """Create a figure, and draw it in the style of the project inside a `with` statement.

    The statement yields the figure and its axes: a single `Axes`, or for a grid an array with rows and columns.

    Args:
        width: width of the figure, inches.
        height: height of the figure, inches.
        grid: number of rows and number of columns of axes; empty for a single `Axes`.
        settings: Matplotlib settings that replace those of the style.
        options: options of `Figure.subplots`.
    """
    with use_style(settings):
        figure = new_figure(width, height)
        yield figure, figure.subplots(*grid, squeeze=not grid, **options)


def legend_above(figure: Figure, axes: Axes, num_columns: int, **options: Any) -> None:
    """Draw a legend of the curves in some axes above a figure. The options are passed to `Figure.legend`."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=num_columns, **options)


def name_rows(axes: Axes, names: Sequence[str]) -> None:
    """Label the rows of a chart, which are at 0, 1, 2, ... on the vertical axis, from top to bottom."""
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(max(len(names), 1) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")


def plot_intervals(axes: Axes, x: ArrayLike, intervals: Sequence[Interval] | np.ndarray, **options: Any) -> None:
    """Plot estimates with their confidence intervals. The options are passed to `Axes.errorbar`."""
    value, low, high = np.transpose(intervals)
    axes.errorbar(x, value, (value - low, high - value), **options)
