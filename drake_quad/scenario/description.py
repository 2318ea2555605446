"""Descriptions and units of the fields of a scenario."""

import re
from typing import Any

from drake_quad.scenario.models import Mission
from drake_quad.scenario.paths import parts_of, steps_of


def description_at(scenario: Mission, path: str) -> str:
    """Return the description of a field, with its unit.

    Args:
        scenario: that has it.
        path: of the field, for example `vehicle.inertia.0`.
    """
    value: Any = scenario
    text = ""
    for step in steps_of(path):
        if not step.isdecimal():
            text = type(value).model_fields[step].description or text
        value = dict(parts_of(value))[step]
    return text


def unit_at(scenario: Mission, path: str) -> str:
    """Return the unit of a field; "" if it has none."""
    return unit_in(description_at(scenario, path))


def unit_in(description: str) -> str:
    """Return the unit in a description, which is in parentheses, not after "eq", nor squared; "" if there is none."""
    found = re.search(r"(?<!eq )\(([^()]*)\)(?!²)", description)
    return found[1] if found else ""
