"""Regression of a position law: linear least squares in the gains, and a search over delay, filter and limit.

`drake_quad.identification.position_law.law` contains the equations. The gains for a given delay, filter and limit
follow from linear least squares. A search minimises the residual over delay, filter and limit (separable least squares:
G. H. Golub and V. Pereyra, Inverse Problems 19, R1, 2003). A constant and a linear trend are also fitted for each
stretch of flight, since the integral begins at an unknown value, and a constant error of the logged position adds a
ramp to the integral.
"""

from collections.abc import Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.identification.evidence import effective_blocks, jackknife, pseudo_inverse, quantile, sums_over_blocks
from drake_quad.identification.position_law.pieces import MIN_REFERENCE_SPEED, Piece, block_numbers
from drake_quad.identification.prepared_logs import MAX_DELAY

ESSENTIAL_TERMS = ("position", "velocity")
"""Terms without which there is no position law."""
REFERENCE_TERMS = ("reference_velocity", "reference_acceleration", "displacement")
"""Terms that need a reference that moves."""
NUISANCE_TERMS = ("deviation", "anti_windup")
"""Nuisance terms, which are fitted but not reported: see `drake_quad.identification.position_law.pieces.Piece`."""
TYPICAL_DELAY = 0.05
"""Usual delay of a position controller, s."""

# Critical value of χ² with one degree of freedom at 99.9 %. It is strict, because a log has over a dozen such tests.
_MIN_LIKELIHOOD_RATIO = 10.83
# An extended law must reduce the unexplained variance at least to this fraction. Smaller reductions hardly affect
# simulations.
_MAX_UNEXPLAINED_RATIO = 0.8
_INITIAL_FILTER_TIMES = (0.01, 0.03, 0.1)  # s, time constants at which the search begins
_MAX_FILTER_TIME = 0.5  # s, largest time constant of the velocity filter
_LIMIT_QUANTILES = (0.6, 0.75, 0.9)  # quantiles of |e| at which the search for the limit of |e| begins


class Shape(NamedTuple):
    """Parameters on which the law depends nonlinearly.

    Attributes:
        delay: delay from a logged measurement to the logged command, s.
        filter_time: time constant of the velocity filter, s; 0 without a filter.
        error_limit: limit on the magnitude of the position error, m.
    """

    delay: float = 0.0
    filter_time: float = 0.0
    error_limit: float = np.inf


class Fit(NamedTuple):
    """Least-squares fit of a law to some axes.

    Attributes:
        terms: names of the k linear terms.
        gains: (k,) gains of the terms.
        shape: nonlinear parameters.
        free: names of the nonlinear parameters that are fitted.
        residuals: (n,) residuals of the command.
        explained_variance: R², fraction of the command variance that the law explains.
    """

    terms: tuple[str, ...]
    gains: np.ndarray
    shape: Shape
    free: tuple[str, ...]
    residuals: np.ndarray
    explained_variance: float


def select_fit(pieces: Sequence[Piece], axes: tuple[int, ...]) -> Fit:
    """Fit a law to some axes. An error limit, a filter and a double integral are added if they are significant."""
    fit = fit_with_limit(pieces, axes)
    filters = [
        fit.shape._replace(delay=max(0.0, fit.shape.delay - time), filter_time=time) for time in _INITIAL_FILTER_TIMES
    ]
    fit = _better_fit(pieces, axes, fit, search_fit(pieces, axes, fit.terms, filters, (*fit.free, "filter_time")))
    return _better_fit(
        pieces, axes, fit, search_fit(pieces, axes, (*fit.terms, "double_integral"), [fit.shape], fit.free)
    )


def fit_with_limit(pieces: Sequence[Piece], axes: tuple[int, ...]) -> Fit:
    """Fit a law without filter to some axes, and add a limit of the error if it is significant."""
    fit = _simplest_fit(pieces, axes)
    errors = np.abs(np.concatenate([piece.error[piece.evaluated][:, axes] for piece in pieces]))
    limits = [fit.shape._replace(error_limit=float(each)) for each in np.quantile(errors, _LIMIT_QUANTILES)]
    with_limit = search_fit(pieces, axes, fit.terms, limits, (*fit.free, "error_limit"))
    return _better_fit(pieces, axes, fit, with_limit)


def _simplest_fit(pieces: Sequence[Piece], axes: tuple[int, ...]) -> Fit:
    """Fit a law without filter, limit and double integral."""
    starts = [Shape(delay) for delay in np.linspace(0.0, MAX_DELAY, 11)]
    return search_fit(pieces, axes, excited_terms(pieces, axes), starts, ("delay",))


def excited_terms(pieces: Sequence[Piece], axes: tuple[int, ...]) -> tuple[str, ...]:
    """Return the terms that the flight excites on some axes."""
    speeds = np.concatenate([piece.reference_velocity[piece.evaluated][:, axes] for piece in pieces])
    is_moving = np.std(speeds) >= MIN_REFERENCE_SPEED
    nuisances = (name for name in NUISANCE_TERMS if any(getattr(piece, name)[:, axes].any() for piece in pieces))
    return (*ESSENTIAL_TERMS, *(REFERENCE_TERMS if is_moving else ()), "integral", *nuisances)


def search_fit(
    pieces: Sequence[Piece],
    axes: tuple[int, ...],
    terms: tuple[str, ...],
    starts: Sequence[Shape],
    free: tuple[str, ...],
) -> Fit:
    """Fit a law by the Nelder-Mead method, from the best of the given starts.

    Args:
        pieces: stretches of flight.
        axes: indices of the axes that share the law.
        terms: names of the linear terms.
        starts: candidates for the initial nonlinear parameters.
        free: names of the nonlinear parameters that are fitted.
    """
    period = float(np.median(np.diff(pieces[0].time)))
    bounds = {"delay": (-period, MAX_DELAY), "filter_time": (1e-3, _MAX_FILTER_TIME), "error_limit": (1e-3, np.inf)}
    steps = {"delay": period, "filter_time": period, "error_limit": 0.02}

    def fit_at(values: np.ndarray) -> Fit:
        bounded = {name: float(np.clip(value, *bounds[name])) for name, value in zip(free, values, strict=True)}
        return _fit_gains(pieces, axes, terms, start._replace(**bounded), free)

    start = min(starts, key=lambda shape: np.sum(_fit_gains(pieces, axes, terms, shape, free).residuals ** 2))
    first = np.array([getattr(start, name) for name in free])
    simplex = np.vstack([first, first + np.diag([steps[name] for name in free])])
    result = scipy.optimize.minimize(
        lambda values: float(np.sum(fit_at(values).residuals ** 2)),
        first,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "xatol": 1e-4, "fatol": np.inf, "maxiter": 60 * len(free)},
    )
    return fit_at(result.x)


def _fit_gains(
    pieces: Sequence[Piece], axes: tuple[int, ...], terms: tuple[str, ...], shape: Shape, free: tuple[str, ...]
) -> Fit:
    """Fit the gains of a law for given nonlinear parameters."""
    regressors, commands = _regression(pieces, axes, terms, shape)
    # Solving the normal equations is ten times as fast as decomposing the regressors.
    products = regressors.T @ regressors
    gains = pseudo_inverse(products, products) @ (regressors.T @ commands)
    residuals = commands - regressors @ gains
    power = float(commands @ commands)
    return Fit(
        terms, gains, shape, free, residuals, 1.0 - float(residuals @ residuals) / power if power > 0.0 else np.nan
    )


def _regression(
    pieces: Sequence[Piece], axes: tuple[int, ...], terms: Sequence[str], shape: Shape
) -> tuple[np.ndarray, np.ndarray]:
    """Return the regressors (n, k) and the commands (n,), each without its mean and trend in each piece and axis."""
    regressors, commands = [], []
    for axis, piece in product(axes, pieces):
        delayed_times = piece.time[piece.evaluated] - shape.delay
        columns = _columns(piece, axis, terms, shape)
        delayed_columns = np.column_stack([np.interp(delayed_times, piece.time, column) for column in columns.T])
        command = piece.command[piece.evaluated, axis]
        time_offset = delayed_times - delayed_times.mean()
        centred = np.column_stack([delayed_columns, command])
        centred -= centred.mean(axis=0) + np.outer(time_offset, time_offset @ centred / (time_offset @ time_offset))
        regressors.append(centred[:, :-1])
        commands.append(centred[:, -1])
    return np.concatenate(regressors), np.concatenate(commands)


def _columns(piece: Piece, axis: int, terms: Sequence[str], shape: Shape) -> np.ndarray:
    """Return the regressors (m, k) of a piece along an axis, without the delay."""
    error = np.clip(piece.error[:, axis], -shape.error_limit, shape.error_limit)
    velocity = piece.velocity[:, axis]
    if shape.filter_time > 0.0:
        decay = float(np.exp(-np.median(np.diff(piece.time)) / shape.filter_time))
        # If the velocity is linear between samples, the error of a step of this filter is of third order in the period.
        weight = 0.5 * (1.0 - decay)
        velocity, _ = scipy.signal.lfilter([weight, weight], [1.0, -decay], velocity, zi=[(1.0 - weight) * velocity[0]])
    columns = {
        "position": error,
        "velocity": -velocity,
        "reference_velocity": piece.reference_velocity[:, axis],
        "reference_acceleration": piece.reference_acceleration[:, axis],
        "displacement": -piece.travel[:, axis],
        "deviation": piece.deviation[:, axis],
        "anti_windup": -piece.anti_windup[:, axis],
    }
    if {"integral", "double_integral"} & {*terms}:
        columns["integral"] = _integral(error, piece.time)
    if "double_integral" in terms:
        columns["double_integral"] = _integral(columns["integral"], piece.time)
    return np.column_stack([columns[name] for name in terms])


def _integral(values: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return the integral (m,) from the first sample by the trapezoidal rule.

    `scipy.integrate.cumulative_trapezoid` takes ten times as long for a thousand samples.
    """
    return np.append(0.0, np.cumsum(np.diff(time) * (values[1:] + values[:-1]) / 2.0))


def _better_fit(pieces: Sequence[Piece], axes: tuple[int, ...], simple: Fit, extended: Fit) -> Fit:
    """Return an extended law if its last parameter is significant, and the simpler law otherwise.

    The parameter is significant if three conditions hold. A likelihood ratio test, which accounts for the correlation
    of the residuals, prefers the extended law. The unexplained variance decreases by at least a fifth. The interval of
    the parameter does not contain zero.
    """
    ratio = np.sum(simple.residuals**2) / max(float(np.sum(extended.residuals**2)), np.finfo(float).tiny)
    if (
        ratio < 1.0 / _MAX_UNEXPLAINED_RATIO
        or _independent_samples(extended.residuals) * np.log(ratio) <= _MIN_LIKELIHOOD_RATIO
    ):
        return simple
    linear = len(extended.terms) > len(simple.terms)
    value = extended.gains[-1] if linear else getattr(extended.shape, extended.free[-1])
    half_widths, _ = uncertainty(pieces, axes, extended)
    return extended if abs(value) > half_widths[len(extended.terms) - 1 if linear else -1] else simple


def _independent_samples(residuals: np.ndarray) -> float:
    """Return the effective sample size of (n,) correlated residuals.

    This is n / (1 + 2 Σ ρ_k), summed over the autocorrelations ρ_k before the first negative one (C. J. Geyer,
    Statistical Science 7, 1992, section 3.3).
    """
    size = scipy.fft.next_fast_len(2 * len(residuals))
    spectrum = np.abs(np.fft.rfft(residuals, size)) ** 2
    correlation = np.fft.irfft(spectrum, size)[: len(residuals) // 2]
    correlation /= correlation[0] if correlation[0] > 0.0 else 1.0
    negative = np.flatnonzero(correlation < 0.0)
    positive = correlation[1 : negative[0] if len(negative) else None]
    return float(len(residuals) / (1.0 + 2.0 * positive.sum()))


def uncertainty(pieces: Sequence[Piece], axes: tuple[int, ...], fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Return the half-widths of the 95 % intervals of all parameters and their degrees of freedom.

    The half-width is the sum of the half-width by the jackknife, of the largest bias that errors of the logged position
    or velocity can cause, and of `_integration_rule_bias`. Errors of a signal with the gain θ and the error variance s²
    bias the parameters by n s² |θ| |M d| / σ². Here n is the number of samples, d is 1 for each regressor that contains
    the signal and 0 for all others, M is the covariance of the parameters, and σ² is the unexplained variance. The
    errors cause at most the variance σ², so s² ≤ σ² / θ².
    """
    regressors, _ = _regression(pieces, axes, fit.terms, fit.shape)
    jacobian = [regressors]
    for name in fit.free:
        step = 1e-3 * max(abs(getattr(fit.shape, name)), TYPICAL_DELAY)
        low, high = (
            _regression(pieces, axes, fit.terms, fit.shape._replace(**{name: getattr(fit.shape, name) + change}))[0]
            for change in (-step, step)
        )
        jacobian.append(((high - low) @ fit.gains / (2.0 * step))[:, None])
    derivatives = np.hstack(jacobian)
    variance = float(np.mean(fit.residuals**2))
    blocks = np.tile(block_numbers(pieces), len(axes))
    information = sums_over_blocks(derivatives[:, :, None] * derivatives[:, None, :] / variance, blocks)
    scores = sums_over_blocks(derivatives * fit.residuals[:, None] / variance, blocks)
    covariance, _, model = jackknife(information, scores)
    # The covariance for a correct model is too small for correlated residuals, so only its variances are a limit.
    variances = np.maximum(np.diag(covariance), np.diag(model))
    freedom = np.maximum(effective_blocks(information, model) - 1.0, 1.0)
    gain_of = dict(zip(fit.terms, fit.gains.tolist(), strict=True))
    bias = np.zeros(len(model))
    for signal_terms in (("position", "deviation"), ("velocity",)):
        shifts = sum(model[:, index] for index, name in enumerate(fit.terms) if name in signal_terms)
        bias = np.maximum(
            bias, len(fit.residuals) * np.abs(shifts / sum(gain_of.get(name, 0.0) for name in signal_terms))
        )
    for name, bound in _integration_rule_bias(gain_of, float(np.median(np.diff(pieces[0].time)))).items():
        bias[fit.terms.index(name)] += bound
    return quantile(freedom) * np.sqrt(variances) + bias, freedom


def _integration_rule_bias(gains: Mapping[str, float], period: float) -> dict[str, float]:
    """Return the largest bias of some gains that the integration rule of the controller can cause.

    A sum over samples differs from the trapezoidal rule by half a period times the last sample. The difference biases
    the position gain of a PID. In a cascade with the same law, it also biases the velocity gains, because the velocity
    loop integrates with a gain k_i'. The gain k_i' is the larger of the gain of the term `displacement` and k_i / K,
    where the position gain K is the larger root of k_v K² - k_p K + k_i = 0. The symbols are those of
    `drake_quad.identification.position_law.law`.
    """
    position, velocity = (abs(gains[name]) for name in ESSENTIAL_TERMS)
    integral, velocity_integral = (abs(gains.get(name, 0.0)) for name in ("integral", "displacement"))
    discriminant = position**2 - 4.0 * velocity * integral
    if discriminant > 0.0:
        velocity_integral = max(velocity_integral, 2.0 * velocity * integral / (position + np.sqrt(discriminant)))
    bounds = {"position": integral, "velocity": velocity_integral, "reference_velocity": velocity_integral}
    return {name: 0.5 * period * bound for name, bound in bounds.items() if name in gains}
