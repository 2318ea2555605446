"""Lists the scenarios that are shipped, by the names that mean them everywhere; or prints one in full.

In full means with what it extends and with all defaults: a file of one's own to begin with.
"""

import argparse
import sys
import textwrap

from drake_quad.command_line.options import add_controller, add_overrides, bare_parser, scenario_of
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.files.shipped import shipped_scenarios


def options() -> argparse.ArgumentParser:
    """Return the options of the command."""
    result = bare_parser(__doc__, "drake-quad scenarios laboratory:high_wind > mine.yaml")
    result.add_argument("scenario", nargs="?", help="FILE or FILE:NAME, or a shipped one (default: list those shipped)")
    add_overrides(result)
    add_controller(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    """Run the command."""
    if arguments.scenario is not None:
        save_scenario(scenario_of(arguments), sys.stdout)
        return
    by_file: dict[str, list[str]] = {}
    for name in shipped_scenarios():
        file, colon, scenario = name.partition(":")
        by_file.setdefault(file + colon, []).append(scenario)
    width = max(map(len, by_file))
    for file, scenarios in by_file.items():
        words = textwrap.wrap(", ".join(scenarios), 118 - width) or [""]
        print("\n".join(f"{name:<{width}}  {line}".rstrip() for name, line in zip([file, *[""] * len(words)], words)))
