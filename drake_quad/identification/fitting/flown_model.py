"""The vehicle of the library as the model of a log: the formulas that fly, for windows and sets of parameters at once.

What the numbers do not say acts as a disturbance: an angular acceleration about the axes of B, and a specific force,
along the axes of W where attitudes are logged, else along those of B. A vehicle leans into the wind: along the axes of
B the force of wind would have a part along the thrust, always of one sign.

The commands act after a delay. A command that is held between samples and comes late by n + f samples
is over a step in the mean

    (1 - f) u[k - n] + f u[k - n - 1],  0 ≤ f < 1

which is what rotors feel of it to first order of the step over their lag, and continuous in the delay.
"""

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from drake_quad.assembly.laboratory import vehicle_parameters
from drake_quad.framework.formulas import kernel
from drake_quad.framework.records import Layout, layout_of
from drake_quad.geometry.axes import BodyAxes, Vector, plus
from drake_quad.identification.fitting.windows import Cut, LogWindow
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.laboratory.sensors.accelerometer import SpecificForce
from drake_quad.scenario.paths import replaced
from drake_quad.signals import AccelerationB, BodyAccelerationB, RotorSpeed, State, Throttle, Time, Wind
from drake_quad.vehicle.attitude_kinematics import RIGID_KINEMATICS
from drake_quad.vehicle.dynamics import Motion
from drake_quad.vehicle.effects import Effects
from drake_quad.vehicle.motion import accelerations, turning
from drake_quad.vehicle.motors import decays, lagging
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.stepping import VehicleState, rotor_target, step_of_flight

BODY = len(State._fields)
PUSH = 6
ROTORS = len(RotorSpeed._fields)
_STILL = Wind(0.0, 0.0, 0.0)
_NOWHERE = State(*(0.0,) * BODY)

# Where the signals of a record stand among the rows of a state.
ROWS = {"position": 0, "attitude": 3, "velocity": 6, "body_rates": 9}

DELAY = "delay"

DisturbanceKind = Literal["world", "body"]


class Disturbance(NamedTuple):
    """What the numbers of a vehicle do not say: a specific force, and an angular acceleration about the axes of B."""

    x: AccelerationB
    y: AccelerationB
    z: AccelerationB
    p: BodyAccelerationB
    q: BodyAccelerationB
    r: BodyAccelerationB


class Span(NamedTuple):
    """How long a step takes."""

    span: Time


class Numbers(NamedTuple):
    """The numbers of a vehicle."""

    parameters: QuadrotorParameters
    effects: Effects


class ModelStep(NamedTuple):
    """The vehicle at the end of a step."""

    body: State
    rotors: RotorSpeed


def step(
    body: State,
    rotors: RotorSpeed,
    command: RotorSpeed | Throttle,
    disturbance: Disturbance,
    span: Span,
    numbers: Numbers,
    kind: DisturbanceKind,
) -> ModelStep:
    """Return the vehicle at the end of a step from time 0 on, during which a disturbance is constant.

    A payload that is dropped later is present in every step.
    """
    (h,) = span
    parameters, effects = numbers
    target = _target(rotors, command, numbers)
    before = VehicleState(body, rotors)
    after = step_of_flight(before, target, _STILL, parameters, effects, h, h, RIGID_KINEMATICS)
    push = Vector(disturbance.x, disturbance.y, disturbance.z)
    if kind == "body":
        push = BodyAxes.of(body.roll, body.pitch, body.yaw).in_world(push)
    moved = after.body
    half = 0.5 * h * h
    pushed = moved._replace(
        x=moved.x + half * push.x,
        y=moved.y + half * push.y,
        z=moved.z + half * push.z,
        v_x=moved.v_x + h * push.x,
        v_y=moved.v_y + h * push.y,
        v_z=moved.v_z + h * push.z,
        p=moved.p + h * disturbance.p,
        q=moved.q + h * disturbance.q,
        r=moved.r + h * disturbance.r,
    )
    return ModelStep(pushed, after.rotors)


def rotors_after(rotors: RotorSpeed, command: RotorSpeed | Throttle, span: Span, numbers: Numbers) -> RotorSpeed:
    """The rotors at the end of a step."""
    target = _target(rotors, command, numbers)
    lags = decays(rotors, target, span.span, numbers.parameters, numbers.effects.spin_down)
    return lagging(rotors, target, lags)


def rotors_at_rest(command: RotorSpeed | Throttle, numbers: Numbers) -> RotorSpeed:
    """The rotors a long time after a command."""
    return _target(RotorSpeed(0.0, 0.0, 0.0, 0.0), command, numbers)


def felt(
    body: State,
    rotors: RotorSpeed,
    command: RotorSpeed | Throttle,
    disturbance: Disturbance,
    numbers: Numbers,
    kind: DisturbanceKind,
) -> SpecificForce:
    """Return the specific force that an accelerometer at the centre of mass measures, m/s²."""
    parameters, effects = numbers
    turned = turning(rotors, _target(rotors, command, numbers), parameters, effects)
    axes = BodyAxes.of(body.roll, body.pitch, body.yaw)
    rates = accelerations(axes, Motion.of(body), None, body.z, turned, _STILL, parameters, effects).motion
    push, own = (
        Vector(disturbance.x, disturbance.y, disturbance.z),
        Vector(rates.v_x, rates.v_y, rates.v_z + parameters.gravity),
    )
    if kind == "body":
        return SpecificForce(*plus(axes.in_body(own), push))
    return SpecificForce(*axes.in_body(plus(own, push)))


def _target(rotors: RotorSpeed, command: RotorSpeed | Throttle, numbers: Numbers) -> RotorSpeed:
    state = VehicleState(_NOWHERE, rotors)
    return rotor_target(state, command, numbers.parameters, None, numbers.effects, 0.0)


class _Kernels(NamedTuple):
    """Machine code of the formulas, and how the numbers stand in its rows."""

    layout: Layout
    step: Callable[..., None]
    rotors_after: Callable[..., None]
    rotors_at_rest: Callable[..., None]
    felt: Callable[..., None]

    @classmethod
    def of(cls, command: type, example: Numbers, kind: DisturbanceKind) -> "_Kernels":
        numbers, told = layout_of(Numbers, example), layout_of(command)
        body, rotors, span = (layout_of(kind) for kind in (State, RotorSpeed, Span))
        push, force = layout_of(Disturbance), layout_of(SpecificForce)
        return cls(
            numbers,
            kernel(step, (body, rotors, told, push, span, numbers, kind), (body, rotors), lone=False),
            kernel(rotors_after, (rotors, told, span, numbers), (rotors,), lone=False),
            kernel(rotors_at_rest, (told, numbers), (rotors,), lone=False),
            kernel(felt, (body, rotors, told, push, numbers, kind), (force,), lone=False),
        )


class FlownVehicle:
    """A vehicle as a function of some of its numbers.

    Args:
        vehicle: of a scenario, of numbers.
        paths: in it of each parameter; all paths of one have its value. `DELAY` alone is no path.
        signal: of the commands in records: `motor_command` or `rotor_speed_command`.
        kind: along whose axes a force disturbs it, "world" or "body".
    """

    def __init__(self, vehicle: Any, paths: Sequence[Sequence[str]], signal: str, *, kind: DisturbanceKind) -> None:
        self.kind = kind
        self.vehicle, self.paths, self.signal = vehicle, [tuple(own) for own in paths], signal
        self.delay = next((i for i, own in enumerate(self.paths) if own == (DELAY,)), None)

    def numbers(self, parameters: np.ndarray) -> Numbers:
        """The numbers for (K, p) parameters, each a number or a (K,) array."""
        values = {path: parameters[:, i] for i, paths in enumerate(self.paths) for path in paths}
        vehicle = replaced(self.vehicle, lambda path, old: values.get(path, old))
        return Numbers(vehicle_parameters(vehicle), vehicle.effect_numbers())

    def delays(self, parameters: np.ndarray) -> np.ndarray:
        """(K,) delay of the commands, s."""
        return np.zeros(len(parameters)) if self.delay is None else parameters[:, self.delay]


class Inputs(NamedTuple):
    """What drives the windows, and when, in T steps from the beginning of the warm-up to the end of each window.

    Attributes:
        commands: (T + 2 · margin, 4, W), so many more at both ends.
        spans: (T, W) of the steps, s.
        period: of the steps, s.
        margin: how many steps a delay can be.
    """

    commands: np.ndarray
    spans: np.ndarray
    period: float
    margin: int

    @classmethod
    def of(
        cls,
        records: Sequence[FlightRecord],
        signal: str,
        windows: Sequence[LogWindow],
        sizes: Cut,
        *,
        split: int,
        longest: float,
    ) -> "Inputs":
        """The inputs of windows of records.

        Args:
            records: that the windows are of.
            signal: the commands.
            windows: W of them.
            sizes: of the windows.
            split: steps to a sample.
            longest: delay that is possible, to either side, s.
        """
        period = float(np.median([record.period for record in records])) / split
        margin = int(np.ceil(longest / period)) + 2
        first = -split * (sizes.settle + sizes.warm_up) - margin
        offsets = np.arange(first, split * sizes.length + margin) // split
        commands, spans = [], []
        for number, start in windows:
            record = records[number]
            steps = np.diff(record.time, append=record.time[-1] + record.period)
            index = np.clip(start + offsets, 0, len(steps) - 1)
            commands.append(record.of(signal)[index])
            spans.append(np.minimum(steps, 3.0 * split * period)[index][margin:-margin] / split)
        return cls(np.ascontiguousarray(np.stack(commands, axis=2)), np.stack(spans, axis=1), period, margin)


class Flown:
    """Vehicles in all windows at once, for K sets of parameters.

    Rows of the state are those of the body, then those of the disturbance: (BODY + PUSH, K, W).

    Args:
        vehicle: the model.
        parameters: (K, p).
        inputs: that drive it.
        warm_up: steps in which rotors follow their commands.
    """

    def __init__(self, vehicle: FlownVehicle, parameters: np.ndarray, inputs: Inputs, warm_up: int) -> None:
        self.count, self.windows = len(parameters), inputs.commands.shape[2]
        numbers = vehicle.numbers(parameters)
        self._kernels = _Kernels.of(
            Throttle if vehicle.signal == "motor_command" else RotorSpeed, numbers, vehicle.kind
        )
        rows = [np.broadcast_to(np.asarray(row, float), (self.count,)) for row in self._kernels.layout.flatten(numbers)]
        self._numbers = np.repeat(np.array(rows), self.windows, axis=1).ravel()
        self._size = self.count * self.windows
        whole = vehicle.delays(parameters) / inputs.period
        late = np.floor(whole).astype(int)
        pairs = list(zip(late.tolist(), (whole - late).tolist(), strict=True))
        self._lags = [(*pair, [k for k in range(self.count) if pairs[k] == pair]) for pair in dict.fromkeys(pairs)]
        self._inputs, self._k = inputs, 0
        self._rotors = np.empty(ROTORS * self._size)
        self._told = np.empty((ROTORS, self.count, self.windows))
        self._span = np.empty((self.count, self.windows))
        self._listen()
        self._kernels.rotors_at_rest(self._size, 0.0, self._rotors, self._told.ravel(), self._numbers)
        for _ in range(warm_up):
            self._kernels.rotors_after(
                self._size, 0.0, self._rotors, self._rotors, self._told.ravel(), self._span.ravel(), self._numbers
            )
            self._next()

    def _listen(self) -> None:
        """Takes the commands and the span of the step that begins now."""
        commands, at = self._inputs.commands, self._k + self._inputs.margin
        for lag, share, which in self._lags:
            self._told[:, which] = ((1.0 - share) * commands[at - lag] + share * commands[at - lag - 1])[:, None, :]
        self._span[:] = self._inputs.spans[min(self._k, len(self._inputs.spans) - 1)]

    def _next(self) -> None:
        self._k += 1
        self._listen()

    @property
    def span(self) -> np.ndarray:
        """(W,) of the step that begins now, s."""
        return self._span[0]

    def step(self, state: np.ndarray) -> None:
        """Takes a state one step on, but for its disturbance, which holds."""
        body = state[:BODY].reshape(-1)
        self._kernels.step(
            self._size,
            0.0,
            body,
            self._rotors,
            body,
            self._rotors,
            self._told.reshape(-1),
            state[BODY:].reshape(-1),
            self._span.reshape(-1),
            self._numbers,
        )
        self._next()

    def felt(self, state: np.ndarray) -> np.ndarray:
        """(3, K, W) what an accelerometer feels."""
        force = np.empty(3 * self._size)
        self._kernels.felt(
            self._size,
            0.0,
            force,
            state[:BODY].reshape(-1),
            self._rotors,
            self._told.reshape(-1),
            state[BODY:].reshape(-1),
            self._numbers,
        )
        return force.reshape(3, self.count, self.windows)
