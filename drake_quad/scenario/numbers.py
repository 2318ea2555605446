"""Reading and replacement of a single number in a scenario, given the path of its field."""

from typing import Any

from pydantic import ValidationError

from drake_quad.errors import InputError
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import path_keys, value_at


def number_at(scenario: Scenario, path: str) -> float:
    """Return the number in a field such as `vehicle.mass` or `control.position.k_p.0`.

    Raises:
        InputError: if the field does not exist or is not a number.
    """
    value = value_at(scenario, path)
    if not isinstance(value, float):
        shown = "a mapping or list" if isinstance(value, Model | tuple) else repr(value)
        raise InputError(f"{path} is {shown}, but must be a real number")
    return value


def with_number(scenario: Scenario, path: str, value: float) -> Scenario:
    """Return the scenario with a new number in a field.

    Omitted fields keep following their defaults. If the vehicle has no mass, for example, a change of `nominal.mass`
    also changes the mass of the vehicle.

    Raises:
        InputError: if the field does not exist, or the value is not allowed.
    """
    value_at(scenario, path)
    whole: Any = scenario.model_dump(mode="json")
    tree = scenario.model_dump(mode="json", exclude_unset=True)
    node: Any = tree
    keys = path_keys(path)
    for key in keys[:-1]:
        whole = whole[key]
        if isinstance(node, dict):
            # A mapping with a kind is copied with all its fields, since their defaults depend on the kind.
            node.setdefault(key, {} if isinstance(whole, dict) and "kind" not in whole else whole)
        node = node[key]
    node[keys[-1]] = value
    try:
        return Scenario.model_validate(tree)
    except ValidationError as error:
        raise InputError(f"{path} cannot be {value:g}: {error.errors()[0]['msg']}") from None
