"""Grid of points, on which shortest routes are computed.

The grid provides seeds for convex regions, and it can prove that no route exists.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np

from drake_quad.reference.regions import Box, Sphere, WaypointRegion
from drake_quad.space.space import Space

# Largest distance at which a waypoint is connected to a grid point, relative to the grid spacing.
_MAX_CONNECTION_SPACINGS = 1.8
# Directions to half of a point's 26 neighbours: one direction of each opposite pair.
_DIRECTIONS = [step for step in itertools.product((-1, 0, 1), repeat=3) if step > (0, 0, 0)]


@dataclass(frozen=True)
class Grid:
    """Regular grid of points.

    Attributes:
        shape: number of points along each axis.
        points: (n, 3) points, m.
        steps: (3,) distance between neighbours along each axis, m.
        space: obstacles.
    """

    shape: tuple[int, int, int]
    points: np.ndarray
    steps: np.ndarray
    space: Space

    @classmethod
    def of(cls, space: Space, bounds: Box, *, max_points: int, min_spacing: float) -> "Grid":
        """Return a grid over bounds with the smallest spacing that both limits allow.

        Args:
            space: obstacles.
            bounds: bounds of the grid.
            max_points: largest number of points.
            min_spacing: smallest spacing, m.
        """
        extent, spacing = bounds.high - bounds.low, min_spacing
        while np.prod(np.ceil(extent / spacing) + 1.0) > max_points:
            spacing *= 1.05
        shape = tuple((np.ceil(extent / spacing).astype(int) + 1).tolist())
        axes = [np.linspace(low, high, n) for low, high, n in zip(bounds.low, bounds.high, shape, strict=True)]
        points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        steps = np.array([axis[1] - axis[0] if len(axis) > 1 else 0.0 for axis in axes])
        return cls(shape, points, steps, space)

    @property
    def spacing(self) -> float:
        """Largest of the grid steps along the three axes, m."""
        return float(self.steps.max())

    @cached_property
    def nearest(self) -> np.ndarray:
        """(n,) distance from each grid point to the nearest obstacle, m."""
        distances = (obstacle.shape.distances(self.points) for obstacle in self.space.obstacles)
        return reduce(np.minimum, distances, np.full(len(self.points), np.inf))

    @cached_property
    def distances(self) -> np.ndarray:
        """(n, obstacles) distance from each point to each obstacle, m; negative inside."""
        distances = [obstacle.shape.distances(self.points) for obstacle in self.space.obstacles]
        return np.stack(distances, -1) if distances else np.empty((len(self.points), 0))

    def route_lengths(
        self, starts: np.ndarray, clearance: float, inside: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the weighted lengths of the shortest routes from several starting points to all grid points.

        The length of a step is multiplied by 2 if the step is only the clearance away from an obstacle, and by a factor
        between 1 and 2 at larger distances. This keeps routes away from obstacles. Since convex regions are bounded by
        planes, a route that closely follows an obstacle would require many regions.

        Args:
            starts: (k, 3) starting points, m.
            clearance: distance that a route keeps from obstacles, m.
            inside: (n,) True for grid points that a route may use; all points if not given.

        Returns:
            (n,) weighted lengths in m, infinite for points that no route reaches, and (n,) indices of the preceding
            point on the route, negative at its start.
        """
        # SciPy is imported here and below, since routes far from obstacles do not need it.
        from scipy.sparse import coo_matrix
        from scipy.sparse.csgraph import dijkstra

        free = self.nearest >= clearance
        rows, columns, lengths = self._connections(clearance)
        if inside is not None:
            free &= inside
            both = inside[rows] & inside[columns]
            rows, columns, lengths = rows[both], columns[both], lengths[both]
        distances_to_starts, _ = self._nearest_of(starts)
        near = np.flatnonzero(free & np.isfinite(distances_to_starts))
        rows = np.append(rows, np.full(len(near), len(self.points)))
        columns = np.append(columns, near)
        # SciPy treats a length of zero as a missing connection.
        lengths = np.append(lengths, np.maximum(distances_to_starts[near], 1e-9))
        size = len(self.points) + 1
        graph = coo_matrix((lengths, (rows, columns)), (size, size))
        all_lengths, predecessors = dijkstra(graph.tocsr(), directed=False, indices=size - 1, return_predecessors=True)
        return all_lengths[:-1], np.where(predecessors[:-1] == size - 1, -1, predecessors[:-1])

    def _connections(self, clearance: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the free lines between neighbours: indices (c,) of both points, and weighted lengths (c,) in m.

        All legs of a route use the same lines, so the result is cached.
        """
        if clearance in self._known_connections:
            return self._known_connections[clearance]
        free = self.nearest >= clearance
        rows, columns, lengths = [], [], []
        for one, other in self.neighbours():
            both = free[one] & free[other]
            one, other = one[both], other[both]
            length = np.linalg.norm(self.points[other] - self.points[one], axis=1)
            # Along a line, the distance from an obstacle changes by at most the length of the line. This often proves
            # that the line is free. Otherwise the middle of the line is checked.
            is_free = self.nearest[one] + self.nearest[other] - length >= 2.0 * clearance
            uncertain = np.flatnonzero(~is_free)
            middles = 0.5 * (self.points[one[uncertain]] + self.points[other[uncertain]])
            is_free[uncertain] = self.space.nearest(middles)[0] >= clearance
            room = np.minimum(self.nearest[one], self.nearest[other]) - clearance
            rows.append(one[is_free])
            columns.append(other[is_free])
            lengths.append((length * (1.0 + self.spacing / (self.spacing + room)))[is_free])
        connections = np.concatenate(rows), np.concatenate(columns), np.concatenate(lengths)
        self._known_connections[clearance] = connections
        return connections

    @cached_property
    def _known_connections(self) -> dict[float, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Cached results of `_connections`, keyed by clearance."""
        return {}

    def neighbours(self) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield the indices of all pairs of neighbouring points, for each of 13 directions."""
        numbers = np.arange(len(self.points)).reshape(self.shape)
        for step in _DIRECTIONS:
            starts = numbers[tuple(slice(max(0, -s), n - max(0, s)) for s, n in zip(step, self.shape, strict=True))]
            neighbours = numbers[tuple(slice(max(0, s), n - max(0, -s)) for s, n in zip(step, self.shape, strict=True))]
            yield starts.ravel(), neighbours.ravel()

    def shortest_route(
        self, lengths: np.ndarray, predecessors: np.ndarray, starts: np.ndarray, ends: np.ndarray
    ) -> np.ndarray | None:
        """Return the shortest route (corners, 3) from any start to any end, m; None if there is no route.

        Args:
            lengths: (n,) lengths from the starting points, a result of `route_lengths`.
            predecessors: (n,) indices of the preceding points, a result of `route_lengths`.
            starts: (k, 3) starting points, m.
            ends: (l, 3) end points, which have at least the same clearance as the route, m.
        """
        _, number, end = self.nearest_end(lengths, ends)
        if number < 0:
            return None
        corners = [ends[end]]
        while number >= 0:
            corners.append(self.points[number])
            number = int(predecessors[number])
        first = np.linalg.norm(starts - corners[-1], axis=1).argmin()
        return np.array([*corners, starts[first]][::-1])

    def nearest_end(self, lengths: np.ndarray, ends: np.ndarray) -> tuple[float, int, int]:
        """Return the length of the shortest route that leads to one of several end points, and where it ends.

        Args:
            lengths: (n,) lengths from the starting points, a result of `route_lengths`.
            ends: (k, 3) end points, m.

        Returns:
            The length in m, the index of the route's last grid point, and the index of its end point. If there is no
            route, the length is infinite and the indices are negative.
        """
        distances_to_ends, nearest = self._nearest_of(ends)
        near = np.flatnonzero(np.isfinite(lengths) & np.isfinite(distances_to_ends))
        if not len(near):
            return np.inf, -1, -1
        number = int(near[(lengths[near] + distances_to_ends[near]).argmin()])
        return float(lengths[number] + distances_to_ends[number]), number, int(nearest[number])

    def _nearest_of(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the distance (n,) from each grid point to the nearest of several points (k, 3), m, and its index.

        Distances beyond the largest distance at which a point is connected to the grid are infinite.
        """
        from scipy.spatial import KDTree

        # SciPy's `distance_upper_bound` is exclusive.
        bound = np.nextafter(_MAX_CONNECTION_SPACINGS * self.spacing, np.inf)
        distances, numbers = KDTree(points).query(self.points, distance_upper_bound=bound)
        return distances, numbers

    def components(self, free: np.ndarray) -> np.ndarray:
        """Return the (n,) number of each free point's connected component, counted from 1; zero for other points."""
        from scipy import ndimage

        return np.asarray(ndimage.label(free.reshape(self.shape), np.ones((3, 3, 3)))[0]).ravel()


def is_near(region: WaypointRegion, points: np.ndarray, distance: float = 0.0) -> np.ndarray:
    """Return a mask (n,) of the points (n, 3) that lie in a region or within a distance (m) of it.

    Near the edges of a polytope, the mask includes some points beyond this distance.
    """
    match region:
        case Box():
            return np.asarray(np.linalg.norm(points - np.clip(points, region.low, region.high), axis=1) <= distance)
        case Sphere():
            return np.asarray(np.linalg.norm(points - region.centre, axis=1) <= region.radius + distance)
    return np.asarray((points @ region.normals.T <= region.offsets + distance).all(axis=1))
