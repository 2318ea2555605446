"""A grid of points, on which ways are measured: it seeds regions, and proves that there is no way."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from drake_quad.reference.regions import Box, Sphere, WaypointRegion
from drake_quad.space.space import Space

# A place leads to points of the grid within so many spacings of it.
_NEAR = 1.8
# One of each pair of opposite directions to the 26 neighbours.
_DIRECTIONS = [step for step in itertools.product((-1, 0, 1), repeat=3) if step > (0, 0, 0)]


@dataclass(frozen=True)
class Grid:
    """Points in rows along the axes.

    Attributes:
        shape: points on each axis.
        points: (n, 3), m.
        steps: (3,) distance between neighbours on each axis, m.
        space: the obstacles.
    """

    shape: tuple[int, int, int]
    points: np.ndarray
    steps: np.ndarray
    space: Space

    @classmethod
    def of(cls, space: Space, bounds: Box, *, most: int, finest: float) -> "Grid":
        """A grid of so many points at most, and of no less than a spacing (m)."""
        extent, spacing = bounds.high - bounds.low, finest
        while np.prod(np.ceil(extent / spacing) + 1.0) > most:
            spacing *= 1.05
        shape = tuple((np.ceil(extent / spacing).astype(int) + 1).tolist())
        axes = [np.linspace(low, high, n) for low, high, n in zip(bounds.low, bounds.high, shape, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        steps = np.array([axis[1] - axis[0] if len(axis) > 1 else 0.0 for axis in axes])
        return cls(shape, points, steps, space)

    @property
    def spacing(self) -> float:
        """The largest of the steps, m."""
        return float(self.steps.max())

    @cached_property
    def nearest(self) -> np.ndarray:
        """(n,) distance from each point to the nearest obstacle, m."""
        distances = (obstacle.shape.distances(self.points) for obstacle in self.space.obstacles)
        return reduce(np.minimum, distances, np.full(len(self.points), np.inf))

    @cached_property
    def distances(self) -> np.ndarray:
        """(n, obstacles) from each point to each obstacle, m; negative inside."""
        found = [obstacle.shape.distances(self.points) for obstacle in self.space.obstacles]
        return np.stack(found, -1) if found else np.empty((len(self.points), 0))

    def lengths_from(
        self, places: np.ndarray, clearance: float, inside: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Lengths of the shortest ways over free points from any of some places, and where each way comes from.

        A way counts twice where it leaves no room, and less the more there is: regions around a convex obstacle are cut
        by planes, and what hugs it is in none of them for long.

        Args:
            places: (k, 3), m.
            clearance: that a way keeps from obstacles, m.
            inside: (n,) whether a way may lead over a point, if not over all.

        Returns:
            (n,) lengths, infinite where no way leads, m, and (n,) numbers of the points before, negative at its begin.
        """
        # Nobody waits for SciPy whose route leads past all obstacles; likewise below.
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import dijkstra

        free = self.nearest >= clearance
        if inside is not None:
            free &= inside
        rows, columns, lengths = [], [], []
        for one, other in self.neighbours():
            both = free[one] & free[other]
            one, other = one[both], other[both]
            length = np.linalg.norm(self.points[other] - self.points[one], axis=1)
            # No distance changes faster than the place; where that is not enough, half way is looked at.
            sure = self.nearest[one] + self.nearest[other] - length >= 2.0 * clearance
            doubtful = np.flatnonzero(~sure)
            middles = 0.5 * (self.points[one[doubtful]] + self.points[other[doubtful]])
            sure[doubtful] = self.space.nearest(middles)[0] >= clearance
            room = np.minimum(self.nearest[one], self.nearest[other]) - clearance
            rows.append(one[sure])
            columns.append(other[sure])
            lengths.append((length * (1.0 + self.spacing / (self.spacing + room)))[sure])
        away = self._nearest_of(places)[0]
        near = np.flatnonzero(free & (away <= _NEAR * self.spacing))
        rows.append(np.full(len(near), len(self.points)))
        columns.append(near)
        # SciPy takes a length of zero for no way.
        lengths.append(np.maximum(away[near], 1e-9))
        size = len(self.points) + 1
        graph = coo_matrix((np.concatenate(lengths), (np.concatenate(rows), np.concatenate(columns))), (size, size))
        found, before = dijkstra(graph.tocsr(), directed=False, indices=size - 1, return_predecessors=True)
        return found[:-1], np.where(before[:-1] == size - 1, -1, before[:-1])

    def neighbours(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yields for each of 13 directions the numbers of the points that have a neighbour there, and of these."""
        numbers = np.arange(len(self.points)).reshape(self.shape)
        for step in _DIRECTIONS:
            here = numbers[tuple(slice(max(0, -s), n - max(0, s)) for s, n in zip(step, self.shape, strict=True))]
            there = numbers[tuple(slice(max(0, s), n - max(0, -s)) for s, n in zip(step, self.shape, strict=True))]
            yield here.ravel(), there.ravel()

    def way(self, lengths: np.ndarray, before: np.ndarray, begins: np.ndarray, ends: np.ndarray) -> np.ndarray | None:
        """(corners, 3) the shortest way from any of some places to any of others, m; None if there is none.

        Args:
            lengths: from the first places, of `lengths_from`.
            before: likewise.
            begins: (k, 3) the first places, m.
            ends: (l, 3) the others, free as the first, m.
        """
        _, number, end = self.shortest(lengths, ends)
        if number < 0:
            return None
        corners = [ends[end]]
        while number >= 0:
            corners.append(self.points[number])
            number = int(before[number])
        first = np.linalg.norm(begins - corners[-1], axis=1).argmin()
        return np.array([*corners, begins[first]][::-1])

    def shortest(self, lengths: np.ndarray, ends: np.ndarray) -> tuple[float, int, int]:
        """Return the length of the shortest way to any of some places (k, 3), m, its last point, and which place it is.

        Without a way the length is infinite and the numbers are negative.
        """
        away, nearest = self._nearest_of(ends)
        near = np.flatnonzero(np.isfinite(lengths) & (away <= _NEAR * self.spacing))
        if not len(near):
            return np.inf, -1, -1
        number = int(near[(lengths[near] + away[near]).argmin()])
        return float(lengths[number] + away[number]), number, int(nearest[number])

    def _nearest_of(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For each point the distance (n,) to the nearest of some places (k, 3), m, and its number (n,)."""
        from scipy.spatial import KDTree

        distances, numbers = KDTree(places).query(self.points)
        return distances, numbers

    def rooms(self, free: np.ndarray) -> np.ndarray:
        """(n,) the number of the room that a free point is in, zero for the others."""
        from scipy import ndimage

        return np.asarray(ndimage.label(free.reshape(self.shape), np.ones((3, 3, 3)))[0]).ravel()


def is_near(place: WaypointRegion, points: np.ndarray, distance: float = 0.0) -> np.ndarray:
    """Return a mask (n,) of the points (n, 3) that are in a place or within a distance (m) of it.

    Near the edges of a polytope the mask also includes some points that are farther away.
    """
    match place:
        case Box():
            return np.asarray(np.linalg.norm(points - np.clip(points, place.low, place.high), axis=1) <= distance)
        case Sphere():
            return np.asarray(np.linalg.norm(points - place.centre, axis=1) <= place.radius + distance)
    return np.asarray((points @ place.normals.T <= place.offsets + distance).all(axis=1))
