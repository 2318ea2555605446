"""Limits of tilt and thrust, in the scenario language."""

from typing import Annotated

import numpy as np
from pydantic import Field

from drake_quad.control import thrust_vectoring
from drake_quad.control.thrust_vectoring import ThrustLimits, VectoringParameters
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.attitude_controllers.controller import AttitudeControllerSettings
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.plausible import not_in_percent
from drake_quad.scenario.quantities import Number, Tilt, bounds
from drake_quad.vehicle.parameters import QuadrotorParameters

MinThrust = Annotated[Number, bounds(gt=0.0, lt=1.0, is_fraction=True)]
# Racing quadrotors produce up to 15 times their weight.
MaxThrust = Annotated[Number, bounds(gt=1.0), not_in_percent(upper=30.0)]


class ThrustVectoringSettings(Model):
    """Limits on the tilt and the thrust that thrust vectoring, eq (7) of the paper, may command."""

    max_tilt: Tilt = Field(default=0.6, description="largest angle between thrust and the vertical (rad)")
    min_thrust: MinThrust = Field(default=0.3, description="smallest vertical thrust, relative to the weight (1)")
    max_thrust: MaxThrust = Field(default=1.8, description="largest thrust, relative to the weight (1)")

    def thrust_limits(self, nominal: QuadrotorParameters) -> ThrustLimits:
        """Return the limits for the nominal vehicle, with thrusts in N."""
        weight = nominal.mass * nominal.gravity
        return ThrustLimits(np.tan(self.max_tilt), self.min_thrust * weight, self.max_thrust * weight)

    def recipe(self, nominal: QuadrotorParameters, attitude: AttitudeControllerSettings | None) -> Recipe:
        """Return the recipe to build the thrust vectoring, given the attitude controller on the ground, if any."""
        structure = {"projects": False} if attitude is None else attitude.vectoring()
        parameters = VectoringParameters(nominal.mass, nominal.gravity, self.thrust_limits(nominal))
        return Recipe(thrust_vectoring.ThrustVectoring, structure, parameters)
