"""Figures of reports, as wide as a column of a journal."""

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from PIL import Image

from drake_quad.visualization.style import styled

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


def save_small(figure: Figure, path: Path) -> None:
    """Writes a figure as PNG with a palette, which is a few times smaller than with full colours."""
    buffer = BytesIO()
    figure.savefig(buffer, dpi=_DPI)
    Image.open(buffer).convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
