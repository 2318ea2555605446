"""Tests of the layouts of records in vectors."""

from types import SimpleNamespace
from typing import Annotated, Any, NamedTuple

import pytest

from drake_quad.framework.records import ROW, layout_of, record_like
from drake_quad.signals import SIGNALS, Row, State


class Point(NamedTuple):
    x: Annotated[Row, "m"] = 0.0
    y: Row = 0.0


class Line(NamedTuple):
    width: Row
    ends: tuple[Point, Point]
    others: tuple[Point, ...] = ()
    style: Any = Point()


EXAMPLE_LINE = Line(1.0, (Point(2.0, 3.0), Point(4.0, 5.0)), (Point(6.0, 7.0),), Point(8.0, 9.0))


def test_rows_of_nested_records_are_consecutive():
    layout = layout_of(Line, EXAMPLE_LINE)
    assert layout.num_rows == 9
    assert layout.flatten(EXAMPLE_LINE) == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]
    assert layout.build([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]) == EXAMPLE_LINE
    assert isinstance(layout.build(range(9)).style, Point)
    assert layout.names == (
        "width",
        "ends.0.x",
        "ends.0.y",
        "ends.1.x",
        "ends.1.y",
        "others.0.x",
        "others.0.y",
        "style.x",
        "style.y",
    )


class WithOptionalPart(NamedTuple):
    first: Row
    point: Point | None = None
    last: Annotated[Row, "m"] | None = None


def test_fields_that_are_none_have_no_rows():
    complete, partial = WithOptionalPart(1.0, Point(2.0, 3.0), 4.0), WithOptionalPart(1.0)
    for value, names in ((complete, ("first", "point.x", "point.y", "last")), (partial, ("first",))):
        layout = layout_of(WithOptionalPart, value)
        assert layout.names == names
        assert layout.build(layout.flatten(value)) == value
    assert layout_of(WithOptionalPart) == layout_of(WithOptionalPart, partial)
    assert layout_of(WithOptionalPart, partial) != layout_of(WithOptionalPart, complete)


def test_a_field_that_is_unexpectedly_none_or_not_none_is_refused():
    complete, partial = WithOptionalPart(1.0, Point(2.0, 3.0)), WithOptionalPart(1.0)
    with pytest.raises(TypeError, match="expected None, not Point"):
        layout_of(WithOptionalPart, partial).flatten(complete)
    with pytest.raises(TypeError, match="expected Point, not NoneType"):
        layout_of(WithOptionalPart, complete).flatten(partial)


def test_types_of_fixed_length_determine_their_layout():
    assert layout_of(State).num_rows == 12
    assert layout_of(State).names == State._fields
    assert layout_of(Row) is layout_of(Annotated[Row, "s"]) is ROW
    assert ROW.names == ("",)
    assert layout_of(tuple[Row, Point]).build([1.0, 2.0, 3.0]) == (1.0, Point(2.0, 3.0))
    assert layout_of(tuple, (1.0, Point())).names == ("0", "1.x", "1.y")
    assert layout_of(Point) == layout_of(Point, Point(1.0, 2.0))


def test_plain_tuples_become_records_of_the_field_types():
    layout = layout_of(Line, Line(1.0, ((2.0, 3.0), (4.0, 5.0)), ()))
    assert layout.build(range(7)).ends == (Point(1, 2), Point(3, 4))


@pytest.mark.parametrize("kind", [int, str, Any])
def test_types_other_than_rows_records_and_tuples_are_refused(kind):
    with pytest.raises(TypeError, match="is not a type of record"):
        layout_of(kind)


@pytest.mark.parametrize("kind", [tuple[int, ...], tuple[Row, ...]])
def test_a_tuple_of_any_length_requires_an_example(kind):
    with pytest.raises(TypeError, match="tuple.* has no fixed number of parts, so its layout requires an example"):
        layout_of(kind)


def test_values_of_another_layout_are_refused():
    layout = layout_of(Line, EXAMPLE_LINE)
    with pytest.raises(ValueError, match="Line has 9 rows, not 8"):
        layout.build(range(8))
    with pytest.raises(TypeError, match="expected Line with 4 parts"):
        layout.flatten((1.0, 2.0))
    with pytest.raises(TypeError, match="expected Point, not State"):
        layout.flatten(EXAMPLE_LINE._replace(style=State(*range(12))))
    for value in (Point(), None, "1.0", 1j, [1.0], {}):
        with pytest.raises(TypeError, match=f"expected a number or a row, not {type(value).__name__}"):
            layout.flatten(EXAMPLE_LINE._replace(width=value))


class Frame(NamedTuple):
    corner: Point
    size: Row
    hole: Point | None = None
    marks: tuple[Point, ...] = ()


def test_a_record_is_built_from_attributes_of_the_same_names():
    """A tuple or an object in the source becomes a record of the field's type."""
    source = SimpleNamespace(corner=(1.0, 2.0), size=3.0, hole=SimpleNamespace(x=4.0, y=5.0), marks=(), other=6.0)
    frame = record_like(Frame, source)
    assert frame == Frame(Point(1.0, 2.0), 3.0, Point(4.0, 5.0))
    assert (type(frame.corner), type(frame.hole)) == (Point, Point)
    marks = (Point(1.0, 1.0), Point(2.0, 2.0))
    assert record_like(Frame, source, size=7.0, hole=None, marks=marks) == Frame(Point(1.0, 2.0), 7.0, None, marks)
    with pytest.raises(AttributeError, match="size"):
        record_like(Frame, SimpleNamespace(corner=(1.0, 2.0)))


def test_every_component_of_a_signal_has_a_unit():
    from drake_quad.signals import Quantity, quantities, row_names

    for name in SIGNALS:
        names, units = row_names(name, 4), quantities(name, 4)
        assert len(names) == len(units) >= 1
        assert all(quantity.unit for quantity in units)
        assert all(quantity.frame in ("", "W", "B") for quantity in units)
    assert row_names("weights", 3) == ["1", "2", "3"]
    assert quantities("wrench", 4)[0] == Quantity("N", "B")
