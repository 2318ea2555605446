"""Differentiate the metrics of a flight with respect to fields of its scenario.

The derivatives are exact, since automatic differentiation computes them through Drake's simulator.
"""

import argparse
import math
import re
from pathlib import Path

import numpy as np

from drake_quad.command_line.flight_remarks import print_flight_remarks
from drake_quad.command_line.options import (
    add_controller,
    add_vector,
    check_metric,
    parser,
    resolve_output_folder,
    scenario_from_arguments,
)
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.design.sensitivity import Sensitivities, differentiable_metrics, flight_sensitivities
from drake_quad.files import output_folder, write_table
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import leaves
from drake_quad.visualization.sensitivity_plots import plot_sensitivities
from drake_quad.visualization.style import save_figures

# Fields by which metrics are differentiated by default. Every vehicle has these fields, and their values are uncertain
# for a real vehicle.
_COMMON_FIELDS = (
    *("vehicle.mass", "nominal.mass", "vehicle.thrust_factor", "nominal.thrust_factor"),
    "vehicle.rotor_time_constant",
)
# Prefixes of the paths of drag fields. A drag field is a default field if its value is not 0.
_DRAG_FIELDS = ("vehicle.linear_drag", "vehicle.quadratic_drag", "vehicle.body_drag", "vehicle.rotor_aerodynamics")
# Names of the gains of controllers on the ground station. These gains are default fields.
_GAIN_NAMES = ("k_p", "k_d")


def default_fields(scenario: Scenario) -> tuple[str, ...]:
    """Return the scenario fields by which metrics are differentiated by default.

    Inertia and rotor positions are left out if the autopilot models the attitude response, since they then have no
    effect.
    """
    autopilot, layout = scenario.laboratory.autopilot, scenario.vehicle.layout
    # Gains of 0 are left out, because the diagram may omit their terms. It then has no derivative with respect to them.
    fields = [
        *_COMMON_FIELDS,
        *(path for path, value in leaves(scenario) if path.startswith(_DRAG_FIELDS) and value),
        *(
            path
            for part in ("position", "velocity")
            for gain in _GAIN_NAMES
            for path, value in leaves(scenario)
            # A gain is one number in some controllers, and one number per axis in others.
            if re.fullmatch(rf"control\.{part}\.{gain}(\.\d)?", path) and value
        ),
    ]
    loop_gains = [f"control.attitude.{gain}" for gain in _GAIN_NAMES]
    if autopilot.controls_attitude:
        names = type(autopilot).model_fields
        loop_gains = [f"laboratory.autopilot.{name}" for name in names if isinstance(getattr(autopilot, name), tuple)]
    gains = [f"{names}.{axis}" for names in loop_gains for axis in (0, 1)]
    if autopilot.models_vehicle:
        return (*fields, *gains)
    geometry_fields = ["arm_length"]
    if layout.has_distances:
        paths = [path for path, _ in leaves(layout) if path in ("length", "width") or ".position." in path]
        # The height of a rotor, the third coordinate, has no effect, so it is left out.
        geometry_fields = [f"layout.{path}" for path in paths if not path.endswith(".2")]
    inertia = [f"{owner}.inertia.{axis}" for owner in ("vehicle", "nominal") for axis in (0, 1)]
    return (*fields, *inertia, *(f"vehicle.{name}" for name in geometry_fields), *gains)


def options() -> argparse.ArgumentParser:
    result = parser(__doc__, "drake-quad sensitivities laboratory:low_wind --metric rmse_y", output="out/sensitivities")
    result.add_argument("--sample", type=int, help="number of the sample to fly; 0 is the first sample of a study")
    result.add_argument(
        "--field",
        action="append",
        metavar="PATH",
        help="field of the scenario; can be given several times (default: uncertain parameters and gains)",
    )
    result.add_argument(
        "--metric", metavar="NAME", default="rmse", help="metric to print and plot (default: %(default)s)"
    )
    add_controller(result)
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    scenario = scenario_from_arguments(arguments)
    check_metric(scenario, arguments.metric, differentiable_metrics(scenario))
    print_flight_remarks([scenario])
    folder = output_folder(resolve_output_folder(arguments, scenario))
    fields = tuple(dict.fromkeys(arguments.field or default_fields(scenario)))
    sensitivities = flight_sensitivities(scenario, fields, sample=arguments.sample)
    figure = plot_sensitivities(sensitivities, arguments.metric)
    files = [
        write_sensitivities(folder / "sensitivities.csv", sensitivities),
        *save_figures({"sensitivities": figure}, folder, vector=arguments.vector),
    ]
    print_sensitivities(sensitivities, arguments.metric)
    print_files(files)


def print_sensitivities(sensitivities: Sensitivities, metric: str) -> None:
    """Print the derivative of a metric with respect to each field, sorted by the effect of a 1 % change."""
    if sensitivities.crash_time < math.inf:
        print(f"crashed at {sensitivities.crash_time:.2f} s; metrics and derivatives refer to the flight until then")
    print(f"{metric} {sensitivities.metrics[metric]:.6g} (SI units)")
    if not abs(sensitivities.metrics[metric]) > 0.0 or np.isnan(sensitivities.gradients[metric]).all():
        print(f"{metric} has no derivative, because it is zero in this flight")
        return
    effects = sensitivities.values * sensitivities.gradients[metric] / (sensitivities.metrics[metric] or math.nan)
    rows = [
        (
            sensitivities.fields[i],
            f"{sensitivities.values[i]:.4g}",
            f"{sensitivities.gradients[metric][i]:.5g}",
            f"{effects[i]:+.3f} %" if sensitivities.values[i] and math.isfinite(effects[i]) else "–",
            "",
        )
        for i in np.argsort(-np.abs(effects))
    ]
    print_columns(("field", "value", "derivative", "change for +1 %", ""), rows)


def write_sensitivities(path: Path, sensitivities: Sensitivities) -> Path:
    """Write a CSV file with a row of metrics, and a row of derivatives for each field, and return its path."""
    columns: dict[str, list] = {"field": ["(metric)", *sensitivities.fields], "value": ["", *sensitivities.values]}
    metrics = {name: [value, *sensitivities.gradients[name]] for name, value in sensitivities.metrics.items()}
    return write_table(path, columns | metrics, digits=9)
