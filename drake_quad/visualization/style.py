"""How every figure of the project looks."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
import numpy as np
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

# M. Okabe and K. Ito, "Color universal design", 2008: distinguishable with any colour vision.
BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILION, PURPLE = (
    "#000000",
    "#E69F00",
    "#56B4E9",
    "#009E73",
    "#F0E442",
    "#0072B2",
    "#D55E00",
    "#CC79A7",
)
REFERENCE: dict[str, Any] = {"color": "0.45", "linestyle": "--", "linewidth": 1.2}
LIMIT: dict[str, Any] = {"color": "0.3", "linestyle": ":", "linewidth": 1.2}
# Keeps text legible where it crosses a line.
PLATE: dict[str, Any] = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0}
AXES = {"x": BLUE, "y": VERMILION, "z": GREEN}
# Light enough for lines and arrows on top.
SHADING = LinearSegmentedColormap.from_list("shading", colormaps["Blues"](np.linspace(0.0, 0.6, 64)))
ROTORS = (BLUE, VERMILION, GREEN, PURPLE)

_SETTINGS: Any = {
    "figure.dpi": 110,
    "savefig.dpi": 150,
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
}


@contextmanager
def styled() -> Iterator[None]:
    """Within it, figures are drawn in the style of the project; outside, nothing has changed."""
    with matplotlib.rc_context(_SETTINGS):
        yield


def new_figure(width: float, height: float) -> Figure:
    """Returns an empty figure of that size in inches, apart from any window or notebook."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure
