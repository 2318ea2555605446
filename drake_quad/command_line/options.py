"""Command-line options that several commands share, and functions that evaluate them."""

import argparse
import importlib
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, get_args

from drake_quad import InputError, Scenario, load_scenario
from drake_quad.command_line.default_outputs import Origin, reserve
from drake_quad.command_line.output import remark
from drake_quad.command_line.parser import Parser
from drake_quad.errors import did_you_mean, join_names
from drake_quad.extras import import_extra
from drake_quad.flight.remarks import replaced_distributions
from drake_quad.laboratory.metrics import metric_definitions
from drake_quad.number_parsing import parse_float, parse_int
from drake_quad.scenario.files.loading import Override, load_undesigned
from drake_quad.scenario.models import NAME, Mission
from drake_quad.user_code import describe_error
from drake_quad.visualization.style import Vector


def parser_without_options(description: str | None, example: str) -> argparse.ArgumentParser:
    """Return a parser without options.

    Args:
        description: description of the command.
        example: complete command line, such as `drake-quad fly slalom`. Its first two words name the command.
    """
    result = Parser(
        prog=" ".join(example.split()[:2]),
        description=description,
        epilog=f"example: {example}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.register("type", int, parse_int)
    result.register("type", float, parse_float)
    return result


def parser(
    description: str | None, example: str, *, output: str, scenario: str = "figure_eight"
) -> argparse.ArgumentParser:
    """Return a parser with the scenario, its overrides and the output folder as options.

    Args:
        description: description of the command.
        example: complete command line, such as `drake-quad fly slalom`. Its first two words name the command.
        output: folder in which the default output folder is created. The latter is named after the scenario.
        scenario: name of the default scenario.
    """
    result = parser_without_options(description, example)
    help_text = "FILE or FILE:NAME, or the name of a shipped scenario (default: %(default)s)"
    result.add_argument("scenario", nargs="?", default=scenario, help=help_text)
    add_overrides(result)
    result.set_defaults(default_output=Path(output))
    result.add_argument(
        "--output",
        type=Path,
        metavar="FOLDER",
        help=f"output folder (default: {output}/NAME with the name of the scenario; required if this folder contains"
        " results for another vehicle)",
    )
    return result


def add_overrides(options: argparse.ArgumentParser) -> None:
    """Add the options that override fields of the scenario."""
    options.add_argument(
        "--set",
        metavar="FIELD=VALUE",
        action="append",
        default=[],
        help="override a field, as in nominal.mass=0.7 or route.waypoints.2=[1,0,1]; can be given several times",
    )
    options.add_argument(
        "--import",
        metavar="FILE.py",
        action=_Import,
        dest="imports",
        default=[],
        help="Python file to run first, for example to register a kind of wind; can be given several times",
    )
    options.add_argument("--seed", type=int, help="seed of all random numbers (default: seed of the scenario)")


class _Import(argparse.Action):
    """Action that imports a Python file while the options are parsed, before any scenario is loaded."""

    def __call__(self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, *values: Any) -> None:
        path = Path(values[0])
        namespace.imports = [*namespace.imports, path]
        try:
            import_file(path)
        except InputError as error:
            raise InputError(f"--import {error}") from error


def import_file(path: Path, *, again: bool = True) -> ModuleType:
    """Import a Python file of the user.

    The folder of the file is added to the search path. Worker processes inherit this path and find the module as well.

    Args:
        path: path of the file.
        again: True to reload a module that is already imported, and thus create its classes again.

    Raises:
        InputError: if the path is not a Python file, the file raises an error, or another module has the same name.
    """
    if path.suffix != ".py" or not path.is_file():
        raise InputError(f"{path} is not an existing Python file")
    loaded = sys.modules.get(path.stem)
    if loaded is not None and getattr(loaded, "__file__", None) != str(path.resolve()):
        raise InputError(f"{path}: another module is also called {path.stem}; rename the file")
    if loaded is not None and not again:
        return loaded
    sys.path.insert(0, str(path.parent.resolve()))
    try:
        return importlib.import_module(path.stem) if loaded is None else importlib.reload(loaded)
    except Exception as error:
        raise InputError(describe_error(error)) from error


def resolve_output_folder(
    arguments: argparse.Namespace, scenario: Mission, *, name: str | None = None, others: Sequence[Origin] = ()
) -> Path:
    """Return the output folder: the value of `--output`, or by default a folder with the name of the scenario.

    Args:
        arguments: arguments of the command, with the FILE or FILE:NAME of the scenario.
        scenario: scenario with all overrides.
        name: name of the default folder; by default the name of the scenario.
        others: inputs of the command besides the scenario.

    Raises:
        InputError: if the default folder was written for another vehicle with the same name, or for other inputs.
    """
    if arguments.output is not None:
        return Path(arguments.output)
    folder = arguments.default_output / (name or scenario.name)
    return reserve(folder, [Origin.of_scenario(arguments.scenario, scenario), *others])


def add_stability_limits(options: argparse.ArgumentParser, sensitivity: float, delay_margin: float) -> None:
    """Add the options for the stability limits of a designed loop, with their default values.

    Args:
        options: parser of the command.
        sensitivity: largest peak sensitivity.
        delay_margin: smallest delay margin, s.
    """
    options.add_argument(
        "--sensitivity",
        type=float,
        default=sensitivity,
        metavar="PEAK",
        help="largest peak sensitivity max |S| (default: %(default)s)",
    )
    options.add_argument(
        "--delay-margin",
        type=float,
        default=delay_margin,
        metavar="SECONDS",
        help="smallest delay margin, s (default: %(default)s)",
    )


def add_vector(options: argparse.ArgumentParser) -> None:
    """Add the option that writes figures in a vector format for print."""
    options.add_argument("--vector", choices=get_args(Vector), help="also write each figure in this vector format")


def check_ranges(arguments: argparse.Namespace, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Check that the given values are within their ranges.

    Args:
        arguments: arguments of the command.
        ranges: smallest and largest value of each option, by the name of the option without leading dashes.

    Raises:
        InputError: if a value is out of its range.
    """
    for option, (minimum, maximum) in ranges.items():
        value = getattr(arguments, option.replace("-", "_"))
        if value is not None and not minimum <= value <= maximum:
            name = option.replace("_", "-")
            raise InputError(f"--{name} is {value:.15g}, but must be between {minimum:.15g} and {maximum:.15g}")


def check_metric(
    scenario: Scenario, name: str, allowed: Sequence[str] | None = None, *, option: str = "--metric"
) -> None:
    """Raise InputError if an option does not name one of the allowed metrics. By default, all metrics are allowed."""
    names = [*metric_definitions(scenario.metrics_type)] if allowed is None else [*allowed]
    if name not in names:
        known = did_you_mean(name, names, 1) or f"choose one of {join_names(names)}"
        raise InputError(f"{option}: {name} is not a metric of {scenario.name}; {known}")


def add_wired(options: argparse.ArgumentParser) -> None:
    """Add the option that simulates diagrams without compiling them."""
    options.add_argument(
        "--wired",
        action="store_true",
        help="simulate the Drake diagrams without compiling them to machine code, which is slower",
    )


def parse_overrides(assignments: Iterable[str], option: str = "--set") -> list[Override]:
    """Return overrides for assignments such as `vehicle.mass=0.7`. Their error messages name the option."""
    return [Override(assignment, f"{option} {assignment}") for assignment in assignments]


def overrides_from_arguments(arguments: argparse.Namespace) -> list[Override]:
    """Return the overrides from the options `--set` and `--seed`."""
    seed = [] if arguments.seed is None else [Override(f"seed={arguments.seed}", f"--seed {arguments.seed}")]
    return [*parse_overrides(arguments.set), *seed]


def add_controller(options: argparse.ArgumentParser, *, several: str | None = None) -> None:
    """Add the option that names the controller.

    Args:
        options: options of a command.
        several: help text on the use of several controllers; None if the command accepts only one controller.
    """
    help_text = (
        "controller that replaces the controller of the scenario: a controller in YAML as FILE:NAME, a Drake system in"
        " Python as FILE.py:CLASS, or a folder with exported C code; assignments as for --set may follow, as in"
        " 'mine.py:Mine control.position.k_p=2'"
    )
    if several is None:
        options.add_argument("--controller", metavar="FILE:NAME", help=help_text)
    else:
        options.add_argument(
            "--controller", metavar="FILE:NAME", action="append", default=[], help=f"{help_text}; {several}"
        )


class NamedController(NamedTuple):
    """Controller that `--controller` names.

    Attributes:
        name: short name of the controller.
        layers: scenario files that are merged over the scenario.
        overrides: overrides of scenario fields. Overrides by `--set` take precedence over them.
        assignments: overrides that follow the controller in the option. They take precedence over `--set`.
    """

    name: str
    layers: tuple[str, ...] = ()
    overrides: tuple[Override, ...] = ()
    assignments: tuple[Override, ...] = ()

    def load(self, spec: str, overrides: Iterable[Override], load: Callable[..., Scenario] = load_scenario) -> Scenario:
        """Return a scenario with this controller.

        Args:
            spec: FILE or FILE:NAME of the scenario.
            overrides: further overrides of the scenario.
            load: function that loads the scenario.
        """
        return load(spec, [*self.overrides, *overrides, *self.assignments], layers=self.layers)


def parse_controller(spec: str, scenario: str, machine: str = "host") -> NamedController:
    """Return the controller that `--controller` names.

    Args:
        spec: value of the option: FILE:NAME, FILE.py:CLASS or a folder with exported code, optionally followed by
            assignments such as `control.position.k_p=2`.
        scenario: scenario that will use the controller. A position controller in Python keeps the scenario's
            feed-forward.
        machine: computer that runs exported code, a key of `drake_quad.exported.machines.MACHINES`.

    Raises:
        InputError: if the file or the class does not exist, or is not a controller.
    """
    spec, *assignments = re.split(_ASSIGNMENT_SEPARATOR, spec.strip())
    found = _controller_without_assignments(spec, scenario, machine)
    values = [f"_{path.split('.')[-1]}_{value}" for path, _, value in (each.partition("=") for each in assignments)]
    suffix = re.sub(r"[^A-Za-z0-9.-]+", "_", "".join(values)).rstrip("_")
    return found._replace(
        name=found.name + suffix, assignments=tuple(parse_overrides(assignments, f"--controller {spec}"))
    )


# Space between the name of a controller and the assignments of fields that follow it.
_ASSIGNMENT_SEPARATOR = r"\s+(?=[\w.]+=)"


def _controller_without_assignments(spec: str, scenario: str, machine: str) -> NamedController:
    """Return the controller that `--controller` names before any assignments.

    The arguments are as in `parse_controller`.
    """
    if Path(spec).is_dir():
        return _exported_controller(spec, machine)
    if machine != "host":
        raise InputError(f"--on {machine} needs --controller FOLDER, with a folder that `drake-quad export` wrote")
    if spec.endswith(".py"):
        raise InputError(f"--controller {spec}: give the class of the controller as well, as in {spec}:CLASS")
    file, _, name = spec.rpartition(":")
    if not file.endswith(".py"):
        return NamedController(Path(name).stem, layers=(spec,))
    # Modules with systems take half a second to import, so they are imported only when they are needed.
    from drake_quad.assembly.registered_controllers import register_controller
    from drake_quad.scenario.controls.control import CONTROLS

    option = f"--controller {spec}"
    try:
        module = import_file(Path(file), again=False)
        if not hasattr(module, name):
            classes = [each for each, value in vars(module).items() if isinstance(value, type)]
            question = did_you_mean(name, classes, 1)
            raise InputError(f"{file} has no class {name}{f'; {question}' if question else ''}")
        kind = register_controller(getattr(module, name))
    except InputError as error:
        raise InputError(f"{option}: {error}") from error
    control = load_undesigned(scenario).control
    cascade = control.cascade()
    if kind in (control.kind, None if cascade is None else cascade.position.kind):
        return NamedController(name)  # the scenario already has parameters of this controller
    if CONTROLS.get(kind) is not None:
        return NamedController(name, overrides=(Override(f"control={{kind: {kind}}}", option),))
    feed_forward = "none" if cascade is None else cascade.position.feed_forward
    position = f"control.position={{kind: {kind}, feed_forward: {feed_forward}}}"
    return NamedController(name, overrides=(Override(position, option), Override("control.network=null", option)))


def _exported_controller(folder: str, machine: str) -> NamedController:
    """Return the controller with the exported code in a folder."""
    from drake_quad.assembly.registered_controllers import register_controller
    from drake_quad.exported.system import exported_controller

    option = f"--controller {folder}"
    try:
        kind = register_controller(exported_controller(folder, machine))
    except InputError as error:
        raise InputError(f"{option}: {error}") from error
    return NamedController(Path(folder).name, overrides=(Override(f"control={{kind: {kind}}}", option),))


def named_controllers(specs: Sequence[str], scenario: str) -> dict[str, NamedController]:
    """Return the controllers that several options `--controller` name, and make their names unique.

    If the short name of a controller is already in use, the name of its file precedes it, as in `laboratory_pd`.

    Args:
        specs: values of the options.
        scenario: scenario that will use the controllers.

    Raises:
        InputError: if a controller is given twice or cannot be loaded, or two names are still equal.
    """
    controllers: dict[str, NamedController] = {}
    for spec in specs:
        if spec in controllers:
            raise InputError(f"--controller {spec} is given twice")
        names, controller = [each.name for each in controllers.values()], parse_controller(spec, scenario)
        if controller.name in names:
            file = Path(re.split(_ASSIGNMENT_SEPARATOR, spec)[0].rpartition(":")[0]).stem
            controller = controller._replace(name=f"{file}_{controller.name}".lstrip("_"))
        if controller.name in names:
            raise InputError(
                f"--controller {spec}: another controller is also called {controller.name}; rename one of them"
            )
        controllers[spec] = controller
    return controllers


def scenario_from_arguments(
    arguments: argparse.Namespace,
    *,
    extra_overrides: Sequence[Override] = (),
    load: Callable[..., Scenario] = load_scenario,
) -> Scenario:
    """Load the scenario that the arguments name, with the controller of `--controller` and all overrides.

    Args:
        arguments: arguments of the command.
        extra_overrides: overrides in addition to the overrides in the arguments.
        load: function that loads the scenario.
    """
    spec = getattr(arguments, "controller", None)
    machine = getattr(arguments, "on", "host")
    if machine != "host" and not spec:
        raise InputError(f"--on {machine} needs --controller FOLDER, with a folder that `drake-quad export` wrote")
    controller = NamedController("") if not spec else parse_controller(spec, arguments.scenario, machine)
    own_overrides = overrides_from_arguments(arguments)
    scenario = controller.load(arguments.scenario, [*own_overrides, *extra_overrides], load)
    if spec and not extra_overrides:
        remark_replaced_distributions(f"--controller {spec}", arguments.scenario, scenario, own_overrides)
    return scenario


def remark_replaced_distributions(
    controller: str, spec: str, controlled: Scenario, overrides: Sequence[Override]
) -> None:
    """Print a remark if a controller replaces random parameters of a scenario by fixed values.

    Args:
        controller: name of the controller in the remark.
        spec: FILE or FILE:NAME of the scenario.
        controlled: scenario with the controller and the overrides.
        overrides: overrides of the scenario, without those of the controller.
    """
    # Overrides of `control` are left out, since they may name fields that only the new controller has.
    fields = tuple(override.assignment.partition("=")[0].strip() for override in overrides)
    others = [each for each, field in zip(overrides, fields, strict=True) if not field.startswith("control")]
    with suppress(InputError):  # the scenario may be incomplete without the controller
        replaced = replaced_distributions(load_undesigned(spec, others), controlled, ignored=fields)
        if replaced:
            remark(f"{controller} replaces random parameters of {spec} by fixed values: {replaced}")


def controlled_scenarios(arguments: argparse.Namespace, spec: str | None = None) -> dict[str, Scenario]:
    """Load a scenario with each of the controllers that `--controller` names, or unchanged if it names none.

    Args:
        arguments: arguments with the controllers and overrides.
        spec: FILE or FILE:NAME of the scenario; by default `arguments.scenario`.

    Returns:
        The scenario with each controller, by the controller's name; or the unchanged scenario, by the scenario's name.
    """
    spec = spec or arguments.scenario
    overrides = overrides_from_arguments(arguments)
    if not arguments.controller:
        scenario = load_scenario(spec, overrides)
        return {scenario.name: scenario}
    scenarios: dict[str, Scenario] = {}
    for each, controller in named_controllers(arguments.controller, spec).items():
        name = controller.name
        if not re.fullmatch(NAME, name):
            raise InputError(f"--controller {each}: {name!r} cannot be the name of a folder; rename the controller")
        scenarios[name] = controller.load(spec, overrides)
        remark_replaced_distributions(f"--controller {each}", spec, scenarios[name], overrides)
    return scenarios


def check_extra(option: str, extra: str, *modules: str) -> None:
    """Check that the modules that an option needs are installed.

    Args:
        option: option of a command, for the message.
        extra: name of the package's extra that installs the modules.
        modules: names of the modules.

    Raises:
        InputError: if a module is not installed.
    """
    try:
        for module in modules:
            import_extra(module, extra)
    except ImportError as error:
        raise InputError(f"{option}: {error}") from None
