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
    places: np.ndarray


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
        places = bounds.low + random.uniform(0.0, 1.0, (2, 3)) * (bounds.high - bounds.low)
        # Start and end are near opposite ends of the room. A room with a wall has it between start and end.
        apart = places[0, 0] < 0.3 * size[0] and places[1, 0] > 0.7 * size[0]
        if apart and least_distances(space, places).min() > clearance + 0.02:
            return Room(space, bounds, places)


def least_distances(space, points):
    """Return the distances (n,) to the nearest solid, m; zero or negative inside."""
    return np.min([_distances(obstacle.shape, points) for obstacle in space.obstacles], axis=0)


def _distances(shape, points):
    match shape:
        case Ball():
            return np.linalg.norm(points - shape.centre, axis=1) - shape.radius
        case Cylinder():
            own = _in_own_frame(shape.centre, shape.rotation, points)
            aside = np.maximum(np.hypot(own[:, 0], own[:, 1]) - shape.radius, 0.0)
            return np.hypot(aside, np.maximum(abs(own[:, 2]) - 0.5 * shape.height, 0.0))
        case Cuboid():
            own = _in_own_frame(shape.centre, shape.rotation, points)
            half = 0.5 * np.array(shape.size)
            return np.linalg.norm(own - np.clip(own, -half, half), axis=1)
    # The three edges at a corner of a box are its axes.
    corners = np.array(shape.corners)
    lengths = np.linalg.norm(corners - corners[0], axis=1)
    edges = _edges(corners, lengths)
    sides = np.linalg.norm(edges, axis=1)
    own = (points - corners.mean(axis=0)) @ (edges / sides[:, None]).T
    return np.linalg.norm(own - np.clip(own, -0.5 * sides, 0.5 * sides), axis=1)


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


def _in_own_frame(centre, rotation, points):
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
                here, there = numbers, numbers
                for axis, shift in enumerate(step):
                    begin, end = [slice(None)] * 3, [slice(None)] * 3
                    if shift != 1:
                        begin[axis], end[axis] = (slice(None, -1), slice(1, None))[:: shift - 1]
                        if shift == 0:
                            begin[axis], end[axis] = slice(1, None), slice(None, -1)
                        here, there = here[tuple(begin)], there[tuple(end)]
                one, other = here.ravel(), there.ravel()
                fits = is_open(one, other)
                yield one[fits], other[fits]

    def _surely_free(self, one, other):
        """Return a mask of the steps that are certainly free: free balls around both end points cover the step."""
        length = np.linalg.norm(self.points[one] - self.points[other], axis=1)
        free = np.minimum(self.distances[one], self.distances[other]) >= self.clearance
        return free & (self.distances[one] + self.distances[other] - length >= 2.0 * self.clearance)

    def shortest(self):
        """Return the shortest free route (n, 3), m, or None if there is none."""
        pairs = [
            (one, other, np.linalg.norm(self.points[one] - self.points[other], axis=1))
            for one, other in self._edges(self._surely_free)
        ]
        rows, columns, lengths = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
        size = len(self.points)
        graph = coo_matrix((lengths, (rows, columns)), (size, size)).tocsr()
        begin, end = (self._next_to(place) for place in self.room.places)
        if not (len(begin) and len(end)):
            return None
        found, before, _ = dijkstra(graph, directed=False, indices=begin, min_only=True, return_predecessors=True)
        number = int(end[found[end].argmin()])
        if not np.isfinite(found[number]):
            return None
        way = []
        while number >= 0:
            way.append(self.points[number])
            number = int(before[number])
        return np.array(way[::-1])

    def _next_to(self, place):
        """Return the indices of the grid points to which the straight line from a position is certainly free."""
        away = np.linalg.norm(self.points - place, axis=1)
        (distance,) = least_distances(self.room.space, place[None])
        return np.flatnonzero(
            (away < 2.0 * self.spacing)
            & (self.distances >= self.clearance)
            & (self.distances + distance - away >= 2.0 * self.clearance)
        )

    def is_surely_blocked(self):
        """Return whether start and end are disconnected even with a clearance reduced by half a cell diagonal."""
        reach = 0.5 * np.sqrt(3.0) * self.spacing
        near = self.distances >= self.clearance - reach
        pairs = list(self._edges(lambda one, other: near[one] & near[other]))
        rows, columns = (np.concatenate(parts) for parts in zip(*pairs, strict=True))
        size = len(self.points)
        rooms = connected_components(coo_matrix((np.ones(len(rows)), (rows, columns)), (size, size)), directed=False)[1]
        # A grid that begins at one bound may end up to one step before the other bound.
        begin, end = (
            set(rooms[near & (np.linalg.norm(self.points - place, axis=1) <= 2.0 * self.spacing)].tolist())
            for place in self.room.places
        )
        return not begin & end
