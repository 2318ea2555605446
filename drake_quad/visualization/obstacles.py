"""Drawing of obstacles in two-dimensional and three-dimensional views of a path."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from matplotlib.patheffects import withStroke
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from drake_quad.space.space import Space

# Obstacles are translucent because their projections can overlap.
_SOLID_STYLE: dict[str, Any] = {"facecolor": (0.35, 0.35, 0.35, 0.5), "edgecolor": "0.35", "linewidth": 0.8}
# From the side, many obstacles hide each other and the path, so they share one light silhouette without outlines.
_SILHOUETTE_STYLE: dict[str, Any] = {"facecolor": "0.88", "linewidth": 0.0}
_MAX_OUTLINED_OBSTACLES = 6  # more obstacles share a silhouette
_CLEARANCE_STYLE: dict[str, Any] = {"fill": False, "edgecolor": "0.55", "linewidth": 0.7, "linestyle": (0, (2, 2))}
_NAME_STYLE: dict[str, Any] = {
    "fontsize": 6,
    "color": "0.25",
    "horizontalalignment": "center",
    "verticalalignment": "top",
}
# Names are drawn for at most this many obstacles, since more names would hide the obstacles.
_MAX_NAMES = 30
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)  # rad, angles of the points of a drawn circle


def draw_obstacles(axes: Axes, space: Space, i: int, j: int, *, clearance: bool = False) -> None:
    """Draw the projections of obstacles onto a plane.

    In a view from above, the obstacles are labelled with their names unless there are too many. In a view from the
    side, many obstacles are drawn as one silhouette.

    Args:
        axes: axes in metres.
        space: space with the obstacles.
        i: index of the axis of W that points to the right.
        j: index of the axis of W that points upwards.
        clearance: True to draw the clearance that a planned path keeps, as a dashed outline around each obstacle.
            The path may cross this outline above, below, in front of or behind the obstacle.
    """
    is_crowded = (i, j) != (0, 1) and len(space.obstacles) > _MAX_OUTLINED_OBSTACLES
    for obstacle in space.obstacles:
        corners = convex_hull(obstacle.shape.triangles().reshape(-1, 3)[:, [i, j]])
        axes.add_patch(Polygon(corners, **(_SILHOUETTE_STYLE if is_crowded else _SOLID_STYLE)))
        if clearance and not is_crowded:
            rounding = space.clearance * np.column_stack([np.cos(_CIRCLE), np.sin(_CIRCLE)])
            outline = convex_hull((corners[:, np.newaxis] + rounding).reshape(-1, 2))
            axes.add_patch(Polygon(outline, **_CLEARANCE_STYLE))
        if (i, j) == (0, 1) and len(space.obstacles) <= _MAX_NAMES:
            halo = [withStroke(linewidth=1.5, foreground="white", alpha=0.8)]
            below = (corners[:, 0].mean(), corners[:, 1].min())
            axes.text(*below, obstacle.name, path_effects=halo, clip_on=True, **_NAME_STYLE)


def draw_solids(axes: Any, space: Space) -> np.ndarray:
    """Draw obstacles in three dimensions, and return the lower and upper corners (2, 3) of their bounding box, m."""
    for obstacle in space.obstacles:
        axes.add_collection3d(Poly3DCollection(obstacle.shape.triangles(), facecolors="0.6", alpha=0.45, shade=True))
    extents = np.array([obstacle.shape.extent() for obstacle in space.obstacles])
    return np.array([extents[:, 0].min(axis=0), extents[:, 1].max(axis=0)])


def convex_hull(points: np.ndarray) -> np.ndarray:
    """Return the corners (m, 2) of the convex hull of points (n, 2), anticlockwise."""
    # SciPy's spatial module is imported here because flights without obstacles do not need it.
    from scipy.spatial import ConvexHull

    return np.asarray(points[ConvexHull(points).vertices])
