"""Regions that paths keep to and pass through: boxes, spheres and convex polytopes."""

import math
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import ClarabelSolver, ClpSolver, MathematicalProgram

from drake_quad.errors import InputError

AXES = "xyz"
# A solver's word on a length is good to this share of the largest length in question.
_ROUNDING = 1e-9
# The inscribed ball of an unbounded polytope is not made larger than this: as far as anything is flown, m.
_LARGEST_RADIUS = 1e5


class Box:
    """An axis-aligned box; a point if both corners are the same.

    Attributes:
        low: (axes,) its lowest corner, m.
        high: (axes,) its highest corner, m.

    Raises:
        InputError: a corner is not finite, or low exceeds high.
    """

    def __init__(self, low: ArrayLike, high: ArrayLike) -> None:
        self.low = np.array(low, dtype=float)
        self.high = np.array(high, dtype=float)
        if self.low.shape != self.high.shape or self.low.ndim != 1:
            raise InputError(f"a box needs two corners of one dimension, not {text(low)} and {text(high)}")
        if not (np.isfinite(self.low).all() and np.isfinite(self.high).all() and (self.low <= self.high).all()):
            raise InputError(f"a box from {text(self.low)} to {text(self.high)} m is empty or not finite")

    @classmethod
    def point(cls, position: ArrayLike) -> "Box":
        """A box of no extent, m."""
        return cls(position, position)

    @property
    def centre(self) -> np.ndarray:
        """(axes,), m."""
        return 0.5 * (self.low + self.high)

    @property
    def is_point(self) -> bool:
        """True if the box has no extent."""
        return bool((self.low == self.high).all())

    def equals(self, other: "Box") -> bool:
        """True if both are the same box."""
        return bool((self.low == other.low).all() and (self.high == other.high).all())

    def intersection(self, other: "Box") -> "Box | None":
        """What both have in common, or None."""
        low, high = np.maximum(self.low, other.low), np.minimum(self.high, other.high)
        return Box(low, high) if (low <= high).all() else None

    def nearest(self, position: np.ndarray) -> np.ndarray:
        """The point of the box that is nearest to a position (axes,), m."""
        return np.clip(position, self.low, self.high)

    def __str__(self) -> str:
        if self.is_point:
            return text(self.low)
        return f"the box from {text(self.low)} to {text(self.high)}"


class Sphere:
    """A ball to pass through.

    Attributes:
        centre: (axes,), m.
        radius: m.

    Raises:
        InputError: the centre is not finite or the radius not positive.
    """

    def __init__(self, centre: ArrayLike, radius: float) -> None:
        self.centre = np.array(centre, dtype=float)
        self.radius = float(radius)
        if not np.isfinite(self.centre).all():
            raise InputError(f"the centre of a sphere, {text(self.centre)}, must be finite")
        if not 0.0 < self.radius < math.inf:
            raise InputError(f"the radius of a sphere is {self.radius:g} m, but must be positive and finite")

    def nearest(self, position: np.ndarray) -> np.ndarray:
        """The point of the ball that is nearest to a position (axes,), m."""
        away = position - self.centre
        distance = float(np.linalg.norm(away))
        return position if distance <= self.radius else self.centre + away * (self.radius / distance)

    def __str__(self) -> str:
        return f"the sphere of {self.radius:g} m around {text(self.centre)}"


class Polytope:
    """A convex polytope, the points p with n · p <= d for every face; it may be unbounded, or flat.

    Attributes:
        normals: (faces, axes) outward unit normals n.
        offsets: (faces,) distances d of the faces from the origin along their normals, m.

    Raises:
        InputError: the shapes do not fit, a number is not finite, a normal is zero or no point satisfies all.
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
        if self.radius < -_ROUNDING * self._largest_offset:
            raise InputError(f"a polytope of {len(rows)} faces is empty: no point lies behind all of them")

    @classmethod
    def from_box(cls, box: Box) -> "Polytope":
        """A box by its faces."""
        identity = np.eye(len(box.low))
        return cls(np.vstack([-identity, identity]), np.concatenate([-box.low, box.high]))

    @property
    def faces(self) -> int:
        """Number of faces."""
        return len(self.offsets)

    @property
    def centre(self) -> np.ndarray:
        """(axes,) of the largest ball inside (Chebyshev centre), m."""
        return self._inscribed[0]

    @property
    def radius(self) -> float:
        """Of the largest ball inside, m; zero if the polytope is flat."""
        return self._inscribed[1]

    @property
    def is_flat(self) -> bool:
        """True if the polytope has no extent in some direction."""
        return self.radius <= _ROUNDING * self._largest_offset

    @cached_property
    def size(self) -> float:
        """The largest of its extents along its faces' normals that are finite, m; 1 m if there is none."""
        extents = [offset + self.reach(-normal) for normal, offset in zip(self.normals, self.offsets, strict=True)]
        return max((extent for extent in extents if math.isfinite(extent)), default=1.0)

    def reach(self, direction: np.ndarray) -> float:
        """How far it extends along a direction (axes,): the largest direction · p, m; infinite if unbounded."""
        program = MathematicalProgram()
        p = program.NewContinuousVariables(len(direction))
        program.AddLinearCost(-direction, 0.0, p)
        program.AddLinearConstraint(self.normals, np.full(self.faces, -np.inf), self.offsets, p)
        result = ClpSolver().Solve(program)
        return -result.get_optimal_cost() if result.is_success() else math.inf

    def equals(self, other: "Polytope") -> bool:
        """True if both have the same faces in the same order."""
        return np.array_equal(self.normals, other.normals) and np.array_equal(self.offsets, other.offsets)

    def intersection(self, other: "Box | Polytope") -> "Polytope | None":
        """What both have in common, or None."""
        faces = Polytope.from_box(other) if isinstance(other, Box) else other
        rows = np.vstack([np.column_stack([p.normals, p.offsets]) for p in (self, faces)])
        # A face that both have is one.
        _, first = np.unique(rows, axis=0, return_index=True)
        rows = rows[np.sort(first)]
        try:
            return Polytope(rows[:, :-1], rows[:, -1])
        except InputError:
            return None

    def beyond(self, position: np.ndarray) -> float:
        """How far a position (axes,) lies beyond the face that it breaks most, m; negative inside."""
        return float((self.normals @ position - self.offsets).max())

    def contains(self, position: np.ndarray) -> bool:
        """True if a position (axes,) is in it, to rounding errors of the solvers that find such positions."""
        return self.beyond(position) <= 1e-7 * max(self.size, 1.0)

    def nearest(self, position: np.ndarray) -> np.ndarray:
        """The point of the polytope that is nearest to a position (axes,), m."""
        if self.beyond(position) <= 0.0:
            return position
        program = MathematicalProgram()
        p = program.NewContinuousVariables(len(position))
        # Relative to the position, so that the solver meets small numbers.
        program.AddQuadraticCost(2.0 * np.eye(len(p)), np.zeros(len(p)), p, is_convex=True)
        offsets = self.offsets - self.normals @ position
        program.AddLinearConstraint(self.normals, np.full(self.faces, -np.inf), offsets, p)
        # The cost is flat around its least: a place is only as good as the root of what the cost is good to.
        for option in ("tol_gap_abs", "tol_gap_rel", "tol_feas"):
            program.SetSolverOption(ClarabelSolver.id(), option, 1e-12)
        return position + ClarabelSolver().Solve(program).GetSolution(p)

    @cached_property
    def _inscribed(self) -> tuple[np.ndarray, float]:
        """Centre and radius of the largest ball inside; the radius is negative if the polytope is empty."""
        axes = self.normals.shape[1]
        program = MathematicalProgram()
        x = program.NewContinuousVariables(axes + 1)
        program.AddLinearCost(-x[-1])
        rows = np.column_stack([self.normals, np.ones(self.faces)])
        program.AddLinearConstraint(rows, np.full(self.faces, -np.inf), self.offsets, x)
        program.AddBoundingBoxConstraint(-_LARGEST_RADIUS, _LARGEST_RADIUS, x)
        result = ClpSolver().Solve(program)
        if not result.is_success():
            return np.zeros(axes), -math.inf
        solution = result.GetSolution(x)
        return solution[:-1], float(solution[-1])

    @property
    def _largest_offset(self) -> float:
        return max(float(np.abs(self.offsets).max()), 1.0)

    def __str__(self) -> str:
        return f"the polytope of {self.faces} faces around {text(self.centre)}"


Corridor = Box | Polytope
Place = Box | Sphere | Polytope


def common(one: Corridor, other: Corridor) -> Corridor | None:
    """What two regions have in common, or None."""
    if isinstance(one, Box):
        return one.intersection(other) if isinstance(other, Box) else other.intersection(one)
    return one.intersection(other)


def touch(place: Place, region: Corridor) -> bool:
    """True if a place has a point in a region."""
    if isinstance(place, Sphere):
        return bool(np.linalg.norm(region.nearest(place.centre) - place.centre) <= place.radius)
    if isinstance(region, Polytope) and isinstance(place, Box) and place.is_point:
        return region.contains(place.centre)
    return common(place, region) is not None


def bounds(place: Box | Sphere) -> Box:
    """The smallest box around a box or a sphere."""
    return place if isinstance(place, Box) else Box(place.centre - place.radius, place.centre + place.radius)


def text(values: ArrayLike) -> str:
    """A vector as messages write it."""
    return "(" + ", ".join(f"{value:g}" for value in np.atleast_1d(np.asarray(values, dtype=float))) + ")"
