"""Writing of a scenario as YAML."""

from pathlib import Path
from typing import TextIO

from ruamel.yaml import YAML

from drake_quad.scenario.models import Scenario


def save_scenario(scenario: Scenario, target: Path | TextIO) -> None:
    """Write a scenario, with the values of all fields, as YAML to a path or a stream."""
    YAML().dump({scenario.name: scenario.model_dump(mode="json", exclude={"name"})}, target)
