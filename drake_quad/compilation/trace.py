"""The trace of a diagram: its formulas, run on symbols, one instant after another.

What a trace leaves in its listing is all that the diagram computes meanwhile, from its state at the beginning to its
state at the end.
"""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from drake_quad.compilation.shared_numbers import TIME_ITSELF, NumberSource, SharedNumbers
from drake_quad.compilation.topology import ExportedPort, Port, Topology
from drake_quad.framework.elementary import untyped, where
from drake_quad.framework.formulas import TIME, Tick, TickOf
from drake_quad.framework.symbols import Listing, Symbol, SymbolKind

# The rows of a port, of a state or of a parameter: symbols, or numbers.
Rows = list[Any]
# The groups of a listing.
STATE, PARAMETERS, INPUTS = range(3)
# By which a quotient of two periods may differ from a whole number.
ROUNDING = 1e-9


class Places(NamedTuple):
    """Where the numbers of a diagram lie: the first of their rows, and how many there are.

    Attributes:
        states: by the path of the leaf system and the number of the group.
        parameters: likewise.
        inputs: by the output port of a system that is not compiled, or the port of the diagram.
    """

    states: Mapping[tuple[str, int], tuple[int, int]]
    parameters: Mapping[tuple[str, int], tuple[int, int]]
    inputs: Mapping[Port | ExportedPort, tuple[int, int]]


class Trace:
    """What happens in a diagram, from an event on.

    Args:
        topology: of the diagram.
        blocks: its leaf systems that are compiled, as `Block`, by path.
        places: of all numbers.
        base: time between two instants, s.
        instants: that an event takes.
        shared: numbers that all vehicles share.

    Attributes:
        listing: of all that has happened.
        instant: of now, counted from the event's.
        inputs: the places of `places.inputs` that have been looked at.
    """

    def __init__(
        self,
        topology: Topology,
        blocks: Mapping[str, Any],
        places: Places,
        *,
        base: float,
        instants: int,
        shared: SharedNumbers,
    ) -> None:
        self.listing, self.instant, self.inputs = Listing(), 0, set[Port | ExportedPort]()
        self._topology, self._blocks, self._places = topology, blocks, places
        self._base, self._instants, self._shared = base, instants, shared
        self._states: dict[tuple[str, int], Rows] = {}
        self._outputs: dict[Port, Rows] = {}

    def output(self, port: Port) -> Rows:
        """The rows of a leaf's output port."""
        if port in self._places.inputs:
            return self._input(port)
        if port not in self._outputs:
            self._outputs[port] = self._blocks[port.path].output(port.number, Around(self, port.path))
        return self._outputs[port]

    def advance(self, works: Iterable[tuple[str, Any]], *, first: bool = False) -> None:
        """Lets blocks do some work, given their paths, all at once.

        Args:
            works: and who does them.
            first: whether the time can be zero.
        """
        self._states |= self.foreseen(works, first=first)
        self._outputs.clear()

    def foreseen(self, works: Iterable[tuple[str, Any]], *, first: bool = False) -> dict[tuple[str, int], Rows]:
        """The rows that groups of the state would hold after some work, which is not done; as for `advance`."""
        after: dict[tuple[str, int], Rows] = {}
        for path, work in works:
            for group, rows in work.compute(Around(self, path)).items():
                if first and not work.at_start:
                    begins, before = self.shared() == 0.0, self.state(path, group)
                    rows = [where(untyped(begins), old, new) for old, new in zip(before, rows, strict=True)]
                after[path, group] = rows
        return after

    def proceed(self) -> None:
        """Goes on to the next instant."""
        self.instant += 1
        self._outputs.clear()

    def changes(self) -> dict[int, Any]:
        """What has changed of the state: the symbols or numbers, by the row."""
        return {
            self._places.states[key][0] + row: value
            for key, rows in self._states.items()
            for row, value in enumerate(rows)
        }

    def shared(self, what: str | NumberSource = TIME_ITSELF) -> Symbol:
        """Return a number that all vehicles share at the instant: the time (s), or an element of a source."""
        return self.listing.shared(self._shared.place(self.instant, what))

    def tick(self, ticks: TickOf) -> Tick:
        """The tick at the instant.

        Where an event takes whole pairs of ticks it is known which tick of a pair this is, and both see the same.
        """
        step = round(ticks.period / self._base)
        on_grid = step > 0 and abs(ticks.period / self._base - step) < ROUNDING
        if on_grid and self._instants % (2 * step) == 0 and self.instant % step == 0:
            pair, place = divmod(self.instant // step, 2)
            return Tick(untyped(self.listing.shared(self._shared.place(pair * 2 * step, ticks))), place == 1)
        number = self.listing.shared(self._shared.place(self.instant, ticks))
        second = self.listing.shared(self._shared.second(self.instant, ticks))
        return Tick(untyped(number), untyped(second == 1.0))

    def state(self, path: str, group: int) -> Rows:
        """The rows of a group of a leaf's state, as it is by now."""
        if (path, group) not in self._states:
            return self._rows(STATE, self._places.states[path, group])
        return self._states[path, group]

    def parameter(self, path: str, index: int) -> Rows:
        """The rows of a leaf's parameter."""
        return self._rows(PARAMETERS, self._places.parameters[path, index])

    def input(self, port: Port) -> Rows | None:
        """The rows at a leaf's input port; None if nothing is connected."""
        source = self._topology.source(port)
        if source is None or isinstance(source, Port):
            return None if source is None else self.output(source)
        return self._input(source)

    def _input(self, source: Port | ExportedPort) -> Rows:
        self.inputs.add(source)
        return self._rows(INPUTS, self._places.inputs[source])

    def _rows(self, group: int, place: tuple[int, int]) -> Rows:
        first, count = place
        return [self.listing.row(group, row, SymbolKind.NUMBER) for row in range(first, first + count)]


class Around(NamedTuple):
    """View of a trace from the block with a path."""

    trace: Trace
    path: str

    def input(self, index: int) -> Rows | None:
        """Return the rows at an input port; None if nothing is connected."""
        return self.trace.input(Port(self.path, index))

    def state(self, group: int) -> Rows:
        """Return the rows of a group of its state."""
        return self.trace.state(self.path, group)

    def parameter(self, index: int) -> Rows:
        """Return the rows of a parameter."""
        return self.trace.parameter(self.path, index)

    def argument(self, read: Any) -> Any:
        """Return the argument of a formula for `TIME` or a `TickOf`."""
        return self.trace.shared() if read is TIME else self.trace.tick(read)

    def source(self, output: int, element: int) -> Any:
        """Return an element of an output port that depends on the time alone."""
        return self.trace.shared(NumberSource(self.path, output, element))
