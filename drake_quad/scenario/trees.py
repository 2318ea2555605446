"""Documents as trees that remember where everything was written."""

from typing import Any, NamedTuple


class Mark(NamedTuple):
    """Where something was written: a file and a line, or an argument of the command line and 0."""

    source: str
    line: int

    def __str__(self) -> str:
        return f"{self.source}:{self.line}" if self.line else self.source


class Tree(NamedTuple):
    """A value of a YAML document with its mark; `value` is a dict or list of trees, or a plain scalar."""

    value: Any
    mark: Mark

    def plain(self) -> Any:
        """The value without marks."""
        if isinstance(self.value, dict):
            return {key: tree.plain() for key, tree in self.value.items()}
        if isinstance(self.value, list):
            return [tree.plain() for tree in self.value]
        return self.value

    def at(self, path: tuple[Any, ...]) -> tuple["Tree", int]:
        """The subtree at a path, or the deepest one on the way there, and how far down the path that is."""
        tree = self
        for depth, key in enumerate(path):
            inside = tree.value
            if (isinstance(inside, dict) and key in inside) or (isinstance(inside, list) and key in range(len(inside))):
                tree = inside[key]
            else:
                return tree, depth
        return tree, len(path)
