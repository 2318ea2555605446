"""Options and workers of the commands that choose the samples themselves: `risk`, `falsify` and `sobol`."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from drake_quad import Scenario
from drake_quad.command_line.flight_remarks import print_flight_remarks
from drake_quad.command_line.options import add_controller, add_vector, parser, resolve_output_folder
from drake_quad.command_line.workers import add_workers, open_executor
from drake_quad.files import output_folder


def search_parser(description: str | None, example: str) -> argparse.ArgumentParser:
    """Return a parser with the options of all searches.

    Args:
        description: description of the command.
        example: complete command line as an example; its second word is the name of the command.
    """
    result = parser(description, example, output=f"out/{example.split()[1]}", scenario="robustness")
    add_controller(result)
    add_workers(result, task="search")
    add_vector(result)
    return result


@contextmanager
def open_search(arguments: argparse.Namespace, scenario: Scenario) -> Iterator[tuple[Path, dict[str, Any]]]:
    """Open the output folder and the workers of a search, and yield the folder and keyword arguments.

    The keyword arguments are those that all search functions accept: `compiled`, `pool`, `folder` and `resume`.
    """
    folder = output_folder(resolve_output_folder(arguments, scenario))
    print_flight_remarks([scenario])
    with open_executor(arguments) as pool:
        yield folder, {
            "compiled": not arguments.wired, "pool": pool, "folder": folder, "resume": arguments.resume
        }  # fmt: skip
