"""Trajectory that is given as it is."""

import itertools
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from drake_quad.reference.pieces import POWERS, plan_of_pieces
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import PolynomialPath, evaluate_at, hermite_path, power_basis
from drake_quad.scenario.distributions import Model, Real, omits_defaults, refused
from drake_quad.scenario.limits import MOST_WAYPOINTS, SHORTEST
from drake_quad.scenario.quantities import TWO_TURNS, PlainMoment, PlainPositive, PlainSpan, Point, radians_demand
from drake_quad.scenario.routes.route import ROUTES, KnownEnd, MissionRoute, Planned
from drake_quad.space.space import Space

# Largest jumps of a trajectory between pieces, by path and order, in m, m/s and rad; no vehicle would notice them. The
# rounding of the coefficients of the previous piece to six decimals, as in files, is added.
_JUMPS = {("path", 0): ("m", 1e-3), ("path", 1): ("m/s", 1e-2), ("yaw", 0): ("rad", 1e-2)}
_DECIMALS = 1e-6
_ENDS = np.array([1.0, 0.0])


class Knot(Model):
    """Position of a trajectory at a time, with its derivatives."""

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
        """Return the row of a table of pieces, see `drake_quad.reference.pieces`."""
        padded = [(*part, *[0.0] * (POWERS - len(part))) for part in (self.x, self.y, self.z, self.yaw)]
        return [self.duration, *itertools.chain(*padded)]


@ROUTES.member
class TrajectoryRoute(MissionRoute):
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

    _written = omits_defaults("knots", "pieces", "origin", "time_scale")

    @model_validator(mode="after")
    def _one_form(self) -> "TrajectoryRoute":
        if (self.knots is None) == (self.pieces is None):
            found = "neither" if self.knots is None else "both"
            raise refused(f"must have either knots or pieces, not {found}")
        if self.pieces is not None and self.yaw_knots is not None:
            raise self.wrong("must be left out: pieces have their yaw", "yaw_knots")
        return self

    @model_validator(mode="after")
    def _in_radians(self) -> "TrajectoryRoute":
        """Raise an error if the yaw never changes and must have been given in degrees; turns are allowed."""
        pieces, yaw_knots = self.pieces or (), self.yaw_knots or ()
        yaws = {piece.yaw[0] for piece in pieces} | {knot.yaw for knot in yaw_knots}
        turns = any(any(piece.yaw[1:]) for piece in pieces) or any(knot.yaw_rate for knot in yaw_knots)
        if len(yaws) == 1 and not turns and abs(yaw := yaws.pop()) > TWO_TURNS:
            path = ("pieces", 0, "yaw", 0) if pieces else ("yaw_knots", 0, "yaw")
            raise self.wrong(radians_demand(yaw, TWO_TURNS), *path)
        return self

    @model_validator(mode="after")
    def _increasing(self) -> "TrajectoryRoute":
        knots, yaw_knots = self.knots or (), self.yaw_knots or ()
        times = {"knots": [knot.time for knot in knots], "yaw_knots": [knot.time for knot in yaw_knots]}
        for field, instants in times.items():
            for i, (now, then) in enumerate(itertools.pairwise(instants)):
                if not then - now >= SHORTEST:
                    raise self.wrong(f"must be later than {now}, by {SHORTEST} s or more", field, i + 1, "time")
        if self.yaw_knots is not None:
            for end, which in ((0, 0), (-1, len(self.yaw_knots) - 1)):
                time = knots[end].time
                if self.yaw_knots[end].time != time:
                    raise self.wrong(f"must be that of the knot, {time}", "yaw_knots", which, "time")
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
                    jumps = f"its {what} jumps by {jump:.3g} {unit}, {most:.2g} at most"
                    raise refused(f"must begin where the one before it ends: {jumps}", path=("pieces", i))
        return self

    def known_end(self) -> KnownEnd:
        """Return the field that determines the duration, and the duration, s."""
        if self.pieces is not None:
            return ("route", "pieces"), self.time_scale * sum(piece.duration for piece in self.pieces)
        assert self.knots is not None
        last = len(self.knots) - 1
        return ("route", "knots", last, "time"), self.time_scale * self.knots[last].time

    def plan(self, space: Space | None) -> Planned:
        """Return the trajectory as a plan."""
        if self.pieces is not None:
            rows = np.array([piece.row() for piece in self.pieces])
            return Planned(plan_of_pieces(rows, origin=self.origin, time_scale=self.time_scale))
        assert self.knots is not None
        times = np.array([knot.time for knot in self.knots])
        derivatives = [[knot.position, knot.velocity, knot.acceleration, knot.jerk] for knot in self.knots]
        path = hermite_path(times, np.array(derivatives))
        path.coefficients[:, 0] += self.origin
        if self.yaw_knots is None:
            return Planned(Plan.facing(path._replace(times=self.time_scale * times)))
        yaw_times = np.array([knot.time for knot in self.yaw_knots])
        yaw = hermite_path(yaw_times, np.array([[[knot.yaw], [knot.yaw_rate]] for knot in self.yaw_knots]))
        scaled = [part._replace(times=self.time_scale * part.times) for part in (path, yaw)]
        return Planned(Plan(scaled[0], scaled[1]))
