"""The scenario language: a closed loop described in YAML."""

from drake_quad.scenario.loading import Override, distributions_in, load_journey, load_scenario
from drake_quad.scenario.models import Journey, Scenario
from drake_quad.scenario.sampling import draw_sample, draw_samples, drawn_numbers
from drake_quad.scenario.saving import save_scenario

__all__ = [
    "Journey",
    "Override",
    "Scenario",
    "distributions_in",
    "draw_sample",
    "draw_samples",
    "drawn_numbers",
    "load_journey",
    "load_scenario",
    "save_scenario",
]
