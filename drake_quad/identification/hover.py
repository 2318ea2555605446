"""White noise of the sensors and trim of the vehicle, from a log at rest and in hover.

The white noise is estimated from third differences, in which a smooth signal vanishes. Third differences of independent
errors with the standard deviation σ have the variance 20 σ². If an estimator has filtered the signal, its errors are
not white, and their standard deviation is underestimated.
"""

from typing import NamedTuple

import numpy as np

from drake_quad.identification.result import EstimatedValue
from drake_quad.identification.windows import airborne_mask, segment_numbers
from drake_quad.logs.record import QUANTITIES, FlightRecord

_DIFFERENCE_ORDER = 3  # order of the differences from which white noise is estimated
_VARIANCE_FACTOR = 20.0  # variance of third differences if errors are independent and have unit variance
_TRANSITION_TIME = 2.0  # s, time before and after each flight that does not count as rest
_MAX_HOVER_SPEED = 0.15  # m/s, faster motion is not hover
_MAX_HOVER_RATE = 0.5  # rad/s, faster rotation is not hover
_MIN_HOVER_TIME = 1.0  # s, shortest hover from which trim is estimated
_BLOCK_DURATION = 0.5  # s, duration of the blocks whose scatter gives the standard deviation of a mean
_MIN_NUM_DIFFERENCES = 30  # smallest number of third differences from which noise is estimated
_MAX_DELAY = 0.3  # s, largest delay from a command to the attitude
_SIGNALS = ("position", "attitude", "body_rates", "specific_force")


class HoverNoise(NamedTuple):
    """White noise on each axis of a signal.

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
    flying = airborne_mask(record)
    margin = min(round(_TRANSITION_TIME / record.period), (len(flying) - 1) // 2)
    resting = np.convolve(flying, np.ones(2 * margin + 1), "same") < 0.5
    noises = []
    for signal in _SIGNALS:
        values = getattr(record, signal)
        if values is not None:
            smooth = np.unwrap(values, axis=0) if signal == "attitude" else values
            deviations = (_deviations(record, smooth, chosen) for chosen in (resting, flying))
            noises.append(HoverNoise(signal, QUANTITIES[signal].unit, *deviations))
    return noises


def _deviations(record: FlightRecord, values: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return the standard deviation (3,) of the white noise in the chosen samples; NaN if too few are chosen."""
    steps = np.diff(record.time)
    evenly_spaced = np.abs(steps / np.median(steps) - 1.0) < 0.5
    complete = np.convolve(chosen, np.ones(_DIFFERENCE_ORDER + 1), "valid") == _DIFFERENCE_ORDER + 1
    complete &= np.convolve(evenly_spaced, np.ones(_DIFFERENCE_ORDER), "valid") == _DIFFERENCE_ORDER
    if complete.sum() < _MIN_NUM_DIFFERENCES:
        return np.full(values.shape[1], np.nan)
    differences = np.diff(values, _DIFFERENCE_ORDER, axis=0)[complete]
    return np.asarray(np.sqrt(np.mean(differences**2, axis=0) / _VARIANCE_FACTOR))


def hover_means(record: FlightRecord, weight: float) -> dict[str, EstimatedValue]:
    """Return the means of tilt, commanded torque, commanded thrust and throttles in hover, by name.

    If throttles are logged, the result includes the mean thrust of a motor divided by the square of its throttle. A
    motor with a damaged propeller has a larger throttle. The standard deviations are computed from means over
    half-second blocks.

    Args:
        record: record of the flight.
        weight: weight of the vehicle, N.

    Returns:
        Means with their standard deviations; empty if the vehicle hovers for less than a second.
    """
    if record.velocity is None:
        return {}
    hovering = airborne_mask(record) & (np.linalg.norm(record.velocity, axis=1) < _MAX_HOVER_SPEED)
    if record.body_rates is not None:
        hovering &= np.linalg.norm(record.body_rates, axis=1) < _MAX_HOVER_RATE
    if hovering.sum() * record.period < _MIN_HOVER_TIME:
        return {}
    blocks = np.floor((record.time - record.time[0]) / _BLOCK_DURATION).astype(int)[hovering]
    hover = record.subset(hovering)
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


def _mean(values: np.ndarray, blocks: np.ndarray, unit: str) -> EstimatedValue:
    """Return the mean of values (n,) and its standard deviation, given the block number (n,) of each value."""
    block_numbers, indices = np.unique(blocks, return_inverse=True)
    means = np.bincount(indices, weights=values) / np.bincount(indices)
    deviation = float(np.std(means, ddof=1) / np.sqrt(len(block_numbers))) if len(block_numbers) > 1 else np.nan
    return EstimatedValue(float(values.mean()), deviation, unit, max(len(block_numbers) - 1.0, 1.0))


def delay_by_correlation(record: FlightRecord) -> float | None:
    """Return the delay, s, of the attitude behind its command with the highest correlation; None if one is not logged.

    The result is a rough check of an identified delay. It is longer than that delay, since it includes the response of
    the vehicle.
    """
    if record.attitude is None or record.attitude_command is None:
        return None
    segments = segment_numbers(record)
    longest = record.subset(segments == np.argmax(np.bincount(segments)))
    lags = np.arange(max(1, round(_MAX_DELAY / longest.period)))
    peaks = []
    for column in range(2):
        command, angle = (np.diff(longest.of(name)[:, column]) for name in ("attitude_command", "attitude"))
        correlations = [float(np.dot(command[: len(command) - lag], angle[lag:])) for lag in lags]
        peaks.append((max(correlations), lags[int(np.argmax(correlations))]))
    return float(max(peaks)[1] * longest.period)
