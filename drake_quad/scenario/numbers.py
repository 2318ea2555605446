"""Single numbers of a scenario, by the path of their field."""

from typing import Any

from pydantic import ValidationError

from drake_quad.errors import InputError
from drake_quad.scenario.models import Scenario


def number_at(scenario: Scenario, path: str) -> float:
    """The number in a field, as in `vehicle.mass` or `control.position.k_p.0`.

    Raises:
        InputError: there is no such field, or it holds something else.
    """
    parent, key = _place(scenario.model_dump(mode="json"), path)
    value = parent[key]
    if isinstance(value, bool | int) or not isinstance(value, float):
        raise InputError(f"{path} is {value!r}, not a real number")
    return value


def with_number(scenario: Scenario, path: str, value: float) -> Scenario:
    """The scenario with another number in a field.

    Raises:
        InputError: there is no such field, or it may not have this value.
    """
    tree = scenario.model_dump(mode="json")
    parent, key = _place(tree, path)
    parent[key] = value
    try:
        return Scenario.model_validate(tree)
    except ValidationError as error:
        raise InputError(f"{path} cannot be {value:g}: {error.errors()[0]['msg']}") from None


def _place(tree: Any, path: str) -> tuple[Any, Any]:
    """The list or map that holds a field, and where in it."""
    *way, last = path.split(".")
    node = tree
    try:
        for step in way:
            node = node[int(step)] if isinstance(node, list) else node[step]
        key = int(last) if isinstance(node, list) else last
        node[key]
    except (KeyError, IndexError, ValueError, TypeError):
        raise InputError(f"there is no field {path} in the scenario") from None
    return node, key
