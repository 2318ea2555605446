"""Write diagrams/crazyswarm2.yaml: the vehicles of four Crazyflies, each from its own log.

The beginning of that file, gains and masses of their info*.yaml, stays as it is. Everything else follows from the
signals of a log, and nothing from a tracking error: thrust, lag, inertia and centre of mass from `identify`, drag from
the force that the acceleration shows, and the error of the estimated velocity from the derivative of the estimated
position.
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
from drake_quad.command_line.options import bare_parser
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.files import output_folder, write_atomically
from drake_quad.identification.flown_again.estimator import VelocityEstimate, linear_drag, velocity_estimate
from drake_quad.identification.identify import identify
from drake_quad.identification.logs.reading import read_log
from drake_quad.identification.result import Identification, Spread
from drake_quad.identification.results.estimates import Estimates
from drake_quad.identification.results.vehicle_numbers import number_of, with_numbers
from drake_quad.linear.closed_loop import closed_loop
from drake_quad.scenario.correlation import correlated_normals
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.models import Scenario

_ROOT = Path(__file__).parents[2]
_FILE = _ROOT / "diagrams" / "crazyswarm2.yaml"
_LOGS = _ROOT / "tests" / "data" / "crazyflie" / "crazyswarm2"
_FLIGHTS = ("08", "100", "145", "180")
# Initial time constant (s) of the rotors, from other flights of a Crazyflie (arXiv 2404.07837). The loop would be
# unstable with that of the data sheet.
_LAG = ("vehicle.rotor_time_constant=0.072", "vehicle.rotor_time_constant_down=null")
# Standard deviation of the tilt, rad. Without an integral, logs rest 3 to 16 mm off the reference: 3 to 15 mrad.
_TILT = 0.008
# A mode with a higher frequency (rad/s) counts as a swing.
_MIN_SWING_FREQUENCY = 3.0
_PRESSURE = "body_drag.centre_of_pressure[2]"
_WRITTEN = (
    "thrust_factor",
    "rotor_time_constant",
    "inertia[0]",
    "inertia[1]",
    "centre_of_mass[0]",
    "centre_of_mass[1]",
    _PRESSURE,
)
_HEAD = """, as `python scripts/identify_crazyswarm2.py` writes it; standard deviations are those of the estimates.
# Thrust, lag, delay, inertia about x and y, centre of mass: by drake_quad.identification.identify from all of the
# log, with the lag to begin with of other flights of Crazyflies (arXiv 2404.07837), for the whole number of ticks of
# delay that is nearest, and given that the vehicle flew: its loop does not swing up by its linear model. Inertia
# about z and the drag factor: those of the data sheet in the same proportion. Drag: the force across the body that
# the rate of the estimated velocity shows. Centre of pressure: such that with this drag the torque that grows with
# the speed is the identified one. Velocity: the estimate over the derivative of the estimated position, as a share of
# it and the rest, which stays on for a while. Misalignment: without an integral (log100) the vehicle rests 3 to 16 mm
# beside the reference, which is a tilt of 3 to 15 mrad. Along an axis that was not flown drag is that along the other.
"""
_BEGINNING_OF_VEHICLES = "\n# What the logs show"


def main() -> None:
    options = bare_parser(__doc__, "python scripts/development/identify_crazyswarm2.py --output mine.yaml")
    options.add_argument(
        "--output", type=Path, default=_FILE, metavar="FILE", help=f"to write (default: {_FILE.relative_to(_ROOT)})"
    )
    options.add_argument("--log", choices=_FLIGHTS, nargs="+", default=list(_FLIGHTS), help="which of the four")
    arguments = options.parse_args()
    if set(arguments.log) != set(_FLIGHTS) and arguments.output.resolve() == _FILE.resolve():
        raise InputError("--log: the shipped file has all four; --output says where to write some")
    output_folder(arguments.output.parent)
    before, _, _ = _FILE.read_text(encoding="utf-8").partition(_BEGINNING_OF_VEHICLES)
    controllers = os.path.relpath(_FILE.parent / "controllers", arguments.output.parent)
    before = before.replace("extends: controllers/", f"extends: {controllers}/")
    parts, rows = [], []
    for log in arguments.log:
        record = read_log(_LOGS / f"log{log}.xz")
        base = load_undesigned(f"{_FILE}:sheet_{log}", list(_LAG))
        found = identify([record], base, held_out_share=0.0)
        estimate, drag = velocity_estimate(record), linear_drag(record, base)
        parts.append(vehicle(log, base, found, estimate, drag))
        rows += shown(log, found, estimate, drag)
    print_columns(("log", "number", "value", "standard deviation"), rows)

    def write(path: Path) -> None:
        path.write_text(before + _BEGINNING_OF_VEHICLES + _HEAD + "".join(parts), encoding="utf-8")

    print_files([write_atomically(arguments.output, write)])


def vehicle(
    log: str, base: Scenario, found: Identification, estimate: VelocityEstimate, drag: tuple[Spread, Spread]
) -> str:
    """Return the scenario of a log in YAML."""
    ticks = round(found.vehicle.laboratory.command_link.delay_ticks)
    flown = load_undesigned(f"{_FILE}:sheet_{log}", [*_LAG, f"laboratory.command_link.delay_ticks={ticks}"])
    numbers = that_flies(found.estimates.part(_WRITTEN), flown)
    values = dict(zip(_WRITTEN, numbers.values, strict=True))
    drawn = correlated_normals(_WRITTEN, numbers.values, numbers.covariance, prefix=f"log{log}")
    told = {name: in_yaml(drawn[name]["normal"], signed=name.startswith("centre_of_mass")) for name in _WRITTEN}
    turning = base.vehicle.drag_factor / base.vehicle.thrust_factor
    yaw = base.vehicle.inertia[2] * values["inertia[0]"] / base.vehicle.inertia[0]
    believed = number_of(base, "body_drag.linear[0]")
    arm = values[_PRESSURE] * 2.0 * believed / (drag[0].value + drag[1].value)
    lines = [
        f"log{log}:",
        f"  extends: sheet_{log}",
        "  vehicle:",
        f"    rotor_time_constant: {told['rotor_time_constant']}",
        "    rotor_time_constant_down: null    # as upwards",
        f"    thrust_factor: {told['thrust_factor']}",
        f"    drag_factor: {values['thrust_factor'] * turning:.4g}",
        "    inertia:",
        f"      - {told['inertia[0]']}",
        f"      - {told['inertia[1]']}",
        f"      - {yaw:.4g}",
        "    body_drag:",
        "      linear:",
        *(f"        - {normal(each.value, each.deviation, 0.0)}" for each in drag),
        "        - 0.01278",
        f"      centre_of_pressure: [0, 0, {arm:.3g}]",
        "    centre_of_mass:",
        *(f"      - {told[f'centre_of_mass[{i}]']}" for i in range(2)),
        "  laboratory:",
        f"    command_link: {{delay_ticks: {ticks}}}",
        "    motion_capture:",
        "      misalignment:",
        *(f"        - {normal(0.0, _TILT)}" for _ in range(2)),
        "        - 0.0",
        "      velocity_error:",
        *(f"        - {normal(each.value, each.deviation, -0.5)}" for each in estimate.scale_error),
        f"      velocity_drift: [{', '.join(f'{each:.3g}' for each in estimate.drift)}]",
        f"      drift_time: {estimate.correlation_time:.2g}",
    ]
    return "\n".join(lines) + "\n"


def that_flies(estimates: Estimates, base: Scenario) -> Estimates:
    """Return the estimates given that the vehicle flew, that is, that its loop is not unstable.

    The growth rate of swings is taken as linear in the parameters. Their normal distribution is truncated where swings
    grow, and replaced by the normal distribution with the same mean and covariance.
    """
    growth = growth_of(base, estimates)
    deviations = estimates.deviations
    slopes = np.empty(len(deviations))
    for i, deviation in enumerate(deviations):
        other = estimates.values + deviation * np.eye(len(deviations))[i]
        slopes[i] = (growth_of(base, replace(estimates, values=other)) - growth) / deviation
    along = estimates.covariance @ slopes
    spread = float(np.sqrt(slopes @ along))
    limit = -growth / spread
    # These are the mean and the variance of a standard normal variable, truncated at the limit.
    mean = -float(np.exp(scipy.stats.norm.logpdf(limit) - scipy.stats.norm.logcdf(limit)))
    variance = 1.0 + limit * mean - mean**2
    values = estimates.values + along / spread * mean
    covariance = estimates.covariance - (1.0 - variance) * np.outer(along, along) / spread**2
    return replace(estimates, values=values, covariance=covariance)


def growth_of(base: Scenario, estimates: Estimates) -> float:
    """Return the growth rate of swings in hover from the linear model of a tick, 1/s; negative if they decay."""
    scenario = with_numbers(base, dict(zip(estimates.names, map(float, estimates.values), strict=True)))
    system = closed_loop(scenario).system
    poles = np.log(system.poles().astype(complex)) / system.period
    return float(poles[np.abs(poles.imag) > _MIN_SWING_FREQUENCY].real.max())


def in_yaml(bell: dict[str, Any], *, signed: bool) -> str:
    """Return a normal distribution in YAML; a positive parameter is limited to 0.5 to 1.5 times its mean."""
    mean = bell["mean"]
    ends = "" if signed else f", min: {0.5 * mean:.4g}, max: {1.5 * mean:.4g}"
    # Weights are truncated rather than rounded, so that the sum of their squares does not exceed 1.
    weights = {name: math.trunc(1e4 * weight) / 1e4 for name, weight in bell.get("shared", {}).items()}
    names = ", ".join(f"{name}: {weight}" for name, weight in weights.items())
    shared = f", shared: {{{names}}}" if names else ""
    return f"{{normal: {{mean: {mean:.5g}, standard_deviation: {bell['standard_deviation']:.3g}{ends}{shared}}}}}"


def normal(mean: float, deviation: float, least: float | None = None, most: float | None = None) -> str:
    """Return a normal distribution in YAML."""
    ends = "".join(f", {name}: {end:.4g}" for name, end in (("min", least), ("max", most)) if end is not None)
    return f"{{normal: {{mean: {mean:.4g}, standard_deviation: {deviation:.2g}{ends}}}}}"


def shown(
    log: str, found: Identification, estimate: VelocityEstimate, drag: tuple[Spread, Spread]
) -> list[tuple[str, str, str, str]]:
    """Return the rows of the table for a log."""
    estimates = found.estimates
    rows = [
        (f"log{log}", name, f"{value:.4g}", f"{deviation:.2g}")
        for name, value, deviation in zip(estimates.names, estimates.values, estimates.deviations, strict=True)
        if name in _WRITTEN
    ]
    for axis, one, share, rest in zip("xy", drag, estimate.scale_error, estimate.drift, strict=False):
        rows += [
            (f"log{log}", f"drag along {axis}, N s/m", f"{one.value:.4g}", f"{one.deviation:.2g}"),
            (f"log{log}", f"share of velocity along {axis}", f"{share.value:.3f}", f"{share.deviation:.2g}"),
            (f"log{log}", f"the rest, for {estimate.correlation_time:.2g} s, m/s", f"{rest:.3f}", "–"),
        ]
    return rows


if __name__ == "__main__":
    run(main)
