"""The scenario language: a closed loop described in YAML."""

from drake_quad.scenario.batch import Batch, draw_sample, middle_of
from drake_quad.scenario.loading import Override, load_mission, load_scenario, load_undesigned
from drake_quad.scenario.models import Mission, Scenario
from drake_quad.scenario.paths import distributions_in
from drake_quad.scenario.saving import save_scenario

__all__ = [
    "Batch",
    "Mission",
    "Override",
    "Scenario",
    "distributions_in",
    "draw_sample",
    "load_mission",
    "load_scenario",
    "load_undesigned",
    "middle_of",
    "save_scenario",
]
