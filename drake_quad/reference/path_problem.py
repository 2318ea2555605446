"""Path-planning problem: waypoints, derivatives given at waypoints, corridors and limits.

Waypoints and segments are numbered from 0, as in scenario files. Segment i leads from waypoint i to waypoint i + 1.
"""

import copy
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from drake_quad.errors import InputError
from drake_quad.reference.minimum_snap import rest_at_ends
from drake_quad.reference.regions import (
    AXES,
    Box,
    Corridor,
    Polytope,
    Sphere,
    WaypointRegion,
    bounding_box,
    intersection_of,
    overlap,
)

# Plans are accurate in floating point within these limits, which no real flight exceeds.
_MIN_DISTANCE = 1e-5  # smallest distance between successive waypoints, m
_MAX_COORDINATE = 1e5  # largest coordinate of a waypoint, m


@dataclass(frozen=True)
class PathLimits:
    """Limits on speed and acceleration along the whole path. Infinity means no limit.

    Attributes:
        speed: largest norm of the velocity, m/s.
        acceleration: largest norm of the acceleration, m/s².

    Raises:
        InputError: if a limit is not positive.
    """

    speed: float = math.inf
    acceleration: float = math.inf

    def __post_init__(self) -> None:
        for name, limit, unit in (("speed", self.speed, "m/s"), ("acceleration", self.acceleration, "m/s²")):
            if not limit > 0.0:
                raise InputError(f"the {name} limit is {limit:g} {unit}, but must be positive")

    @property
    def by_order(self) -> dict[int, float]:
        """Finite limits of the path, keyed by the order of the derivative of the position that they bound."""
        both = {1: self.speed, 2: self.acceleration}
        return {order: limit for order, limit in both.items() if limit < math.inf}


@dataclass(frozen=True)
class PathProblem:
    """Constraints on a path that is to be planned.

    Attributes:
        waypoints: segments + 1 regions through which the path passes, in order. A point is a box without extent.
        derivatives: (segments + 1, 3, axes) velocity (m/s), acceleration (m/s²) and jerk (m/s³) at the waypoints. Each
            derivative is given on all axes, or NaN on all axes if it is free. By default the path is at rest at both
            ends and free in between.
        corridors: box or polytope that each segment must stay in, or None for a segment without a corridor. By default
            there are no corridors.
        limits: limits on speed and acceleration; by default no limits.
        start: (segments + 1, axes) initial points of a search within the waypoints' regions, m. By default these are
            the centres of the regions, or, if a region is a polytope, points on the shortest polyline through all
            regions.

    Raises:
        InputError: if shapes do not match, or no path can satisfy the constraints at any times.
    """

    waypoints: tuple[WaypointRegion, ...]
    derivatives: np.ndarray
    corridors: tuple[Corridor | None, ...]
    limits: PathLimits = field(default_factory=PathLimits)
    start: np.ndarray | None = None

    def __init__(
        self,
        waypoints: Sequence[WaypointRegion],
        *,
        derivatives: ArrayLike | None = None,
        corridors: Sequence[Corridor | None] | None = None,
        limits: PathLimits | None = None,
        start: ArrayLike | None = None,
    ) -> None:
        if not all(isinstance(region, Box | Sphere | Polytope) for region in waypoints):
            raise InputError("a waypoint must be a Box (Box.point for a point), a Sphere or a Polytope")
        axes = len(waypoints[0].centre) if waypoints else 0
        if len(waypoints) < 2 or any(len(region.centre) != axes for region in waypoints):
            raise InputError("a path needs two or more waypoints of the same dimension")
        given = rest_at_ends(len(waypoints), axes) if derivatives is None else np.array(derivatives, dtype=float)
        if given.shape != (len(waypoints), 3, axes):
            raise InputError(f"the derivatives have the shape {given.shape}, but must have {(len(waypoints), 3, axes)}")
        boxes = (None,) * (len(waypoints) - 1) if corridors is None else tuple(corridors)
        if len(boxes) != len(waypoints) - 1:
            raise InputError(f"there are {len(boxes)} corridors for {len(waypoints) - 1} segments")
        object.__setattr__(self, "waypoints", tuple(waypoints))
        object.__setattr__(self, "derivatives", given)
        object.__setattr__(self, "corridors", boxes)
        object.__setattr__(self, "limits", limits or PathLimits())
        object.__setattr__(self, "start", None if start is None else np.array(start, dtype=float))
        if self.start is not None and self.start.shape != (len(waypoints), axes):
            raise InputError(f"the start has the shape {self.start.shape}, but must have {(len(waypoints), axes)}")
        self._check_waypoints()
        self._check_overlaps()
        self._check_derivatives()

    @property
    def segments(self) -> int:
        """Number of path segments, one less than the number of waypoints."""
        return len(self.waypoints) - 1

    @property
    def has_closed_form_path(self) -> bool:
        """True if all waypoints are points and there are no corridors, so the path without limits has a closed form."""
        return all(map(_is_point, self.waypoints)) and not any(self.corridors)

    @property
    def is_time_scalable(self) -> bool:
        """True if all given derivatives are zero, so a path can be slowed down without changing its shape."""
        return not np.nan_to_num(self.derivatives).any()

    def without_limits(self) -> "PathProblem":
        """Return the same problem without limits on speed and acceleration."""
        # The copy skips the checks of the constructor, which this problem has already passed.
        problem = copy.copy(self)
        vars(problem).update(limits=PathLimits(), start=self.representatives())
        vars(problem).pop("_representatives", None)
        return problem

    def allowed_box(self, waypoint: int) -> Box | None:
        """Return the intersection of all boxes that apply at a waypoint: its region and adjacent corridors."""
        box = None
        for region in self._regions(waypoint):
            if isinstance(region, Box):
                box = region if box is None else box.intersection(region)
                assert box is not None, "checked by the constructor"
        return box

    def allowed_polytope(self, waypoint: int) -> Polytope | None:
        """Return the intersection of all polytopes that apply at a waypoint: its region and adjacent corridors.

        The result is None if the waypoint is a point, since the constructor has checked that the polytopes contain it.
        """
        return None if _is_point(self.waypoints[waypoint]) else self._faces[waypoint]

    def inner_point(self, waypoint: int) -> np.ndarray:
        """Return the point (axes,) of a waypoint's allowed region that is farthest from the faces of this region, m.

        If the waypoint is a point or a sphere, or if the allowed region is no polytope, the result is the point of the
        waypoint in `representatives`.
        """
        faces, box = self.allowed_polytope(waypoint), self.allowed_box(waypoint)
        region = self.waypoints[waypoint]
        if faces is None or isinstance(region, Sphere):
            return self.representatives()[waypoint]
        intersection = faces if box is None else faces.intersection(box)
        assert intersection is not None, "checked by the constructor"
        return intersection.centre

    def representatives(self) -> np.ndarray:
        """Return an allowed point (segments + 1, axes) for each waypoint, m.

        If `start` is given, the result is the allowed point nearest to `start`. Otherwise it is the allowed point
        nearest to the centre of the waypoint's region, or, if a region is a polytope, the point on the shortest
        polyline through all regions.
        """
        return self._representatives

    @cached_property
    def _representatives(self) -> np.ndarray:
        polytopes = any(isinstance(region, Polytope) for region in self.waypoints)
        if self.start is None and polytopes:
            return self._shortest_polyline()
        targets = [region.centre for region in self.waypoints] if self.start is None else self.start
        points = []
        for i, target in enumerate(targets):
            box, faces = self.allowed_box(i), self.allowed_polytope(i)
            if faces is None or faces.max_violation(target if box is None else box.nearest(target)) <= 0.0:
                points.append(target if box is None else box.nearest(target))
            else:
                points.append((faces if box is None else faces.intersection(box) or faces).nearest(target))
        return np.array(points)

    @cached_property
    def _faces(self) -> tuple[Polytope | None, ...]:
        faces_of_waypoints: list[Polytope | None] = []
        for i in range(len(self.waypoints)):
            intersection = None
            for region in self._regions(i):
                if isinstance(region, Polytope):
                    intersection = region if intersection is None else intersection.intersection(region)
            faces_of_waypoints.append(intersection)
        return tuple(faces_of_waypoints)

    def _regions(self, waypoint: int) -> list[WaypointRegion]:
        """Return the corridors before and after a waypoint, and the waypoint's region."""
        adjacent = self.corridors[max(waypoint - 1, 0) : waypoint + 1]
        return [*(corridor for corridor in adjacent if corridor is not None), self.waypoints[waypoint]]

    def _shortest_polyline(self) -> np.ndarray:
        """Return the shortest polyline (segments + 1, axes) with an allowed point for each waypoint, m."""
        program = MathematicalProgram()
        axes = len(self.waypoints[0].centre)
        points = program.NewContinuousVariables(len(self.waypoints), axes)
        for i, region in enumerate(self.waypoints):
            box, faces = self.allowed_box(i), self.allowed_polytope(i)
            if box is not None:
                program.AddBoundingBoxConstraint(box.low, box.high, points[i])
            if faces is not None:
                program.AddLinearConstraint(faces.normals, np.full(faces.faces, -np.inf), faces.offsets, points[i])
            if isinstance(region, Sphere):
                matrix = np.vstack([np.zeros(axes), np.eye(axes)])
                program.AddLorentzConeConstraint(matrix, np.concatenate([[region.radius], -region.centre]), points[i])
        difference = np.vstack([np.zeros(2 * axes), np.hstack([-np.eye(axes), np.eye(axes)])])
        for pair in itertools.pairwise(points):
            length = program.NewContinuousVariables(1)
            program.AddLinearCost(length[0])
            rows = np.column_stack([np.eye(axes + 1)[:, 0], difference])
            program.AddLorentzConeConstraint(rows, np.zeros(axes + 1), np.concatenate([length, *pair]))
        result = ClarabelSolver().Solve(program)
        if not result.is_success():
            raise InputError(
                "no feasible point was found for each waypoint: waypoints and corridors leave too little space"
            )
        solution = result.GetSolution(points)
        return np.array(
            [
                solution[i] if (box := self.allowed_box(i)) is None else box.nearest(solution[i])
                for i in range(len(solution))
            ]
        )

    def _check_waypoints(self) -> None:
        """Raise InputError if a waypoint is too far from the origin or too close to the next waypoint."""
        for i, region in enumerate(self.waypoints):
            if np.abs(region.centre).max() > _MAX_COORDINATE:
                raise InputError(f"waypoint {i}, {region} m, is farther than {_MAX_COORDINATE:g} m from the origin")
        for i, (one, other) in enumerate(itertools.pairwise(self.waypoints)):
            distance = float(np.linalg.norm(other.centre - one.centre))
            if _is_point(one) and _is_point(other) and 0.0 < distance < _MIN_DISTANCE:
                raise InputError(
                    f"waypoints {i} and {i + 1} are {distance:g} m apart; make them equal, or place them at least"
                    f" {_MIN_DISTANCE:g} m apart"
                )

    def _check_overlaps(self) -> None:
        """Raise InputError if successive corridors, or a waypoint and its corridors, do not overlap."""
        intersections: dict[int, Corridor] = {}
        for i, (before, after) in enumerate(itertools.pairwise(self.corridors)):
            if before and after:
                intersection = intersection_of(before, after)
                if intersection is None:
                    raise InputError(
                        f"the corridors of segments {i} and {i + 1} do not overlap{_describe_gap(before, after)}"
                    )
                intersections[i + 1] = intersection
        for i, region in enumerate(self.waypoints):
            adjacent = range(max(i - 1, 0), min(i + 1, self.segments))
            corridors = [(segment, corridor) for segment in adjacent if (corridor := self.corridors[segment])]
            for segment, corridor in corridors:
                if not overlap(region, corridor):
                    raise InputError(
                        f"waypoint {i}, {region} m, lies outside the corridor of segment {segment}, {corridor} m"
                        f"{_describe_gap(region, corridor)}"
                    )
            if i in intersections and not overlap(region, intersections[i]):
                raise InputError(
                    f"waypoint {i}, {region} m, has no point where the corridors of segments {i - 1} and {i} overlap"
                )

    def _check_derivatives(self) -> None:
        """Raise InputError if given derivatives are incomplete, leave a flat corridor, or exceed a limit."""
        given = ~np.isnan(self.derivatives)
        if (given.any(axis=2) != given.all(axis=2)).any() or np.isinf(self.derivatives).any():
            raise InputError(
                "velocity, acceleration and jerk at a waypoint must be finite on all axes or NaN on all axes"
            )
        for segment, corridor in enumerate(self.corridors):
            if isinstance(corridor, Polytope) and corridor.is_flat:
                raise InputError(
                    f"the corridor of segment {segment}, {corridor} m, is flat; give it an extent, or use a box"
                )
            if not isinstance(corridor, Box):
                continue
            flat = corridor.low == corridor.high
            for waypoint in (segment, segment + 1):
                if np.nan_to_num(self.derivatives[waypoint][:, flat]).any():
                    raise InputError(
                        f"the derivatives given at waypoint {waypoint} lead out of the corridor of segment {segment}, "
                        f"{corridor} m, which has no extent in that direction"
                    )
        for order, limit in self.limits.by_order.items():
            sizes = np.linalg.norm(self.derivatives[:, order - 1], axis=1)
            for i in np.flatnonzero(sizes > limit):
                name, unit = (("velocity", "m/s"), ("acceleration", "m/s²"))[order - 1]
                raise InputError(
                    f"the {name} at waypoint {i} is {sizes[i]:g} {unit}, more than the limit of {limit:g} {unit}"
                )


def _is_point(region: WaypointRegion) -> bool:
    """Return True if a region is a single point."""
    return isinstance(region, Box) and region.is_point


def _describe_gap(one: WaypointRegion, other: WaypointRegion) -> str:
    """Describe the distance between two regions, and for two boxes the axis along which it is measured.

    The text is empty if the distance is unknown.
    """
    if isinstance(one, Polytope) or isinstance(other, Polytope):
        polytope, region = (one, other) if isinstance(one, Polytope) else (other, one)
        if not _is_point(region):
            return ""
        distance = float(np.linalg.norm(polytope.nearest(region.centre) - region.centre))
        return f": they are {distance:g} m apart"
    one, other = bounding_box(one), bounding_box(other)
    gaps = np.maximum(one.low - other.high, other.low - one.high)
    axis = int(np.argmax(gaps))
    name = AXES[axis] if len(gaps) <= len(AXES) else f"axis {axis}"
    return f": they are {gaps[axis]:g} m apart on {name}" if gaps[axis] > 0.0 else ""
