"""Compiler of a diagram, which determines the instants of its events and generates the machine code of each event."""

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from pydrake.systems.framework import Context, Diagram

from drake_quad.caching import ThreadSafeCache
from drake_quad.compilation.blocks import Block, BlockUpdate, find_block
from drake_quad.compilation.clocked_loop import ClockedLoop
from drake_quad.compilation.loop import EventCode, Loop
from drake_quad.compilation.parts import PartSizes, Results
from drake_quad.compilation.placeholder import has_state, wrapped_system
from drake_quad.compilation.shared_values import SharedValues
from drake_quad.compilation.topology import ExportedPort, Port, Topology
from drake_quad.compilation.trace import PERIOD_TOLERANCE, RowRanges, Trace
from drake_quad.errors import InputError
from drake_quad.framework.fleet_system import FleetSystem
from drake_quad.process_settings import without_garbage_collection

# Largest supported number of instants in the least common multiple of all periods.
_MAX_CYCLE = 64
# Largest number of events whose machine code is cached. Diagrams that differ only in their values and in the number of
# vehicles share this machine code.
_MAX_CACHED_EVENTS = 256
_event_cache: ThreadSafeCache[Any] = ThreadSafeCache(_MAX_CACHED_EVENTS)
_Result = TypeVar("_Result")
_Key = TypeVar("_Key")


class Event(NamedTuple):
    """Machine code that simulates an event.

    Attributes:
        loop: machine code and its memory.
        shared: columns of the table of values that all vehicles share.
        instants: number of consecutive instants that the event simulates.
        inputs: external inputs that the event reads.
    """

    loop: Loop
    shared: SharedValues
    instants: int
    inputs: frozenset[Port | ExportedPort]


class EventCycle(NamedTuple):
    """Machine code that simulates consecutive events, which are repeated periodically.

    Events with the same operations share their machine code.

    Attributes:
        loop: machine code of all kinds of events, and its memory.
        kinds: index of the kind of each event in the cycle.
        logs: mask of the events in the cycle that write to the log.
        shared: columns of the table of values that all vehicles share, for each event in the cycle.
        instants: number of consecutive instants that each event simulates.
        inputs: external inputs that the events read.
    """

    loop: Loop
    kinds: np.ndarray
    logs: np.ndarray
    shared: list[SharedValues]
    instants: int
    inputs: frozenset[Port | ExportedPort]


class _TracedEvent(NamedTuple):
    """Event before its operations are compiled: the operations, the shared values, and the external inputs it reads."""

    code: EventCode
    shared: SharedValues
    inputs: frozenset[Port | ExportedPort]


def _cached(make: Callable[..., _Result]) -> Callable[..., _Result]:
    """Cache the results of a `Program` method for all equivalent diagrams; its arguments must be hashable."""

    @functools.wraps(make)
    def shared(program: "Program", *arguments: Any) -> _Result:
        def make_without_collection() -> _Result:
            with without_garbage_collection():
                return make(program, *arguments)

        result: _Result = _event_cache.get((program.signature, make.__name__, *arguments), make_without_collection)
        return result

    return shared


class Program:
    """Compiler of a diagram.

    Attributes:
        diagram: diagram to compile.
        topology: leaf systems and connections of the diagram.
        blocks: leaf systems that can be compiled, by path.
        row_ranges: rows that each state group, parameter and external input occupies.
        sizes: total number of state rows, parameter rows and rows of external inputs.
        num_vehicles: number N of vehicles.
        base: time between two instants, which is the diagram's shortest period, s.
        cycle: number of instants in a cycle, which is the least common multiple of the diagram's periods.

    Raises:
        InputError: if the diagram contains no FleetSystem, or if its periods are not multiples of the shortest period.
    """

    def __init__(self, diagram: Diagram) -> None:
        self.diagram, self.topology = diagram, Topology(diagram)
        leaves = self.topology.leaves
        blocks = {path: find_block(system) for path, system in leaves.items()}
        self.blocks: dict[str, Block] = {path: block for path, block in blocks.items() if block is not None}
        fleets = {system.num_vehicles for system in leaves.values() if isinstance(system, FleetSystem)}
        if not fleets:
            raise InputError(f"{diagram.get_name()} cannot be compiled: it contains no FleetSystem")
        if len(fleets) > 1:
            raise InputError(
                f"{diagram.get_name()} cannot be compiled: its systems have different numbers of vehicles:"
                f" {sorted(fleets)}"
            )
        (self.num_vehicles,) = fleets
        self.row_ranges = self._row_ranges(diagram.CreateDefaultContext())
        self.sizes = PartSizes(*(sum(rows for _, rows in row_ranges.values()) for row_ranges in self.row_ranges))
        self.base, self.cycle = self._instants()

    @property
    def uncompiled(self) -> dict[str, Any]:
        """Leaf systems of the diagram that are not compiled, keyed by path."""
        return {path: system for path, system in self.topology.leaves.items() if path not in self.blocks}

    @property
    def uncompiled_have_state(self) -> bool:
        """True if an uncompiled system has a state."""
        return any(has_state(wrapped_system(system)) for system in self.uncompiled.values())

    def updates(self, instant: int | None, *, unrestricted: bool = False) -> list[tuple[str, BlockUpdate]]:
        """Return all updates at an instant, each with the path of its block.

        Args:
            instant: number of the instant in the cycle; None for the start of a simulation.
            unrestricted: True for the unrestricted updates, False for the discrete updates.
        """
        return [
            (path, update)
            for path, block in self.blocks.items()
            for update in block.updates
            if update.unrestricted == unrestricted and self._is_due(update, instant)
        ]

    def external_sources(self, port: Port) -> set[Port | ExportedPort]:
        """Return the external sources that have direct feedthrough to a leaf system's output port."""
        if port in self.row_ranges.inputs:
            return {port}
        sources: set[Port | ExportedPort] = set()
        for index in self.blocks[port.path].feedthrough(port.number):
            source = self.topology.source(Port(port.path, index))
            if isinstance(source, Port):
                sources |= self.external_sources(source)
            elif source is not None:
                sources.add(source)
        return sources

    def read(self, context: Context) -> tuple[np.ndarray, np.ndarray]:
        """Return the (rows · N,) state and parameters in a context of the diagram."""
        n = self.num_vehicles
        state, parameters = np.empty(self.sizes.state * n), np.empty(self.sizes.parameters * n)
        for vector, numbers in self._vectors(context, state, parameters):
            numbers[:] = vector.CopyToVector()
        return state, parameters

    def write(self, context: Context, state: np.ndarray, parameters: np.ndarray) -> None:
        """Write (rows · N,) state and parameters to a context of the diagram."""
        for vector, numbers in self._vectors(context, state, parameters):
            vector.SetFromVector(numbers)

    @_cached
    def event_at(
        self, instant: int | None, recorded: tuple[Port, ...] = (), unrestricted: bool = False
    ) -> Event | None:
        """Return the event at an instant of the cycle, or at the start of a simulation; None if nothing happens then.

        Args:
            instant: number of the instant in the cycle; None for the start of a simulation.
            recorded: output ports that are logged before the updates.
            unrestricted: True for an event with the unrestricted updates, False for an event with the discrete updates.
        """
        updates = self.updates(instant, unrestricted=unrestricted)
        trace, shared = self._trace(1)
        logged = _rows(trace, recorded)
        if not updates and not logged:
            return None
        trace.advance(updates, first=not instant)
        return self._event(trace, shared, 1, logged)

    @_cached
    def logging_event(self, logged_ports: tuple[Port, ...]) -> Event:
        """Return an event that logs the values of output ports at an instant, and changes no state."""
        trace, shared = self._trace(1)
        return self._event(trace, shared, 1, _rows(trace, logged_ports))

    def num_instants(self, period: float) -> int:
        """Return the number of instants in a period (s) of the diagram.

        Raises:
            InputError: if the diagram's cycle is not a multiple of this period.
        """
        instants = round(period / self.base)
        if not instants or abs(period / self.base - instants) > PERIOD_TOLERANCE or self.cycle % instants:
            raise InputError(
                f"{self.diagram.get_name()} cannot be compiled with ticks of {period:g} s: their period must be a"
                f" multiple of {self.base:g} s, and must divide {self.cycle * self.base:g} s, the least common multiple"
                " of all periods"
            )
        return instants

    @_cached
    def event_cycle(self, recorded: tuple[Port, ...], max_instants: int) -> EventCycle | None:
        """Return the events that simulate a cycle, each over as many instants as possible.

        An event starts with the discrete updates at an instant and ends just before the discrete updates at a later
        instant. A cycle consists of several events if external inputs are read more than once, or if a single event
        would exceed `max_instants` instants. The result is None if an unrestricted update takes place at time zero, or
        reads an external input.

        Args:
            recorded: ports that are logged every `max_instants` instants, from the first instant on.
            max_instants: largest number of instants in an event. The cycle must be a multiple of it.
        """
        if any(update.at_start for _, update in self.updates(0, unrestricted=True)):
            # An event begins with discrete updates, so it cannot contain an unrestricted update at time zero.
            return None
        for instants in (each for each in range(max_instants, 0, -1) if max_instants % each == 0):
            events = []
            for first in range(0, self.cycle, instants):
                event = self._multi_instant_event(first, instants, () if first % max_instants else recorded)
                if event is None:
                    break
                events.append(event)
            else:
                return self._compiled_cycle(events, instants)
        return None

    def _compiled_cycle(self, events: Sequence[_TracedEvent], instants: int) -> EventCycle:
        """Return the machine code of the events of a cycle, each over the given number of instants."""
        operations = [(event.code.listing.digest(), Results.of(*event.code)) for event in events]
        kinds = [index for index, each in enumerate(operations) if each not in operations[:index]]
        loop = Loop(
            [events[index].code for index in kinds],
            sizes=self.sizes,
            width=max(event.shared.width for event in events),
            single_vehicle=self.num_vehicles == 1,
        )
        return EventCycle(
            loop,
            np.array([kinds.index(operations.index(each)) for each in operations], dtype=np.int64),
            np.array([len(event.code.logged) > 0 for event in events]),
            [event.shared for event in events],
            instants,
            frozenset().union(*[event.inputs for event in events]),
        )

    def _multi_instant_event(self, first: int, instants: int, recorded: Iterable[Port]) -> _TracedEvent | None:
        """Return an event over several instants; None if it would read external inputs after the first instant."""
        trace, shared = self._trace(instants)
        logged = _rows(trace, recorded)
        trace.advance(self.updates(first), first=first == 0)
        used_inputs = frozenset(trace.inputs)
        trace.inputs.clear()
        self._trace_until(trace, first, instants)
        return None if trace.inputs else _TracedEvent(_code_of(trace, logged), shared, used_inputs)

    def _trace_until(self, trace: Trace, first: int, instants: int) -> None:
        """Trace the events that follow the discrete updates at the instant `first`.

        The trace ends just before the discrete updates at the instant `first + instants`.
        """
        for instant in range(first + 1, first + instants + 1):
            trace.next_instant()
            trace.advance(self.updates(instant % self.cycle, unrestricted=True))
            if instant < first + instants:
                trace.advance(self.updates(instant % self.cycle))

    def tick_loop(
        self, instants: int, logged_ports: tuple[Port, ...], monitor: str
    ) -> tuple[ClockedLoop, SharedValues]:
        """Return the machine code of a tick for vehicles with individual clocks, and its columns of shared values.

        At the end of a tick, the log contains the rows of the ports, followed by the monitor's next state in the order
        of its state groups.

        Args:
            instants: number of instants in a tick; it must equal the number of instants in a cycle of the diagram.
            logged_ports: output ports whose values are logged.
            monitor: path of the system whose next state is logged.

        Raises:
            InputError: if a tick is shorter than a cycle of the diagram, or the diagram has an unrestricted update at
                time zero.
        """
        name = self.diagram.get_name()
        if instants != self.cycle:
            raise InputError(
                f"vehicles of {name} cannot have individual clocks: the events of the diagram must repeat in every tick"
                f" of {instants * self.base:g} s, but repeat only every {self.cycle * self.base:g} s"
            )
        if any(update.at_start for _, update in self.updates(0, unrestricted=True)):
            raise InputError(
                f"vehicles of {name} cannot have individual clocks: the diagram has an unrestricted update at time zero"
            )
        loop, shared = self._tick_loop(instants, logged_ports, monitor)
        return loop.with_num_vehicles(self.num_vehicles), shared

    @_cached
    def _tick_loop(
        self, instants: int, logged_ports: tuple[Port, ...], monitor: str
    ) -> tuple[ClockedLoop, SharedValues]:
        trace, shared = self._trace(instants)
        trace.advance(self.updates(0), first=True)
        self._trace_until(trace, 0, instants)
        logged = _rows(trace, logged_ports)
        next_states = trace.updated_states([(path, update) for path, update in self.updates(0) if path == monitor])
        logged += [row for _, rows in sorted(next_states.items()) for row in rows]
        loop = ClockedLoop(
            trace.listing,
            trace.changes(),
            logged,
            sizes=self.sizes,
            width=shared.width,
            num_vehicles=1 if self.num_vehicles == 1 else 2,
        )
        return loop, shared

    def times(self, events: np.ndarray, instants: int) -> np.ndarray:
        """Return the times of all instants of events, an array (events, instants + 1), s.

        Args:
            events: numbers of the events, counted from time zero.
            instants: number of instants of each event.
        """
        begins = instants * events
        times: np.ndarray = (begins[:, None] + np.arange(instants + 1)) * self.base
        return times

    def table(self, shared: SharedValues, times: np.ndarray) -> np.ndarray:
        """Return the table (events, width) of shared values at given times (events, instants), s."""
        # Each call creates new contexts, so that threads that share a diagram do not change each other's time.
        contexts: dict[str, Context] = {}

        def values(path: str, output: int, time: float) -> np.ndarray:
            system = self.topology.leaves[path]
            if path not in contexts:
                contexts[path] = system.CreateDefaultContext()
            contexts[path].SetTime(time)
            value: np.ndarray = system.get_output_port(output).Eval(contexts[path])
            return value

        return shared.table(times, values)

    @functools.cached_property
    def signature(self) -> tuple[Any, ...]:
        """Hashable key of the program. Diagrams with equal keys have the same machine code."""
        leaves = self.topology.leaves
        blocks = tuple(
            [(path, block.signature, tuple(self.topology.sources(path))) for path, block in self.blocks.items()]
        )
        uncompiled = tuple([(path, tuple(self.topology.sources(path))) for path in leaves if path not in self.blocks])
        outputs = tuple(self.topology.outputs.items())
        row_ranges = tuple([tuple(each.items()) for each in self.row_ranges])
        return blocks, uncompiled, outputs, row_ranges, self.num_vehicles == 1

    def _trace(self, instants: int) -> tuple[Trace, SharedValues]:
        shared = SharedValues()
        trace = Trace(self.topology, self.blocks, self.row_ranges, base=self.base, instants=instants, shared=shared)
        return trace, shared

    def _event(self, trace: Trace, shared: SharedValues, instants: int, logged: Sequence[Any]) -> Event:
        loop = Loop(
            [_code_of(trace, logged)],
            sizes=self.sizes,
            width=shared.width,
            single_vehicle=self.num_vehicles == 1,
        )
        return Event(loop, shared, instants, frozenset(trace.inputs))

    def _is_due(self, update: BlockUpdate, instant: int | None) -> bool:
        if instant is None or update.period is None:
            return instant is None and update.period is None
        return instant % round(update.period / self.base) == 0

    def _instants(self) -> tuple[float, int]:
        """Return the time between two instants (s), and the number of instants in a cycle."""
        periods = [
            (path, update.period)
            for path, block in self.blocks.items()
            for update in block.updates
            if update.period is not None
        ]
        if not periods:
            raise InputError(f"{self.diagram.get_name()} cannot be compiled: it has no periodic events")
        base = min(period for _, period in periods)
        for path, period in periods:
            if abs(period / base - round(period / base)) > PERIOD_TOLERANCE:
                raise InputError(
                    f"{path} cannot be compiled: its period, {period:g} s, is not a multiple of {base:g} s"
                )
        cycle = math.lcm(*(round(period / base) for _, period in periods))
        if cycle > _MAX_CYCLE:
            raise InputError(
                f"{self.diagram.get_name()} cannot be compiled: the least common multiple of its periods is too long,"
                f" {cycle * base:g} s"
            )
        return base, cycle

    def _row_ranges(self, context: Context) -> RowRanges:
        states, parameters = (
            {
                (path, index): self._num_rows(vector.size(), f"{name} {index} of {path}")
                for path, index, vector in self._groups(name, context)
            }
            for name in ("state", "parameters")
        )
        inputs = {source: self._num_rows(size, _label(source)) for source, size in self._external_sizes().items()}
        return RowRanges(_consecutive_ranges(states), _consecutive_ranges(parameters), _consecutive_ranges(inputs))

    def _external_sizes(self) -> dict[Port | ExportedPort, int]:
        """Return the size of each external source that the compiled systems and the diagram's outputs read."""
        sizes: dict[Port | ExportedPort, int] = {}
        leaves = self.topology.leaves
        used = [source for path in self.blocks for source in self.topology.sources(path)]
        for source in [*used, *self.topology.outputs.values()]:
            if isinstance(source, ExportedPort):
                sizes[source] = source.size
            elif source is not None and source.path not in self.blocks:
                sizes[source] = leaves[source.path].get_output_port(source.number).size()
        return sizes

    def _num_rows(self, size: int, label: str) -> int:
        if size % self.num_vehicles:
            raise InputError(
                f"{label} cannot be compiled: it has {size} elements, not a multiple of {self.num_vehicles} vehicles"
            )
        return size // self.num_vehicles

    def _groups(self, name: str, root: Context) -> Iterable[tuple[str, int, Any]]:
        """Yield path, number and vector of each state group or numeric parameter in the compiled systems."""
        for path in self.blocks:
            context = self.topology.leaves[path].GetMyMutableContextFromRoot(root)
            if name == "state":
                for group in range(context.num_discrete_state_groups()):
                    yield path, group, context.get_mutable_discrete_state(group)
            else:
                for index in range(context.num_numeric_parameter_groups()):
                    yield path, index, context.get_mutable_numeric_parameter(index)

    def _vectors(self, context: Context, state: np.ndarray, parameters: np.ndarray) -> Iterable[tuple[Any, np.ndarray]]:
        """Yield each vector in a context, with the slice of `state` or `parameters` that belongs to it."""
        for name, row_ranges, numbers in (
            ("state", self.row_ranges.states, state),
            ("parameters", self.row_ranges.parameters, parameters),
        ):
            for path, index, vector in self._groups(name, context):
                first, rows = row_ranges[path, index]
                yield vector, numbers[first * self.num_vehicles : (first + rows) * self.num_vehicles]


def _label(source: Port | ExportedPort) -> str:
    if isinstance(source, ExportedPort):
        return f"the input port {source.name}"
    return f"output {source.number} of {source.path}"


def _consecutive_ranges(num_rows: Mapping[_Key, int]) -> dict[_Key, tuple[int, int]]:
    """Return the first row and the number of rows of each group, if the groups are stored consecutively."""
    firsts = itertools.accumulate(num_rows.values(), initial=0)
    return {key: (first, count) for (key, count), first in zip(num_rows.items(), firsts)}


def _rows(trace: Trace, ports: Iterable[Port]) -> list[Any]:
    """Return the rows of several output ports, in the order of the ports."""
    return [row for port in ports for row in trace.output(port)]


def _code_of(trace: Trace, logged: Sequence[Any]) -> EventCode:
    return EventCode(trace.listing, trace.changes(), logged)
