"""A vehicle from logs of what its rotors were told.

Which numbers are looked for follows from the scenario and from what is logged: those of effects that its vehicle has
(`body_drag`, a lag of its own for rotors that slow down, ...), as far as an output tells them. What the log turns out
not to tell is left at its value in the scenario, and why is said.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError, listed
from drake_quad.identification.evidence import Evidence, Uncertainty
from drake_quad.identification.firmware import allocated_commands
from drake_quad.identification.fitting.flown_model import DELAY, DisturbanceKind, FlownVehicle
from drake_quad.identification.forecast import Forecast, forecast
from drake_quad.identification.fit import (
    ParameterChoice,
    PredictionFit,
    fit,
    noise_covariance,
    whitened,
)
from drake_quad.identification.prediction_errors import FORCE, Output, PredictionNoise, Predictor
from drake_quad.identification.random_effects import of_the_mean, variation_of
from drake_quad.identification.windows import WindowSizes, airborne, coarser, cut, held_out, steep_remarks
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.results.estimates import (
    CONFIDENCE,
    Estimates,
    Explained,
    Source,
    quantile,
    scenario_path,
)
from drake_quad.scenario.layouts import arm_length_of
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import value_at
from drake_quad.statistics.interval import plus_minus

# Samples are taken together up to this time, and longer ones taken apart, s: a tenth of a small motor's lag.
_SAMPLE, _STEP = 0.008, 0.005
# Of the windows, s: with an IMU alone attitude and speed are unknown and drift, with poses they are not.
_IMU_WINDOW, _POSE_WINDOW = (1.0, 0.4), (2.5, 0.5)
_SHORTEST, _WARM_UP = 1.0, 0.4
# Horizons of the score, s.
_IMU_HORIZON, _POSE_HORIZON = 0.1, 0.5
# Of the delay, s.
_LONGEST = 0.05
# A number whose 95 % interval reaches farther to each side than so much of its scale is not told by a log.
_TOLD = 1.0
# Nor one with fewer degrees of freedom: hardly more than one stretch of the flights tells it.
_FEWEST_DEGREES = 2.0
# And one so near to a limit, in its scale, is not either.
_AT_LIMIT = 1e-3
# Information on numbers in their scales that is none, but for rounding.
_NOTHING = 1e-6
# Over which a speed is taken, s.
_SPEED = 0.1
# Of the blocks, over which errors are correlated: about so long, s, and at least so many.
_BLOCK, _BLOCKS = 4.0, 15
# Fewer windows give no interval.
_FEWEST = 4
_POSE = ("position", "attitude")
_NOISES = {signal: f"laboratory.motion_capture.{signal}_noise" for signal in _POSE}


class _Sought(NamedTuple):
    """A number that may be found.

    Attributes:
        name: as in `Estimates`.
        scale: by how much it may be off.
        least: limit.
        most: limit.
    """

    name: str
    scale: float
    least: float
    most: float


class Delay(NamedTuple):
    """By how much later than logged commands act on what is measured, as it is logged, s.

    Attributes:
        value: of it; negative if measurements are later than the commands.
        deviation: standard deviation of its error.
        degrees_of_freedom: of Student's distribution of the error.
    """

    value: float
    deviation: float
    degrees_of_freedom: float

    @property
    def interval(self) -> tuple[float, float]:
        """Of 95 % confidence, s."""
        reach = float(quantile(self.degrees_of_freedom)) * self.deviation
        return self.value - reach, self.value + reach


@dataclass(frozen=True, eq=False)
class RotorIdentification:
    """What was identified from logs.

    Attributes:
        estimates: numbers of the vehicle and of its cameras, of all of the logs.
        delay: of the commands.
        noise: of measurements and of what disturbs.
        forecast: on the part that was held out, by what was identified from the rest; None if nothing was.
        fitted: the fit to all of the logs.
        evidence: what parts of the logs say of all numbers that were fitted, the delay among them.
    """

    estimates: Estimates
    delay: Delay | None
    noise: PredictionNoise
    forecast: Forecast | None
    fitted: PredictionFit
    evidence: Evidence


def identify(records: Sequence[FlightRecord], scenario: Scenario, *, share: float = 1.0 / 3.0) -> RotorIdentification:
    """Identifies the vehicle of a scenario from logs of it.

    Args:
        records: of one and the same vehicle, with commands of rotors or motors, or of thrust and torques, which are
            taken to go through the allocation that is believed; and with body rates and specific force, or position and
            attitude, or both.
        scenario: whose vehicle is to be identified: what it has tells what is looked for and where that begins; its
            mass, its layout and its drag factor are believed. Distributions are not allowed.
        share: of each record's time in the air, its last, that is held out for the score; 0 for none.

    Raises:
        InputError: there is no record, one lacks what is needed or tells motors what this vehicle's are not told, or
            there is too little flight.
    """
    if not records:
        raise InputError("there is no log to identify a vehicle from")
    signal = "motor_command" if scenario.vehicle.motors.take_throttles else "rotor_speed_command"
    prepared = [_resampled(_commanded(record, scenario, signal)) for record in records]
    outputs = _outputs(prepared)
    flying = [airborne(record) for record in prepared]
    sought = _sought(scenario.vehicle, {output.signal for output in outputs})
    problem = _Problem(scenario.vehicle, signal, prepared, outputs)
    shown = None
    started = problem.values(sought), _first_noise(outputs)
    if share > 0.0:
        spared = [held_out(usable, share) for usable in flying]
        training = problem.predictor(sought, [a & ~b for a, b in zip(flying, spared, strict=True)])
        sought = _told(training, sought, problem.values(sought), started[1])
        training = problem.predictor(sought, [a & ~b for a, b in zip(flying, spared, strict=True)])
        first = fit(training, _choice(sought, problem.values(sought)), started[1])
        shown = forecast(problem.predictor(sought, spared, horizon=True), first.parameters, first.noise)
        started = first.parameters, first.noise
    else:
        sought = _told(problem.predictor(sought, flying), sought, problem.values(sought), started[1])
        started = problem.values(sought), started[1]
    predictor = problem.predictor(sought, flying)
    fitted = fit(predictor, _choice(sought, started[0]), started[1])
    uncertainty = fitted.covariance(_blocks(predictor))
    return _identified(records, scenario.vehicle, predictor, sought, fitted, uncertainty, shown)


def _blocks(predictor: Predictor) -> np.ndarray:
    """(W,) number of the block that each window is in, of some seconds: what a model lacks lasts as long."""
    windows = len(predictor.windows)
    time = windows * predictor.sizes.length * predictor.period
    number = min(windows, max(_BLOCKS, round(time / _BLOCK)))
    return np.asarray(np.arange(windows) * number // windows)


def _commanded(record: FlightRecord, scenario: Scenario, signal: str) -> FlightRecord:
    """Return a record with the commands that the vehicle's motors receive."""
    if getattr(record, signal) is not None:
        return record
    if record.thrust_command is None or record.torque_command is None:
        other = {"rotor_speed_command": "throttles", "motor_command": "speeds"}[signal]
        told = record.motor_command is not None or record.rotor_speed_command is not None
        why = f"; its motors are told {other}, so use a vehicle with vehicle.motors for them" if told else ""
        raise InputError(f"the log {record.name} lacks {signal}, or thrust_command with torque_command{why}")
    commands: Any = allocated_commands(
        record.thrust_command, record.torque_command, scenario, throttles=signal == "motor_command"
    )
    return replace(record, **{signal: commands})


def _resampled(record: FlightRecord) -> FlightRecord:
    return coarser(record, max(1, int(_SAMPLE / record.period + 0.05)))


def _outputs(records: Sequence[FlightRecord]) -> list[Output]:
    """What is to be predicted: of what all records have.

    Velocities, and body rates beside attitudes without an accelerometer, are left out: who logs these made them of
    position and attitude, with the same noise and a delay of their own.
    """
    have = set.intersection(*(set(record.names) for record in records))
    signals = [name for name in _POSE if name in have]
    if "body_rates" in have and (FORCE in have or "attitude" not in have):
        signals += ["body_rates", *([FORCE] if FORCE in have else [])]
    if not signals or signals == ["position"]:
        raise InputError(
            "to identify a vehicle a log needs body_rates and specific_force, or position and attitude; all of these"
            f" logs have {listed(sorted(have), len(have)) or 'nothing'}"
        )
    return [Output(name, column) for name in signals for column in range(3)]


def _sought(vehicle: Any, signals: set[str]) -> list[_Sought]:
    """The numbers of a vehicle that outputs may tell."""
    turning, moving = bool({"attitude", "body_rates"} & signals), bool({"position", FORCE} & signals)
    found: list[_Sought] = []
    if vehicle.motors.take_throttles:
        top = abs(sum(vehicle.motors.curve))
        found += [_Sought(f"motors.curve[{i}]", top, -10.0 * top, 10.0 * top) for i in range(3)]
    else:
        found.append(_positive("thrust_factor", vehicle.thrust_factor))
    found.append(_positive("rotor_time_constant", vehicle.rotor_time_constant))
    if vehicle.rotor_time_constant_down is not None:
        found.append(_positive("rotor_time_constant_down", vehicle.rotor_time_constant_down))
    if turning:
        found += [_positive(f"inertia[{i}]", vehicle.inertia[i]) for i in range(3)]
        arm = arm_length_of(vehicle)
        found += [_Sought(f"centre_of_mass[{i}]", 0.2 * arm, -arm, arm) for i in range(2)]
        if vehicle.reaction_torque:
            found.append(_positive("rotor_inertia", vehicle.rotor_inertia))
    if moving and vehicle.linear_drag > 0.0:
        found.append(_Sought("linear_drag", vehicle.linear_drag, 0.0, 1e3 * vehicle.linear_drag))
    if vehicle.body_drag is not None:
        if "position" in signals:
            found += [
                _Sought(f"body_drag.linear[{i}]", value, 0.0, 1e3 * value)
                for i, value in enumerate(vehicle.body_drag.linear)
                if value > 0.0
            ]
        if turning and FORCE in signals:
            found.append(_Sought("body_drag.centre_of_pressure[2]", 0.2 * arm, -arm, arm))
    if moving and vehicle.rotor_aerodynamics is not None and vehicle.rotor_aerodynamics.climb != 0.0:
        scale = abs(vehicle.rotor_aerodynamics.climb)
        found.append(_Sought("rotor_aerodynamics.climb", scale, -1e3 * scale, 1e3 * scale))
    found.append(_Sought(DELAY, 0.01, -0.9 * _LONGEST, 0.9 * _LONGEST))
    return found


def _positive(name: str, value: float) -> _Sought:
    return _Sought(name, value, 0.02 * value, 50.0 * value)


class _Problem:
    """Predictors for parts of records.

    Args:
        vehicle: of the scenario.
        signal: of the commands.
        records: as they are used.
        outputs: that are predicted.
    """

    def __init__(self, vehicle: Any, signal: str, records: Sequence[FlightRecord], outputs: Sequence[Output]) -> None:
        self.vehicle, self.signal, self.records, self.outputs = vehicle, signal, records, outputs
        self.period = float(np.median([record.period for record in records]))
        self.poses = "attitude" in {output.signal for output in outputs}
        self.kind: DisturbanceKind = "world" if self.poses else "body"

    def values(self, sought: Sequence[_Sought]) -> np.ndarray:
        """(p,) values in the scenario; the delay is a sample."""
        return np.array(
            [0.5 * self.period if each.name == DELAY else self._value(each.name) for each in sought], dtype=float
        )

    def _value(self, name: str) -> float:
        return float(value_at(self.vehicle, _path(name)))

    def predictor(self, sought: Sequence[_Sought], flying: Sequence[np.ndarray], *, horizon: bool = False) -> Predictor:
        """Of the parts where the vehicle is flying, in windows of their usual length or of the score's horizon."""
        length, settle = _POSE_WINDOW if self.poses else _IMU_WINDOW
        if horizon:
            length = _POSE_HORIZON if self.poses else _IMU_HORIZON
        else:
            # Of a short flight shorter ones, for as many blocks.
            time = self.period * sum(int(usable.sum()) for usable in flying)
            length = min(length, max(_SHORTEST, time / (_BLOCKS + 1)))
        sizes = WindowSizes(*(max(1, round(time / self.period)) for time in (length, settle, _WARM_UP)))
        windows = cut(self.records, flying, sizes)
        if len(windows) < _FEWEST:
            raise InputError(
                f"the logs have {len(windows)} stretches of {length + settle:g} s in the air without a gap; to identify"
                f" a vehicle takes {_FEWEST} at least, in what is held out and in the rest"
            )
        paths = [(DELAY,) if each.name == DELAY else (_path(each.name),) for each in sought]
        vehicle = FlownVehicle(self.vehicle, paths, self.signal, kind=self.kind)
        split = max(1, int(np.ceil(self.period / _STEP - 0.05))) if self.period > 2.0 * _STEP else 1
        return Predictor(vehicle, self.records, windows, sizes, self.outputs, split=split, longest=_LONGEST)


def _path(name: str) -> str:
    return scenario_path(name).removeprefix("vehicle.")


def _first_noise(outputs: Sequence[Output]) -> PredictionNoise:
    """Where the noise begins: that of small vehicles; with cameras, turbulence turns them less than is seen."""
    of = {"position": 1e-3, "attitude": 4e-3, "body_rates": 0.02, FORCE: 0.3}
    imu = any(output.signal == FORCE for output in outputs)
    turning = [8.0, 8.0, 3.0] if imu else [0.01, 0.01, 0.01]
    memory = [0.1, 0.1, 0.1, 0.05, 0.05, 0.05] if imu else [0.5] * 6
    disturbance = np.array([0.3, 0.3, 0.5, *turning])
    return PredictionNoise(np.array([of[output.signal] for output in outputs]), disturbance, np.array(memory))


def _choice(sought: Sequence[_Sought], start: np.ndarray) -> ParameterChoice:
    scale, least, most = (np.array(values) for values in zip(*(each[1:] for each in sought), strict=True))
    return ParameterChoice(start, scale, least, most)


def _told(predictor: Predictor, sought: Sequence[_Sought], start: np.ndarray, noise: PredictionNoise) -> list[_Sought]:
    """Those numbers that a log tells, by the information at the start.

    One after another the number that is told worst is left out, until all are told well, even without the block that
    tells most of it: what a single block tells has no interval.
    """
    gains = predictor.gains(start, noise)
    _, slopes, *_ = whitened(predictor, _choice(sought, start), start, gains, noise)
    scaled, blocks = slopes * np.array([each.scale for each in sought]), _blocks(predictor)
    own = np.stack([np.einsum("wkp,wkq->pq", part, part) for part in (scaled[blocks == b] for b in np.unique(blocks))])
    others = own.sum(axis=0) - own
    left = list(range(len(sought)))
    while left:
        values, vectors = np.linalg.eigh(others[:, left][:, :, left])
        variances = np.einsum("bij,bj->bi", vectors**2, 1.0 / np.maximum(values, _NOTHING)).max(axis=0)
        worst = int(np.argmax(variances))
        if scipy.stats.norm.ppf(0.5 * (1.0 + CONFIDENCE)) * np.sqrt(variances[worst]) < _TOLD:
            break
        del left[worst]
    return [sought[i] for i in left]


def _identified(
    records: Sequence[FlightRecord],
    vehicle: Any,
    predictor: Predictor,
    sought: Sequence[_Sought],
    fitted: PredictionFit,
    uncertainty: Uncertainty,
    shown: Forecast | None,
) -> RotorIdentification:
    names = [each.name for each in sought]
    scales = np.array([each.scale for each in sought])
    evidence = fitted.evidence(names, scales, len(predictor.windows) * predictor.sizes.length * predictor.period)
    variation = variation_of(evidence)
    uncertainty = of_the_mean(uncertainty, evidence, variation)
    swamped = _swamped(vehicle, predictor, sought, fitted) | _wide(sought, fitted, uncertainty)
    own = [i for i, name in enumerate(names) if name != DELAY and name not in swamped]
    if not own:
        raise InputError(
            "the logs tell no number of the vehicle: " + "; ".join(f"{n}: {w}" for n, w in swamped.items())
        )
    values, covariance = fitted.parameters[own], uncertainty.covariance[np.ix_(own, own)]
    freedom = uncertainty.degrees_of_freedom[own]
    variation = None if variation is None else variation.part(own)
    signals = {output.signal for output in predictor.outputs}
    seen = [name for name in _POSE if name in signals]
    if seen:
        places = [predictor.outputs.index(Output(name, 0)) for name in seen]
        level = fitted.noise.measured[places]
        apart = noise_covariance(predictor, fitted)[np.ix_(places, places)] * np.outer(level, level)
        values, covariance = np.concatenate([values, level]), scipy.linalg.block_diag(covariance, apart)
        freedom = np.concatenate([freedom, np.full(len(seen), float(fitted.errors.size))])
        variation = None if variation is None else variation.beside(len(seen))
    what = " and ".join(sorted(signal.replace("_", " ") for signal in signals))
    source = Source(f"prediction errors of {what}", ", ".join(record.name for record in records))
    estimates = Estimates(
        names=(*(names[i] for i in own), *(_NOISES[name] for name in seen)),
        values=values,
        covariance=covariance,
        degrees_of_freedom=freedom,
        sources=source,
        explained={} if shown is None else _explained([names[i] for i in own], shown),
        not_seen=_not_seen(vehicle, names, signals) | swamped,
        remarks=(*_remarks(predictor, fitted, names), *steep_remarks(records)),
        variation=variation,
    )
    delay = None
    if DELAY in names:
        i = names.index(DELAY)
        deviation = float(np.sqrt(uncertainty.covariance[i, i]))
        delay = Delay(float(fitted.parameters[i]), deviation, float(uncertainty.degrees_of_freedom[i]))
    return RotorIdentification(estimates, delay, fitted.noise, shown, fitted, evidence)


def _wide(sought: Sequence[_Sought], fitted: PredictionFit, uncertainty: Uncertainty) -> dict[str, str]:
    """Return the parameters that are not identified, with the reason.

    These are parameters at a limit, with too wide an interval, or determined by a single part of the flights.
    """
    quantiles = quantile(uncertainty.degrees_of_freedom)
    reaches = quantiles * np.sqrt(np.diag(uncertainty.covariance))
    found = {}
    columns = zip(sought, fitted.parameters, reaches, uncertainty.degrees_of_freedom, strict=True)
    for each, value, reach, freedom in columns:
        size = min(each.scale, value) if each.least > 0.0 else each.scale
        near = _AT_LIMIT * each.scale
        if value - each.least < near or each.most - value < near:
            found[each.name] = f"the best fit is at the limit of what is looked for, {value:.3g}"
        elif reach > _TOLD * size:
            found[each.name] = (
                f"its interval would be {plus_minus(value, reach)}, from the differences between parts of the flights"
            )
        elif freedom < _FEWEST_DEGREES:
            found[each.name] = f"hardly more than one stretch of the flights tells it, as {value:.3g}"
    found.pop(DELAY, None)
    return found


def _swamped(vehicle: Any, predictor: Predictor, sought: Sequence[_Sought], fitted: PredictionFit) -> dict[str, str]:
    """Numbers of drag that is less than what disturbs, each with the reason why it is not told.

    Wind depends on the place, and a controller lets it push the vehicle: so it goes with velocity, by a part that no
    interval from the flight itself knows. Where it is as large as drag, the estimate of drag is more of wind.
    """
    places = [i for i, output in enumerate(predictor.outputs) if output.signal == "position"]
    if not places:
        return {}
    positions = predictor.measured[predictor.counted][:, places]
    ahead = max(1, round(_SPEED / predictor.period))
    speed = np.sqrt(np.mean((positions[ahead:] - positions[:-ahead]) ** 2, axis=(0, 2))) / (ahead * predictor.period)
    push = float(vehicle.mass) * fitted.noise.force
    found = {}
    for each, value in zip(sought, fitted.parameters, strict=True):
        axes = [0, 1] if each.name == "linear_drag" else [int(each.name[-2])] if "drag.linear" in each.name else []
        if axes and np.any(push[axes] > value * speed[axes]):
            found[each.name] = (
                f"what disturbs, as wind does, is {push[axes].max():.2g} N, and drag itself"
                f" {(value * speed[axes]).min():.2g} N"
            )
    return found


_TELLS = {
    "inertia[0]": ("body rate p", "roll"),
    "inertia[1]": ("body rate q", "pitch"),
    "inertia[2]": ("body rate r", "yaw"),
    "rotor_inertia": ("body rate r", "yaw"),
    "centre_of_mass[0]": ("body rate q", "pitch"),
    "centre_of_mass[1]": ("body rate p", "roll"),
    "body_drag.centre_of_pressure[2]": ("body rate q", "pitch"),
    "body_drag.linear[0]": ("position x",),
    "body_drag.linear[1]": ("position y",),
    "linear_drag": ("position x",),
    "rotor_time_constant": ("body rate p", "roll"),
    "rotor_time_constant_down": ("body rate p", "roll"),
}


def _explained(names: Sequence[str], shown: Forecast) -> dict[str, Explained]:
    """The score of the output that tells each number best."""
    shares = dict(zip(shown.names, shown.explained, strict=True))
    found = {}
    for name in names:
        for output in _TELLS.get(name, ("specific force along z", "position z")):
            if output in shares:
                found[name] = Explained(float(shares[output]), output)
                break
    return found


def _not_seen(vehicle: Any, names: Sequence[str], signals: set[str]) -> dict[str, str]:
    """Why numbers are not told."""
    why = {
        "mass": "motions tell forces over mass only; weigh it",
        "drag_factor": "motions tell it over inertia[2] only; inertia[2] rests on its value in the scenario",
    }
    if vehicle.motors.take_throttles:
        why["thrust_factor"] = "motors that take throttles show their thrust, not their speed"
    for each in _sought(vehicle, signals):
        if each.name != DELAY and each.name not in names:
            why[each.name] = "the flights hardly depend on it: its interval would be wider than the number itself"
    if "linear_drag" in names and vehicle.quadratic_drag > 0.0:
        why["quadratic_drag"] = (
            "in wind that is not logged it looks like linear drag, and linear_drag has that part of it in it"
        )
    if FORCE in signals and "position" not in signals and vehicle.body_drag is not None:
        why |= {
            f"body_drag.linear[{i}]": "without positions or velocities, drag and speed are told as a product only"
            for i in range(3)
        }
    return why


def _remarks(predictor: Predictor, fitted: PredictionFit, names: Sequence[str]) -> tuple[str, ...]:
    time = len(predictor.windows) * predictor.sizes.length * predictor.inputs.period * predictor.split
    found = [f"{time:.1f} s in the air in {len(predictor.windows)} windows, {fitted.rounds} rounds"]
    if "rotor_time_constant_down" in names:
        up, down = (fitted.parameters[names.index(f"rotor_time_constant{end}")] for end in ("", "_down"))
        found.append(f"the lag of small motions is between its two: {500.0 * (up + down):.3g} ms in the mean")
    return tuple(found)
