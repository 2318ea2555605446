"""Preparation of logs for the forward model: commands, outputs, usable samples, and a common period."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError, join_names
from drake_quad.identification.model import (
    DELAY,
    DisturbanceFrame,
    LogModel,
    level_vehicle,
    thrust_of_fraction,
    with_commands,
)
from drake_quad.identification.prediction_errors import FORCE, Output, PredictionNoise, Predictor
from drake_quad.identification.results.vehicle_values import with_effects, with_throttles
from drake_quad.identification.windows import (
    LogWindow,
    WindowSizes,
    airborne_mask,
    common_period,
    downsample,
    split_into_windows,
)
from drake_quad.logs.attitudes import rotation_matrices
from drake_quad.logs.record import FlightRecord
from drake_quad.scenario.models import Scenario
from drake_quad.vehicle.motors import thrust_from_throttle

# Shortest sampling period of a prepared log, s, about a tenth of the time constant of a small motor. Faster logs are
# averaged.
_MIN_PERIOD = 0.008
_MAX_STEP = 0.01  # s, longest step of the model
# Length of a window, and duration before the window in which the filter settles, s. In logs without poses, the
# predicted attitude and velocity drift, so windows are shorter.
_POSE_WINDOW = (1.25, 0.4)  # for logs with poses
_IMU_WINDOW = (1.0, 0.4)  # for logs with IMU measurements only
_MIN_WINDOW = 0.5  # s, shortest length of a window
WARM_UP = 0.4  # s, duration in which only the rotors are simulated, about five time constants of a small motor
_POSE_HORIZON = 0.5  # s, horizon of forecasts for logs with poses
_IMU_HORIZON = 0.1  # s, horizon of forecasts for logs with IMU measurements only
MAX_DELAY = 0.15  # s, largest delay from a command to the measurement of its effect
MIN_BLOCKS = 15  # smallest number of blocks for the jackknife of the estimates
_BLOCK_DURATION = 4.0  # s, longer than the correlation time of model errors
_MIN_WINDOWS = 4  # smallest number of windows for a fit or a forecast
_POSE = ("position", "attitude")


class PreparedLogs(NamedTuple):
    """Logs in the form that the model requires.

    Attributes:
        records: records with the commands and outputs of the model.
        scenario: scenario with the vehicle of the logs.
        outputs: outputs that are predicted.
        flying: (n,) mask of the usable airborne samples of each record.
        has_motor_throttles: True if the logs contain a throttle for each motor.
        averaging_period: period over which the samples of faster logs were averaged, s; 0 if none were.
    """

    records: list[FlightRecord]
    scenario: Scenario
    outputs: list[Output]
    flying: list[np.ndarray]
    has_motor_throttles: bool
    averaging_period: float = 0.0

    @property
    def period(self) -> float:
        """Time between samples, s."""
        return common_period(self.records)

    @property
    def loop_period(self) -> float | None:
        """Period of the loop on board that commands the rotors, s; None without a loop, or if logs were averaged."""
        autopilot = self.scenario.laboratory.autopilot
        return None if autopilot.models_vehicle or self.averaging_period else autopilot.period

    @property
    def voltage(self) -> float | None:
        """Voltage at which the rotors reach their commanded speed, or for which the thrust curve holds, V.

        The voltage is `motors.voltage` of the vehicle. If this is not set, it is the voltage of the full battery, or
        the median voltage in the logs if the vehicle has no battery. It is None if a log lacks the voltage, or if
        rotors are commanded by speed and the vehicle has no battery.
        """
        if any(record.battery_voltage is None for record in self.records):
            return None
        vehicle: Any = self.scenario.vehicle
        if self.has_motor_throttles and vehicle.motors.voltage is not None:
            return float(vehicle.motors.voltage)
        if vehicle.battery is not None:
            return float(vehicle.battery.voltage)
        if not self.has_motor_throttles:
            return None
        voltages = [
            record.of("battery_voltage")[usable] for record, usable in zip(self.records, self.flying, strict=True)
        ]
        return float(np.median(np.concatenate(voltages)))

    @property
    def signals(self) -> set[str]:
        """Signals that are predicted."""
        return {output.signal for output in self.outputs}

    @property
    def has_poses(self) -> bool:
        """True if positions, attitudes or velocities are predicted."""
        return bool({"position", "attitude", "velocity"} & self.signals)

    def predictor(
        self, names: Sequence[str], flying: Sequence[np.ndarray], *, for_forecast: bool = False, delay: float = 0.0
    ) -> Predictor:
        """Return a predictor of the outputs, in windows in the usable parts of the records.

        Args:
            names: names of the parameters.
            flying: (n,) mask of the usable samples of each record.
            for_forecast: True for the short windows of a forecast, False for the longer windows of a fit.
            delay: delay if it is not a parameter, s.

        Raises:
            InputError: if the usable parts are too short.
        """
        length, settle = _POSE_WINDOW if self.has_poses else _IMU_WINDOW
        airborne_time = self.period * sum(int(usable.sum()) for usable in flying)
        if for_forecast:
            length = min(_POSE_HORIZON if self.has_poses else _IMU_HORIZON, airborne_time / (2.0 * _MIN_WINDOWS))
            settle = min(settle, length)
        else:
            length = min(length, max(_MIN_WINDOW, airborne_time / (MIN_BLOCKS + 1)))
        sizes = WindowSizes(*(max(1, round(seconds / self.period)) for seconds in (length, settle, WARM_UP)))
        windows = split_into_windows(self.records, flying, sizes)
        if len(windows) < _MIN_WINDOWS:
            raise InputError(
                f"{'the held-out part of the logs' if for_forecast else 'the flight in the logs'} contains only"
                f" {len(windows)} windows of {length + settle:.2g} s in the air; at least {_MIN_WINDOWS} are needed, so"
                " use longer flights"
            )
        return self.predictor_for_windows(windows, sizes, names, delay=delay)

    def predictor_for_windows(
        self, windows: Sequence[LogWindow], sizes: WindowSizes, names: Sequence[str] = (), *, delay: float = 0.0
    ) -> Predictor:
        """Return the predictor of the outputs in given windows.

        Args:
            windows: windows of the records.
            sizes: sizes of the windows.
            names: names of the parameters.
            delay: delay if it is not a parameter, s.
        """
        scenario = with_effects(self.scenario, tuple(name for name in names if name != DELAY))
        frame: DisturbanceFrame = "world" if self.has_poses else "body"
        model = LogModel(scenario, names, frame=frame, delay=delay, voltage=self.voltage)
        split = max(1, int(np.ceil(self.period / _MAX_STEP - 0.05)))
        max_delay = max(MAX_DELAY, delay) + self.period
        return Predictor(model, self.records, windows, sizes, self.outputs, split=split, max_delay=max_delay)


def window_blocks(predictor: Predictor) -> np.ndarray:
    """Return the block number (W,) of each window, for the jackknife of the estimates."""
    return block_numbers_of_windows(len(predictor.windows), predictor.duration, MIN_BLOCKS)


def block_numbers_of_windows(windows: int, duration: float, minimum: int) -> np.ndarray:
    """Return the block number (windows,) of each window, for blocks of adjacent windows.

    A block lasts about four seconds, which is longer than the correlation time of model errors. Blocks are shorter if
    there would otherwise be fewer than `minimum` blocks.

    Args:
        windows: number of windows.
        duration: duration of all windows together, s.
        minimum: smallest number of blocks, unless there are fewer windows.
    """
    num_blocks = min(windows, max(minimum, round(duration / _BLOCK_DURATION)))
    return np.asarray(np.arange(windows) * num_blocks // windows)


def prepare(
    records: Sequence[FlightRecord],
    scenario: Scenario,
    nominal: Scenario | None = None,
    *,
    attitude_is_estimated: bool = False,
) -> tuple[PreparedLogs, Scenario]:
    """Return logs in the form that the model requires, and the initial scenario, whose values the estimates replace.

    Args:
        records: records of flights of the same vehicle.
        scenario: scenario with the vehicle.
        nominal: scenario whose `nominal` vehicle the firmware's allocation uses; by default `scenario`.
        attitude_is_estimated: True if the attitude lags the gyroscope, so that body rates are predicted instead.

    Raises:
        InputError: if a log lacks commands or outputs, or the logs have different sample rates.
    """
    has_motor_throttles = any(record.motor_command is not None for record in records)
    if has_motor_throttles:
        scenario = with_throttles(scenario)
    model_scenario = scenario
    responds = scenario.laboratory.autopilot.models_vehicle
    if responds:
        vehicle = scenario.vehicle.model_copy(update={"rotor_time_constant_down": None})
        model_scenario = scenario = scenario.model_copy(update={"vehicle": vehicle})
    elif any(record.attitude is None and record.body_rates is None for record in records):
        records = [replace(record, attitude_command=np.zeros((len(record.time), 3))) for record in records]
        model_scenario = level_vehicle(scenario)
    nominal = nominal or scenario
    prepared = [_with_specific_force(record, nominal) for record in records]
    prepared = [with_commands(record, model_scenario, nominal) for record in prepared]
    steps = [max(1, int(_MIN_PERIOD / record.period + 0.05)) for record in prepared]
    prepared = [downsample(record, step) for record, step in zip(prepared, steps, strict=True)]
    logs = PreparedLogs(
        prepared,
        model_scenario,
        _outputs(prepared, attitude_is_estimated),
        [airborne_mask(record) for record in prepared],
        has_motor_throttles,
        max((record.period for record, step in zip(prepared, steps, strict=True) if step > 1), default=0.0),
    )
    common_period(prepared)  # raises an error if the logs have different sample rates
    return logs, scenario


def _with_specific_force(record: FlightRecord, scenario: Scenario) -> FlightRecord:
    """Return a record with a specific force if only the residual force is logged.

    The residual force in the log of an autopilot is the force in addition to the weight and the commanded thrust. The
    specific force is what an accelerometer would measure.
    """
    if record.residual_force is None or record.attitude is None or record.specific_force is not None:
        return record
    if record.thrust_fraction is not None and record.hover_thrust_fraction is not None:
        thrust = thrust_of_fraction(record, scenario.vehicle.mass * scenario.vehicle.gravity)
    elif record.thrust_command is not None:
        thrust = record.thrust_command
    else:
        curve = scenario.nominal.motors.thrust_curve()
        if record.thrust_fraction is None or curve is None:
            return record
        fractions: Any = np.repeat(record.thrust_fraction[:, None], 4, axis=1)
        thrust = np.asarray(thrust_from_throttle(fractions, curve)).sum(axis=1)
    to_body = rotation_matrices(record.attitude).inv()
    force = to_body.apply(record.residual_force) + thrust[:, None] * np.array([0.0, 0.0, 1.0])
    return replace(record, specific_force=force / scenario.vehicle.mass)


def _outputs(records: Sequence[FlightRecord], attitude_is_estimated: bool) -> list[Output]:
    """Return the outputs that are predicted, all of which every record contains.

    Velocities are left out if positions are logged. Body rates are left out if attitudes but no specific forces are
    logged. An estimator usually derives these velocities and body rates from positions and attitudes, so they contain
    the same noise with an additional delay.
    """
    logged = set.intersection(*(set(record.names) for record in records))
    if attitude_is_estimated:
        logged -= {"attitude"}
    signals = [name for name in _POSE if name in logged]
    if "position" not in logged and "velocity" in logged and "attitude" in logged:
        signals.append("velocity")
    if "body_rates" in logged and ("attitude" not in logged or FORCE in logged):
        signals.append("body_rates")
    if FORCE in logged and ("body_rates" in logged or "attitude" in logged):
        signals.append(FORCE)
    if not signals:
        raise InputError(
            "to identify a vehicle, logs need body_rates with specific_force, attitude with position or velocity, or"
            " position; the signals that all of these logs contain are"
            f" {join_names(sorted(logged), len(logged)) or 'none'}"
        )
    if signals == ["position"]:
        return [Output("position", 2)]
    return [Output(name, column) for name in signals for column in range(3)]


def initial_noise(outputs: Sequence[Output]) -> PredictionNoise:
    """Return the initial noise of a fit.

    The initial disturbance is large, so that the measurements correct a poor initial model before it diverges within a
    window. The maximum-likelihood estimate reduces the disturbance in the first rounds of the fit.
    """
    measured = {"position": 1e-3, "velocity": 2e-2, "attitude": 4e-3, "body_rates": 2e-2, FORCE: 0.3}
    correlation_times = [0.1, 0.1, 0.1, 0.05, 0.05, 0.05]
    return PredictionNoise(
        np.array([measured[output.signal] for output in outputs]),
        np.array([1.0, 1.0, 1.0, 8.0, 8.0, 3.0]),
        np.array(correlation_times),
    )
