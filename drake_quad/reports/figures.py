"""Figures of reports, as wide as a column of a journal, and their common parts."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from PIL import Image

from drake_quad.statistics.interval import Interval
from drake_quad.visualization.style import new_figure, styled

# Width of a column of the paper's journal, inches.
COLUMN = 3.5
# Dots per inch, and colours of the palette.
_DPI, _COLOURS = 220, 128


@contextmanager
def in_print() -> Iterator[None]:
    """A context in which figures are drawn in the style of the project, with letters for the width of a column."""
    small: Any = {
        "font.size": 8,
        "axes.labelsize": 8,
        "axes.titlesize": 8,
        "legend.fontsize": 7.5,
        "lines.linewidth": 1.1,
    }
    with styled(), matplotlib.rc_context({**small, "xtick.labelsize": 7.5, "ytick.labelsize": 7.5}):
        yield


@contextmanager
def new_panels(height: float, *grid: int, width: float = COLUMN, **options: Any) -> Iterator[tuple[Figure, Any]]:
    """A context in which a figure is drawn as for `in_print`: the figure, and its axes or the array of its axes.

    Args:
        height: height of the figure, inches.
        grid: number of rows and of columns of axes; a single one by default.
        width: width of the figure, inches.
        options: options of `Figure.subplots`.
    """
    with in_print():
        figure = new_figure(width, height)
        yield figure, figure.subplots(*grid, **options)


def legend_above(figure: Figure, axes: Axes, num_columns: int, **options: Any) -> None:
    """Draw the legend of the curves of some axes above the figure; the options are those of `Figure.legend`."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=num_columns, **options)


def name_rows(axes: Axes, names: Sequence[str]) -> None:
    """Name rows at the heights 0, 1, ... from the top to the bottom."""
    axes.set_yticks(range(len(names)), names)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")


def plot_intervals(axes: Axes, x: ArrayLike, intervals: Sequence[Interval], **options: Any) -> None:
    """Plot estimates with their confidence intervals; the options are those of `Axes.errorbar`."""
    value, low, high = np.transpose(intervals)
    axes.errorbar(x, value, (value - low, high - value), **options)


def save_small(figure: Figure, path: Path) -> None:
    """Writes a figure as PNG with a palette, which is a few times smaller than with full colours."""
    buffer = BytesIO()
    figure.savefig(buffer, dpi=_DPI)
    Image.open(buffer).convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
