"""Machine code of whole events: what happens to one vector of vehicles after another, from event to event.

The rows of a vector's vehicles are copied out of the fleet, so that they lie together in the processor's nearest cache
while many events pass, and are copied back at the end:

    fleet  ──gather──▶  rows of a vector's vehicles  ──event──▶──event──▶ ... ──scatter──▶  fleet

What follows from parameters alone is computed before the first event and kept beside these rows.
"""

import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from drake_quad.compilation.parts import EVENT, PREPARE, Part, Sizes, aligned, divided
from drake_quad.framework.instructions import declarations
from drake_quad.framework.kernels import copying, elements_of
from drake_quad.framework.machine_code import LANES, address
from drake_quad.framework.symbols import Listing


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
        before, event = divided(listing, changes, logged)
        # The function runs under Python's lock, one call at a time.
        self._scratch = aligned((sum(sizes) + len(before.stores)) * self._lanes)
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


def _module(before: Part, event: Part, sizes: Sizes, num_logged: int, width: int, lanes: int) -> str:
    """The text of a loop in LLVM's language."""
    return "\n".join(
        [
            declarations(lanes),
            copying(lanes),
            before.written(PREPARE, lanes=lanes, log_stride=0, shared=""),
            event.written(EVENT, lanes=lanes, log_stride="%padded", shared="%shared"),
            _driver(sizes, num_logged, width, lanes),
        ]
    )


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
            "  call void @prepare(ptr %parameters, ptr %kept)",
            "  %log_first = getelementptr double, ptr %log_rows, i64 %first",
            "  %any = icmp ugt i64 %events, 0",
            "  br i1 %any, label %event, label %passed",
            "event:",
            "  %k = phi i64 [0, %vector], [%k1, %event]",
            f"  %shared_row = mul i64 %k, {width}",
            "  %shared = getelementptr double, ptr %shared_rows, i64 %shared_row",
            "  %log_row = mul i64 %k, %logged",
            "  %log = getelementptr double, ptr %log_first, i64 %log_row",
            f"  call void {EVENT}",
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
