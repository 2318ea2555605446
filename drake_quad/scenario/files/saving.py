"""Writing of a scenario as YAML, and the command-line options that are needed to read it again."""

import io
import re
from pathlib import Path
from typing import TextIO

from ruamel.yaml import YAML

from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import mappings_in

# First line of a saved scenario that uses kinds from the user's Python files.
_HEADER = "# This scenario needs the command-line options {}\n"
_MAX_HEADER_LENGTH = 1000  # characters


def save_scenario(scenario: Scenario, target: Path | str | TextIO) -> None:
    """Write a scenario with the values of all its fields as YAML to a path or a stream.

    If the scenario uses kinds from the user's Python files, a comment in the first line lists the command-line options
    that are needed to read it again.
    """
    text = io.StringIO()
    if options := registration_options(scenario):
        text.write(_HEADER.format(options))
    YAML().dump({scenario.name: scenario.model_dump(mode="json", exclude={"name"})}, text)
    if isinstance(target, Path | str):
        Path(target).write_text(text.getvalue(), encoding="utf-8")
    else:
        target.write(text.getvalue())


def registration_options(scenario: Scenario) -> str:
    """Return the command-line options that import the user's files which a scenario needs; empty for built-in kinds."""
    options = (type(mapping).registration_option() for _, mapping in mappings_in(scenario))
    return " ".join(dict.fromkeys(filter(None, options)))


def saved_options(source: str) -> str:
    """Return the options in the first line of a file that `save_scenario` wrote; empty if there are none.

    Args:
        source: path of the file, or the name of another source of a scenario.
    """
    try:
        with Path(source).open(encoding="utf-8") as file:
            line = file.readline(_MAX_HEADER_LENGTH)
    except (OSError, ValueError):
        return ""
    found = re.fullmatch(_HEADER.format("(.+)"), line)
    return found[1] if found else ""
