"""Random rooms, and an independent search for routes through them.

The search computes distances by clipping coordinates in the frame of each solid. All hulls are boxes.
"""

from typing import NamedTuple

import numpy as np
from pydrake.math import RollPitchYaw
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from drake_quad.reference.regions import Box
from drake_quad.space.shapes import Ball, Cuboid, Cylinder, convex_hull
from drake_quad.space.space import Obstacle, Space

SPACING = 0.05  # m, distance between neighbouring grid points


class Room(NamedTuple):
    space: Space
    bounds: Box
    endpoints: np.ndarray


def random_room(seed):
    """Return a room of about 3 m with 5 to 20 obstacles and a clearance of 0.15 to 0.3 m.

    Every fourth room has a wall across it.
    """
    random = np.random.default_rng([27, seed])
    size = np.array([*random.uniform(2.6, 3.4, 2), random.uniform(1.2, 1.6)])
    obstacles = []
    for i in range(random.integers(5, 21)):
        centre = tuple((random.uniform(0.0, 1.0, 3) * size).tolist())
        rotation = tuple((random.uniform(-1.0, 1.0, 3) * [0.5, 0.5, 3.0]).tolist())
        sides = tuple(random.uniform(0.1, 0.6, 3).tolist())
        shapes = (
            Cylinder((*centre[:2], 0.5 * size[2]), radius=0.3 * sides[0], height=size[2]),
            Cuboid(centre, rotation, sides),
            Ball(centre, radius=0.4 * sides[0]),
            convex_hull(Cuboid(centre, rotation, sides).corners()),
            Cylinder(centre, rotation, 0.3 * sides[0], 2.0 * sides[1]),
        )
        obstacles.append(Obstacle(f"solid_{i}", shapes[i % 5]))
    if seed % 4 == 0:
        door = 0.4 * (seed % 3)
        across = Cuboid((0.5 * size[0], 0.5 * (size[1] - door), 0.5 * size[2]), size=(0.1, size[1] - door, size[2]))
        obstacles.append(Obstacle("wall", across))
    clearance = random.uniform(0.15, 0.3)
    space = Space(tuple(obstacles), radius=0.1, margin=clearance - 0.1)
    bounds = Box(np.full(3, clearance), size - clearance)
    while True:
        endpoints = bounds.low + random.uniform(0.0, 1.0, (2, 3)) * (bounds.high - bounds.low)
        # Start and end are near opposite ends of the room. A room with a wall has it between start and end.
        are_apart = endpoints[0, 0] < 0.3 * size[0] and endpoints[1, 0] > 0.7 * size[0]
        if are_apart and least_distances(space, endpoints).min() > clearance + 0.02:
            return Room(space, bounds, endpoints)


def least_distances(space, points):
    """Return the distances (n,) to the nearest solid, m; zero or negative inside."""
    return np.min([_distances(obstacle.shape, points) for obstacle in space.obstacles], axis=0)


def _distances(shape, points):
    match shape:
        case Ball():
            return np.linalg.norm(points - shape.centre, axis=1) - shape.radius
        case Cylinder():
            local = _in_solid_frame(shape.centre, shape.rotation, points)
            radial = np.maximum(np.hypot(local[:, 0], local[:, 1]) - shape.radius, 0.0)
            return np.hypot(radial, np.maximum(abs(local[:, 2]) - 0.5 * shape.height, 0.0))
        case Cuboid():
            local = _in_solid_frame(shape.centre, shape.rotation, points)
            half = 0.5 * np.array(shape.size)
            return np.linalg.norm(local - np.clip(local, -half, half), axis=1)
    # The three edges at a corner of a box are its axes.
    corners = np.array(shape.corners)
    lengths = np.linalg.norm(corners - corners[0], axis=1)
    edges = _edges(corners, lengths)
    sides = np.linalg.norm(edges, axis=1)
    local = (points - corners.mean(axis=0)) @ (edges / sides[:, None]).T
    return np.linalg.norm(local - np.clip(local, -0.5 * sides, 0.5 * sides), axis=1)


def _edges(corners, lengths):
    """Return the edges (3, 3) from a box's first corner to its neighbours, which are perpendicular to each other."""
    order = np.argsort(lengths)[1:]
    for i in order:
        for j in order:
            for k in order:
                edges = corners[[i, j, k]] - corners[0]
                product = edges @ edges.T
                if i < j < k and abs(product - np.diag(np.diag(product))).max() < 1e-9:
                    return edges
    raise AssertionError("the hull is not a box")


def _in_solid_frame(centre, rotation, points):
    return (points - np.array(centre)) @ RollPitchYaw(np.array(rotation)).ToRotationMatrix().matrix()


class Search:
    """Search for routes through a room on a grid of points, by default with a spacing of 5 cm."""

    def __init__(self, room, spacing=SPACING):
        self.spacing = spacing
        axes = [
            np.arange(low, high + 1e-9, spacing) for low, high in zip(room.bounds.low, room.bounds.high, strict=True)
        ]
        self.shape = tuple(len(axis) for axis in axes)
        self.points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
        self.distances = least_distances(room.space, self.points)
        self.clearance, self.room = room.space.clearance, room

    def _edges(self, is_open):
        """Yield the row and column indices of neighbouring points, along axes and diagonals."""
        numbers = np.arange(len(self.points)).reshape(self.shape)
        for step in np.ndindex(3, 3, 3):
            if step > (1, 1, 1):
                first_points, second_points = numbers, numbers
                for axis, shift in enumerate(step):
                    begin, end = [slice(None)] * 3, [slice(None)] * 3
                    if shift != 1:
                        begin[axis], end[axis] = (slice(None, -1), slice(1, None))[:: shift - 1]
                        if shift == 0:
                            begin[axis], end[axis] = slice(1, None), slice(None, -1)
                        first_points, second_points = first_points[tuple(begin)], second_points[tuple(end)]
                first, second = first_points.ravel(), second_points.ravel()
                is_selected = is_open(first, second)
                yield first[is_selected], second[is_selected]

    def _surely_free(self, first, second):
        """Return a mask of the steps that are certainly free: free balls around both end points cover the step."""
        length = np.linalg.norm(self.points[first] - self.points[second], axis=1)
        free = np.minimum(self.distances[first], self.distances[second]) >= self.clearance
        return free & (self.distances[first] + self.distances[second] - length >= 2.0 * self.clearance)

    def shortest(self):
        """Return the shortest free route (n, 3), m, or None if there is none."""
        pairs = [
            (first, second, np.linalg.norm(self.points[first] - self.points[second], axis=1))
            for first, second in self._edges(self._surely_free)
        ]
        rows, columns, lengths = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
        size = len(self.points)
        graph = coo_matrix((lengths, (rows, columns)), (size, size)).tocsr()
        begin, end = (self._surely_connected_to(endpoint) for endpoint in self.room.endpoints)
        if not (len(begin) and len(end)):
            return None
        lengths_to_points, predecessors, _ = dijkstra(
            graph, directed=False, indices=begin, min_only=True, return_predecessors=True
        )
        number = int(end[lengths_to_points[end].argmin()])
        if not np.isfinite(lengths_to_points[number]):
            return None
        route = []
        while number >= 0:
            route.append(self.points[number])
            number = int(predecessors[number])
        return np.array(route[::-1])

    def _surely_connected_to(self, position):
        """Return the indices of the grid points to which the straight line from a position is certainly free."""
        distances_to_points = np.linalg.norm(self.points - position, axis=1)
        (distance,) = least_distances(self.room.space, position[None])
        return np.flatnonzero(
            (distances_to_points < 2.0 * self.spacing)
            & (self.distances >= self.clearance)
            & (self.distances + distance - distances_to_points >= 2.0 * self.clearance)
        )

    def is_surely_blocked(self):
        """Return whether start and end are disconnected even with a clearance reduced by half a cell diagonal."""
        half_diagonal = 0.5 * np.sqrt(3.0) * self.spacing
        may_be_free = self.distances >= self.clearance - half_diagonal
        pairs = list(self._edges(lambda first, second: may_be_free[first] & may_be_free[second]))
        rows, columns = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
        size = len(self.points)
        rooms = connected_components(coo_matrix((np.ones(len(rows)), (rows, columns)), (size, size)), directed=False)[1]
        # A grid that begins at one bound may end up to one step before the other bound.
        begin, end = (
            set(rooms[may_be_free & (np.linalg.norm(self.points - endpoint, axis=1) <= 2.0 * self.spacing)].tolist())
            for endpoint in self.room.endpoints
        )
        return not begin & end
