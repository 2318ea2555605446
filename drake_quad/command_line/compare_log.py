"""Fly the reference of a flight log in simulation, with the vehicle and controller of a scenario, and compare errors.

If the scenario has no controller, the command predicts the logged flight in open loop: it simulates the vehicle with
the logged commands, over horizons of 0.1 to 2 s.
"""

import argparse
from pathlib import Path

from drake_quad import load_scenario
from drake_quad.command_line.default_outputs import Origin
from drake_quad.command_line.flight_remarks import print_flight_remarks
from drake_quad.command_line.options import (
    add_overrides,
    add_vector,
    check_ranges,
    overrides_from_arguments,
    parser_without_options,
    resolve_output_folder,
)
from drake_quad.command_line.output import print_columns, print_files, print_predictions, remark
from drake_quad.command_line.progress import progress_bar
from drake_quad.errors import join_names
from drake_quad.files import output_folder, write_atomically
from drake_quad.identification.results.vehicle_file import nominal_estimates
from drake_quad.identification.validation.comparison import (
    AXES,
    DEFAULT_REST,
    LogComparison,
    compare_with_log,
    flights_to_compare,
)
from drake_quad.identification.validation.prediction import predict
from drake_quad.logs.reading import read_log
from drake_quad.logs.record import FlightRecord
from drake_quad.reports.results import write_rows
from drake_quad.scenario.batch import median_scenario
from drake_quad.scenario.files.loading import Override, has_control, load_undesigned
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.paths import distributions_in
from drake_quad.statistics.interval import Interval

_MAX_SAMPLES = 10_000  # largest number of simulated flights
# Scenarios need a route to be valid, although the reference of the log replaces it.
_PLACEHOLDER_ROUTE = Override("route={kind: hover, duration: 1.0}", "the route of the log")
_STATISTICS = {"rmse": "RMSE", "mean": "mean", "largest": "95th percentile"}


def options() -> argparse.ArgumentParser:
    result = parser_without_options(
        __doc__, "drake-quad compare-log tests/data/crazyflie/crazyswarm2/log08.xz crazyswarm2:log08 --samples 100"
    )
    result.add_argument("log", metavar="LOG", type=Path, help="flight log, in any format that `read_log` reads")
    result.add_argument(
        "scenario", metavar="SCENARIO", help="FILE or FILE:NAME; the reference of the log replaces its route"
    )
    result.add_argument(
        "--mapping", metavar="FILE", help="YAML file that maps columns to signals, or the name of a shipped mapping"
    )
    result.add_argument("--samples", type=int, default=1000, help="number of simulated flights (default: %(default)s)")
    result.add_argument(
        "--rest",
        type=float,
        default=DEFAULT_REST,
        help="duration of the simulated hover before the log begins, s (default: %(default)s)",
    )
    result.add_argument(
        "--start",
        type=float,
        help="time in the log at which the evaluation of errors begins, s (default: when the reference begins to move)",
    )
    add_overrides(result)
    result.set_defaults(default_output=Path("out/compare_log"))
    result.add_argument(
        "--output", type=Path, metavar="FOLDER", help="output folder (default: out/compare_log/LOG_SCENARIO)"
    )
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    check_ranges(arguments, {"samples": (1, _MAX_SAMPLES), "rest": (0.0, 60.0)})
    record = read_log(arguments.log, arguments.mapping)
    for sentence in record.remarks:
        remark(sentence)
    if not has_control(arguments.scenario):
        predict_in_open_loop(record, arguments)
        return
    scenario = load_scenario(arguments.scenario, [_PLACEHOLDER_ROUTE, *overrides_from_arguments(arguments)])
    print_flight_remarks([scenario])
    log = Origin.of_file(arguments.log)
    folder = output_folder(
        resolve_output_folder(arguments, scenario, name=f"{record.name}_{scenario.name}", others=[log])
    )
    with progress_bar(scenario.name, unit=" flights") as progress:
        comparison = compare_with_log(
            record,
            scenario,
            samples=arguments.samples,
            rest=arguments.rest,
            start=arguments.start,
            progress=progress,
        )
    print_comparison(comparison)
    print_files(save_comparison(comparison, folder, arguments))


def predict_in_open_loop(record: FlightRecord, arguments: argparse.Namespace) -> None:
    """Print the errors of open-loop predictions of a log, for a scenario without a controller."""
    vehicle = load_undesigned(arguments.scenario, overrides_from_arguments(arguments))
    if distributions_in(vehicle):
        remark("the predictions use the medians of the vehicle's random parameters")
    nominal = nominal_estimates(vehicle)
    if nominal and record.rotor_speed_command is None and record.motor_command is None:
        remark(
            f"the logged thrust and torque are converted to rotor commands with `nominal` of {vehicle.name}, which has"
            f" identified values ({join_names(nominal)}); the prediction is correct only if the firmware assumed these"
            " values in the flight; otherwise, use a file that drake-quad identify wrote without --nominal"
        )
    print(f"{vehicle.name} has no controller; RMS errors of its open-loop predictions of {record.name}:")
    print_predictions(predict(record, {vehicle.name: median_scenario(vehicle)}))


def print_comparison(comparison: LogComparison) -> None:
    """Print a table of the measured and predicted position errors, and a sentence that compares their RMSE."""
    time = comparison.time
    print(f"{comparison.record.name}: {len(time):,} samples, from {time[0]:.2f} to {time[-1]:.2f} s of the log")
    print(f"reference: {comparison.reference}")
    print_columns(
        ("error (cm)", "axis", "measured", "predicted median [95 %]", "measured within 95 %"), _rows(comparison)
    )
    if comparison.crashes:
        print(f"{comparison.crashes:,} of {len(comparison.predicted):,} simulated flights crash")
    print(verdict(comparison))


def verdict(comparison: LogComparison) -> str:
    """Return a sentence that compares the measured and the predicted RMSE of the position."""
    logged_rmse = comparison.logged_statistics.rmse[-1]
    predicted = _predicted(comparison, "rmse", -1, unit="cm")
    if not comparison.varies:
        return f"The measured RMSE is {100.0 * logged_rmse:.2f} cm. All simulated flights have an RMSE of {predicted}."
    where, flights = "within" if comparison.within("rmse")[-1] else "outside", len(comparison.predicted)
    return (
        f"The measured RMSE, {100.0 * logged_rmse:.2f} cm, is {where} the 95 % interval of {flights:,} simulated"
        f" flights, whose median is {predicted}."
    )


def save_comparison(comparison: LogComparison, folder: Path, arguments: argparse.Namespace) -> list[Path]:
    """Write table, plot and replay of both flights, and their scenario, and return the paths of the files."""
    # Matplotlib takes half a second to import, so it is imported only when there is something to draw.
    from drake_quad.visualization.log_comparison_plots import plot_log_comparison
    from drake_quad.visualization.replay.page import save_replay
    from drake_quad.visualization.style import save_figures

    rows = []
    for statistic in _STATISTICS:
        median, low, high = comparison.interval(statistic)
        values = {"flown": getattr(comparison.logged_statistics, statistic), "median": median, "low": low, "high": high}
        for i, axis in enumerate(AXES):
            metres = {f"{name} (m)": f"{end[i]:.6g}" for name, end in values.items()}
            rows.append({"error": statistic, "axis": axis, **metres})
    return [
        write_rows(folder / "errors.csv", rows),
        *save_figures({"comparison": plot_log_comparison(comparison)}, folder, vector=arguments.vector),
        save_replay(flights_to_compare(comparison), folder / "replay.html"),
        write_atomically(folder / "scenario.yaml", lambda path: save_scenario(comparison.scenario, path)),
    ]


def _rows(comparison: LogComparison) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for statistic, name in _STATISTICS.items():
        logged, within = getattr(comparison.logged_statistics, statistic), comparison.within(statistic)
        for i, axis in enumerate(AXES):
            position = ("yes" if within[i] else "no") if comparison.varies else "–"
            rows.append((name, axis, f"{100.0 * logged[i]:.2f}", _predicted(comparison, statistic, i), position))
    return rows


def _predicted(comparison: LogComparison, statistic: str, axis: int, *, unit: str = "") -> str:
    """Return a predicted error statistic in cm as text: its median, with a 95 % interval if the flights differ."""
    median, low, high = (float(end[axis]) for end in comparison.interval(statistic))
    interval = Interval(median, low, high)
    return (interval if comparison.varies else interval.without_interval()).text(
        unit=unit, size=0.01, infinities=("-∞", "crash")
    )
