"""Files of designed controllers, one for each family of laboratories (test scenarios).

Scenarios use them by `extends: FILE:NAME`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from drake_quad.errors import InputError
from drake_quad.evaluation.entries import Tree
from drake_quad.files import write_atomically


def design_file(diagrams: Path, family: str) -> Path:
    """Return the path of the file with the designs for a family."""
    return diagrams / "controllers" / "designed" / f"{family}.yaml"


def read_designs(path: Path) -> CommentedMap:
    """Return the designs in a file, by name; an empty mapping if the file does not exist.

    Raises:
        InputError: if the file does not contain a mapping.
    """
    if not path.exists():
        return CommentedMap()
    tree = _yaml().load(path)
    if not isinstance(tree, CommentedMap):
        raise InputError(f"{path} must contain a mapping from names to controllers")
    return tree


def write_designs(path: Path, designs: Mapping[str, Tree], *, comments: Mapping[str, str], header: str = "") -> Path:
    """Write designs into a file atomically, without changing its other designs, and return the path.

    Args:
        path: path of the YAML file with the designs of a family.
        designs: fields of each design, by its name.
        comments: YAML comment after the name of each design, by name.
        header: new comment at the top of the file; if empty, the existing comment is kept.
    """
    tree = read_designs(path)
    for name, design in designs.items():
        tree[name] = _in_flow_style(design)
        if name in comments:
            tree.yaml_add_eol_comment(comments[name], name)
    if header:
        tree.yaml_set_start_comment(header)
    yaml = _yaml()
    return write_atomically(path, lambda target: yaml.dump(tree, target))


def _yaml() -> Any:
    """Return a YAML reader and writer that preserves comments and writes None as null."""
    yaml = YAML()
    yaml.width = 120
    yaml.representer.add_representer(
        type(None), lambda dumper, _: dumper.represent_scalar("tag:yaml.org,2002:null", "null")
    )
    return yaml


def _in_flow_style(value: Any) -> Any:
    """Return a copy of a tree in which lists, and flat mappings without a `kind`, are written to YAML on one line."""
    if isinstance(value, list):
        sequence = CommentedSeq(value)
        sequence.fa.set_flow_style()
        return sequence
    if not isinstance(value, dict):
        return value
    tree = CommentedMap({key: _in_flow_style(part) for key, part in value.items()})
    if len(tree) > 1 and not any(isinstance(part, dict) for part in value.values()) and "kind" not in value:
        tree.fa.set_flow_style()
    return tree
