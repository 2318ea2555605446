"""What happens at an event, in two parts: what follows from parameters alone, and the rest, which reads that."""

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
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
    before, rest = Listing(), Listing()
    kept: list[Symbol] = []

    @functools.cache
    def in_before(line: int) -> Symbol:
        return _copied(before, listing.operations[line], in_before)

    @functools.cache
    def in_rest(line: int) -> Symbol:
        operation = listing.operations[line]
        # Truth values are quickly computed again.
        if fixed[line] and operation.name != "constant" and operation.kind is not SymbolKind.TRUTH:
            kept.append(in_before(line))
            return rest.row(KEPT, len(kept) - 1, operation.kind)
        return _copied(rest, operation, in_rest)

    # In their order, so that nothing is asked for in depth.
    for line in _needed(listing, lines):
        if not fixed[line]:
            in_rest(line)
        elif listing.operations[line].name != "row":
            in_before(line)
    stores = list(zip(targets, map(in_rest, lines), strict=True))
    del in_before, in_rest  # they refer to themselves, and would keep the listings until garbage is collected
    return Part(before, [((KEPT, row), symbol) for row, symbol in enumerate(kept)]), Part(rest, stores)


def _copied(listing: Listing, operation: Operation, symbol_of: Callable[[int], Symbol]) -> Symbol:
    """The symbol of a line of another listing in this one, given those of its operands."""
    operands = operation.operands
    if operation.name not in LEAVES:
        operands = tuple([symbol_of(operand).line for operand in operands])
    return listing.add(operation.name, operands, operation.kind, operation.inside)


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
