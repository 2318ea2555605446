"""Machine code of whole events: what happens to one vector of vehicles after another, from event to event.

The rows of a vector's vehicles are copied out of the fleet, so that they lie together in the processor's nearest cache
while many events pass, and are copied back at the end:

    fleet  ──gather──▶  rows of a vector's vehicles  ──event──▶──event──▶ ... ──scatter──▶  fleet

What follows from parameters alone is computed before the first event and kept beside these rows.
"""

import ctypes
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from drake_quad.compilation.trace import INPUTS, PARAMETERS, STATE
from drake_quad.framework.instructions import Rows, Store, declarations, function
from drake_quad.framework.kernels import copying, elements_of
from drake_quad.framework.machine_code import LANES, address
from drake_quad.framework.symbols import LEAVES, Kind, Listing, Operation, Symbol

# Groups beside those of a trace: what is kept for later, and what is logged.
_KEPT, _LOG = 3, 4
# Bytes of a line of the processor's cache: rows begin with one.
_CACHE_LINE = 64


class Sizes(NamedTuple):
    """How many rows there are.

    Attributes:
        state: of the state.
        parameters: of all parameters.
        inputs: of what comes from elsewhere.
    """

    state: int
    parameters: int
    inputs: int


class Loop:
    """Machine code that lets events pass.

    Args:
        listing: of what happens from one event to the next; its groups are `STATE`, `PARAMETERS` and `INPUTS`.
        changes: symbols or numbers that the state will hold, by the row.
        logged: symbols or numbers that are written down at every event.
        sizes: of the groups.
        width: numbers that all vehicles share at an event.
        lone: whether it is for a single vehicle.

    Attributes:
        num_logged: rows that are written down at every event.
    """

    def __init__(
        self,
        listing: Listing,
        changes: Mapping[int, Any],
        logged: Sequence[Any],
        *,
        sizes: Sizes,
        width: int,
        lone: bool,
    ) -> None:
        self._lanes, self.num_logged = 1 if lone else LANES, len(logged)
        before, rest, results = _divided(listing, [*changes.values(), *logged])
        targets = [*((STATE, row) for row in changes), *((_LOG, row) for row in range(len(logged)))]
        event = _Part(rest, list(zip(targets, results, strict=True)))
        # The function runs under Python's lock, one call at a time.
        self._scratch = _aligned((sum(sizes) + len(before.stores)) * self._lanes)
        text = _module(before, event, sizes, len(logged), max(1, width), self._lanes)
        arguments: list[Any] = [ctypes.c_int64, ctypes.c_int64, *[ctypes.py_object] * 6]
        self._run: Callable[..., None] = ctypes.PYFUNCTYPE(None, *arguments)(address(text))

    def padded(self, num_vehicles: int) -> int:
        """The vehicles that a log has room for."""
        return -(-num_vehicles // self._lanes) * self._lanes

    def run(
        self,
        state: np.ndarray,
        parameters: np.ndarray,
        inputs: np.ndarray,
        shared: np.ndarray,
        log: np.ndarray,
        num_vehicles: int,
    ) -> None:
        """Lets events pass.

        Args:
            state: (rows · N,), which changes.
            parameters: (rows · N,).
            inputs: (rows · N,) at the first event; it does not change.
            shared: (events, width).
            log: (events, logged rows, N padded), which is written.
            num_vehicles: N.
        """
        self._run(num_vehicles, len(shared), state, parameters, inputs, shared, log, self._scratch)


class _Part(NamedTuple):
    """A part of what happens.

    Attributes:
        listing: of it.
        stores: what is written where: group and row.
    """

    listing: Listing
    stores: list[tuple[tuple[int, int], Symbol]]


def _aligned(size: int) -> np.ndarray:
    """An array of so many numbers that begins with a line of the cache."""
    array = np.empty(size + _CACHE_LINE // 8)
    first = -array.ctypes.data % _CACHE_LINE // 8
    return array[first : first + size]


def _divided(listing: Listing, results: Sequence[Any]) -> tuple[_Part, Listing, list[Symbol]]:
    """What follows from parameters alone, and the rest, which reads that in `_KEPT`, with the results."""
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
        if fixed[line] and operation.name != "constant" and operation.kind is not Kind.TRUTH:
            kept.append(in_before(line))
            return rest.row(_KEPT, len(kept) - 1, operation.kind)
        return _copied(rest, operation, in_rest)

    # In their order, so that nothing is asked for in depth.
    for line in _needed(listing, lines):
        if not fixed[line]:
            in_rest(line)
        elif listing.operations[line].name != "row":
            in_before(line)
    symbols = [in_rest(line) for line in lines]
    return _Part(before, [((_KEPT, row), symbol) for row, symbol in enumerate(kept)]), rest, symbols


def _copied(listing: Listing, operation: Operation, symbol_of: Callable[[int], Symbol]) -> Symbol:
    """The symbol of a line of another listing in this one, given those of its operands."""
    operands = operation.operands
    if operation.name not in LEAVES:
        operands = tuple([symbol_of(operand).line for operand in operands])
    return listing.add(operation.name, operands, operation.kind, operation.branch)


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


def _module(before: _Part, event: _Part, sizes: Sizes, num_logged: int, width: int, lanes: int) -> str:
    """The text of a loop in LLVM's language."""
    groups = {
        STATE: Rows("%state", lanes),
        PARAMETERS: Rows("%parameters", lanes),
        INPUTS: Rows("%inputs", lanes),
        _KEPT: Rows("%kept", lanes),
        _LOG: Rows("%log", "%padded"),
    }

    def written(head: str, part: _Part) -> str:
        stores = [Store(groups[group], row, symbol) for (group, row), symbol in part.stores]
        return function(head, part.listing, stores, groups, shared="%shared", lanes=lanes, overlapping=False)

    return "\n".join(
        [
            declarations(lanes),
            copying(lanes),
            written("@prepare(ptr %parameters, ptr %kept, ptr %shared) noinline", before),
            written(f"@event({_ARGUMENTS}) noinline", event),
            _driver(sizes, num_logged, width, lanes),
        ]
    )


_ARGUMENTS = "ptr %state, ptr %inputs, ptr %kept, ptr %shared, ptr %log, i64 %padded"


def _driver(sizes: Sizes, num_logged: int, width: int, lanes: int) -> str:
    """The function that Python calls."""
    arrays = ("state_rows", "parameter_rows", "input_rows", "shared_rows", "log_rows", "scratch")
    copied = {"state": sizes.state, "parameters": sizes.parameters, "inputs": sizes.inputs}
    fleets = dict(zip(copied, arrays))
    places = {"state": 0, "parameters": sizes.state, "inputs": sizes.state + sizes.parameters, "kept": sum(sizes)}
    return "\n".join(
        [
            f"define void @kernel(i64 %n, i64 %events, {', '.join(f'ptr %{name}_array' for name in arrays)}) {{",
            "entry:",
            *(line for name in arrays for line in elements_of(name)),
            *(f"  %{name} = getelementptr double, ptr %scratch, i64 {row * lanes}" for name, row in places.items()),
            f"  %up = add i64 %n, {lanes - 1}",
            f"  %vectors = udiv i64 %up, {lanes}",
            f"  %padded = mul i64 %vectors, {lanes}",
            f"  %logged = mul i64 %padded, {num_logged}",
            "  %some = icmp ugt i64 %n, 0",
            "  br i1 %some, label %vector, label %done",
            "vector:",
            "  %first = phi i64 [0, %entry], [%next, %passed]",
            "  %left = sub i64 %n, %first",
            f"  %full = icmp ugt i64 %left, {lanes}",
            f"  %count = select i1 %full, i64 {lanes}, i64 %left",
            *(f"  %{name}_there = getelementptr double, ptr %{fleets[name]}, i64 %first" for name in copied),
            *(
                f"  call void @gather(ptr %{name}, ptr %{name}_there, i64 {count}, i64 %n, i64 %count)"
                for name, count in copied.items()
            ),
            "  call void @prepare(ptr %parameters, ptr %kept, ptr %shared_rows)",
            "  %log_first = getelementptr double, ptr %log_rows, i64 %first",
            "  %any = icmp ugt i64 %events, 0",
            "  br i1 %any, label %event, label %passed",
            "event:",
            "  %k = phi i64 [0, %vector], [%k1, %event]",
            f"  %shared_row = mul i64 %k, {width}",
            "  %shared = getelementptr double, ptr %shared_rows, i64 %shared_row",
            "  %log_row = mul i64 %k, %logged",
            "  %log = getelementptr double, ptr %log_first, i64 %log_row",
            f"  call void @event({_ARGUMENTS})",
            "  %k1 = add i64 %k, 1",
            "  %more = icmp ult i64 %k1, %events",
            "  br i1 %more, label %event, label %passed",
            "passed:",
            f"  call void @scatter(ptr %state, ptr %state_there, i64 {sizes.state}, i64 %n, i64 %count)",
            f"  %next = add i64 %first, {lanes}",
            "  %again = icmp ult i64 %next, %n",
            "  br i1 %again, label %vector, label %done",
            "done:",
            "  ret void",
            "}",
        ]
    )
