"""Flight of an exported controller: C code that `drake-quad export` wrote, compiled and called in the loop."""

import ctypes
import hashlib
import json
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from drake_quad.caching import ThreadSafeCache
from drake_quad.errors import InputError, shorten_text

DESCRIPTION_FILE = "export.json"
"""Name of the file that describes exported code."""
COMPILER_FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
"""Options with which a C compiler keeps the order and rounding of all operations."""
_COMPILERS = ("cc", "gcc", "clang")
_NUMBER_TYPES = {"double": np.float64, "single": np.float32}
_MAX_MESSAGE_LENGTH = 500  # characters of a compiler's message
# C code that is compiled together with exported code, to compare the layout of its structs with the description.
_SIZES_CODE = """\
#include "{name}.h"
const unsigned long struct_sizes[4] = {{
    sizeof({name}_t), sizeof({name}_parameters_t), sizeof({name}_inputs_t), sizeof({name}_outputs_t)}};
"""


class ExportDescription(NamedTuple):
    """Description of exported code.

    Attributes:
        name: name of the files, and prefix of the names in C.
        precision: "double" or "single".
        period: time between two steps, s.
        output_divisor: number of steps between two steps that write outputs.
        inputs: number of rows of each input.
        outputs: number of rows of each output.
        num_states: number of rows of the state.
        num_parameters: number of rows of the parameters.
        num_operations: largest number of arithmetic operations and calls of `math.h` in a step.
        scenario: name of the scenario.
        scenario_sha256: digest of the scenario's file.
        version: version of drake_quad.
    """

    name: str
    precision: str
    period: float
    output_divisor: int
    inputs: dict[str, int]
    outputs: dict[str, int]
    num_states: int
    num_parameters: int
    num_operations: int
    scenario: str
    scenario_sha256: str
    version: str

    @property
    def number_type(self) -> Any:
        """NumPy type of a number."""
        return _NUMBER_TYPES[self.precision]

    @property
    def state_type(self) -> np.dtype:
        """NumPy type of the state struct."""
        fields = [("numbers", self.number_type, (self.num_states,)), ("step", np.uint32)]
        return np.dtype(fields if self.num_states else fields[1:], align=True)


def read_description(folder: Path) -> ExportDescription:
    """Return the description of the exported code in a folder.

    Raises:
        InputError: if the folder contains no exported code, or its description is damaged.
    """
    file = folder / DESCRIPTION_FILE
    try:
        fields = json.loads(file.read_text(encoding="utf-8"))
        description = ExportDescription(**fields)
        valid = description.precision in _NUMBER_TYPES and description.name.isidentifier() and description.period > 0.0
    except (OSError, ValueError) as error:
        raise InputError(f"{folder} contains no exported controller: {error}") from None
    except TypeError:
        valid = False
    if not valid:
        raise InputError(f"{file} is damaged, or was written by another version of drake_quad; export again")
    return description


class Machine(Protocol):
    """Computer that runs exported code."""

    def step(self, state: bytes, inputs: bytes) -> tuple[bytes, bytes]:
        """Return the next state and the outputs of a step, given the bytes of the structs."""


class HostMachine:
    """This computer: the exported code is compiled to a shared library.

    Args:
        folder: folder with the exported code.
        compiler: C compiler; by default the first that is found of cc, gcc and clang.
        flags: options of the compiler.

    Raises:
        InputError: if there is no compiler, the code cannot be compiled, or its structs differ from the description.
    """

    def __init__(
        self, folder: Path, *, compiler: str | None = None, flags: tuple[str, ...] = COMPILER_FLAGS
    ) -> None:
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
        """Return the next state and the outputs of a step."""
        memory, outputs = ctypes.create_string_buffer(state, len(state)), ctypes.create_string_buffer(self._num_output_bytes)
        self._step(memory, ctypes.c_void_p(self._parameters), inputs, outputs)
        return memory.raw, outputs.raw

    @staticmethod
    def initial_state(folder: Path, description: ExportDescription) -> bytes:
        """Return the initial state."""
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
    path = compiler or next(filter(None, map(shutil.which, _COMPILERS)), None)
    if path is None or shutil.which(path) is None:
        raise InputError(
            f"flying exported code needs a C compiler, but {compiler or 'none of cc, gcc and clang'} is"
            f"{' not' if compiler else ''} on PATH"
        )
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
        command = [compiler, *flags, "-shared", "-fPIC", "-I", folder, "-o", library, folder / f"{name}.c", sizes, "-lm"]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode:
            message = shorten_text(" ".join(result.stderr.split()), _MAX_MESSAGE_LENGTH)
            raise InputError(f"{compiler} cannot compile {folder / name}.c: {message}")
        return ctypes.CDLL(str(library))


class ExportedController(LeafSystem):
    """Controller that runs exported C code.

    The input and output ports have the names of the signals of the exported controller. The discrete state contains
    the rows of the exported state, and the number of steps since the start.

    `exported_controller` returns a subclass for a folder.

    Args:
        num_vehicles: number of vehicles N.

    Attributes:
        description: description of the exported code.
        folder: folder with the exported code.
        machine: name of the computer that runs the code, a key of `MACHINES`.
    """

    description: ClassVar[ExportDescription]
    folder: ClassVar[Path]
    machine: ClassVar[str]

    def __init__(self, num_vehicles: int = 1) -> None:
        super().__init__()
        self.num_vehicles = num_vehicles
        description = self.description
        for name, rows in description.inputs.items():
            self.DeclareVectorInputPort(name, rows * num_vehicles)
        self._running = MACHINES[self.machine](self.folder)
        initial = np.frombuffer(HostMachine.initial_state(self.folder, description), description.state_type)[0]
        rows = np.append(initial["numbers"] if description.num_states else [], float(initial["step"]))
        self.DeclareDiscreteState(np.repeat(rows, num_vehicles))
        self.DeclarePeriodicDiscreteUpdateEvent(description.period, 0.0, self._update)
        first = 0
        for name, rows in description.outputs.items():
            self._declare_output(name, slice(first, first + rows))
            first += rows

    def _declare_output(self, name: str, rows: slice) -> None:
        def calc(context: Context, output: BasicVector) -> None:
            # Between two steps that write outputs, the outputs are those of the present state.
            _, outputs = self._stepped(context, whole_divisor=True)
            output.SetFromVector(outputs[rows].ravel())

        self.DeclareVectorOutputPort(name, (rows.stop - rows.start) * self.num_vehicles, calc)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        next_state, _ = self._stepped(context, whole_divisor=False)
        state.set_value(next_state.ravel())

    def _stepped(self, context: Context, *, whole_divisor: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the (rows, N) next state and the (rows, N) outputs of a step.

        Args:
            context: context of the system.
            whole_divisor: True to round the number of the step down to a step that writes outputs.
        """
        description, n = self.description, self.num_vehicles
        state = context.get_discrete_state(0).value().reshape(-1, n)
        ports = [self.get_input_port(index) for index in range(self.num_input_ports())]
        values = [port.Eval(context).reshape(-1, n) for port in ports]
        inputs = np.vstack(values).astype(description.number_type)
        next_state, outputs = np.empty(state.shape), np.empty((sum(description.outputs.values()), n))
        memory = np.zeros(1, description.state_type)
        for vehicle in range(n):
            if description.num_states:
                memory["numbers"] = state[:-1, vehicle]
            step = int(state[-1, vehicle])
            memory["step"] = step - step % description.output_divisor if whole_divisor else step
            after, out = self._running.step(memory.tobytes(), inputs[:, vehicle].tobytes())
            stepped = np.frombuffer(after, description.state_type)[0]
            next_state[:-1, vehicle] = stepped["numbers"] if description.num_states else []
            next_state[-1, vehicle] = stepped["step"]
            outputs[:, vehicle] = np.frombuffer(out, description.number_type)
        return next_state, outputs


def exported_controller(folder: Path | str, machine: str = "host") -> type[ExportedController]:
    """Return the class of Drake systems that run the exported code in a folder.

    Args:
        folder: folder that `drake-quad export` wrote.
        machine: name of the computer that runs the code, a key of `MACHINES`.

    Raises:
        InputError: if the folder contains no exported code, the machine is unknown, or the code cannot be compiled.
    """
    folder = Path(folder)
    description = read_description(folder)
    if machine not in MACHINES:
        raise InputError(f"machine {machine!r} does not exist; use {', '.join(MACHINES)}")
    HostMachine(folder)  # reports errors of the compiler at once

    class Controller(ExportedController):
        pass

    Controller.__doc__, Controller.__name__ = ExportedController.__doc__, f"exported_{description.name}"
    Controller.description, Controller.folder, Controller.machine = description, folder, machine
    return Controller


MACHINES: dict[str, Callable[[Path], Machine]] = {"host": HostMachine}
"""Computers that can run exported code, by name."""
