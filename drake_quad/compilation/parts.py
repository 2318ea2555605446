"""What happens at an event, in two parts: what follows from parameters alone, and the rest, which reads that."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from drake_quad.compilation.trace import INPUTS, PARAMETERS, STATE
from drake_quad.framework.instructions import Rows, Store, function
from drake_quad.framework.symbols import LEAVES, Listing, Operation, Symbol, SymbolKind

# Groups beside those of a trace: what is kept for later, and what is logged.
KEPT, LOG = 3, 4
# Bytes of a line of the processor's cache: rows begin with one.
CACHE_LINE = 64
# The functions of the two parts, with their arguments.
PREPARE = "@prepare(ptr %parameters, ptr %kept)"
EVENT = "@event(ptr %state, ptr %inputs, ptr %kept, ptr %shared, ptr %log, i64 %padded)"


class PartSizes(NamedTuple):
    """How many rows there are.

    Attributes:
        state: of the state.
        parameters: of all parameters.
        inputs: of what comes from elsewhere.
    """

    state: int
    parameters: int
    inputs: int


class Part(NamedTuple):
    """A part of what happens.

    Attributes:
        listing: of it.
        stores: what is written where: group and row.
    """

    listing: Listing
    stores: list[tuple[tuple[int, int], Symbol]]

    def written(self, head: str, *, lanes: int, log_stride: str | int, shared: str | Rows) -> str:
        """The function that does it, in LLVM's language.

        Args:
            head: its name and arguments, `PREPARE` or `EVENT`.
            lanes: vehicles of a vector.
            log_stride: from a row of the log to the next, in numbers.
            shared: the numbers that all vehicles share, as for `function`.
        """
        groups = {
            STATE: Rows("%state", lanes),
            PARAMETERS: Rows("%parameters", lanes),
            INPUTS: Rows("%inputs", lanes),
            KEPT: Rows("%kept", lanes),
            LOG: Rows("%log", log_stride),
        }
        stores = [Store(groups[group], row, symbol) for (group, row), symbol in self.stores]
        return function(f"{head} noinline", self.listing, stores, groups, shared=shared, lanes=lanes, overlapping=False)


def aligned(size: int) -> np.ndarray:
    """An array of so many numbers that begins with a line of the cache."""
    array = np.empty(size + CACHE_LINE // 8)
    first = -array.ctypes.data % CACHE_LINE // 8
    return array[first : first + size]


def divided(listing: Listing, changes: Mapping[int, Any], logged: Sequence[Any]) -> tuple[Part, Part]:
    """Split a listing into the part that depends on parameters only, whose results are kept, and the rest.

    Args:
        listing: of what happens from one event to the next; its groups are `STATE`, `PARAMETERS` and `INPUTS`.
        changes: symbols or numbers that the state will hold, by the row.
        logged: symbols or numbers that are written down.
    """
    results = [*changes.values(), *logged]
    targets = [*((STATE, row) for row in changes), *((LOG, row) for row in range(len(logged)))]
    lines = [result.line if result.__class__ is Symbol else listing.constant(result).line for result in results]
    fixed = _follow_from_parameters(listing)
    before = _Copy(listing)
    rest = _Rest(listing, fixed, before)
    # In their order, so that nothing is asked for in depth.
    for line in _needed(listing, lines):
        if not fixed[line]:
            rest.line(line)
        elif listing.operations[line].name != "row":
            before.line(line)
    stores = list(zip(targets, map(rest.symbol, lines), strict=True))
    kept = [((KEPT, row), before.symbol(line)) for row, line in enumerate(rest.kept)]
    return Part(before.listing, kept), Part(rest.listing, stores)


class _Copy:
    """A listing with lines of another one, each of which is copied when it is asked for first.

    Args:
        source: the other listing.

    Attributes:
        listing: the copy.
    """

    def __init__(self, source: Listing) -> None:
        self.listing, self._source = Listing(), source.operations
        self._lines: dict[int, int] = {}

    def line(self, line: int) -> int:
        """Return the number in the copy of a line of the source."""
        found = self._lines.get(line)
        if found is None:
            found = self._lines[line] = self._copied(line, self._source[line])
        return found

    def symbol(self, line: int) -> Symbol:
        """Return the symbol of a line of the source in the copy."""
        return Symbol(self.listing, self.line(line), self._source[line].kind)

    def _copied(self, line: int, operation: Operation) -> int:
        name, operands, kind, inside = operation
        if name not in LEAVES:
            operands = tuple([self.line(operand) for operand in operands])
        return self.listing.line(name, operands, kind, inside)


class _Rest(_Copy):
    """A copy that reads what follows from parameters, instead of computing it.

    Args:
        source: the other listing.
        fixed: which of its lines follow from parameters.
        before: copy in which these are computed.

    Attributes:
        kept: what is read, lines of the source that `before` computes.
    """

    def __init__(self, source: Listing, fixed: Sequence[bool], before: _Copy) -> None:
        super().__init__(source)
        self.kept: list[int] = []
        self._fixed, self._before = fixed, before

    def _copied(self, line: int, operation: Operation) -> int:
        # Truth values are quickly computed again.
        if self._fixed[line] and operation.name != "constant" and operation.kind is not SymbolKind.TRUTH:
            self._before.line(line)
            self.kept.append(line)
            return self.listing.line("row", (KEPT, len(self.kept) - 1), operation.kind)
        return super()._copied(line, operation)


def _follow_from_parameters(listing: Listing) -> list[bool]:
    """Which lines of a listing do."""
    follow: list[bool] = []
    for operation in listing.operations:
        name, operands = operation.name, operation.operands
        if name in LEAVES:
            follow.append(name == "constant" or (name == "row" and operands[0] == PARAMETERS))
        else:
            follow.append(all(follow[operand] for operand in operands))
    return follow


def _needed(listing: Listing, lines: Iterable[int]) -> list[int]:
    """The lines of a listing that some lines need, those among them, in order."""
    needed = [False] * len(listing.operations)
    for line in lines:
        needed[line] = True
    for line in reversed(range(len(needed))):
        operation = listing.operations[line]
        if needed[line] and operation.name not in LEAVES:
            for operand in operation.operands:
                needed[operand] = True
    return [line for line, is_needed in enumerate(needed) if is_needed]
