"""How a record stands in the rows of a vector.

A record is a NamedTuple whose fields are rows, other records, or tuples of either. Its rows are those of its fields,
one after another, whatever they are nested in: a vehicle's mass, then its three moments of inertia, and so on.

The types of the fields say which records are inside. How many there are in a tuple of any length (`tuple[Row, ...]`)
only a value can say, and the layout of such a record is that of a value. A field that may be None (`Record | None`) has
rows only in the layout of a value in which it is not.
"""

import functools
from collections.abc import Iterator, Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from drake_quad.signals import Row, field_quantities

_Record = TypeVar("_Record", bound=tuple[Any, ...])


class Layout(NamedTuple):
    """Which rows a value is made of, and of what kind it is.

    Attributes:
        kind: a NamedTuple class, or `tuple`; `float` for a single row, `NoneType` for a part that is not there.
        parts: of a record or tuple, one after another.
        num_rows: of the value.
    """

    kind: type
    parts: tuple["Layout", ...]
    num_rows: int

    def build(self, rows: Sequence[Any]) -> Any:
        """The value of these rows.

        Raises:
            ValueError: there are too many or too few.
        """
        if len(rows) != self.num_rows:
            raise ValueError(f"{self} has {self.num_rows} rows, not {len(rows)}")
        return self._built(iter(rows))

    def flatten(self, value: Any) -> list[Any]:
        """The rows of a value.

        Raises:
            TypeError: it is made of other parts.
        """
        rows: list[Any] = []
        self._flatten(value, rows)
        return rows

    @property
    def names(self) -> tuple[str, ...]:
        """What the rows are called: the fields and places on the way, joined by dots; empty for a row alone."""
        steps = self.kind._fields if hasattr(self.kind, "_fields") else map(str, range(len(self.parts)))
        inside = [f"{step}.{name}".rstrip(".") for step, part in zip(steps, self.parts) for name in part.names]
        return tuple(inside) if self is not ROW else ("",)

    def __str__(self) -> str:
        """The name of the type."""
        return {float: "a row", NoneType: "nothing"}.get(self.kind, self.kind.__name__)

    def _built(self, rows: Iterator[Any]) -> Any:
        if self is ROW:
            return next(rows)
        if self is ABSENT:
            return None
        parts = [part._built(rows) for part in self.parts]
        return tuple(parts) if self.kind is tuple else self.kind(*parts)

    def _flatten(self, value: Any, rows: list[Any]) -> None:
        if self is ROW:
            if value is None or isinstance(value, _NO_ROWS):
                raise TypeError(f"a number or a row is wanted, not {type(value).__name__}")
            rows.append(value)
            return
        if (self is ABSENT) != (value is None):
            raise TypeError(f"{self} is wanted, not {type(value).__name__}")
        if value is None:
            return
        if hasattr(type(value), "_fields") and type(value) is not self.kind:
            raise TypeError(f"{self} is wanted, not {type(value).__name__}")
        if not isinstance(value, tuple | list) or len(value) != len(self.parts):
            raise TypeError(f"{self} is made of {len(self.parts)} parts, which {value!r} has not")
        for part, inside in zip(self.parts, value, strict=True):
            part._flatten(inside, rows)


# Types of values that a formula may return by mistake where a row is expected.
_NO_ROWS = (tuple, list, dict, str, bytes, complex)
ROW = Layout(float, (), 1)
ABSENT = Layout(NoneType, (), 0)


def rows_layout(num_rows: int) -> Layout:
    """The layout of so many rows without names."""
    return Layout(tuple, (ROW,) * num_rows, num_rows)


def layout_of(kind: Any, value: Any = None) -> Layout:
    """The layout of a type of rows.

    Args:
        kind: a row, a record, or a tuple of them, as an annotation says it.
        value: an example; needed where there are tuples of any length.

    Raises:
        TypeError: it is no such type, or an example is missing.
    """
    return _fixed(kind) if value is None else _like(kind, value)


@functools.cache
def _fixed(kind: Any) -> Layout:
    return _like(kind, None)


def _like(kind: Any, value: Any) -> Layout:
    if hasattr(type(value), "_fields"):
        kind = type(value)
    if get_origin(kind) in (Union, UnionType):
        if value is None:
            return ABSENT
        (kind,) = (choice for choice in get_args(kind) if choice is not NoneType)
    if get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    if kind is Row:
        return ROW
    if get_origin(kind) is tuple:
        inside = get_args(kind)
        if len(inside) == 2 and inside[1] is Ellipsis:
            if value is None:
                raise TypeError(f"how many parts {kind} has only a value can say")
            inside = inside[:1] * len(value)
        return _joined(tuple, inside, value)
    if kind is tuple and value is not None:
        return _joined(tuple, [type(part) if isinstance(part, tuple) else Row for part in value], value)
    if isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields"):
        return _joined(kind, _field_types(kind), value)
    raise TypeError(f"{kind} is no type of rows")


def _joined(kind: type, types: Sequence[Any], value: Any) -> Layout:
    values = [None] * len(types) if value is None else value
    parts = tuple([_like(inside, example) for inside, example in zip(types, values, strict=True)])
    return Layout(kind, parts, sum(part.num_rows for part in parts))


@functools.cache
def _field_types(kind: Any) -> tuple[Any, ...]:
    hints = get_type_hints(kind)
    return tuple([hints[name] for name in kind._fields])


def record_like(kind: type[_Record], source: Any, **given: Any) -> _Record:
    """Return a record whose fields have the values of the attributes of the same names.

    A tuple becomes the record that the type of the field names, and a model inside of the source is treated likewise.

    Args:
        kind: type of the record.
        source: object with the attributes, such as a model of the scenario language.
        given: values of fields that the source does not have.

    Raises:
        AttributeError: the source lacks a field that is not given.
    """
    names = kind._fields  # type: ignore[attr-defined]
    values = [given[name] if name in given else getattr(source, name) for name in names]
    return kind(*map(_nested, _field_types(kind), values))


def _nested(kind: Any, value: Any) -> Any:
    """Return the value of a field, as the record that its type names if that is one."""
    choices = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    records = [choice for choice in choices if hasattr(choice, "_fields")]
    if len(records) != 1 or value is None or hasattr(value, "_fields"):
        return value
    return records[0](*value) if isinstance(value, tuple) else record_like(records[0], value)


def check_signs(record: Any, path: str = "numbers") -> None:
    """Raise ValueError if a number in a record lacks the sign that the `Quantity` of its field demands.

    Args:
        record: record, or tuple of records, of numbers or (N,) arrays.
        path: name of the record for messages.
    """
    if not isinstance(record, tuple):
        return
    quantities = field_quantities(type(record)) if hasattr(record, "_fields") else {}
    names = record._fields if hasattr(record, "_fields") else range(len(record))
    for name, value in zip(names, record, strict=True):
        quantity = quantities.get(name)
        if quantity is None or not quantity.sign or value is None:
            check_signs(value, f"{path}.{name}")
            continue
        numbers = np.asarray(value, dtype=float)
        right = numbers > 0.0 if quantity.sign == "positive" else numbers >= 0.0
        if not right.all():
            least = "larger than 0" if quantity.sign == "positive" else "at least 0"
            raise ValueError(f"{path}.{name} is {numbers[~right].flat[0]:g} {quantity.unit}, but must be {least}")
