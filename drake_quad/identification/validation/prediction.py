"""Open-loop prediction of a logged flight with vehicle models, over horizons of 0.1 to 2 s.

Predictions begin at many samples of a log, which are called starts. The Kalman filter of
`drake_quad.identification.prediction_errors`, whose model is the vehicle, follows the measurements up to each start.
The filter uses past measurements only, with the maximum-likelihood noise for the log and the vehicle. The vehicle is
simulated from the start on, with the logged commands and without measurements.

The filter also estimates a disturbing force and torque, for example of a wind that is not logged. The predictions set
this force and torque to zero. A second prediction with the first of the given vehicles includes them. It shows how well
a controller with a disturbance observer predicts.

Two predictors without a model serve as baselines. They begin at the end of a parabola through the last 50 ms of each
measured signal. *Constant velocity* continues with the velocity and the body rates at the start; *constant
acceleration* also continues with the acceleration and the angular acceleration. If a vehicle model predicts worse than
one of these baselines at a horizon, it is of no use at this horizon.

Errors are evaluated at the horizon: the distance between the positions, the norm of the difference of velocities and of
body rates, and the angle between the attitudes. The filter does not use velocities or body rates that an estimator
derives from other measurements. The prediction of such a signal is its measured value at the start plus the predicted
change. Errors of neighbouring starts are correlated, so confidence intervals are based on Student's t over blocks that
are at least one second and at least the horizon long. Vehicles are compared by paired differences, start by start.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError, short_repr
from drake_quad.framework.result_cache import cached_on_disk
from drake_quad.identification.delays import total_delay
from drake_quad.identification.evidence import quantile
from drake_quad.identification.fit import fit
from drake_quad.identification.model import STATE_ROWS
from drake_quad.identification.prepared_logs import WARM_UP, PreparedLogs, initial_noise, prepare
from drake_quad.identification.windows import LogWindow, WindowSizes, airborne_mask, held_out_mask, segment_numbers
from drake_quad.logs.attitudes import rotation_matrices
from drake_quad.logs.record import QUANTITIES, FlightRecord
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in
from drake_quad.statistics.interval import Interval

HORIZONS = (0.1, 0.2, 0.5, 1.0, 2.0)
"""Default horizons of the predictions, s."""
CONSTANT_VELOCITY = "constant velocity"
CONSTANT_ACCELERATION = "constant acceleration"
WITH_DISTURBANCE = "with disturbance"
"""Name of the prediction with the first vehicle and the disturbance that its filter estimates before the start."""
START_SPACING = 0.1  # s, time between the starts of two predictions
_PARABOLA_TIME = 0.05  # s, duration of the parabolas that give the initial motion of the predictors without a model
_MIN_PARABOLA_SAMPLES = 4  # smallest number of samples to which a parabola is fitted
_SETTLING_TIME = 0.5  # s, time before the start of a prediction in which the filter settles
_MIN_BLOCK_DURATION = 1.0  # s, shortest block whose mean error counts as independent
UNITS = {"height": "m", "climb": "m/s"} | {name: QUANTITIES[name].unit for name in STATE_ROWS}
"""Unit of each predicted quantity."""


@dataclass(frozen=True, eq=False)
class Predictions:
    """Prediction errors of vehicles.

    Attributes:
        vehicles: (v,) names of the vehicles, and of the predictors without a model.
        horizons: (h,) horizons, s.
        log: (S,) name of the log that contains each start.
        time: (S,) time of each start, s.
        errors: (v, h, S) errors of the vehicles at the horizons, by quantity; NaN if a flight ends before the horizon.
    """

    vehicles: tuple[str, ...]
    horizons: tuple[float, ...]
    log: np.ndarray
    time: np.ndarray
    errors: dict[str, np.ndarray]

    def rmse(self, quantity: str, vehicle: str, horizon: float) -> Interval:
        """Return the RMS error at a horizon with its 95 % interval; NaN if no prediction reaches the horizon."""
        squares, blocks = self._squares(quantity, horizon, vehicle)
        if not len(blocks):
            return Interval(math.nan, math.nan, math.nan)
        mean = float(np.mean(squares))
        if mean == 0.0:
            return Interval(0.0, 0.0, 0.0)
        half_width = 0.5 * _half_width(squares / mean - 1.0, blocks)
        value = math.sqrt(mean)
        return Interval(value, value * math.exp(-half_width), value * math.exp(half_width))

    def error_reduction(self, quantity: str, vehicle: str, other: str, horizon: float) -> Interval:
        """Return the fraction by which a vehicle reduces the RMS error of another vehicle, from the same starts.

        It is NaN if no prediction reaches the horizon, or if the other vehicle is exact.
        """
        squares, blocks = self._squares(quantity, horizon, vehicle)
        other_squares, _ = self._squares(quantity, horizon, other)
        if not other_squares.any():
            return Interval(math.nan, math.nan, math.nan)
        if not squares.any():
            return Interval(1.0, 1.0, 1.0)
        difference = squares / np.mean(squares) - other_squares / np.mean(other_squares)
        half_width = 0.5 * _half_width(difference, blocks)
        ratio = math.sqrt(float(np.mean(squares) / np.mean(other_squares)))
        return Interval(1.0 - ratio, 1.0 - ratio * math.exp(half_width), 1.0 - ratio * math.exp(-half_width))

    def remark_on_worse_predictions(self, vehicle: str) -> str:
        """Return a remark on the quantities that a vehicle predicts worse than a predictor without a model does.

        The remark lists the horizons at which the vehicle is significantly worse: the 95 % interval of the difference
        excludes zero. The remark is empty if there are no such horizons.
        """
        worse, baselines = [], (CONSTANT_VELOCITY, CONSTANT_ACCELERATION)
        for quantity in self.errors:
            significant = [
                f"{horizon:g}"
                for horizon in self.horizons
                if any(self.error_reduction(quantity, vehicle, other, horizon).high < 0.0 for other in baselines)
            ]
            if significant:
                worse.append(f"{quantity.replace('_', ' ')} ({', '.join(significant)} s)")
        if not worse:
            return ""
        return f"{vehicle} predicts worse than constant velocity or constant acceleration: {', '.join(worse)}"

    def starts(self, horizon: float) -> int:
        """Return the number of starts whose prediction reaches a horizon, in s, before the flight ends."""
        errors = next(iter(self.errors.values()))
        return int(np.isfinite(errors[0, self.horizons.index(horizon)]).sum())

    def _squares(self, quantity: str, horizon: float, vehicle: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the squared errors of a vehicle, and the block number of each error."""
        errors = self.errors[quantity][self.vehicles.index(vehicle), self.horizons.index(horizon)]
        is_known = np.isfinite(errors)
        length = max(_MIN_BLOCK_DURATION, horizon)
        labels = [
            f"{log} {int(time // length)}" for log, time in zip(self.log[is_known], self.time[is_known], strict=True)
        ]
        _, blocks = np.unique(labels, return_inverse=True)
        return errors[is_known] ** 2, blocks


def concatenate_predictions(parts: Sequence[Predictions]) -> Predictions:
    """Concatenate the predictions of several logs, for the quantities that all logs contain.

    Raises:
        InputError: if no predictions are given.
    """
    if not parts:
        raise InputError("no log is given; at least one is needed for a prediction")
    first = parts[0]
    common = [name for name in first.errors if all(name in part.errors for part in parts)]
    return Predictions(
        first.vehicles,
        first.horizons,
        np.concatenate([part.log for part in parts]),
        np.concatenate([part.time for part in parts]),
        {name: np.concatenate([part.errors[name] for part in parts], axis=2) for name in common},
    )


def predict(
    record: FlightRecord,
    vehicles: Mapping[str, Scenario],
    *,
    nominal: Scenario | None = None,
    horizons: Sequence[float] = HORIZONS,
    final_fraction: float = 1.0,
) -> Predictions:
    """Predict a flight with vehicle models and with two baselines, from many samples of the flight.

    The predictors in the result are the vehicles, the baselines `CONSTANT_VELOCITY` and `CONSTANT_ACCELERATION`, and
    `WITH_DISTURBANCE`, which is the first vehicle with the estimated disturbance. The result is cached on disk.

    Args:
        record: record of the flight.
        vehicles: scenarios of the vehicles, by name.
        nominal: scenario whose `nominal` vehicle the firmware's allocation uses; by default the scenario of each
            vehicle.
        horizons: horizons, s.
        final_fraction: fraction of the airborne time, at its end, in which predictions start; 1 for the whole time.

    Raises:
        InputError: if the log contains no signal that can be predicted, lacks the commands of a vehicle, or is too
            short, or a vehicle contains a distribution.
    """
    for name, vehicle in vehicles.items():
        if (path := next(iter(distributions_in(vehicle)), None)) is not None:
            raise InputError(
                f"{short_repr(name)} cannot predict a flight: {path} is a distribution; use draw_sample(scenario, 0)"
            )
    if not any(getattr(record, name) is not None for name in STATE_ROWS):
        raise InputError(
            f"the log {short_repr(record.name)} contains no signal that can be predicted: it needs position, velocity,"
            f" attitude or body_rates, but contains {', '.join(record.names)}"
        )
    return cached_on_disk(_predictions, record, dict(vehicles), nominal, tuple(horizons), final_fraction)


def _predictions(
    record: FlightRecord,
    vehicles: Mapping[str, Scenario],
    nominal: Scenario | None,
    horizons: Sequence[float],
    final_fraction: float,
) -> Predictions:
    """Return the predictions of a flight; the arguments are those of `predict`."""
    prepared = {name: prepare([record], each, nominal)[0] for name, each in vehicles.items()}
    (record,) = next(iter(prepared.values())).records
    measured = [name for name in STATE_ROWS if getattr(record, name) is not None]
    only_vertical = "attitude" not in measured and "body_rates" not in measured
    num_past = max(_MIN_PARABOLA_SAMPLES, round(_PARABOLA_TIME / record.period) + 1)
    steps = [round(horizon / record.period) for horizon in horizons]
    if min(np.diff([0, *steps])) < 1:
        raise InputError(
            f"the log {short_repr(record.name)} has a sampling period of {record.period:.2g} s, which is too long for"
            f" predictions over {', '.join(f'{horizon:g}' for horizon in horizons)} s"
        )
    starts = _starts(record, num_past, horizons, final_fraction)
    if not len(starts):
        raise InputError(
            f"the log {short_repr(record.name)} has no airborne stretch of at least"
            f" {_SETTLING_TIME + min(horizons):.2g} s, which a prediction needs"
        )
    motion = _Motion.at(record, measured, starts, num_past)
    continues = np.stack([_continues(record, starts, step) for step in steps])
    times = [record.time[np.minimum(starts + step, len(record.time) - 1)] - record.time[starts] for step in steps]
    open_loop = {
        name: _open_loop_states(each, vehicles[name], motion, starts, steps) for name, each in prepared.items()
    }
    predicted = {name: [state[:, 0] for state in states] for name, states in open_loop.items()}
    predicted[CONSTANT_VELOCITY] = [motion.after(time) for time in times]
    predicted[CONSTANT_ACCELERATION] = [motion.after(time, accelerated=True) for time in times]
    predicted[WITH_DISTURBANCE] = [state[:, 1] for state in next(iter(open_loop.values()))]
    errors: dict[str, list[np.ndarray]] = {}
    for states in predicted.values():
        for quantity, values in _errors(record, measured, states, starts, steps, only_vertical).items():
            errors.setdefault(quantity, []).append(np.where(continues, values, np.nan))
    log = np.array([record.name] * len(starts))
    stacked = {quantity: np.stack(values) for quantity, values in errors.items()}
    return Predictions(tuple(predicted), tuple(horizons), log, record.time[starts], stacked)


class _Motion(NamedTuple):
    """Measured motion at the S samples at which predictions start.

    Attributes:
        state: (12, S) state; components that are not measured are zero.
        acceleration: (3, S) acceleration in W, m/s².
        angular_acceleration: (3, S) angular acceleration about the axes of B, rad/s².
    """

    state: np.ndarray
    acceleration: np.ndarray
    angular_acceleration: np.ndarray

    @classmethod
    def at(cls, record: FlightRecord, measured: Sequence[str], starts: np.ndarray, num_past: int) -> "_Motion":
        """Fit parabolas to the last `num_past` samples up to each start, and return the motion at their ends."""
        samples = starts[:, None] + np.arange(1 - num_past, 1)
        ends = {}
        for name in measured:
            values = np.unwrap(record.of(name), axis=0) if name == "attitude" else record.of(name)
            ends[name] = _parabolas(record, samples, values[samples])
        zero = np.zeros((3, len(starts)))
        position, velocity, acceleration = ends.get("position", (zero, zero, zero))
        if "velocity" in ends:
            velocity, acceleration, _ = ends["velocity"]
        attitude, *_ = ends.get("attitude", (zero, zero, zero))
        rates, angular_acceleration = zero, zero
        if "body_rates" in ends:
            rates, angular_acceleration, _ = ends["body_rates"]
        elif "attitude" in ends:
            attitudes = rotation_matrices(record.of("attitude"))
            rotation_vectors = (attitudes[np.repeat(starts, num_past)].inv() * attitudes[samples.ravel()]).as_rotvec()
            _, rates, angular_acceleration = _parabolas(record, samples, rotation_vectors.reshape(*samples.shape, 3))
        return cls(np.concatenate([position, attitude, velocity, rates]), acceleration, angular_acceleration)

    def after(self, time: np.ndarray, *, accelerated: bool = False) -> np.ndarray:
        """Return the states (12, S) after times (S,) in s, at constant velocities or constant accelerations."""
        position, attitude, velocity, rates = np.split(self.state, 4)
        acceleration, angular_acceleration = (
            (self.acceleration, self.angular_acceleration) if accelerated else (0.0, 0.0)
        )
        rotation = scipy.spatial.transform.Rotation.from_rotvec(((rates + 0.5 * angular_acceleration * time) * time).T)
        attitudes = rotation_matrices(attitude.T) * rotation
        return np.concatenate(
            [
                position + velocity * time + 0.5 * acceleration * time**2,
                attitudes.as_euler("ZYX").T[::-1],
                velocity + acceleration * time,
                rates + angular_acceleration * time,
            ]
        )


def _parabolas(record: FlightRecord, samples: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, ...]:
    """Fit parabolas to values, and return value, rate and acceleration (3, S) at the end of each parabola.

    Args:
        record: record that contains the samples.
        samples: (S, num_past) indices of the samples of each parabola.
        values: (S, num_past, 3) values of the samples.
    """
    time = record.time[samples] - record.time[samples[:, -1:]]
    inverse = np.linalg.pinv(np.stack([np.ones_like(time), time, 0.5 * time**2], axis=2))
    return tuple(np.moveaxis(inverse @ values, 0, 2))


def _open_loop_states(
    logs: PreparedLogs, scenario: Scenario, motion: _Motion, starts: np.ndarray, steps: Sequence[int]
) -> list[np.ndarray]:
    """Return the predicted states (12, 2, S), without and with disturbance, for each number of samples in `steps`."""
    delay, no_parameters = total_delay(scenario), np.zeros(0)
    noise = fit(logs.predictor((), logs.flying, delay=delay), (), initial_noise(logs.outputs)).noise
    settle, warm_up = (max(1, round(time / logs.period)) for time in (_SETTLING_TIME, WARM_UP))
    windows = [LogWindow(0, int(start) + 1) for start in starts]
    # Computing the gains of the filter takes most of the time. The filter is needed only up to the start of each
    # prediction, so its windows end there.
    gains = logs.predictor_for_windows(windows, WindowSizes(1, settle, warm_up), delay=delay).gains(
        no_parameters, noise
    )
    predictor = logs.predictor_for_windows(windows, WindowSizes(max(steps), settle, warm_up), delay=delay)
    at_start, *predicted = predictor.open_loop(no_parameters, gains, steps)
    for signal, row in STATE_ROWS.items():
        if signal not in logs.signals:
            rows = slice(row, row + 3)
            for end in predicted:
                end[rows] += motion.state[rows, None] - at_start[rows]
    return predicted


def _starts(record: FlightRecord, num_past: int, horizons: Sequence[float], final_fraction: float) -> np.ndarray:
    """Return the indices (S,) of the logged samples at which predictions begin."""
    flying = airborne_mask(record)
    is_allowed = held_out_mask(flying, final_fraction) if final_fraction < 1.0 and flying.any() else flying
    spacing = max(1, round(START_SPACING / record.period))
    min_steps = round(min(horizons) / record.period)
    num_past = max(num_past, round(_SETTLING_TIME / record.period))
    samples = np.arange(num_past, len(record.time) - min_steps, spacing)
    has_past = _continues(record, samples - num_past, num_past)
    return np.asarray(samples[is_allowed[samples] & has_past & _continues(record, samples, min_steps)])


def _continues(record: FlightRecord, starts: np.ndarray, steps: int) -> np.ndarray:
    """Return a mask (S,) of the starts after which the flight continues for `steps` samples without a gap."""
    ends = starts + steps
    is_logged = ends < len(record.time)
    ends = np.minimum(ends, len(record.time) - 1)
    segments, num_grounded = segment_numbers(record), np.concatenate([[0], np.cumsum(~airborne_mask(record))])
    return np.asarray(
        is_logged & (segments[starts] == segments[ends]) & (num_grounded[ends + 1] == num_grounded[starts])
    )


def _errors(
    record: FlightRecord,
    measured: Sequence[str],
    states: Sequence[np.ndarray],
    starts: np.ndarray,
    steps: Sequence[int],
    only_vertical: bool,
) -> dict[str, np.ndarray]:
    """Return the errors (h, S) of each quantity at h horizons, which `steps` gives as numbers of samples."""
    errors_by_quantity: dict[str, list[np.ndarray]] = {}
    for step, state in zip(steps, states, strict=True):
        samples = np.minimum(starts + step, len(record.time) - 1)
        for name in measured:
            predicted = state[STATE_ROWS[name] : STATE_ROWS[name] + 3].T
            actual = record.of(name)[samples]
            if only_vertical:
                quantity, error = {"position": "height", "velocity": "climb"}[name], np.abs(predicted - actual)[:, 2]
            elif name == "attitude":
                predicted_rotation, actual_rotation = rotation_matrices(predicted), rotation_matrices(actual)
                quantity, error = name, (predicted_rotation.inv() * actual_rotation).magnitude()
            else:
                quantity, error = name, np.linalg.norm(predicted - actual, axis=1)
            errors_by_quantity.setdefault(quantity, []).append(error)
    return {quantity: np.stack(errors) for quantity, errors in errors_by_quantity.items()}


def _half_width(values: np.ndarray, blocks: np.ndarray) -> float:
    """Return the half-width of the 95 % interval of a mean; infinite for a single block.

    Args:
        values: (n,) values minus their mean.
        blocks: (n,) block number of each value. Values are correlated only within a block.
    """
    totals = np.bincount(blocks, weights=values) / len(values)
    count = len(totals)
    if count < 2:
        return math.inf
    variance = count / (count - 1) * float(np.sum(totals**2))
    return float(quantile(count - 1)) * math.sqrt(variance)
