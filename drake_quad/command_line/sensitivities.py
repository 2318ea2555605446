"""Differentiates the metrics of a flight by numbers of its scenario, exactly, through Drake's simulator."""

import argparse
import math
from pathlib import Path

import numpy as np

from drake_quad.command_line.flight_remarks import print_flight_remarks
from drake_quad.command_line.options import add_controller, add_vector, folder_of, parser, scenario_of
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.design.sensitivity import DIFFERENTIABLE, Sensitivities, flight_sensitivities
from drake_quad.files import output_folder, write_table
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import leaves
from drake_quad.visualization.sensitivity_plots import plot_sensitivities
from drake_quad.visualization.style import save_figures

# Default fields of every vehicle; a builder can get each of them wrong.
_FIELDS = (
    *("vehicle.mass", "nominal.mass", "vehicle.thrust_factor", "nominal.thrust_factor"),
    "vehicle.rotor_time_constant",
)
# Fields of the drag, which are default fields where they are not 0.
_DRAG = ("vehicle.linear_drag", "vehicle.quadratic_drag", "vehicle.body_drag", "vehicle.rotor_aerodynamics")
# Gains of a loop on the ground that are default fields.
_GAINS = ("k_p", "k_d")


def default_fields(scenario: Scenario) -> tuple[str, ...]:
    """Return the default fields, with inertia and arms unless the autopilot models the response of the attitude."""
    autopilot, layout = scenario.laboratory.autopilot, scenario.vehicle.layout
    # Gains of 0 are left out, because the diagram may lack their term and then has no derivative with respect to it.
    fields = [
        *_FIELDS,
        *(path for path, value in leaves(scenario) if path.startswith(_DRAG) and value),
        *(
            f"control.{part}.{gain}.{axis}"
            for part in ("position", "velocity")
            for gain in _GAINS
            for axis, value in enumerate(getattr(getattr(scenario.control, part, None), gain, None) or ())
            if value != 0.0
        ),
    ]
    loops = [f"control.attitude.{gain}" for gain in _GAINS]
    if autopilot.controls_attitude:
        numbers = type(autopilot).model_fields
        loops = [f"laboratory.autopilot.{name}" for name in numbers if isinstance(getattr(autopilot, name), tuple)]
    gains = [f"{numbers}.{axis}" for numbers in loops for axis in (0, 1)]
    if autopilot.models_vehicle:
        return (*fields, *gains)
    level = ["arm_length"]
    if layout.has_distances:
        places = [path for path, _ in leaves(layout) if path in ("length", "width") or ".position." in path]
        # The height of a rotor has no effect, so it is left out.
        level = [f"layout.{path}" for path in places if not path.endswith(".2")]
    inertia = [f"{owner}.inertia.{axis}" for owner in ("vehicle", "nominal") for axis in (0, 1)]
    return (*fields, *inertia, *(f"vehicle.{name}" for name in level), *gains)


def options() -> argparse.ArgumentParser:
    """Return the options of the command."""
    result = parser(__doc__, "drake-quad sensitivities laboratory:low_wind --metric rmse_y", output="out/sensitivities")
    result.add_argument("--sample", type=int, help="which sample of the scenario's study to fly, from 0 on")
    result.add_argument(
        "--field", action="append", metavar="PATH", help="of a number of the scenario; can be given several times"
    )
    result.add_argument(
        "--metric", choices=DIFFERENTIABLE, default="rmse", help="that is printed and drawn (default: %(default)s)"
    )
    add_controller(result)
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    """Run the command."""
    scenario = scenario_of(arguments)
    print_flight_remarks([scenario])
    folder = output_folder(folder_of(arguments, scenario.name))
    fields = tuple(dict.fromkeys(arguments.field or default_fields(scenario)))
    found = flight_sensitivities(scenario, fields, sample=arguments.sample)
    figure = plot_sensitivities(found, arguments.metric)
    files = [
        write_sensitivities(folder / "sensitivities.csv", found),
        *save_figures({"sensitivities": figure}, folder, vector=arguments.vector),
    ]
    print_sensitivities(found, arguments.metric)
    print_files(files)


def print_sensitivities(found: Sensitivities, metric: str) -> None:
    """Print the derivatives of a metric by each field, sorted by the effect of a change of 1 %, largest first."""
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


def write_sensitivities(path: Path, found: Sensitivities) -> Path:
    """Write a CSV file with a row of metrics and a row of their derivatives by each field, and return its path."""
    columns: dict[str, list] = {"field": ["(metric)", *found.fields], "value": ["", *found.values]}
    metrics = {name: [value, *found.gradients[name]] for name, value in found.metrics.items()}
    return write_table(path, columns | metrics, digits=9)
