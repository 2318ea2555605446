"""Checks of whether logs identify a vehicle, and each of its parameters.

The functions return the parameters that the logs do not identify, by their names, with the reason.
"""

from collections.abc import Sequence

import numpy as np

from drake_quad.errors import InputError
from drake_quad.identification.evidence import Uncertainty
from drake_quad.identification.fit import PredictionFit
from drake_quad.identification.parameters import Parameter
from drake_quad.identification.physical_limits import SearchVariables
from drake_quad.identification.prediction_errors import Output, PredictionNoise, Predictor
from drake_quad.identification.prepared_logs import PreparedLogs
from drake_quad.identification.result import ForecastOutput
from drake_quad.identification.results.estimates import quantile
from drake_quad.scenario.models import Scenario
from drake_quad.statistics.interval import plus_minus

# A parameter is identified if the half-width of its 95 % interval is at most this multiple of its scale.
_MAX_REACH = 1.0
_MAX_VERTICAL_FORCE = 0.15  # relative to the weight, in means over `_FORCE_WINDOW`; 0.03 in flights in strong wind
_FORCE_WINDOW = 0.5  # s
_SPEED_WINDOW = 0.1  # s, long enough to average out position noise


def check_forecast(shown: Sequence[ForecastOutput]) -> None:
    """Reject a vehicle that forecasts no output of held-out flight better than persistence.

    Raises:
        InputError: if some outputs vary, and the vehicle explains none of their variance.
    """
    varying = [output for output in shown if np.isfinite(output.explained)]
    best = max(varying, key=lambda output: output.explained, default=None)
    if best is not None and best.explained <= 0.0:
        raise InputError(
            "cannot identify the vehicle: after a fit to the rest of the logs it forecasts no output of the held-out"
            f" part better than motion that continues at constant rates does (best: {best.name}); a log that"
            " only hovers does not identify a vehicle; otherwise check the mapping and the vehicle to begin with"
        )


def check_thrust(scenario: Scenario, noise: PredictionNoise) -> None:
    """Reject a vehicle whose thrust does not follow from the commands, so that a disturbance has to carry it.

    Raises:
        InputError: if the disturbing force along z is a large share of the weight.
    """
    *_, vertical = noise.mean_force(_FORCE_WINDOW) / float(scenario.vehicle.gravity)
    if vertical > _MAX_VERTICAL_FORCE:
        raise InputError(
            f"cannot identify the vehicle: its thrust does not follow from the logged commands, since a force of"
            f" {100.0 * vertical:.0f} % of the weight is left along z; a log that only hovers identifies nothing else"
        )


def not_identified(parameters: Sequence[Parameter], values: np.ndarray, uncertainty: Uncertainty) -> dict[str, str]:
    """Return the parameters with a wide interval or at a physical limit, with the reason.

    Args:
        parameters: p parameters.
        values: (p,) estimates.
        uncertainty: uncertainty of the estimates.
    """
    reaches = quantile(uncertainty.degrees_of_freedom) * np.sqrt(np.diag(uncertainty.covariance))
    found = {}
    limited = SearchVariables.of(parameters).limited(values)
    for parameter, value, reach, at_limit in zip(parameters, values, reaches, limited, strict=True):
        size = min(parameter.scale, value) if parameter.lower > 0.0 else parameter.scale
        if reach > _MAX_REACH * size:
            found[parameter.name] = (
                f"its 95 % interval is {plus_minus(value, reach)}, wider than the usual error of a data sheet,"
                f" {parameter.scale:.2g}"
            )
        elif at_limit:
            found[parameter.name] = f"its estimate, {value:.3g}, is at the limit of what is physically possible"
    return found


def weaker_than_disturbance(
    scenario: Scenario, predictor: Predictor, parameters: Sequence[Parameter], fitted: PredictionFit
) -> dict[str, str]:
    """Return the drag parameters if the drag is smaller than the disturbing force, with the reason.

    A wind that is not logged depends on the position, so it is correlated with the velocity. The interval of the drag
    does not include this error. If the force of the wind is as large as the drag, the estimate mostly reflects the
    wind.
    """
    places = [i for i, output in enumerate(predictor.outputs) if output.signal == "position"]
    if len(places) < 3:
        return {}
    positions = predictor.measured[predictor.counted][:, places]
    samples = max(1, round(_SPEED_WINDOW / predictor.period))
    speed = np.sqrt(np.mean((positions[samples:] - positions[:-samples]) ** 2, axis=(0, 2))) / (
        samples * predictor.period
    )
    force = float(scenario.vehicle.mass) * fitted.noise.force
    found = {}
    for parameter, value in zip(parameters, fitted.values, strict=True):
        name = parameter.name
        axes = [0, 1] if name == "linear_drag" else [int(name[-2])] if "drag.linear" in name else []
        if axes and np.any(force[axes] > value * speed[axes]):
            found[name] = (
                f"the disturbing force, such as wind, is {force[axes].max():.2g} N, and the drag itself"
                f" {(value * speed[axes]).min():.2g} N"
            )
    return found


def unexcited(logs: PreparedLogs, parameters: Sequence[Parameter], fitted: PredictionFit) -> dict[str, str]:
    """Return the response parameters of each angle whose command varies less than its noise, with the reason.

    The motion of such an angle is mostly noise, to which any response can be fitted.
    """
    found = {}
    for parameter in parameters:
        output = Output("attitude", int(parameter.name[-2])) if parameter.name.startswith("autopilot.") else None
        if output is not None and output in logs.outputs:
            axis = output.column
            noise = fitted.noise.measured[logs.outputs.index(output)]
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


def undetermined(scenario: Scenario, names: Sequence[str]) -> dict[str, str]:
    """Return the parameters that no log determines, with the reason.

    Args:
        scenario: scenario with the vehicle.
        names: names of the estimated parameters.
    """
    reasons = {"mass": "motion determines forces only relative to the mass; weigh the vehicle"}
    if "inertia[2]" in names:
        reasons["drag_factor"] = "yaw determines only its ratio to inertia[2], which assumes its value in the scenario"
    if scenario.vehicle.motors.take_throttles:
        reasons["thrust_factor"] = "motors that take throttles show their thrust, not their speed"
    if "linear_drag" in names and scenario.vehicle.quadratic_drag > 0.0:
        reasons["quadratic_drag"] = (
            "in a wind that is not logged it looks like linear drag, so linear_drag includes that part of it"
        )
    return reasons
