"""Formulas, applied to every vehicle.

A formula is a plain function of records and constants. On numbers it runs as machine code, made of it once; on
AutoDiffXd, Expression, and wherever the environment variable DRAKE_QUAD_INTERPRETED is set, it runs as it is written.
"""

import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from drake_quad.caching import ThreadSafeCache
from drake_quad.framework.elementary import nearest
from drake_quad.framework.kernels import compiled
from drake_quad.framework.records import ABSENT, Layout
from drake_quad.framework.symbols import ALLOWED, Listing, Symbol, number
from drake_quad.signals import Row

# So that a debugger stops in formulas.
INTERPRETED = bool(os.environ.get("DRAKE_QUAD_INTERPRETED"))


class _Time:
    """Stands among the arguments of a formula for the time, s."""

    def __repr__(self) -> str:
        return "TIME"


TIME = _Time()


class Tick(NamedTuple):
    """Where an instant stands among ticks, which are counted in pairs.

    Attributes:
        pair: which pair it belongs to, a whole number from 0 on.
        second: whether it is the second of the pair.
    """

    pair: Row
    second: bool


class TickOf(NamedTuple):
    """Stands among the arguments of a formula for the nearest `Tick` of a period.

    Attributes:
        period: s.
    """

    period: float

    def at(self, time: Row) -> Tick:
        """The tick nearest to a time (s)."""
        number = nearest(time / self.period)
        pair = nearest(0.5 * number - 0.25)
        return Tick(pair, number > 2.0 * pair)


_kernels: ThreadSafeCache[Callable[..., None]] = ThreadSafeCache()


def kernel(
    formula: Callable[..., Any], arguments: tuple[Any, ...], results: tuple[Layout, ...], *, lone: bool
) -> Callable[..., None]:
    """Return the machine code of a formula.

    Args:
        formula: function to compile.
        arguments: kinds of its arguments: a `Layout` for a record that is read, `TIME`, a `TickOf`, or a constant.
        results: layouts of its results: that of a single record, or those of the parts of a tuple or record.
        lone: True for code that computes a single vehicle.

    Raises:
        TypeError: if the results do not fit the layouts, or the formula branches on a row.
    """
    key = formula, tuple(map(told_apart, arguments)), results, lone
    return _kernels.get(key, lambda: _made(formula, arguments, results, lone))


def told_apart(constant: Any) -> tuple[Any, str]:
    """A constant, told from those that are equal to it and yet others: -0.0 from 0.0, and 1 from 1.0."""
    try:
        hash(constant)
    except TypeError:
        # What may change, such as a list, is like nothing else.
        return object(), ""
    return constant, repr(constant)


def _made(
    formula: Callable[..., Any], arguments: Sequence[Any], results: Sequence[Layout], lone: bool
) -> Callable[..., None]:
    """Compile a formula to machine code; arguments are those of `kernel`."""
    listing = Listing()
    values: list[Any] = []
    sizes: list[int] = []
    for argument in arguments:
        if isinstance(argument, Layout):
            rows = [listing.row(len(sizes), place) for place in range(argument.num_rows)]
            values.append(argument.build(rows))
            sizes.append(argument.num_rows)
        else:
            values.append(at_time(argument, listing.shared(0)))
    returned = traced(formula, values, results)
    targets = [layout.num_rows for layout in results if layout is not ABSENT]
    return compiled(listing, returned, sources=sizes, targets=targets, lone=lone)


def traced(formula: Callable[..., Any], values: Sequence[Any], results: Sequence[Layout]) -> list[Any]:
    """Run a formula on symbols, and return the rows of its results; truth values become 0 and 1.

    Args:
        formula: function to trace.
        values: arguments of the formula.
        results: layouts of the results.

    Raises:
        TypeError: if the results do not fit the layouts, or the formula branches on a row or calls a function that does
            not accept symbols.
    """
    try:
        return [_number(row) for row in flattened(formula(*values), results)]
    except (TypeError, AttributeError) as error:
        name = getattr(formula, "__name__", repr(formula))
        # Authors of formulas know rows, not symbols, so messages of Python and NumPy about a Symbol need a hint.
        hint = f"; a Symbol is a row that is not known yet: {ALLOWED}" if "Symbol" in str(error) else ""
        raise TypeError(f"formula {name}: {error}{hint}") from error


def _number(row: Any) -> Any:
    if row.__class__ is Symbol:
        return number(row)
    return float(row) if isinstance(row, bool | np.bool) else row


def interpret(
    formula: Callable[..., Any],
    arguments: Sequence[Any],
    sources: Sequence[np.ndarray],
    results: Sequence[Layout],
    num_vehicles: int,
    time: Any,
) -> list[np.ndarray]:
    """Runs a formula as it is written, and returns the elements of each result.

    Args:
        formula: to apply.
        arguments: that it takes: a `Layout` for a record that is read, `TIME`, a `TickOf`, or a constant.
        sources: the elements of what is read, one array for each layout among the arguments.
        results: layouts of what it returns: that of the only record, or those of the parts of a tuple or record.
        num_vehicles: N.
        time: s.
    """
    read = iter(sources)
    values = []
    for argument in arguments:
        if isinstance(argument, Layout):
            elements = next(read)
            rows: Any = elements.tolist() if num_vehicles == 1 else elements.reshape(-1, num_vehicles)
            values.append(argument.build(rows))
        else:
            values.append(at_time(argument, time))
    rows = iter(flattened(formula(*values), results))
    sizes = [layout.num_rows for layout in results if layout is not ABSENT]
    return [packed([next(rows) for _ in range(size)], num_vehicles) for size in sizes]


def at_time(argument: Any, time: Any) -> Any:
    """What a formula gets at a time (s) for an argument that is no record."""
    if argument is TIME:
        return time
    return argument.at(time) if isinstance(argument, TickOf) else argument


def flattened(returned: Any, results: Sequence[Layout]) -> list[Any]:
    """Return the rows of the results of a formula, one result after another, without absent results."""
    parts = [returned] if len(results) == 1 else returned
    if not isinstance(parts, tuple | list) or len(parts) != len(results):
        wanted = "one result is" if len(results) == 1 else f"{len(results)} results are"
        raise TypeError(f"{wanted} wanted, not {returned!r}")
    present = [(layout, part) for layout, part in zip(results, parts, strict=True) if layout is not ABSENT]
    return [row for layout, part in present for row in layout.flatten(part)]


def packed(rows: Sequence[Any], num_vehicles: int) -> np.ndarray:
    """Packs rows, each a number or an (N,) array, into one (rows · N,) vector."""
    # `np.broadcast_to` would take twenty times as long.
    if num_vehicles == 1:
        return np.array([row.item() if row.__class__ is np.ndarray else row for row in rows])
    whole = (num_vehicles,)
    return np.concatenate([row if getattr(row, "shape", ()) == whole else np.full(whole, row) for row in rows])
