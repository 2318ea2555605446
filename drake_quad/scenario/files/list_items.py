"""Access to list items by index in a path, as in `vehicle.inertia.0`."""

from typing import Any

from drake_quad.errors import InputError, shortened
from drake_quad.scenario.files.layers import merged
from drake_quad.scenario.files.marked_tree import Tree
from drake_quad.scenario.paths import is_item, joined


def within_lists(tree: Tree, override: Tree, path: str = "") -> Tree:
    """Return an override in which whole lists replace items that are given by index.

    Args:
        tree: part of the scenario to which the override applies.
        override: override of this part.
        path: path of this part in the scenario.

    Raises:
        InputError: if the override has an index that is outside the list.
    """
    old, new = tree.value, override.value
    if isinstance(old, dict) and isinstance(new, dict):
        known = {
            key: within_lists(old[key], value, joined(path, key)) if key in old else value for key, value in new.items()
        }
        return Tree(known, override.mark)
    if isinstance(old, list) and isinstance(new, dict) and new and all(map(is_item, new)):
        items = {str(i): item for i, item in enumerate(old)}
        for key, value in new.items():
            if key not in items:
                there = f"its items are {joined(path, 0)} to {joined(path, len(old) - 1)}" if old else "it is empty"
                raise InputError(f"{override.mark}: {path} has no item {shortened(key)}; {there}")
            items[key] = merged(items[key], within_lists(items[key], value, joined(path, key)))
        return Tree([*items.values()], override.mark)
    return override


def without(tree: Tree, path: tuple[Any, ...]) -> Tree:
    """Return the tree without the field at a path."""
    key, *inside = path
    parts = tree.value.copy()
    if inside:
        parts[key] = without(parts[key], tuple(inside))
    else:
        del parts[key]
    return Tree(parts, tree.mark)
