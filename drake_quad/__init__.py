"""A Drake laboratory for quadrotor tracking control."""

from drake_quad.assembly.tracking import build_tracking_diagram
from drake_quad.errors import InputError
from drake_quad.flight import Flight, simulate
from drake_quad.scenario import Scenario, load_scenario
from drake_quad.studies import Study, read_study, run_monte_carlo

__all__ = [
    "Flight",
    "InputError",
    "Scenario",
    "Study",
    "build_tracking_diagram",
    "load_scenario",
    "read_study",
    "run_monte_carlo",
    "simulate",
]
