"""Thrust and attitude as a policy action."""

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from drake_quad.control.policy.actions import AttitudeScale
from drake_quad.control.policy.actuation import AttitudeActuation
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.actions.action import ACTIONS, ThrustAction
from drake_quad.scenario.attitude_controllers.controller import AttitudeControllerSettings
from drake_quad.scenario.quantities import FixedTilt, radians
from drake_quad.scenario.setting import ControlSetting


@ACTIONS.register
class AttitudeAction(ThrustAction):
    """Action with thrust, roll, pitch, and yaw relative to the yaw of the reference."""

    kind: Literal["attitude"]
    # The default is the tilt limit of the other controllers. The figure eight needs only 4°.
    max_tilt: FixedTilt = Field(default=0.6, description="roll and pitch that an action of 1 commands (rad)")
    max_yaw: Annotated[float, Field(ge=0.0, le=math.pi), radians(math.pi)] = Field(
        default=0.5, description="yaw that an action of 1 commands, relative to the yaw of the reference (rad)"
    )
    commands: ClassVar = "attitude"

    def recipe(self, setting: ControlSetting, *, turn: float, attitude: AttitudeControllerSettings | None) -> Recipe:
        """Return the recipe to build an `AttitudeActuation`."""
        scale = AttitudeScale(self.thrusts(setting.nominal), self.max_tilt, self.max_yaw)
        return Recipe(AttitudeActuation, {}, scale)
