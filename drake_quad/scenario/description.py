"""What the fields of a scenario mean."""

import re
from typing import Any

from drake_quad.scenario.models import Journey


def description_at(scenario: Journey, path: str) -> str:
    """The description of a field, with its unit.

    Args:
        scenario: that has it.
        path: as `distributions_in` gives it, for example `vehicle.inertia[0]`.
    """
    value: Any = scenario
    text = ""
    for name, index in re.findall(r"(\w+)|\[(\d+)\]", path):
        if name:
            text = type(value).model_fields[name].description or text
            value = getattr(value, name)
        else:
            value = value[int(index)]
    return text


def unit_at(scenario: Journey, path: str) -> str:
    """The unit of a field: what stands in parentheses in its description, not after "eq"; "" if there is none."""
    found = re.findall(r"(?<!eq )\(([^()]*)\)", description_at(scenario, path))
    return found[0] if found else ""
