"""Horizontal circle, in the scenario language."""

import dataclasses
import math
from typing import Literal

from pydantic import Field

from drake_quad.reference.routes import circle
from drake_quad.scenario.quantities import Number, Positive
from drake_quad.scenario.routes.route import ROUTES, Laps, MovingRoute, PlannedRoute
from drake_quad.space.space import Space


@ROUTES.register
class CircleRoute(MovingRoute):
    """Laps of a horizontal circle around the Z axis, scaled in time until one of the limits is met exactly."""

    kind: Literal["circle"]
    radius: Positive = Field(default=1.5, description="radius (m)")
    height: Number = Field(default=1.0, description="height (m)")
    laps: Laps = Field(default=2, description="number of laps")

    def plan(self, space: Space | None) -> PlannedRoute:
        """Return the plan of the laps."""
        geometry = circle(radius=self.radius, height=self.height, laps=self.laps)
        plan = self.scaled_in_time(geometry, math.sqrt(self.top_acceleration * self.radius))
        return PlannedRoute(dataclasses.replace(plan, laps=(*plan.leg_times, plan.duration)))
