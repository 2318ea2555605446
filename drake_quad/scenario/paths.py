"""Fields of a scenario by their paths, such as `vehicle.mass` or `control.position.k_p.0`.

Items of lists are counted from 0, but for those of rotors, which are called as everywhere else:
`vehicle.thrust_factor_error.rotor_1`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeVar

from drake_quad.errors import InputError
from drake_quad.scenario.distributions import Distribution, Model

# Fields that hold a list of one item for each rotor.
_PER_ROTOR = ("thrust_factor_error", "rotors")
_ROTOR = "rotor_"

_AnyModel = TypeVar("_AnyModel", bound=Model)


def joined(*steps: str | int) -> str:
    """Return the path that consists of some steps, each of which may be a path itself."""
    path = ""
    for step in map(str, steps):
        if is_item(step) and path.rpartition(".")[2] in _PER_ROTOR:
            step = f"{_ROTOR}{int(step) + 1}"
        path = f"{path}.{step}" if path else step
    return path


def is_item(step: str) -> bool:
    """Return whether a step of a path is the index of a list item."""
    return step.isascii() and step.isdecimal()


def steps_of(path: str) -> list[str]:
    """Return the steps of a path, where items of lists are counted from 0.

    Raises:
        InputError: it counts rotors from 0, or otherwise than by their names.
    """
    steps: list[str] = []
    for step in path.split("."):
        if steps and steps[-1] in _PER_ROTOR:
            number = step.removeprefix(_ROTOR)
            if number == step or number not in ("1", "2", "3", "4"):
                raise InputError(f"{path} names no rotor: they are rotor_1, rotor_2, rotor_3 and rotor_4")
            step = str(int(number) - 1)
        steps.append(step)
    return steps


def keys_of(path: str) -> list[str | int]:
    """Return the steps of a path as keys of mappings and indices of lists."""
    return [int(step) if step.isdecimal() else step for step in steps_of(path)]


def parts_of(value: Any) -> Iterator[tuple[str, Any]]:
    """Yield step and value of the fields of a mapping or the items of a list; nothing for other values."""
    if isinstance(value, Model) and not isinstance(value, Distribution):
        for name in type(value).model_fields:
            yield name, getattr(value, name)
    elif isinstance(value, tuple):
        for i, item in enumerate(value):
            yield str(i), item
    elif isinstance(value, dict):
        yield from value.items()


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """All numbers, distributions, words and so on in a part of a scenario, each after its path."""
    inside = isinstance(value, dict)
    for step, part in parts_of(value):
        inside = True
        yield from leaves(part, joined(path, step))
    if not inside and not isinstance(value, tuple):
        yield path, value


def distributions_in(scenario: Model) -> dict[str, Distribution]:
    """Return the distributions in a scenario, by path."""
    return {path: value for path, value in leaves(scenario) if isinstance(value, Distribution)}


def value_at(scenario: Model, path: str) -> Any:
    """Return the value of a field.

    Raises:
        InputError: there is no such field.
    """
    value: Any = scenario
    for step in steps_of(path):
        parts = dict(parts_of(value))
        if step not in parts:
            raise InputError(f"there is no field {path} in the scenario")
        value = parts[step]
    return value


def replaced(value: Any, replace: Callable[[str, Any], Any], path: str = "") -> Any:
    """Return a copy of a part of a scenario in which leaves are replaced.

    Args:
        value: the part.
        replace: returns what takes a leaf's place, given its path and itself.
        path: of the part.
    """
    parts = dict(parts_of(value))
    if not parts:
        return value if isinstance(value, tuple | dict) else replace(path, value)
    after = {step: replaced(part, replace, joined(path, step)) for step, part in parts.items()}
    changed = {step: part for step, part in after.items() if part is not parts[step]}
    if not changed:
        return value
    if isinstance(value, dict):
        return after
    return tuple(after.values()) if isinstance(value, tuple) else value.model_copy(update=changed)


def updated(model: _AnyModel, values: Mapping[str, Any]) -> _AnyModel:
    """Return a copy of a mapping with other values in some fields, which are not validated.

    Args:
        model: a scenario, or a mapping in it.
        values: new values by the paths of their fields; a field is no item of a list.
    """
    inside: dict[str, dict[str, Any]] = {}
    for path, value in values.items():
        field, _, rest = path.partition(".")
        inside.setdefault(field, {})[rest] = value
    parts = {field: own[""] if "" in own else updated(getattr(model, field), own) for field, own in inside.items()}
    return model.model_copy(update=parts)


def refuse_distributions(paths: Iterable[str]) -> None:
    """Raise InputError if there is any field that holds a distribution, given by their paths."""
    for path in paths:
        raise InputError(
            f"{path} is a distribution; one flight needs a number there, or a sample to draw it for: sample=0 in"
            " Python, --sample 0 in a shell"
        )
