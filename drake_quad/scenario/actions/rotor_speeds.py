"""Rotor speeds as a policy action."""

from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, model_validator

from drake_quad.control.policy.actions import PerRotor, SpeedScale
from drake_quad.control.policy.actuation import RotorSpeedActuation
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.actions.action import ACTIONS, Action
from drake_quad.scenario.attitude_controllers.controller import AttitudeControllerSettings
from drake_quad.scenario.quantities import FixedNonNegative
from drake_quad.scenario.setting import ControlSetting
from drake_quad.signals import RotorSpeed, Wrench
from drake_quad.vehicle.dynamics import hover_rotor_speeds, rotor_action
from drake_quad.vehicle.parameters import QuadrotorParameters


@ACTIONS.register
class RotorSpeedsAction(Action):
    """Action with the speed of each rotor, from the idle speed to the top speed."""

    kind: Literal["rotor_speeds"]
    min_rotor_speed: FixedNonNegative | None = Field(
        default=None,
        description="rotor speed that an action of -1 commands (rad/s); by default, `nominal.min_rotor_speed`",
    )
    order: Annotated[tuple[int, int, int, int], Field(strict=False)] = Field(
        default=(1, 2, 3, 4), description="number of the rotor that each element of the action commands"
    )
    num_rows: ClassVar = 4
    commands: ClassVar = "wrench"

    @model_validator(mode="after")
    def _names_each_rotor_once(self) -> "RotorSpeedsAction":
        if sorted(self.order) != [1, 2, 3, 4]:
            raise self.field_error("must name each rotor from 1 to 4 once", "order")
        return self

    def recipe(self, setting: ControlSetting, *, turn: float, attitude: AttitudeControllerSettings | None) -> Recipe:
        """Return the recipe to build a `RotorSpeedActuation`."""
        nominal = setting.nominal
        units = [RotorSpeed._make(np.eye(4)[rotor].tolist()) for rotor in range(4)]
        wrenches = PerRotor._make(Wrench._make(map(float, rotor_action(unit, nominal).wrench)) for unit in units)
        order = tuple([self.order.index(rotor) for rotor in (1, 2, 3, 4)])
        speeds = SpeedScale(self._min_speed(nominal), nominal.max_rotor_speed, wrenches)
        return Recipe(RotorSpeedActuation, {"order": order}, speeds)

    def hover_action(self, nominal: QuadrotorParameters) -> tuple[float, ...]:
        """Return the action that commands the hover speeds of the nominal vehicle."""
        min_speed, max_speed = self._min_speed(nominal), float(nominal.max_rotor_speed)
        speeds = hover_rotor_speeds(nominal)
        return tuple(
            [2.0 * (float(speeds[rotor - 1]) - min_speed) / (max_speed - min_speed) - 1.0 for rotor in self.order]
        )

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if `min_rotor_speed` is not below the top speed of the nominal rotors."""
        super().check_fits(scenario)
        top = scenario.nominal.max_rotor_speed
        if self.min_rotor_speed is not None and not self.min_rotor_speed < top:
            demand = f"must be smaller than max_rotor_speed in nominal, {top}"
            raise scenario.field_error(demand, "control", "action", "min_rotor_speed")

    def _min_speed(self, nominal: QuadrotorParameters) -> float:
        return float(nominal.min_rotor_speed if self.min_rotor_speed is None else self.min_rotor_speed)
