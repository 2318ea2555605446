"""Control by a trained policy, in the scenario language."""

from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Literal

from pydantic import Field, model_validator
from pydrake.systems.framework import Diagram

from drake_quad.control.policy import systems as policies
from drake_quad.control.policy.observation import ObservationParameters
from drake_quad.errors import join_names
from drake_quad.framework.recipe import Recipe
from drake_quad.scenario.actions.action import ACTIONS, AnyAction
from drake_quad.scenario.attitude_controllers.controller import ATTITUDE_CONTROLLERS, AnyAttitudeController
from drake_quad.scenario.controls.control import CONTROLS, Control
from drake_quad.scenario.controls.thrust_vectoring import ThrustVectoringSettings
from drake_quad.scenario.inactive import FlightConditions, InactiveSetting, is_set
from drake_quad.scenario.networks.learned import allow_file_name
from drake_quad.scenario.policies.observation import ObservationSettings
from drake_quad.scenario.policies.trained_network import TrainedNetwork
from drake_quad.scenario.setting import ControlSetting
from drake_quad.signals import valid_signal


@CONTROLS.register
class PolicyControl(Control):
    """A trained network that replaces the position controller or, depending on `action`, all ground station control."""

    kind: Literal["policy"]
    policy: TrainedNetwork | None = Field(
        default=None,
        description="file of the network, .npz or .onnx, relative to the folder of the scenario's file; FILE.onnx:NAME"
        " selects one of several outputs; without a network, the scenario can only be used in drake_quad.gym",
        json_schema_extra=allow_file_name,
    )
    action: AnyAction = Field(description="meaning of the output of the network")
    observation: ObservationSettings = Field(default=ObservationSettings(), description="input of the network")
    thrust_vectoring: ThrustVectoringSettings = Field(
        default=ThrustVectoringSettings(), description="limits of thrust and tilt, for actions of kind acceleration"
    )
    attitude: AnyAttitudeController | None = Field(
        default=None,
        description="attitude controller on the ground; required for actions that are accelerations or attitudes if"
        " there is no autopilot",
    )
    network: ClassVar = None
    user_system_paths: ClassVar = {"policy": ("policy",)}

    @model_validator(mode="after")
    def _network_has_right_size(self) -> "PolicyControl":
        """Raise an error if the network's inputs and outputs do not match the sizes of observation and action."""
        if self.policy is None:
            return self
        last = len(self.policy.layers) - 1
        rows = self.policy_rows()
        for index, side, size in ((0, "inputs", rows["observation"]), (last, "outputs", rows["action"])):
            if getattr(self.policy.layers[index], side) != size:
                demand = f"must be {size}, the number of elements of this control's observation or action"
                raise self.field_error(demand, "policy", "layers", index, side)
        return self

    def check_fits(self, scenario: Any) -> None:
        """Raise a validation error if the action does not fit the autopilot, or the observation the laboratory."""
        self.action.check_fits(scenario)
        sensors = scenario.laboratory.named_sensors
        available = {*sensors, *map(valid_signal, sensors)}
        for index, name in enumerate(self.observation.signals):
            if name in self.sensor_signals() and name not in available:
                whose = f"whose signals are {join_names(sorted(available))}" if available else "which is empty"
                demand = f"must be a signal of a sensor in laboratory.sensors, {whose}"
                raise scenario.field_error(demand, "control", "observation", "signals", index)
        if "clearance" in self.observation.signals and not (scenario.space and scenario.space.obstacles):
            demand = "must not contain clearance, which is infinite without obstacles in `space`"
            raise scenario.field_error(demand, "control", "observation", "signals")

    def inactive_settings(self, flight: FlightConditions, path: str) -> Iterator[InactiveSetting]:
        """Yield settings without effect, such as thrust vectoring limits if actions are not accelerations."""
        yield from super().inactive_settings(flight, path)
        if is_set(self, "thrust_vectoring") and not self.action.vectors_thrust:
            yield InactiveSetting(f"{path}.thrust_vectoring", f"{path}.action.kind is {self.action.kind}")

    def recipes(self, setting: ControlSetting) -> dict[str, Recipe]:
        """Return the recipes to build the observation, the actuation and, if there is a network, the policy."""
        action, observation, nominal = self.action, self.observation, setting.nominal
        structure = {
            "period": setting.tick,
            "spec": observation.spec(),
            "num_actions": action.num_rows,
            "num_ahead": len(observation.ahead),
            "clearance": observation.clearance(setting.space),
        }
        numbers = ObservationParameters(nominal.max_rotor_speed, action.hover_action(nominal))
        recipes = {"observation": Recipe(policies.Observation, structure, numbers)}
        if self.policy is not None:
            network = {"period": setting.tick, "network": self.policy.network()}
            recipes["policy"] = Recipe(policies.Policy, network, None)
        recipes["actuation"] = action.recipe(setting, turn=observation.turn, attitude=self.attitude)
        if action.vectors_thrust:
            recipes["thrust_vectoring"] = self.thrust_vectoring.recipe(nominal, self.attitude)
        if action.commands == "attitude" and self.attitude is not None:
            recipes["attitude"] = self.attitude.recipe(nominal.inertia, setting.tick)
        return recipes

    def build(self, systems: Mapping[str, Any], user_systems: Mapping[str, Any]) -> Diagram:
        """Return the diagram that contains the policy, which may be a user's system."""
        return policies.build_policy_control(
            observation=systems["observation"],
            policy=systems.get("policy", user_systems.get("policy")),
            actuation=systems["actuation"],
            state_source=self.observation.state_source,
            thrust_vectoring=systems.get("thrust_vectoring"),
            attitude=systems.get("attitude"),
            sensor_signals=self.observation.spec().sensor_signals,
        )

    def sensor_signals(self) -> tuple[str, ...]:
        """Return the names of the sensor signals that the policy observes."""
        return self.observation.spec().sensor_signals

    def limits(self) -> ThrustVectoringSettings:
        """Return the limits of tilt and thrust that thrust vectoring obeys."""
        return self.thrust_vectoring

    def commands_rates_only(self) -> bool:
        """Return whether the actions of the policy command body rates."""
        return self.action.commands == "rates"

    def preview_times(self) -> tuple[float, ...]:
        """Return the preview times of the policy: it observes the reference at these times after the present, s."""
        return self.observation.ahead

    def policy_rows(self) -> dict[str, int]:
        """Return the numbers of elements of the signals `observation` and `action`."""
        rows = self.action.num_rows
        return {"observation": self.observation.num_rows(rows), "action": rows}

    def lacks_policy(self) -> bool:
        """Return whether the scenario contains no network for the policy."""
        return self.policy is None

    def policy_fields(self) -> dict[str, Any]:
        """Return all fields except the network, which another control of kind `policy` inherits."""
        return {name: getattr(self, name) for name in ("action", "observation", "thrust_vectoring", "attitude")}


ATTITUDE_CONTROLLERS.add_dependent_models(PolicyControl)
ACTIONS.add_dependent_models(PolicyControl)
