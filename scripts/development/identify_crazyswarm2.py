"""Identify four Crazyflies from one flight log each, and write them to diagrams/crazyswarm2.yaml.

The script keeps the beginning of that file, which contains the gains and masses from the info*.yaml files. It estimates
all other parameters from the logged signals, without tracking errors. `identify` estimates thrust, lag, inertia and
centre of mass. The drag follows from the measured acceleration. The error of the estimated velocity follows from the
derivative of the estimated position.
"""

import math
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

from drake_quad.command_line.running import run

import numpy as np
import scipy

from drake_quad import InputError
from drake_quad.command_line.options import parser_without_options
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.files import output_folder, write_atomically
from drake_quad.identification.identify import identify
from drake_quad.identification.result import EstimatedValue, Identification
from drake_quad.identification.results.estimates import Estimates
from drake_quad.identification.results.vehicle_values import vehicle_value, with_vehicle_values
from drake_quad.identification.validation.estimator import VelocityErrorEstimate, estimate_velocity_error, linear_drag
from drake_quad.linear.closed_loop import closed_loop
from drake_quad.logs.reading import read_log
from drake_quad.scenario.correlation import correlated_normals
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.models import Scenario

_ROOT = Path(__file__).parents[2]
_FILE = _ROOT / "diagrams" / "crazyswarm2.yaml"
_LOGS = _ROOT / "tests" / "data" / "crazyflie" / "crazyswarm2"
_FLIGHTS = ("08", "100", "145", "180")
# Rotor time constant (s) with which the identification starts, from other flights of a Crazyflie (arXiv 2404.07837).
# The loop would be unstable with the time constant in the data sheet.
_INITIAL_LAG = ("vehicle.rotor_time_constant=0.072", "vehicle.rotor_time_constant_down=null")
# Standard deviation of the misalignment, rad. The vehicle without integral action (log100) settles 3 to 16 mm off the
# reference, which corresponds to a misalignment of 3 to 15 mrad.
_MISALIGNMENT = 0.008
_MIN_SWING_FREQUENCY = 3.0  # rad/s; slower modes of the loop do not count as oscillations
_CENTRE_OF_PRESSURE = "body_drag.centre_of_pressure[2]"
_WRITTEN_PARAMETERS = (
    "thrust_factor",
    "rotor_time_constant",
    "inertia[0]",
    "inertia[1]",
    "centre_of_mass[0]",
    "centre_of_mass[1]",
    _CENTRE_OF_PRESSURE,
)
_VEHICLES_COMMENT = """ by `python scripts/development/identify_crazyswarm2.py`. The standard
# deviations are those of the estimates.
# - Thrust, lag, delay, inertia about x and y, centre of mass: estimates of drake_quad.identification.identify from the
#   whole log. Its initial lag is from other flights of Crazyflies (arXiv 2404.07837), and its delay is rounded to whole
#   ticks. The estimates are conditioned on a loop that is stable in the linear model, because the vehicle flew.
# - Inertia about z and drag factor: scaled like inertia about x and thrust factor from the data sheet.
# - Drag: from the lateral force that the derivative of the estimated velocity shows. Along an axis that was not flown,
#   it equals the drag along the other axis.
# - Centre of pressure: together with this drag, it gives the identified torque, which grows with the speed.
# - Error of the estimated velocity: from the derivative of the estimated position, as a scale error and a correlated
#   drift.
# - Misalignment: without an integral (log100), the vehicle rests 3 to 16 mm off the reference, which corresponds to a
#   misalignment of 3 to 15 mrad.
"""
_VEHICLES_START = "\n# Vehicles that are identified from the logs"


def main() -> None:
    options = parser_without_options(__doc__, "python scripts/development/identify_crazyswarm2.py --output mine.yaml")
    options.add_argument(
        "--output",
        type=Path,
        default=_FILE,
        metavar="FILE",
        help=f"file (default: {_FILE.relative_to(_ROOT)})",
    )
    options.add_argument("--log", choices=_FLIGHTS, nargs="+", default=list(_FLIGHTS), help="logs (default: all four)")
    arguments = options.parse_args()
    if set(arguments.log) != set(_FLIGHTS) and arguments.output.resolve() == _FILE.resolve():
        raise InputError("--log: the shipped file contains all four logs; use --output to write fewer to another file")
    output_folder(arguments.output.parent)
    before, _, _ = _FILE.read_text(encoding="utf-8").partition(_VEHICLES_START)
    controllers = os.path.relpath(_FILE.parent / "controllers", arguments.output.parent)
    before = before.replace("extends: controllers/", f"extends: {controllers}/")
    parts, rows = [], []
    for log in arguments.log:
        record = read_log(_LOGS / f"log{log}.xz")
        base = load_undesigned(f"{_FILE}:sheet_{log}", list(_INITIAL_LAG))
        identification = identify([record], base, held_out_fraction=0.0)
        estimate, drag = estimate_velocity_error(record), linear_drag(record, base)
        parts.append(vehicle(log, base, identification, estimate, drag))
        rows += table_rows(log, identification, estimate, drag)
    print_columns(("log", "number", "value", "standard deviation"), rows)

    def write(path: Path) -> None:
        path.write_text(before + _VEHICLES_START + _VEHICLES_COMMENT + "".join(parts), encoding="utf-8")

    print_files([write_atomically(arguments.output, write)])


def vehicle(
    log: str,
    base: Scenario,
    identification: Identification,
    estimate: VelocityErrorEstimate,
    drag: tuple[EstimatedValue, EstimatedValue],
) -> str:
    """Return the YAML text of the scenario that is identified from a log.

    Args:
        log: number of the log, such as "100".
        base: scenario from which the identification started.
        identification: result of the identification.
        estimate: error of the estimated velocity.
        drag: linear drag along x and y, with its variation.
    """
    ticks = round(identification.vehicle.laboratory.command_link.delay_ticks)
    sheet = load_undesigned(f"{_FILE}:sheet_{log}", [*_INITIAL_LAG, f"laboratory.command_link.delay_ticks={ticks}"])
    numbers = conditioned_on_stability(identification.estimates.subset(_WRITTEN_PARAMETERS), sheet)
    values = dict(zip(_WRITTEN_PARAMETERS, numbers.values, strict=True))
    drawn = correlated_normals(_WRITTEN_PARAMETERS, numbers.values, numbers.covariance, prefix=f"log{log}")
    texts = {
        name: in_yaml(drawn[name]["normal"], signed=name.startswith("centre_of_mass")) for name in _WRITTEN_PARAMETERS
    }
    torque_ratio = base.vehicle.drag_factor / base.vehicle.thrust_factor
    yaw_inertia = base.vehicle.inertia[2] * values["inertia[0]"] / base.vehicle.inertia[0]
    nominal = vehicle_value(base, "body_drag.linear[0]")
    arm = values[_CENTRE_OF_PRESSURE] * 2.0 * nominal / (drag[0].value + drag[1].value)
    lines = [
        f"log{log}:",
        f"  extends: sheet_{log}",
        "  vehicle:",
        f"    rotor_time_constant: {texts['rotor_time_constant']}",
        "    rotor_time_constant_down: null    # same as for increasing speed",
        f"    thrust_factor: {texts['thrust_factor']}",
        f"    drag_factor: {values['thrust_factor'] * torque_ratio:.4g}",
        "    inertia:",
        f"      - {texts['inertia[0]']}",
        f"      - {texts['inertia[1]']}",
        f"      - {yaw_inertia:.4g}",
        "    body_drag:",
        "      linear:",
        *(f"        - {normal(each.value, each.deviation, 0.0)}" for each in drag),
        "        - 0.01278",
        f"      centre_of_pressure: [0, 0, {arm:.3g}]",
        "    centre_of_mass:",
        *(f"      - {texts[f'centre_of_mass[{i}]']}" for i in range(2)),
        "  laboratory:",
        f"    command_link: {{delay_ticks: {ticks}}}",
        "    motion_capture:",
        "      misalignment:",
        *(f"        - {normal(0.0, _MISALIGNMENT)}" for _ in range(2)),
        "        - 0.0",
        "      velocity_error:",
        *(f"        - {normal(each.value, each.deviation, -0.5)}" for each in estimate.scale_error),
        f"      velocity_drift: [{', '.join(f'{each:.3g}' for each in estimate.drift)}]",
        f"      drift_time: {estimate.correlation_time:.2g}",
    ]
    return "\n".join(lines) + "\n"


def conditioned_on_stability(estimates: Estimates, base: Scenario) -> Estimates:
    """Return the estimates under the condition that the loop is stable, because the vehicle flew.

    The growth rate of oscillations is assumed to be linear in the parameters. The normal distribution of the parameters
    is truncated where oscillations grow, and then replaced by a normal distribution with the same mean and covariance.
    """
    growth = swing_growth(base, estimates)
    deviations = estimates.deviations
    slopes = np.empty(len(deviations))
    for i, deviation in enumerate(deviations):
        other = estimates.values + deviation * np.eye(len(deviations))[i]
        slopes[i] = (swing_growth(base, replace(estimates, values=other)) - growth) / deviation
    along = estimates.covariance @ slopes
    spread = float(np.sqrt(slopes @ along))
    limit = -growth / spread
    # Mean and variance of a standard normal variable that is truncated at the limit.
    mean = -float(np.exp(scipy.stats.norm.logpdf(limit) - scipy.stats.norm.logcdf(limit)))
    variance = 1.0 + limit * mean - mean**2
    values = estimates.values + along / spread * mean
    covariance = estimates.covariance - (1.0 - variance) * np.outer(along, along) / spread**2
    return replace(estimates, values=values, covariance=covariance)


def swing_growth(base: Scenario, estimates: Estimates) -> float:
    """Return the growth rate of oscillations in hover in the linear model, 1/s; negative if they decay."""
    scenario = with_vehicle_values(base, dict(zip(estimates.names, map(float, estimates.values), strict=True)))
    system = closed_loop(scenario).system
    poles = np.log(system.poles().astype(complex)) / system.period
    return float(poles[np.abs(poles.imag) > _MIN_SWING_FREQUENCY].real.max())


def in_yaml(normal_fields: dict[str, Any], *, signed: bool) -> str:
    """Return a normal distribution as YAML text; positive parameters are limited to 0.5 to 1.5 times their mean."""
    mean = normal_fields["mean"]
    ends = "" if signed else f", min: {0.5 * mean:.4g}, max: {1.5 * mean:.4g}"
    # The weights are rounded towards zero, so that the sum of their squares does not exceed 1.
    weights = {name: math.trunc(1e4 * weight) / 1e4 for name, weight in normal_fields.get("shared", {}).items()}
    names = ", ".join(f"{name}: {weight}" for name, weight in weights.items())
    shared = f", shared: {{{names}}}" if names else ""
    return (
        f"{{normal: {{mean: {mean:.5g}, standard_deviation: {normal_fields['standard_deviation']:.3g}{ends}{shared}}}}}"
    )


def normal(mean: float, deviation: float, low: float | None = None, high: float | None = None) -> str:
    """Return a normal distribution as YAML text, with optional limits."""
    ends = "".join(f", {name}: {end:.4g}" for name, end in (("min", low), ("max", high)) if end is not None)
    return f"{{normal: {{mean: {mean:.4g}, standard_deviation: {deviation:.2g}{ends}}}}}"


def table_rows(
    log: str,
    identification: Identification,
    estimate: VelocityErrorEstimate,
    drag: tuple[EstimatedValue, EstimatedValue],
) -> list[tuple[str, str, str, str]]:
    """Return the rows of the printed table that belong to a log."""
    estimates = identification.estimates
    rows = [
        (f"log{log}", name, f"{value:.4g}", f"{deviation:.2g}")
        for name, value, deviation in zip(estimates.names, estimates.values, estimates.deviations, strict=True)
        if name in _WRITTEN_PARAMETERS
    ]
    for axis, one, fraction, rest in zip("xy", drag, estimate.scale_error, estimate.drift, strict=False):
        rows += [
            (f"log{log}", f"drag along {axis}, N s/m", f"{one.value:.4g}", f"{one.deviation:.2g}"),
            (
                f"log{log}",
                f"scale error of the velocity along {axis}",
                f"{fraction.value:.3f}",
                f"{fraction.deviation:.2g}",
            ),
            (
                f"log{log}",
                f"velocity drift along {axis}, over {estimate.correlation_time:.2g} s, m/s",
                f"{rest:.3f}",
                "–",
            ),
        ]
    return rows


if __name__ == "__main__":
    run(main)
