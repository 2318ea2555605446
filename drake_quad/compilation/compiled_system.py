"""The Drake system that replaces all compiled systems of a diagram."""

import functools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from drake_quad.caching import ThreadSafeCache
from drake_quad.compilation.program import Event, EventCycle, Program
from drake_quad.compilation.shared_values import SharedValues
from drake_quad.compilation.topology import ExportedPort, Port
from drake_quad.compilation.trace import PERIOD_TOLERANCE
from drake_quad.errors import InputError, lookup, not_connected
from drake_quad.framework.fleet_system import FleetSystem

# Largest number of cached tables of shared values. When the cache is full, a new table replaces the oldest one.
_MAX_TABLES = 256
# Number of events in each cached table of shared values if the simulator requests one event at a time.
_EVENTS_PER_TABLE = 64


class Log:
    """Outputs of a compiled system, recorded since time zero.

    Attributes:
        parts: arrays (ticks, rows, columns) in the order of time. There is a column for each vehicle, and there are
            unused columns that fill the last SIMD vector.
    """

    def __init__(self) -> None:
        self.parts: list[np.ndarray] = []


class CompiledSystem(LeafSystem):
    """Single system that replaces all compiled systems of a diagram.

    The discrete state contains the state rows of all compiled systems, system by system. The first numeric parameter
    contains all their parameter rows.

    Args:
        program: compiler of the diagram.
        ticks: largest number of ticks that one event may simulate, if no other system needs intermediate results; None
            to declare an event at every instant at which the original diagram has an event.
        tick: period of the ticks, s, as in `compile_diagram`; None for the least common multiple of all periods.
        record: True to record the diagram's output ports at every tick.

    Attributes:
        program: compiler of the diagram.
        tick: period of the ticks, s.
        recorded: recorded output ports, by name.

    Raises:
        InputError: if the period of the ticks does not match the periods of the diagram.
    """

    def __init__(self, program: Program, *, ticks: int | None, tick: float | None, record: bool) -> None:
        super().__init__()
        self.program = program
        self._instants = program.cycle if tick is None else program.num_instants(tick)
        self.tick = self._instants * program.base
        state, parameters = program.read(program.diagram.CreateDefaultContext())
        self._state = self.DeclareDiscreteState(BasicVector(state))
        self._parameters = self.DeclareNumericParameter(BasicVector(parameters))
        self._end = self.DeclareNumericParameter(BasicVector([np.inf]))
        self._inputs = {
            source: self.DeclareVectorInputPort(input_name(program, source), rows * program.num_vehicles).get_index()
            for source, (_, rows) in program.row_ranges.inputs.items()
        }
        for name, port in program.topology.outputs.items():
            self._declare_output(name, port)
        for path, system in program.uncompiled.items():
            for index, source in enumerate(program.topology.sources(path)):
                if isinstance(source, Port) and source.path in program.blocks:
                    self._declare_output(f"{path}.{system.get_input_port(index).get_name()}", source)
        self.recorded = dict(program.topology.outputs) if record else {}
        self._log = self.DeclareAbstractParameter(AbstractValue.Make(Log())) if record else None
        self._tables: ThreadSafeCache[np.ndarray] = ThreadSafeCache(_MAX_TABLES)
        # An event may span several instants only if no other system uses the intermediate results.
        is_alone = not program.row_ranges.inputs
        cycle, ports = None, tuple(self.recorded.values())
        if ticks is not None and (is_alone or not program.uncompiled_have_state):
            cycle = program.event_cycle(ports, self._instants)
        if cycle is None:
            self._declare_instants()
        else:
            self._declare_cycle(cycle, ticks if is_alone and ticks is not None else 1)
        self._first = program.event_at(None)
        if self._first is not None:
            self.DeclareInitializationDiscreteUpdateEvent(self._initialize)

    def read(self, context: Context, diagram_context: Context) -> None:
        """Copy state and parameters of the compiled systems from a context of the original diagram."""
        state, parameters = self.program.read(diagram_context)
        context.get_mutable_discrete_state(self._state).SetFromVector(state)
        context.get_mutable_numeric_parameter(self._parameters).SetFromVector(parameters)

    def write(self, context: Context, diagram_context: Context) -> None:
        """Copy state and parameters of the compiled systems to a context of the original diagram."""
        state = context.get_discrete_state(self._state).CopyToVector()
        parameters = context.get_numeric_parameter(self._parameters).CopyToVector()
        self.program.write(diagram_context, state, parameters)

    def set_end(self, context: Context, time: float) -> None:
        """Set the end of the simulation, s. An event that simulates several ticks omits the ticks after this time."""
        context.get_mutable_numeric_parameter(self._end).SetFromVector([time])

    def get_state(self, context: Context, path: str, name: str) -> Any:
        """Return a copy of a FleetSystem's state group, as a NamedTuple with named components.

        Args:
            context: context of this system.
            path: path of the FleetSystem in the diagram, with names joined by dots.
            name: name of the state group.
        """
        group = lookup(self._system(path).states, name, "group of the state")
        rows = self._rows(
            context.get_discrete_state(self._state).value(), self.program.row_ranges.states[path, int(group.index)]
        )
        return group.layout.build(rows)

    def get_parameter(self, context: Context, path: str, name: str) -> Any:
        """Return a copy of a FleetSystem's parameter, as a NamedTuple; the arguments are as in `get_state`."""
        parameter = lookup(self._system(path).parameters, name, "parameter")
        row_range = self.program.row_ranges.parameters[path, int(parameter.index)]
        return parameter.layout.build(self._rows(context.get_numeric_parameter(self._parameters).value(), row_range))

    def log(self, context: Context) -> dict[str, np.ndarray]:
        """Return the signals recorded since time zero, by name, as arrays (ticks, rows · N)."""
        parts = context.get_abstract_parameter(self._log).get_value().parts
        n = self.program.num_vehicles
        num_rows = sum(self.GetOutputPort(name).size() for name in self.recorded) // n
        rows = np.concatenate(parts)[:, :, :n] if parts else np.empty((0, num_rows, n))
        signals, first = {}, 0
        for name in self.recorded:
            size = self.GetOutputPort(name).size() // n
            signals[name] = rows[:, first : first + size].reshape(len(rows), size * n)
            first += size
        return signals

    def _system(self, path: str) -> Any:
        system = self.program.topology.leaves.get(path)
        if not isinstance(system, FleetSystem) or path not in self.program.blocks:
            raise KeyError(
                f"{path} is not a compiled system; the compiled systems are {', '.join(self.program.blocks)}"
            )
        return system

    def _rows(self, numbers: np.ndarray, row_range: tuple[int, int]) -> Sequence[Any]:
        n = self.program.num_vehicles
        first, count = row_range
        part = numbers[first * n : (first + count) * n].copy()
        return part.tolist() if n == 1 else part.reshape(count, n)  # type: ignore[return-value]

    def _declare_instants(self) -> None:
        """Declare an event at every instant at which the original diagram has an event."""
        program, ports = self.program, tuple(self.recorded.values())
        discrete = [
            program.event_at(instant, () if instant % self._instants else ports) for instant in range(program.cycle)
        ]
        unrestricted = [program.event_at(instant, (), True) for instant in range(program.cycle)]
        starts = any(block_update.at_start for _, block_update in program.updates(0, unrestricted=True))

        def update(context: Context, values: Any) -> None:
            instant = round(context.get_time() / program.base)
            event = discrete[instant % program.cycle]
            if event is not None:
                self._advance(event, context, values.get_mutable_value(self._state), instant)

        def step(context: Context, state: Any) -> None:
            instant = round(context.get_time() / program.base)
            event = unrestricted[instant % program.cycle]
            if event is not None and (instant or starts):
                numbers = state.get_mutable_discrete_state(self._state).get_mutable_value()
                self._advance(event, context, numbers, instant)

        if any(unrestricted):
            self.DeclarePeriodicUnrestrictedUpdateEvent(program.base, 0.0, step)
        self.DeclarePeriodicDiscreteUpdateEvent(program.base, 0.0, update)

    def _declare_cycle(self, cycle: EventCycle, ticks: int) -> None:
        """Declare a periodic event that simulates consecutive events of a cycle.

        Args:
            cycle: events that are repeated periodically.
            ticks: number of consecutive events that one event of Drake's simulator simulates.
        """
        period, length = cycle.instants * self.program.base, len(cycle.kinds)

        def advance(context: Context, values: Any) -> None:
            first, count = round(context.get_time() / period), ticks
            if ticks > 1:
                last = context.get_numeric_parameter(self._end).value()[0]
                while count and (first + count - 1) * period > last:
                    count -= 1
            if count:
                state = values.get_mutable_value(self._state)
                if length == 1:  # the table and the log of a single kind of event need no copy
                    log = self._run(
                        cycle, context, state, self._table(cycle.shared[0], cycle.instants, first, count, 1)
                    )
                else:
                    places = (first + np.arange(count)) % length
                    log = self._run(cycle, context, state, self._cycle_table(cycle, first, places), cycle.kinds[places])
                    log = log[cycle.logs[places]]
                if cycle.loop.num_logged:
                    self._append_to_log(context, log, first)

        def check(context: Context, values: Any) -> None:
            begin = context.get_time() / (period * ticks)
            if abs(begin - round(begin)) > PERIOD_TOLERANCE:
                raise InputError(
                    f"a simulation cannot begin at {context.get_time():g} s, since an event simulates {ticks} ticks and"
                    f" events are {period * ticks:g} s apart; compile the diagram with ticks=None"
                )

        self.DeclareInitializationDiscreteUpdateEvent(check)
        self.DeclarePeriodicDiscreteUpdateEvent(period * ticks, 0.0, advance)

    def _initialize(self, context: Context, values: Any) -> None:
        self._run_now(self._first, context, values.get_mutable_value(self._state))

    def _advance(self, event: Event, context: Context, state: np.ndarray, instant: int) -> None:
        """Run the event at an instant of the diagram, counted from time zero, which changes the state."""
        table = self._table(event.shared, event.instants, instant, 1, self.program.cycle)
        log = self._run(event, context, state, table)
        if event.loop.num_logged:
            self._append_to_log(context, log, instant)

    def _append_to_log(self, context: Context, log: np.ndarray, first: int) -> None:
        """Append the log of events to the recorded outputs. The event with the number 0 begins a new record."""
        parts = context.get_abstract_parameter(self._log).get_value().parts
        if first == 0:
            parts.clear()
        parts.append(log)

    def _table(self, shared: SharedValues, instants: int, first: int, count: int, stride: int) -> np.ndarray:
        """Return the table rows of recurring events: the values that all vehicles share.

        The rows are cached. If few events are requested, the rows of later recurrences are computed as well.

        Args:
            shared: columns of the table.
            instants: number of instants of an event.
            first: number of the first event, counted from time zero.
            count: number of events.
            stride: distance between two recurrences. There are `stride - 1` other events between them.
        """
        recurrence, offset = divmod(first, stride)
        size = max(1, _EVENTS_PER_TABLE // count) * count
        begin = recurrence - recurrence % size
        if recurrence + count > begin + size:
            begin, size = recurrence, count

        def make() -> np.ndarray:
            numbers = stride * (begin + np.arange(size)) + offset
            return self.program.table(shared, self.program.times(numbers, instants))

        rows = self._tables.get((id(shared), stride, begin, size), make)
        return rows[recurrence - begin : recurrence - begin + count]

    def _cycle_table(self, cycle: EventCycle, first: int, places: np.ndarray) -> np.ndarray:
        """Return the table rows of consecutive events of a cycle, given their places in the cycle; see `_table`."""
        rows = np.zeros((len(places), max(1, *(each.width for each in cycle.shared))))
        for place in dict.fromkeys(places.tolist()):
            events = np.flatnonzero(places == place)
            start = first + int(events[0])
            table = self._table(cycle.shared[place], cycle.instants, start, len(events), len(cycle.kinds))
            rows[events, : table.shape[1]] = table
        return rows

    def _run_now(self, event: Any, context: Context, state: np.ndarray) -> np.ndarray:
        """Run an event of the compiled diagram at the time of the context, and return the values that it logs."""
        shared = self._shared_at(event, context.get_time())[None]
        return self._run(event, context, state, shared)[0, :, : self.program.num_vehicles]

    def _run(
        self,
        event: Event | EventCycle,
        context: Context,
        state: np.ndarray,
        shared: np.ndarray,
        order: np.ndarray | None = None,
    ) -> np.ndarray:
        """Run consecutive events with a table (events, width) of shared values, and return their logs.

        The kinds of the events in a cycle are given by `order`.
        """
        n = self.program.num_vehicles
        log = np.empty((len(shared), event.loop.num_logged, event.loop.padded_num_vehicles(n)))
        parameters = context.get_numeric_parameter(self._parameters).value()
        event.loop.run(state, parameters, self._input_rows(event.inputs, context), shared, log, n, order=order)
        return log

    def _input_rows(self, sources: Iterable[Port | ExportedPort], context: Context) -> np.ndarray:
        """Return the rows of all external inputs; rows of inputs that are not in `sources` are uninitialized."""
        n, sizes = self.program.num_vehicles, self.program.sizes
        inputs = np.empty(sizes.inputs * n)
        for source in sources:
            first, rows = self.program.row_ranges.inputs[source]
            vector = self.EvalVectorInput(context, self._inputs[source])
            if vector is None:
                raise not_connected(input_name(self.program, source), self)
            if rows == sizes.inputs:
                whole: np.ndarray = vector.value()
                return whole
            inputs[first * n : (first + rows) * n] = vector.value()
        return inputs

    def _declare_output(self, name: str, port: Port) -> None:
        """Declare an output port that has the value of a leaf system's output port."""
        size = self.program.topology.leaves[port.path].get_output_port(port.number).size()
        logging_event = functools.cache(
            lambda: self.program.logging_event((port,))
        )  # an output is compiled when it is first evaluated

        def calc(context: Context, output: BasicVector) -> None:
            # The event writes the value of the port to its log, and does not change the state.
            state = context.get_discrete_state(self._state).value()
            output.SetFromVector(self._run_now(logging_event(), context, state).ravel())

        sources = self.program.external_sources(port)
        tickets = {self.xd_ticket(), self.pn_ticket(), self.time_ticket()}
        tickets |= {self.input_port_ticket(self._inputs[source]) for source in sources}
        self.DeclareVectorOutputPort(name, size, calc, tickets)

    def _shared_at(self, event: Event, time: float) -> np.ndarray:
        """Return the shared values at a time (s); they are cached if the time is an instant of the diagram."""
        instant = round(time / self.program.base)
        if instant * self.program.base == time:
            return self._table(event.shared, event.instants, instant, 1, 1)[0]
        return self.program.table(event.shared, np.full((1, event.instants + 1), time))[0]


def input_name(program: Program, source: Port | ExportedPort) -> str:
    """Return the name of the compiled system's input port for an external source."""
    if isinstance(source, ExportedPort):
        return source.name
    port = program.topology.leaves[source.path].get_output_port(source.number)
    return f"{source.path}.{port.get_name()}"
