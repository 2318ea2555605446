"""Options that several commands share."""

import argparse
import importlib
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, get_args

from drake_quad import InputError, Scenario, load_scenario
from drake_quad.extras import import_extra
from drake_quad.scenario.files.loading import Override, load_undesigned
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
    """Add the options that override fields of the scenario."""
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
    """Action that imports a Python file when the option is parsed, before any scenario is loaded."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, *given: Any) -> None:
        path = Path(given[0])
        namespace.imports = [*namespace.imports, path]
        try:
            import_file(path)
        except InputError as error:
            parser.error(f"--import {error}")


def import_file(path: Path, *, again: bool = True) -> ModuleType:
    """Import a Python file of the user.

    Its folder joins the search path, which worker processes inherit, so they find the module as well.

    Args:
        path: path of the file.
        again: whether a module that is imported already is imported again, which makes new classes.

    Raises:
        InputError: if it is no Python file, raises an error, or has the name of another module.
    """
    if path.suffix != ".py" or not path.is_file():
        raise InputError(f"{path}: is not a Python file")
    loaded = sys.modules.get(path.stem)
    if loaded is not None and getattr(loaded, "__file__", None) != str(path.resolve()):
        raise InputError(f"{path}: another module is called {path.stem}; rename the file")
    if loaded is not None and not again:
        return loaded
    sys.path.insert(0, str(path.parent.resolve()))
    try:
        return importlib.import_module(path.stem) if loaded is None else importlib.reload(loaded)
    except Exception as error:
        raise InputError(f"{path}: {type(error).__name__}: {error}") from error


def folder_of(arguments: argparse.Namespace, name: str) -> Path:
    """Return the output folder: the one of --output, or by default the one for a scenario of this name."""
    chosen: Path = arguments.output or arguments.default_output / name
    return chosen


def add_vector(options: argparse.ArgumentParser) -> None:
    """Add the option to write figures in a vector format for print."""
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
    """Return the overrides for the assignments of an option; error messages name the option."""
    return [Override(assignment, f"{option} {assignment}") for assignment in assignments]


def all_overrides_of(arguments: argparse.Namespace) -> list[Override]:
    """Return the overrides of --set and --seed."""
    seed = [] if arguments.seed is None else [Override(f"seed={arguments.seed}", f"--seed {arguments.seed}")]
    return [*overrides_of(arguments.set), *seed]


def add_controller(options: argparse.ArgumentParser, *, several: str | None = None) -> None:
    """Add the option that names the controller.

    Args:
        options: options of a command.
        several: phrase about the use of several controllers; None if the command takes one.
    """
    help_ = (
        "controller that replaces that of the scenario: a layer as FILE:NAME, shipped or your own, or a Drake system in"
        " Python as FILE.py:CLASS"
    )
    if several is None:
        options.add_argument("--controller", metavar="FILE:NAME", help=help_)
    else:
        options.add_argument(
            "--controller", metavar="FILE:NAME", action="append", default=[], help=f"{help_}; {several}"
        )


class NamedController(NamedTuple):
    """Controller that a command line names.

    Attributes:
        name: short name of the controller.
        layers: layers over the scenario.
        overrides: overrides of the scenario, before those of `--set`.
    """

    name: str
    layers: tuple[str, ...] = ()
    overrides: tuple[Override, ...] = ()


def controller_of(spec: str, scenario: str) -> NamedController:
    """Return the controller that `--controller` names.

    Args:
        spec: FILE:NAME, or FILE.py:CLASS.
        scenario: scenario over which it is laid, whose feed-forward a position controller in Python keeps.

    Raises:
        InputError: if the file or the class does not exist, or is no controller.
    """
    file, _, name = spec.rpartition(":")
    if not file.endswith(".py"):
        return NamedController(Path(name).stem, layers=(spec,))
    # Imported here because systems take half a second to load.
    from drake_quad.assembly.registered_controllers import register_controller
    from drake_quad.scenario.controls.control import CONTROLS

    option = f"--controller {spec}"
    try:
        module = import_file(Path(file), again=False)
        if not hasattr(module, name):
            raise InputError(f"{file} has no class {name}")
        kind = register_controller(getattr(module, name))
    except InputError as error:
        raise InputError(f"{option}: {error}") from error
    control = load_undesigned(scenario).control
    cascade = control.cascade()
    if kind in (control.kind, None if cascade is None else cascade.position.kind):
        return NamedController(name)  # the scenario has its parameters
    if CONTROLS.get(kind) is not None:
        return NamedController(name, overrides=(Override(f"control={{kind: {kind}}}", option),))
    feed_forward = "none" if cascade is None else cascade.position.feed_forward
    position = f"control.position={{kind: {kind}, feed_forward: {feed_forward}}}"
    return NamedController(name, overrides=(Override(position, option), Override("control.network=null", option)))


def scenario_of(
    arguments: argparse.Namespace,
    *,
    further: Sequence[Override] = (),
    load: Callable[..., Scenario] = load_scenario,
) -> Scenario:
    """Load the scenario that the arguments name, with its `--controller`, their overrides and further overrides."""
    spec = getattr(arguments, "controller", None)
    controller = NamedController("") if not spec else controller_of(spec, arguments.scenario)
    overrides = [*controller.overrides, *all_overrides_of(arguments), *further]
    return load(arguments.scenario, overrides, layers=controller.layers)


def controlled_scenarios(arguments: argparse.Namespace, spec: str | None = None) -> dict[str, Scenario]:
    """Load a scenario once with each `--controller`, or once as it is if there is none.

    Args:
        arguments: arguments with the controllers and overrides.
        spec: scenario; by default that of the arguments.

    Returns:
        The scenarios, by the names of the controllers; or the only one, by its own name.
    """
    spec = spec or arguments.scenario
    overrides = all_overrides_of(arguments)
    if not arguments.controller:
        scenario = load_scenario(spec, overrides)
        return {scenario.name: scenario}
    found: dict[str, Scenario] = {}
    for each in arguments.controller:
        name, layers, own = controller_of(each, spec)
        if not re.fullmatch(NAME, name):
            raise InputError(f"--controller {each}: {name!r} is no name for a folder; use letters and digits")
        if name in found:
            raise InputError(f"--controller {each}: another controller is called {name}; give each its own name")
        found[name] = load_scenario(spec, [*own, *overrides], layers=layers)
    return found


def check_extra(option: str, extra: str, *modules: str) -> None:
    """Raise InputError if an option needs a module of an extra that is not installed."""
    try:
        for module in modules:
            import_extra(module, extra)
    except ImportError as error:
        raise InputError(f"{option}: {error}") from None
