"""Command-line options that import a user's Python files, which define kinds of controllers, effects and so on."""

import shlex
import sys
from pathlib import Path

from drake_quad.errors import shortest_path

_LIBRARY_NAME = __name__.partition(".")[0]


def defining_file(defined: type) -> str:
    """Return the path of the user's file that defines a class, quoted for a shell; empty for built-in classes.

    The path is relative if the file is inside the working directory. The path is also empty if the class is not
    defined in a file.
    """
    file = getattr(sys.modules.get(defined.__module__), "__file__", None)
    if file is None or defined.__module__.partition(".")[0] == _LIBRARY_NAME:
        return ""
    return shlex.quote(str(shortest_path(Path(file).resolve())))


def import_option(defined: type) -> str:
    """Return the option `--import FILE.py` with the file that defines a class; empty for built-in classes."""
    file = defining_file(defined)
    return f"--import {file}" if file else ""
