"""Files that are whole or not there."""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path

from drake_quad.errors import InputError, shortened


def output_folder(path: Path) -> Path:
    """Creates a folder if need be and returns it.

    Raises:
        InputError: it cannot be created or written to.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            pass
    except (OSError, ValueError) as error:
        reason = (getattr(error, "strerror", None) or str(error)).lower()
        raise InputError(f"the output folder {shortened(str(path), 120)} cannot be written: {reason}") from None
    return path


def write_whole(path: Path, write: Callable[[Path], None]) -> Path:
    """Lets `write` fill a temporary file beside `path`, renames it and returns the path; on an error it is gone."""
    temporary = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        write(temporary)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    return path


def write_text(path: Path, text: str) -> Path:
    """Writes a text file whole and returns the path."""

    def write(target: Path) -> None:
        target.write_text(text, encoding="utf-8")

    return write_whole(path, write)
