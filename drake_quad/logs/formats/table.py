"""Reader of CSV logs: a row of names, then rows of numbers, or of vectors written as "[a, b, c]"."""

import csv
import io
from collections.abc import Sequence

import numpy as np

from drake_quad.errors import InputError, short_repr
from drake_quad.logs.conversion import Table
from drake_quad.logs.formats.log_format import LogContent, NamedMapping, best_mapping
from drake_quad.logs.record import COLUMNS
from drake_quad.logs.source import LogFile
from drake_quad.logs.units import UNITS
from drake_quad.number_parsing import parse_float

# Largest size of a CSV file. Its cells take ten times as much memory as the file.
MAX_BYTES = 50_000_000
_MAX_COLUMNS = 10_000  # a first row with more cells is not a row of column names
# Brackets and separators in a cell that contains a vector, which become spaces.
_VECTOR_PUNCTUATION = str.maketrans("[](),;", "      ")


def is_text(log: LogFile) -> bool:
    """Return whether a file begins with a line of text."""
    return bool(_text_end(log.data))


def read_table(log: LogFile, user_mapping: NamedMapping | None) -> LogContent:
    """Read the columns of a CSV file that a mapping uses.

    Args:
        log: content of the file.
        user_mapping: name and mapping; if None, the shipped mapping that uses most of the columns.

    Raises:
        InputError: if the file is too large, no mapping fits, or a cell is not a number.
    """
    text, unread = _text(log)
    (name, mapping), names = best_mapping(log, user_mapping, lambda mapping: _header(log, text, mapping.delimiter))
    header, rows, lines, remarks = _rows(log, text, mapping.delimiter)
    sources = mapping.available_sources(set(names))
    widths = {
        source.column: 4 if source.quaternion else COLUMNS[signal]
        for signal, source in sources.items()
        if source.column
    }
    assert mapping.time is not None
    needed = {mapping.time.column}.union(*(source.names for source in sources.values()))
    position = {each: header.index(each) for each in needed}
    columns = {
        each: _numbers(log, each, [row[position[each]] for row in rows], lines, widths.get(each))
        for each in sorted(needed)
    }
    time = columns.pop(mapping.time.column) * UNITS["s"][mapping.time.unit].scale
    return LogContent(
        [Table("", time, columns)],
        (name, mapping),
        (*unread, *remarks),
        tuple(each for each in names if each),
    )


def _text(log: LogFile) -> tuple[str, list[str]]:
    """Return the lines of a log before its first byte that is not text, and a remark on unread bytes, if any."""
    data = log.data
    if len(data) > MAX_BYTES:
        raise InputError(f"{log.mark}: is too large: a CSV file may have at most {MAX_BYTES:,} bytes")
    end = _text_end(data)
    remarks = [] if end == len(data) else [log.unread_remark(end, "it is not text")]
    return data[:end].decode("utf-8-sig"), remarks


def _text_end(data: bytes) -> int:
    """Return the size, in bytes, of the lines before the first byte that is not text."""
    end = len(data) if (null := data.find(b"\0")) < 0 else null
    try:
        data[:end].decode("utf-8")
    except UnicodeDecodeError as error:
        end = error.start
    return end if end == len(data) else 1 + max(data.rfind(b"\n", 0, end), data.rfind(b"\r", 0, end))


def _header(log: LogFile, text: str, delimiter: str) -> list[str]:
    start = text[: _MAX_COLUMNS * 100]
    try:
        row = next(csv.reader(io.StringIO(start, newline=""), delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        row = []
    names = [each.strip() for each in row]
    if not any(names) or len(names) > _MAX_COLUMNS:
        raise InputError(
            f"{log.mark}: is not a log in a known format: the first row of a CSV file must name its columns"
        )
    return names


def _rows(log: LogFile, text: str, delimiter: str) -> tuple[list[str], list[list[str]], list[int], list[str]]:
    """Return the names of the columns, the complete rows, their line numbers, and remarks on the other rows."""
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, skipinitialspace=True)
    header = [each.strip() for each in next(reader)]
    rows: list[list[str]] = []
    lines: list[int] = []
    short, remarks = 0, []
    try:
        for row in reader:
            if len(row) == len(header):
                rows.append(row)
                lines.append(reader.line_num)
            elif row:
                short += 1
    except csv.Error as error:
        remarks.append(f"only the lines up to {reader.line_num:,} are read: {error}")
    if short:
        remarks.append(
            f"{short:,} {'rows' if short > 1 else 'row'} left out: the number of cells is not {len(header)}, the number"
            " of names"
        )
    if rows and not text.endswith(("\n", "\r")):
        rows.pop()
        lines.pop()
        remarks.append("the last row is left out: its line has no end, so it may be truncated")
    if len(rows) < 2:
        raise InputError(f"{log.mark}: has fewer than two rows of {len(header)} cells below the column names")
    return header, rows, lines, remarks


def _numbers(log: LogFile, name: str, cells: Sequence[str], lines: Sequence[int], width: int | None) -> np.ndarray:
    """Return a column of numbers (rows,), or of vectors (rows, width); empty cells become NaN."""
    values: list[float | list[float]] = []
    for cell, line in zip(cells, lines, strict=True):
        try:
            values.append(_vector(cell, width) if width else parse_float(cell) if cell else np.nan)
        except ValueError:
            vector = f"{width} numbers as [a, b, ...]" if width and width > 1 else "a number, as [a]"
            raise InputError(
                f"{log.mark._replace(line=line)}: {short_repr(name)} is {short_repr(cell)}, but must be"
                f" {vector if width else 'a number'}"
            ) from None
    return np.array(values)


def _vector(cell: str, width: int) -> list[float]:
    parts = [parse_float(part) for part in cell.translate(_VECTOR_PUNCTUATION).split()]
    if parts and len(parts) != width:
        raise ValueError
    return parts or [np.nan] * width
