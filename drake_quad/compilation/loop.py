"""Machine code that simulates several events, one SIMD vector of vehicles at a time.

The rows of the vehicles in a SIMD vector are copied from the fleet to contiguous memory, which remains in the
processor's fastest cache during all events. After the last event they are copied back:

    fleet  ──gather──▶  rows of one SIMD vector  ──event──▶──event──▶ ... ──scatter──▶  fleet

Results that depend only on parameters are computed before the first event and stored next to these rows. The events can
be of several kinds, which occur in any order.
"""

import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from drake_quad.compilation.parts import EVENT, PREPARE, PartSizes, Results, aligned, numbered, split_listing
from drake_quad.framework.drivers import Driver, copy_functions
from drake_quad.framework.instructions import declarations
from drake_quad.framework.machine_code import LANES, generated_kernel_address
from drake_quad.framework.symbols import Listing


class EventCode(NamedTuple):
    """Operations of a kind of event.

    Attributes:
        listing: operations of an event, which read the groups `STATE`, `PARAMETERS` and `INPUTS`.
        changes: new value of each changed row of the state, a symbol or a number, by row index.
        logged: symbols or numbers that every event writes to the log.
    """

    listing: Listing
    changes: Mapping[int, Any]
    logged: Sequence[Any]


class Loop:
    """Machine code that simulates consecutive events.

    Args:
        kinds: operations of each kind of event.
        sizes: number of rows in each group.
        width: number of columns in the table of the values that all vehicles share; each event has one row.
        single_vehicle: True for machine code that computes only one vehicle.

    Attributes:
        num_logged: number of rows in the log of an event. Events of a kind that logs fewer rows write only the first.
    """

    def __init__(self, kinds: Sequence[EventCode], *, sizes: PartSizes, width: int, single_vehicle: bool) -> None:
        self._lanes = 1 if single_vehicle else LANES
        results = [Results.of(*kind) for kind in kinds]
        self.num_logged = max(len(each.logged) for each in results)
        # The precomputed results of each kind occupy the last rows. There are at most as many results as operations,
        # and unused memory costs nothing. All calls can share this memory, since the function holds Python's global
        # interpreter lock.
        listings = [kind.listing for kind in kinds]
        num_rows = sum(sizes) + sum(len(each.operations) for each in listings)
        self._scratch = aligned(num_rows * self._lanes)
        self._only_kind = np.zeros(1, dtype=np.int64)
        digests = " ".join(f"{result} {listing.digest()}" for result, listing in zip(results, listings, strict=True))
        address = generated_kernel_address(
            f"loop {self._lanes} {sizes} {width} {digests}", lambda: self._module(listings, results, sizes, width)
        )
        arguments: list[Any] = [ctypes.c_int64, ctypes.c_int64, *[ctypes.py_object] * 7]
        self._run: Callable[..., None] = ctypes.PYFUNCTYPE(None, *arguments)(address)

    def _module(self, listings: Sequence[Listing], results: Sequence[Results], sizes: PartSizes, width: int) -> str:
        """Return the LLVM code of both parts of each kind of event, and of the driver that calls them."""
        functions = []
        for number, (listing, result) in enumerate(zip(listings, results, strict=True)):
            preparation, event = split_listing(listing, result)
            prepare_head, event_head = numbered(PREPARE, number), numbered(EVENT, number)
            functions += [
                preparation.llvm_function(prepare_head, lanes=self._lanes, log_stride=0, shared=""),
                event.llvm_function(event_head, lanes=self._lanes, log_stride="%padded", shared="%shared"),
            ]
        num_operations = [len(each.operations) for each in listings]
        driver = _driver(sizes, num_operations, self.num_logged, max(1, width), self._lanes)
        return "\n".join([declarations(self._lanes), copy_functions(self._lanes), *functions, driver])

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
        *,
        order: np.ndarray | None = None,
    ) -> None:
        """Simulate consecutive events.

        Args:
            state: (rows · N,) state, which is overwritten.
            parameters: (rows · N,) parameters.
            inputs: (rows · N,) inputs, which are the same at all events.
            shared: (events, width) values that all vehicles share.
            log: (events, num_logged, padded N) log, which is overwritten.
            num_vehicles: number N of vehicles.
            order: (events,) index of the kind of each event, 64-bit integers; None if there is only one kind.
        """
        kinds = self._only_kind if order is None else order
        self._run(num_vehicles, len(shared), state, parameters, inputs, shared, log, kinds, self._scratch)


def _driver(sizes: PartSizes, num_operations: Sequence[int], num_logged: int, width: int, lanes: int) -> str:
    """Return the LLVM code of the function that Python calls.

    Args:
        sizes: number of rows in each group.
        num_operations: number of operations of each kind of event, which limits the number of its precomputed results.
        num_logged: number of rows in the log of an event.
        width: number of columns in the table of shared values.
        lanes: number of vehicles in a SIMD vector.
    """
    copied = sizes._asdict()
    arrays = [f"{name}_rows" for name in (*copied, "shared", "log")]
    driver = Driver.of_arrays("i64 %n, i64 %events", [*arrays, "order", "scratch"])
    kinds = range(len(num_operations))
    row = 0
    for name, count in {**copied, **{f"precomputed_{k}": num_operations[k] for k in kinds}}.items():
        driver.at(name, "scratch", row * lanes)
        row += count
    prepares, events = (
        [numbered(head, k).replace("ptr %precomputed", f"ptr %precomputed_{k}") for k in kinds]
        for head in (PREPARE, EVENT)
    )
    driver.let("up", f"add i64 %n, {lanes - 1}")
    driver.let("vectors", f"udiv i64 %up, {lanes}")
    driver.let("padded", f"mul i64 %vectors, {lanes}")
    driver.let("logged", f"mul i64 %padded, {num_logged}")
    with driver.loop("first", 0, "%n", lanes):
        driver.let("left", "sub i64 %n, %first")
        for name, count in copied.items():
            driver.at(f"{name}_there", f"{name}_rows", "%first")
            driver.do(f"call void @gather(ptr %{name}, ptr %{name}_there, i64 {count}, i64 %n, i64 %left)")
        for prepare in prepares:
            driver.do(f"call void {prepare}")
        driver.at("log_first", "log_rows", "%first")
        with driver.loop("k", 0, "%events"):
            driver.let("shared_row", f"mul i64 %k, {width}")
            driver.at("shared", "shared_rows", "%shared_row")
            driver.let("log_row", "mul i64 %k, %logged")
            driver.at("log", "log_first", "%log_row")
            if len(events) == 1:
                driver.do(f"call void {events[0]}")
            else:
                driver.at("kind_at", "order", "%k", "i64")
                driver.let("kind", "load i64, ptr %kind_at, align 8")
                for number, event in enumerate(events):
                    with driver.when(f"is_kind_{number}", f"icmp eq i64 %kind, {number}"):
                        driver.do(f"call void {event}")
        driver.do(f"call void @scatter(ptr %state, ptr %state_there, i64 {sizes.state}, i64 %n, i64 %left)")
    return driver.text()
