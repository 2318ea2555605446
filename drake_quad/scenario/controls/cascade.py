"""Cascade of position and attitude control, in the scenario language."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import Field, model_validator
from pydrake.systems.framework import Diagram

from drake_quad.control.cascade import build_cascade
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.attitude_controllers.controller import (
    ATTITUDE_CONTROLLERS,
    AnyAttitudeController,
    check_attitude_control,
)
from drake_quad.scenario.controls.control import CONTROLS, Control
from drake_quad.scenario.controls.thrust_vectoring import ThrustVectoringSettings
from drake_quad.scenario.networks.network import Network
from drake_quad.scenario.position_controllers.controller import POSITION_CONTROLLERS, AnyPositionController
from drake_quad.scenario.setting import ControlSetting


@CONTROLS.register
class CascadeControl(Control):
    """Cascade of a position controller, thrust vectoring and, without an autopilot on board, an attitude controller."""

    kind: Literal["cascade"] = Field(
        default="cascade", description="may be omitted, since it is the default kind of a control"
    )
    position: AnyPositionController
    network: Network | None = Field(  # type: ignore[misc]
        default=None, description="fuzzy network that corrects the acceleration command; none if not given"
    )
    thrust_vectoring: ThrustVectoringSettings = ThrustVectoringSettings()
    attitude: AnyAttitudeController | None = Field(
        default=None,
        description="attitude controller on the ground; required if there is no autopilot; otherwise it must be"
        " omitted or null",
    )
    user_system_paths: ClassVar = {"position_controller": ("position", "network.")}

    @model_validator(mode="after")
    def _supports_its_network(self) -> "CascadeControl":
        """Raise a validation error if the network needs a port that the position controller does not have."""
        if self.network is None:
            return self
        if not self.position.takes_correction:
            demand = f"must be left out, since a position controller of kind {self.position.kind} takes no correction"
            raise self.field_error(demand, "network")
        if self.network.inputs.disturbance is not None and not self.position.estimates_disturbance:
            demand = (
                f"must be left out, since a position controller of kind {self.position.kind} estimates no disturbance"
            )
            raise self.field_error(demand, "network", "inputs", "disturbance")
        return self

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the cascade does not fit the autopilot.

        Attitude must be controlled either on the ground or on board, and the autopilot must accept the derivatives that
        the cascade feeds forward.
        """
        check_attitude_control(scenario)
        autopilot = scenario.laboratory.autopilot
        if self.position.feed_forward not in autopilot.feeds_forward:
            allowed = " or ".join(autopilot.feeds_forward)
            demand = f"must be {allowed} with laboratory.autopilot of kind {autopilot.kind}"
            raise scenario.field_error(demand, "control", "position", "feed_forward")

    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipes to build all parts of the cascade."""
        recipes = self.position.recipes(setting)
        if self.network is not None:
            recipes |= self.network.recipes(setting.tick, setting.plan)
        recipes["thrust_vectoring"] = self.thrust_vectoring.recipe(setting.nominal, self.attitude)
        if self.attitude is not None:
            recipes["attitude"] = self.attitude.recipe(setting.nominal.inertia, setting.tick)
        return recipes

    def build(self, systems: Mapping[str, Any], user_systems: Mapping[str, Any]) -> Diagram:
        """Return the diagram of the cascade. A user's `position_controller` also replaces the network."""
        position, network = user_systems.get("position_controller"), None
        if position is None:
            network = None if self.network is None else self.network.build(systems)
            position = self.position.build(systems, takes_correction=network is not None)
        return build_cascade(
            position=position,
            network=network,
            thrust_vectoring=systems["thrust_vectoring"],
            attitude=systems.get("attitude"),
            feed_forward=self.position.feed_forward,
        )

    def contains_user_system(self) -> bool:
        """Return whether the position controller is a user's Python system."""
        return self.position.is_user_system

    def limits(self) -> ThrustVectoringSettings:
        """Return the limits of tilt and thrust that thrust vectoring obeys."""
        return self.thrust_vectoring

    def cascade(self) -> "CascadeControl":
        """Return the control itself, which is a cascade."""
        return self

    def parts(self) -> list[str]:
        """Return the kinds of the cascade's controllers and of its network."""
        network = [] if self.network is None else [f"{self.network.kind} network"]
        attitude = [] if self.attitude is None else [f"attitude {self.attitude.kind}"]
        return [self.position.kind, *network, *attitude]

    def policy_fields(self) -> dict[str, Any]:
        """Return the fields for thrust vectoring and attitude control, which a control of kind `policy` inherits."""
        return {"thrust_vectoring": self.thrust_vectoring, "attitude": self.attitude}


POSITION_CONTROLLERS.add_dependent_models(CascadeControl)
ATTITUDE_CONTROLLERS.add_dependent_models(CascadeControl)
