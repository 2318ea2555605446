"""Checks of whether logs identify a vehicle and each of its parameters.

Checks of the vehicle raise an error. Checks of parameters return the reason for each parameter that the logs do not
identify, by its name.
"""

from collections.abc import Sequence

import numpy as np

from drake_quad.errors import InputError
from drake_quad.identification.evidence import Uncertainty, quantile
from drake_quad.identification.fit import PredictionFit
from drake_quad.identification.parameters import Parameter
from drake_quad.identification.physical_limits import SearchVariables
from drake_quad.identification.prediction_errors import Output, PredictionNoise, Predictor
from drake_quad.identification.prepared_logs import PreparedLogs
from drake_quad.identification.result import ForecastOutput
from drake_quad.logs.consistency import inconsistencies
from drake_quad.logs.record import FlightRecord
from drake_quad.scenario.models import Scenario
from drake_quad.statistics.interval import plus_minus

# Largest half-width of the 95 % interval of an identified parameter, relative to the scale of the parameter.
_MAX_RELATIVE_HALF_WIDTH = 1.0
# Largest disturbing force along z, averaged over `_FORCE_WINDOW`, relative to the weight. Strong wind causes a force of
# 0.03.
_MAX_VERTICAL_FORCE_RATIO = 0.15
_FORCE_WINDOW = 0.5  # s, duration over which the disturbing force is averaged
_MEASUREMENTS = {"position", "velocity", "attitude", "body_rates", "specific_force"}
# Signal, its derivative, and the smallest derivative (SI units) with which the signal cannot be constant.
_DERIVATIVES = ("position", "velocity", 0.05), ("attitude", "body_rates", 0.05)
_RESOLUTION = 1e-9  # m or rad; a signal that varies less is constant
_SPEED_WINDOW = 0.1  # s, long enough to average out position noise


def check_signals(records: Sequence[FlightRecord]) -> None:
    """Reject records whose measured signals contradict each other.

    Raises:
        InputError: if a measurement has a wrong sign, unit or frame, contradicts another one, or is constant although
            its derivative is not zero.
    """
    for record in records:
        for name, rate, threshold in _DERIVATIVES:
            values, rates = getattr(record, name), getattr(record, rate)
            if values is None or rates is None:
                continue
            if np.all(np.ptp(values, axis=0) < _RESOLUTION) and np.sqrt(np.mean(rates**2, axis=0)).max() > threshold:
                raise InputError(
                    f"cannot identify the vehicle: in {record.name}, {name} is constant although {rate} is not zero;"
                    " correct the mapping of the log"
                )
        for each in inconsistencies(dict(record.signals()), record.time):
            if not _MEASUREMENTS.isdisjoint(each.faulty):
                raise InputError(
                    f"cannot identify the vehicle: in {record.name}, {each.text}; correct the mapping of the log, or"
                    " remove the wrong signal from it"
                )


def check_forecast(forecasts: Sequence[ForecastOutput]) -> None:
    """Reject a vehicle whose forecast of held-out flight is worse than persistence for every output.

    Raises:
        InputError: if some outputs vary, and no forecast explains any of their variance.
    """
    varying = [forecast for forecast in forecasts if np.isfinite(forecast.explained_variance)]
    best = max(varying, key=lambda forecast: forecast.explained_variance, default=None)
    if best is not None and best.explained_variance <= 0.0:
        raise InputError(
            "cannot identify the vehicle: after a fit to the rest of the logs, it forecasts no output of the held-out"
            f" part better than motion at constant rates (best: {best.name}); use logs with more motion than hover,"
            " and check the mapping and the initial scenario"
        )


def check_thrust(scenario: Scenario, noise: PredictionNoise) -> None:
    """Reject a vehicle whose thrust does not follow from its commands.

    Raises:
        InputError: if the disturbing force along z, which replaces the missing thrust, is over 15 % of the weight.
    """
    *_, vertical = noise.mean_force(_FORCE_WINDOW) / float(scenario.vehicle.gravity)
    if vertical > _MAX_VERTICAL_FORCE_RATIO:
        raise InputError(
            f"cannot identify the vehicle: its thrust does not follow from the logged commands, since a force of"
            f" {100.0 * vertical:.0f} % of the weight along z is unexplained; use logs with more motion than hover, and"
            " check the mapping"
        )


def imprecise_parameters(
    parameters: Sequence[Parameter], values: np.ndarray, uncertainty: Uncertainty
) -> dict[str, str]:
    """Return a reason for each parameter whose interval is wide or whose estimate is at a physical limit.

    Args:
        parameters: p parameters.
        values: (p,) estimates.
        uncertainty: uncertainty of the estimates.
    """
    half_widths = quantile(uncertainty.degrees_of_freedom) * np.sqrt(np.diag(uncertainty.covariance))
    reasons = {}
    limited = SearchVariables.of(parameters).limited(values)
    for parameter, value, half_width, at_limit in zip(parameters, values, half_widths, limited, strict=True):
        if parameter.lower > 0.0:
            size = min(parameter.scale, value)
        else:  # a wide interval that is far from the initial value is informative
            size = max(parameter.scale, 0.5 * abs(value - parameter.start))
        if half_width > _MAX_RELATIVE_HALF_WIDTH * size:
            reasons[parameter.name] = (
                f"its 95 % interval is {plus_minus(value, half_width)}, wider than the typical error of a data sheet,"
                f" {parameter.scale:.2g}"
            )
        elif at_limit:
            reasons[parameter.name] = f"its estimate, {value:.3g}, is at the limit of what is physically possible"
    return reasons


def parameters_below_disturbance(
    scenario: Scenario, predictor: Predictor, parameters: Sequence[Parameter], fitted: PredictionFit
) -> dict[str, str]:
    """Return a reason for each drag parameter whose drag force is smaller than the disturbing force.

    A wind that is not logged varies with the position, so its force is correlated with the velocity. The confidence
    interval of the drag does not account for this error. If the wind force is as large as the drag force, the estimate
    mostly reflects the wind.
    """
    columns = [i for i, output in enumerate(predictor.outputs) if output.signal == "position"]
    if len(columns) < 3:
        return {}
    positions = predictor.measured[predictor.evaluated][:, columns]
    lag = max(1, round(_SPEED_WINDOW / predictor.period))
    speed = np.sqrt(np.mean((positions[lag:] - positions[:-lag]) ** 2, axis=(0, 2))) / (lag * predictor.period)
    force = float(scenario.vehicle.mass) * fitted.noise.force
    reasons = {}
    for parameter, value in zip(parameters, fitted.values, strict=True):
        name = parameter.name
        axes = [0, 1] if name == "linear_drag" else [int(name[-2])] if "drag.linear" in name else []
        if axes and np.any(force[axes] > value * speed[axes]):
            reasons[name] = (
                f"the disturbing force, such as wind, is {force[axes].max():.2g} N, but the drag force is only"
                f" {(value * speed[axes]).min():.2g} N"
            )
    return reasons


def unexcited_parameters(logs: PreparedLogs, parameters: Sequence[Parameter], fitted: PredictionFit) -> dict[str, str]:
    """Return a reason for each attitude response parameter whose command varies less than the measurement noise.

    The measured angle is then mostly noise, to which any response can be fitted.
    """
    reasons = {}
    for parameter in parameters:
        output = Output("attitude", int(parameter.name[-2])) if parameter.name.startswith("autopilot.") else None
        if output is not None and output in logs.outputs:
            axis = output.column
            noise = fitted.noise.measured[logs.outputs.index(output)]
            commands = [
                record.of("attitude_command")[usable, axis]
                for record, usable in zip(logs.records, logs.flying, strict=True)
            ]
            deviation = max(float(np.std(command)) for command in commands if len(command))
            if deviation < noise:
                reasons[parameter.name] = (
                    f"the command of {('roll', 'pitch', 'yaw')[axis]} varies by {deviation:.2g} rad, less than the"
                    f" noise of its measurement, {noise:.2g} rad"
                )
    return reasons


def undetermined_parameters(scenario: Scenario, names: Sequence[str]) -> dict[str, str]:
    """Return a reason for each parameter that no log of this vehicle can determine."""
    reasons = {"mass": "motion determines forces only relative to the mass, so weigh the vehicle"}
    if "inertia[2]" in names:
        reasons["drag_factor"] = (
            "the yaw motion determines only its ratio to inertia[2]; the estimate of inertia[2] assumes the given value"
        )
    if scenario.vehicle.motors.take_throttles:
        reasons["thrust_factor"] = "a log of motors with throttle commands determines thrusts, not rotor speeds"
    if "linear_drag" in names and scenario.vehicle.quadratic_drag > 0.0:
        reasons["quadratic_drag"] = (
            "in a wind that is not logged, it cannot be distinguished from linear drag, so linear_drag includes it"
        )
    return reasons
