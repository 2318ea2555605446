"""Approximation of a convex hull by an enclosing hull with fewer corners.

1. The algorithm selects some of the corners: first the extreme corners along the coordinate axes, then repeatedly the
   corner that is farthest from the hull of the selected corners.
2. It shifts and scales the hull of the selected corners by the smallest factor with which the hull contains all
   corners. Scaling keeps the face normals, so the shift and the factor follow from a linear programme.

The result contains the original hull. The point of the result that is farthest from the original hull is one of its
corners, so only the distances of the corners are computed.

The algorithm runs twice: with distances in metres, and with distances in principal axes that are scaled so that the
hull has the same width along each axis. The better result is returned.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from drake_quad.errors import InputError
from drake_quad.space.shapes import convex_hull

# Largest allowed growth when a hull is replaced by one with fewer corners that contains it. The growth is the largest
# distance between the two hulls, relative to the size of the hull. If the hull of a finely meshed sphere is simplified
# to 100 corners, it grows by 2.5 %. The hull of a drone's mesh, which has flat sides, grows by less than 1 %.
MAX_GROWTH = 0.05
# Largest number of candidate corners. If a hull has more corners, the candidates are the extreme corners along this
# number of directions.
_MAX_CANDIDATES = 500
# Smallest margin by which the result is enlarged, relative to its smallest width. It ensures that the result contains
# all corners despite rounding.
_MIN_ROUNDING_MARGIN = 1e-9
# Largest rounding error of the distance between a point and a face, relative to the largest coordinate. It is the sum
# of the errors from three products, from the additions, and from the corners themselves.
_ROUNDING_ERROR = 16.0 * float(np.finfo(float).eps)


class SimplifiedHull(NamedTuple):
    """Simplified convex hull that contains an original hull.

    Attributes:
        corners: (n, 3) corners of the hull, m.
        growth: largest distance between a corner and the original hull, m; 0 if the hulls are equal.
        replaced: number of corners of the original hull, which this hull replaces.
        size: largest extent of the original hull along a coordinate axis, m.
    """

    corners: np.ndarray
    growth: float
    replaced: int
    size: float

    @property
    def is_simpler(self) -> bool:
        """True if the hull has fewer corners than the original hull. Otherwise the two hulls are equal."""
        return len(self.corners) < self.replaced

    def __str__(self) -> str:
        """Return a sentence about the replacement of the original hull, with the growth."""
        fraction = 100.0 * self.growth / self.size
        return (
            f"its convex hull with {self.replaced} corners is replaced by an enclosing hull with {len(self.corners)}"
            f" corners, larger by at most {self.growth:.3g}, {fraction:.2g} % of its size"
        )


def simplified_hull(points: ArrayLike, max_corners: int) -> SimplifiedHull:
    """Return a convex hull with few corners that encloses points.

    Args:
        points: (n, 3) points that the hull must contain, m.
        max_corners: largest number of corners. If the hull of the points has no more corners, it is returned unchanged.

    Raises:
        InputError: if the hull of the points has no volume, no enclosing hull is found, or it would be larger than the
            original hull by more than `MAX_GROWTH` of its size.
    """
    array = np.ascontiguousarray(points, dtype=float)
    return _surrounding(array.tobytes(), array.shape, max_corners)


@functools.lru_cache(maxsize=32)
def _surrounding(data: bytes, shape: tuple[int, ...], max_corners: int) -> SimplifiedHull:
    hull = convex_hull(np.frombuffer(data).reshape(shape))
    corners = np.array(hull.corners)
    size = float(np.ptp(corners, axis=0).max())
    if len(corners) <= max_corners:
        return SimplifiedHull(corners, 0.0, len(corners), size)
    # The solver has absolute tolerances, so coordinates are scaled until the hull has the width 1 along each axis.
    middle, _, axes = _principal(corners)
    offsets = corners - middle
    along = offsets @ axes.T
    widths = np.ptp(along, axis=0)
    as_wide_as_long = along / widths
    margin = max(_MIN_ROUNDING_MARGIN, _ROUNDING_ERROR * float(np.abs(corners).max() / widths.min()))
    hulls = []
    candidates = _candidates(as_wide_as_long)
    for each in (offsets / size, as_wide_as_long):
        selected = candidates[_select_corners(each[candidates], max_corners)]
        enlarged = _scaled_to_contain(as_wide_as_long, as_wide_as_long[selected], margin)
        hulls.append(middle + (enlarged * widths) @ axes)
    growths = [float(hull.distances(each).max()) for each in hulls]
    best = int(np.argmin(growths))
    if growths[best] > MAX_GROWTH * size:
        raise InputError(
            f"the convex hull has {len(corners)} corners, and an enclosing hull with {max_corners} corners would be"
            f" larger by {100.0 * growths[best] / size:.2g} % of its size, more than {100.0 * MAX_GROWTH:g} %; simplify"
            " the mesh"
        )
    return SimplifiedHull(hulls[best], growths[best], len(corners), size)


def _principal(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the centre of the given corners, and the singular values and directions of their principal axes."""
    middle = corners.mean(axis=0)
    _, widths, axes = np.linalg.svd(corners - middle, full_matrices=False)
    return middle, widths, axes


def _candidates(corners: np.ndarray) -> np.ndarray:
    """Return the indices of at most `_MAX_CANDIDATES` corners, from which the simplified hull is built."""
    if len(corners) <= _MAX_CANDIDATES:
        return np.arange(len(corners))
    return np.unique((corners @ _directions(_MAX_CANDIDATES).T).argmax(axis=0))


def _select_corners(candidates: np.ndarray, count: int) -> np.ndarray:
    """Return the indices of `count` corners, each selected as the farthest from the hull of the preceding corners."""
    selected = list(dict.fromkeys([*candidates.argmax(axis=0).tolist(), *candidates.argmin(axis=0).tolist()]))
    while len(selected) < count:
        distances = _distances_from_hull(candidates, candidates[selected])
        distances[selected] = -np.inf
        selected.append(int(distances.argmax()))
    return np.array(selected)


def _directions(count: int) -> np.ndarray:
    """Return evenly spread unit vectors (count, 3), a Fibonacci lattice on the sphere."""
    index = np.arange(count) + 0.5
    height = 1.0 - 2.0 * index / count
    angle = math.pi * (3.0 - math.sqrt(5.0)) * index
    across = np.sqrt(1.0 - height * height)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), height])


def _distances_from_hull(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the distances (n,) of points (n, 3) from the hull of corners, normal to its faces; negative inside.

    If the corners span only a plane, a line or a point, the distance is measured from this subspace.
    """
    middle, widths, axes = _principal(corners)
    if len(corners) < 4 or widths[-1] <= 1e-6 * widths[0]:
        # Qhull needs four corners that span a volume.
        spanned = axes[widths > 1e-6 * widths[0]]
        offset = points - middle
        distances: np.ndarray = np.linalg.norm(offset - offset @ spanned.T @ spanned, axis=1)
        return distances
    normals, offsets = _faces(corners)
    outside: np.ndarray = (points @ normals.T - offsets).max(axis=1)
    return outside


def _faces(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the outward unit normals (n, 3) and the offsets (n,) of the faces of a hull."""
    middle, widths, axes = _principal(corners)
    # Qhull fails for thin hulls, so the corners are scaled to the same spread along each principal axis.
    scaled_normals = scipy.spatial.ConvexHull((corners - middle) @ axes.T / widths).equations[:, :3]
    normals = (scaled_normals / widths) @ axes
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals, (normals @ corners.T).max(axis=1)


def _scaled_to_contain(points: np.ndarray, corners: np.ndarray, margin: float) -> np.ndarray:
    """Shift corners, and scale them by the smallest factor with which their hull contains all points.

    Args:
        points: (n, 3) points around the origin, scaled so that their hull has the width 1 along each axis.
        corners: (m, 3) some of these points.
        margin: distance by which the hull exceeds the smallest possible hull, in the units of the points.

    Raises:
        InputError: if the solver fails.
    """
    inside = corners.mean(axis=0)
    centred = corners - inside
    normals, offsets = _faces(centred)
    support = (points @ normals.T).max(axis=0)
    # After shift and scaling, a face n·x <= d becomes n·x <= n·shift + factor d.
    smallest = scipy.optimize.linprog(
        [0.0, 0.0, 0.0, 1.0], A_ub=-np.column_stack([normals, offsets]), b_ub=-support, bounds=(None, None)
    )
    if smallest.x is None:
        raise InputError(
            f"no enclosing hull with {len(corners)} corners was found for the convex hull with {len(points)} corners;"
            " simplify the mesh"
        )
    shift = smallest.x[:3]
    # The solver may violate a face by its tolerance, so the factor is computed again from the solution. All offsets are
    # positive.
    factor = float(((support + margin - normals @ shift) / offsets).max())
    enlarged: np.ndarray = shift + factor * centred
    return enlarged
