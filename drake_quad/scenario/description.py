"""Look-up of the description and the unit of a field of a scenario."""

import re
from typing import Any

from drake_quad.scenario.models import Mission
from drake_quad.scenario.paths import children, split_path


def description_at(scenario: Mission, path: str) -> str:
    """Return the description of a field, with its unit.

    Args:
        scenario: scenario with the field.
        path: path of the field, such as `vehicle.inertia.0`.
    """
    value: Any = scenario
    text = ""
    for step in split_path(path):
        if not step.isdecimal():
            text = type(value).model_fields[step].description or text
        value = dict(children(value))[step]
    return text


def unit_at(scenario: Mission, path: str) -> str:
    """Return the unit of a field, "" if it has none."""
    return unit_from_description(description_at(scenario, path))


def unit_from_description(description: str) -> str:
    """Return the unit in a description, "" if it has none.

    The unit is the first text in parentheses that is neither an equation number, as in "eq (8)", nor followed by ².
    """
    found = re.search(r"(?<!eq )\(([^()]*)\)(?!²)", description)
    return found[1] if found else ""
