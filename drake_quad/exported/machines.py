"""Computers that run exported code: this one, and emulated boards with a microcontroller."""

import contextlib
import ctypes
import hashlib
import os
import select
import shutil
import subprocess
import tempfile
import time
import weakref
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from drake_quad.c_compiler import compile_c, find_compiler
from drake_quad.caching import ThreadSafeCache
from drake_quad.errors import InputError
from drake_quad.exported.description import DESCRIPTION_FILE, ExportDescription, read_description

COMPILER_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
"""Options with which a C compiler keeps the order and rounding of all operations."""
# C code that is compiled together with exported code, to compare the sizes of its structs with the description.
_SIZES_CODE = """\
#include "{name}.h"
const unsigned long struct_sizes[4] = {{
    sizeof({name}_t), sizeof({name}_parameters_t), sizeof({name}_inputs_t), sizeof({name}_outputs_t)}};
"""


class Machine(Protocol):
    """Computer that runs exported code."""

    def step(self, state: bytes, inputs: bytes) -> tuple[bytes, bytes]:
        """Return the next state and the outputs of a step, given the bytes of the structs."""


class HostMachine:
    """This computer: the exported code is compiled to a shared library.

    Args:
        folder: folder with the exported code.
        compiler: C compiler. By default, the first of cc, gcc and clang that is on PATH.
        flags: compiler options.

    Raises:
        InputError: if there is no compiler, the code cannot be compiled, or its structs differ from the description.
    """

    def __init__(self, folder: Path, *, compiler: str | None = None, flags: tuple[str, ...] = COMPILER_FLAGS) -> None:
        description = read_description(folder)
        library = _compiled(folder, description, compiler, flags)
        name = description.name
        self._step = getattr(library, f"{name}_step")
        self._step.restype = None
        self._parameters = ctypes.addressof(ctypes.c_char.in_dll(library, f"{name}_default_parameters"))
        sizes = (ctypes.c_ulong * 4).in_dll(library, "struct_sizes")
        number = np.dtype(description.number_type).itemsize
        self._num_output_bytes = number * sum(description.outputs.values())
        expected = description.state_type.itemsize, number * sum(description.inputs.values()), self._num_output_bytes
        if (sizes[0], sizes[2], sizes[3]) != expected:
            raise InputError(f"{folder}: the structs of {name}.h differ from {DESCRIPTION_FILE}; export again")

    def step(self, state: bytes, inputs: bytes) -> tuple[bytes, bytes]:
        """Execute one step of the exported code, and return the next state and the outputs as bytes."""
        memory = ctypes.create_string_buffer(state, len(state))
        outputs = ctypes.create_string_buffer(self._num_output_bytes)
        self._step(memory, ctypes.c_void_p(self._parameters), inputs, outputs)
        return memory.raw, outputs.raw

    @staticmethod
    def initial_state(folder: Path, description: ExportDescription) -> bytes:
        """Return the initial state of the exported code, as the bytes of its C struct."""
        library = _compiled(folder, description, None, COMPILER_FLAGS)
        memory = ctypes.create_string_buffer(description.state_type.itemsize)
        getattr(library, f"{description.name}_init")(memory)
        return memory.raw


# Shared libraries by their sources and compilers. They are never unloaded.
_libraries: ThreadSafeCache[ctypes.CDLL] = ThreadSafeCache()


def _compiled(
    folder: Path, description: ExportDescription, compiler: str | None, flags: tuple[str, ...]
) -> ctypes.CDLL:
    """Return the shared library of exported code, which is compiled once per process."""
    path = find_compiler("flying exported code", compiler)
    digest = hashlib.sha256()
    for suffix in (".h", ".c"):
        file = folder / f"{description.name}{suffix}"
        try:
            digest.update(file.read_bytes())
        except OSError as error:
            raise InputError(f"cannot read {file}: {str(error.strerror).lower()}") from None
    key = str(folder.resolve()), digest.hexdigest(), path, flags
    return _libraries.get(key, lambda: _compile(folder, description.name, path, flags))


def _compile(folder: Path, name: str, compiler: str, flags: tuple[str, ...]) -> ctypes.CDLL:
    with tempfile.TemporaryDirectory() as temporary:
        sizes, library = Path(temporary) / "sizes.c", Path(temporary) / "library.so"
        sizes.write_text(_SIZES_CODE.format(name=name))
        source = folder / f"{name}.c"
        arguments: list[Path | str] = [*flags, "-shared", "-fPIC", "-I", folder, "-o", library, source, sizes, "-lm"]
        compile_c(compiler, arguments, source)
        return ctypes.CDLL(str(library))


class Core(NamedTuple):
    """Microcontroller core on a board that QEMU emulates.

    Attributes:
        board: name of the board in QEMU.
        flags: compiler options that select the core and its floating-point unit.
    """

    board: str
    flags: tuple[str, ...]


CORES = {
    "cortex-m4f": Core("mps2-an386", ("-mcpu=cortex-m4", "-mfpu=fpv4-sp-d16")),
    "cortex-m7": Core("mps2-an500", ("-mcpu=cortex-m7", "-mfpu=fpv5-d16")),
}
"""Cores on which exported code can be emulated, by name: one with a unit for single, one for double precision."""
CROSS_COMPILER, EMULATOR = "arm-none-eabi-gcc", "qemu-system-arm"
_CROSS_FLAGS = (*COMPILER_FLAGS, "-mthumb", "-mfloat-abi=hard", "-ffunction-sections", "-fdata-sections")
_ICOUNT_SHIFT = 5  # QEMU simulates 2^5 ns for each instruction
_TIMER_PERIOD = 40.0  # ns; the timer of the board runs at 25 MHz
_INSTRUCTIONS_PER_COUNT = _TIMER_PERIOD / 2**_ICOUNT_SHIFT  # simulated instructions per count of the timer
_STEP_TIMEOUT = 60.0  # s; an emulated step takes milliseconds


class EmulatedBoard:
    """Board with a microcontroller that QEMU emulates, with the exported code as its only program.

    The board receives the state and the inputs of each step over a pipe, and returns the outputs and the next state.

    Args:
        folder: folder with the exported code.
        core: name of the core, a key of `CORES`.

    Attributes:
        max_instructions: largest number of instructions that a step has taken.

    Raises:
        InputError: if the cross-compiler or QEMU is missing, or the code cannot be compiled.
    """

    def __init__(self, folder: Path, core: str) -> None:
        for program, package in ((CROSS_COMPILER, "gcc-arm-none-eabi"), (EMULATOR, EMULATOR)):
            if shutil.which(program) is None:
                raise InputError(
                    f"the emulated {core} needs {program}, which is not on PATH; on Debian, install the package"
                    f" {package}"
                )
        description = read_description(folder)
        self.max_instructions = 0
        number = np.dtype(description.number_type).itemsize
        self._num_output_bytes = number * sum(description.outputs.values())
        self._num_state_bytes = description.state_type.itemsize
        directory = tempfile.TemporaryDirectory()
        work = Path(directory.name)
        compile_for_board(folder, core, work / "program.elf")
        for name in ("requests", "responses"):
            os.mkfifo(work / name)
        # Opening a pipe for both reading and writing does not block until the emulator opens it.
        self._requests, self._responses = (os.open(work / name, os.O_RDWR) for name in ("requests", "responses"))
        command = [EMULATOR, "-M", CORES[core].board, "-kernel", "program.elf", "-nographic", "-monitor", "none"]
        command += ["-serial", "none", "-semihosting-config", "enable=on,target=native"]
        command += ["-icount", f"shift={_ICOUNT_SHIFT}"]
        self._process = subprocess.Popen(
            command, cwd=work, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        self._finalizer = weakref.finalize(self, _stop, self._process, (self._requests, self._responses), directory)

    def close(self) -> None:
        """Stop the emulation of the board."""
        self._finalizer()

    def step(self, state: bytes, inputs: bytes) -> tuple[bytes, bytes]:
        """Return the next state and the outputs of a step.

        Raises:
            RuntimeError: if the emulation ends or hangs.
        """
        os.write(self._requests, state + inputs)
        response = self._read(self._num_output_bytes + self._num_state_bytes + 4)
        outputs, after = response[: self._num_output_bytes], response[self._num_output_bytes : -4]
        count = int.from_bytes(response[-4:], "little")
        self.max_instructions = max(self.max_instructions, round(count * _INSTRUCTIONS_PER_COUNT))
        return after, outputs

    def _read(self, size: int) -> bytes:
        data, end = b"", time.monotonic() + _STEP_TIMEOUT
        while len(data) < size:
            ready, _, _ = select.select([self._responses], [], [], 0.5)
            if ready:
                data += os.read(self._responses, size - len(data))
            elif self._process.poll() is not None:
                assert self._process.stderr is not None
                message = self._process.stderr.read().decode(errors="replace")
                raise RuntimeError(f"{EMULATOR} ended with status {self._process.returncode}: {message.strip()}")
            elif time.monotonic() > end:
                raise RuntimeError(f"the emulated program did not answer within {_STEP_TIMEOUT:g} s")
        return data


def _stop(
    process: subprocess.Popen[bytes], pipes: tuple[int, ...], directory: "tempfile.TemporaryDirectory[str]"
) -> None:
    """Stop an emulation and delete its files."""
    process.kill()
    process.wait()
    if process.stderr is not None:
        process.stderr.close()
    for pipe in pipes:
        with contextlib.suppress(OSError):
            os.close(pipe)
    directory.cleanup()


def compile_for_board(folder: Path, core: str, program: Path) -> None:
    """Compile exported code and the program that runs it on an emulated board.

    Args:
        folder: folder with the exported code.
        core: name of the core, a key of `CORES`.
        program: path of the executable file to write.

    Raises:
        InputError: if the code cannot be compiled.
    """
    name = read_description(folder).name
    here = Path(__file__).parent
    macros = [f'-DHEADER="{name}.h"', *(f"-D{part.upper()}={name}_{part}" for part in ("init", "step"))]
    macros += [f"-D{part.upper()}_T={name}_{part}_t" for part in ("inputs", "outputs")]
    macros += [f"-DSTATE_T={name}_t", f"-DPARAMETERS={name}_default_parameters"]
    source = folder / f"{name}.c"
    arguments: list[Path | str] = [*_CROSS_FLAGS, *CORES[core].flags, *macros, "-I", folder, "-nostartfiles"]
    arguments += ["-T", here / "board.ld", "-Wl,--gc-sections", "-o", program, here / "board.c", source, "-lm"]
    compile_c(CROSS_COMPILER, arguments, source)


def has_cross_compiler() -> bool:
    """Return whether the cross-compiler for the cores is installed."""
    return shutil.which(CROSS_COMPILER) is not None


def code_size(folder: Path, core: str) -> int:
    """Return the size of the machine code and constants of exported code on a core, compiled for small size, bytes.

    The functions of `math.h` are not included.
    """
    name = read_description(folder).name
    with tempfile.TemporaryDirectory() as temporary:
        object_file = Path(temporary) / "controller.o"
        flags = [*_CROSS_FLAGS, "-Os", *CORES[core].flags]
        command = [CROSS_COMPILER, *flags, "-c", "-o", object_file, folder / f"{name}.c"]
        subprocess.run([*map(str, command)], check=True, capture_output=True)
        size = [CROSS_COMPILER.replace("gcc", "size"), str(object_file)]
        report = subprocess.run(size, check=True, capture_output=True, text=True).stdout
    text, data, *_ = report.splitlines()[1].split()
    return int(text) + int(data)


MACHINES: dict[str, Callable[[Path], Machine]] = {
    "host": HostMachine,
    **{f"qemu-{core}": partial(EmulatedBoard, core=core) for core in CORES},
}
"""Computers that can run exported code, by name."""
