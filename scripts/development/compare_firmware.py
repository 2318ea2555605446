"""Fly a racing quadrotor with Betaflight and with controllers of this library, and compare the errors.

All controllers fly the same samples of two scenarios: `robustness`, with the vehicle `racer`, and `upset`, in which the
vehicle starts tilted and tumbling. The gains of all cascades are from the same design. Requires the extra `betaflight`.
"""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from drake_quad.command_line.running import run

import numpy as np

from drake_quad import Flight, load_scenario, simulate_samples
from drake_quad.command_line.options import check_ranges, parser_without_options
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.command_line.progress import new_bar
from drake_quad.files import output_folder, write_table
from drake_quad.statistics.estimates import mean_interval, proportion_interval
from drake_quad.statistics.interval import Interval
from drake_quad.statistics.ratios import ratio_of_means
from drake_quad.studies.processes import Workers
from drake_quad.studies.worker_pool import run_tasks
from drake_quad.visualization.style import save_figures, use_style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BATCH_SIZE = 8  # flights
_ANGLE, _ACRO = "firmware/betaflight:angle", "firmware/betaflight:acro"
# Errors of the gyroscope TDK ICM-42688-P (data sheet DS-000347).
_NOISE_DENSITY, _RESOLUTION = 4.89e-5, 1.0653e-3  # rad/s/√Hz, rad/s
# Betaflight reads one sample of the gyroscope in each period.
_GYROSCOPE: dict[str, Any] = {
    "laboratory": {
        "sensors": [
            {"kind": "gyroscope", "period": 0.00125, "noise_density": _NOISE_DENSITY, "resolution": _RESOLUTION}
        ]
    }
}
_AUTOPILOT_PERIOD = 0.0025  # s
# Loops whose gains `drake-quad design --integral 0.1` finds in the paper's laboratory for the vehicle `racer`: attitude
# and rate loops on board (option --on-board), and a cascade on the ground.
_ON_BOARD: dict[str, Any] = {
    "vehicle": {"time_step": 0.0025},
    "laboratory": {
        "autopilot": {
            "kind": "attitude",
            "period": _AUTOPILOT_PERIOD,
            "k_attitude": [9.021] * 3,
            "k_rate": [19.01] * 3,
            # Standard deviation of white noise and rounding in one sample of the same gyroscope.
            "gyroscope_noise": math.hypot(
                _NOISE_DENSITY * math.sqrt(0.5 / _AUTOPILOT_PERIOD), _RESOLUTION / math.sqrt(12)
            ),
        },
    },
    "control": {
        "network": None,
        "attitude": None,
        "position": {
            "kind": "pid",
            "derivative": "tracking_error",
            "feed_forward": "jerk",
            "k_p": [1.927, 1.927, 5.816],
            "k_d": [1.921, 1.921, 3.383],
            "k_i": [1.031, 1.031, 5.481],
        },
    },
}
_ON_GROUND: dict[str, Any] = {
    "vehicle": {"time_step": 0.0025},
    "control": {
        "network": None,
        "attitude": {"kind": "pd", "k_p": [7.471] * 3, "k_d": [4.052] * 3},
        "position": {
            "kind": "pid",
            "derivative": "tracking_error",
            "feed_forward": "snap",
            "k_p": [0.3136, 0.3136, 6.103],
            "k_d": [0.6866, 0.6866, 3.469],
            "k_i": [0.05998, 0.05998, 5.897],
        },
    },
}
# Settings that pilots discuss, relative to the default settings of Betaflight 4.6.
_LOWER_FILTERS = (
    *("set gyro_lpf1_dyn_min_hz = 125", "set gyro_lpf1_dyn_max_hz = 250", "set gyro_lpf2_static_hz = 250"),
    *("set dterm_lpf1_dyn_min_hz = 37", "set dterm_lpf1_dyn_max_hz = 75", "set dterm_lpf2_static_hz = 75"),
)
_SETTINGS: dict[str, tuple[str, ...]] = {
    "filter cutoffs halved": _LOWER_FILTERS,
    "D gain halved": ("set d_roll = 15", "set d_pitch = 17"),
    "D gain doubled": ("set d_roll = 60", "set d_pitch = 68"),
    "airmode off": ("feature -AIRMODE",),
}
_BASELINE = "Betaflight, angle mode"
# Layers and overrides of each controller.
_CONTROLLERS: dict[str, tuple[list[str], list[dict[str, Any]]]] = {
    _BASELINE: ([_ANGLE], [_GYROSCOPE]),
    "Betaflight, acro mode": ([_ACRO], [_GYROSCOPE]),
    **{
        f"angle mode, {name}": ([_ANGLE], [_GYROSCOPE, {"laboratory": {"autopilot": {"settings": list(lines)}}}])
        for name, lines in _SETTINGS.items()
    },
    "attitude loops on board": ([], [_ON_BOARD]),
    "cascade on the ground": ([], [_ON_GROUND]),
    "LQG on the ground": (["controllers/designed/vehicles:racer"], []),
}
_SCENARIOS = ("robustness", "upset")
_SETTLED_RADIUS = 0.2  # m; a thrown vehicle has recovered when it stays this close to its position
_LAST_SECONDS = 5.0  # s of a flight in which a thrown vehicle must be close to its position


class FlightResult(NamedTuple):
    """Result of a flight, or (N,) results of N flights.

    Attributes:
        rmse: root-mean-square position error, m.
        crashed: 1 if the vehicle crashed, else 0.
        recovered: 1 if the vehicle is close to its reference in the last seconds of the flight, else 0.
        activity: root-mean-square change of the commanded rotor speeds from one control tick to the next, relative to
            the median speed.
    """

    rmse: Any
    crashed: Any
    recovered: Any
    activity: Any

    @classmethod
    def of(cls, flight: Flight) -> "FlightResult":
        """Return the result of a flight."""
        changes = np.diff(flight["rotor_speed_command"], axis=0)
        speed = np.median(flight["rotor_speed_command"])
        last = flight.euclidean_error[flight.time > flight.time[-1] - _LAST_SECONDS]
        recovered = not flight.metrics.crashed and bool(last.max() < _SETTLED_RADIUS)
        return cls(
            flight.metrics.rmse,
            float(flight.metrics.crashed),
            float(recovered),
            float(np.sqrt(np.mean(np.square(changes))) / speed),
        )


class Estimates(NamedTuple):
    """Estimates for a controller, with 95 % intervals.

    Attributes:
        rmse: mean RMSE in `robustness`, m.
        ratio: mean RMSE in `robustness`, relative to Betaflight in angle mode.
        activity: mean activity of the rotors in `robustness`, relative to Betaflight in angle mode.
        crashes: probability of a crash in `robustness`.
        recoveries: probability that the vehicle recovers in `upset`.
    """

    rmse: Interval
    ratio: Interval
    activity: Interval
    crashes: Interval
    recoveries: Interval


Task = tuple[str, str, tuple[int, ...]]
"""Scenario, controller and samples of a batch."""


def main() -> None:
    options = parser_without_options(__doc__, "python scripts/development/compare_firmware.py --samples 8")
    options.add_argument("--samples", type=int, default=64, help="flights of each controller (default: %(default)s)")
    options.add_argument("--processes", type=int, default=2, help="number of worker processes (default: %(default)s)")
    options.add_argument(
        "--output", type=Path, default=Path("out/compare_firmware"), help="folder (default: %(default)s)"
    )
    arguments = options.parse_args()
    check_ranges(arguments, {"samples": (2, 1000), "processes": (1, 256)})
    folder = output_folder(arguments.output)
    tasks = [
        (scenario, name, tuple(range(first, min(first + _BATCH_SIZE, arguments.samples))))
        for scenario in _SCENARIOS
        for name in _CONTROLLERS
        for first in range(0, arguments.samples, _BATCH_SIZE)
    ]
    waiting = iter(tasks)
    flown: dict[Task, list[FlightResult]] = {}
    with Workers(arguments.processes) as workers, new_bar(total=len(tasks), desc="batches of flights") as bar:
        for outcome in run_tasks(workers, fly, lambda: next(waiting, None)):
            if outcome.result is None:
                raise RuntimeError(outcome.reason)
            flown |= outcome.result
            bar.update()
    results = {
        (scenario, name): columns_of([each for task in tasks if task[:2] == (scenario, name) for each in flown[task]])
        for scenario in _SCENARIOS
        for name in _CONTROLLERS
    }
    print_results(results)
    files = [write_table(folder / "compare_firmware.csv", table_of(results), digits=6)]
    print_files([*files, *save_figures({"compare_firmware": draw(results)}, folder)])


def fly(task: Task) -> dict[Task, list[FlightResult]]:
    """Fly samples of a scenario with a controller, and return their results by task."""
    scenario, name, samples = task
    layers, overrides = _CONTROLLERS[name]
    loaded = load_scenario(scenario, overrides, layers=["vehicles/racer", *layers])
    return {task: [FlightResult.of(flight) for flight in simulate_samples(loaded, samples)]}


def columns_of(results: list[FlightResult]) -> FlightResult:
    """Return the results of N flights as (N,) arrays."""
    return FlightResult._make(np.array(column) for column in zip(*results, strict=True))


def estimates_of(results: dict[tuple[str, str], FlightResult], name: str) -> Estimates:
    """Return the estimates for a controller."""
    windy, upset = (results[scenario, name] for scenario in _SCENARIOS)
    baseline = results["robustness", _BASELINE]
    return Estimates(
        mean_interval(windy.rmse),
        ratio_of_means(windy.rmse, baseline.rmse),
        ratio_of_means(windy.activity, baseline.activity),
        proportion_interval(windy.crashed.sum(), len(windy.crashed)),
        proportion_interval(upset.recovered.sum(), len(upset.recovered)),
    )


def print_results(results: dict[tuple[str, str], FlightResult]) -> None:
    """Print the estimates for each controller."""
    rows = []
    for name in _CONTROLLERS:
        each = estimates_of(results, name)
        numbers = each.rmse.text(size=0.01), each.ratio.ratio(), each.activity.ratio()
        rows.append((name, *numbers, each.crashes.percent(), each.recoveries.percent()))
    header = ("controller", "RMSE (cm)", "RMSE, relative", "activity, relative", "crashes (%)", "recoveries (%)")
    print_columns(header, rows)


def table_of(results: dict[tuple[str, str], FlightResult]) -> dict[str, list[Any]]:
    """Return the table of all flights."""
    table: dict[str, list[Any]] = {"scenario": [], "controller": [], "sample": []}
    for (scenario, name), each in results.items():
        count = len(each.rmse)
        table["scenario"] += [scenario] * count
        table["controller"] += [name] * count
        table["sample"] += range(count)
        for field, values in each._asdict().items():
            table.setdefault(field, []).extend(values.tolist())
    return table


def draw(results: dict[tuple[str, str], FlightResult]) -> "Figure":
    """Plot the RMSE in wind and the fraction of recoveries of each controller, with 95 % intervals."""
    from drake_quad.visualization.style import new_figure

    names = list(_CONTROLLERS)
    estimates = [estimates_of(results, name) for name in names]
    with use_style():
        figure = new_figure(7.2, 2.9)
        left, right = figure.subplots(1, 2, sharey=True)
        for axes, field, factor in ((left, "rmse", 1e2), (right, "recoveries", 1e2)):
            values = [getattr(each, field) for each in estimates]
            means = factor * np.array([each[0] for each in values])
            ends = factor * np.array([each[1:] for each in values]).T
            axes.errorbar(means, range(len(names)), xerr=abs(ends - means), fmt="o", ms=4.0, capsize=2.0)
        left.set(xlabel="RMSE in robustness (cm)", xscale="log", yticks=range(len(names)), yticklabels=names)
        left.invert_yaxis()
        right.set(xlabel="recoveries in upset (%)", xlim=(-2.0, 102.0))
        return figure


if __name__ == "__main__":
    run(main)
