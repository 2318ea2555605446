"""White noise of the sensors and trim of the vehicle, from a log at rest and in hover.

The white noise follows from third differences, which remove a smooth signal. For independent errors with standard
deviation σ, third differences have the variance 20 σ². If an estimator has filtered the signal, its errors are not
white, and the result underestimates them.
"""

from typing import NamedTuple

import numpy as np

from drake_quad.identification.logs.record import QUANTITIES, FlightRecord
from drake_quad.identification.result import Spread
from drake_quad.identification.windows import airborne, pieces

_DIFFERENCE_ORDER = 3
_VARIANCE_FACTOR = 20.0  # variance of third differences of independent errors of unit variance
_LANDING_TIME = 2.0  # s, time before take-off and after landing that counts neither as rest nor as flight
_MAX_HOVER_SPEED = 0.15  # m/s
_MAX_HOVER_RATE = 0.5  # rad/s
_MIN_HOVER_TIME = 1.0  # s
_BLOCK = 0.5  # s, duration of the blocks whose scatter gives standard deviations
_MIN_WHOLE_DIFFERENCES = 30
_MAX_DELAY = 0.3  # s, largest delay of the attitude behind its command
_SIGNALS = ("position", "attitude", "body_rates", "specific_force")


class HoverNoise(NamedTuple):
    """White noise of each axis of a signal.

    Attributes:
        signal: name of the signal.
        unit: unit of the signal.
        at_rest: (3,) standard deviations on the ground; NaN if the log contains too few samples on the ground.
        in_flight: (3,) standard deviations in the air.
    """

    signal: str
    unit: str
    at_rest: np.ndarray
    in_flight: np.ndarray


def white_noise(record: FlightRecord) -> list[HoverNoise]:
    """Return the white noise of each measured signal."""
    flying = airborne(record)
    around = min(round(_LANDING_TIME / record.period), (len(flying) - 1) // 2)
    resting = np.convolve(flying, np.ones(2 * around + 1), "same") < 0.5
    found = []
    for signal in _SIGNALS:
        values = getattr(record, signal)
        if values is not None:
            smooth = np.unwrap(values, axis=0) if signal == "attitude" else values
            deviations = (_deviations(record, smooth, chosen) for chosen in (resting, flying))
            found.append(HoverNoise(signal, QUANTITIES[signal].unit, *deviations))
    return found


def _deviations(record: FlightRecord, values: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return standard deviations (3,) from differences of adjacent chosen samples; NaN if there are too few."""
    steps = np.diff(record.time)
    even = np.abs(steps / np.median(steps) - 1.0) < 0.5
    whole = np.convolve(chosen, np.ones(_DIFFERENCE_ORDER + 1), "valid") == _DIFFERENCE_ORDER + 1
    whole &= np.convolve(even, np.ones(_DIFFERENCE_ORDER), "valid") == _DIFFERENCE_ORDER
    if whole.sum() < _MIN_WHOLE_DIFFERENCES:
        return np.full(values.shape[1], np.nan)
    differences = np.diff(values, _DIFFERENCE_ORDER, axis=0)[whole]
    return np.asarray(np.sqrt(np.mean(differences**2, axis=0) / _VARIANCE_FACTOR))


def trim(record: FlightRecord, weight: float) -> dict[str, Spread]:
    """Return mean tilt and mean commanded torque, thrust and throttles in hover; empty if it lasts less than a second.

    For a log with throttles, the result includes the mean thrust of a motor divided by the square of its throttle. A
    damaged propeller shows as a larger throttle of its motor.

    Standard deviations follow from the means of blocks of half a second.

    Args:
        record: record of the flight.
        weight: weight of the vehicle, N.
    """
    if record.velocity is None:
        return {}
    hovering = airborne(record) & (np.linalg.norm(record.velocity, axis=1) < _MAX_HOVER_SPEED)
    if record.body_rates is not None:
        hovering &= np.linalg.norm(record.body_rates, axis=1) < _MAX_HOVER_RATE
    if hovering.sum() * record.period < _MIN_HOVER_TIME:
        return {}
    blocks = np.floor((record.time - record.time[0]) / _BLOCK).astype(int)[hovering]
    hover = record.part(hovering)
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
    """Return the mean of values (n,), with the standard deviation from the means of blocks (n,)."""
    numbers, places = np.unique(blocks, return_inverse=True)
    means = np.bincount(places, weights=values) / np.bincount(places)
    deviation = float(np.std(means, ddof=1) / np.sqrt(len(numbers))) if len(numbers) > 1 else np.nan
    return Spread(float(values.mean()), deviation, unit, max(len(numbers) - 1.0, 1.0))


def delay_by_correlation(record: FlightRecord) -> float | None:
    """Return the delay with the largest correlation of the attitude and its command, s; None if one is not logged.

    It serves to check the order of magnitude of an identified delay. It is longer than the identified delay, since it
    includes the response of the vehicle.
    """
    if record.attitude is None or record.attitude_command is None:
        return None
    piece = pieces(record)
    part = record.part(piece == np.argmax(np.bincount(piece)))
    lags = np.arange(max(1, round(_MAX_DELAY / part.period)))
    best = []
    for column in range(2):
        command, angle = (np.diff(part.of(name)[:, column]) for name in ("attitude_command", "attitude"))
        correlations = [float(np.dot(command[: len(command) - lag], angle[lag:])) for lag in lags]
        best.append((max(correlations), lags[int(np.argmax(correlations))]))
    return float(max(best)[1] * part.period)
