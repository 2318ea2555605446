"""Identification of the position law that flew a log: gains, integral, feed-forward, filter, limit and delay.

On each axis the output of the law at time t, sampled by the logged commands, is

    u(t) = k_p e + k_v (-v_f) + k_r v_r + k_a a_r + k_i ∫e - k_x p + b,      all at t - delay

with the position error e = p_r - p, which may be limited, the measured velocity v_f behind a lag of first order, the
reference's velocity v_r and acceleration a_r, and a constant b for each stretch of flight. PD and PID are this law with
k_r = k_v or 0 and k_x = 0. A cascade P(position) → PI(velocity) with gains K, k, k_i' and the share f of v_r has

    k_p = k K + f k_i',  k_v = k,  k_r = f k,  k_i = k_i' K,  k_x = (1 - f) k_i'

For given delay, filter and limit the gains are linear least squares; these three minimise what that leaves
(separable least squares: G. H. Golub and V. Pereyra, Inverse Problems 19, R1, 2003). Filter, limit and k_x are part of
the law only if they explain more in the mean of blocks of the flight, by a paired t interval. The intervals are those
of the jackknife over blocks, `drake_quad.identification.evidence`.

The logged signals should be those that the controller used. If they differ by an error, the gains are too small: with
one regressor by the share 1 - R² of the variance that is not explained (W. A. Fuller, "Measurement Error Models", 1987,
section 1.1). Axes with 1 - R² above 5 % are therefore not identified.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError, shown
from drake_quad.identification.evidence import explained_share, inverted, jackknife, of_blocks
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.position_law.commands import FORMS, Form, at_limit, commanded, specific_thrust
from drake_quad.identification.prepared_logs import MAX_DELAY, MIN_BLOCKS
from drake_quad.identification.result import Spread
from drake_quad.identification.results.estimates import quantile
from drake_quad.identification.windows import airborne, pieces as piece_numbers
from drake_quad.scenario.models import Scenario

_MIN_EXPLAINED = 0.95
_BLOCK = 2.0  # s, several times the memory of filters and quantisation
_MIN_SHARE = 1e-12  # of variance, below which rounding decides
_MIN_PIECE = 2.0  # s, shortest stretch of flight with a constant b of its own
_SMOOTHING = 0.1  # s, of parabolas through the reference for its derivatives
_MIN_REFERENCE_SPEED = 0.01  # m/s, standard deviation of a reference that moves
# Critical value of χ² with one degree of freedom at 99.9 %: more than a dozen comparisons are made for a log.
_LIKELIHOOD_RATIO = 10.83
_MAX_REFERENCE_ACCELERATION = 50.0  # m/s², 5 g; a reference with more jumps
_FILTERS = (0.01, 0.03, 0.1)  # s, time constants where the search begins
_MAX_FILTER = 0.5  # s
_LIMIT_QUANTILES = (0.6, 0.75, 0.9)  # of |e|, where the search for its limit begins
# A parameter is identified if its 95 % interval reaches no farther than this share of its typical size.
_MAX_REACH = 0.5
_TYPICAL_INTEGRAL_TIME = 1.0  # s, k_p / k_i of a usual PID
_TYPICAL_DELAY = 0.05  # s
_AXES = ("x", "y", "z")

_ESSENTIAL = ("position", "velocity")
_OF_REFERENCE = ("reference_velocity", "reference_acceleration", "displacement")


class Shape(NamedTuple):
    """Parameters in which the law is not linear.

    Attributes:
        delay: delay from a logged measurement to the logged command, s.
        filter_time: time constant of the filter of the velocity, s; 0 without one.
        error_limit: largest position error, m.
    """

    delay: float = 0.0
    filter_time: float = 0.0
    error_limit: float = np.inf


class Piece(NamedTuple):
    """Stretch of flight without a gap, as the regression takes it.

    Attributes:
        time: (m,), s.
        command: (m, 3) output of the law.
        error: (m, 3) p_r - p, m.
        position: (m, 3), m.
        velocity: (m, 3), m/s.
        reference_velocity: (m, 3), m/s.
        reference_acceleration: (m, 3), m/s².
        counted: (m,) mask of the samples that are compared.
    """

    time: np.ndarray
    command: np.ndarray
    error: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    reference_velocity: np.ndarray
    reference_acceleration: np.ndarray
    counted: np.ndarray


class _Fit(NamedTuple):
    """Law of some axes with the least squares.

    Attributes:
        terms: names of the linear terms.
        gains: (k,) their gains.
        shape: other parameters.
        free: names of the other parameters that are fitted.
        left: (n,) command that is not explained.
        explained: R².
    """

    terms: tuple[str, ...]
    gains: np.ndarray
    shape: Shape
    free: tuple[str, ...]
    left: np.ndarray
    explained: float


@dataclass(frozen=True)
class AxisLaw:
    """Law of one axis, or of X and Y if they are alike.

    Attributes:
        axes: axes that have this law.
        gains: estimate of each identified parameter by name: position, velocity, reference_velocity,
            reference_acceleration, integral, displacement, delay, filter_time and error_limit.
        explained: R², share of the variance of the command that the law explains.
        not_identified: reason for each parameter that the log does not identify.
        at_error_limit: share of the samples with a position error beyond its limit.
    """

    axes: tuple[str, ...]
    gains: Mapping[str, Spread]
    explained: float
    not_identified: Mapping[str, str] = field(default_factory=dict)
    at_error_limit: float = 0.0

    def gain(self, name: str) -> float:
        """Return the estimate of a parameter, 0 if it is not identified."""
        return self.gains[name].value if name in self.gains else 0.0


@dataclass(frozen=True)
class PositionLaw:
    """Position law that flew a log.

    Attributes:
        axes: laws of the axes that are identified.
        form: relation between the output of the law and the commands of attitude and thrust.
        at_limits: share of the samples that are left out, since a command is at a limit.
        not_identified: reason for each axis that the log does not identify.
        remarks: sentences on the fit.
    """

    axes: tuple[AxisLaw, ...]
    form: Form
    at_limits: float
    not_identified: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


def identify_position_law(records: Sequence[FlightRecord], scenario: Scenario) -> PositionLaw:
    """Identify the position law of the controller that flew some logs.

    Args:
        records: records of flights under the same controller, with position, reference_position, attitude_command (or
            attitude, whose lag is then part of the delay), and thrust_command or thrust_share.
        scenario: scenario with the `nominal` vehicle that the controller believed, for mass and gravity.

    Raises:
        InputError: a log lacks a signal, the reference stays where it is, or no axis is identified.
    """
    if not records:
        raise InputError("there is no log to identify a position law from")
    remarks: list[str] = []
    prepared = [_prepared(record, scenario, remarks) for record in records]
    candidates = {form: [piece for found in prepared for piece in found[0][form]] for form in FORMS}
    form = min(FORMS, key=lambda each: _unexplained(candidates[each]))
    pieces = candidates[form]
    laws, refused = [], {}
    fits = {axis: _chosen(pieces, (axis,)) for axis in range(3)}
    for axis, fit in fits.items():
        if not fit.explained >= _MIN_EXPLAINED:
            refused[_AXES[axis]] = _too_little(fit.explained)
    alike = not {"x", "y"} & refused.keys() and _alike(pieces, fits)
    groups = [(0, 1), (2,)] if alike else [(0,), (1,), (2,)]
    for group in groups:
        if not {_AXES[axis] for axis in group} & refused.keys():
            law = _axis_law(pieces, group, form, fits[group[0]] if len(group) == 1 else _chosen(pieces, group))
            weak = [name for name in _ESSENTIAL if name in law.not_identified]
            if weak:
                names = " and ".join(law.axes)
                refused[names] = "; ".join(f"{name}: {law.not_identified[name]}" for name in weak)
            else:
                laws.append(law)
    if not laws:
        reasons = "; ".join(f"{axis}: {reason}" for axis, reason in refused.items())
        raise InputError(f"cannot identify the position law: {reasons}")
    share = float(np.mean(np.concatenate([found[1] for found in prepared])))
    return PositionLaw(tuple(laws), form, share, refused, tuple(dict.fromkeys(remarks)))


def _too_little(explained: float) -> str:
    share = "nothing" if not explained > 0.0 else f"{100.0 * explained:.3g} %"
    return (
        f"a linear law of position, velocity and reference explains {share} of the variance of the command, and"
        f" {100.0 * _MIN_EXPLAINED:g} % are needed; are the logged position and velocity those that the controller used?"
    )


def _prepared(
    record: FlightRecord, scenario: Scenario, remarks: list[str]
) -> tuple[dict[Form, list[Piece]], np.ndarray]:
    """Return the pieces of a record for each form, and the mask of limited samples among those in the air."""
    reference, position = record.of("reference_position"), record.of("position")
    if record.attitude_command is None:
        record.of("attitude")
        remarks.append("no attitude command is logged; the measured attitude stands for it, and the delay has its lag")
    usable = airborne(record)
    if not usable.any():
        raise InputError(f"the log {shown(record.name)} has no sample in the air")
    if np.all(np.ptp(reference[usable], axis=0) < _MIN_REFERENCE_SPEED * _BLOCK):
        raise InputError(
            f"the reference of the log {shown(record.name)} does not move; a hover does not identify a position law"
        )
    thrust, remark = specific_thrust(record, scenario, usable)
    if remark is not None:
        remarks.append(remark)
    limited = at_limit(record, thrust, usable)
    counted = usable & ~limited
    number = piece_numbers(record)
    found: dict[Form, list[Piece]] = {form: [] for form in FORMS}
    for each in range(number.max() + 1):
        here = number == each
        if counted[here].sum() * record.period < _MIN_PIECE:
            continue
        piece = _piece(record.part(here), reference[here] - position[here], counted[here])
        for form in FORMS:
            command = commanded(record.part(here), thrust[here], form, float(scenario.nominal.gravity))
            found[form].append(piece._replace(command=command))
    if not found["tilt"]:
        raise InputError(f"the log {shown(record.name)} has no stretch of {_MIN_PIECE:g} s in the air without a gap")
    return found, limited[usable]


def _piece(record: FlightRecord, error: np.ndarray, counted: np.ndarray) -> Piece:
    """Return a piece without its command; derivatives that are not logged are those of smoothed signals."""
    reference, position = record.of("reference_position"), record.of("position")
    window = 2 * max(2, round(0.5 * _SMOOTHING / record.period)) + 1

    def slope(values: np.ndarray, order: int = 1) -> np.ndarray:
        """Return a derivative of parabolas through the values."""
        return np.asarray(
            scipy.signal.savgol_filter(values, window, 2, deriv=order, delta=record.period, axis=0, mode="interp")
        )

    velocity = slope(position) if record.velocity is None else record.velocity
    if record.reference_velocity is None:
        reference_velocity, acceleration = slope(reference), slope(reference, 2)
    else:
        reference_velocity, acceleration = record.reference_velocity, slope(record.reference_velocity)
    if record.reference_acceleration is not None:
        acceleration = record.reference_acceleration
    # A reference that jumps has no derivatives; the samples whose smoothed or delayed reference has the jump are left out.
    jumps = np.abs(slope(reference, 2)).max(axis=1) > _MAX_REFERENCE_ACCELERATION
    near = np.convolve(jumps, np.ones(1 + round(MAX_DELAY / record.period)))[: len(jumps)] > 0.5
    late = record.time >= record.time[0] + MAX_DELAY
    early = record.time <= record.time[-1] - record.period
    compared = counted & late & early & ~near
    return Piece(record.time, error, error, position, velocity, reference_velocity, acceleration, compared)


def _terms(pieces: Sequence[Piece], axes: tuple[int, ...]) -> tuple[str, ...]:
    """Return the terms that the flight excites on some axes."""
    speeds = np.concatenate([piece.reference_velocity[piece.counted][:, axes] for piece in pieces])
    moves = np.std(speeds) >= _MIN_REFERENCE_SPEED
    return (*_ESSENTIAL, *(_OF_REFERENCE if moves else ()), "integral")


def _columns(piece: Piece, axis: int, terms: Sequence[str], shape: Shape) -> np.ndarray:
    """Return the regressors (m, k) of a piece on an axis, without the delay."""
    error = np.clip(piece.error[:, axis], -shape.error_limit, shape.error_limit)
    velocity = piece.velocity[:, axis]
    if shape.filter_time > 0.0:
        keep = float(np.exp(-np.median(np.diff(piece.time)) / shape.filter_time))
        velocity, _ = scipy.signal.lfilter([1.0 - keep], [1.0, -keep], velocity, zi=[keep * velocity[0]])
    once = scipy.integrate.cumulative_trapezoid(error, piece.time, initial=0.0)
    twice = scipy.integrate.cumulative_trapezoid(once, piece.time, initial=0.0)
    columns = {
        "position": error,
        "velocity": -velocity,
        "reference_velocity": piece.reference_velocity[:, axis],
        "reference_acceleration": piece.reference_acceleration[:, axis],
        "integral": once,
        "displacement": -piece.position[:, axis],
        "double_integral": twice,
    }
    return np.column_stack([columns[name] for name in terms])


def _regression(
    pieces: Sequence[Piece], axes: tuple[int, ...], terms: Sequence[str], shape: Shape
) -> tuple[np.ndarray, np.ndarray]:
    """Return the regressors (n, k) and the commands (n,), each without its mean over the piece and axis."""
    regressors, commands = [], []
    for axis, piece in product(axes, pieces):
        at = piece.time[piece.counted] - shape.delay
        columns = _columns(piece, axis, terms, shape)
        delayed = np.column_stack([np.interp(at, piece.time, column) for column in columns.T])
        command = piece.command[piece.counted, axis]
        time = at - at.mean()
        both = np.column_stack([delayed, command])
        both -= both.mean(axis=0) + np.outer(time, time @ both / (time @ time))
        regressors.append(both[:, :-1])
        commands.append(both[:, -1])
    return np.concatenate(regressors), np.concatenate(commands)


def _solved(
    pieces: Sequence[Piece], axes: tuple[int, ...], terms: tuple[str, ...], shape: Shape, free: tuple[str, ...]
) -> _Fit:
    """Return the law with the gains of least squares for given other parameters."""
    regressors, commands = _regression(pieces, axes, terms, shape)
    # The normal equations cost a tenth of a decomposition of the regressors.
    products = regressors.T @ regressors
    gains = inverted(products, products) @ (regressors.T @ commands)
    left = commands - regressors @ gains
    return _Fit(terms, gains, shape, free, left, float(explained_share(left @ left, commands @ commands)))


def _searched(
    pieces: Sequence[Piece], axes: tuple[int, ...], terms: tuple[str, ...], starts: Sequence[Shape], free: tuple[str, ...]
) -> _Fit:
    """Return the law with the least squares, from the best of some starts by the method of Nelder and Mead."""
    period = float(np.median(np.diff(pieces[0].time)))
    bounds = {"delay": (-period, MAX_DELAY), "filter_time": (1e-3, _MAX_FILTER), "error_limit": (1e-3, np.inf)}
    steps = {"delay": period, "filter_time": period, "error_limit": 0.02}

    def at(values: np.ndarray) -> _Fit:
        limited = {name: float(np.clip(value, *bounds[name])) for name, value in zip(free, values, strict=True)}
        return _solved(pieces, axes, terms, start._replace(**limited), free)

    start = min(starts, key=lambda shape: np.sum(_solved(pieces, axes, terms, shape, free).left ** 2))
    first = np.array([getattr(start, name) for name in free])
    simplex = np.vstack([first, first + np.diag([steps[name] for name in free])])
    found = scipy.optimize.minimize(
        lambda values: float(np.sum(at(values).left ** 2)),
        first,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 1e-4, "fatol": np.inf, "maxiter": 60 * len(free)},
    )
    return at(found.x)


def _simplest(pieces: Sequence[Piece], axes: tuple[int, ...]) -> _Fit:
    """Return the law without filter, limit and displacement."""
    starts = [Shape(delay) for delay in np.linspace(0.0, MAX_DELAY, 16)]
    return _searched(pieces, axes, _terms(pieces, axes), starts, ("delay",))


def _unexplained(pieces: Sequence[Piece]) -> float:
    """Return the sum of the logarithms of the shares that the law leaves on each axis."""
    return sum(float(np.log(max(1.0 - _limited(pieces, (axis,)).explained, _MIN_SHARE))) for axis in range(3))


def _limited(pieces: Sequence[Piece], axes: tuple[int, ...]) -> _Fit:
    """Return the law of some axes without filter, with a limit of the error if it explains more."""
    fit = _simplest(pieces, axes)
    errors = np.abs(np.concatenate([piece.error[piece.counted][:, axes] for piece in pieces]))
    limits = [fit.shape._replace(error_limit=float(each)) for each in np.quantile(errors, _LIMIT_QUANTILES)]
    limited = _searched(pieces, axes, fit.terms, limits, (*fit.free, "error_limit"))
    return _better(fit, limited)


def _chosen(pieces: Sequence[Piece], axes: tuple[int, ...]) -> _Fit:
    """Return the law of some axes with those of limit, filter and displacement that explain more."""
    fit = _limited(pieces, axes)
    filters = [
        fit.shape._replace(delay=max(0.0, fit.shape.delay - each), filter_time=each) for each in _FILTERS
    ]
    fit = _better(fit, _searched(pieces, axes, fit.terms, filters, (*fit.free, "filter_time")))
    return _better(fit, _searched(pieces, axes, (*fit.terms, "double_integral"), [fit.shape], fit.free))


def _better(simple: _Fit, rich: _Fit) -> _Fit:
    """Return the richer of two laws if a likelihood ratio test prefers it, given the correlation of what is left."""
    ratio = np.sum(simple.left**2) / max(float(np.sum(rich.left**2)), np.finfo(float).tiny)
    return rich if _independent_samples(rich.left) * np.log(ratio) > _LIKELIHOOD_RATIO else simple


def _independent_samples(left: np.ndarray) -> float:
    """Return the number of independent samples that tell as much as (n,) correlated ones.

    It is n over 1 + 2 Σ ρ_k, with the autocorrelations ρ_k up to the first that is negative (C. J. Geyer, Statistical
    Science 7, 1992, section 3.3).
    """
    size = scipy.fft.next_fast_len(2 * len(left))
    spectrum = np.abs(np.fft.rfft(left, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[: len(left) // 2]
    correlation /= correlation[0] if correlation[0] > 0.0 else 1.0
    negative = np.flatnonzero(correlation < 0.0)
    kept = correlation[1 : negative[0] if len(negative) else None]
    return float(len(left) / (1.0 + 2.0 * kept.sum()))


def _block_numbers(pieces: Sequence[Piece]) -> np.ndarray:
    """Return the number (n,) of the block of each counted sample of an axis."""
    count = sum(int(piece.counted.sum()) for piece in pieces)
    seconds = count * float(np.median(np.diff(pieces[0].time)))
    number = max(MIN_BLOCKS, round(seconds / _BLOCK))
    return np.arange(count) * number // count


def _uncertainty(pieces: Sequence[Piece], axes: tuple[int, ...], fit: _Fit) -> tuple[np.ndarray, np.ndarray]:
    """Return the half-widths of the 95 % intervals of all parameters and their degrees of freedom.

    The half-width is that of the jackknife, plus the largest bias that errors of the logged position or of the logged
    velocity can cause, which is n σ² M_ij / θ_j with the variance σ² of what is not explained and M = (Jᵀ J)⁻¹.
    The rule by which the controller integrates is not known either, which is worth half a period times the integral
    gain.
    """
    regressors, _ = _regression(pieces, axes, fit.terms, fit.shape)
    slopes = [regressors]
    for name in fit.free:
        step = 1e-3 * max(abs(getattr(fit.shape, name)), _TYPICAL_DELAY)
        low, high = (
            _regression(pieces, axes, fit.terms, fit.shape._replace(**{name: getattr(fit.shape, name) + change}))[0]
            for change in (-step, step)
        )
        slopes.append(((high - low) @ fit.gains / (2.0 * step))[:, None])
    derivatives = np.hstack(slopes)
    variance = float(np.mean(fit.left**2))
    blocks = np.tile(_block_numbers(pieces), len(axes))
    information = of_blocks(derivatives[:, :, None] * derivatives[:, None, :] / variance, blocks)
    scores = of_blocks(derivatives * fit.left[:, None] / variance, blocks)
    covariance, freedom, model = jackknife(information, scores)
    measured = [fit.terms.index(name) for name in _ESSENTIAL]
    bias = len(fit.left) * np.abs(model[:, measured] / fit.gains[measured]).max(axis=1)
    half = 0.5 * float(np.median(np.diff(pieces[0].time)))
    for name, integral in (("position", "integral"), ("velocity", "displacement")):
        if integral in fit.terms:
            bias[fit.terms.index(name)] += half * abs(fit.gains[fit.terms.index(integral)])
    return quantile(freedom) * np.sqrt(np.diag(covariance)) + bias, freedom


def _alike(pieces: Sequence[Piece], fits: Mapping[int, _Fit]) -> bool:
    """Return whether X and Y have the same law: all intervals of the differences of their gains contain zero."""
    x, y = (_spreads(pieces, (axis,), fits[axis], "acceleration") for axis in (0, 1))
    for name in x.keys() & y.keys():
        difference = abs(x[name].value - y[name].value)
        if difference > np.hypot(x[name].reach, y[name].reach):
            return False
    return True


def _spreads(pieces: Sequence[Piece], axes: tuple[int, ...], fit: _Fit, form: Form) -> dict[str, Spread]:
    """Return the estimates of all parameters of a law."""
    values = dict(zip(fit.terms, fit.gains.tolist(), strict=True)) | {
        name: getattr(fit.shape, name) for name in fit.free
    }
    units = _units("rad" if form == "tilt" and 2 not in axes else "m/s²")
    reaches, freedoms = _uncertainty(pieces, axes, fit)
    return {
        name: Spread(values[name], float(reach / quantile(freedom)), units[name], float(freedom))
        for name, reach, freedom in zip(values, reaches, freedoms, strict=True)
    }


def _units(output: str) -> dict[str, str]:
    names = {
        "rad": ("rad/m", "rad s/m", "rad s²/m", "rad/(m s)", "rad/(m s²)"),
        "m/s²": ("1/s²", "1/s", "1", "1/s³", "1/s⁴"),
    }
    position, velocity, acceleration, integral, twice = names[output]
    return {
        "position": position,
        "velocity": velocity,
        "reference_velocity": velocity,
        "reference_acceleration": acceleration,
        "integral": integral,
        "displacement": position,
        "double_integral": twice,
        "delay": "s",
        "filter_time": "s",
        "error_limit": "m",
    }


def _axis_law(pieces: Sequence[Piece], axes: tuple[int, ...], form: Form, fit: _Fit) -> AxisLaw:
    """Return the law of some axes, without the parameters that the log does not identify."""
    spreads = _spreads(pieces, axes, fit, form)
    weak = _weak(spreads)
    dropped = [name for name in weak if name in fit.terms and name not in _ESSENTIAL]
    if dropped:
        kept = tuple(name for name in fit.terms if name not in dropped)
        again = _searched(pieces, axes, kept, [fit.shape], fit.free)
        # The uncertainty of a gain that is held at zero widens the intervals of the others.
        spreads = {
            name: spread._replace(deviation=max(spread.deviation, spreads[name].deviation))
            for name, spread in _spreads(pieces, axes, again, form).items()
        }
        fit = again
    if _OF_REFERENCE[0] not in _terms(pieces, axes):
        weak |= dict.fromkeys(_OF_REFERENCE, "the reference does not move along this axis")
    errors = np.abs(np.concatenate([piece.error[piece.counted][:, axes] for piece in pieces]))
    return AxisLaw(
        tuple(_AXES[axis] for axis in axes),
        {name: spread for name, spread in spreads.items() if name not in weak},
        fit.explained,
        weak,
        float(np.mean(errors > fit.shape.error_limit)),
    )


def _weak(spreads: Mapping[str, Spread]) -> dict[str, str]:
    """Return the parameters whose interval is wide beside their typical size, with the reason."""
    position, velocity = (abs(spreads[name].value) for name in _ESSENTIAL)
    acceleration = 1.0 / 9.81 if spreads["position"].unit == "rad/m" else 1.0
    typical = {
        "position": position,
        "velocity": velocity,
        "reference_velocity": velocity,
        "reference_acceleration": acceleration,
        "integral": position / _TYPICAL_INTEGRAL_TIME,
        "displacement": position,
        "double_integral": position / _TYPICAL_INTEGRAL_TIME**2,
        "delay": _TYPICAL_DELAY,
        "filter_time": _TYPICAL_DELAY,
        "error_limit": np.inf,
    }
    return {
        name: f"its 95 % interval reaches {spread.reach:.2g} {spread.unit} to each side"
        for name, spread in spreads.items()
        if spread.reach > _MAX_REACH * typical[name]
    }
