"""Tables of results in CSV files."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad.errors import InputError
from drake_quad.files import read_table, write_table
from drake_quad.statistics.interval import Interval


def write_rows(path: Path, rows: Iterable[Mapping[str, Any]], *, digits: int = 17) -> Path:
    """Write a table and return its path.

    Args:
        path: path of the file.
        rows: rows with the same columns. An interval is written to three columns, such as rmse, rmse_low and rmse_high.
        digits: number of significant digits; all digits by default.
    """
    columns: dict[str, list[Any]] = {}
    for row in rows:
        for name, value in row.items():
            is_interval = isinstance(value, Interval)
            names = (name, f"{name}_low", f"{name}_high") if is_interval else (name,)
            for column, cell in zip(names, value if is_interval else (value,), strict=True):
                columns.setdefault(column, []).append(cell)
    return write_table(path, columns, digits=digits)


def write_groups(
    path: Path,
    keys: Sequence[str],
    groups: Mapping[tuple[str, ...], Mapping[str, Iterable[Any]]],
    *,
    digits: int = 17,
) -> Path:
    """Write a table whose first columns name the group to which a row belongs, and return its path.

    Args:
        path: path of the file.
        keys: names of the first columns.
        groups: columns of each group, which have equal length; the dictionary keys are the group's values in the
            columns `keys`.
        digits: number of significant digits; all digits by default.
    """
    rows = (
        {**dict(zip(keys, group, strict=True)), **dict(zip(columns, cells, strict=True))}
        for group, columns in groups.items()
        for cells in zip(*columns.values(), strict=True)
    )
    return write_rows(path, rows, digits=digits)


def read_groups(
    path: Path, keys: Sequence[str], required: Sequence[str] = ()
) -> dict[tuple[str, ...], dict[str, np.ndarray]]:
    """Read a table that `write_groups` wrote, and return the columns of each group.

    Args:
        path: path of the file.
        keys: names of the columns that name the group.
        required: names of other columns that the table must have.

    Raises:
        InputError: if the file cannot be read, or lacks a column.
    """
    columns = read_columns(path, (*keys, *required))
    labels = list(zip(*(map(str, columns.pop(key)) for key in keys), strict=True))
    chosen = {group: np.array([label == group for label in labels]) for group in dict.fromkeys(labels)}
    return {group: {name: values[indices] for name, values in columns.items()} for group, indices in chosen.items()}


def read_columns(path: Path, required: Sequence[str]) -> dict[str, np.ndarray]:
    """Read a table, and return all its columns.

    Args:
        path: path of the file.
        required: names of the columns that the table must have.

    Raises:
        InputError: if the file cannot be read, or lacks a required column.
    """
    columns = read_table(path)
    for name in required:
        if name not in columns:
            raise InputError(f"{path} has no column {name}")
    return columns
