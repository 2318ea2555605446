"""Conversion of overrides given as Python values, such as mappings, lists, arrays and parts of scenarios."""

from collections.abc import Iterator, Mapping
from os import PathLike, fspath
from typing import Any

import numpy as np

from drake_quad.errors import InputError, short_repr, shorten_text
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.files.library import Library
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.limits import MAX_CHARACTERS, MAX_LEVELS
from drake_quad.scenario.paths import join_path, split_path

# Largest number of characters that a message shows of a path. The longest path has seventy characters.
_MAX_PATH_CHARACTERS = 80


def override_trees(fields: Mapping[Any, Any], library: Library) -> Iterator[Tree]:
    """Yield a separate document for each item of a mapping from paths to values.

    Args:
        fields: values by the path of their field, such as `vehicle.mass`. A value may itself be a mapping from paths to
            values.
        library: library of the scenario, which counts the values towards its size limits.

    Raises:
        InputError: if a key is not a path, or a value has a type that a scenario cannot contain.
    """
    for path, value in fields.items():
        mark = Mark(f"override {shorten_text(str(path), _MAX_PATH_CHARACTERS)}", 0)
        yield _Converter(mark, library).mapping({path: value}, "", 1)


class _Converter:
    """Converter of Python values to trees.

    Args:
        mark: location of the values for error messages.
        library: library of the scenario, which counts the values towards its size limits.
    """

    def __init__(self, mark: Mark, library: Library) -> None:
        self._mark, self._library = mark, library

    def tree(self, value: Any, path: str, level: int) -> Tree:
        """Convert a value to a `Tree`, and count it towards the size limits of the scenario.

        Args:
            value: value of a field.
            path: path of the field.
            level: nesting level of the value.
        """
        self._library.count(self._mark)
        if level > MAX_LEVELS:
            raise InputError(f"{self._mark}: is nested too deeply: a scenario may have at most {MAX_LEVELS} levels")
        if isinstance(value, Model):
            value = value.model_dump(mode="json")
        if isinstance(value, Mapping):
            return self.mapping(value, path, level)
        if isinstance(value, np.ndarray | np.generic):
            value = value.tolist()
        if isinstance(value, list | tuple):
            return Tree([self.tree(item, join_path(path, i), level + 1) for i, item in enumerate(value)], self._mark)
        if isinstance(value, PathLike):
            value = fspath(value)
        if not (value is None or isinstance(value, bool | int | float | str)):
            raise InputError(
                f"{self._mark}: {short_repr(value)} is a {type(value).__name__}, but must be a number, text, list or"
                " mapping"
            )
        if isinstance(value, str) and len(value) > MAX_CHARACTERS:
            raise InputError(
                f"{self._mark}: {short_repr(value)} is too long: a key or value may have at most {MAX_CHARACTERS:,}"
                " characters"
            )
        return Tree(value, self._mark)

    def mapping(self, fields: Mapping[Any, Any], path: str, level: int) -> Tree:
        """Convert a mapping from paths to values to a tree; `path` and `level` are those of the mapping itself."""
        result = Tree({}, self._mark)
        for key, value in fields.items():
            name = str(key) if isinstance(key, int) and not isinstance(key, bool) else key
            if not isinstance(name, str) or not all(name.split(".")) or len(name) > MAX_CHARACTERS:
                raise InputError(f"{self._mark}: {short_repr(key)} must be the path of a field, as in vehicle.mass")
            inside = f"{path}.{name}" if path else name
            try:
                steps = split_path(inside)[len(path.split(".")) if path else 0 :]
            except InputError as error:
                raise InputError(f"{self._mark}: {error}") from None
            if level + len(steps) > MAX_LEVELS:
                raise InputError(f"{self._mark}: is nested too deeply: a scenario may have at most {MAX_LEVELS} levels")
            tree = self.tree(value, inside, level + len(steps))
            for step in reversed(steps):
                tree = Tree({step: tree}, self._mark)
            result = _merged(result, tree)
        return result


def _merged(one: Tree, other: Tree) -> Tree:
    """Merge two parts of one mapping; the second part takes precedence.

    Unlike `merge`, this function also merges two mappings with different `kind`, since both belong to one override.
    """
    if not (isinstance(one.value, dict) and isinstance(other.value, dict)):
        return other
    both = {key: _merged(one.value[key], part) for key, part in other.value.items() if key in one.value}
    return Tree({**one.value, **other.value, **both}, other.mark)
