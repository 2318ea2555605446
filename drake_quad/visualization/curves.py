"""Line styles that distinguish overlapping curves, and quantiles over many flights."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

# Two curves overlap if the distance between them is below `_OVERLAP_DISTANCE` at more than this fraction of the
# abscissas.
_MIN_OVERLAP = 0.25
_OVERLAP_DISTANCE = 1.2  # typographic points, 1/72 inch
# Dashes of overlapping curves, and the gaps between them, are multiples of this length, in line widths.
_DASH_LENGTH = 5.0


def dash_overlapping_curves(axes: Axes) -> None:
    """Dash the curves that lie on top of other curves, so that the colour of each curve is visible.

    If n curves overlap, the first one stays solid. The dashes of the second curve cover (n - 1) / n of its length, and
    the dashes of the last curve cover 1 / n. Only solid curves with the same abscissas are compared.

    Args:
        axes: axes in which all curves have been drawn.
    """
    axes.autoscale_view()  # Matplotlib scales the axes only when it draws, but distances are needed now
    remaining: list[Line2D] = [
        line for line in axes.lines if np.size(line.get_xdata()) > 2 and line.get_linestyle() == "-"
    ]
    while remaining:
        first, *others = remaining
        group = [first, *(other for other in others if _coincide(axes, first, other))]
        for index, line in enumerate(group[1:], start=1):
            line.set_linestyle(dashes(index, len(group)))
        remaining = [line for line in others if line not in group]


def dashes(index: int, count: int) -> tuple[float, Sequence[float]]:
    """Return the line style of the curve with this index among `count` overlapping curves."""
    return (0.0, (_DASH_LENGTH * (count - index), _DASH_LENGTH * index))


def _coincide(axes: Axes, one: Line2D, other: Line2D) -> bool:
    a, b = (np.asarray(line.get_xydata(), dtype=float) for line in (one, other))
    if a.shape != b.shape:
        return False
    distance = np.linalg.norm(axes.transData.transform(a) - axes.transData.transform(b), axis=1)
    points = distance * 72.0 / axes.figure.dpi
    return bool(np.mean(points < _OVERLAP_DISTANCE) > _MIN_OVERLAP)


def quantiles_over_flights(values: np.ndarray, probabilities: Sequence[float]) -> np.ndarray:
    """Return quantiles over the flights, ignoring NaN, at each of n instants; NaN where all flights are NaN.

    Args:
        values: values (flights, n).
        probabilities: probabilities of the quantiles.

    Returns:
        The quantiles (probabilities, n).
    """
    quantiles = np.full((len(probabilities), values.shape[1]), np.nan)
    has_values = ~np.isnan(values).all(axis=0)
    quantiles[:, has_values] = np.nanquantile(values[:, has_values], probabilities, axis=0)
    return quantiles
