"""Versions and digests of the code that flies a study, for comparison with the code of other machines."""

import functools
import hashlib
import importlib
import platform
import sys
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any

_PACKAGES = ("drake_quad", "drake", "numpy", "scipy", "llvmlite")


def provenance() -> dict[str, str]:
    """Return the versions of Python and of the required packages, and a digest of drake_quad's source files."""
    return {
        "python": platform.python_version(),
        **{name: version(name) for name in _PACKAGES},
        "sources": _digest_of_package(),
    }


@functools.cache
def _digest_of_package() -> str:
    folder = Path(__file__).parent.parent
    return _digest(sorted(folder.rglob("*.py")), folder)


def source_digest(functions: Iterable[Callable[..., Any] | None]) -> str:
    """Return a digest of the source files in which functions or classes are defined.

    Functions without a file are ignored, and so are functions of the main script, whose module has a different name in
    other processes.
    """
    files = set()
    for function in functions:
        name = getattr(getattr(function, "func", function), "__module__", None)
        if name is None or name in ("__main__", "__mp_main__"):
            continue
        module = sys.modules.get(name) or importlib.import_module(name)
        if getattr(module, "__file__", None) is not None:
            files.add(Path(str(module.__file__)))
    return _digest(sorted(files, key=lambda file: file.name), None)


def _digest(files: Iterable[Path], folder: Path | None) -> str:
    digest = hashlib.sha256()
    for file in files:
        digest.update(str(file.name if folder is None else file.relative_to(folder)).encode() + b"\0")
        digest.update(file.read_bytes() + b"\0")
    return digest.hexdigest()[:16]


# Description of the difference between two digests, by the name of the digest.
_DIGEST_MESSAGES = {
    "sources": "a different version of drake_quad's source files",
    "user_systems": "different source files of the user's systems",
}


def code_difference(here: dict[str, str], there: dict[str, str]) -> str | None:
    """Return a description of the first difference between the code of two processes; None if there is none.

    Args:
        here: code of this process, see `provenance`.
        there: code of the other process.
    """
    for name, value in here.items():
        if there.get(name) != value:
            return _DIGEST_MESSAGES.get(name, f"{name} {there.get(name)}, not {value}")
    return None
