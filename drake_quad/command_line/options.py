"""What the options of all commands share."""

import argparse
import importlib
import re
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, get_args

from drake_quad import InputError, Scenario, load_scenario
from drake_quad.extras import import_extra
from drake_quad.scenario.files.loading import Override
from drake_quad.scenario.models import NAME
from drake_quad.visualization.style import Vector
from drake_quad.written_numbers import float_in, int_in


def bare_parser(description: str | None, example: str) -> argparse.ArgumentParser:
    """Return a parser without options.

    Args:
        description: sentence that says what the command does.
        example: complete command line that runs, whose first two words are those of the command.
    """
    result = argparse.ArgumentParser(
        prog=" ".join(example.split()[:2]),
        description=description,
        epilog=f"example: {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.register("type", int, int_in)
    result.register("type", float, float_in)
    return result


def parser(
    description: str | None, example: str, *, output: str, scenario: str = "figure_eight"
) -> argparse.ArgumentParser:
    """Return a parser with the options of a command for a scenario.

    Args:
        description: as for `bare_parser`.
        example: as for `bare_parser`.
        output: folder that by default contains a folder for each scenario.
        scenario: name of the default scenario, which is shipped.
    """
    result = bare_parser(description, example)
    help_ = "FILE or FILE:NAME, or a shipped one by its name (default: %(default)s)"
    result.add_argument("scenario", nargs="?", default=scenario, help=help_)
    add_overrides(result)
    result.set_defaults(default_output=Path(output))
    result.add_argument(
        "--output", type=Path, metavar="FOLDER", help=f"to write to (default: {output}/NAME, after the scenario)"
    )
    return result


def add_overrides(options: argparse.ArgumentParser) -> None:
    """Adds the options that give fields other values."""
    options.add_argument(
        "--set",
        metavar="FIELD=VALUE",
        action="append",
        default=[],
        help="override a field, as in nominal.mass=0.7 or route.waypoints.2=[1,0,1]",
    )
    options.add_argument(
        "--import",
        metavar="FILE.py",
        action=_Import,
        dest="imports",
        default=[],
        help="run a Python file of yours first, such as one that registers a kind of wind; can be given several times",
    )
    options.add_argument("--seed", type=int, help="seed of everything random (default: the scenario's)")


class _Import(argparse.Action):
    """Imports a Python file when the option is parsed, before any scenario is loaded."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, *given: Any) -> None:
        path = Path(given[0])
        namespace.imports = [*namespace.imports, path]
        if path.suffix != ".py" or not path.is_file():
            parser.error(f"--import {path}: is not a Python file")
        loaded = sys.modules.get(path.stem)
        if loaded is not None and getattr(loaded, "__file__", None) != str(path.resolve()):
            parser.error(f"--import {path}: another module is called {path.stem}; rename the file")
        # Worker processes inherit the search path, so that they find the module as well.
        sys.path.insert(0, str(path.parent.resolve()))
        try:
            importlib.import_module(path.stem) if loaded is None else importlib.reload(loaded)
        except Exception as error:
            parser.error(f"--import {path}: {type(error).__name__}: {error}")


def folder_of(arguments: argparse.Namespace, name: str) -> Path:
    """The folder to write to: that of --output, or else the default one for a scenario of this name."""
    chosen: Path = arguments.output or arguments.default_output / name
    return chosen


def add_vector(options: argparse.ArgumentParser) -> None:
    """Adds the option that writes figures for print."""
    options.add_argument("--vector", choices=get_args(Vector), help="write each figure also as a vector drawing")


def check_ranges(arguments: argparse.Namespace, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Raise InputError if a given number is out of its range; ranges are by option, without its leading dashes."""
    for option, (least, most) in ranges.items():
        value = getattr(arguments, option.replace("-", "_"))
        if value is not None and not least <= value <= most:
            raise InputError(f"--{option} is {value:g}, but must be between {least:g} and {most:g}")


def add_wired(options: argparse.ArgumentParser) -> None:
    """Add the option to simulate diagrams without compiling them."""
    options.add_argument(
        "--wired",
        action="store_true",
        help="simulate diagrams without compiling them to machine code, which is slower",
    )


def overrides_of(assignments: Iterable[str], option: str = "--set") -> list[Override]:
    """The overrides that an option of the command line asks for; errors will name the option."""
    return [Override(assignment, f"{option} {assignment}") for assignment in assignments]


def all_overrides_of(arguments: argparse.Namespace) -> list[Override]:
    """The overrides that --set and --seed ask for."""
    seed = [] if arguments.seed is None else [Override(f"seed={arguments.seed}", f"--seed {arguments.seed}")]
    return [*overrides_of(arguments.set), *seed]


def scenario_of(arguments: argparse.Namespace, *, further: Sequence[Override] = ()) -> Scenario:
    """Loads the scenario that the arguments name, with the overrides that they ask for and further ones."""
    return load_scenario(arguments.scenario, [*all_overrides_of(arguments), *further])


def controlled_scenarios(arguments: argparse.Namespace) -> dict[str, Scenario]:
    """Loads the scenario once for each --controller, which is laid over it; without any, as it is.

    Returns:
        The scenarios, by the names of the controllers; or the only one, by its own.
    """
    if not arguments.controller:
        scenario = scenario_of(arguments)
        return {scenario.name: scenario}
    overrides = all_overrides_of(arguments)
    found: dict[str, Scenario] = {}
    for controller in arguments.controller:
        name = Path(controller.rpartition(":")[2]).stem
        if not re.fullmatch(NAME, name):
            raise InputError(f"--controller {controller}: {name!r} is no name for a folder; use letters and digits")
        if name in found:
            raise InputError(f"--controller {controller}: {name} is to be flown already; give each its own name")
        found[name] = load_scenario(arguments.scenario, overrides, layers=[controller])
    return found


def check_extra(option: str, extra: str, *modules: str) -> None:
    """Raises InputError if an option needs a module of an extra that is not installed."""
    try:
        for module in modules:
            import_extra(module, extra)
    except ImportError as error:
        raise InputError(f"{option}: {error}") from None
