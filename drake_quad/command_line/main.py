"""Command `drake-quad` and its subcommands, each of which is loaded only when it runs."""

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

# Commands with their descriptions, by purpose.
COMMANDS_BY_PURPOSE = {
    "fly": {
        "fly": "fly one scenario: metrics, signals, plots, a replay",
        "live": "fly in the browser in real time, and change wind, mass and gains meanwhile",
        "replay": "replay a hundred samples in one scene, or controllers side by side",
        "scenarios": "list the shipped scenarios, or print one in full",
        "draw": "draw the block diagram of a scenario",
        "plan": "plan a minimum-snap route through waypoints, gates and corridors",
    },
    "study and compare": {
        "study": "fly thousands of samples of a scenario, and summarise their metrics",
        "compare": "fly several controllers in several laboratories on the same samples",
        "sensitivities": "differentiate the metrics of a flight by numbers of its scenario",
        "judge": "tune and judge the field's controllers by one protocol, with a report",
    },
    "design": {
        "design": "design the gains of the cascade, and state their margins",
        "design-lqg": "design linear-quadratic-Gaussian control, and state its margins",
        "tune": "tune any numbers of a controller by flights, under a limit on its loops",
        "map": "map which gains are stable",
    },
    "use flight logs": {
        "identify": "identify a vehicle, with its uncertainty, from flight logs",
        "identify-controller": "identify the position law that flew a log, as a controller",
        "compare-log": "fly the reference of a flight log again, and compare errors flown and predicted",
    },
    "more": {
        "replicate": "fly the paper's experiment again, with a report",
        "completion": "print what completes commands in a shell",
    },
}
COMMANDS = {name: words for commands in COMMANDS_BY_PURPOSE.values() for name, words in commands.items()}

_GC_THRESHOLD = 50_000  # new objects between two collections; Python's default is 2,000 or fewer
_WORDS = "A Drake laboratory for quadrotor tracking control."


def main(*before: str) -> None:
    """Run `drake-quad` with the arguments of this process, and exit.

    Args:
        before: arguments in front of those of the process, as in `main("fly")`.
    """
    # Libraries and scenarios consist of hundreds of thousands of objects that live until the end. With Python's default
    # thresholds, the garbage collector visits them again and again, and at exit once more: half a second per command.
    gc.set_threshold(_GC_THRESHOLD, 20, 50)
    atexit.register(gc.freeze)
    # On small matrices two threads can take a hundred times as long as one. NumPy and SciPy read this when loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # From this import on, Ctrl-C ends the command without a traceback.
    from drake_quad.command_line.running import orderly_exit, run

    with orderly_exit():
        arguments = [*before, *sys.argv[1:]]
        if not arguments:
            _parser().print_help()
            sys.exit()
        command = _parser().parse_args(arguments[:1]).command
        module = module_of(command)
        options = module.options().parse_args(arguments[1:])
        options.command = shlex.join(["drake-quad", *arguments])
    run(lambda: module.main(options))


def module_of(command: str) -> ModuleType:
    """Return the module with the `options` and the `main` of a command."""
    return import_module(f"drake_quad.command_line.{command.replace('-', '_')}")


def _parser() -> argparse.ArgumentParser:
    width = max(map(len, COMMANDS))
    lines = "\n\n".join(
        "\n".join([f"{purpose}:", *(f"  {name:<{width}}  {words}" for name, words in commands.items())])
        for purpose, commands in COMMANDS_BY_PURPOSE.items()
    )
    result = argparse.ArgumentParser(
        prog="drake-quad",
        usage="drake-quad COMMAND ...",
        description=_WORDS,
        epilog=f"{lines}\n\n`drake-quad COMMAND --help` has more; example: drake-quad fly figure_eight",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    result.add_argument("--version", action="version", version=_versions(), help="print versions, and exit")
    result.add_argument("command", metavar="COMMAND", choices=COMMANDS, help="one of those below")
    return result


def _versions() -> str:
    """Return the versions of the packages on which results depend."""
    return f"drake_quad {__version__} (Drake {version('drake')}, NumPy {version('numpy')}, Python {python_version()})"


def full_parser(complete: Callable[[argparse.Action], None] = lambda _: None) -> argparse.ArgumentParser:
    """Return a parser with the options of all commands, for completion and documentation.

    Building it takes a few seconds, since it loads all commands.

    Args:
        complete: function that is called with each argument of each command.
    """
    result = argparse.ArgumentParser(prog="drake-quad", description=_WORDS)
    result.add_argument("--version", action="version", version=__version__, help="print versions, and exit")
    commands = result.add_subparsers(metavar="COMMAND", required=True)
    for name, words in COMMANDS.items():
        options: argparse.ArgumentParser = module_of(name).options()
        for action in options._actions:
            complete(action)
        commands.add_parser(name, help=words, description=options.description, parents=[options], add_help=False)
    return result
