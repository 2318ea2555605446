"""Drag, translational lift and thrust from the force that a flight shows beside its weight.

What moves a vehicle is known from its acceleration, or from the residual force where a log has that, and so is the
attitude in which it acts. With the air's velocity u relative to the vehicle, in the axes of the body,

    F_x = (c₁ₓ + c₂ₓ |u|) u_x + b_x,               F_y in the same way,
    F_z = a + k T(t) + (c_climb + c₂_z |u|) u_z + c_lift (u_x² + u_y²),

where T is the thrust that was commanded, as the autopilot believes it, after delay and lag. All but the lag is linear
and found by least squares; no flight is integrated, so that a force that the wind changes for seconds is no error of
where the vehicle is. Forces and what explains them go through one filter of 0.1 s, which shifts nothing and keeps
noise out. b is the trim: a body that leans where its autopilot takes it for level, or a wind that nobody told.

What is left hangs together for seconds, as gusts do, and all over a log, as a wind does that is not quite what it is
said to be. Deviations are those of clusters, stretches of 3 s or whole logs, whichever scatter more, corrected for how
much each of a few clusters moves the fit (R. M. Bell and D. F. McCaffrey, "Bias reduction in standard errors for linear
regression with multi-stage samples", Survey Methodology 28, 2002).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError, shown
from drake_quad.identification.fitting.evidence import bias_reduced, explained_share
from drake_quad.identification.fitting.open_loop import delay_of, thrust_by_share
from drake_quad.identification.fitting.windows import airborne, common_period, held_out, pieces
from drake_quad.identification.identified import Fitted, Spread
from drake_quad.identification.logs.attitudes import rotations
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.results.estimates import Estimates, Explained, Source, kind_of
from drake_quad.identification.results.vehicle_numbers import number_of
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.winds.source import steady_wind
from drake_quad.vehicle.motors import thrust_of

METHOD = "least squares on the residual force"
# Of a stretch, s.
STRETCH = 3.0
# Of the filter, and of the beginning of a log in which commands from before it are still at work, s.
_SMOOTH, _BEFORE = 0.1, 0.5
# In which what is left is one sample of noise where it is weighed against what is believed, s.
_TOGETHER = 0.5
# Stretches, at least, and logs from which on whole ones are left out.
_FEWEST, _LOGS = 5, 3
# Standard deviation of the speed along an axis, m/s, below which noise is too large a share of it.
_STILL = 0.2
# Of the other axis' speed, below which the air hardly moves along one.
_MOVED = 0.3
_LONGEST_LAG, _LAG_STEP = 0.4, 1e-3
# A standard deviation that is a larger share of what a number may well be off by: the logs do not tell it.
_TOLD = 0.5
# Standard deviation of what is anywhere within a sample, and is measured anywhere within another, in samples.
_WITHIN = float(np.sqrt(2.0 / 12.0))
# Of its own error, what a cluster leaves in the fit, at least.
_LEFT = 1e-3
# Beliefs, in so many of these.
_WEAK = 4.0
_NEVER_NEGATIVE = ("body_drag", "rotor_aerodynamics.lift")
_LAG, _TRIM, _LEVEL, _SLOPE = "rotor_time_constant", "trim", "level", "slope"
_CURVE = ("motors.curve[0]", "motors.curve[1]")


@dataclass(frozen=True, eq=False)
class Forces:
    """What forces tell.

    Attributes:
        estimates: drag, lift and climb; the thrust curve, if the vehicle takes throttles; the lag of the thrust, if it
            is known from its command only.
        outputs: the residual force along each axis of the body, beside what these numbers make of it.
        further: trim along x and y, and what thrust is over its command.
        remarks: sentences.
    """

    estimates: Estimates
    outputs: tuple[Fitted, ...]
    further: dict[str, Spread]
    remarks: tuple[str, ...]


class _Column(NamedTuple):
    """A number and what it is multiplied by, (W, T); what is believed of it, and by how much it may well be off."""

    name: str
    values: np.ndarray
    believed: float
    scale: float


class _Target(NamedTuple):
    """The force that is fitted along an axis.

    Attributes:
        axis: x, y or z.
        force: (W, T) all but the weight, N.
        thrust: (W, T) of it, what was commanded, N.
    """

    axis: str
    force: np.ndarray
    thrust: np.ndarray


class _Fit(NamedTuple):
    """Numbers along an axis.

    Attributes:
        names: (p,).
        values: (p,).
        covariance: (p, p).
        freedom: (p,) degrees of freedom.
        predicted: (W, T) force, N.
        not_seen: why a number is not told, by its name.
        below: names of those that came out below zero and are held there.
        explained: what a number is good for, beside what was believed of it, by its name.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    freedom: np.ndarray
    predicted: np.ndarray
    not_seen: dict[str, str]
    below: tuple[str, ...]
    explained: dict[str, Explained]

    def of(self, name: str, unit: str) -> Spread:
        """A number with its standard deviation."""
        place = self.names.index(name)
        deviation = float(np.sqrt(self.covariance[place, place]))
        return Spread(float(self.values[place]), deviation, unit, float(self.freedom[place]))


class _Stretches:
    """Stretches of logs, all of one length: (W, T) of what is filtered, in samples.

    Raises:
        InputError: the logs are of different rates.
    """

    def __init__(self, records: Sequence[FlightRecord], share: float, stretch: float) -> None:
        period = common_period(records)
        self.records = records
        self.length = max(2, round(stretch / period))
        self._width = max(1, round(_SMOOTH / period)) // 2 * 2 + 1
        logs, starts, unseen = [], [], []
        for number, record in enumerate(records):
            flying = airborne(record)
            late = held_out(flying, share) if flying.any() and share > 0.0 else np.zeros(len(flying), dtype=bool)
            piece, margin = pieces(record), self._width
            start = max(margin, round(_BEFORE / record.period))
            while start + self.length + margin <= len(record.time):
                around = slice(start - margin, start + self.length + margin)
                if flying[around].all() and piece[around][0] == piece[around][-1]:
                    logs.append(number)
                    starts.append(start)
                    unseen.append(bool(late[start : start + self.length].any()))
                    start += self.length
                else:
                    start += 1
        self.log, self.starts, self.unseen = np.array(logs, int), np.array(starts, int), np.array(unseen, bool)
        self.period = period

    def of(self, series: Sequence[np.ndarray]) -> np.ndarray:
        """(W, T) of a signal (n,) of each log, filtered."""
        box = np.ones(self._width) / self._width
        smooth = [np.convolve(each, box, "same") for each in series]
        return self.cut(smooth)

    def cut(self, series: Sequence[np.ndarray]) -> np.ndarray:
        """(W, T) of a signal (n,) of each log."""
        steps = np.arange(self.length)
        return np.stack([series[log][start + steps] for log, start in zip(self.log, self.starts, strict=True)])


class _Motion(NamedTuple):
    """Of a log.

    Attributes:
        air: (n, 3) velocity of the air relative to the vehicle, in B, m/s.
        force: (n, 3) all but the weight, in B, N.
        commanded: (n,) thrust, N.
    """

    air: np.ndarray
    force: np.ndarray
    commanded: np.ndarray

    @property
    def speed(self) -> np.ndarray:
        """(n,) of the air, m/s."""
        return np.asarray(np.linalg.norm(self.air, axis=1))


def tells_forces(record: FlightRecord) -> bool:
    """Does a log have the residual force, and what explains it?"""
    thrust = record.thrust_share is not None or record.thrust_command is not None
    return thrust and all(each is not None for each in (record.residual_force, record.velocity, record.attitude))


def identify_forces(
    records: Sequence[FlightRecord],
    scenario: Scenario,
    *,
    delay_deviation: float = 0.0,
    held_out_share: float = 1.0 / 3.0,
    stretch: float = STRETCH,
) -> Forces:
    """Identifies drag, lift, and thrust over its command.

    Args:
        records: of flights of the same vehicle, with velocity, attitude and a command of thrust. Where a log has no
            residual force it follows from the velocity. Logs that do not say how the air moves are left out where
            others do; where none does, it moves as the steady wind of the scenario.
        scenario: to begin with; its mass and delay are believed, and its `nominal` vehicle is what the autopilot knows.
        delay_deviation: standard deviation of the error of the delay, s.
        held_out_share: of the time in the air, at the end of each log, that is only predicted.
        stretch: that is taken for one, s: the shorter, the less must gusts hang together.

    Raises:
        InputError: a log lacks a signal, logs are of different rates, or there is too little flight.
    """
    told = [record for record in records if record.wind is not None]
    used, remarks = told or [*records], []
    if not told:
        remarks.append("no log says how the air moved: drag is that against the wind of the vehicle to begin with")
    elif len(told) < len(records):
        names = ", ".join(record.name for record in records if record.wind is None)
        remarks.append(f"forces of {names} are not used: how the air moved is said of other logs only")
    stretches = _Stretches(used, held_out_share, stretch)
    if (~stretches.unseen).sum() < _FEWEST:
        raise InputError(
            f"there are {(~stretches.unseen).sum()} stretches of {stretch:g} s in the air to be fitted, too few:"
            f" it takes {_FEWEST}"
        )
    motions = [_motion(record, scenario) for record in used]
    across = [_across(stretches, motions, scenario, axis) for axis in range(2)]
    fits = [*across, _along(stretches, motions, scenario, delay_deviation)]
    weight = scenario.vehicle.mass * scenario.vehicle.gravity
    further = {}
    for axis, each in zip("xy", across, strict=True):
        force, deviation, unit, freedom = each.of(_TRIM, "N")
        further[f"trim force along {axis}"] = Spread(force, deviation, unit, freedom)
        further[f"tilt that makes it along {axis}"] = Spread(force / weight, deviation / weight, "rad", freedom)
    further["change of thrust over what is commanded"] = fits[2].of(_SLOPE, "1")
    remarks += [
        f"{name} came out below zero, where it makes no sense, and is held there" for fit in fits for name in fit.below
    ]
    return Forces(_estimates(fits, scenario, stretches), _outputs(fits, stretches, motions), further, tuple(remarks))


def linear_drag(record: FlightRecord, scenario: Scenario, *, block: float = 0.5) -> tuple[Spread, Spread]:
    """Drag along x and y of the body of a flight that is too short to tell linear and quadratic drag apart, N s/m.

    Least squares of the force on the velocity and a constant, with deviations by how blocks scatter; of an axis along
    which the air hardly moved, that of the other.

    Args:
        record: with velocity, attitude and a command of thrust.
        scenario: whose mass is believed, and whose steady wind blows where the log has none.
        block: s.

    Raises:
        InputError: a signal is not logged, the log is too short, or the vehicle hovers.
    """
    motion = _motion(record, scenario)
    width = max(1, round(_SMOOTH / record.period))
    box, inside = np.ones(width) / width, slice(2 * width, -2 * width)
    blocks = np.floor(record.time / block).astype(int)[inside]
    if len(np.unique(blocks)) < 2:
        raise InputError(f"{record.name}: is too short to tell drag")
    if motion.air[:, :2].std(axis=0).max() < _STILL:
        raise InputError(f"{record.name}: hovers, which does not tell drag")
    found, moved = [], []
    for axis in range(2):
        air, force = (np.convolve(each[:, axis], box, "same")[inside] for each in (motion.air, motion.force))
        rows = np.column_stack([air, np.ones_like(air)])
        squares = np.linalg.inv(rows.T @ rows)
        values = squares @ rows.T @ force
        left = rows * (force - rows @ values)[:, None]
        scores = np.stack([left[blocks == each].sum(axis=0) for each in np.unique(blocks)])
        covariance = len(scores) / (len(scores) - 1) * squares @ scores.T @ scores @ squares
        found.append(Spread(float(values[0]), float(np.sqrt(covariance[0, 0])), "N s/m", len(scores) - 1.0))
        moved.append(float(air.std()))
    most = int(np.argmax(moved))
    alike = [each if speed > _MOVED * moved[most] else found[most] for each, speed in zip(found, moved, strict=True)]
    return alike[0], alike[1]


def _motion(record: FlightRecord, scenario: Scenario) -> _Motion:
    turned = rotations(record.of("attitude")).inv()
    velocity, commanded = record.of("velocity"), _commanded(record, scenario)
    wind = np.asarray(steady_wind(scenario.laboratory.wind), dtype=float) if record.wind is None else record.wind
    if record.residual_force is not None:
        force = turned.apply(record.residual_force) + commanded[:, None] * np.array([0.0, 0.0, 1.0])
    else:
        acceleration = np.gradient(velocity, record.time, axis=0) + np.array([0.0, 0.0, scenario.vehicle.gravity])
        force = scenario.vehicle.mass * turned.apply(acceleration)
    return _Motion(turned.apply(wind - velocity), force, commanded)


def _commanded(record: FlightRecord, scenario: Scenario) -> np.ndarray:
    """(n,) thrust as it was commanded, N; of the rotors' speeds, where they were measured.

    Raises:
        InputError: nothing of it is logged, or the share of hover is zero or less.
    """
    weight = scenario.vehicle.mass * scenario.vehicle.gravity
    curve = scenario.nominal.motors.thrust_curve()
    speed = record.rotor_speed if record.rotor_speed is not None else record.rotor_speed_command
    if record.rotor_speed is None and record.thrust_share is not None and record.hover_share is not None:
        return thrust_by_share(record, weight)
    if record.rotor_speed is None and record.thrust_command is not None:
        return record.thrust_command
    if record.rotor_speed is None and curve is not None:
        shares: Any = record.motor_command
        if shares is None and record.thrust_share is not None:
            shares = np.repeat(record.thrust_share[:, None], 4, axis=1)
        if shares is not None:
            return np.asarray(thrust_of(shares, curve)).sum(axis=1)
    if speed is not None:
        return np.asarray(scenario.nominal.thrust_factor * (speed**2).sum(axis=1))
    raise InputError(
        f"the log {shown(record.name)} says nothing of the thrust: it needs thrust_command, thrust_share or commands of"
        f" rotors, and has {', '.join(record.names)}"
    )


def _across(stretches: _Stretches, motions: Sequence[_Motion], scenario: Scenario, axis: int) -> _Fit:
    """Drag along x or y of the body."""
    mass = scenario.vehicle.mass
    air = [motion.air[:, axis] for motion in motions]
    rows = (
        (f"body_drag.linear[{axis}]", air, 0.3 * mass),
        (f"body_drag.quadratic[{axis}]", [m.speed * u for m, u in zip(motions, air, strict=True)], 0.05 * mass),
        (_TRIM, [np.ones_like(u) for u in air], 0.2 * mass * scenario.vehicle.gravity),
    )
    columns = [
        _Column(name, stretches.of(values), 0.0 if name == _TRIM else number_of(scenario, name), scale)
        for name, values, scale in rows
    ]
    force = stretches.of([motion.force[:, axis] for motion in motions])
    target = _Target("xy"[axis], force, np.zeros_like(force))
    *drag, trim = columns
    speed = float(drag[0].values[~stretches.unseen].std())
    if speed > _STILL:
        return _fit(columns, target, stretches)
    believed = sum(column.believed * column.values for column in drag)
    fit = _fit([trim], target._replace(force=force - believed), stretches)
    why = f"the air along {'xy'[axis]} of the body moves by {speed:.2g} m/s, too little beside noise"
    return fit._replace(predicted=fit.predicted + believed, not_seen={column.name: why for column in drag})


def _along(stretches: _Stretches, motions: Sequence[_Motion], scenario: Scenario, delay_deviation: float) -> _Fit:
    """Drag and lift along z of the body, and thrust over its command.

    The delay has an error, s. When within a sample a command begins is not known, nor when within it a force is
    measured. By how much numbers change with a command that is later by the standard deviation of these together is
    part of their covariance: above all the lag, which is shorter by next to as much as the delay is longer.

    A lag that is not told stays as in the vehicle, and the rest is fitted with it.
    """
    delay, step = float(delay_of(scenario)), stretches.period * _WITHIN
    delays = delay, delay + step
    fit, later = (_along_after(stretches, motions, scenario, each) for each in delays)
    if _LAG in fit.not_seen:
        why, lag = {_LAG: fit.not_seen[_LAG]}, number_of(scenario, _LAG)
        fit, later = (_along_after(stretches, motions, scenario, each, lag) for each in delays)
        fit = fit._replace(not_seen=fit.not_seen | why)
    change = (later.values - fit.values) / step * np.hypot(step, delay_deviation)
    return fit._replace(covariance=fit.covariance + np.outer(change, change))


def _along_after(
    stretches: _Stretches, motions: Sequence[_Motion], scenario: Scenario, delay: float, lag: float | None = None
) -> _Fit:
    """The same with commands that act after a delay, and with a lag, s, that is sought if it is None."""
    mass, weight = scenario.vehicle.mass, scenario.vehicle.mass * scenario.vehicle.gravity
    rows = (
        ("body_drag.quadratic[2]", [m.speed * m.air[:, 2] for m in motions], 0.05 * mass),
        ("rotor_aerodynamics.climb", [m.air[:, 2] for m in motions], 0.3 * mass),
        ("rotor_aerodynamics.lift", [m.air[:, 0] ** 2 + m.air[:, 1] ** 2 for m in motions], 0.05 * mass),
    )
    columns = [_Column(name, stretches.of(values), number_of(scenario, name), scale) for name, values, scale in rows]
    columns.append(_Column(_LEVEL, np.ones_like(columns[0].values), 0.0, weight))
    target = _Target(
        "z",
        stretches.of([motion.force[:, 2] for motion in motions]),
        stretches.of([motion.commanded for motion in motions]),
    )

    def thrust(lag: float) -> np.ndarray:
        followed = [
            _followed(record.time, motion.commanded, delay, lag)
            for record, motion in zip(stretches.records, motions, strict=True)
        ]
        return stretches.of(followed)

    if all(record.rotor_speed is not None for record in stretches.records):
        return _fit([*columns, _Column(_SLOPE, target.thrust, 1.0, 0.5)], target, stretches)
    if lag is not None:
        return _fit([*columns, _Column(_SLOPE, thrust(lag), 1.0, 0.5)], target, stretches)

    def left(lag: float) -> float:
        found = _solved([*columns, _Column(_SLOPE, thrust(lag), 1.0, 0.5)], target.force, stretches)
        return float(np.sum((target.force - found)[~stretches.unseen] ** 2))

    lag = float(scipy.optimize.minimize_scalar(left, bounds=(0.0, _LONGEST_LAG), method="bounded").x)
    slope = _Column(_SLOPE, thrust(lag), 1.0, 0.5)
    change = _fit([*columns, slope], target, stretches).of(_SLOPE, "1").value
    later = change * (thrust(lag + _LAG_STEP) - slope.values) / _LAG_STEP
    # Around the lag that was found: what is predicted has it already.
    columns += [slope, _Column(_LAG, later, lag, 0.04)]
    fit = _fit(columns, target._replace(force=target.force + lag * later), stretches)
    place = fit.names.index(_LAG)
    values, kind = fit.values.copy(), kind_of(_LAG)
    values[place] = np.clip(values[place], kind.least, kind.most)
    return fit._replace(values=values, predicted=fit.predicted + (values - fit.values)[place] * later - lag * later)


def _followed(time: np.ndarray, command: np.ndarray, delay: float, lag: float) -> np.ndarray:
    """(n,) what follows a command that holds until the next sample, a delay later and with a lag, s."""
    steps = np.diff(time)
    integral = np.concatenate([[0.0], np.cumsum(command[:-1] * steps)])
    # Before the log as at its first sample.
    before = np.concatenate([[time[0] - delay - 1.0], time]), np.concatenate([[-command[0] * (delay + 1.0)], integral])
    means = np.diff(np.interp(time - delay, *before)) / steps
    followed = np.empty_like(command)
    followed[0] = command[0]
    shares = 1.0 - np.exp(-steps / lag) if lag > 0.0 else np.ones_like(steps)
    for i, (share, mean) in enumerate(zip(shares.tolist(), means.tolist(), strict=True)):
        followed[i + 1] = followed[i] + share * (mean - followed[i])
    return followed


def _solved(columns: Sequence[_Column], force: np.ndarray, stretches: _Stretches) -> np.ndarray:
    """(W, T) force by plain least squares."""
    rows = np.stack([column.values for column in columns], axis=-1)
    seen = ~stretches.unseen
    flat = rows[seen].reshape(-1, len(columns))
    return np.asarray(rows @ np.linalg.lstsq(flat, force[seen].ravel(), rcond=None)[0])


def _fit(columns: Sequence[_Column], target: _Target, stretches: _Stretches) -> _Fit:
    """Least squares with weak beliefs; numbers that are not told, or are below zero, are held, and the rest fitted.

    Args:
        columns: of the numbers.
        target: what is fitted.
        stretches: of the logs.
    """
    force = target.force
    names = tuple(column.name for column in columns)
    believed, scales = (np.array([getattr(column, each) for column in columns]) for each in ("believed", "scale"))
    rows = np.stack([column.values for column in columns], axis=-1)
    seen = ~stretches.unseen
    left = (force - rows @ believed)[seen]
    squares = np.einsum("wtp,wtq->wpq", rows[seen], rows[seen])
    products = np.einsum("wtp,wt->wp", rows[seen], left)
    white = float(np.mean((force - _solved(columns, force, stretches))[seen] ** 2))
    noise = max(white, 1e-12) * max(1.0, _TOGETHER / stretches.period)
    reach = _WEAK * scales

    def solved(held: np.ndarray) -> np.ndarray:
        """(p,) by how much the numbers are off what is believed, where some are held."""
        beliefs = np.diag(1.0 / np.where(held, 1e-6 * scales, reach) ** 2)
        return np.asarray(np.linalg.solve(squares.sum(axis=0) / noise + beliefs, products.sum(axis=0) / noise))

    off = solved(np.zeros(len(names), dtype=bool))
    weighed = np.linalg.inv(squares.sum(axis=0) / noise + np.diag(reach**-2.0))
    covariance, freedom = _clustered(squares / noise, (products - squares @ off) / noise, weighed, stretches.log[seen])
    deviations = np.sqrt(np.diag(covariance))
    own = np.array([name in (_TRIM, _LEVEL, _SLOPE) for name in names])
    untold = (deviations > _TOLD * scales) & ~own
    not_seen = {
        names[i]: (
            f"the flight does not excite it: its standard deviation would be {deviations[i]:.2g}, where it may well be"
            f" off by {scales[i]:.2g}"
        )
        for i in np.flatnonzero(untold)
    }
    off = solved(untold)
    never = np.array([name.startswith(_NEVER_NEGATIVE) for name in names])
    below = never & ~untold & (believed + off < 0.0)
    if below.any():
        # Held at zero: what is believed of it does not count.
        zero = np.where(below, -believed, 0.0)
        products = products - np.einsum("wpq,q->wp", squares, zero)
        off = solved(untold | below) + zero
    values = np.where(below, 0.0, np.where(untold, believed, believed + off))
    chosen = stretches.unseen if stretches.unseen.any() else seen
    rest = (force - rows @ values)[chosen]
    changed = rest[..., None] + rows[chosen] * (values - believed)
    whole = float(np.var((force - target.thrust)[chosen])) * rest.size
    worth = explained_share(np.sum(rest**2), whole) - explained_share(np.sum(changed**2, axis=(0, 1)), whole)
    explained = {
        name: Explained(min(float(share), 1.0), f"residual force {target.axis}")
        for name, share in zip(names, worth, strict=True)
        if share > 0.0
    }
    held = tuple(names[i] for i in np.flatnonzero(below))
    return _Fit(names, values, covariance, freedom, rows @ values, not_seen, held, explained)


def _clustered(
    squares: np.ndarray, scores: np.ndarray, weighed: np.ndarray, logs: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(p, p) covariance, and (p,) degrees of freedom.

    Correlations and, at least, deviations are those of stretches; larger ones are of whole logs, or what noise and
    beliefs alone would give.

    Args:
        squares: (W, p, p) of each stretch, over the variance of the noise.
        scores: (W, p) of each stretch, at the solution.
        weighed: (p, p) covariance by noise and beliefs.
        logs: (W,) the log of each stretch.
    """
    count = len(logs)
    # A number that nothing excites scatters not at all.
    covariance = bias_reduced(squares, scores, weighed, least=_LEFT) + _LEFT**2 * np.diag(np.diag(weighed))
    own = np.sqrt(np.diag(covariance))
    deviations, freedom = np.maximum(own, np.sqrt(np.diag(weighed))), np.full(len(own), count - 1.0)
    groups = logs == np.unique(logs)[:, None]
    if len(groups) >= _LOGS:
        whole, sums = (np.stack([each[group].sum(axis=0) for group in groups]) for each in (squares, scores))
        of_logs = np.sqrt(np.diag(bias_reduced(whole, sums, weighed, least=_LEFT)))
        freedom = np.where(of_logs > deviations, len(groups) - 1.0, freedom)
        deviations = np.maximum(deviations, of_logs)
    factor = deviations / own
    return covariance * np.outer(factor, factor), freedom


def _estimates(fits: Sequence[_Fit], scenario: Scenario, stretches: _Stretches) -> Estimates:
    """All that is told, in the language of scenarios."""
    names = [name for fit in fits for name in fit.names]
    values = np.concatenate([fit.values for fit in fits])
    covariance = scipy.linalg.block_diag(*(fit.covariance for fit in fits))
    freedom = np.concatenate([fit.freedom for fit in fits])
    not_seen = {name: why for fit in fits for name, why in fit.not_seen.items()}
    curve = scenario.nominal.motors.thrust_curve()
    kept = [i for i, name in enumerate(names) if name not in not_seen and name not in (_TRIM, _LEVEL, _SLOPE)]
    turned = np.eye(len(names))[kept]
    told = [names[i] for i in kept]
    freedom_of = list(freedom[kept])
    if scenario.vehicle.motors.take_throttles and curve is not None and curve.k_2 == 0.0:
        level, slope = names.index(_LEVEL), names.index(_SLOPE)
        rows = np.zeros((2, len(names)))
        rows[0, [level, slope]] = 0.25, curve.k_0
        rows[1, slope] = curve.k_1
        turned, told = np.vstack([rows, turned]), [*_CURVE, *told]
        freedom_of = [min(freedom[level], freedom[slope]), freedom[slope], *freedom_of]
    if not told:
        raise InputError("the logs tell nothing of drag and lift: the vehicle hardly moves through the air")
    explained = {name: share for fit in fits for name, share in fit.explained.items() if name in told}
    source = Source(METHOD, ", ".join(dict.fromkeys(record.name for record in stretches.records)))
    return Estimates(
        tuple(told), turned @ values, turned @ covariance @ turned.T, np.array(freedom_of), source, explained, not_seen
    )


def _outputs(fits: Sequence[_Fit], stretches: _Stretches, motions: Sequence[_Motion]) -> tuple[Fitted, ...]:
    """The residual force: what there is beside weight and the thrust that was commanded."""
    log = np.array([stretches.records[number].name for number in stretches.log])
    time = stretches.cut([record.time for record in stretches.records])
    commanded = stretches.of([motion.commanded for motion in motions])
    found = []
    for axis, fit in enumerate(fits):
        thrust = commanded if axis == 2 else 0.0
        measured = stretches.of([motion.force[:, axis] for motion in motions]) - thrust
        predicted = fit.predicted - thrust
        share = {unseen: _share(measured, predicted, stretches.unseen == unseen) for unseen in (True, False)}
        deviation = float(np.std(np.diff(measured - predicted, axis=1)) / np.sqrt(2.0))
        found.append(
            Fitted(
                f"residual force {'xyz'[axis]}",
                "N",
                log,
                time,
                measured,
                predicted,
                stretches.unseen,
                share[True],
                share[False],
                deviation,
            )
        )
    return tuple(found)


def _share(measured: np.ndarray, predicted: np.ndarray, chosen: np.ndarray) -> float:
    """Return the share of the variance around the mean that is explained; NaN where nothing varies."""
    if not chosen.any():
        return np.nan
    return float(explained_share(np.mean((measured - predicted)[chosen] ** 2), np.var(measured[chosen])))
