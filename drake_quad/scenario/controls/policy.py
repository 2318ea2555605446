"""Control by a trained policy."""

from collections.abc import Mapping
from typing import Any, ClassVar, Literal

from pydantic import Field, model_validator
from pydrake.systems.framework import Diagram

from drake_quad.control.policy import systems as policies
from drake_quad.control.policy.observation import ObservationNumbers
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.actions.action import ACTIONS, AnyAction
from drake_quad.scenario.attitude_controllers.controller import ATTITUDE_CONTROLLERS, AnyAttitudeController
from drake_quad.scenario.controls.control import CONTROLS, Control
from drake_quad.scenario.controls.thrust_vectoring import ThrustVectoringSettings
from drake_quad.scenario.networks.learned import or_file
from drake_quad.scenario.policies.observation import ObservationSettings
from drake_quad.scenario.policies.trained_network import TrainedNetwork
from drake_quad.scenario.setting import ControlSetting


@CONTROLS.member
class PolicyControl(Control):
    """A trained network in place of the position controller, of the cascade, or of all that is not on board."""

    kind: Literal["policy"]
    policy: TrainedNetwork | None = Field(
        default=None,
        description="file of the network, .npz or .onnx, beside the one that names it; FILE.onnx:NAME takes one of"
        " several outputs; without a network there is no flying but in drake_quad.gym",
        json_schema_extra=or_file,
    )
    action: AnyAction = Field(description="what the network's output means")
    observation: ObservationSettings = Field(default=ObservationSettings(), description="what the network sees")
    thrust_vectoring: ThrustVectoringSettings = Field(
        default=ThrustVectoringSettings(), description="limits, where the action is an acceleration"
    )
    attitude: AnyAttitudeController | None = Field(
        default=None, description="on the ground; needed without an autopilot for accelerations and attitudes"
    )
    network: ClassVar = None
    places: ClassVar = {"policy": ("policy",)}

    @model_validator(mode="after")
    def _has_rows(self) -> "PolicyControl":
        """Raise an error if the network has other rows than the observation and the action."""
        if self.policy is None:
            return self
        last = len(self.policy.layers) - 1
        rows = self.policy_rows()
        for place, side, wanted in ((0, "inputs", rows["observation"]), (last, "outputs", rows["action"])):
            if getattr(self.policy.layers[place], side) != wanted:
                demand = f"must be {wanted}, as many as this observation and action have"
                raise self.wrong(demand, "policy", "layers", place, side)
        return self

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if actions do not get there, or there are no obstacles to look at."""
        self.action.check_fits(scenario)
        if "clearance" in self.observation.signals and not (scenario.space and scenario.space.obstacles):
            demand = "must not have clearance, which is infinite: there are no obstacles in `space`"
            raise scenario.wrong(demand, "control", "observation", "signals")

    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipes for what is around the policy, and for the policy if there is one."""
        action, seen, believed = self.action, self.observation, setting.believed
        structure = {
            "period": setting.tick,
            "spec": seen.spec(),
            "num_actions": action.num_rows,
            "num_ahead": len(seen.ahead),
            "clearance": seen.clearance(setting.space),
        }
        numbers = ObservationNumbers(believed.max_rotor_speed, action.hovering(believed))
        recipes = {"observation": Recipe(policies.Observation, structure, numbers)}
        if self.policy is not None:
            network = {"period": setting.tick, "network": self.policy.network()}
            recipes["policy"] = Recipe(policies.Policy, network, None)
        recipes["actuation"] = action.recipe(setting, turn=seen.turn, attitude=self.attitude)
        if action.vectors_thrust:
            recipes["thrust_vectoring"] = self.thrust_vectoring.recipe(believed, self.attitude)
        if action.commands == "attitude" and self.attitude is not None:
            recipes["attitude"] = self.attitude.recipe(believed.inertia, setting.tick)
        return recipes

    def build(self, systems: Mapping[str, Any], own: Mapping[str, Any]) -> Diagram:
        """Return the diagram around the policy, which may be one of the user's."""
        return policies.build_policy_control(
            observation=systems["observation"],
            policy=systems.get("policy", own.get("policy")),
            actuation=systems["actuation"],
            sees=self.observation.sees,
            thrust_vectoring=systems.get("thrust_vectoring"),
            attitude=systems.get("attitude"),
        )

    def limits(self) -> ThrustVectoringSettings:
        """Return the limits of thrust vectoring."""
        return self.thrust_vectoring

    def commands_rates_alone(self) -> bool:
        """Return whether actions are body rates."""
        return self.action.commands == "rates"

    def ahead(self) -> tuple[float, ...]:
        """Return the times from now at which the reference is observed, s."""
        return self.observation.ahead

    def policy_rows(self) -> dict[str, int]:
        """Return the number of rows of the observation and the action."""
        rows = self.action.num_rows
        return {"observation": self.observation.num_rows(rows), "action": rows}

    def lacks_policy(self) -> bool:
        """Return whether there is no network."""
        return self.policy is None

    def policy_fields(self) -> dict[str, Any]:
        """Return all fields but the network."""
        return {name: getattr(self, name) for name in ("action", "observation", "thrust_vectoring", "attitude")}


ATTITUDE_CONTROLLERS.rebuild(PolicyControl)
ACTIONS.rebuild(PolicyControl)
