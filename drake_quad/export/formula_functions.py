"""C functions for the computations of systems: one function for each formula, with pointers to structs as arguments."""

import functools
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

from drake_quad.errors import InputError
from drake_quad.export.structs import Structs, accessors, summary
from drake_quad.framework.c_code import Body, Functions, function_text, identifier, wrapped
from drake_quad.framework.fleet_system import REQUIRED, Computation, Input, Parameter, StateGroup
from drake_quad.framework.formulas import TIME, CurrentTick, hashable_key, trace_formula
from drake_quad.framework.records import ABSENT, ROW, Layout
from drake_quad.framework.symbols import LEAVES, Listing, Symbol
from drake_quad.framework.variable_names import collect_names

_TIME_GROUP = -1  # index of the time among the inputs of a formula; ports, parameters and states are counted from 0


class Argument(NamedTuple):
    """Argument of a C function.

    Attributes:
        read: port, parameter or state group that is read; None for the time.
        name: name of the argument.
        layout: layout of the argument.
    """

    read: Any
    name: str
    layout: Layout


class FormulaFunction(NamedTuple):
    """C function that computes an output or an update of a system.

    Attributes:
        name: name of the function.
        arguments: arguments that the function uses.
        num_operations: number of operations of a call.
    """

    name: str
    arguments: tuple[Argument, ...]
    num_operations: int


class FormulaFunctions:
    """C functions of all computations of a diagram.

    Args:
        structs: structs of the header, to which the types of arguments and results are added.
        functions: static functions of the C file. Functions that a formula calls, such as network layers, are added.
        reserved: names that no function may have, because variables of the calling function have these names.

    Attributes:
        texts: C code of each function.
    """

    def __init__(self, structs: Structs, functions: Functions, reserved: Collection[str]) -> None:
        self.texts: list[str] = []
        self._structs, self._functions, self._reserved = structs, functions, {"lambda", "identity", *reserved}
        self._by_signature: dict[Any, FormulaFunction] = {}

    def function(self, path: str, label: str, computation: Computation, absent: set[int]) -> FormulaFunction:
        """Return the C function of a computation. Equal computations of several systems share a function.

        Args:
            path: path of the system, for messages.
            label: name of the function if the formula has no name of its own.
            computation: computation of an output or update.
            absent: indices of the input ports that are not connected.

        Raises:
            InputError: if the computation reads random numbers or an input port that is not connected.
        """
        keys: list[tuple[Any, ...]] = []
        for read in computation.reads:
            if isinstance(read, Input | Parameter | StateGroup):
                if isinstance(read, Input) and int(read.index) in absent:
                    keys.append((Input, read.name, *hashable_key(read.absent)))
                else:
                    keys.append((type(read), read.name, read.layout))
            else:
                keys.append((None, *hashable_key(read)))
        signature = computation.formula, *keys, *computation.results
        if signature not in self._by_signature:
            self._by_signature[signature] = self._trace(path, label, computation, absent)
        shared = self._by_signature[signature]
        # Systems can share a C function, but each system reads its own ports, parameters and states.
        reads = [read for read in computation.reads if isinstance(read, Input | Parameter | StateGroup)]
        own = {(type(read), read.name): read for read in reads}
        arguments = [
            argument if argument.read is None else argument._replace(read=own[type(argument.read), argument.read.name])
            for argument in shared.arguments
        ]
        return shared._replace(arguments=tuple(arguments))

    def _trace(self, path: str, label: str, computation: Computation, absent: set[int]) -> FormulaFunction:
        """Trace the formula of a computation, append the text of its C function to `texts`, and return the function."""
        listing = Listing(calls_functions=True)
        arguments: list[Argument] = []
        values: list[Any] = []
        for read in computation.reads:
            if isinstance(read, Input) and int(read.index) in absent:
                if read.absent is REQUIRED:
                    raise InputError(f"{path} cannot be exported: its input port {read.name} is not connected")
                values.append(read.absent)
            elif isinstance(read, Input | Parameter | StateGroup):
                rows = [listing.row(len(arguments), index) for index in range(read.layout.num_rows)]
                arguments.append(Argument(read, read.name, read.layout))
                values.append(read.layout.build(rows))
            elif isinstance(read, CurrentTick):
                raise InputError(f"{path} cannot be exported: it reads random numbers")
            else:
                values.append(listing.shared(0) if read is TIME else read)
        with collect_names(listing) as names:
            returned = trace_formula(computation.formula, values, computation.results)
        used = _used_groups(listing, returned)
        texts = [
            [
                f"{argument.name}->{accessor[1:]}" if accessor else argument.name
                for accessor in accessors(argument.layout)
            ]
            for argument in arguments
        ]
        kept = [argument for group, argument in enumerate(arguments) if group in used]
        if _TIME_GROUP in used:
            kept.append(Argument(None, "time", ROW))
        targets = [f"next_{group.name}" for group in computation.writes] or ["result"]
        body = Body(
            listing,
            returned,
            row=lambda group, row: texts[group][row],
            functions=self._functions,
            names=names,
            reserved=[*(argument.name for argument in arguments), *targets],
        )
        name = self._name(computation.formula, label)
        self.texts.append(self._text(name, computation, kept, targets, body))
        return FormulaFunction(name, tuple(kept), body.num_operations)

    def _name(self, formula: Any, label: str) -> str:
        """Return the name of the C function of a formula.

        It is the name of the Python function, or `compute_` and the label if this name is already taken.
        """
        name = identifier(getattr(_unwrapped(formula), "__name__", "lambda").strip("_<>"))
        taken = {function.name for function in self._by_signature.values()}
        return f"compute_{label}" if name in self._reserved | taken else name

    def _text(
        self, name: str, computation: Computation, arguments: Sequence[Argument], targets: Sequence[str], body: Body
    ) -> str:
        """Return the C code of a function.

        Args:
            name: name of the function.
            computation: computation that the function implements.
            arguments: arguments that the function reads.
            targets: names of the pointer arguments for its results.
            body: statements and result expressions of the function.
        """
        real = self._functions.precision.real
        heads = [
            f"{real} {argument.name}"
            if argument.layout is ROW
            else f"const {self._structs.c_type(argument.layout)} *{argument.name}"
            for argument in arguments
        ]
        results = [result.text for result in body.results]
        present = [layout for layout in computation.results if layout is not ABSENT]
        lines = [*body.lines]
        if present == [ROW] and not computation.writes:
            head = f"static {real} {name}({', '.join(heads) or 'void'})"
            lines.append(f"return {results[0]};")
        else:
            pointers = [f"{self._structs.c_type(layout)} *{target}" for target, layout in zip(targets, present)]
            head = f"static void {name}({', '.join([*heads, *pointers])})"
            places = [
                f"{target}->{accessor[1:]}" if accessor else f"*{target}"
                for target, layout in zip(targets, present, strict=True)
                for accessor in accessors(layout)
            ]
            lines += [f"{place} = {result};" for place, result in zip(places, results, strict=True)]
        comment = summary(_unwrapped(computation.formula))
        return "\n".join([*(wrapped(f"/* {comment} */") if comment else []), function_text(head, lines)])


def _unwrapped(formula: Any) -> Any:
    """Return the function that a `functools.partial` wraps; other functions are returned unchanged."""
    return _unwrapped(formula.func) if isinstance(formula, functools.partial) else formula


def _used_groups(listing: Listing, results: Sequence[Any]) -> set[int]:
    """Return the indices of the formula inputs on which traced results depend, with `_TIME_GROUP` for the time.

    Args:
        listing: recorded operations of the formula.
        results: symbols or constants that the formula returns.
    """
    required, used = set[int](), set[int]()
    stack = [result.line for result in results if isinstance(result, Symbol)]
    while stack:
        line = stack.pop()
        if line in required:
            continue
        required.add(line)
        name, operands, *_ = listing.operations[line]
        if name == "row":
            used.add(operands[0])
        elif name == "shared":
            used.add(_TIME_GROUP)
        elif name not in LEAVES:
            stack += operands
    return used
