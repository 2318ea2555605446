"""Log of a simulated flight with inertial sensors of known errors."""

import numpy as np

from drake_quad import load_scenario, simulate
from drake_quad.logs.record import FlightRecord

GYROSCOPE = {"noise_density": 1e-3, "bias": [0.02, -0.01, 0.015]}
ACCELEROMETER = {"noise_density": 0.01, "bias": [0.05, -0.1, 0.08]}
PERIOD = 0.02  # s, sampling period of both sensors


def simulated_log() -> FlightRecord:
    """Return the log of a simulated flight with noisy and biased inertial sensors, sampled at 50 Hz."""
    sensors = [
        {"kind": "gyroscope", "period": PERIOD, **GYROSCOPE},
        {"kind": "accelerometer", "period": PERIOD, **ACCELEROMETER},
    ]
    flight = simulate(load_scenario("figure_eight", {"laboratory.sensors": sensors, "duration": 12.0}), compiled=True)
    state = np.array(flight.record("state"))
    return FlightRecord(
        "simulated",
        np.array(flight.time),
        position=state[0:3].T + np.array([0.0, 0.0, 1.0]),
        velocity=state[6:9].T,
        attitude=state[3:6].T,
        body_rates=np.array(flight.record("gyroscope")).T,
        specific_force=np.array(flight.record("accelerometer")).T,
    )
