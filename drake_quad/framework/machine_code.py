"""From the listing of a formula to machine code, by LLVM.

A kernel applies a formula to every vehicle of a fleet, `LANES` at a time: each line of the listing becomes one vector
instruction. A group of k rows is an array of k N numbers, row after row, and a kernel finds row i of its vehicles from
`first` on at `first + i N`. What is left of a fleet that is no multiple of `LANES` goes through the same instructions
in a copy.

    sources  ┌─────────────┐  load   %v12 = <8 x double>      store  ┌─────────────┐  targets
    (k N,)   │ row 0       │ ──────▶ %v13 = fmul %v12, %v7   ──────▶ │ row 0       │  (m N,)
             │ row 1       │         %v14 = fadd %v13, %v2           │ row 1       │
             └─────────────┘                                         └─────────────┘

Arithmetic is as the formula has it: nothing is reordered, and a product is rounded before it is added. So a vehicle
flies the same alone and in a fleet, on any processor.

Machine code is kept on the disk under a name that is made of the instructions and the processor: what a formula was
when it was compiled does not matter, only what it does now.
"""

import ctypes
import functools
import hashlib
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numpy as np

from drake_quad.files import write_whole
from drake_quad.framework.symbols import Kind, Listing, Symbol

# Vehicles in a vector: what the widest registers of today hold.
LANES = 8

# What an operation is in LLVM's language, {t} being the type of its first operand and {r} that of the result.
INSTRUCTIONS = {
    "add": "fadd {t} {0}, {1}",
    "subtract": "fsub {t} {0}, {1}",
    "multiply": "fmul {t} {0}, {1}",
    "divide": "fdiv {t} {0}, {1}",
    "negate": "fneg {t} {0}",
    "absolute": "call {t} @llvm.fabs.{s}({t} {0})",
    "square_root": "call {t} @llvm.sqrt.{s}({t} {0})",
    "nearest": "call {t} @llvm.rint.{s}({t} {0})",
    "multiply_add": "call {t} @llvm.fma.{s}({t} {0}, {t} {1}, {t} {2})",
    "copy_sign": "call {t} @llvm.copysign.{s}({t} {0}, {t} {1})",
    "less": "fcmp olt {t} {0}, {1}",
    "less_or_equal": "fcmp ole {t} {0}, {1}",
    "greater": "fcmp ogt {t} {0}, {1}",
    "greater_or_equal": "fcmp oge {t} {0}, {1}",
    "equal": "fcmp oeq {t} {0}, {1}",
    "unequal": "fcmp une {t} {0}, {1}",
    "select": "select {t} {0}, {r} {1}, {r} {2}",
    "bits_of": "bitcast {t} {0} to {r}",
    "number_of": "bitcast {t} {0} to {r}",
    "float_of": "uitofp {t} {0} to {r}",
}
# Of words and truth values.
_BITWISE = {
    "add": "add {t} {0}, {1}",
    "multiply": "mul {t} {0}, {1}",
    "and": "and {t} {0}, {1}",
    "or": "or {t} {0}, {1}",
    "xor": "xor {t} {0}, {1}",
    "shift_left": "shl {t} {0}, {1}",
    "shift_right": "lshr {t} {0}, {1}",
}
_ELEMENTS = {Kind.NUMBER: "double", Kind.TRUTH: "i1", Kind.WORD: "i64"}
_INTRINSICS = {"fabs": 1, "sqrt": 1, "rint": 1, "fma": 3, "copysign": 2}
_CHECKSUM_SIZE = 32
# A NumPy array's pointer to its elements stands behind what all Python objects begin with (NumPy's C interface).
_POINTER = object.__basicsize__


def _check_pointer() -> None:
    """Raises ImportError where NumPy's arrays are laid out in another way."""
    array = np.zeros(1)
    if ctypes.c_void_p.from_address(id(array) + _POINTER).value != array.ctypes.data:
        raise ImportError("machine code cannot find the elements of NumPy's arrays in this Python")


_check_pointer()


def _type(kind: Kind, lanes: int) -> str:
    return f"<{lanes} x {_ELEMENTS[kind]}>"


class Kernel:
    """Machine code that applies a formula to every vehicle.

    Args:
        listing: of the formula; its groups are those that are read.
        results: symbols or constants, the rows that are written, one group after another.
        sources: rows of each group that is read.
        targets: rows of each group that is written.
        lone: whether it is for a single vehicle.

    Attributes:
        function: takes the number of vehicles, the time (s), and the arrays, targets first, all contiguous and of the
            right size, which it does not check. A target may be a source, too.
    """

    def __init__(
        self,
        listing: Listing,
        results: Sequence[Any],
        *,
        sources: Sequence[int],
        targets: Sequence[int],
        lone: bool,
    ) -> None:
        text = _module(listing, results, sources, targets, 1 if lone else LANES)
        address = _address(text)
        arguments = [ctypes.py_object] * (len(targets) + len(sources))
        self.function = ctypes.PYFUNCTYPE(None, ctypes.c_int64, ctypes.c_double, *arguments)(address)


def _module(
    listing: Listing, results: Sequence[Any], sources: Sequence[int], targets: Sequence[int], lanes: int
) -> str:
    """The text of a kernel in LLVM's language."""
    vector = f"v{lanes}f64"
    declarations = [
        f"declare {_type(Kind.NUMBER, lanes)} @llvm.{name}.{vector}({', '.join([_type(Kind.NUMBER, lanes)] * count)})"
        for name, count in _INTRINSICS.items()
    ]
    body = _block(listing, results, len(sources), targets, lanes)
    driver = _lone(sources, targets) if lanes == 1 else _fleet(sources, targets)
    return "\n".join([*declarations, body, driver])


def _block(listing: Listing, results: Sequence[Any], num_sources: int, targets: Sequence[int], lanes: int) -> str:
    """The function that does what is listed for the vehicles of one vector, whose rows lie `stride` apart."""
    symbols = [result if result.__class__ is Symbol else listing.constant(result) for result in results]
    lines: list[str] = []
    names = [_written(lines, listing, line, lanes) for line in range(len(listing.operations))]
    number = _type(Kind.NUMBER, lanes)
    places = [(group, place) for group, rows in enumerate(targets) for place in range(rows)]
    for (group, place), symbol in zip(places, symbols, strict=True):
        pointer = f"%store_{group}_{place}"
        lines += _pointer(pointer, f"%target_{group}", place)
        lines.append(f"store {number} {names[symbol.line]}, ptr {pointer}, align 8")
    groups = [f"ptr %target_{i}" for i in range(len(targets))] + [f"ptr %source_{i}" for i in range(num_sources)]
    return "\n".join(
        [
            f"define internal void @block(i64 %stride, double %time, {', '.join(groups)}) "
            f"{'alwaysinline' if lanes == 1 else 'noinline'} {{",
            *(f"  {line}" for line in lines),
            "  ret void",
            "}",
        ]
    )


def _written(lines: list[str], listing: Listing, number: int, lanes: int) -> str:
    """Writes a line of a listing, and returns the name of its result or, of a constant, its text."""
    operation = listing.operations[number]
    kind, name = operation.kind, f"%v{number}"
    if operation.name == "constant":
        (bits,) = operation.operands
        text = f"0x{bits:016X}" if kind is Kind.NUMBER else str(bits)
        return f"<{', '.join([f'{_ELEMENTS[kind]} {text}'] * lanes)}>"
    if operation.name == "time":
        lines.append(f"{name}_one = insertelement {_type(kind, lanes)} poison, double %time, i32 0")
        lines.append(
            f"{name} = shufflevector {_type(kind, lanes)} {name}_one, {_type(kind, lanes)} poison,"
            f" <{lanes} x i32> zeroinitializer"
        )
        return name
    if operation.name == "row":
        group, place = operation.operands
        lines += _pointer(f"{name}_at", f"%source_{group}", place)
        lines.append(f"{name} = load {_type(kind, lanes)}, ptr {name}_at, align 8")
        return name
    first = listing.operations[operation.operands[0]].kind
    templates = INSTRUCTIONS if first is Kind.NUMBER or operation.name not in _BITWISE else _BITWISE
    operands = [_name(listing, operand, lanes) for operand in operation.operands]
    text = templates[operation.name].format(*operands, t=_type(first, lanes), r=_type(kind, lanes), s=f"v{lanes}f64")
    lines.append(f"{name} = {text}")
    return name


def _name(listing: Listing, number: int, lanes: int) -> str:
    return _written([], listing, number, lanes) if listing.operations[number].name == "constant" else f"%v{number}"


def _pointer(name: str, group: str, place: int) -> list[str]:
    """The lines that find a row of a group."""
    return [f"{name}_row = mul i64 %stride, {place}", f"{name} = getelementptr double, ptr {group}, i64 {name}_row"]


def _arrays(sources: Sequence[int], targets: Sequence[int]) -> tuple[str, list[str], list[str]]:
    """The arguments of a kernel, the lines that find the elements of its arrays, and their names."""
    names = [f"target_{i}" for i in range(len(targets))] + [f"source_{i}" for i in range(len(sources))]
    lines = []
    for name in names:
        lines += [
            f"  %{name}_at = getelementptr i8, ptr %{name}_array, i64 {_POINTER}",
            f"  %{name} = load ptr, ptr %{name}_at",
        ]
    return ", ".join(f"ptr %{name}_array" for name in names), lines, names


def _lone(sources: Sequence[int], targets: Sequence[int]) -> str:
    """The function that Python calls for one vehicle."""
    arguments, found, names = _arrays(sources, targets)
    return "\n".join(
        [
            f"define void @kernel(i64 %n, double %time, {arguments}) {{",
            *found,
            f"  call void @block(i64 1, double %time, {', '.join(f'ptr %{name}' for name in names)})",
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
            _COPYING,
            f"define void @kernel(i64 %n, double %time, {arguments}) {{",
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
            f"  call void @block(i64 %n, double %time, {', '.join(f'ptr %{name}_here' for name in names)})",
            f"  %following = add i64 %first, {LANES}",
            "  %more = icmp ult i64 %following, %next",
            "  br i1 %more, label %vector, label %last",
            "last:",
            "  %any = icmp ugt i64 %left, 0",
            "  br i1 %any, label %copied, label %done",
            "copied:",
            *rest,
            *(copy("gather", name) for name in names if name.startswith("source")),
            f"  call void @block(i64 {LANES}, double %time, {', '.join(f'ptr %{name}_copy' for name in names)})",
            *(copy("scatter", name) for name in names if name.startswith("target")),
            "  br label %done",
            "done:",
            "  ret void",
            "}",
        ]
    )


def _copying(name: str, lanes: str, moves: Sequence[str]) -> str:
    """A function that copies `lanes` elements of every row between a copy and a fleet."""
    return "\n".join(
        [
            f"define internal void @{name}(ptr %copy, ptr %fleet, i64 %rows, i64 %stride, i64 %left) noinline {{",
            "entry:",
            "  %most = sub i64 %left, 1",
            "  %none = icmp eq i64 %rows, 0",
            "  br i1 %none, label %done, label %row",
            "row:",
            "  %r = phi i64 [0, %entry], [%r1, %next]",
            f"  %to = mul i64 %r, {LANES}",
            "  %from = mul i64 %r, %stride",
            "  br label %lane",
            "lane:",
            "  %l = phi i64 [0, %row], [%l1, %lane]",
            "  %within = icmp ult i64 %l, %most",
            "  %k = select i1 %within, i64 %l, i64 %most",
            "  %a = add i64 %to, %l",
            "  %b = add i64 %from, %k",
            "  %c = getelementptr i64, ptr %copy, i64 %a",
            "  %f = getelementptr i64, ptr %fleet, i64 %b",
            *(f"  {move}" for move in moves),
            "  %l1 = add i64 %l, 1",
            f"  %again = icmp ult i64 %l1, {lanes}",
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


# Lanes without a vehicle get the last one's numbers.
_COPYING = "\n".join(
    [
        _copying("gather", str(LANES), ["%x = load i64, ptr %f, align 8", "store i64 %x, ptr %c, align 8"]),
        _copying("scatter", "%left", ["%x = load i64, ptr %c, align 8", "store i64 %x, ptr %f, align 8"]),
    ]
)


@functools.cache
def _machine() -> Any:
    """LLVM's idea of this processor."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    target = llvm.Target.from_default_triple()
    features = llvm.get_host_cpu_features().flatten()
    return target.create_target_machine(cpu=llvm.get_host_cpu_name(), features=features, opt=2, jit=True)


@functools.cache
def _engine() -> Any:
    """What machine code lives in, as long as the process."""
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), _machine())


def _address(text: str) -> int:
    """The address of the kernel of a module's text, from the disk or compiled."""
    machine = _machine()
    made_by = llvmlite.__version__, llvm.llvm_version_info, machine.triple, llvm.get_host_cpu_name()
    identity = repr((*made_by, llvm.get_host_cpu_features().flatten(), text))
    name = f"kernel_{hashlib.sha256(identity.encode()).hexdigest()[:32]}"
    code = _kept(name)
    if code is None:
        code = _compiled(text.replace("@kernel(", f"@{name}("))
        _keep(name, code)
    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    return int(engine.get_function_address(name))


def _compiled(text: str) -> bytes:
    """The object file of a module's text."""
    machine = _machine()
    module = llvm.parse_assembly(text)
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    builder.getModulePassManager().run(module, builder)
    code: bytes = machine.emit_object(module)
    return code


def _kept(name: str) -> bytes | None:
    """The object file of that name on the disk; None if it is not there or not as it was written."""
    folder = cache_folder()
    if folder is None:
        return None
    try:
        content = (folder / f"{name}.o").read_bytes()
    except OSError:
        return None
    code, checksum = content[:-_CHECKSUM_SIZE], content[-_CHECKSUM_SIZE:]
    return code if hashlib.sha256(code).digest() == checksum else None


def _keep(name: str, code: bytes) -> None:
    """Writes an object file to the disk; where that is not possible the next process compiles again."""
    folder = cache_folder()
    if folder is None:
        return
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        content = code + hashlib.sha256(code).digest()
        write_whole(folder / f"{name}.o", lambda path: _write(path, content))


def _write(path: Path, content: bytes) -> None:
    path.write_bytes(content)


def cache_folder() -> Path | None:
    """Where machine code is kept: in the folder that DRAKE_QUAD_CACHE names, or among the user's caches.

    None, so that nothing is kept, if that variable is empty or the user has no home.
    """
    named = os.environ.get("DRAKE_QUAD_CACHE")
    if named is not None:
        return Path(named) if named else None
    try:
        home = Path.home()
    except RuntimeError:
        return None
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local") / "drake_quad" / "cache"
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / "drake_quad"
    return Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache") / "drake_quad"
