"""The task of an environment: a scenario with a place for actions, and what is seen of it."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drake_quad.errors import InputError
from drake_quad.scenario import Scenario, load_scenario
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.loading import Overrides, with_fields
from drake_quad.scenario.policy import PolicyControl


def task_of(
    scenario: Scenario | str | Path,
    overrides: Overrides = (),
    *,
    action: str | Mapping[str, Any] | Model | None = None,
    observation: Mapping[str, Any] | Model | None = None,
) -> Scenario:
    """The scenario of an environment, whose control is a policy that is not there.

    Args:
        scenario: what flies where, in which laboratory, with which distributions; or the file or name of one.
        overrides: as for `load_scenario`, of a scenario that is loaded.
        action: what actions mean: a kind, or the fields of `control.action`. That of the scenario's policy, or an
            acceleration, if not given.
        observation: fields of `control.observation`; as the scenario's policy has it, or by default, if not given.

    Raises:
        InputError: there is no such scenario, or a field is wrong.
    """
    if not isinstance(scenario, Scenario):
        scenario = load_scenario(scenario, overrides)
    elif overrides:
        raise InputError("overrides are of a scenario that is loaded by its name, not of one that is given")
    control = scenario.control
    known = control.model_dump(mode="json") if isinstance(control, PolicyControl) else {}
    wanted = {"kind": action} if isinstance(action, str) else action
    fields: dict[str, Any] = {
        "kind": "policy",
        "action": wanted or known.get("action") or {"kind": "acceleration"},
        "observation": observation or known.get("observation") or {},
    }
    for name in ("thrust_vectoring", "attitude"):
        if getattr(control, name, None) is not None:
            fields[name] = getattr(control, name)
    return with_fields(scenario, {"control": fields})
