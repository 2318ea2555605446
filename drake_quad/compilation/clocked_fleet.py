"""Compiled fleet whose vehicles restart individually, each with its own clock.

In Drake's simulator, all vehicles share one time. Vehicles that restart at different times need individual clocks. A
vehicle's clock counts the ticks since its last restart, and determines its reference and its random numbers.
"""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.systems.framework import Context, Diagram

from drake_quad.compilation.program import Program
from drake_quad.errors import InputError
from drake_quad.framework.fleet_system import FleetSystem
from drake_quad.framework.records import Layout, layout_of
from drake_quad.signals import SIGNALS

# First row in the log, and layout, of each port or state group, by name.
_LogRows = dict[str, tuple[int, Layout]]


class InitialValues(NamedTuple):
    """State, parameters and outputs of N vehicles at time zero.

    Attributes:
        state: (N, rows) state.
        parameters: (N, rows) parameters.
        outputs: (N, rows) values of the selected output ports.
    """

    state: np.ndarray
    parameters: np.ndarray
    outputs: np.ndarray


class Initializer:
    """Machine code that computes the initial values of a diagram's simulations.

    Args:
        diagram: diagram for any number of vehicles; all its systems must be compilable.
        outputs: names of the selected output ports.

    Raises:
        InputError: if a system of the diagram cannot be compiled.
    """

    def __init__(self, diagram: Diagram, *, outputs: Sequence[str]) -> None:
        self._program = program = _compilable_program(diagram)
        logging_event = program.logging_event(tuple([program.topology.outputs[name] for name in outputs]))
        self._events = [event for event in (program.event_at(None), logging_event) if event is not None]

    def initial_values(self, context: Context) -> InitialValues:
        """Return state, parameters and outputs at time zero, for the parameters in a context of the diagram."""
        program, n = self._program, self._program.num_vehicles
        state, parameters = program.read(context)
        for event in self._events:
            table = program.table(event.shared, np.zeros((1, event.instants + 1)))
            log = np.empty((1, event.loop.num_logged, event.loop.padded_num_vehicles(n)))
            event.loop.run(state, parameters, np.zeros(program.sizes.inputs * n), table, log, n)
        return InitialValues(state.reshape(-1, n).T, parameters.reshape(-1, n).T, log[0, :, :n].T)


def _compilable_program(diagram: Diagram) -> Program:
    program = Program(diagram)
    for path, system in program.uncompiled.items():
        raise InputError(
            f"{path}, a {type(system).__name__}, cannot be compiled, so vehicles of its diagram cannot have individual"
            " clocks"
        )
    return program


class ClockedFleet:
    """Fleet that machine code simulates tick by tick, with an individual clock for each vehicle.

    A tick starts with discrete updates and ends just before the discrete updates of the next tick. The value of the
    diagram's input port is constant during a tick. The outputs are evaluated at the end of the tick.

    Args:
        diagram: diagram for any number of vehicles with one input port; all its systems must be compilable.
        tick: period of the ticks, s; it must be the least common multiple of the diagram's periods.
        num_ticks: tick count at which each clock stops.
        outputs: names of the selected output ports of the diagram, without duplicates.
        monitor: path of a system whose next discrete state can also be read.

    Attributes:
        num_vehicles: number N of vehicles.
        clocks: (N,) numbers of ticks since the last restart of each vehicle, int64.

    Raises:
        InputError: if the diagram cannot be compiled with ticks of this period.
    """

    def __init__(self, diagram: Diagram, *, tick: float, num_ticks: int, outputs: Sequence[str], monitor: str) -> None:
        self._program = program = _compilable_program(diagram)
        ports = tuple([program.topology.outputs[name] for name in outputs])
        instants = program.num_instants(tick)
        loop, shared = program.tick_loop(instants, ports, monitor)
        self.num_vehicles, self._loop, self._max_clock = program.num_vehicles, loop, num_ticks
        self._table = program.table(shared, program.times(np.arange(num_ticks + 1), instants))
        self._output_rows, self._state_rows = self._log_rows(outputs, monitor)
        self._all_clocks = loop.clocks.reshape(-1)
        self.clocks = self._all_clocks[: self.num_vehicles]
        self._inputs = np.zeros((self._all_clocks.size, program.sizes.inputs))

    def restart(self, vehicles: np.ndarray, initial: InitialValues) -> None:
        """Restart k vehicles.

        Args:
            vehicles: (k,) indices of the vehicles.
            initial: initial values of the k vehicles.
        """
        loop = self._loop
        vectors, lanes = np.divmod(vehicles, loop.lanes)
        self.clocks[vehicles] = 0
        loop.log[vectors, : initial.outputs.shape[1], lanes] = initial.outputs
        loop.state[vectors, :, lanes] = initial.state
        loop.parameters[vectors, :, lanes] = initial.parameters
        loop.prepare(np.unique(vectors).tolist())

    def advance(self, inputs: np.ndarray) -> None:
        """Simulate one tick.

        Args:
            inputs: (N, rows) value of the diagram's input port.
        """
        loop, rows = self._loop, self._inputs.shape[1]
        self._inputs[: self.num_vehicles] = inputs
        loop.inputs[...] = self._inputs.reshape(len(loop.state), loop.lanes, rows).transpose(0, 2, 1)
        loop.advance(self._table)
        np.minimum(self._all_clocks + 1, self._max_clock, out=self._all_clocks)

    def columns(self, name: str) -> slice:
        """Return the columns of `InitialValues.outputs` that belong to a selected output port."""
        first, layout = self._output_rows[name]
        return slice(first, first + layout.num_rows)

    def outputs(self, name: str, dtype: Any = float) -> np.ndarray:
        """Return the (N, rows) value of a selected output port after a tick, converted to a NumPy type."""
        rows = self._loop.log[:, self.columns(name)]
        return np.array(rows.transpose(0, 2, 1), dtype, order="C").reshape(-1, rows.shape[1])[: self.num_vehicles]

    def output_record(self, name: str) -> Any:
        """Return the value of a selected output port after a tick, as a NamedTuple of (N,) arrays."""
        return self._record(*self._output_rows[name])

    def next_state(self, name: str) -> Any:
        """Return the value that the monitor's next update will give to its state group `name`.

        The result is a NamedTuple of (N,) arrays.
        """
        return self._record(*self._state_rows[name])

    def _record(self, first: int, layout: Layout) -> Any:
        rows = self._loop.log[:, first : first + layout.num_rows].transpose(1, 0, 2)
        return layout.build([*np.array(rows, order="C").reshape(len(rows), -1)[:, : self.num_vehicles]])

    def _log_rows(self, outputs: Sequence[str], monitor: str) -> tuple[_LogRows, _LogRows]:
        """Return the first row in the log, and the layout, of each output port and each state group of the monitor."""
        ports = []
        for name in outputs:
            kind, size = SIGNALS[name], self._program.diagram.GetOutputPort(name).size() // self.num_vehicles
            ports.append(layout_of(kind, None if hasattr(kind, "_fields") else (0.0,) * size))
        system: FleetSystem = self._program.topology.leaves[monitor]
        written = {write.name for update in system.updates for write in update.computation.writes}
        groups = sorted(system.states.values(), key=lambda group: int(group.index or 0))
        states = {group.name: group.layout for group in groups if group.name in written}
        layouts = [*ports, *states.values()]
        firsts = itertools.accumulate((layout.num_rows for layout in layouts), initial=0)
        log_rows = [*zip(firsts, layouts, strict=False)]
        return dict(zip(outputs, log_rows, strict=False)), dict(zip(states, log_rows[len(outputs) :], strict=True))
