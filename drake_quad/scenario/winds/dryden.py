"""Continuous turbulence."""

from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from drake_quad.framework.recipe import Recipe
from drake_quad.laboratory.wind.dryden import WIND_AT_20_FEET, DrydenTurbulence, Turbulence, TurbulenceNumbers
from drake_quad.scenario.quantities import Direction, NonNegative, Number, bounded
from drake_quad.scenario.winds.source import WINDS, WindSource, WindSurroundings, speed
from drake_quad.signals import VelocityW


@WINDS.member
class DrydenSource(WindSource):
    """Continuous turbulence of MIL-F-8785C at low altitude."""

    kind: Literal["dryden"]
    level: Literal["light", "moderate", "severe"] = Field(
        default="moderate", description="a wind of 15, 30 or 45 knots at 20 feet"
    )
    intensity: NonNegative = Field(default=1.0, description="factor on the level's standard deviations (1)")
    height: Annotated[Number, bounded(least=3.048, most=304.8)] = Field(
        default=6.096, description="at which scales and deviations are taken (m); from 10 to 1000 feet"
    )
    airspeed: Annotated[Number, bounded(least=1.0)] | None = Field(
        default=None,
        description="with which the turbulence goes by (m/s); that of the steady wind, or 1 m/s, if not given",
    )
    heading: Direction | None = Field(
        default=None,
        description="of the longitudinal axis, from X towards Y (rad); that of the steady wind if not given",
    )
    depends_on_place: ClassVar = False
    depends_on_time: ClassVar = False

    def max_speed(self) -> VelocityW:
        """Return 0, since the mean of turbulence is 0."""
        return 0.0

    def without_turbulence(self) -> WindSource | None:
        """Return None."""
        return None

    def recipe(self, surroundings: WindSurroundings) -> Recipe:
        """Return the recipe for a `DrydenTurbulence`, carried by the steady wind unless the source says otherwise."""
        mean = surroundings.steady_wind
        turbulence = Turbulence.at_low_altitude(
            height=self.height,
            wind_at_20_feet=WIND_AT_20_FEET[self.level] * self.intensity,
            airspeed=speed(mean) if self.airspeed is None else self.airspeed,
        )
        heading = np.arctan2(mean.y, mean.x) if self.heading is None else self.heading
        return Recipe(DrydenTurbulence, {"period": surroundings.period}, TurbulenceNumbers(turbulence, heading))
