"""Acceleration as a policy action."""

from typing import ClassVar, Literal

from pydantic import Field

from drake_quad.control.policy.actions import AccelerationScale
from drake_quad.control.policy.actuation import AccelerationActuation
from drake_quad.control.policy.frames import LevelFrame
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.actions.action import ACTIONS, Action
from drake_quad.scenario.attitude_controllers.controller import AttitudeControllerSettings
from drake_quad.scenario.quantities import FixedPositives
from drake_quad.scenario.setting import ControlSetting
from drake_quad.vehicle.parameters import QuadrotorParameters


@ACTIONS.register
class AccelerationAction(Action):
    """Acceleration action, which thrust vectoring converts to thrust and attitude."""

    kind: Literal["acceleration"]
    # The default is several times the acceleration of the figure eight (0.7 m/s²). The reserve is for gusts and for
    # flights that begin off the path.
    max_acceleration: FixedPositives = Field(
        default=(5.0, 5.0, 5.0), description="acceleration that an action of 1 commands (m/s²)"
    )
    frame: LevelFrame = Field(
        default="world", description="axes in which the acceleration is commanded, named as in `observation.frame`"
    )
    num_rows: ClassVar = 3
    commands: ClassVar = "attitude"
    vectors_thrust: ClassVar = True

    def recipe(self, setting: ControlSetting, *, turn: float, attitude: AttitudeControllerSettings | None) -> Recipe:
        """Return the recipe to build an `AccelerationActuation`."""
        return Recipe(
            AccelerationActuation, {"frame": self.frame, "turn": turn}, AccelerationScale(*self.max_acceleration)
        )

    def hover_action(self, nominal: QuadrotorParameters) -> tuple[float, ...]:
        """Return the action that commands zero acceleration."""
        return (0.0, 0.0, 0.0)
