"""Run the error-state Kalman filter on logged flights, and compare it with the filter that flew on board.

The argument is the folder of the NanoBench data set (S. I. Ullah, J. Baca, arXiv 2603.09908; BSD-3). The filter reads
gyroscope and accelerometer of the logs, and every n-th position of motion capture. The table lists root-mean-square
errors of both filters against motion capture while the vehicle flies.

The logs contain the inertial sensors as they arrived over the radio, at 75 to 84 Hz and late, and so they contain the
estimate of the filter on board. The lag of either is estimated and removed: the lag of the gyroscope by its correlation
with the rotation of motion capture, and the lag of the estimate as the one with the smallest error of the position.
"""

from pathlib import Path
from typing import NamedTuple

from drake_quad.command_line.running import run

import numpy as np

from drake_quad.command_line.options import bare_parser
from drake_quad.command_line.output import print_columns
from drake_quad.errors import InputError
from drake_quad.estimation.corrections import PositionAiding
from drake_quad.estimation.covariance import InertialNoise
from drake_quad.estimation.error_state_filter import Aiding, AidingParameters, ErrorStateKalmanFilter, FilterParameters
from drake_quad.identification.logs.attitudes import rotation_matrices
from drake_quad.identification.logs.reading import read_log
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.signals import EstimateDeviation

_PERIOD = 0.01  # s, period of the table in a log
# White noise of the filter in the Crazyflie's firmware: 0.5 m/s² (procNoiseAcc_xy) and 0.1 rad/s
# (measNoiseGyro_rollpitch), constant over each prediction of 0.01 s. The firmware estimates no biases of these sensors;
# the random walks of the biases, the limit and the initial deviations are rough choices, not fitted.
_NOISE = InertialNoise(0.01, 0.05, 1e-4, 1e-3)
_POSITION = PositionAiding(0.01, 0.01, 0.01)  # m, extPosStdDev of the firmware
_INNOVATION_LIMIT = 25.0
_MAX_REJECTION_TIME = 0.1  # s, after which rejected positions are used; it is chosen for these flights
# Initial deviations: the position is unknown, and the vehicle rests with a known yaw.
_INITIAL = EstimateDeviation(*[10.0] * 3, *[0.1] * 3, *[0.05] * 3, *[0.01] * 3, *[0.2] * 3)
_MIN_HEIGHT = 0.1  # m, height above the start at which the vehicle counts as flying
_MAX_LAG = 0.1  # s
_LAG_STEP = 0.002  # s


class Errors(NamedTuple):
    """Root-mean-square errors in flight.

    Attributes:
        position: error of the position, m.
        velocity: error of the velocity, m/s.
    """

    position: float
    velocity: float


class Table(NamedTuple):
    """Signals of a flight at a constant period; arrays have the shape (n, 3)."""

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    attitude: np.ndarray
    body_rates: np.ndarray
    specific_force: np.ndarray


def resampled(record: FlightRecord, time: np.ndarray) -> Table:
    """Return the signals of a record at given times, s; angles are not interpolated across ±π."""
    arrays = (record.position, record.velocity, record.attitude, record.body_rates, record.specific_force)
    columns = []
    for array in arrays:
        assert array is not None
        columns.append(np.stack([np.interp(time, record.time, column) for column in array.T], axis=1))
    return Table(time, *columns)


def gyroscope_lag(table: Table) -> float:
    """Return the lag (s) of the gyroscope behind the rotation of motion capture, by correlation."""
    rotations = rotation_matrices(table.attitude)
    rates = (rotations[:-2].inv() * rotations[2:]).as_rotvec() / (2.0 * _PERIOD)
    lags = np.arange(-_MAX_LAG, _MAX_LAG, _LAG_STEP)
    times = table.time[1:-1]
    errors = [np.square(rates - _shifted(times + lag, table.time, table.body_rates)).mean() for lag in lags]
    return float(lags[int(np.argmin(errors))])


def _shifted(times: np.ndarray, clock: np.ndarray, values: np.ndarray) -> np.ndarray:
    return np.stack([np.interp(times, clock, column) for column in values.T], axis=1)


def errors_of(table: Table, position: np.ndarray, velocity: np.ndarray) -> Errors:
    """Return the errors of an estimate, which are arrays (n, 3), while the vehicle flies."""
    flies = table.position[:, 2] > table.position[0, 2] + _MIN_HEIGHT
    squares = (np.square(each[flies]).sum(axis=1) for each in (position - table.position, velocity - table.velocity))
    return Errors(*(float(np.sqrt(each.mean())) for each in squares))


def estimated_errors(table: Table, samples: int, lag: float) -> Errors:
    """Return the errors of the filter.

    Args:
        table: signals of the flight.
        samples: period of the positions, a whole number of samples.
        lag: lag of the inertial sensors, s.
    """
    aiding = AidingParameters(_POSITION, _INNOVATION_LIMIT, max(1.0, _MAX_REJECTION_TIME / (samples * _PERIOD)))
    system = ErrorStateKalmanFilter(
        aiding=(Aiding("position", "position", samples),),
        period=_PERIOD,
        block_samples=samples,
        parameters=FilterParameters(_NOISE, _INITIAL, (aiding,), initial_yaw=float(table.attitude[0, 2])),
    )
    context = system.CreateDefaultContext()
    # A reading acts until the next sample, so it is taken in the middle.
    middle = table.time + 0.5 * _PERIOD + lag
    gyroscope, accelerometer = (_shifted(middle, table.time, each) for each in (table.body_rates, table.specific_force))
    states = [np.hstack([table.position[0], np.zeros(9)])]
    for k in range(len(table.time) - 1):
        for name, values in (("gyroscope", gyroscope), ("accelerometer", accelerometer), ("position", table.position)):
            system.GetInputPort(name).FixValue(context, values[k])
        context.SetTime((k + 1) * _PERIOD)
        context.SetDiscreteState(system.EvalUniquePeriodicDiscreteUpdate(context).Clone())
        states.append(system.GetOutputPort("measurement").Eval(context))
    return errors_of(table, np.array(states)[:, 0:3], np.array(states)[:, 6:9])


def on_board(record: FlightRecord, table: Table) -> tuple[Errors, float]:
    """Return the errors of the filter on board without the lag of the log, and this lag, s."""
    assert record.position is not None
    assert record.velocity is not None
    errors = {}
    for lag in np.arange(0.0, _MAX_LAG, _LAG_STEP):
        position, velocity = (
            _shifted(table.time + lag, record.time, each) for each in (record.position, record.velocity)
        )
        errors[float(lag)] = errors_of(table, position, velocity)
    best = min(errors, key=lambda lag: errors[lag].position)
    return errors[best], best


def main() -> None:
    parser = bare_parser(__doc__, "python scripts/development/check_estimator.py nanobench --samples 1 10")
    parser.add_argument("folder", type=Path, help="folder of the NanoBench data set")
    parser.add_argument(
        "--samples",
        type=int,
        nargs="+",
        default=[1, 10],
        metavar="COUNT",
        help="periods of the positions in samples of 10 ms (default: 1 10)",
    )
    arguments = parser.parse_args()
    paths = sorted(arguments.folder.glob("*.csv.xz"))
    if not paths:
        raise InputError(f"{arguments.folder} contains no logs (*.csv.xz)")
    if min(arguments.samples) < 1:
        raise InputError(f"--samples {min(arguments.samples)}: a period is at least 1 sample")
    rows = []
    for path in paths:
        record = read_log(path, "nanobench")
        table = resampled(record, np.arange(record.time[0], record.time[-1], _PERIOD))
        lag = gyroscope_lag(table)
        board, board_lag = on_board(read_log(path, "nanobench_onboard"), table)
        row = [path.name.removesuffix(".csv.xz"), f"{1e3 * lag:.0f}", f"{1e3 * board_lag:.0f}"]
        for errors in (board, *(estimated_errors(table, samples, lag) for samples in arguments.samples)):
            row += [f"{1e3 * errors.position:.1f}", f"{1e2 * errors.velocity:.1f}"]
        rows.append(row)
    filters = ["on board", *(f"{100.0 / samples:.3g} Hz" for samples in arguments.samples)]
    units = [f"{name}, {unit}" for name in filters for unit in ("mm", "cm/s")]
    print_columns(["flight", "IMU lag, ms", "estimate lag, ms", *units], rows)


if __name__ == "__main__":
    run(main)
