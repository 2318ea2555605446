"""Identify a vehicle from flight logs, and write it with its uncertainty.

The command prints the signals of the logs, the identified parameters with 95 % intervals, the parameters that are not
identified with the reasons, and two scores on the last third of each flight, which is held out: the variance that a
forecast explains, and the errors of open-loop predictions beside those of the initial vehicle.
"""

import argparse
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from drake_quad import InputError, Scenario
from drake_quad.command_line.options import add_vector, bare_parser, overrides_of
from drake_quad.command_line.output import print_columns, print_files, print_predictions, remark
from drake_quad.errors import shown
from drake_quad.files import output_folder
from drake_quad.identification.flown_again.prediction import Predictions, joined, predict
from drake_quad.identification.hover import delay_by_correlation, trim, white_noise
from drake_quad.identification.identify import identify
from drake_quad.identification.logs.reading import read_log
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.result import Identification
from drake_quad.identification.results.vehicle_file import write_vehicle
from drake_quad.scenario.files.loading import Override, load_undesigned
from drake_quad.scenario.models import NAME
from drake_quad.scenario.paths import distributions_in
from drake_quad.statistics.interval import plus_minus, spread_text
from drake_quad.visualization import identification_plots as plots
from drake_quad.visualization.style import save_figures
from drake_quad.written_numbers import float_in

# Initial vehicles that are suggested for a log that names none, with the commands that they take.
_AUTOPILOT_EXAMPLE = "vehicles/neural_fly:neural_fly", "whose autopilot takes attitudes and thrust"
_ROTORS_EXAMPLE = "vehicles/hummingbird", "whose rotors are commanded"
_MAX_WIND = 100.0  # m/s, as in scenarios
_HELD_OUT_SHARE = 1.0 / 3.0  # share of the airborne time, at its end


def options() -> argparse.ArgumentParser:
    """Return the options of the command."""
    result = bare_parser(__doc__, "drake-quad identify tests/data/crazyflie/crazyswarm2/log100.xz --mass 0.0375")
    result.add_argument("log", nargs="+", type=Path, help="flight logs of the same vehicle, in any format of read_log")
    result.add_argument(
        "--vehicle",
        help="FILE or FILE:NAME of the initial vehicle (default: that of the mapping, or of a saved flight)",
    )
    result.add_argument("--mapping", help="mapping of columns to signals: a YAML file, or the name of a shipped one")
    result.add_argument(
        "--wind",
        metavar="X,Y,Z",
        action="append",
        default=[],
        help="wind velocity in W, m/s, for logs that do not contain it: given once for all logs, or once for each",
    )
    result.add_argument("--mass", type=float, metavar="KG", help="weighed mass, which logs do not determine")
    result.add_argument(
        "--set", metavar="FIELD=VALUE", action="append", default=[], help="override a field of the initial vehicle"
    )
    result.add_argument("--output", type=Path, metavar="FILE", help="file to write (default: out/identified/NAME.yaml)")
    result.add_argument(
        "--nominal",
        action="store_true",
        help="also write the estimates to nominal, which planner and controllers believe",
    )
    result.add_argument("--name", help="name of the vehicle (default: that of the file, or of the first log)")
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    """Run the command."""
    name = name_of(arguments)
    path = arguments.output or Path("out/identified") / f"{name}.yaml"
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(f"--output {path}: must end in .yaml or .yml")
    output_folder(path.parent)
    given = overrides_of(arguments.set)
    if arguments.mass is not None:
        given.append(Override(f"nominal.mass={arguments.mass}", f"--mass {arguments.mass:g}"))
    records = with_winds([read_log(log, arguments.mapping) for log in arguments.log], arguments.wind)
    vehicle = arguments.vehicle or vehicle_to_begin_with(records, arguments.log)
    base = vehicle_of(vehicle, given)
    print_logs(records)
    print_hover(records, float(base.vehicle.mass * base.vehicle.gravity))
    print(f"the initial vehicle is {vehicle}")
    found = identify(records, base, held_out_share=_HELD_OUT_SHARE)
    print_estimates(found)
    print_flights(found)
    print_score(found)
    predictions = predicted(records, found, base)
    print("RMS error of open-loop predictions of the last third of each flight, by a vehicle identified from the rest")
    print_predictions(predictions)
    for sentence in predictions.losses("identified"):
        remark(sentence)
    assignments = [each.assignment for each in given]
    motors = found.vehicle.vehicle.motors
    written = {"base": vehicle, "nominal": arguments.nominal, "given": assignments}
    write_vehicle(path, name, found.estimates, **written, voltage=getattr(motors, "voltage", None))
    figures = {
        "fit": plots.plot_fit(found),
        "residuals": plots.plot_residuals(found),
        "thrust": plots.plot_thrust(found, throttles(records)),
        "correlations": plots.plot_correlations(found.estimates),
        "predictions": plots.plot_predictions(predictions),
    }
    drawn = {name: figure for name, figure in figures.items() if figure is not None}
    folder = output_folder(path.with_suffix(""))
    print_files([path, *save_figures(drawn, folder, vector=arguments.vector)])


def name_of(arguments: argparse.Namespace) -> str:
    """Return the name of the vehicle."""
    if arguments.name is not None:
        if not re.fullmatch(NAME, arguments.name):
            raise InputError(f"--name {shown(arguments.name)}: allowed are letters, digits, '_', '.' and '-'")
        return str(arguments.name)
    source = arguments.output or arguments.log[0]
    return re.sub(r"[^\w.-]", "_", source.name.partition(".")[0]) or "identified"


def with_winds(records: list[FlightRecord], winds: list[str]) -> list[FlightRecord]:
    """Return the logs with the winds from the command line."""
    if not winds:
        return records
    if len(winds) not in (1, len(records)):
        raise InputError(f"--wind is given {len(winds)} times; give it once, or once for each of {len(records)} logs")
    given = winds * len(records) if len(winds) == 1 else winds
    found = []
    for record, text in zip(records, given, strict=True):
        try:
            wind = [float_in(each) for each in text.split(",")]
        except ValueError:
            wind = []
        if len(wind) != 3 or not np.all(np.abs(wind) < _MAX_WIND):
            raise InputError(f"--wind {shown(text)}: must be three numbers below {_MAX_WIND:g} m/s, as in -8.5,0,0")
        if record.wind is not None:
            remark(f"{record.name}: contains the wind, which --wind does not replace")
        found.append(record if record.wind is not None else replace(record, wind=np.tile(wind, (len(record.time), 1))))
    return found


def vehicle_to_begin_with(records: list[FlightRecord], logs: list[Path]) -> str:
    """Return the initial vehicle: that of the mapping, or the scenario that was saved beside a flight.

    Raises:
        InputError: if the logs are of different vehicles, or do not say which vehicle they are of.
    """
    beside = logs[0].parent / "scenario.yaml"
    named = sorted({record.vehicle for record in records if record.vehicle is not None})
    if len(named) > 1:
        raise InputError(f"the logs are of different vehicles, {' and '.join(named)}: identify them one by one")
    if named:
        return named[0]
    if logs[0].name.startswith("flight.csv") and beside.is_file():
        return str(beside)
    has = {name for record in records for name in record.names}
    onboard = {"attitude", "attitude_command"} <= has and not has & {"motor_command", "rotor_speed_command"}
    example, commands = _AUTOPILOT_EXAMPLE if onboard else _ROTORS_EXAMPLE
    raise InputError(
        f"the log {shown(records[0].name)} does not say which vehicle it is of: give an initial vehicle by --vehicle,"
        f" such as {example}, {commands}, and its weighed mass by --mass"
    )


def vehicle_of(spec: str, given: list[Override]) -> Scenario:
    """Return the initial vehicle.

    Raises:
        InputError: if it cannot be loaded, or contains a distribution.
    """
    base = load_undesigned(spec, given)
    drawn = distributions_in(base)
    if drawn:
        raise InputError(f"{spec}: {next(iter(drawn))} is a distribution; an identification begins with numbers")
    return base


def throttles(records: list[FlightRecord]) -> np.ndarray | None:
    """Return all commanded throttles (n,); None if there are none."""
    found = [each for record in records for each in (record.motor_command, record.thrust_share) if each is not None]
    return np.concatenate([each.ravel() for each in found]) if found else None


def predicted(records: list[FlightRecord], found: Identification, base: Scenario) -> Predictions:
    """Predict the ends of the flights by a vehicle identified from the rest, and by the initial vehicle."""
    vehicles = {"identified": found.training_vehicle or found.vehicle, base.name: base}
    return joined([predict(record, vehicles, believed=base, share=_HELD_OUT_SHARE) for record in records])


def print_logs(records: list[FlightRecord]) -> None:
    """Print duration, rate, signals and remarks of the logs."""
    for record in records:
        seconds = record.time[-1] - record.time[0]
        print(f"{record.name}: {seconds:.1f} s, {len(record.time):,} samples at {1.0 / record.period:.0f} Hz")
        print(f"  {', '.join(record.names)}")
        for sentence in record.remarks:
            remark(f"{record.name}: {sentence}")


def print_estimates(found: Identification) -> None:
    """Print the identified parameters, and the parameters that could not be identified."""
    estimates = found.estimates
    reaches = estimates.quantiles() * estimates.deviations
    elsewhere = estimates.for_new_flight()
    farther = elsewhere.quantiles() * elsewhere.deviations
    rows = []
    known = estimates.variation_known
    columns = zip(estimates.names, estimates.values, reaches, farther, known, estimates.units, strict=True)
    for name, value, reach, far, varies, unit in columns:
        if name in estimates.not_identified:
            continue
        explained = estimates.explained.get(name)
        share = (
            ""
            if explained is None or explained.share < 5e-4
            else f"{100.0 * explained.share:.1f} % of {explained.output}"
        )
        another = spread_text(far) if varies else "–"
        rows.append((name, plus_minus(value, reach), "" if unit == "1" else unit, another, covered(found, name), share))
    print("identified parameters with 95 % intervals, those for another stretch, and held-out stretches inside them")
    print_columns(("parameter", "value", "unit", "another stretch", "inside", "explained, held out"), rows)
    if found.delay is not None:
        delay = plus_minus(1e3 * found.delay.value, 1e3 * found.delay.reach)
        print(f"delay from a command to the measurement of its effect: {delay} ms")
    for name, why in estimates.not_identified.items():
        print(f"not identified: {name}: {why}")
    for sentence in (*found.remarks, *estimates.remarks):
        remark(sentence)


def covered(found: Identification, name: str) -> str:
    """Return how many held-out stretches are inside the interval of a parameter; empty if this is unknown."""
    if name not in found.held_out:
        return ""
    each = found.held_out[name]
    return f"{each.covered} of {len(each.errors)}"


def print_flights(found: Identification) -> None:
    """Print the thrust and the mean forces that each flight has of its own."""
    rows = []
    for flight in found.flights:
        thrust = "–" if flight.thrust is None else plus_minus(100.0 * flight.thrust.value, 100.0 * flight.thrust.reach)
        forces = (flight.forces.get(f"{kind}_force.{axis}") for kind in ("trim", "wind") for axis in "xy")
        rows.append((flight.name, thrust, *("–" if f is None else plus_minus(f.value, f.reach) for f in forces)))
    if any(set(row[1:]) != {"–"} for row in rows):
        print("each flight: thrust relative to the mean, and mean forces in addition to those of the vehicle")
        print_columns(("flight", "thrust, %", "trim x, N", "trim y, N", "wind x, N", "wind y, N"), rows)


def print_score(found: Identification) -> None:
    """Print the share of the variance that the forecast of held-out flight explains."""
    rows = [
        (
            output.name,
            percent(output.explained),
            f"{np.sqrt(np.mean(output.residual**2)):.2g}",
            f"{output.deviation:.2g}",
            output.unit,
        )
        for output in found.outputs
    ]
    print("forecast of held-out flight, in windows")
    print_columns(("output", "explained variance", "RMS error", "white noise", ""), rows)


def print_hover(records: list[FlightRecord], weight: float) -> None:
    """Print the white noise of the measurements, and the trim for a weight in N."""
    rows = []
    for record in records:
        for noise in white_noise(record):
            sizes = (f"{np.sqrt(np.mean(each**2)):.2g}" for each in (noise.at_rest, noise.in_flight))
            rest, flown = ("–" if size == "nan" else size for size in sizes)
            rows.append((f"{record.name}: white noise of {noise.signal.replace('_', ' ')}", rest, flown, noise.unit))
    print_columns(("", "at rest", "in flight", ""), rows)
    for record in records:
        for name, spread in trim(record, weight).items():
            print(f"{record.name}: {name} in hover {plus_minus(spread.value, spread.reach)} {spread.unit}")
        behind = delay_by_correlation(record)
        if behind is not None:
            print(f"{record.name}: the attitude correlates most with its command {1e3 * behind:.0f} ms before")


def percent(share: float) -> str:
    """Return an explained share of variance as text."""
    if not math.isfinite(share):
        return "–"
    return f"{100.0 * share:.1f} %" if share > 0.0 else "none"
