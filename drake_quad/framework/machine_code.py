"""Compilation of LLVM code to machine code in this process, cached in memory and on the disk.

The key of the cache is a digest of the processor, the compiler, and either the LLVM code or the operations from which
it is generated. If a formula changes, its operations and therefore the key change, so that outdated machine code is
never used.
"""

import ctypes
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numpy as np

from drake_quad.caching import ThreadSafeCache
from drake_quad.framework import code_cache

# Process-wide options that disable LLVM's schedulers, which consider fewer instructions at a time than
# `drake_quad.framework.scheduling`. (The option -regalloc=basic would shorten the compilation by a tenth, but fleets
# would fly 15 to 25 % slower.)
_LLVM_OPTIONS = ("-pre-RA-sched=source", "-enable-misched=false")
# Offset in bytes of the pointer to the elements in a NumPy array. In NumPy's C interface, this pointer follows the
# header of a Python object.
ELEMENTS_POINTER_OFFSET = object.__basicsize__
# Instruction sets of this processor, in LLVM's notation.
_FEATURES = str(llvm.get_host_cpu_features().flatten())
_HAS_AVX512 = "+avx512f" in _FEATURES
# Number of vector registers of the processor.
NUM_VECTOR_REGISTERS = 32 if _HAS_AVX512 else 16
# Number of vehicles that are computed at once, which is the number of doubles in a vector register.
LANES = 8 if _HAS_AVX512 else 4


def _check_array_layout() -> None:
    """Raise ImportError if NumPy arrays do not have the memory layout that machine code expects."""
    array = np.zeros(1)
    if ctypes.c_void_p.from_address(id(array) + ELEMENTS_POINTER_OFFSET).value != array.ctypes.data:
        raise ImportError("NumPy arrays have an unsupported memory layout in this build of Python; use CPython")


_check_array_layout()


def _generator_digest() -> str | None:
    """Return a digest of the modules that generate LLVM code; None if a source file cannot be read."""
    digest, package = hashlib.sha256(), Path(__file__).parent.parent
    sources = sorted(path for folder in ("framework", "compilation") for path in (package / folder).glob("*.py"))
    try:
        for source in sources:
            digest.update(f"{source.relative_to(package)}\0".encode() + source.read_bytes())
    except OSError:
        return None
    return digest.hexdigest() if sources else None


# The digest is computed during the import, so that it belongs to the imported sources even if they are edited later.
_GENERATOR_DIGEST = _generator_digest()


def _target_machine() -> Any:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    for option in _LLVM_OPTIONS:
        llvm.set_option("drake_quad", option)
    target = llvm.Target.from_default_triple()
    return target.create_target_machine(cpu=llvm.get_host_cpu_name(), features=_FEATURES, opt=1, jit=True)


# An engine frees its machine code when it is deleted, so a single engine exists for the whole process. It is created
# during the import to avoid races, since Python imports a module once. Only the function that computes values of
# `_addresses` uses the engine and the target machine, and `ThreadSafeCache` runs this function in one thread at a time.
_MACHINE = _target_machine()
_ENGINE = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _MACHINE)
_addresses: ThreadSafeCache[int] = ThreadSafeCache()


def kernel_address(text: str) -> int:
    """Return the address of the function `kernel` in an LLVM module.

    The machine code is loaded or compiled once per process. It is loaded if the disk cache contains it. This function
    is thread-safe.
    """
    name = _name(text)
    return _addresses.get(name, lambda: _load_or_compile(name, lambda: text))


def generated_kernel_address(identity: str, generate: Callable[[], str]) -> int:
    """Return the address of the function `kernel` in an LLVM module; the module is generated only if it is not cached.

    A cached module is not generated, because generating its code takes as long as tracing its formulas. This function
    is thread-safe.

    Args:
        identity: text that, together with the generator's sources, determines the LLVM code.
        generate: function that returns the LLVM code of the module.
    """
    if _GENERATOR_DIGEST is None:
        return kernel_address(generate())
    name = _name(f"{_GENERATOR_DIGEST} {ELEMENTS_POINTER_OFFSET} {identity}")
    return _addresses.get(name, lambda: _load_or_compile(name, generate))


def _name(identity: str) -> str:
    """Return a name for a module's cache file and function, a digest of all data that determine the machine code."""
    compiler = llvmlite.__version__, llvm.llvm_version_info, _MACHINE.triple, llvm.get_host_cpu_name()
    text = repr((*compiler, _FEATURES, _LLVM_OPTIONS, identity))
    return f"kernel_{hashlib.sha256(text.encode()).hexdigest()[:32]}"


def _load_or_compile(name: str, generate: Callable[[], str]) -> int:
    """Load a kernel from the cache, or else generate and compile its LLVM code, and return its address."""
    cached = code_cache.read(name)
    address = 0 if cached is None else _load(name, cached)
    if not address:
        code = _compile(generate().replace("@kernel(", f"@{name}("))
        code_cache.write(name, code)
        address = _load(name, code)
    if not address:
        raise RuntimeError(f"LLVM does not find the function {name} in the machine code that it has just compiled")
    return address


def _load(name: str, code: bytes) -> int:
    """Load an object file and return the address of the function `name`; 0 if the file contains no such function."""
    _ENGINE.add_object_file(llvm.ObjectFileRef.from_data(code))
    _ENGINE.finalize_object()
    return int(_ENGINE.get_function_address(name))


def _compile(text: str) -> bytes:
    """Compile an LLVM module to an object file.

    LLVM's optimisation passes are not run. They took a third of the compilation time and made no kernel faster in
    measurements, because the code is already scheduled and contains no duplicate or unused instructions. A higher
    optimisation level of the code generator did not make kernels faster, either.
    """
    code: bytes = _MACHINE.emit_object(llvm.parse_assembly(text))
    return code
