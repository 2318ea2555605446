"""Identification of a vehicle from flight logs, by prediction errors.

A Kalman filter predicts each measurement from those before it, with the vehicle as its model
(`drake_quad.identification.prediction_errors`). The estimates are those parameters for which the predictions are best,
given a weak prior around the values of a data sheet (`drake_quad.identification.fit`). The model is the same for every
log: rotors that are commanded one by one, or the attitude response of an autopilot, with an accelerometer, a motion
capture system, or heights alone. What differs is which outputs are predicted
(`drake_quad.identification.prepared_logs`) and which parameters they may determine
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
from drake_quad.identification.evidence import Uncertainty
from drake_quad.identification.fit import MIN_NOISE, PredictionFit, fit, noise_covariance
from drake_quad.identification.forecast import Forecast, forecast
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.model import (
    DELAY,
)
from drake_quad.identification.parameters import Parameter, names_of, parameters_of
from drake_quad.identification.physical_limits import SearchVariables
from drake_quad.identification.prediction_errors import Output, PredictionNoise, Predictor
from drake_quad.identification.prepared_logs import MAX_DELAY, MIN_BLOCKS, PreparedLogs, initial_noise, prepare
from drake_quad.identification.random_effects import of_the_mean, variation_of
from drake_quad.identification.result import ForecastOutput, Identification, Spread
from drake_quad.identification.results.estimates import Estimates, Explained, Source, quantile
from drake_quad.identification.results.held_out import hold_out
from drake_quad.identification.results.vehicle_numbers import (
    with_numbers,
)
from drake_quad.identification.windows import (
    held_out,
    steep_remarks,
)
from drake_quad.scenario.models import Scenario
from drake_quad.statistics.interval import plus_minus
from drake_quad.vehicle.rigid_body import inertia_flaw

_BLOCK = 4.0  # s, over which errors are correlated
# A parameter is identified if its 95 % interval reaches no farther than its scale to each side.
_MAX_REACH = 1.0
_MAX_VERTICAL_FORCE = 0.15  # of the weight, in means over `_FORCE_MEAN`; flights in strong wind leave 0.03
_FORCE_MEAN = 0.5  # s
_SPEED_WINDOW = 0.1  # s, long enough to average out position noise
_POSE = ("position", "attitude")
_NOISES = {signal: f"laboratory.motion_capture.{signal}_noise" for signal in _POSE}
_UNITS = {"position": "m", "velocity": "m/s", "specific": "m/s²", "body": "rad/s"}


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
        InputError: no log is given, a log lacks a signal, the flights are too short, or the logged values are
            physically impossible.
    """
    if not records:
        raise InputError("there is no log to identify a vehicle from")
    try:
        found = _identified(records, scenario, held_out_share)
    except (np.linalg.LinAlgError, FloatingPointError) as error:
        raise InputError(
            f"the logs cannot be fitted ({error}): their values are not those of a flying vehicle; check the units in"
            " the mapping"
        ) from error
    flaw = inertia_flaw(found.vehicle.vehicle.inertia)
    remarks = [f"the identified inertia is not that of a rigid body, because of its error: {flaw}"] if flaw else []
    return replace(found, remarks=(*found.remarks, *remarks))


def _identified(records: Sequence[FlightRecord], scenario: Scenario, share: float) -> Identification:
    """Identify a vehicle; arguments are those of `identify`."""
    logs, scenario = prepare(records, scenario)
    parameters = parameters_of(
        logs.scenario,
        logs.signals,
        own_throttles=logs.own_throttles,
        delay=max(0.5 * logs.period, min(frame_age(scenario), 0.5 * MAX_DELAY)),
        max_delay=MAX_DELAY,
    )
    noise, start, shown, early = initial_noise(logs.outputs), None, None, None
    if share > 0.0:
        spared = [held_out(usable, share) for usable in logs.flying]
        kept = [usable & ~late for usable, late in zip(logs.flying, spared, strict=True)]
        training = fit(logs.predictor(names_of(parameters), kept), parameters, noise)
        shown = forecast(logs.predictor(names_of(parameters), spared, horizon=True), training.values, training.noise)
        _check_forecast(shown)
        start, noise = training.values, training.noise
        early = _vehicle(logs, scenario, dict(zip(names_of(parameters), map(float, start), strict=True)))
    predictor = logs.predictor(names_of(parameters), logs.flying)
    fitted = fit(predictor, parameters, noise, start)
    _check_thrust(logs.scenario, fitted.noise)
    held = _swamped(logs.scenario, predictor, parameters, fitted) | _unexcited(logs, parameters, fitted)
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


def _check_forecast(shown: Forecast) -> None:
    """Refuse a vehicle that forecasts no output of held-out flight better than persistence does.

    Raises:
        InputError: if some outputs vary, and the vehicle explains nothing of any of them.
    """
    varying = np.isfinite(shown.explained)
    if varying.any() and np.all(shown.explained[varying] <= 0.0):
        best = int(np.nanargmax(shown.explained))
        raise InputError(
            "cannot identify the vehicle: after a fit to the rest of the logs it forecasts no output of the held-out"
            f" part better than motion that continues at constant rates does (best: {shown.names[best]}); a log that"
            " only hovers does not identify a vehicle; otherwise check the mapping and the vehicle to begin with"
        )


def _check_thrust(scenario: Scenario, noise: PredictionNoise) -> None:
    """Refuse a vehicle whose thrust does not follow from the commands, so that a disturbance has to carry it.

    Raises:
        InputError: if the disturbing force along z is a large share of the weight.
    """
    vertical = noise.mean_force(_FORCE_MEAN)[2] / float(scenario.vehicle.gravity)
    if vertical > _MAX_VERTICAL_FORCE:
        raise InputError(
            f"cannot identify the vehicle: its thrust does not follow from the logged commands, since a force of"
            f" {100.0 * vertical:.0f} % of the weight is left along z; a log that only hovers identifies nothing else"
        )


def _blocks(predictor: Predictor) -> np.ndarray:
    """Return the number (W,) of the block of each window; blocks last some seconds, as model errors do."""
    windows = len(predictor.windows)
    number = min(windows, max(MIN_BLOCKS, round(predictor.duration / _BLOCK)))
    return np.asarray(np.arange(windows) * number // windows)


def _result(
    logs: PreparedLogs,
    scenario: Scenario,
    predictor: Predictor,
    parameters: Sequence[Parameter],
    fitted: PredictionFit,
    shown: Forecast | None,
    held: dict[str, str],
) -> Identification:
    names = names_of(parameters)
    blocks = _blocks(predictor)
    evidence = fitted.evidence(names, [parameter.scale for parameter in parameters], predictor.duration)
    variation = variation_of(evidence)
    uncertainty = of_the_mean(fitted.covariance(blocks), evidence, variation)
    weak = _not_identified(parameters, fitted.values, uncertainty)
    if {*names} <= {*weak, DELAY}:
        raise InputError(
            "cannot identify the vehicle: the logs determine none of its parameters: "
            + "; ".join(f"{name}: {reason}" for name, reason in weak.items())
        )
    own = [i for i, name in enumerate(names) if name != DELAY]
    values, covariance = fitted.values[own], uncertainty.covariance[np.ix_(own, own)]
    freedom, told = uncertainty.degrees_of_freedom[own], [names[i] for i in own]
    pose = {name: predictor.outputs.index(Output(name, 0)) for name in _POSE if Output(name, 0) in predictor.outputs}
    seen = [name for name, place in pose.items() if fitted.noise.measured[place] > 2.0 * MIN_NOISE]
    quiet = {_NOISES[name]: f"it is below {2.0 * MIN_NOISE:g} in SI units" for name in pose if name not in seen}
    if seen:
        places = [pose[name] for name in seen]
        level = fitted.noise.measured[places]
        spread = noise_covariance(predictor, fitted)[np.ix_(places, places)] * np.outer(level, level)
        told, values = [*told, *(_NOISES[name] for name in seen)], np.concatenate([values, level])
        covariance = scipy.linalg.block_diag(covariance, spread)
        freedom = np.concatenate([freedom, np.full(len(seen), float(fitted.errors.size))])
    estimates = Estimates(
        names=tuple(told),
        values=values,
        covariance=covariance,
        degrees_of_freedom=freedom,
        sources=Source(
            f"prediction errors of {' and '.join(sorted(signal.replace('_', ' ') for signal in logs.signals))}",
            ", ".join(dict.fromkeys(record.name for record in logs.records)),
        ),
        explained={} if shown is None else _explained(parameters, fitted, predictor, shown),
        not_seen=_never_identified(logs.scenario, names)
        | held
        | quiet
        | {name: reason for name, reason in weak.items() if name != DELAY},
        variation=None if variation is None else variation.part(own).beside(len(seen)),
    )
    i = names.index(DELAY)
    deviation = float(np.sqrt(uncertainty.covariance[i, i]))
    delay = Spread(float(fitted.values[i]), deviation, "s", float(uncertainty.degrees_of_freedom[i]))
    numbers = dict(zip(estimates.names, map(float, estimates.values), strict=True))
    remarks = [*_remarks(predictor, fitted, names), *steep_remarks(logs.records)]
    if DELAY in weak:
        remarks.append(f"the delay is not identified: {weak[DELAY]}")
    else:
        numbers[DELAY] = delay.value
    outputs = () if shown is None else _series(shown, fitted.noise.measured)
    covered = {name: each for name, each in hold_out(evidence).items() if name not in weak}
    result_delay = None if DELAY in weak else delay
    vehicle = _vehicle(logs, scenario, numbers)
    return Identification(estimates, vehicle, outputs, result_delay, fitted.noise, tuple(remarks), covered)


def _not_identified(parameters: Sequence[Parameter], values: np.ndarray, uncertainty: Uncertainty) -> dict[str, str]:
    """Return the parameters that are not identified, with the reason.

    Their estimates are those of the data sheet, as far as the log narrows them.
    """
    reaches = quantile(uncertainty.degrees_of_freedom) * np.sqrt(np.diag(uncertainty.covariance))
    found = {}
    limited = SearchVariables.of(parameters).limited(values)
    for parameter, value, reach, limit in zip(parameters, values, reaches, limited, strict=True):
        size = min(parameter.scale, value) if parameter.least > 0.0 else parameter.scale
        if reach > _MAX_REACH * size:
            found[parameter.name] = (
                f"its 95 % interval is {plus_minus(value, reach)}, wider than the usual error of a data sheet,"
                f" {parameter.scale:.2g}"
            )
        elif limit:
            found[parameter.name] = f"its estimate, {value:.3g}, is at the limit of what is physically possible"
    return found


def _swamped(
    scenario: Scenario, predictor: Predictor, parameters: Sequence[Parameter], fitted: PredictionFit
) -> dict[str, str]:
    """Return the drag parameters that are smaller than the disturbing force, with the reason.

    A wind that is not logged depends on the place, so it is correlated with the velocity, and no interval contains that
    part. Where it is as large as the drag, the estimate of drag is mostly an estimate of the wind.
    """
    places = [i for i, output in enumerate(predictor.outputs) if output.signal == "position"]
    if len(places) < 3:
        return {}
    positions = predictor.measured[predictor.counted][:, places]
    ahead = max(1, round(_SPEED_WINDOW / predictor.period))
    speed = np.sqrt(np.mean((positions[ahead:] - positions[:-ahead]) ** 2, axis=(0, 2))) / (ahead * predictor.period)
    push = float(scenario.vehicle.mass) * fitted.noise.force
    found = {}
    for parameter, value in zip(parameters, fitted.values, strict=True):
        name = parameter.name
        axes = [0, 1] if name == "linear_drag" else [int(name[-2])] if "drag.linear" in name else []
        if axes and np.any(push[axes] > value * speed[axes]):
            found[name] = (
                f"the disturbing force, such as wind, is {push[axes].max():.2g} N, and the drag itself"
                f" {(value * speed[axes]).min():.2g} N"
            )
    return found


def _unexcited(logs: PreparedLogs, parameters: Sequence[Parameter], fitted: PredictionFit) -> dict[str, str]:
    """Return the parameters of the response of an angle whose command varies less than its noise, with the reason.

    The free motion of such an angle is mostly noise, which any response can explain.
    """
    found = {}
    for parameter in parameters:
        if parameter.name.startswith("autopilot."):
            axis = int(parameter.name[-2])
            noise = fitted.noise.measured[logs.outputs.index(Output("attitude", axis))]
            commands = [
                record.of("attitude_command")[usable, axis]
                for record, usable in zip(logs.records, logs.flying, strict=True)
            ]
            varying = max(float(np.std(command)) for command in commands if len(command))
            if varying < noise:
                found[parameter.name] = (
                    f"the command of {('roll', 'pitch', 'yaw')[axis]} varies by {varying:.2g} rad, less than the noise"
                    f" of its measurement, {noise:.2g} rad"
                )
    return found


def _explained(
    parameters: Sequence[Parameter], fitted: PredictionFit, predictor: Predictor, shown: Forecast
) -> dict[str, Explained]:
    """Return, for each parameter, the share of the variance that is forecast of the output that determines it most."""
    count = len(predictor.outputs)
    slopes = fitted.slopes.reshape(len(fitted.slopes), -1, count, len(parameters))
    most = np.argmax(np.einsum("wtop,wtop->op", slopes, slopes), axis=0)
    return {
        parameter.name: Explained(float(shown.explained[output]), shown.names[output])
        for parameter, output in zip(parameters, most, strict=True)
        if parameter.name != DELAY and np.isfinite(shown.explained[output])
    }


def _never_identified(scenario: Scenario, names: Sequence[str]) -> dict[str, str]:
    """Return parameters that no log determines, with the reason."""
    why = {"mass": "motion determines forces only relative to the mass; weigh the vehicle"}
    if "inertia[2]" in names:
        why["drag_factor"] = "yaw determines only its ratio to inertia[2], which assumes its value in the scenario"
    if scenario.vehicle.motors.take_throttles:
        why["thrust_factor"] = "motors that take throttles show their thrust, not their speed"
    if "linear_drag" in names and scenario.vehicle.quadratic_drag > 0.0:
        why["quadratic_drag"] = (
            "in a wind that is not logged it looks like linear drag, so linear_drag includes that part of it"
        )
    return why


def _remarks(predictor: Predictor, fitted: PredictionFit, names: Sequence[str]) -> tuple[str, ...]:
    length = predictor.duration / len(predictor.windows)
    found = [f"{len(predictor.windows)} windows of {length:.2g} s in the air were fitted"]
    if "rotor_time_constant_down" in names:
        up, down = (fitted.values[names.index(f"rotor_time_constant{end}")] for end in ("", "_down"))
        found.append(f"small motions lag by the mean of the two time constants, {500.0 * (up + down):.3g} ms")
    if "rotor_aerodynamics.climb" in names:
        found.append("climb includes the linear drag along z of the body, which a flight does not tell from it")
    return tuple(found)


def _series(shown: Forecast, deviations: np.ndarray) -> tuple[ForecastOutput, ...]:
    """Return the forecast of each output, one window after another."""
    windows = shown.measured.shape[2]
    time = np.arange(windows)[:, None] * float(shown.time[-1]) + shown.time
    columns = zip(shown.names, shown.explained, deviations, strict=True)
    return tuple(
        ForecastOutput(
            name,
            _UNITS.get(name.split()[0], "rad"),
            time,
            shown.measured[:, i].T,
            shown.predicted[:, i].T,
            float(explained),
            float(deviation),
        )
        for i, (name, explained, deviation) in enumerate(columns)
    )
