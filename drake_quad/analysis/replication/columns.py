"""Tables of columns as CSV; numbers come back as they were."""

import csv
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from drake_quad.errors import InputError
from drake_quad.files import write_whole


def write_columns(path: Path, columns: Mapping[str, Iterable[Any]]) -> Path:
    """Writes columns of equal length, numbers and words, and returns the path."""
    rows = zip(*(map(_cell, values) for values in columns.values()), strict=True)

    def write(target: Path) -> None:
        with target.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(rows)

    return write_whole(path, write)


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return value
    return "" if np.isnan(value) else repr(value.item() if isinstance(value, np.generic) else value)


def read_columns(path: Path) -> dict[str, np.ndarray]:
    """Reads what `write_columns` wrote: arrays of numbers where every cell is one or empty, else of words.

    Raises:
        InputError: the file cannot be read, or its rows differ in length.
    """
    try:
        header, *rows = csv.reader(path.read_text(encoding="utf-8").splitlines())
        columns = zip(*rows, strict=True) if rows else [()] * len(header)
        return {name: _array(cells) for name, cells in zip(header, columns, strict=True)}
    except (OSError, ValueError):
        raise InputError(f"{path} cannot be read, or is not a table") from None


def _array(cells: tuple[str, ...]) -> np.ndarray:
    try:
        return np.array([float(cell) if cell else np.nan for cell in cells])
    except ValueError:
        return np.array(cells)
