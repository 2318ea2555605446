"""Convex hulls of few corners around hulls of many.

Of the corners as many are chosen as there may be: first those that lie farthest out along the axes, then one at a time
the one that is farthest from the hull of those before it. The hull of the chosen ones is moved and scaled by the least
factor with which it holds all corners; that is a linear programme in the shift and the factor, since a hull that is
scaled keeps the directions of its faces. So what results holds the original hull, and no point of it is farther from
the original than its farthest corner.

"Farthest" is meant either in metres or in the axes in which the hull is as wide as long; the better result of the two
is taken.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
import scipy
from numpy.typing import ArrayLike

from drake_quad.errors import InputError
from drake_quad.space.shapes import hull_of

# A hull that would have to grow by a larger share of its size is refused. To 100 corners, a sphere of any number grows
# by 2.5 % of its size, and a mesh of a drone, which has flat sides, by less than 1 %.
MAX_GROWTH = 0.05
# Of more corners only those are candidates that lie farthest out in as many directions.
_MOST_CANDIDATES = 500
# By which a hull is enlarged beyond what holds all corners, so that it holds them in floating point, too.
_ROUNDING = 1e-9


class Surrounding(NamedTuple):
    """A hull around another.

    Attributes:
        corners: (n, 3), m.
        growth: the largest distance of its corners from the other hull, m; 0 if they are the same.
        replaced: how many corners the other hull has.
        size: of the other hull, along the axis along which it is largest, m.
    """

    corners: np.ndarray
    growth: float
    replaced: int
    size: float

    @property
    def is_simpler(self) -> bool:
        """True if it has fewer corners than the other hull; else they are the same."""
        return len(self.corners) < self.replaced

    def __str__(self) -> str:
        """A sentence on what was replaced by what."""
        share = 100.0 * self.growth / self.size
        return (
            f"its convex hull of {self.replaced} corners is replaced by one of {len(self.corners)} around it, which is"
            f" larger by at most {self.growth:.3g}, {share:.2g} % of its size"
        )


def surrounding(points: ArrayLike, most: int) -> Surrounding:
    """Return the corners of a convex hull around points that has few corners.

    Args:
        points: (n, 3), m.
        most: corners that the hull may have. If the hull of the points has no more, it is taken as it is.

    Raises:
        InputError: the points have no hull, or the hull would have to grow by more than `MAX_GROWTH` of its size.
    """
    found = np.ascontiguousarray(points, dtype=float)
    return _surrounding(found.tobytes(), found.shape, most)


@functools.lru_cache(maxsize=32)
def _surrounding(data: bytes, shape: tuple[int, ...], most: int) -> Surrounding:
    hull = hull_of(np.frombuffer(data).reshape(shape))
    corners = np.array(hull.corners)
    size = float(np.ptp(corners, axis=0).max())
    if len(corners) <= most:
        return Surrounding(corners, 0.0, len(corners), size)
    middle, _, axes = _principal(corners)
    as_wide_as_long = (corners - middle) @ axes.T / np.ptp(corners @ axes.T, axis=0)
    tries = [_around(corners, corners[_spread(each, most)]) for each in (corners, as_wide_as_long)]
    growths = [float(hull.distances(each).max()) for each in tries]
    best = int(np.argmin(growths))
    if growths[best] > MAX_GROWTH * size:
        raise InputError(
            f"the convex hull has {len(corners)} corners, and one of {most} corners around it would be larger by"
            f" {100.0 * growths[best] / size:.2g} % of its size, more than {100.0 * MAX_GROWTH:g} %: simplify the mesh"
        )
    return Surrounding(tries[best], growths[best], len(corners), size)


def _principal(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    middle = corners.mean(axis=0)
    _, widths, axes = np.linalg.svd(corners - middle, full_matrices=False)
    return middle, widths, axes


def _spread(corners: np.ndarray, count: int) -> np.ndarray:
    """Return the numbers of so many corners whose hull is as large as one can tell step by step."""
    candidates = np.arange(len(corners))
    if len(corners) > _MOST_CANDIDATES:
        candidates = np.unique((corners @ _directions(_MOST_CANDIDATES).T).argmax(axis=0))
    tried = corners[candidates]
    chosen = list(dict.fromkeys([*tried.argmax(axis=0).tolist(), *tried.argmin(axis=0).tolist()]))
    while len(chosen) < count:
        distances = _outside(tried, tried[chosen])
        distances[chosen] = -np.inf
        chosen.append(int(distances.argmax()))
    numbers: np.ndarray = candidates[chosen]
    return numbers


def _directions(count: int) -> np.ndarray:
    """Return unit vectors (count, 3) that are spread evenly: a Fibonacci lattice on the sphere."""
    place = np.arange(count) + 0.5
    height = 1.0 - 2.0 * place / count
    angle = math.pi * (3.0 - math.sqrt(5.0)) * place
    across = np.sqrt(1.0 - height * height)
    return np.column_stack([across * np.cos(angle), across * np.sin(angle), height])


def _outside(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return how far points (n, 3) are outside of the hull of corners across its faces, or of the plane of few."""
    middle, widths, axes = _principal(corners)
    if len(corners) < 4 or widths[-1] <= 1e-6 * widths[0]:
        # The corners span a plane, a line or less.
        spanned = axes[widths > 1e-6 * widths[0]]
        offset = points - middle
        distances: np.ndarray = np.linalg.norm(offset - offset @ spanned.T @ spanned, axis=1)
        return distances
    normals, offsets = _faces(corners)
    outside: np.ndarray = (points @ normals.T - offsets).max(axis=1)
    return outside


def _faces(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the outward unit normals (n, 3) and the offsets (n,) of the faces of a hull."""
    equations = scipy.spatial.ConvexHull(corners).equations
    return equations[:, :3], -equations[:, 3]


def _around(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """Return the corners, moved and scaled by the least factor with which their hull holds all points."""
    normals, offsets = _faces(corners)
    support = (points @ normals.T).max(axis=0)
    # A face n·x <= d becomes n·x <= n·shift + factor d.
    least = scipy.optimize.linprog(
        [0.0, 0.0, 0.0, 1.0], A_ub=-np.column_stack([normals, offsets]), b_ub=-support, bounds=(None, None)
    )
    *shift, factor = least.x
    moved = np.array(shift) + factor * corners
    middle = moved.mean(axis=0)
    around: np.ndarray = middle + (1.0 + _ROUNDING) * (moved - middle)
    return around
