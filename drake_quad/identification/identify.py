"""Identification of a vehicle from flight logs, by prediction errors.

A Kalman filter predicts each measurement from the preceding ones, with the vehicle as its model
(`drake_quad.identification.prediction_errors`). The estimates are the parameters with the smallest prediction errors,
given a weak prior around the values of a data sheet (`drake_quad.identification.fit`).

The same method applies to all logs: to rotors that are commanded one by one or the attitude response of an autopilot,
and to measurements by an accelerometer, by motion capture, or of heights alone. Logs differ only in the outputs that
are predicted (`drake_quad.identification.prepared_logs`) and in the parameters that these may determine
(`drake_quad.identification.parameters`).

A parameter whose posterior is not much narrower than its prior is reported as not identified. It keeps its value, and
its uncertainty widens the intervals of the parameters with which it is correlated.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import scipy

from drake_quad.errors import InputError
from drake_quad.identification.delays import frame_age
from drake_quad.identification.fit import MIN_NOISE, PredictionFit, fit, noise_covariance
from drake_quad.identification.flight_differences import flight_differences, with_differences, within_flights
from drake_quad.identification.forecast import forecast
from drake_quad.identification.identifiability import (
    check_forecast,
    check_thrust,
    not_identified,
    undetermined,
    unexcited,
    weaker_than_disturbance,
)
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.model import DELAY
from drake_quad.identification.parameters import Parameter, names_of, parameters_of
from drake_quad.identification.prediction_errors import Output, Predictor
from drake_quad.identification.prepared_logs import MAX_DELAY, PreparedLogs, initial_noise, prepare, window_blocks
from drake_quad.identification.random_effects import uncertainty_of_mean, variation_of
from drake_quad.identification.result import ForecastOutput, Identification, Spread
from drake_quad.identification.results.estimates import Estimates, Explained, Source
from drake_quad.identification.results.held_out import hold_out
from drake_quad.identification.results.vehicle_numbers import with_numbers
from drake_quad.identification.sampling import (
    Synchronised,
    attenuated,
    fast_command_remarks,
    synchronised,
)
from drake_quad.identification.windows import held_out, steep_remarks
from drake_quad.scenario.models import Scenario
from drake_quad.vehicle.rigid_body import inertia_flaw

_POSE = ("position", "attitude")
_MIN_POSE_NOISE = 2.0 * MIN_NOISE  # SI units; smaller noise is at the limit of the fit
_NOISES = {signal: f"laboratory.motion_capture.{signal}_noise" for signal in _POSE}


def identify(
    records: Sequence[FlightRecord], scenario: Scenario, *, held_out_share: float = 1.0 / 3.0
) -> Identification:
    """Identify a vehicle from flight logs.

    Args:
        records: records of flights of the same vehicle. Each needs commands that the vehicle takes, and body rates with
            specific force, poses, or heights.
        scenario: scenario without distributions, with the initial values. Its mass and geometry are taken as known.
        held_out_share: share of the airborne time, at the end of each log, that is held out for the forecast.

    Raises:
        InputError: if no log is given, a log lacks a signal, the flights are too short, or the logged values are
            physically impossible.
    """
    if not records:
        raise InputError("there is no log to identify a vehicle from")
    logs = synchronised(records)
    try:
        found = _identified(logs, scenario, held_out_share)
    except (np.linalg.LinAlgError, FloatingPointError) as error:
        raise InputError(
            f"the logs cannot be fitted ({error}): their values are not those of a flying vehicle; check the units in"
            " the mapping"
        ) from error
    remarks = [*found.remarks, *logs.remarks, *fast_command_remarks(records)]
    flaw = inertia_flaw(found.vehicle.vehicle.inertia)
    if flaw:
        remarks.append(f"the identified inertia is not that of a rigid body, because of its error: {flaw}")
    return replace(found, remarks=tuple(remarks))


def _identified(given: Synchronised, scenario: Scenario, share: float) -> Identification:
    """Identify a vehicle from synchronised records; the other arguments are those of `identify`."""
    logs, scenario = prepare(given.records, scenario, late_attitude=given.late_attitude)
    parameters = parameters_of(
        logs.scenario,
        logs.signals,
        own_throttles=logs.own_throttles,
        delay=max(0.5 * logs.period, min(frame_age(scenario), 0.5 * MAX_DELAY)),
        max_delay=MAX_DELAY,
    )
    noise, start, early = initial_noise(logs.outputs), None, None
    shown: tuple[ForecastOutput, ...] = ()
    if share > 0.0:
        spared = [held_out(usable, share) for usable in logs.flying]
        kept = [usable & ~late for usable, late in zip(logs.flying, spared, strict=True)]
        training = fit(logs.predictor(names_of(parameters), kept), parameters, noise)
        shown = forecast(logs.predictor(names_of(parameters), spared, horizon=True), training.values, training.noise)
        check_forecast(shown)
        start, noise = training.values, training.noise
        early = _vehicle(logs, scenario, dict(zip(names_of(parameters), map(float, start), strict=True)))
    predictor = logs.predictor(names_of(parameters), logs.flying)
    fitted = fit(predictor, parameters, noise, start)
    check_thrust(logs.scenario, fitted.noise)
    held = weaker_than_disturbance(logs.scenario, predictor, parameters, fitted) | unexcited(logs, parameters, fitted)
    if held:
        kept = [i for i, parameter in enumerate(parameters) if parameter.name not in held]
        parameters = [parameters[i] for i in kept]
        predictor = logs.predictor(names_of(parameters), logs.flying)
        fitted = fit(predictor, parameters, fitted.noise, fitted.values[kept])
    found = _result(logs, scenario, predictor, parameters, fitted, shown, held)
    return replace(found, training_vehicle=early)


def _vehicle(logs: PreparedLogs, scenario: Scenario, values: dict[str, float]) -> Scenario:
    """Return the scenario with values of parameters, by name, and with the voltage of the thrust curve."""
    numbers = {name: value for name, value in values.items() if name != DELAY}
    if DELAY in values:
        ticks = (values[DELAY] - frame_age(scenario)) / scenario.laboratory.command_link.period
        numbers["laboratory.command_link.delay_ticks"] = max(0.0, ticks)
    vehicle = with_numbers(scenario, numbers)
    if logs.voltage is not None:
        motors = vehicle.vehicle.motors.model_copy(update={"voltage": logs.voltage})
        vehicle = vehicle.model_copy(update={"vehicle": vehicle.vehicle.model_copy(update={"motors": motors})})
    return vehicle


def _result(
    logs: PreparedLogs,
    scenario: Scenario,
    predictor: Predictor,
    parameters: Sequence[Parameter],
    fitted: PredictionFit,
    shown: Sequence[ForecastOutput],
    held: dict[str, str],
) -> Identification:
    """Return the result of a fit.

    Args:
        logs: logs that were fitted.
        scenario: scenario to which the estimates are written.
        predictor: predictor of the outputs in all windows.
        parameters: parameters that were fitted.
        fitted: result of the fit.
        shown: forecast of held-out flight; empty if nothing was held out.
        held: parameters that were held at their initial values, with the reason.
    """
    names = names_of(parameters)
    blocks = window_blocks(predictor)
    evidence = fitted.evidence(names, [parameter.scale for parameter in parameters], predictor.duration)
    differences = flight_differences(logs, predictor, fitted, evidence)
    variation = variation_of(within_flights(evidence, predictor, differences))
    uncertainty = uncertainty_of_mean(fitted.uncertainty(blocks), evidence, variation)
    remarks = [*_remarks(predictor, fitted, names), *steep_remarks(logs.records)]
    weak = not_identified(parameters, fitted.values, uncertainty)
    weak |= attenuated(logs.records, parameters, fitted.noise)
    if {*names} <= {*weak, DELAY}:
        raise InputError(
            "cannot identify the vehicle: the logs determine none of its parameters: "
            + "; ".join(f"{name}: {reason}" for name, reason in weak.items())
        )
    own = [i for i, name in enumerate(names) if name != DELAY]
    noise_names, noise_values, noise_covariances, weak_noise = _noise_estimates(predictor, fitted)
    noise_freedom = np.full(len(noise_names), float(fitted.errors.size))
    estimates = Estimates(
        names=(*(names[i] for i in own), *noise_names),
        values=np.concatenate([fitted.values[own], noise_values]),
        covariance=scipy.linalg.block_diag(uncertainty.covariance[np.ix_(own, own)], noise_covariances),
        degrees_of_freedom=np.concatenate([uncertainty.degrees_of_freedom[own], noise_freedom]),
        sources=Source(
            f"prediction errors of {' and '.join(sorted(signal.replace('_', ' ') for signal in logs.signals))}",
            ", ".join(dict.fromkeys(record.name for record in logs.records)),
        ),
        explained=_explained(parameters, fitted, predictor, shown) if shown else {},
        not_identified=undetermined(logs.scenario, names)
        | held
        | weak_noise
        | {name: reason for name, reason in weak.items() if name != DELAY},
        variation=None if variation is None else variation.part(own).with_unknown(len(noise_names)),
    )
    estimates = with_differences(estimates, differences, logs.scenario, predictor.duration / max(1, len(differences)))
    i = names.index(DELAY)
    deviation = float(np.sqrt(uncertainty.covariance[i, i]))
    delay = Spread(float(fitted.values[i]), deviation, "s", float(uncertainty.degrees_of_freedom[i]))
    numbers = dict(zip(estimates.names, map(float, estimates.values), strict=True))
    if DELAY in weak:
        remarks.append(f"the delay is not identified: {weak[DELAY]}")
    else:
        numbers[DELAY] = delay.value
    deviations = map(float, fitted.noise.measured)
    outputs = tuple(output._replace(deviation=own) for output, own in zip(shown, deviations, strict=False))
    covered = {name: each for name, each in hold_out(evidence).items() if name not in weak}
    result_delay = None if DELAY in weak else delay
    vehicle = _vehicle(logs, scenario, numbers)
    return Identification(
        estimates, vehicle, outputs, result_delay, fitted.noise, tuple(remarks), covered, flights=differences
    )


def _noise_estimates(
    predictor: Predictor, fitted: PredictionFit
) -> tuple[list[str], np.ndarray, np.ndarray, dict[str, str]]:
    """Return names, values and covariance of the pose noise, and the reason for each noise that is not identified."""
    rows = {name: predictor.outputs.index(Output(name, 0)) for name in _POSE if Output(name, 0) in predictor.outputs}
    large = {name: row for name, row in rows.items() if fitted.noise.measured[row] > _MIN_POSE_NOISE}
    weak = {_NOISES[name]: f"it is below {_MIN_POSE_NOISE:g} in SI units" for name in rows if name not in large}
    if not large:
        return [], np.empty(0), np.empty((0, 0)), weak
    places = [*large.values()]
    values = fitted.noise.measured[places]
    covariance = noise_covariance(predictor, fitted)[np.ix_(places, places)] * np.outer(values, values)
    return [_NOISES[name] for name in large], values, covariance, weak


def _explained(
    parameters: Sequence[Parameter], fitted: PredictionFit, predictor: Predictor, shown: Sequence[ForecastOutput]
) -> dict[str, Explained]:
    """Return the explained variance of the output that depends most on each parameter, by the name of the parameter."""
    count = len(predictor.outputs)
    slopes = fitted.slopes.reshape(len(fitted.slopes), -1, count, len(parameters))
    outputs = np.argmax(np.einsum("wtop,wtop->op", slopes, slopes), axis=0)
    return {
        parameter.name: Explained(shown[output].explained, shown[output].name)
        for parameter, output in zip(parameters, outputs, strict=True)
        if parameter.name != DELAY and np.isfinite(shown[output].explained)
    }


def _remarks(predictor: Predictor, fitted: PredictionFit, names: Sequence[str]) -> tuple[str, ...]:
    length = predictor.duration / len(predictor.windows)
    found = [f"{len(predictor.windows)} windows of {length:.2g} s in the air were fitted"]
    if "rotor_time_constant_down" in names:
        up, down = (fitted.values[names.index(f"rotor_time_constant{end}")] for end in ("", "_down"))
        found.append(f"small motions lag by the mean of the two time constants, {500.0 * (up + down):.3g} ms")
    if "rotor_aerodynamics.climb" in names:
        found.append("climb includes the linear drag along z of the body, which a flight does not distinguish from it")
    return tuple(found)
