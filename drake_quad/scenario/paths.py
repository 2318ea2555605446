"""Paths to the fields of a scenario, such as `vehicle.mass` or `control.position.k_p.0`.

A path names a list item by its index, counted from 0. If a list has one item for each rotor, its items are instead
called `rotor_1` to `rotor_4`, as in `vehicle.thrust_factor_error.rotor_1`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeVar

from drake_quad.errors import InputError, did_you_mean, short_repr
from drake_quad.scenario.distributions import Distribution, Model

# Fields whose value is a list with one item for each rotor.
_ROTOR_LISTS = ("thrust_factor_error", "rotors")
_ROTOR_PREFIX = "rotor_"

_AnyModel = TypeVar("_AnyModel", bound=Model)


def join_path(*steps: str | int) -> str:
    """Join steps, each of which may itself be a path, to one path."""
    path = ""
    for step in map(str, steps):
        if is_item(step) and path.rpartition(".")[2] in _ROTOR_LISTS:
            step = f"{_ROTOR_PREFIX}{int(step) + 1}"
        path = f"{path}.{step}" if path else step
    return path


def is_item(step: str) -> bool:
    """Return whether a step of a path is the index of a list item."""
    return step.isascii() and step.isdecimal()


def split_path(path: str) -> list[str]:
    """Split a path into steps. List items, including rotors, become indices counted from 0.

    Raises:
        InputError: if the path refers to a rotor by another name than `rotor_1` to `rotor_4`.
    """
    steps: list[str] = []
    for step in path.split("."):
        if steps and steps[-1] in _ROTOR_LISTS:
            number = step.removeprefix(_ROTOR_PREFIX)
            if number == step or number not in ("1", "2", "3", "4"):
                raise InputError(
                    f"{path} does not name a rotor; write rotor_1, rotor_2, rotor_3 or rotor_4 instead of"
                    f" {short_repr(step)}"
                )
            step = str(int(number) - 1)
        steps.append(step)
    return steps


def path_keys(path: str) -> list[str | int]:
    """Return the steps of a path as keys of mappings and indices of lists."""
    return [int(step) if step.isdecimal() else step for step in split_path(path)]


def children(value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the name and value of each field of a mapping, or the index and value of each item of a list.

    Other values, including distributions, have no parts.
    """
    if isinstance(value, Model) and not isinstance(value, Distribution):
        for name in type(value).model_fields:
            yield name, getattr(value, name)
    elif isinstance(value, tuple):
        for i, item in enumerate(value):
            yield str(i), item
    elif isinstance(value, dict):
        yield from value.items()


def mappings_in(value: Any, path: str = "") -> Iterator[tuple[str, Model]]:
    """Yield the path and value of each mapping in a part of a scenario, outer mappings first."""
    if isinstance(value, Model) and not isinstance(value, Distribution):
        yield path, value
    for step, part in children(value):
        yield from mappings_in(part, join_path(path, step))


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the path and value of each number, distribution, text or other leaf in a part of a scenario.

    Args:
        value: part of the scenario.
        path: path of the part; empty for a whole scenario.
    """
    has_parts = isinstance(value, dict)
    for step, part in children(value):
        has_parts = True
        yield from leaves(part, join_path(path, step))
    if not has_parts and not isinstance(value, tuple):
        yield path, value


def distributions_in(scenario: Model) -> dict[str, Distribution]:
    """Return the distributions in a scenario, by path."""
    return {path: value for path, value in leaves(scenario) if isinstance(value, Distribution)}


def value_at(scenario: Model, path: str) -> Any:
    """Return the value of the field at a path.

    Raises:
        InputError: if the field does not exist.
    """
    value: Any = scenario
    for step in split_path(path):
        parts = dict(children(value))
        if step not in parts:
            question = did_you_mean(step, parts, 1)
            raise InputError(f"the scenario has no field {path}{f'; {question}' if question else ''}")
        value = parts[step]
    return value


def map_leaves(value: Any, replace: Callable[[str, Any], Any], path: str = "") -> Any:
    """Return a copy of a part of a scenario in which leaves are replaced.

    Args:
        value: part of the scenario.
        replace: function that returns the new value of a leaf, given the path and the old value.
        path: path of the part; empty for a whole scenario.
    """
    parts = dict(children(value))
    if not parts:
        return value if isinstance(value, tuple | dict) else replace(path, value)
    new_parts = {step: map_leaves(part, replace, join_path(path, step)) for step, part in parts.items()}
    changed = {step: part for step, part in new_parts.items() if part is not parts[step]}
    if not changed:
        return value
    if isinstance(value, dict):
        return new_parts
    return tuple(new_parts.values()) if isinstance(value, tuple) else value.model_copy(update=changed)


def with_values(model: _AnyModel, values: Mapping[str, Any]) -> _AnyModel:
    """Return a copy of a mapping with new values of some fields, without validation.

    Args:
        model: scenario, or a mapping in it.
        values: new values by the path of their field, which must not be an item of a list.
    """
    values_by_field: dict[str, dict[str, Any]] = {}
    for path, value in values.items():
        field, _, rest = path.partition(".")
        values_by_field.setdefault(field, {})[rest] = value
    parts = {
        field: field_values[""] if "" in field_values else with_values(getattr(model, field), field_values)
        for field, field_values in values_by_field.items()
    }
    return model.model_copy(update=parts)


def refuse_distributions(paths: Iterable[str]) -> None:
    """Raise InputError about the first of the given paths of fields with distributions; do nothing if there is none."""
    for path in paths:
        raise InputError(
            f"{path} is a distribution, but one flight needs a number; give a number, or select a sample with"
            " draw_sample(scenario, 0) in Python or --sample 0 in a shell"
        )
