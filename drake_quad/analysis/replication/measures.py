"""Numbers of recorded flights: effort as others define it, the PD's output, distance to the path, errors leg by leg."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial import KDTree

from drake_quad.flight import Flight

# Between points of the path to which the distance is measured, s; at 2 m/s they are 4 mm apart.
_FINE = 0.002


STRAIGHT = ("climb", "straight", "descent", "return")
CURVED = ("circle", "turn", "curve")


class Effort(NamedTuple):
    """A definition of control effort.

    Attributes:
        words: what it is.
        signal: from which it is made.
        rows: of the signal, for X and Y.
        measure: of the (ticks, 2) values of a signal.
    """

    words: str
    signal: str
    rows: tuple[int, int]
    measure: Callable[[np.ndarray], np.ndarray]


def _mean_square(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.mean(values**2, axis=0))


def _rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(_mean_square(values))


def _mean_size(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.mean(np.abs(values), axis=0))


def _variance(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.var(values, axis=0))


def _peak(values: np.ndarray) -> np.ndarray:
    return np.asarray(np.max(np.abs(values), axis=0))


def _step_square(values: np.ndarray) -> np.ndarray:
    return _mean_square(np.diff(values, axis=0))


def _step_size(values: np.ndarray) -> np.ndarray:
    return _mean_size(np.diff(values, axis=0))


_COMMAND: tuple[str, tuple[int, int]] = ("acceleration_command", (0, 1))
_PD: tuple[str, tuple[int, int]] = ("pd", (0, 1))
# Pitch moves the vehicle along X, and roll along Y.
_TORQUE: tuple[str, tuple[int, int]] = ("wrench", (2, 1))

OUR_EFFORT = "command_mean_square"
EFFORTS = {
    OUR_EFFORT: Effort("mean square of the command", *_COMMAND, _mean_square),
    "command_rms": Effort("root mean square of the command", *_COMMAND, _rms),
    "command_mean_size": Effort("mean size of the command", *_COMMAND, _mean_size),
    "command_variance": Effort("variance of the command", *_COMMAND, _variance),
    "command_peak": Effort("largest command", *_COMMAND, _peak),
    "command_step_square": Effort("mean square of the command's steps", *_COMMAND, _step_square),
    "command_step_size": Effort("total variation of the command", *_COMMAND, _step_size),
    "pd_mean_square": Effort("mean square of the PD's part", *_PD, _mean_square),
    "pd_mean_size": Effort("mean size of the PD's part", *_PD, _mean_size),
    "torque_mean_square": Effort("mean square of the torque", *_TORQUE, _mean_square),
    "torque_mean_size": Effort("mean size of the torque", *_TORQUE, _mean_size),
}


def measures(flight: Flight) -> dict[str, float]:
    """All numbers of a flight with a PD, by name; NaN for one that crashed.

    Each effort has a number for "_x" and one for "_y". "pd_fade" is the RMS of the PD's horizontal output in the last
    quarter of the flight over that in the quarter after the rise, "pd_return" that in the 1 s after the changes of
    segment over that in the 1 s before, and "path_error" the RMS distance to the reference's path, wherever the
    reference is on it, m.
    """
    found: dict[str, float] = {}
    for name, effort in EFFORTS.items():
        values = effort.measure(flight[effort.signal][:, list(effort.rows)])
        found |= {f"{name}_{axis}": float(value) for axis, value in zip("xy", values, strict=True)}
    found |= {
        "pd_fade": _late_over_early(flight),
        "pd_return": _after_over_before(flight),
        "path_error": _path_error(flight),
    }
    return dict.fromkeys(found, np.nan) if flight.metrics.crashed else found


def _late_over_early(flight: Flight) -> float:
    squared = np.sum(flight["pd"][:, 0:2] ** 2, axis=1)
    quarter = len(squared) // 4
    risen = int(np.searchsorted(flight.time, flight.plan.leg_times[1]))
    return float(np.sqrt(squared[-quarter:].mean() / squared[risen : risen + quarter].mean()))


def _after_over_before(flight: Flight) -> float:
    squared = np.sum(flight["pd"][:, 0:2] ** 2, axis=1)
    # The flight begins with the first, and before the second it rises on the spot.
    changes = flight.plan.leg_times[2:]
    after, before = (
        np.any([(flight.time >= t + first) & (flight.time < t + first + 1.0) for t in changes], axis=0)
        for first in (0.0, -1.0)
    )
    return float(np.sqrt(squared[after].mean() / squared[before].mean()))


def _path_error(flight: Flight) -> float:
    path = KDTree(flight.plan.derivative(0).vector_values(np.arange(0.0, flight.time[-1], _FINE)).T)
    distance, _ = path.query(flight["state"][:, 0:3])
    return float(np.sqrt(np.mean(distance**2)))


class LegErrors(NamedTuple):
    """RMSE over the straight and over the curved legs, m, and how much the command swings on the straight ones.

    Attributes:
        straight: m.
        curved: m.
        swing: total variation of the horizontal command a second on the straight legs, m/s³.
    """

    straight: np.ndarray
    curved: np.ndarray
    swing: np.ndarray


def leg_errors(flights: Sequence[Flight]) -> LegErrors:
    """(flights,) errors of flights of the paper's route; NaN for those that crashed."""
    rows = [_of_flight(flight) if not flight.metrics.crashed else (np.nan,) * 3 for flight in flights]
    return LegErrors(*np.array(rows).T)


def _of_flight(flight: Flight) -> tuple[float, float, float]:
    names = np.array([leg.name for leg in flight.plan.legs])
    leg = names[np.searchsorted(flight.plan.leg_times, flight.time, side="right") - 1]
    squared = flight.euclidean_error**2
    straight, curved = np.isin(leg, STRAIGHT), np.isin(leg, CURVED)
    steps = np.abs(np.diff(flight["acceleration_command"][:, 0:2], axis=0)).sum(axis=1)
    both = straight[1:] & straight[:-1]
    period = flight.time[1]  # from 0 on
    return (
        float(np.sqrt(squared[straight].mean())),
        float(np.sqrt(squared[curved].mean())),
        float(steps[both].sum() / (both.sum() * period)),
    )
