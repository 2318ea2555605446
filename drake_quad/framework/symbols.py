"""Rows that are not known yet: a formula that is run on them writes itself down.

A formula says what it computes in plain Python. Run once on symbols, it leaves a `Listing` of everything that it did,
in order, from which machine code is made. What Python decides meanwhile, such as a loop over rules or an `if` on a
constant, is decided once; a row can decide nothing, only select: `drake_quad.framework.elementary.where`. What costs
much and is seldom needed is a listing of its own, a `Branch`: `drake_quad.framework.elementary.where_needed`. What
would be thousands of lines that are alike is a loop, a `SymbolLayer`: `drake_quad.framework.elementary.dense`.
"""

import hashlib
import struct
from collections.abc import Callable, Iterator, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np


class SymbolKind(IntEnum):
    """What a symbol stands for: a floating-point number of 64 bits, true or false, or 64 bits."""

    NUMBER = 1
    TRUTH = 2
    WORD = 3


# Hint for authors of formulas, which ends error messages.
ALLOWED = "compute with rows by arithmetic, comparisons and the functions of drake_quad.framework.elementary"
# What takes nothing from other lines.
LEAVES = ("constant", "row", "shared")


class Operation(NamedTuple):
    """One line of a listing.

    Attributes:
        name: of what is done, a key of `INSTRUCTIONS` in `drake_quad.framework.instructions`; or "constant", "row",
            "shared".
        operands: numbers of the lines that it takes; of a constant its bits, of a row its group and place, of a number
            that is shared its place.
        kind: of the result.
        inside: what a function of its own does with the operands, and which of its results this is: a branch, if the
            first operand is true for any vehicle at hand, with the others; or a layer. None unless the operation is
            called "branch" or "layer".
    """

    name: str
    operands: tuple[int, ...]
    kind: SymbolKind
    inside: "tuple[Branch | SymbolLayer, int] | None" = None


class Branch(NamedTuple):
    """What is done only where it is needed.

    Attributes:
        operations: its lines, which take from elsewhere the rows of group 0 and nothing else.
        results: numbers of the lines that it results in.
    """

    operations: tuple[Operation, ...]
    results: tuple[int, ...]

    @property
    def listing(self) -> "Listing":
        """Its lines."""
        listing = Listing()
        for operation in self.operations:
            listing.add(*operation)
        return listing


class Matrix:
    """Constant numbers of a layer: weights by row and column, and the biases that are added.

    Args:
        weights: (rows, columns).
        biases: (rows,).

    Attributes:
        shape: rows and columns.
    """

    __slots__ = ("_digest", "_numbers", "shape")

    def __init__(self, weights: np.ndarray, biases: np.ndarray) -> None:
        self._numbers = np.column_stack([biases, weights]).astype(float)
        self._numbers.setflags(write=False)
        self.shape = self._numbers.shape[0], self._numbers.shape[1] - 1
        self._digest = hashlib.sha256(self._numbers.tobytes()).hexdigest()

    @property
    def num_rows(self) -> int:
        """Rows of what it makes."""
        rows, _ = self.shape
        return rows

    def biases_and_weights(self) -> Iterator[tuple[float, list[float]]]:
        """Bias and weights of each row."""
        for bias, *weights in self._numbers.tolist():
            yield bias, weights

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Matrix) and (self.shape, self._digest) == (other.shape, other._digest)

    def __hash__(self) -> int:
        return hash((self.shape, self._digest))

    def __repr__(self) -> str:
        return f"Matrix({self.shape}, {self._digest})"


class SymbolLayer(NamedTuple):
    """A matrix times rows, plus biases, and the activation of the sums.

    Attributes:
        matrix: of the layer.
        activation: of a sum, the only row of group 0; with one result.
    """

    matrix: Matrix
    activation: Branch


class Listing:
    """What a formula did, line by line; what it did twice stands there once."""

    def __init__(self) -> None:
        self.operations: list[Operation] = []
        # Numbers instead of symbols, which refer to their listing: without such circles it is freed at once.
        self._lines: dict[tuple[Any, ...], int] = {}

    def line(
        self,
        name: str,
        operands: tuple[int, ...],
        kind: SymbolKind,
        inside: tuple[Branch | SymbolLayer, int] | None = None,
    ) -> int:
        """The number of a line, which is added unless it is there."""
        key = name, operands, kind, inside
        line = self._lines.get(key)
        if line is None:
            line = self._lines[key] = len(self.operations)
            # This skips the constructor, which is in Python and takes as long as all else here.
            self.operations.append(tuple.__new__(Operation, key))
        return line

    def add(
        self,
        name: str,
        operands: tuple[int, ...],
        kind: SymbolKind,
        inside: tuple[Branch | SymbolLayer, int] | None = None,
    ) -> "Symbol":
        """The symbol of a line, which is added unless it is there."""
        return Symbol(self, self.line(name, operands, kind, inside), kind)

    def row(self, group: int, place: int, kind: SymbolKind = SymbolKind.NUMBER) -> "Symbol":
        """The symbol of a row of a group that is read."""
        return self.add("row", (group, place), kind)

    def shared(self, place: int) -> "Symbol":
        """The symbol of a number that is the same for all vehicles, given its place among those."""
        return self.add("shared", (place,), SymbolKind.NUMBER)

    def constant(self, value: Any) -> "Symbol":
        """Return the symbol of a number, of a NumPy uint64 or of a truth value."""
        if value.__class__ is float:  # most of them
            return self.add("constant", _WORD.unpack(_FLOAT.pack(value)), SymbolKind.NUMBER)
        if isinstance(value, np.ndarray) and value.ndim:
            raise TypeError(f"an array of shape {value.shape} stands where a number or a row is wanted; {ALLOWED}")
        if isinstance(value, bool | np.bool):
            return self.add("constant", (int(value),), SymbolKind.TRUTH)
        if isinstance(value, np.uint64):
            return self.add("constant", (int(value),), SymbolKind.WORD)
        return self.add("constant", (int(np.float64(value).view(np.uint64)),), SymbolKind.NUMBER)


_NUMBER = SymbolKind.NUMBER
_TRUTH = SymbolKind.TRUTH
_COMPARISONS = ("less", "less_equal", "greater", "greater_equal", "equal", "not_equal")
_LOGICAL = ("bitwise_and", "bitwise_or", "bitwise_xor")
# A number and the word with the same bits.
_FLOAT, _WORD = struct.Struct("<d"), struct.Struct("<Q")


def _binary(name: str) -> tuple[Callable[..., "Symbol"], Callable[..., "Symbol"]]:
    """An operator of two operands, and the same with its operands the other way round."""
    takes_numbers, kind = name not in _LOGICAL, _TRUTH if name in _COMPARISONS else _NUMBER

    # Two numbers of one listing, as most operands are, need none of the checks of `operation`.
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


class Symbol:
    """Row of a formula that is being traced, or a value computed from rows.

    Authors of formulas see symbols only in a debugger. Numbers support arithmetic and comparisons. Truth values support
    `&` and `|`, and are 0 or 1 beside numbers. Words support sums, products, shifts and bitwise operations with other
    words.
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

    def __abs__(self) -> "Symbol":
        return operation("absolute", self)

    def __array_ufunc__(self, function: np.ufunc, method: str, *inputs: Any, **options: Any) -> "Symbol":
        """Compute arithmetic and comparisons with NumPy's scalars, and reject all other functions of NumPy."""
        name = function.__name__
        if name not in _UFUNCS or method != "__call__" or options:
            raise TypeError(f"numpy.{name} does not take a row that is not known yet; {ALLOWED}")
        return operation(name, *inputs)

    def __float__(self) -> float:
        raise TypeError(f"a row that is not known yet is not a float, as the functions of math take it; {ALLOWED}")

    def __bool__(self) -> bool:
        raise TypeError("a formula cannot branch on a row, which differs from vehicle to vehicle: select with `where`")


# NumPy's names of the operations that a symbol can be an operand of.
_UFUNCS = (
    *("add", "subtract", "multiply", "divide", "negative", "absolute", "left_shift", "right_shift"),
    *(*_COMPARISONS, *_LOGICAL),
)


def operation(name: str, *operands: Any, kind: SymbolKind | None = None) -> Symbol:
    """Return the symbol of an operation on symbols and constants, at least one of them a symbol.

    Truth values are converted to numbers where the operation takes numbers.

    Args:
        name: name of the operation.
        operands: its operands.
        kind: kind of the result; if not given, a truth value for a comparison, and else that of the first symbol.

    Raises:
        TypeError: if the operation does not apply to operands of these kinds, or they are of several listings.
    """
    symbols = lifted(*operands)
    first = _first_symbol(operands)
    if name in _COMPARISONS:
        kind = _TRUTH
    if name in _LOGICAL:
        if first.kind is _NUMBER or any(symbol.kind is not first.kind for symbol in symbols):
            raise TypeError(f"`&`, `|` and `^` take comparisons, not numbers; {ALLOWED}")
    elif name != "select":
        for symbol in symbols:
            if symbol.kind is _TRUTH:
                return _of_truths(name, symbols, kind or _NUMBER)
    return first.listing.add(name, tuple([symbol.line for symbol in symbols]), kind or first.kind)


def _of_truths(name: str, symbols: Sequence[Symbol], kind: SymbolKind) -> Symbol:
    """Return the symbol of an operation that takes numbers, on operands of which some are truth values."""
    if all(symbol.kind is _TRUTH for symbol in symbols):
        if name == "multiply":
            return operation("bitwise_and", *symbols)
        if name in _AMBIGUOUS:
            raise TypeError(_TRUTHS_ADDED)
    return operation(name, *map(number, symbols), kind=kind)


# Operations whose results on truth values differ between Python and NumPy.
_AMBIGUOUS = ("add", "subtract", "negative")
_TRUTHS_ADDED = (
    "comparisons cannot be added, subtracted or negated: use where(comparison, 1.0, 0.0) of"
    " drake_quad.framework.elementary, or combine them by `&` and `|`"
)


def number(symbol: Symbol) -> Symbol:
    """Return the number 1 for a symbol that is true and 0 for one that is false; other symbols are returned as is."""
    if symbol.kind is not _TRUTH:
        return symbol
    _, one, zero = lifted(symbol, 1.0, 0.0)
    return operation("select", symbol, one, zero, kind=_NUMBER)


def truth(symbol: Symbol) -> Symbol:
    """Return whether a number differs from zero; other symbols are returned as is."""
    return operation("not_equal", symbol, 0.0) if symbol.kind is _NUMBER else symbol


def lifted(*operands: Any) -> list[Symbol]:
    """The operands, of which at least one is a symbol, as symbols.

    Raises:
        TypeError: they are of several listings.
    """
    listing, symbols = _first_symbol(operands).listing, []
    for operand in operands:
        symbol = operand if operand.__class__ is Symbol else listing.constant(operand)
        if symbol.listing is not listing:
            raise TypeError(_FOREIGN)
        symbols.append(symbol)
    return symbols


def _first_symbol(operands: Sequence[Any]) -> Symbol:
    """Return the first symbol among operands."""
    for operand in operands:
        if operand.__class__ is Symbol:
            return operand
    raise TypeError("none of the operands is a symbol")


def are_same(x: Any, y: Any) -> bool:
    """Return whether two rows are one object, or symbols of the same line."""
    if x.__class__ is Symbol and y.__class__ is Symbol:
        return x.listing is y.listing and x.line == y.line
    return x is y


_FOREIGN = "what is computed only where it is needed must take all its rows as arguments"


def branched(mask: Symbol, formula: Callable[..., Any], arguments: Sequence[Any]) -> Any:
    """What a formula makes of symbols and constants, a row or a tuple of them, if the mask is true for any vehicle.

    For vehicles for which it is not true the result means nothing.

    Raises:
        TypeError: the formula takes symbols that are not among its arguments.
    """
    inside, taken = Listing(), [argument for argument in arguments if argument.__class__ is Symbol]
    rows = iter([inside.row(0, place, symbol.kind) for place, symbol in enumerate(taken)])
    returned = formula(*[next(rows) if argument.__class__ is Symbol else argument for argument in arguments])
    parts = returned if isinstance(returned, tuple) else (returned,)
    symbols = [part for part in parts if part.__class__ is Symbol]
    branch = _branch(inside, symbols)
    operands = tuple([symbol.line for symbol in lifted(truth(mask), *taken)])
    results = iter(
        [mask.listing.add("branch", operands, symbol.kind, (branch, place)) for place, symbol in enumerate(symbols)]
    )
    found = [next(results) if part.__class__ is Symbol else part for part in parts]
    if not isinstance(returned, tuple):
        return found[0]
    return returned._make(found) if hasattr(returned, "_make") else tuple(found)


def _branch(inside: Listing, results: Sequence[Symbol]) -> Branch:
    if any(symbol.listing is not inside for symbol in results):
        raise TypeError(_FOREIGN)
    return Branch(tuple(inside.operations), tuple([symbol.line for symbol in results]))


def layer(matrix: Matrix, rows: Sequence[Any], activation: Callable[[Any], Any]) -> list[Symbol]:
    """The symbols of what a layer makes of rows, of which at least one is a symbol.

    Raises:
        TypeError: the activation takes other symbols than the sum, or the rows are of several listings.
    """
    inside = Listing()
    result = number(lifted(inside.row(0, 0), activation(inside.row(0, 0)))[1])
    symbols = [number(symbol) for symbol in lifted(*rows)]
    found = SymbolLayer(matrix, _branch(inside, [result]))
    operands = tuple([symbol.line for symbol in symbols])
    return [
        symbols[0].listing.add("layer", operands, SymbolKind.NUMBER, (found, place)) for place in range(matrix.shape[0])
    ]
