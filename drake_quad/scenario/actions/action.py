"""Actions of policies, and the questions about them that the rest of the library asks.

An action of your own is a class that extends `Action` and is registered with `ACTIONS.member`.
"""

from abc import abstractmethod
from typing import Annotated, Any, ClassVar

from pydantic import Field, model_validator

from drake_quad.control.policy.actions import ThrustRange
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.attitude_controllers.controller import AttitudeControllerSettings, check_attitude_control
from drake_quad.scenario.autopilots.autopilot import Autopilot, Commanded
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import PlainNonNegative, PlainPositive
from drake_quad.scenario.setting import ControlSetting
from drake_quad.scenario.unions import OpenUnion
from drake_quad.vehicle.parameters import QuadrotorParameters


class Action(Model):
    """Meaning of the output of a policy, whose rows are between -1 and 1.

    Attributes:
        num_rows: number of rows of an action.
        commands: what it commands. Without an autopilot, an attitude control on the ground makes torques of attitudes.
        vectors_thrust: whether a `ThrustVectoring` makes thrust and attitude of it.
    """

    kind: str
    num_rows: ClassVar[int]
    commands: ClassVar[Commanded]
    vectors_thrust: ClassVar[bool] = False

    @abstractmethod
    def recipe(self, setting: ControlSetting, *, turn: float, attitude: AttitudeControllerSettings | None) -> Recipe:
        """Return the recipe for the system that makes a command of an action.

        Args:
            setting: setting of the control.
            turn: angle about z from x_B to the front of the policy, rad.
            attitude: attitude control on the ground, if any; gains that vary are (N,) arrays.
        """

    @abstractmethod
    def hovering(self, believed: QuadrotorParameters) -> tuple[float, ...]:
        """Return the action that is believed to hold a vehicle in hover."""

    def needs_attitude(self, autopilot: Autopilot) -> bool:
        """Return whether it needs an attitude control on the ground."""
        return self.commands == "attitude" and not autopilot.controls_attitude

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the action does not fit the other parts of its `Scenario`."""
        autopilot = scenario.laboratory.autopilot
        if self.commands not in autopilot.accepts:
            allowed = ", ".join(name for name, kind in ACTIONS.members.items() if kind.commands in autopilot.accepts)
            demand = f"must be {allowed}: laboratory.autopilot of kind {autopilot.kind} takes no other"
            raise scenario.wrong(demand, "control", "action", "kind")
        if self.commands == "attitude":
            check_attitude_control(scenario)
        elif scenario.control.attitude is not None and not self.needs_attitude(autopilot):
            demand = f"must be left out, or null: with actions of kind {self.kind} it is not used"
            raise scenario.wrong(demand, "control", "attitude")


ACTIONS = OpenUnion(Action)
"""Kinds of actions."""

AnyAction = Annotated[Action, ACTIONS]


class ThrustAction(Action):
    """Action whose first row is a thrust. The default range is ours; the paper's rotors give 2.2 times the weight."""

    min_thrust: PlainNonNegative = Field(default=0.0, description="of an action of -1, as a share of the weight (1)")
    max_thrust: PlainPositive = Field(default=2.0, description="of an action of 1, as a share of the weight (1)")
    num_rows: ClassVar = 4

    @model_validator(mode="after")
    def _has_room(self) -> "ThrustAction":
        if not self.min_thrust < self.max_thrust:
            raise self.wrong(f"must be larger than min_thrust, {self.min_thrust}", "max_thrust")
        return self

    def thrusts(self, believed: QuadrotorParameters) -> ThrustRange:
        """Return the thrusts of actions of -1 and 1, N."""
        weight = believed.mass * believed.gravity
        return ThrustRange(self.min_thrust * weight, self.max_thrust * weight)

    def hovering(self, believed: QuadrotorParameters) -> tuple[float, ...]:
        """Return a thrust of the weight without any rotation."""
        return (2.0 * (1.0 - self.min_thrust) / (self.max_thrust - self.min_thrust) - 1.0, 0.0, 0.0, 0.0)
