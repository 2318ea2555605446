"""Distributions relative to a vehicle, written `{relative: {to: 0.68, normal: {...}}}`.

Their numbers are those of a vehicle whose field has the value `to`; for any other vehicle they are scaled in
proportion. So a scenario can say how much vehicles differ without saying which vehicle flies. The value beneath a
relative distribution is kept beside it while scenarios are laid over each other, and the two become an ordinary
distribution when all layers are known.
"""

from typing import Any

from pydantic import ValidationError

from drake_quad.errors import InputError, listed, shown
from drake_quad.scenario.distributions import DISTRIBUTIONS
from drake_quad.scenario.layouts import arm_length_of
from drake_quad.scenario.marked_tree import Tree

RELATIVE = "relative"
# Key of the value beneath a relative distribution. It has a space, so that no path of a field can name it.
_BENEATH = "value beneath"
_REFERENCE = "to"
# Fields without a nominal value: shares, which are relative already.
_SHARES = ("thrust_factor_error", "battery_sag")
# Fields of distributions that are in the unit of the quantity.
_SCALED = ("mean", "standard_deviation", "min", "max")


def is_relative(tree: Tree) -> bool:
    """Return whether a tree is a relative distribution."""
    return isinstance(tree.value, dict) and RELATIVE in tree.value


def are_relative(tree: Tree) -> bool:
    """Return whether a tree is a list in which some item is a relative distribution."""
    return isinstance(tree.value, list) and any(map(is_relative, tree.value))


def laid_on_value(beneath: Tree, distribution: Tree) -> Tree:
    """Return a relative distribution with the value that it is laid on, be it a number or a distribution."""
    if is_relative(beneath):
        if _BENEATH not in beneath.value:
            return distribution
        beneath = beneath.value[_BENEATH]
    return distribution._replace(value={RELATIVE: distribution.value[RELATIVE], _BENEATH: beneath})


def laid_on_values(beneath: Tree, distributions: Tree) -> Tree:
    """Return a list of which some items are relative distributions, each with the item that it is laid on."""
    if not isinstance(beneath.value, list) or len(beneath.value) != len(distributions.value):
        return distributions
    pairs = zip(beneath.value, distributions.value, strict=True)
    return distributions._replace(value=[laid_on_value(old, new) if is_relative(new) else new for old, new in pairs])


def relative_part(tree: Tree) -> Tree | None:
    """Return what of a tree is relative, without the values beneath; None if nothing is."""
    if is_relative(tree):
        return tree._replace(value={RELATIVE: tree.value[RELATIVE]})
    if are_relative(tree):
        if not all(map(is_relative, tree.value)):
            return None
        return tree._replace(value=[relative_part(item) for item in tree.value])
    if not isinstance(tree.value, dict):
        return None
    parts = {key: relative_part(part) for key, part in tree.value.items()}
    kept = {key: part for key, part in parts.items() if part is not None}
    return tree._replace(value=kept) if kept else None


def with_absolute_distributions(tree: Tree, nominal: Any, defaults: Any) -> Tree:
    """Return a scenario in which the relative distributions of `vehicle` are ordinary ones.

    A field that the vehicle does not have, such as body drag, or that is zero, has no distribution.

    Args:
        tree: the scenario, with all its layers.
        nominal: the `Nominal` of the scenario, whose values count for fields that `vehicle` does not have.
        defaults: a `Vehicle` with the defaults of all other fields.

    Raises:
        InputError: something relative is not a distribution.
    """
    vehicle = tree.value.get("vehicle")
    if vehicle is not None and isinstance(vehicle.value, dict) and relative_part(vehicle) is not None:
        fields = {}
        for name, field in vehicle.value.items():
            default = getattr(nominal, name, getattr(defaults, name, None))
            if name == "centre_of_mass":
                default = (arm_length_of(nominal),) * 2
            elif name in _SHARES:
                default = 1.0
            fields[name] = _absolute(field, default, f"vehicle.{name}")
        kept = {name: field for name, field in fields.items() if field is not None}
        tree = tree._replace(value={**tree.value, "vehicle": vehicle._replace(value=kept)})
    return tree


def _absolute(tree: Tree, reference: Any, path: str) -> Tree | None:
    """A field with ordinary distributions; None if it has nothing but distributions of what the vehicle does not have.

    Args:
        tree: of the field.
        reference: the value of the field where nothing stands beneath: a number, a model, a tuple or None.
        path: of the field.
    """
    if is_relative(tree):
        beneath = tree.value.get(_BENEATH)
        number = reference if beneath is None else _middle(beneath)
        if path.split(".")[1] in (*_SHARES, "centre_of_mass"):
            number = reference
        return None if number is None else _scaled(tree, number, path)
    if are_relative(tree):
        references = reference if isinstance(reference, tuple) else (reference,) * len(tree.value)
        if len(references) != len(tree.value):
            return tree
        items = [
            _absolute(item, each, f"{path}.{i}")
            for i, (item, each) in enumerate(zip(tree.value, references, strict=True))
        ]
        return None if any(item is None for item in items) else tree._replace(value=items)
    if not isinstance(tree.value, dict):
        return tree
    parts = {key: _absolute(part, getattr(reference, key, None), f"{path}.{key}") for key, part in tree.value.items()}
    kept = {key: part for key, part in parts.items() if part is not None}
    return None if parts and not kept else tree._replace(value=kept)


def _middle(tree: Tree) -> float | None:
    """The number of a tree, or the median of its distribution; None if it is neither."""
    plain = tree.plain()
    if isinstance(plain, dict):
        for name, model in DISTRIBUTIONS.items():
            if name in plain:
                try:
                    return float(model.model_validate(plain).quantile(0.5))
                except ValidationError:
                    return None
    return float(plain) if isinstance(plain, int | float) and not isinstance(plain, bool) else None


def _scaled(tree: Tree, number: float, path: str) -> Tree:
    """A relative distribution as an ordinary one, for a vehicle whose field has the value of a number."""
    body = tree.value[RELATIVE]
    names = [name for name in DISTRIBUTIONS if isinstance(body.value, dict) and name in body.value]
    if len(names) != 1 or not body.value.keys() <= {names[0], _REFERENCE}:
        raise InputError(
            f"{body.mark}: {path}.relative must be one of the distributions {listed([*DISTRIBUTIONS])}, and may have"
            " `to`, the value to which its numbers belong"
        )
    (name,) = names
    reference = body.value[_REFERENCE].value if _REFERENCE in body.value else 1.0
    if isinstance(reference, bool) or not isinstance(reference, int | float) or not reference > 0.0:
        raise InputError(
            f"{body.value[_REFERENCE].mark}: {path}.relative.to is {shown(reference)}, but must be positive"
        )
    if number < 0.0:
        raise InputError(f"{tree.mark}: {path} is {number:g}, and a negative number has no relative distribution")
    if number == 0.0 and path.split(".")[1] not in _SHARES:
        return Tree(0.0, tree.mark)
    factor = number / reference
    inside = body.value[name]
    if name == "choice" and isinstance(inside.value, list):
        scaled = inside._replace(value=[_times(item, factor) for item in inside.value])
    elif isinstance(inside.value, dict):
        scaled = inside._replace(
            value={key: _times(each, factor) if key in _SCALED else each for key, each in inside.value.items()}
        )
    else:
        scaled = inside
    return Tree({name: scaled}, tree.mark)


def _times(tree: Tree, factor: float) -> Tree:
    """A number times a factor; what is no number is left to be refused."""
    number = tree.value
    return (
        tree._replace(value=number * factor)
        if isinstance(number, int | float) and not isinstance(number, bool)
        else tree
    )


def refuse_elsewhere(tree: Tree) -> None:
    """Raise InputError if a scenario has a relative distribution that is not in `vehicle`."""
    for name, part in tree.value.items():
        if name != "vehicle":
            _refuse(part, name)


def _refuse(tree: Tree, path: str) -> None:
    """Raise InputError if there is a relative distribution in a part of a scenario at a path."""
    if is_relative(tree):
        raise InputError(
            f"{tree.value[RELATIVE].mark}: {path} is relative, but only fields of `vehicle` have a nominal value that"
            " they can be relative to"
        )
    if isinstance(tree.value, dict | list):
        for key, part in tree.value.items() if isinstance(tree.value, dict) else enumerate(tree.value):
            _refuse(part, f"{path}.{key}")
