"""A vehicle of the library, driven open loop by the commands of a log: many starts and many sets of numbers at once.

The formulas are those that fly, `quadrotor_step` or, behind an autopilot whose attitude responds as a whole,
`responding_step`, in machine code. Commands hold until the next sample and act a delay D later; over a step from t to
t + h the vehicle is given their mean,

    ū = 1/h ∫ u(s - D) ds  over s from t to t + h,

which is exact for what is linear in them, and has a derivative by D. Before a start the rotors follow the commands from
`_WARM` on, so that their speeds are known there.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from drake_quad.assembly.laboratory import vehicle_parameters
from drake_quad.errors import InputError, shown
from drake_quad.framework.formulas import kernel
from drake_quad.framework.records import layout_of
from drake_quad.geometry.kinematics import small_rotation
from drake_quad.identification.firmware import allocated_commands
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.results.estimates import scenario_path
from drake_quad.scenario.autopilots.response import AttitudeResponseSettings as ResponseOfScenario
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import replaced
from drake_quad.scenario.winds.source import steady_wind
from drake_quad.signals import Attitude, AttitudeTarget, RotorSpeed, Row, State, Throttle, Wind
from drake_quad.vehicle.attitude_kinematics import RIGID_KINEMATICS
from drake_quad.vehicle.effects import Effects
from drake_quad.vehicle.motors import decays, lagging
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.responding import (
    AttitudeResponse,
    DampingRatios,
    NaturalFrequencies,
    RespondingBody,
    RespondingState,
    responding_step,
    shown_state,
)
from drake_quad.vehicle.stepping import VehicleState, rotor_target, step_of_flight

# Before a start, s: five times the lag of the slowest rotors.
_WARM = 0.7
# After the beginning of a log or a gap, s: commands before it are not known, and rotors still follow them.
UNKNOWN = 0.4
# Longest step, s.
_STEP = 0.01
# Natural frequency of a vehicle that stays level, rad/s; any does.
_LEVEL = 20.0
DELAY = "laboratory.command_link.delay_ticks"


class _Span(NamedTuple):
    """How long a step is, s."""

    time: Row


class _Numbers(NamedTuple):
    """Of a vehicle."""

    parameters: QuadrotorParameters
    effects: Effects


class _RespondingNumbers(NamedTuple):
    """Of a vehicle behind its autopilot."""

    parameters: QuadrotorParameters
    effects: Effects
    response: AttitudeResponse


class _Step(NamedTuple):
    body: State
    rotors: RotorSpeed


def _rotors_after(
    rotors: RotorSpeed, command: RotorSpeed | Throttle, span: _Span, numbers: _Numbers | _RespondingNumbers
) -> RotorSpeed:
    """The rotors at the end of a step."""
    target = _target(command, numbers)
    return lagging(rotors, target, decays(rotors, target, span.time, numbers.parameters, numbers.effects.spin_down))


def _target(command: RotorSpeed | Throttle, numbers: _Numbers | _RespondingNumbers) -> RotorSpeed:
    """Where the rotors go."""
    state = VehicleState(State(*[0.0] * 12), RotorSpeed(*[0.0] * 4))
    return rotor_target(state, command, numbers.parameters, None, numbers.effects, 0.0)


def _rigid_step(
    body: State, rotors: RotorSpeed, command: RotorSpeed | Throttle, wind: Wind, span: _Span, numbers: _Numbers
) -> _Step:
    """Return the vehicle at the end of a step from time 0 on.

    A payload that is dropped later is present in every step.
    """
    (h,) = span
    before, target = VehicleState(body, rotors), _target(command, numbers)
    after = step_of_flight(before, target, wind, numbers.parameters, numbers.effects, h, h, RIGID_KINEMATICS)
    return _Step(after.body, after.rotors)


def _responding_step(
    body: RespondingBody,
    rotors: RotorSpeed,
    command: RotorSpeed | Throttle,
    target: Attitude,
    wind: Wind,
    span: _Span,
    numbers: _RespondingNumbers,
) -> RespondingState:
    """The vehicle behind its autopilot at the end of a step."""
    wanted = AttitudeTarget(0.0, *target, 0.0, 0.0, 0.0)
    parameters, effects, response = numbers
    rest = wind, None, parameters, response, None, effects, 0.0, span.time, "exact"
    return responding_step(body, rotors, command, wanted, *rest)  # type: ignore[arg-type]


class Commands(NamedTuple):
    """What drives a vehicle.

    Attributes:
        rotors: (n, 4) speeds, rad/s, or throttles.
        throttles: whether they are throttles.
        attitude: (n, 3) roll, pitch, yaw, rad, of an autopilot; None if rotors alone turn the vehicle.
    """

    rotors: np.ndarray
    throttles: bool
    attitude: np.ndarray | None


def commands_of(record: FlightRecord, vehicle: Scenario, believed: Scenario) -> Commands:
    """Return the commands of a log in the form that a vehicle takes as input.

    The commands are those of the rotors or motors if they are logged. Otherwise the firmware's allocation converts the
    logged thrust and torque, or the thrust alone behind an autopilot, to rotor speeds or throttles. If the autopilot
    logs its estimate of the hover thrust as a share of full thrust, commanded shares are converted to multiples of the
    weight. A battery that discharges then does not distort the thrust curve.

    Args:
        record: record of the flight.
        vehicle: scenario of the vehicle that takes the commands; with an attitude response it takes attitude commands.
        believed: scenario whose `nominal` vehicle the firmware's allocation uses.

    Raises:
        InputError: if the log does not contain commands for this vehicle, or its hover thrust is not positive.
    """
    responds = vehicle.laboratory.autopilot.models_vehicle
    throttles = vehicle.vehicle.motors.take_throttles
    attitude = np.unwrap(record.of("attitude_command"), axis=0) if responds else None
    if throttles and record.motor_command is not None:
        return Commands(record.motor_command, True, attitude)
    if throttles and responds and record.thrust_share is not None and record.hover_share is not None:
        thrust = thrust_by_share(record, believed.nominal.mass * believed.nominal.gravity)
        commands = allocated_commands(thrust, np.zeros((len(thrust), 3)), believed, throttles=True)
        return Commands(commands, True, attitude)
    if throttles and responds and record.thrust_share is not None:
        return Commands(np.repeat(record.thrust_share[:, None], 4, axis=1), True, attitude)
    if not throttles and record.rotor_speed_command is not None:
        return Commands(record.rotor_speed_command, False, attitude)
    if record.thrust_command is not None and (responds or record.torque_command is not None):
        torque = np.zeros((len(record.time), 3)) if record.torque_command is None else record.torque_command
        if responds:
            torque = np.zeros_like(torque)
        commands = allocated_commands(record.thrust_command, torque, believed, throttles=throttles)
        return Commands(commands, throttles, attitude)
    wanted = "motor_command" if throttles else "rotor_speed_command"
    also = (
        " (a vehicle that takes motor commands has motors: {kind: throttle})"
        if record.motor_command is not None
        else ""
    )
    raise InputError(
        f"the log {shown(record.name)} has no commands that drive the vehicle {vehicle.name}: it needs {wanted}, or"
        f" thrust_command{'' if responds else ' and torque_command'}, and has {', '.join(record.names)}{also}"
    )


def thrust_by_share(record: FlightRecord, weight: float) -> np.ndarray:
    """(n,) thrust, N, of a log with the share of full thrust at which the autopilot takes the vehicle to hover.

    Args:
        record: with thrust_share and hover_share.
        weight: of the vehicle, N.

    Raises:
        InputError: the share of hover is zero or less.
    """
    hover = record.of("hover_share")
    if np.any(hover <= 0.0):
        raise InputError(f"the log {shown(record.name)} has a hover_share of zero or less")
    return np.asarray(weight * record.of("thrust_share") / hover)


def level_vehicle(vehicle: Scenario) -> Scenario:
    """A vehicle that stays level, whatever its rotors do: they only lift it."""
    angles = (_LEVEL, _LEVEL, _LEVEL)
    autopilot = ResponseOfScenario(kind="response", natural_frequency=angles, damping=(1.0, 1.0, 1.0))
    laboratory = vehicle.laboratory.model_copy(update={"autopilot": autopilot})
    return vehicle.model_copy(update={"laboratory": laboratory})


def with_level_commands(record: FlightRecord) -> FlightRecord:
    """A record of a vehicle that shall stay level."""
    return replace(record, attitude_command=np.zeros((len(record.time), 3)))


class Starts(NamedTuple):
    """Where flights begin.

    Attributes:
        samples: (W,) of the log.
        length: of each, samples.
    """

    samples: np.ndarray
    length: int


def delay_of(scenario: Scenario, ticks: Any = None) -> Any:
    """From a command to what is measured of it, s: what the link takes, and how old a frame of the cameras is.

    Args:
        scenario: with numbers.
        ticks: of the link in the place of those of the scenario.
    """
    laboratory = scenario.laboratory
    cameras, link = laboratory.motion_capture, laboratory.command_link
    return (link.delay_ticks if ticks is None else ticks) * link.period + (1 + cameras.latency_frames) * cameras.period


class _Steps(NamedTuple):
    """Steps of windows.

    Attributes:
        commands: (T, parts, c, D, W) means over parts of a step, for D delays.
        lengths: (T, W) of a part, s.
        wind: (T, 3, W) m/s.
    """

    commands: np.ndarray
    lengths: np.ndarray
    wind: np.ndarray


class OpenLoop:
    """A vehicle driven by the commands of a log.

    Args:
        vehicle: a scenario whose vehicle, and whose autopilot if it is a response, fly; numbers only.
        record: of the flight.
        believed: whose `nominal` vehicle the firmware's allocation knows; by default that of `vehicle`.
        delay: of the commands, s.

    Raises:
        InputError: the log has no commands that drive this vehicle.
    """

    def __init__(
        self, vehicle: Scenario, record: FlightRecord, *, believed: Scenario | None = None, delay: float = 0.0
    ) -> None:
        self._scenario, self._record, self._delay = vehicle, record, delay
        self.commands = commands_of(record, vehicle, believed or vehicle)
        self.responds = self.commands.attitude is not None
        self._parts = max(1, math.ceil(record.period / _STEP - 1e-6))
        steps = np.diff(record.time, append=record.time[-1] + record.period)
        self._ends = np.append(record.time, record.time[-1] + record.period)
        rows = (
            [self.commands.rotors] if self.commands.attitude is None else [self.commands.rotors, self.commands.attitude]
        )
        every = np.concatenate(rows, axis=1)
        self._integral = np.concatenate([np.zeros((1, every.shape[1])), np.cumsum(every * steps[:, None], axis=0)])
        wind = np.asarray(steady_wind(vehicle.laboratory.wind), dtype=float)
        self._wind = np.tile(wind, (len(record.time), 1)) if record.wind is None else record.wind

    def fly(
        self, starts: Starts, bodies: np.ndarray, numbers: Mapping[str, np.ndarray] | None = None, *, every: int = 1
    ) -> np.ndarray:
        """Flies from each start with each set of numbers.

        Args:
            starts: of the log.
            bodies: (K, W, 12) states there, in the order of `State`; behind an autopilot, rates of the angles in the
                place of body rates.
            numbers: (K,) of each name, as in `Estimates`, in the place of those of the vehicle.
            every: how many samples there are from one that is returned to the next.

        Returns:
            (T, K, W, 12) from the start on.
        """
        count, windows = bodies.shape[:2]
        numbers = numbers or {}
        rows = count * windows
        layout, flat = self._flat(numbers, count, windows)
        ticks = numbers.get(DELAY)
        delay = (
            np.full(count, self._delay) if ticks is None else delay_of(self._scenario, np.broadcast_to(ticks, (count,)))
        )
        step, rotors_after, target = _kernels(layout, self.commands.throttles, self.responds)
        body = np.moveaxis(bodies, 2, 0).flatten()
        rotors = np.empty(4 * rows)
        different, which = np.unique(delay, return_inverse=True)

        def told(mean: np.ndarray) -> np.ndarray:
            return np.ascontiguousarray(mean[:, which]).ravel()

        before = self._steps(starts.samples, np.arange(-math.ceil(_WARM / self._record.period), 0), 1, different)
        target(rows, 0.0, rotors, told(before.commands[0, 0, :4]), flat)
        for mean, length in zip(before.commands[:, 0, :4], before.lengths, strict=True):
            rotors_after(rows, 0.0, rotors, rotors, told(mean), np.tile(length, count), flat)
        steps = self._steps(starts.samples, np.arange(starts.length), self._parts, different)
        found = np.empty((starts.length // every + 1, 12, rows))
        found[0] = body.reshape(12, rows)
        for number, (means, length, wind) in enumerate(zip(*steps, strict=True)):
            span = np.tile(length, count)
            air = np.ascontiguousarray(np.broadcast_to(wind[:, None, :], (3, count, windows))).ravel()
            for mean in means:
                arguments = [told(mean[:4])] if not self.responds else [told(mean[:4]), told(mean[4:])]
                step(rows, 0.0, body, rotors, body, rotors, *arguments, air, span, flat)
            if (number + 1) % every == 0:
                found[(number + 1) // every] = body.reshape(12, rows)
        return np.moveaxis(found.reshape(-1, 12, count, windows), 1, 3)

    def shown(self, bodies: np.ndarray) -> np.ndarray:
        """(..., 12) states in the order of `State`, of what `fly` takes and returns."""
        if not self.responds:
            return bodies
        rows: Any = np.moveaxis(bodies, -1, 0)
        return np.stack(shown_state(RespondingBody(*rows), small_rotation), axis=-1)

    def _steps(self, samples: np.ndarray, numbers: np.ndarray, parts: int, delays: np.ndarray) -> "_Steps":
        """What happens in steps that are counted from each start, for some delays."""
        at = np.clip(samples[None, :] + numbers[:, None], 0, len(self._record.time) - 1)
        lengths = (self._ends[at + 1] - self._ends[at]) / parts
        begins = self._ends[at][:, None, :] + np.arange(parts)[None, :, None] * lengths[:, None, :]
        low = self._integrated(begins[:, :, None, :] - delays[:, None])
        high = self._integrated((begins + lengths[:, None, :])[:, :, None, :] - delays[:, None])
        means = np.moveaxis((high - low) / lengths[:, None, None, :, None], -1, 2)
        return _Steps(means, lengths, np.moveaxis(self._wind[at], 2, 1))

    def _integrated(self, time: np.ndarray) -> np.ndarray:
        """(..., c) integrals of the commands until some times, before the log as at its first sample."""
        place = np.clip(np.searchsorted(self._ends, time, side="right") - 1, 0, len(self._record.time) - 1)
        share = (time - self._ends[place]) / (self._ends[place + 1] - self._ends[place])
        return np.asarray(
            self._integral[place] + share[..., None] * (self._integral[place + 1] - self._integral[place])
        )

    def _flat(self, numbers: Mapping[str, np.ndarray], count: int, windows: int) -> tuple[Any, np.ndarray]:
        """The layout of the numbers, and their rows for all copies."""
        values = {scenario_path(name): value for name, value in numbers.items() if name != DELAY}
        own = replaced(self._scenario.vehicle, lambda path, old: values.get(path, old), "vehicle")
        parameters, effects = vehicle_parameters(own), own.effect_numbers()
        record: Any = _Numbers(parameters, effects)
        autopilot: Any = self._scenario.laboratory.autopilot
        if self.responds:
            autopilot = replaced(autopilot, lambda path, old: values.get(path, old), "laboratory.autopilot")
            response = AttitudeResponse(
                NaturalFrequencies(*autopilot.natural_frequency), DampingRatios(*autopilot.damping)
            )
            record = _RespondingNumbers(parameters, effects, response)
        layout = layout_of(type(record), record)
        rows = np.array([np.broadcast_to(np.asarray(row, float), (count,)) for row in layout.flatten(record)])
        return layout, np.ascontiguousarray(np.repeat(rows, windows, axis=1)).ravel()


def _kernels(numbers: Any, throttles: bool, responds: bool) -> Sequence[Any]:
    """Machine code of a step, of the rotors alone, and of where they go."""
    command = layout_of(Throttle if throttles else RotorSpeed)
    body, rotors, wind, span = (
        layout_of(kind) for kind in (RespondingBody if responds else State, RotorSpeed, Wind, _Span)
    )
    if responds:
        arguments: tuple[Any, ...] = (body, rotors, command, layout_of(Attitude), wind, span, numbers)
        step = kernel(_responding_step, arguments, (body, rotors), lone=False)
    else:
        step = kernel(_rigid_step, (body, rotors, command, wind, span, numbers), (body, rotors), lone=False)
    after = kernel(_rotors_after, (rotors, command, span, numbers), (rotors,), lone=False)
    return step, after, kernel(_target, (command, numbers), (rotors,), lone=False)
