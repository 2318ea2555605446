"""Scenario of an environment, whose control is a policy without a network."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drake_quad.errors import InputError, short_repr
from drake_quad.scenario.actions.action import ACTIONS
from drake_quad.scenario.batch import median_scenario
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.files.loading import Overrides, load_scenario, with_fields
from drake_quad.scenario.models import Scenario


def environment_scenario(
    scenario: Scenario | str | Path,
    overrides: Overrides = (),
    *,
    action: str | Mapping[str, Any] | Model | None = None,
    observation: Mapping[str, Any] | Model | None = None,
) -> Scenario:
    """Return the scenario of an environment, whose control is a policy without a network.

    If an attitude control is needed, it is taken from the scenario, or designed if the scenario has none.

    Args:
        scenario: scenario, or the file or name of a scenario to load.
        overrides: overrides for `load_scenario`, if the scenario is loaded.
        action: type of action, or the fields of `control.action`. By default the action of the scenario's policy; if
            there is no policy, an acceleration.
        observation: fields of `control.observation`. By default the observation of the scenario's policy; if there is
            no policy, the default values of the scenario language.

    Raises:
        InputError: if the scenario does not exist, or a field is invalid.
    """
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario, overrides)
    elif overrides:
        raise InputError(
            "overrides apply only to a scenario that is loaded by file or name; change the given Scenario instead"
        )
    control, autopilot = scenario.control, scenario.laboratory.autopilot
    fields = {"kind": "policy", "action": {"kind": "acceleration"}, **control.policy_fields()}
    attitude = fields.pop("attitude", None)
    if action is not None:
        fields["action"] = {"kind": action} if isinstance(action, str) else action
    if observation is not None:
        fields["observation"] = observation
    if isinstance(fields["action"], Model):
        fields["action"] = fields["action"].model_dump(mode="json")
    if not isinstance(fields["action"], Mapping):
        raise InputError(
            f"action is {short_repr(action)}, but must be the name of an action type, or a mapping of fields"
        )
    kind = ACTIONS.get(fields["action"].get("kind"))
    # The validation of the scenario checks the fields of the action.
    unchecked = {str(name): value for name, value in fields["action"].items()}
    if kind is not None and kind.model_construct(**unchecked).needs_attitude(autopilot):
        fields["attitude"] = attitude or _designed_attitude(scenario)
    return with_fields(scenario, {"control": fields})


def _designed_attitude(scenario: Scenario) -> dict[str, Any]:
    """Return the attitude control that `drake-quad design` designs for a scenario without attitude control."""
    from drake_quad.design.cascade import design_cascade

    ones = {"k_p": [1.0, 1.0, 1.0], "k_d": [1.0, 1.0, 1.0]}
    cascade = {"position": {"kind": "pd", "feed_forward": "none", **ones}, "attitude": ones}
    gains = design_cascade(median_scenario(with_fields(scenario, {"control": cascade}))).gains()["attitude"]
    return {name: list(rows) for name, rows in gains.items()}
