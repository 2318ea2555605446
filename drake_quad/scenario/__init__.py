"""The scenario language: a closed loop described in YAML."""

from drake_quad.scenario.loading import distributions_in, load_scenario
from drake_quad.scenario.models import Scenario

__all__ = ["Scenario", "distributions_in", "load_scenario"]
