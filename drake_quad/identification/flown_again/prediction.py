"""How far ahead a vehicle predicts a flight: open loop, from the logged commands, over horizons of 0.1 to 2 s.

From starts all over a log the vehicle flies on without any further measurement. Its start state is estimated from the
past alone: the state from which the vehicle, driven by the logged commands, fits best what was measured in the 0.15 s
before (least squares; each signal is weighted by what is left of it). Where several vehicles are compared, all begin at
the state that the first of them finds, each with rotors that followed the commands with its own lag.

Errors are those at the horizon: distance, length of the difference of velocities and of body rates, and angle of the
rotation between the two attitudes. Errors of starts close by are correlated, so intervals are of Student's t over
blocks of at least a second, and of at least the horizon. Vehicles are compared start by start.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from drake_quad.errors import InputError, shown
from drake_quad.identification.fitting.multiple_shooting import Problem, fit
from drake_quad.identification.fitting.open_loop import (
    UNKNOWN,
    OpenLoop,
    Starts,
    delay_of,
    level_vehicle,
    with_level_commands,
)
from drake_quad.identification.fitting.windows import airborne, held_out, pieces, within_half_a_turn
from drake_quad.identification.logs.attitudes import rotations
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.results.estimates import quantile
from drake_quad.scenario.models import Scenario
from drake_quad.statistics.interval import Interval

HORIZONS = (0.1, 0.2, 0.5, 1.0, 2.0)
# Between starts, s.
SPACING = 0.1
# In which the start state is fitted, s.
_PAST = 0.15
# Of a block, at least, s.
_BLOCK = 1.0
# Of each signal, standard deviations to begin with.
_USUAL = {"position": 2e-3, "velocity": 3e-2, "attitude": 5e-3, "body_rates": 5e-2}
_ROWS = {"position": 0, "attitude": 3, "velocity": 6, "body_rates": 9}
UNITS = {"position": "m", "height": "m", "velocity": "m/s", "climb": "m/s", "attitude": "rad", "body_rates": "rad/s"}
_STATE_SCALES = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0])
# Beliefs about states that nothing measures.
_BELIEFS = np.array([1e3, 1e3, 1e3, 1.0, 1.0, 1e3, 10.0, 10.0, 10.0, 30.0, 30.0, 30.0])


@dataclass(frozen=True, eq=False)
class Predictions:
    """Errors of vehicles that predict flights.

    Attributes:
        vehicles: their names.
        horizons: (h,) s.
        log: (S,) name of the log of each start.
        time: (S,) of each start, s.
        errors: (v, h, S) of vehicles at horizons, by the quantity; NaN where a flight ends before the horizon.
    """

    vehicles: tuple[str, ...]
    horizons: tuple[float, ...]
    log: np.ndarray
    time: np.ndarray
    errors: dict[str, np.ndarray]

    def rmse(self, quantity: str, vehicle: str, horizon: float) -> Interval:
        """Return a vehicle's RMS error at a horizon with its 95 % interval; NaN if nothing was predicted so far."""
        own, blocks = self._squares(quantity, horizon, vehicle)
        if not len(blocks):
            return Interval(math.nan, math.nan, math.nan)
        mean = float(np.mean(own))
        if mean == 0.0:
            return Interval(0.0, 0.0, 0.0)
        reach = 0.5 * _reach(_totals(own / mean - 1.0, blocks) / len(own))
        value = math.sqrt(mean)
        return Interval(value, value * math.exp(-reach), value * math.exp(reach))

    def better(self, quantity: str, vehicle: str, other: str, horizon: float) -> Interval:
        """Return the share by which a vehicle's RMS error is smaller than that of another, from the same starts.

        It is NaN if nothing was predicted so far, or if the other vehicle is exact.
        """
        own, blocks = self._squares(quantity, horizon, vehicle)
        others, _ = self._squares(quantity, horizon, other)
        if not others.any():
            return Interval(math.nan, math.nan, math.nan)
        if not own.any():
            return Interval(1.0, 1.0, 1.0)
        difference = own / np.mean(own) - others / np.mean(others)
        reach = 0.5 * _reach(_totals(difference, blocks) / len(own))
        ratio = math.sqrt(float(np.mean(own) / np.mean(others)))
        return Interval(1.0 - ratio, 1.0 - ratio * math.exp(reach), 1.0 - ratio * math.exp(-reach))

    def starts(self, horizon: float) -> int:
        """How many starts there are from which the flight goes on as far."""
        errors = next(iter(self.errors.values()))
        return int(np.isfinite(errors[0, self.horizons.index(horizon)]).sum())

    def _squares(self, quantity: str, horizon: float, vehicle: str) -> tuple[np.ndarray, np.ndarray]:
        """Squared errors of a vehicle, and the block of each."""
        errors = self.errors[quantity][self.vehicles.index(vehicle), self.horizons.index(horizon)]
        there = np.isfinite(errors)
        length = max(_BLOCK, horizon)
        places = [f"{log} {int(time // length)}" for log, time in zip(self.log[there], self.time[there], strict=True)]
        _, blocks = np.unique(places, return_inverse=True)
        return errors[there] ** 2, blocks


def joined(parts: Sequence[Predictions]) -> Predictions:
    """Predictions of several logs as one; quantities that all of them have.

    Raises:
        InputError: there are none.
    """
    if not parts:
        raise InputError("there is no log to predict")
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
    believed: Scenario | None = None,
    horizons: Sequence[float] = HORIZONS,
    share: float = 1.0,
) -> Predictions:
    """Predicts a flight with vehicles, from starts all over it.

    Args:
        record: of the flight.
        vehicles: of which each predicts it, by a name; the first finds the start states.
        believed: whose `nominal` vehicle the firmware's allocation knows; by default that of each vehicle.
        horizons: s.
        share: of the time in the air, at its end, in which starts are; 1 for all of it.

    Raises:
        InputError: the log has nothing that could be predicted, no commands for a vehicle, or is too short.
    """
    measured = [name for name in _USUAL if getattr(record, name) is not None]
    if not measured:
        raise InputError(
            f"the log {shown(record.name)} has nothing that could be predicted: it needs position, velocity, attitude"
            f" or body_rates, and has {', '.join(record.names)}"
        )
    level = "attitude" not in measured and "body_rates" not in measured
    if level:
        vehicles = {name: level_vehicle(vehicle) for name, vehicle in vehicles.items()}
        record = with_level_commands(record)
    loops = {
        name: OpenLoop(each, record, believed=believed or each, delay=float(delay_of(each)))
        for name, each in vehicles.items()
    }
    past = max(3, round(_PAST / record.period))
    starts = _starts(record, past, horizons, share)
    if not len(starts):
        raise InputError(
            f"the log {shown(record.name)} has no stretch in the air that lasts {_PAST + min(horizons):.2g} s"
        )
    states = _begun(next(iter(loops.values())), record, measured, starts, past, level)
    steps = [round(horizon / record.period) for horizon in horizons]
    reached = [_reached(record, starts, step) for step in steps]
    errors: dict[str, list[np.ndarray]] = {}
    for loop in loops.values():
        flown = loop.fly(Starts(starts, max(steps)), states[None])[:, 0]
        for quantity, values in _errors(record, measured, loop.shown(flown), starts, steps, level).items():
            errors.setdefault(quantity, []).append(np.where(reached, values, np.nan))
    log = np.array([record.name] * len(starts))
    stacked = {quantity: np.stack(values) for quantity, values in errors.items()}
    return Predictions(tuple(vehicles), tuple(horizons), log, record.time[starts], stacked)


def _starts(record: FlightRecord, past: int, horizons: Sequence[float], share: float) -> np.ndarray:
    """(S,) samples at which predictions begin."""
    flying = airborne(record)
    wanted = held_out(flying, share) if share < 1.0 and flying.any() else flying
    apart = max(1, round(SPACING / record.period))
    last = round(min(horizons) / record.period)
    first = max(past, round(UNKNOWN / record.period))
    samples = np.arange(first, len(record.time) - last, apart)
    piece = pieces(record)
    whole = _reached(record, samples - past, past) & (piece[samples - first] == piece[samples])
    return np.asarray(samples[wanted[samples] & whole & _reached(record, samples, last)])


def _reached(record: FlightRecord, starts: np.ndarray, steps: int) -> np.ndarray:
    """(S,) True where the flight goes on for so many samples, in the air and without a gap."""
    ends = starts + steps
    inside = ends < len(record.time)
    ends = np.minimum(ends, len(record.time) - 1)
    piece, landed = pieces(record), np.concatenate([[0], np.cumsum(~airborne(record))])
    return np.asarray(inside & (piece[starts] == piece[ends]) & (landed[ends + 1] == landed[starts]))


def _begun(
    loop: OpenLoop, record: FlightRecord, measured: Sequence[str], starts: np.ndarray, past: int, level: bool
) -> np.ndarray:
    """Return the states (S, 12) at the starts, fitted to the measurements before them."""
    before = Starts(starts - past, past)
    at = before.samples[:, None] + np.arange(past + 1)
    values = {name: _continuous(record, name)[at] for name in measured}
    states = np.zeros((len(starts), 12))
    for name in measured:
        states[:, _ROWS[name] : _ROWS[name] + 3] = values[name][:, 0]
    deviations = {name: _USUAL[name] for name in measured}
    beliefs, first = (_BELIEFS if not level else np.where(np.arange(12) % 6 < 3, 1e3, 1e-6)), states
    for _ in range(2):

        def residuals(_: np.ndarray, states: np.ndarray) -> np.ndarray:
            flown = np.moveaxis(loop.shown(loop.fly(before, states)), 0, 2)
            off = [
                _difference(name, flown[..., _ROWS[name] : _ROWS[name] + 3], values[name]) / deviations[name]
                for name in measured
            ]
            shapes = [each.reshape(*each.shape[:2], -1) for each in off]
            return np.concatenate([*shapes, (states - first) / beliefs], axis=2)

        none = np.zeros(0)
        fitted = fit(Problem(residuals, none, _STATE_SCALES, none, none, none), none, states, iterations=8)
        states = fitted.states
        left = fitted.slopes.residuals[:, : 3 * (past + 1) * len(measured)].reshape(len(starts), len(measured), -1)
        for i, name in enumerate(measured):
            deviations[name] *= max(float(np.sqrt(np.mean(left[:, i] ** 2))), 0.05)
    return np.asarray(loop.fly(before, states[None])[-1, 0])


def _difference(name: str, predicted: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return predicted minus measured values, with differences of angles wrapped to [-π, π]."""
    return within_half_a_turn(predicted - values) if name == "attitude" else predicted - values


def _continuous(record: FlightRecord, name: str) -> np.ndarray:
    values = record.of(name)
    return np.unwrap(values, axis=0) if name == "attitude" else values


def _errors(
    record: FlightRecord,
    measured: Sequence[str],
    flown: np.ndarray,
    starts: np.ndarray,
    steps: Sequence[int],
    level: bool,
) -> dict[str, np.ndarray]:
    """(h, S) errors by quantity, of (T, S, 12) states."""
    found: dict[str, list[np.ndarray]] = {}
    for step in steps:
        at = np.minimum(starts + step, len(record.time) - 1)
        for name in measured:
            predicted = flown[step, :, _ROWS[name] : _ROWS[name] + 3]
            actual = record.of(name)[at]
            if level:
                quantity, error = {"position": "height", "velocity": "climb"}[name], np.abs(predicted - actual)[:, 2]
            elif name == "attitude":
                quantity, error = name, _angle_between(predicted, actual)
            else:
                quantity, error = name, np.linalg.norm(predicted - actual, axis=1)
            found.setdefault(quantity, []).append(error)
    return {quantity: np.stack(errors) for quantity, errors in found.items()}


def _angle_between(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(S,) angle of the rotation between attitudes, rad."""
    return np.asarray((rotations(one).inv() * rotations(other)).magnitude())


def _totals(values: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    return np.bincount(blocks, weights=values)


def _reach(totals: np.ndarray) -> float:
    """Half of the interval of a sum of blocks; endless if there is one."""
    count = len(totals)
    if count < 2:
        return math.inf
    variance = count / (count - 1) * float(np.sum(totals**2))
    return float(quantile(count - 1)) * math.sqrt(variance)
