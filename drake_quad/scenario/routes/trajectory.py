"""Trajectory given by knots or polynomials, in the scenario language."""

import itertools
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from drake_quad.reference.pieces import POWERS, pieces_to_plan
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate_at, hermite_path, power_basis
from drake_quad.scenario.distributions import Model, Real, omits_defaults, validation_error
from drake_quad.scenario.limits import MAX_WAYPOINTS, MIN_DURATION
from drake_quad.scenario.quantities import TWO_TURNS, FixedMoment, FixedPositive, FixedSpan, Point, radians_demand
from drake_quad.scenario.routes.route import ROUTES, KnownEnd, MissionRoute, PlannedRoute
from drake_quad.space.space import Space

# Unit and largest allowed jump between trajectory pieces, by path and order of the derivative. Smaller jumps do not
# affect the flight of a vehicle.
_MAX_JUMPS = {("path", 0): ("m", 1e-3), ("path", 1): ("m/s", 1e-2), ("yaw", 0): ("rad", 1e-2)}
# Rounding error of coefficients in files with six decimals. Its effect at the end of a piece is added to the allowed
# jump.
_COEFFICIENT_ROUNDING = 1e-6
# Normalised times at which two pieces meet: the end of the first piece and the beginning of the second.
_JOINT_TIMES = np.array([1.0, 0.0])


class Knot(Model):
    """Position and its derivatives at one time of a trajectory."""

    time: FixedMoment = Field(description="time of the knot (s)")
    position: Point = Field(description="position in W (m)")
    velocity: Point = Field(default=(0.0, 0.0, 0.0), description="velocity in W (m/s)")
    acceleration: Point = Field(default=(0.0, 0.0, 0.0), description="acceleration in W (m/s²)")
    jerk: Point = Field(default=(0.0, 0.0, 0.0), description="jerk in W (m/s³)")


class YawKnot(Model):
    """Yaw and its rate at one time of a trajectory."""

    time: FixedMoment = Field(description="time of the knot (s)")
    yaw: Real = Field(description="yaw (rad)")
    yaw_rate: Real = Field(default=0.0, description="rate of the yaw (rad/s)")


_Coefficients = Annotated[tuple[Real, ...], Field(strict=False, min_length=1, max_length=POWERS)]


class Piece(Model):
    """Piece of a trajectory: polynomials c_0 + c_1 t + ... + c_7 t⁷ in the time t since its beginning."""

    duration: FixedSpan = Field(description="duration of the piece (s)")
    x: _Coefficients = Field(description="coefficients of X in W, c_0 first (m, s)")
    y: _Coefficients = Field(description="coefficients of Y in W, c_0 first (m, s)")
    z: _Coefficients = Field(description="coefficients of Z in W, c_0 first (m, s)")
    yaw: _Coefficients = Field(
        default=(0.0,),
        description="coefficients of the yaw, c_0 first (rad, s); it may jump by whole turns between pieces",
    )

    def row(self) -> list[float]:
        """Return the piece as a table row; see `drake_quad.reference.pieces`."""
        padded = [(*part, *[0.0] * (POWERS - len(part))) for part in (self.x, self.y, self.z, self.yaw)]
        return [self.duration, *itertools.chain(*padded)]


@ROUTES.register
class TrajectoryRoute(MissionRoute):
    """A trajectory given by knots, as written by `drake-quad plan`, or by polynomials, as in Crazyswarm2 files.

    Between knots, the position is a polynomial of degree 7. Between yaw knots, the yaw is a polynomial of degree 3.
    """

    kind: Literal["trajectory"]
    knots: Annotated[tuple[Knot, ...], Field(strict=False, min_length=2)] | None = Field(
        default=None, description="position and derivatives at increasing times, in place of `pieces`"
    )
    yaw_knots: Annotated[tuple[YawKnot, ...], Field(strict=False, min_length=2)] | None = Field(
        default=None,
        description="yaw and its rate at increasing times from the first to the last knot; the yaw turns by the"
        " difference between two knots, which may be more than half a turn",
    )
    pieces: Annotated[tuple[Piece, ...], Field(strict=False, min_length=1, max_length=MAX_WAYPOINTS)] | None = Field(
        default=None,
        description="successive polynomials from time 0 on, in place of `knots`; or the name of a CSV file with the"
        " polynomials, relative to the folder of the scenario's file",
    )
    origin: Point = Field(
        default=(0.0, 0.0, 0.0), description="position of the origin of the trajectory's coordinates, in W (m)"
    )
    time_scale: FixedPositive = Field(
        default=1.0, description="factor by which all times of the trajectory are multiplied (1)"
    )

    _serialized = omits_defaults("knots", "pieces", "origin", "time_scale")

    @model_validator(mode="after")
    def _has_one_form(self) -> "TrajectoryRoute":
        if (self.knots is None) == (self.pieces is None):
            specified = "neither" if self.knots is None else "both"
            raise validation_error(f"must have either knots or pieces, not {specified}")
        if self.pieces is not None and self.yaw_knots is not None:
            raise self.field_error("must be left out, since pieces contain the yaw", "yaw_knots")
        return self

    @model_validator(mode="after")
    def _yaw_is_in_radians(self) -> "TrajectoryRoute":
        """Raise an error if a constant yaw was apparently given in degrees. A varying yaw may have any magnitude."""
        pieces, yaw_knots = self.pieces or (), self.yaw_knots or ()
        yaws = {piece.yaw[0] for piece in pieces} | {knot.yaw for knot in yaw_knots}
        turns = any(any(piece.yaw[1:]) for piece in pieces) or any(knot.yaw_rate for knot in yaw_knots)
        if len(yaws) == 1 and not turns and abs(yaw := yaws.pop()) > TWO_TURNS:
            path = ("pieces", 0, "yaw", 0) if pieces else ("yaw_knots", 0, "yaw")
            raise self.field_error(radians_demand(yaw, TWO_TURNS), *path)
        return self

    @model_validator(mode="after")
    def _times_increase(self) -> "TrajectoryRoute":
        knots, yaw_knots = self.knots or (), self.yaw_knots or ()
        times = {"knots": [knot.time for knot in knots], "yaw_knots": [knot.time for knot in yaw_knots]}
        for field, instants in times.items():
            for i, (now, then) in enumerate(itertools.pairwise(instants)):
                if not then - now >= MIN_DURATION:
                    raise self.field_error(f"must be at least {MIN_DURATION} s later than {now}", field, i + 1, "time")
        if self.yaw_knots is not None:
            for end, index in ((0, 0), (-1, len(self.yaw_knots) - 1)):
                time = knots[end].time
                if self.yaw_knots[end].time != time:
                    end_name = "last" if end else "first"
                    raise self.field_error(
                        f"must be {time}, the time of the {end_name} of `knots`", "yaw_knots", index, "time"
                    )
        return self

    @model_validator(mode="after")
    def _is_continuous(self) -> "TrajectoryRoute":
        """Raise an error if position, velocity or yaw jump between pieces. Yaw jumps by whole turns are allowed."""
        if self.pieces is None:
            return self
        plan = pieces_to_plan(np.array([piece.row() for piece in self.pieces]))
        for i in range(1, len(self.pieces)):
            for (name, order), (unit, max_jump) in _MAX_JUMPS.items():
                path: PolynomialPath = getattr(plan, name)
                jump = float(np.linalg.norm(np.subtract(*evaluate_at(path, np.array([i - 1, i]), _JOINT_TIMES, order))))
                rounding = _COEFFICIENT_ROUNDING * float(power_basis(order, self.pieces[i - 1].duration, POWERS).sum())
                limit = max_jump + rounding
                if not jump <= limit:
                    quantity = "yaw" if name == "yaw" else "velocity" if order else "position"
                    jumps = f"its {quantity} jumps by {jump:.3g} {unit}, more than {limit:.2g}"
                    raise validation_error(
                        f"must continue from the end of the preceding piece: {jumps}", path=("pieces", i)
                    )
        return self

    def known_end_time(self) -> KnownEnd:
        """Return the name of the field that sets the duration, and the duration (s)."""
        if self.pieces is not None:
            return ("route", "pieces"), self.time_scale * sum(piece.duration for piece in self.pieces)
        assert self.knots is not None
        last = len(self.knots) - 1
        return ("route", "knots", last, "time"), self.time_scale * self.knots[last].time

    def plan(self, space: Space | None) -> PlannedRoute:
        """Return the trajectory as a plan."""
        if self.pieces is not None:
            rows = np.array([piece.row() for piece in self.pieces])
            return PlannedRoute(pieces_to_plan(rows, origin=self.origin, time_scale=self.time_scale))
        assert self.knots is not None
        times = np.array([knot.time for knot in self.knots])
        derivatives = [[knot.position, knot.velocity, knot.acceleration, knot.jerk] for knot in self.knots]
        path = hermite_path(times, np.array(derivatives))
        path.coefficients[:, 0] += self.origin
        if self.yaw_knots is None:
            return PlannedRoute(Plan.with_constant_yaw(path._replace(times=self.time_scale * times)))
        yaw_times = np.array([knot.time for knot in self.yaw_knots])
        yaw = hermite_path(yaw_times, np.array([[[knot.yaw], [knot.yaw_rate]] for knot in self.yaw_knots]))
        scaled = [part._replace(times=self.time_scale * part.times) for part in (path, yaw)]
        return PlannedRoute(Plan(scaled[0], scaled[1]))
