"""Overrides that are given as Python's values: mappings, lists, numbers of Python and NumPy, parts of scenarios."""

from collections.abc import Iterator, Mapping
from os import PathLike, fspath
from typing import Any

import numpy as np

from drake_quad.errors import InputError, shortened, shown
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.files.library import Library
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.limits import MOST_CHARACTERS, MOST_LEVELS
from drake_quad.scenario.paths import joined, steps_of

# Characters of the path of a field that a message shows; the longest path has seventy.
_MOST_OF_A_PATH = 80


def given_trees(fields: Mapping[Any, Any], library: Library) -> Iterator[Tree]:
    """Yield a document for each field of a mapping from their paths to values.

    Args:
        fields: by their paths, such as `vehicle.mass`; values may be mappings of paths again.
        library: of the scenario, within whose limits they stay.

    Raises:
        InputError: a path is none, or a value is something that no scenario holds.
    """
    for path, value in fields.items():
        mark = Mark(f"override {shortened(str(path), _MOST_OF_A_PATH)}", 0)
        yield _Values(mark, library).mapping({path: value}, "", 1)


class _Values:
    """From Python's values to trees.

    Args:
        mark: what errors call them.
        library: within whose limits they stay.
    """

    def __init__(self, mark: Mark, library: Library) -> None:
        self._mark, self._library = mark, library

    def tree(self, value: Any, path: str, level: int) -> Tree:
        """Return the tree of a value.

        Args:
            value: of the field.
            path: of the field.
            level: how deep it is.
        """
        self._library.count(self._mark)
        if level > MOST_LEVELS:
            raise InputError(f"{self._mark}: is nested too deep: a scenario may have {MOST_LEVELS} levels")
        if isinstance(value, Model):
            value = value.model_dump(mode="json")
        if isinstance(value, Mapping):
            return self.mapping(value, path, level)
        if isinstance(value, np.ndarray | np.generic):
            value = value.tolist()
        if isinstance(value, list | tuple):
            return Tree([self.tree(item, joined(path, i), level + 1) for i, item in enumerate(value)], self._mark)
        if isinstance(value, PathLike):
            value = fspath(value)
        if not (value is None or isinstance(value, bool | int | float | str)):
            raise InputError(
                f"{self._mark}: {shown(value)} is a {type(value).__name__}, but must be a number, text, list or mapping"
            )
        if isinstance(value, str) and len(value) > MOST_CHARACTERS:
            raise InputError(
                f"{self._mark}: {shown(value)} is too long: a name or value may have {MOST_CHARACTERS:,} characters"
            )
        return Tree(value, self._mark)

    def mapping(self, fields: Mapping[Any, Any], path: str, level: int) -> Tree:
        """Return the tree of a mapping from paths to values, where the mapping itself is at a path."""
        result = Tree({}, self._mark)
        for key, value in fields.items():
            name = str(key) if isinstance(key, int) and not isinstance(key, bool) else key
            if not isinstance(name, str) or not all(name.split(".")) or len(name) > MOST_CHARACTERS:
                raise InputError(f"{self._mark}: {shown(key)} must be the path of a field, as in vehicle.mass")
            inside = f"{path}.{name}" if path else name
            try:
                steps = steps_of(inside)[len(path.split(".")) if path else 0 :]
            except InputError as error:
                raise InputError(f"{self._mark}: {error}") from None
            if level + len(steps) > MOST_LEVELS:
                raise InputError(f"{self._mark}: is nested too deep: a scenario may have {MOST_LEVELS} levels")
            tree = self.tree(value, inside, level + len(steps))
            for step in reversed(steps):
                tree = Tree({step: tree}, self._mark)
            result = _united(result, tree)
        return result


def _united(one: Tree, other: Tree) -> Tree:
    """Return the union of two parts of one mapping; if a field is in both, the second value counts.

    Unlike `merged`, this function does not replace a mapping of another kind, since both parts belong together.
    """
    if not (isinstance(one.value, dict) and isinstance(other.value, dict)):
        return other
    both = {key: _united(one.value[key], part) for key, part in other.value.items() if key in one.value}
    return Tree({**one.value, **other.value, **both}, other.mark)
