"""C compiler of this computer."""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from drake_quad.errors import InputError, shorten_text

_COMPILERS = ("cc", "gcc", "clang")
_MAX_MESSAGE_LENGTH = 500  # largest number of characters of a compiler message that an error shows


def find_compiler(purpose: str, name: str | None = None) -> str:
    """Return the path of a C compiler.

    Args:
        purpose: task that needs the compiler, for the error message, such as "flying exported code".
        name: name of the compiler. By default, the first of cc, gcc and clang that is on PATH.

    Raises:
        InputError: if the compiler is not installed.
    """
    found = next(filter(None, map(shutil.which, [name] if name else _COMPILERS)), None)
    if found is None:
        missing = f"{name} is not" if name else "none of cc, gcc and clang is"
        raise InputError(f"{purpose} needs a C compiler, but {missing} on PATH")
    return found


def compile_c(compiler: str, arguments: Sequence[Path | str], source: Path) -> None:
    """Run a C compiler.

    Args:
        compiler: path of the compiler.
        arguments: arguments of the compiler.
        source: source file, for the error message.

    Raises:
        InputError: if the compiler fails.
    """
    result = subprocess.run([compiler, *map(str, arguments)], capture_output=True, text=True, check=False)
    if result.returncode:
        message = shorten_text(" ".join(result.stderr.split()), _MAX_MESSAGE_LENGTH)
        raise InputError(f"{compiler} cannot compile {source}: {message}")
