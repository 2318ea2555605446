"""Approximation of the free space by convex regions, which Drake's IRIS grows around seeds.

A point is free if its distance from every obstacle is at least the clearance. IRIS grows a region between the original
obstacles, and the faces of the region are then moved inwards by the clearance. All points of the reduced region are
free, since a ball around such a point, with the clearance as its radius, lies in the original region and touches no
obstacle. The seed is in the reduced region, since IRIS starts with such a ball around the seed.

R. Deits and R. Tedrake, "Computing large convex regions of obstacle-free space through semidefinite programming",
Workshop on the Algorithmic Foundations of Robotics, 2014.
"""

from collections.abc import Iterable

import numpy as np
from pydrake.geometry.optimization import HPolyhedron, Hyperellipsoid, Iris, IrisOptions

from drake_quad.reference.regions import Box, Polytope
from drake_quad.space.space import Space

# Additional clearance, m. It is needed because the planner lets a path leave its corridors by a small tolerance.
SLACK = 1e-5
# Smallest inscribed radius of the intersection of two regions that a path may connect, m.
MIN_COMMON_RADIUS = 1e-3
# Largest number of IRIS iterations. Regions between obstacles hardly grow in further iterations.
_MAX_IRIS_ROUNDS = 4
_MIN_IRIS_GAIN = 0.05  # smallest relative growth of the region's ellipsoid that is worth a further iteration
# Fraction of the free points that the regions must cover. Growth ends earlier if there are `_MAX_REGIONS` regions.
_MIN_COVERAGE = 0.95  # fraction of the free points
_MAX_REGIONS = 40  # largest number of regions
# Distance outside a face up to which a point counts as inside the region, m, to allow for rounding errors.
_FACE_TOLERANCE = 1e-9


class Regions:
    """Collection of convex regions of free points, to which regions can be added.

    Args:
        space: obstacles.
        bounds: bounds of the centre of mass.
    """

    def __init__(self, space: Space, bounds: Box) -> None:
        self._sets = [obstacle.shape.convex_set() for obstacle in space.obstacles]
        self._distance, self._bounds = space.clearance + SLACK, bounds
        self._regions: list[Polytope] = []
        self._intersections: dict[tuple[int, int], Polytope | None] = {}

    def __len__(self) -> int:
        return len(self._regions)

    def __getitem__(self, number: int) -> Polytope:
        return self._regions[number]

    def grow(self, seed: np.ndarray) -> int:
        """Grow a region around a free point, (3,) in m, and return its index."""
        domain = HPolyhedron.MakeBox(self._bounds.low - self._distance, self._bounds.high + self._distance)
        options = IrisOptions(require_sample_point_is_contained=True, relative_termination_threshold=_MIN_IRIS_GAIN)
        options.starting_ellipse = Hyperellipsoid.MakeHypersphere(self._distance, seed)
        for rounds in (_MAX_IRIS_ROUNDS, 1):
            options.iteration_limit = rounds
            region = Iris(self._sets, seed, domain, options)
            lengths = np.linalg.norm(region.A(), axis=1)
            normals, offsets = region.A() / lengths[:, np.newaxis], region.b() / lengths - self._distance
            # Later iterations of IRIS may lose the ball around the seed.
            if (normals @ seed <= offsets + _FACE_TOLERANCE).all():
                break
        reduced = HPolyhedron(normals, offsets).ReduceInequalities()
        self._regions.append(Polytope(reduced.A(), reduced.b()))
        return len(self._regions) - 1

    def cover(self, points: np.ndarray, distances: np.ndarray) -> None:
        """Add regions until they contain most of the given free points.

        The seed of each new region is the uncovered point with the largest distance from obstacles.

        Args:
            points: (n, 3) free points, m.
            distances: (n,) distances to the nearest obstacle, m.
        """
        uncovered = ~self.containing(points).any(axis=0)
        max_uncovered = (1.0 - _MIN_COVERAGE) * len(points)
        while uncovered.sum() > max_uncovered and len(self._regions) < _MAX_REGIONS:
            candidates = np.flatnonzero(uncovered)
            number = self.grow(points[candidates[int(distances[candidates].argmax())]])
            uncovered &= ~self.containing(points, [number])[0]

    def containing(self, points: np.ndarray, numbers: Iterable[int] | None = None) -> np.ndarray:
        """Return a (regions, n) array that is True where a region contains a point.

        Args:
            points: (n, 3) points, m.
            numbers: indices of the regions to check. By default, all regions.
        """
        chosen = self._regions if numbers is None else [self._regions[number] for number in numbers]
        rows = [(points @ region.normals.T <= region.offsets + _FACE_TOLERANCE).all(axis=1) for region in chosen]
        return np.array(rows, dtype=bool).reshape(len(chosen), len(points))

    def intersection(self, one: int, other: int) -> Polytope | None:
        """Return the intersection of two regions, or None if it is too small for a path."""
        pair = min(one, other), max(one, other)
        if pair not in self._intersections:
            overlap = self._regions[pair[0]].intersection(self._regions[pair[1]])
            self._intersections[pair] = overlap if overlap is not None and overlap.radius > MIN_COMMON_RADIUS else None
        return self._intersections[pair]
