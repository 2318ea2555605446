"""What a compiled diagram does, and when."""

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from pydrake.systems.framework import Context, Diagram

from drake_quad.caching import ThreadSafeCache
from drake_quad.compilation.blocks import Block, Work, block_of
from drake_quad.compilation.clocked_loop import ClockedLoop
from drake_quad.compilation.loop import Loop
from drake_quad.compilation.parts import PartSizes
from drake_quad.compilation.shared_numbers import SharedNumbers
from drake_quad.compilation.stand_in import remembers, system_of
from drake_quad.compilation.topology import ExportedPort, Port, Topology
from drake_quad.compilation.trace import ROUNDING, Places, Trace
from drake_quad.errors import InputError
from drake_quad.framework.fleet_system import FleetSystem
from drake_quad.process_settings import without_garbage_collection

# Of instants until everything happens together again.
_LONGEST_CYCLE = 64
# Events of diagrams that are alike but for their numbers, and the size of their fleets, are made once.
_MAX_MADE = 256
_made: ThreadSafeCache[Any] = ThreadSafeCache(_MAX_MADE)
_Result = TypeVar("_Result")
_Key = TypeVar("_Key")


class Event(NamedTuple):
    """Machine code of an event.

    Attributes:
        loop: the machine code.
        shared: the numbers that all vehicles share.
        instants: that it takes, seen from its own.
        inputs: at which it looks.
    """

    loop: Loop
    shared: SharedNumbers
    instants: int
    inputs: frozenset[Port | ExportedPort]


def _made_once(make: Callable[..., _Result]) -> Callable[..., _Result]:
    """Return a method of `Program` whose results are shared by equivalent diagrams; its arguments can be hashed."""

    @functools.wraps(make)
    def shared(program: "Program", *arguments: Any) -> _Result:
        def uncollected() -> _Result:
            with without_garbage_collection():
                return make(program, *arguments)

        result: _Result = _made.get((program.signature, make.__name__, *arguments), uncollected)
        return result

    return shared


class Program:
    """A diagram, taken apart for the compiler.

    Args:
        diagram: to be compiled.

    Attributes:
        diagram: that was given.
        topology: of it.
        blocks: its leaf systems that can be compiled, by path.
        places: of all numbers.
        sizes: rows of the groups.
        num_vehicles: N.
        base: time between two instants, s.
        cycle: instants until everything happens together again.

    Raises:
        InputError: no system is a fleet's, or the periods do not fit together.
    """

    def __init__(self, diagram: Diagram) -> None:
        self.diagram, self.topology = diagram, Topology(diagram)
        leaves = self.topology.leaves
        blocks = {path: block_of(system) for path, system in leaves.items()}
        self.blocks: dict[str, Block] = {path: block for path, block in blocks.items() if block is not None}
        fleets = {system.num_vehicles for system in leaves.values() if isinstance(system, FleetSystem)}
        if not fleets:
            raise InputError(f"{diagram.get_name()} cannot be compiled: none of its systems is made for a fleet")
        if len(fleets) > 1:
            raise InputError(
                f"{diagram.get_name()} cannot be compiled: its systems are made for {sorted(fleets)} vehicles"
            )
        (self.num_vehicles,) = fleets
        self.places = self._places(diagram.CreateDefaultContext())
        self.sizes = PartSizes(*(sum(rows for _, rows in places.values()) for places in self.places))
        self.base, self.cycle = self._grid()

    @property
    def others(self) -> dict[str, Any]:
        """The leaf systems that are not compiled, by path."""
        return {path: system for path, system in self.topology.leaves.items() if path not in self.blocks}

    @property
    def others_remember(self) -> bool:
        """Whether a system that is not compiled has a state of its own."""
        return any(remembers(system_of(other)) for other in self.others.values())

    def works(self, instant: int | None, *, unrestricted: bool = False) -> list[tuple[str, Work]]:
        """What is done, and by whom: at an instant of the cycle, or when a simulation begins."""
        return [
            (path, work)
            for path, block in self.blocks.items()
            for work in block.works
            if work.unrestricted == unrestricted and self._is_due(work, instant)
        ]

    def reach(self, port: Port) -> set[Port | ExportedPort]:
        """What from elsewhere a leaf's output port depends on at once."""
        if port in self.places.inputs:
            return {port}
        found: set[Port | ExportedPort] = set()
        for index in self.blocks[port.path].passes(port.number):
            source = self.topology.source(Port(port.path, index))
            if isinstance(source, Port):
                found |= self.reach(source)
            elif source is not None:
                found.add(source)
        return found

    def read(self, context: Context) -> tuple[np.ndarray, np.ndarray]:
        """The (rows · N,) state and parameters in a context of the diagram."""
        n = self.num_vehicles
        state, parameters = np.empty(self.sizes.state * n), np.empty(self.sizes.parameters * n)
        for vector, numbers in self._vectors(context, state, parameters):
            numbers[:] = vector.CopyToVector()
        return state, parameters

    def write(self, context: Context, state: np.ndarray, parameters: np.ndarray) -> None:
        """Puts (rows · N,) state and parameters into a context of the diagram."""
        for vector, numbers in self._vectors(context, state, parameters):
            vector.SetFromVector(numbers)

    @_made_once
    def stage(self, instant: int | None, recorded: tuple[Port, ...] = (), unrestricted: bool = False) -> Event | None:
        """What is done at a single instant of the cycle, or when a simulation begins; None if it is nothing.

        Args:
            instant: None when a simulation begins.
            recorded: ports that are logged before.
            unrestricted: whether it is that of unrestricted updates.
        """
        works = self.works(instant, unrestricted=unrestricted)
        trace, shared = self._trace(1)
        logged = _rows(trace, recorded)
        if not works and not logged:
            return None
        trace.advance(works, first=not instant)
        return self._event(trace, shared, 1, logged)

    @_made_once
    def look(self, shown: tuple[Port, ...]) -> Event:
        """Return the machine code that logs what ports show at an instant, and that changes nothing."""
        trace, shared = self._trace(1)
        return self._event(trace, shared, 1, _rows(trace, shown))

    def instants_of(self, period: float) -> int:
        """How many instants a period (s) takes, of something that happens."""
        instants = round(period / self.base)
        if not instants or abs(period / self.base - instants) > ROUNDING or self.cycle % instants:
            raise InputError(f"{self.diagram.get_name()} cannot be compiled: nothing happens in it every {period:g} s")
        return instants

    @_made_once
    def strides(self, recorded: tuple[Port, ...], longest: int) -> list[Event] | None:
        """What is done in a cycle, from the discrete updates of an instant until those of a later one begin.

        There are several events where something from elsewhere is looked at more than once, or where they may not take
        a whole cycle; None if that cannot be.

        Args:
            recorded: ports that are logged every `longest` instants, from the first on.
            longest: instants that an event may take, of which a cycle is a multiple.
        """
        if any(work.at_start for _, work in self.works(0, unrestricted=True)):
            # Nothing but an event of their own can do them at time zero.
            return None
        for instants in (each for each in range(longest, 0, -1) if longest % each == 0):
            events = []
            for first in range(0, self.cycle, instants):
                event = self._stride(first, instants, () if first % longest else recorded)
                if event is None:
                    break
                events.append(event)
            else:
                return events
        return None

    def _stride(self, first: int, instants: int, recorded: Iterable[Port]) -> Event | None:
        """None if something from elsewhere would be looked at after the first instant, or in unrestricted updates."""
        trace, shared = self._trace(instants)
        logged = _rows(trace, recorded)
        trace.advance(self.works(first), first=first == 0)
        looked_at = frozenset(trace.inputs)
        trace.inputs.clear()
        self._pass(trace, first, instants)
        return None if trace.inputs else self._event(trace, shared, instants, logged)._replace(inputs=looked_at)

    def _pass(self, trace: Trace, first: int, instants: int) -> None:
        """Goes on from after the discrete updates of an instant until those of a later one begin."""
        for instant in range(first + 1, first + instants + 1):
            trace.proceed()
            trace.advance(self.works(instant % self.cycle, unrestricted=True))
            if instant < first + instants:
                trace.advance(self.works(instant % self.cycle))

    def tick(self, instants: int, shown: tuple[Port, ...], judge: str) -> tuple[ClockedLoop, SharedNumbers]:
        """What happens from one tick to the next, for vehicles with clocks of their own; and the table that it takes.

        At its end is shown what ports hold, and then what the discrete updates of a system would make of its state:
        row after row, in the order of its groups.

        Args:
            instants: of a tick, which must be a whole cycle.
            shown: ports.
            judge: path of the system.

        Raises:
            InputError: not all that happens in the diagram happens in every tick.
        """
        name = self.diagram.get_name()
        if instants != self.cycle:
            raise InputError(
                f"vehicles of {name} cannot have clocks of their own: something happens in it less often than every"
                f" {instants * self.base:g} s"
            )
        if any(work.at_start for _, work in self.works(0, unrestricted=True)):
            raise InputError(f"vehicles of {name} cannot have clocks of their own: it begins with an update of its own")
        loop, shared = self._tick(instants, shown, judge)
        return loop.fresh(self.num_vehicles), shared

    @_made_once
    def _tick(self, instants: int, shown: tuple[Port, ...], judge: str) -> tuple[ClockedLoop, SharedNumbers]:
        trace, shared = self._trace(instants)
        trace.advance(self.works(0), first=True)
        self._pass(trace, 0, instants)
        logged = _rows(trace, shown)
        judged = trace.foreseen([(path, work) for path, work in self.works(0) if path == judge])
        logged += [row for _, rows in sorted(judged.items()) for row in rows]
        loop = ClockedLoop(
            trace.listing,
            trace.changes(),
            logged,
            sizes=self.sizes,
            width=shared.width,
            num_vehicles=1 if self.num_vehicles == 1 else 2,
        )
        return loop, shared

    def times(self, first: int, instants: int, count: int) -> np.ndarray:
        """The (count, instants + 1) times (s) of events of so many instants, from event `first` on."""
        begins = instants * (first + np.arange(count))
        times: np.ndarray = (begins[:, None] + np.arange(instants + 1)) * self.base
        return times

    def table(self, shared: SharedNumbers, times: np.ndarray) -> np.ndarray:
        """Return the (events, width) numbers that all vehicles share at the (events, instants) times (s)."""
        # Each call creates its own contexts, so that threads that share a diagram do not set each other's time.
        contexts: dict[str, Context] = {}

        def values(path: str, output: int, time: float) -> np.ndarray:
            system = self.topology.leaves[path]
            if path not in contexts:
                contexts[path] = system.CreateDefaultContext()
            contexts[path].SetTime(time)
            shown: np.ndarray = system.get_output_port(output).Eval(contexts[path])
            return shown

        return shared.table(times, values)

    @functools.cached_property
    def signature(self) -> tuple[Any, ...]:
        """All that its machine code depends on."""
        leaves = self.topology.leaves
        blocks = tuple(
            [(path, block.signature, tuple(self.topology.sources(path))) for path, block in self.blocks.items()]
        )
        others = tuple([(path, tuple(self.topology.sources(path))) for path in leaves if path not in self.blocks])
        outputs = tuple(self.topology.outputs.items())
        places = tuple([tuple(each.items()) for each in self.places])
        return blocks, others, outputs, places, self.num_vehicles == 1

    def _trace(self, instants: int) -> tuple[Trace, SharedNumbers]:
        shared = SharedNumbers()
        trace = Trace(self.topology, self.blocks, self.places, base=self.base, instants=instants, shared=shared)
        return trace, shared

    def _event(self, trace: Trace, shared: SharedNumbers, instants: int, logged: Sequence[Any]) -> Event:
        loop = Loop(
            trace.listing,
            trace.changes(),
            logged,
            sizes=self.sizes,
            width=shared.width,
            single_vehicle=self.num_vehicles == 1,
        )
        return Event(loop, shared, instants, frozenset(trace.inputs))

    def _is_due(self, work: Work, instant: int | None) -> bool:
        if instant is None or work.period is None:
            return instant is None and work.period is None
        return instant % round(work.period / self.base) == 0

    def _grid(self) -> tuple[float, int]:
        """The time between two instants, and the number of instants of a cycle."""
        periods = [
            (path, work.period)
            for path, block in self.blocks.items()
            for work in block.works
            if work.period is not None
        ]
        if not periods:
            raise InputError(f"{self.diagram.get_name()} cannot be compiled: nothing happens in it")
        base = min(period for _, period in periods)
        for path, period in periods:
            if abs(period / base - round(period / base)) > ROUNDING:
                raise InputError(f"{path} cannot be compiled: its period, {period:g} s, is no multiple of {base:g} s")
        cycle = math.lcm(*(round(period / base) for _, period in periods))
        if cycle > _LONGEST_CYCLE:
            raise InputError(
                f"{self.diagram.get_name()} cannot be compiled: its periods come together only every {cycle * base:g} s"
            )
        return base, cycle

    def _places(self, context: Context) -> Places:
        states, parameters = (
            {
                (path, index): self._num_rows(vector.size(), f"{name} {index} of {path}")
                for path, index, vector in self._groups(name, context)
            }
            for name in ("state", "parameters")
        )
        inputs = {source: self._num_rows(size, _described(source)) for source, size in self._elsewhere().items()}
        return Places(_in_turn(states), _in_turn(parameters), _in_turn(inputs))

    def _elsewhere(self) -> dict[Port | ExportedPort, int]:
        """What comes from elsewhere, and its size."""
        found: dict[Port | ExportedPort, int] = {}
        leaves = self.topology.leaves
        used = [source for path in self.blocks for source in self.topology.sources(path)]
        for source in [*used, *self.topology.outputs.values()]:
            if isinstance(source, ExportedPort):
                found[source] = source.size
            elif source is not None and source.path not in self.blocks:
                found[source] = leaves[source.path].get_output_port(source.number).size()
        return found

    def _num_rows(self, size: int, what: str) -> int:
        if size % self.num_vehicles:
            raise InputError(
                f"{what} cannot be compiled: it has {size} elements, no multiple of {self.num_vehicles} vehicles"
            )
        return size // self.num_vehicles

    def _groups(self, name: str, root: Context) -> Iterable[tuple[str, int, Any]]:
        """The vectors in a context, with path and number."""
        for path in self.blocks:
            context = self.topology.leaves[path].GetMyMutableContextFromRoot(root)
            if name == "state":
                for group in range(context.num_discrete_state_groups()):
                    yield path, group, context.get_mutable_discrete_state(group)
            else:
                for index in range(context.num_numeric_parameter_groups()):
                    yield path, index, context.get_mutable_numeric_parameter(index)

    def _vectors(self, context: Context, state: np.ndarray, parameters: np.ndarray) -> Iterable[tuple[Any, np.ndarray]]:
        """The vectors in a context of the diagram, with their parts of state and parameters."""
        for name, places, numbers in (
            ("state", self.places.states, state),
            ("parameters", self.places.parameters, parameters),
        ):
            for path, index, vector in self._groups(name, context):
                first, rows = places[path, index]
                yield vector, numbers[first * self.num_vehicles : (first + rows) * self.num_vehicles]


def _described(source: Port | ExportedPort) -> str:
    if isinstance(source, ExportedPort):
        return f"the input port {source.name}"
    return f"output {source.number} of {source.path}"


def _in_turn(num_rows: Mapping[_Key, int]) -> dict[_Key, tuple[int, int]]:
    """Return the first row and the number of rows of each of several groups that follow one another."""
    firsts = itertools.accumulate(num_rows.values(), initial=0)
    return {key: (first, count) for (key, count), first in zip(num_rows.items(), firsts)}


def _rows(trace: Trace, ports: Iterable[Port]) -> list[Any]:
    """Return the rows of several ports, one port after another."""
    return [row for port in ports for row in trace.output(port)]
