"""Identify the Crazyflie of the NanoBench flights, and write it with its firmware to diagrams/nanobench.yaml.

The argument is the folder of the NanoBench data set (S. I. Ullah, J. Baca, arXiv 2603.09908; BSD-3). The script uses
the slow and medium flights, but not their tracking errors. The fast flights are left out, so that predictions can be
tested on them. `identify` estimates inertia, lag and centre of pressure from the IMU and the motor commands, which have
the same clock. The other parameters differ between flights, so the file contains their distributions.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from drake_quad.command_line.running import run

import numpy as np
import scipy

from drake_quad.command_line.options import parser_without_options
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.design.firmware.crazyflie import MAX_THRUST
from drake_quad.errors import InputError, short_repr
from drake_quad.files import write_atomically
from drake_quad.identification.identify import identify
from drake_quad.identification.validation.free_flight import free_flight
from drake_quad.identification.windows import downsample
from drake_quad.logs.attitudes import rotation_matrices
from drake_quad.logs.reading import read_log
from drake_quad.logs.record import FlightRecord
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.motors import ThrottleMotors

_FILE = Path(__file__).parents[2] / "diagrams" / "nanobench.yaml"
# Coefficients of the polynomial from motor voltage (V) to rotor thrust (N). The firmware uses it to convert thrust
# commands to PWM (crazyflie-firmware, platform_defaults_cf2.h, VMOTOR2THRUST0 to 3 of the propellers 2.1+).
_THRUST_OF_VOLTAGE = (-0.02476538, 0.06523794, -0.02679250, 0.006776789)
# Rotor command for throttle 1 in the scenario, relative to the firmware's largest collective command. It exceeds 1,
# because the command of a single rotor may exceed the largest collective command.
_FULL_THROTTLE = 1.28
_MASS = 0.027  # kg, from the data sheet; the flights depend only on ratios of other parameters to the mass
_ARM = 0.03253  # m, distance of the rotors from the centre along x and y
_GRAVITY = 9.81  # m/s²
_NUM_AVERAGED = 3  # log samples per average over 30 ms; radio packets arrive at only 75 to 84 Hz
_SMOOTHING_SAMPLES = 8  # standard deviation of the Gaussian filter, log samples
_CLIMB_SAMPLES = 400  # samples after lift-off that determine the derivative of the thrust
_PERIOD = 0.01  # s, period of the log
_ESTIMATOR_PERIOD = 0.002  # s, period of the estimator
_SETTLING_SAMPLES = 150  # samples after take-off and before landing that are not used


# Parameters whose estimates are proportional to the assumed derivative of the thrust with respect to the command.
_PROPORTIONAL = ("inertia[0]", "inertia[1]", "inertia[2]", "rotor_inertia", "body_drag.centre_of_pressure[2]")
# All parameters of the rotational dynamics that are identified.
_ROTATIONAL = (*_PROPORTIONAL, "rotor_time_constant")


class Flight(NamedTuple):
    """Parameters that are estimated separately for each flight.

    Attributes:
        hover: collective thrust command in hover, relative to the full command.
        slope: derivative of the vertical acceleration with respect to the relative collective command, m/s².
        moments: (2,) roll and pitch commands in hover, relative to the full thrust.
        drag: (2,) linear drag along x and y divided by the mass, 1/s.
        scale: (3,) scale error of the estimated velocity.
        drift: (3,) standard deviation of the velocity error without its scale error, m/s.
        drift_time: correlation time of the drift, s.
        lag: delay of the estimated position relative to motion capture, s.
        velocity: (n, 2) horizontal velocity along x and y, m/s.
        direction_error: (n, 2) error of the estimated thrust direction along x and y, as a difference of unit vectors.
    """

    hover: float
    slope: float
    moments: np.ndarray
    drag: np.ndarray
    scale: np.ndarray
    drift: np.ndarray
    drift_time: float
    lag: float
    velocity: np.ndarray
    direction_error: np.ndarray


def main() -> None:
    """Identify the vehicle, write the scenario, and print the parameters of each flight."""
    options = parser_without_options(__doc__, "python scripts/development/identify_nanobench.py nanobench")
    options.add_argument("folder", type=Path)
    options.add_argument("--output", type=Path, default=_FILE, metavar="FILE", help="file (default: the shipped file)")
    arguments = options.parse_args()
    records, flights, names = [], [], []
    for path in sorted(arguments.folder.glob("B*_rep1.csv.xz")):
        table = np.genfromtxt(path, delimiter=",", names=True)
        # Flights in which the logged outputs of the PID are zero used the Mellinger controller.
        if "_fast_" in path.name or not table["pid_controller_cmd_thrust"].any():
            continue
        record = with_commands(read_log(path))
        if record.of("position")[:, 2].max() < 0.25:
            continue
        records.append(record)
        flights.append(flight_of(record, table))
        names.append(path.name.partition("_rep1")[0])
    if not flights:
        raise InputError(
            f"{short_repr(str(arguments.folder))} contains no slow or medium PID flight of NanoBench; give its folder"
        )
    print_columns(
        ("flight", "hover", "slope (m/s²)", "drag (1/s)", "velocity scale", "lag (ms)"),
        [
            (name, *(f"{value:.3g}" for value in (f.hover, f.slope, f.drag.mean(), f.scale[:2].mean(), 1e3 * f.lag)))
            for name, f in zip(names, flights, strict=True)
        ],
    )
    text = scenario_text(flights, identified(records, flights))

    def write(path: Path) -> None:
        path.write_text(text, encoding="utf-8")

    print_files([write_atomically(arguments.output, write)])


def with_commands(record: FlightRecord) -> FlightRecord:
    """Return a record with the motor commands that the firmware computed before it compensated for the voltage."""
    voltage = scipy.ndimage.gaussian_filter1d(record.of("battery_voltage"), _SMOOTHING_SAMPLES)
    motors = record.of("motor_command")
    thrust = np.polynomial.polynomial.polyval(motors * voltage[:, np.newaxis], _THRUST_OF_VOLTAGE)
    fractions = np.clip(thrust / (_FULL_THROTTLE * MAX_THRUST), 0.0, 1.0)
    return replace(record, motor_command=np.where(motors > 0.0, fractions, 0.0), battery_voltage=None)


def flight_of(record: FlightRecord, table: np.ndarray) -> Flight:
    """Estimate the parameters of a `Flight` from its record and from the rows of its log."""
    part = free_flight(record)
    free_flight_record = record.subset(slice(part.first + _SETTLING_SAMPLES, part.end - _SETTLING_SAMPLES))
    rows = table[part.first + _SETTLING_SAMPLES : part.end - _SETTLING_SAMPLES]
    commands = _FULL_THROTTLE * free_flight_record.of("motor_command")
    roll = 0.25 * (commands[:, 2] + commands[:, 3] - commands[:, 0] - commands[:, 1])
    pitch = 0.25 * (commands[:, 1] + commands[:, 2] - commands[:, 0] - commands[:, 3])
    position, velocity = (
        smooth(each) for each in (free_flight_record.of("position"), free_flight_record.of("velocity"))
    )
    body = rotation_matrices(free_flight_record.of("attitude"))
    drag = -slopes(body.inv().apply(velocity)[:, :2], smooth(free_flight_record.of("specific_force"))[:, :2])
    estimated = np.column_stack([rows[f"est_stateEstimate_{axis}"] for axis in ("x", "y", "z")])
    speeds = np.column_stack([rows[f"est_stateEstimate_v{axis}"] for axis in ("x", "y", "z")])
    scale = slopes(velocity, smooth(speeds)) - 1.0
    drift = smooth(speeds) - (1.0 + scale) * velocity
    quaternions = np.column_stack([rows[f"att_stateEstimate_q{axis}"] for axis in ("x", "y", "z", "w")])
    up = np.array([0.0, 0.0, 1.0])
    direction_error = scipy.spatial.transform.Rotation.from_quat(quaternions).apply(up) - body.apply(up)
    return Flight(
        float(commands.mean()),
        climb_slope(record, part.lift_off or part.first),
        np.array([roll.mean(), pitch.mean()]),
        drag,
        scale,
        drift.std(axis=0),
        free_flight_record.period * float(np.mean([correlation_samples(column) for column in drift.T])),
        float(-slopes(velocity[:, :2], (estimated - position)[:, :2]).mean()),
        velocity[:, :2],
        smooth(direction_error)[:, :2],
    )


def smooth(signal: np.ndarray) -> np.ndarray:
    """Return a signal (n, ...) after a low-pass filter."""
    return np.asarray(scipy.ndimage.gaussian_filter1d(signal, _SMOOTHING_SAMPLES, axis=0))


def slopes(inputs: np.ndarray, outputs: np.ndarray) -> np.ndarray:
    """Fit a straight line to each pair of columns of `inputs` and `outputs` (n, columns), and return the slopes."""
    return np.array([np.polyfit(x, y, 1)[0] for x, y in zip(inputs.T, outputs.T, strict=True)])


def correlation_samples(signal: np.ndarray) -> int:
    """Return the number of samples after which the autocorrelation of a signal (n,) has fallen to 1/e."""
    centred = signal - signal.mean()
    correlation = scipy.signal.correlate(centred, centred, method="fft")[len(centred) - 1 :]
    return int(np.argmax(correlation < correlation[0] / np.e))


def climb_slope(record: FlightRecord, lift_off: int) -> float:
    """Estimate the derivative of the vertical acceleration with respect to the collective command in a climb, m/s²."""
    part = record.subset(slice(lift_off + 20, lift_off + _CLIMB_SAMPLES))
    acceleration = np.gradient(smooth(np.gradient(part.of("position")[:, 2], part.time)), part.time)
    command = smooth(_FULL_THROTTLE * part.of("motor_command").mean(axis=1))
    best = (np.inf, 0.0)
    for delay in range(20):
        rows = np.column_stack([command[: len(command) - delay], np.ones(len(command) - delay)])
        line, residual, *_ = np.linalg.lstsq(rows, acceleration[delay:], rcond=None)
        best = min(best, (float(residual[0]) / len(rows), float(line[0])))
    return best[1]


def direction_error_time(flight: Flight, error_per_speed: float) -> float:
    """Return the time constant (s) with which the error of the estimated thrust direction follows the velocity.

    Args:
        flight: parameters of a flight.
        error_per_speed: error per speed at constant velocity, s/m. The error is opposite to the velocity.
    """

    def error(time: float) -> float:
        decay = np.exp(-_PERIOD / time)
        expected = scipy.signal.lfilter([1.0 - decay], [1.0, -decay], -error_per_speed * flight.velocity, axis=0)
        return float(np.sum((flight.direction_error - expected)[_SETTLING_SAMPLES:].var(axis=0)))

    return float(scipy.optimize.minimize_scalar(error, bounds=(0.05, 5.0), method="bounded").x)


def identified(records: list[FlightRecord], flights: list[Flight]) -> dict[str, tuple[float, float]]:
    """Return the value and the standard deviation of each rotational parameter.

    The IMU determines the ratio of torque to inertia, but hardly the derivative of the thrust with respect to the
    command. The climbs determine this derivative. Parameters that are proportional to it are scaled accordingly.
    """
    weight = 0.25 * _MASS * _GRAVITY
    hover, slope = (np.mean([getattr(flight, name) for flight in flights]) for name in ("hover", "slope"))
    base = load_undesigned("vehicles/crazyflie", [f"nominal.mass={_MASS}"])
    motors = ThrottleMotors(kind="throttle", curve=(0.0, weight / hover * _FULL_THROTTLE, 0.0))
    changes = {"motors": motors, "rotor_time_constant": 0.072, "rotor_time_constant_down": None, "min_rotor_speed": 0.0}
    vehicle = base.vehicle.model_copy(update=changes | {"max_rotor_speed": 2.0 * base.vehicle.max_rotor_speed})
    start = base.model_copy(update={"vehicle": vehicle})
    rows = []
    for record in records:
        # Each flight is identified separately, because the centre of mass differs between flights.
        imu = downsample(replace(record, position=None, velocity=None, attitude=None), _NUM_AVERAGED)
        identification = identify([imu], start, held_out_fraction=0.0)
        values = identification.fitted
        k_1, k_2 = (values[f"motors.curve[{power}]"] for power in (1, 2))
        factor = 0.25 * _MASS * slope * _FULL_THROTTLE / (k_1 + 2.0 * k_2 * hover / _FULL_THROTTLE)
        rows.append([values[name] * (factor if name in _PROPORTIONAL else 1.0) for name in _ROTATIONAL])
    # All flights have the same vehicle, so differences between the estimates are errors, which the mean reduces.
    return {
        name: (float(column.mean()), float(column.std(ddof=1)) / np.sqrt(len(rows)))
        for name, column in zip(_ROTATIONAL, np.array(rows).T, strict=True)
    }


def scenario_text(flights: list[Flight], numbers: dict[str, tuple[float, float]]) -> str:
    """Return the scenario as YAML text.

    Args:
        flights: parameters of each flight.
        numbers: value and standard deviation of each rotational parameter, keyed by name.
    """

    def spread(name: str, column: int | slice | None = None) -> tuple[float, float]:
        values = np.array([getattr(flight, name) for flight in flights])
        values = values if column is None else values[:, column]
        values = values.mean(axis=1) if values.ndim > 1 else values
        # The value in a further flight has a Student distribution. The returned standard deviation is that of a normal
        # distribution with the same 95 % interval.
        student = scipy.stats.t.ppf(0.975, len(values) - 1) / scipy.stats.norm.ppf(0.975)
        return float(values.mean()), float(student * values.std(ddof=1) * np.sqrt(1.0 + 1.0 / len(values)))

    def normal(mean: float, deviation: float, end: str = "") -> str:
        end = f", {end}" if end else ""
        return f"{{normal: {{mean: {mean:.4g}, standard_deviation: {deviation:.2g}{end}}}}}"

    hover, hover_deviation = spread("hover")
    slope, _ = spread("slope")
    weight = 0.25 * _MASS * _GRAVITY
    full = 0.25 * _MASS * slope
    level = weight - full * hover
    roll, pitch = (spread("moments", axis) for axis in (0, 1))
    arm = 4.0 * full * _ARM / (_MASS * _GRAVITY)
    drag, drag_deviation = spread("drag", slice(0, 2))
    scale, vertical = spread("scale", slice(0, 2)), spread("scale", 2)
    frames = [max(0, round(flight.lag / _ESTIMATOR_PERIOD)) for flight in flights]
    drift = np.mean([flight.drift for flight in flights], axis=0)
    linear = normal(drag * _MASS, drag_deviation * _MASS, "shared: {drag: 1}, min: 0")
    tilt_per_speed = drag / _GRAVITY
    times = [round(direction_error_time(flight, tilt_per_speed), 2) for flight in flights]
    along = normal(*scale, "shared: {estimator: 1}, min: -0.5")
    values = {
        name: normal(mean, deviation, f"min: {0.5 * mean:.4g}, max: {1.5 * mean:.4g}")
        for name, (mean, deviation) in numbers.items()
    }
    return f"""\
# Flights of a Crazyflie 2.1 with motion capture under the PID of its firmware 2025.12.1: NanoBench, S. I. Ullah,
# J. Baca, arXiv 2603.09908, 2026 (BSD-3). `drake-quad compare-log` flies the setpoints of a log in place of the route
# below. This file was written by
#   python scripts/development/identify_nanobench.py FOLDER
# from {len(flights)} slow and medium flights, without their tracking errors (see docs/background/real_flights.md).
nanobench:
  extends: [vehicles/crazyflie, controllers/crazyflie]
  route: {{kind: hover, duration: 5.0}}
  # The limits are wide, because the laboratory has no ground and the setpoints jump.
  crash: {{height: -20.0, position_error: 20.0}}
  nominal:
    # The firmware commands thrust. Throttle 1 is {_FULL_THROTTLE} times its full collective command of {MAX_THRUST} N,
    # which single rotors may exceed.
    motors: {{kind: throttle, curve: [0.0, {_FULL_THROTTLE * MAX_THRUST:.4g}, 0.0]}}
    max_rotor_speed: 2784.0    # at {_FULL_THROTTLE * MAX_THRUST:.4g} N
  laboratory:
    autopilot:
      # The estimator of the firmware neglects drag.
      neglected_drag: {{tilt_per_speed: {tilt_per_speed:.3g}, time: {{choice: {times}}}}}
    motion_capture:
      # Lag of the estimated position in each of the flights. The scale error of the velocity is constant in a flight.
      latency_frames: {{choice: {frames}}}
      velocity_error:
        - {along}
        - {along}
        - {normal(*vertical, "min: -0.5")}
      velocity_drift: [{", ".join(f"{each:.2g}" for each in drift)}]
      drift_time: {spread("drift_time")[0]:.2g}
  vehicle:
    mass: {_MASS}    # from the data sheet, since only ratios to the mass matter
    inertia:
      - {values["inertia[0]"]}
      - {values["inertia[1]"]}
      - {values["inertia[2]"]}
    rotor_inertia: {values["rotor_inertia"]}
    rotor_time_constant: {values["rotor_time_constant"]}
    rotor_time_constant_down: null
    min_rotor_speed: 0.0
    max_rotor_speed: 4862.0
    motors:
      # The hover command differs between flights, with a standard deviation of {hover_deviation:.3f} of the full
      # command.
      kind: throttle
      curve: [{normal(level, full * hover_deviation)}, {full * _FULL_THROTTLE:.4g}, 0.0]
    centre_of_mass:    # depends on the position of the battery
      - {normal(-arm * pitch[0], arm * pitch[1])}
      - {normal(arm * roll[0], arm * roll[1])}
    body_drag:
      linear: [{linear}, {linear}, {drag * _MASS:.3g}]
      centre_of_pressure: [0.0, 0.0, {values["body_drag.centre_of_pressure[2]"]}]
    # The ground effect of a Crazyflie is 11.4 times that of Cheeseman and Bennett for a radius of 23.1 mm (J. Panerati
    # et al., "Learning to fly", IROS 2021, gnd_eff_coeff), hence √11.4 · 23.1 mm. The markers are 2 cm above the
    # rotors.
    ground_effect: {{rotor_radius: 0.078, ground_height: 0.02}}
"""


if __name__ == "__main__":
    run(main)
