"""Style of all figures, and functions that create and write figures."""

import functools
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from drake_quad.files import write_atomically

# Matplotlib takes half a second to import, but some modules need only a colour or the type `Vector` from this module.
if TYPE_CHECKING:
    from matplotlib.colors import Colormap
    from matplotlib.figure import Figure

# The following colours are distinguishable in all types of colour vision (M. Okabe and K. Ito, "Color universal
# design", 2008).
BLACK = "#000000"
ORANGE = "#E69F00"
SKY = "#56B4E9"
GREEN = "#009E73"
YELLOW = "#F0E442"
BLUE = "#0072B2"
VERMILION = "#D55E00"
PURPLE = "#CC79A7"
REFERENCE: dict[str, Any] = {"color": "0.45", "linestyle": "--", "linewidth": 1.2}
LIMIT: dict[str, Any] = {"color": "0.3", "linestyle": ":", "linewidth": 1.2}
# Background that keeps a text legible if it crosses a line.
TEXT_BACKGROUND: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0}
# Position of a legend above the right end of the axes, so that it hides no curve.
LEGEND_ABOVE: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "borderaxespad": 0.2}
AXIS_COLORS = {"x": BLUE, "y": VERMILION, "z": GREEN}
ROTOR_COLORS = (BLUE, VERMILION, GREEN, PURPLE)

_SETTINGS: Any = {
    "figure.dpi": 110,
    "font.size": 9.5,
    "axes.titlesize": 10,
    "axes.labelsize": 9.5,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "0.9",
    "grid.linewidth": 0.8,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "legend.fontsize": 9,
    # Publishers require TrueType fonts. The fixed salt makes SVG files reproducible byte by byte.
    "pdf.fonttype": 42,
    "svg.hashsalt": "drake_quad",
}

Vector = Literal["pdf", "svg"]
_NO_DATE: dict[str, Any] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}


@functools.cache
def shading() -> "Colormap":
    """Return a colour map for areas, light enough for lines and arrows on top of the areas."""
    from matplotlib import colormaps
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("shading", colormaps["Blues"](np.linspace(0.0, 0.6, 64)))


@contextmanager
def use_style(settings: Mapping[str, Any] = MappingProxyType({})) -> Iterator[None]:
    """Apply the style of the project to figures inside a `with` statement, and then restore Matplotlib's settings.

    Args:
        settings: Matplotlib settings that replace those of the style.
    """
    import matplotlib

    with matplotlib.rc_context(_SETTINGS | dict(settings)):
        yield


def new_figure(width: float, height: float) -> "Figure":
    """Return an empty figure. It opens no window, but a notebook displays it as the value of a cell.

    Args:
        width: width, inches.
        height: height, inches.
    """
    from drake_quad.visualization.notebook_figure import NotebookFigure

    return NotebookFigure(figsize=(width, height), layout="constrained")


def save_figures(figures: Mapping[str, "Figure"], folder: Path, *, vector: Vector | None = None) -> list[Path]:
    """Write each figure as a PNG file, optionally also in a vector format, and return the paths of the files.

    Args:
        figures: figures by the names of their files, without a suffix.
        folder: folder for the files.
        vector: format of additional vector graphics; None for no vector graphics.
    """
    files = []
    for name, figure in figures.items():
        with use_style():
            files.append(write_atomically(folder / f"{name}.png", figure.savefig))
        if vector is not None:
            files.append(save_vector(figure, folder / f"{name}.{vector}", vector))
    return files


def save_vector(figure: "Figure", path: Path, kind: Vector) -> Path:
    """Write a figure as a PDF or SVG file without a date, so that the file is reproducible, and return its path."""
    with use_style():
        return write_atomically(path, lambda target: figure.savefig(target, format=kind, metadata=_NO_DATE[kind]))
