"""Forward model of a log: the vehicle of the simulation, driven by logged commands.

The formulas are those of the simulation: `flying_step`, or `attitude_response_step` for an autopilot whose closed
attitude loop is modelled as a whole. The model simulates windows of a log for several sets of parameters at once.

A disturbance represents model errors. It consists of a specific force, and of an angular acceleration about the axes of
B (for an attitude response, accelerations of the angles). During a step, the components of the specific force are
constant. They are components along the axes of W if the log contains positions, attitudes or velocities, and along the
axes of B otherwise. The axes of W are preferred, since a vehicle leans into the wind: along the axes of B, the force of
a constant wind would have a constant component along the thrust.

Commands act after a delay. A command that is constant between samples and delayed by n + f samples has the mean

    (1 - f) u[k - n] + f u[k - n - 1],  0 ≤ f < 1,

over one step. The model uses this mean, which is continuous in the delay. The resulting rotor speeds are correct to
first order in the ratio of the step to the time constant of the rotors.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np

from drake_quad.assembly.laboratory import vehicle_parameters
from drake_quad.errors import InputError, short_repr
from drake_quad.framework.formulas import kernel
from drake_quad.framework.records import layout_of
from drake_quad.geometry.axes import BodyAxes, Vector, plus
from drake_quad.geometry.kinematics import small_rotation
from drake_quad.identification.firmware import allocated_commands
from drake_quad.identification.results.estimates import scenario_path
from drake_quad.identification.windows import LogWindow, WindowSizes
from drake_quad.laboratory.motion_capture import attitude_of_markers
from drake_quad.laboratory.sensors.accelerometer import SpecificForce
from drake_quad.logs.attitudes import rotation_matrices
from drake_quad.logs.record import FlightRecord
from drake_quad.scenario.autopilots.response import AttitudeResponseSettings
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import map_leaves
from drake_quad.scenario.winds.source import steady_wind
from drake_quad.signals import (
    AccelerationB,
    Attitude,
    AttitudeTarget,
    BodyAccelerationB,
    Number,
    RotorSpeed,
    State,
    Throttle,
    Time,
    Wind,
)
from drake_quad.vehicle.attitude_kinematics import RIGID_KINEMATICS
from drake_quad.vehicle.attitude_response import (
    AttitudeResponse,
    AttitudeResponseBody,
    DampingRatios,
    NaturalFrequencies,
    attitude_response_step,
    state_from_body,
)
from drake_quad.vehicle.dynamics import Motion
from drake_quad.vehicle.effects import Effects
from drake_quad.vehicle.motion import accelerations, rotor_state
from drake_quad.vehicle.motors import decay_factors, lagged_speeds
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.stepping import VehicleState, flying_step, rotor_target

NUM_BODY = len(State._fields)
NUM_DISTURBANCE = 8  # number of components of `Disturbance`
NUM_ROTORS = len(RotorSpeed._fields)
# First component of each signal in the model state.
STATE_ROWS = {"position": 0, "attitude": 3, "velocity": 6, "body_rates": 9}

DELAY = "delay"
"""Name of the delay from a logged command to the logged measurement of its effect, s."""
MISALIGNMENT = tuple(f"laboratory.motion_capture.misalignment[{axis}]" for axis in range(3))
"""Names of the roll, pitch and yaw of the markers' frame in B, rad."""

# Natural frequency of the attitude response, rad/s, for a vehicle that stays level. Results do not depend on this
# value.
_LEVEL_FREQUENCY = 20.0
_VOLTAGE_WINDOW = 0.1  # s, duration over which the logged voltage is averaged

DisturbanceFrame = Literal["world", "body"]


class Disturbance(NamedTuple):
    """Specific force and angular acceleration that represent model errors. The force has a constant part."""

    x: AccelerationB
    y: AccelerationB
    z: AccelerationB
    p: BodyAccelerationB
    q: BodyAccelerationB
    r: BodyAccelerationB
    constant_x: AccelerationB
    constant_y: AccelerationB

    @property
    def force(self) -> Vector:
        """Disturbing specific force including its constant part, along the axes of the `DisturbanceFrame`, m/s²."""
        return Vector(self.x + self.constant_x, self.y + self.constant_y, self.z)


class Span(NamedTuple):
    """Duration of an integration step, and battery voltage in it, relative to the voltage of the thrust curve."""

    span: Time
    voltage: Number


class ModelParameters(NamedTuple):
    """Numerical parameters of a vehicle, and of its attitude response if it has one."""

    parameters: QuadrotorParameters
    effects: Effects
    response: AttitudeResponse | None


def step(
    body: State,
    rotors: RotorSpeed,
    command: RotorSpeed | Throttle,
    attitude: Attitude,
    wind: Wind,
    disturbance: Disturbance,
    span: Span,
    model_parameters: ModelParameters,
    frame: DisturbanceFrame,
) -> tuple[State, RotorSpeed]:
    """Return body and rotors at the end of a step, during which inputs and disturbance are constant.

    Each step starts at time 0, so a payload that is dropped later is present in every step. With an attitude response,
    the body rates in the state are the rates of the angles.
    """
    h = span.span
    parameters, effects, response = model_parameters
    target = steady_rotor_speed(command, span, model_parameters)
    after: Any
    if response is None:
        before = VehicleState(body, rotors)
        after = flying_step(before, target, wind, parameters, effects, h, h, RIGID_KINEMATICS)
    else:
        target_attitude = AttitudeTarget(0.0, *attitude, 0.0, 0.0, 0.0)
        settings = wind, None, parameters, response, None, effects, 0.0, h, "exact"
        after = attitude_response_step(AttitudeResponseBody(*body), rotors, command, target_attitude, *settings)  # type: ignore[arg-type]
    force = disturbance.force
    if frame == "body":
        force = BodyAxes.of(body.roll, body.pitch, body.yaw).in_world(force)
    undisturbed = State(*after.body)
    half = 0.5 * h * h
    disturbed = undisturbed._replace(
        x=undisturbed.x + half * force.x,
        y=undisturbed.y + half * force.y,
        z=undisturbed.z + half * force.z,
        v_x=undisturbed.v_x + h * force.x,
        v_y=undisturbed.v_y + h * force.y,
        v_z=undisturbed.v_z + h * force.z,
        p=undisturbed.p + h * disturbance.p,
        q=undisturbed.q + h * disturbance.q,
        r=undisturbed.r + h * disturbance.r,
    )
    return disturbed, after.rotors


def rotors_after(
    rotors: RotorSpeed, command: RotorSpeed | Throttle, span: Span, model_parameters: ModelParameters
) -> RotorSpeed:
    """Return the rotor speeds at the end of an integration step, after their first-order lag."""
    target = steady_rotor_speed(command, span, model_parameters)
    lags = decay_factors(rotors, target, span.span, model_parameters.parameters, model_parameters.effects.spin_down)
    return lagged_speeds(rotors, target, lags)


def specific_force(
    body: State,
    rotors: RotorSpeed,
    command: RotorSpeed | Throttle,
    wind: Wind,
    disturbance: Disturbance,
    span: Span,
    model_parameters: ModelParameters,
    frame: DisturbanceFrame,
) -> SpecificForce:
    """Return the specific force that an ideal accelerometer at the centre of mass measures."""
    parameters, effects, response = model_parameters
    rotor_inputs = rotor_state(rotors, steady_rotor_speed(command, span, model_parameters), parameters, effects)
    axes = BodyAxes.of(body.roll, body.pitch, body.yaw)
    motion = Motion.of(body) if response is None else Motion(body.v_x, body.v_y, body.v_z, 0.0, 0.0, 0.0)
    rates = accelerations(axes, motion, None, body.z, rotor_inputs, wind, parameters, effects).motion
    force_in_world = Vector(rates.v_x, rates.v_y, rates.v_z + parameters.gravity)
    if frame == "body":
        return SpecificForce(*plus(axes.in_body(force_in_world), disturbance.force))
    return SpecificForce(*axes.in_body(plus(force_in_world, disturbance.force)))


def measured_attitude(attitude: Attitude, misalignment: Attitude) -> Attitude:
    """Return the attitude of the markers' frame in W, given the attitude of B in W and the misalignment."""
    return attitude_of_markers(attitude, BodyAxes.of(misalignment.roll, misalignment.pitch, misalignment.yaw))


def steady_rotor_speed(command: RotorSpeed | Throttle, span: Span, model_parameters: ModelParameters) -> RotorSpeed:
    """Return the rotor speeds in the steady state. At a given throttle, they are proportional to the voltage."""
    state = VehicleState(State(*(0.0,) * NUM_BODY), RotorSpeed(*(0.0,) * NUM_ROTORS))
    target = rotor_target(state, command, model_parameters.parameters, None, model_parameters.effects, 0.0)
    return RotorSpeed(*(span.voltage * speed for speed in target))


def thrust_of_fraction(record: FlightRecord, weight: float) -> np.ndarray:
    """Return the commanded thrust (n,), N, of a log that contains the autopilot's estimate of its hover thrust.

    Args:
        record: record with thrust_fraction and hover_thrust_fraction.
        weight: weight of the vehicle, N.

    Raises:
        InputError: if hover_thrust_fraction is not positive in all samples.
    """
    hover = record.of("hover_thrust_fraction")
    if np.any(hover <= 0.0):
        raise InputError(
            f"hover_thrust_fraction of the log {short_repr(record.name)} is zero or negative; it must be positive"
        )
    return np.asarray(weight * record.of("thrust_fraction") / hover)


def with_commands(record: FlightRecord, scenario: Scenario, nominal: Scenario) -> FlightRecord:
    """Return a record with the commands that the vehicle takes as input.

    These are `motor_command` for a vehicle with throttles, and otherwise `rotor_speed_command`. With an attitude
    response, `attitude_command` is added. If the log lacks the commands of the rotors, they are allocated as in the
    firmware, from the logged thrust and torque, or with an attitude response from the thrust alone. If the autopilot
    logs its estimate of the hover thrust, the commanded thrust is divided by this estimate and multiplied by the
    weight, so that the discharge of the battery does not distort the thrust curve.

    Args:
        record: record of the flight.
        scenario: scenario with the vehicle that takes the commands.
        nominal: scenario whose `nominal` vehicle the allocation of the firmware uses.

    Raises:
        InputError: if the log has no commands for this vehicle.
    """
    throttles, responds = scenario.vehicle.motors.take_throttles, scenario.laboratory.autopilot.models_vehicle
    signal = "motor_command" if throttles else "rotor_speed_command"
    if responds:
        record = replace(record, attitude_command=np.unwrap(record.of("attitude_command"), axis=0))
    if getattr(record, signal) is not None:
        return record
    thrust, torque = record.thrust_command, record.torque_command
    if throttles and responds and record.thrust_fraction is not None:
        if record.hover_thrust_fraction is None:
            return replace(record, motor_command=np.repeat(record.thrust_fraction[:, None], NUM_ROTORS, axis=1))
        thrust = thrust_of_fraction(record, nominal.nominal.mass * nominal.nominal.gravity)
    if thrust is None or (torque is None and not responds):
        logged_kind = {"rotor_speed_command": "throttles", "motor_command": "speeds"}[signal]
        has_rotor_commands = record.motor_command is not None or record.rotor_speed_command is not None
        hint = (
            f"; the log has {logged_kind}: use a vehicle whose vehicle.motors take them" if has_rotor_commands else ""
        )
        needed = f"{signal}, or thrust_command" + ("" if responds else " and torque_command")
        raise InputError(
            f"the log {short_repr(record.name)} has no commands for the vehicle {scenario.name}: the vehicle needs"
            f" {needed}, but the log contains {', '.join(record.names)}{hint}"
        )
    torques = np.zeros((len(record.time), 3)) if responds or torque is None else torque
    commands: Any = allocated_commands(thrust, torques, nominal, throttles=throttles)
    return replace(record, **{signal: commands})


def relative_voltage(record: FlightRecord, model: "LogModel") -> np.ndarray:
    """Return the battery voltage (n,), averaged over a tenth of a second, divided by `LogModel.voltage`.

    The result is 1 if no voltage is logged, or if the rotor speed does not depend on the voltage.
    """
    if record.battery_voltage is None or model.voltage is None:
        return np.ones(len(record.time))
    width = max(1, round(_VOLTAGE_WINDOW / record.period)) // 2 * 2 + 1
    padded = np.pad(record.battery_voltage, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1.0 / width), "valid") / model.voltage


def level_vehicle(scenario: Scenario) -> Scenario:
    """Return the scenario with a vehicle that always stays level, for logs that contain heights but no attitude."""
    angles = (_LEVEL_FREQUENCY,) * 3
    autopilot = AttitudeResponseSettings(kind="response", natural_frequency=angles, damping=(1.0, 1.0, 1.0))
    laboratory = scenario.laboratory.model_copy(update={"autopilot": autopilot})
    return scenario.model_copy(update={"laboratory": laboratory})


class LogModel:
    """Model of the vehicle as a function of p parameters.

    Args:
        scenario: scenario without distributions, with the vehicle and its autopilot.
        names: names of the parameters, as in `Estimates`, and `DELAY`.
        frame: axes along which the disturbing force is constant during a step.
        delay: delay if it is not a parameter, s.
        voltage: voltage at which the rotors reach their commanded speed, or for which the thrust curve holds, V; None
            if the rotor speed does not depend on the voltage.
    """

    def __init__(
        self,
        scenario: Scenario,
        names: Sequence[str],
        *,
        frame: DisturbanceFrame = "world",
        delay: float = 0.0,
        voltage: float | None = None,
    ) -> None:
        self.scenario, self.names, self.frame = scenario, tuple(names), frame
        self.takes_throttles = scenario.vehicle.motors.take_throttles
        self.has_attitude_response = scenario.laboratory.autopilot.models_vehicle
        self._delay, self.voltage = delay, voltage
        self._paths = {
            scenario_path(name): i for i, name in enumerate(names) if name != DELAY and name not in MISALIGNMENT
        }
        command = layout_of(Throttle if self.takes_throttles else RotorSpeed)
        model_parameters = self.physical_parameters(np.empty((1, len(names))) + 1.0)
        self.layout = layout_of(ModelParameters, model_parameters)
        body, rotors, span, wind = (layout_of(kind) for kind in (State, RotorSpeed, Span, Wind))
        disturbance, force, attitude = (layout_of(kind) for kind in (Disturbance, SpecificForce, Attitude))
        inputs = body, rotors, command, attitude, wind, disturbance, span, self.layout, frame
        self.step = kernel(step, inputs, (body, rotors), single_vehicle=False)
        self.rotors_after = kernel(rotors_after, (rotors, command, span, self.layout), (rotors,), single_vehicle=False)
        self.steady_rotor_speed = kernel(
            steady_rotor_speed, (command, span, self.layout), (rotors,), single_vehicle=False
        )
        without_attitude = body, rotors, command, wind, disturbance, span, self.layout, frame
        self.specific_force = kernel(specific_force, without_attitude, (force,), single_vehicle=False)
        self.measured_attitude = kernel(measured_attitude, (attitude, attitude), (attitude,), single_vehicle=False)

    @property
    def command_signal(self) -> str:
        """Name of the logged signal with the rotor commands."""
        return "motor_command" if self.takes_throttles else "rotor_speed_command"

    @property
    def delay_index(self) -> int | None:
        """Index of the delay among the parameters; None if it is fixed."""
        return self.names.index(DELAY) if DELAY in self.names else None

    def physical_parameters(self, parameters: np.ndarray) -> ModelParameters:
        """Return the parameters of the vehicle for (K, p) estimated parameters. Each is a scalar or a (K,) array."""
        scenario = map_leaves(
            self.scenario, lambda path, value: parameters[:, self._paths[path]] if path in self._paths else value
        )
        response = None
        if self.has_attitude_response:
            autopilot = scenario.laboratory.autopilot
            frequency, damping = autopilot.natural_frequency, autopilot.damping
            response = AttitudeResponse(NaturalFrequencies(*frequency), DampingRatios(*damping))
        return ModelParameters(vehicle_parameters(scenario.vehicle), scenario.vehicle.effect_parameters(), response)

    def misalignment(self, parameters: np.ndarray) -> np.ndarray:
        """Return roll, pitch and yaw (3, K) of the markers' frame in B for (K, p) parameters."""
        defaults = self.scenario.laboratory.motion_capture.misalignment
        angles = [
            parameters[:, self.names.index(name)]
            if name in self.names
            else np.full(len(parameters), default, dtype=float)
            for name, default in zip(MISALIGNMENT, defaults, strict=True)
        ]
        return np.stack(angles)

    def delays(self, parameters: np.ndarray) -> np.ndarray:
        """Return the delays (K,) of the commands for (K, p) parameters, s."""
        index = self.delay_index
        return np.full(len(parameters), self._delay) if index is None else parameters[:, index]

    def measured_state(self, state: np.ndarray) -> np.ndarray:
        """Return the states (12, S) that motion capture would measure, with the misalignment of the scenario."""
        if self.has_attitude_response:
            state = np.stack(state_from_body(AttitudeResponseBody(*state), small_rotation))
        misalignment = np.array(self.scenario.laboratory.motion_capture.misalignment, dtype=float)
        if not misalignment.any():
            return state
        body_from_markers = rotation_matrices(misalignment)
        position, attitude, *rest = np.split(state, len(STATE_ROWS))
        angles = (rotation_matrices(attitude.T) * body_from_markers).as_euler("ZYX").T[::-1]
        return np.concatenate([position, angles, *rest])


class WindowInputs(NamedTuple):
    """Inputs of the model in W windows, in T steps from the beginning of the warm-up to the end of each window.

    Attributes:
        commands: (T + 2 · margin, 7, W) commands of rotors and attitude, including `margin` further steps at both ends.
        wind: (T, 3, W) velocity of the air, m/s.
        spans: (T, 2, W) durations of the steps, s, and battery voltages divided by the voltage of the thrust curve.
        period: median duration of a step, s.
        margin: largest delay, in steps.
    """

    commands: np.ndarray
    wind: np.ndarray
    spans: np.ndarray
    period: float
    margin: int

    @classmethod
    def of(
        cls,
        records: Sequence[FlightRecord],
        model: LogModel,
        windows: Sequence[LogWindow],
        sizes: WindowSizes,
        *,
        split: int,
        max_delay: float,
    ) -> "WindowInputs":
        """Return the inputs in windows of the records.

        Args:
            records: records that contain the windows, with the commands of the model, see `with_commands`.
            model: model that takes the inputs.
            windows: W windows.
            sizes: sizes of the windows.
            split: number of steps per sample.
            max_delay: largest delay, s, from a command to the measurement, or from a measurement to the command.
        """
        period = float(np.median([record.period for record in records])) / split
        margin = int(np.ceil(max_delay / period)) + 2
        first = -split * (sizes.settle + sizes.warm_up) - margin
        offsets = np.arange(first, split * sizes.length + margin) // split
        default_wind = np.asarray(steady_wind(model.scenario.laboratory.wind), dtype=float)
        rows, winds, spans = [], [], []
        for record in records:
            voltage = relative_voltage(record, model)
            steps = np.diff(record.time, append=record.time[-1] + record.period)
            size = len(steps)
            attitude = record.of("attitude_command") if model.has_attitude_response else np.zeros((size, 3))
            rows.append(np.hstack([record.of(model.command_signal), attitude]))
            winds.append(np.tile(default_wind, (size, 1)) if record.wind is None else record.wind)
            spans.append(np.column_stack([np.minimum(steps, 3.0 * split * period) / split, voltage]))
        index = [(log, np.clip(start + offsets, 0, len(spans[log]) - 1)) for log, start in windows]
        inner = slice(margin, -margin)
        commands = np.stack([rows[log][samples] for log, samples in index], axis=2)
        wind = np.stack([winds[log][samples[inner]] for log, samples in index], axis=2)
        step_spans = np.stack([spans[log][samples[inner]] for log, samples in index], axis=2)
        return cls(commands, wind, step_spans, period, margin)


class ModelFlight:
    """Flight of the model in W windows at once, for K sets of parameters.

    A state (NUM_BODY + NUM_DISTURBANCE, K, W) contains the components of the body, and then those of the disturbance.

    Args:
        model: model of the vehicle.
        parameters: (K, p) parameters.
        inputs: inputs in the windows.
        warm_up: number of steps during which only the rotors follow their commands.
    """

    def __init__(self, model: LogModel, parameters: np.ndarray, inputs: WindowInputs, warm_up: int) -> None:
        self.model, self.parameters = model, parameters
        count, windows = len(parameters), inputs.commands.shape[2]
        self.shape, self._size = (count, windows), count * windows
        model_parameters = model.layout.flatten(model.physical_parameters(parameters))
        rows = [np.broadcast_to(np.asarray(row, float), (count,)) for row in model_parameters]
        self._numbers = np.repeat(np.array(rows), windows, axis=1).ravel()
        self._misalignment = np.repeat(model.misalignment(parameters), windows, axis=1).ravel()
        delay_steps = model.delays(parameters) / inputs.period
        self._lags = np.floor(delay_steps).astype(int)
        self._fractions = (delay_steps - self._lags)[:, None, None]
        self._inputs, self._step_index = inputs, 0
        self._rotors = np.empty(NUM_ROTORS * self._size)
        self._command = np.empty((inputs.commands.shape[1], count, windows))
        self._span, self._wind = np.empty((2, count, windows)), np.empty((3, count, windows))
        self._read_inputs()
        self._run(model.steady_rotor_speed, self._rotors, self._rotor_command, self._span)
        for _ in range(warm_up):
            self._run(model.rotors_after, self._rotors, self._rotors, self._rotor_command, self._span)
            self._next()

    @property
    def _rotor_command(self) -> np.ndarray:
        return self._command[:NUM_ROTORS]

    def _run(self, formula: Any, *rows: np.ndarray) -> None:
        """Evaluate a formula of the model. `rows` are its output arrays, which are overwritten, and then its inputs."""
        formula(self._size, 0.0, *(each.reshape(-1) for each in rows), self._numbers)

    def _read_inputs(self) -> None:
        """Read the commands, the wind and the duration of the current step."""
        commands, now = self._inputs.commands, self._step_index + self._inputs.margin - self._lags
        delayed = (1.0 - self._fractions) * commands[now] + self._fractions * commands[now - 1]
        self._command[:] = delayed.swapaxes(0, 1)
        step = min(self._step_index, len(self._inputs.spans) - 1)
        self._span[:], self._wind[:] = self._inputs.spans[step][:, None, :], self._inputs.wind[step][:, None, :]

    def _next(self) -> None:
        self._step_index += 1
        self._read_inputs()

    def step(self, state: np.ndarray) -> None:
        """Advance the state of the model by one step, with a constant disturbance."""
        body, disturbance = state[:NUM_BODY], state[NUM_BODY:]
        inputs = (
            body,
            self._rotors,
            self._rotor_command,
            self._command[NUM_ROTORS:],
            self._wind,
            disturbance,
            self._span,
        )
        self._run(self.model.step, body, self._rotors, *inputs)
        self._next()

    def specific_force(self, state: np.ndarray) -> np.ndarray:
        """Return the specific force (3, K, W) in a state, m/s², for K parameter vectors and W windows."""
        force = np.empty((3, *self.shape))
        inputs = state[:NUM_BODY], self._rotors, self._rotor_command, self._wind, state[NUM_BODY:], self._span
        self._run(self.model.specific_force, force, *inputs)
        return force

    def measured_attitude(self, state: np.ndarray) -> np.ndarray:
        """Return roll, pitch and yaw (3, K, W) that motion capture measures in a state, for its misaligned markers."""
        row = STATE_ROWS["attitude"]
        attitude = state[row : row + 3]
        if not self._misalignment.any():
            return attitude
        measured = np.empty(3 * self._size)
        self.model.measured_attitude(self._size, 0.0, measured, attitude.reshape(-1), self._misalignment)
        return measured.reshape(3, *self.shape)
