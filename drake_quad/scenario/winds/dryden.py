"""Dryden turbulence in the scenario language."""

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.wind.dryden import WIND_AT_20_FEET, DrydenTurbulence, Turbulence, TurbulenceParameters
from drake_quad.scenario.quantities import Direction, NonNegative, Number, bounds
from drake_quad.scenario.winds.source import WINDS, WindSource, WindSurroundings, speed
from drake_quad.signals import VelocityW


@WINDS.register
class DrydenSource(WindSource):
    """Continuous turbulence by the Dryden model of MIL-F-8785C at low altitude."""

    kind: Literal["dryden"]
    level: Literal["light", "moderate", "severe"] = Field(
        default="moderate", description="intensity level: a mean wind of 15, 30 or 45 knots at 20 feet"
    )
    intensity: NonNegative = Field(
        default=1.0, description="factor (1) by which the standard deviations of the level are multiplied"
    )
    height: Annotated[Number, bounds(ge=3.048, le=304.8)] = Field(
        default=6.096, description="height for which length scales and standard deviations are computed (m)"
    )
    airspeed: Annotated[Number, bounds(ge=1.0)] | None = Field(
        default=None,
        description="speed at which the turbulence passes the vehicle (m/s); by default, the larger of 1 m/s and the"
        " speed of the steady wind",
    )
    heading: Direction | None = Field(
        default=None,
        description="direction of the longitudinal axis, from X towards Y (rad); by default, the direction of the"
        " steady wind",
    )
    strength_fields: ClassVar = ("intensity",)
    depends_on_position: ClassVar = False
    depends_on_time: ClassVar = False

    def max_speed(self) -> VelocityW:
        """Return 0, since the mean of turbulence is 0."""
        return 0.0

    def without_turbulence(self) -> WindSource | None:
        """Return None, since turbulence is the only part of this wind."""
        return None

    def recipe(self, surroundings: WindSurroundings) -> Recipe:
        """Return the recipe to build a `DrydenTurbulence`."""
        mean = surroundings.steady_wind
        turbulence = Turbulence.at_low_altitude(
            height=self.height,
            wind_at_20_feet=WIND_AT_20_FEET[self.level] * self.intensity,
            airspeed=speed(mean) if self.airspeed is None else self.airspeed,
        )
        heading = np.arctan2(mean.y, mean.x) if self.heading is None else self.heading
        return Recipe(DrydenTurbulence, {"period": surroundings.period}, TurbulenceParameters(turbulence, heading))
