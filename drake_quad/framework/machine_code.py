"""From LLVM's language to machine code in this process, which is compiled once and kept on the disk.

Machine code is kept under a name that is made of the instructions and the processor: what a formula was when it was
compiled does not matter, only what it does now.
"""

import ctypes
import hashlib
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numpy as np

from drake_quad.caching import ThreadSafeCache
from drake_quad.framework import code_cache

# So that LLVM leaves instructions in the order of `drake_quad.framework.scheduling`, since its own schedulers look less
# far. These are options of the whole process.
_AS_WRITTEN = ("-pre-RA-sched=source", "-enable-misched=false")
# A NumPy array's pointer to its elements stands behind what all Python objects begin with (NumPy's C interface).
POINTER = object.__basicsize__
# What this processor can do, in LLVM's words.
_FEATURES = str(llvm.get_host_cpu_features().flatten())
# Registers for vectors, and vehicles in a vector: what the widest of them hold.
REGISTERS, LANES = (32, 8) if "+avx512f" in _FEATURES else (16, 4)


def _check_pointer() -> None:
    """Raises ImportError where NumPy's arrays are laid out in another way."""
    array = np.zeros(1)
    if ctypes.c_void_p.from_address(id(array) + POINTER).value != array.ctypes.data:
        raise ImportError("machine code cannot find the elements of NumPy's arrays in this Python")


_check_pointer()


def _target_machine() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    for option in _AS_WRITTEN:
        llvm.set_option("drake_quad", option)
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(cpu=llvm.get_host_cpu_name(), features=_FEATURES, opt=1, jit=True)


# An engine frees its machine code when it is freed itself, so there is one, made by the import, which Python does once
# whatever the number of threads. Both are used only while a thread makes a value of `_addresses`, that is one thread
# at a time.
_MACHINE = _target_machine()
_ENGINE = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _MACHINE)
_addresses: ThreadSafeCache[int] = ThreadSafeCache()


def address(text: str) -> int:
    """Return the address of the function `kernel` of a module's text, from the disk or compiled.

    Any number of threads may call this; a module is compiled and loaded once.
    """
    name = _name(text)
    return _addresses.get(name, lambda: _made(name, text))


def _name(text: str) -> str:
    """Return the name of a module's file and function, made of all that its machine code depends on."""
    made_by = llvmlite.__version__, llvm.llvm_version_info, _MACHINE.triple, llvm.get_host_cpu_name()
    identity = repr((*made_by, _FEATURES, _AS_WRITTEN, text))
    return f"kernel_{hashlib.sha256(identity.encode()).hexdigest()[:32]}"


def _made(name: str, text: str) -> int:
    kept = code_cache.read(name)
    found = 0 if kept is None else _loaded(name, kept)
    if not found:
        code = _compiled(text.replace("@kernel(", f"@{name}("))
        code_cache.write(name, code)
        found = _loaded(name, code)
    if not found:
        raise RuntimeError(f"LLVM does not find {name}, which it has just compiled")
    return found


def _loaded(name: str, code: bytes) -> int:
    """Load an object file and return the address of a function of that name; 0 if it has none."""
    _ENGINE.add_object_file(llvm.ObjectFileRef.from_data(code))
    _ENGINE.finalize_object()
    return int(_ENGINE.get_function_address(name))


def _compiled(text: str) -> bytes:
    """Return the object file of a module's text.

    A listing has no line twice and none that is not needed, and it comes in its order: LLVM's passes over its language,
    which take a third of the time, made nothing faster, and nor did a higher level of optimisation.
    """
    code: bytes = _MACHINE.emit_object(llvm.parse_assembly(text))
    return code
