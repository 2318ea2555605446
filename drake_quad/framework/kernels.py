"""Kernels: machine code that applies a formula to every vehicle of a fleet, `LANES` at a time.

A group of k rows is an array of k N numbers, row after row, and a kernel finds row i of its vehicles from `first` on at
`first + i N`. What is left of a fleet that is no multiple of `LANES` goes through the same instructions in a copy.

    sources  ┌─────────────┐  load   %v12 = <8 x double>      store  ┌─────────────┐  targets
    (k N,)   │ row 0       │ ──────▶ %v13 = fmul %v12, %v7   ──────▶ │ row 0       │  (m N,)
             │ row 1       │         %v14 = fadd %v13, %v2           │ row 1       │
             └─────────────┘                                         └─────────────┘
"""

import ctypes
from collections.abc import Callable, Sequence
from typing import Any

from drake_quad.framework.instructions import Rows, Store, declarations, function
from drake_quad.framework.machine_code import LANES, POINTER, address
from drake_quad.framework.symbols import Listing, Symbol


def compiled(
    listing: Listing, results: Sequence[Any], *, sources: Sequence[int], targets: Sequence[int], lone: bool
) -> Callable[..., None]:
    """Machine code that applies a formula to every vehicle.

    Args:
        listing: of the formula; its groups are those that are read, and the number that all vehicles share is the time.
        results: symbols or constants, the rows that are written, one group after another.
        sources: rows of each group that is read.
        targets: rows of each group that is written.
        lone: whether it is for a single vehicle.

    Returns:
        A function of the number of vehicles, the time (s), and the arrays, targets first, all contiguous and of the
        right size, which it does not check. A target may be a source, too.
    """
    text = _module(listing, results, sources, targets, 1 if lone else LANES)
    arguments = [ctypes.py_object] * (len(targets) + len(sources))
    run: Callable[..., None] = ctypes.PYFUNCTYPE(None, ctypes.c_int64, ctypes.c_double, *arguments)(address(text))
    return run


def _module(
    listing: Listing, results: Sequence[Any], sources: Sequence[int], targets: Sequence[int], lanes: int
) -> str:
    """The text of a kernel in LLVM's language."""
    symbols = [result if result.__class__ is Symbol else listing.constant(result) for result in results]
    places = [(f"%target_{group}", place) for group, rows in enumerate(targets) for place in range(rows)]
    stores = [
        Store(Rows(group, "%stride"), place, symbol) for (group, place), symbol in zip(places, symbols, strict=True)
    ]
    groups = {group: Rows(f"%source_{group}", "%stride") for group in range(len(sources))}
    pointers = [f"ptr %target_{i}" for i in range(len(targets))] + [f"ptr %source_{i}" for i in range(len(sources))]
    head = f"@block(i64 %stride, ptr %time, {', '.join(pointers)}) {'alwaysinline' if lanes == 1 else 'noinline'}"
    body = function(head, listing, stores, groups, shared="%time", lanes=lanes, overlapping=True)
    driver = _lone(sources, targets) if lanes == 1 else _fleet(sources, targets)
    return "\n".join([declarations(lanes), body, driver])


def _arrays(sources: Sequence[int], targets: Sequence[int]) -> tuple[str, list[str], list[str]]:
    """The arguments of a kernel, the lines that find time and the elements of its arrays, and the arrays' names."""
    names = [f"target_{i}" for i in range(len(targets))] + [f"source_{i}" for i in range(len(sources))]
    lines = ["  %time = alloca double", "  store double %now, ptr %time"]
    for name in names:
        lines += elements_of(name)
    return ", ".join(f"ptr %{name}_array" for name in names), lines, names


def elements_of(name: str) -> list[str]:
    """The lines that find the elements of an array of NumPy's, which is called the same with `_array` appended."""
    return [
        f"  %{name}_at = getelementptr i8, ptr %{name}_array, i64 {POINTER}",
        f"  %{name} = load ptr, ptr %{name}_at",
    ]


def _lone(sources: Sequence[int], targets: Sequence[int]) -> str:
    """The function that Python calls for one vehicle."""
    arguments, found, names = _arrays(sources, targets)
    return "\n".join(
        [
            f"define void @kernel(i64 %n, double %now, {arguments}) {{",
            *found,
            f"  call void @block(i64 1, ptr %time, {', '.join(f'ptr %{name}' for name in names)})",
            "  ret void",
            "}",
        ]
    )


def _fleet(sources: Sequence[int], targets: Sequence[int]) -> str:
    """The function that Python calls for a fleet: whole vectors in place, and the rest in a copy."""
    arguments, found, names = _arrays(sources, targets)
    sizes = dict(zip(names, [*targets, *sources], strict=True))
    copies = [f"  %{name}_copy = alloca [{max(size, 1) * LANES} x double], align 64" for name, size in sizes.items()]
    whole = [f"  %{name}_here = getelementptr double, ptr %{name}, i64 %first" for name in names]
    rest = [f"  %{name}_rest = getelementptr double, ptr %{name}, i64 %next" for name in names]

    def copy(way: str, name: str) -> str:
        return f"  call void @{way}(ptr %{name}_copy, ptr %{name}_rest, i64 {sizes[name]}, i64 %n, i64 %left)"

    return "\n".join(
        [
            copying(LANES),
            f"define void @kernel(i64 %n, double %now, {arguments}) {{",
            "entry:",
            *found,
            *copies,
            f"  %vectors = udiv i64 %n, {LANES}",
            f"  %next = mul i64 %vectors, {LANES}",
            "  %left = sub i64 %n, %next",
            "  %some = icmp ugt i64 %vectors, 0",
            "  br i1 %some, label %vector, label %last",
            "vector:",
            "  %first = phi i64 [0, %entry], [%following, %vector]",
            *whole,
            f"  call void @block(i64 %n, ptr %time, {', '.join(f'ptr %{name}_here' for name in names)})",
            f"  %following = add i64 %first, {LANES}",
            "  %more = icmp ult i64 %following, %next",
            "  br i1 %more, label %vector, label %last",
            "last:",
            "  %any = icmp ugt i64 %left, 0",
            "  br i1 %any, label %copied, label %done",
            "copied:",
            *rest,
            *(copy("gather", name) for name in names if name.startswith("source")),
            f"  call void @block(i64 {LANES}, ptr %time, {', '.join(f'ptr %{name}_copy' for name in names)})",
            *(copy("scatter", name) for name in names if name.startswith("target")),
            "  br label %done",
            "done:",
            "  ret void",
            "}",
        ]
    )


def copying(lanes: int) -> str:
    """Functions that copy rows of up to a vector's vehicles out of a fleet, `gather`, and back, `scatter`.

    Lanes without a vehicle get the last one's numbers.
    """
    return "\n".join(
        [_copying("gather", lanes, str(lanes), "fleet", "copy"), _copying("scatter", lanes, "%left", "copy", "fleet")]
    )


def _copying(name: str, lanes: int, count: str, source: str, target: str) -> str:
    """A function that copies whole vectors, or `count` single elements of every row."""
    vector = f"<{lanes} x i64>"
    return "\n".join(
        [
            f"define internal void @{name}(ptr %copy, ptr %fleet, i64 %rows, i64 %stride, i64 %left) noinline {{",
            "entry:",
            "  %most = sub i64 %left, 1",
            "  %none = icmp eq i64 %rows, 0",
            "  br i1 %none, label %done, label %row",
            "row:",
            "  %r = phi i64 [0, %entry], [%r1, %next]",
            f"  %to = mul i64 %r, {lanes}",
            "  %from = mul i64 %r, %stride",
            "  %copy_here = getelementptr i64, ptr %copy, i64 %to",
            "  %fleet_here = getelementptr i64, ptr %fleet, i64 %from",
            f"  %whole = icmp uge i64 %left, {lanes}",
            "  br i1 %whole, label %vector, label %lane",
            "vector:",
            f"  %all = load {vector}, ptr %{source}_here, align 8",
            f"  store {vector} %all, ptr %{target}_here, align 8",
            "  br label %next",
            "lane:",
            "  %l = phi i64 [0, %row], [%l1, %lane]",
            "  %within = icmp ult i64 %l, %most",
            "  %k = select i1 %within, i64 %l, i64 %most",
            "  %copy_at = getelementptr i64, ptr %copy_here, i64 %l",
            "  %fleet_at = getelementptr i64, ptr %fleet_here, i64 %k",
            f"  %x = load i64, ptr %{source}_at, align 8",
            f"  store i64 %x, ptr %{target}_at, align 8",
            "  %l1 = add i64 %l, 1",
            f"  %again = icmp ult i64 %l1, {count}",
            "  br i1 %again, label %lane, label %next",
            "next:",
            "  %r1 = add i64 %r, 1",
            "  %more = icmp ult i64 %r1, %rows",
            "  br i1 %more, label %row, label %done",
            "done:",
            "  ret void",
            "}",
        ]
    )
