"""YAML 1.2 as trees, within limits."""

import functools
from collections.abc import Iterator
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import ScalarEvent
from ruamel.yaml.nodes import MappingNode, ScalarNode, SequenceNode
from ruamel.yaml.reader import ReaderError

from drake_quad.errors import InputError, shortened, shown
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.limits import MOST_CHARACTERS, MOST_LEVELS, MOST_NODES

_SCALARS = ("float", "int", "bool", "null", "str")


@functools.lru_cache(maxsize=256)
def parse_document(text: str, source: str, *, numbered: bool = True, most: int = MOST_NODES) -> Tree:
    """Parse YAML 1.2 text; the tree is not to be changed.

    Args:
        text: to parse.
        source: what errors call it.
        numbered: whether marks have line numbers.
        most: names and values that it may have.

    Raises:
        InputError: it is not YAML, is too large or nested too deep, or holds a key twice, a tag or a key that is not
            text.
    """
    yaml = YAML(typ="safe", pure=True)
    reader = _Reader(source, numbered, most)
    yaml.Composer = reader.of  # type: ignore[assignment] # any callable will do
    try:
        node = yaml.compose(text)
        return Tree(None, Mark(source, 0)) if node is None else reader.document(node)
    except MarkedYAMLError as error:
        place = error.problem_mark or error.context_mark
        mark = Mark(source, place.line + 1 if numbered and place else 0)
        raise InputError(f"{mark}: is not YAML: {shortened(str(error.problem or error.context), 100)}") from None
    except ReaderError as error:
        mark = Mark(source, text.count("\n", 0, error.position) + 1 if numbered else 0)
        raise InputError(f"{mark}: is not YAML: it holds {shown(text[error.position])}, which is no text") from None
    except InputError:
        raise
    except (YAMLError, ValueError) as error:
        raise InputError(f"{Mark(source, 0)}: is not YAML: {shortened(str(error).splitlines()[0], 100)}") from None


class _Reader(Composer):
    """Reader of one document: from text to nodes, and from nodes to trees.

    It stops at the first name or value beyond a limit, and does not parse the text after it. What an alias stands for
    counts again each time, since it may contain others, or itself.
    """

    def __init__(self, source: str, numbered: bool, most: int) -> None:
        self._source, self._numbered, self._most = source, numbered, most
        self._count = self._level = 0

    def of(self, loader: YAML) -> "_Reader":
        super().__init__(loader)
        self.warn_double_anchors = False  # the YAML standard allows to name something else by an anchor
        return self

    def _mark(self, place: Any) -> Mark:
        return Mark(self._source, place.line + 1 if self._numbered else 0)

    def _enter(self, place: Any) -> None:
        self._count += 1
        self._level += 1
        if self._count > self._most:
            raise InputError(
                f"{self._mark(place)}: is too large: a scenario and what it extends may have {MOST_NODES:,} names and"
                " values in all"
            )
        if self._level > MOST_LEVELS:
            raise InputError(f"{self._mark(place)}: is nested too deep: a scenario may have {MOST_LEVELS} levels")

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.parser.peek_event()
        self._enter(event.start_mark)
        if isinstance(event, ScalarEvent) and len(event.value) > MOST_CHARACTERS:
            raise InputError(
                f"{self._mark(event.start_mark)}: {shown(event.value)} is too long: a name or value may have"
                f" {MOST_CHARACTERS:,} characters"
            )
        node = super().compose_node(parent, index)
        self._level -= 1
        return node

    def document(self, node: Any) -> Tree:
        self._count = self._level = 0
        return self._tree(node)

    def _tree(self, node: Any) -> Tree:
        self._enter(node.start_mark)
        tree = Tree(self._value(node), self._mark(node.start_mark))
        self._level -= 1
        return tree

    def _value(self, node: Any) -> Any:
        if isinstance(node, MappingNode) and str(node.tag).endswith(":map"):
            return dict(self._items(node))
        if isinstance(node, SequenceNode) and str(node.tag).endswith(":seq"):
            return [self._tree(child) for child in node.value]
        return self._scalar(node)

    def _items(self, node: MappingNode) -> Iterator[tuple[str, Tree]]:
        seen: dict[str, Mark] = {}
        for key_node, value_node in node.value:
            mark = self._mark(key_node.start_mark)
            key = self._tree(key_node).value if isinstance(key_node, ScalarNode) else None
            if not isinstance(key, str):
                raise InputError(f"{mark}: a field's name must be text")
            if key in seen:
                raise InputError(f"{mark}: {shown(key)} is already given at {seen[key]}")
            seen[key] = mark
            # What a person looks for is the line of the field, not of the first entry of its value.
            yield key, Tree(self._tree(value_node).value, mark)

    def _scalar(self, node: Any) -> Any:
        mark = self._mark(node.start_mark)
        kind = str(node.tag).rpartition(":")[2]
        if not isinstance(node, ScalarNode) or kind not in _SCALARS:
            raise InputError(
                f"{mark}: the tag {shortened(str(node.tag))} is not allowed; write numbers, text, lists and mappings"
            )
        try:
            # ruamel.yaml accepts underscores between digits as in YAML 1.1, although YAML 1.2 does not allow them.
            if kind in ("int", "float") and "_" in node.value:
                raise ValueError
            return self.loader.constructor.construct_object(node)
        except (LookupError, ValueError, OverflowError):
            what = "true or false" if kind == "bool" else "a number that can be read"
            raise InputError(f"{mark}: {shown(node.value)} is not {what}") from None
