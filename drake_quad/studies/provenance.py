"""Versions and sources of the code that flies a study, on this machine and on others."""

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
    """Return the versions of Python and of the packages that a flight depends on, and a digest of our sources."""
    return {
        "python": platform.python_version(),
        **{name: version(name) for name in _PACKAGES},
        "sources": _digest_of_package(),
    }


@functools.cache
def _digest_of_package() -> str:
    folder = Path(__file__).parent.parent
    return _digest(sorted(folder.rglob("*.py")), folder)


def sources_of(functions: Iterable[Callable[..., Any] | None]) -> str:
    """Return a digest of the files of some functions or classes, as this process would import them.

    Functions without a file do not contribute. Nor do those of the main script, whose module has a different name in
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


# Descriptions of digests that differ, for messages.
_DIGESTS = {"sources": "other sources of drake_quad", "own": "another controller or wind of the user's"}


def difference(here: dict[str, str], there: dict[str, str]) -> str | None:
    """Return the first difference between the code of another process and this one as text; None if there is none.

    Args:
        here: code of this process, see `provenance`.
        there: code of the other process.
    """
    for name, value in here.items():
        if there.get(name) != value:
            return _DIGESTS.get(name, f"{name} {there.get(name)}, not {value}")
    return None
