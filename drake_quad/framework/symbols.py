"""Symbols for tracing formulas. A formula that is executed on symbols records a listing of its operations.

A formula is plain Python. If it is executed on symbols instead of numbers, all its operations are recorded in a
`Listing`, from which machine code is generated. Python's control flow, such as a loop over rules or an `if` on a
constant, is executed during tracing. A row is a quantity that has one value for each vehicle of a fleet. A formula
cannot branch on a row. `drake_quad.framework.elementary` contains two functions that select instead:

- `where` selects one of two rows.
- `lazy_where` evaluates an expensive formula only where it is needed. It records the formula in a separate listing, a
  `Branch`.

A Python loop over the weights of a network would record thousands of similar lines. The function `dense` evaluates a
layer of a network and records a `SymbolLayer` instead, which becomes a loop.

A call of an elementary function, such as the sine, is recorded as the operations of its approximation. If the generated
code can call elementary functions, as in C, the listing records a `Function` instead.
"""

import hashlib
import marshal
import struct
from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.framework.replacements import (
    ROW_OPERATIONS_HINT,
    calling_numpy_function,
    numpy_function_error,
    power_error,
    replacement,
    unsupported_operation,
)


class SymbolKind(IntEnum):
    """Type of a symbol: double, boolean ("truth value"), or 64-bit word."""

    NUMBER = 1
    TRUTH = 2
    WORD = 3


# Operations whose operands are not the results of other operations.
LEAVES = ("constant", "row", "shared")


class Operation(NamedTuple):
    """Line of a listing: one operation on the results of earlier lines.

    Attributes:
        name: name of the operation: a key of `INSTRUCTIONS` in `drake_quad.framework.instructions`, or "constant",
            "row", "shared", "branch", "layer" or "function".
        operands: numbers of the lines that are the operands. Operations in `LEAVES` have other operands: the bits of a
            constant, the group of a row and its index in the group, or the index of a shared value.
        kind: type of the result.
        called_part: for the operations "branch", "layer" and "function", the called part and the index of the line
            among its results; None for other operations. The first operand of a branch is the mask of the vehicles that
            need it.
    """

    name: str
    operands: tuple[int, ...]
    kind: SymbolKind
    called_part: "tuple[Branch | SymbolLayer | Function, int] | None" = None


class Branch(NamedTuple):
    """Part of a formula that is executed only if at least one vehicle of a vector needs it.

    Attributes:
        operations: lines of the branch. A "row" operation of group 0 reads an argument of the branch.
        results: numbers of the lines that are the results.
    """

    operations: tuple[Operation, ...]
    results: tuple[int, ...]

    @property
    def listing(self) -> "Listing":
        """Listing that contains the operations of the branch."""
        listing = Listing()
        for operation in self.operations:
            listing.add(*operation)
        return listing


class Matrix:
    """Constant weights and biases of a network layer.

    Args:
        weights: (rows, columns) weights.
        biases: (rows,) biases.

    Attributes:
        shape: numbers of rows and columns of the weights.
    """

    __slots__ = ("_digest", "_numbers", "shape")

    def __init__(self, weights: np.ndarray, biases: np.ndarray) -> None:
        self._numbers = np.column_stack([biases, weights]).astype(float)
        self._numbers.setflags(write=False)
        self.shape = self._numbers.shape[0], self._numbers.shape[1] - 1
        self._digest = hashlib.sha256(self._numbers.tobytes()).hexdigest()

    @property
    def num_rows(self) -> int:
        """Number of outputs of the network layer."""
        rows, _ = self.shape
        return rows

    def biases_and_weights(self) -> Iterator[tuple[float, list[float]]]:
        """Yield the bias and the weights of each output of the network layer."""
        for bias, *weights in self._numbers.tolist():
            yield bias, weights

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Matrix) and (self.shape, self._digest) == (other.shape, other._digest)

    def __hash__(self) -> int:
        return hash((self.shape, self._digest))

    def __repr__(self) -> str:
        return f"Matrix({self.shape}, {self._digest})"


class SymbolLayer(NamedTuple):
    """Network layer: a matrix product plus biases, followed by an activation function.

    Attributes:
        matrix: weights and biases of the layer.
        activation: activation function, as a branch whose argument and result are a single row.
    """

    matrix: Matrix
    activation: Branch


class Function(NamedTuple):
    """Elementary function that generated code calls by name, with its approximation in double precision.

    Attributes:
        name: name of the function.
        approximation: operations that compute the function. A "row" operation of group 0 reads an argument of the
            function.
    """

    name: str
    approximation: Branch


class Listing:
    """Operations of a traced formula, in order and without duplicates.

    Args:
        calls_functions: True to record an elementary function as a `Function` instead of the operations of its
            approximation.

    Attributes:
        operations: lines of the listing.
        calls_functions: True if elementary functions are recorded as calls of a `Function`.
    """

    def __init__(self, *, calls_functions: bool = False) -> None:
        self.operations: list[Operation] = []
        self.calls_functions = calls_functions
        # The values are line numbers. Symbols would refer to the listing, and this reference cycle would delay the
        # deletion of the listing.
        self._lines: dict[tuple[Any, ...], int] = {}

    def line(
        self,
        name: str,
        operands: tuple[int, ...],
        kind: SymbolKind,
        called_part: tuple[Branch | SymbolLayer | Function, int] | None = None,
    ) -> int:
        """Return the line number of an operation, which is appended if it is new; arguments as in `Operation`."""
        key = name, operands, kind, called_part
        line = self._lines.get(key)
        if line is None:
            line = self._lines[key] = len(self.operations)
            # `tuple.__new__` avoids the constructor, which is written in Python and would take half of the time of this
            # function.
            self.operations.append(tuple.__new__(Operation, key))
        return line

    def add(
        self,
        name: str,
        operands: tuple[int, ...],
        kind: SymbolKind,
        called_part: tuple[Branch | SymbolLayer | Function, int] | None = None,
    ) -> "Symbol":
        """Return the symbol of an operation, which is appended if it is new; arguments as in `Operation`."""
        return Symbol(self, self.line(name, operands, kind, called_part), kind)

    def digest(self) -> str:
        """Return a digest of all operations in the listing."""
        return _digest(self.operations, {})

    def row(self, group: int, index: int, kind: SymbolKind = SymbolKind.NUMBER) -> "Symbol":
        """Return the symbol of a row, given the number of its group and its index in the group."""
        return self.add("row", (group, index), kind)

    def shared(self, index: int) -> "Symbol":
        """Return the symbol of a value that all vehicles share, given its index among these values."""
        return self.add("shared", (index,), SymbolKind.NUMBER)

    def constant(self, value: Any) -> "Symbol":
        """Return the symbol of a constant: a number, a NumPy uint64 or a boolean."""
        if value.__class__ is float:  # the most frequent type
            return self.add("constant", _WORD_FORMAT.unpack(_FLOAT_FORMAT.pack(value)), SymbolKind.NUMBER)
        if isinstance(value, np.ndarray):
            value = scalar_element(value)
        if isinstance(value, bool | np.bool):
            return self.add("constant", (int(value),), SymbolKind.TRUTH)
        if isinstance(value, np.uint64):
            return self.add("constant", (int(value),), SymbolKind.WORD)
        if not isinstance(value, int | float | np.number):
            raise TypeError(f"expected a number or a row, not {type(value).__name__}; {ROW_OPERATIONS_HINT}")
        try:
            number = np.float64(value)
        except OverflowError:
            raise InputError("a formula contains an integer that is too large for a floating-point number") from None
        return self.add("constant", (int(number.view(np.uint64)),), SymbolKind.NUMBER)


def scalar_element(array: np.ndarray) -> Any:
    """Return the element of a zero-dimensional array.

    Raises:
        TypeError: if the array has dimensions.
    """
    if array.ndim:
        raise TypeError(
            f"expected a number or a row, not an array of shape {array.shape}; compute with its elements, as in [k * x"
            " for k in array]"
        )
    return array[()]


def _digest(operations: Sequence[Operation], known: dict[int, bytes]) -> str:
    """Return a digest of operations.

    Args:
        operations: operations of a listing or branch.
        known: digests of branches and layers by `id`, to which new digests are added. They are reused, since many lines
            are results of the same branch.
    """
    names: dict[str, int] = {}
    lines = [
        (
            names.setdefault(name, len(names)),
            operands,
            int(kind),
            called_part if called_part is None else _identity(called_part, known),
        )
        for name, operands, kind, called_part in operations
    ]
    # Version 2 of the format writes a repeated object in full again, so that the bytes depend only on the values.
    return hashlib.sha256(marshal.dumps(([name.encode() for name in names], lines), 2)).hexdigest()


def _identity(called_part: tuple[Branch | SymbolLayer | Function, int], known: dict[int, bytes]) -> tuple[bytes, int]:
    """Return the digest of the branch, layer or function in `Operation.called_part`, and the index of the result."""
    part, index = called_part
    if id(part) not in known:
        match part:
            case Branch():
                branch, label = part, ""
            case SymbolLayer():
                branch, label = part.activation, str(part.matrix)
            case Function():
                branch, label = part.approximation, part.name
        known[id(part)] = f"{label} {branch.results} {_digest(branch.operations, known)}".encode()
    return known[id(part)], index


_NUMBER = SymbolKind.NUMBER
_TRUTH = SymbolKind.TRUTH
_COMPARISONS = ("less", "less_equal", "greater", "greater_equal", "equal", "not_equal")
_LOGICAL = ("bitwise_and", "bitwise_or", "bitwise_xor")
# Packing with `_FLOAT_FORMAT` and unpacking with `_WORD_FORMAT` converts a double to the word with the same bits.
_FLOAT_FORMAT = struct.Struct("<d")
_WORD_FORMAT = struct.Struct("<Q")


def _binary(name: str) -> tuple[Callable[..., "Symbol"], Callable[..., "Symbol"]]:
    """Return the two methods of a binary operator, for operands in normal and in reflected order."""
    takes_numbers, kind = name not in _LOGICAL, _TRUTH if name in _COMPARISONS else _NUMBER

    # Usually, both operands are numbers of the same listing. The checks of `operation` are then skipped.
    def operator(self: "Symbol", other: Any) -> "Symbol":
        if takes_numbers and self.kind is _NUMBER:
            listing = self.listing
            if other.__class__ is float:
                other = listing.constant(other)
            if other.__class__ is Symbol and other.kind is _NUMBER and other.listing is listing:
                return Symbol(listing, listing.line(name, (self.line, other.line), kind), kind)
        return operation(name, self, other)

    def reflected(self: "Symbol", other: Any) -> "Symbol":
        if takes_numbers and self.kind is _NUMBER and other.__class__ is float:
            return self.listing.add(name, (self.listing.constant(other).line, self.line), kind)
        return operation(name, other, self)

    return operator, reflected


def _unsupported(function: str, name: str) -> Callable[..., Any]:
    """Return a method that raises the TypeError for an operator or function that a formula cannot apply to rows.

    Args:
        function: description of the operator or function.
        name: name of NumPy's equivalent function.
    """

    def method(*_: Any) -> Any:
        raise unsupported_operation(function, replacement(name))

    return method


class Symbol:
    """Row of a formula that is being traced, or a value computed from rows.

    Authors of formulas do not use symbols directly. Numbers support arithmetic and comparisons. Booleans support `&`
    and `|`; in arithmetic with numbers, they are converted to 0 or 1. 64-bit words support sums, products, shifts and
    bitwise operations with other words.
    """

    __slots__ = ("kind", "line", "listing")

    def __init__(self, listing: Listing, line: int, kind: SymbolKind) -> None:
        self.listing, self.line, self.kind = listing, line, kind

    __add__, __radd__ = _binary("add")
    __sub__, __rsub__ = _binary("subtract")
    __mul__, __rmul__ = _binary("multiply")
    __truediv__, __rtruediv__ = _binary("divide")
    __and__, __rand__ = _binary("bitwise_and")
    __or__, __ror__ = _binary("bitwise_or")
    __xor__, __rxor__ = _binary("bitwise_xor")
    __lshift__, _ = _binary("left_shift")
    __rshift__, _ = _binary("right_shift")
    __lt__, _ = _binary("less")
    __le__, _ = _binary("less_equal")
    __gt__, _ = _binary("greater")
    __ge__, _ = _binary("greater_equal")
    __eq__, _ = _binary("equal")  # type: ignore[assignment]
    __ne__, _ = _binary("not_equal")  # type: ignore[assignment]
    __hash__ = object.__hash__

    def __neg__(self) -> "Symbol":
        return operation("negative", self)

    def __pos__(self) -> "Symbol":
        return self

    def __abs__(self) -> "Symbol":
        return operation("absolute", self)

    def __pow__(self, exponent: Any) -> "Symbol":
        raise power_error(exponent)

    __rpow__ = _unsupported("`**`", "power")
    __floordiv__ = __rfloordiv__ = _unsupported("`//`", "floor_divide")
    __mod__ = __rmod__ = _unsupported("`%`", "remainder")
    __divmod__ = __rdivmod__ = _unsupported("divmod", "remainder")
    __invert__ = _unsupported("`~`", "logical_not")
    __round__ = _unsupported("round", "round")
    __floor__ = _unsupported("math.floor", "floor")
    __ceil__ = _unsupported("math.ceil", "ceil")

    def __array_ufunc__(self, function: np.ufunc, method: str, *inputs: Any, **options: Any) -> "Symbol":
        """Compute arithmetic and comparisons with NumPy's scalars; raise TypeError for all other functions of NumPy."""
        name = function.__name__
        if name not in _ACCEPTED_UFUNCS or method != "__call__" or options:
            raise numpy_function_error(calling_numpy_function() or name)
        return operation(name, *inputs)

    def __array_function__(self, function: Callable[..., Any], *_: Any) -> Any:
        """Raise TypeError for functions of NumPy that are not universal functions."""
        raise numpy_function_error(function.__name__)

    def __float__(self) -> float:
        if caller := calling_numpy_function():
            raise numpy_function_error(caller)
        raise TypeError(
            "a row cannot be converted to a float; use functions of drake_quad.framework.elementary instead of those of"
            " math, as in sqrt(x), and a list instead of an array of floats"
        )

    def __index__(self) -> int:
        raise TypeError(
            "a row cannot be converted to an int, and cannot be an index or a number of repetitions; use nearest(x) of"
            " drake_quad.framework.elementary to round, and where(condition, x, y) to select"
        )

    def __bool__(self) -> bool:
        if caller := calling_numpy_function():
            raise numpy_function_error(caller)
        raise TypeError(
            "a formula cannot branch on a row, which differs from vehicle to vehicle; use where(x > 0.0, x, y) instead"
            " of `if`, maximum(x, y) and minimum(x, y) instead of max and min, and `&` and `|` instead of `and` and"
            " `or`, with the functions of drake_quad.framework.elementary"
        )

    def __format__(self, specification: str) -> str:
        if not specification:
            return repr(self)
        raise TypeError(
            "a row has no value while its formula is compiled; set the environment variable DRAKE_QUAD_INTERPRETED to 1"
            " to print its values"
        )

    def __repr__(self) -> str:
        return f"<row {self.line} of a formula that is being compiled>"


# Names of NumPy's functions that accept symbols.
_ACCEPTED_UFUNCS = (
    *("add", "subtract", "multiply", "divide", "negative", "absolute", "left_shift", "right_shift"),
    *(*_COMPARISONS, *_LOGICAL),
)


def operation(name: str, *operands: Any, kind: SymbolKind | None = None) -> Symbol:
    """Return the symbol of an operation on symbols and constants; at least one operand must be a symbol.

    Booleans are converted to numbers if the operation requires numbers.

    Args:
        name: name of the operation.
        operands: operands of the operation.
        kind: type of the result; by default a boolean for a comparison, and the type of the first symbol otherwise.

    Raises:
        TypeError: if the operation does not apply to operands of these types, or the operands belong to different
            listings.
    """
    symbols = to_symbols(*operands)
    first = _first_symbol(operands)
    if name in _COMPARISONS:
        kind = _TRUTH
    if name in _LOGICAL:
        if first.kind is _NUMBER or any(symbol.kind is not first.kind for symbol in symbols):
            raise TypeError(f"the operands of `&`, `|` and `^` must be comparisons, not numbers; {ROW_OPERATIONS_HINT}")
    elif name != "select":
        for symbol in symbols:
            if symbol.kind is _TRUTH:
                return _operation_on_booleans(name, symbols, kind or _NUMBER)
    return first.listing.add(name, tuple([symbol.line for symbol in symbols]), kind or first.kind)


def _operation_on_booleans(name: str, symbols: Sequence[Symbol], kind: SymbolKind) -> Symbol:
    """Return the symbol of an operation on numbers, given operands that include booleans."""
    if all(symbol.kind is _TRUTH for symbol in symbols):
        if name == "multiply":
            return operation("bitwise_and", *symbols)
        if name in _AMBIGUOUS_OPERATIONS:
            raise TypeError(_BOOLEAN_ARITHMETIC_MESSAGE)
    return operation(name, *map(as_number, symbols), kind=kind)


# Operations whose results for booleans differ between Python and NumPy.
_AMBIGUOUS_OPERATIONS = ("add", "subtract", "negative")
_BOOLEAN_ARITHMETIC_MESSAGE = (
    "comparisons cannot be added, subtracted or negated: use where(comparison, 1.0, 0.0) of"
    " drake_quad.framework.elementary, or combine them by `&` and `|`"
)


def as_number(symbol: Symbol) -> Symbol:
    """Convert a boolean to the number 1 or 0; other symbols are returned unchanged."""
    if symbol.kind is not _TRUTH:
        return symbol
    _, one, zero = to_symbols(symbol, 1.0, 0.0)
    return operation("select", symbol, one, zero, kind=_NUMBER)


def as_truth_value(symbol: Symbol) -> Symbol:
    """Convert a number to a boolean, true if it differs from zero; other symbols are returned unchanged."""
    return operation("not_equal", symbol, 0.0) if symbol.kind is _NUMBER else symbol


def to_symbols(*operands: Any) -> list[Symbol]:
    """Convert operands to symbols; at least one of them must be a symbol.

    Raises:
        TypeError: if the symbols belong to different listings.
    """
    listing, symbols = _first_symbol(operands).listing, []
    for operand in operands:
        symbol = operand if operand.__class__ is Symbol else listing.constant(operand)
        if symbol.listing is not listing:
            raise TypeError(_FOREIGN_SYMBOL_MESSAGE)
        symbols.append(symbol)
    return symbols


def _first_symbol(operands: Sequence[Any]) -> Symbol:
    """Return the first symbol among operands."""
    for operand in operands:
        if operand.__class__ is Symbol:
            return operand
    raise TypeError("none of the operands is a symbol")


def are_same(x: Any, y: Any) -> bool:
    """Return whether two rows are the same object, or symbols for the same line of a listing."""
    if x.__class__ is Symbol and y.__class__ is Symbol:
        return x.listing is y.listing and x.line == y.line
    return x is y


_FOREIGN_SYMBOL_MESSAGE = (
    "the formula of `lazy_where` or an activation uses a row that is not one of its arguments; pass the row as an"
    " argument"
)


def add_branch(mask: Symbol, formula: Callable[..., Any], arguments: Sequence[Any]) -> Any:
    """Return the results of a formula that is executed only if the mask is true for at least one vehicle of a vector.

    The results are a row or a tuple of rows. They are undefined for vehicles for which the mask is false.

    Raises:
        TypeError: if the formula uses symbols that are not arguments.
    """
    inside = Listing(calls_functions=mask.listing.calls_functions)
    inputs = [argument for argument in arguments if argument.__class__ is Symbol]
    rows = iter([inside.row(0, index, symbol.kind) for index, symbol in enumerate(inputs)])
    returned = formula(*[next(rows) if argument.__class__ is Symbol else argument for argument in arguments])
    parts = returned if isinstance(returned, tuple) else (returned,)
    symbols = [part for part in parts if part.__class__ is Symbol]
    branch = _branch(inside, symbols)
    operands = tuple([symbol.line for symbol in to_symbols(as_truth_value(mask), *inputs)])
    results = iter(
        [mask.listing.add("branch", operands, symbol.kind, (branch, index)) for index, symbol in enumerate(symbols)]
    )
    values = [next(results) if part.__class__ is Symbol else part for part in parts]
    if not isinstance(returned, tuple):
        return values[0]
    return returned._make(values) if hasattr(returned, "_make") else tuple(values)


def _branch(inside: Listing, results: Sequence[Symbol]) -> Branch:
    if any(symbol.listing is not inside for symbol in results):
        raise TypeError(_FOREIGN_SYMBOL_MESSAGE)
    return Branch(tuple(inside.operations), tuple([symbol.line for symbol in results]))


def layer(matrix: Matrix, rows: Sequence[Any], activation: Callable[[Any], Any]) -> list[Symbol]:
    """Return symbols for the outputs of a network layer; at least one input must be a symbol.

    Raises:
        TypeError: if the activation uses symbols other than its argument, or the inputs belong to different listings.
    """
    symbols = [as_number(symbol) for symbol in to_symbols(*rows)]
    inside = Listing(calls_functions=symbols[0].listing.calls_functions)
    result = as_number(to_symbols(inside.row(0, 0), activation(inside.row(0, 0)))[1])
    symbol_layer = SymbolLayer(matrix, _branch(inside, [result]))
    operands = tuple([symbol.line for symbol in symbols])
    return [
        symbols[0].listing.add("layer", operands, SymbolKind.NUMBER, (symbol_layer, index))
        for index in range(matrix.shape[0])
    ]


def add_function(name: str, approximation: Callable[..., Any], arguments: Sequence[Any]) -> Any:
    """Record a call of an elementary function, and return its result or the tuple of its results.

    Args:
        name: name of the function.
        approximation: formula that computes the results from the arguments.
        arguments: numbers; at least one must be a symbol.
    """
    inside = Listing(calls_functions=True)
    returned = approximation(*[inside.row(0, index) for index in range(len(arguments))])
    results = returned if isinstance(returned, tuple) else (returned,)
    function = Function(name, _branch(inside, results))
    symbols = [as_number(symbol) for symbol in to_symbols(*arguments)]
    operands, listing = tuple([symbol.line for symbol in symbols]), symbols[0].listing
    calls = [listing.add("function", operands, _NUMBER, (function, index)) for index in range(len(results))]
    return tuple(calls) if isinstance(returned, tuple) else calls[0]
