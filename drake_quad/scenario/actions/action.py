"""Base classes of policy actions, and their registry `ACTIONS`.

To add an action, extend `Action` and register the class with `ACTIONS.register`.
"""

from abc import abstractmethod
from typing import Annotated, Any, ClassVar

from pydantic import Field, model_validator

from drake_quad.control.policy.actions import ThrustRange
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.attitude_controllers.controller import AttitudeControllerSettings, check_attitude_control
from drake_quad.scenario.autopilots.autopilot import Autopilot, Commanded
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.quantities import FixedNonNegative, FixedPositive
from drake_quad.scenario.setting import ControlSetting
from drake_quad.scenario.unions import OpenUnion
from drake_quad.vehicle.parameters import QuadrotorParameters


class Action(Model):
    """Conversion of a policy's output, whose elements are between -1 and 1, to a command.

    Attributes:
        num_rows: number of elements of an action.
        commands: type of the command. Without an autopilot, an attitude controller on the ground converts a commanded
            attitude to torques.
        vectors_thrust: True if a `ThrustVectoring` converts the command to thrust and attitude.
    """

    kind: str
    num_rows: ClassVar[int]
    commands: ClassVar[Commanded]
    vectors_thrust: ClassVar[bool] = False

    @abstractmethod
    def recipe(self, setting: ControlSetting, *, turn: float, attitude: AttitudeControllerSettings | None) -> Recipe:
        """Return the recipe to build the system that converts an action to a command.

        Args:
            setting: scenario properties on which the recipe depends.
            turn: angle about z from x_B to the forward direction of the policy, rad.
            attitude: attitude controller on the ground, if any. Its gains may be (N,) arrays.
        """

    @abstractmethod
    def hover_action(self, nominal: QuadrotorParameters) -> tuple[float, ...]:
        """Return the action with which the nominal vehicle hovers."""

    def needs_attitude(self, autopilot: Autopilot) -> bool:
        """Return whether the action needs an attitude controller on the ground."""
        return self.commands == "attitude" and not autopilot.controls_attitude

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the action does not fit the other parts of its `Scenario`."""
        autopilot = scenario.laboratory.autopilot
        if self.commands not in autopilot.accepts:
            allowed = ", ".join(name for name, kind in ACTIONS.members.items() if kind.commands in autopilot.accepts)
            demand = f"must be {allowed} with laboratory.autopilot of kind {autopilot.kind}"
            raise scenario.field_error(demand, "control", "action", "kind")
        if self.commands == "attitude":
            check_attitude_control(scenario)
        elif scenario.control.attitude is not None and not self.needs_attitude(autopilot):
            demand = f"must be left out, or null, since actions of kind {self.kind} do not use it"
            raise scenario.field_error(demand, "control", "attitude")


ACTIONS = OpenUnion(Action)
"""Registry of the kinds of actions."""

AnyAction = Annotated[Action, ACTIONS]


class ThrustAction(Action):
    """Action whose first element is a thrust."""

    min_thrust: FixedNonNegative = Field(
        default=0.0, description="thrust that an action of -1 commands, relative to the weight (1)"
    )
    max_thrust: FixedPositive = Field(
        default=2.0, description="thrust that an action of 1 commands, relative to the weight (1)"
    )
    num_rows: ClassVar = 4

    @model_validator(mode="after")
    def _has_range(self) -> "ThrustAction":
        if not self.min_thrust < self.max_thrust:
            raise self.field_error(f"must be larger than min_thrust, {self.min_thrust}", "max_thrust")
        return self

    def thrusts(self, nominal: QuadrotorParameters) -> ThrustRange:
        """Return the thrusts (N) that the action values -1 and 1 command."""
        weight = nominal.mass * nominal.gravity
        return ThrustRange(self.min_thrust * weight, self.max_thrust * weight)

    def hover_action(self, nominal: QuadrotorParameters) -> tuple[float, ...]:
        """Return the action that commands a thrust equal to the weight, no tilt and no rotation."""
        return (2.0 * (1.0 - self.min_thrust) / (self.max_thrust - self.min_thrust) - 1.0, 0.0, 0.0, 0.0)
