"""Flying: one vehicle, or a fleet of them."""

from drake_quad.flight.fleet import StudyFleet
from drake_quad.flight.flight import Flight, read_flight
from drake_quad.flight.learned import save_network
from drake_quad.flight.simulation import simulate, simulate_batch, simulate_samples

__all__ = ["Flight", "StudyFleet", "read_flight", "save_network", "simulate", "simulate_batch", "simulate_samples"]
