"""Comparison of a logged flight with simulated flights along the same reference, under the control of a scenario."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError, shown
from drake_quad.fleets.fleet_simulation import simulate_fleet
from drake_quad.flight.flight import Flight
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate
from drake_quad.identification.flown_again.flown_part import flown_part
from drake_quad.identification.flown_again.reference import LoggedReference, is_slow, logged_reference
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.laboratory.metrics import Metrics
from drake_quad.planning.duration import flight_duration
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario
from drake_quad.signals import Reference, State

AXES = ("x", "y", "z", "all")
"""Columns of `ErrorFigures`: the axes of W, and the norm of the error."""
INTERVAL = (0.025, 0.975)
"""Probabilities of the ends of the interval of predictions."""
DEFAULT_REST = 8.0
"""Duration of the hover before the log, s. The integrators of on-board controllers settle within some seconds."""
_MIN_MOVEMENT = 1e-2  # m, movement of the reference at which the comparison starts
_FLEET_SIZE = 32  # number of vehicles that are simulated together


class ErrorFigures(NamedTuple):
    """Statistics of position errors along x, y and z, and of their norm, m.

    Attributes:
        rmse: (..., 4) root mean square.
        mean: (..., 4) mean; signed along the axes.
        largest: (..., 4) 95th percentile of the magnitude.
    """

    rmse: np.ndarray
    mean: np.ndarray
    largest: np.ndarray

    @classmethod
    def of(cls, error: np.ndarray) -> "ErrorFigures":
        """Return the statistics of errors (..., samples, 3) in m; NaN if an error is NaN because of a crash."""
        size = np.concatenate([error, np.linalg.norm(error, axis=-1, keepdims=True)], axis=-1)
        return cls(np.sqrt(np.mean(size**2, axis=-2)), np.mean(size, axis=-2), np.quantile(np.abs(size), 0.95, axis=-2))


@dataclass(frozen=True, eq=False)
class LogComparison:
    """Logged flight and its predictions.

    Attributes:
        record: record of the log.
        scenario: scenario of the predictions, with the reference of the log as its route.
        reference: reference of the log.
        plan: plan of the route.
        time: (n,) times of the samples that are compared, on the clock of the log, s.
        target: (n, 3) position of the route at these times, in W, m.
        flown: (n, 3) logged position error, reference minus position in W, m.
        predicted: (samples, n, 3) measured position error of each simulated flight, m; NaN after a crash.
    """

    record: FlightRecord
    scenario: Scenario
    reference: LoggedReference
    plan: Plan
    time: np.ndarray
    target: np.ndarray
    flown: np.ndarray
    predicted: np.ndarray

    @property
    def crashes(self) -> int:
        """Number of predicted flights that end in a crash."""
        return int(np.isnan(self.predicted).any(axis=(1, 2)).sum())

    @property
    def varies(self) -> bool:
        """True if the predicted flights differ. Without distributions, wind and noise they are identical."""
        return not np.allclose(self.predicted, self.predicted[:1], rtol=0.0, atol=1e-9, equal_nan=True)

    @property
    def flown_figures(self) -> ErrorFigures:
        """Statistics (4,) of the logged errors."""
        return ErrorFigures.of(self.flown)

    def predicted_figures(self) -> ErrorFigures:
        """Return the statistics (samples, 4) of each predicted flight; infinite for a flight with a crash."""
        figures = ErrorFigures.of(self.predicted)
        return ErrorFigures(*(np.where(np.isnan(values), np.inf, values) for values in figures))

    def interval(self, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the median, lower and upper end (4,) of the 95 % interval of a statistic, given by its name."""
        values = getattr(self.predicted_figures(), name)
        # The method "nearest" is used because interpolation fails for infinite values.
        median, low, high = np.quantile(values, (0.5, *INTERVAL), axis=0, method="nearest")
        return median, low, high

    def within(self, name: str) -> np.ndarray:
        """Return a mask (4,) of the axes on which a statistic of the log is inside the interval of the predictions."""
        _, low, high = self.interval(name)
        flown = getattr(self.flown_figures, name)
        return np.asarray((flown >= low) & (flown <= high))

    def typical_sample(self) -> int:
        """Return the number of the sample with the median RMSE."""
        rmse = self.predicted_figures().rmse[:, -1]
        return int(np.argsort(rmse, kind="stable")[(len(rmse) - 1) // 2])


def compare_with_log(
    record: FlightRecord,
    scenario: Scenario,
    *,
    samples: int = 1000,
    rest: float = DEFAULT_REST,
    start: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> LogComparison:
    """Simulate the reference of a log under the control of a scenario, and compare the result with the logged flight.

    The simulated vehicle hovers at the first point of the reference for `rest`, and then follows the reference on the
    clock of the log. If the reference jumps and the vehicle takes off in the log, the simulation begins at the point
    of the lift-off.

    The comparison covers the part of the log in free flight, see `flown_part`. It begins when the reference of the log
    has moved by 1 cm, so that a take-off before the log does not count. If the reference never moves, it covers the
    whole log. Both errors are those of measured positions, since a log contains no true positions.

    Args:
        record: record of the log, with position and reference position.
        scenario: scenario whose route is replaced by the reference of the log. If it has distributions, each sample
            draws its own vehicle. Sample i has the same wind and noise for all scenarios with the same seed.
        samples: number of simulated flights.
        rest: duration of the hover before the log, s.
        start: time in the log at which the comparison starts, s; by default as described above.
        progress: function that is called with the number of simulated flights and their total number.

    Raises:
        InputError: if the log has no position, its vehicle does not fly, its reference cannot be flown, there is
            nothing to compare, or the vehicle has no time step.
    """
    if scenario.vehicle.time_step == 0.0:
        raise InputError("vehicle.time_step is 0; flights are compared with a log only with a time step")
    part = flown_part(record)
    record = record.part(slice(part.end))
    reference = logged_reference(record, rest=rest, lift_off=part.lift_off)
    begin = max(_first_movement(record), float(record.time[part.first])) if start is None else start
    chosen = (record.time >= max(begin, -reference.start)) & (record.time <= reference.end)
    if chosen.sum() < 2:
        raise InputError(f"nothing of the log {shown(record.name)} is left to compare from {begin:g} s on")
    flying = on_route(scenario, reference)
    plan = plan_route(flying)
    instants = record.time[chosen] + reference.start
    target = evaluate(plan.flown_path, instants).T
    # Between the samples of a slow reference, only the path shows where the reference was.
    followed = target if is_slow(record) else record.of("reference_position")[chosen]
    flown = followed - record.of("position")[chosen]
    predicted = _positions(flying, plan, instants, samples, progress)
    return LogComparison(record, flying, reference, plan, record.time[chosen], target, flown, target - predicted)


def on_route(scenario: Scenario, reference: LoggedReference) -> Scenario:
    """Return the scenario with the reference of a log as its route, and with metrics over the whole log."""
    start = max(reference.start, 0.0)
    window = scenario.metrics.model_copy(update={"start": start, "first_lap": None, "end": None})
    return scenario.model_copy(update={"route": reference.route, "duration": None, "metrics": window})


def side_by_side(comparison: LogComparison) -> dict[str, Flight]:
    """Return the logged flight and the typical prediction as two flights of the same reference, for a replay.

    The states of both are measured states. If the log contains no rotor speeds, those of the prediction are shown. A
    prediction that crashes before the start of the log is left out.
    """
    record, start = comparison.record, comparison.reference.start
    flight = simulate(comparison.scenario, sample=comparison.typical_sample(), plan=comparison.plan, compiled=True)
    rotor_speed = record.rotor_speed
    if rotor_speed is None:
        rotor_speed = _at(record.time + start, flight.time, flight["rotor_speed"])
    signals = {
        "state": _state(record),
        "reference": comparison.plan.reference().vector_values(record.time + start)[: len(Reference._fields)].T,
        "rotor_speed": rotor_speed,
        "wind": np.zeros((len(record.time), 3)),
    }
    unknown = Metrics._make(np.nan for _ in Metrics._fields)._replace(crash_time=np.inf)
    flights = {"flown": replace(flight, time=record.time, signals=signals, metrics=unknown)}
    kept = flight.time >= start
    if kept.any():
        shown_signals = {name: flight[name][kept] for name in signals} | {"state": flight["measurement"][kept]}
        flights["predicted"] = replace(flight, time=flight.time[kept] - start, signals=shown_signals)
    return flights


def _first_movement(record: FlightRecord) -> float:
    """Return the last time at which the reference is still at its first position, s; 0 if it never moves."""
    position = record.of("reference_position")
    moved = np.linalg.norm(position - position[0], axis=1) > _MIN_MOVEMENT
    return float(record.time[max(int(np.argmax(moved)) - 1, 0)])


def _positions(
    scenario: Scenario, plan: Plan, instants: np.ndarray, samples: int, progress: Callable[[int, int], None] | None
) -> np.ndarray:
    """Return the measured positions (samples, n, 3) of simulated flights at instants (n,), m; NaN after a crash."""
    size = min(samples, _FLEET_SIZE)
    duration = flight_duration(scenario, plan)
    simulation = simulate_fleet(Batch.draw(scenario, range(size)), plan, record=True, compiled=True)
    found = np.empty((samples, len(instants), 3))
    for first in range(0, samples, size):
        numbers = range(first, min(first + size, samples))
        if first:
            simulation.reset(Batch.draw(scenario, numbers).padded(size))
        simulation.fly(duration)
        crash_time = np.asarray(simulation.metrics().crash_time)
        time, signals = simulation.recording()
        measured = State(*signals["measurement"].reshape(len(time), -1, size).transpose(1, 0, 2))
        places = [np.asarray(row) for row in (measured.x, measured.y, measured.z)]
        for vehicle, number in enumerate(numbers):
            found[number] = _at(instants, time, np.column_stack([row[:, vehicle] for row in places]))
            found[number, instants > crash_time[vehicle]] = np.nan
        if progress is not None:
            progress(numbers[-1] + 1, samples)
    return found


def _at(instants: np.ndarray, time: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return rows at other instants (n,) by linear interpolation, (n, columns)."""
    return np.column_stack([np.interp(instants, time, column) for column in rows.T])


def _state(record: FlightRecord) -> np.ndarray:
    """Return the logged state (n, 12); signals that are not logged are zero."""
    zero = np.zeros((len(record.time), 3))
    parts = (record.of("position"), record.attitude, record.velocity, record.body_rates)
    return np.hstack([zero if part is None else part for part in parts])
