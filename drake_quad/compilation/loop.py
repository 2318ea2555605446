"""Machine code that simulates several events, one SIMD vector of vehicles at a time.

The rows of the vehicles in a SIMD vector are copied from the fleet to contiguous memory, which remains in the
processor's fastest cache during all events. After the last event they are copied back:

    fleet  ──gather──▶  rows of one SIMD vector  ──event──▶──event──▶ ... ──scatter──▶  fleet

Results that depend only on parameters are computed before the first event and stored next to these rows.
"""

import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from drake_quad.compilation.parts import EVENT, PREPARE, PartSizes, Results, aligned, split_listing
from drake_quad.framework.drivers import Driver, copy_functions
from drake_quad.framework.instructions import declarations
from drake_quad.framework.machine_code import LANES, generated_kernel_address
from drake_quad.framework.symbols import Listing


class Loop:
    """Machine code that simulates consecutive events.

    Args:
        listing: operations of an event, which read the groups `STATE`, `PARAMETERS` and `INPUTS`.
        changes: new value of each changed row of the state, a symbol or a number, by row index.
        logged: symbols or numbers that every event writes to the log.
        sizes: number of rows in each group.
        width: number of columns in the table of the values that all vehicles share; each event has one row.
        single_vehicle: True for machine code that computes only one vehicle.

    Attributes:
        num_logged: number of rows that every event writes to the log.
    """

    def __init__(
        self,
        listing: Listing,
        changes: Mapping[int, Any],
        logged: Sequence[Any],
        *,
        sizes: PartSizes,
        width: int,
        single_vehicle: bool,
    ) -> None:
        self._lanes, self.num_logged = 1 if single_vehicle else LANES, len(logged)
        results = Results.of(listing, changes, logged)
        # The precomputed results occupy the last rows. There are at most as many results as operations, and unused
        # memory costs nothing. All calls can share this memory, since the function holds Python's global interpreter
        # lock.
        self._scratch = aligned((sum(sizes) + len(listing.operations)) * self._lanes)
        identity = f"loop {self._lanes} {sizes} {width} {results} {listing.digest()}"
        address = generated_kernel_address(identity, lambda: self._module(listing, results, sizes, width))
        arguments: list[Any] = [ctypes.c_int64, ctypes.c_int64, *[ctypes.py_object] * 6]
        self._run: Callable[..., None] = ctypes.PYFUNCTYPE(None, *arguments)(address)

    def _module(self, listing: Listing, results: Results, sizes: PartSizes, width: int) -> str:
        """Return the LLVM code of both parts of an event, and of the driver that calls them."""
        preparation, event = split_listing(listing, results)
        return "\n".join(
            [
                declarations(self._lanes),
                copy_functions(self._lanes),
                preparation.llvm_function(PREPARE, lanes=self._lanes, log_stride=0, shared=""),
                event.llvm_function(EVENT, lanes=self._lanes, log_stride="%padded", shared="%shared"),
                _driver(sizes, len(results.logged), max(1, width), self._lanes),
            ]
        )

    def padded_num_vehicles(self, num_vehicles: int) -> int:
        """Return the number of columns in a log: the number of vehicles, rounded up to whole SIMD vectors."""
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
        """Simulate consecutive events.

        Args:
            state: (rows · N,) state, which is overwritten.
            parameters: (rows · N,) parameters.
            inputs: (rows · N,) inputs, which are the same at all events.
            shared: (events, width) values that all vehicles share.
            log: (events, num_logged, padded N) log, which is overwritten.
            num_vehicles: number N of vehicles.
        """
        self._run(num_vehicles, len(shared), state, parameters, inputs, shared, log, self._scratch)


def _driver(sizes: PartSizes, num_logged: int, width: int, lanes: int) -> str:
    """Return the LLVM code of the function that Python calls."""
    copied = sizes._asdict()
    arrays = [f"{name}_rows" for name in (*copied, "shared", "log")]
    driver = Driver.of_arrays("i64 %n, i64 %events", [*arrays, "scratch"])
    row = 0
    for name, count in {**copied, "precomputed": 0}.items():
        driver.at(name, "scratch", row * lanes)
        row += count
    driver.let("up", f"add i64 %n, {lanes - 1}")
    driver.let("vectors", f"udiv i64 %up, {lanes}")
    driver.let("padded", f"mul i64 %vectors, {lanes}")
    driver.let("logged", f"mul i64 %padded, {num_logged}")
    with driver.loop("first", 0, "%n", lanes):
        driver.let("left", "sub i64 %n, %first")
        for name, count in copied.items():
            driver.at(f"{name}_there", f"{name}_rows", "%first")
            driver.do(f"call void @gather(ptr %{name}, ptr %{name}_there, i64 {count}, i64 %n, i64 %left)")
        driver.do(f"call void {PREPARE}")
        driver.at("log_first", "log_rows", "%first")
        with driver.loop("k", 0, "%events"):
            driver.let("shared_row", f"mul i64 %k, {width}")
            driver.at("shared", "shared_rows", "%shared_row")
            driver.let("log_row", "mul i64 %k, %logged")
            driver.at("log", "log_first", "%log_row")
            driver.do(f"call void {EVENT}")
        driver.do(f"call void @scatter(ptr %state, ptr %state_there, i64 {sizes.state}, i64 %n, i64 %left)")
    return driver.text()
