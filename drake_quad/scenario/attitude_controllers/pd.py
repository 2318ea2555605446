"""PD attitude controller, in the scenario language."""

from typing import Literal

from pydantic import Field

from drake_quad.control import attitude
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.attitude_controllers.controller import ATTITUDE_CONTROLLERS, AttitudeControllerSettings
from drake_quad.vehicle.parameters import Inertia


@ATTITUDE_CONTROLLERS.register
class PdAttitude(AttitudeControllerSettings):
    """PD controller of roll, pitch and yaw."""

    kind: Literal["pd"] = Field(
        default="pd", description="may be omitted, since it is the default kind of an attitude controller"
    )

    def recipe(self, inertia: Inertia, period: float) -> Recipe:
        """Return the recipe to build the PD controller."""
        return Recipe(attitude.AttitudeController, {}, self.parameters(inertia))
