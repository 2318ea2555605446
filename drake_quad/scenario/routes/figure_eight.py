"""The paper's figure eight, in the scenario language."""

from typing import Literal

import numpy as np
from pydantic import Field, ValidationInfo, field_validator

from drake_quad.reference.laps import path_of_laps
from drake_quad.reference.plan import Plan
from drake_quad.reference.routes import Route, figure_eight
from drake_quad.reference.time_allocation import stretch_factor, trapezoid_times
from drake_quad.scenario.distributions import validation_error
from drake_quad.scenario.quantities import Number, Positive
from drake_quad.scenario.routes.route import ROUTES, Laps, MovingRoute, PlannedRoute, split_three_laps
from drake_quad.space.space import Space


@ROUTES.register
class FigureEightRoute(MovingRoute):
    """The paper's figure eight, scaled in time until one of the limits is met exactly."""

    kind: Literal["figure_eight"]
    lower_height: Positive = Field(default=1.0, description="height of the second circle and of the crossing (m)")
    upper_height: Positive = Field(default=2.0, description="height of the first circle (m)")
    radius: Positive = Field(default=1.4, description="radius of both circles (m)")
    offset: Positive = Field(default=1.9, description="distance of the circles' centres from the start (m)")
    cruise_speed: Positive = Field(
        default=1.2, description="top speed of the trapezoidal profile that sets the times before scaling (m/s)"
    )
    laps: Laps = Field(
        default=1,
        description="number of laps; the first lap begins and the last lap ends at rest, and all laps between are"
        " equal",
    )

    @field_validator("offset")
    @classmethod
    def _exceeds_radius(cls, offset: Number, info: ValidationInfo) -> Number:
        radius = info.data.get("radius")
        if isinstance(offset, float) and isinstance(radius, float) and not offset > radius:
            raise validation_error(f"must be larger than the radius, {radius}")
        return offset

    def plan(self, space: Space | None) -> PlannedRoute:
        """Return the plan of the laps."""
        geometry = figure_eight(
            lower_height=self.lower_height, upper_height=self.upper_height, radius=self.radius, offset=self.offset
        )
        return PlannedRoute(
            self.scaled_in_time(geometry, self.cruise_speed) if self.laps == 1 else self._plan_laps(geometry)
        )

    def _plan_laps(self, geometry: Route) -> Plan:
        """Return a plan with a climb and several laps.

        The durations of the first, the middle and the last laps come from a speed profile over three laps.
        """
        lap = geometry.waypoints[1:]
        three_laps = np.vstack([geometry.waypoints, lap[1:], lap[1:]])
        times = trapezoid_times(three_laps, speed=self.cruise_speed, acceleration=self.top_acceleration)
        durations = split_three_laps(np.diff(times), len(lap) - 1)
        path, laps = path_of_laps(geometry.waypoints, durations, self.laps, lead=1)
        factor = stretch_factor(path, self.limits())
        path, laps = path.scaled_in_time(factor), tuple([factor * time for time in laps])
        climb, *others = geometry.legs
        legs = [leg._replace(first=leg.first + i * (len(lap) - 1)) for i in range(self.laps) for leg in others]
        return Plan(path, self.yaw_profile(path), (climb, *legs), laps)
