"""CSV file with the results of a study. Rows are appended, and the file remains valid if the process is killed.

Every row ends with a checksum of its text and of its study. The checksum reveals rows that were altered and rows of
another study.
"""

import os
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.files import write_atomically

try:
    import fcntl
except ImportError:  # Windows has no fcntl, so two studies could write to the same file there
    fcntl = None  # type: ignore[assignment]

CHECKSUM = "checksum"
_NUMBER_FORMAT = "%.12g"  # repeated flights of a sample agree to more than 12 digits
_EXACT_FORMAT = "%.17g"


class RowFormat(NamedTuple):
    """Format of the rows in a results file.

    Attributes:
        columns: names of the columns; the first is the index of the sample or flight. An empty cell means infinity in
            the column `crash_time`, and NaN in other columns.
        study: text that identifies the study; the checksums include it.
        is_exact: True to write all digits, and infinity as `inf`, so that reading returns exactly the written numbers.
    """

    columns: Sequence[str]
    study: str
    is_exact: bool = False

    @property
    def header(self) -> bytes:
        """First line of the results file, with the names of its columns."""
        return (",".join([*self.columns, CHECKSUM]) + "\n").encode()

    def text(self, rows: np.ndarray) -> bytes:
        """Return rows (n, columns) as the text of n lines."""
        pattern = ",".join([_EXACT_FORMAT if self.is_exact else _NUMBER_FORMAT] * len(self.columns)) + ","
        texts = [pattern % tuple(row) for row in rows.tolist()]
        if not self.is_exact:
            texts = [text.replace("nan", "").replace("inf", "") for text in texts]
        lines = [text.encode() for text in texts]
        return b"".join([line + self._checksum(line) + b"\n" for line in lines])

    def row(self, line: bytes) -> list[float] | None:
        """Return the numbers in a line (without line break); None if the checksum is wrong."""
        numbers, comma, checksum = line.rpartition(b",")
        numbers += comma
        if checksum != self._checksum(numbers):
            return None
        cells = zip(numbers.split(b",")[:-1], self.columns, strict=True)
        return [float(cell) if cell else np.inf if name == "crash_time" else np.nan for cell, name in cells]

    def _checksum(self, numbers: bytes) -> bytes:
        return b"%08x" % zlib.crc32(numbers, zlib.crc32(self.study.encode()))


class StoredRows(NamedTuple):
    """Content of a results file.

    Attributes:
        rows: (n, columns) rows of n different samples.
        lines: (n,) line numbers of the rows; the first line of the file has number 1.
        invalid_lines: line numbers of invalid rows.
        end: position of the end of the last complete line, bytes.
    """

    rows: np.ndarray
    lines: np.ndarray
    invalid_lines: list[int]
    end: int


class ResultsFile:
    """Results file that is open for appending rows.

    Args:
        path: path of the CSV file.
        row_format: format of the rows.
        file: unbuffered file object that is open for reading and writing.
    """

    def __init__(self, path: Path, row_format: RowFormat, file: BinaryIO) -> None:
        self.path, self._row_format, self._file = path, row_format, file

    def append(self, rows: np.ndarray) -> None:
        """Append rows (n, columns) and pass them to the operating system.

        Raises:
            OSError: if the rows could not be written; the file is unchanged.
        """
        end, text = self._file.seek(0, os.SEEK_END), memoryview(self._row_format.text(rows))
        try:
            while text:
                text = text[self._file.write(text) :]
        except OSError:
            self._file.truncate(end)
            raise


@contextmanager
def open_results(path: Path, row_format: RowFormat) -> Iterator[tuple[ResultsFile, StoredRows]]:
    """Open a results file for appending rows, and yield the file and its content.

    An incomplete row at the end of the file is removed. The file is created if it does not exist.

    Raises:
        InputError: if the file belongs to another study, or another run is writing to it.
    """
    # The file is unbuffered. A buffered file would keep the data after a failed write, and could write them later.
    with path.open("a+b", buffering=0) as file:
        _lock(file, path)
        file.seek(0)
        if row_format.header.startswith(file.read()):
            file.truncate(0)
            file.write(row_format.header)
        stored = read_results(path, row_format)
        file.truncate(stored.end)
        yield ResultsFile(path, row_format, file), stored


def read_results(path: Path, row_format: RowFormat) -> StoredRows:
    """Read a results file.

    Raises:
        InputError: if the file cannot be read, or has different columns.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {(error.strerror or str(error)).lower()}") from None
    if not content.startswith(row_format.header):
        raise InputError(f"{path} is not a results file of this study: its columns are different")
    end = content.rfind(b"\n") + 1
    rows: dict[float, tuple[int, list[float]]] = {}
    invalid_lines = []
    for number, line in enumerate(content[len(row_format.header) : end].split(b"\n")[:-1], start=2):
        row = row_format.row(line)
        if row is None:
            invalid_lines.append(number)
        else:
            rows.setdefault(row[0], (number, row))
    table = np.array([row for _, row in rows.values()]).reshape(-1, len(row_format.columns))
    return StoredRows(table, np.array([number for number, _ in rows.values()], dtype=int), invalid_lines, end)


def write_results(path: Path, row_format: RowFormat, rows: np.ndarray) -> Path:
    """Write a complete results file atomically, and return its path."""

    def write(target: Path) -> None:
        target.write_bytes(row_format.header + row_format.text(rows))

    return write_atomically(path, write)


def _lock(file: BinaryIO, path: Path) -> None:
    if fcntl is None:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(f"another run is writing to {path}; wait until it ends, or choose another folder") from None
