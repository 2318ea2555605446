"""Reading of files that a scenario includes by name."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

from drake_quad.errors import InputError
from drake_quad.scenario.files.library import Library
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.files.mesh_file import mesh_points
from drake_quad.scenario.files.policy_file import policy_network
from drake_quad.scenario.files.setting_lines import setting_lines
from drake_quad.scenario.paths import join_path

_WILDCARD = "*"  # element of a path that matches every key of a mapping
# Fields that may contain a file name, by path, each with a function that reads the file, given a library and the path.
_FILE_FIELDS: dict[tuple[str, ...], Callable[..., Tree]] = {
    ("control", "network", "learned"): Library.mapping,
    ("laboratory", "autopilot", "settings"): lambda _, path: setting_lines(path),
    ("laboratory", "autopilot", "parameters"): lambda _, path: setting_lines(path),
    ("control", "policy"): lambda _, path, *output: policy_network(path, *output),
    ("route", "pieces"): Library.pieces,
    ("space", "obstacles", _WILDCARD, "points"): lambda _, path: mesh_points(path),
}

# Fields whose value may be FILE:NAME, where NAME selects one of several outputs of a network.
_FIELDS_WITH_OUTPUTS = ("control.policy",)
# Suffix of network files that can have several outputs.
_NETWORK_SUFFIX = ".onnx"


def with_named_files(tree: Tree, library: Library) -> Tree:
    """Replace the file names in a scenario by the contents of the files.

    As in `extends`, a file name is relative to the folder of the file that contains it.

    Args:
        tree: scenario with file names.
        library: library that reads the files and enforces the limits on their size.

    Raises:
        InputError: if a file does not exist, cannot be read or has another format.
    """
    for path, read in _FILE_FIELDS.items():
        tree = _with_file(tree, path, partial(read, library))
    return tree


def _with_file(tree: Tree, path: tuple[str, ...], read: Callable[..., Tree], parent: str = "") -> Tree:
    """Replace one file name in a tree by the contents of the file.

    Args:
        tree: scenario, or a part of it.
        path: path of the field within the tree.
        read: function that reads the file, given its path and, if the field selects one, the name of an ONNX output.
        parent: path of the tree itself within the scenario.

    Raises:
        InputError: if the file does not exist, or `read` rejects it.
    """
    if not path:
        return read(*_named_file(tree, parent)) if isinstance(tree.value, str) else tree
    field, *inside = path
    if not isinstance(tree.value, dict):
        return tree
    fields = [field] if field != _WILDCARD else [*tree.value]
    read_fields = {
        each: _with_file(tree.value[each], tuple(inside), read, join_path(parent, each))
        for each in fields
        if each in tree.value
    }
    return Tree({**tree.value, **read_fields}, tree.mark)


def _named_file(tree: Tree, path: str) -> tuple[Path, *tuple[str, ...]]:
    """Return the path of the file that a field names, and the name of the ONNX output if the field selects one.

    Raises:
        InputError: if the file does not exist.
    """
    folder = Path(tree.mark.source).parent if tree.mark.line else Path()
    name, separator, output = tree.value.partition(f"{_NETWORK_SUFFIX}:")
    if separator and path in _FIELDS_WITH_OUTPUTS:
        file, outputs = folder / f"{name}{_NETWORK_SUFFIX}", [output]
    else:
        file, outputs = folder / tree.value, []
    if not os.path.isfile(file):  # noqa: PTH113 - Path.is_file raises an error if a name is too long
        reason = "is not a file" if os.path.exists(file) else "does not exist"  # noqa: PTH110 - as above
        raise InputError(f"{tree.mark}: {path} refers to {Mark(str(file), 0)}, which {reason}")
    return (file, *outputs)
