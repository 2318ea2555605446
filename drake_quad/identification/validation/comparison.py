"""Comparison of a logged flight with simulated flights along the same reference, with the controller of a scenario."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError, short_repr
from drake_quad.fleets.fleet_simulation import simulate_fleet
from drake_quad.flight.flight import Flight
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate
from drake_quad.identification.validation.free_flight import free_flight
from drake_quad.identification.validation.reference import LoggedReference, is_slow, logged_reference
from drake_quad.laboratory.metrics import Metrics
from drake_quad.logs.record import FlightRecord
from drake_quad.planning.duration import flight_duration
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.models import Scenario
from drake_quad.signals import Reference, State

AXES = ("x", "y", "z", "all")
"""Columns of `ErrorStatistics`: the axes of W, and the norm of the error."""
INTERVAL_QUANTILES = (0.025, 0.975)
"""Quantiles at the ends of the 95 % interval of the predictions."""
DEFAULT_REST = 8.0
"""Duration of the hover before the log, s. The integrators of on-board controllers settle within some seconds."""
_MIN_MOVEMENT = 1e-2  # m; the comparison starts when the reference has moved by this distance
_BATCH_SIZE = 32  # number of flights that are simulated at once


class ErrorStatistics(NamedTuple):
    """Statistics of position errors along x, y and z, and of their norm, m.

    Attributes:
        rmse: (..., 4) root mean square.
        mean: (..., 4) mean; signed along the axes.
        largest: (..., 4) 95th percentile of the absolute value, which represents the largest error.
    """

    rmse: np.ndarray
    mean: np.ndarray
    largest: np.ndarray

    @classmethod
    def of(cls, error: np.ndarray) -> "ErrorStatistics":
        """Return the statistics of errors (..., samples, 3) in m; NaN if an error is NaN because of a crash."""
        components = np.concatenate([error, np.linalg.norm(error, axis=-1, keepdims=True)], axis=-1)
        return cls(
            np.sqrt(np.mean(components**2, axis=-2)),
            np.mean(components, axis=-2),
            np.quantile(np.abs(components), 0.95, axis=-2),
        )


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
        logged_error: (n, 3) position error in the log, reference minus position in W, m.
        predicted: (samples, n, 3) measured position error of each simulated flight in W, m; NaN after a crash.
    """

    record: FlightRecord
    scenario: Scenario
    reference: LoggedReference
    plan: Plan
    time: np.ndarray
    target: np.ndarray
    logged_error: np.ndarray
    predicted: np.ndarray

    @property
    def crashes(self) -> int:
        """Number of predicted flights that end in a crash."""
        return int(np.isnan(self.predicted).any(axis=(1, 2)).sum())

    @property
    def varies(self) -> bool:
        """True if the predicted flights differ, which requires distributions, wind or noise in the scenario."""
        return not np.allclose(self.predicted, self.predicted[:1], rtol=0.0, atol=1e-9, equal_nan=True)

    @property
    def logged_statistics(self) -> ErrorStatistics:
        """Statistics (4,) of the logged position errors, with components in the order of `AXES`."""
        return ErrorStatistics.of(self.logged_error)

    def predicted_statistics(self) -> ErrorStatistics:
        """Return the statistics (samples, 4) of each predicted flight; infinite for a flight with a crash."""
        statistics = ErrorStatistics.of(self.predicted)
        return ErrorStatistics(*(np.where(np.isnan(values), np.inf, values) for values in statistics))

    def interval(self, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return median, lower and upper end of the 95 % interval of the named statistic, (4,) each as in `AXES`."""
        values = getattr(self.predicted_statistics(), name)
        # The method "nearest" is used because interpolation fails for infinite values.
        median, low, high = np.quantile(values, (0.5, *INTERVAL_QUANTILES), axis=0, method="nearest")
        return median, low, high

    def within(self, name: str) -> np.ndarray:
        """Return a mask (4,): True where a statistic of the logged errors is inside the predicted 95 % interval.

        Args:
            name: field of `ErrorStatistics`. The components of the mask are in the order of `AXES`.
        """
        _, low, high = self.interval(name)
        logged = getattr(self.logged_statistics, name)
        return np.asarray((logged >= low) & (logged <= high))

    def median_sample(self) -> int:
        """Return the index of the simulated flight with the median RMSE."""
        rmse = self.predicted_statistics().rmse[:, -1]
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
    """Simulate the reference of a log with the controller of a scenario, and compare the result with the logged flight.

    The simulated vehicle hovers at the first point of the reference for `rest`, and then follows the reference on the
    clock of the log. If the reference jumps and the vehicle takes off in the log, the simulation begins at the point
    of the lift-off.

    The comparison covers the part of the log in free flight, see `free_flight`. It begins when the reference of the log
    has moved by 1 cm, so that transients of an earlier take-off are excluded. If the reference never moves, the
    comparison covers the whole free flight. Both errors are computed from measured positions, since a log contains no
    true positions.

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
        raise InputError("vehicle.time_step is 0; a comparison with a log needs a time step above 0")
    free = free_flight(record)
    record = record.subset(slice(free.end))
    reference = logged_reference(record, rest=rest, lift_off=free.lift_off)
    first_time = max(_first_movement(record), float(record.time[free.first])) if start is None else start
    is_compared = (record.time >= max(first_time, -reference.start)) & (record.time <= reference.end)
    if is_compared.sum() < 2:
        raise InputError(
            f"the log {short_repr(record.name)} has fewer than two samples to compare from {first_time:g} s on"
        )
    routed_scenario = on_route(scenario, reference)
    plan = plan_route(routed_scenario)
    times = record.time[is_compared] + reference.start
    target = evaluate(plan.extended_path, times).T
    # Between the samples of a slowly logged reference, the path replaces the logged positions.
    logged_target = target if is_slow(record) else record.of("reference_position")[is_compared]
    logged_error = logged_target - record.of("position")[is_compared]
    predicted = _positions(routed_scenario, plan, times, samples, progress)
    return LogComparison(
        record,
        routed_scenario,
        reference,
        plan,
        record.time[is_compared],
        target,
        logged_error,
        target - predicted,
    )


def on_route(scenario: Scenario, reference: LoggedReference) -> Scenario:
    """Return the scenario with the reference of a log as its route, and with metrics over the whole log."""
    start = max(reference.start, 0.0)
    window = scenario.metrics.model_copy(update={"start": start, "first_lap": None, "end": None})
    return scenario.model_copy(update={"route": reference.route, "duration": None, "metrics": window})


def flights_to_compare(comparison: LogComparison) -> dict[str, Flight]:
    """Return the logged flight, and the predicted flight with the median error, to replay them side by side.

    Both flights have the same reference, and contain measured states. If the log contains no rotor speeds, the logged
    flight is returned with the rotor speeds of the prediction. A prediction that crashes before the start of the log is
    left out.
    """
    record, start = comparison.record, comparison.reference.start
    prediction = simulate(comparison.scenario, sample=comparison.median_sample(), plan=comparison.plan, compiled=True)
    rotor_speed = record.rotor_speed
    if rotor_speed is None:
        rotor_speed = _interpolated(record.time + start, prediction.time, prediction["rotor_speed"])
    signals = {
        "state": _state(record),
        "reference": comparison.plan.reference().vector_values(record.time + start)[: len(Reference._fields)].T,
        "rotor_speed": rotor_speed,
        "wind": np.zeros((len(record.time), 3)),
    }
    unknown_metrics = Metrics._make(np.nan for _ in Metrics._fields)._replace(crash_time=np.inf)
    flights = {"flown": replace(prediction, time=record.time, signals=signals, metrics=unknown_metrics)}
    is_after_start = prediction.time >= start
    if is_after_start.any():
        predicted_signals = {name: prediction[name][is_after_start] for name in signals} | {
            "state": prediction["measurement"][is_after_start]
        }
        flights["predicted"] = replace(
            prediction, time=prediction.time[is_after_start] - start, signals=predicted_signals
        )
    return flights


def _first_movement(record: FlightRecord) -> float:
    """Return the last time before the reference has moved by 1 cm, s; 0 if it never moves."""
    position = record.of("reference_position")
    has_moved = np.linalg.norm(position - position[0], axis=1) > _MIN_MOVEMENT
    return float(record.time[max(int(np.argmax(has_moved)) - 1, 0)])


def _positions(
    scenario: Scenario, plan: Plan, times: np.ndarray, samples: int, progress: Callable[[int, int], None] | None
) -> np.ndarray:
    """Return the measured positions (samples, n, 3) of simulated flights at some times (n,), m; NaN after a crash."""
    size = min(samples, _BATCH_SIZE)
    duration = flight_duration(scenario, plan)
    simulation = simulate_fleet(Batch.draw(scenario, range(size)), plan, record=True, compiled=True)
    positions = np.empty((samples, len(times), 3))
    for first in range(0, samples, size):
        sample_numbers = range(first, min(first + size, samples))
        if first:
            simulation.reset(Batch.draw(scenario, sample_numbers).padded(size))
        simulation.fly(duration)
        crash_time = np.asarray(simulation.metrics().crash_time)
        time, signals = simulation.recording()
        measured = State(*signals["measurement"].reshape(len(time), -1, size).transpose(1, 0, 2))
        coordinates = [np.asarray(row) for row in (measured.x, measured.y, measured.z)]
        for vehicle, sample in enumerate(sample_numbers):
            positions[sample] = _interpolated(times, time, np.column_stack([row[:, vehicle] for row in coordinates]))
            positions[sample, times > crash_time[vehicle]] = np.nan
        if progress is not None:
            progress(sample_numbers[-1] + 1, samples)
    return positions


def _interpolated(new_times: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values (n, columns) at new times (n,) by linear interpolation."""
    return np.column_stack([np.interp(new_times, time, column) for column in values.T])


def _state(record: FlightRecord) -> np.ndarray:
    """Return the logged state (n, 12); signals that are not logged are zero."""
    zero = np.zeros((len(record.time), 3))
    parts = (record.of("position"), record.attitude, record.velocity, record.body_rates)
    return np.hstack([zero if part is None else part for part in parts])
