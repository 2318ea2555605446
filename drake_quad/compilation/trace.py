"""Trace of a diagram, which executes the diagram's formulas on symbols, instant by instant.

The listing of a trace contains all operations that compute the diagram's final state from its initial state.
"""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

from drake_quad.compilation.shared_values import TIME_VALUE, SharedValues, SharedValueSource
from drake_quad.compilation.topology import ExportedPort, Port, Topology
from drake_quad.errors import not_connected
from drake_quad.framework.elementary import untyped, where
from drake_quad.framework.formulas import TIME, CurrentTick, Tick
from drake_quad.framework.symbols import Listing, Symbol, SymbolKind

# List of the components of a port, state group or parameter. A component is called a row, and is a symbol or a number.
Rows = list[Any]
# Numbers of the groups of rows that a listing reads: state, parameters and external inputs.
STATE, PARAMETERS, INPUTS = range(3)
# Tolerance for rounding errors in the ratio of two periods, which must be a whole number.
PERIOD_TOLERANCE = 1e-9


class RowRanges(NamedTuple):
    """Row range (first row and number of rows) of each state group, parameter and external input.

    Attributes:
        states: range of each state group, by the path of its leaf system and its number.
        parameters: range of each parameter, by the path of its leaf system and its index.
        inputs: ranges of external inputs, by their source: an uncompiled system's output port, or a port of the
            diagram.
    """

    states: Mapping[tuple[str, int], tuple[int, int]]
    parameters: Mapping[tuple[str, int], tuple[int, int]]
    inputs: Mapping[Port | ExportedPort, tuple[int, int]]


class Trace:
    """Trace of an event of a diagram.

    Args:
        topology: leaf systems and connections of the diagram.
        blocks: compiled leaf systems, as `Block`, by path.
        row_ranges: rows that each state group, parameter and external input occupies.
        base: time between two instants, s.
        instants: number of instants in the event.
        shared: table columns of shared values, to which the trace adds the columns that it needs.

    Attributes:
        listing: operations traced so far.
        instant: index of the current instant in the event.
        inputs: external inputs read so far.
    """

    def __init__(
        self,
        topology: Topology,
        blocks: Mapping[str, Any],
        row_ranges: RowRanges,
        *,
        base: float,
        instants: int,
        shared: SharedValues,
    ) -> None:
        self.listing, self.instant, self.inputs = Listing(), 0, set[Port | ExportedPort]()
        self._topology, self._blocks, self._row_ranges = topology, blocks, row_ranges
        self._base, self._instants, self._shared = base, instants, shared
        self._states: dict[tuple[str, int], Rows] = {}
        self._outputs: dict[Port, Rows] = {}

    def output(self, port: Port) -> Rows:
        """Return the components of the signal at a leaf system's output port."""
        if port in self._row_ranges.inputs:
            return self._input(port)
        if port not in self._outputs:
            self._outputs[port] = self._blocks[port.path].output(port.number, BlockView(self, port.path))
        return self._outputs[port]

    def advance(self, updates: Iterable[tuple[str, Any]], *, first: bool = False) -> None:
        """Apply simultaneous updates of blocks.

        Args:
            updates: updates, each with the path of its block.
            first: True if the updates may take place at time zero.
        """
        self._states |= self.updated_states(updates, first=first)
        self._outputs.clear()

    def updated_states(self, updates: Iterable[tuple[str, Any]], *, first: bool = False) -> dict[tuple[str, int], Rows]:
        """Return the new values of state groups without applying the updates; the arguments are as in `advance`."""
        after: dict[tuple[str, int], Rows] = {}
        for path, update in updates:
            for group, rows in update.compute(BlockView(self, path)).items():
                if first and not update.at_start:
                    is_start, previous = self.shared() == 0.0, self.state(path, group)
                    rows = [where(untyped(is_start), old, new) for old, new in zip(previous, rows, strict=True)]
                after[path, group] = rows
        return after

    def next_instant(self) -> None:
        """Proceed to the next instant of the event."""
        self.instant += 1
        self._outputs.clear()

    def changes(self) -> dict[int, Any]:
        """Return the new value of each changed row of the state, a symbol or a number, by row index."""
        return {
            self._row_ranges.states[key][0] + row: value
            for key, rows in self._states.items()
            for row, value in enumerate(rows)
        }

    def shared(self, value: str | SharedValueSource = TIME_VALUE) -> Symbol:
        """Return a value that all vehicles share at the current instant: the time (s), or an element of a port."""
        return self.listing.shared(self._shared.column(self.instant, value))

    def tick(self, ticks: CurrentTick) -> Tick:
        """Return the tick at the current instant.

        If the event contains an even number of ticks, each tick has the same position in its pair in every event, so
        the position is a constant. The two ticks of a pair then use one shared value, the number of the pair.
        """
        step = round(ticks.period / self._base)
        on_grid = step > 0 and abs(ticks.period / self._base - step) < PERIOD_TOLERANCE
        if on_grid and self._instants % (2 * step) == 0 and self.instant % step == 0:
            pair, position = divmod(self.instant // step, 2)
            return Tick(untyped(self.listing.shared(self._shared.column(pair * 2 * step, ticks))), position == 1)
        number = self.listing.shared(self._shared.column(self.instant, ticks))
        second = self.listing.shared(self._shared.second(self.instant, ticks))
        return Tick(untyped(number), untyped(second == 1.0))

    def state(self, path: str, group: int) -> Rows:
        """Return the components of a state group of a leaf system at the current instant."""
        if (path, group) not in self._states:
            return self._rows(STATE, self._row_ranges.states[path, group])
        return self._states[path, group]

    def parameter(self, path: str, index: int) -> Rows:
        """Return the components of a parameter of a leaf system."""
        return self._rows(PARAMETERS, self._row_ranges.parameters[path, index])

    def input(self, port: Port) -> Rows | None:
        """Return the components of the signal at a leaf system's input port; None if the port is not connected."""
        source = self._topology.source(port)
        if source is None or isinstance(source, Port):
            return None if source is None else self.output(source)
        return self._input(source)

    def required_input(self, port: Port) -> Rows:
        """Return the components of the signal at a leaf system's input port.

        Raises:
            InputError: if the port is not connected.
        """
        rows = self.input(port)
        if rows is None:
            system = self._topology.leaves[port.path]
            raise not_connected(system.get_input_port(port.number).get_name(), system)
        return rows

    def _input(self, source: Port | ExportedPort) -> Rows:
        self.inputs.add(source)
        return self._rows(INPUTS, self._row_ranges.inputs[source])

    def _rows(self, group: int, row_range: tuple[int, int]) -> Rows:
        first, count = row_range
        return [self.listing.row(group, row, SymbolKind.NUMBER) for row in range(first, first + count)]


class BlockView(NamedTuple):
    """View of a trace, restricted to the ports and states of one block.

    Attributes:
        trace: trace of the diagram.
        path: path of the block in the diagram.
    """

    trace: Trace
    path: str

    def input(self, index: int) -> Rows | None:
        """Return the components of the signal at the block's input port; None if the port is not connected."""
        return self.trace.input(Port(self.path, index))

    def required_input(self, index: int) -> Rows:
        """Return the components of the signal at the block's input port.

        Raises:
            InputError: if the port is not connected.
        """
        return self.trace.required_input(Port(self.path, index))

    def state(self, group: int) -> Rows:
        """Return the components of a state group of the block at the current instant."""
        return self.trace.state(self.path, group)

    def parameter(self, index: int) -> Rows:
        """Return the components of a parameter of the block."""
        return self.trace.parameter(self.path, index)

    def argument(self, read: Any) -> Any:
        """Return the value of the placeholder `TIME` or `CurrentTick` at the current instant."""
        return self.trace.shared() if read is TIME else self.trace.tick(read)

    def source(self, output: int, element: int) -> Any:
        """Return an element of the block's output port. The value of the port must depend only on time."""
        return self.trace.shared(SharedValueSource(self.path, output, element))
