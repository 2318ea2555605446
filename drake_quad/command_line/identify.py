"""Identify a vehicle from flight logs, and write it with the uncertainty of its parameters.

The command prints the signals of the logs, the identified parameters with 95 % intervals, and the parameters that the
logs do not identify, with the reasons. It also prints two scores on held-out data, the last third of each flight: the
variance that a forecast explains, and the errors of open-loop predictions, compared with the initial vehicle.
"""

import argparse
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from drake_quad import InputError, Scenario
from drake_quad.command_line.default_outputs import Origin, reserve
from drake_quad.command_line.options import add_vector, parse_overrides, parser_without_options
from drake_quad.command_line.output import print_columns, print_files, print_predictions, remark
from drake_quad.errors import short_repr
from drake_quad.files import output_folder
from drake_quad.identification.hover import delay_by_correlation, hover_means, white_noise
from drake_quad.identification.identify import identify
from drake_quad.identification.result import Identification
from drake_quad.identification.results.vehicle_file import write_vehicle
from drake_quad.identification.validation.prediction import Predictions, concatenate_predictions, predict
from drake_quad.identification.windows import airborne_mask
from drake_quad.logs.reading import read_log
from drake_quad.logs.record import FlightRecord
from drake_quad.number_parsing import parse_float
from drake_quad.scenario.files.loading import Override, load_undesigned
from drake_quad.scenario.models import NAME
from drake_quad.scenario.paths import distributions_in
from drake_quad.statistics.interval import plus_minus, spread_text
from drake_quad.visualization import identification_plots as plots
from drake_quad.visualization.style import save_figures

# Initial vehicles that an error message suggests if a log does not name its vehicle.
_EXAMPLE_WITH_AUTOPILOT = "vehicles/neural_fly:neural_fly, whose autopilot takes attitudes and thrust"
_EXAMPLE_WITH_ROTOR_COMMANDS = "vehicles/hummingbird, which takes rotor commands"
_MAX_WIND = 100.0  # m/s, the largest wind speed that a scenario may contain
_HELD_OUT_FRACTION = 1.0 / 3.0  # fraction of the airborne time, at the end of each flight, that is held out


def options() -> argparse.ArgumentParser:
    result = parser_without_options(
        __doc__, "drake-quad identify tests/data/crazyflie/crazyswarm2/log100.xz --mass 0.0375"
    )
    result.add_argument(
        "log", nargs="+", type=Path, help="flight logs of the same vehicle, in any format that `read_log` reads"
    )
    result.add_argument(
        "--vehicle",
        help="FILE or FILE:NAME of the initial vehicle (default: the vehicle named in the mapping or saved flight)",
    )
    result.add_argument("--mapping", help="YAML file that maps columns to signals, or the name of a shipped mapping")
    result.add_argument(
        "--wind",
        metavar="X,Y,Z",
        action="append",
        default=[],
        help="wind velocity in the world frame, m/s, for logs that do not contain it; given once for all logs, or once"
        " for each log",
    )
    result.add_argument("--mass", type=float, metavar="KG", help="measured mass, which logs cannot identify")
    result.add_argument(
        "--set", metavar="FIELD=VALUE", action="append", default=[], help="override a field of the initial vehicle"
    )
    result.add_argument("--output", type=Path, metavar="FILE", help="file to write (default: out/identified/NAME.yaml)")
    result.add_argument(
        "--nominal",
        action="store_true",
        help="also write the estimates to `nominal`, the parameters that planner and controllers use",
    )
    result.add_argument(
        "--name", help="name of the vehicle (default: name of the output file or, without --output, of the first log)"
    )
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    name = vehicle_name(arguments)
    path = output_file(arguments, f"{name}.yaml")
    overrides = parse_overrides(arguments.set)
    if arguments.mass is not None:
        overrides.append(Override(f"nominal.mass={arguments.mass}", f"--mass {arguments.mass:g}"))
    records = with_winds([read_log(log, arguments.mapping) for log in arguments.log], arguments.wind)
    vehicle = arguments.vehicle or initial_vehicle_name(records, arguments.log)
    base = load_initial_vehicle(vehicle, overrides)
    print_logs(records)
    print_hover(records, float(base.vehicle.mass * base.vehicle.gravity))
    print(f"the initial vehicle is {vehicle}")
    identification = identify(records, base, held_out_fraction=_HELD_OUT_FRACTION)
    print_estimates(identification)
    print_flights(identification)
    print_score(identification)
    predictions = predict_held_out(records, identification, base)
    print("RMS errors of open-loop predictions of held-out flight, by a vehicle identified from the training set")
    print_predictions(predictions)
    losses = predictions.remark_on_worse_predictions("identified")
    if losses:
        remark(losses)
    assignments = [override.assignment for override in overrides]
    motors = identification.vehicle.vehicle.motors
    file_options = {"base": vehicle, "nominal": arguments.nominal, "overrides": assignments}
    write_vehicle(path, name, identification.estimates, **file_options, voltage=getattr(motors, "voltage", None))
    figures = {
        "fit": plots.plot_fit(identification),
        "residuals": plots.plot_residuals(identification),
        "thrust": plots.plot_thrust(identification, throttles(records)),
        "correlations": plots.plot_correlations(identification.estimates),
        "predictions": plots.plot_predictions(predictions),
    }
    saved = {name: figure for name, figure in figures.items() if figure is not None}
    folder = output_folder(path.with_suffix(""))
    print_files([path, *save_figures(saved, folder, vector=arguments.vector)])


def output_file(arguments: argparse.Namespace, name: str) -> Path:
    """Return the file to write: the value of `--output`, or by default a file that is named after the first log.

    Raises:
        InputError: if the file is not YAML, cannot be written, or was written for another log with the same name.
    """
    path: Path = arguments.output or Path("out/identified") / name
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(f"--output {path}: the name of the file must end in .yaml or .yml")
    output_folder(path.parent)
    # A file with the default name must not be overwritten for another log. A name that the user gives is not protected.
    return (
        path if arguments.output or arguments.name else reserve(path, [Origin.of_file(arguments.log[0])], is_file=True)
    )


def vehicle_name(arguments: argparse.Namespace) -> str:
    """Return the name of the identified vehicle."""
    if arguments.name is not None:
        if not re.fullmatch(NAME, arguments.name):
            raise InputError(
                f"--name {short_repr(arguments.name)}: a name consists of letters, digits, '_', '.' and '-'"
            )
        return str(arguments.name)
    source = arguments.output or arguments.log[0]
    return re.sub(r"[^\w.-]", "_", source.name.partition(".")[0]) or "identified"


def with_winds(records: list[FlightRecord], winds: list[str]) -> list[FlightRecord]:
    """Return the logs with the winds from the command line."""
    if not winds:
        return records
    if len(winds) not in (1, len(records)):
        raise InputError(
            f"--wind is given {len(winds)} times for {len(records)} logs; give it once, or once for each log"
        )
    wind_of_log = winds * len(records) if len(winds) == 1 else winds
    records_with_wind = []
    for record, text in zip(records, wind_of_log, strict=True):
        try:
            wind = [parse_float(each) for each in text.split(",")]
        except ValueError:
            wind = []
        if len(wind) != 3 or not np.all(np.abs(wind) < _MAX_WIND):
            raise InputError(
                f"--wind {short_repr(text)} must be three numbers between -{_MAX_WIND:g} and {_MAX_WIND:g} m/s, as in"
                " -8.5,0,0"
            )
        if record.wind is not None:
            remark(f"{record.name}: the log contains the wind, so --wind is ignored")
        records_with_wind.append(
            record if record.wind is not None else replace(record, wind=np.tile(wind, (len(record.time), 1)))
        )
    return records_with_wind


def initial_vehicle_name(records: list[FlightRecord], logs: list[Path]) -> str:
    """Return FILE or FILE:NAME of the initial vehicle.

    It is the vehicle that the logs name or, for a saved flight, the scenario beside the log.

    Raises:
        InputError: if the logs name different vehicles, or no vehicle.
    """
    saved_scenario = logs[0].parent / "scenario.yaml"
    vehicles = sorted({record.vehicle for record in records if record.vehicle is not None})
    if len(vehicles) > 1:
        raise InputError(
            f"the logs are of different vehicles, {' and '.join(vehicles)}; identify each vehicle separately"
        )
    if vehicles:
        return vehicles[0]
    if logs[0].name.startswith("flight.csv") and saved_scenario.is_file():
        return str(saved_scenario)
    signals = {name for record in records for name in record.names}
    onboard = {"attitude", "attitude_command"} <= signals and not signals & {"motor_command", "rotor_speed_command"}
    example = _EXAMPLE_WITH_AUTOPILOT if onboard else _EXAMPLE_WITH_ROTOR_COMMANDS
    raise InputError(
        f"the log {short_repr(records[0].name)} does not name its vehicle; give an initial vehicle by --vehicle,"
        f" such as {example}, and its measured mass by --mass"
    )


def load_initial_vehicle(spec: str, overrides: list[Override]) -> Scenario:
    """Load the initial vehicle.

    Raises:
        InputError: if the vehicle cannot be loaded, or contains a distribution.
    """
    base = load_undesigned(spec, overrides)
    distributions = distributions_in(base)
    if distributions:
        raise InputError(
            f"{spec}: {next(iter(distributions))} is a distribution, but the initial vehicle must not contain"
            " distributions; replace it by a number"
        )
    return base


def throttles(records: list[FlightRecord]) -> np.ndarray | None:
    """Return all throttles commanded in flight in the logs, (n,); None if the logs contain no throttle."""
    commands = [
        command[airborne_mask(record)].ravel()
        for record in records
        for command in (record.motor_command, record.thrust_fraction)
        if command is not None
    ]
    return np.concatenate(commands) if commands else None


def predict_held_out(records: list[FlightRecord], identification: Identification, base: Scenario) -> Predictions:
    """Predict the held-out end of each flight with the vehicle from the training set, and with the initial vehicle."""
    vehicles = {"identified": identification.training_vehicle or identification.vehicle, base.name: base}
    return concatenate_predictions(
        [predict(record, vehicles, nominal=base, final_fraction=_HELD_OUT_FRACTION) for record in records]
    )


def print_logs(records: list[FlightRecord]) -> None:
    """Print the duration, the sampling rate, the origin of each signal, and the remarks, for each log."""
    for record in records:
        seconds = record.time[-1] - record.time[0]
        print(f"{record.name}: {seconds:.1f} s, {len(record.time):,} samples at {1.0 / record.period:.0f} Hz")
        rows = [
            (each.signal, f"{each.rate:.4g} Hz", each.resampling, missing_text(each.missing_fraction), each.columns)
            for each in record.origins
        ]
        print_columns(("signal", "rate", "resampled", "not a number", "columns of the log"), rows)
        for sentence in record.remarks:
            remark(f"{record.name}: {sentence}")


def missing_text(fraction: float) -> str:
    """Return the fraction of missing samples in percent; empty if none is missing."""
    return f"{100.0 * fraction:.2g} %" if fraction else ""


def print_estimates(identification: Identification) -> None:
    """Print the identified parameters, and the parameters that the logs do not identify."""
    estimates = identification.estimates
    half_widths = estimates.quantiles() * estimates.deviations
    new_flight = estimates.for_new_flight()
    new_flight_half_widths = new_flight.quantiles() * new_flight.deviations
    rows = []
    known = estimates.variation_known
    columns = zip(
        estimates.names, estimates.values, half_widths, new_flight_half_widths, known, estimates.units, strict=True
    )
    for name, value, half_width, new_flight_half_width, varies, unit in columns:
        if name in estimates.not_identified:
            continue
        explained = estimates.explained_variance.get(name)
        fraction = (
            ""
            if explained is None or explained.fraction < 5e-4
            else f"{100.0 * explained.fraction:.1f} % of {explained.output}"
        )
        new_flight_text = spread_text(new_flight_half_width) if varies else "–"
        rows.append(
            (
                name,
                plus_minus(value, half_width),
                "" if unit == "1" else unit,
                new_flight_text,
                coverage_text(identification, name),
                fraction,
            )
        )
    print(
        "identified parameters with 95 % intervals, the half-width of the interval for a new flight, the number of"
        " held-out segments whose estimate is within it, and the explained variance of held-out flight"
    )
    print_columns(("parameter", "value", "unit", "new flight", "within", "explained variance"), rows)
    if identification.delay is not None:
        delay = plus_minus(1e3 * identification.delay.value, 1e3 * identification.delay.half_width)
        print(f"delay from a command to the measurement of its effect: {delay} ms")
    names_by_reason: dict[str, list[str]] = {}
    for name, why in estimates.not_identified.items():
        names_by_reason.setdefault(why, []).append(name)
    for why, names in names_by_reason.items():
        print(f"not identified: {', '.join(names)}: {why}")
    for sentence in identification.remarks:
        remark(sentence)
    total = len({*estimates.names, *estimates.not_identified})
    if 2 * len(estimates.identified) < total:
        remark(
            f"the logs identify only {len(estimates.identified)} of {total} parameters; the others, except"
            " coefficients of a thrust curve, keep the values of the initial vehicle"
        )


def coverage_text(identification: Identification, name: str) -> str:
    """Return the fraction of held-out segments with an estimate within the parameter's interval, such as "3 of 4".

    The result is empty if the fraction is unknown.
    """
    if name not in identification.held_out:
        return ""
    errors = identification.held_out[name]
    return f"{errors.num_covered} of {len(errors.errors)}"


def print_flights(identification: Identification) -> None:
    """Print how flights differ: the thrust of each flight relative to the mean, its trim force and its wind force."""
    rows = []
    for flight in identification.flights:
        thrust = (
            "–" if flight.thrust is None else plus_minus(100.0 * flight.thrust.value, 100.0 * flight.thrust.half_width)
        )
        forces = (flight.forces.get(f"{kind}_force.{axis}") for kind in ("trim", "wind") for axis in "xy")
        rows.append((flight.name, thrust, *("–" if f is None else plus_minus(f.value, f.half_width) for f in forces)))
    if any(set(row[1:]) != {"–"} for row in rows):
        print(
            "differences between flights: thrust relative to the mean over all flights, mean trim force and wind force"
        )
        print_columns(("flight", "thrust, %", "trim x, N", "trim y, N", "wind x, N", "wind y, N"), rows)


def print_score(identification: Identification) -> None:
    """Print the forecast scores on the held-out data, with a row for each output."""
    rows = [
        (
            output.name,
            variance_text(output.explained_variance),
            f"{np.sqrt(np.mean(output.residual**2)):.2g}",
            f"{output.deviation:.2g}",
            output.unit,
        )
        for output in identification.outputs
    ]
    print("forecasts of short sections of held-out flight")
    print_columns(("output", "explained variance", "RMS error", "white noise", ""), rows)


def print_hover(records: list[FlightRecord], weight: float) -> None:
    """Print the white noise of the measurements, the trim in hover and the attitude delay.

    Args:
        records: logs of the flights.
        weight: weight of the vehicle, N.
    """
    rows = []
    for record in records:
        for noise in white_noise(record):
            sizes = (f"{np.sqrt(np.mean(each**2)):.2g}" for each in (noise.at_rest, noise.in_flight))
            rest, in_flight = ("–" if size == "nan" else size for size in sizes)
            rows.append(
                (f"{record.name}: white noise of {noise.signal.replace('_', ' ')}", rest, in_flight, noise.unit)
            )
    print_columns(("", "at rest", "in flight", ""), rows)
    for record in records:
        for name, spread in hover_means(record, weight).items():
            print(f"{record.name}: {name} in hover {plus_minus(spread.value, spread.half_width)} {spread.unit}")
        delay = delay_by_correlation(record)
        if delay is not None:
            print(f"{record.name}: delay of the attitude behind its command, by correlation: {1e3 * delay:.0f} ms")


def variance_text(fraction: float) -> str:
    """Return the explained fraction of the variance as text."""
    if not math.isfinite(fraction):
        return "–"
    return f"{100.0 * fraction:.1f} %" if fraction > 0.0 else "none"
