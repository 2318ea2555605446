"""Machine code of a tick for vehicles with clocks of their own.

Vehicles lie in memory vector by vector, each with all of its rows, and stay there from tick to tick:

    rows    (vectors, rows, lanes)      [state of vehicles 0 to 7] [state of vehicles 8 to 15] ...

The numbers that depend on the time alone stand in a table, a row a tick; each vehicle takes the row of its clock. What
follows from parameters alone is computed when these change.
"""

import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from drake_quad.compilation.parts import EVENT, PREPARE, Sizes, aligned, divided
from drake_quad.framework.instructions import Rows, declarations
from drake_quad.framework.kernels import elements_of
from drake_quad.framework.machine_code import LANES, address
from drake_quad.framework.symbols import Listing


class ClockedLoop:
    """Machine code that lets a tick pass.

    Args:
        listing: of what happens from one tick to the next; its groups are `STATE`, `PARAMETERS` and `INPUTS`.
        changes: symbols or numbers that the state will hold, by the row.
        logged: symbols or numbers that are shown.
        sizes: of the groups.
        width: numbers of a row of the table.
        num_vehicles: N.

    Attributes:
        lanes: vehicles of a vector.
        state: (vectors, rows, lanes), which changes.
        parameters: (vectors, rows, lanes); `prepare` must follow a change.
        inputs: (vectors, rows, lanes).
        log: (vectors, rows, lanes), what is shown.
        clocks: (vectors, lanes) int64, the row of the table that each vehicle takes.
    """

    def __init__(
        self,
        listing: Listing,
        changes: Mapping[int, Any],
        logged: Sequence[Any],
        *,
        sizes: Sizes,
        width: int,
        num_vehicles: int,
    ) -> None:
        self.lanes = lanes = 1 if num_vehicles == 1 else LANES
        vectors, width = -(-num_vehicles // lanes), max(1, width)
        before, event = divided(listing, changes, logged)
        rows = {**sizes._asdict(), "kept": len(before.stores), "log": len(logged)}
        self.state, self.parameters, self.inputs, self._kept, self.log = (
            _zeros(vectors, count, lanes) for count in rows.values()
        )
        self.clocks = np.zeros((vectors, lanes), dtype=np.int64)
        self._shared = aligned(width * lanes)
        shared = Rows("%shared", lanes)
        text = "\n".join(
            [
                declarations(lanes),
                before.written(PREPARE, lanes=lanes, log_stride=0, shared=shared),
                event.written(EVENT, lanes=lanes, log_stride=lanes, shared=shared),
                _taking(width, lanes),
                _driver(rows, lanes),
            ]
        )
        arguments: list[Any] = [ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, *[ctypes.py_object] * 8]
        self._run: Callable[..., None] = ctypes.PYFUNCTYPE(None, *arguments)(address(text))
        self._arrays = self.state, self.parameters, self.inputs, self._kept, self.log, self.clocks, self._shared

    def prepare(self, vectors: Sequence[int]) -> None:
        """Computes what follows from the parameters of some vectors, given their numbers."""
        for vector in vectors:
            self._run(vector, 1, 1, *self._arrays, self._shared)

    def advance(self, table: np.ndarray) -> None:
        """Lets a tick pass for all vehicles.

        Args:
            table: (ticks, width).
        """
        self._run(0, len(self.state), 0, *self._arrays, table)


def _zeros(vectors: int, rows: int, lanes: int) -> np.ndarray:
    array = aligned(vectors * rows * lanes).reshape(vectors, rows, lanes)
    array[...] = 0.0
    return array


def _taking(width: int, lanes: int) -> str:
    """The function that copies the numbers of each vehicle of a vector from the row of its clock into rows."""
    return "\n".join(
        [
            "define internal void @take(ptr %shared, ptr %table, ptr %clocks) noinline {",
            "entry:",
            "  br label %lane",
            "lane:",
            "  %l = phi i64 [0, %entry], [%l1, %next]",
            "  %clock_at = getelementptr i64, ptr %clocks, i64 %l",
            "  %clock = load i64, ptr %clock_at, align 8",
            f"  %first = mul i64 %clock, {width}",
            "  %row = getelementptr double, ptr %table, i64 %first",
            "  %lane_of_rows = getelementptr double, ptr %shared, i64 %l",
            "  br label %number",
            "number:",
            "  %k = phi i64 [0, %lane], [%k1, %number]",
            "  %from = getelementptr double, ptr %row, i64 %k",
            f"  %place = mul i64 %k, {lanes}",
            "  %to = getelementptr double, ptr %lane_of_rows, i64 %place",
            "  %x = load double, ptr %from, align 8",
            "  store double %x, ptr %to, align 8",
            "  %k1 = add i64 %k, 1",
            f"  %more = icmp ult i64 %k1, {width}",
            "  br i1 %more, label %number, label %next",
            "next:",
            "  %l1 = add i64 %l, 1",
            f"  %again = icmp ult i64 %l1, {lanes}",
            "  br i1 %again, label %lane, label %done",
            "done:",
            "  ret void",
            "}",
        ]
    )


def _driver(rows: Mapping[str, int], lanes: int) -> str:
    """The function that Python calls: for vectors from the first on, what is prepared, or a tick."""
    names = ("state", "parameters", "inputs", "kept", "log")
    arrays = [f"{name}_rows" for name in names] + ["clock_rows", "shared_rows", "table_rows"]
    here = [
        line
        for name, count in zip(names, rows.values(), strict=True)
        for line in (
            f"  %{name}_first = mul i64 %v, {count * lanes}",
            f"  %{name} = getelementptr double, ptr %{name}_rows, i64 %{name}_first",
        )
    ]
    pointers = ", ".join(f"ptr %{name}_array" for name in arrays)
    return "\n".join(
        [
            f"define void @kernel(i64 %begin, i64 %count, i64 %prepares, {pointers}) {{",
            "entry:",
            *(line for name in arrays for line in elements_of(name)),
            "  %end = add i64 %begin, %count",
            "  %shared = getelementptr double, ptr %shared_rows, i64 0",
            f"  %padded = add i64 0, {lanes}",
            "  %is_ahead = icmp ne i64 %prepares, 0",
            "  br label %vector",
            "vector:",
            "  %v = phi i64 [%begin, %entry], [%next, %passed]",
            *here,
            "  br i1 %is_ahead, label %ahead, label %tick",
            "ahead:",
            f"  call void {PREPARE}",
            "  br label %passed",
            "tick:",
            f"  %clock_first = mul i64 %v, {lanes}",
            "  %clocks = getelementptr i64, ptr %clock_rows, i64 %clock_first",
            "  call void @take(ptr %shared, ptr %table_rows, ptr %clocks)",
            f"  call void {EVENT}",
            "  br label %passed",
            "passed:",
            "  %next = add i64 %v, 1",
            "  %again = icmp ult i64 %next, %end",
            "  br i1 %again, label %vector, label %done",
            "done:",
            "  ret void",
            "}",
        ]
    )
