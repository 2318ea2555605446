"""The scenario language: a closed loop described in YAML."""

from drake_quad.scenario.loading import distributions_in, load_journey, load_scenario
from drake_quad.scenario.models import Journey, Scenario

__all__ = ["Journey", "Scenario", "distributions_in", "load_journey", "load_scenario"]
