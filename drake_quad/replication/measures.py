"""Measures of recorded flights: control effort, output of the PD, distance to the path, and metrics leg by leg."""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy

from drake_quad.flight.flight import Flight

# The distance to the path is the distance to the nearest of points with this time step, s. At 2 m/s, the points are
# 4 mm apart.
_PATH_TIME_STEP = 0.002

# Names of the legs that are straight, and of the legs that are curved.
STRAIGHT_LEGS = ("climb", "straight", "descent", "return")
CURVED_LEGS = ("circle", "turn", "curve")


class Effort(NamedTuple):
    """Definition of control effort.

    Attributes:
        definition: short description of the definition.
        signal: name of the signal from which the effort is computed.
        x: component of the signal that moves the vehicle along X.
        y: component of the signal that moves the vehicle along Y.
        measure: function from the values (ticks,) of a component to the effort.
    """

    definition: str
    signal: str
    x: str
    y: str
    measure: Callable[[np.ndarray], Any]


def _mean_square(values: np.ndarray) -> float:
    return float(np.mean(values**2))


def _mean_absolute(values: np.ndarray) -> float:
    return float(np.mean(np.abs(values)))


# Each tuple contains a signal from which a control effort is computed, and its components for X and Y.
_COMMAND = ("acceleration_command", "x", "y")
_PD_OUTPUT = ("pd", "x", "y")
# The pitch torque moves the vehicle along X, and the roll torque along Y.
_TORQUE = ("wrench", "tau_y", "tau_x")

OUR_EFFORT = "command_mean_square"  # definition of control effort that this library uses
# Definitions of control effort, keyed by name.
EFFORTS = {
    OUR_EFFORT: Effort("mean square of the command", *_COMMAND, _mean_square),
    "command_rms": Effort("root mean square of the command", *_COMMAND, lambda u: math.sqrt(_mean_square(u))),
    "command_mean_size": Effort("mean absolute command", *_COMMAND, _mean_absolute),
    "command_variance": Effort("variance of the command", *_COMMAND, np.var),
    "command_peak": Effort("largest absolute command", *_COMMAND, lambda u: np.max(np.abs(u))),
    "command_step_square": Effort("mean square of the command's steps", *_COMMAND, lambda u: _mean_square(np.diff(u))),
    "command_step_size": Effort("total variation of the command", *_COMMAND, lambda u: _mean_absolute(np.diff(u))),
    "pd_mean_square": Effort("mean square of the PD's output", *_PD_OUTPUT, _mean_square),
    "pd_mean_size": Effort("mean absolute output of the PD", *_PD_OUTPUT, _mean_absolute),
    "torque_mean_square": Effort("mean square of the torque", *_TORQUE, _mean_square),
    "torque_mean_size": Effort("mean absolute torque", *_TORQUE, _mean_absolute),
}


def measures(flight: Flight) -> dict[str, float]:
    """Return all measures of a flight with a PD, keyed by name; NaN if the vehicle crashed.

    - The control efforts that `EFFORTS` defines, along X and along Y. Their names end in "_x" and "_y".
    - "pd_fade": RMS of the PD's horizontal output in the last quarter of the flight, divided by its RMS in the first
      quarter of the flight's duration after the climb.
    - "pd_return": RMS of the PD's horizontal output in the first second of each route segment, divided by its RMS in
      the last second of the segment before.
    - "path_error": RMS distance to the nearest point of the path, m.
    """
    result: dict[str, float] = {}
    for name, effort in EFFORTS.items():
        signal = flight.record(effort.signal)
        result[f"{name}_x"] = float(effort.measure(getattr(signal, effort.x)))
        result[f"{name}_y"] = float(effort.measure(getattr(signal, effort.y)))
    result |= {
        "pd_fade": _fade_ratio(flight),
        "pd_return": _return_ratio(flight),
        "path_error": _path_error(flight),
    }
    return dict.fromkeys(result, np.nan) if flight.metrics.crashed else result


def _horizontal_square(flight: Flight) -> np.ndarray:
    """Return the squared magnitude (ticks,) of the PD's horizontal output, m²/s⁴."""
    pd = flight.record("pd")
    square: np.ndarray = pd.x**2 + pd.y**2
    return square


def _fade_ratio(flight: Flight) -> float:
    squared = _horizontal_square(flight)
    quarter = len(squared) // 4
    risen = int(np.searchsorted(flight.time, flight.plan.leg_times[1]))
    return float(np.sqrt(squared[-quarter:].mean() / squared[risen : risen + quarter].mean()))


def _return_ratio(flight: Flight) -> float:
    squared = _horizontal_square(flight)
    # The first two legs are excluded, since the flight starts with the first leg, and the second leg follows a vertical
    # climb, in which the horizontal output is small.
    changes = flight.plan.leg_times[2:]
    after, before = (
        np.any([(flight.time >= t + first) & (flight.time < t + first + 1.0) for t in changes], axis=0)
        for first in (0.0, -1.0)
    )
    return float(np.sqrt(squared[after].mean() / squared[before].mean()))


def _path_error(flight: Flight) -> float:
    path = scipy.spatial.KDTree(
        flight.plan.derivative(0).vector_values(np.arange(0.0, flight.time[-1], _PATH_TIME_STEP)).T
    )
    state = flight.record("state")
    distance, _ = path.query(np.column_stack([state.x, state.y, state.z]))
    return float(np.sqrt(np.mean(distance**2)))


class LegMetrics(NamedTuple):
    """Metrics of flights over the straight and the curved legs of the paper's route, as arrays of equal shape.

    Attributes:
        straight: RMSE over the straight legs, m.
        curved: RMSE over the curved legs, m.
        swing: total variation of the horizontal command per second over the straight legs, m/s³.
    """

    straight: np.ndarray
    curved: np.ndarray
    swing: np.ndarray


def leg_metrics(flights: Sequence[Flight]) -> LegMetrics:
    """Return the metrics (flights,) of flights over the paper's route; NaN for flights that crashed."""
    rows = [_leg_metrics_of_flight(flight) if not flight.metrics.crashed else (np.nan,) * 3 for flight in flights]
    return LegMetrics(*np.array(rows).T)


def _leg_metrics_of_flight(flight: Flight) -> tuple[float, float, float]:
    names = np.array([leg.name for leg in flight.plan.legs])
    leg = names[np.searchsorted(flight.plan.leg_times, flight.time, side="right") - 1]
    squared = flight.euclidean_error**2
    straight, curved = np.isin(leg, STRAIGHT_LEGS), np.isin(leg, CURVED_LEGS)
    command = flight.record("acceleration_command")
    steps = np.abs(np.diff(command.x)) + np.abs(np.diff(command.y))
    both = straight[1:] & straight[:-1]
    period = flight.time[1]  # the first tick is at 0
    return (
        float(np.sqrt(squared[straight].mean())),
        float(np.sqrt(squared[curved].mean())),
        float(steps[both].sum() / (both.sum() * period)),
    )
