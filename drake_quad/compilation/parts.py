"""Division of an event's operations into two parts: results that depend only on parameters are computed in advance."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from drake_quad.compilation.trace import INPUTS, PARAMETERS, STATE
from drake_quad.framework.instructions import Rows, Store, function
from drake_quad.framework.symbols import LEAVES, Listing, Operation, Symbol, SymbolKind

# Each group of rows has a number. The numbers of the groups `STATE`, `PARAMETERS` and `INPUTS` are in `trace.py`.
PRECOMPUTED = 3  # number of the group of precomputed results
LOG = 4  # number of the group of logged results
# Size of a cache line of the processor, bytes. Array addresses are multiples of this size.
CACHE_LINE = 64
# Names and arguments of the LLVM functions that compute the two parts of an event.
PREPARE = "@prepare(ptr %parameters, ptr %precomputed)"
EVENT = "@event(ptr %state, ptr %inputs, ptr %precomputed, ptr %shared, ptr %log, i64 %padded)"


def numbered(head: str, number: int) -> str:
    """Return the head of a function, `PREPARE` or `EVENT`, with a number in its name; without it for the number 0."""
    return head.replace("(", f"_of_kind_{number}(", 1) if number else head


class PartSizes(NamedTuple):
    """Number of rows in each group of rows that the operations of an event read.

    Attributes:
        state: number of rows of the state.
        parameters: number of rows of all parameters.
        inputs: number of rows of the external inputs.
    """

    state: int
    parameters: int
    inputs: int


class Part(NamedTuple):
    """One of the two parts of an event.

    Attributes:
        listing: list of the operations of this part.
        stores: for each result of this part, its destination (number of a group, index of a row) and its symbol.
    """

    listing: Listing
    stores: list[tuple[tuple[int, int], Symbol]]

    def llvm_function(self, head: str, *, lanes: int, log_stride: str | int, shared: str | Rows) -> str:
        """Return the LLVM code of a function that computes this part.

        Args:
            head: name and arguments of the function, `PREPARE` or `EVENT`.
            lanes: number of vehicles in a SIMD vector.
            log_stride: distance between consecutive rows of the log, in elements.
            shared: shared values, as in `drake_quad.framework.instructions.function`.
        """
        groups = {
            STATE: Rows("%state", lanes),
            PARAMETERS: Rows("%parameters", lanes),
            INPUTS: Rows("%inputs", lanes),
            PRECOMPUTED: Rows("%precomputed", lanes),
            LOG: Rows("%log", log_stride),
        }
        stores = [Store(groups[group], row, symbol) for (group, row), symbol in self.stores]
        return function(f"{head} noinline", self.listing, stores, groups, shared=shared, lanes=lanes, overlapping=False)


def aligned(size: int) -> np.ndarray:
    """Return an uninitialized array with `size` elements that is aligned with the processor's cache lines."""
    array = np.empty(size + CACHE_LINE // 8)
    first = -array.ctypes.data % CACHE_LINE // 8
    return array[first : first + size]


class Results(NamedTuple):
    """Lines of a listing, which is a list of operations, that compute the results of an event.

    Attributes:
        changes: line that computes the new value of each changed state row, by row index.
        logged: lines that are written to the log.
    """

    changes: dict[int, int]
    logged: list[int]

    @classmethod
    def of(cls, listing: Listing, changes: Mapping[int, Any], logged: Sequence[Any]) -> "Results":
        """Return the lines that compute given symbols or numbers; numbers are added to the listing as constants."""

        def line(result: Any) -> int:
            return (result if result.__class__ is Symbol else listing.constant(result)).line

        return cls({row: line(result) for row, result in changes.items()}, [line(result) for result in logged])


def split_listing(listing: Listing, results: Results) -> tuple[Part, Part]:
    """Split the operations of an event into those that depend only on parameters, and all others.

    The second part reads the results of the first part.

    Args:
        listing: operations of an event, which read the groups `STATE`, `PARAMETERS` and `INPUTS`.
        results: results of the event.
    """
    lines = [*results.changes.values(), *results.logged]
    targets = [*((STATE, row) for row in results.changes), *((LOG, row) for row in range(len(results.logged)))]
    fixed = _are_fixed(listing)
    preparation = _PartialCopy(listing)
    rest = _RemainingPart(listing, fixed)
    # A line is copied after the lines that compute its operands. Copying a line therefore never recurses deeply.
    for line in _required_lines(listing, lines):
        if not fixed[line]:
            rest.line(line)
        elif listing.operations[line].name != "row":
            preparation.line(line)
    stores = list(zip(targets, map(rest.symbol, lines), strict=True))
    precomputed = [((PRECOMPUTED, row), preparation.symbol(line)) for row, line in enumerate(rest.precomputed)]
    return Part(preparation.listing, precomputed), Part(rest.listing, stores)


class _PartialCopy:
    """Partial copy of a listing, with only the requested operations and their operands.

    Attributes:
        listing: listing of the copied lines.
    """

    def __init__(self, source: Listing) -> None:
        self.listing, self._source = Listing(), source.operations
        self._lines: dict[int, int] = {}

    def line(self, line: int) -> int:
        """Copy a line of the source unless it was copied before, and return its number in the copy."""
        found = self._lines.get(line)
        if found is None:
            found = self._lines[line] = self._copied(line, self._source[line])
        return found

    def symbol(self, line: int) -> Symbol:
        """Copy a line of the source unless it was copied before, and return its symbol in the copy."""
        return Symbol(self.listing, self.line(line), self._source[line].kind)

    def _copied(self, line: int, operation: Operation) -> int:
        name, operands, kind, inside = operation
        if name not in LEAVES:
            operands = tuple([self.line(operand) for operand in operands])
        return self.listing.line(name, operands, kind, inside)


class _RemainingPart(_PartialCopy):
    """Partial copy of a listing that reads precomputed results where they depend only on parameters.

    Args:
        source: listing to copy.
        fixed: mask of the lines that depend only on parameters.

    Attributes:
        precomputed: lines of the source that depend only on parameters and whose results this copy reads.
    """

    def __init__(self, source: Listing, fixed: Sequence[bool]) -> None:
        super().__init__(source)
        self.precomputed: list[int] = []
        self._fixed = fixed

    def _copied(self, line: int, operation: Operation) -> int:
        # Recomputing a comparison is faster than storing its result.
        if self._fixed[line] and operation.name != "constant" and operation.kind is not SymbolKind.TRUTH:
            self.precomputed.append(line)
            return self.listing.line("row", (PRECOMPUTED, len(self.precomputed) - 1), operation.kind)
        return super()._copied(line, operation)


def _are_fixed(listing: Listing) -> list[bool]:
    """Return, for each line of a listing, whether the line depends only on parameters and constants."""
    fixed: list[bool] = []
    for operation in listing.operations:
        name, operands = operation.name, operation.operands
        if name in LEAVES:
            fixed.append(name == "constant" or (name == "row" and operands[0] == PARAMETERS))
        else:
            fixed.append(all(fixed[operand] for operand in operands))
    return fixed


def _required_lines(listing: Listing, lines: Iterable[int]) -> list[int]:
    """Return given lines of a listing, and all lines on which they depend, in ascending order."""
    required = [False] * len(listing.operations)
    for line in lines:
        required[line] = True
    for line in reversed(range(len(required))):
        operation = listing.operations[line]
        if required[line] and operation.name not in LEAVES:
            for operand in operation.operands:
                required[operand] = True
    return [line for line, is_required in enumerate(required) if is_required]
