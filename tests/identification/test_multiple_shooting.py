"""Least squares with states of their own in each window, beside closed forms."""

import numpy as np
import pytest

from drake_quad.identification.fitting.multiple_shooting import Problem, fit, uncertainty
from drake_quad.identification.fitting.whitening import Noise, noise_of, still, straying

RNG = np.random.default_rng(3)
WINDOWS, SIZE, PARAMETERS, STATES = 24, 12, 3, 2
J = RNG.normal(size=(WINDOWS, SIZE, PARAMETERS))
X = RNG.normal(size=(WINDOWS, SIZE, STATES))
Y = RNG.normal(size=(WINDOWS, SIZE))


def problem(residuals, **options):
    one = np.ones(PARAMETERS)
    given = {"believed": 0.0 * one, "beliefs": 1e6 * one, "least": -np.inf * one, **options}
    return Problem(residuals, np.array([1.0, 10.0, 0.1]), np.ones(STATES), **given)


def linear(parameters, states):
    return np.einsum("wmp,kp->kwm", J, parameters) + np.einsum("wms,kws->kwm", X, states) - Y


def whole_matrix():
    """The same as one least squares problem with a column for each state of each window."""
    blocks = np.zeros((WINDOWS, SIZE, WINDOWS, STATES))
    for w in range(WINDOWS):
        blocks[w, :, w] = X[w]
    return np.concatenate([J.reshape(-1, PARAMETERS), blocks.reshape(WINDOWS * SIZE, -1)], axis=1)


def test_a_linear_problem_has_the_solution_of_plain_least_squares():
    found = fit(problem(linear), np.ones(PARAMETERS), np.zeros((WINDOWS, STATES)), tolerance=1e-14)
    expected = np.linalg.lstsq(whole_matrix(), Y.ravel(), rcond=None)[0]
    assert found.converged
    np.testing.assert_allclose(found.parameters, expected[:PARAMETERS], rtol=1e-6)
    np.testing.assert_allclose(found.states.ravel(), expected[PARAMETERS:], rtol=1e-5, atol=1e-8)


def test_a_linear_problem_is_solved_in_three_iterations():
    """Each leaves about as much of the error as the damping: 1e-3, 1e-4 and 1e-5."""
    found = fit(problem(linear), np.ones(PARAMETERS), np.zeros((WINDOWS, STATES)), iterations=3)
    expected = np.linalg.lstsq(whole_matrix(), Y.ravel(), rcond=None)[0]
    np.testing.assert_allclose(found.parameters, expected[:PARAMETERS], rtol=1e-6)


def test_a_belief_is_one_more_measurement():
    believed, beliefs = np.array([1.0, -2.0, 0.5]), np.array([0.1, 0.2, 0.3])
    found = fit(
        problem(linear, believed=believed, beliefs=beliefs), believed, np.zeros((WINDOWS, STATES)), tolerance=1e-14
    )
    more = np.eye(PARAMETERS, whole_matrix().shape[1]) / beliefs[:, None]
    expected = np.linalg.lstsq(np.vstack([whole_matrix(), more]), np.append(Y.ravel(), believed / beliefs), rcond=None)[
        0
    ]
    np.testing.assert_allclose(found.parameters, expected[:PARAMETERS], rtol=1e-6)


def test_a_parameter_does_not_go_below_what_makes_sense():
    free = fit(problem(linear), np.ones(PARAMETERS), np.zeros((WINDOWS, STATES))).parameters
    least = free + np.array([0.5, -1.0, -1.0])
    found = fit(problem(linear, least=least), free + 1.0, np.zeros((WINDOWS, STATES))).parameters
    assert found[0] == least[0]


def test_a_curved_problem_is_solved():
    """A decay whose rate is shared and whose beginning is each window's own."""
    times = np.linspace(0.0, 2.0, 20)
    begun = RNG.uniform(1.0, 3.0, size=30)
    measured = begun[:, None] * np.exp(-1.7 * times)

    def residuals(parameters, states):
        return states * np.exp(-parameters[:, :1, None] * times) - measured

    one = np.ones(1)
    curved = Problem(residuals, one, one, 0.0 * one, 1e9 * one, 0.0 * one)
    found = fit(curved, 0.3 * one, np.ones((30, 1)), tolerance=1e-12)
    assert found.parameters[0] == pytest.approx(1.7, rel=1e-6)
    np.testing.assert_allclose(found.states[:, 0], begun, rtol=1e-5)


def test_a_state_that_nothing_measures_takes_nothing_away():
    without = fit(problem(linear), np.zeros(PARAMETERS), np.zeros((WINDOWS, STATES)))
    unmeasured = problem(lambda parameters, states: linear(parameters, states[..., :STATES]))
    unmeasured = unmeasured._replace(state_scales=np.ones(STATES + 1))
    found = fit(unmeasured, np.zeros(PARAMETERS), np.zeros((WINDOWS, STATES + 1)))
    np.testing.assert_allclose(found.slopes.projected()[1], without.slopes.projected()[1], atol=1e-6)


def test_white_residuals_have_the_covariance_of_least_squares():
    """Of which the sandwich is the same in the mean, and makes it larger where residuals hang together."""
    white, hanging = [], []
    blocks = np.arange(WINDOWS) // 2
    for seed in range(60):
        noise = np.random.default_rng(seed).normal(size=(WINDOWS, SIZE))
        pushed = noise + np.repeat(np.random.default_rng(seed + 99).normal(size=WINDOWS // 2), 2)[:, None] * J[:, :, 0]
        for values, kept in ((noise, white), (pushed, hanging)):
            own = problem(lambda p, s, y=values: linear(p, s) + Y - y)
            found = fit(own, np.zeros(PARAMETERS), np.zeros((WINDOWS, STATES)), iterations=3)
            kept.append((found.parameters, np.sqrt(np.diag(uncertainty(own, found, blocks).covariance))))
    expected = np.sqrt(np.diag(np.linalg.inv(whole_matrix().T @ whole_matrix()))[:PARAMETERS])
    deviations = np.array([each[1] for each in white])
    assert np.all(deviations >= 0.999 * expected)
    np.testing.assert_allclose(deviations.mean(axis=0), expected, rtol=0.25)
    scatter = np.std([each[0] for each in hanging], axis=0)
    assert scatter[0] > 2.0 * expected[0]
    assert np.mean([each[1] for each in hanging], axis=0)[0] == pytest.approx(scatter[0], rel=0.3)


def test_the_sandwich_makes_up_for_blocks_that_the_fit_follows():
    """Over residuals: H⁻¹ Σ Xᵀ A e eᵀ A X H⁻¹ with A = (1 - X H⁻¹ Xᵀ)^(-1/2) of each block."""
    blocks = np.arange(WINDOWS) // 2
    pushed = 3.0 * np.random.default_rng(7).normal(size=(WINDOWS, 1)) * J[:, :, 0]
    own = problem(lambda p, s: linear(p, s) + pushed)
    found = fit(own, np.zeros(PARAMETERS), np.zeros((WINDOWS, STATES)), iterations=3)
    residuals, slopes = found.slopes.projected()
    inverse = np.linalg.inv(np.einsum("wmi,wmj->ij", slopes, slopes))
    expected = np.zeros((PARAMETERS, PARAMETERS))
    for b in np.unique(blocks):
        X, e = slopes[blocks == b].reshape(-1, PARAMETERS), residuals[blocks == b].ravel()
        values, vectors = np.linalg.eigh(np.eye(len(e)) - X @ inverse @ X.T)
        A = (vectors / np.sqrt(values)) @ vectors.T
        pull = inverse @ X.T @ A @ e
        expected += np.outer(pull, pull)
    larger = np.diag(expected) > np.diag(inverse)
    assert larger[0]
    np.testing.assert_allclose(
        np.diag(uncertainty(own, found, blocks).covariance)[larger], np.diag(expected)[larger], rtol=1e-5
    )


def test_numbers_that_few_blocks_tell_have_few_degrees_of_freedom():
    """Twice as many as blocks tell it, and one less than there are blocks at most."""

    def residuals(parameters, states):
        found = states + parameters[:, None, :1] * J[:, :, 0] + Y
        found[:, :2] += parameters[:, 1:2, None] * J[:2, :, 1]
        return found

    flat = np.zeros(2)
    few = Problem(residuals, np.ones(2), np.ones(1), flat, 1e9 * np.ones(2), np.full(2, -np.inf))
    own = few._replace(residuals=lambda p, s: residuals(p, np.broadcast_to(s, (*s.shape[:2], SIZE))))
    found = fit(own, flat, np.zeros((WINDOWS, 1)), iterations=3)
    freedom = uncertainty(own, found, np.arange(WINDOWS)).degrees_of_freedom
    assert freedom[0] == WINDOWS - 1
    assert 2.0 < freedom[1] < 4.5


def test_a_number_that_no_block_tells_keeps_its_belief():
    """It is as unsure as before, its degrees of freedom are the fewest, and the others are as without it."""

    def sure(residuals, count):
        ones = np.ones(count)
        own = Problem(residuals, ones, np.ones(STATES), 0.0 * ones, 10.0 * ones, -np.inf * ones)
        return uncertainty(own, fit(own, 0.0 * ones, np.zeros((WINDOWS, STATES)), iterations=3), np.arange(WINDOWS))

    own, without = sure(lambda p, s: linear(p[:, :-1], s), PARAMETERS + 1), sure(linear, PARAMETERS)
    assert own.covariance[-1, -1] == pytest.approx(100.0)
    assert own.degrees_of_freedom[-1] == own.degrees_of_freedom.min()
    np.testing.assert_allclose(own.covariance[:-1, :-1], without.covariance, rtol=1e-9)
    np.testing.assert_allclose(own.degrees_of_freedom[:-1], without.degrees_of_freedom, rtol=1e-9)


def test_noise_and_straying_are_told_apart():
    times = np.linspace(0.0, 1.0, 51)
    shape = straying(times)
    true = Noise(0.002, 0.05)
    drawn = RNG.normal(size=(400, 51)) @ np.linalg.inv(true.whitener(shape))
    found = noise_of(drawn, shape)
    assert found.white == pytest.approx(true.white, rel=0.05)
    assert found.strayed == pytest.approx(true.strayed, rel=0.1)
    whitened = drawn @ found.whitener(shape)
    np.testing.assert_allclose(np.cov(whitened.T), np.eye(51), atol=0.3)
    assert noise_of(RNG.normal(size=(50, 51)), still(shape)).strayed == 0.0


def test_what_strays_is_the_double_integral_of_white_noise():
    times = np.arange(200) * 0.01
    steps = RNG.normal(size=(3000, 200)) / np.sqrt(0.01)
    strayed = np.cumsum(np.cumsum(steps, axis=1) * 0.01, axis=1) * 0.01
    values, vectors = straying(times)
    K = vectors * values @ vectors.T
    np.testing.assert_allclose(np.cov(strayed[:, [99, 199]].T), K[np.ix_([99, 199], [99, 199])], rtol=0.1)
