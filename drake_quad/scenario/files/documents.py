"""Parser of YAML 1.2 documents, with limits on their size."""

import functools
import re
from collections.abc import Iterator
from typing import Any, NamedTuple

import yaml
from yaml.reader import ReaderError

from drake_quad.errors import InputError, short_repr, shorten_text
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.limits import MAX_CHARACTERS, MAX_LEVELS, MAX_NODES

# The parser of libyaml is written in C and 20 times as fast as the Python parser. PyYAML contains it on all common
# platforms.
_PARSER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_TAG_PREFIX = "tag:yaml.org,2002:"
# Patterns of plain scalars in the core schema of YAML 1.2.2, section 10.3.2. PyYAML itself follows YAML 1.1, in which
# `on` means true.
_SCALAR_PATTERNS = {
    "null": re.compile(r"~|null|Null|NULL|"),
    "bool": re.compile(r"true|True|TRUE|false|False|FALSE"),
    "int": re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+"),
    "float": re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)"),
}
# Characters that are not printable according to YAML 1.2.2, section 5.1.
_FORBIDDEN_CHARACTER = re.compile("[^\t\n\r\x20-\x7e\x85\xa0-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


class Document(NamedTuple):
    """Content of a YAML document.

    Attributes:
        tree: values with their marks.
        nodes: number of keys and values.
    """

    tree: Tree
    nodes: int


@functools.lru_cache(maxsize=4096)
def parse_document(text: str, source: str, *, with_line_numbers: bool = True, max_nodes: int = MAX_NODES) -> Document:
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
    try:
        return _Reader(text, source, with_line_numbers, max_nodes).document()
    except yaml.MarkedYAMLError as error:
        position = error.problem_mark or error.context_mark
        mark = Mark(source, position.line + 1 if with_line_numbers and position else 0)
        raise InputError(f"{mark}: is not YAML: {shorten_text(str(error.problem or error.context), 100)}") from None
    except (ReaderError, UnicodeEncodeError):
        forbidden = _FORBIDDEN_CHARACTER.search(text)
        assert forbidden is not None
        mark = Mark(source, text.count("\n", 0, forbidden.start()) + 1 if with_line_numbers else 0)
        raise InputError(
            f"{mark}: is not YAML: it contains the character {short_repr(forbidden[0])}, which YAML does not allow"
        ) from None


class _Anchored(NamedTuple):
    """Tree with an anchor, to which aliases can refer.

    Attributes:
        tree: tree with the anchor.
        nodes: number of keys and values in the tree.
        levels: number of nested levels in the tree.
    """

    tree: Tree
    nodes: int
    levels: int


class _Reader:
    """Reader of one document.

    Reading stops at the first node beyond a limit, and the rest of the text is not parsed. The content of an alias
    counts each time that the alias occurs, since the content may include further aliases.
    """

    def __init__(self, text: str, source: str, with_line_numbers: bool, max_nodes: int) -> None:
        self._events: Iterator[Any] = yaml.parse(text, _PARSER)
        self._source, self._with_line_numbers, self._max_nodes = source, with_line_numbers, max_nodes
        self._nodes = self._level = self._deepest = 0
        self._anchors: dict[str, _Anchored] = {}

    def document(self) -> Document:
        """Return the single YAML document in the text that was passed to the constructor."""
        tree = Tree(None, Mark(self._source, 0))
        for event in self._events:
            if isinstance(event, yaml.DocumentStartEvent):
                tree = self._tree(next(self._events))
                next(self._events)  # the end of the document
                self._refuse_another_document()
        return Document(tree, max(self._nodes, 1))

    def _refuse_another_document(self) -> None:
        event = next(self._events)
        if isinstance(event, yaml.DocumentStartEvent):
            raise InputError(f"{self._mark(event)}: is not YAML: expected a single document, but another begins here")

    def _mark(self, event: Any) -> Mark:
        return Mark(self._source, event.start_mark.line + 1 if self._with_line_numbers else 0)

    def _enter(self, event: Any, nodes: int, levels: int) -> None:
        """Count nodes and nested levels, and raise an error if a limit is exceeded."""
        self._nodes += nodes
        self._deepest = max(self._deepest, self._level + levels)
        if self._nodes > self._max_nodes:
            raise InputError(
                f"{self._mark(event)}: is too large: a scenario and all that it extends may have at most"
                f" {MAX_NODES:,} keys and values"
            )
        if self._deepest > MAX_LEVELS:
            raise InputError(
                f"{self._mark(event)}: is nested too deeply: a scenario may have at most {MAX_LEVELS} levels"
            )

    def _tree(self, event: Any) -> Tree:
        if isinstance(event, yaml.AliasEvent):
            return self._aliased(event)
        nodes, deepest = self._nodes, self._deepest
        self._deepest = self._level
        self._enter(event, 1, 1)
        self._level += 1
        tree = Tree(self._value(event), self._mark(event))
        self._level -= 1
        if event.anchor is not None:
            self._anchors[event.anchor] = _Anchored(tree, self._nodes - nodes, self._deepest - self._level)
        self._deepest = max(deepest, self._deepest)
        return tree

    def _aliased(self, event: Any) -> Tree:
        if event.anchor not in self._anchors:
            raise InputError(
                f"{self._mark(event)}: is not YAML: the alias *{shorten_text(event.anchor)} must come after the"
                " value with its anchor"
            )
        anchored = self._anchors[event.anchor]
        self._enter(event, anchored.nodes, anchored.levels)
        return anchored.tree

    def _value(self, event: Any) -> Any:
        tag = (event.tag or "").removeprefix(_TAG_PREFIX)
        if isinstance(event, yaml.MappingStartEvent) and tag in ("", "!", "map"):
            return dict(self._items())
        if isinstance(event, yaml.SequenceStartEvent) and tag in ("", "!", "seq"):
            return [self._tree(item) for item in self._until(yaml.SequenceEndEvent)]
        if isinstance(event, yaml.ScalarEvent) and tag in ("", "!", "str", *_SCALAR_PATTERNS):
            return self._scalar(event, tag)
        raise InputError(
            f"{self._mark(event)}: the tag {shorten_text(event.tag)} is not allowed; write numbers, text, lists and"
            " mappings"
        )

    def _until(self, end: type[Any]) -> Iterator[Any]:
        while not isinstance(event := next(self._events), end):
            yield event

    def _items(self) -> Iterator[tuple[str, Tree]]:
        seen: dict[str, Mark] = {}
        for event in self._until(yaml.MappingEndEvent):
            mark = self._mark(event)
            key = self._tree(event).value
            if not isinstance(key, str):
                raise InputError(f"{mark}: the name of a field must be text")
            if key in seen:
                raise InputError(f"{mark}: {short_repr(key)} is already given at {seen[key]}")
            seen[key] = mark
            # Messages about a field refer to the line of its key, not to the first line of its value.
            yield key, Tree(self._tree(next(self._events)).value, mark)

    def _scalar(self, event: Any, tag: str) -> Any:
        text = event.value
        if len(text) > MAX_CHARACTERS:
            raise InputError(
                f"{self._mark(event)}: {short_repr(text)} is too long: a key or value may have at"
                f" most {MAX_CHARACTERS:,} characters"
            )
        if not tag:
            tag = _implicit_type(text) if event.implicit[0] else "str"
        if tag in ("!", "str"):
            return text
        try:
            return _converted(text, tag)
        except ValueError:
            expected = {"null": "null", "bool": "true or false"}.get(tag, "a valid number")
            raise InputError(f"{self._mark(event)}: {short_repr(text)} is not {expected}") from None


def _implicit_type(text: str) -> str:
    """Return the type of a plain scalar."""
    # YAML 1.1 allows underscores between digits, YAML 1.2 does not. Such a scalar is a mistaken number, not a text.
    digits = text.replace("_", "") if text[:1].isdecimal() else text
    return next((name for name, pattern in _SCALAR_PATTERNS.items() if pattern.fullmatch(digits)), "str")


def _converted(text: str, tag: str) -> Any:
    """Convert the text of a scalar. Raise ValueError if it is not of the type that the tag names."""
    if not _SCALAR_PATTERNS[tag].fullmatch(text) and not (tag == "float" and _SCALAR_PATTERNS["int"].fullmatch(text)):
        raise ValueError(f"{text} is not of type {tag}")
    if tag == "null":
        return None
    if tag == "bool":
        return text.lower() == "true"
    if tag == "int":
        return int(text, 0 if text[:2] in ("0o", "0x") else 10)
    return float(re.sub(r"\.(?=[inIN])", "", text))  # YAML writes .inf and .nan
