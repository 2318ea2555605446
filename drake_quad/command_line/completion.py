"""Print a shell script that completes commands, options, files and the names of shipped scenarios.

For bash, add `source <(drake-quad completion bash)` to ~/.bashrc. For zsh, write the script to a file called
_drake-quad in a folder of $fpath.
"""

import argparse
from pathlib import Path

import shtab

from drake_quad.command_line.options import parser_without_options
from drake_quad.scenario.files.shipped import shipped_scenarios

# Arguments whose values are completed with the names of shipped scenarios.
_SCENARIO_ARGUMENTS = ("scenario", "controller", "vehicle")
# Names of scenarios contain colons. Colons are removed from COMP_WORDBREAKS, since Bash would end a word at a colon.
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
    result = parser_without_options(__doc__, "drake-quad completion bash")
    result.add_argument("shell", choices=("bash", "zsh"), help="shell for which the script is printed")
    return result


def main(arguments: argparse.Namespace) -> None:
    from drake_quad.command_line.main import full_parser

    names = shipped_scenarios()
    preamble = _PREAMBLE[arguments.shell].format(
        names=" ".join(names), escaped=" ".join(name.replace(":", r"\:") for name in names)
    )
    print(shtab.complete(full_parser(_complete), arguments.shell, preamble=preamble))


def _complete(action: argparse.Action) -> None:
    """Set the attribute that tells shtab how to complete an argument."""
    function = "_drake_quad_scenarios"
    if action.dest in _SCENARIO_ARGUMENTS:
        action.complete = {"bash": function, "zsh": function}  # type: ignore[attr-defined]
    elif action.metavar == "FOLDER":
        action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
    elif action.type is Path or action.metavar == "FILE":
        action.complete = shtab.FILE  # type: ignore[attr-defined]
