"""Identification of a vehicle from flight logs, by prediction errors.

A Kalman filter, whose model is the vehicle, predicts each measurement from the preceding ones
(`drake_quad.identification.prediction_errors`). The estimates minimise the prediction errors and the distance to a weak
prior around the values of a data sheet (`drake_quad.identification.fit`).

The same method applies to all logs. The commands may be rotor commands, or attitude commands to an autopilot. The
measurements may come from an accelerometer, from motion capture, or from a height sensor alone. Logs differ only in the
outputs that are predicted (`drake_quad.identification.prepared_logs`) and in the parameters that these outputs may
determine (`drake_quad.identification.parameters`).

A parameter whose posterior is not much narrower than its prior is not identified and keeps its initial value. It is
fitted nevertheless, so that its uncertainty widens the intervals of the parameters with which it is correlated. The
resulting vehicle is the fit of all others, given its initial value. Only coefficients of the thrust curve keep their
estimates: the curve is often known in the range of the flight although its coefficients are not.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError
from drake_quad.framework.result_cache import cached_on_disk
from drake_quad.identification.delays import frame_age
from drake_quad.identification.fit import MIN_NOISE, PredictionFit, fit, noise_covariance
from drake_quad.identification.flight_differences import flight_differences, with_differences, within_flights
from drake_quad.identification.forecast import forecast
from drake_quad.identification.identifiability import (
    check_forecast,
    check_signals,
    check_thrust,
    imprecise_parameters,
    parameters_below_disturbance,
    undetermined_parameters,
    unexcited_parameters,
)
from drake_quad.identification.model import DELAY
from drake_quad.identification.parameters import Parameter, parameter_names, parameters_of
from drake_quad.identification.prediction_errors import Output, Predictor
from drake_quad.identification.prepared_logs import MAX_DELAY, PreparedLogs, initial_noise, prepare, window_blocks
from drake_quad.identification.random_effects import estimate_variation, uncertainty_of_mean
from drake_quad.identification.result import EstimatedValue, ForecastOutput, Identification
from drake_quad.identification.results.estimates import Estimates, ExplainedVariance, Source
from drake_quad.identification.results.held_out import hold_out_check
from drake_quad.identification.results.vehicle_values import with_vehicle_values
from drake_quad.identification.sampling import (
    SynchronisedRecords,
    distorted_parameters,
    fast_command_remarks,
    logs_without_fast_commands,
    synchronise,
    with_averaging_error,
)
from drake_quad.identification.windows import held_out_mask, steep_pitch_remarks
from drake_quad.logs.record import FlightRecord
from drake_quad.scenario.models import Scenario

_POSE = ("position", "attitude")
_MIN_POSE_NOISE = 2.0 * MIN_NOISE  # m or rad; a smaller estimate is affected by the lower bound `MIN_NOISE`
_NOISE_NAMES = {signal: f"laboratory.motion_capture.{signal}_noise" for signal in _POSE}


class _Training(NamedTuple):
    """Fit to the training data.

    Attributes:
        masks: (n,) mask of the usable samples of each record that are not held out.
        parameters: fitted parameters.
        fitted: result of the fit.
        forecasts: forecasts of the held-out flight.
    """

    masks: list[np.ndarray]
    parameters: list[Parameter]
    fitted: PredictionFit
    forecasts: tuple[ForecastOutput, ...]


def identify(
    records: Sequence[FlightRecord], scenario: Scenario, *, held_out_fraction: float = 1.0 / 3.0
) -> Identification:
    """Identify a vehicle from flight logs. The result is cached on disk.

    Args:
        records: records of flights of the same vehicle. Each contains the commands that the vehicle takes, and
            measurements: body rates with specific force, poses, or heights.
        scenario: scenario with the initial values and without distributions. Its mass and geometry are not estimated.
        held_out_fraction: fraction of the airborne time, at the end of each log, that is held out for the forecast.

    Raises:
        InputError: if no log is given, a log lacks a signal, measured signals contradict each other, the flights are
            too short, or the logged values are physically impossible.
    """
    if not records:
        raise InputError("no log is given; at least one is needed to identify a vehicle")
    check_signals(records)
    logs = synchronise(records)
    try:
        identification = cached_on_disk(_identified, logs, scenario, held_out_fraction)
    except (np.linalg.LinAlgError, FloatingPointError) as error:
        raise InputError(
            f"the logs cannot be fitted ({error}): their values are impossible for a flying vehicle; check the units in"
            " the mapping"
        ) from error
    return replace(identification, remarks=(*identification.remarks, *logs.remarks, *fast_command_remarks(records)))


def _identified(synchronised_logs: SynchronisedRecords, scenario: Scenario, fraction: float) -> Identification:
    """Identify a vehicle from synchronised records; the scenario and the held-out fraction are as in `identify`."""
    logs, scenario = prepare(
        synchronised_logs.records, scenario, attitude_is_estimated=synchronised_logs.attitude_is_estimated
    )
    parameters = parameters_of(
        logs.scenario,
        logs.signals,
        has_motor_throttles=logs.has_motor_throttles,
        delay=max(0.5 * logs.period, min(frame_age(scenario), 0.5 * MAX_DELAY)),
        max_delay=MAX_DELAY,
    )
    noise, start, training = initial_noise(logs.outputs), None, None
    if fraction > 0.0:
        held_out_masks = [held_out_mask(usable, fraction) for usable in logs.flying]
        training_masks = [usable & ~mask for usable, mask in zip(logs.flying, held_out_masks, strict=True)]
        training_fit = fit(logs.predictor(parameter_names(parameters), training_masks), parameters, noise)
        start, noise = training_fit.values, training_fit.noise
        forecasts = forecast(
            logs.predictor(parameter_names(parameters), held_out_masks, for_forecast=True), start, noise
        )
        check_forecast(forecasts)
        training = _Training(training_masks, parameters, training_fit, forecasts)
    predictor = logs.predictor(parameter_names(parameters), logs.flying)
    fitted = fit(predictor, parameters, noise, start)
    check_thrust(logs.scenario, fitted.noise)
    fixed = parameters_below_disturbance(logs.scenario, predictor, parameters, fitted) | unexcited_parameters(
        logs, parameters, fitted
    )
    if fixed:
        fitted = _fit_of_others(logs, logs.flying, parameters, fitted, fixed)
        parameters = [parameter for parameter in parameters if parameter.name not in fixed]
        predictor = logs.predictor(parameter_names(parameters), logs.flying)
    return _result(logs, scenario, predictor, parameters, fitted, training, fixed)


def _fit_of_others(
    logs: PreparedLogs,
    masks: Sequence[np.ndarray],
    parameters: Sequence[Parameter],
    fitted: PredictionFit,
    held: Collection[str],
) -> PredictionFit:
    """Return the fit of all parameters except those that are held at their initial values.

    Args:
        logs: logs that are fitted.
        masks: (n,) mask of the fitted samples of each record.
        parameters: parameters of the previous fit.
        fitted: previous fit.
        held: names of parameters that are held. They may also have been held in the previous fit.
    """
    others = [i for i, parameter in enumerate(parameters) if parameter.name not in held]
    kept = [parameters[i] for i in others]
    return fit(logs.predictor(parameter_names(kept), masks), kept, fitted.noise, fitted.values[others])


def _vehicle(logs: PreparedLogs, scenario: Scenario, values: dict[str, float]) -> Scenario:
    """Return the scenario with the named parameter values, and with the voltage for which the thrust curve holds."""
    numbers = {name: value for name, value in values.items() if name != DELAY}
    if DELAY in values:
        delay_ticks = (values[DELAY] - frame_age(scenario)) / scenario.laboratory.command_link.period
        numbers["laboratory.command_link.delay_ticks"] = max(0.0, delay_ticks)
    vehicle = with_vehicle_values(scenario, numbers)
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
    training: _Training | None,
    fixed: dict[str, str],
) -> Identification:
    """Return the result of a fit.

    Args:
        logs: logs that were fitted.
        scenario: initial scenario, whose values the estimates replace.
        predictor: predictor of the outputs in all windows.
        parameters: parameters that were fitted.
        fitted: result of the fit.
        training: fit to the training data; None if nothing was held out.
        fixed: reason for each parameter that was fixed at its initial value, by name.
    """
    names = parameter_names(parameters)
    blocks = window_blocks(predictor)
    evidence = fitted.evidence(names, [parameter.scale for parameter in parameters], predictor.duration)
    differences = flight_differences(logs, predictor, fitted, evidence)
    variation = estimate_variation(within_flights(evidence, predictor, differences))
    uncertainty = uncertainty_of_mean(fitted.uncertainty(blocks), evidence, variation)
    uncertainty = with_averaging_error(uncertainty, names, fitted.values, logs.averaging_period)
    remarks = [*_remarks(predictor, fitted, names), *steep_pitch_remarks(logs.records)]
    unidentified = imprecise_parameters(parameters, fitted.values, uncertainty)
    unidentified |= distorted_parameters(logs.records, parameters, fitted.noise, logs.loop_period)
    if {*names} <= {*unidentified, DELAY}:
        raise InputError(
            "cannot identify the vehicle: the logs determine none of its parameters: "
            + "; ".join(f"{name}: {reason}" for name, reason in unidentified.items())
        )
    forecasts = () if training is None else training.forecasts
    explained = _explained(parameters, fitted, predictor, forecasts) if forecasts else {}
    held = {name for name in unidentified if name != DELAY and not name.startswith("motors.curve")}
    training_vehicle = None if training is None else _training_vehicle(logs, scenario, training, held | {*fixed})
    vehicle_indices = [i for i, name in enumerate(names) if name != DELAY and name not in held]
    noise_names, noise_values, noise_covariances, unidentified_noise = _noise_estimates(logs, predictor, fitted)
    noise_freedom = np.full(len(noise_names), float(fitted.errors.size))
    estimates = Estimates(
        names=(*(names[i] for i in vehicle_indices), *noise_names),
        values=np.concatenate([fitted.values[vehicle_indices], noise_values]),
        covariance=scipy.linalg.block_diag(
            uncertainty.covariance[np.ix_(vehicle_indices, vehicle_indices)], noise_covariances
        ),
        degrees_of_freedom=np.concatenate([uncertainty.degrees_of_freedom[vehicle_indices], noise_freedom]),
        sources=Source(
            f"prediction errors of {' and '.join(sorted(signal.replace('_', ' ') for signal in logs.signals))}",
            ", ".join(dict.fromkeys(record.name for record in logs.records)),
        ),
        explained_variance={name: each for name, each in explained.items() if name not in held},
        not_identified=undetermined_parameters(logs.scenario, names)
        | fixed
        | unidentified_noise
        | {name: reason for name, reason in unidentified.items() if name != DELAY},
        variation=None
        if variation is None
        else variation.subset(vehicle_indices).with_unknown_parameters(len(noise_names)),
    )
    estimates = with_differences(estimates, differences, logs.scenario, predictor.duration / max(1, len(differences)))
    delay_index = names.index(DELAY)
    deviation = float(np.sqrt(uncertainty.covariance[delay_index, delay_index]))
    delay = EstimatedValue(
        float(fitted.values[delay_index]), deviation, "s", float(uncertainty.degrees_of_freedom[delay_index])
    )
    numbers = dict(zip(estimates.names, map(float, estimates.values), strict=True)) | {DELAY: delay.value}
    if held:
        others = [name for name in names if name not in held]
        numbers |= dict(
            zip(others, map(float, _fit_of_others(logs, logs.flying, parameters, fitted, held).values), strict=True)
        )
    if DELAY in unidentified:
        remarks.append(f"the delay is not identified: {unidentified[DELAY]}")
        del numbers[DELAY]
    noise_deviations = map(float, fitted.noise.measured)
    outputs = tuple(
        output._replace(deviation=noise_deviation)
        for output, noise_deviation in zip(forecasts, noise_deviations, strict=False)
    )
    coverage = {name: each for name, each in hold_out_check(evidence).items() if name not in unidentified}
    result_delay = None if DELAY in unidentified else delay
    vehicle = _vehicle(logs, scenario, numbers)
    return Identification(
        estimates,
        vehicle,
        outputs,
        result_delay,
        fitted.noise,
        tuple(remarks),
        coverage,
        training_vehicle=training_vehicle,
        flights=differences,
        fitted=dict(zip(names, map(float, fitted.values), strict=True)),
    )


def _training_vehicle(logs: PreparedLogs, scenario: Scenario, training: _Training, held: set[str]) -> Scenario:
    """Return the scenario with the estimates from the training data, except for the parameters that are held."""
    fitted = training.fitted
    if held:
        fitted = _fit_of_others(logs, training.masks, training.parameters, fitted, held)
    names = [parameter.name for parameter in training.parameters if parameter.name not in held]
    return _vehicle(logs, scenario, dict(zip(names, map(float, fitted.values), strict=True)))


def _noise_estimates(
    logs: PreparedLogs, predictor: Predictor, fitted: PredictionFit
) -> tuple[list[str], np.ndarray, np.ndarray, dict[str, str]]:
    """Return names, values and covariance of the pose noise parameters, and reasons for those not identified.

    Missing commands cause fast rotations, which the fit cannot distinguish from noise of the attitude.
    """
    rows = {name: predictor.outputs.index(Output(name, 0)) for name in _POSE if Output(name, 0) in predictor.outputs}
    if logs.scenario.laboratory.estimator.integrates_sensors:
        reason = "the pose is an estimate of the vehicle, so its error is not that of motion capture"
        return [], np.empty(0), np.empty((0, 0)), {_NOISE_NAMES[name]: reason for name in rows}
    sufficient = {name: row for name, row in rows.items() if fitted.noise.measured[row] > _MIN_POSE_NOISE}
    unidentified = {
        _NOISE_NAMES[name]: f"it is below {_MIN_POSE_NOISE:g} m or rad" for name in rows if name not in sufficient
    }
    affected_logs = logs_without_fast_commands(logs.records, fitted.noise, logs.loop_period)
    if affected_logs and sufficient.pop("attitude", None) is not None:
        unidentified[_NOISE_NAMES["attitude"]] = (
            f"the log may lack commands between its samples ({', '.join(affected_logs)}), which adds to the noise"
        )
    if not sufficient:
        return [], np.empty(0), np.empty((0, 0)), unidentified
    large_rows = [*sufficient.values()]
    values = fitted.noise.measured[large_rows]
    covariance = noise_covariance(predictor, fitted)[np.ix_(large_rows, large_rows)] * np.outer(values, values)
    return [_NOISE_NAMES[name] for name in sufficient], values, covariance, unidentified


def _explained(
    parameters: Sequence[Parameter], fitted: PredictionFit, predictor: Predictor, forecasts: Sequence[ForecastOutput]
) -> dict[str, ExplainedVariance]:
    """Return, by parameter name, the explained variance of the output that depends most on the parameter."""
    num_outputs = len(predictor.outputs)
    jacobian = fitted.jacobian.reshape(len(fitted.jacobian), -1, num_outputs, len(parameters))
    outputs = np.argmax(np.einsum("wtop,wtop->op", jacobian, jacobian), axis=0)
    return {
        parameter.name: ExplainedVariance(forecasts[output].explained_variance, forecasts[output].name)
        for parameter, output in zip(parameters, outputs, strict=True)
        if parameter.name != DELAY and np.isfinite(forecasts[output].explained_variance)
    }


def _remarks(predictor: Predictor, fitted: PredictionFit, names: Sequence[str]) -> tuple[str, ...]:
    """Return remarks on the windows, and on how to interpret some of the estimates."""
    window_length = predictor.duration / len(predictor.windows)
    remarks = [f"{len(predictor.windows)} windows of {window_length:.2g} s in the air were fitted"]
    if "rotor_time_constant_down" in names:
        up, down = (fitted.values[names.index(f"rotor_time_constant{suffix}")] for suffix in ("", "_down"))
        remarks.append(f"small motions lag by the mean of the two time constants, {500.0 * (up + down):.3g} ms")
    if "rotor_aerodynamics.climb" in names:
        remarks.append("climb includes the linear drag along z of the body, since flights cannot separate the two")
    return tuple(remarks)
