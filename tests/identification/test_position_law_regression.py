"""Tests of gains, delay, filter and limit of a position law, identified from sums of sines."""

import numpy as np
import pytest
import scipy

from drake_quad.errors import InputError
from drake_quad.identification.evidence import quantile
from drake_quad.identification.position_law import law, regression
from drake_quad.identification.position_law.law import AxisLaw, identify_position_law
from drake_quad.identification.position_law.pieces import Piece
from drake_quad.identification.position_law.regression import (
    NUISANCE_TERMS,
    Fit,
    Shape,
    excited_terms,
    fit_with_limit,
    search_fit,
    select_fit,
    uncertainty,
)
from drake_quad.identification.result import EstimatedValue

PERIOD = 0.01  # s, sampling period
BASIC_TERMS = ("position", "velocity", "reference_velocity", "reference_acceleration", "displacement", "integral")
GAINS = {
    "position": 4.0,
    "velocity": 3.0,
    "reference_velocity": 2.0,
    "reference_acceleration": 0.7,
    "displacement": 0.5,
    "integral": 1.5,
    "double_integral": 2.5,
}


def sines(seed, time, order=0, lag=0.0):
    """Return a derivative of sums (n, 3) of sines after a first-order lag; a negative order is an integral."""
    random = np.random.default_rng(seed)
    rates, phases = random.uniform(1.0, 7.0, (2, 3, 5))
    amplitudes = random.uniform(0.1, 0.3, (3, 5)) / np.hypot(1.0, rates * lag)
    angles = rates * np.asarray(time)[:, None, None] + phases - np.arctan(rates * lag) + 0.5 * np.pi * order
    return (amplitudes * rates**order * np.sin(angles)).sum(axis=2)


def columns_at(time, shape):
    """Return the terms (n, 3) of the law at the given times, without a limit."""
    return {
        "position": sines(1, time),
        "velocity": -sines(2, time, 1, shape.filter_time),
        "reference_velocity": sines(1, time, 1) + sines(2, time, 1),
        "reference_acceleration": sines(1, time, 2) + sines(2, time, 2),
        "displacement": -sines(2, time),
        "integral": sines(1, time, -1),
        "double_integral": sines(1, time, -2),
    }


def flown(terms=BASIC_TERMS, shape=Shape(), *, noise=0.0, begin=0.0, seconds=8.0, settle=1.0):
    """Return a stretch of flight under the law. The regression does not use its first `settle` seconds."""
    random = np.random.default_rng(round(begin))
    time = begin + PERIOD * np.arange(round(seconds / PERIOD))
    terms_then = columns_at(time - shape.delay, shape)
    terms_then["position"] = np.clip(terms_then["position"], -shape.error_limit, shape.error_limit)
    command = sum(GAINS[name] * terms_then[name] for name in terms) + noise * random.normal(size=(len(time), 3))
    error, position = sines(1, time), sines(2, time)
    now = columns_at(time, Shape())
    # The constant stands for an integral that begins at an unknown value.
    return Piece(
        time=time,
        command=command + np.array([1.0, -2.0, 9.0]),
        error=error,
        velocity=-now["velocity"],
        reference_velocity=now["reference_velocity"],
        reference_acceleration=now["reference_acceleration"],
        travel=position - position[0],
        deviation=np.zeros_like(error),
        anti_windup=np.zeros_like(error),
        evaluated=time >= begin + settle,
    )


@pytest.mark.parametrize(
    ("terms", "shape", "free"),
    [
        (BASIC_TERMS, Shape(0.06), ("delay",)),
        (BASIC_TERMS, Shape(0.03, 0.08), ("delay", "filter_time")),
        ((*BASIC_TERMS, "double_integral"), Shape(0.1), ("delay",)),
        (BASIC_TERMS[:4], Shape(0.04, 0.0, 0.2), ("delay", "error_limit")),
    ],
)
@pytest.mark.parametrize("axes", [(0,), (1, 2)])
def test_a_law_is_recovered_from_noise_free_commands(terms, shape, free, axes):
    pieces = [flown(terms, shape), flown(terms, shape, begin=20.0, seconds=5.0)]
    starts = [
        Shape(0.0, 0.2 if shape.filter_time else 0.0, np.inf if np.isinf(shape.error_limit) else 0.35),
        Shape(0.14, 0.4 if shape.filter_time else 0.0, np.inf if np.isinf(shape.error_limit) else 0.05),
    ]
    result = search_fit(pieces, axes, terms, starts, free)
    assert (result.terms, result.free) == (terms, free)
    np.testing.assert_allclose(result.gains, [GAINS[name] for name in terms], rtol=0.01)
    np.testing.assert_allclose(result.shape.delay, shape.delay, atol=3e-4)
    np.testing.assert_allclose(result.shape.filter_time, shape.filter_time, atol=1e-3)
    np.testing.assert_allclose(result.shape.error_limit, shape.error_limit, atol=1e-3)
    assert result.explained_variance > 0.99999


def test_the_search_begins_at_the_best_start():
    """A Nelder-Mead search does not move away from a limit that no error exceeds, since the objective is flat there."""
    pieces = [flown(BASIC_TERMS[:4], Shape(0.0, 0.0, 0.2))]
    starts = [Shape(0.0, 0.0, limit) for limit in (50.0, 0.25, 20.0)]
    assert search_fit(pieces, (0,), BASIC_TERMS[:4], starts, ("error_limit",)).shape.error_limit == pytest.approx(
        0.2, abs=1e-3
    )


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.09, 0.15])
def test_the_delay_of_weakly_autocorrelated_signals_is_found(delay):
    """The squared residuals have a narrow minimum over the delay, so the search starts from delays 15 ms apart."""
    (piece, _) = (without_nuisances(piece) for piece in noisy_pieces(300))
    undelayed = regression._columns(piece, 0, BASIC_TERMS, Shape()) @ [GAINS[name] for name in BASIC_TERMS]
    command = np.interp(piece.time - delay, piece.time, undelayed)
    evaluated = piece.evaluated & (piece.time >= 0.15)
    result = regression._simplest_fit([piece._replace(command=np.tile(command[:, None], 3), evaluated=evaluated)], (0,))
    assert result.shape.delay == pytest.approx(delay, abs=2e-4)
    np.testing.assert_allclose(result.gains, [GAINS[name] for name in BASIC_TERMS], rtol=0.02)
    assert (result.terms, result.free) == (BASIC_TERMS, ("delay",))


@pytest.mark.parametrize(("delay", "expected"), [(0.3, 0.15), (-0.05, -PERIOD)])
def test_an_identified_delay_is_between_minus_one_sample_and_0_15_s(delay, expected):
    pieces = [flown(shape=Shape(delay))]
    assert search_fit(pieces, (0,), BASIC_TERMS, [Shape(0.05)], ("delay",)).shape.delay == pytest.approx(
        expected, abs=2e-4
    )


def test_the_time_constant_of_a_filter_is_at_most_half_a_second():
    pieces = [flown(shape=Shape(0.0, 2.0))]
    result = search_fit(pieces, (0,), BASIC_TERMS, [Shape(0.0, 0.3)], ("filter_time",))
    assert result.shape.filter_time == pytest.approx(0.5, abs=2e-4)


def noisy_pieces(samples=60):
    """Return two stretches of flight with independent noise signals. The regression does not use all samples."""
    random = np.random.default_rng(3)
    return [
        Piece(
            begin + PERIOD * np.arange(count),
            *random.normal(size=(8, count, 3)),
            random.uniform(size=count) < 0.8,
        )
        for begin, count in ((0.0, samples), (5.0, 45))
    ]


def without_nuisances(piece):
    """Return a stretch of flight with the regressors `deviation` and `anti_windup` set to zero."""
    return piece._replace(deviation=np.zeros_like(piece.error), anti_windup=np.zeros_like(piece.error))


def stacked(pieces, axes, terms):
    """Return the regressors, with a constant and a linear trend for each stretch, and the commands of the pieces."""
    sign = {"velocity": -1.0, "displacement": -1.0, "anti_windup": -1.0}
    values = {"position": "error", "displacement": "travel"}
    result, commands, free = [], [], []
    for axis in axes:
        for piece in pieces:
            evaluated = piece.evaluated
            columns = [sign.get(name, 1.0) * getattr(piece, values.get(name, name))[evaluated, axis] for name in terms]
            result.append(np.column_stack(columns))
            commands.append(piece.command[evaluated, axis])
            free.append(np.column_stack([np.ones(evaluated.sum()), piece.time[evaluated]]))
    return np.concatenate(result), np.concatenate(commands), scipy.linalg.block_diag(*free)


@pytest.mark.parametrize("axes", [(2,), (0, 1)])
def test_gains_are_the_least_squares_solution_with_a_linear_trend_per_stretch_and_axis(axes):
    pieces, terms = noisy_pieces(), (*BASIC_TERMS[:5], *NUISANCE_TERMS)
    regressors, commands, free = stacked(pieces, axes, terms)
    together = np.hstack([regressors, free])
    solution = np.linalg.lstsq(together, commands, rcond=None)[0]
    residuals = commands - together @ solution
    detrended = commands - free @ np.linalg.lstsq(free, commands, rcond=None)[0]
    result = regression._fit_gains(pieces, axes, terms, Shape(), ("delay",))
    np.testing.assert_allclose(result.gains, solution[: len(terms)], rtol=1e-8)
    np.testing.assert_allclose(result.residuals, residuals, atol=1e-10)
    assert result.explained_variance == pytest.approx(1.0 - residuals @ residuals / (detrended @ detrended))
    assert (result.terms, result.shape, result.free) == (terms, Shape(), ("delay",))


def test_the_explained_variance_of_a_constant_command_is_nan():
    pieces = [piece._replace(command=np.zeros_like(piece.command)) for piece in noisy_pieces()]
    assert np.isnan(regression._fit_gains(pieces, (0,), BASIC_TERMS, Shape(), ()).explained_variance)


def test_the_regressors_are_the_terms_of_the_law():
    piece = noisy_pieces()[1]
    terms = (*GAINS, *NUISANCE_TERMS)
    actual = dict(zip(terms, regression._columns(piece, 1, terms, Shape(0.0, 0.0, 0.5)).T, strict=True))
    error = np.clip(piece.error[:, 1], -0.5, 0.5)
    assert np.ptp(error) == 1.0

    def integral(values):
        return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]) * np.diff(piece.time))])

    expected = {
        "position": error,
        "velocity": -piece.velocity[:, 1],
        "reference_velocity": piece.reference_velocity[:, 1],
        "reference_acceleration": piece.reference_acceleration[:, 1],
        "displacement": -piece.travel[:, 1],
        "deviation": piece.deviation[:, 1],
        "anti_windup": -piece.anti_windup[:, 1],
        "integral": integral(error),
        "double_integral": integral(integral(error)),
    }
    for name, values in expected.items():
        np.testing.assert_allclose(actual[name], values, atol=1e-12, err_msg=name)


def test_the_velocity_filter_is_a_first_order_lag_that_starts_in_steady_state():
    """The response to a ramp is exact to third order in the period, and does not start with a jump."""
    piece = flown()
    constant = piece._replace(velocity=np.full_like(piece.velocity, 2.0))
    actual = regression._columns(constant, 0, ("velocity",), Shape(0.0, 0.1))
    np.testing.assert_allclose(actual, -2.0)
    ramp = piece._replace(velocity=np.tile(piece.time[:, None], 3))
    ramp_response = -regression._columns(ramp, 0, ("velocity",), Shape(0.0, 0.1))[:, 0]
    # The response to the ramp r(t) = t is t - τ (1 - exp(-t / τ)).
    expected = piece.time - 0.1 * (1.0 - np.exp(-piece.time / 0.1))
    np.testing.assert_allclose(ramp_response, expected, atol=0.1 * (PERIOD / 0.1) ** 2 / 11.0)


def test_the_reference_velocity_is_a_term_if_it_varies_by_a_centimetre_per_second():
    piece = flown()
    for deviation, is_term in ((0.009, False), (0.011, True)):
        speed = np.where(np.arange(len(piece.time)) % 2, 1.0, -1.0)
        # Larger motion in samples that the regression does not use, or on another axis, is ignored.
        slow = np.column_stack([np.where(piece.evaluated, deviation * speed, speed), speed, speed])
        terms = excited_terms([piece._replace(reference_velocity=slow)], (0,))
        assert ("displacement" in terms) == ("reference_velocity" in terms) == is_term
        assert {"position", "velocity", "integral"} <= {*terms}


@pytest.mark.parametrize("name", NUISANCE_TERMS)
def test_nuisance_terms_are_fitted_only_if_they_are_not_zero_on_a_fitted_axis(name):
    piece = flown()
    values = np.zeros_like(piece.error)
    values[5, 1] = 0.1
    pieces = [piece, piece._replace(**{name: values})]
    assert excited_terms(pieces, (0,)) == excited_terms([piece], (0, 1, 2)) == BASIC_TERMS
    assert excited_terms(pieces, (0, 1)) == (*BASIC_TERMS, name)


def direct_independent_samples(residuals):
    """Return n / (1 + 2 Σ ρ_k), from direct sums over pairs of samples."""
    count, total = len(residuals), 0.0
    for lag in range(1, count // 2):
        correlation = residuals[:-lag] @ residuals[lag:] / (residuals @ residuals)
        if correlation < 0.0:
            break
        total += correlation
    return count / (1.0 + 2.0 * total)


def test_correlated_samples_are_less_informative_than_independent_ones():
    random = np.random.default_rng(2)
    white = random.normal(size=1500)
    slow = scipy.signal.lfilter([1.0], [1.0, -0.9], random.normal(size=20001))
    for residuals in (white, slow[:1500], np.ones(200), np.ones(201), np.tile([1.0, -1.0], 40)):
        expected = direct_independent_samples(residuals)
        assert regression._independent_samples(residuals) == pytest.approx(expected, rel=1e-9)
    # With correlations 0.9^k, n samples are equivalent to n (1 - 0.9) / (1 + 0.9) independent samples.
    assert regression._independent_samples(slow) == pytest.approx(20001 / 19.0, rel=0.15)
    assert regression._independent_samples(np.zeros(50)) == 50.0


def fit_with(residuals, terms=("position", "velocity"), free=("delay",), last=1.0):
    """Return a fit with given residuals, whose last gain and last nonlinear parameter both have the value `last`."""
    shape = Shape()._replace(**{free[-1]: last})
    return Fit(terms, np.array([2.0] * (len(terms) - 1) + [last]), shape, free, residuals, 0.9)


@pytest.mark.parametrize(
    ("samples", "fraction", "last", "better"),
    [
        # The sum of squared residuals must fall by at least a fifth.
        (2000, 0.79, 1.0, True),
        (2000, 0.81, 1.0, False),
        # The test statistic is the number of samples times the logarithm of the ratio of unexplained variances. It must
        # exceed 10.83, the critical value of χ² at 99.9 %.
        (24, np.exp(-10.9 / 24), 1.0, True),
        (24, np.exp(-10.7 / 24), 1.0, False),
        # The interval of the parameter must not contain zero.
        (2000, 0.1, 0.31, True),
        (2000, 0.1, 0.29, False),
        (2000, 0.1, -0.31, True),
        (2000, 0.1, -0.29, False),
        (2000, 1e-20, 1.0, True),
    ],
)
@pytest.mark.parametrize("linear", [True, False])
def test_an_extended_law_is_taken_if_its_last_parameter_is_significant(
    monkeypatch, samples, fraction, last, better, linear
):
    # Residuals of alternating sign have no positive correlation.
    residuals = np.tile([1.0, -1.0], samples // 2)
    simple = fit_with(residuals)
    extended = fit_with(
        np.sqrt(fraction) * residuals,
        ("position", "velocity", "integral") if linear else simple.terms,
        simple.free if linear else ("delay", "filter_time"),
        last,
    )
    half_widths = np.full(4, 1e9)
    half_widths[2 if linear else 3] = 0.3
    monkeypatch.setattr(regression, "uncertainty", lambda pieces, axes, fit: (half_widths, None))
    assert regression._better_fit([], (0,), simple, extended) is (extended if better else simple)


def test_the_simpler_law_is_taken_if_both_laws_fit_exactly(monkeypatch):
    """Both laws leave no residual, for example if the command is constant."""
    monkeypatch.setattr(regression, "uncertainty", lambda pieces, axes, fit: (np.zeros(4), None))
    simple, extended = (fit_with(np.zeros(100), free=free) for free in (("delay",), ("delay", "filter_time")))
    assert regression._better_fit([], (0,), simple, extended) is simple


def rule_bias(named):
    """Return the bias of gains if the controller integrates by the rectangle rule.

    The rectangle rule differs from the trapezoidal rule by half a period. A cascade with this law and the position gain
    K integrates the velocity error with the gain k_i / K.
    """
    roots = np.roots([named["velocity"], -named["position"], named["integral"]])
    of_velocity = named["displacement"]
    if np.isreal(roots).all():
        of_velocity = max(of_velocity, named["integral"] / roots.real.max())
    bounds = {"position": named["integral"], "velocity": of_velocity, "reference_velocity": of_velocity}
    return [0.5 * PERIOD * bounds.get(name, 0.0) for name in (*named, "delay")]


@pytest.mark.parametrize("integral", [0.5, 1.5])
@pytest.mark.parametrize("with_deviation", [False, True])
def test_a_half_width_is_the_sum_of_jackknife_signal_error_and_integration_rule_terms(with_deviation, integral):
    """Each jackknife estimate is one Gauss-Newton step to the fit without one of fifteen blocks.

    Errors of the logged position affect the regressors `position` and `deviation`. A cascade with k_p = 4 and k_v = 3
    can have integral gains up to 4 / 3, so the test uses an integral gain below and one above this limit.
    """
    terms, shape, free = (*BASIC_TERMS[:3], *BASIC_TERMS[4:]), Shape(0.02, 0.05), ("delay",)
    pieces = [flown(terms, shape, noise=0.2), flown(terms, shape, noise=0.2, begin=20.0, seconds=6.0)]
    pieces = [
        piece._replace(command=piece.command + (integral - GAINS["integral"]) * sines(1, piece.time - 0.02, -1))
        for piece in pieces
    ]
    if with_deviation:
        terms = (*terms, "deviation")
        pieces = [piece._replace(deviation=sines(3, piece.time)) for piece in pieces]
        pieces = [piece._replace(command=piece.command + sines(3, piece.time - 0.02)) for piece in pieces]
    fit = search_fit(pieces, (0, 1), terms, [shape], free)
    half_widths, freedom = uncertainty(pieces, (0, 1), fit)
    step = 1e-5
    with_delay = [
        regression._regression(pieces, (0, 1), terms, fit.shape._replace(delay=fit.shape.delay + change))[0]
        for change in (-step, 0.0, step)
    ]
    jacobian = np.column_stack([with_delay[1], (with_delay[2] - with_delay[0]) @ fit.gains / (2.0 * step)])
    count = len(jacobian) // 2
    # Twelve seconds give fifteen blocks per axis. A block is left out on both axes at the same time.
    blocks = np.tile(np.floor(np.arange(count) * 15 / count), 2)
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    changes, fractions = [], []
    for block in range(15):
        others = blocks != block
        changes.append(
            np.linalg.solve(jacobian[others].T @ jacobian[others], jacobian[~others].T @ fit.residuals[~others])
        )
        fractions.append(np.diag(inverse @ jacobian[~others].T @ jacobian[~others] @ inverse))
    model = np.mean(fit.residuals**2) * inverse
    variances = np.maximum(14 / 15 * np.sum(np.square(changes), axis=0), np.diag(model))
    expected_freedom = np.sum(fractions, axis=0) ** 2 / np.sum(np.square(fractions), axis=0) - 1.0
    named = dict(zip(terms, fit.gains.tolist(), strict=True))
    with_position = np.isin([*terms, "delay"], ["position", "deviation"])
    of_position = np.abs(model @ with_position) / (named["position"] + named.get("deviation", 0.0))
    of_velocity = np.abs(model[:, 1]) / named["velocity"]
    bias = len(fit.residuals) * np.maximum(of_position, of_velocity) + rule_bias(named)
    # The derivative with respect to the delay is a difference between interpolated samples. The tolerance allows for
    # its dependence on the step of the difference.
    np.testing.assert_allclose(freedom, expected_freedom, rtol=0.02)
    np.testing.assert_allclose(half_widths, quantile(expected_freedom) * np.sqrt(variances) + bias, rtol=0.02)


@pytest.mark.parametrize(
    ("terms", "shape", "additional"),
    [
        (BASIC_TERMS, Shape(0.05), ()),
        (BASIC_TERMS, Shape(0.05, 0.1), ("filter_time",)),
        ((*BASIC_TERMS, "double_integral"), Shape(0.05), ("double_integral",)),
    ],
)
def test_the_terms_of_a_law_are_recovered(terms, shape, additional):
    """No filter, limit or double integral is found if the law has none."""
    piece = flown(terms, shape, noise=0.02)
    result = select_fit([piece], (0,))
    assert {*result.terms, *result.free} == {*BASIC_TERMS, "delay", *additional}
    np.testing.assert_allclose(result.gains, [GAINS[name] for name in result.terms], rtol=0.1)
    assert result.shape.delay == pytest.approx(0.05, abs=0.01)


def test_an_error_limit_is_found_if_a_fifth_of_the_errors_exceed_it():
    """No limit is found in a flight without one."""
    limit = float(np.quantile(np.abs(sines(1, PERIOD * np.arange(800))[100:, 0]), 0.8))
    result = fit_with_limit([flown(BASIC_TERMS[:4], Shape(0.02, 0.0, limit), noise=0.02)], (0,))
    assert result.free == ("delay", "error_limit")
    assert result.shape.error_limit == pytest.approx(limit, rel=0.05)
    assert fit_with_limit([flown(noise=0.02)], (0,)).free == ("delay",)


def prepared(monkeypatch, *logs):
    """Replace the preparation of logs, so that each log has the given pieces and mask of limited samples."""
    waiting = iter(logs)

    def prepared_pieces(record, scenario, remarks):
        remarks.append("a remark on each log")
        return next(waiting)

    monkeypatch.setattr(law, "prepared_pieces", prepared_pieces)
    monkeypatch.setattr(law, "FORMS", tuple(logs[0][0]))
    return [None] * len(logs), None


def scaled(piece, *factors, noise=0.0):
    """Return a stretch of flight whose command is multiplied by a factor for each axis, with noise added on Z."""
    unrelated = noise * np.random.default_rng(5).normal(size=len(piece.time))
    return piece._replace(command=piece.command * factors + np.outer(unrelated, [0.0, 0.0, 1.0]))


@pytest.mark.long
@pytest.mark.parametrize(
    ("factors", "groups", "forms"),
    [
        ((1.0, 1.0, 2.0), ["xy", "z"], ("decoupled", "heading")),
        ((1.0, 1.3, 2.0), ["x", "y", "z"], ("heading",)),
    ],
)
def test_axes_with_the_same_law_are_fitted_together_in_the_form_that_fits_best(monkeypatch, factors, groups, forms):
    parts = [flown(shape=Shape(0.05), noise=0.02, begin=begin, seconds=4.0) for begin in (0.0, 20.0)]
    noises = {"decoupled": 1.0, "heading": 0.0}
    logs = [{form: [scaled(part, *factors, noise=noises[form])] for form in forms} for part in parts]
    result = identify_position_law(
        *prepared(
            monkeypatch,
            (logs[0], np.array([True, False, False])),
            (logs[1], np.array([False])),
        )
    )
    assert result.form == "heading"
    assert result.at_limits == 0.25
    assert result.remarks == ("a remark on each log",)
    assert (result.not_identified, ["".join(each.axes) for each in result.axes]) == ({}, groups)
    for each in result.axes:
        factor = factors["xyz".index(each.axes[0])]
        for name in BASIC_TERMS:
            spread = each.gains[name]
            # About one of twenty 95 % intervals misses the true value by chance.
            assert spread.value == pytest.approx(factor * GAINS[name], abs=1.5 * spread.half_width)
        assert each.gain("delay") == pytest.approx(0.05, abs=0.003)
        assert each.explained_variance > 0.999


@pytest.mark.long
def test_an_axis_is_refused_if_no_law_explains_its_command(monkeypatch):
    piece = scaled(flown(seconds=3.0, noise=0.02), 1.0, 1.0, 1.0, noise=3.0)
    result = identify_position_law(*prepared(monkeypatch, ({"heading": [piece]}, np.zeros(1))))
    assert [each.axes for each in result.axes] == [("x", "y")]
    assert {*result.not_identified} == {"z"}
    assert "of the variance of the command, but must explain at least 95 %" in result.not_identified["z"]
    noise = piece._replace(command=np.random.default_rng(2).normal(size=piece.command.shape))
    with pytest.raises(InputError, match="^cannot identify the position law: x: a linear law .*; y: a linear law "):
        identify_position_law(*prepared(monkeypatch, ({"heading": [noise]}, np.zeros(1))))


def fit_of_everything(explained_variance=0.99):
    return Fit(
        BASIC_TERMS,
        np.array([GAINS[name] for name in BASIC_TERMS]),
        Shape(0.05),
        ("delay",),
        np.ones(4),
        explained_variance,
    )


@pytest.mark.parametrize(
    ("explained", "are_equal", "imprecise", "groups", "refused"),
    [
        ((0.96, 0.96, 0.96), True, "", ["xy", "z"], []),
        ((0.96, 0.96, 0.96), False, "", ["x", "y", "z"], []),
        # Axes are not compared if one of them is refused.
        ((0.94, 0.96, 0.96), None, "", ["y", "z"], ["x"]),
        ((0.96, np.nan, 0.96), None, "", ["x", "z"], ["y"]),
        ((0.96, 0.96, 0.94), True, "", ["xy"], ["z"]),
        ((0.96, 0.96, 0.96), True, "xy", ["z"], ["x and y"]),
        ((0.96, 0.96, 0.96), False, "y", ["x", "z"], ["y"]),
    ],
)
def test_an_axis_is_refused_if_its_fit_is_poor_or_its_velocity_gain_is_uncertain(
    monkeypatch, explained, are_equal, imprecise, groups, refused
):
    def axis_law(pieces, axes, form, fit):
        names = "".join("xyz"[axis] for axis in axes)
        reasons = {"velocity": "too wide", "integral": "too wide"} if names == imprecise else {"integral": "too wide"}
        return AxisLaw(tuple(names), {}, fit.explained_variance, reasons)

    def compared(pieces, fits):
        assert are_equal is not None
        return are_equal

    monkeypatch.setattr(law, "_log_unexplained", len)
    monkeypatch.setattr(law, "select_fit", lambda pieces, axes: fit_of_everything(explained[axes[0]]))
    monkeypatch.setattr(law, "_axis_law", axis_law)
    monkeypatch.setattr(law, "_have_same_law", compared)
    result = identify_position_law(*prepared(monkeypatch, ({"heading": []}, np.zeros(1))))
    assert ["".join(each.axes) for each in result.axes] == groups
    assert [*result.not_identified] == refused
    if imprecise:
        assert result.not_identified[refused[0]] == "velocity: too wide"


def test_a_poor_fit_is_reported_with_the_fraction_that_it_explains():
    assert "explains 94.9 % of the variance" in law._poor_fit_reason(0.949)
    for nothing in (0.0, -0.1, np.nan):
        assert "explains nothing of the variance" in law._poor_fit_reason(nothing)


@pytest.mark.parametrize(("difference", "are_combined"), [(0.49, True), (-0.49, True), (0.51, False), (-0.51, False)])
def test_two_axes_are_combined_if_all_intervals_of_differences_contain_zero(monkeypatch, difference, are_combined):
    """With half-widths of 0.3 and 0.4, the difference has the half-width 0.5.

    Terms of only one axis are not compared.
    """

    def spreads(pieces, axes, fit, form):
        offset, half_width = (0.0, 0.3) if axes == (0,) else (difference, 0.4)
        values = {"position": 4.0, "velocity": 3.0 + offset, "filter_time" if axes == (0,) else "error_limit": 100.0}
        deviation = half_width / quantile(7.0)
        return {name: EstimatedValue(value, deviation, "", 7.0) for name, value in values.items()}

    monkeypatch.setattr(law, "_estimates", spreads)
    assert law._have_same_law([], dict.fromkeys(range(3))) == are_combined


@pytest.mark.parametrize(
    ("form", "axes", "units"),
    [
        ("heading", (0,), ["1/s²", "1/s", "1/s", "1", "1/s²", "1/s³"]),
        ("tilt", (2,), ["1/s²", "1/s", "1/s", "1", "1/s²", "1/s³"]),
        ("tilt", (0, 1), ["rad/m", "rad s/m", "rad s/m", "rad s²/m", "rad/m", "rad/(m s)"]),
    ],
)
def test_estimates_have_their_intervals_and_units(monkeypatch, form, axes, units):
    half_widths, freedoms = np.linspace(0.1, 0.7, 7), np.linspace(3.0, 9.0, 7)
    monkeypatch.setattr(law, "uncertainty", lambda pieces, axes, fit: (half_widths, freedoms))
    result = law._estimates([], axes, fit_of_everything(), form)
    assert [*result] == [*BASIC_TERMS, "delay"]
    np.testing.assert_allclose([each.value for each in result.values()], [*(GAINS[name] for name in BASIC_TERMS), 0.05])
    np.testing.assert_allclose([each.half_width for each in result.values()], half_widths)
    assert [each.degrees_of_freedom for each in result.values()] == freedoms.tolist()
    assert [each.unit for each in result.values()] == [*units, "s"]
    assert law._UNITS["double_integral"] == ("1/s⁴", "rad/(m s²)")


@pytest.mark.parametrize(
    ("name", "typical", "unit"),
    [
        ("position", 4.0, "1/s²"),
        ("velocity", 3.0, "1/s"),
        ("reference_velocity", 3.0, "1/s"),
        ("reference_acceleration", 1.0, "1"),
        # A small pitch angle in rad is the acceleration divided by g.
        ("reference_acceleration", 1.0 / 9.81, "rad s²/m"),
        ("integral", 4.0, "1/s³"),
        ("displacement", 4.0, "1/s²"),
        ("double_integral", 4.0, "1/s⁴"),
        ("delay", 0.05, "s"),
        ("filter_time", 0.05, "s"),
        ("error_limit", np.inf, "m"),
    ],
)
def test_a_parameter_is_identified_if_its_half_width_is_below_half_of_its_typical_value(name, typical, unit):
    certain = {"position": EstimatedValue(-4.0, 0.01, "rad/m" if "rad" in unit else "1/s²", 20.0)}
    certain["velocity"] = EstimatedValue(-3.0, 0.01, "1/s", 20.0)
    for fraction in (0.49, 0.51):
        half_width = fraction * min(typical, 1e6)
        estimate = certain.get(name, EstimatedValue(0.01, 0.0, unit, 20.0))._replace(
            deviation=half_width / quantile(20.0)
        )
        imprecise = law._imprecise(certain | {name: estimate})
        if fraction > 0.5 and np.isfinite(typical):
            assert imprecise == {name: f"the half-width of its 95 % interval is {half_width:.2g} {unit}"}
        else:
            assert imprecise == {}


def test_a_gain_that_is_not_identified_is_zero_and_widens_the_other_intervals(monkeypatch):
    """Position and velocity gain, delay, filter and limit stay in the fit, even if they are not identified."""
    pieces = [flown(BASIC_TERMS[:4], Shape(0.05), noise=0.02)]
    fit = search_fit(pieces, (0,), BASIC_TERMS, [Shape(0.05)], ("delay",))
    imprecise = {"position": "wide", "displacement": "wide", "delay": "wide"}
    monkeypatch.setattr(law, "_imprecise", lambda spreads: dict(imprecise))
    result = law._axis_law(pieces, (0,), "heading", fit)
    identified = tuple(name for name in BASIC_TERMS if name != "displacement")
    refit = search_fit(pieces, (0,), identified, [fit.shape], ("delay",))
    assert result.not_identified == imprecise
    assert {*result.gains} == {*identified} - {"position"}
    wide, narrow = (law._estimates(pieces, (0,), each, "heading") for each in (fit, refit))
    for name, spread in result.gains.items():
        assert spread.value == narrow[name].value
        assert spread.deviation == max(wide[name].deviation, narrow[name].deviation)
    assert result.explained_variance == refit.explained_variance != fit.explained_variance
    assert any(wide[name].deviation > 1.1 * narrow[name].deviation for name in result.gains)
    assert (result.gain("velocity"), result.gain("displacement")) == (narrow["velocity"].value, 0.0)


def test_reference_gains_are_not_identified_if_the_reference_rests(monkeypatch):
    piece = flown(("position", "velocity", "integral"), Shape(0.05), noise=0.02)
    piece = piece._replace(
        reference_velocity=np.zeros_like(piece.velocity), reference_acceleration=np.zeros_like(piece.velocity)
    )
    limit = float(np.quantile(np.abs(piece.error[piece.evaluated][:, :2]), 0.75))
    fit = search_fit([piece], (0, 1), ("position", "velocity", "integral"), [Shape(0.05)], ("delay",))
    fit = fit._replace(shape=fit.shape._replace(error_limit=limit))
    monkeypatch.setattr(law, "_imprecise", lambda spreads: {})
    result = law._axis_law([piece], (0, 1), "heading", fit)
    assert result.axes == ("x", "y")
    assert result.not_identified == dict.fromkeys(BASIC_TERMS[2:5], "the reference does not move along this axis")
    assert {*result.gains} == {"position", "velocity", "integral", "delay"}
    assert result.explained_variance == fit.explained_variance
    assert result.at_error_limit == pytest.approx(0.25, abs=1e-3)


def test_forms_of_the_law_are_compared_by_the_unexplained_variances_of_all_axes(monkeypatch):
    """An exact fit of a single axis does not decide the comparison: its unexplained variance is raised to 1e-12."""
    used = []

    def fit_with_limit(pieces, axes):
        used.append([np.flatnonzero(piece.evaluated) for piece in pieces])
        return fit_of_everything((1.0 - 1e-3, 1.0 - 1e-6, 1.0)[axes[0]])

    monkeypatch.setattr(law, "fit_with_limit", fit_with_limit)
    pieces = [flown(seconds=10.0), flown(seconds=12.0, begin=20.0)]
    expected = np.log(1e-3) + np.log(1e-6) + np.log(1e-12)
    assert law._log_unexplained(pieces) == pytest.approx(expected, rel=1e-6)
    # Every third of 2000 samples is used, which is more than 600 samples.
    for actual, piece in zip(used[0], pieces, strict=True):
        every = np.arange(0, len(piece.time), 3)
        np.testing.assert_array_equal(actual, every[piece.evaluated[every]])
    law._log_unexplained([flown(seconds=6.0)])
    np.testing.assert_array_equal(used[-1][0], np.arange(100, 600))
