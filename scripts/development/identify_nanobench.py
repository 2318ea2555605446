"""Write diagrams/nanobench.yaml: the Crazyflie of NanoBench with its firmware, from the slow and medium flights.

Give the folder of NanoBench (S. I. Ullah, J. Baca, arXiv 2603.09908; BSD-3). Nothing follows from a tracking error:
inertia, lag and centre of pressure are from `identify`, on the IMU and the motors, which share a clock. The rest is
what flights differ by. The fast flights are left out, so that they can be predicted.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from drake_quad.command_line.running import run

import numpy as np
import scipy

from drake_quad.command_line.options import bare_parser
from drake_quad.command_line.output import print_columns, print_files
from drake_quad.design.firmware.crazyflie import MAX_THRUST
from drake_quad.errors import InputError, shown
from drake_quad.files import write_atomically
from drake_quad.identification.flown_again.flown_part import flown_part
from drake_quad.identification.identify import identify
from drake_quad.identification.logs.attitudes import rotations
from drake_quad.identification.logs.reading import read_log
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.windows import coarser
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.motors import ThrottleMotors

_FILE = Path(__file__).parents[2] / "diagrams" / "nanobench.yaml"
# Thrust of a rotor (N) over the voltage of its motor, by which the firmware makes PWM of the commanded thrust
# (crazyflie-firmware, platform_defaults_cf2.h, VMOTOR2THRUST0 to 3 of the propellers 2.1+).
_THRUST_OF_VOLTAGE = (-0.02476538, 0.06523794, -0.02679250, 0.006776789)
# Throttle 1 of the scenario over the firmware's full command; single rotors get more than the full collective command.
_FULL = 1.28
_MASS, _ARM, _GRAVITY = 0.027, 0.03253, 9.81  # kg, m, m/s²; only ratios to the mass matter
_NUM_AVERAGED = 3  # samples of the log averaged to one, 30 ms, since radio packets arrive at 75 to 84 Hz
_SMOOTHING_SAMPLES = 8  # samples
_CLIMB_SAMPLES = 400  # samples after lift-off that show the slope of the thrust
_PERIOD = 0.01  # s, period of the log
_FRAME = 0.002  # s, period of the estimator
_SETTLING_SAMPLES = 150  # samples after and before take-off and landing that are left out


# Parameters of the rotational motion, and those that torques identify only relative to the slope of the thrust.
_PROPORTIONAL = ("inertia[0]", "inertia[1]", "inertia[2]", "rotor_inertia", "body_drag.centre_of_pressure[2]")
_TURNING = (*_PROPORTIONAL, "rotor_time_constant")


class Flight(NamedTuple):
    """Parameters of a single flight.

    Attributes:
        hover: collective command that carries the vehicle, relative to the full one.
        slope: vertical acceleration over the collective command, m/s².
        moments: (2,) command of roll and pitch that the vehicle needs in hover, as a share of the full thrust.
        drag: (2,) linear drag along x and y over the mass, 1/s.
        scale: (3,) scale error of the estimated velocity.
        drift: (3,) standard deviation of the rest of its error, m/s.
        drift_time: correlation time of that, s.
        lag: lag of the estimated position behind motion capture, s.
        lean: samples (n, 2) of the horizontal velocity (m/s) and of the error of the estimated direction of thrust.
    """

    hover: float
    slope: float
    moments: np.ndarray
    drag: np.ndarray
    scale: np.ndarray
    drift: np.ndarray
    drift_time: float
    lag: float
    lean: tuple[np.ndarray, np.ndarray]


def main() -> None:
    """Write the scenario, and print its parameters."""
    options = bare_parser(__doc__, "python scripts/development/identify_nanobench.py nanobench")
    options.add_argument("folder", type=Path)
    options.add_argument("--output", type=Path, default=_FILE, metavar="FILE", help="to write (default: the shipped)")
    arguments = options.parse_args()
    records, flights, names = [], [], []
    for path in sorted(arguments.folder.glob("B*_rep1.csv.xz")):
        table = np.genfromtxt(path, delimiter=",", names=True)
        # The Mellinger controller of the firmware leaves the outputs of the PID at zero.
        if "_fast_" in path.name or not table["pid_controller_cmd_thrust"].any():
            continue
        record = with_commands(read_log(path))
        if record.of("position")[:, 2].max() < 0.25:
            continue
        records.append(record)
        flights.append(flight_of(record, table))
        names.append(path.name.partition("_rep1")[0])
    if not flights:
        raise InputError(f"{shown(str(arguments.folder))} has no slow or medium flight of NanoBench under the PID")
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
    """Return a record whose motor commands are those before the firmware compensates the voltage of the battery."""
    voltage = scipy.ndimage.gaussian_filter1d(record.of("battery_voltage"), _SMOOTHING_SAMPLES)
    motors = record.of("motor_command")
    thrust = np.polynomial.polynomial.polyval(motors * voltage[:, np.newaxis], _THRUST_OF_VOLTAGE)
    shares = np.clip(thrust / (_FULL * MAX_THRUST), 0.0, 1.0)
    return replace(record, motor_command=np.where(motors > 0.0, shares, 0.0), battery_voltage=None)


def flight_of(record: FlightRecord, table: np.ndarray) -> Flight:
    """Return the parameters of a flight."""
    part = flown_part(record)
    flown = record.part(slice(part.first + _SETTLING_SAMPLES, part.end - _SETTLING_SAMPLES))
    rows = table[part.first + _SETTLING_SAMPLES : part.end - _SETTLING_SAMPLES]
    commands = _FULL * flown.of("motor_command")
    roll = 0.25 * (commands[:, 2] + commands[:, 3] - commands[:, 0] - commands[:, 1])
    pitch = 0.25 * (commands[:, 1] + commands[:, 2] - commands[:, 0] - commands[:, 3])
    position, velocity = (smooth(each) for each in (flown.of("position"), flown.of("velocity")))
    body = rotations(flown.of("attitude"))
    drag = -slopes(body.inv().apply(velocity)[:, :2], smooth(flown.of("specific_force"))[:, :2])
    estimated = np.column_stack([rows[f"est_stateEstimate_{axis}"] for axis in ("x", "y", "z")])
    speeds = np.column_stack([rows[f"est_stateEstimate_v{axis}"] for axis in ("x", "y", "z")])
    scale = slopes(velocity, smooth(speeds)) - 1.0
    drift = smooth(speeds) - (1.0 + scale) * velocity
    quaternions = np.column_stack([rows[f"att_stateEstimate_q{axis}"] for axis in ("x", "y", "z", "w")])
    up = np.array([0.0, 0.0, 1.0])
    lean = scipy.spatial.transform.Rotation.from_quat(quaternions).apply(up) - body.apply(up)
    return Flight(
        float(commands.mean()),
        climb_slope(record, part.lift_off or part.first),
        np.array([roll.mean(), pitch.mean()]),
        drag,
        scale,
        drift.std(axis=0),
        flown.period * float(np.mean([correlation_samples(column) for column in drift.T])),
        float(-slopes(velocity[:, :2], (estimated - position)[:, :2]).mean()),
        (velocity[:, :2], smooth(lean)[:, :2]),
    )


def smooth(signal: np.ndarray) -> np.ndarray:
    """Return a signal (n, ...) without its fast part."""
    return np.asarray(scipy.ndimage.gaussian_filter1d(signal, _SMOOTHING_SAMPLES, axis=0))


def slopes(inputs: np.ndarray, outputs: np.ndarray) -> np.ndarray:
    """Return the (columns,) slopes of straight lines through samples (n, columns)."""
    return np.array([np.polyfit(x, y, 1)[0] for x, y in zip(inputs.T, outputs.T, strict=True)])


def correlation_samples(signal: np.ndarray) -> int:
    """Return the number of samples after which the autocorrelation of a signal (n,) has fallen to 1/e."""
    centred = signal - signal.mean()
    correlation = scipy.signal.correlate(centred, centred, method="fft")[len(centred) - 1 :]
    return int(np.argmax(correlation < correlation[0] / np.e))


def climb_slope(record: FlightRecord, lift_off: int) -> float:
    """Return the slope of the vertical acceleration over the collective command after take-off, m/s²."""
    part = record.part(slice(lift_off + 20, lift_off + _CLIMB_SAMPLES))
    acceleration = np.gradient(smooth(np.gradient(part.of("position")[:, 2], part.time)), part.time)
    command = smooth(_FULL * part.of("motor_command").mean(axis=1))
    best = (np.inf, 0.0)
    for delay in range(20):
        rows = np.column_stack([command[: len(command) - delay], np.ones(len(command) - delay)])
        found, left, *_ = np.linalg.lstsq(rows, acceleration[delay:], rcond=None)
        best = min(best, (float(left[0]) / len(rows), float(found[0])))
    return best[1]


def lean_time(flight: Flight, lean: float) -> float:
    """Return the time constant (s) with which the error of the estimated tilt of a flight follows the velocity."""
    velocity, found = flight.lean

    def error(time: float) -> float:
        decay = np.exp(-_PERIOD / time)
        expected = scipy.signal.lfilter([1.0 - decay], [1.0, -decay], -lean * velocity, axis=0)
        return float(np.sum((found - expected)[_SETTLING_SAMPLES:].var(axis=0)))

    return float(scipy.optimize.minimize_scalar(error, bounds=(0.05, 5.0), method="bounded").x)


def identified(records: list[FlightRecord], flights: list[Flight]) -> dict[str, tuple[float, float]]:
    """Return value and standard deviation of the parameters of the rotation, in the units of the thrust curve.

    The IMU shows torques over inertia, and hardly the slope of the thrust, which the climbs show. So all that is
    proportional to this slope is scaled to it.
    """
    weight = 0.25 * _MASS * _GRAVITY
    hover, slope = (np.mean([getattr(flight, name) for flight in flights]) for name in ("hover", "slope"))
    base = load_undesigned("vehicles/crazyflie", [f"nominal.mass={_MASS}"])
    motors = ThrottleMotors(kind="throttle", curve=(0.0, weight / hover * _FULL, 0.0))
    changes = {"motors": motors, "rotor_time_constant": 0.072, "rotor_time_constant_down": None, "min_rotor_speed": 0.0}
    vehicle = base.vehicle.model_copy(update=changes | {"max_rotor_speed": 2.0 * base.vehicle.max_rotor_speed})
    start = base.model_copy(update={"vehicle": vehicle})
    rows = []
    for record in records:
        # The centre of mass differs from flight to flight, so each is identified by itself.
        imu = coarser(replace(record, position=None, velocity=None, attitude=None), _NUM_AVERAGED)
        found = identify([imu], start, held_out_share=0.0)
        fitted: Any = found.vehicle.vehicle.motors
        _, k_1, k_2 = fitted.curve
        factor = 0.25 * _MASS * slope * _FULL / (k_1 + 2.0 * k_2 * hover / _FULL)
        values = dict(zip(found.estimates.names, found.estimates.values, strict=True))
        rows.append([float(values[name]) * (factor if name in _PROPORTIONAL else 1.0) for name in _TURNING])
    # All flights are of one vehicle, so their scatter is estimation error, and their mean is the best estimate.
    return {
        name: (float(column.mean()), float(column.std(ddof=1)) / np.sqrt(len(rows)))
        for name, column in zip(_TURNING, np.array(rows).T, strict=True)
    }


def scenario_text(flights: list[Flight], numbers: dict[str, tuple[float, float]]) -> str:
    """Return the scenario in YAML."""

    def spread(name: str, column: int | slice | None = None) -> tuple[float, float]:
        values = np.array([getattr(flight, name) for flight in flights])
        values = values if column is None else values[:, column]
        values = values.mean(axis=1) if values.ndim > 1 else values
        # The normal distribution has the 95 % interval of Student's for one more flight.
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
    frames = [max(0, round(flight.lag / _FRAME)) for flight in flights]
    drift = np.mean([flight.drift for flight in flights], axis=0)
    linear = normal(drag * _MASS, drag_deviation * _MASS, "shared: {drag: 1}, min: 0")
    lean = drag / _GRAVITY
    times = [round(lean_time(flight, lean), 2) for flight in flights]
    along = normal(*scale, "shared: {estimator: 1}, min: -0.5")
    values = {
        name: normal(mean, deviation, f"min: {0.5 * mean:.4g}, max: {1.5 * mean:.4g}")
        for name, (mean, deviation) in numbers.items()
    }
    return f"""\
# Flights of a Crazyflie 2.1 with motion capture under the PID of its firmware 2025.12.1: NanoBench, S. I. Ullah,
# J. Baca, arXiv 2603.09908, 2026 (BSD-3). `drake-quad compare-log` flies the setpoints of a log in the place of the
# route here. Written by
#   python scripts/development/identify_nanobench.py FOLDER
# from {len(flights)} slow and medium flights, without their tracking errors. docs/background/real_flights.md says how.
nanobench:
  extends: [vehicles/crazyflie, controllers/crazyflie]
  route: {{kind: hover, duration: 5.0}}
  # The laboratory has no ground, and the setpoints jump.
  crash: {{height: -20.0, position_error: 20.0}}
  nominal:
    # The firmware commands thrust. A throttle of 1 is {_FULL} of its full command of {MAX_THRUST} N, which it may
    # exceed for single rotors.
    motors: {{kind: throttle, curve: [0.0, {_FULL * MAX_THRUST:.4g}, 0.0]}}
    max_rotor_speed: 2784.0    # of {_FULL * MAX_THRUST:.4g} N
  laboratory:
    autopilot:
      # The estimator of the firmware has no drag.
      neglected_drag: {{lean: {lean:.3g}, time: {{choice: {times}}}}}
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
    mass: {_MASS}    # of the data sheet, not of this vehicle; only ratios to it matter
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
      # The command of hover differs between flights, by a standard deviation of {hover_deviation:.3f} of the full one.
      kind: throttle
      curve: [{normal(level, full * hover_deviation)}, {full * _FULL:.4g}, 0.0]
    centre_of_mass:    # differs with the place of the battery
      - {normal(-arm * pitch[0], arm * pitch[1])}
      - {normal(arm * roll[0], arm * roll[1])}
    body_drag:
      linear: [{linear}, {linear}, {drag * _MASS:.3g}]
      centre_of_pressure: [0.0, 0.0, {values["body_drag.centre_of_pressure[2]"]}]
    # The rotors of a Crazyflie gain 11.4 times as much as Cheeseman and Bennett have for one of 23.1 mm (J. Panerati et
    # al., "Learning to fly", IROS 2021, gnd_eff_coeff): √11.4 · 23.1 mm. The markers are 2 cm above the rotors.
    ground_effect: {{rotor_radius: 0.078, ground_height: 0.02}}
"""


if __name__ == "__main__":
    run(main)
