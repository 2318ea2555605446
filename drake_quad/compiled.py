"""Formulas as machine code.

A formula takes groups of rows, then plain numbers, and returns groups of rows. In Python it works on whatever a row
may be (`drake_quad.elementary`). `fleet_map` makes a function of it that applies it to every vehicle of a fleet of
plain numbers, compiled by Numba once for a machine and kept on its disk.

A formula that can be compiled is made of arithmetic, comparisons, the functions of `drake_quad.elementary`, other
formulas, and tuples of fixed length, NamedTuples among them: no lists, no loops over rows, no branches on rows.
Constants stand in the file of a function that uses them, so that machine code is made anew when they change.

The compiler turns a loop over vehicles into vector instructions if nothing in it is a call and all distances in memory
are known. So formulas are inlined, elementary functions are arithmetic, and a tile of vehicles is copied in and out.
"""

import functools
import hashlib
import inspect
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numba.core import event
from numba.extending import register_jitable

from drake_quad import compiled_elementary
from drake_quad.compiled_elementary import INLINED

_Function = TypeVar("_Function", bound=Callable[..., Any])

_OPTIONS: dict[str, Any] = {name: INLINED[name] for name in ("error_model", "fastmath")}

# Files and folders whose functions stay Python, one after another as on a search path: a debugger stops in them, and
# `make mutants` does not wait for the compiler.
_INTERPRETED = tuple(filter(None, os.environ.get("DRAKE_QUAD_INTERPRETED", "").split(os.pathsep)))

# Vehicles in a tile: sixty rows of them take 31 kB, about what the fastest cache holds.
TILE = 64


def formula(function: _Function) -> _Function:
    """Marks a function that can be compiled; it stays what it is."""
    marked: _Function = register_jitable(**INLINED)(function)
    return marked


def loop(function: _Function) -> _Function:
    """Marks a function with loops over arrays for `compiled` ones to call; it stays what it is."""
    marked: _Function = register_jitable(**_OPTIONS)(function)
    return marked


@functools.cache
def fleet_map(formula: Callable[..., Any], inputs: tuple[int, ...], outputs: tuple[int, ...]) -> Callable[..., None]:
    """Returns the function that applies a formula to every vehicle.

    It takes the number N of vehicles; a tuple of arrays that it writes; a tuple of arrays that it reads, one for each
    group that the formula takes; and a tuple of the formula's numbers. A group of k rows is read from an array of k N
    elements, row after row, or of k, which stand for all vehicles. The rows of all groups that the formula returns go,
    one after another, into the arrays that are written, whose sizes are multiples of N.

    Args:
        formula: marked as such.
        inputs: rows of each group that the formula takes.
        outputs: rows of each group that it returns.
    """
    num_inputs, num_rows = sum(inputs), sum(inputs) + sum(outputs)
    load, store = _load(inputs), _store(outputs, num_inputs)
    sources = fingerprint(formula)

    def apply(num_vehicles: int, targets: Any, arrays: Any, numbers: Any) -> None:
        sources  # noqa: B018
        tile = np.empty((num_rows, TILE))
        for i, array in enumerate(arrays):
            if array.size != inputs[i] * num_vehicles and array.size != inputs[i]:
                raise ValueError("an array to read has a wrong size")
        written = 0
        for target in targets:
            written += target.size
        if written != (num_rows - num_inputs) * num_vehicles:
            raise ValueError("the arrays to write have wrong sizes")
        for first in range(0, num_vehicles, TILE):
            count = min(TILE, num_vehicles - first)
            row = 0
            for i, array in enumerate(arrays):
                for k in range(inputs[i]):
                    if array.size == inputs[i]:
                        for place in range(count):
                            tile[row, place] = array[k]
                    else:
                        values = array[k * num_vehicles + first :]
                        for place in range(count):
                            tile[row, place] = values[place]
                    row += 1
            for place in range(count):
                store(tile, place, formula(*load(tile, place), *numbers))
            for target in targets:
                for start in range(first, target.size, num_vehicles):
                    values = target[start:]
                    for place in range(count):
                        values[place] = tile[row, place]
                    row += 1

    machine_code: Callable[..., None] = _kept(
        apply, f"{formula.__module__}.{formula.__qualname__}", inputs, outputs, sources
    )
    return machine_code


def compiled(function: _Function) -> _Function:
    """Makes a function of arrays and numbers machine code; it may call formulas and loop over elements.

    It stays Python where the first array has elements that are no plain numbers.
    """
    if stays_python(function):
        return function
    sources, marked = fingerprint(function), formula(function)

    def run(*arguments: Any) -> Any:
        sources  # noqa: B018
        return marked(*arguments)

    machine_code = _kept(run, function.__module__, function.__qualname__, sources)

    @functools.wraps(function)
    def call(*arguments: Any) -> Any:
        return function(*arguments) if arguments[0].dtype == object else machine_code(*arguments)

    wrapped: Any = call
    return cast("_Function", wrapped)


def _kept(function: Callable[..., Any], *identity: Any) -> Any:
    """Compiles a function when it is first called, and keeps the machine code on the disk if there is a place.

    Numba calls machine code after the function's name and a number that counts up in each process. So functions of one
    name, compiled by different processes, could be taken for each other when a third one reads them from the disk: each
    gets a name that is made of its identity.
    """
    digest = hashlib.sha256(repr(identity).encode()).hexdigest()[:16]
    function.__name__ = function.__qualname__ = f"{function.__name__}_{digest}"
    try:
        return njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:  # neither the package's folder nor the user's can be written
        return njit(**_OPTIONS)(function)


@contextmanager
def telling_of_compilation(tell: Callable[[], None]) -> Iterator[None]:
    """Has a function called when something is compiled because it is not on the disk yet; once."""

    class Listener(event.Listener):
        told = False

        def on_start(self, _: Any) -> None:
            if not self.told:
                tell()
            self.told = True

        def on_end(self, _: Any) -> None:
            """Nothing to tell."""

    listener = Listener()
    event.register("numba:compile", listener)
    try:
        yield
    finally:
        event.unregister("numba:compile", listener)


def stays_python(function: Callable[..., Any]) -> bool:
    """Is there code of a function in what the environment variable DRAKE_QUAD_INTERPRETED names?"""
    return bool(_INTERPRETED) and any(file.startswith(_INTERPRETED) for file in source_files(function))


def fingerprint(function: Callable[..., Any]) -> str:
    """A digest of the files that a function's code comes from.

    Numba keeps machine code by the constants that it finds in a function, but does not look into what that calls.
    """
    digest = hashlib.sha256()
    for file in source_files(function):
        digest.update(Path(file).read_bytes())
    return digest.hexdigest()


def source_files(function: Callable[..., Any]) -> list[str]:
    """The files that the code of a function comes from, and that of the functions and classes it uses.

    Those are of this package and of the function's own; other packages do not change.
    """
    files = {__file__, compiled_elementary.__file__}
    roots = {module.split(".")[0] for module in (__name__, function.__module__)}
    pending: list[Any] = [function]
    seen = set()
    while pending:
        found = inspect.unwrap(pending.pop())
        if found in seen or found.__module__.split(".")[0] not in roots:
            continue
        seen.add(found)
        files.add(inspect.getfile(found))
        if isinstance(found, FunctionType):
            used = (found.__globals__.get(name) for name in found.__code__.co_names)
            pending += [value for value in used if isinstance(value, FunctionType | type)]
    return sorted(files)


def _load(inputs: tuple[int, ...]) -> Callable[..., Any]:
    """The function that reads a vehicle's groups from a tile."""
    row, groups = 0, []
    for size in inputs:
        groups.append("".join(f"tile[{row + k}, place], " for k in range(size)))
        row += size
    name = "_".join(map(str, ("load", *inputs)))
    return _written(name, f"def {name}(tile, place): return ({' '.join(f'({group}),' for group in groups)})")


def _store(outputs: tuple[int, ...], row: int) -> Callable[..., Any]:
    """The function that writes a vehicle's groups into a tile, from a row on."""
    lines, first = [], row
    for group, size in enumerate(outputs):
        for k in range(size):
            lines.append(f"    tile[{row}, place] = groups[{group}][{k}]")
            row += 1
    name = "_".join(map(str, ("store", first, *outputs)))
    return _written(name, f"def {name}(tile, place, groups):\n" + "\n".join(lines))


def _written(name: str, source: str) -> Callable[..., Any]:
    """The function of a source text: only tuples that are written out have types that the compiler knows."""
    # Whenever Numba looks for machine code, it looks for the home of its functions: in all modules, if they name none.
    scope: dict[str, Any] = {"__name__": __name__}
    exec(source, scope)
    function: Callable[..., Any] = formula(scope[name])
    return function
