"""Parser for CSV tables of numbers with named columns."""

import csv
import io
import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from drake_quad.errors import InputError, short_repr
from drake_quad.number_parsing import parse_float
from drake_quad.scenario.files.marked_tree import Mark
from drake_quad.scenario.limits import MAX_WAYPOINTS

Row = tuple[Mark, dict[str, float | None]]
"""Location of a row in its file, and its numbers by column, with None for an empty cell."""


class TableFormat(NamedTuple):
    """Format of a table.

    Attributes:
        content: word for the rows in error messages, such as "waypoints".
        columns: names of all columns that a table may have.
        description: text that lists the column names in error messages.
        required: columns that a table must have.
        default: columns of a table without a header row.
        optional: columns whose cells may be empty.
    """

    content: str
    columns: tuple[str, ...]
    description: str
    required: tuple[str, ...]
    default: tuple[str, ...]
    optional: tuple[str, ...] = ()


def table_rows(text: str, path: Path, table: TableFormat) -> list[Row]:
    """Parse a table.

    Empty lines, lines that begin with #, and empty cells after the last column are ignored.

    Args:
        text: text of the file.
        path: path of the file, for messages.
        table: format of the table.

    Raises:
        InputError: if the text is not such a table, or has no rows or too many.
    """
    file = Mark(str(path), 0)
    rows = list(_filled_rows(text, file, table))
    names = [cell.lower() for cell in rows[0][1]] if rows else []
    while names and not names[-1]:
        names.pop()
    if not all(_number_in(name) is not None for name in names):
        _check_names(names, rows.pop(0)[0], table)
    elif rows and len(names) != len(table.default):
        columns = f"a table with {len(names)} columns needs a first row with their names"
        raise InputError(f"{rows[0][0]}: {columns}: {table.description}")
    else:
        names = [*table.default]
    if not rows:
        raise InputError(f"{file}: contains no {table.content}")
    return [(mark, _numbers(names, cells, mark, table)) for mark, cells in rows]


def _filled_rows(text: str, file: Mark, table: TableFormat) -> Iterator[tuple[Mark, list[str]]]:
    """Yield the location and the cells of each row that is not empty and not a comment."""
    reader = csv.reader(io.StringIO(text, newline=""))
    count = 0
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if not any(cells) or cells[0].startswith("#"):
                continue
            mark = file._replace(line=reader.line_num)
            count += 1
            if count > MAX_WAYPOINTS + 1:  # one row may contain the names of the columns
                limit = f"a route may have at most {MAX_WAYPOINTS:,} {table.content}"
                raise InputError(f"{mark}: the table has too many rows: {limit}")
            yield mark, cells
    except csv.Error:
        raise InputError(f"{file}: is not a CSV file") from None


def _check_names(names: list[str], mark: Mark, table: TableFormat) -> None:
    unknown = next((name for name in names if name not in table.columns), None)
    if unknown is not None:
        raise InputError(f"{mark}: the column {short_repr(unknown)} is unknown; allowed are {table.description}")
    for name in table.required:
        if name not in names:
            raise InputError(f"{mark}: the column {name} is missing")
    if len(set(names)) < len(names):
        raise InputError(f"{mark}: two columns have the same name")


def _numbers(names: list[str], cells: list[str], mark: Mark, table: TableFormat) -> dict[str, float | None]:
    """Return the numbers of a row by column."""
    if len(cells) < len(names) or any(cells[len(names) :]):
        raise InputError(f"{mark}: has {len(cells)} cells, but the table has {len(names)} columns")
    numbers = {name: _number_in(cell) for name, cell in zip(names, cells)}
    for name, cell in zip(names, cells):
        if numbers[name] is None and (cell or name not in table.optional):
            raise InputError(f"{mark}: {name} is {short_repr(cell)}, but must be a finite number")
    return numbers


def _number_in(cell: str) -> float | None:
    """Return the number in a cell, or None if the cell does not contain a finite number."""
    try:
        number = parse_float(cell)
    except ValueError:
        return None
    return number if math.isfinite(number) else None
