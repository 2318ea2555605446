"""Simulated flights of vehicles whose numbers are known, to see whether identification finds them.

A vehicle with numbers of its own flies past waypoints at changing yaw, with the noise, the delays and the losses of a
laboratory: in that of the paper in low wind, where rotors are commanded, or behind the autopilot of Neural-Fly's
vehicle, where attitude and thrust are. What is logged is what a laboratory has: what its cameras measure, and commands.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.flight.flight import Flight
from drake_quad.flight.simulation import simulate_samples
from drake_quad.identification.delays import delay_of
from drake_quad.identification.identify import identify
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.model import DELAY
from drake_quad.identification.results.estimates import Estimates
from drake_quad.identification.results.vehicle_numbers import number_of
from drake_quad.scenario.files.loading import load_scenario
from drake_quad.scenario.models import Scenario

# Of the waypoints, along X, Y and Z (m) and in yaw (rad): sines whose phases go on by so much from one to the next
# (rad), so that none comes again.
_CENTRE, _AMPLITUDE = np.array([0.0, 0.0, 1.5, 0.0]), np.array([1.2, 1.2, 0.4, 0.5])
_PHASES, _FIRST = np.array([0.91, 0.73, 1.31, 1.73]), np.array([0.0, 1.0, 2.0, 3.0])
_WAYPOINTS = 41
# Thrust of a rotor at full throttle as Neural-Fly's autopilot believes it, N: diagrams/vehicles/neural_fly.yaml.
_FULL = 14.27


class KnownFlights(NamedTuple):
    """Flights of a kind.

    Attributes:
        scenario: in `diagrams/`.
        seconds: from a waypoint to the next, s.
        own: overrides: what each vehicle has of its own.
        believed: overrides: what the identification begins with.
    """

    scenario: str
    seconds: float
    own: tuple[str, ...]
    believed: tuple[str, ...]

    def flown(self, diagrams: Path, overrides: Sequence[str] = ()) -> Scenario:
        """The scenario that flies."""
        route = f"route={json.dumps(wandering(self.seconds))}"
        return load_scenario(diagrams / self.scenario, [route, *self.own, *overrides])

    def begun_with(self, diagrams: Path) -> Scenario:
        """The scenario that the identification begins with."""
        return load_scenario(diagrams / self.scenario, self.believed)


class Checked(NamedTuple):
    """A number that was identified, beside the true one.

    Attributes:
        name: as in `Estimates`, or `delay` (s) where rotors are commanded.
        true: that of the vehicle that flew.
        value: that was found.
        deviation: standard deviation of its error.
        degrees_of_freedom: of the error.
    """

    name: str
    true: float
    value: float
    deviation: float
    degrees_of_freedom: float


def _between(low: float, high: float) -> str:
    return f"{{uniform: {{min: {low}, max: {high}}}}}"


KNOWN = {
    "rotors": KnownFlights(
        "laboratory.yaml:low_wind",
        1.0,
        (
            f"vehicle.inertia=[{_between(0.0056, 0.0084)}, {_between(0.0056, 0.0084)}, {_between(0.0096, 0.0144)}]",
            f"vehicle.thrust_factor={_between(3.6e-5, 4.6e-5)}",
            f"vehicle.rotor_time_constant={_between(0.03, 0.07)}",
            f"vehicle.linear_drag={_between(0.05, 0.2)}",
            f"vehicle.centre_of_mass=[{_between(-0.004, 0.004)}, {_between(-0.004, 0.004)}]",
        ),
        (),
    ),
    "autopilot": KnownFlights(
        "neural_fly.yaml:still",
        1.25,
        (
            f"laboratory.autopilot.natural_frequency=[{', '.join([_between(6.0, 9.0)] * 3)}]",
            f"laboratory.autopilot.damping=[{', '.join([_between(0.4, 0.8)] * 3)}]",
            f"laboratory.motion_capture.misalignment=[{_between(-0.02, 0.02)}, {_between(-0.02, 0.02)}, 0.0]",
            f"vehicle.motors.curve=[{_between(-2.2, -1.4)}, {_between(17.5, 19.0)}, 0.0]",
            f"vehicle.rotor_time_constant={_between(0.015, 0.06)}",
            f"vehicle.body_drag.linear=[{_between(0.4, 1.0)}, {_between(0.4, 1.0)}, 0.0]",
            f"vehicle.rotor_aerodynamics.climb={_between(-0.3, -0.1)}",
            "metrics.start=0",
        ),
        (
            "laboratory.autopilot.natural_frequency=[10, 10, 10]",
            "laboratory.autopilot.damping=[0.7, 0.7, 0.7]",
            "laboratory.command_link.delay_ticks=0",
            "vehicle.body_drag={linear: [0.3, 0.3, 0.0]}",
            "vehicle.rotor_aerodynamics=null",
            f"vehicle.motors={{kind: throttle, curve: [0.0, {_FULL}, 0.0]}}",
            "vehicle.rotor_time_constant=0.05",
        ),
    ),
}


def wandering(seconds: float) -> dict[str, object]:
    """A route past waypoints at changing yaw, so many seconds apart, as the scenario language has it."""
    places = _CENTRE + _AMPLITUDE * np.sin(np.outer(np.arange(_WAYPOINTS), _PHASES) + _FIRST)
    waypoints = [{"point": row[:3], "yaw": row[3]} for row in places.round(3).tolist()]
    times = [round(seconds * i, 6) for i in range(_WAYPOINTS)]
    free = {"heading": "waypoints", "top_speed": None, "top_acceleration": None}
    return {"kind": "waypoints", "waypoints": waypoints, "times": times, **free}


def record_of(flight: Flight) -> FlightRecord:
    """The log of a flight: what cameras measured, and what rotors or an autopilot were told."""
    seen = flight.signals["measurement"]
    pose: Any = {"position": seen[:, :3], "attitude": seen[:, 3:6], "velocity": seen[:, 6:9], "body_rates": seen[:, 9:]}
    target = flight.signals.get("attitude_target")
    if target is None:
        return FlightRecord("flight", flight.time, **pose, rotor_speed_command=flight.signals["rotor_speed_command"])
    share, angles = target[:, 0] / (4.0 * _FULL), target[:, 1:4]
    return FlightRecord("flight", flight.time, **pose, thrust_share=share, attitude_command=angles)


def checked(flight: Flight, believed: Scenario) -> list[Checked]:
    """Identifies the vehicle of a flight, and puts what was found beside what flew; empty if the log tells nothing.

    Args:
        flight: of a known vehicle.
        believed: to begin with.
    """
    try:
        found = identify([record_of(flight)], believed, held_out_share=0.0)
    except InputError:
        return []
    rows = _beside(found.estimates, flight.scenario)
    if found.delay is not None:
        delay, deviation, _, freedom = found.delay
        rows.append(Checked(DELAY, _late(flight.scenario), delay, deviation, freedom))
    return rows


class Task(NamedTuple):
    """Flights to be flown together and identified one by one.

    Attributes:
        flights: which of `KNOWN`.
        diagrams: the folder of the shipped scenarios.
        overrides: of what flies.
        samples: their numbers.
    """

    flights: str
    diagrams: Path
    overrides: Sequence[str]
    samples: Sequence[int]


def check_batch(task: Task) -> dict[int, list[Checked]]:
    """What was found of each flight of a task, by the number of the sample."""
    known = KNOWN[task.flights]
    flown = simulate_samples(known.flown(task.diagrams, task.overrides), task.samples, compiled=True)
    believed = known.begun_with(task.diagrams)
    return {sample: checked(flight, believed) for sample, flight in zip(task.samples, flown, strict=True)}


def _beside(estimates: Estimates, scenario: Scenario) -> list[Checked]:
    freedom = np.asarray(estimates.degrees_of_freedom)
    columns = zip(estimates.names, estimates.values, estimates.deviations, freedom, strict=True)
    return [Checked(name, number_of(scenario, name), *map(float, rest)) for name, *rest in columns]


def _late(scenario: Scenario) -> float:
    """Return the delay from a logged command to the logged measurement of its effect, s."""
    if scenario.laboratory.autopilot.models_vehicle:
        return delay_of(scenario)
    capture, link = scenario.laboratory.motion_capture, scenario.laboratory.command_link
    return float(capture.period * (1 + capture.latency_frames) - link.period)
