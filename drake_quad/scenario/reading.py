"""Text files, as far as they may be read."""

import stat
from pathlib import Path

from drake_quad.errors import InputError
from drake_quad.scenario.limits import MOST_BYTES
from drake_quad.scenario.marked_tree import Mark


def read_text(path: Path, *, most: int = MOST_BYTES) -> str:
    """Reads a file of UTF-8 text, without its byte-order mark.

    Args:
        path: of a file, not of a device or a pipe, which need not end.
        most: bytes that it may have.

    Raises:
        InputError: it cannot be read, is not UTF-8 text, or is larger.
    """
    mark = Mark(str(path), 0)
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise InputError(f"{mark}: cannot be read: it is not a file")
        with path.open("rb") as file:
            data = file.read(most + 1)
    except OSError as error:
        raise InputError(f"{mark}: cannot be read: {(error.strerror or str(error)).lower()}") from None
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{mark}: cannot be read: a path cannot have such characters") from None
    if len(data) > most:
        raise InputError(f"{mark}: is too large: a scenario and what it extends may have {MOST_BYTES:,} bytes in all")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{mark}: is not UTF-8 text") from None
