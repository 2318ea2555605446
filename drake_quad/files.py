"""Functions that write files atomically, and read CSV tables and .npz files."""

import csv
import os
import tempfile
import threading
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import IO, Any
from zipfile import ZipFile

import numpy as np

from drake_quad.errors import InputError, short_repr, shorten_text
from drake_quad.number_parsing import parse_float
from drake_quad.process_settings import without_warnings


def output_folder(path: Path) -> Path:
    """Create a folder if it does not exist, and return its path.

    Raises:
        InputError: if the folder cannot be created or written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except (OSError, ValueError) as error:
        reason = (getattr(error, "strerror", None) or str(error)).lower()
        raise InputError(f"cannot write to the output folder {shorten_text(str(path), 120)}: {reason}") from None
    return path


def write_atomically(path: Path, write: Callable[[Path], None]) -> Path:
    """Write a file atomically and return its path.

    A temporary file in the same folder is written and then renamed. It is deleted if an error occurs.

    Args:
        path: path of the file.
        write: function that writes the content into a file at a given path.
    """
    # The temporary name is unique, since other processes and threads may write the same file at the same time.
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.{threading.get_ident()}{path.suffix}")
    try:
        write(temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    return path


def write_text(path: Path, text: str) -> Path:
    """Write a text file atomically and return its path."""

    def write(target: Path) -> None:
        target.write_text(text, encoding="utf-8")

    return write_atomically(path, write)


def write_table(path: Path, columns: Mapping[str, Iterable[Any]], *, digits: int = 17) -> Path:
    """Write columns of equal length as a CSV file, and return its path.

    Args:
        path: path of the file.
        columns: numbers or texts of each column, by heading; NaN becomes an empty cell.
        digits: number of significant digits. By default all digits are written, so that `read_table` returns exactly
            the same numbers.
    """
    format_float = repr if digits == 17 else f"{{:.{digits}g}}".format

    def cell(value: Any) -> str:
        plain = value.item() if isinstance(value, np.generic) else value
        if isinstance(plain, float):
            return "" if plain != plain else format_float(plain)
        return str(plain)

    plain = (values.tolist() if isinstance(values, np.ndarray) else values for values in columns.values())
    rows = zip(*(map(cell, values) for values in plain), strict=True)

    def write(target: Path) -> None:
        with target.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(rows)

    return write_atomically(path, write)


def read_table(path: Path) -> dict[str, np.ndarray]:
    """Read a table written by `write_table`.

    Returns:
        The columns by heading: an array of numbers if all cells are numbers or empty, otherwise an array of text.

    Raises:
        InputError: if the file cannot be read, or its rows differ in length.
    """
    if not path.is_file():  # reading a pipe could block forever
        raise InputError(f"{path} cannot be read: it is not a regular file")
    try:
        header, *rows = csv.reader(path.read_text(encoding="utf-8").splitlines())
        columns = zip(*rows, strict=True) if rows else [()] * len(header)
        return {name: _array(cells) for name, cells in zip(header, columns, strict=True)}
    except (OSError, ValueError):
        raise InputError(f"{path} cannot be read, or is not a CSV table whose rows have equal length") from None


def read_arrays(file: IO[bytes], *, max_bytes: int | None = None) -> dict[str, np.ndarray]:
    """Return the arrays of an .npz file by name; arrays of Python objects are rejected.

    Args:
        file: file opened for reading in binary mode.
        max_bytes: largest total size of the decompressed arrays, bytes; None for no limit.

    Raises:
        ValueError: if the arrays are too large, two arrays have the same name, or the file is damaged or not an .npz
            file.
    """
    try:
        with ZipFile(file) as packed, without_warnings():
            members = packed.infolist()
            names = [member.filename.removesuffix(".npy") for member in members]
            is_too_large = max_bytes is not None and sum(member.file_size for member in members) > max_bytes
            arrays = {}
            for name, member in zip(names, [] if is_too_large else members, strict=False):
                with packed.open(member) as content:
                    arrays[name] = np.lib.format.read_array(content, allow_pickle=False)
    except Exception:  # zipfile and NumPy raise errors of many types for damaged files
        raise ValueError("is not an .npz file of arrays") from None
    if is_too_large:
        raise ValueError(f"is too large: its arrays have more than {max_bytes:,} bytes")
    repeated = [name for i, name in enumerate(names) if name in names[:i]]
    if repeated:
        raise ValueError(f"contains two arrays named {short_repr(repeated[0])}")
    return arrays


def _array(cells: tuple[str, ...]) -> np.ndarray:
    try:
        return np.array([parse_float(cell) if cell else np.nan for cell in cells])
    except ValueError:
        return np.array(cells)
