"""Conversion of a listing of operations to an LLVM function.

Each line of the listing becomes one instruction, which computes a vector of vehicles or a single vehicle:

    %v12 = load <8 x double>, ptr %v12_at, align 8
    %v13 = fmul <8 x double> %v12, %v7
    %v14 = fadd <8 x double> %v13, %v2

The instructions compute exactly the arithmetic of the formula: sums are not reordered, and products are rounded before
they are added. A vehicle therefore has the same results alone, in a fleet, and on any processor.
`drake_quad.framework.scheduling` determines the order of the instructions.

A `Branch` becomes a separate function, which is called if at least one vehicle of the vector needs it. The lines that
select its results or other rows are part of the conditional code, so that they take no time if no vehicle needs it:

    test_16:
    %v15_lanes = bitcast <8 x i1> %v15 to i8
    %v16_any = icmp ne i8 %v15_lanes, 0
    br i1 %v16_any, label %needed_16, label %beyond_16
    needed_16:
    ...
    %v16_0 = load <8 x double>, ptr %v16_result_0, align 8
    %v17_selected = select <8 x i1> %v15, <8 x double> %v16_0, <8 x double> %v3
    br label %beyond_16
    beyond_16:
    %v17 = phi <8 x double> [ %v17_selected, %needed_16 ], [ %v3, %test_16 ]

A layer of a network becomes a function with a loop over blocks of rows, which contains a loop over the columns.
"""

import functools
from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.framework.scheduling import schedule
from drake_quad.framework.symbols import LEAVES, Branch, Function, Listing, Symbol, SymbolKind, SymbolLayer

# LLVM instruction for each operation. {t} is the type of the first operand, {r} the type of the result, and {s} the
# suffix of intrinsic functions.
INSTRUCTIONS = {
    "add": "fadd {t} {0}, {1}",
    "subtract": "fsub {t} {0}, {1}",
    "multiply": "fmul {t} {0}, {1}",
    "divide": "fdiv {t} {0}, {1}",
    "negative": "fneg {t} {0}",
    "absolute": "call {t} @llvm.fabs.{s}({t} {0})",
    "square_root": "call {t} @llvm.sqrt.{s}({t} {0})",
    "nearest": "call {t} @llvm.rint.{s}({t} {0})",
    "multiply_add": "call {t} @llvm.fma.{s}({t} {0}, {t} {1}, {t} {2})",
    "copy_sign": "call {t} @llvm.copysign.{s}({t} {0}, {t} {1})",
    "less": "fcmp olt {t} {0}, {1}",
    "less_equal": "fcmp ole {t} {0}, {1}",
    "greater": "fcmp ogt {t} {0}, {1}",
    "greater_equal": "fcmp oge {t} {0}, {1}",
    "equal": "fcmp oeq {t} {0}, {1}",
    "not_equal": "fcmp une {t} {0}, {1}",
    "select": "select {t} {0}, {r} {1}, {r} {2}",
    "float_bits": "bitcast {t} {0} to {r}",
    "number_of": "bitcast {t} {0} to {r}",
    "sign_bit": "icmp slt {t} {0}, zeroinitializer",
    "word_of_truth": "zext {t} {0} to {r}",
    "truth_of_word": "trunc {t} {0} to {r}",
}
# LLVM instructions for those operations that differ between numbers and 64-bit words or booleans.
_INTEGER_INSTRUCTIONS = {
    "add": "add {t} {0}, {1}",
    "multiply": "mul {t} {0}, {1}",
    "bitwise_and": "and {t} {0}, {1}",
    "bitwise_or": "or {t} {0}, {1}",
    "bitwise_xor": "xor {t} {0}, {1}",
    "left_shift": "shl {t} {0}, {1}",
    "right_shift": "lshr {t} {0}, {1}",
}
_ELEMENT_TYPES = {SymbolKind.NUMBER: "double", SymbolKind.TRUTH: "i1", SymbolKind.WORD: "i64"}
# LLVM intrinsics that the instructions call, and the number of arguments of each.
_INTRINSICS = {"fabs": 1, "sqrt": 1, "rint": 1, "fma": 3, "copysign": 2}


class Rows(NamedTuple):
    """Memory of a group of rows, starting at the first vehicle of a vector.

    Attributes:
        pointer: LLVM name of the pointer to the first row.
        stride: distance between consecutive rows, in elements: an LLVM name, or a whole number.
    """

    pointer: str
    stride: str | int


class Store(NamedTuple):
    """Assignment of a symbol's value to a row in memory.

    Attributes:
        target: number of the group that contains the row.
        row: index of the row in the group.
        symbol: value to store.
    """

    target: Rows
    row: int
    symbol: Symbol


def declarations(lanes: int) -> str:
    """Return the declarations that begin an LLVM module. Its functions compute `lanes` vehicles at a time."""
    number = _type(SymbolKind.NUMBER, lanes)
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
    shared: str | Rows,
    lanes: int,
    overlapping: bool,
) -> str:
    """Return the LLVM code of a function that executes a listing for one vector of vehicles.

    Args:
        head: name of the function with its arguments and attributes.
        listing: operations of the function.
        stores: rows to write.
        sources: groups of rows to read, by their number in the listing.
        shared: name of the pointer to the shared values; or the rows of these values, if they differ between vehicles.
        lanes: number of vehicles in a vector.
        overlapping: True if the same memory may be read and written through different pointers. All rows are then read
            before the first row is written. Otherwise a row is written as soon as its new value is computed and its old
            value is no longer needed.
    """
    selections = _selections(listing)
    selected = {each.line for group in selections.values() for each in group}
    order = schedule(listing, _operands_of_branches(listing, selections))
    position = {line: k for k, line in enumerate(order)}
    # Position, in the schedule, of the last operation that reads each row.
    last_reads: dict[tuple[str, int], int] = {}
    for k, line in enumerate(order):
        operation = listing.operations[line]
        if operation.name == "row":
            group, row = operation.operands
            last_reads[sources[group].pointer, row] = k
    last = max(last_reads.values(), default=0)
    due: dict[int, list[tuple[int, Store]]] = defaultdict(list)
    for count, store in enumerate(stores):
        free = last if overlapping else last_reads.get((store.target.pointer, store.row), 0)
        due[max(position[store.symbol.line], free)].append((count, store))
    names: dict[int, str] = {}
    lines: list[str] = []
    calls = _Calls(head.split("(")[0], lanes, selections)
    for k, number in enumerate(order):
        if number in selected:
            names[number] = f"%v{number}"  # written together with its branch
        elif listing.operations[number].called_part is None:
            names[number] = _write_operation(lines, names, listing, number, sources, shared, lanes)
        else:
            names[number] = calls.append_call(lines, names, listing, number)
        for count, (target, row, symbol) in due.get(k, ()):
            pointer = f"%store_{count}"
            lines += _pointer(pointer, target, row)
            lines.append(f"store {_type(symbol.kind, lanes)} {names[symbol.line]}, ptr {pointer}, align 8")
    # Processors access vectors on the stack faster if their addresses are multiples of the register size.
    attributes = "" if lanes == 1 else f" alignstack({8 * lanes})"
    body = [*calls.memory(), *lines, "ret void"]
    return "\n".join(
        [*calls.functions, f"define internal void {head}{attributes} {{", *(f"  {line}" for line in body), "}"]
    )


# Number of rows of a layer that are summed in parallel, so that a processor need not wait for the previous addition.
_BLOCK_ROWS = 8


class _Selection(NamedTuple):
    """Line that selects the result of a branch for vehicles that need the branch, and another row for all others.

    Attributes:
        line: number of the line.
        row: index of the result of the branch.
        otherwise: number of the line with the other row.
    """

    line: int
    row: int
    otherwise: int


_Call = tuple[Branch | SymbolLayer | Function, tuple[int, ...]]
"""Called part and its operands."""


def _selections(listing: Listing) -> dict[_Call, list[_Selection]]:
    """Return, for each call of a branch, the lines that select its results with the mask of the branch.

    Lines whose other row follows the first line of the call are left out, since this row could depend on the results.
    """
    first: dict[_Call, int] = {}
    found: dict[_Call, list[_Selection]] = defaultdict(list)
    for line, operation in enumerate(listing.operations):
        if operation.called_part is not None and isinstance(operation.called_part[0], Branch):
            first.setdefault((operation.called_part[0], operation.operands), line)
        elif operation.name == "select":
            mask, chosen, otherwise = operation.operands
            source, other = listing.operations[chosen], listing.operations[otherwise]
            if source.called_part is None or not isinstance(source.called_part[0], Branch):
                continue
            part, row = source.called_part
            call = part, source.operands
            if source.operands[0] == mask and (otherwise < first[call] or other.name in LEAVES):
                found[call].append(_Selection(line, row, otherwise))
    return found


def _operands_of_branches(listing: Listing, selections: Mapping[_Call, list[_Selection]]) -> dict[int, tuple[int, ...]]:
    """Return the operands of each line of a branch, including the other rows of its selections."""
    others = {call: tuple([each.otherwise for each in group]) for call, group in selections.items()}
    return {
        line: (*operation.operands, *others.get((operation.called_part[0], operation.operands), ()))
        for line, operation in enumerate(listing.operations)
        if operation.called_part is not None
    }


class _Calls:
    """Generator of functions for the branches and layers of a listing, and of the calls of these functions.

    Args:
        name: name of the calling function.
        lanes: number of vehicles in a vector.
        selections: lines that select the results of branches, by call.

    Attributes:
        functions: LLVM code of the called functions.
    """

    def __init__(self, name: str, lanes: int, selections: Mapping[_Call, list[_Selection]]) -> None:
        self.functions: list[str] = []
        self._selections = selections
        self._name, self._lanes, self._rows = name, lanes, 0
        self._called: dict[Branch | SymbolLayer, str] = {}
        self._results: dict[_Call, int] = {}

    def memory(self) -> list[str]:
        """Return the LLVM lines that allocate memory for the arguments and results of calls."""
        if not self._called:
            return []
        allocation = f"alloca [{self._rows * self._lanes} x double], align {8 * self._lanes}"
        return [f"%call_arguments = {allocation}", f"%call_results = {allocation}"]

    def append_call(self, lines: list[str], names: Mapping[int, str], listing: Listing, number: int) -> str:
        """Append the call that computes a line, unless it was appended before; return the name of the result."""
        operation = listing.operations[number]
        assert operation.called_part is not None
        part, row = operation.called_part
        assert not isinstance(part, Function), "LLVM code contains the operations of elementary functions"
        first = self._results.setdefault((part, operation.operands), number)
        if first == number:
            if isinstance(part, Branch):
                self._write_branch(lines, names, listing, number)
            else:
                operand_names = [(names[line], listing.operations[line].kind) for line in operation.operands]
                self._write_layer(lines, number, operand_names, part)
        return f"%v{first}_{row}"

    def _write_branch(self, lines: list[str], names: Mapping[int, str], listing: Listing, number: int) -> None:
        """Append the call of the branch on a line, and the lines that select its results."""
        operation, lanes = listing.operations[number], self._lanes
        branch, _ = operation.called_part or (None, 0)
        assert isinstance(branch, Branch)
        selections = self._selections.get((branch, operation.operands), ())
        mask, *arguments = operation.operands
        mask_type = _type(SymbolKind.TRUTH, lanes)
        types = [_type(branch.operations[line].kind, lanes) for line in branch.results]
        lines += [
            f"br label %test_{number}",
            f"test_{number}:",
            f"%v{number}_lanes = bitcast {mask_type} {names[mask]} to i{lanes}",
            f"%v{number}_any = icmp ne i{lanes} %v{number}_lanes, 0",
            f"br i1 %v{number}_any, label %needed_{number}, label %beyond_{number}",
            f"needed_{number}:",
        ]
        self._store_arguments(lines, number, [(names[line], listing.operations[line].kind) for line in arguments])
        # The function is marked as cold, so that LLVM keeps other values in registers on the path without the call.
        lines.append(f"call void {self._function_of(branch, 'noinline cold')}(ptr %call_arguments, ptr %call_results)")
        for line, row, otherwise in selections:
            lines += _load_row(f"%v{line}_computed", Rows("%call_results", lanes), row, types[row])
            operands = f"{mask_type} {names[mask]}, {types[row]} %v{line}_computed, {types[row]} {names[otherwise]}"
            lines.append(f"%v{line}_selected = select {operands}")
        lines += [f"br label %beyond_{number}", f"beyond_{number}:"]
        lines += [
            f"%v{line} = phi {types[row]} [ %v{line}_selected, %needed_{number} ],"
            f" [ {names[otherwise]}, %test_{number} ]"
            for line, row, otherwise in selections
        ]
        # LLVM removes the loads of results that are only selected.
        self._load_results(lines, number, types)

    def _write_layer(
        self, lines: list[str], number: int, operand_names: Sequence[tuple[str, SymbolKind]], layer: SymbolLayer
    ) -> None:
        rows, _ = layer.matrix.shape
        self._store_arguments(lines, number, operand_names)
        lines.append(f"call void {self._function_of_layer(layer)}(ptr %call_arguments, ptr %call_results)")
        self._load_results(lines, number, [_type(SymbolKind.NUMBER, self._lanes)] * rows)
        # The function writes all rows of the last block, even if the layer has fewer rows.
        self._rows = max(self._rows, rows + -rows % _BLOCK_ROWS)

    def _store_arguments(self, lines: list[str], number: int, arguments: Sequence[tuple[str, SymbolKind]]) -> None:
        for row, (name, kind) in enumerate(arguments):
            pointer = f"%v{number}_argument_{row}"
            lines += _pointer(pointer, Rows("%call_arguments", self._lanes), row)
            lines.append(f"store {_type(kind, self._lanes)} {name}, ptr {pointer}, align 8")
        self._rows = max(self._rows, len(arguments))

    def _load_results(self, lines: list[str], number: int, types: Sequence[str]) -> None:
        """Append the lines that load all results of a call, given their LLVM types."""
        for row, type_ in enumerate(types):
            lines += _load_row(f"%v{number}_{row}", Rows("%call_results", self._lanes), row, type_)
        self._rows = max(self._rows, len(types))

    def _function_of(self, branch: Branch, attributes: str) -> str:
        """Return the name of the function for a branch. The first request generates the function."""
        if branch not in self._called:
            name = self._called[branch] = f"{self._name}_{len(self._called)}"
            rows, results, listing = Rows("%rows", self._lanes), Rows("%results", self._lanes), branch.listing
            stores = [
                Store(results, row, Symbol(listing, line, branch.operations[line].kind))
                for row, line in enumerate(branch.results)
            ]
            head = f"{name}(ptr %rows, ptr %results) {attributes}"
            self.functions.append(
                function(head, listing, stores, {0: rows}, shared="", lanes=self._lanes, overlapping=False)
            )
        return self._called[branch]

    def _function_of_layer(self, layer: SymbolLayer) -> str:
        """Return the name of the function for a layer. The first request generates the function."""
        if layer not in self._called:
            activation = self._function_of(layer.activation, "alwaysinline")
            name = self._called[layer] = f"{self._name}_{len(self._called)}"
            self.functions.append(_layer_function(name, layer, activation, self._lanes))
        return self._called[layer]


def _layer_function(name: str, layer: SymbolLayer, activation: str, lanes: int) -> str:
    """Return the LLVM code of a layer.

    The rows of the layer are divided into blocks. The constants of a block are adjacent: first the biases of its rows,
    then the weights of its rows, column by column.
    """
    rows, columns = layer.matrix.shape
    type_, block = _type(SymbolKind.NUMBER, lanes), range(_BLOCK_ROWS)
    blocks = -(-rows // _BLOCK_ROWS)
    numbers = [[bias, *weights] for bias, weights in layer.matrix.biases_and_weights()]
    numbers += [[0.0] * (columns + 1)] * (blocks * _BLOCK_ROWS - rows)
    numbers_in_order = [
        numbers[_BLOCK_ROWS * b + j][i] for b in range(blocks) for i in range(columns + 1) for j in block
    ]
    bits = np.array(numbers_in_order).view(np.uint64).tolist()
    constants = ", ".join(f"double 0x{each:016X}" for each in bits)

    def spread(result: str, column: str, j: int) -> list[str]:
        return [f"  {line}" for line in _load_to_all_lanes(result, column, j, lanes)]

    return "\n".join(
        [
            f"{name}_numbers = private constant [{len(bits)} x double] [{constants}]",
            f"define internal void {name}(ptr %rows, ptr %results) noinline {{",
            "entry:",
            "  br label %block",
            "block:",
            "  %b = phi i64 [0, %entry], [%b1, %end]",
            f"  %block_first = mul i64 %b, {(columns + 1) * _BLOCK_ROWS}",
            f"  %biases = getelementptr double, ptr {name}_numbers, i64 %block_first",
            *(line for j in block for line in spread(f"%bias{j}", "%biases", j)),
            "  br label %column",
            "column:",
            "  %i = phi i64 [0, %block], [%i1, %column]",
            *(f"  %sum{j} = phi {type_} [%bias{j}, %block], [%next{j}, %column]" for j in block),
            f"  %row_first = mul i64 %i, {lanes}",
            "  %row_at = getelementptr double, ptr %rows, i64 %row_first",
            f"  %row = load {type_}, ptr %row_at, align 8",
            "  %i1 = add i64 %i, 1",
            f"  %column_first = mul i64 %i1, {_BLOCK_ROWS}",
            "  %weights = getelementptr double, ptr %biases, i64 %column_first",
            *(
                line
                for j in block
                for line in (
                    *spread(f"%weight{j}", "%weights", j),
                    f"  %product{j} = fmul {type_} %weight{j}, %row",
                    f"  %next{j} = fadd {type_} %sum{j}, %product{j}",
                )
            ),
            f"  %more = icmp ult i64 %i1, {columns}",
            "  br i1 %more, label %column, label %end",
            "end:",
            f"  %result_first = mul i64 %b, {_BLOCK_ROWS * lanes}",
            "  %results_here = getelementptr double, ptr %results, i64 %result_first",
            *(
                line
                for j in block
                for line in (
                    f"  %result{j} = getelementptr double, ptr %results_here, i64 {j * lanes}",
                    f"  store {type_} %next{j}, ptr %result{j}, align 8",
                    f"  call void {activation}(ptr %result{j}, ptr %result{j})",
                )
            ),
            "  %b1 = add i64 %b, 1",
            f"  %again = icmp ult i64 %b1, {blocks}",
            "  br i1 %again, label %block, label %done",
            "done:",
            "  ret void",
            "}",
        ]
    )


def _load_row(name: str, rows: Rows, row: int, type_: str) -> list[str]:
    """Return the LLVM lines that load a row."""
    return [*_pointer(f"{name}_at", rows, row), f"{name} = load {type_}, ptr {name}_at, align 8"]


@functools.cache
def _type(kind: SymbolKind, lanes: int) -> str:
    return f"<{lanes} x {_ELEMENT_TYPES[kind]}>"


def _write_operation(
    lines: list[str],
    names: Mapping[int, str],
    listing: Listing,
    number: int,
    sources: Mapping[int, Rows],
    shared: str | Rows,
    lanes: int,
) -> str:
    """Append the instructions for one operation of a listing, and return the name of its result, or a constant."""
    operation = listing.operations[number]
    kind, name = operation.kind, f"%v{number}"
    type_ = _type(kind, lanes)
    if operation.name == "constant":
        (bits,) = operation.operands
        text = f"0x{bits:016X}" if kind is SymbolKind.NUMBER else str(bits)
        return f"<{', '.join([f'{_ELEMENT_TYPES[kind]} {text}'] * lanes)}>"
    if operation.name == "shared" and isinstance(shared, str):
        (row,) = operation.operands
        lines += _load_to_all_lanes(name, shared, row, lanes)
        return name
    if operation.name in LEAVES:
        *group, row = operation.operands
        rows = sources[group[0]] if group else shared
        assert isinstance(rows, Rows)
        lines += _load_row(name, rows, row, type_)
        return name
    template = _template(operation.name, listing.operations[operation.operands[0]].kind, kind, lanes)
    lines.append(f"{name} = {template.format(*[names[operand] for operand in operation.operands])}")
    return name


@functools.cache
def _template(name: str, first: SymbolKind, kind: SymbolKind, lanes: int) -> str:
    """Return an instruction's template, given the types of its first operand and its result."""
    templates = (
        INSTRUCTIONS if first is SymbolKind.NUMBER or name not in _INTEGER_INSTRUCTIONS else _INTEGER_INSTRUCTIONS
    )
    return templates[name].format("{0}", "{1}", "{2}", t=_type(first, lanes), r=_type(kind, lanes), s=f"v{lanes}f64")


def _load_to_all_lanes(result: str, pointer: str, row: int, lanes: int) -> list[str]:
    """Return the LLVM lines that load an array element and copy it to all lanes."""
    type_ = _type(SymbolKind.NUMBER, lanes)
    return [
        f"{result}_at = getelementptr double, ptr {pointer}, i64 {row}",
        f"{result}_number = load double, ptr {result}_at, align 8",
        f"{result}_one = insertelement {type_} poison, double {result}_number, i32 0",
        f"{result} = shufflevector {type_} {result}_one, {type_} poison, <{lanes} x i32> zeroinitializer",
    ]


def _pointer(name: str, rows: Rows, row: int) -> list[str]:
    """Return the LLVM lines that compute the pointer to a row of a group."""
    if isinstance(rows.stride, int):
        return [f"{name} = getelementptr double, ptr {rows.pointer}, i64 {row * rows.stride}"]
    return [
        f"{name}_row = mul i64 {rows.stride}, {row}",
        f"{name} = getelementptr double, ptr {rows.pointer}, i64 {name}_row",
    ]
