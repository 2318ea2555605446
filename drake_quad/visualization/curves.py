"""Line styles that distinguish overlapping curves, and quantiles in place of many curves."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

# Curves that are nearer than this on the page, in points, over more than this share of their length, coincide.
_NEAR, _SHARE = 1.2, 0.25
# Of each curve that is seen of those that coincide, in widths of the line.
_SEEN = 5.0


def tell_apart(axes: Axes) -> None:
    """Dashes the curves of axes that lie on top of others, so that the colour of each is seen.

    Of n that coincide the first drawn stays whole; of the next, (n - 1) / n is drawn, and of the last 1 / n. Only
    solid curves over the same places are compared.

    Args:
        axes: with all that they show.
    """
    axes.autoscale_view()  # Matplotlib would only do so as it draws
    left: list[Line2D] = [line for line in axes.lines if np.size(line.get_xdata()) > 2 and line.get_linestyle() == "-"]
    while left:
        first, *others = left
        group = [first, *(other for other in others if _coincide(axes, first, other))]
        for place, line in enumerate(group[1:], start=1):
            line.set_linestyle(dashes(place, len(group)))
        left = [line for line in others if line not in group]


def dashes(place: int, count: int) -> tuple[float, Sequence[float]]:
    """The style of a curve that is drawn as number `place`, from 0 on, of several that coincide."""
    return (0.0, (_SEEN * (count - place), _SEEN * place))


def _coincide(axes: Axes, one: Line2D, other: Line2D) -> bool:
    a, b = (np.asarray(line.get_xydata(), dtype=float) for line in (one, other))
    if a.shape != b.shape:
        return False
    distance = np.linalg.norm(axes.transData.transform(a) - axes.transData.transform(b), axis=1)
    points = distance * 72.0 / axes.figure.dpi
    return bool(np.mean(points < _NEAR) > _SHARE)


def quantiles_over_flights(values: np.ndarray, shares: Sequence[float]) -> np.ndarray:
    """Return quantiles (shares, n) at each of n instants over values (flights, n), without NaN; NaN if all are NaN."""
    found = np.full((len(shares), values.shape[1]), np.nan)
    there = ~np.isnan(values).all(axis=0)
    found[:, there] = np.nanquantile(values[:, there], shares, axis=0)
    return found
