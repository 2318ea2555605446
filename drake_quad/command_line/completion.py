"""Prints a script by which a shell completes commands, options, files and the names of shipped scenarios.

For bash, add `source <(drake-quad completion bash)` to ~/.bashrc; for zsh, write it to a file called _drake-quad in a
folder of $fpath.
"""

import argparse
from pathlib import Path

import shtab

from drake_quad.command_line.options import bare_parser
from drake_quad.scenario.files.shipped import shipped_scenarios

# Arguments that are completed with the names of scenarios.
_SCENARIOS = ("scenario", "controller", "vehicle")
# Names contain colons, and bash ends a word at a colon unless COMP_WORDBREAKS lacks it.
_PREAMBLE = {
    "bash": """COMP_WORDBREAKS=${{COMP_WORDBREAKS//:}}
_drake_quad_scenarios() {{
  compgen -W "{names}" -- "$1"
  compgen -f -- "$1"
}}
""",
    "zsh": """_drake_quad_scenarios() {{
  _alternative 'files:file:_files' 'scenarios:scenario:({escaped})'
}}
""",
}


def options() -> argparse.ArgumentParser:
    """Return the options of the command."""
    result = bare_parser(__doc__, "drake-quad completion bash")
    result.add_argument("shell", choices=("bash", "zsh"), help="whose script to print")
    return result


def main(arguments: argparse.Namespace) -> None:
    """Run the command."""
    from drake_quad.command_line.main import full_parser

    names = shipped_scenarios()
    preamble = _PREAMBLE[arguments.shell].format(
        names=" ".join(names), escaped=" ".join(name.replace(":", r"\:") for name in names)
    )
    print(shtab.complete(full_parser(_complete), arguments.shell, preamble=preamble))


def _complete(action: argparse.Action) -> None:
    """Set the completion of an argument as shtab expects it."""
    own = "_drake_quad_scenarios"
    if action.dest in _SCENARIOS:
        action.complete = {"bash": own, "zsh": own}  # type: ignore[attr-defined]
    elif action.metavar == "FOLDER":
        action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
    elif action.type is Path or action.metavar == "FILE":
        action.complete = shtab.FILE  # type: ignore[attr-defined]
