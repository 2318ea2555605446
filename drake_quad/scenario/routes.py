"""Routes of the scenario language: where to fly, and when."""

import itertools
import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)
from pydantic_core import PydanticCustomError

from drake_quad.errors import InputError
from drake_quad.reference.minimum_snap import rest_at_ends
from drake_quad.reference.path_problem import Limits, PathProblem
from drake_quad.reference.pieces import POWERS, plan_of_pieces
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate_at, power_basis
from drake_quad.reference.regions import Box, Corridor, Polytope, Sphere, common
from drake_quad.scenario.distributions import Model, Real
from drake_quad.scenario.limits import LONGEST, MOST_WAYPOINTS, SHORTEST
from drake_quad.scenario.quantities import (
    RADIANS,
    TWO_TURNS,
    Direction,
    Number,
    PlainDirection,
    PlainDirections,
    PlainMoment,
    PlainPositive,
    PlainSpan,
    Point,
    Position,
    Positive,
    in_radians,
)

_Laps = Annotated[int, Field(ge=1, le=100)]
# Of a sine in a lap.
_Turns = Annotated[int, Field(ge=0, le=20)]
# Of a corridor; a normal shorter than this, 1, has no direction to speak of.
_MOST_FACES, _SHORTEST_NORMAL = 100, 1e-9
# Half a turn plus a tolerance for rounding, rad. If consecutive yaws differ by no more, they describe continuous turns.
_HALF_TURN = math.pi + 1e-6
# Path of a field, and its number.
_End = tuple[tuple[str | int, ...], float | None]


class _Moving(Model):
    """Fields of all routes that move."""

    yaw: Direction = Field(default=0.0, description="yaw of the reference where the heading is constant (rad)")
    heading: Literal["constant", "along_path"] = Field(
        default="constant", description="what the yaw follows; along_path looks where the path goes"
    )
    top_speed: Positive = Field(default=2.0, description="limit on the speed (m/s); the paper's 2 m/s")
    top_acceleration: Positive = Field(
        default=0.7, description="limit on the acceleration (m/s²); the paper's 0.7 m/s²"
    )

    def limits(self) -> Limits:
        """Those of the path; the route holds no distributions."""
        return Limits(speed=self.top_speed, acceleration=self.top_acceleration)

    def known_end(self) -> _End:
        """The field of a scenario that says when the route is over, and this time (s); None if a plan decides."""
        return ("route",), None


class FigureEightRoute(_Moving):
    """The paper's figure eight, stretched in time until one of the limits is met exactly."""

    kind: Literal["figure_eight"]
    lower_height: Positive = Field(default=1.0, description="height of the second circle and of the crossing (m)")
    upper_height: Positive = Field(default=2.0, description="height of the first circle (m)")
    radius: Positive = Field(default=1.4, description="radius of both circles (m)")
    offset: Positive = Field(default=1.9, description="distance of the circles' centres from the start (m)")
    cruise_speed: Positive = Field(
        default=1.2, description="speed by which the times are first shared out among the waypoints (m/s)"
    )
    laps: _Laps = Field(
        default=1, description="number of laps; the first begins, the last ends at rest, those in between are alike"
    )

    @field_validator("offset")
    @classmethod
    def _beyond_radius(cls, offset: Number, info: ValidationInfo) -> Number:
        radius = info.data.get("radius")
        if isinstance(offset, float) and isinstance(radius, float) and not offset > radius:
            raise PydanticCustomError("offset", "must be larger than the radius, {radius}", {"radius": radius})
        return offset


class CircleRoute(_Moving):
    """Laps of a level circle about the origin, stretched in time until one of the limits is met exactly."""

    kind: Literal["circle"]
    radius: Positive = Field(default=1.5, description="radius (m)")
    height: Number = Field(default=1.0, description="height (m)")
    laps: _Laps = Field(default=2, description="number of turns")


class LissajousRoute(Model):
    """Laps of a sine of time along each axis, at given times: centre + amplitude · sin(2π turns t / period + phase).

    The path moves from its first moment on, where the vehicle hovers: `metrics.start` leaves the transient out.
    """

    kind: Literal["lissajous"]
    centre: Point = Field(default=(0.0, 0.0, 1.0), description="in W (m)")
    amplitude: Point = Field(description="along X, Y, Z (m)")
    turns: Annotated[tuple[_Turns, _Turns, _Turns], Field(strict=False)] = Field(
        default=(1, 1, 2), description="of each sine in a lap (1)"
    )
    phase: PlainDirections = Field(default=(0.0, 0.0, 0.0), description="of each sine (rad)")
    period: PlainSpan = Field(description="time for a lap (s)")
    laps: _Laps = Field(default=2, description="number of laps")
    yaw: PlainDirection = Field(default=0.0, description="constant yaw of the reference (rad)")

    def known_end(self) -> _End:
        """As for the others."""
        return ("route", "laps"), self.laps * self.period


class HoverRoute(Model):
    """Staying at a point."""

    kind: Literal["hover"]
    position: Position = Field(default=(0.0, 0.0, 1.0), description="where to stay, in W (m)")
    yaw: Direction = Field(default=0.0, description="constant yaw of the reference (rad)")
    duration: PlainSpan = Field(default=10.0, description="how long to stay (s)")

    def known_end(self) -> _End:
        """As for the others."""
        return ("route", "duration"), self.duration


def _check_corners(region: Model, lowest: Sequence[float], highest: Sequence[float]) -> None:
    for i, (low, high) in enumerate(zip(lowest, highest, strict=True)):
        if low > high:
            raise region.wrong("max", i, kind="box", demand="must not be less than that of min, {low}", low=low)


class BoxRegion(Model):
    """An axis-aligned box."""

    min: Point = Field(description="lowest corner, in W (m)")
    max: Point = Field(description="highest corner, in W (m)")

    @model_validator(mode="after")
    def _not_empty(self) -> "BoxRegion":
        _check_corners(self, self.min, self.max)
        return self

    def box(self) -> Box:
        """The region as the planner has it."""
        return Box(self.min, self.max)


class HalfSpace(Model):
    """All that lies behind a plane."""

    normal: Point = Field(description="out of the half-space, in W; of any length (1)")
    point: Point = Field(description="on the plane, in W (m)")

    @model_validator(mode="after")
    def _has_a_direction(self) -> "HalfSpace":
        if not np.linalg.norm(self.normal) > _SHORTEST_NORMAL:
            raise self.wrong("normal", kind="normal", demand="must not be zero")
        return self


class CorridorRegion(Model):
    """A box, or what lies behind planes of any direction, or both at once: the part of the box behind the planes."""

    min: Point | None = Field(default=None, description="lowest corner, in W (m)")
    max: Point | None = Field(default=None, description="highest corner, in W (m)")
    half_spaces: Annotated[tuple[HalfSpace, ...], Field(strict=False, min_length=1, max_length=_MOST_FACES)] | None = (
        Field(default=None, description="the corridor lies in all of them")
    )

    @model_serializer(mode="wrap")
    def _written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """What is not given is not written, so that a box is written as ever."""
        return {name: value for name, value in write(self).items() if value is not None}

    @model_validator(mode="after")
    def _not_empty(self) -> "CorridorRegion":
        if (self.min is None) != (self.max is None):
            missing = "min" if self.min is None else "max"
            raise self.wrong(missing, kind="box", demand="must be given: a box has both corners")
        if self.min is None and self.half_spaces is None:
            raise PydanticCustomError("place", "must have min and max, or half_spaces, or both", {})
        if self.min is not None and self.max is not None:
            _check_corners(self, self.min, self.max)
        if self.half_spaces is not None:
            try:
                region = self.region()
            except InputError:
                region = None
            beside = "" if self.min is None else " of the box"
            if region is None:
                left = "no point"
            elif isinstance(region, Polytope) and region.is_flat:
                left = "no more than a plane, a line or a point"
            else:
                return self
            demand = "must have room: its half-spaces leave {left}{beside}"
            raise PydanticCustomError("place", demand, {"left": left, "beside": beside})
        return self

    def region(self) -> Corridor | None:
        """The region as the planner has it; None if the half-spaces leave nothing of the box.

        Raises:
            InputError: the half-spaces have no point in common.
        """
        box = None if self.min is None or self.max is None else Box(self.min, self.max)
        if self.half_spaces is None:
            return box
        normals = np.array([half_space.normal for half_space in self.half_spaces])
        points = np.array([half_space.point for half_space in self.half_spaces])
        polytope = Polytope(normals, (normals * points).sum(axis=1))
        return polytope if box is None else polytope.intersection(box)


class SphereRegion(Model):
    """A ball."""

    centre: Point = Field(description="centre, in W (m)")
    radius: PlainPositive = Field(description="radius (m)")


class Waypoint(Model):
    """Where to pass, and if need be how; [x, y, z] alone is short for its point."""

    point: Position | None = Field(default=None, description="exactly here, in W (m)")
    box: BoxRegion | None = Field(default=None, description="somewhere in this box")
    sphere: SphereRegion | None = Field(default=None, description="somewhere in this sphere")
    velocity: Point | None = Field(default=None, description="given velocity, in W (m/s); free by default")
    acceleration: Point | None = Field(default=None, description="given acceleration, in W (m/s²); free by default")
    jerk: Point | None = Field(default=None, description="given jerk, in W (m/s³); free by default")
    stop: bool = Field(default=False, description="whether velocity, acceleration and jerk are zero here")
    yaw: Real | None = Field(default=None, description="yaw here (rad), for heading: waypoints; free by default")

    @model_validator(mode="before")
    @classmethod
    def _short_form(cls, data: Any) -> Any:
        return {"point": data} if isinstance(data, list | tuple) else data

    @model_validator(mode="after")
    def _one_place(self) -> "Waypoint":
        given = [name for name in ("point", "box", "sphere") if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) or "none"
            raise PydanticCustomError("place", "must have one of point, box and sphere, not {found}", {"found": found})
        if self.stop and any(value is not None for value in (self.velocity, self.acceleration, self.jerk)):
            raise PydanticCustomError("place", "must not have both stop and given derivatives", {})
        return self

    def place(self) -> Box | Sphere:
        """The place as the planner has it; it holds no distributions."""
        if self.box is not None:
            return self.box.box()
        if self.sphere is not None:
            return Sphere(self.sphere.centre, self.sphere.radius)
        return Box.point(np.array(self.point, dtype=float))


class Given(Model):
    """When to pass each waypoint; a list of numbers alone is short for its times."""

    kind: Literal["given"]
    times: Annotated[tuple[Real, ...], Field(strict=False, min_length=1)] = Field(
        description="one for each waypoint, increasing (s)"
    )

    @field_validator("times")
    @classmethod
    def _increasing(cls, times: tuple[float, ...]) -> tuple[float, ...]:
        if times[0] < 0.0:
            raise PydanticCustomError("order", "must start at 0 or later")
        for i, (now, then) in enumerate(itertools.pairwise(times)):
            if not then - now >= SHORTEST:
                raise PydanticCustomError(
                    "order",
                    "must increase, each time by {least} s or more; time {i} does not",
                    {"i": i + 1, "least": SHORTEST},
                )
        if times[-1] > LONGEST:
            raise PydanticCustomError("order", "must end by {longest} s", {"longest": LONGEST})
        return times


class Heuristic(Model):
    """By rule: the shorter of a ride without stops and a flight with stops everywhere, stretched to the limits."""

    kind: Literal["heuristic"]


class LeastSnap(Model):
    """The times with the least snap in a given total."""

    kind: Literal["least_snap"]
    duration: PlainSpan = Field(description="total (s)")


class Shortest(Model):
    """The least total time for which the minimum-snap path keeps to the limits, a local optimum."""

    kind: Literal["shortest"]


Times = Annotated[Given | Heuristic | LeastSnap | Shortest, Field(discriminator="kind")]


class WaypointRoute(_Moving):
    """Minimum snap through waypoints, within limits and corridors."""

    kind: Literal["waypoints"]
    waypoints: Annotated[tuple[Waypoint, ...], Field(strict=False, min_length=2, max_length=MOST_WAYPOINTS)] = Field(
        description="places to pass, in order; segment i leads from waypoint i to waypoint i + 1"
    )
    times: Times = Field(default=Shortest(kind="shortest"), description="when to pass them, or how to choose that")
    corridors: Annotated[tuple[CorridorRegion | None, ...], Field(strict=False)] | None = Field(
        default=None, description="for each segment a box or half-spaces that the path must not leave, or null"
    )
    space: BoxRegion | None = Field(default=None, description="a box that the whole path must not leave")
    laps: _Laps = Field(
        default=1,
        description="number of laps, if the route ends where it begins; the first begins, the last ends at rest, those"
        " in between are alike; there is rest between them only if the last waypoint is a stop",
    )
    # Mypy does not allow to widen what a base class has fixed.
    heading: Literal["constant", "along_path", "waypoints"] = Field(  # type: ignore[assignment]
        default="constant", description="what the yaw follows; waypoints turns through the yaws given at them"
    )
    top_speed: Positive | None = Field(
        default=2.0, description="limit on the speed (m/s), or null for none; the paper's 2 m/s"
    )
    top_acceleration: Positive | None = Field(
        default=0.7, description="limit on the acceleration (m/s²), or null for none; the paper's 0.7 m/s²"
    )

    @field_validator("times", mode="before")
    @classmethod
    def _short_form(cls, times: Any) -> Any:
        if isinstance(times, str):
            return {"kind": times}
        return {"kind": "given", "times": times} if isinstance(times, list | tuple) else times

    @model_validator(mode="after")
    def _consistent(self) -> "WaypointRoute":
        count = len(self.waypoints)
        if isinstance(self.times, Given) and len(self.times.times) != count:
            raise self.wrong(
                "times", kind="count", demand="must hold one time for each of the {count} waypoints", count=count
            )
        if self.corridors is not None and len(self.corridors) != count - 1:
            raise self.wrong(
                "corridors",
                kind="count",
                demand="must hold one box, half-spaces or null for each of the {count} segments",
                count=count - 1,
            )
        yaws = [waypoint.yaw for waypoint in self.waypoints]
        if self.heading == "waypoints" and not any(yaw is not None for yaw in yaws):
            raise self.wrong("heading", kind="heading", demand="needs a yaw at one of the waypoints")
        if self.heading != "waypoints" and any(yaw is not None for yaw in yaws):
            raise self.wrong("heading", kind="heading", demand="must be waypoints if yaws are given there")
        self._check_yaws()
        limited = self.top_speed is not None or self.top_acceleration is not None
        if not limited and isinstance(self.times, Heuristic | Shortest):
            demand = "must be a number, or else top_acceleration, to choose the total time"
            raise self.wrong("top_speed", kind="limits", demand=demand)
        return self

    def _check_yaws(self) -> None:
        """Raise an error if the yaws must have been given in degrees; continuous turns are allowed."""
        before = 0.0
        for i, waypoint in enumerate(self.waypoints):
            if waypoint.yaw is None:
                continue
            if abs(waypoint.yaw) > TWO_TURNS and abs(waypoint.yaw - before) > _HALF_TURN:
                numbers = in_radians(waypoint.yaw, TWO_TURNS)
                raise self.wrong("waypoints", i, "yaw", kind="radians", demand=RADIANS, **numbers)
            before = waypoint.yaw

    @model_validator(mode="after")
    def _closed(self) -> "WaypointRoute":
        """What is flown in laps ends where it begins, in a way that can be repeated."""
        if self.laps == 1:
            return self
        first, last = self.waypoints[0].point, self.waypoints[-1].point
        if first is None or first != last:
            demand = "must be 1, since the route does not end at the point where it begins"
            raise self.wrong("laps", kind="laps", demand=demand)
        if self.laps * len(self.waypoints) > MOST_WAYPOINTS:
            demand = "must be fewer: in all laps there may be {most} waypoints"
            raise self.wrong("laps", kind="laps", demand=demand, most=MOST_WAYPOINTS)
        for i, waypoint in enumerate(self.waypoints):
            for name in ("velocity", "acceleration", "jerk"):
                if getattr(waypoint, name) is not None:
                    demand = "must be left out: with laps only stops can be given at a waypoint"
                    raise self.wrong("waypoints", i, name, kind="laps", demand=demand)
        for name in ("corridors", "space"):
            if getattr(self, name) is not None:
                raise self.wrong(name, kind="laps", demand="must be left out: laps keep to none")
        if isinstance(self.times, LeastSnap):
            demand = "must be given, heuristic or shortest, since there are laps"
            raise self.wrong("times", "kind", kind="laps", demand=demand)
        return self

    @model_validator(mode="after")
    def _flyable(self) -> "WaypointRoute":
        quantities = [
            self.top_speed,
            self.top_acceleration,
            *(x for waypoint in self.waypoints for x in waypoint.point or ()),
        ]
        if all(quantity is None or isinstance(quantity, float) for quantity in quantities):
            try:
                self.problem()
            except InputError as error:
                raise PydanticCustomError("path", "{reason}", {"reason": str(error)}) from None
        return self

    def limits(self) -> Limits:
        """Those of the path; the route holds no distributions."""
        given = {"speed": self.top_speed, "acceleration": self.top_acceleration}
        return Limits(**{name: limit for name, limit in given.items() if limit is not None})

    def known_end(self) -> _End:
        """As for the others."""
        match self.times:
            case Given(times=times):
                return ("route", "times"), times[0] + self.laps * (times[-1] - times[0])
            case LeastSnap(duration=duration):
                return ("route", "times", "duration"), duration
        return super().known_end()

    def problem(self, laps: int = 1) -> PathProblem:
        """What the path of so many laps must keep to; the route holds no distributions.

        Raises:
            InputError: no path can, whatever its times.
        """
        waypoints = [*self.waypoints, *self.waypoints[1:] * (laps - 1)]
        derivatives = rest_at_ends(len(waypoints), 3)
        for i, waypoint in enumerate(waypoints):
            if waypoint.stop:
                derivatives[i] = 0.0
            for row, value in enumerate((waypoint.velocity, waypoint.acceleration, waypoint.jerk)):
                if value is not None:
                    derivatives[i, row] = value
        return PathProblem(
            [waypoint.place() for waypoint in waypoints],
            derivatives=derivatives,
            corridors=self._corridors() * laps,
            limits=self.limits(),
        )

    def _corridors(self) -> list[Corridor | None]:
        """Each segment's corridor, as much of it as lies in the space."""
        given = self.corridors or (None,) * (len(self.waypoints) - 1)
        corridors = [None if corridor is None else corridor.region() for corridor in given]
        if self.space is None:
            return corridors
        space = self.space.box()
        inside = [space if corridor is None else common(corridor, space) for corridor in corridors]
        for i, corridor in enumerate(inside):
            if corridor is None:
                raise InputError(f"the corridor of segment {i} lies outside the space")
        return inside


# By which a trajectory may jump from piece to piece, by path and order, in m, m/s and rad: no vehicle would notice.
# Added to that is what is left of six decimals in the coefficients of the piece before, with which files are written.
_JUMPS = {("path", 0): ("m", 1e-3), ("path", 1): ("m/s", 1e-2), ("yaw", 0): ("rad", 1e-2)}
_DECIMALS = 1e-6
_ENDS = np.array([1.0, 0.0])


class Knot(Model):
    """Where a trajectory is at a time, and how it moves there."""

    time: PlainMoment = Field(description="when (s)")
    position: Point = Field(description="in W (m)")
    velocity: Point = Field(default=(0.0, 0.0, 0.0), description="in W (m/s)")
    acceleration: Point = Field(default=(0.0, 0.0, 0.0), description="in W (m/s²)")
    jerk: Point = Field(default=(0.0, 0.0, 0.0), description="in W (m/s³)")


class YawKnot(Model):
    """The yaw of a trajectory at a time."""

    time: PlainMoment = Field(description="when (s)")
    yaw: Real = Field(description="rad")
    yaw_rate: Real = Field(default=0.0, description="rad/s")


_Coefficients = Annotated[tuple[Real, ...], Field(strict=False, min_length=1, max_length=POWERS)]


class Piece(Model):
    """A part of a trajectory: polynomials c_0 + c_1 t + ... + c_7 t⁷ in the seconds t from its beginning."""

    duration: PlainSpan = Field(description="how long it lasts (s)")
    x: _Coefficients = Field(description="coefficients, from the constant on, in W (m, s)")
    y: _Coefficients = Field(description="likewise (m, s)")
    z: _Coefficients = Field(description="likewise (m, s)")
    yaw: _Coefficients = Field(
        default=(0.0,),
        description="likewise (rad, s); whole turns between the end of a piece and the next do not count",
    )

    def row(self) -> list[float]:
        """As the row of a table of pieces, see `drake_quad.reference.pieces`."""
        padded = [(*part, *[0.0] * (POWERS - len(part))) for part in (self.x, self.y, self.z, self.yaw)]
        return [self.duration, *itertools.chain(*padded)]


class TrajectoryRoute(Model):
    """A trajectory as it is: by its knots, as `drake-quad plan` writes it, or by pieces, as Crazyswarm2 has it.

    Between knots it is of degree 7, the yaw of degree 3 between its own.
    """

    kind: Literal["trajectory"]
    knots: Annotated[tuple[Knot, ...], Field(strict=False, min_length=2)] | None = Field(
        default=None, description="position to jerk at increasing times, from 0 on; or else `pieces`"
    )
    yaw_knots: Annotated[tuple[YawKnot, ...], Field(strict=False, min_length=2)] | None = Field(
        default=None,
        description="yaw and its rate at increasing times, from the first knot to the last; the yaw turns by the"
        " difference of two knots, also by more than half a turn",
    )
    pieces: Annotated[tuple[Piece, ...], Field(strict=False, min_length=1, max_length=MOST_WAYPOINTS)] | None = Field(
        default=None,
        description="polynomials one after another, from time 0 on; or the name of a CSV file of them, beside the file"
        " that names it",
    )
    origin: Point = Field(default=(0.0, 0.0, 0.0), description="where the origin of its coordinates is, in W (m)")
    time_scale: PlainPositive = Field(default=1.0, description="by which all its times are multiplied (1)")

    @model_serializer(mode="wrap")
    def _written(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """What has its default says nothing of it: its studies are those from before it could be."""
        fields: dict[str, Any] = write(self)
        silent = {"knots": None, "pieces": None, "origin": (0.0, 0.0, 0.0), "time_scale": 1.0}
        return {
            name: value for name, value in fields.items() if name not in silent or getattr(self, name) != silent[name]
        }

    @model_validator(mode="after")
    def _one_form(self) -> "TrajectoryRoute":
        if (self.knots is None) == (self.pieces is None):
            found = "neither" if self.knots is None else "both"
            raise PydanticCustomError("forms", "must have either knots or pieces, not {found}", {"found": found})
        if self.pieces is not None and self.yaw_knots is not None:
            raise self.wrong("yaw_knots", kind="forms", demand="must be left out: pieces have their yaw")
        return self

    @model_validator(mode="after")
    def _in_radians(self) -> "TrajectoryRoute":
        """Raise an error if the yaw never changes and must have been given in degrees; turns are allowed."""
        pieces, yaw_knots = self.pieces or (), self.yaw_knots or ()
        yaws = {piece.yaw[0] for piece in pieces} | {knot.yaw for knot in yaw_knots}
        turns = any(any(piece.yaw[1:]) for piece in pieces) or any(knot.yaw_rate for knot in yaw_knots)
        if len(yaws) == 1 and not turns and abs(yaw := yaws.pop()) > TWO_TURNS:
            path = ("pieces", 0, "yaw", 0) if pieces else ("yaw_knots", 0, "yaw")
            raise self.wrong(*path, kind="radians", demand=RADIANS, **in_radians(yaw, TWO_TURNS))
        return self

    @model_validator(mode="after")
    def _increasing(self) -> "TrajectoryRoute":
        knots, yaw_knots = self.knots or (), self.yaw_knots or ()
        times = {"knots": [knot.time for knot in knots], "yaw_knots": [knot.time for knot in yaw_knots]}
        for field, instants in times.items():
            for i, (now, then) in enumerate(itertools.pairwise(instants)):
                if not then - now >= SHORTEST:
                    demand = "must be later than {now}, by {least} s or more"
                    raise self.wrong(field, i + 1, "time", kind="order", demand=demand, now=now, least=SHORTEST)
        if self.yaw_knots is not None:
            for end, which in ((0, 0), (-1, len(self.yaw_knots) - 1)):
                time = knots[end].time
                if self.yaw_knots[end].time != time:
                    demand = "must be that of the knot, {time}"
                    raise self.wrong("yaw_knots", which, "time", kind="order", demand=demand, time=time)
        return self

    @model_validator(mode="after")
    def _joined(self) -> "TrajectoryRoute":
        """Check that position, velocity and yaw are continuous between pieces, up to whole turns of the yaw."""
        if self.pieces is None:
            return self
        plan = plan_of_pieces(np.array([piece.row() for piece in self.pieces]))
        for i in range(1, len(self.pieces)):
            for (name, order), (unit, least) in _JUMPS.items():
                path: PolynomialPath = getattr(plan, name)
                jump = float(np.linalg.norm(np.subtract(*evaluate_at(path, np.array([i - 1, i]), _ENDS, order))))
                most = least + _DECIMALS * float(power_basis(order, self.pieces[i - 1].duration, POWERS).sum())
                if not jump <= most:
                    what = "yaw" if name == "yaw" else "velocity" if order else "position"
                    demand = (
                        "must begin where the one before it ends: its {what} jumps by {jump} {unit}, {most} at most"
                    )
                    context = {"what": what, "jump": f"{jump:.3g}", "unit": unit, "most": f"{most:.2g}"}
                    raise PydanticCustomError("jump", demand, {**context, "path": ("pieces", i)})
        return self

    def known_end(self) -> _End:
        """As for the others."""
        if self.pieces is not None:
            return ("route", "pieces"), self.time_scale * sum(piece.duration for piece in self.pieces)
        assert self.knots is not None
        last = len(self.knots) - 1
        return ("route", "knots", last, "time"), self.time_scale * self.knots[last].time


Route = Annotated[
    FigureEightRoute | CircleRoute | LissajousRoute | HoverRoute | WaypointRoute | TrajectoryRoute,
    Field(discriminator="kind"),
]
