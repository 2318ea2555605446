"""Kernels: machine code that applies a formula to every vehicle of a fleet, `LANES` vehicles at a time.

A group of k rows is an array with k N elements, in which row i starts at element i N. A vector of vehicles that starts
with vehicle `first` has its rows at the elements `first + i N`. If N is not a multiple of `LANES`, the remaining
vehicles are copied to a full vector. The same instructions compute this vector, and its results are copied back.

    sources  ┌─────────────┐  load   %v12 = <8 x double>      store  ┌─────────────┐  targets
    (k N,)   │ row 0       │ ──────▶ %v13 = fmul %v12, %v7   ──────▶ │ row 0       │  (m N,)
             │ row 1       │         %v14 = fadd %v13, %v2           │ row 1       │
             └─────────────┘                                         └─────────────┘
"""

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

from drake_quad.framework.drivers import Driver, copy_functions
from drake_quad.framework.instructions import Rows, Store, declarations, function
from drake_quad.framework.machine_code import LANES, generated_kernel_address
from drake_quad.framework.symbols import Listing, Symbol


def compile_kernel(
    listing: Listing, results: Sequence[Any], *, sources: Sequence[int], targets: Sequence[int], single_vehicle: bool
) -> Callable[..., None]:
    """Return machine code that applies a formula to every vehicle.

    Args:
        listing: listing of the formula. Its groups are the sources, and its only shared value is the time.
        results: symbols or constants of the rows to write, target by target.
        sources: number of rows in each source, a group that is read.
        targets: number of rows in each target, a group that is written.
        single_vehicle: True for machine code that computes only one vehicle.

    Returns:
        Function with the arguments number of vehicles, time (s), arrays of the targets, arrays of the sources. It does
        not check that the arrays are contiguous and have the correct size. A target may also be a source.
    """
    lanes = 1 if single_vehicle else LANES
    symbols = [result if result.__class__ is Symbol else listing.constant(result) for result in results]
    identity = f"kernel {lanes} {[*sources]} {[*targets]} {[symbol.line for symbol in symbols]} {listing.digest()}"
    address = generated_kernel_address(identity, lambda: _module(listing, symbols, sources, targets, lanes))
    arguments = [ctypes.py_object] * (len(targets) + len(sources))
    run: Callable[..., None] = ctypes.PYFUNCTYPE(None, ctypes.c_int64, ctypes.c_double, *arguments)(address)
    return run


def _module(
    listing: Listing, symbols: Sequence[Symbol], sources: Sequence[int], targets: Sequence[int], lanes: int
) -> str:
    """Return the LLVM code of a kernel, given the symbols of its results."""
    indices = [(f"%target_{group}", index) for group, rows in enumerate(targets) for index in range(rows)]
    stores = [
        Store(Rows(group, "%stride"), index, symbol) for (group, index), symbol in zip(indices, symbols, strict=True)
    ]
    groups = {group: Rows(f"%source_{group}", "%stride") for group in range(len(sources))}
    pointers = [f"ptr %target_{i}" for i in range(len(targets))] + [f"ptr %source_{i}" for i in range(len(sources))]
    head = f"@block(i64 %stride, ptr %time, {', '.join(pointers)}) {'alwaysinline' if lanes == 1 else 'noinline'}"
    body = function(head, listing, stores, groups, shared="%time", lanes=lanes, overlapping=True)
    return "\n".join([declarations(lanes), body, _driver(sources, targets, lanes)])


def _driver(sources: Sequence[int], targets: Sequence[int], lanes: int) -> str:
    """Return the LLVM code of the function that Python calls, which copies the last vehicles to a full vector."""
    sizes = {f"target_{i}": rows for i, rows in enumerate(targets)}
    sizes |= {f"source_{i}": rows for i, rows in enumerate(sources)}
    driver = Driver.of_arrays("i64 %n, double %now", [*sizes])
    driver.let("time", "alloca double")
    driver.do("store double %now, ptr %time")

    def call(stride: str | int, suffix: str = "") -> None:
        driver.do(f"call void @block(i64 {stride}, ptr %time, {', '.join(f'ptr %{name}{suffix}' for name in sizes)})")

    def copy(function_name: str, prefix: str) -> None:
        for name, size in sizes.items():
            if name.startswith(prefix):
                driver.do(
                    f"call void @{function_name}(ptr %{name}_copy, ptr %{name}_rest, i64 {size}, i64 %n, i64 %left)"
                )

    if lanes == 1:
        call(1)
        return driver.text()
    for name, size in sizes.items():
        driver.let(f"{name}_copy", f"alloca [{max(size, 1) * lanes} x double], align 64")
    driver.let("vectors", f"udiv i64 %n, {lanes}")
    driver.let("whole", f"mul i64 %vectors, {lanes}")
    driver.let("left", "sub i64 %n, %whole")
    with driver.loop("first", 0, "%whole", lanes):
        for name in sizes:
            driver.at(f"{name}_here", name, "%first")
        call("%n", "_here")
    with driver.when("some", "icmp ugt i64 %left, 0"):
        for name in sizes:
            driver.at(f"{name}_rest", name, "%whole")
        copy("gather", "source")
        call(lanes, "_copy")
        copy("scatter", "target")
    return "\n".join([copy_functions(lanes), driver.text()])
