"""YAML files as trees, and `extends` between them."""

import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, ScalarNode, SequenceNode

from drake_quad.errors import InputError
from drake_quad.scenario.distributions import DISTRIBUTIONS
from drake_quad.scenario.trees import Mark, Tree
from drake_quad.scenario.waypoint_table import read_waypoint_table

# No scenario is near these; they stop a file whose aliases multiply or contain themselves.
_MAX_DEPTH = 40
_MAX_NODES = 20_000
_SUFFIXES = (".yaml", ".yml", ".csv")
_SCALARS = ("float", "int", "bool", "null", "str")


def read_document(path: Path) -> Tree:
    """Reads a YAML 1.2 file.

    Raises:
        InputError: it cannot be read, is not YAML, or holds a key twice, a tag or a key that is not text.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not UTF-8 text") from None
    return parse_document(text, str(path))


@functools.lru_cache(maxsize=32)
def parse_document(text: str, source: str, *, numbered: bool = True) -> Tree:
    """Parses YAML 1.2 text; the tree is not to be changed.

    Args:
        text: to parse.
        source: what errors call it.
        numbered: whether marks have line numbers.

    Raises:
        InputError: as `read_document`.
    """
    yaml = YAML(typ="safe", pure=True)
    try:
        node = yaml.compose(text)
        converter = _Converter(yaml, source, numbered)
        return Tree(None, Mark(source, 0)) if node is None else converter.tree(node, 0)
    except MarkedYAMLError as error:
        place = error.problem_mark or error.context_mark
        mark = Mark(source, place.line + 1 if numbered and place else 0)
        raise InputError(f"{mark}: is not YAML: {error.problem or error.context}") from None
    except (YAMLError, RecursionError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{source}: is not YAML: {str(error).splitlines()[0]}") from None


class _Converter:
    def __init__(self, yaml: YAML, source: str, numbered: bool) -> None:
        self._construct = yaml.constructor
        self._source, self._numbered = source, numbered
        self._count = 0

    def mark(self, node: Any) -> Mark:
        return Mark(self._source, node.start_mark.line + 1 if self._numbered else 0)

    def tree(self, node: Any, depth: int) -> Tree:
        mark = self.mark(node)
        self._count += 1
        if depth > _MAX_DEPTH or self._count > _MAX_NODES:
            raise InputError(f"{mark}: is nested too deep or too large for a scenario")
        if isinstance(node, MappingNode) and str(node.tag).endswith(":map"):
            return Tree(dict(self._items(node, depth)), mark)
        if isinstance(node, SequenceNode) and str(node.tag).endswith(":seq"):
            return Tree([self.tree(child, depth + 1) for child in node.value], mark)
        return Tree(self._scalar(node, mark), mark)

    def _items(self, node: MappingNode, depth: int) -> Iterator[tuple[str, Tree]]:
        seen: dict[str, Mark] = {}
        for key_node, value_node in node.value:
            mark = self.mark(key_node)
            key = self._scalar(key_node, mark) if isinstance(key_node, ScalarNode) else None
            if not isinstance(key, str):
                raise InputError(f"{mark}: a field's name must be text")
            if key in seen:
                raise InputError(f"{mark}: {key!r} is already given at {seen[key]}")
            seen[key] = mark
            # What a person looks for is the line of the field, not of the first entry of its value.
            yield key, Tree(self.tree(value_node, depth + 1).value, mark)

    def _scalar(self, node: Any, mark: Mark) -> Any:
        kind = str(node.tag).rpartition(":")[2]
        if not isinstance(node, ScalarNode) or kind not in _SCALARS:
            raise InputError(f"{mark}: the tag {node.tag} is not allowed; write numbers, text, lists and mappings")
        try:
            return self._construct.construct_object(node)
        except (ValueError, OverflowError):
            raise InputError(f"{mark}: {node.value[:40]} is not a number that can be read") from None


def merged(base: Tree, extension: Tree) -> Tree:
    """Returns a deep merge: mappings are joined, anything else in the extension replaces.

    A mapping of another `kind`, or a distribution, replaces as a whole: its fields mean something else.
    """
    old, new = base.value, extension.value
    if not (isinstance(old, dict) and isinstance(new, dict)):
        return extension
    other_kind = "kind" in new and "kind" in old and new["kind"].value != old["kind"].value
    if other_kind or any(name in old or name in new for name in DISTRIBUTIONS):
        return extension
    joined = {key: merged(old[key], tree) if key in old else tree for key, tree in new.items()}
    return Tree({**old, **joined}, extension.mark)


def find_scenario(spec: str | Path) -> tuple[str, Tree]:
    """Finds a scenario and merges it with what it extends.

    Args:
        spec: FILE, or FILE:NAME where the file holds several.

    Returns:
        The scenario's name and tree, without `extends`.

    Raises:
        InputError: a file or name does not exist, or extensions go in a circle.
    """
    path, name = _split(str(spec))
    return _resolve(Path(path), name, Mark(str(spec), 0), ())


def _split(spec: str) -> tuple[str, str | None]:
    path, separator, name = spec.rpartition(":")
    if separator and path.endswith(_SUFFIXES):
        return path, name
    return spec, None


def _resolve(path: Path, name: str | None, asked_by: Mark, stack: tuple[str, ...]) -> tuple[str, Tree]:
    if stack and not path.is_file():
        raise InputError(f"{asked_by}: extends {path}, which does not exist")
    document = read_waypoint_table(path) if path.suffix == ".csv" else read_document(path)
    if not isinstance(document.value, dict) or not document.value:
        raise InputError(f"{path}: holds no scenario; the first level of the file must be names of scenarios")
    names = ", ".join(document.value)
    if name is None:
        if len(document.value) > 1:
            asking = "" if str(asked_by) == str(path) else f"{asked_by}: "
            raise InputError(f"{asking}{path} holds several scenarios; choose one as {path}:NAME from {names}")
        name = next(iter(document.value))
    if name not in document.value:
        raise InputError(f"{asked_by}: there is no scenario {name!r} in {path}; it holds {names}")
    identity = f"{path.resolve()}:{name}"
    if identity in stack:
        raise InputError(f"{asked_by}: {name} extends itself")
    tree = document.value[name]
    if not isinstance(tree.value, dict):
        raise InputError(f"{tree.mark}: scenario {name} must be a mapping of fields")
    own = Tree({key: value for key, value in tree.value.items() if key != "extends"}, tree.mark)
    if "extends" not in tree.value:
        return name, own
    result: Tree | None = None
    for base_spec in _bases(tree.value["extends"]):
        base_file, base_name = _split(base_spec.value)
        in_this_file = not base_file.endswith(_SUFFIXES)
        base_path = path if in_this_file else path.parent / base_file
        _, base = _resolve(
            base_path, base_spec.value if in_this_file else base_name, base_spec.mark, (*stack, identity)
        )
        result = base if result is None else merged(result, base)
    return name, merged(result, own) if result else own


def _bases(tree: Tree) -> list[Tree]:
    bases = tree.value if isinstance(tree.value, list) else [tree]
    if not bases or not all(isinstance(base.value, str) and base.value for base in bases):
        raise InputError(f"{tree.mark}: extends must name a scenario as FILE, FILE:NAME or NAME, or several in a list")
    return bases
