"""Line styles that distinguish overlapping curves, and quantiles in place of many curves."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

# Curves coincide if they are nearer than this distance (points) over more than this share of their length.
_MAX_SEPARATION, _MIN_OVERLAP = 1.2, 0.25
# Length of a dash of one of several coinciding curves, in line widths.
_DASH_LENGTH = 5.0


def tell_apart(axes: Axes) -> None:
    """Dash the curves that lie on top of other curves, so that the colour of each curve is visible.

    If n curves coincide, the first one stays solid, the second shows (n - 1) / n of its length, and the last one 1 / n.
    Only solid curves over the same abscissas are compared.

    Args:
        axes: axes with all their curves.
    """
    axes.autoscale_view()  # otherwise Matplotlib scales the axes only when it draws
    left: list[Line2D] = [line for line in axes.lines if np.size(line.get_xdata()) > 2 and line.get_linestyle() == "-"]
    while left:
        first, *others = left
        group = [first, *(other for other in others if _coincide(axes, first, other))]
        for place, line in enumerate(group[1:], start=1):
            line.set_linestyle(dashes(place, len(group)))
        left = [line for line in others if line not in group]


def dashes(place: int, count: int) -> tuple[float, Sequence[float]]:
    """Return the line style of the curve with index `place` among `count` curves that coincide."""
    return (0.0, (_DASH_LENGTH * (count - place), _DASH_LENGTH * place))


def _coincide(axes: Axes, one: Line2D, other: Line2D) -> bool:
    a, b = (np.asarray(line.get_xydata(), dtype=float) for line in (one, other))
    if a.shape != b.shape:
        return False
    distance = np.linalg.norm(axes.transData.transform(a) - axes.transData.transform(b), axis=1)
    points = distance * 72.0 / axes.figure.dpi
    return bool(np.mean(points < _MAX_SEPARATION) > _MIN_OVERLAP)


def quantiles_over_flights(values: np.ndarray, shares: Sequence[float]) -> np.ndarray:
    """Return quantiles (shares, n) at each of n instants over values (flights, n), without NaN; NaN if all are NaN."""
    found = np.full((len(shares), values.shape[1]), np.nan)
    there = ~np.isnan(values).all(axis=0)
    found[:, there] = np.nanquantile(values[:, there], shares, axis=0)
    return found
