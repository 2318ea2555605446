"""Route of setpoints in the scenario language, each held until the next one."""

import itertools
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.scenario.distributions import Real
from drake_quad.scenario.limits import MIN_DURATION
from drake_quad.scenario.quantities import TWO_TURNS, FixedMoment, FixedSpan, radians_demand
from drake_quad.scenario.routes.route import ROUTES, KnownEnd, MissionRoute, PlannedRoute
from drake_quad.space.space import Space

Setpoint = Annotated[tuple[FixedMoment, Real, Real, Real, Real], Field(strict=False)]


@ROUTES.register
class SetpointsRoute(MissionRoute):
    """Setpoints of position and yaw, each held until the next one, as a companion computer sends them to an autopilot.

    The reference jumps from one setpoint to the next. Its velocity and higher derivatives are zero, so no derivative is
    fed forward.
    """

    kind: Literal["setpoints"]
    setpoints: Annotated[tuple[Setpoint, ...], Field(strict=False, min_length=1)] = Field(
        description="time in s, x, y, z in W in m, and yaw in rad of each setpoint; times must begin with 0 and"
        " increase"
    )
    last_hold: FixedSpan = Field(default=1.0, description="time for which the last setpoint is held (s)")

    @model_validator(mode="after")
    def _times_increase(self) -> "SetpointsRoute":
        times = [setpoint[0] for setpoint in self.setpoints]
        if times[0] != 0.0:
            raise self.field_error("must be 0", "setpoints", 0, 0)
        for i, (now, then) in enumerate(itertools.pairwise(times)):
            if not then - now >= MIN_DURATION:
                raise self.field_error(f"must be at least {MIN_DURATION} s later than {now}", "setpoints", i + 1, 0)
        return self

    @model_validator(mode="after")
    def _yaw_is_in_radians(self) -> "SetpointsRoute":
        """Raise an error if a constant yaw was apparently given in degrees. A varying yaw may have any magnitude."""
        yaws = {setpoint[4] for setpoint in self.setpoints}
        if len(yaws) == 1 and abs(yaw := yaws.pop()) > TWO_TURNS:
            raise self.field_error(radians_demand(yaw, TWO_TURNS), "setpoints", 0, 4)
        return self

    def known_end_time(self) -> KnownEnd:
        """Return the name of the field that sets the duration, and the duration (s)."""
        return ("route", "last_hold"), self.setpoints[-1][0] + self.last_hold

    def plan(self, space: Space | None) -> PlannedRoute:
        """Return the setpoints as a plan of constant pieces."""
        rows = np.array(self.setpoints)
        times = np.append(rows[:, 0], rows[-1, 0] + self.last_hold)
        coefficients = np.zeros((len(rows), 8, 4))
        coefficients[:, 0] = rows[:, 1:]
        path, yaw = (PolynomialPath(times, part) for part in np.split(coefficients, [3], axis=2))
        return PlannedRoute(Plan(path, yaw))
