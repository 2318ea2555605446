"""Hover at one point, in the scenario language."""

from typing import Literal

from pydantic import Field

from drake_quad.reference.plan import Plan
from drake_quad.scenario.quantities import Direction, FixedSpan, Position
from drake_quad.scenario.routes.route import ROUTES, KnownEnd, MissionRoute, PlannedRoute
from drake_quad.space.space import Space


@ROUTES.register
class HoverRoute(MissionRoute):
    """Hover at one point."""

    kind: Literal["hover"]
    position: Position = Field(default=(0.0, 0.0, 1.0), description="position of the hover, in W (m)")
    yaw: Direction = Field(default=0.0, description="constant yaw of the reference (rad)")
    duration: FixedSpan = Field(default=10.0, description="duration of the hover (s)")

    def known_end_time(self) -> KnownEnd:
        """Return the name of the field that sets the duration, and the duration (s)."""
        return ("route", "duration"), self.duration

    def plan(self, space: Space | None) -> PlannedRoute:
        """Return the plan of the hover."""
        return PlannedRoute(Plan.hover(self.position, duration=self.duration, yaw=self.yaw))
