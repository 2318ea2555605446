"""A compiled fleet whose vehicles have clocks of their own.

Drake's simulator has one time for all. Where one vehicle of a fleet begins anew while the others fly on, each needs a
time of its own: its clock counts the ticks since it began, and says which reference and which random numbers it gets.
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

# First row and layout, by the name.
_Places = dict[str, tuple[int, Layout]]


class Beginnings(NamedTuple):
    """Vehicles at time zero.

    Attributes:
        state: (N, rows).
        parameters: (N, rows).
        shown: (N, rows) of the ports that are shown.
    """

    state: np.ndarray
    parameters: np.ndarray
    shown: np.ndarray


class Beginning:
    """How simulations of a diagram begin, in machine code.

    Args:
        diagram: of systems that can be compiled, for any number of vehicles.
        shown: names of its output ports.

    Raises:
        InputError: the diagram cannot be compiled so, and why.
    """

    def __init__(self, diagram: Diagram, *, shown: Sequence[str]) -> None:
        self._program = program = _compilable(diagram)
        look = program.look(tuple([program.topology.outputs[name] for name in shown]))
        self._events = [event for event in (program.stage(None), look) if event is not None]

    def of(self, context: Context) -> Beginnings:
        """The vehicles of a context of the diagram, at time zero."""
        program, n = self._program, self._program.num_vehicles
        state, parameters = program.read(context)
        for event in self._events:
            table = program.table(event.shared, np.zeros((1, event.instants + 1)))
            log = np.empty((1, event.loop.num_logged, event.loop.padded(n)))
            event.loop.run(state, parameters, np.zeros(program.sizes.inputs * n), table, log, n)
        return Beginnings(state.reshape(-1, n).T, parameters.reshape(-1, n).T, log[0, :, :n].T)


def _compilable(diagram: Diagram) -> Program:
    program = Program(diagram)
    for path, system in program.others.items():
        raise InputError(
            f"{path}, a {type(system).__name__}, cannot be compiled, so vehicles beside it have no clocks of their own"
        )
    return program


class ClockedFleet:
    """The vehicles of a diagram in machine code, tick after tick, each at its own time.

    A tick goes from before the discrete updates of an instant to before those of the next one: what the diagram's input
    port holds meanwhile is seen by the first, and what is shown is what the next one will see.

    Args:
        diagram: of systems that can be compiled, for any number of vehicles, with one input port.
        tick: s; all that happens in the diagram must happen in each.
        num_ticks: that a clock can count; at the last it stays.
        shown: names of the diagram's output ports, each once.
        judge: path of the system whose next discrete state is shown, too.

    Attributes:
        num_vehicles: N.
        clocks: (N,) ticks that each vehicle has flown, int64.

    Raises:
        InputError: the diagram cannot be compiled so, and why.
    """

    def __init__(self, diagram: Diagram, *, tick: float, num_ticks: int, shown: Sequence[str], judge: str) -> None:
        self._program = program = _compilable(diagram)
        ports = tuple([program.topology.outputs[name] for name in shown])
        instants = program.instants_of(tick)
        loop, shared = program.tick(instants, ports, judge)
        self.num_vehicles, self._loop, self._last = program.num_vehicles, loop, num_ticks
        self._table = program.table(shared, program.times(0, instants, num_ticks + 1))
        self._ports, self._judged = self._placed(shown, judge)
        self._all_clocks = loop.clocks.reshape(-1)
        self.clocks = self._all_clocks[: self.num_vehicles]
        self._held = np.zeros((self._all_clocks.size, program.sizes.inputs))

    def place(self, vehicles: np.ndarray, begun: Beginnings) -> None:
        """Lets vehicles begin anew.

        Args:
            vehicles: (k,) their numbers.
            begun: (k, rows) how each of them begins.
        """
        loop = self._loop
        vectors, lanes = np.divmod(vehicles, loop.lanes)
        self.clocks[vehicles] = 0
        loop.log[vectors, : begun.shown.shape[1], lanes] = begun.shown
        loop.state[vectors, :, lanes] = begun.state
        loop.parameters[vectors, :, lanes] = begun.parameters
        loop.prepare(np.unique(vectors).tolist())

    def advance(self, inputs: np.ndarray) -> None:
        """Lets a tick pass.

        Args:
            inputs: (N, rows) of the diagram's input port.
        """
        loop, rows = self._loop, self._held.shape[1]
        self._held[: self.num_vehicles] = inputs
        loop.inputs[...] = self._held.reshape(len(loop.state), loop.lanes, rows).transpose(0, 2, 1)
        loop.advance(self._table)
        np.minimum(self._all_clocks + 1, self._last, out=self._all_clocks)

    def columns(self, name: str) -> slice:
        """Where among all that is shown a port stands, given its name."""
        first, layout = self._ports[name]
        return slice(first, first + layout.num_rows)

    def shown(self, name: str, dtype: Any = float) -> np.ndarray:
        """(N, rows) what a port shows after a tick, given its name, as numbers of a kind."""
        rows = self._loop.log[:, self.columns(name)]
        return np.array(rows.transpose(0, 2, 1), dtype, order="C").reshape(-1, rows.shape[1])[: self.num_vehicles]

    def record(self, name: str) -> Any:
        """The same as a record of (N,) rows."""
        return self._record(*self._ports[name])

    def judged(self, name: str) -> Any:
        """What a state of the judge will be, given its name, as a record of (N,) rows."""
        return self._record(*self._judged[name])

    def _record(self, first: int, layout: Layout) -> Any:
        rows = self._loop.log[:, first : first + layout.num_rows].transpose(1, 0, 2)
        return layout.build([*np.array(rows, order="C").reshape(len(rows), -1)[:, : self.num_vehicles]])

    def _placed(self, shown: Sequence[str], judge: str) -> tuple[_Places, _Places]:
        """Where ports stand, and where the judge's states."""
        ports = []
        for name in shown:
            kind, size = SIGNALS[name], self._program.diagram.GetOutputPort(name).size() // self.num_vehicles
            ports.append(layout_of(kind, None if hasattr(kind, "_fields") else (0.0,) * size))
        system: FleetSystem = self._program.topology.leaves[judge]
        written = {write.name for update in system.updates for write in update.computation.writes}
        groups = sorted(system.states.values(), key=lambda group: int(group.index or 0))
        states = {group.name: group.layout for group in groups if group.name in written}
        layouts = [*ports, *states.values()]
        firsts = itertools.accumulate((layout.num_rows for layout in layouts), initial=0)
        places = [*zip(firsts, layouts, strict=False)]
        return dict(zip(shown, places, strict=False)), dict(zip(states, places[len(shown) :], strict=True))
