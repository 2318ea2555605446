"""Reading of files with a limit on their size."""

import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from drake_quad.errors import InputError
from drake_quad.scenario.files.marked_tree import Mark
from drake_quad.scenario.limits import MAX_BYTES


@contextmanager
def open_source(path: Path) -> Iterator[IO[bytes]]:
    """Open a regular file for reading, as a context manager. Devices and pipes are rejected, since they may never end.

    Raises:
        InputError: if the file cannot be opened, or reading fails inside the context.
    """
    mark = Mark(str(path), 0)
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise InputError(f"{mark}: cannot be read: it is not a file")
        with path.open("rb") as file:
            yield file
    except OSError as error:
        raise InputError(f"{mark}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{mark}: cannot be read: the path contains an invalid character") from None


def read_bytes(path: Path, max_bytes: int, limit: str) -> bytes:
    """Read a file.

    Args:
        path: path of the file.
        max_bytes: largest number of bytes.
        limit: description of the limit for the message, such as "a mesh may have at most 1,000 bytes".

    Raises:
        InputError: if the file cannot be read or is too large.
    """
    with open_source(path) as file:
        data = file.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise InputError(f"{Mark(str(path), 0)}: is too large: {limit}")
    return data


def read_text(path: Path, *, max_bytes: int = MAX_BYTES) -> str:
    """Read a file of UTF-8 text, without its byte-order mark.

    Args:
        path: path of the file.
        max_bytes: largest number of bytes.

    Raises:
        InputError: if the file cannot be read, is not UTF-8 text, or is too large.
    """
    limit = f"a scenario and all that it extends may have at most {MAX_BYTES:,} bytes"
    try:
        return read_bytes(path, max_bytes, limit).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{Mark(str(path), 0)}: is not UTF-8 text") from None
