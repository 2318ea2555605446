"""Layout of records in a vector.

A row is a quantity that has one value for each vehicle. A record is a NamedTuple whose fields are rows, other records,
or tuples of rows or records. The vector contains the rows of all fields in order, at any depth of nesting: for example
a vehicle's mass, then its three moments of inertia.

The types of the fields determine the layout, with two exceptions, for which an example of the record is required. The
example determines the length of a tuple of any length (`tuple[Row, ...]`), and whether an optional field (`Record |
None`) is None. A field that is None has no rows.
"""

import functools
from collections.abc import Iterator, Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from drake_quad.signals import Row, field_quantities

_Record = TypeVar("_Record", bound=tuple[Any, ...])


class Layout(NamedTuple):
    """Layout of a value: its type, the layouts of its parts, and its number of rows.

    Attributes:
        kind: a NamedTuple class, or `tuple`; `float` for a single row, and `NoneType` for None.
        parts: layouts of the parts of a record or tuple, in order.
        num_rows: total number of rows.
    """

    kind: type
    parts: tuple["Layout", ...]
    num_rows: int

    def build(self, rows: Sequence[Any]) -> Any:
        """Return a value of this layout, given its rows.

        Raises:
            ValueError: if the number of rows does not match the layout.
        """
        if len(rows) != self.num_rows:
            raise ValueError(f"{self} has {self.num_rows} rows, not {len(rows)}")
        return self._take(iter(rows))

    def flatten(self, value: Any) -> list[Any]:
        """Return the rows of a value.

        Raises:
            TypeError: if the value does not have this layout.
        """
        rows: list[Any] = []
        self._flatten(value, rows)
        return rows

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the rows: field names and indices, joined by dots; an empty name if the value is a single row."""
        steps = self.kind._fields if hasattr(self.kind, "_fields") else map(str, range(len(self.parts)))
        inside = [f"{step}.{name}".rstrip(".") for step, part in zip(steps, self.parts) for name in part.names]
        return tuple(inside) if self is not ROW else ("",)

    def __str__(self) -> str:
        """Return the name of the type, for error messages."""
        return {float: "a row", NoneType: "None"}.get(self.kind, self.kind.__name__)

    def _take(self, rows: Iterator[Any]) -> Any:
        if self is ROW:
            return next(rows)
        if self is ABSENT:
            return None
        parts = [part._take(rows) for part in self.parts]
        return tuple(parts) if self.kind is tuple else self.kind(*parts)

    def _flatten(self, value: Any, rows: list[Any]) -> None:
        if self is ROW:
            if value is None or isinstance(value, _REJECTED_TYPES):
                raise TypeError(f"expected a number or a row, not {type(value).__name__}")
            rows.append(value)
            return
        if (self is ABSENT) != (value is None):
            raise TypeError(f"expected {self}, not {type(value).__name__}")
        if value is None:
            return
        if hasattr(type(value), "_fields") and type(value) is not self.kind:
            raise TypeError(f"expected {self}, not {type(value).__name__}")
        if not isinstance(value, tuple | list) or len(value) != len(self.parts):
            raise TypeError(f"expected {self} with {len(self.parts)} parts, not {value!r}")
        for part, inside in zip(self.parts, value, strict=True):
            part._flatten(inside, rows)


# Types that are rejected where a row is expected. A formula may return them by mistake.
_REJECTED_TYPES = (tuple, list, dict, str, bytes, complex)
ROW = Layout(float, (), 1)
"""Layout of a single row."""
ABSENT = Layout(NoneType, (), 0)
"""Layout of None, which has no rows."""


def rows_layout(num_rows: int) -> Layout:
    """Return the layout of a tuple of `num_rows` rows."""
    return Layout(tuple, (ROW,) * num_rows, num_rows)


def layout_of(kind: Any, value: Any = None) -> Layout:
    """Return the layout of a row, a record or a tuple, given its type.

    Args:
        kind: type as in an annotation: a row, a record, or a tuple of rows or records.
        value: example of the type, which is required if the type contains tuples of any length.

    Raises:
        TypeError: if `kind` is another type, or if a required example is missing.
    """
    return _layout_without_example(kind) if value is None else _layout(kind, value)


@functools.cache
def _layout_without_example(kind: Any) -> Layout:
    return _layout(kind, None)


def _layout(kind: Any, value: Any) -> Layout:
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
                raise TypeError(f"{kind} has no fixed number of parts, so its layout requires an example")
            inside = inside[:1] * len(value)
        return _layout_of_parts(tuple, inside, value)
    if kind is tuple and value is not None:
        return _layout_of_parts(tuple, [type(part) if isinstance(part, tuple) else Row for part in value], value)
    if isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields"):
        return _layout_of_parts(kind, _field_types(kind), value)
    raise TypeError(f"{kind} is not a type of record; use Row, a NamedTuple of rows, or a tuple of these")


def _layout_of_parts(kind: type, types: Sequence[Any], value: Any) -> Layout:
    values = [None] * len(types) if value is None else value
    parts = tuple([_layout(inside, example) for inside, example in zip(types, values, strict=True)])
    return Layout(kind, parts, sum(part.num_rows for part in parts))


@functools.cache
def _field_types(kind: Any) -> tuple[Any, ...]:
    hints = get_type_hints(kind)
    return tuple([hints[name] for name in kind._fields])


def record_like(kind: type[_Record], source: Any, **overrides: Any) -> _Record:
    """Return a record whose fields are the attributes of the same names of another object.

    If a field's type is a record, the source's tuple or model is converted to this record.

    Args:
        kind: type of the record.
        source: object with the attributes, such as a model of the scenario language.
        overrides: values of fields that are not attributes of the source.

    Raises:
        AttributeError: if a field is neither an attribute of the source nor in `overrides`.
    """
    names = kind._fields  # type: ignore[attr-defined]
    values = [overrides[name] if name in overrides else getattr(source, name) for name in names]
    return kind(*map(_converted, _field_types(kind), values))


def _converted(kind: Any, value: Any) -> Any:
    """Return the value of a field, converted to a record if that is the field's type."""
    choices = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    records = [choice for choice in choices if hasattr(choice, "_fields")]
    if len(records) != 1 or value is None or hasattr(value, "_fields"):
        return value
    return records[0](*value) if isinstance(value, tuple) else record_like(records[0], value)


def check_signs(record: Any, path: str = "parameters") -> None:
    """Raise ValueError if a number in a record has a sign that its field's `Quantity` forbids.

    Args:
        record: record, or tuple of records, of numbers or (N,) arrays.
        path: name of the record for error messages.
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
        is_right = numbers > 0.0 if quantity.sign == "positive" else numbers >= 0.0
        if not is_right.all():
            condition = "larger than 0" if quantity.sign == "positive" else "at least 0"
            raise ValueError(
                f"{path}.{name} is {numbers[~is_right].flat[0]:g} {quantity.unit}, but must be {condition}"
            )
