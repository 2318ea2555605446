"""Lissajous curve, in the scenario language."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from drake_quad.reference.lissajous import lissajous
from drake_quad.reference.plan import Plan
from drake_quad.scenario.quantities import FixedDirection, FixedDirections, FixedSpan, Point
from drake_quad.scenario.routes.route import ROUTES, KnownEnd, Laps, MissionRoute, PlannedRoute
from drake_quad.space.space import Space

_Turns = Annotated[int, Field(ge=0, le=20)]


@ROUTES.register
class LissajousRoute(MissionRoute):
    """Laps of a Lissajous curve: centre + amplitude · sin(2π turns t / period + phase) along each axis, with time t.

    At time zero the reference already moves, but the vehicle hovers. Set `metrics.start` to exclude the transient.
    """

    kind: Literal["lissajous"]
    centre: Point = Field(default=(0.0, 0.0, 1.0), description="centre of the curve, in W (m)")
    amplitude: Point = Field(description="amplitude along X, Y, Z (m)")
    turns: Annotated[tuple[_Turns, _Turns, _Turns], Field(strict=False)] = Field(
        default=(1, 1, 2), description="number of periods of the sine along X, Y, Z in a lap (1)"
    )
    phase: FixedDirections = Field(default=(0.0, 0.0, 0.0), description="phase of the sine along X, Y, Z (rad)")
    period: FixedSpan = Field(description="duration of a lap (s)")
    laps: Laps = Field(default=2, description="number of laps")
    yaw: FixedDirection = Field(default=0.0, description="constant yaw of the reference (rad)")

    def known_end_time(self) -> KnownEnd:
        """Return the name of the field that sets the duration, and the duration (s)."""
        return ("route", "laps"), self.laps * self.period

    def plan(self, space: Space | None) -> PlannedRoute:
        """Return the plan of the laps."""
        names = ("centre", "amplitude", "turns", "phase", "period", "laps")
        laps = tuple(np.linspace(0.0, self.laps * self.period, self.laps + 1).tolist())
        path = lissajous(**{name: getattr(self, name) for name in names})
        return PlannedRoute(Plan.with_constant_yaw(path, self.yaw, laps=laps))
