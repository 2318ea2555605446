"""Parser of YAML 1.2 documents, with limits on their size."""

import functools
from collections.abc import Iterator
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.events import ScalarEvent
from ruamel.yaml.nodes import MappingNode, ScalarNode, SequenceNode
from ruamel.yaml.reader import ReaderError

from drake_quad.errors import InputError, short_repr, shorten_text
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.limits import MAX_CHARACTERS, MAX_LEVELS, MAX_NODES

_SCALAR_TYPES = ("float", "int", "bool", "null", "str")


@functools.lru_cache(maxsize=4096)
def parse_document(text: str, source: str, *, with_line_numbers: bool = True, max_nodes: int = MAX_NODES) -> Tree:
    """Parse YAML 1.2 text. The result is cached, so callers must not change it.

    Args:
        text: text of the document.
        source: name of the document in error messages.
        with_line_numbers: True to add line numbers to the marks.
        max_nodes: largest number of YAML nodes (keys and values) that is accepted.

    Raises:
        InputError: if the text is not YAML, is too large or nested too deeply, or contains a duplicate key, a key that
            is not text, or a tag.
    """
    yaml = YAML(typ="safe", pure=True)
    reader = _Reader(source, with_line_numbers, max_nodes)
    yaml.Composer = reader.of  # type: ignore[assignment] # any callable will do
    try:
        node = yaml.compose(text)
        return Tree(None, Mark(source, 0)) if node is None else reader.document(node)
    except MarkedYAMLError as error:
        position = error.problem_mark or error.context_mark
        mark = Mark(source, position.line + 1 if with_line_numbers and position else 0)
        raise InputError(f"{mark}: is not YAML: {shorten_text(str(error.problem or error.context), 100)}") from None
    except ReaderError as error:
        mark = Mark(source, text.count("\n", 0, error.position) + 1 if with_line_numbers else 0)
        raise InputError(
            f"{mark}: is not YAML: it contains the character {short_repr(text[error.position])}, which YAML does not"
            " allow"
        ) from None
    except InputError:
        raise
    except (YAMLError, ValueError) as error:
        raise InputError(f"{Mark(source, 0)}: is not YAML: {shorten_text(str(error).splitlines()[0], 100)}") from None


class _Reader(Composer):
    """Reader of one document, which converts text to nodes, and nodes to trees.

    Reading stops at the first node beyond a limit, and the rest of the text is not parsed. The content of an alias
    counts each time that the alias occurs, since the content may include further aliases or the alias itself.
    """

    def __init__(self, source: str, with_line_numbers: bool, max_nodes: int) -> None:
        self._source, self._with_line_numbers, self._max_nodes = source, with_line_numbers, max_nodes
        self._count = self._level = 0

    def of(self, loader: YAML) -> "_Reader":
        super().__init__(loader)
        self.warn_double_anchors = False  # the YAML standard allows an anchor to be redefined
        return self

    def _mark(self, position: Any) -> Mark:
        return Mark(self._source, position.line + 1 if self._with_line_numbers else 0)

    def _enter(self, position: Any) -> None:
        self._count += 1
        self._level += 1
        if self._count > self._max_nodes:
            raise InputError(
                f"{self._mark(position)}: is too large: a scenario and all that it extends may have at most"
                f" {MAX_NODES:,} keys and values"
            )
        if self._level > MAX_LEVELS:
            raise InputError(
                f"{self._mark(position)}: is nested too deeply: a scenario may have at most {MAX_LEVELS} levels"
            )

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.parser.peek_event()
        self._enter(event.start_mark)
        if isinstance(event, ScalarEvent) and len(event.value) > MAX_CHARACTERS:
            raise InputError(
                f"{self._mark(event.start_mark)}: {short_repr(event.value)} is too long: a key or value may have at"
                f" most {MAX_CHARACTERS:,} characters"
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
                raise InputError(f"{mark}: {short_repr(key)} is already given at {seen[key]}")
            seen[key] = mark
            # Messages about a field refer to the line of its key, not to the first line of its value.
            yield key, Tree(self._tree(value_node).value, mark)

    def _scalar(self, node: Any) -> Any:
        mark = self._mark(node.start_mark)
        kind = str(node.tag).rpartition(":")[2]
        if not isinstance(node, ScalarNode) or kind not in _SCALAR_TYPES:
            raise InputError(
                f"{mark}: the tag {shorten_text(str(node.tag))} is not allowed; write numbers, text, lists and mappings"
            )
        try:
            # ruamel.yaml accepts underscores between digits, which YAML 1.1 allows but YAML 1.2 does not.
            if kind in ("int", "float") and "_" in node.value:
                raise ValueError
            return self.loader.constructor.construct_object(node)
        except (LookupError, ValueError, OverflowError):
            expected = "true or false" if kind == "bool" else "a valid number"
            raise InputError(f"{mark}: {short_repr(node.value)} is not {expected}") from None
