"""What a log shows at rest and in hover: white noise of the sensors, and trim.

White noise is what differences of third order leave of a signal that is smooth besides: of n samples with independent
errors of standard deviation σ they have the variance 20 σ². Where an estimator has filtered a signal nothing of its
noise is white, and what is found is less than the signal is off by.
"""

from typing import NamedTuple

import numpy as np

from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.logs.timing import pieces
from drake_quad.identification.result import Spread
from drake_quad.identification.windows import airborne

_ORDER, _FACTOR = 3, 20.0
# Before take-off and after landing, s: neither in the air nor at rest.
_LANDING = 2.0
# Of hover: slower than this, m/s, and turning less, rad/s.
_SLOW, _QUIET = 0.15, 0.5
# Of hover, s, for a mean; and of the blocks for its deviation.
_SHORTEST, _BLOCK = 1.0, 0.5
_MEASURED = {"position": "m", "attitude": "rad", "body_rates": "rad/s", "specific_force": "m/s²"}


class HoverNoise(NamedTuple):
    """White noise of a signal, each axis by itself.

    Attributes:
        signal: of the record.
        unit: of it.
        at_rest: (3,) standard deviations on the ground; NaN if the log shows none of it.
        in_flight: (3,) in the air.
    """

    signal: str
    unit: str
    at_rest: np.ndarray
    in_flight: np.ndarray


def white_noise(record: FlightRecord) -> list[HoverNoise]:
    """The white noise of each signal that is measured."""
    flying = airborne(record)
    around = min(round(_LANDING / record.period), (len(flying) - 1) // 2)
    resting = np.convolve(flying, np.ones(2 * around + 1), "same") < 0.5
    found = []
    for signal, unit in _MEASURED.items():
        values = getattr(record, signal)
        if values is not None:
            smooth = np.unwrap(values, axis=0) if signal == "attitude" else values
            parts = (_white(record, smooth, chosen) for chosen in (resting, flying))
            found.append(HoverNoise(signal, unit, *parts))
    return found


def _white(record: FlightRecord, values: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(3,) by differences among samples that follow each other and are all chosen; the median keeps outliers out."""
    steps = np.diff(record.time)
    even = np.abs(steps / np.median(steps) - 1.0) < 0.5
    whole = np.convolve(chosen, np.ones(_ORDER + 1), "valid") == _ORDER + 1
    whole &= np.convolve(even, np.ones(_ORDER), "valid") == _ORDER
    if whole.sum() < 10 * _ORDER:
        return np.full(values.shape[1], np.nan)
    differences = np.diff(values, _ORDER, axis=0)[whole]
    return np.asarray(np.sqrt(np.mean(differences**2, axis=0) / _FACTOR))


def trim(record: FlightRecord, weight: float) -> dict[str, Spread]:
    """Return what holds a vehicle in hover: mean tilt, torque, thrust and throttles; empty without a second of hover.

    A log with throttles shows the thrust of a motor over the square of its throttle, in the mean of the motors. A
    propeller that has lost thrust shows in the throttle of its motor.

    Standard deviations are those of means over blocks of half a second.

    Args:
        record: record of the flight.
        weight: weight of the vehicle, N.
    """
    if record.velocity is None:
        return {}
    still = airborne(record) & (np.linalg.norm(record.velocity, axis=1) < _SLOW)
    if record.body_rates is not None:
        still &= np.linalg.norm(record.body_rates, axis=1) < _QUIET
    if still.sum() * record.period < _SHORTEST:
        return {}
    blocks = np.floor((record.time - record.time[0]) / _BLOCK).astype(int)[still]
    hover = record.part(still)
    columns: dict[str, tuple[np.ndarray, str]] = {}
    if hover.attitude is not None:
        columns |= {f"mean {name}": (hover.attitude[:, i], "rad") for i, name in enumerate(("roll", "pitch"))}
    if hover.torque_command is not None:
        columns |= {f"mean torque about {axis}": (hover.torque_command[:, i], "N m") for i, axis in enumerate("xyz")}
    if hover.thrust_command is not None:
        columns["mean thrust"] = hover.thrust_command, "N"
    if hover.motor_command is not None:
        squares = hover.motor_command**2
        columns |= {f"mean throttle of motor {i + 1}": (hover.motor_command[:, i], "") for i in range(4)}
        columns["thrust of a motor over the square of its throttle"] = weight / squares.sum(axis=1), "N"
    return {name: _mean(values, blocks, unit) for name, (values, unit) in columns.items()}


def _mean(values: np.ndarray, blocks: np.ndarray, unit: str) -> Spread:
    names, which = np.unique(blocks, return_inverse=True)
    means = np.bincount(which, weights=values) / np.bincount(which)
    deviation = float(np.std(means, ddof=1) / np.sqrt(len(names))) if len(names) > 1 else np.nan
    return Spread(float(values.mean()), deviation, unit, max(len(names) - 1.0, 1.0))


def delay_by_correlation(record: FlightRecord, longest: float = 0.3) -> float | None:
    """By how much the attitude is behind its command where the two are most alike, s; None if one is not logged.

    A check of an order of magnitude: it has the response of the vehicle in it, and is longer than a delay alone.
    """
    if record.attitude is None or record.attitude_command is None:
        return None
    part = max(pieces(record), key=lambda piece: len(piece.time))
    lags = np.arange(max(1, round(longest / part.period)))
    best = []
    for column in range(2):
        command, angle = (np.diff(part.of(name)[:, column]) for name in ("attitude_command", "attitude"))
        alike = [float(np.dot(command[: len(command) - lag], angle[lag:])) for lag in lags]
        best.append((max(alike), lags[int(np.argmax(alike))]))
    return float(max(best)[1] * part.period)
