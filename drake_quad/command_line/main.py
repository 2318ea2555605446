"""Command `drake-quad` and its subcommands, whose modules are loaded only when they run."""

import argparse
import atexit
import gc
import os
import shlex
import sys
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version
from platform import python_version
from types import ModuleType

from drake_quad import __version__
from drake_quad.command_line.parser import Parser

# Description of each command, by purpose and name.
COMMANDS_BY_PURPOSE = {
    "fly": {
        "fly": "fly one scenario, and write metrics, signals, plots and a replay",
        "live": "fly in the browser in real time, with sliders for wind, mass and gains",
        "replay": "replay many samples, or several controllers, in one scene",
        "scenarios": "list the shipped scenarios, or print one in full",
        "draw": "draw the block diagram of a scenario",
        "plan": "plan a minimum-snap route through waypoints, gates and corridors",
    },
    "study and compare": {
        "study": "fly thousands of samples of a scenario, and summarise their metrics",
        "risk": "estimate the probability of a rare event, and find the worst samples",
        "falsify": "search for the worst case of a scenario",
        "certify": "certify the range of parameters in which hover is stable",
        "sobol": "attribute the variance of a metric to the random parameters",
        "compare": "fly several controllers in several laboratories on the same samples",
        "sensitivities": "differentiate the metrics of a flight with respect to fields of its scenario",
        "judge": "tune and compare state-of-the-art controllers by one protocol, with a report",
    },
    "design": {
        "design": "design the gains of the cascade, and print the stability margins",
        "design-lqg": "design a linear-quadratic-Gaussian controller, and print its margins",
        "tune": "tune parameters of a controller by simulated flights, under a limit on its margins",
        "map": "map stability and errors over two gains, or flights over two other fields",
    },
    "take to hardware": {
        "export": "write the controller of a scenario as C code",
        "offboard": "fly a real vehicle that has PX4 or ArduPilot over MAVLink",
    },
    "use flight logs": {
        "identify": "identify a vehicle and its uncertainty from flight logs",
        "identify-controller": "identify the position law of a controller from flight logs",
        "estimate": "run a state estimator on the inertial sensors of flight logs",
        "compare-log": "fly the reference of a log in simulation, and compare measured and predicted errors",
    },
    "more": {
        "replicate": "repeat the experiment of the paper, and write a report",
        "completion": "print a script with which a shell completes commands",
    },
}
COMMANDS = {name: text for commands in COMMANDS_BY_PURPOSE.values() for name, text in commands.items()}

_GC_THRESHOLD = 50_000  # new objects between two garbage collections; Python's default is 2,000 or fewer
_DESCRIPTION = "A Drake laboratory for quadrotor tracking control."


def main(*first_arguments: str) -> None:
    """Run `drake-quad` with the arguments of this process, and exit.

    Args:
        first_arguments: arguments that precede the arguments of the process, as in `main("fly")`.
    """
    # Libraries and scenarios consist of hundreds of thousands of objects that live until the end of the process. With
    # Python's default thresholds, the garbage collector visits them repeatedly, which takes half a second per command.
    gc.set_threshold(_GC_THRESHOLD, 20, 50)
    atexit.register(gc.freeze)
    # Two BLAS threads can take a hundred times as long as one for small matrices. NumPy and SciPy read this variable
    # when they are imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # The import of `running` makes Ctrl-C end the command without a traceback.
    from drake_quad.command_line.running import orderly_exit, run

    with orderly_exit():
        arguments = [*first_arguments, *sys.argv[1:]]
        if not arguments:
            _parser().print_help()
            sys.exit()
        command = _parser().parse_args(arguments[:1]).command
        module = command_module(command)
        options = module.options().parse_args(arguments[1:])
        options.command = shlex.join(["drake-quad", *arguments])
    run(lambda: module.main(options))


def command_module(command: str) -> ModuleType:
    """Return the module of a command, with its functions `options` and `main`."""
    return import_module(f"drake_quad.command_line.{command.replace('-', '_')}")


def _parser() -> argparse.ArgumentParser:
    width = max(map(len, COMMANDS))
    lines = "\n\n".join(
        "\n".join([f"{purpose}:", *(f"  {name:<{width}}  {description}" for name, description in commands.items())])
        for purpose, commands in COMMANDS_BY_PURPOSE.items()
    )
    result = Parser(
        prog="drake-quad",
        usage="drake-quad COMMAND ...",
        description=_DESCRIPTION,
        epilog=f"{lines}\n\n`drake-quad COMMAND --help` describes a command; example: drake-quad fly figure_eight",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.add_argument(
        "--version", action="version", version=_versions(), help="print the versions of the packages, and exit"
    )
    result.add_argument("command", metavar="COMMAND", choices=COMMANDS, help="one of the commands below")
    return result


def _versions() -> str:
    """Return a text with the versions of the packages that affect results."""
    return f"drake_quad {__version__} (Drake {version('drake')}, NumPy {version('numpy')}, Python {python_version()})"


def full_parser(complete: Callable[[argparse.Action], None] = lambda _: None) -> argparse.ArgumentParser:
    """Return a parser with the options of all commands, for completion in a shell.

    This takes a few seconds, since the modules of all commands are loaded.

    Args:
        complete: function that is called with each argument of each command.
    """
    result = argparse.ArgumentParser(prog="drake-quad", description=_DESCRIPTION)
    result.add_argument(
        "--version", action="version", version=__version__, help="print the versions of the packages and exit"
    )
    commands = result.add_subparsers(metavar="COMMAND", required=True)
    for name, description in COMMANDS.items():
        options: argparse.ArgumentParser = command_module(name).options()
        for action in options._actions:
            complete(action)
        commands.add_parser(name, help=description, description=options.description, parents=[options], add_help=False)
    return result
