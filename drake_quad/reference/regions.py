"""Regions for waypoints and corridors: boxes, spheres and convex polytopes."""

import math
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import ClarabelSolver, ClpSolver, MathematicalProgram

from drake_quad.errors import InputError

AXES = "xyz"
# Accuracy of lengths that a solver returns, relative to the largest length in the program.
_RELATIVE_ROUNDING = 1e-9
# Limit on radius and centre coordinates of the inscribed ball, m, needed for unbounded polytopes. It is larger than any
# flight.
_MAX_INSCRIBED_RADIUS = 1e5


class Box:
    """Axis-aligned box. It is a point if both corners are equal.

    Attributes:
        low: (axes,) lowest corner, m.
        high: (axes,) highest corner, m.

    Raises:
        InputError: if a corner is not finite, or `low` exceeds `high`.
    """

    def __init__(self, low: ArrayLike, high: ArrayLike) -> None:
        self.low = np.array(low, dtype=float)
        self.high = np.array(high, dtype=float)
        if self.low.shape != self.high.shape or self.low.ndim != 1:
            raise InputError(
                f"a box needs two corners of the same dimension, not {format_vector(low)} and {format_vector(high)}"
            )
        if not (np.isfinite(self.low).all() and np.isfinite(self.high).all() and (self.low <= self.high).all()):
            raise InputError(
                f"a box from {format_vector(self.low)} to {format_vector(self.high)} m is empty or not finite"
            )

    @classmethod
    def point(cls, position: ArrayLike) -> "Box":
        """Return a box without extent at a position (axes,), m."""
        return cls(position, position)

    @property
    def centre(self) -> np.ndarray:
        """(axes,) centre of the box, m."""
        return 0.5 * (self.low + self.high)

    @property
    def is_point(self) -> bool:
        """True if the box has no extent."""
        return bool((self.low == self.high).all())

    def equals(self, other: "Box") -> bool:
        """Return True if both boxes have the same corners."""
        return bool((self.low == other.low).all() and (self.high == other.high).all())

    def intersection(self, other: "Box") -> "Box | None":
        """Return the intersection of both boxes, or None if it is empty."""
        low, high = np.maximum(self.low, other.low), np.minimum(self.high, other.high)
        return Box(low, high) if (low <= high).all() else None

    def nearest(self, position: np.ndarray) -> np.ndarray:
        """Return the point of the box that is nearest to a position (axes,), m."""
        return np.clip(position, self.low, self.high)

    def __str__(self) -> str:
        if self.is_point:
            return format_vector(self.low)
        return f"the box from {format_vector(self.low)} to {format_vector(self.high)}"


class Sphere:
    """Ball through which a path must pass.

    Attributes:
        centre: (axes,) centre, m.
        radius: radius, m.

    Raises:
        InputError: if the centre is not finite, or the radius is not positive and finite.
    """

    def __init__(self, centre: ArrayLike, radius: float) -> None:
        self.centre = np.array(centre, dtype=float)
        self.radius = float(radius)
        if not np.isfinite(self.centre).all():
            raise InputError(f"the centre of a sphere, {format_vector(self.centre)}, must be finite")
        if not 0.0 < self.radius < math.inf:
            raise InputError(f"the radius of a sphere is {self.radius:g} m, but must be positive and finite")

    def nearest(self, position: np.ndarray) -> np.ndarray:
        """Return the point of the ball that is nearest to a position (axes,), m."""
        offset = position - self.centre
        distance = float(np.linalg.norm(offset))
        return position if distance <= self.radius else self.centre + offset * (self.radius / distance)

    def __str__(self) -> str:
        return f"the sphere of {self.radius:g} m around {format_vector(self.centre)}"


class Polytope:
    """Convex polytope: the points p with n · p <= d for every face. It may be unbounded, or flat.

    Attributes:
        normals: (faces, axes) outward unit normals n.
        offsets: (faces,) distances d of the faces from the origin along their normals, m.

    Raises:
        InputError: if shapes do not match, a number is not finite, a normal is zero, or the polytope is empty.
    """

    def __init__(self, normals: ArrayLike, offsets: ArrayLike) -> None:
        rows, distances = np.array(normals, dtype=float), np.array(offsets, dtype=float)
        if rows.ndim != 2 or not rows.size or distances.shape != rows.shape[:1]:
            raise InputError(f"a polytope needs one offset for each normal, not {distances.shape} for {rows.shape}")
        lengths = np.linalg.norm(rows, axis=1)
        if not (np.isfinite(lengths).all() and np.isfinite(distances).all() and lengths.all()):
            raise InputError("the faces of a polytope need finite numbers, and normals that are not zero")
        self.normals = rows / lengths[:, np.newaxis]
        self.offsets = distances / lengths
        if self.radius < -_RELATIVE_ROUNDING * self._largest_offset:
            raise InputError(f"a polytope of {len(rows)} faces is empty: no point lies on the inner side of all faces")

    @classmethod
    def from_box(cls, box: Box) -> "Polytope":
        """Convert a box to a polytope."""
        identity = np.eye(len(box.low))
        return cls(np.vstack([-identity, identity]), np.concatenate([-box.low, box.high]))

    @property
    def faces(self) -> int:
        """Number of faces of the polytope."""
        return len(self.offsets)

    @property
    def centre(self) -> np.ndarray:
        """(axes,) centre of the largest inscribed ball (Chebyshev centre), m."""
        return self._inscribed[0]

    @property
    def radius(self) -> float:
        """Radius of the largest inscribed ball, m; zero if the polytope is flat."""
        return self._inscribed[1]

    @property
    def is_flat(self) -> bool:
        """True if the polytope has no extent in some direction."""
        return self.radius <= _RELATIVE_ROUNDING * self._largest_offset

    @cached_property
    def size(self) -> float:
        """Largest finite extent of the polytope along the normals of its faces, m; 1 m if all are infinite."""
        extents = [offset + self.support(-normal) for normal, offset in zip(self.normals, self.offsets, strict=True)]
        return max((extent for extent in extents if math.isfinite(extent)), default=1.0)

    def support(self, direction: np.ndarray) -> float:
        """Return the largest value of direction · p over the points p, m, or infinity if the polytope is unbounded."""
        program = MathematicalProgram()
        p = program.NewContinuousVariables(len(direction))
        program.AddLinearCost(-direction, 0.0, p)
        program.AddLinearConstraint(self.normals, np.full(self.faces, -np.inf), self.offsets, p)
        result = ClpSolver().Solve(program)
        return -result.get_optimal_cost() if result.is_success() else math.inf

    def equals(self, other: "Polytope") -> bool:
        """Return True if both polytopes have the same faces in the same order."""
        return np.array_equal(self.normals, other.normals) and np.array_equal(self.offsets, other.offsets)

    def intersection(self, other: "Box | Polytope") -> "Polytope | None":
        """Return the intersection with another region, or None if it is empty.

        The search for a path intersects the same regions many times, so results are cached.
        """
        return _intersection_of_faces(self, other)

    def max_violation(self, position: np.ndarray) -> float:
        """Return the largest distance by which a position (axes,) lies beyond a face plane, m; negative inside."""
        return float((self.normals @ position - self.offsets).max())

    def contains(self, position: np.ndarray) -> bool:
        """Return whether the polytope contains a position (axes,), within solver accuracy."""
        return self.max_violation(position) <= 1e-7 * max(self.size, 1.0)

    def nearest(self, position: np.ndarray) -> np.ndarray:
        """Return the point of the polytope that is nearest to a position (axes,), m."""
        if self.max_violation(position) <= 0.0:
            return position
        program = MathematicalProgram()
        p = program.NewContinuousVariables(len(position))
        # The variables are relative to the position, so that they are small for the solver.
        program.AddQuadraticCost(2.0 * np.eye(len(p)), np.zeros(len(p)), p, is_convex=True)
        offsets = self.offsets - self.normals @ position
        program.AddLinearConstraint(self.normals, np.full(self.faces, -np.inf), offsets, p)
        # The cost is nearly constant around its minimum, so the error of the point is about the square root of the
        # solver tolerance.
        for option in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
            program.SetSolverOption(ClarabelSolver.id(), option, 1e-12)
        return position + ClarabelSolver().Solve(program).GetSolution(p)

    @cached_property
    def _inscribed(self) -> tuple[np.ndarray, float]:
        """Centre and radius (m) of the largest inscribed ball. The radius is negative if the polytope is empty."""
        axes = self.normals.shape[1]
        program = MathematicalProgram()
        x = program.NewContinuousVariables(axes + 1)
        program.AddLinearCost(-x[-1])
        rows = np.column_stack([self.normals, np.ones(self.faces)])
        program.AddLinearConstraint(rows, np.full(self.faces, -np.inf), self.offsets, x)
        program.AddBoundingBoxConstraint(-_MAX_INSCRIBED_RADIUS, _MAX_INSCRIBED_RADIUS, x)
        result = ClpSolver().Solve(program)
        if not result.is_success():
            return np.zeros(axes), -math.inf
        solution = result.GetSolution(x)
        return solution[:-1], float(solution[-1])

    @property
    def _largest_offset(self) -> float:
        return max(float(np.abs(self.offsets).max()), 1.0)

    def __str__(self) -> str:
        faces = f"{self.faces} {'face' if self.faces == 1 else 'faces'}"
        if np.abs([*self.centre, self.radius]).max() >= _MAX_INSCRIBED_RADIUS:
            return f"the unbounded polytope of {faces}"
        return f"the polytope of {faces} around {format_vector(self.centre)}"


@lru_cache(maxsize=4096)
def _intersection_of_faces(one: Polytope, other: Box | Polytope) -> Polytope | None:
    """Return the intersection of two regions, or None if it is empty."""
    others = Polytope.from_box(other) if isinstance(other, Box) else other
    rows = np.vstack([np.column_stack([p.normals, p.offsets]) for p in (one, others)])
    # Equal faces are merged.
    different = np.array([*dict.fromkeys(map(tuple, rows.tolist()))])
    try:
        return Polytope(different[:, :-1], different[:, -1])
    except InputError:
        return None


Corridor = Box | Polytope
"""Region that a path must not leave on a segment."""
WaypointRegion = Box | Sphere | Polytope
"""Region through which a path passes at a waypoint."""


def intersection_of(one: Corridor, other: Corridor) -> Corridor | None:
    """Return the intersection of two regions, or None if it is empty."""
    if isinstance(one, Box):
        return one.intersection(other) if isinstance(other, Box) else other.intersection(one)
    return one.intersection(other)


def overlap(waypoint: WaypointRegion, corridor: Corridor) -> bool:
    """Return whether a waypoint's region and a corridor have a common point."""
    if isinstance(waypoint, Sphere):
        return bool(np.linalg.norm(corridor.nearest(waypoint.centre) - waypoint.centre) <= waypoint.radius)
    if isinstance(corridor, Polytope) and isinstance(waypoint, Box) and waypoint.is_point:
        return corridor.contains(waypoint.centre)
    return intersection_of(waypoint, corridor) is not None


def bounding_box(region: Box | Sphere) -> Box:
    """Return the smallest box around a box or a sphere."""
    return region if isinstance(region, Box) else Box(region.centre - region.radius, region.centre + region.radius)


def format_vector(values: ArrayLike) -> str:
    """Return a vector as text for messages."""
    return "(" + ", ".join(f"{value:g}" for value in np.atleast_1d(np.asarray(values, dtype=float))) + ")"
