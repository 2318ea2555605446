"""A simulated flight of the Neural-Fly vehicle, written as a log in Neural-Fly's format."""

import csv
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from drake_quad import load_scenario, simulate
from drake_quad.identification.delays import frame_age
from drake_quad.scenario.models import Scenario

DIAGRAM = Path(__file__).parent.parent.parent / "diagrams" / "neural_fly.yaml"
# Thrust of a rotor at full throttle that the autopilot assumes, N.
ASSUMED_MAX_THRUST = 14.27
# Overrides with initial values that were guessed without a log.
GUESSED_PARAMETERS = (
    "laboratory.autopilot.natural_frequency=[10, 10, 10]",
    "laboratory.autopilot.damping=[0.7, 0.7, 0.7]",
    "laboratory.command_link.delay_ticks=0",
    "vehicle.body_drag={linear: [0.3, 0.3, 0.0]}",
    "vehicle.rotor_aerodynamics=null",
    "vehicle.motors={kind: throttle, curve: [0.0, 14.27, 0.0]}",
    "vehicle.rotor_time_constant=0.05",
)


def guessed(*overrides: str) -> Scenario:
    """Return the scenario from which an identification starts."""
    return load_scenario(f"{DIAGRAM}:still", [*GUESSED_PARAMETERS, *overrides])


def write_flight(path: Path, scenario: Scenario) -> Path:
    """Fly a scenario, and write measurements and commands in Neural-Fly's format, with vectors in brackets."""
    flight = simulate(scenario, compiled=True)
    measurement, target = flight["measurement"], flight["attitude_target"]

    def cells(rows: np.ndarray) -> list[str]:
        return [str([float(f"{value:.9g}") for value in row]) for row in rows]

    def quaternions(angles: np.ndarray) -> list[str]:
        return cells(Rotation.from_euler("ZYX", angles[:, ::-1]).as_quat())

    # The force is evaluated at the time of the camera measurement.
    frame_time = flight.time - frame_age(scenario)
    state = np.column_stack([np.interp(frame_time, flight.time, row) for row in flight["state"].T])
    mass = scenario.vehicle.mass
    up = Rotation.from_euler("ZYX", state[:, 5:2:-1]).apply([0.0, 0.0, 1.0])
    acceleration = np.gradient(state[:, 6:9], flight.time, axis=0) + np.array([0.0, 0.0, 9.81])
    columns = {
        "t": [f"{time:.6f}" for time in flight.time],
        "p": cells(measurement[:, 0:3]),
        "v": cells(measurement[:, 6:9]),
        "q": quaternions(measurement[:, 3:6]),
        "w": cells(measurement[:, 9:12]),
        "p_d": cells(flight["reference"][:, 0:3]),
        "v_d": cells(flight["reference"][:, 3:6]),
        "T_sp": [f"{thrust / (4.0 * ASSUMED_MAX_THRUST):.9g}" for thrust in target[:, 0]],
        "q_sp": quaternions(target[:, 1:4]),
        "fa": cells(mass * acceleration - target[:, :1] * up),
    }
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))
    return path
