"""Figures of reports, as wide as a column of a journal."""

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from PIL import Image

from drake_quad.visualization.panels import new_panels

# Width of a column of the paper's journal, inches.
COLUMN = 3.5
# Dots per inch, and colours of the palette.
_DPI, _COLOURS = 220, 128


_SMALL = dict.fromkeys(("font.size", "axes.labelsize", "axes.titlesize"), 8) | dict.fromkeys(
    ("legend.fontsize", "xtick.labelsize", "ytick.labelsize"), 7.5
)


@contextmanager
def print_panels(height: float, *grid: int, width: float = COLUMN, **options: Any) -> Iterator[tuple[Figure, Any]]:
    """The context of `new_panels` with letters and lines for the width of a column, which is the default width."""
    with new_panels(width, height, *grid, settings={**_SMALL, "lines.linewidth": 1.1}, **options) as found:
        yield found


def save_small(figure: Figure, path: Path) -> None:
    """Writes a figure as PNG with a palette, which is a few times smaller than with full colours."""
    buffer = BytesIO()
    figure.savefig(buffer, dpi=_DPI)
    Image.open(buffer).convert("RGB").quantize(_COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)
