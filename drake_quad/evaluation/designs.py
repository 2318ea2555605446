"""Designed controllers as files: one for each family of laboratories, for `extends: [SCENARIO, FILE:NAME]`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from drake_quad.errors import InputError
from drake_quad.evaluation.entries import Tree
from drake_quad.files import write_atomically


def design_file(diagrams: Path, family: str) -> Path:
    """The file with the designs for a family."""
    return diagrams / "controllers" / "designed" / f"{family}.yaml"


def designs_in(path: Path) -> CommentedMap:
    """Return the designs of a file by their names; none if there is no file.

    Raises:
        InputError: the file contains no mapping.
    """
    if not path.exists():
        return CommentedMap()
    tree = _yaml().load(path)
    if not isinstance(tree, CommentedMap):
        raise InputError(f"{path} must be a mapping of controllers by their names")
    return tree


def write_designs(path: Path, designs: Mapping[str, Tree], *, said: Mapping[str, str], head: str = "") -> Path:
    """Write designs into a file atomically, and leave its other designs as they are.

    Args:
        path: of the file.
        designs: by their names.
        said: comments, by the names of the designs that they stand beside.
        head: comment at the top of the file, in place of what stands there; as it is if empty.

    Returns:
        The path.
    """
    tree = designs_in(path)
    for name, design in designs.items():
        tree[name] = _flowing(design)
        if name in said:
            tree.yaml_add_eol_comment(said[name], name)
    if head:
        tree.yaml_set_start_comment(head)
    yaml = _yaml()
    return write_atomically(path, lambda target: yaml.dump(tree, target))


def _yaml() -> Any:
    """YAML that keeps comments, with lists of numbers in a line."""
    yaml = YAML()
    yaml.width = 120
    yaml.representer.add_representer(
        type(None), lambda dumper, _: dumper.represent_scalar("tag:yaml.org,2002:null", "null")
    )
    return yaml


def _flowing(value: Any) -> Any:
    """Return a tree in which lists, and mappings of numbers and texts alone, are written in a line."""
    if isinstance(value, list):
        sequence = CommentedSeq(value)
        sequence.fa.set_flow_style()
        return sequence
    if not isinstance(value, dict):
        return value
    tree = CommentedMap({key: _flowing(part) for key, part in value.items()})
    if len(tree) > 1 and not any(isinstance(part, dict) for part in value.values()) and "kind" not in value:
        tree.fa.set_flow_style()
    return tree
