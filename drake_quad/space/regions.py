"""Free space as convex regions, grown by Drake's IRIS around seeds.

A vehicle's centre of mass is free where it is at the clearance or farther from every obstacle. Regions are grown around
the obstacles as they are, and their faces then moved in by the clearance: the ball of that radius around a point of
what is left lies in the region as it was, and so touches no obstacle. A seed lies in its region, since IRIS begins with
such a ball around it.

R. Deits and R. Tedrake, "Computing large convex regions of obstacle-free space through semidefinite programming",
Workshop on the Algorithmic Foundations of Robotics, 2014.
"""

from collections.abc import Iterable

import numpy as np
from pydrake.geometry.optimization import HPolyhedron, Hyperellipsoid, Iris, IrisOptions

from drake_quad.reference.regions import Box, Polytope
from drake_quad.space.space import Space

# Beside the clearance, m: so far may a path leave the faces that it is planned within.
SLACK = 1e-5
# Regions that have less in common do not lead to each other: radius of a ball, m.
NARROWEST = 1e-3
# Of IRIS: more rounds, or finer ones, gain a room little.
_ROUNDS, _GAIN = 4, 0.05
# Regions are grown until so much of the free points is covered.
_COVERED = 0.95
_MOST_REGIONS = 40
# A point on a face lies in its region by floating point, m.
_ROUNDING = 1e-9


class Regions:
    """Convex regions of free places, more and more of them.

    Args:
        space: the obstacles.
        bounds: for the centre of mass.
    """

    def __init__(self, space: Space, bounds: Box) -> None:
        self._sets = [obstacle.shape.convex_set() for obstacle in space.obstacles]
        self._distance, self._bounds = space.clearance + SLACK, bounds
        self._found: list[Polytope] = []
        self._common: dict[tuple[int, int], Polytope | None] = {}

    def __len__(self) -> int:
        return len(self._found)

    def __getitem__(self, number: int) -> Polytope:
        return self._found[number]

    def grow(self, seed: np.ndarray) -> int:
        """Adds the region around a free point (3,), m, and returns its number."""
        domain = HPolyhedron.MakeBox(self._bounds.low - self._distance, self._bounds.high + self._distance)
        options = IrisOptions(require_sample_point_is_contained=True, relative_termination_threshold=_GAIN)
        options.starting_ellipse = Hyperellipsoid.MakeHypersphere(self._distance, seed)
        for rounds in (_ROUNDS, 1):
            options.iteration_limit = rounds
            region = Iris(self._sets, seed, domain, options)
            lengths = np.linalg.norm(region.A(), axis=1)
            normals, offsets = region.A() / lengths[:, np.newaxis], region.b() / lengths - self._distance
            # The seed's ball may have been left by rounds after the first.
            if (normals @ seed <= offsets + _ROUNDING).all():
                break
        reduced = HPolyhedron(normals, offsets).ReduceInequalities()
        self._found.append(Polytope(reduced.A(), reduced.b()))
        return len(self._found) - 1

    def cover(self, points: np.ndarray, distances: np.ndarray) -> None:
        """Adds regions until they hold most of some free points, where there is most room first.

        Args:
            points: (n, 3), m.
            distances: (n,) to the nearest obstacle, m.
        """
        left = ~self.holding(points).any(axis=0)
        enough = (1.0 - _COVERED) * len(points)
        while left.sum() > enough and len(self._found) < _MOST_REGIONS:
            candidates = np.flatnonzero(left)
            number = self.grow(points[candidates[int(distances[candidates].argmax())]])
            left &= ~self.holding(points, [number])[0]

    def holding(self, points: np.ndarray, numbers: Iterable[int] | None = None) -> np.ndarray:
        """(regions, n) which regions hold which of the points (n, 3); all regions unless numbers are given."""
        chosen = self._found if numbers is None else [self._found[number] for number in numbers]
        rows = [(points @ region.normals.T <= region.offsets + _ROUNDING).all(axis=1) for region in chosen]
        return np.array(rows, dtype=bool).reshape(len(chosen), len(points))

    def common(self, one: int, other: int) -> Polytope | None:
        """What two regions have in common; None if it is nothing to speak of."""
        pair = min(one, other), max(one, other)
        if pair not in self._common:
            both = self._found[pair[0]].intersection(self._found[pair[1]])
            self._common[pair] = both if both is not None and both.radius > NARROWEST else None
        return self._common[pair]
