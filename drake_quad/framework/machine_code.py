"""From LLVM's language to machine code, which is kept on the disk.

It is kept under a name that is made of the instructions and the processor: what a formula was when it was compiled does
not matter, only what it does now.
"""

import ctypes
import functools
import hashlib
import os
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numpy as np

from drake_quad.files import write_whole

_CHECKSUM_SIZE = 32
# So that LLVM leaves instructions in the order of `drake_quad.framework.scheduling`, since its own schedulers look less
# far. These are options of the whole process.
_AS_WRITTEN = ("-pre-RA-sched=source", "-enable-misched=false")
# A NumPy array's pointer to its elements stands behind what all Python objects begin with (NumPy's C interface).
POINTER = object.__basicsize__


@functools.cache
def _features() -> str:
    """What this processor can do, in LLVM's words."""
    return str(llvm.get_host_cpu_features().flatten())


# Registers for vectors, and vehicles in a vector: what the widest of them hold.
REGISTERS, LANES = (32, 8) if "+avx512f" in _features() else (16, 4)


def _check_pointer() -> None:
    """Raises ImportError where NumPy's arrays are laid out in another way."""
    array = np.zeros(1)
    if ctypes.c_void_p.from_address(id(array) + POINTER).value != array.ctypes.data:
        raise ImportError("machine code cannot find the elements of NumPy's arrays in this Python")


_check_pointer()


@functools.cache
def _machine() -> Any:
    """LLVM's idea of this processor."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    for option in _AS_WRITTEN:
        llvm.set_option("drake_quad", option)
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(cpu=llvm.get_host_cpu_name(), features=_features(), opt=1, jit=True)


@functools.cache
def _engine() -> Any:
    """What machine code lives in, as long as the process."""
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine())


def address(text: str) -> int:
    """The address of the function `kernel` of a module's text, from the disk or compiled."""
    machine = _machine()
    made_by = llvmlite.__version__, llvm.llvm_version_info, machine.triple, llvm.get_host_cpu_name()
    identity = repr((*made_by, _features(), _AS_WRITTEN, text))
    name = f"kernel_{hashlib.sha256(identity.encode()).hexdigest()[:32]}"
    code = _kept(name)
    if code is None:
        code = _compiled(text.replace("@kernel(", f"@{name}("))
        _keep(name, code)
    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return int(engine.get_function_address(name))


def _compiled(text: str) -> bytes:
    """The object file of a module's text.

    A listing has no line twice and none that is not needed, and it comes in its order: LLVM's passes over its language,
    which take a third of the time, made nothing faster, and nor did a higher level of optimisation.
    """
    code: bytes = _machine().emit_object(llvm.parse_assembly(text))
    return code


def _kept(name: str) -> bytes | None:
    """The object file of that name on the disk; None if it is not there or not as it was written."""
    folder = cache_folder()
    if folder is None:
        return None
    try:
        content = (folder / f"{name}.o").read_bytes()
    except OSError:
        return None
    code, checksum = content[:-_CHECKSUM_SIZE], content[-_CHECKSUM_SIZE:]
    return code if hashlib.sha256(code).digest() == checksum else None


def _keep(name: str, code: bytes) -> None:
    """Writes an object file to the disk; where that is not possible the next process compiles again."""
    folder = cache_folder()
    if folder is None:
        return
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        content = code + hashlib.sha256(code).digest()
        write_whole(folder / f"{name}.o", lambda path: _write(path, content))


def _write(path: Path, content: bytes) -> None:
    path.write_bytes(content)


def cache_folder() -> Path | None:
    """Where machine code is kept: in the folder that DRAKE_QUAD_CACHE names, or among the user's caches.

    None, so that nothing is kept, if that variable is empty or the user has no home.
    """
    named = os.environ.get("DRAKE_QUAD_CACHE")
    if named is not None:
        return Path(named) if named else None
    try:
        home = Path.home()
    except RuntimeError:
        return None
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local") / "drake_quad" / "cache"
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / "drake_quad"
    return Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache") / "drake_quad"
