"""Fields in which the name of a file may stand for its contents."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

from drake_quad.errors import InputError
from drake_quad.scenario.library import Library
from drake_quad.scenario.marked_tree import Mark, Tree
from drake_quad.scenario.paths import joined

# Stands in a path for each name of a mapping.
_EACH = "*"
# Fields in which the name of a file may stand, and how a library reads it.
_FILES: dict[tuple[str, ...], Callable[..., Tree]] = {
    ("control", "network", "learned"): Library.mapping,
    ("control", "policy"): Library.policy,
    ("route", "pieces"): Library.pieces,
    ("space", "obstacles", _EACH, "points"): Library.points,
}

# Fields in which FILE:NAME names one output of a network, and the ending of such a file.
_FIELDS_WITH_OUTPUTS = ("control.policy",)
_NETWORK_ENDING = ".onnx"


def with_named_files(tree: Tree, library: Library) -> Tree:
    """Return a scenario as it is written with the contents of files in the place of their names.

    A file that is named in another is looked for beside that, as those that are extended are.

    Args:
        tree: of the scenario.
        library: that reads the files.

    Raises:
        InputError: a file does not exist, cannot be read or is something else.
    """
    for path, read in _FILES.items():
        tree = _with_file(tree, path, partial(read, library))
    return tree


def _with_file(tree: Tree, path: tuple[str, ...], read: Callable[..., Tree], parent: str = "") -> Tree:
    """Return the tree with the contents of a file in the place of its name.

    Args:
        tree: of the scenario, or a part of it.
        path: from there to the field.
        read: reads the file, given its path, and the name of an output if one is chosen.
        parent: path of the tree in the scenario.

    Raises:
        InputError: there is no such file, or `read` refuses it.
    """
    if not path:
        return read(*_named_file(tree, parent)) if isinstance(tree.value, str) else tree
    field, *inside = path
    if not isinstance(tree.value, dict):
        return tree
    fields = [field] if field != _EACH else [*tree.value]
    read_fields = {
        each: _with_file(tree.value[each], tuple(inside), read, joined(parent, each))
        for each in fields
        if each in tree.value
    }
    return Tree({**tree.value, **read_fields}, tree.mark)


def _named_file(tree: Tree, path: str) -> tuple[Path, *tuple[str, ...]]:
    """Return the file that the field at a path names, and the name of an output behind it, if there is one.

    Raises:
        InputError: there is no such file.
    """
    folder = Path(tree.mark.source).parent if tree.mark.line else Path()
    name, separator, output = tree.value.partition(f"{_NETWORK_ENDING}:")
    if separator and path in _FIELDS_WITH_OUTPUTS:
        file, outputs = folder / f"{name}{_NETWORK_ENDING}", [output]
    else:
        file, outputs = folder / tree.value, []
    if not os.path.isfile(file):  # noqa: PTH113 - Path.is_file raises where a name is too long
        flaw = "is not a file" if os.path.exists(file) else "does not exist"  # noqa: PTH110 - as above
        raise InputError(f"{tree.mark}: {path} names {Mark(str(file), 0)}, which {flaw}")
    return (file, *outputs)
