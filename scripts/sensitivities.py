"""How the metrics of a flight change with the numbers of its scenario, by derivatives carried through the simulator."""

import csv
import math
from pathlib import Path

from command_line import add_vector, folder_of, parser, print_columns, print_files, run, scenario_of

import numpy as np

from drake_quad.analysis.sensitivity import DIFFERENTIABLE, Sensitivities, flight_sensitivities
from drake_quad.files import output_folder, write_whole
from drake_quad.visualization.sensitivity_plots import plot_sensitivities
from drake_quad.visualization.style import save_figures

# Differentiated unless others are asked for: what a builder can get wrong, and what a designer can choose.
_FIELDS = (
    *("vehicle.mass", "vehicle.inertia.0", "vehicle.inertia.1", "vehicle.thrust_factor", "vehicle.arm_length"),
    *("vehicle.rotor_time_constant", "vehicle.linear_drag"),
    *(f"control.position.{gain}.{axis}" for gain in ("k_p", "k_d") for axis in (0, 1, 2)),
    *(f"control.attitude.{gain}.{axis}" for gain in ("k_p", "k_d") for axis in (0, 1)),
)


def main() -> None:
    options = parser(
        description=__doc__,
        example="python scripts/sensitivities.py diagrams/laboratory.yaml:low_wind --metric rmse_y",
        output="out/sensitivities",
        scenario="figure_eight.yaml",
    )
    options.add_argument("--sample", type=int, help="which sample of the scenario's study to fly, from 0 on")
    options.add_argument(
        "--field", action="append", metavar="PATH", help="of a number of the scenario; can be given several times"
    )
    options.add_argument(
        "--metric", choices=DIFFERENTIABLE, default="rmse", help="that is printed and drawn (default: %(default)s)"
    )
    add_vector(options)
    arguments = options.parse_args()
    scenario = scenario_of(arguments)
    folder = output_folder(folder_of(arguments, scenario.name))
    fields = tuple(dict.fromkeys(arguments.field or _FIELDS))
    found = flight_sensitivities(scenario, fields, sample=arguments.sample)
    figure = plot_sensitivities(found, arguments.metric)
    files = [
        write_whole(folder / "sensitivities.csv", lambda path: write_table(path, found)),
        *save_figures({"sensitivities": figure}, folder, vector=arguments.vector),
    ]
    print_sensitivities(found, arguments.metric)
    print_files(files)


def print_sensitivities(found: Sensitivities, metric: str) -> None:
    """Prints each field with the derivative of a metric, the largest effect of a change of 1 % first."""
    if found.crash_time < math.inf:
        print(f"crashed at {found.crash_time:.2f} s; metrics and derivatives are those of the flight until then")
    print(f"{metric} {found.metrics[metric]:.6g} (SI units)")
    if not found.metrics[metric] > 0.0 or np.isnan(found.gradients[metric]).all():
        print(f"{metric} is zero, where it has no derivative")
        return
    effects = found.values * found.gradients[metric] / (found.metrics[metric] or math.nan)
    rows = [
        (
            found.fields[i],
            f"{found.values[i]:.4g}",
            f"{found.gradients[metric][i]:.5g}",
            f"{effects[i]:+.3f} %" if found.values[i] and math.isfinite(effects[i]) else "–",
            "",
        )
        for i in np.argsort(-np.abs(effects))
    ]
    print_columns(("field", "value", "derivative", "change for +1 %", ""), rows)


def write_table(path: Path, found: Sensitivities) -> None:
    """Writes a line for each field, with the derivatives of all metrics."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["field", "value", *found.metrics])
        writer.writerow(["(metric)", "", *(f"{value:.9g}" for value in found.metrics.values())])
        for i, field in enumerate(found.fields):
            writer.writerow([field, f"{found.values[i]:.9g}", *(f"{row[i]:.9g}" for row in found.gradients.values())])


if __name__ == "__main__":
    run(main)
