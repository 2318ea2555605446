"""The results of a study as a CSV file that grows, and that survives whatever ends the process that writes it.

Every row ends with a checksum of its text and of what study it is from, so that a row that was altered, or is another
study's, is known from one that was flown.
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
except ImportError:  # not on Windows, where nothing keeps two studies from one file
    fcntl = None  # type: ignore[assignment]

CHECKSUM = "checksum"
# Two runs of a sample agree to more than this, and nobody reads more.
_NUMBER = "%.12g"


class Format(NamedTuple):
    """What the rows of a study's file look like.

    Attributes:
        columns: names of the numbers of a row; the first is `sample`. An empty cell stands for what there is not: for
            infinity in the column `crash_time`, else for NaN.
        study: a text that no other study has.
    """

    columns: Sequence[str]
    study: str

    @property
    def header(self) -> bytes:
        """The first line."""
        return (",".join([*self.columns, CHECKSUM]) + "\n").encode()

    def text(self, rows: np.ndarray) -> bytes:
        """The lines of (n, columns) rows."""
        pattern = ",".join([_NUMBER] * len(self.columns)) + ","
        lines = [(pattern % tuple(row)).replace("nan", "").replace("inf", "").encode() for row in rows.tolist()]
        return b"".join([line + self._checksum(line) + b"\n" for line in lines])

    def row(self, line: bytes) -> list[float] | None:
        """The numbers of a line without its end; None if it is not as it was written."""
        numbers, comma, checksum = line.rpartition(b",")
        numbers += comma
        if checksum != self._checksum(numbers):
            return None
        cells = zip(numbers.split(b",")[:-1], self.columns, strict=True)
        return [float(cell) if cell else np.inf if name == "crash_time" else np.nan for cell, name in cells]

    def _checksum(self, numbers: bytes) -> bytes:
        return b"%08x" % zlib.crc32(numbers, zlib.crc32(self.study.encode()))


class Found(NamedTuple):
    """What a results file holds.

    Attributes:
        rows: (n, columns) rows, of as many samples.
        lines: (n,) numbers of the lines that they stand in.
        misfits: numbers of the lines that are not as they were written, from 1 on.
        end: bytes up to the end of the last whole line.
    """

    rows: np.ndarray
    lines: np.ndarray
    misfits: list[int]
    end: int


class ResultsFile:
    """A results file that is open for more rows.

    Args:
        path: of the file.
        form: of its rows.
        file: open for reading and writing, unbuffered.
    """

    def __init__(self, path: Path, form: Format, file: BinaryIO) -> None:
        self.path, self._form, self._file = path, form, file

    def append(self, rows: np.ndarray) -> None:
        """Appends (n, columns) rows and hands them to the operating system.

        Raises:
            OSError: they could not be written; the file is as it was.
        """
        end, text = self._file.seek(0, os.SEEK_END), memoryview(self._form.text(rows))
        try:
            while text:
                text = text[self._file.write(text) :]
        except OSError:
            self._file.truncate(end)
            raise


@contextmanager
def open_results(path: Path, form: Format) -> Iterator[tuple[ResultsFile, Found]]:
    """Opens a results file for more rows, and gives what it holds.

    A half-written row at its end is dropped. The file is made if it is not there.

    Raises:
        InputError: the file is not of this study, or another run is writing to it.
    """
    # Unbuffered, so that nothing of what could not be written is left for a later attempt.
    with path.open("a+b", buffering=0) as file:
        _lock(file, path)
        file.seek(0)
        if form.header.startswith(file.read()):
            file.truncate(0)
            file.write(form.header)
        found = read_results(path, form)
        file.truncate(found.end)
        yield ResultsFile(path, form, file), found


def read_results(path: Path, form: Format) -> Found:
    """Reads a results file.

    Raises:
        InputError: it cannot be read, or its columns are others.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {(error.strerror or str(error)).lower()}") from None
    if not content.startswith(form.header):
        raise InputError(f"{path} is not a results file of this study: its columns are others")
    end = content.rfind(b"\n") + 1
    rows: dict[float, tuple[int, list[float]]] = {}
    misfits = []
    for number, line in enumerate(content[len(form.header) : end].split(b"\n")[:-1], start=2):
        row = form.row(line)
        if row is None:
            misfits.append(number)
        else:
            rows.setdefault(row[0], (number, row))
    table = np.array([row for _, row in rows.values()]).reshape(-1, len(form.columns))
    return Found(table, np.array([number for number, _ in rows.values()], dtype=int), misfits, end)


def write_results(path: Path, form: Format, rows: np.ndarray) -> Path:
    """Writes a results file anew, whole."""

    def write(target: Path) -> None:
        target.write_bytes(form.header + form.text(rows))

    return write_atomically(path, write)


def _lock(file: BinaryIO, path: Path) -> None:
    if fcntl is None:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(f"{path} is being written by another run") from None
