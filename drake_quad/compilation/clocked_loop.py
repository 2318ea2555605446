"""Machine code that simulates one tick of vehicles with individual clocks.

The rows of all vehicles in a SIMD vector are stored contiguously in memory, and remain there from tick to tick:

    rows    (vectors, rows, lanes)      [state of vehicles 0 to 7] [state of vehicles 8 to 15] ...

A table contains the values that depend only on time, with one row for each tick. The clock of a vehicle selects the row
of the table. Results that depend only on parameters are computed when the parameters change.
"""

import copy
import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import numpy as np

from drake_quad.compilation.parts import EVENT, PREPARE, Part, PartSizes, Results, aligned, split_listing
from drake_quad.framework.drivers import Driver
from drake_quad.framework.instructions import Rows, declarations
from drake_quad.framework.machine_code import LANES, generated_kernel_address
from drake_quad.framework.symbols import Listing


class ClockedLoop:
    """Machine code that simulates a tick.

    Args:
        listing: operations of a tick, which read the groups `STATE`, `PARAMETERS` and `INPUTS`.
        changes: new value of each changed row of the state, a symbol or a number, by row index.
        logged: symbols or numbers that are written to the log, row by row.
        sizes: number of rows in each group.
        width: number of columns in the table of time-dependent values.
        num_vehicles: number N of vehicles.

    Attributes:
        lanes: number of vehicles in a SIMD vector.
        state: (vectors, rows, lanes) state, which each tick updates.
        parameters: (vectors, rows, lanes) parameters; `prepare` must be called after they change.
        inputs: (vectors, rows, lanes) inputs.
        log: (vectors, rows, lanes) logged values of the last tick.
        clocks: (vectors, lanes) indices of the table rows that the vehicles use, int64.
    """

    def __init__(
        self,
        listing: Listing,
        changes: Mapping[int, Any],
        logged: Sequence[Any],
        *,
        sizes: PartSizes,
        width: int,
        num_vehicles: int,
    ) -> None:
        self.lanes = lanes = 1 if num_vehicles == 1 else LANES
        width = max(1, width)
        results = Results.of(listing, changes, logged)
        preparation, event = split_listing(listing, results)
        rows = {**sizes._asdict(), "precomputed": len(preparation.stores), "log": len(logged)}
        identity = f"clocked loop {lanes} {rows} {width} {results} {listing.digest()}"
        address = generated_kernel_address(identity, lambda: _module(preparation, event, rows, width, lanes))
        arguments: list[Any] = [ctypes.c_int64, ctypes.c_int64, ctypes.c_int64, *[ctypes.py_object] * 8]
        self._run: Callable[..., None] = ctypes.PYFUNCTYPE(None, *arguments)(address)
        self._counts, self._width = tuple(rows.values()), width
        self._allocate(num_vehicles)

    def with_num_vehicles(self, num_vehicles: int) -> Self:
        """Return a copy of this loop for another number of vehicles, with the same machine code.

        A loop for a single vehicle cannot be converted to a loop for several vehicles, or vice versa.
        """
        result = copy.copy(self)
        result._allocate(num_vehicles)
        return result

    def _allocate(self, num_vehicles: int) -> None:
        vectors = -(-num_vehicles // self.lanes)
        self.state, self.parameters, self.inputs, self._precomputed, self.log = (
            _zeros(vectors, count, self.lanes) for count in self._counts
        )
        self.clocks = np.zeros((vectors, self.lanes), dtype=np.int64)
        self._shared = aligned(self._width * self.lanes)
        self._arrays = self.state, self.parameters, self.inputs, self._precomputed, self.log, self.clocks, self._shared

    def prepare(self, vectors: Sequence[int]) -> None:
        """Compute the results that depend only on parameters.

        Args:
            vectors: indices of the SIMD vectors whose parameters have changed.
        """
        for vector in vectors:
            self._run(vector, 1, 1, *self._arrays, self._shared)

    def advance(self, table: np.ndarray) -> None:
        """Simulate one tick for all vehicles.

        Args:
            table: (ticks, width) values that depend only on time.
        """
        self._run(0, len(self.state), 0, *self._arrays, table)


def _zeros(vectors: int, rows: int, lanes: int) -> np.ndarray:
    array = aligned(vectors * rows * lanes).reshape(vectors, rows, lanes)
    array[...] = 0.0
    return array


def _module(preparation: Part, event: Part, rows: Mapping[str, int], width: int, lanes: int) -> str:
    """Return the LLVM code of a tick: the function `PREPARE`, the function `EVENT`, and the driver that calls them."""
    shared = Rows("%shared", lanes)
    return "\n".join(
        [
            declarations(lanes),
            preparation.llvm_function(PREPARE, lanes=lanes, log_stride=0, shared=shared),
            event.llvm_function(EVENT, lanes=lanes, log_stride=lanes, shared=shared),
            _take_function(width, lanes),
            _driver(rows, lanes),
        ]
    )


def _take_function(width: int, lanes: int) -> str:
    """Return the LLVM code of the function `take`, which copies table rows for the vehicles of one SIMD vector.

    The clock of each vehicle is the index of its table row.
    """
    driver = Driver("internal void @take(ptr %shared, ptr %table, ptr %clocks) noinline")
    with driver.loop("lane", 0, lanes):
        driver.at("clock_at", "clocks", "%lane", "i64")
        driver.let("clock", "load i64, ptr %clock_at, align 8")
        driver.let("first", f"mul i64 %clock, {width}")
        driver.at("row", "table", "%first")
        driver.at("lane_of_rows", "shared", "%lane")
        with driver.loop("k", 0, width):
            driver.at("from", "row", "%k")
            driver.let("place", f"mul i64 %k, {lanes}")
            driver.at("to", "lane_of_rows", "%place")
            driver.let("number", "load double, ptr %from, align 8")
            driver.do("store double %number, ptr %to, align 8")
    return driver.text()


def _driver(rows: Mapping[str, int], lanes: int) -> str:
    """Return the LLVM code of the function that Python calls, which prepares SIMD vectors or simulates a tick."""
    arrays = [f"{name}_rows" for name in rows]
    driver = Driver.of_arrays("i64 %begin, i64 %count, i64 %prepares", [*arrays, "clock_rows", "shared", "table"])
    driver.let("end", "add i64 %begin, %count")
    driver.let("padded", f"add i64 0, {lanes}")
    with driver.loop("vector", "%begin", "%end"):
        for name, count in rows.items():
            driver.let(f"{name}_first", f"mul i64 %vector, {count * lanes}")
            driver.at(name, f"{name}_rows", f"%{name}_first")
        with driver.when("is_ahead", "icmp ne i64 %prepares, 0"):
            driver.do(f"call void {PREPARE}")
        with driver.when("is_tick", "icmp eq i64 %prepares, 0"):
            driver.let("clock_first", f"mul i64 %vector, {lanes}")
            driver.at("clocks", "clock_rows", "%clock_first", "i64")
            driver.do("call void @take(ptr %shared, ptr %table, ptr %clocks)")
            driver.do(f"call void {EVENT}")
    return driver.text()
