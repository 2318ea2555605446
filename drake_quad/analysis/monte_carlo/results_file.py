"""The results of a study as a CSV file that grows, and that survives whatever ends the process that writes it."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

import numpy as np

from drake_quad.errors import InputError
from drake_quad.files import write_whole

try:
    import fcntl
except ImportError:  # not on Windows, where nothing keeps two studies from one file
    fcntl = None  # type: ignore[assignment]

# Two runs of a sample agree to more than this, and nobody reads more.
_NUMBER = "%.12g"


class ResultsFile:
    """A results file that is open for more rows.

    Args:
        path: of the file.
        file: open for reading and writing, unbuffered.
    """

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self.path, self._file = path, file

    def append(self, rows: np.ndarray) -> None:
        """Appends (n, columns) rows and hands them to the operating system.

        Raises:
            OSError: they could not be written; the file is as it was.
        """
        end, text = self._file.seek(0, os.SEEK_END), memoryview(_text(rows))
        try:
            while text:
                text = text[self._file.write(text) :]
        except OSError:
            self._file.truncate(end)
            raise


@contextmanager
def open_results(path: Path, columns: Sequence[str]) -> Iterator[tuple[ResultsFile, np.ndarray]]:
    """Opens a results file for more rows, and gives the (n, columns) rows that it holds.

    A half-written row at its end is dropped. The file is made if it is not there.

    Raises:
        InputError: the file is not of this study, or another run is writing to it.
    """
    header = _header(columns)
    rows = np.empty((0, len(columns)))
    # Unbuffered, so that nothing of what could not be written is left for a later attempt.
    with path.open("a+b", buffering=0) as file:
        _lock(file, path)
        if _length(file) <= len(header) and header.startswith(_content(file)):
            file.truncate(0)
            file.write(header)
        else:
            end, rows = read_rows(path, columns)
            file.truncate(end)
        yield ResultsFile(path, file), rows


def read_rows(path: Path, columns: Sequence[str]) -> tuple[int, np.ndarray]:
    """Reads a results file.

    Returns:
        Where its last whole row ends, and its (n, columns) rows.

    Raises:
        InputError: it holds something else than rows of these columns.
    """
    content, header = path.read_bytes(), _header(columns)
    if not content.startswith(header):
        raise InputError(f"{path} is not a results file of this study: its columns are others")
    end = content.rfind(b"\n") + 1
    lines = content[len(header) : end].splitlines()
    rows = np.empty((len(lines), len(columns)))
    for i, line in enumerate(lines):
        try:
            rows[i] = [float(cell) if cell else np.nan for cell in line.split(b",")]
        except ValueError:
            raise InputError(f"{path}, line {i + 2}: is not a row of a results file") from None
    # An empty cell is a metric that there is not; that of the time of a crash stands for never.
    rows[np.isnan(rows[:, -1]), -1] = np.inf
    samples = rows[:, 0]
    if not (np.isfinite(samples).all() and len(np.unique(samples)) == len(samples)):
        raise InputError(f"{path} holds a sample twice, or a row without the number of its sample")
    return end, rows


def sort_results(path: Path) -> None:
    """Puts the rows of a results file in the order of their samples; batches finish in any order."""
    header, *lines = path.read_bytes().splitlines(keepends=True)
    ordered = sorted(lines, key=lambda line: int(line.partition(b",")[0]))
    if ordered != lines:

        def write(target: Path) -> None:
            target.write_bytes(b"".join([header, *ordered]))

        write_whole(path, write)


def _header(columns: Sequence[str]) -> bytes:
    return (",".join(columns) + "\n").encode()


def _text(rows: np.ndarray) -> bytes:
    pattern = ",".join([_NUMBER] * rows.shape[1]) + "\n"
    text = "".join([pattern % tuple(row) for row in rows.tolist()])
    return text.replace("nan", "").replace("inf", "").encode()


def _length(file: BinaryIO) -> int:
    return file.seek(0, os.SEEK_END)


def _content(file: BinaryIO) -> bytes:
    file.seek(0)
    return file.read()


def _lock(file: BinaryIO, path: Path) -> None:
    if fcntl is None:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(f"{path} is being written by another run") from None
