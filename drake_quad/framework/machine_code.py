"""Compilation of LLVM code to machine code in this process, with a cache in memory and on the disk.

The key of the cache is derived from the LLVM code and the processor, so that cached machine code is never outdated when
a formula changes.
"""

import ctypes
import hashlib
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numpy as np

from drake_quad.caching import ThreadSafeCache
from drake_quad.framework import code_cache

# LLVM leaves instructions in the order of `drake_quad.framework.scheduling`, since its own schedulers look less far.
# With its basic register allocation a kernel compiles in 60 % of the time that the greedy one takes, and is as fast.
# These are options of the whole process.
_OPTIONS = ("-pre-RA-sched=source", "-enable-misched=false", "-regalloc=basic")
# A NumPy array's pointer to its elements stands behind what all Python objects begin with (NumPy's C interface).
POINTER = object.__basicsize__
# Instruction sets of this processor, in LLVM's notation.
_FEATURES = str(llvm.get_host_cpu_features().flatten())
# Registers for vectors, and vehicles in a vector: what the widest of them hold.
_HAS_AVX512 = "+avx512f" in _FEATURES
REGISTERS = 32 if _HAS_AVX512 else 16
LANES = 8 if _HAS_AVX512 else 4


def _check_pointer() -> None:
    """Raises ImportError where NumPy's arrays are laid out in another way."""
    array = np.zeros(1)
    if ctypes.c_void_p.from_address(id(array) + POINTER).value != array.ctypes.data:
        raise ImportError("machine code cannot find the elements of NumPy's arrays in this Python")


_check_pointer()


def _target_machine() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    for option in _OPTIONS:
        llvm.set_option("drake_quad", option)
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(cpu=llvm.get_host_cpu_name(), features=_FEATURES, opt=1, jit=True)


# An engine frees its machine code when it is deleted, so one engine lives as long as the process. Creating it during
# the import avoids races, since Python imports a module once. Only the code that makes values of `_addresses` uses the
# engine and the target machine, and `ThreadSafeCache` runs that code in one thread at a time.
_MACHINE = _target_machine()
_ENGINE = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _MACHINE)
_addresses: ThreadSafeCache[int] = ThreadSafeCache()


def address(text: str) -> int:
    """Return the address of the function `kernel` in an LLVM module, which is loaded from the disk or compiled.

    The function is thread-safe, and it compiles and loads each module once.
    """
    name = _name(text)
    return _addresses.get(name, lambda: _made(name, text))


def _name(text: str) -> str:
    """Return the name of a module's file and function, a digest of everything that its machine code depends on."""
    made_by = llvmlite.__version__, llvm.llvm_version_info, _MACHINE.triple, llvm.get_host_cpu_name()
    identity = repr((*made_by, _FEATURES, _OPTIONS, text))
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
    """Load an object file and return the address of the function `name`; 0 if it has no such function."""
    _ENGINE.add_object_file(llvm.ObjectFileRef.from_data(code))
    _ENGINE.finalize_object()
    return int(_ENGINE.get_function_address(name))


def _compiled(text: str) -> bytes:
    """Compile an LLVM module to an object file.

    LLVM's optimisation passes are not run. They take a third of the time and made no kernel faster, because the code is
    already free of duplicate and unused instructions, and scheduled. A higher optimisation level did not help either.
    """
    code: bytes = _MACHINE.emit_object(llvm.parse_assembly(text))
    return code
