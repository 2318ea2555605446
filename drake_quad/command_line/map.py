"""Map the stability and the errors of a loop over its two gains, or flights over two other fields of the scenario.

A map of gains shows the stability of the linear model, and the errors of simulated flights, for the scenario and for a
worst case with larger lag and delay. If the autopilot has the kind `attitude`, the gains of the attitude loop are the
autopilot's k_attitude and k_rate. With the option --vary, the command maps flights over two fields instead, such as
components of the initial attitude, and shows which flights crash or violate a requirement. All other random parameters
then have their median values.
"""

import argparse
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import get_args

import numpy as np

from drake_quad import InputError, Scenario
from drake_quad.command_line.flight_remarks import print_flight_remarks
from drake_quad.command_line.options import (
    add_controller,
    add_vector,
    add_wired,
    check_metric,
    check_ranges,
    controlled_scenarios,
    parse_overrides,
    parser,
    resolve_output_folder,
    scenario_from_arguments,
)
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.design.field_map import FieldMap, field_map
from drake_quad.design.stability_map import Loop, MappedGains, linear_map, mapped_gains, simulated_map
from drake_quad.files import output_folder, write_table
from drake_quad.scenario.batch import draw_sample
from drake_quad.scenario.description import unit_at
from drake_quad.scenario.paths import value_at
from drake_quad.visualization.field_map_plots import plot_field_maps
from drake_quad.visualization.map_plots import MapPanel, plot_map
from drake_quad.visualization.names import short_name
from drake_quad.visualization.style import save_figures

_MIN_GAIN_RATIO = 0.05  # smallest gain of a map, relative to the gain of the scenario
_MAX_GAIN_RATIO = 3.0  # largest gain of a map, relative to the gain of the scenario
# Factor on the time constant of the rotors in the default worst case.
_WORST_LAG_FACTOR = 1.4
# Additional delay of the command link in the default worst case, ticks.
_WORST_EXTRA_TICKS = 1


def options() -> argparse.ArgumentParser:
    result = parser(__doc__, "drake-quad map laboratory:nominal --loop attitude", output="out/stability")
    result.add_argument("--loop", choices=get_args(Loop), help="loop whose gains are mapped (default: position)")
    result.add_argument("--size", type=int, help="number of gains along each side of the map (default: 40)")
    for flags, help_text in (
        (
            ("--k-p", "--k-attitude"),
            "range of k_P, 1/s², or of k_attitude, 1/s (default: around the value of the scenario)",
        ),
        (("--k-d", "--k-rate"), "range of k_D or k_rate, 1/s (default: around the value of the scenario)"),
    ):
        result.add_argument(*flags, type=float, nargs=2, metavar=("MIN", "MAX"), help=help_text)
    result.add_argument(
        "--worst",
        metavar="FIELD=VALUE",
        action="append",
        help="value of a field of vehicle or laboratory in the worst case; can be given several times (default: rotor"
        f" time constant × {_WORST_LAG_FACTOR:g}, and an additional delay of one tick)",
    )
    result.add_argument(
        "--vary",
        nargs=3,
        action="append",
        metavar=("FIELD", "MIN", "MAX"),
        help="map the flights over this field in place of gains, as in 'initial.attitude.0 -3 3'; must be given twice,"
        " first for the horizontal axis",
    )
    result.add_argument(
        "--metric", metavar="NAME", default="rmse", help="metric of the flights with --vary (default: %(default)s)"
    )
    result.add_argument("--quick", action="store_true", help="map 12 by 12 flights of 5 s, as a quick test")
    add_controller(result, several="can be given several times with --vary, for a panel each")
    add_wired(result)
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    check_ranges(arguments, {"size": (2, 200)})
    arguments.size = arguments.size or (12 if arguments.quick else 40)
    if arguments.quick:
        arguments.set = ["duration=5", *arguments.set]
    if arguments.vary:
        map_fields(arguments)
    else:
        map_gains(arguments)


def map_fields(arguments: argparse.Namespace) -> None:
    """Map the flights over two fields of the scenario, for each controller."""
    for option in ("loop", "k_p", "k_d", "worst"):
        if getattr(arguments, option) is not None:
            raise InputError(f"--{option.replace('_', '-')} is an option of maps of gains; leave it out with --vary")
    if len(arguments.vary) != 2:
        raise InputError(f"--vary is given {len(arguments.vary)} times, but a map has two axes; give it twice")
    ranges = [f"{path}={{uniform: {{min: {low}, max: {high}}}}}" for path, low, high in arguments.vary]
    (x, *_), (y, *_) = arguments.vary
    arguments.set = [*arguments.set, *ranges]
    scenarios = controlled_scenarios(arguments)
    scenario = next(iter(scenarios.values()))
    print_flight_remarks(scenarios.values())
    check_metric(scenario, arguments.metric)
    folder = output_folder(resolve_output_folder(arguments, scenario))
    maps = {}
    for name, each in scenarios.items():
        maps[name] = field_map(each, x, y, size=arguments.size, compiled=not arguments.wired)
    units = unit_at(scenario, x), unit_at(scenario, y)
    figure = plot_field_maps(maps, arguments.metric, labels=(short_name(x), short_name(y)), units=units)
    columns = [name for name in scenario.requirements if name != arguments.metric]
    files = [
        write_field_maps(folder / "field_map.csv", maps, [arguments.metric, *columns, "crash_time"], (x, y)),
        *save_figures({"field_map": figure}, folder, vector=arguments.vector),
    ]
    rows = [
        (name, *(f"{int(np.sum(mask)):,} of {mask.size:,}" for mask in (each.satisfied, each.metrics.crashed)))
        for name, each in maps.items()
    ]
    print_columns(("controller", "no crash, no violated requirement", "crashed"), rows)
    print_files(files)


def write_field_maps(path: Path, maps: Mapping[str, FieldMap], columns: Sequence[str], fields: tuple[str, str]) -> Path:
    """Write a CSV file with a row for each cell of the maps, and return its path.

    Args:
        path: path of the file.
        maps: map of each controller, by its name.
        columns: names of the metrics to write, or `crash_time`.
        fields: paths of the fields on the horizontal and on the vertical axis.
    """
    first = next(iter(maps.values()))
    x, y = np.meshgrid(first.x, first.y)
    table = {fields[0]: x.ravel(), fields[1]: y.ravel()}
    for name, each in maps.items():
        table |= {f"{name}: {column}": getattr(each.metrics, column).ravel() for column in columns}
    return write_table(path, table, digits=6)


def map_gains(arguments: argparse.Namespace) -> None:
    """Map the gains of a loop of the scenario."""
    if len(arguments.controller) > 1:
        raise InputError("a map of gains has one controller; give --controller once, or map other fields by --vary")
    arguments.controller = arguments.controller[0] if arguments.controller else None
    arguments.loop = arguments.loop or "position"
    size = arguments.size
    scenario = scenario_from_arguments(arguments)
    print_flight_remarks([scenario])
    gains = mapped_gains(scenario, arguments.loop)
    axis = 0 if arguments.loop == "position" else 1
    first, second = (float(value_at(scenario, f"{gains.block}.{name}.{axis}")) for name in gains.fields)
    k_p = _grid("--k-p", arguments.k_p or (_MIN_GAIN_RATIO * first, _MAX_GAIN_RATIO * first), size)
    k_d = _grid("--k-d", arguments.k_d or (_MIN_GAIN_RATIO * second, _MAX_GAIN_RATIO * second), size)
    worst = arguments.worst or _default_worst_case(scenario)
    names = [field.split("=")[0].split(".")[-1] + "=" + field.split("=", 1)[-1] for field in worst]
    cases = {"nominal": scenario, ", ".join(names): _worst_case(arguments, worst)}
    folder = output_folder(resolve_output_folder(arguments, scenario))
    compiled = not arguments.wired
    panels = [panel(title, case, arguments.loop, k_p, k_d, compiled=compiled) for title, case in cases.items()]
    figure = plot_map(panels, k_p, k_d, labels=gains.labels, marked=(first, second), loop=arguments.loop)
    files = [
        write_map(folder / f"{arguments.loop}_map.csv", panels, gains, k_p, k_d),
        *save_figures({f"{arguments.loop}_map": figure}, folder, vector=arguments.vector),
    ]
    for each in panels:
        print_panel(each, gains, k_p, k_d)
    print_files(files)


def _default_worst_case(scenario: Scenario) -> list[str]:
    """Return the assignments of the default worst case."""
    drawn = draw_sample(scenario, scenario.sample or 0)
    lag, delay = drawn.vehicle.rotor_time_constant, drawn.laboratory.command_link.delay_ticks
    return [
        f"vehicle.rotor_time_constant={_WORST_LAG_FACTOR * lag:.4g}",
        f"laboratory.command_link.delay_ticks={min(delay + _WORST_EXTRA_TICKS, 50):g}",
    ]


def _worst_case(arguments: argparse.Namespace, worst: list[str]) -> Scenario:
    """Return the scenario with the assignments of the worst case."""
    for field in worst:
        if not field.startswith(("vehicle.", "laboratory.")):
            raise InputError(
                f"--worst {field} must change a field of vehicle or laboratory; use --set for other fields"
            )
    return scenario_from_arguments(arguments, extra_overrides=parse_overrides(worst, "--worst"))


def panel(title: str, scenario: Scenario, loop: Loop, k_p: np.ndarray, k_d: np.ndarray, *, compiled: bool) -> MapPanel:
    """Return the map of the gains for one scenario, from its linear model and from simulated flights."""
    linear = linear_map(scenario, loop, k_p, k_d)
    simulated = simulated_map(scenario, loop, k_p, k_d, sample=scenario.sample or 0, compiled=compiled)
    return MapPanel(title, linear, simulated)


def print_panel(panel: MapPanel, gains: MappedGains, k_p: np.ndarray, k_d: np.ndarray) -> None:
    """Print the fraction of stable gains, the fraction of gains without a crash, and the best pair of gains."""
    rmse = np.where(panel.simulated.crashed | ~panel.linear.stable, np.inf, panel.simulated.rmse)
    row, column = np.unravel_index(np.argmin(rmse), rmse.shape)
    best = "all flights with stable gains crashed"
    if np.isfinite(rmse[row, column]):
        first, second = gains.symbols
        best = (
            f"smallest RMSE with stable gains: {100.0 * rmse[row, column]:.2f} cm at {first} = {k_p[row]:.3g},"
            f" {second} = {k_d[column]:.3g}"
        )
    print(
        f"{panel.title}: {100.0 * panel.linear.stable.mean():.0f} % of the gains are stable,"
        f" {100.0 * (~panel.simulated.crashed).mean():.0f} % do not crash; {best}"
    )


def write_map(path: Path, panels: list[MapPanel], gains: MappedGains, k_p: np.ndarray, k_d: np.ndarray) -> Path:
    """Write a CSV file with a row for each pair of gains, and return its path."""
    rows, columns = np.meshgrid(k_p, k_d, indexing="ij")
    table = dict(zip(gains.labels, (rows.ravel(), columns.ravel()), strict=True))
    for title, linear, simulated in panels:
        table |= {
            f"{title}: stable": linear.stable.ravel().astype(int),
            f"{title}: damping": linear.damping.ravel(),
            f"{title}: delay margin (s)": linear.delay.ravel(),
            f"{title}: RMSE (m)": np.ravel(simulated.rmse),
            f"{title}: crash time (s)": np.ravel(simulated.crash_time),
        }
    return write_table(path, table, digits=6)


def _grid(name: str, limits: tuple[float, float], size: int) -> np.ndarray:
    minimum, maximum = limits
    if not 0.0 <= minimum < maximum < math.inf:
        raise InputError(
            f"{name} {minimum:g} {maximum:g}: the first gain must be at least 0, and the second must be larger than it"
        )
    return np.linspace(minimum, maximum, size)
