"""Trees of YAML values with their locations in a file or an override, to which error messages refer."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from drake_quad.errors import shorten_text

# A message shortens the path of a file to this number of characters. Most paths are shorter, so they remain complete.
_MAX_SOURCE_CHARACTERS = 120


class Mark(NamedTuple):
    """Location of a value in a file or an override.

    Attributes:
        source: path of the file, or text of the override.
        line: line in the file, counted from 1; 0 for an override or a whole file.
        remark: text that messages show after the location.
    """

    source: str
    line: int
    remark: str = ""

    def __str__(self) -> str:
        source = shorten_text(self.source, _MAX_SOURCE_CHARACTERS)
        return f"{source}:{self.line}{self.remark}" if self.line else f"{source}{self.remark}"


class Tree(NamedTuple):
    """Value of a YAML document with its mark.

    Attributes:
        value: dict of trees by key, list of trees, or scalar.
        mark: location of the value.
    """

    value: Any
    mark: Mark

    @classmethod
    def of(cls, value: Any, mark: Mark) -> "Tree":
        """Convert a plain value to a tree with the same mark for all its parts."""
        if isinstance(value, Mapping):
            return cls({name: cls.of(part, mark) for name, part in value.items()}, mark)
        if isinstance(value, list | tuple):
            return cls([cls.of(part, mark) for part in value], mark)
        return cls(value, mark)

    def to_python(self) -> Any:
        """Convert the tree to a plain value without marks."""
        if isinstance(self.value, dict):
            return {key: tree.to_python() for key, tree in self.value.items()}
        if isinstance(self.value, list):
            return [tree.to_python() for tree in self.value]
        return self.value

    def at(self, path: tuple[Any, ...]) -> tuple["Tree", int]:
        """Return the subtree at a path, and the number of path steps that lead to it.

        If there is no such subtree, the deepest existing subtree on the path is returned.
        """
        tree = self
        for depth, key in enumerate(path):
            inside = tree.value
            if (isinstance(inside, dict) and key in inside) or (isinstance(inside, list) and key in range(len(inside))):
                tree = inside[key]
            else:
                return tree, depth
        return tree, len(path)
