"""What a path must keep to: places to pass, derivatives there, corridors and limits.

Waypoints and segments are counted from 0, as in the files: segment i leads from waypoint i to waypoint i + 1.
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
from drake_quad.reference.regions import AXES, Box, Corridor, Place, Polytope, Sphere, bounds, common, touch

# What a quadrotor flies, and what floating point can plan, lies between: m.
_NEAREST, _FARTHEST = 1e-5, 1e5


@dataclass(frozen=True)
class PathLimits:
    """Bounds on norms along the whole path; infinite where there is none.

    Attributes:
        speed: of the velocity, m/s.
        acceleration: of the acceleration, m/s².

    Raises:
        InputError: a limit is not positive.
    """

    speed: float = math.inf
    acceleration: float = math.inf

    def __post_init__(self) -> None:
        for name, limit, unit in (("speed", self.speed, "m/s"), ("acceleration", self.acceleration, "m/s²")):
            if not limit > 0.0:
                raise InputError(f"the {name} limit is {limit:g} {unit}, but must be positive")

    @property
    def by_order(self) -> dict[int, float]:
        """The finite limits by the order of the derivative that they bound."""
        both = {1: self.speed, 2: self.acceleration}
        return {order: limit for order, limit in both.items() if limit < math.inf}


@dataclass(frozen=True)
class PathProblem:
    """A path to be found.

    Attributes:
        places: (segments + 1) where to pass; a point is a box of no extent.
        derivatives: (segments + 1, 3, axes) velocity (m/s), acceleration (m/s²) and jerk (m/s³) at the waypoints, each
            on all axes, or NaN on all where the path is free to choose. Rest at both ends and freedom in between by
            default.
        corridors: (segments) boxes or polytopes that the path must not leave on a segment, or None; none by default.
        limits: on speed and acceleration; none by default.
        start: (segments + 1, axes) where a search begins for waypoints that may be chosen, m; if not given, at the
            centres of their places, and along the shortest way through those that are polytopes.

    Raises:
        InputError: the shapes do not fit, or no path can keep to all of this, whatever its times.
    """

    places: tuple[Place, ...]
    derivatives: np.ndarray
    corridors: tuple[Corridor | None, ...]
    limits: PathLimits = field(default_factory=PathLimits)
    start: np.ndarray | None = None

    def __init__(
        self,
        places: Sequence[Place],
        *,
        derivatives: ArrayLike | None = None,
        corridors: Sequence[Corridor | None] | None = None,
        limits: PathLimits | None = None,
        start: ArrayLike | None = None,
    ) -> None:
        if not all(isinstance(place, Box | Sphere | Polytope) for place in places):
            raise InputError("a waypoint must be a Box, of which Box.point is one, a Sphere or a Polytope")
        axes = len(places[0].centre) if places else 0
        if len(places) < 2 or any(len(place.centre) != axes for place in places):
            raise InputError("two or more waypoints of the same dimension are needed")
        given = rest_at_ends(len(places), axes) if derivatives is None else np.array(derivatives, dtype=float)
        if given.shape != (len(places), 3, axes):
            raise InputError(f"the derivatives have the shape {given.shape}, but must have {(len(places), 3, axes)}")
        boxes = (None,) * (len(places) - 1) if corridors is None else tuple(corridors)
        if len(boxes) != len(places) - 1:
            raise InputError(f"there are {len(boxes)} corridors for {len(places) - 1} segments")
        object.__setattr__(self, "places", tuple(places))
        object.__setattr__(self, "derivatives", given)
        object.__setattr__(self, "corridors", boxes)
        object.__setattr__(self, "limits", limits or PathLimits())
        object.__setattr__(self, "start", None if start is None else np.array(start, dtype=float))
        if self.start is not None and self.start.shape != (len(places), axes):
            raise InputError(f"the start has the shape {self.start.shape}, but must have {(len(places), axes)}")
        self._check_places()
        self._check_overlaps()
        self._check_derivatives()

    @property
    def segments(self) -> int:
        """Number of segments."""
        return len(self.places) - 1

    @property
    def passes_points(self) -> bool:
        """True if every place is a point and there are no corridors: the fast path's problem, but for the limits."""
        return all(map(_is_point, self.places)) and not any(self.corridors)

    @property
    def stretchable(self) -> bool:
        """True if no motion is given at the waypoints, so that a path may be flown slower, or faster, as it is."""
        return not np.nan_to_num(self.derivatives).any()

    def without_limits(self) -> "PathProblem":
        """The same problem, whatever the speed and acceleration."""
        # A copy needs no further checks.
        problem = copy.copy(self)
        vars(problem).update(limits=PathLimits(), start=self.representatives())
        vars(problem).pop("_representatives", None)
        return problem

    def room(self, waypoint: int) -> Box | None:
        """The box that the boxes among a waypoint's place and the corridors before and after it leave it."""
        room = None
        for region in self._regions(waypoint):
            if isinstance(region, Box):
                room = region if room is None else room.intersection(region)
                assert room is not None, "seen to by the constructor"
        return room

    def faces(self, waypoint: int) -> Polytope | None:
        """What the polytopes among a waypoint's place and the corridors before and after it leave it.

        None for a point, which lies there already.
        """
        return None if _is_point(self.places[waypoint]) else self._faces[waypoint]

    def inner_point(self, waypoint: int) -> np.ndarray:
        """(axes,) a point of a waypoint's room as far from its faces as can be, m; its representative without faces."""
        faces, room = self.faces(waypoint), self.room(waypoint)
        place = self.places[waypoint]
        if faces is None or isinstance(place, Sphere):
            return self.representatives()[waypoint]
        joint = faces if room is None else faces.intersection(room)
        assert joint is not None, "seen to by the constructor"
        return joint.centre

    def representatives(self) -> np.ndarray:
        """(segments + 1, axes) an allowed point for each waypoint: the centre, or the nearest that corridors leave.

        Where a place is a polytope, its point on the shortest way; or the nearest to the start if there is one.
        """
        return self._representatives

    @cached_property
    def _representatives(self) -> np.ndarray:
        polytopes = any(isinstance(place, Polytope) for place in self.places)
        if self.start is None and polytopes:
            return self._shortest_way()
        wishes = [place.centre for place in self.places] if self.start is None else self.start
        points = []
        for i, wish in enumerate(wishes):
            room, faces = self.room(i), self.faces(i)
            if faces is None or faces.beyond(wish if room is None else room.nearest(wish)) <= 0.0:
                points.append(wish if room is None else room.nearest(wish))
            else:
                points.append((faces if room is None else faces.intersection(room) or faces).nearest(wish))
        return np.array(points)

    @cached_property
    def _faces(self) -> tuple[Polytope | None, ...]:
        found: list[Polytope | None] = []
        for i in range(len(self.places)):
            joint = None
            for region in self._regions(i):
                if isinstance(region, Polytope):
                    joint = region if joint is None else joint.intersection(region)
            found.append(joint)
        return tuple(found)

    def _regions(self, waypoint: int) -> list[Place]:
        around = self.corridors[max(waypoint - 1, 0) : waypoint + 1]
        return [*(corridor for corridor in around if corridor is not None), self.places[waypoint]]

    def _shortest_way(self) -> np.ndarray:
        """(segments + 1, axes) the shortest polyline with a point in every waypoint's room."""
        program = MathematicalProgram()
        axes = len(self.places[0].centre)
        points = program.NewContinuousVariables(len(self.places), axes)
        for i, place in enumerate(self.places):
            room, faces = self.room(i), self.faces(i)
            if room is not None:
                program.AddBoundingBoxConstraint(room.low, room.high, points[i])
            if faces is not None:
                program.AddLinearConstraint(faces.normals, np.full(faces.faces, -np.inf), faces.offsets, points[i])
            if isinstance(place, Sphere):
                matrix = np.vstack([np.zeros(axes), np.eye(axes)])
                program.AddLorentzConeConstraint(matrix, np.concatenate([[place.radius], -place.centre]), points[i])
        difference = np.vstack([np.zeros(2 * axes), np.hstack([-np.eye(axes), np.eye(axes)])])
        for pair in itertools.pairwise(points):
            length = program.NewContinuousVariables(1)
            program.AddLinearCost(length[0])
            rows = np.column_stack([np.eye(axes + 1)[:, 0], difference])
            program.AddLorentzConeConstraint(rows, np.zeros(axes + 1), np.concatenate([length, *pair]))
        result = ClarabelSolver().Solve(program)
        if not result.is_success():
            raise InputError("no point was found for each waypoint: the places and corridors leave too little room")
        found = result.GetSolution(points)
        return np.array(
            [found[i] if (room := self.room(i)) is None else room.nearest(found[i]) for i in range(len(found))]
        )

    def _check_places(self) -> None:
        for i, place in enumerate(self.places):
            if np.abs(place.centre).max() > _FARTHEST:
                raise InputError(f"waypoint {i}, {place} m, is farther than {_FARTHEST:g} m from the origin")
        for i, (one, other) in enumerate(itertools.pairwise(self.places)):
            distance = float(np.linalg.norm(other.centre - one.centre))
            if _is_point(one) and _is_point(other) and 0.0 < distance < _NEAREST:
                raise InputError(
                    f"waypoints {i} and {i + 1} are {distance:g} m apart: repeat one exactly, or keep {_NEAREST:g} m"
                )

    def _check_overlaps(self) -> None:
        joints: dict[int, Corridor] = {}
        for i, (before, after) in enumerate(itertools.pairwise(self.corridors)):
            if before and after:
                joint = common(before, after)
                if joint is None:
                    raise InputError(f"the corridors of segments {i} and {i + 1} do not overlap{_gap(before, after)}")
                joints[i + 1] = joint
        for i, place in enumerate(self.places):
            around = range(max(i - 1, 0), min(i + 1, self.segments))
            corridors = [(segment, region) for segment in around if (region := self.corridors[segment])]
            for segment, region in corridors:
                if not touch(place, region):
                    raise InputError(
                        f"waypoint {i}, {place} m, lies outside the corridor of segment {segment}, {region} m"
                        f"{_gap(place, region)}"
                    )
            if i in joints and not touch(place, joints[i]):
                raise InputError(
                    f"waypoint {i}, {place} m, has no point where the corridors of segments {i - 1} and {i} overlap"
                )

    def _check_derivatives(self) -> None:
        given = ~np.isnan(self.derivatives)
        if (given.any(axis=2) != given.all(axis=2)).any() or np.isinf(self.derivatives).any():
            raise InputError("velocity, acceleration and jerk at a waypoint are finite, on all axes or on none")
        for segment, corridor in enumerate(self.corridors):
            if isinstance(corridor, Polytope) and corridor.is_flat:
                raise InputError(
                    f"the corridor of segment {segment}, {corridor} m, is flat: give it an extent, or a box"
                )
            if not isinstance(corridor, Box):
                continue
            flat = corridor.low == corridor.high
            for waypoint in (segment, segment + 1):
                if np.nan_to_num(self.derivatives[waypoint][:, flat]).any():
                    raise InputError(
                        f"what is given at waypoint {waypoint} leads out of the corridor of segment {segment}, "
                        f"{corridor} m, which has no extent in that direction"
                    )
        for order, limit in self.limits.by_order.items():
            sizes = np.linalg.norm(self.derivatives[:, order - 1], axis=1)
            for i in np.flatnonzero(sizes > limit):
                name, unit = (("velocity", "m/s"), ("acceleration", "m/s²"))[order - 1]
                raise InputError(
                    f"the {name} at waypoint {i} is given as {sizes[i]:g} {unit}, beyond the limit of {limit:g} {unit}"
                )


def _is_point(place: Place) -> bool:
    return isinstance(place, Box) and place.is_point


def _gap(one: Place, other: Place) -> str:
    """Says how far two regions are apart, and boxes on which axis."""
    if isinstance(one, Polytope) or isinstance(other, Polytope):
        polytope, place = (one, other) if isinstance(one, Polytope) else (other, one)
        if not _is_point(place):
            return ""
        distance = float(np.linalg.norm(polytope.nearest(place.centre) - place.centre))
        return f": they are {distance:g} m apart"
    one, other = bounds(one), bounds(other)
    gaps = np.maximum(one.low - other.high, other.low - one.high)
    axis = int(np.argmax(gaps))
    name = AXES[axis] if len(gaps) <= len(AXES) else f"axis {axis}"
    return f": they are {gaps[axis]:g} m apart on {name}" if gaps[axis] > 0.0 else ""
