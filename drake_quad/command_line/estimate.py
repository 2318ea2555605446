"""Run an error-state Kalman filter on the inertial sensors and positions of flight logs.

Position and attitude of a log are taken as ground truth. The filter integrates the gyroscope and the accelerometer, and
is corrected by every n-th position. The command prints the root-mean-square errors of the filter in flight, and plots
its errors over time. If a log also contains the estimate that was computed on board, the option --on-board adds the
errors of this estimate.

The command also prints noise density and bias of the inertial sensors, and saves them as a scenario that others can
extend. The noise includes vibration and fast motion of the vehicle.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from drake_quad.command_line.options import add_vector, check_ranges, parser_without_options
from drake_quad.command_line.output import print_columns, print_files, remark
from drake_quad.errors import InputError
from drake_quad.files import output_folder, write_atomically
from drake_quad.identification.inertial_errors import InertialErrors, inertial_errors
from drake_quad.identification.logged_estimate import (
    CRAZYFLIE_ATTITUDE_NOISE,
    CRAZYFLIE_POSITION_NOISE,
    EstimateErrors,
    LoggedEstimate,
    errors_on_board,
    estimate_logged_flight,
)
from drake_quad.logs.reading import read_log
from drake_quad.statistics.interval import plus_minus

# Smallest and largest value of each option: a number of samples, and standard deviations in m and rad.
_OPTION_RANGES = {"skip": (0, 1000), "position_noise": (1e-6, 10.0), "attitude_noise": (1e-6, 1.0)}
# Names of the errors in the table, with their factors and units.
_COLUMNS = (("position", 1e3, "mm"), ("velocity", 1e2, "cm/s"), ("tilt", 1e3, "mrad"), ("yaw", 1e3, "mrad"))
_HEADER = ("log", "filter", *(f"{name} ({unit})" for name, _, unit in _COLUMNS), "lag removed (ms)")
_SENSOR_HEADER = ("log", "sensor", "noise density", "bias at the end")
_MAX_SQUARED_INNOVATION = 2.0  # mean above which a filter is inconsistent; the expected value is 1


def options() -> argparse.ArgumentParser:
    result = parser_without_options(__doc__, "drake-quad estimate flight.csv --skip 9 --on-board nanobench_onboard")
    result.add_argument("log", nargs="+", type=Path, help="flight logs")
    result.add_argument("--mapping", help="YAML file that maps columns to signals, or the name of a shipped mapping")
    result.add_argument(
        "--on-board", metavar="MAPPING", help="mapping that reads the on-board estimate as position and attitude"
    )
    result.add_argument(
        "--skip",
        type=int,
        default=0,
        metavar="COUNT",
        help="number of positions to skip after each position that the filter uses (default: %(default)s)",
    )
    result.add_argument(
        "--position-noise",
        type=float,
        default=CRAZYFLIE_POSITION_NOISE,
        metavar="METRES",
        help="standard deviation that the filter assumes for a position on each axis (default: %(default)s, from the"
        " firmware of the Crazyflie)",
    )
    result.add_argument(
        "--attitude-noise",
        type=float,
        metavar="RADIANS",
        nargs="?",
        const=CRAZYFLIE_ATTITUDE_NOISE,
        help="use the attitude at the time of each position, with this assumed standard deviation (default without a"
        " number: %(const)s, from the firmware of the Crazyflie)",
    )
    result.add_argument(
        "--output", type=Path, default=Path("out/estimate"), help="output folder (default: out/estimate)"
    )
    add_vector(result)
    return result


def main(arguments: argparse.Namespace) -> None:
    check_ranges(arguments, _OPTION_RANGES)
    folder = output_folder(arguments.output)
    # Matplotlib takes half a second to import, so it is imported after the options have been checked.
    from drake_quad.visualization.estimate_plots import plot_estimate
    from drake_quad.visualization.style import save_figures

    rows, sensor_rows, figures, files = [], [], {}, []
    for path in arguments.log:
        name = path.name.partition(".")[0]
        if name in figures:
            raise InputError(f"two of the logs are called {name}; run the command once for each of them")
        record = read_log(path, arguments.mapping)
        estimate = estimate_logged_flight(
            record,
            num_skipped=arguments.skip,
            position_noise=arguments.position_noise,
            attitude_noise=arguments.attitude_noise,
        )
        used = "positions" if arguments.attitude_noise is None else "poses"
        rate = 1.0 / (estimate.period * (1 + arguments.skip))
        rows.append(_row(name, f"{used} at {rate:.3g} Hz", estimate.errors, estimate.is_flying, estimate.lag))
        on_board = None
        if arguments.on_board is not None:
            on_board, is_flying, lag = errors_on_board(record, read_log(path, arguments.on_board))
            rows.append(_row(name, "on board", on_board, is_flying, lag))
        _remark_inconsistency(name, estimate)
        figures[name] = plot_estimate(estimate, on_board)
        try:
            sensors = inertial_errors(record, estimate)
        except InputError as error:
            remark(str(error))
        else:
            sensor_rows += [row for sensor in sensors for row in _sensor_rows(name, sensor)]
            files.append(write_sensors(folder / f"{name}_sensors.yaml", name, sensors))
    print("root-mean-square errors in flight")
    print_columns(_HEADER, rows)
    if sensor_rows:
        print("\ninertial sensors in flight, with 95 % intervals")
        print_columns(_SENSOR_HEADER, sensor_rows)
    print_files([*save_figures(figures, folder, vector=arguments.vector), *files])


def _sensor_rows(name: str, sensor: InertialErrors) -> list[tuple[str, ...]]:
    return [
        (name, f"{sensor.kind} {axis}", f"{plus_minus(density.value, density.half_width)} {density.unit}",
         f"{plus_minus(bias.value, bias.half_width)} {bias.unit}")
        for axis, density, bias in zip("xyz", sensor.noise_density, sensor.bias, strict=True)
    ]  # fmt: skip


def write_sensors(path: Path, name: str, sensors: Sequence[InertialErrors]) -> Path:
    """Write the inertial sensors of a log as a scenario with the name of the log, and return the path."""
    from ruamel.yaml import YAML

    scenario = {name: {"laboratory": {"sensors": [each.settings() for each in sensors]}}}
    return write_atomically(path, lambda file: YAML().dump(scenario, file))


def _row(name: str, label: str, errors: EstimateErrors, is_flying: np.ndarray, lag: float) -> tuple[str, ...]:
    values = zip(errors.root_mean_squares(is_flying), _COLUMNS, strict=True)
    return name, label, *(f"{factor * value:.3g}" for value, (_, factor, _) in values), f"{1e3 * lag:.0f}"


def _remark_inconsistency(name: str, estimate: LoggedEstimate) -> None:
    """Remark that the innovations are larger than the filter expects."""
    size = estimate.mean_squared_innovation
    if size > _MAX_SQUARED_INNOVATION:
        remark(
            f"{name}: the squared innovations are {size:.1f} times as large as the filter expects, so its standard"
            " deviations are too small, for example because the clocks of the sensors differ"
        )
