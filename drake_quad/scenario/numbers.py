"""Single numbers of a scenario, by the path of their field."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from pydantic import ValidationError

from drake_quad.errors import InputError
from drake_quad.scenario.models import Scenario


def number_at(scenario: Scenario, path: str) -> float:
    """The number in a field, as in `vehicle.mass` or `control.position.k_p.0`.

    Raises:
        InputError: there is no such field, or it holds something else.
    """
    value: Any = scenario.model_dump(mode="json")
    for key in _keys(value, path):
        value = value[key]
    if isinstance(value, bool | int) or not isinstance(value, float):
        shown = "a block of fields" if isinstance(value, dict) else repr(value)
        raise InputError(f"{path} is {shown}, not a real number")
    return value


def with_number(scenario: Scenario, path: str, value: float) -> Scenario:
    """The scenario with another number in a field, as if it had been written there.

    What the scenario does not say stays unsaid: a vehicle that is as in `nominal` follows it.

    Raises:
        InputError: there is no such field, or it may not have this value.
    """
    whole = scenario.model_dump(mode="json")
    keys = _keys(whole, path)
    tree = node = scenario.model_dump(mode="json", exclude_unset=True)
    for key in keys[:-1]:
        whole = whole[key]
        if isinstance(node, dict):
            node.setdefault(key, {} if isinstance(whole, dict) else whole)
        node = node[key]
    node[keys[-1]] = value
    try:
        return Scenario.model_validate(tree)
    except ValidationError as error:
        raise InputError(f"{path} cannot be {value:g}: {error.errors()[0]['msg']}") from None


def _keys(tree: Any, path: str) -> list[Any]:
    """The keys and indices on the way to a field."""
    keys: list[Any] = []
    for step in path.split("."):
        key = int(step) if isinstance(tree, list) and step.isdecimal() else step
        try:
            tree = tree[key]
        except (KeyError, IndexError, TypeError):
            raise InputError(f"there is no field {path} in the scenario") from None
        keys.append(key)
    return keys


def with_rows(scenario: Scenario, path: str, values: np.ndarray) -> Scenario:
    """The scenario with an array in a field, an entry a vehicle, as `draw_samples` makes them.

    Nothing checks whether the field may have these values.

    Raises:
        InputError: there is no such field.
    """
    try:
        replaced: Scenario = _replaced(scenario, path.split("."), values)
    except (AttributeError, IndexError, ValueError):
        raise InputError(f"there is no field {path} in the scenario") from None
    return replaced


def _replaced(value: Any, steps: Sequence[str], new: Any) -> Any:
    """A copy of a part of a scenario with something else at the end of a path."""
    if not steps:
        return new
    step, *rest = steps
    if isinstance(value, tuple):
        items = list(value)
        items[int(step)] = _replaced(items[int(step)], rest, new)
        return tuple(items)
    return value.model_copy(update={step: _replaced(getattr(value, step), rest, new)})
