"""Identification of a position control law from a log: gains, integral, feed-forward, filter, limit and delay.

The logged commands are samples of the output of the law. On each axis, the output at time t is

    u(t) = k_p e + k_v (-v_f) + k_r v_r + k_a a_r + k_i ∫e - k_x p + b,      all at t - delay

with the position error e = p_r - p, which may be limited, the measured velocity v_f after a first-order filter, the
velocity v_r and acceleration a_r of the reference, and a constant b for each stretch of flight. PD and PID are this law
with k_r = k_v or 0 and k_x = 0. A cascade P(position) → PI(velocity) with gains K, k, k_i' and feed-forward f v_r has

    k_p = k K + f k_i',  k_v = k,  k_r = f k,  k_i = k_i' K,  k_x = (1 - f) k_i'

If its position loop also has an integral, with gain K_i, then k_i = k_i' K + k K_i, and the law also has the double
integral with the gain k_i' K_i. Filter, limit and double integral are part of the law only if a likelihood ratio test
prefers them (`drake_quad.identification.position_law.regression`). Confidence intervals follow from the jackknife over
blocks (`drake_quad.identification.evidence`), plus the bias that errors of the logged measurements can cause.

The position p in the term k_x p is the integral of the logged velocity, because the controller integrates the velocity.
This integral does not contain the noise of the logged position. In the form `tilt`, axes and integrals are along the
heading: X is forward, and Y is to the left. In the form `decoupled`, the law has two nuisance terms, which are not
reported: one for the position noise that only the position loop integrates, and one for the anti-windup of PX4
(`drake_quad.identification.position_law.pieces.Piece`).

The logged signals should be the signals that the controller used. Errors in them bias the gains towards zero. The
relative bias with one regressor is the unexplained fraction of the variance, 1 - R² (W. A. Fuller, "Measurement Error
Models", 1987, section 1.1). Axes with 1 - R² above 5 % are therefore not identified.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from drake_quad.errors import InputError
from drake_quad.framework.result_cache import cached_on_disk
from drake_quad.identification.evidence import quantile
from drake_quad.identification.position_law.commands import FORMS, Form
from drake_quad.identification.position_law.pieces import Piece, prepared_pieces
from drake_quad.identification.position_law.regression import (
    ESSENTIAL_TERMS,
    NUISANCE_TERMS,
    REFERENCE_TERMS,
    TYPICAL_DELAY,
    Fit,
    excited_terms,
    fit_with_limit,
    search_fit,
    select_fit,
    uncertainty,
)
from drake_quad.identification.result import EstimatedValue
from drake_quad.logs.record import FlightRecord
from drake_quad.scenario.models import Scenario

_MIN_EXPLAINED_VARIANCE = 0.95  # smallest R² of an identified axis
_MIN_UNEXPLAINED_VARIANCE = 1e-12  # smaller unexplained fractions of the variance are rounding errors
# A parameter is identified if the half-width of its 95 % interval is at most this fraction of its typical magnitude.
_MAX_RELATIVE_HALF_WIDTH = 0.5
_TYPICAL_INTEGRAL_TIME = 1.0  # s, typical k_p / k_i of a PID
_NUM_FORM_SAMPLES = 600  # approximate number of samples to which laws of all forms are fitted, to select the best form
_AXES = ("x", "y", "z")
# Units of each parameter if the output of the law is an acceleration, and if it is an angle.
_UNITS = {
    "position": ("1/s²", "rad/m"),
    "velocity": ("1/s", "rad s/m"),
    "reference_velocity": ("1/s", "rad s/m"),
    "reference_acceleration": ("1", "rad s²/m"),
    "integral": ("1/s³", "rad/(m s)"),
    "displacement": ("1/s²", "rad/m"),
    "double_integral": ("1/s⁴", "rad/(m s²)"),
    "delay": ("s", "s"),
    "filter_time": ("s", "s"),
    "error_limit": ("m", "m"),
}


@dataclass(frozen=True)
class AxisLaw:
    """Law of one axis, or of X and Y if these have the same law.

    Attributes:
        axes: axes that have this law; along the heading in the form `tilt`.
        gains: estimate of each identified parameter by name: position, velocity, reference_velocity,
            reference_acceleration, integral, displacement (k_x), double_integral, delay, filter_time and error_limit.
        explained_variance: R², fraction of the command variance that the law explains.
        not_identified: reason for each parameter that the log does not identify.
        at_error_limit: fraction of the samples whose position error exceeds the limit.
    """

    axes: tuple[str, ...]
    gains: Mapping[str, EstimatedValue]
    explained_variance: float
    not_identified: Mapping[str, str] = field(default_factory=dict)
    at_error_limit: float = 0.0

    def gain(self, name: str) -> float:
        """Return the estimate of the named parameter; 0 if the log does not identify the parameter."""
        return self.gains[name].value if name in self.gains else 0.0


@dataclass(frozen=True)
class PositionLaw:
    """Position control law that was identified from a log.

    Attributes:
        axes: laws of the axes that are identified.
        form: relation between the output of the law and the commands of attitude and thrust.
        at_limits: fraction of the samples that are left out because a command is at a limit.
        not_identified: reason for each axis that the log does not identify.
        remarks: remarks on the fit.
    """

    axes: tuple[AxisLaw, ...]
    form: Form
    at_limits: float
    not_identified: Mapping[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


def identify_position_law(records: Sequence[FlightRecord], scenario: Scenario) -> PositionLaw:
    """Identify the position law of a controller from logs of its flights. The result is cached on disk.

    Args:
        records: records of flights under the same controller, with position, reference_position, attitude_command (or
            attitude, whose lag is then part of the delay), and thrust_command or thrust_fraction.
        scenario: scenario with the `nominal` vehicle that the controller assumed, for mass and gravity.

    Raises:
        InputError: if a log lacks a signal, a reference does not move, or no axis is identified.
    """
    if not records:
        raise InputError("at least one log is needed to identify a position law")
    return cached_on_disk(_identified_law, list(records), scenario)


def _identified_law(records: Sequence[FlightRecord], scenario: Scenario) -> PositionLaw:
    """Return the position law; arguments and errors are those of `identify_position_law`."""
    remarks: list[str] = []
    prepared = [prepared_pieces(record, scenario, remarks) for record in records]
    candidates = {form: [piece for log_pieces in prepared for piece in log_pieces[0][form]] for form in FORMS}
    form = min(FORMS, key=lambda each: _log_unexplained(candidates[each]))
    pieces = candidates[form]
    laws, not_identified = [], {}
    fits = {axis: select_fit(pieces, (axis,)) for axis in range(3)}
    for axis, fit in fits.items():
        if not fit.explained_variance >= _MIN_EXPLAINED_VARIANCE:
            not_identified[_AXES[axis]] = _poor_fit_reason(fit.explained_variance)
    is_shared = not {"x", "y"} & not_identified.keys() and _have_same_law(pieces, fits)
    groups = [(0, 1), (2,)] if is_shared else [(0,), (1,), (2,)]
    for group in groups:
        if not {_AXES[axis] for axis in group} & not_identified.keys():
            law = _axis_law(pieces, group, form, fits[group[0]] if len(group) == 1 else select_fit(pieces, group))
            imprecise = [name for name in ESSENTIAL_TERMS if name in law.not_identified]
            if imprecise:
                names = " and ".join(law.axes)
                not_identified[names] = "; ".join(f"{name}: {law.not_identified[name]}" for name in imprecise)
            else:
                laws.append(law)
    if not laws:
        reasons = "; ".join(f"{axis}: {reason}" for axis, reason in not_identified.items())
        raise InputError(f"cannot identify the position law: {reasons}")
    fraction = float(np.mean(np.concatenate([log_pieces[1] for log_pieces in prepared])))
    return PositionLaw(tuple(laws), form, fraction, not_identified, tuple(dict.fromkeys(remarks)))


def _poor_fit_reason(explained: float) -> str:
    fraction = "nothing" if not explained > 0.0 else f"{100.0 * explained:.3g} %"
    return (
        f"a linear law of position, velocity and reference explains {fraction} of the variance of the command, but must"
        f" explain at least {100.0 * _MIN_EXPLAINED_VARIANCE:g} %; check that the controller used the logged position"
        " and velocity"
    )


def _log_unexplained(pieces: Sequence[Piece]) -> float:
    """Return the sum over the axes of log(1 - R²), for laws that are fitted to evenly spaced samples."""
    step = max(1, sum(int(piece.evaluated.sum()) for piece in pieces) // _NUM_FORM_SAMPLES)
    thinned = [piece._replace(evaluated=piece.evaluated & (np.arange(len(piece.time)) % step == 0)) for piece in pieces]
    return sum(
        float(np.log(max(1.0 - fit_with_limit(thinned, (axis,)).explained_variance, _MIN_UNEXPLAINED_VARIANCE)))
        for axis in range(3)
    )


def _have_same_law(pieces: Sequence[Piece], fits: Mapping[int, Fit]) -> bool:
    """Return whether X and Y may have the same law: the interval of each gain difference contains zero."""
    x, y = (_estimates(pieces, (axis,), fits[axis], "acceleration") for axis in (0, 1))
    for name in x.keys() & y.keys():
        difference = abs(x[name].value - y[name].value)
        if difference > np.hypot(x[name].half_width, y[name].half_width):
            return False
    return True


def _estimates(pieces: Sequence[Piece], axes: tuple[int, ...], fit: Fit, form: Form) -> dict[str, EstimatedValue]:
    """Return the estimates of all parameters of a position law, keyed by name."""
    values = dict(zip(fit.terms, fit.gains.tolist(), strict=True)) | {
        name: getattr(fit.shape, name) for name in fit.free
    }
    is_angle = form == "tilt" and 2 not in axes
    half_widths, freedoms = uncertainty(pieces, axes, fit)
    return {
        name: EstimatedValue(
            values[name], float(half_width / quantile(freedom)), _UNITS[name][is_angle], float(freedom)
        )
        for name, half_width, freedom in zip(values, half_widths, freedoms, strict=True)
        if name not in NUISANCE_TERMS
    }


def _axis_law(pieces: Sequence[Piece], axes: tuple[int, ...], form: Form, fit: Fit) -> AxisLaw:
    """Return the law of some axes, without the parameters that the log does not identify."""
    estimates = _estimates(pieces, axes, fit, form)
    imprecise = _imprecise(estimates)
    dropped = [name for name in imprecise if name in fit.terms and name not in ESSENTIAL_TERMS]
    if dropped:
        remaining = tuple(name for name in fit.terms if name not in dropped)
        refit = search_fit(pieces, axes, remaining, [fit.shape], fit.free)
        # The remaining intervals must not become narrower, since the true values of the removed gains may differ from
        # zero.
        estimates = {
            name: estimate._replace(deviation=max(estimate.deviation, estimates[name].deviation))
            for name, estimate in _estimates(pieces, axes, refit, form).items()
        }
        fit = refit
    if REFERENCE_TERMS[0] not in excited_terms(pieces, axes):
        imprecise |= dict.fromkeys(REFERENCE_TERMS, "the reference does not move along this axis")
    errors = np.abs(np.concatenate([piece.error[piece.evaluated][:, axes] for piece in pieces]))
    return AxisLaw(
        tuple(_AXES[axis] for axis in axes),
        {name: estimate for name, estimate in estimates.items() if name not in imprecise},
        fit.explained_variance,
        imprecise,
        float(np.mean(errors > fit.shape.error_limit)),
    )


def _imprecise(estimates: Mapping[str, EstimatedValue]) -> dict[str, str]:
    """Return a reason for each parameter whose interval is too wide, relative to its typical magnitude."""
    position, velocity = (abs(estimates[name].value) for name in ESSENTIAL_TERMS)
    acceleration = 1.0 / 9.81 if estimates["position"].unit == "rad/m" else 1.0
    typical = {
        "position": position,
        "velocity": velocity,
        "reference_velocity": velocity,
        "reference_acceleration": acceleration,
        "integral": position / _TYPICAL_INTEGRAL_TIME,
        "displacement": position,
        "double_integral": position / _TYPICAL_INTEGRAL_TIME**2,
        "delay": TYPICAL_DELAY,
        "filter_time": TYPICAL_DELAY,
        "error_limit": np.inf,
    }
    return {
        name: f"the half-width of its 95 % interval is {estimate.half_width:.2g} {estimate.unit}"
        for name, estimate in estimates.items()
        if estimate.half_width > _MAX_RELATIVE_HALF_WIDTH * typical[name]
    }
