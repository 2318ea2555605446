"""A listing, written as a function in LLVM's language.

Each line of the listing becomes one instruction on a vector of vehicles, or on one for a lone vehicle:

    %v12 = load <8 x double>, ptr %v12_at, align 8
    %v13 = fmul <8 x double> %v12, %v7
    %v14 = fadd <8 x double> %v13, %v2

Arithmetic is as the formula has it: no sum is taken in another order, and a product is rounded before it is added. So a
vehicle flies the same alone and in a fleet, on any processor. The lines themselves are written in the order in which a
processor does them soonest (`drake_quad.framework.scheduling`).

What is done only where it is needed is a function of its own, which is called if a vehicle of the vector needs it:

    %v15_lanes = bitcast <8 x i1> %v15 to i8
    %v16_any = icmp ne i8 %v15_lanes, 0
    br i1 %v16_any, label %needed_16, label %beyond_16
"""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from drake_quad.framework.scheduling import scheduled
from drake_quad.framework.symbols import Branch, Kind, Listing, Symbol

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
    "negative": "icmp slt {t} {0}, zeroinitializer",
    "word_of_truth": "zext {t} {0} to {r}",
    "truth_of_word": "trunc {t} {0} to {r}",
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


class Rows(NamedTuple):
    """A group of rows in memory, as seen from the first vehicle of a vector.

    Attributes:
        pointer: to its first row, a name in LLVM's language.
        stride: from a row to the next, in numbers: a name, or a whole number.
    """

    pointer: str
    stride: str | int


class Store(NamedTuple):
    """A row that is written.

    Attributes:
        target: where.
        place: in its group.
        symbol: what.
    """

    target: Rows
    place: int
    symbol: Symbol


def declarations(lanes: int) -> str:
    """What a module with functions for so many lanes must begin with."""
    number = _type(Kind.NUMBER, lanes)
    return "\n".join(
        f"declare {number} @llvm.{name}.v{lanes}f64({', '.join([number] * count)})"
        for name, count in _INTRINSICS.items()
    )


def function(
    head: str,
    listing: Listing,
    stores: Sequence[Store],
    sources: Mapping[int, Rows],
    *,
    shared: str,
    lanes: int,
    overlapping: bool,
) -> str:
    """The function that does what is listed for the vehicles of one vector.

    Args:
        head: the function's name with its arguments, and its attributes.
        listing: what is computed.
        stores: what is written.
        sources: the groups of the listing.
        shared: a pointer to the numbers that are the same for all vehicles.
        lanes: vehicles of a vector.
        overlapping: whether a row may be written that is read by another name. Then all rows are read before the first
            is written; else a row is written as soon as it has been read and computed.
    """
    order = scheduled(listing)
    position = {line: k for k, line in enumerate(order)}
    # Where each row is read last.
    read: dict[tuple[str, int], int] = {}
    for k, line in enumerate(order):
        operation = listing.operations[line]
        if operation.name == "row":
            group, place = operation.operands
            read[sources[group].pointer, place] = k
    last = max(read.values(), default=0)
    due: dict[int, list[tuple[int, Store]]] = defaultdict(list)
    for count, store in enumerate(stores):
        free = last if overlapping else read.get((store.target.pointer, store.place), 0)
        due[max(position[store.symbol.line], free)].append((count, store))
    names: dict[int, str] = {}
    lines: list[str] = []
    branches = _Branches(head.split("(")[0], lanes)
    for k, number in enumerate(order):
        if listing.operations[number].branch is None:
            names[number] = _written(lines, names, listing, number, sources, shared, lanes)
        else:
            names[number] = branches.written(lines, names, listing, number)
        for count, (target, place, symbol) in due[k]:
            pointer = f"%store_{count}"
            lines += _pointer(pointer, target, place)
            lines.append(f"store {_type(symbol.kind, lanes)} {names[symbol.line]}, ptr {pointer}, align 8")
    # A processor is slow with vectors on the stack that do not begin where its registers would.
    attributes = "" if lanes == 1 else f" alignstack({8 * lanes})"
    body = [*branches.memory(), *lines, "ret void"]
    return "\n".join(
        [*branches.functions, f"define internal void {head}{attributes} {{", *(f"  {line}" for line in body), "}"]
    )


class _Branches:
    """The branches of a function.

    Args:
        name: of the function.
        lanes: vehicles of a vector.

    Attributes:
        functions: the text of what is called.
    """

    def __init__(self, name: str, lanes: int) -> None:
        self.functions: list[str] = []
        self._name, self._lanes, self._rows = name, lanes, 0
        self._called: dict[Branch, str] = {}
        self._results: dict[tuple[Branch, tuple[int, ...]], int] = {}

    def memory(self) -> list[str]:
        """The lines that make room for what is given to functions and for their results."""
        if not self._called:
            return []
        room = f"alloca [{self._rows * self._lanes} x double], align {8 * self._lanes}"
        return [f"%given = {room}", f"%found = {room}"]

    def written(self, lines: list[str], names: Mapping[int, str], listing: Listing, number: int) -> str:
        """Writes the branch that a line is a result of, unless it stands above; returns the name of the result."""
        operation = listing.operations[number]
        assert operation.branch is not None
        branch, place = operation.branch
        first = self._results.setdefault((branch, operation.operands), number)
        if first == number:
            self._write(lines, names, listing, number, branch)
        return f"%v{first}_{place}"

    def _write(self, lines: list[str], names: Mapping[int, str], listing: Listing, number: int, branch: Branch) -> None:
        mask, *arguments = listing.operations[number].operands
        lanes = self._lanes
        lines += [
            f"%v{number}_lanes = bitcast <{lanes} x i1> {names[mask]} to i{lanes}",
            f"%v{number}_any = icmp ne i{lanes} %v{number}_lanes, 0",
            f"br i1 %v{number}_any, label %needed_{number}, label %beyond_{number}",
            f"needed_{number}:",
        ]
        for place, argument in enumerate(arguments):
            pointer = f"%v{number}_given_{place}"
            lines += _pointer(pointer, Rows("%given", lanes), place)
            lines.append(
                f"store {_type(listing.operations[argument].kind, lanes)} {names[argument]}, ptr {pointer}, align 8"
            )
        lines += [
            f"call void {self._function(branch)}(ptr %given, ptr %found)",
            f"br label %beyond_{number}",
            f"beyond_{number}:",
        ]
        for place, line in enumerate(branch.results):
            pointer = f"%v{number}_found_{place}"
            lines += _pointer(pointer, Rows("%found", lanes), place)
            kind = branch.operations[line].kind
            lines.append(f"%v{number}_{place} = load {_type(kind, lanes)}, ptr {pointer}, align 8")
        self._rows = max(self._rows, len(arguments), len(branch.results))

    def _function(self, branch: Branch) -> str:
        """The name of the function that does what is in a branch."""
        if branch not in self._called:
            name = self._called[branch] = f"{self._name}_{len(self._called)}"
            given, found, listing = Rows("%rows", self._lanes), Rows("%results", self._lanes), branch.listing
            stores = [
                Store(found, place, Symbol(listing, line, branch.operations[line].kind))
                for place, line in enumerate(branch.results)
            ]
            # Cold, so that what is computed around the call stays in registers where it is not called.
            head = f"{name}(ptr %rows, ptr %results) noinline cold"
            self.functions.append(
                function(head, listing, stores, {0: given}, shared="", lanes=self._lanes, overlapping=False)
            )
        return self._called[branch]


def _type(kind: Kind, lanes: int) -> str:
    return f"<{lanes} x {_ELEMENTS[kind]}>"


def _written(
    lines: list[str],
    names: Mapping[int, str],
    listing: Listing,
    number: int,
    sources: Mapping[int, Rows],
    shared: str,
    lanes: int,
) -> str:
    """Writes a line of a listing, and returns the name of its result or, of a constant, its text."""
    operation = listing.operations[number]
    kind, name = operation.kind, f"%v{number}"
    type_ = _type(kind, lanes)
    if operation.name == "constant":
        (bits,) = operation.operands
        text = f"0x{bits:016X}" if kind is Kind.NUMBER else str(bits)
        return f"<{', '.join([f'{_ELEMENTS[kind]} {text}'] * lanes)}>"
    if operation.name == "shared":
        (place,) = operation.operands
        lines += [
            f"{name}_at = getelementptr double, ptr {shared}, i64 {place}",
            f"{name}_number = load double, ptr {name}_at, align 8",
            f"{name}_one = insertelement {type_} poison, double {name}_number, i32 0",
            f"{name} = shufflevector {type_} {name}_one, {type_} poison, <{lanes} x i32> zeroinitializer",
        ]
        return name
    if operation.name == "row":
        group, place = operation.operands
        lines += _pointer(f"{name}_at", sources[group], place)
        lines.append(f"{name} = load {type_}, ptr {name}_at, align 8")
        return name
    first = listing.operations[operation.operands[0]].kind
    templates = INSTRUCTIONS if first is Kind.NUMBER or operation.name not in _BITWISE else _BITWISE
    operands = [names[operand] for operand in operation.operands]
    text = templates[operation.name].format(*operands, t=_type(first, lanes), r=type_, s=f"v{lanes}f64")
    lines.append(f"{name} = {text}")
    return name


def _pointer(name: str, rows: Rows, place: int) -> list[str]:
    """The lines that find a row of a group."""
    if isinstance(rows.stride, int):
        return [f"{name} = getelementptr double, ptr {rows.pointer}, i64 {place * rows.stride}"]
    return [
        f"{name}_row = mul i64 {rows.stride}, {place}",
        f"{name} = getelementptr double, ptr {rows.pointer}, i64 {name}_row",
    ]
