"""The vehicle behind its autopilot, from logs with commands of attitude and thrust.

Each angle follows its command as a lag of second order, and the thrust moves the vehicle against its drag: the formulas
of `drake_quad.vehicle.responding`. Windows of some seconds are flown again from free initial states, driven by the
logged commands, and what comes out is compared with measured positions and attitudes (velocities, where there is no
position; body rates and velocities are filtered by whoever logs them, positions and attitudes hardly). Sought are

    natural frequency and damping of roll, pitch, yaw      a delay that all commands share
    thrust over throttle: level and slope                  lag of the thrust
    drag per body axis, translational lift, climb          tilt of what is measured against the body (trim)

What a log does not tell stays as in the vehicle that the identification began with, and `not_seen` says why.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.geometry.axes import BodyAxes
from drake_quad.identification.evidence import Evidence, Uncertainty, explained_share
from drake_quad.identification.fitting.multiple_shooting import Fit, Problem, evidence, fit, slopes_at, uncertainty
from drake_quad.identification.fitting.open_loop import (
    DELAY,
    UNKNOWN,
    OpenLoop,
    Starts,
    delay_of,
    level_vehicle,
    with_level_commands,
)
from drake_quad.identification.random_effects import Variation, of_the_mean, variation_of
from drake_quad.identification.fitting.whitening import Noise, Shape, noise_of, still, straying
from drake_quad.identification.windows import (
    airborne,
    common_period,
    held_out,
    pieces,
    steep_remarks,
    within_half_a_turn,
)
from drake_quad.identification.identified import Fitted, Identification, Spread
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.results.estimates import Estimates, Explained, Source, kind_of, quantile
from drake_quad.identification.results.held_out import hold_out
from drake_quad.identification.results.vehicle_numbers import number_of, with_effects, with_estimates, with_throttles
from drake_quad.laboratory.motion_capture import attitude_of_markers
from drake_quad.scenario.models import Scenario
from drake_quad.signals import Attitude
from drake_quad.statistics.interval import plus_minus

METHOD = "multiple shooting on positions and attitudes"
# Of a window, s. Commands follow measurements, and with them their noise, which is taken for the vehicle's answer as
# far as initial states can follow it: the less, the longer a window is.
_LENGTH = 3.0
_RIGID_LENGTH, _LEVEL_LENGTH, _ATTITUDE_LENGTH = 0.4, 1.0, 6.0
# Of a window, from which its initial state is guessed, s.
_EARLY = 0.2
# Of samples that are compared, s: more would cost time and tell next to nothing more of motions this slow.
_APART = 0.02
# Windows in a block of the jackknife, at least, and blocks, at most and at least.
_TOGETHER, _BLOCKS, _FEWEST = 1, 30, 5
# A standard deviation that is a larger share of what a number may well be off by: the log does not tell it.
_TOLD = 0.5
# Beliefs, in so many of these.
_WEAK = 4.0
# And of what is held, in the same unit.
_HELD = 1e-9
# Of the noise, at most.
_ROUNDS = 8
# Of the variance of an output, less of which the whole model explains by chance.
_EXPLAINED = 0.2
_MISALIGNMENT = "laboratory.motion_capture.misalignment"
_ANGLES = ("roll", "pitch", "yaw")
_SHORTEST_LAG = 2e-3
# Cannot be zero or below, and are at least this share of what is believed.
_POSITIVE = ("autopilot.natural_frequency", "inertia", "drag_factor", "thrust_factor")
_LEAST = 0.02
_NEVER_NEGATIVE = ("body_drag.quadratic", "body_drag.linear", "rotor_aerodynamics.lift", DELAY)
# Standard deviations that are an error's.
_ERRORS = 2.0


class _Output(NamedTuple):
    """A measured signal.

    Attributes:
        name: in words.
        unit: of it.
        signal: of the record.
        column: of the signal.
        row: of the state.
        usual: standard deviation of its noise, to begin with.
        strays: by what acts on the vehicle and is not in the model, to begin with (unit over s^(3/2)); 0 if it is held.
    """

    name: str
    unit: str
    signal: str
    column: int
    row: int
    usual: float
    strays: float


class _Task(NamedTuple):
    """What is sought, from which outputs, in windows of which length, s."""

    outputs: tuple[_Output, ...]
    names: tuple[str, ...]
    seconds: float


# Of a log without attitude: the vehicle is taken for level, and its height is what its rotors do.
_HEIGHT = (_Output("height", "m", "position", 2, 2, 3e-3, 0.3),)
_LEVEL_CANDIDATES = (
    "motors.curve[2]",  # at hover alone, the three of a curve are one number
    DELAY,
    "rotor_time_constant",
    "rotor_aerodynamics.climb",
)


_LEVEL_TASK = _Task(_HEIGHT, _LEVEL_CANDIDATES, _LEVEL_LENGTH)


@dataclass(frozen=True)
class _Windows:
    """The windows of all logs.

    Attributes:
        loops: a vehicle driven by each log.
        places: which log each window is of.
        starts: first sample of each window.
        length: samples.
        every: how many samples there are from one that is compared to the next.
        unseen: (W,) True for those that are held out.
    """

    loops: tuple[OpenLoop, ...]
    records: tuple[FlightRecord, ...]
    places: np.ndarray
    starts: np.ndarray
    length: int
    every: int
    unseen: np.ndarray

    def chosen(self, windows: np.ndarray) -> "_Windows":
        """Some of the windows."""
        return replace(self, places=self.places[windows], starts=self.starts[windows], unseen=self.unseen[windows])

    def measured(self, signal: str, column: int) -> np.ndarray:
        """(W, T) of a signal."""
        steps = np.arange(0, self.length + 1, self.every)
        values = [
            np.unwrap(r.of(signal), axis=0) if signal.startswith("attitude") else r.of(signal) for r in self.records
        ]
        return np.stack([values[p][s + steps, column] for p, s in zip(self.places, self.starts, strict=True)])

    def times(self) -> np.ndarray:
        """(W, T) s."""
        steps = np.arange(0, self.length + 1, self.every)
        return np.stack([self.records[p].time[s + steps] for p, s in zip(self.places, self.starts, strict=True)])

    def fly(self, bodies: np.ndarray, numbers: dict[str, np.ndarray]) -> np.ndarray:
        """(T, K, W, 12) from (K, W, 12)."""
        found = np.empty((self.length // self.every + 1, *bodies.shape))
        for place in np.unique(self.places):
            own = self.places == place
            starts = Starts(self.starts[own], self.length)
            found[:, :, own] = self.loops[place].fly(starts, bodies[:, own], numbers, every=self.every)
        return found


def identify_from_poses(
    records: Sequence[FlightRecord], scenario: Scenario, *, held_out_share: float = 1.0 / 3.0
) -> Identification:
    """Identifies a vehicle behind its autopilot.

    Args:
        records: of flights of the same vehicle, with attitude commands, commands of thrust, attitudes, and positions
            or velocities.
        scenario: to begin with; its mass is believed, and so is what the logs do not tell. Its autopilot is a
            response of the attitude.
        held_out_share: of the time in the air, at the end of each log, that is only predicted.

    Raises:
        InputError: a log lacks a signal, the autopilot is another, or there is too little flight.
    """
    if any(record.motor_command is not None for record in records):
        scenario = with_throttles(scenario)
    scenario = _of_one_lag(scenario)
    if scenario.laboratory.autopilot.models_vehicle:
        task = _Task(_outputs(records, True), _candidates(scenario), _LENGTH)
    elif any(record.attitude is None and record.body_rates is None for record in records):
        records = [with_level_commands(record) for record in records]
        return _identified(records, level_vehicle(scenario), _LEVEL_TASK, held_out_share, scenario)
    else:
        task = _Task(_outputs(records, False), _rigid_candidates(scenario), _RIGID_LENGTH)
    return _identified(records, scenario, task, held_out_share, scenario)


def identify_attitude_response(
    records: Sequence[FlightRecord], scenario: Scenario, *, held_out_share: float = 1.0 / 3.0
) -> Identification:
    """Identifies how the attitude answers its command, from attitudes alone, whatever moves the vehicle.

    Args:
        records: of flights of the same vehicle, with attitude commands, commands of thrust, and attitudes.
        scenario: to begin with; its autopilot is a response of the attitude.
        held_out_share: of the time in the air, at the end of each log, that is only predicted.

    Raises:
        InputError: a log lacks a signal, or there is too little flight.
    """
    outputs = tuple(output for output in _outputs(records, True) if output.signal == "attitude")
    names = tuple(
        name for name in _candidates(scenario) if name.startswith(("autopilot.", _MISALIGNMENT)) or name == DELAY
    )
    task = _Task(outputs, names, _ATTITUDE_LENGTH)
    return _identified(records, _of_one_lag(scenario), task, held_out_share, scenario)


def _identified(
    records: Sequence[FlightRecord], flown: Scenario, task: _Task, held_out_share: float, scenario: Scenario
) -> Identification:
    """Fits what is sought to windows of the logs.

    Args:
        records: of flights of the same vehicle.
        flown: the vehicle whose numbers are sought.
        task: what is sought, and from what.
        held_out_share: of the time in the air.
        scenario: that the estimates are put into.
    """
    outputs, names, seconds = task
    believed = with_effects(flown, names)
    windows = _cut(records, believed, held_out_share, seconds)
    seen = windows.chosen(~windows.unseen)
    if len(seen.starts) < _FEWEST * _TOGETHER:
        raise InputError(
            f"there are {len(seen.starts)} stretches of {seconds:g} s to be fitted, too few: it takes"
            f" {_FEWEST * _TOGETHER}"
        )
    model = _Model.of(believed, outputs, names)
    not_seen: dict[str, str] = {}
    names, fitted, problem, noises = _told(model, seen, names, not_seen)
    blocks = _blocks(seen)
    variance, freedom, _ = uncertainty(problem, fitted, blocks)
    source = Source(METHOD, ", ".join(dict.fromkeys(record.name for record in records)))
    parameters, deviations = fitted.parameters, np.sqrt(np.diag(variance))
    values = parameters
    not_seen |= _untold(names, deviations, problem.scales)
    told = [name for name in names if name not in not_seen]
    if not told:
        raise InputError("the logs tell nothing of the vehicle: it hardly moves")
    # What is not told stays as believed, and what cannot be below zero is not: the rest of the vehicle goes with that.
    # A delay may be as much below as its error.
    least = np.where([name == DELAY for name in names], -_ERRORS * deviations, 0.0)
    below = np.array([name.startswith(_NEVER_NEGATIVE) for name in names]) & (values < least)
    fixed = below | np.array([name in not_seen for name in names])
    if fixed.any():
        target = np.where(below, 0.0, problem.believed)
        held = problem._replace(
            believed=np.where(fixed, target, problem.believed),
            beliefs=np.where(fixed, 1e-6 * problem.scales, problem.beliefs),
        )
        fitted = fit(held, np.where(fixed, target, values), fitted.states, tolerance=1e-7)
        values = np.where(fixed, target, fitted.parameters)
    free = [name for name, held in zip(names, fixed, strict=True) if not held]
    parts = _evidence(model, windows, names, noises, fitted).given(free)
    variance, freedom, variation = _of_stretches(variance, freedom, parts, np.flatnonzero(~fixed))
    everything = Estimates(names, values, variance, freedom, source, variation=variation)
    estimates = replace(everything.part(told), not_seen=not_seen)
    whole = _refitted(model, windows, names, fitted)
    explained = _explained(model, windows, names, whole, values, outputs)
    estimates = replace(estimates, explained={name: share for name, share in explained.items() if name in told})
    series = _series(model, windows, whole, noises)
    delay = None
    if DELAY in told:
        i, period = told.index(DELAY), scenario.laboratory.command_link.period
        own_freedom = float(np.asarray(estimates.degrees_of_freedom)[i])
        late = float(delay_of(scenario, estimates.values[i]))
        delay = Spread(late, float(estimates.deviations[i]) * period, "s", own_freedom)
    further = {
        f"white noise of {output.name}": Spread(noise.white, np.nan, output.unit)
        for output, noise in zip(outputs, noises, strict=True)
    }
    reaches = quantile(freedom) * deviations
    remarks = (*_remarks(windows, told), *_below_remarks(scenario, names, below, parameters, reaches))
    return Identification(
        estimates, with_estimates(scenario, estimates), series, delay, further, remarks, hold_out(parts)
    )


def _of_stretches(
    variance: np.ndarray, freedom: np.ndarray, parts: Evidence, free: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Variation | None]:
    """Covariance and degrees of freedom of the mean, and the variation, of all numbers; of some there is evidence."""
    among = np.ix_(free, free)
    found = variation_of(parts)
    mean = of_the_mean(Uncertainty(variance[among], freedom[free], variance[among]), parts, found)
    wider, own = np.ones(len(variance)), freedom.copy()
    wider[free] = np.sqrt(np.diag(mean.covariance) / np.diag(variance)[free])
    own[free] = mean.degrees_of_freedom
    if found is not None:
        whole = np.diag(np.full(len(variance), np.nan))
        whole[among] = found.covariance
        found = found._replace(covariance=whole)
    return variance * np.outer(wider, wider), own, found


def _of_one_lag(scenario: Scenario) -> Scenario:
    """The vehicle with one lag of its rotors in both directions."""
    vehicle = scenario.vehicle.model_copy(update={"rotor_time_constant_down": None})
    return scenario.model_copy(update={"vehicle": vehicle})


def _remarks(windows: _Windows, names: Sequence[str]) -> tuple[str, ...]:
    known, unseen = int((~windows.unseen).sum()), int(windows.unseen.sum())
    logs, length = len(windows.records), windows.length * windows.records[0].period
    found = [
        f"{known} windows of {length:.2g} s were fitted and {unseen} held out, of {logs} log{'s' if logs > 1 else ''}"
    ]
    found += steep_remarks(windows.records)
    if "rotor_aerodynamics.climb" in names:
        found.append("climb has what drag along z of the body does, too: a flight does not tell them apart")
    if "body_drag.centre_of_pressure[2]" in names:
        found.append(
            "the drag of the body is believed; its centre of pressure has all torque that grows with the speed"
        )
    if "inertia[0]" in names:
        found.append("inertia about z is believed, and the drag factor goes with it: yaw tells their ratio alone")
    return tuple(found)


def _below_remarks(
    scenario: Scenario, names: Sequence[str], below: np.ndarray, values: np.ndarray, reaches: np.ndarray
) -> tuple[str, ...]:
    """Return a sentence on each parameter that is set to zero, with its 95 % interval; delays are given in ms."""
    found = []
    for name, value, reach, held in zip(names, values, reaches, below, strict=True):
        size, unit = (
            (1e3 * scenario.laboratory.command_link.period, "ms") if name == DELAY else (1.0, kind_of(name).unit)
        )
        if held:
            found.append(
                f"{name} came out at {plus_minus(size * value, size * reach)} {unit}, and is held at zero, because"
                " it cannot be negative"
            )
    return tuple(found)


def _outputs(records: Sequence[FlightRecord], responds: bool) -> tuple[_Output, ...]:
    """What all records have measured."""
    for record in records:
        record.of("attitude")
    if all(record.position is not None for record in records):
        where = [_Output(f"position {axis}", "m", "position", i, i, 3e-3, 0.3) for i, axis in enumerate("xyz")]
    else:
        for record in records:
            record.of("velocity")
        where = [_Output(f"velocity {axis}", "m/s", "velocity", i, 6 + i, 3e-2, 0.3) for i, axis in enumerate("xyz")]
    angles = [
        _Output(name, "rad", "attitude", i, 3 + i, 5e-3, 0.0 if responds else 0.3) for i, name in enumerate(_ANGLES)
    ]
    if responds:
        return (*where, *angles)
    for record in records:
        record.of("body_rates")
    rates = [_Output(f"body rate {name}", "rad/s", "body_rates", i, 9 + i, 5e-2, 3.0) for i, name in enumerate("pqr")]
    return (*where, *angles, *rates)


def _candidates(scenario: Scenario) -> tuple[str, ...]:
    """What is sought."""
    thrust = ("motors.curve[0]", "motors.curve[1]")
    if not scenario.vehicle.motors.take_throttles:
        thrust = ("thrust_factor",)  # type: ignore[assignment]
    return (
        *(f"autopilot.natural_frequency[{i}]" for i in range(3)),
        *(f"autopilot.damping[{i}]" for i in range(3)),
        DELAY,
        *thrust,
        "rotor_time_constant",
        *(f"body_drag.linear[{i}]" for i in range(2)),
        *(f"body_drag.quadratic[{i}]" for i in range(3)),
        "rotor_aerodynamics.lift",
        "rotor_aerodynamics.climb",
        *(f"{_MISALIGNMENT}[{i}]" for i in range(2)),
    )


def _rigid_candidates(scenario: Scenario) -> tuple[str, ...]:
    """What is sought of a vehicle whose rotors are commanded."""
    thrust = ("motors.curve[0]", "motors.curve[2]") if scenario.vehicle.motors.take_throttles else ("thrust_factor",)
    # Without body drag there is no force at the centre of pressure.
    pressure = ("body_drag.centre_of_pressure[2]",) if "body_drag" in scenario.vehicle.effects() else ()
    return (
        *thrust,
        "rotor_time_constant",
        *(f"inertia[{i}]" for i in range(2)),
        *(f"centre_of_mass[{i}]" for i in range(2)),
        "drag_factor",
        DELAY,
        *pressure,
        *(f"{_MISALIGNMENT}[{i}]" for i in range(2)),
    )


def _scale(scenario: Scenario, name: str) -> float:
    """By how much a number may well be off."""
    mass, value = scenario.vehicle.mass, abs(number_of(scenario, name))
    hover = 0.25 * mass * scenario.vehicle.gravity
    period = scenario.laboratory.command_link.period
    usual = {
        "autopilot.damping": 0.5,
        DELAY: 0.03 / period,
        "motors.curve": hover,
        "rotor_time_constant": 0.04,
        "body_drag.linear": 0.3 * mass,
        "body_drag.quadratic": 0.05 * mass,
        "rotor_aerodynamics.lift": 0.05 * mass,
        "rotor_aerodynamics.climb": 0.3 * mass,
        _MISALIGNMENT: 0.05,
        "centre_of_mass": 5e-3,
        "body_drag.centre_of_pressure": 0.03,
    }
    return next((scale for path, scale in usual.items() if name.startswith(path)), value)


def _least(name: str, believed: float) -> float:
    """Below which a number makes no sense; drag below zero does until all is fitted."""
    if name == "rotor_time_constant":
        return _SHORTEST_LAG
    return _LEAST * believed if name.startswith(_POSITIVE) else -np.inf


def _cut(records: Sequence[FlightRecord], scenario: Scenario, share: float, seconds: float) -> _Windows:
    """Cuts the logs into windows.

    Raises:
        InputError: the logs are of different rates.
    """
    period = common_period(records)
    every = max(1, round(min(_APART, 0.02 * seconds) / period))
    length = every * max(2, round(seconds / (every * period)))
    places, starts, unseen = [], [], []
    for place, record in enumerate(records):
        flying = airborne(record)
        last = held_out(flying, share) if flying.any() and share > 0.0 else np.zeros(len(flying), dtype=bool)
        piece = pieces(record)
        told = round(UNKNOWN / record.period)
        start = told
        while start + length < len(record.time):
            inside = slice(start, start + length + 1)
            if flying[inside].all() and piece[start - told] == piece[start + length]:
                places.append(place)
                starts.append(start)
                unseen.append(bool(last[start]))
                start += length
            else:
                start += 1
    delay = float(delay_of(scenario))
    loops = tuple(OpenLoop(scenario, record, believed=scenario, delay=delay) for record in records)
    return _Windows(
        loops, tuple(records), np.array(places, int), np.array(starts, int), length, every, np.array(unseen, bool)
    )


def _blocks(windows: _Windows) -> np.ndarray:
    """(W,) number of the block that each window is in."""
    together = max(_TOGETHER, -(-len(windows.starts) // _BLOCKS))
    return np.arange(len(windows.starts)) // together


class _Model(NamedTuple):
    """Model of the vehicle and of its measurements."""

    scenario: Scenario
    outputs: tuple[_Output, ...]
    believed: dict[str, float]
    scales: dict[str, float]

    @classmethod
    def of(cls, scenario: Scenario, outputs: tuple[_Output, ...], names: Sequence[str]) -> "_Model":
        """The model of a scenario, with numbers that are sought."""
        tilts = [f"{_MISALIGNMENT}[{i}]" for i in range(3)]
        believed = {name: number_of(scenario, name) for name in (*names, *tilts)}
        return cls(scenario, outputs, believed, {name: _scale(scenario, name) for name in names})

    def predictions(
        self, windows: _Windows, names: Sequence[str], parameters: np.ndarray, states: np.ndarray
    ) -> np.ndarray:
        """(K, W, o, T) of (K, p) parameters and (K, W, 12) states."""
        numbers = {name: parameters[:, i] for i, name in enumerate(names)}
        flown = windows.fly(
            states, {name: value for name, value in numbers.items() if not name.startswith(_MISALIGNMENT)}
        )
        tilts = (f"{_MISALIGNMENT}[{i}]" for i in range(3))
        angles: Any = [numbers.get(name, np.full(len(parameters), self.believed[name]))[:, None] for name in tilts]
        turned = BodyAxes.of(*angles)
        roll, pitch, yaw = np.moveaxis(flown[..., 3:6], -1, 0)
        flown[..., 3:6] = np.stack(attitude_of_markers(Attitude(roll, pitch, yaw), turned), axis=-1)
        rows = [output.row for output in self.outputs]
        return np.transpose(flown[..., rows], (1, 2, 3, 0))

    def measured(self, windows: _Windows) -> np.ndarray:
        """(W, o, T)."""
        return np.stack([windows.measured(output.signal, output.column) for output in self.outputs], axis=1)

    def errors(self, predicted: np.ndarray, measured: np.ndarray) -> np.ndarray:
        """Return predicted minus measured values (..., W, o, T), with differences of angles wrapped to [-π, π]."""
        errors = predicted - measured
        angles = [o for o, output in enumerate(self.outputs) if output.signal == "attitude"]
        errors[..., angles, :] = within_half_a_turn(errors[..., angles, :])
        return errors

    def first_states(self, windows: _Windows) -> np.ndarray:
        """(W, 12) by straight lines through the first samples."""
        states = np.zeros((len(windows.starts), 12))
        times = windows.times()
        early = slice(0, 1 + max(3, round(_EARLY / (times[0, 1] - times[0, 0]))))
        since = times[:, early] - times[:, :1]
        for output in self.outputs:
            values = windows.measured(output.signal, output.column)[:, early]
            centred = since - since.mean(axis=1, keepdims=True)
            slope = np.sum(centred * values, axis=1) / np.sum(centred**2, axis=1)
            states[:, output.row] = values.mean(axis=1) - slope * since.mean(axis=1)
            if output.row < 6:
                states[:, output.row + 6] = slope
        return states

    def problem(self, windows: _Windows, names: Sequence[str], whiteners: Sequence[np.ndarray]) -> Problem:
        """Return the least-squares problem of the parameters `names` in some windows."""
        measured = self.measured(windows)

        def residuals(parameters: np.ndarray, states: np.ndarray) -> np.ndarray:
            off = self.errors(self.predictions(windows, names, parameters, states), measured)
            # As one matrix: of a stack of rows that lie apart each would be multiplied by itself.
            sets, count, _, samples = off.shape
            weighted = [off[:, :, o].reshape(-1, samples) @ whitener for o, whitener in enumerate(whiteners)]
            return np.concatenate([each.reshape(sets, count, -1) for each in weighted], axis=2)

        scales = np.array([self.scales[name] for name in names])
        believed = np.array([self.believed[name] for name in names])
        least = np.array([_least(name, self.believed[name]) for name in names])
        return Problem(residuals, scales, _STATE_SCALES, believed, _WEAK * scales, least)

    def shape(self, windows: _Windows) -> Shape:
        """Of what strays in a window."""
        times = windows.times()
        return straying(np.median(times - times[:, :1], axis=0))


_STATE_SCALES = np.array([0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.5, 0.5, 0.5, 1.0, 1.0, 1.0])


def _told(
    model: _Model, windows: _Windows, names: tuple[str, ...], not_seen: dict[str, str]
) -> tuple[tuple[str, ...], Fit, Problem, list[Noise]]:
    """Fit the parameters that the windows identify; the others are removed one by one."""
    shape = model.shape(windows)
    noises = [Noise(output.usual, output.strays) for output in model.outputs]
    states = model.first_states(windows)
    parameters = np.array([model.believed[name] for name in names])
    rounds, settled = 0, False
    while True:
        names, parameters = _excited(model, windows, noises, names, parameters, not_seen)
        problem = model.problem(windows, names, [noise.whitener(shape) for noise in noises])
        fitted = fit(problem, parameters, states, tolerance=1e-7 if settled else 1e-4)
        parameters, states = fitted.parameters, fitted.states
        rounds += 1
        if not settled:
            predicted = model.predictions(windows, names, parameters[None], states[None])[0]
            off = model.errors(predicted, model.measured(windows))
            before = noises
            noises = [
                noise_of(off[:, o], shape if output.strays else still(shape)) for o, output in enumerate(model.outputs)
            ]
            settled = rounds == _ROUNDS or all(map(_alike, before, noises))
            continue
        return names, fitted, problem, noises


def _alike(one: Noise, other: Noise) -> bool:
    """Are two noises next to the same?"""
    near = abs(one.strayed - other.strayed) <= 0.1 * max(one.strayed, other.strayed)
    return near and abs(one.white - other.white) <= 0.05 * other.white


def _excited(
    model: _Model,
    windows: _Windows,
    noises: Sequence[Noise],
    names: tuple[str, ...],
    parameters: np.ndarray,
    not_seen: dict[str, str],
) -> tuple[tuple[str, ...], np.ndarray]:
    """What is left when the response of angles is not sought whose commands vary less than what is measured of them.

    Their free motions alone are noise, of which any response can be made.
    """
    if not any(name.startswith("autopilot.") for name in names):
        return names, parameters
    commands = [windows.measured("attitude_command", i) for i in range(3)]
    varying = [float(np.sqrt(np.mean((each - each.mean(axis=1, keepdims=True)) ** 2))) for each in commands]
    noise = {output.row - 3: noise.white for output, noise in zip(model.outputs, noises, strict=True)}
    kept = []
    for i, name in enumerate(names):
        axis = int(name[-2]) if name.startswith("autopilot.") else -1
        if axis >= 0 and varying[axis] < noise[axis]:
            not_seen[name] = (
                f"the command of {_ANGLES[axis]} varies by {varying[axis]:.2g} rad, less than the noise of what is"
                f" measured, {noise[axis]:.2g} rad"
            )
        else:
            kept.append(i)
    return tuple(names[i] for i in kept), parameters[kept]


def _untold(names: Sequence[str], deviations: np.ndarray, scales: np.ndarray) -> dict[str, str]:
    """Why numbers are not told that are not, by name."""
    return {
        name: (
            f"the flight does not excite it: its standard deviation would be {deviation:.2g}, where it may well be"
            f" off by {scale:.2g}"
        )
        for name, deviation, scale in zip(names, deviations, scales, strict=True)
        if deviation > _TOLD * scale
    }


class _Left(NamedTuple):
    """What a vehicle leaves of what was measured.

    Attributes:
        residuals: (W, o, T) predicted minus measured, in units of the outputs.
        slopes: (W, o, T, p) by the parameters, with initial states that follow.
    """

    residuals: np.ndarray
    slopes: np.ndarray


def _evidence(model: _Model, windows: _Windows, names: Sequence[str], noises: Sequence[Noise], fitted: Fit) -> Evidence:
    """What all windows say, in the order of flight; in those that were held out only initial states are fitted."""
    scales = np.array([model.scales[name] for name in names])
    seconds = len(windows.starts) * windows.length * windows.records[0].period
    known = evidence(fitted, names, scales, seconds)
    if not windows.unseen.any():
        return known
    unseen = windows.chosen(windows.unseen)
    shape = model.shape(unseen)
    problem = model.problem(unseen, names, [noise.whitener(shape) for noise in noises])
    held = problem._replace(believed=fitted.parameters, beliefs=_HELD * scales)
    more = evidence(fit(held, fitted.parameters, model.first_states(unseen)), names, scales, seconds)
    order = np.argsort(np.concatenate([np.flatnonzero(~windows.unseen), np.flatnonzero(windows.unseen)]))
    return known._replace(
        information=np.concatenate([known.information, more.information])[order],
        scores=np.concatenate([known.scores, more.scores])[order],
    )


def _refitted(model: _Model, windows: _Windows, names: Sequence[str], fitted: Fit) -> _Left:
    """What is left in all windows, with initial states fitted by plain least squares and parameters held."""
    shape = model.shape(windows)
    whole = model.problem(windows, names, [Noise(output.usual, 0.0).whitener(shape) for output in model.outputs])
    held = whole._replace(believed=fitted.parameters, beliefs=_HELD * whole.scales)
    found = fit(held, fitted.parameters, model.first_states(windows), iterations=15)
    plain = model.problem(windows, names, [np.eye(len(shape.values))] * len(model.outputs))
    slopes = slopes_at(plain, fitted.parameters, found.states)
    follow = np.linalg.pinv(found.slopes.to_states, rcond=1e-9) @ found.slopes.to_parameters
    windows_count, size, count = slopes.to_parameters.shape
    outputs = len(model.outputs)
    moved = slopes.to_parameters - slopes.to_states @ follow
    return _Left(
        slopes.residuals.reshape(windows_count, outputs, size // outputs),
        moved.reshape(windows_count, outputs, size // outputs, count),
    )


def _varying(values: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(W, T) values without the straight line of each window."""
    line = np.stack([np.ones_like(times), times - times.mean(axis=1, keepdims=True)], axis=2)
    basis, _ = np.linalg.qr(line)
    return np.asarray(values - (basis @ (np.swapaxes(basis, 1, 2) @ values[:, :, None]))[:, :, 0])


def _explained(
    model: _Model,
    windows: _Windows,
    names: Sequence[str],
    left: _Left,
    values: np.ndarray,
    outputs: tuple[_Output, ...],
) -> dict[str, Explained]:
    """What each number explains, on windows that were held out, beside what is believed without the log."""
    chosen = windows.unseen if windows.unseen.any() else ~windows.unseen
    residuals, to_parameters = left
    times = windows.times()
    found = {}
    for i, name in enumerate(names):
        change = model.believed[name] - values[i]
        shares = []
        for o, output in enumerate(outputs):
            own = residuals[chosen, o]
            other = own + change * to_parameters[chosen, o, :, i]
            varying = _varying(windows.measured(output.signal, output.column), times)[chosen]
            told = _share(varying, own)  # NaN, and so not larger, of an output that does not vary
            shares.append(min(told - _share(varying, other), 1.0) if told > _EXPLAINED else 0.0)
        best = int(np.argmax(shares))
        if shares[best] > 0.0:
            found[name] = Explained(shares[best], outputs[best].name)
    return found


def _share(varying: np.ndarray, left: np.ndarray) -> float:
    """Return the share of the variance that is explained; NaN where nothing varies."""
    return float(explained_share(np.sum(left**2), np.sum(varying**2)))


def _series(
    model: _Model,
    windows: _Windows,
    left: _Left,
    noises: Sequence[Noise],
) -> tuple[Fitted, ...]:
    """What was measured beside what is predicted."""
    residuals = left.residuals
    times, series = windows.times(), []
    log = np.array([windows.records[place].name for place in windows.places])
    for o, output in enumerate(model.outputs):
        measured = windows.measured(output.signal, output.column)
        varying = _varying(measured, times)
        share, share_fitted = (
            _share(varying[chosen], residuals[chosen, o]) for chosen in (windows.unseen, ~windows.unseen)
        )
        series.append(
            Fitted(
                output.name,
                output.unit,
                log,
                times,
                measured,
                measured + residuals[:, o],
                windows.unseen,
                share,
                share_fitted,
                noises[o].white,
            )
        )
    return tuple(series)
