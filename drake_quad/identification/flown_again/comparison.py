"""A flight of a log beside the same flight as a scenario predicts it: its reference, under the scenario's control."""

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
from drake_quad.identification.flown_again.reference import LoggedReference, logged_reference
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.laboratory.metrics import Metrics
from drake_quad.planning.duration import flight_duration
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario
from drake_quad.signals import Reference, State

# Of what an error is told: along each axis of W, and its norm.
AXES = ("x", "y", "z", "all")
# Probabilities between which a prediction lies.
INTERVAL = (0.025, 0.975)
# Before the log, s: integrators of on-board controllers find what they have to hold within some seconds.
REST = 8.0
# What the reference has moved by when it is on its way, m.
_MOVED = 1e-2
# Vehicles that fly side by side, and so are recorded at once.
_FLEET = 32


class ErrorFigures(NamedTuple):
    """What is told of position errors along x, y, z, and of their norm, m.

    Attributes:
        rmse: (..., 4) root of the mean square.
        mean: (..., 4) mean, with its sign along an axis.
        largest: (..., 4) what 95 % of the errors do not exceed in size.
    """

    rmse: np.ndarray
    mean: np.ndarray
    largest: np.ndarray

    @classmethod
    def of(cls, error: np.ndarray) -> "ErrorFigures":
        """Those of errors (..., samples, 3) in m; NaN where a vehicle did not get to the end."""
        size = np.concatenate([error, np.linalg.norm(error, axis=-1, keepdims=True)], axis=-1)
        return cls(np.sqrt(np.mean(size**2, axis=-2)), np.mean(size, axis=-2), np.quantile(np.abs(size), 0.95, axis=-2))


@dataclass(frozen=True, eq=False)
class LogComparison:
    """A flown flight and its predictions.

    Attributes:
        record: of the log.
        scenario: that predicts, with the reference of the log as its route.
        reference: of the log.
        plan: of the route.
        time: (n,) the log's samples from which on both are compared, s of the log.
        target: (n, 3) position of the route then, in W, m.
        flown: (n, 3) position error as it is logged, reference minus position in W, m.
        predicted: (samples, n, 3) the same of each flight of the scenario, as it is measured, NaN from a crash on, m.
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
        """Number of predictions that end in a crash."""
        return int(np.isnan(self.predicted).any(axis=(1, 2)).sum())

    @property
    def varies(self) -> bool:
        """Whether the predictions differ; they do not without distributions, wind and noise."""
        return not np.allclose(self.predicted, self.predicted[:1], rtol=0.0, atol=1e-9, equal_nan=True)

    @property
    def flown_figures(self) -> ErrorFigures:
        """(4,) of the log."""
        return ErrorFigures.of(self.flown)

    def predicted_figures(self) -> ErrorFigures:
        """(samples, 4) of each flight; a crash is an infinite error."""
        figures = ErrorFigures.of(self.predicted)
        return ErrorFigures(*(np.where(np.isnan(values), np.inf, values) for values in figures))

    def interval(self, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(4,) median, lower and upper end of the 95 % interval of a figure, by its name."""
        values = getattr(self.predicted_figures(), name)
        # Ranks, not interpolation: a share of flights may be at infinity.
        median, low, high = np.quantile(values, (0.5, *INTERVAL), axis=0, method="nearest")
        return median, low, high

    def within(self, name: str) -> np.ndarray:
        """(4,) whether a figure of the log lies within the interval of the predictions."""
        _, low, high = self.interval(name)
        flown = getattr(self.flown_figures, name)
        return np.asarray((flown >= low) & (flown <= high))

    def typical_sample(self) -> int:
        """Number of the sample whose RMSE is the median of all."""
        rmse = self.predicted_figures().rmse[:, -1]
        return int(np.argsort(rmse, kind="stable")[(len(rmse) - 1) // 2])


def compare_with_log(
    record: FlightRecord,
    scenario: Scenario,
    *,
    samples: int = 1000,
    rest: float = REST,
    start: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> LogComparison:
    """Simulate the reference of a log under a scenario's control, and compare the simulation with the logged flight.

    The simulated vehicle hovers at the first point of the reference for `rest` and then follows the log's clock. If the
    reference jumps and the vehicle takes off in the log, the simulated vehicle begins where the flown one lifts off.

    The comparison covers the part of the log in free flight, see `flown_part`. It begins when the reference of the log
    has moved by 1 cm, so that a take-off before the log does not count. If the reference never moves, it covers the
    whole log. Both errors are those of measured positions, since a log contains no true positions.

    Args:
        record: record of the log, with position and reference position.
        scenario: scenario whose route is replaced by the reference of the log. If it has distributions, each sample
            draws its own vehicle. Sample i has the same wind and noise for all scenarios with the same seed.
        samples: number of simulated flights.
        rest: duration of the hover before the log, s.
        start: time of the log from which errors count, s.
        progress: function that is called with the number of simulated flights and their total number.

    Raises:
        InputError: if the log has no position, its vehicle does not fly, its reference cannot be flown, there is
            nothing to compare, or the vehicle has no time step.
    """
    if scenario.vehicle.time_step == 0.0:
        raise InputError("vehicle.time_step is 0; flights are compared with a log only with a time step")
    part = flown_part(record)
    record = record.part(slice(part.end))
    flown = record.of("reference_position") - record.of("position")
    reference = logged_reference(record, rest=rest, lift_off=part.lift_off)
    begun = max(_moves_from(record), float(record.time[part.first])) if start is None else start
    chosen = record.time >= max(begun, -reference.start)
    if chosen.sum() < 2:
        raise InputError(f"nothing of the log {shown(record.name)} is left to compare from {begun:g} s on")
    flying = on_route(scenario, reference)
    plan = plan_route(flying)
    instants = record.time[chosen] + reference.start
    target = evaluate(plan.flown_path, instants).T
    predicted = _positions(flying, plan, instants, samples, progress)
    return LogComparison(
        record, flying, reference, plan, record.time[chosen], target, flown[chosen], target - predicted
    )


def on_route(scenario: Scenario, reference: LoggedReference) -> Scenario:
    """The scenario with the reference of a log in the place of its route; its whole flight is flown and counts."""
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
    nothing = Metrics._make(np.nan for _ in Metrics._fields)._replace(crash_time=np.inf)
    flights = {"flown": replace(flight, time=record.time, signals=signals, metrics=nothing)}
    kept = flight.time >= start
    if kept.any():
        shown_signals = {name: flight[name][kept] for name in signals} | {"state": flight["measurement"][kept]}
        flights["predicted"] = replace(flight, time=flight.time[kept] - start, signals=shown_signals)
    return flights


def _moves_from(record: FlightRecord) -> float:
    """The last moment at which the reference is still where it began, s; 0 if it stays there."""
    position = record.of("reference_position")
    moved = np.linalg.norm(position - position[0], axis=1) > _MOVED
    return float(record.time[max(int(np.argmax(moved)) - 1, 0)])


def _positions(
    scenario: Scenario, plan: Plan, instants: np.ndarray, samples: int, progress: Callable[[int, int], None] | None
) -> np.ndarray:
    """(samples, n, 3) the measured positions of samples of a scenario at instants (n,), m; NaN from a crash on."""
    size = min(samples, _FLEET)
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
    """(n, columns) rows at other instants (n,), by linear interpolation."""
    return np.column_stack([np.interp(instants, time, column) for column in rows.T])


def _state(record: FlightRecord) -> np.ndarray:
    """(n, 12) the logged state; at rest and level where it is not logged."""
    nothing = np.zeros((len(record.time), 3))
    parts = (record.of("position"), record.attitude, record.velocity, record.body_rates)
    return np.hstack([nothing if part is None else part for part in parts])
