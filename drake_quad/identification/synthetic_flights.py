"""Simulated flights of vehicles with known parameters, for tests of identification.

A vehicle with random parameters flies past waypoints with changing yaw. The simulation includes the noise, delays and
packet losses of a laboratory. The log contains only the camera measurements and the commands. `SYNTHETIC_FLIGHTS`
contains six conditions:

- calm: the laboratory of `diagrams/laboratory.yaml` without wind, with rotor speed commands,
- wind: the same laboratory in low wind that is not logged,
- delay: the same laboratory in calm air, with camera frames that are 30 ms older,
- autopilot: attitude and thrust commands to the autopilot of Neural-Fly's vehicle,
- slow_log: a control loop at 500 Hz, with every fifth sample in the log,
- battery: throttle commands to motors that lose 7 % of their thrust as the battery discharges; its voltage is logged.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.flight.flight import Flight
from drake_quad.flight.simulation import simulate_samples
from drake_quad.identification.delays import frame_age, total_delay
from drake_quad.identification.identify import identify
from drake_quad.identification.model import DELAY, STATE_ROWS
from drake_quad.identification.results.estimates import Estimates
from drake_quad.identification.results.vehicle_values import vehicle_value
from drake_quad.logs.record import FlightRecord
from drake_quad.scenario.files.loading import load_scenario
from drake_quad.scenario.models import Scenario
from drake_quad.signals import AttitudeTarget

# Waypoints are samples of sines along X, Y and Z (m) and in yaw (rad). The phases (rad) of the sines increase by
# incommensurable steps from one waypoint to the next, so that no waypoint is visited twice.
_CENTRE = np.array([0.0, 0.0, 1.5, 0.0])  # mean of X, Y, Z (m) and yaw (rad)
_AMPLITUDE = np.array([1.2, 1.2, 0.4, 0.5])  # amplitudes in X, Y, Z (m) and yaw (rad)
_PHASE_STEPS = np.array([0.91, 0.73, 1.31, 1.73])  # rad, phase increments from one waypoint to the next
_FIRST_PHASES = np.array([0.0, 1.0, 2.0, 3.0])  # rad, phases at the first waypoint
_NUM_WAYPOINTS = 41  # number of waypoints
# Thrust of one rotor at full throttle in Neural-Fly's autopilot, N, from diagrams/vehicles/neural_fly.yaml.
_FULL_THRUST = 14.27


class SyntheticFlights(NamedTuple):
    """Simulated flights under one condition.

    Attributes:
        scenario: FILE:NAME of the scenario in `diagrams/`.
        leg_duration: time from one waypoint to the next, s.
        overrides: overrides of the scenario that set the condition and the distributions of the parameters.
        initial_overrides: overrides of the scenario that set the initial values of the identification.
        samples_per_row: number of simulated samples from one row of the log to the next.
    """

    scenario: str
    leg_duration: float
    overrides: tuple[str, ...]
    initial_overrides: tuple[str, ...] = ()
    samples_per_row: int = 1

    def simulated_scenario(self, diagrams: Path, further_overrides: Sequence[str] = ()) -> Scenario:
        """Return the scenario of the simulated flights."""
        route = f"route={json.dumps(random_waypoint_route(self.leg_duration))}"
        return load_scenario(diagrams / self.scenario, [route, *self.overrides, *further_overrides])

    def initial_scenario(self, diagrams: Path) -> Scenario:
        """Return the initial scenario of the identification."""
        return load_scenario(diagrams / self.scenario, self.initial_overrides)


class CheckedParameter(NamedTuple):
    """Estimate of an identified parameter, and its true value.

    Attributes:
        name: name as in `Estimates`, or `DELAY`.
        true: value of the simulated vehicle.
        value: estimate.
        deviation: standard deviation of the estimation error.
        degrees_of_freedom: degrees of freedom of the error, which follows Student's t-distribution.
    """

    name: str
    true: float
    value: float
    deviation: float
    degrees_of_freedom: float


def _between(low: float, high: float) -> str:
    return f"{{uniform: {{min: {low}, max: {high}}}}}"


# Overrides for the random parameters that all simulated vehicles have, in SI units.
_BODY_DISTRIBUTIONS = (
    f"vehicle.inertia=[{_between(0.0056, 0.0084)}, {_between(0.0056, 0.0084)}, {_between(0.0096, 0.0144)}]",
    f"vehicle.rotor_time_constant={_between(0.03, 0.07)}",
    f"vehicle.linear_drag={_between(0.05, 0.2)}",
    f"vehicle.centre_of_mass=[{_between(-0.004, 0.004)}, {_between(-0.004, 0.004)}]",
)
_ROTOR_VEHICLE_DISTRIBUTIONS = (*_BODY_DISTRIBUTIONS, f"vehicle.thrust_factor={_between(3.6e-5, 4.6e-5)}")
_THROTTLES = "nominal.motors={kind: throttle, curve: [0.0, 1.0, 3.4]}"

SYNTHETIC_FLIGHTS = {
    "calm": SyntheticFlights("laboratory.yaml:nominal", 1.0, _ROTOR_VEHICLE_DISTRIBUTIONS),
    "wind": SyntheticFlights("laboratory.yaml:low_wind", 1.0, _ROTOR_VEHICLE_DISTRIBUTIONS),
    "delay": SyntheticFlights(
        "laboratory.yaml:nominal", 1.0, (*_ROTOR_VEHICLE_DISTRIBUTIONS, "laboratory.motion_capture.latency_frames=3")
    ),
    "autopilot": SyntheticFlights(
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
            f"vehicle.motors={{kind: throttle, curve: [0.0, {_FULL_THRUST}, 0.0]}}",
            "vehicle.rotor_time_constant=0.05",
        ),
    ),
    "slow_log": SyntheticFlights(
        "laboratory.yaml:nominal",
        1.0,
        (
            *_ROTOR_VEHICLE_DISTRIBUTIONS,
            "laboratory.command_link.period=0.002",
            "laboratory.motion_capture.period=0.002",
            "vehicle.time_step=0.001",
        ),
        samples_per_row=5,
    ),
    "battery": SyntheticFlights(
        "laboratory.yaml:nominal",
        1.0,
        (
            *_BODY_DISTRIBUTIONS,
            _THROTTLES,
            "vehicle.motors={kind: throttle, curve:"
            f" [{_between(0.0, 0.2)}, {_between(0.5, 1.5)}, {_between(2.9, 3.9)}]}}",
            "vehicle.battery={voltage: 12.6, empty_voltage: 10.5, capacity: 0.2, resistance: 0.02, efficiency: 0.6}",
        ),
        # The thrust curve of the vehicle holds for the voltage of the full battery.
        (_THROTTLES, "vehicle.motors={kind: throttle, curve: [0.0, 1.0, 3.4], voltage: 12.6}"),
    ),
}


def random_waypoint_route(seconds: float) -> dict[str, object]:
    """Return a route past waypoints with changing yaw, in the scenario language.

    Args:
        seconds: time from a waypoint to the next, s.
    """
    phases = np.outer(np.arange(_NUM_WAYPOINTS), _PHASE_STEPS) + _FIRST_PHASES
    waypoints = [{"point": row[:3], "yaw": row[3]} for row in (_CENTRE + _AMPLITUDE * np.sin(phases)).round(3).tolist()]
    times = [round(seconds * i, 6) for i in range(_NUM_WAYPOINTS)]
    settings = {"heading": "waypoints", "top_speed": None, "top_acceleration": None}
    return {"kind": "waypoints", "waypoints": waypoints, "times": times, **settings}


def record_of(flight: Flight, samples_per_row: int = 1) -> FlightRecord:
    """Return the log of a flight: camera measurements, commands, and the battery voltage if there is a battery."""
    signals = flight.signals
    values: dict[str, Any] = dict(
        zip(STATE_ROWS, np.split(signals["measurement"], len(STATE_ROWS), axis=1), strict=True)
    )
    if "attitude_target" in signals:
        target = AttitudeTarget(*signals["attitude_target"].T)
        values["thrust_fraction"] = target.thrust / (4.0 * _FULL_THRUST)
        values["attitude_command"] = np.column_stack([target.roll, target.pitch, target.yaw])
    elif "throttle_command" in signals:
        values["motor_command"] = signals["throttle_command"]
    else:
        values["rotor_speed_command"] = signals["rotor_speed_command"]
    if "battery" in signals:
        values["battery_voltage"] = flight.record("battery").voltage
    step = slice(None, None, samples_per_row)
    return FlightRecord("flight", flight.time[step], **{name: rows[step] for name, rows in values.items()})


def check_flight(flight: Flight, nominal: Scenario, samples_per_row: int = 1) -> list[CheckedParameter]:
    """Identify the vehicle of a simulated flight, and return each identified parameter with its true value.

    Args:
        flight: simulated flight.
        nominal: initial scenario of the identification.
        samples_per_row: number of simulated samples from one row of the log to the next.

    Returns:
        Identified parameters; empty if the log cannot be identified.
    """
    try:
        identification = identify([record_of(flight, samples_per_row)], nominal, held_out_fraction=0.0)
    except InputError:
        return []
    parameters = _with_true_values(identification.estimates, flight.scenario)
    if identification.delay is not None:
        delay, deviation, _, freedom = identification.delay
        parameters.append(CheckedParameter(DELAY, _true_delay(flight.scenario), delay, deviation, freedom))
    return parameters


class CheckTask(NamedTuple):
    """Flights that are simulated together, and identified one by one.

    Attributes:
        flights: name of the condition in `SYNTHETIC_FLIGHTS`.
        diagrams: folder of the shipped scenarios.
        overrides: further overrides of the simulated scenario.
        samples: sample number of each flight, which determines its random parameters.
    """

    flights: str
    diagrams: Path
    overrides: Sequence[str]
    samples: Sequence[int]


def check_batch(task: CheckTask) -> dict[int, list[CheckedParameter]]:
    """Simulate the flights of a task, and return the identified parameters of each flight, by its sample number."""
    condition = SYNTHETIC_FLIGHTS[task.flights]
    flights = simulate_samples(condition.simulated_scenario(task.diagrams, task.overrides), task.samples, compiled=True)
    nominal = condition.initial_scenario(task.diagrams)
    return {
        sample: check_flight(flight, nominal, condition.samples_per_row)
        for sample, flight in zip(task.samples, flights, strict=True)
    }


def _with_true_values(estimates: Estimates, scenario: Scenario) -> list[CheckedParameter]:
    """Return each identified parameter with its true value, which is its value in the scenario."""
    freedom = np.asarray(estimates.degrees_of_freedom)
    columns = zip(estimates.names, estimates.values, estimates.deviations, freedom, strict=True)
    return [
        CheckedParameter(name, vehicle_value(scenario, name), *map(float, numbers))
        for name, *numbers in columns
        if name in estimates.identified
    ]


def _true_delay(scenario: Scenario) -> float:
    """Return the delay from a logged command to the logged measurement of its effect, s.

    The command in a sample of a flight is the command that was held during the tick before the sample.
    """
    if scenario.laboratory.autopilot.models_vehicle:
        return total_delay(scenario)
    return frame_age(scenario) - float(scenario.laboratory.command_link.period)
