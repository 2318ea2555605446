"""Simulators and environments whose speed is compared. Each is measured in its own process."""

import importlib.util
import multiprocessing
import os
import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from typing import Any, NamedTuple

from drake_quad.command_line.options import parser_without_options
from drake_quad.command_line.output import remark


class Contender(NamedTuple):
    """Simulator or environment, with the settings of its measurement.

    Attributes:
        package: name of the package on PyPI.
        label: description of the settings in the printed table.
        build: function that takes the number of vehicles, and returns the function (without arguments) that is timed.
        repetitions: number of timed calls.
    """

    package: str
    label: str
    build: Callable[[int], Callable[[], Any]]
    repetitions: int = 5


def is_quick(description: str | None, example: str, quick: str) -> bool:
    """Read the command line of a comparison, and return whether it has the option `--quick`.

    Args:
        description: description of the comparison for the help text.
        example: example of the command for the help text.
        quick: effect of the option for the help text.
    """
    options = parser_without_options(description, example)
    options.add_argument("--quick", action="store_true", help=quick)
    return bool(options.parse_args().quick)


def installed(contenders: Sequence[Contender]) -> list[Contender]:
    """Return the contenders whose packages are installed, and print a remark for each missing package."""
    available = [each for each in contenders if importlib.util.find_spec(each.package)]
    for package in sorted({each.package for each in contenders} - {each.package for each in available}):
        remark(f"{package} is not installed, so it is not measured")
    os.environ["SCIPY_ARRAY_API"] = "1"  # crazyflow needs this before the first import of SciPy
    return available


def run_isolated(work: Callable[[], Any]) -> Any:
    """Call a function in a new process whose printed output is discarded, and return the result."""
    context = multiprocessing.get_context("spawn")
    with (
        tempfile.TemporaryDirectory() as folder,
        ProcessPoolExecutor(1, mp_context=context, initializer=_silence, initargs=(folder,)) as pool,
    ):
        return pool.submit(work).result()


def _silence(folder: str) -> None:
    """Discard the printed output of this process, and make libraries such as MuJoCo write log files into a folder."""
    os.chdir(folder)
    devnull = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(devnull, stream)
