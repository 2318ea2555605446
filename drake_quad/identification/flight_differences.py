"""Differences between flights of the same vehicle: thrust, trim force and wind of each flight.

Even in the same mean wind, the mean force on a vehicle differs between flights by several per cent of its weight: the
battery is mounted in another position, propellers are replaced, or motors are warm. A fit to all flights estimates the
mean of the flights. This module estimates the deviation of each flight from this mean.

Let θ be the estimates from all flights, and let H_w and g_w be the information and the score of window w. The thrust of
flight f, divided by the thrust with the parameters θ, is 1 + s_f. Here s_f is the Gauss-Newton step along the direction
d of the thrust parameters,

    s_f = -Σ_w dᵀ g_w / Σ_w dᵀ H_w d.

The filter estimates the force that the model does not explain. Its horizontal part along the axes of W is modelled as

    f(t) = R(ψ) b + w

where the trim force b turns with the heading ψ, and w is the force of a wind that is not logged. Both are estimated by
least squares. If the heading hardly changes, b and w are indistinguishable, and the estimate of b includes w.

If there are three or more flights, the variance between them is added to the variation of the estimates, so that the
distributions in a vehicle file describe the next flight. If F flights have the variance s² between them, the next
flight has the variance s² (1 + 1/F) around their mean, with F - 1 degrees of freedom.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from drake_quad.identification.evidence import Evidence, Uncertainty, jackknife, ratio, sums_over_blocks
from drake_quad.identification.fit import PredictionFit
from drake_quad.identification.model import NUM_BODY, Disturbance
from drake_quad.identification.prediction_errors import Predictor
from drake_quad.identification.prepared_logs import PreparedLogs, block_numbers_of_windows
from drake_quad.identification.random_effects import Variation
from drake_quad.identification.result import EstimatedValue, FlightDifference
from drake_quad.identification.results.estimates import Estimates, Source
from drake_quad.identification.results.vehicle_values import vehicle_value
from drake_quad.scenario.models import Scenario

TRIM_FORCE = ("trim_force.x", "trim_force.y")
"""Names of the trim force along x and y of B."""
MIN_FLIGHTS = 3
"""Smallest number of flights whose variance is estimated. Two flights would leave one degree of freedom."""
# Trim force and wind are distinguished if the unit vector along the heading has at least this variance, which
# corresponds to a standard deviation of the heading of about 18°. The variance of either estimate is then ten times the
# variance of their sum.
_MIN_HEADING_VARIANCE = 0.1
_MIN_FORCE_ERROR = 1e-9  # N, avoids a division by zero
_MIN_BLOCKS = 5  # smallest number of blocks from which the standard error of a flight's mean force is estimated


def flight_differences(
    logs: PreparedLogs, predictor: Predictor, fitted: PredictionFit, evidence: Evidence
) -> tuple[FlightDifference, ...]:
    """Estimate the thrust, trim force and wind of each flight, in the order of the logs.

    Args:
        logs: logs that were fitted.
        predictor: predictor of the outputs in windows of the logs.
        fitted: result of the fit.
        evidence: information of the windows.
    """
    flight_indices = _flights(predictor, len(predictor.windows))
    flights_of_parts = _flights(predictor, len(evidence.scores))
    direction = thrust_direction(evidence.names, evidence.values)
    has_poses = "position" in logs.signals and all(record.attitude is not None for record in logs.records)
    differences = []
    for flight in np.unique(flight_indices):
        thrust_is_undefined = not direction.any() or np.all(flight_indices == flight)
        thrust = None if thrust_is_undefined else _step_along(direction, evidence, flights_of_parts == flight)
        forces = _forces(logs, predictor, fitted, np.flatnonzero(flight_indices == flight)) if has_poses else {}
        differences.append(FlightDifference(logs.records[flight].name, thrust, forces))
    return tuple(differences)


def _flights(predictor: Predictor, count: int) -> np.ndarray:
    """Return the flight index (count,) of each window, or of each of the equal parts into which windows are divided."""
    return np.repeat([window.record for window in predictor.windows], count // len(predictor.windows))


def thrust_direction(names: Sequence[str], values: np.ndarray) -> np.ndarray:
    """Return the direction (p,) in which all thrust parameters grow in proportion; zero without thrust parameters."""
    mask = [name == "thrust_factor" or name.startswith("motors.curve") for name in names]
    return np.where(mask, values, 0.0)


def _step_along(direction: np.ndarray, evidence: Evidence, mask: np.ndarray) -> EstimatedValue | None:
    """Return the Gauss-Newton step of the parameters along a direction (p,).

    Only the windows for which `mask` (w,) is True are used. The result is None if they do not determine the step.
    """
    information = np.einsum("i,wij,j->w", direction, evidence.information[mask], direction)
    scores = evidence.scores[mask] @ direction
    if len(scores) < 2 or information.sum() <= 0.0:
        return None
    step = -scores.sum() / information.sum()
    uncertainty = jackknife(information[:, None, None], (scores + information * step)[:, None])
    return _estimated_value(step, uncertainty, 0, "1")


def _estimated_value(value: float, uncertainty: Uncertainty, index: int, unit: str) -> EstimatedValue:
    deviation = float(np.sqrt(uncertainty.covariance[index, index]))
    return EstimatedValue(float(value), deviation, unit, float(uncertainty.degrees_of_freedom[index]))


def _forces(
    logs: PreparedLogs, predictor: Predictor, fitted: PredictionFit, window_indices: np.ndarray
) -> dict[str, EstimatedValue]:
    """Return the trim force and the wind force of a flight, N, from all windows of this flight."""
    record = logs.records[predictor.windows[window_indices[0]].record]
    mass = float(logs.scenario.vehicle.mass)
    samples = np.array([predictor.windows[w].start for w in window_indices])[:, None] + np.arange(
        predictor.sizes.length
    )
    heading = record.of("attitude")[samples, 2]
    force = mass * estimated_force(predictor, fitted)[:, window_indices].transpose(1, 2, 0)
    duration = predictor.duration * len(window_indices) / len(predictor.windows)
    return forces_of(heading, force, block_numbers_of_windows(len(window_indices), duration, _MIN_BLOCKS))


def estimated_force(predictor: Predictor, fitted: PredictionFit) -> np.ndarray:
    """Return the horizontal specific force (2, W, T) that the filter has estimated at the samples of each window."""
    estimated_rows = list(predictor.rows)
    decay = np.exp(-predictor.period / fitted.noise.correlation_time)
    forces = []
    for axis, (varying, constant) in enumerate((("x", "constant_x"), ("y", "constant_y"))):
        axis_rows = [NUM_BODY + Disturbance._fields.index(name) for name in (varying, constant)]
        # `gains.disturbance` is the prediction for the next sample, at which the varying force has decayed by the
        # factor `decay`. Dividing by this factor gives the varying force at this sample.
        components = [fitted.gains.disturbance[predictor.evaluated][:, estimated_rows.index(row)] for row in axis_rows]
        forces.append(components[0] / decay[axis] + components[1])
    return np.stack(forces).swapaxes(1, 2)


def forces_of(heading: np.ndarray, force: np.ndarray, blocks: np.ndarray) -> dict[str, EstimatedValue]:
    """Return the trim force and the wind force of a flight, N.

    Args:
        heading: (W, T) heading in W windows, rad.
        force: (W, T, 2) horizontal force along x and y of the world frame, N.
        blocks: (W,) block number of each window, from 0. Errors of different blocks are treated as independent.

    Returns:
        `trim_force.x` and `.y` along the axes of B and, if the heading changes enough, `wind_force.x` and `.y` along
        the axes of the world frame.
    """
    cos, sin = np.cos(heading), np.sin(heading)
    columns = [np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)]
    names = [*TRIM_FORCE]
    if 1.0 - np.hypot(cos.mean(), sin.mean()) ** 2 > _MIN_HEADING_VARIANCE:
        columns += [np.broadcast_to(axis, force.shape) for axis in np.eye(2)]
        names += ["wind_force.x", "wind_force.y"]
    design = np.stack(columns, axis=-1).reshape(len(force), -1, len(columns))
    matrix = design.reshape(-1, len(columns))
    values, *_ = np.linalg.lstsq(matrix, force.ravel())
    errors = (matrix @ values - force.ravel()).reshape(len(force), -1)
    # The jackknife requires errors of unit variance.
    scale = max(float(np.std(errors)), _MIN_FORCE_ERROR)
    information = sums_over_blocks(design.swapaxes(1, 2) @ design / scale**2, blocks)
    scores = sums_over_blocks(np.einsum("wki,wk->wi", design, errors) / scale**2, blocks)
    uncertainty = jackknife(information, scores)
    return {
        name: _estimated_value(value, uncertainty, i, "N")
        for i, (name, value) in enumerate(zip(names, values, strict=True))
    }


def within_flights(evidence: Evidence, predictor: Predictor, differences: Sequence[FlightDifference]) -> Evidence:
    """Return the evidence of the windows, corrected as if the thrust parameters were equal in all flights.

    Args:
        evidence: information of the windows.
        predictor: predictor of the outputs in the windows.
        differences: estimated difference of each flight.
    """
    flight_indices = np.unique(_flights(predictor, len(evidence.scores)), return_inverse=True)[1]
    thrusts = np.array([0.0 if each.thrust is None else each.thrust.value for each in differences])
    steps = thrusts[flight_indices][:, None] * thrust_direction(evidence.names, evidence.values)
    return evidence._replace(scores=evidence.scores + np.einsum("wij,wj->wi", evidence.information, steps))


def with_differences(
    estimates: Estimates, differences: Sequence[FlightDifference], scenario: Scenario, duration: float
) -> Estimates:
    """Add the mean trim force, and the variation of thrust and trim force between flights, to the estimates.

    The estimates are returned unchanged if there are fewer than three flights.

    Args:
        estimates: estimates from all flights.
        differences: estimated difference of each of F flights from the mean of all flights.
        scenario: initial scenario of the fit.
        duration: mean duration of a flight, s.
    """
    if len(differences) < MIN_FLIGHTS:
        return estimates
    direction = thrust_direction(estimates.names, estimates.values)
    thrusts = [each.thrust for each in differences if each.thrust is not None]
    variance = next_flight_variance(thrusts) if direction.any() else 0.0
    covariance = variance * np.outer(direction, direction)
    if all(each.forces for each in differences):
        trims = [[each.forces[name] for each in differences] for name in TRIM_FORCE]
        estimates = _with_trim_force(estimates, trims, scenario)
        covariance = scipy.linalg.block_diag(covariance, *map(next_flight_variance, trims))
    freedom = float(len(differences) - 1)
    return replace(estimates, flight_variation=Variation(covariance, freedom, duration))


def next_flight_variance(flights: Sequence[EstimatedValue]) -> float:
    """Return the variance of the next flight around the mean of F flights, s² (1 + 1/F).

    s² is the variance of the estimates minus the mean variance of their errors, or zero if the difference is negative.
    """
    between = np.var([each.value for each in flights], ddof=1) - np.mean([each.deviation**2 for each in flights])
    return max(0.0, float(between)) * (1.0 + 1.0 / len(flights))


def _with_trim_force(estimates: Estimates, trims: Sequence[Sequence[EstimatedValue]], scenario: Scenario) -> Estimates:
    """Add the mean trim force to the estimates. Its error does not include the variation between flights."""
    values = np.array([[each.value for each in axis_trims] for axis_trims in trims]).mean(axis=1)
    errors = np.array([[each.deviation**2 for each in axis_trims] for axis_trims in trims])
    freedoms = np.array([[each.degrees_of_freedom for each in axis_trims] for axis_trims in trims])
    source = Source("mean force that the model does not explain", estimates.sources_of(0)[0].log)
    sources = [estimates.sources_of(index) for index in range(len(estimates.names))]
    return replace(
        estimates,
        names=(*estimates.names, *TRIM_FORCE),
        values=np.append(estimates.values, values + [vehicle_value(scenario, name) for name in TRIM_FORCE]),
        covariance=scipy.linalg.block_diag(estimates.covariance, np.diag(errors.mean(axis=1) / errors.shape[1])),
        degrees_of_freedom=np.append(
            estimates.degrees_of_freedom,
            ratio(errors.sum(axis=1) ** 2, (errors**2 / freedoms).sum(axis=1), np.inf),
        ),
        sources=(*sources, *[(source,)] * len(TRIM_FORCE)),
        variation=None if estimates.variation is None else estimates.variation.with_unknown_parameters(len(TRIM_FORCE)),
    )
