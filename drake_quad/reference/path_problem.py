"""What a path must keep to: places to pass, derivatives there, corridors and limits.

Waypoints and segments are counted from 0, as in the files: segment i leads from waypoint i to waypoint i + 1.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from drake_quad.errors import InputError
from drake_quad.reference.minimum_snap import rest_at_ends

AXES = "xyz"
# What a quadrotor flies, and what floating point can plan, lies between: m.
_NEAREST, _FARTHEST = 1e-5, 1e5


@dataclass(frozen=True)
class Box:
    """An axis-aligned box; a point if both corners are the same.

    Attributes:
        low: (axes,) its lowest corner, m.
        high: (axes,) its highest corner, m.

    Raises:
        InputError: a corner is not finite, or low exceeds high.
    """

    low: np.ndarray
    high: np.ndarray

    def __init__(self, low: ArrayLike, high: ArrayLike) -> None:
        object.__setattr__(self, "low", np.array(low, dtype=float))
        object.__setattr__(self, "high", np.array(high, dtype=float))
        if self.low.shape != self.high.shape or self.low.ndim != 1:
            raise InputError(f"a box needs two corners of one dimension, not {_vector(low)} and {_vector(high)}")
        if not (np.isfinite(self.low).all() and np.isfinite(self.high).all() and (self.low <= self.high).all()):
            raise InputError(f"a box from {_vector(self.low)} to {_vector(self.high)} m is empty or not finite")

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
            return _vector(self.low)
        return f"the box from {_vector(self.low)} to {_vector(self.high)}"


@dataclass(frozen=True)
class Sphere:
    """A ball to pass through.

    Attributes:
        centre: (axes,), m.
        radius: m.

    Raises:
        InputError: the centre is not finite or the radius not positive.
    """

    centre: np.ndarray
    radius: float

    def __init__(self, centre: ArrayLike, radius: float) -> None:
        object.__setattr__(self, "centre", np.array(centre, dtype=float))
        object.__setattr__(self, "radius", float(radius))
        if not np.isfinite(self.centre).all():
            raise InputError(f"the centre of a sphere, {_vector(self.centre)}, must be finite")
        if not 0.0 < self.radius < math.inf:
            raise InputError(f"the radius of a sphere is {self.radius:g} m, but must be positive and finite")

    def nearest(self, position: np.ndarray) -> np.ndarray:
        """The point of the ball that is nearest to a position (axes,), m."""
        away = position - self.centre
        distance = float(np.linalg.norm(away))
        return position if distance <= self.radius else self.centre + away * (self.radius / distance)

    def __str__(self) -> str:
        return f"the sphere of {self.radius:g} m around {_vector(self.centre)}"


@dataclass(frozen=True)
class Limits:
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
        corridors: (segments) boxes that the path must not leave on a segment, or None; none by default.
        limits: on speed and acceleration; none by default.

    Raises:
        InputError: the shapes do not fit, or no path can keep to all of this, whatever its times.
    """

    places: tuple[Box | Sphere, ...]
    derivatives: np.ndarray
    corridors: tuple[Box | None, ...]
    limits: Limits = field(default_factory=Limits)

    def __init__(
        self,
        places: Sequence[Box | Sphere],
        *,
        derivatives: ArrayLike | None = None,
        corridors: Sequence[Box | None] | None = None,
        limits: Limits | None = None,
    ) -> None:
        if not all(isinstance(place, Box | Sphere) for place in places):
            raise InputError("a waypoint must be a Box, of which Box.point is one, or a Sphere")
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
        object.__setattr__(self, "limits", limits or Limits())
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
        return PathProblem(self.places, derivatives=self.derivatives, corridors=self.corridors)

    def room(self, waypoint: int) -> Box | None:
        """The box that the corridors before and after a waypoint leave it, and its own if it has one."""
        boxes = [*self.corridors[max(waypoint - 1, 0) : waypoint + 1], self.places[waypoint]]
        room = None
        for box in boxes:
            if isinstance(box, Box):
                room = box if room is None else room.intersection(box)
                assert room is not None, "seen to by the constructor"
        return room

    def representatives(self) -> np.ndarray:
        """(segments + 1, axes) an allowed point for each waypoint: the centre, or the nearest that corridors leave."""
        points = []
        for i, place in enumerate(self.places):
            room = self.room(i)
            points.append(place.centre if room is None else room.nearest(place.centre))
        return np.array(points)

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
        for i, (before, after) in enumerate(itertools.pairwise(self.corridors)):
            if before and after and before.intersection(after) is None:
                raise InputError(f"the corridors of segments {i} and {i + 1} do not overlap{_gap(before, after)}")
        for i, place in enumerate(self.places):
            around = range(max(i - 1, 0), min(i + 1, self.segments))
            corridors = [(segment, box) for segment in around if (box := self.corridors[segment])]
            for segment, box in corridors:
                if not _touch(place, box):
                    raise InputError(
                        f"waypoint {i}, {place} m, lies outside the corridor of segment {segment}, {box} m"
                        f"{_gap(_bounds(place), box)}"
                    )
            if len(corridors) == 2:
                joint = corridors[0][1].intersection(corridors[1][1])
                if joint is None or not _touch(place, joint):
                    raise InputError(
                        f"waypoint {i}, {place} m, has no point where the corridors of segments {i - 1} and {i} overlap"
                    )

    def _check_derivatives(self) -> None:
        given = ~np.isnan(self.derivatives)
        if (given.any(axis=2) != given.all(axis=2)).any() or np.isinf(self.derivatives).any():
            raise InputError("velocity, acceleration and jerk at a waypoint are finite, on all axes or on none")
        for segment, corridor in enumerate(self.corridors):
            if corridor is None:
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


def _is_point(place: Box | Sphere) -> bool:
    return isinstance(place, Box) and place.is_point


def _touch(place: Box | Sphere, box: Box) -> bool:
    """True if a place has a point in a box."""
    if isinstance(place, Box):
        return place.intersection(box) is not None
    return bool(np.linalg.norm(box.nearest(place.centre) - place.centre) <= place.radius)


def _bounds(place: Box | Sphere) -> Box:
    return place if isinstance(place, Box) else Box(place.centre - place.radius, place.centre + place.radius)


def _gap(one: Box, other: Box) -> str:
    """Says on which axis two boxes are apart, and by how much."""
    gaps = np.maximum(one.low - other.high, other.low - one.high)
    axis = int(np.argmax(gaps))
    name = AXES[axis] if len(gaps) <= len(AXES) else f"axis {axis}"
    return f": they are {gaps[axis]:g} m apart on {name}" if gaps[axis] > 0.0 else ""


def _vector(values: ArrayLike) -> str:
    return "(" + ", ".join(f"{value:g}" for value in np.atleast_1d(np.asarray(values, dtype=float))) + ")"
