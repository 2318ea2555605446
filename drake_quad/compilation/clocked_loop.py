"""Machine code of a tick for vehicles with clocks of their own.

Vehicles lie in memory vector by vector, each with all of its rows, and stay there from tick to tick:

    rows    (vectors, rows, lanes)      [state of vehicles 0 to 7] [state of vehicles 8 to 15] ...

The numbers that depend on the time alone stand in a table, a row a tick; each vehicle takes the row of its clock. What
follows from parameters alone is computed when these change.
"""

import copy
import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Self

import numpy as np

from drake_quad.compilation.parts import EVENT, PREPARE, PartSizes, aligned, divided
from drake_quad.framework.drivers import Driver
from drake_quad.framework.instructions import Rows, declarations
from drake_quad.framework.machine_code import LANES, kernel_address
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
        sizes: PartSizes,
        width: int,
        num_vehicles: int,
    ) -> None:
        self.lanes = lanes = 1 if num_vehicles == 1 else LANES
        width = max(1, width)
        before, event = divided(listing, changes, logged)
        rows = {**sizes._asdict(), "kept": len(before.stores), "log": len(logged)}
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
        self._run: Callable[..., None] = ctypes.PYFUNCTYPE(None, *arguments)(kernel_address(text))
        self._counts, self._width = tuple(rows.values()), width
        self._allocate(num_vehicles)

    def fresh(self, num_vehicles: int) -> Self:
        """Return a loop with the same machine code for another number of vehicles, which stays 1 if it was."""
        result = copy.copy(self)
        result._allocate(num_vehicles)
        return result

    def _allocate(self, num_vehicles: int) -> None:
        vectors = -(-num_vehicles // self.lanes)
        self.state, self.parameters, self.inputs, self._kept, self.log = (
            _zeros(vectors, count, self.lanes) for count in self._counts
        )
        self.clocks = np.zeros((vectors, self.lanes), dtype=np.int64)
        self._shared = aligned(self._width * self.lanes)
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
    """Return the function that copies the numbers of each vehicle of a vector from the row of its clock into rows."""
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
    """Return the function that Python calls, which prepares several vectors or lets a tick pass for them."""
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
