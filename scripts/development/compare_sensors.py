"""Fly one vehicle with different sensors, and compare the errors of its state estimates and of its flights."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from drake_quad.command_line.running import run

import numpy as np

from drake_quad import Flight, load_scenario, simulate_samples
from drake_quad.command_line.options import check_ranges, parser_without_options
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.command_line.progress import new_bar
from drake_quad.files import output_folder, write_table
from drake_quad.visualization.style import save_figures, use_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_CAMERAS = {"position_noise": 0.001, "attitude_noise": 0.002}
_NO_AUTOPILOT_NOISE = {"gyroscope_noise": 0.0, "gyroscope_bias": [0.0, 0.0, 0.0]}
_CALM = {"wind": [], "command_link": {"delay_ticks": 0, "loss_rate": 0.0}, "autopilot": _NO_AUTOPILOT_NOISE}
_IMU = [
    {"kind": "gyroscope", "period": 0.0025, "noise_density": 4.89e-5},
    {"kind": "accelerometer", "period": 0.0025, "noise_density": 6.86e-4},
]
# The route begins at height 0, 1 m above the ground. The noise is that of the scenario `indoor_flow`.
_FLOW_DECK = [
    {"kind": "range_finder", "period": 0.04, "ground": -1.0, "distance_noise": 0.0025},
    {"kind": "optical_flow", "period": 0.01, "ground": -1.0, "max_flow": 7.4, "flow_noise": 0.41},
]
_FILTER: dict[str, Any] = {"kind": "error_state_filter"}
# For each set of sensors, a shipped scenario and the changes to it.
_SENSOR_SETS: dict[str, tuple[str, dict[str, Any]]] = {
    "motion capture alone": ("onboard", {"laboratory": {**_CALM, "motion_capture": _CAMERAS}}),
    "motion capture and IMU": (
        "onboard",
        {
            "laboratory": {
                **_CALM,
                "motion_capture": _CAMERAS,
                "sensors": _IMU,
                "estimator": {**_FILTER, "aiding": {"motion_capture": {}}},
            }
        },
    ),
    "ultra-wideband ranges": ("warehouse_uwb", {}),
    "satellite navigation": ("outdoor_gnss", {"laboratory": {"wind": []}}),
    "optical flow": ("onboard", {"laboratory": {**_CALM, "sensors": [*_IMU, *_FLOW_DECK], "estimator": _FILTER}}),
}


class Errors(NamedTuple):
    """Root-mean-square errors of the flights with a set of sensors.

    Attributes:
        position: error of the estimated position, m.
        velocity: error of the estimated velocity, m/s.
        tilt: error of the estimated roll and pitch, rad.
        yaw: error of the estimated yaw, rad.
        tracking: distance of the vehicle from the reference, m.
    """

    position: float
    velocity: float
    tilt: float
    yaw: float
    tracking: float


def main() -> None:
    options = parser_without_options(__doc__, "python scripts/development/compare_sensors.py --samples 4")
    options.add_argument(
        "--samples", type=int, default=64, help="flights with each set of sensors (default: %(default)s)"
    )
    options.add_argument(
        "--output", type=Path, default=Path("out/compare_sensors"), help="folder (default: %(default)s)"
    )
    arguments = options.parse_args()
    check_ranges(arguments, {"samples": (1, 1000)})
    folder = output_folder(arguments.output)
    flights = {name: fly(name, arguments.samples) for name in new_bar(list(_SENSOR_SETS), desc="flying")}
    errors = {name: errors_of(each) for name, each in flights.items()}
    columns = {name: [getattr(each, name) for each in errors.values()] for name in Errors._fields}
    print_columns(
        ("sensors", "position (cm)", "velocity (cm/s)", "tilt (mrad)", "yaw (mrad)", "tracking (cm)"),
        [
            (name, *(f"{factor * value:.3g}" for factor, value in zip((1e2, 1e2, 1e3, 1e3, 1e2), each, strict=True)))
            for name, each in errors.items()
        ],
    )
    files = [write_table(folder / "compare_sensors.csv", {"sensors": [*errors], **columns}, digits=4)]
    print_files([*files, *save_figures({"compare_sensors": draw(flights)}, folder)])


def fly(name: str, samples: int) -> list[Flight]:
    """Fly samples with a set of sensors."""
    scenario, changes = _SENSOR_SETS[name]
    return simulate_samples(load_scenario(scenario, changes), range(samples))


def estimation_error(flight: Flight) -> np.ndarray:
    """Return the measured minus the true state (12, ticks), with angles in [-π, π]."""
    error = np.array(flight.record("measurement")) - np.array(flight.record("state"))
    error[3:6] = np.arctan2(np.sin(error[3:6]), np.cos(error[3:6]))
    return error


def errors_of(flights: list[Flight]) -> Errors:
    """Return the errors over all flights."""
    error = np.hstack([estimation_error(flight) for flight in flights])
    parts = error[0:3], error[6:9], error[3:5], error[5:6]
    position, velocity, tilt, yaw = (float(np.sqrt(np.square(each).sum(axis=0).mean())) for each in parts)
    tracking = float(np.sqrt(np.mean([flight.metrics.rmse**2 for flight in flights])))
    return Errors(position, velocity, tilt, yaw, tracking)


def draw(flights: dict[str, list[Flight]]) -> "Figure":
    """Plot the median position error and the median tilt error of the flights over time."""
    from drake_quad.visualization.style import new_figure

    with use_style():
        figure = new_figure(7.2, 4.6)
        upper, lower = figure.subplots(2, 1, sharex=True)
        for name, each in flights.items():
            errors = np.array([estimation_error(flight) for flight in each])
            time = np.array(each[0].time)
            for axes, rows, factor in ((upper, slice(0, 3), 1e2), (lower, slice(3, 5), 1e3)):
                axes.plot(time, factor * np.median(np.linalg.norm(errors[:, rows], axis=1), axis=0), lw=1.0, label=name)
        # The estimates start at the true state, so their first errors would extend the logarithmic axes by decades.
        upper.set(ylabel="position error (cm)", yscale="log", ylim=(2e-2, 2e2))
        lower.set(ylabel="tilt error (mrad)", yscale="log", ylim=(5e-2, 2e1), xlabel="time (s)", xlim=(0.0, time[-1]))
        figure.legend(*upper.get_legend_handles_labels(), loc="outside upper left", ncols=3)
        return figure


if __name__ == "__main__":
    run(main)
