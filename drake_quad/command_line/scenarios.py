"""List the shipped scenarios by name, or print one scenario in full.

The names are valid in every command and in Python. A scenario that is printed in full includes all scenarios that it
extends and all default values, so it is a starting point for your own file.
"""

import argparse
import sys
import textwrap

from drake_quad.command_line.options import (
    add_controller,
    add_overrides,
    parser_without_options,
    scenario_from_arguments,
)
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.files.shipped import shipped_scenarios


def options() -> argparse.ArgumentParser:
    result = parser_without_options(__doc__, "drake-quad scenarios laboratory:high_wind > mine.yaml")
    result.add_argument(
        "scenario",
        nargs="?",
        help="FILE or FILE:NAME, or the name of a shipped scenario (default: list all shipped scenarios)",
    )
    add_overrides(result)
    add_controller(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    if arguments.scenario is not None:
        save_scenario(scenario_from_arguments(arguments), sys.stdout)
        return
    by_file: dict[str, list[str]] = {}
    for name in shipped_scenarios():
        file, colon, scenario = name.partition(":")
        by_file.setdefault(file + colon, []).append(scenario)
    width = max(map(len, by_file))
    for file, scenarios in by_file.items():
        words = textwrap.wrap(", ".join(scenarios), 118 - width) or [""]
        print("\n".join(f"{name:<{width}}  {line}".rstrip() for name, line in zip([file, *[""] * len(words)], words)))
