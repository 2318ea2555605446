"""Designed controllers as files: one for each family of laboratories, for `extends: [SCENARIO, FILE:NAME]`."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap

from drake_quad.errors import InputError
from drake_quad.evaluation.entries import Tree
from drake_quad.files import write_whole


def design_file(diagrams: Path, family: str) -> Path:
    """The file with the designs for a family."""
    return diagrams / "controllers" / "designed" / f"{family}.yaml"


def designs_in(path: Path) -> Mapping[str, Tree]:
    """The designs that a file has, by their names; none if there is no file.

    Raises:
        InputError: it is no mapping.
    """
    return _read(path)


def write_designs(path: Path, designs: Mapping[str, Tree], *, said: Mapping[str, str], head: str = "") -> Path:
    """Writes designs into a file, whole or not at all; others that it has stay as they are.

    Args:
        path: of the file.
        designs: by their names.
        said: comments, by the names of the designs that they stand beside.
        head: comment at the top of the file, in place of what stands there; as it is if empty.

    Returns:
        The path.
    """
    tree = _read(path)
    for name, design in designs.items():
        tree[name] = _flowing(design)
        if name in said:
            tree.yaml_add_eol_comment(said[name], name)
    if head:
        tree.yaml_set_start_comment(head)
    yaml = _yaml()
    return write_whole(path, lambda target: yaml.dump(tree, target))


def _read(path: Path) -> CommentedMap:
    if not path.exists():
        return CommentedMap()
    tree = _yaml().load(path)
    if not isinstance(tree, CommentedMap):
        raise InputError(f"{path} must be a mapping of controllers by their names")
    return tree


def _yaml() -> Any:
    """YAML that keeps comments, with lists of numbers in a line."""
    yaml = YAML()
    yaml.width = 120
    yaml.representer.add_representer(
        type(None), lambda dumper, _: dumper.represent_scalar("tag:yaml.org,2002:null", "null")
    )
    return yaml


def _flowing(value: Any) -> Any:
    """A tree in which lists, and mappings of nothing else than numbers and words, are written in a line."""
    if not isinstance(value, dict):
        return _in_a_line(value)
    branches = {key: _flowing(part) for key, part in value.items()}
    tree = CommentedMap(branches)
    if len(branches) > 1 and not any(isinstance(part, dict) for part in value.values()) and "kind" not in value:
        tree.fa.set_flow_style()
    return tree


def _in_a_line(value: Any) -> Any:
    from ruamel.yaml.comments import CommentedSeq

    if not isinstance(value, list):
        return value
    sequence = CommentedSeq(value)
    sequence.fa.set_flow_style()
    return sequence
