"""Distributions relative to a vehicle, such as `{relative: {to: 0.68, normal: {...}}}`.

The parameters of such a distribution apply to a vehicle whose field has the value `to`. They are scaled in proportion
for other vehicles, so a scenario can describe a variation that applies to any vehicle. While layers are merged, a
relative distribution is stored together with the value from the lower layers. When all layers are merged, both are
converted to an ordinary distribution.
"""

from typing import Any

from pydantic import ValidationError

from drake_quad.errors import InputError, join_names, short_repr
from drake_quad.scenario.distributions import DISTRIBUTIONS
from drake_quad.scenario.files.marked_tree import Tree
from drake_quad.scenario.layouts import arm_length_of
from drake_quad.scenario.paths import is_item, join_path

RELATIVE = "relative"
# Key under which the value from the lower layers is stored. It contains a space, so no path can name it.
_BASE_VALUE_KEY = "base value"
# Key of the value to which the parameters of a relative distribution apply, as in
# `{relative: {to: 0.68, normal: {...}}}`.
_REFERENCE_KEY = "to"
# Fields whose values are already relative to the vehicle. Their distributions are not scaled.
_FRACTION_FIELDS = ("thrust_factor_error", "battery_sag")


def is_relative(tree: Tree) -> bool:
    """Return whether a tree is a relative distribution."""
    return isinstance(tree.value, dict) and RELATIVE in tree.value


def has_relative_items(tree: Tree) -> bool:
    """Return whether a tree is a list with a relative distribution among its items."""
    return isinstance(tree.value, list) and any(map(is_relative, tree.value))


def _contains_relative(tree: Tree) -> bool:
    """Return whether a tree is or contains a relative distribution."""
    if is_relative(tree):
        return True
    parts = tree.value.values() if isinstance(tree.value, dict) else tree.value
    return isinstance(tree.value, dict | list) and any(map(_contains_relative, parts))


def with_base_value(base: Tree, distribution: Tree) -> Tree:
    """Return a relative distribution together with the number or distribution to which it applies."""
    if is_relative(base):
        if _BASE_VALUE_KEY not in base.value:
            return distribution
        base = base.value[_BASE_VALUE_KEY]
    return distribution._replace(value={RELATIVE: distribution.value[RELATIVE], _BASE_VALUE_KEY: base})


def with_base_values(base: Tree, distributions: Tree) -> Tree:
    """Return a list in which each relative distribution is stored together with the item to which it applies."""
    if not isinstance(base.value, list) or len(base.value) != len(distributions.value):
        return distributions
    pairs = zip(base.value, distributions.value, strict=True)
    return distributions._replace(value=[with_base_value(old, new) if is_relative(new) else new for old, new in pairs])


def relative_part(tree: Tree) -> Tree | None:
    """Return the relative distributions in a tree, without the base values stored with them; None if there are none.

    A list becomes a mapping from the index of each item with a relative distribution to this distribution.
    """
    if is_relative(tree):
        return tree._replace(value={RELATIVE: tree.value[RELATIVE]})
    parts = tree.value if isinstance(tree.value, dict) else {}
    if has_relative_items(tree):
        parts = {str(i): item for i, item in enumerate(tree.value) if is_relative(item)}
    kept = {key: part for key, each in parts.items() if (part := relative_part(each)) is not None}
    return tree._replace(value=kept) if kept else None


def with_absolute_distributions(tree: Tree, nominal: Any, defaults: Any) -> tuple[Tree, dict[str, Tree]]:
    """Replace the relative distributions of `vehicle` in a scenario by ordinary distributions.

    A field that is zero or missing in the vehicle, such as body drag, gets no distribution.

    Args:
        tree: scenario with all its layers merged.
        nominal: `Nominal` of the scenario, which supplies fields that are missing in `vehicle`.
        defaults: `Vehicle` that supplies the defaults of all other fields.

    Returns:
        The scenario, and the dropped relative distributions by path. A distribution is dropped if the vehicle has no
        value to which it could apply.

    Raises:
        InputError: if a relative field is not a distribution, applies to a negative number, or is one of several items
            of a list and has no value to apply to.
    """
    vehicle = tree.value.get("vehicle")
    dropped: dict[str, Tree] = {}
    if vehicle is not None and isinstance(vehicle.value, dict) and _contains_relative(vehicle):
        fields = {}
        for name, field in vehicle.value.items():
            default = getattr(nominal, name, getattr(defaults, name, None))
            if name == "centre_of_mass":
                default = (arm_length_of(nominal),) * 2
            elif name in _FRACTION_FIELDS:
                default = 1.0
            is_unknown = name not in type(defaults).model_fields
            fields[name] = field if is_unknown else _absolute(field, default, f"vehicle.{name}", dropped)
        kept = {name: field for name, field in fields.items() if field is not None}
        tree = tree._replace(value={**tree.value, "vehicle": vehicle._replace(value=kept)})
    return tree, dropped


def _absolute(tree: Tree, reference: Any, path: str, dropped: dict[str, Tree]) -> Tree | None:
    """Replace the relative distributions in a field by ordinary distributions.

    Args:
        tree: value of the field.
        reference: default value of the field (a number, a model, a tuple or None). It is used if no layer gives a value
            that a distribution can vary.
        path: path of the field in the scenario.
        dropped: mapping to which this function adds the relative distributions that have no value to vary, by path.

    Returns:
        The field without these distributions; None if nothing else remains.
    """
    if is_relative(tree):
        base = tree.value.get(_BASE_VALUE_KEY)
        number = reference if base is None else _median(base)
        if path.split(".")[1] in (*_FRACTION_FIELDS, "centre_of_mass"):
            number = reference
        if number is None:
            dropped[path] = tree
            return None
        return _scaled(tree, number, path)
    if isinstance(tree.value, list) and _contains_relative(tree):
        references = reference if isinstance(reference, tuple) else (reference,) * len(tree.value)
        if len(references) != len(tree.value):
            return tree
        items = [
            _absolute(item, each, f"{path}.{i}", dropped)
            for i, (item, each) in enumerate(zip(tree.value, references, strict=True))
        ]
        if None not in items:
            return tree._replace(value=items)
        if not all(map(is_relative, tree.value)):
            i = items.index(None)
            raise_no_base_value(tree.value[i], f"{path}.{i}")
        return None
    if not isinstance(tree.value, dict):
        return tree
    parts = {
        key: _absolute(part, _part_of(reference, key), f"{path}.{key}", dropped) for key, part in tree.value.items()
    }
    kept = {key: part for key, part in parts.items() if part is not None}
    return None if parts and not kept else tree._replace(value=kept)


def raise_no_base_value(distribution: Tree, path: str) -> None:
    """Raise InputError, because the relative distribution of a required field has no value to which it applies."""
    raise InputError(
        f"{distribution.mark}: {join_path(*path.split('.'))} is relative, but the vehicle has no value to which the"
        " distribution could apply; make the distribution absolute"
    )


def _part_of(reference: Any, key: str) -> Any:
    """Return the field of a model, or the list item with an index, or None if it does not exist.

    If the value is a single number, it is returned for any index. The last item is returned for an index beyond the
    end, which validation rejects later.
    """
    if is_item(key) and isinstance(reference, tuple | float):
        return reference if isinstance(reference, float) else reference[min(int(key), len(reference) - 1)]
    return getattr(reference, key, None)


def _median(tree: Tree) -> float | None:
    """Return the number in a tree or the median of its distribution; None if the tree contains neither."""
    plain = tree.to_python()
    if isinstance(plain, dict):
        for name, model in DISTRIBUTIONS.items():
            if name in plain:
                try:
                    return float(model.model_validate(plain).quantile(0.5))
                except ValidationError:
                    return None
    return float(plain) if isinstance(plain, int | float) and not isinstance(plain, bool) else None


def _scaled(tree: Tree, number: float, path: str) -> Tree:
    """Scale a relative distribution for a vehicle whose field has the value `number`."""
    body = tree.value[RELATIVE]
    names = [name for name in DISTRIBUTIONS if isinstance(body.value, dict) and name in body.value]
    if len(names) != 1 or not body.value.keys() <= {names[0], _REFERENCE_KEY}:
        raise InputError(
            f"{body.mark}: {path}.relative must be one of the distributions {join_names([*DISTRIBUTIONS])}, and may"
            " also have `to`, the value to which the distribution applies"
        )
    (name,) = names
    reference = body.value[_REFERENCE_KEY].value if _REFERENCE_KEY in body.value else 1.0
    if isinstance(reference, bool) or not isinstance(reference, int | float) or not reference > 0.0:
        raise InputError(
            f"{body.value[_REFERENCE_KEY].mark}: {path}.relative.to is {short_repr(reference)}, but must be positive"
        )
    if number < 0.0:
        raise InputError(
            f"{tree.mark}: {path} is {number:g}, and a negative number has no relative distribution; make the"
            " distribution absolute"
        )
    if number == 0.0 and path.split(".")[1] not in _FRACTION_FIELDS:
        return Tree(0.0, tree.mark)
    factor = number / reference
    inside = body.value[name]
    if isinstance(inside.value, list):
        scaled = inside._replace(value=[_times(item, factor) for item in inside.value])
    elif isinstance(inside.value, dict):
        scaled = inside._replace(
            value={
                key: each if key in DISTRIBUTIONS[name].dimensionless else _times(each, factor)
                for key, each in inside.value.items()
            }
        )
    else:
        scaled = inside
    return Tree({name: scaled}, tree.mark)


def _times(tree: Tree, factor: float) -> Tree:
    """Multiply a number by a factor. Other values are returned unchanged, and validation rejects them later."""
    number = tree.value
    return (
        tree._replace(value=number * factor)
        if isinstance(number, int | float) and not isinstance(number, bool)
        else tree
    )


def refuse_outside_vehicle(tree: Tree) -> None:
    """Raise InputError if a distribution outside the section `vehicle` is relative to a nominal value."""
    for name, part in tree.value.items():
        if name != "vehicle":
            _refuse(part, name)


def _refuse(tree: Tree, path: str) -> None:
    """Raise InputError if the given part of a scenario contains a relative distribution."""
    if is_relative(tree):
        raise InputError(
            f"{tree.value[RELATIVE].mark}: {path} is relative, but only fields of `vehicle` can be relative, since"
            " only they have a nominal value; make the distribution absolute"
        )
    if isinstance(tree.value, dict | list):
        for key, part in tree.value.items() if isinstance(tree.value, dict) else enumerate(tree.value):
            _refuse(part, f"{path}.{key}")
