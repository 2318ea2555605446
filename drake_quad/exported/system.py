"""Drake system that runs exported code in the loop."""

import hashlib
from pathlib import Path
from typing import ClassVar

import numpy as np
from pydrake.systems.framework import BasicVector, Context, DiscreteValues, LeafSystem

from drake_quad.errors import InputError
from drake_quad.exported.description import ExportDescription, read_description
from drake_quad.exported.machines import MACHINES, HostMachine


class ExportedController(LeafSystem):
    """Controller that runs exported C code.

    The input and output ports have the names of the signals of the exported controller. The discrete state consists
    of the state variables of the C code and the number of steps since the start.

    `exported_controller` returns a subclass for a folder.

    Args:
        num_vehicles: number of vehicles N.

    Attributes:
        description: description of the exported code.
        folder: folder with the exported code.
        machine: name of the computer that runs the code, a key of `MACHINES`.
        max_instructions: largest number of instructions of a step so far; 0 if the computer does not count them.
        reads_true_state: True if the exported controller has the input `state` instead of `measurement`. This is the
            case for policies that were trained on the true state.
    """

    description: ClassVar[ExportDescription]
    folder: ClassVar[Path]
    machine: ClassVar[str]
    max_instructions: ClassVar[int] = 0

    def __init__(self, num_vehicles: int = 1) -> None:
        super().__init__()
        self.reads_true_state = "state" in self.description.inputs
        self.num_vehicles = num_vehicles
        description = self.description
        for name, rows in description.inputs.items():
            self.DeclareVectorInputPort(name, rows * num_vehicles)
        self._running = MACHINES[self.machine](self.folder)
        initial = np.frombuffer(HostMachine.initial_state(self.folder, description), description.state_type)[0]
        numbers = np.append(initial["numbers"] if description.num_states else [], float(initial["step"]))
        self.DeclareDiscreteState(np.repeat(numbers, num_vehicles))
        self.DeclarePeriodicDiscreteUpdateEvent(description.period, 0.0, self._update)
        first = 0
        for name, rows in description.outputs.items():
            self._declare_output(name, slice(first, first + rows))
            first += rows

    def _declare_output(self, name: str, rows: slice) -> None:
        def calc(context: Context, output: BasicVector) -> None:
            # The C code writes outputs only in some steps. To evaluate the port at any time, pretend that the present
            # step is one of them.
            _, outputs = self._stepped(context, as_output_step=True)
            output.SetFromVector(outputs[rows].ravel())

        self.DeclareVectorOutputPort(name, (rows.stop - rows.start) * self.num_vehicles, calc)

    def _update(self, context: Context, state: DiscreteValues) -> None:
        next_state, _ = self._stepped(context, as_output_step=False)
        state.set_value(next_state.ravel())

    def _stepped(self, context: Context, *, as_output_step: bool) -> tuple[np.ndarray, np.ndarray]:
        """Return the next state and the outputs of a step, both as arrays (components, N).

        Args:
            context: context of the system.
            as_output_step: True to replace the step number by that of the latest step in which the code writes outputs.
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
            memory["step"] = step - step % description.output_divisor if as_output_step else step
            after, out = self._running.step(memory.tobytes(), inputs[:, vehicle].tobytes())
            stepped = np.frombuffer(after, description.state_type)[0]
            next_state[:-1, vehicle] = stepped["numbers"] if description.num_states else []
            next_state[-1, vehicle] = stepped["step"]
            outputs[:, vehicle] = np.frombuffer(out, description.number_type)
        type(self).max_instructions = max(self.max_instructions, getattr(self._running, "max_instructions", 0))
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
    HostMachine(folder)  # compiles the code now, so that compiler errors are reported here

    class Controller(ExportedController):
        pass

    code = b"".join((folder / f"{description.name}{suffix}").read_bytes() for suffix in (".h", ".c"))
    digest = hashlib.sha256(f"{machine} {description}".encode() + code).hexdigest()[:8]
    # `register_controller` derives the kind of the controller in scenarios from these names: exported.NAME_DIGEST.
    Controller.__module__, Controller.__name__ = "exported", f"{description.name}_{digest}"
    Controller.__doc__ = ExportedController.__doc__
    Controller.description, Controller.folder, Controller.machine = description, folder, machine
    return Controller
