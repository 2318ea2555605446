"""Contenders of a comparison, each of which is measured in a process of its own."""

import importlib.util
import multiprocessing
import os
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

from drake_quad.command_line.options import bare_parser
from drake_quad.command_line.output import remark


class Contender(NamedTuple):
    """Simulator, or an environment of it, with the settings with which it is measured.

    Attributes:
        package: name of its package on PyPI.
        how: its settings in words, for the table.
        build: function that returns, for a number of vehicles, a function without arguments whose calls are timed.
        repetitions: number of measurements.
    """

    package: str
    how: str
    build: Callable[[int], Callable[[], Any]]
    repetitions: int = 5


def is_quick(description: str | None, example: str, quick: str) -> bool:
    """Read the command line of a comparison, and return whether it has the option `--quick`."""
    options = bare_parser(description, example)
    options.add_argument("--quick", action="store_true", help=quick)
    return bool(options.parse_args().quick)


def installed(contenders: Sequence[Contender]) -> list[Contender]:
    """Return the contenders whose packages are installed, and print a remark on each other package."""
    there = [each for each in contenders if importlib.util.find_spec(each.package)]
    for package in sorted({each.package for each in contenders} - {each.package for each in there}):
        remark(f"{package} is not installed, so it is not measured")
    os.environ["SCIPY_ARRAY_API"] = "1"  # crazyflow needs it from the first import of SciPy on
    return there


def apart(work: Callable[[], Any]) -> Any:
    """Return the result of a function that is called in a process of its own, whose output is discarded."""
    context = multiprocessing.get_context("spawn")
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(1, mp_context=context, initializer=_silence, initargs=(folder,)) as pool,
    ):
        return pool.submit(work).result()


def _silence(folder: str) -> None:
    """Discard what libraries print, and have them write their logs, such as that of MuJoCo, into a folder."""
    os.chdir(folder)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)
