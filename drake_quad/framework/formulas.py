"""Execution of formulas for every vehicle of a fleet, as machine code or as plain Python.

A formula is a Python function of records and constants. It is compiled to machine code once for floats. Python executes
it for AutoDiffXd and Expression, or if the environment variable DRAKE_QUAD_INTERPRETED is set.
"""

import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from drake_quad.caching import ThreadSafeCache
from drake_quad.framework.elementary import nearest
from drake_quad.framework.kernels import compile_kernel
from drake_quad.framework.records import ABSENT, Layout
from drake_quad.framework.replacements import explain_formula_error
from drake_quad.framework.symbols import Listing, Symbol, as_number, scalar_element
from drake_quad.signals import Row

# True if Python executes all formulas, so that a debugger can stop inside a formula.
INTERPRETED = bool(os.environ.get("DRAKE_QUAD_INTERPRETED"))


class _Time:
    """Placeholder for the time (s) among the arguments of a formula."""

    def __repr__(self) -> str:
        return "TIME"


TIME = _Time()
"""Placeholder for the time (s) among the arguments of a formula."""


class Tick(NamedTuple):
    """Number of a tick, split into the number of a pair of ticks and the position in the pair.

    Random number streams use the pair, since one random word yields normal numbers for two successive ticks.

    Attributes:
        pair: number of the pair, a whole number from 0 on.
        second: True if the tick is the second tick of the pair.
    """

    pair: Row
    second: bool


class CurrentTick(NamedTuple):
    """Placeholder, among the arguments of a formula, for the `Tick` nearest to the current time.

    Attributes:
        period: period of the ticks, s.
    """

    period: float

    def at(self, time: Row) -> Tick:
        """Return the tick nearest to a time (s)."""
        number = nearest(time / self.period)
        pair = nearest(0.5 * number - 0.25)
        return Tick(pair, number > 2.0 * pair)


_kernels: ThreadSafeCache[Callable[..., None]] = ThreadSafeCache()


def kernel(
    formula: Callable[..., Any], arguments: tuple[Any, ...], results: tuple[Layout, ...], *, single_vehicle: bool
) -> Callable[..., None]:
    """Return the machine code of a formula.

    Args:
        formula: function to compile.
        arguments: arguments of the formula: a `Layout` for a record to read, `TIME`, a `CurrentTick`, or a constant.
        results: layout of the result if it is a single record; else the layouts of all parts of a tuple or record.
        single_vehicle: True for machine code that computes only one vehicle.

    Raises:
        TypeError: if the results do not match the layouts, or the formula branches on a row.
    """
    key = formula, tuple(map(hashable_key, arguments)), results, single_vehicle
    return _kernels.get(key, lambda: _compile(formula, arguments, results, single_vehicle))


def hashable_key(constant: Any) -> tuple[Any, str]:
    """Return a key for a constant that distinguishes equal constants, such as -0.0 from 0.0 and 1 from 1.0."""
    try:
        hash(constant)
    except TypeError:
        # A mutable object, such as a list, gets a key that differs from all other keys.
        return object(), ""
    return constant, repr(constant)


def _compile(
    formula: Callable[..., Any], arguments: Sequence[Any], results: Sequence[Layout], single_vehicle: bool
) -> Callable[..., None]:
    """Compile a formula to machine code; the arguments are as in `kernel`."""
    listing = Listing()
    values: list[Any] = []
    sizes: list[int] = []
    for argument in arguments:
        if isinstance(argument, Layout):
            rows = [listing.row(len(sizes), index) for index in range(argument.num_rows)]
            values.append(argument.build(rows))
            sizes.append(argument.num_rows)
        else:
            values.append(at_time(argument, listing.shared(0)))
    returned = trace_formula(formula, values, results)
    targets = [layout.num_rows for layout in results if layout is not ABSENT]
    return compile_kernel(listing, returned, sources=sizes, targets=targets, single_vehicle=single_vehicle)


def trace_formula(formula: Callable[..., Any], values: Sequence[Any], results: Sequence[Layout]) -> list[Any]:
    """Run a formula on symbols, and return the rows of its results; booleans are converted to 0 and 1.

    Raises:
        TypeError: if the results do not match the layouts, or if the formula branches on a row or calls a function that
            does not accept symbols.
        IndexError: if the formula uses a wrong index.
    """
    try:
        return [_number(row) for row in flatten_results(formula(*values), results)]
    except (TypeError, AttributeError, IndexError) as error:
        name = getattr(formula, "__name__", repr(formula))
        kind = IndexError if isinstance(error, IndexError) else TypeError
        raise kind(f"formula {name}: {explain_formula_error(error)}") from error


def _number(row: Any) -> Any:
    if row.__class__ is Symbol:
        return as_number(row)
    if row.__class__ is np.ndarray:
        return _number(scalar_element(row))
    return float(row) if isinstance(row, bool | np.bool) else row


def interpret(
    formula: Callable[..., Any],
    arguments: Sequence[Any],
    sources: Sequence[np.ndarray],
    results: Sequence[Layout],
    num_vehicles: int,
    time: Any,
) -> list[np.ndarray]:
    """Execute a formula in Python, and return the elements of each result.

    Args:
        formula: function to execute.
        arguments: arguments of the formula: a `Layout` for a record to read, `TIME`, a `CurrentTick`, or a constant.
        sources: elements of the records to read, one array for each layout among the arguments.
        results: layout of the result if it is a single record; else the layouts of all parts of a tuple or record.
        num_vehicles: number N of vehicles.
        time: time, s.
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
    rows = iter(flatten_results(formula(*values), results))
    sizes = [layout.num_rows for layout in results if layout is not ABSENT]
    return [pack_rows([next(rows) for _ in range(size)], num_vehicles) for size in sizes]


def at_time(argument: Any, time: Any) -> Any:
    """Return the value of an argument (`TIME`, a `CurrentTick` or a constant) at a time, s."""
    if argument is TIME:
        return time
    return argument.at(time) if isinstance(argument, CurrentTick) else argument


def flatten_results(returned: Any, results: Sequence[Layout]) -> list[Any]:
    """Return the rows of all results of a formula in order; absent results have no rows.

    Raises:
        TypeError: if the results do not match the layouts.
    """
    parts = [returned] if len(results) == 1 else returned
    if not isinstance(parts, tuple | list) or len(parts) != len(results):
        expected = "a single result" if len(results) == 1 else f"{len(results)} results"
        raise TypeError(f"expected {expected}, but the formula returned {returned!r}")
    present = [(layout, part) for layout, part in zip(results, parts, strict=True) if layout is not ABSENT]
    return [row for layout, part in present for row in layout.flatten(part)]


def pack_rows(rows: Sequence[Any], num_vehicles: int) -> np.ndarray:
    """Concatenate rows to one vector of num_rows · N elements; each row is a number or an (N,) array."""
    # `np.broadcast_to` would be twenty times slower than the following code.
    if num_vehicles == 1:
        return np.array([row.item() if row.__class__ is np.ndarray else row for row in rows])
    shape = (num_vehicles,)
    return np.concatenate([row if getattr(row, "shape", ()) == shape else np.full(shape, row) for row in rows])
