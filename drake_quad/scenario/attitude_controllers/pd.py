"""PD controller of the attitude."""

from typing import Literal

from pydantic import Field

from drake_quad.control import attitude
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.attitude_controllers.controller import ATTITUDE_CONTROLLERS, AttitudeControllerSettings
from drake_quad.vehicle.parameters import Inertia


@ATTITUDE_CONTROLLERS.member
class PdAttitude(AttitudeControllerSettings):
    """PD on the error of roll, pitch and yaw."""

    kind: Literal["pd"] = Field(default="pd", description="may be left out")

    def recipe(self, inertia: Inertia, period: float) -> Recipe:
        """Return the recipe for the PD."""
        return Recipe(attitude.AttitudeController, {}, self.numbers(inertia))
