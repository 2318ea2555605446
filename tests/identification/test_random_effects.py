"""Tests of parameters that vary between stretches of flight.

The tests compare with known solutions and with refits of single stretches, and check the coverage of intervals.
"""

import numpy as np
import pytest
from scipy.stats import chi2, f

from drake_quad.identification.evidence import Evidence, Uncertainty, jackknife, sums_over_blocks
from drake_quad.identification.random_effects import (
    NUM_SEGMENTS,
    FlightSegments,
    Variation,
    estimate_variation,
    uncertainty_of_mean,
)
from drake_quad.identification.results.held_out import hold_out_check

PRIOR_SCALES = np.full(2, 1e6)  # so large that the prior has no influence


def evidence(rng, *, deviation: float, windows: int = 60, samples: int = 8) -> Evidence:
    """Return the evidence of a linear fit with unit noise; its second parameter varies between flight stretches."""
    rows = rng.normal(size=(windows, samples, 2)) * rng.uniform(0.7, 1.4, size=(windows, 1, 1))
    jacobian = np.stack([np.ones(NUM_SEGMENTS), -2.0 + deviation * rng.normal(size=NUM_SEGMENTS)], axis=1)
    parameters_of_window = jacobian[np.arange(windows) * NUM_SEGMENTS // windows]
    values = np.einsum("wkp,wp->wk", rows, parameters_of_window) + rng.normal(size=(windows, samples))
    result = np.linalg.lstsq(rows.reshape(-1, 2), values.ravel(), rcond=None)[0]
    errors = values - rows @ result
    return Evidence(
        ("drag", "lag"), result, PRIOR_SCALES, rows.swapaxes(1, 2) @ rows, -np.einsum("wkp,wk->wp", rows, errors), 80.0
    )


def stretches_of(estimates: np.ndarray, variances: np.ndarray) -> FlightSegments:
    """Return stretches of flight with estimates of one parameter and the variances of the estimation errors."""
    information = 1.0 / variances[:, None, None]
    nothing = np.zeros((len(estimates), 1))
    return FlightSegments(information, nothing, estimates[:, None], variances[:, None], 50.0, 1.0)


def test_the_variation_of_a_parameter_is_zero_if_the_log_contains_no_information_on_it() -> None:
    rng = np.random.default_rng(5)
    informative = evidence(rng, deviation=0.5)
    zeros = np.zeros(2)
    extended = informative._replace(
        names=(*informative.names, "none"),
        values=np.append(informative.values, 3.0),
        scales=np.append(informative.scales, 1.0),
        information=np.pad(informative.information, [(0, 0), (0, 1), (0, 1)]),
        scores=np.pad(informative.scores, [(0, 0), (0, 1)]),
    )
    result, known = estimate_variation(extended), estimate_variation(informative)
    assert result is not None
    assert known is not None
    np.testing.assert_allclose(result.covariance[:2, :2], known.covariance, rtol=1e-9)
    np.testing.assert_array_equal(result.covariance[2], [*zeros, 0.0])
    # If the jackknife finds no variance, the variance of the mean is also zero.
    uncertainty = jackknife(extended.information, extended.scores)
    mean = uncertainty_of_mean(uncertainty, extended, result)
    assert np.isfinite(mean.covariance).all()
    assert mean.covariance[2, 2] == 0.0


def test_each_stretch_of_flight_is_fitted_separately() -> None:
    """One Gauss-Newton step is exact for a linear model, so the test compares it with a refit of each stretch."""
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(20, 5, 2))
    values = rows @ [1.0, -2.0] + rng.normal(size=(20, 5))
    actual = np.linalg.lstsq(rows.reshape(-1, 2), values.ravel(), rcond=None)[0]
    scores = -np.einsum("wkp,wk->wp", rows, values - rows @ actual)
    stretches = FlightSegments.of(Evidence(("a", "b"), actual, PRIOR_SCALES, rows.swapaxes(1, 2) @ rows, scores, 20.0))
    for b in range(NUM_SEGMENTS):
        windows = slice(2 * b, 2 * b + 2)
        expected = np.linalg.lstsq(rows[windows].reshape(-1, 2), values[windows].ravel(), rcond=None)[0]
        np.testing.assert_allclose(stretches.estimates[b], expected, rtol=1e-6)
    rest = stretches.without(4)
    others = np.arange(20) // 2 != 4
    expected = np.linalg.lstsq(rows[others].reshape(-1, 2), values[others].ravel(), rcond=None)[0]
    np.testing.assert_allclose(actual + rest.step(), expected, rtol=1e-9)


@pytest.mark.parametrize("windows", [20, 23, 37])
@pytest.mark.parametrize("noise", [0.2, 3.0])
def test_error_variances_follow_from_the_scatter_of_windows_within_a_stretch(windows, noise) -> None:
    """All windows have the same information h.

    If model and noise are right, the scores of the windows have the variance h, and the error of a stretch of n windows
    has the variance 1 / (n h). If the mean variance of the scores is larger than h, the variance of the error is larger
    by the same factor.
    """
    rng = np.random.default_rng(11)
    scores = noise * rng.normal(size=(windows, 1))
    h = 1.7
    stretches = FlightSegments.of(
        Evidence(("drag",), np.zeros(1), np.full(1, 1e6), np.full((windows, 1, 1), h), scores, 5.0)
    )
    blocks = [scores[np.arange(windows) * NUM_SEGMENTS // windows == b] for b in range(NUM_SEGMENTS)]
    sizes = np.array([len(block) for block in blocks])
    assert len(set(sizes)) == (1 if windows == 20 else 2)
    differ = sum(len(block) * np.var(block, ddof=1) for block in blocks) / windows
    np.testing.assert_allclose(stretches.variances[:, 0], max(1.0, differ / h) / (sizes * h), rtol=1e-9)
    assert (differ > h) == (noise > 1.0)
    assert stretches.degrees_of_freedom == windows - NUM_SEGMENTS
    assert stretches.duration == pytest.approx(0.5)


def test_error_variances_follow_from_the_information_if_each_stretch_of_flight_has_one_window() -> None:
    fitted = evidence(np.random.default_rng(12), deviation=3.0, windows=NUM_SEGMENTS, samples=40)
    stretches = FlightSegments.of(fitted._replace(scales=np.full(2, 0.3)))
    nominal = np.linalg.inv(fitted.information + np.eye(2) / 0.09)
    np.testing.assert_allclose(stretches.variances, np.diagonal(nominal, axis1=1, axis2=2), rtol=1e-9)
    assert stretches.degrees_of_freedom == np.inf


def test_a_parameter_varies_if_its_scatter_is_significant_at_ten_per_cent() -> None:
    """The significance test is χ² for known errors, and F for errors estimated with few degrees of freedom."""
    unit = np.array([-1.5, 1.5, -1.0, 1.0, -0.5, 0.5, -2.0, 2.0, -0.2, 0.2])
    unit *= np.sqrt(9.0 / np.sum(unit**2))
    for freedom, critical in ((np.inf, chi2.isf(0.1, 9) / 9.0), (10.0, f.isf(0.1, 9, 10)), (50.0, f.isf(0.1, 9, 50))):
        for factor, varies in ((0.99, False), (1.01, True)):
            stretches = stretches_of(np.sqrt(factor * critical) * unit, np.ones(10))._replace(
                degrees_of_freedom=freedom
            )
            assert (stretches.variance_between()[0] > 0.0) == varies
            if varies:
                assert stretches.variance_between()[0] == pytest.approx(factor * critical - 1.0)


def test_parameters_that_vary_together_are_correlated() -> None:
    """The second parameter is -2 times the first, and the third is independent of both."""
    rng = np.random.default_rng(13)
    one, other = rng.normal(size=(2, 400))
    estimates = 5.0 + np.stack([one, -2.0 * one, other], axis=1)
    variances = np.full((400, 3), 1e-6)
    given = FlightSegments(np.zeros((400, 3, 3)), np.zeros((400, 3)), estimates, variances, 50.0, 1.0)
    result = given.correlation(np.array([1.0, 4.0, 1.0]))
    np.testing.assert_allclose(result[:2, :2], [[1.0, -1.0], [-1.0, 1.0]])
    assert result[0, 2] == pytest.approx(np.corrcoef(one, other)[0, 1], rel=1e-3)
    # Stretches with large errors have less weight; here, only the first ten matter.
    variances[10:] = 1e9
    assert given.correlation(np.ones(3))[0, 2] == pytest.approx(np.corrcoef(one[:10], other[:10])[0, 1], rel=1e-3)
    # The covariance of a variation follows from these correlations and from the variance of each parameter.
    evidences = evidence(rng, deviation=2.0)
    varied = estimate_variation(evidences)
    stretches = FlightSegments.of(evidences)
    sizes = np.sqrt(np.diag(varied.covariance))
    np.testing.assert_allclose(sizes**2, stretches.variance_between())
    np.testing.assert_allclose(varied.covariance, stretches.correlation(sizes**2) * np.outer(sizes, sizes))
    assert varied.degrees_of_freedom == NUM_SEGMENTS - 1
    assert varied.duration == 8.0


def test_a_variation_can_be_reduced_to_some_parameters_and_extended_by_unknown_ones() -> None:
    variation = Variation(np.arange(9.0).reshape(3, 3), 9.0, 8.0)
    part = variation.subset([2, 0])
    np.testing.assert_array_equal(part.covariance, [[8.0, 6.0], [2.0, 0.0]])
    extended = part.with_unknown_parameters(2)
    np.testing.assert_array_equal(extended.covariance[:2, :2], part.covariance)
    assert np.isnan(np.diag(extended.covariance)[2:]).all()
    assert not extended.covariance[:2, 2:].any()


def test_the_variance_of_estimation_errors_is_subtracted_from_the_variance_between_stretches() -> None:
    """The variance between stretches is s² - v, for the sample variance s² and equal error variances v."""
    estimates = np.array([1.0, 3.0, -2.0, 5.0, 0.0, 4.0, -1.0, 2.0, 6.0, -3.0])
    result = stretches_of(estimates, np.full(10, 2.0)).variance_between()
    assert result[0] == pytest.approx(np.var(estimates, ddof=1) - 2.0)
    # The estimated variance does not depend on the unit of the parameter.
    tiny = stretches_of(1e-8 * estimates, np.full(10, 2e-16)).variance_between()
    assert tiny[0] == pytest.approx(1e-16 * result[0], rel=1e-9)


def test_the_weighted_sum_of_squares_equals_its_degrees_of_freedom() -> None:
    estimates, variances = np.array([0.0, 1.0, 9.0, -4.0, 2.0, 7.0]), np.array([0.1, 4.0, 1.0, 0.5, 2.0, 0.3])
    (between,) = stretches_of(estimates, variances).variance_between()
    weights = 1.0 / (variances + between)
    mean = np.sum(weights * estimates) / weights.sum()
    assert np.sum(weights * (estimates - mean) ** 2) == pytest.approx(5.0)


@pytest.mark.long
def test_random_scatter_is_seldom_taken_for_variation() -> None:
    """The significance level is ten per cent."""
    rng = np.random.default_rng(0)
    result = [estimate_variation(evidence(rng, deviation=0.0)) for _ in range(300)]
    varies = np.array([np.diag(each.covariance) > 0.0 for each in result if each is not None])
    assert len(varies) == 300
    assert 0.02 < varies.mean() < 0.12


def test_variation_is_found_only_in_the_parameter_that_varies() -> None:
    rng = np.random.default_rng(1)
    result = np.array([np.diag(estimate_variation(evidence(rng, deviation=0.5)).covariance) for _ in range(100)])
    assert np.mean(result[:, 1]) == pytest.approx(0.25, rel=0.15)
    assert np.median(result[:, 0]) == 0.0


def test_a_variation_is_estimated_from_at_least_twenty_windows() -> None:
    complete = evidence(np.random.default_rng(2), deviation=1.0, windows=20)

    def first(count):
        return complete._replace(information=complete.information[:count], scores=complete.scores[:count])

    nine_windows = first(9)
    assert estimate_variation(first(19)) is None
    assert estimate_variation(complete) is not None
    assert hold_out_check(first(10)).keys() == {"drag", "lag"}
    assert hold_out_check(nine_windows) == {}
    uncertainty = Uncertainty(np.eye(2), np.full(2, 8.0), np.eye(2))
    assert uncertainty_of_mean(uncertainty, nine_windows, None) is uncertainty


def test_the_variance_of_a_parameter_that_varies_is_the_jackknife_variance_over_stretches_of_flight() -> None:
    """The uncertainty of a parameter that does not vary is unchanged."""
    fitted = evidence(np.random.default_rng(4), deviation=2.0)
    blocks = np.arange(60) * NUM_SEGMENTS // 60
    by_stretches = jackknife(sums_over_blocks(fitted.information, blocks), sums_over_blocks(fitted.scores, blocks))
    before = Uncertainty(np.array([[4e-3, 1e-3], [1e-3, 5e-3]]), np.full(2, 30.0), np.eye(2))
    varies = Variation(np.diag([0.0, 4.0]), 9.0, 8.0)
    mean = uncertainty_of_mean(before, fitted, varies)
    assert mean.covariance[0, 0] == before.covariance[0, 0]
    assert mean.covariance[1, 1] == pytest.approx(by_stretches.covariance[1, 1])
    assert mean.covariance[1, 1] > 10.0 * before.covariance[1, 1]
    correlation = before.covariance[0, 1] / np.sqrt(np.prod(np.diag(before.covariance)))
    assert mean.covariance[0, 1] / np.sqrt(np.prod(np.diag(mean.covariance))) == pytest.approx(correlation)
    np.testing.assert_allclose(mean.degrees_of_freedom, [30.0, by_stretches.degrees_of_freedom[1]])


@pytest.mark.long
@pytest.mark.parametrize("deviation", [0.3, 3.0])
def test_intervals_cover_the_estimates_from_held_out_stretches(deviation) -> None:
    """The coverage is 95 % for small and for large variation, to within three standard errors."""
    rng = np.random.default_rng(5)
    held = [
        [each.num_covered for each in hold_out_check(evidence(rng, deviation=deviation)).values()] for _ in range(60)
    ]
    fraction = np.mean(held, axis=0) / NUM_SEGMENTS
    # The standard error of the coverage of 600 intervals is 0.009.
    assert np.all(fraction > 0.95 - 3.0 * 0.009)
    assert np.all(fraction < 0.95 + 4.0 * 0.009)


@pytest.mark.filterwarnings("error")
def test_a_parameter_that_only_one_stretch_determines_has_the_variance_for_a_correct_model() -> None:
    """The parameter has one degree of freedom, since all other stretches contain no information on it."""
    fitted = evidence(np.random.default_rng(7), deviation=0.0)
    alone = np.arange(60) * NUM_SEGMENTS // 60 == 3
    mask = np.where(alone, 1.0, 0.0)[:, None] * [0.0, 1.0] + [1.0, 0.0]
    reduced = fitted._replace(
        scales=np.ones(2),
        information=fitted.information * np.eye(2) * mask[:, :, None],
        scores=(fitted.scores - np.mean(fitted.scores[alone], axis=0)) * mask,
    )
    mean = FlightSegments.of(reduced).uncertainty()
    # Leaving out another stretch does not change the estimate, so the jackknife variance is zero. The variance for a
    # correct model replaces it.
    assert mean.covariance[1, 1] == pytest.approx(1.0 / reduced.information[:, 1, 1].sum())
    assert mean.degrees_of_freedom[1] == 1.0
    only_drag = reduced._replace(
        names=("drag",),
        values=reduced.values[:1],
        scales=reduced.scales[:1],
        information=reduced.information[:, :1, :1],
        scores=reduced.scores[:, :1],
    )
    drag_uncertainty = FlightSegments.of(only_drag).uncertainty()
    assert mean.covariance[0, 0] == pytest.approx(drag_uncertainty.covariance[0, 0])
    before = Uncertainty(np.diag([4e-3, 2e-2]), np.full(2, 30.0), np.eye(2))
    after = uncertainty_of_mean(before, reduced, Variation(np.diag([0.0, 1.0]), 9.0, 8.0))
    np.testing.assert_array_equal(after.covariance, before.covariance)
    held = hold_out_check(reduced)
    assert np.all(np.isfinite(held["lag"].half_widths))
    np.testing.assert_allclose(held["drag"].errors, hold_out_check(only_drag)["drag"].errors)
