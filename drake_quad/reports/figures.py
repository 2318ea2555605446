"""Figures of reports, which fit into a journal column."""

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from PIL import Image

from drake_quad.visualization.panels import new_panels

# Width of a column in the journal in which Kayacan and Maslim (2016) was published, inches.
COLUMN_WIDTH = 3.5
_DOTS_PER_INCH = 220  # resolution of a PNG file
_NUM_COLOURS = 128  # size of the palette of a PNG file


_SMALL_FONTS = dict.fromkeys(("font.size", "axes.labelsize", "axes.titlesize"), 8) | dict.fromkeys(
    ("legend.fontsize", "xtick.labelsize", "ytick.labelsize"), 7.5
)


@contextmanager
def print_panels(
    height: float, *grid: int, width: float = COLUMN_WIDTH, **options: Any
) -> Iterator[tuple[Figure, Any]]:
    """Yield a figure and its panels like `new_panels`, with small fonts and thin lines for the width of a column.

    Args:
        height: height of the figure, inches.
        grid: numbers of rows and columns of panels.
        width: width of the figure, inches.
        options: further options of `new_panels`.
    """
    with new_panels(
        width, height, *grid, settings={**_SMALL_FONTS, "lines.linewidth": 1.1}, **options
    ) as figure_and_panels:
        yield figure_and_panels


def save_small(figure: Figure, path: Path) -> None:
    """Write a figure as a PNG file with a colour palette, which is a few times smaller than a true-colour file."""
    buffer = BytesIO()
    figure.savefig(buffer, dpi=_DOTS_PER_INCH)
    Image.open(buffer).convert("RGB").quantize(_NUM_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
