"""Obstacles in views of a path from a side or from above."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from drake_quad.space.space import Space

# One shadow may lie on another.
_SOLID: dict[str, Any] = {"facecolor": (0.35, 0.35, 0.35, 0.5), "edgecolor": "0.35", "linewidth": 0.8}
_CLEARANCE: dict[str, Any] = {"fill": False, "edgecolor": "0.55", "linewidth": 0.7, "linestyle": (0, (2, 2))}
_NAME: dict[str, Any] = {"fontsize": 6, "color": "0.25", "horizontalalignment": "center", "verticalalignment": "top"}
# More names than these hide what they name.
_MOST_NAMES = 30
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)


def draw_obstacles(axes: Axes, space: Space, i: int, j: int, *, clearance: bool = False) -> None:
    """Draws the shadows that obstacles cast in a plane, from above with their names, if they are not too many.

    Args:
        axes: with metres on both axes.
        space: whose obstacles are drawn.
        i: axis of W to the right.
        j: axis of W upwards.
        clearance: whether how far a planned path keeps from them is drawn, too: around a shadow it is exact where the
            path is at the height, or the depth, at which the shadow ends.
    """
    for obstacle in space.obstacles:
        corners = shadow(obstacle.shape.triangles().reshape(-1, 3)[:, [i, j]])
        axes.add_patch(Polygon(corners, **_SOLID))
        if clearance:
            rounding = space.clearance * np.column_stack([np.cos(_CIRCLE), np.sin(_CIRCLE)])
            axes.add_patch(Polygon(shadow((corners[:, np.newaxis] + rounding).reshape(-1, 2)), **_CLEARANCE))
        if (i, j) == (0, 1) and len(space.obstacles) <= _MOST_NAMES:
            halo = [withStroke(linewidth=1.5, foreground="white", alpha=0.8)]
            below = (corners[:, 0].mean(), corners[:, 1].min())
            axes.text(*below, obstacle.name, path_effects=halo, clip_on=True, **_NAME)


def draw_solids(axes: Any, space: Space) -> np.ndarray:
    """Draws obstacles in three dimensions, and returns the (2, 3) corners of the box around them all, m."""
    for obstacle in space.obstacles:
        axes.add_collection3d(Poly3DCollection(obstacle.shape.triangles(), facecolors="0.6", alpha=0.45, shade=True))
    extents = np.array([obstacle.shape.extent() for obstacle in space.obstacles])
    return np.array([extents[:, 0].min(axis=0), extents[:, 1].max(axis=0)])


def shadow(points: np.ndarray) -> np.ndarray:
    """Returns the (corners, 2) convex polygon around points (n, 2), anticlockwise."""
    # Imported here because flights without obstacles do not need it.
    from scipy.spatial import ConvexHull

    return np.asarray(points[ConvexHull(points).vertices])
