"""A Drake laboratory for quadrotor tracking control."""

from drake_quad.errors import InputError
from drake_quad.flight import Flight, simulate
from drake_quad.scenario import Scenario, load_scenario
from drake_quad.tracking import build_tracking_diagram

__all__ = ["Flight", "InputError", "Scenario", "build_tracking_diagram", "load_scenario", "simulate"]
