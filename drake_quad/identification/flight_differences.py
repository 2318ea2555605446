"""Differences between flights of the same vehicle: the thrust, a trim force, and the wind of each flight.

Even with the same mean wind, the mean force on a vehicle differs between flights by several per cent of its weight: the
battery is at another position, propellers are exchanged, or motors are warm. A fit to all flights finds the mean. This
module estimates the deviation of each flight from it.

With θ the estimates from all flights, and with H_w and g_w the information and the score of window w, the thrust of
flight f relative to θ is the Gauss-Newton step along the direction d of the parameters of the thrust,

    s_f = -Σ_w dᵀ g_w / Σ_w dᵀ H_w d.

The filter estimates the specific force that the model does not explain, along the axes of W. Its horizontal part is
modelled as

    f(t) = R(ψ) b + w

with the trim force b, which turns with the heading ψ, and the force w of a wind that is not logged. Both follow from
least squares. If the heading hardly changes, the two are indistinguishable, and b includes w.

The variance between at least three flights is added to the variation of the estimates, so that the distributions in the
file of a vehicle describe the next flight. With F flights and the variance s² between them, the variance of the next
flight around their mean is s² (1 + 1/F), with F - 1 degrees of freedom.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from drake_quad.identification.evidence import Evidence, Uncertainty, jackknife, sums_over_blocks
from drake_quad.identification.fit import PredictionFit
from drake_quad.identification.model import NUM_BODY, Disturbance
from drake_quad.identification.prediction_errors import Predictor
from drake_quad.identification.prepared_logs import PreparedLogs, blocks_of
from drake_quad.identification.random_effects import Variation
from drake_quad.identification.result import FlightDifference, Spread
from drake_quad.identification.results.estimates import Estimates, Source
from drake_quad.identification.results.vehicle_numbers import number_of
from drake_quad.scenario.models import Scenario

TRIM_FORCE = ("trim_force.x", "trim_force.y")
MIN_FLIGHTS = 3
"""Smallest number of flights whose variance is estimated. Two flights would leave one degree of freedom."""
# Smallest variance of the unit vector of the heading for which trim force and wind are distinguished. It corresponds to
# a standard deviation of the heading of about 18°. The variance of either force is then ten times that of their sum.
_MIN_HEADING_VARIANCE = 0.1
_MIN_FORCE_ERROR = 1e-9  # N
_MIN_BLOCKS = 5  # smallest number of blocks of a flight that gives the error of its mean force


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
    flights = _flights(predictor, len(predictor.windows))
    parts = _flights(predictor, len(evidence.scores))
    direction = thrust_direction(evidence.names, evidence.values)
    has_forces = "position" in logs.signals and all(record.attitude is not None for record in logs.records)
    found = []
    for flight in np.unique(flights):
        only = not direction.any() or np.all(flights == flight)
        thrust = None if only else _step_along(direction, evidence, parts == flight)
        forces = _forces(logs, predictor, fitted, np.flatnonzero(flights == flight)) if has_forces else {}
        found.append(FlightDifference(logs.records[flight].name, thrust, forces))
    return tuple(found)


def _flights(predictor: Predictor, count: int) -> np.ndarray:
    """Return the index (count,) of the record of each window, or of each part if windows are divided equally."""
    return np.repeat([window.record for window in predictor.windows], count // len(predictor.windows))


def thrust_direction(names: Sequence[str], values: np.ndarray) -> np.ndarray:
    """Return the direction (p,) in which all thrust parameters grow by the same share; zero if there are none."""
    mask = [name == "thrust_factor" or name.startswith("motors.curve") for name in names]
    return np.where(mask, values, 0.0)


def _step_along(direction: np.ndarray, evidence: Evidence, chosen: np.ndarray) -> Spread | None:
    """Return the Gauss-Newton step along a direction for some windows; None if they do not determine it."""
    information = np.einsum("i,wij,j->w", direction, evidence.information[chosen], direction)
    scores = evidence.scores[chosen] @ direction
    if len(scores) < 2 or information.sum() <= 0.0:
        return None
    step = -scores.sum() / information.sum()
    uncertainty = jackknife(information[:, None, None], (scores + information * step)[:, None])
    return _spread(step, uncertainty, 0, "1")


def _spread(value: float, uncertainty: Uncertainty, place: int, unit: str) -> Spread:
    deviation = float(np.sqrt(uncertainty.covariance[place, place]))
    return Spread(float(value), deviation, unit, float(uncertainty.degrees_of_freedom[place]))


def _forces(logs: PreparedLogs, predictor: Predictor, fitted: PredictionFit, windows: np.ndarray) -> dict[str, Spread]:
    """Return the trim force and the wind force (N) in the flight that contains some windows."""
    record = logs.records[predictor.windows[windows[0]].record]
    mass = float(logs.scenario.vehicle.mass)
    samples = np.array([predictor.windows[w].start for w in windows])[:, None] + np.arange(predictor.sizes.length)
    heading = record.of("attitude")[samples, 2]
    force = mass * estimated_force(predictor, fitted)[:, windows].transpose(1, 2, 0)
    duration = predictor.duration * len(windows) / len(predictor.windows)
    return forces_of(heading, force, blocks_of(len(windows), duration, _MIN_BLOCKS))


def estimated_force(predictor: Predictor, fitted: PredictionFit) -> np.ndarray:
    """Return the horizontal specific force (2, W, T) that the filter has estimated at the samples of each window."""
    rows = list(predictor.rows)
    decay = np.exp(-predictor.period / fitted.noise.memory)
    found = []
    for axis, (own, constant) in enumerate((("x", "constant_x"), ("y", "constant_y"))):
        places = [NUM_BODY + Disturbance._fields.index(name) for name in (own, constant)]
        # The gains contain the disturbance at the next sample, by which time its first part has decayed.
        parts = [fitted.gains.disturbance[predictor.counted][:, rows.index(place)] for place in places]
        found.append(parts[0] / decay[axis] + parts[1])
    return np.stack(found).swapaxes(1, 2)


def forces_of(heading: np.ndarray, force: np.ndarray, blocks: np.ndarray) -> dict[str, Spread]:
    """Return the trim force and the wind force of a flight, N.

    Args:
        heading: (W, T) heading in W windows, rad.
        force: (W, T, 2) horizontal force in W, N.
        blocks: (W,) block number of each window, from 0; the force is correlated within blocks.

    Returns:
        `trim_force.x` and `.y` along the axes of B and, if the heading changes enough, `wind_force.x` and `.y` along
        those of W.
    """
    cos, sin = np.cos(heading), np.sin(heading)
    columns = [np.stack([cos, sin], axis=-1), np.stack([-sin, cos], axis=-1)]
    names = [*TRIM_FORCE]
    if 1.0 - np.hypot(cos.mean(), sin.mean()) ** 2 > _MIN_HEADING_VARIANCE:
        columns += [np.broadcast_to(axis, force.shape) for axis in np.eye(2)]
        names += ["wind_force.x", "wind_force.y"]
    design = np.stack(columns, axis=-1).reshape(len(force), -1, len(columns))
    flat = design.reshape(-1, len(columns))
    values, *_ = np.linalg.lstsq(flat, force.ravel())
    errors = (flat @ values - force.ravel()).reshape(len(force), -1)
    # The jackknife requires errors of unit variance.
    scale = max(float(np.std(errors)), _MIN_FORCE_ERROR)
    information = sums_over_blocks(design.swapaxes(1, 2) @ design / scale**2, blocks)
    scores = sums_over_blocks(np.einsum("wki,wk->wi", design, errors) / scale**2, blocks)
    uncertainty = jackknife(information, scores)
    return {
        name: _spread(value, uncertainty, i, "N") for i, (name, value) in enumerate(zip(names, values, strict=True))
    }


def within_flights(evidence: Evidence, predictor: Predictor, differences: Sequence[FlightDifference]) -> Evidence:
    """Return the evidence that windows would give if the thrust were the same in all flights.

    Args:
        evidence: information of the windows.
        predictor: predictor of the outputs in the windows.
        differences: estimated difference of each flight.
    """
    flights = np.unique(_flights(predictor, len(evidence.scores)), return_inverse=True)[1]
    own = np.array([0.0 if each.thrust is None else each.thrust.value for each in differences])
    steps = own[flights][:, None] * thrust_direction(evidence.names, evidence.values)
    return evidence._replace(scores=evidence.scores + np.einsum("wij,wj->wi", evidence.information, steps))


def with_differences(
    estimates: Estimates, differences: Sequence[FlightDifference], scenario: Scenario, duration: float
) -> Estimates:
    """Return the estimates with the mean trim force, and with the variation of thrust and trim force between flights.

    The estimates are returned unchanged if there are fewer than three flights.

    Args:
        estimates: estimates from all flights.
        differences: estimated difference of each of F flights.
        scenario: scenario that the fit began with.
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


def next_flight_variance(flights: Sequence[Spread]) -> float:
    """Return the variance of the next flight around the mean of F flights, s² (1 + 1/F).

    The mean variance of the errors is subtracted from s², which is then at least zero.
    """
    between = np.var([each.value for each in flights], ddof=1) - np.mean([each.deviation**2 for each in flights])
    return max(0.0, float(between)) * (1.0 + 1.0 / len(flights))


def _with_trim_force(estimates: Estimates, trims: Sequence[Sequence[Spread]], scenario: Scenario) -> Estimates:
    """Return the estimates with the mean trim force of F flights, whose error contains no variation of flights."""
    values = np.array([[each.value for each in own] for own in trims]).mean(axis=1)
    errors = np.array([[each.deviation**2 for each in own] for own in trims])
    freedoms = np.array([[each.degrees_of_freedom for each in own] for own in trims])
    source = Source("mean force that nothing else explains", estimates.sources_of(0)[0].log)
    sources = [estimates.sources_of(place) for place in range(len(estimates.names))]
    return replace(
        estimates,
        names=(*estimates.names, *TRIM_FORCE),
        values=np.append(estimates.values, values + [number_of(scenario, name) for name in TRIM_FORCE]),
        covariance=scipy.linalg.block_diag(estimates.covariance, np.diag(errors.mean(axis=1) / errors.shape[1])),
        degrees_of_freedom=np.append(
            estimates.degrees_of_freedom, errors.sum(axis=1) ** 2 / (errors**2 / freedoms).sum(axis=1)
        ),
        sources=(*sources, *[(source,)] * len(TRIM_FORCE)),
        variation=None if estimates.variation is None else estimates.variation.with_unknown(len(TRIM_FORCE)),
    )
