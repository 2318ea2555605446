"""Single numbers of a scenario, by the path of their field."""

from typing import Any

from pydantic import ValidationError

from drake_quad.errors import InputError
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import keys_of, value_at


def number_at(scenario: Scenario, path: str) -> float:
    """Return the number in a field, as in `vehicle.mass` or `control.position.k_p.0`.

    Raises:
        InputError: there is no such field, or it holds something else.
    """
    value = value_at(scenario, path)
    if not isinstance(value, float):
        shown = "a block of fields" if isinstance(value, Model | tuple) else repr(value)
        raise InputError(f"{path} is {shown}, not a real number")
    return value


def with_number(scenario: Scenario, path: str, value: float) -> Scenario:
    """Return the scenario with another number in a field, as if it had been written there.

    What the scenario does not say stays unsaid: a vehicle that is as in `nominal` follows it.

    Raises:
        InputError: there is no such field, or it may not have this value.
    """
    value_at(scenario, path)
    whole: Any = scenario.model_dump(mode="json")
    tree = scenario.model_dump(mode="json", exclude_unset=True)
    node: Any = tree
    keys = keys_of(path)
    for key in keys[:-1]:
        whole = whole[key]
        if isinstance(node, dict):
            # A mapping that has kinds is said as a whole.
            node.setdefault(key, {} if isinstance(whole, dict) and "kind" not in whole else whole)
        node = node[key]
    node[keys[-1]] = value
    try:
        return Scenario.model_validate(tree)
    except ValidationError as error:
        raise InputError(f"{path} cannot be {value:g}: {error.errors()[0]['msg']}") from None
