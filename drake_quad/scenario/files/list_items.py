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
    if not inside:
        return Tree({name: each for name, each in tree.value.items() if name != key}, tree.mark)
    return _replaced(tree, key, without(tree.value[key], tuple(inside)))


def with_items(tree: Tree, path: tuple[Any, ...], default: list[Any], items: Tree) -> Tree:
    """Return a scenario with a list that it does not contain: the default list with some items replaced.

    Args:
        tree: scenario without defaults.
        path: path of the list in the scenario.
        default: default value of the list.
        items: new items, by their index.

    Raises:
        InputError: an index is outside the list.
    """
    return _placed(tree, path, within_lists(Tree.of(default, items.mark), items, joined(*path)))


def at(value: Any, path: tuple[Any, ...]) -> Any:
    """Return the value at a path in nested mappings and lists; None if the path does not exist."""
    for key in path:
        is_there = key in value if isinstance(value, dict) else isinstance(value, list) and key in range(len(value))
        if not is_there:
            return None
        value = value[key]
    return value


def _placed(tree: Tree, path: tuple[Any, ...], part: Tree) -> Tree:
    if not path:
        return part
    key, *inside = path
    before = tree.value[key] if isinstance(tree.value, list) or key in tree.value else Tree({}, part.mark)
    return _replaced(tree, key, _placed(before, tuple(inside), part))


def _replaced(tree: Tree, key: Any, part: Tree) -> Tree:
    """Return the tree with the part at a key or index replaced."""
    if isinstance(tree.value, list):
        return Tree([part if i == key else each for i, each in enumerate(tree.value)], tree.mark)
    return Tree({**tree.value, key: part}, tree.mark)
