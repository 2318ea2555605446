"""C structs for the records (named tuples) that formulas use."""

import inspect
import re
from collections.abc import Sequence
from typing import Any, NamedTuple

from drake_quad.framework.c_code import identifier
from drake_quad.framework.records import ROW, Layout
from drake_quad.signals import Quantity, field_quantities

# Column at which the comments of struct members begin.
_COMMENT_COLUMN = 44


class StructMember(NamedTuple):
    """Member of a C struct.

    Attributes:
        type_name: C type, or type of the elements of an array.
        name: name of the member.
        comment: comment on the member; may be empty.
        sizes: sizes of an array, the first index first; empty if the member is not an array.
    """

    type_name: str
    name: str
    comment: str = ""
    sizes: tuple[int, ...] = ()

    def __str__(self) -> str:
        """Return the declaration of the member in C."""
        declaration = f"    {self.type_name} {self.name}{''.join(f'[{size}]' for size in self.sizes)};"
        return f"{declaration:{_COMMENT_COLUMN - 1}} /* {self.comment} */" if self.comment else declaration


class Struct(NamedTuple):
    """Definition of a C struct.

    Attributes:
        type_name: C type.
        comment: comment on the struct.
        members: members of the struct.
    """

    type_name: str
    comment: str
    members: Sequence[StructMember]

    def __str__(self) -> str:
        """Return the definition of the struct in C."""
        head = f"/* {self.comment} */\ntypedef struct {{"
        return "\n".join([head, *map(str, self.members), f"}} {self.type_name};", ""])


class Structs:
    """C structs of a header, one for each layout of a record or tuple.

    Args:
        prefix: prefix of the names of types.
        real: C type of a number.

    Attributes:
        definitions: definitions, each after the definitions of the structs that it contains.
    """

    def __init__(self, prefix: str, real: str) -> None:
        self.definitions: list[Struct] = []
        self._prefix, self._real = prefix, real
        self._names: dict[Layout, str] = {}

    def c_type(self, layout: Layout) -> str:
        """Return the name of the C type of a layout; the struct is defined at the first request."""
        if layout is ROW:
            return self._real
        if layout not in self._names:
            members = self._members(layout)
            base = f"{self._prefix}_{_snake_case(layout.kind.__name__) if layout.kind is not tuple else 'values'}"
            taken, name, number = {*self._names.values()}, f"{base}_t", 2
            while name in taken:
                name, number = f"{base}_{number}_t", number + 1
            self._names[layout] = name
            self.definitions.append(Struct(name, summary(layout.kind), members))
        return self._names[layout]

    def member(self, name: str, layout: Layout, comment: str = "") -> StructMember:
        """Return a struct member that has the C type of a layout."""
        return StructMember(self.c_type(layout), identifier(name), comment)

    def _field(self, name: str, layout: Layout, comment: str = "") -> StructMember:
        """Return a struct member, which is an array for a tuple of equal parts."""
        sizes: tuple[int, ...] = ()
        while layout.kind is tuple and _is_uniform(layout):
            sizes += (len(layout.parts),)
            layout = layout.parts[0]
        return StructMember(self.c_type(layout), identifier(name), comment, sizes)

    def _members(self, layout: Layout) -> list[StructMember]:
        if layout.kind is tuple:
            if _is_uniform(layout):
                return [self._field("values", layout)]
            return [self._field(f"part_{index}", part) for index, part in enumerate(layout.parts)]
        quantities, texts = field_quantities(layout.kind), _attribute_texts(layout.kind)
        return [
            self._field(name, part, _comment(texts.get(name, ""), quantities.get(name)))
            for name, part in zip(layout.kind._fields, layout.parts, strict=True)  # type: ignore[attr-defined]
            if part.num_rows
        ]


def accessors(layout: Layout) -> list[str]:
    """Return the C suffix that selects each component of a value, such as `.gains.k_p.x`."""
    if layout.kind is tuple and _is_uniform(layout):
        return [f".values{suffix}" for suffix in _element_accessors(layout)]
    return _element_accessors(layout)


def _element_accessors(layout: Layout) -> list[str]:
    if layout is ROW:
        return [""]
    if not layout.num_rows:
        return []
    if layout.kind is tuple and _is_uniform(layout):
        return [f"[{i}]{suffix}" for i, part in enumerate(layout.parts) for suffix in _element_accessors(part)]
    return [
        f".{identifier(field)}{suffix}"
        for field, part in zip(_fields(layout), layout.parts, strict=True)
        for suffix in _element_accessors(part)
    ]


def initializer(layout: Layout, texts: Sequence[str]) -> str:
    """Return the C initializer of a value, given the expression of each component."""
    text = _element_initializer(layout, iter(texts))
    return f"{{{text}}}" if layout.kind is tuple and _is_uniform(layout) else text


def _element_initializer(layout: Layout, texts: Any) -> str:
    if layout is ROW:
        return str(next(texts))
    return f"{{{', '.join(_element_initializer(part, texts) for part in layout.parts if part.num_rows)}}}"


def _fields(layout: Layout) -> Sequence[str]:
    if layout.kind is tuple:
        return [f"part_{index}" for index in range(len(layout.parts))]
    return layout.kind._fields  # type: ignore[attr-defined]


def _is_uniform(layout: Layout) -> bool:
    """Return whether all parts of a tuple have the same layout, so that it is an array in C."""
    return len(layout.parts) > 0 and all(part == layout.parts[0] for part in layout.parts)


def summary(documented: Any) -> str:
    """Return the first paragraph of a docstring, without line breaks."""
    text = (inspect.getdoc(documented) or "").split("\n\n")[0]
    return " ".join(text.replace("`", "").split()).replace("*/", "* /")


def _attribute_texts(kind: type) -> dict[str, str]:
    """Return the descriptions of the attributes in the docstring of a record."""
    _, _, section = (inspect.getdoc(kind) or "").partition("Attributes:\n")
    texts: dict[str, str] = {}
    name = ""
    for line in section.splitlines():
        match = re.match(r"^    (\w+): (.*)", line)
        if match:
            name = match[1]
            texts[name] = match[2]
        elif name and line.strip():
            texts[name] += f" {line.strip()}"
        else:
            name = ""
    return {name: text.replace("`", "").rstrip(".") for name, text in texts.items()}


def _comment(text: str, quantity: Quantity | None) -> str:
    """Return the comment on a field: its description, unit and coordinate frame."""
    if quantity is None:
        return text
    frame = {"W": "world frame", "B": "body frame"}.get(quantity.frame, "")
    unit = "" if quantity.unit == "1" else quantity.unit
    # Some descriptions contain the unit.
    unit = "" if text.endswith(f", {unit}") else unit
    return ", ".join(part for part in (text, unit, frame) if part)


def _snake_case(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name).lower()
