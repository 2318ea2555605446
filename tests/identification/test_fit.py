"""Tests of fits: covariances, degrees of freedom and noise are compared with known solutions."""

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
import scipy

from drake_quad.errors import InputError
from drake_quad.identification import fit as fitting
from drake_quad.identification.evidence import effective_blocks, jackknife, quantile, sums_over_blocks
from drake_quad.identification.fit import PredictionFit, noise_likelihood
from drake_quad.identification.parameters import Parameter
from drake_quad.identification.prediction_errors import Gains, PredictionNoise

# Noise of one measurement, and standard deviations and correlation times of the six components of the disturbance.
UNIT_NOISE = PredictionNoise(np.ones(1), np.ones(6), np.ones(6))
EMPTY_GAINS = Gains(*(np.empty(0) for _ in Gains._fields))._replace(noise=UNIT_NOISE)


def line_fit(windows: int, samples: int, seed: int) -> tuple[PredictionFit, np.ndarray, np.ndarray]:
    """Return a least-squares fit of two parameters to windows of samples, the regressors and the fitted values."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(windows, samples, 2)) * rng.uniform(0.5, 2.0, size=(windows, 1, 1))
    values = rows @ [1.0, -2.0] + rng.normal(size=(windows, 1)) + 0.3 * rng.normal(size=(windows, samples))
    result = np.linalg.lstsq(rows.reshape(-1, 2), values.ravel(), rcond=None)[0]
    # An error is measured minus predicted.
    return PredictionFit(result, UNIT_NOISE, EMPTY_GAINS, -rows, values - rows @ result, np.zeros(2)), rows, values


@pytest.mark.parametrize("prior", [np.zeros(2), np.array([30.0, 0.5])], ids=["without a prior", "with a prior"])
@pytest.mark.parametrize("adjacent", [False, True])
def test_the_covariance_is_the_jackknife_estimate_over_blocks(prior: np.ndarray, adjacent: bool) -> None:
    """One Gauss-Newton step is exact for a linear model, so the test refits without each block in turn."""
    _, rows, values = line_fit(12, 7, seed=0)
    blocks, mean = np.arange(12) // 3, np.array([0.5, -1.0])

    def fitted(included: np.ndarray) -> np.ndarray:
        result, measured = rows[included].reshape(-1, 2), values[included].ravel()
        return np.linalg.solve(result.T @ result + np.diag(prior), result.T @ measured + prior * mean)

    complete_fit = fitted(np.full(12, True))
    changes = np.array([fitted(blocks != b) - complete_fit for b in range(4)])
    expected = 3 / 4 * changes.T @ changes
    if adjacent:
        first, second = changes[:-1], changes[1:]
        expected += 3 / 4 * 0.5 * (first.T @ second + second.T @ first)
    inverse = np.linalg.inv(np.einsum("wkp,wkq->pq", rows, rows) + np.diag(prior))
    expected += inverse @ np.diag(prior) @ inverse
    # Each interval is at least as wide as that for a correct model, whose variances are on the diagonal of `inverse`.
    freedom = effective_blocks(sums_over_blocks(rows.swapaxes(1, 2) @ rows, blocks), inverse) - 1.0
    widths = scipy.stats.t.ppf(0.975, freedom) * np.sqrt(np.diag(expected))
    is_narrow = widths < scipy.stats.norm.ppf(0.975) * np.sqrt(np.diag(inverse))
    scale = np.where(is_narrow, np.sqrt(np.diag(inverse) / np.diag(expected)), 1.0)
    actual = PredictionFit(complete_fit, UNIT_NOISE, EMPTY_GAINS, -rows, values - rows @ complete_fit, prior)
    if adjacent:
        result = actual.uncertainty(blocks)
    else:
        information = sums_over_blocks(np.einsum("wkp,wkq->wpq", actual.jacobian, actual.jacobian), blocks)
        scores = sums_over_blocks(np.einsum("wkp,wk->wp", actual.jacobian, actual.errors), blocks)
        result = jackknife(information, scores, prior=prior)
    np.testing.assert_allclose(result.covariance, expected * np.outer(scale, scale), rtol=1e-9)
    np.testing.assert_allclose(result.model_covariance, inverse, rtol=1e-9)


def test_an_interval_is_at_least_as_wide_as_for_a_correct_model() -> None:
    """The scores of the first parameter are far smaller than expected, and those of the second far larger."""
    information = np.tile(np.diag([4.0, 1.0]), (10, 1, 1))
    scores = np.stack([np.full(10, 1e-6), np.tile([3.0, -3.0], 5)], axis=1)
    result = jackknife(information, scores)
    assert result.covariance[0, 0] == pytest.approx(1.0 / 40.0)
    assert result.covariance[1, 1] == pytest.approx(9.0 / 10.0 * 10 * (3.0 / 9.0) ** 2)
    np.testing.assert_allclose(result.degrees_of_freedom, [np.inf, 9.0])
    # The scores are such that the jackknife variance is slightly smaller than that of a correct model, but its
    # interval, with the quantile for nine degrees of freedom, is wider.
    similar = jackknife(information[:, 1:, 1:], np.tile([0.9, -0.9], 5)[:, None])
    assert similar.covariance[0, 0] == pytest.approx(0.09)
    assert similar.degrees_of_freedom == pytest.approx(9.0)


@pytest.mark.parametrize(("variance", "largest"), [(1.0, 0.98), (2.0, 0.97), (9.0, 0.96)])
def test_jackknife_intervals_cover_the_true_value_also_if_the_model_is_correct(variance, largest) -> None:
    """With ten blocks, at least 95 % of the intervals contain the true value, and few more.

    Args:
        variance: variance of the whitened errors. It is 1 if the model is correct.
        largest: largest coverage.
    """
    rng, covered, count = np.random.default_rng(8), 0, 4000
    for errors in np.sqrt(variance) * rng.normal(size=(count, 10)):
        result = jackknife(np.ones((10, 1, 1)), (errors - errors.mean())[:, None])
        half_width = quantile(result.degrees_of_freedom[0]) * np.sqrt(result.covariance[0, 0])
        covered += abs(errors.mean()) < half_width
    assert 0.94 < covered / count < largest


def test_an_interval_from_a_single_informative_block_is_wide() -> None:
    """The jackknife then cannot show that the model is wrong, so the interval has one degree of freedom."""
    information, scores = np.zeros((10, 1, 1)), np.zeros((10, 1))
    information[3] = 4.0
    result = jackknife(information, scores)
    assert result.covariance[0, 0] == pytest.approx(0.25)
    assert result.degrees_of_freedom[0] == 1.0


def test_condensed_residuals_keep_the_normal_equations_and_the_sum_of_squares() -> None:
    """The columns differ by eight orders of magnitude, like the derivatives for an inertia and a time constant."""
    rng = np.random.default_rng(4)
    jacobian, residuals = rng.normal(size=(300, 4)) * [1e-4, 1.0, 1e4, 1.0], rng.normal(size=300)
    condensed_residuals, condensed_jacobian = fitting._condensed(residuals, jacobian)
    assert (condensed_residuals.shape, condensed_jacobian.shape) == ((5,), (5, 4))
    np.testing.assert_allclose(condensed_residuals @ condensed_residuals, residuals @ residuals)
    np.testing.assert_allclose(condensed_jacobian.T @ condensed_jacobian, jacobian.T @ jacobian, rtol=1e-9)
    np.testing.assert_allclose(condensed_jacobian.T @ condensed_residuals, jacobian.T @ residuals, rtol=1e-9)


def test_negative_correlation_of_adjacent_windows_narrows_intervals() -> None:
    """The errors are n_k - 0.8 n_(k-1) with white noise n.

    The standard deviation of their mean is a fifth of the standard deviation of the mean of n.
    """
    variances, mean_errors = {}, []
    for seed in range(300):
        noise = 30.0 * np.random.default_rng(seed).normal(size=41)  # far more noise than the model expects
        errors = (noise[1:] - 0.8 * noise[:-1])[:, None, None]
        mean_errors.append(errors.mean())
        information, scores = np.ones((40, 1, 1)), -(errors - errors.mean())[:, 0]
        for adjacent in (True, False):
            result = jackknife(information, scores, adjacent=adjacent)
            variances.setdefault(adjacent, []).append(float(result.covariance[0, 0]))
    variance = float(np.mean(np.square(mean_errors)))
    assert np.mean(variances[False]) > 20.0 * variance
    assert np.mean(variances[True]) < 0.55 * np.mean(variances[False])


def test_degrees_of_freedom_count_the_informative_blocks() -> None:
    """Ten equally informative blocks give nine degrees of freedom; two informative ones give one."""
    jacobian = np.zeros((10, 5, 2))
    jacobian[:, :3, 0] = 1.0
    jacobian[:2, 3:, 1] = 1.0
    errors = 30.0 * np.random.default_rng(1).normal(size=(10, 5))  # far more than the model expects
    fitted = PredictionFit(np.zeros(2), UNIT_NOISE, EMPTY_GAINS, jacobian, errors, np.zeros(2))
    result = fitted.uncertainty(np.arange(10)).degrees_of_freedom
    np.testing.assert_allclose(result, [9.0, 1.0])


@pytest.mark.slow
def test_intervals_cover_the_true_values_if_errors_are_correlated() -> None:
    """The errors within a window are correlated, so intervals for independent samples would be far too short."""
    inside = 0
    for seed in range(400):
        fitted, *_ = line_fit(15, 6, seed)
        result = fitted.uncertainty(np.arange(15))
        half_widths = scipy.stats.t.ppf(0.975, result.degrees_of_freedom) * np.sqrt(np.diag(result.covariance))
        inside += np.sum(np.abs(fitted.values - [1.0, -2.0]) < half_widths)
    assert 0.93 < inside / 800 < 0.99


def test_score_and_information_match_normally_distributed_errors() -> None:
    """Errors e of variance s² have the score Σ (e²/s² - 1) and the information 2 per sample with respect to log s."""
    rng = np.random.default_rng(1)
    errors, deviation, step = rng.normal(0.0, 2.0, size=(50, 1, 3, 1)), 1.5, 1e-4
    spreads = np.full((50, 2, 3, 1, 1), deviation**2)
    spreads[:, 1] *= np.exp(2.0 * step)
    result, score, information = noise_likelihood(np.tile(errors, (1, 2, 1, 1)), spreads, step)
    squares = (errors / deviation) ** 2
    assert result == pytest.approx(-150 * np.log(deviation) - 0.5 * squares.sum())
    assert score[0] == pytest.approx((squares - 1.0).sum(), rel=1e-3)
    assert information[0, 0] == pytest.approx(300.0, rel=1e-3)


@pytest.mark.parametrize(("windows", "parts"), [(7, 9), (30, 2), (60, 1), (90, 1)])
def test_evidence_has_at_least_sixty_parts_because_few_windows_are_split(windows: int, parts: int) -> None:
    """The parts are in the order of time. All outputs of a sample stay in the same part."""
    fitted, _, _ = line_fit(windows, 24, seed=1)
    fitted = fitted._replace(noise=PredictionNoise(np.ones(2), np.ones(6), np.ones(6)))
    result = fitted.evidence(["a", "b"], np.array([1.0, 2.0]), 30.0)
    assert len(result.scores) == windows * parts
    pieces = [
        (rows, errors)
        for window, window_errors in zip(fitted.jacobian, fitted.errors, strict=True)
        for rows, errors in zip(
            np.array_split(window.reshape(12, 2, 2), parts),
            np.array_split(window_errors.reshape(12, 2), parts),
            strict=True,
        )
    ]
    for part, (rows, errors) in enumerate(pieces):
        np.testing.assert_allclose(result.information[part], np.einsum("kmp,kmq->pq", rows, rows))
        np.testing.assert_allclose(result.scores[part], np.einsum("kmp,km->p", rows, errors))
    assert (result.names, result.duration) == (("a", "b"), 30.0)
    np.testing.assert_array_equal(result.values, fitted.values)
    np.testing.assert_array_equal(result.scales, [1.0, 2.0])


class LinearPredictor:
    """Stub of a predictor with a linear model.

    The errors are `measured` minus `rows` times θ. The noise is white, with unit variance.
    """

    class Model:
        delay_index = None

    model = Model()

    def __init__(self, rows: np.ndarray, measured: np.ndarray) -> None:
        self.rows, self.target = rows, measured
        self.windows = range(rows.shape[1])
        self.evaluated = np.full(len(rows), True)

    def gains(self, values: np.ndarray, noise: PredictionNoise) -> Gains:
        whitening = np.ones((*self.target.shape, 1, 1))
        return EMPTY_GAINS._replace(whitening=whitening, noise=noise)

    def errors(self, parameters: np.ndarray, *_: object) -> tuple[np.ndarray, np.ndarray]:
        result = self.target[:, :, None] - self.rows @ parameters.T
        return result.transpose(0, 2, 1)[:, None], np.zeros((1, len(parameters), len(self.windows)))

    def continue_windows(self, *_: object) -> None: ...


def linear_parameters(starts: dict[str, tuple[float, float]]) -> list[Parameter]:
    return [Parameter(name, start, scale) for name, (start, scale) in starts.items()]


def fitted_line(monkeypatch: pytest.MonkeyPatch, rows: np.ndarray, measured: np.ndarray, starts: dict) -> PredictionFit:
    monkeypatch.setattr(fitting, "_noise_of", lambda predictor, gains, chosen=None: gains.noise)
    noise = PredictionNoise(np.ones(1), np.full(6, 1e-3), np.ones(6))
    return fitting.fit(LinearPredictor(rows, measured), linear_parameters(starts), noise)  # type: ignore[arg-type]


def test_the_fit_of_a_linear_model_is_the_posterior_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    rows = rng.normal(size=(30, 4, 2))
    measured = rows @ [2.0, -0.5] + rng.normal(size=(30, 4))
    result = fitted_line(monkeypatch, rows, measured, {"mass": (1.0, 0.1), "linear_drag": (0.2, 0.5)})
    flat, prior = rows.reshape(-1, 2), np.array([100.0, 4.0])
    information = flat.T @ flat + np.diag(prior)
    np.testing.assert_allclose(
        result.values, np.linalg.solve(information, flat.T @ measured.ravel() + prior * [1.0, 0.2]), rtol=1e-4
    )
    np.testing.assert_allclose(result.prior, prior)


@pytest.mark.parametrize("true", [[5.0, -3.0, 1.0], [-1.0, 4.0, 0.5], [1.0, 6.0, -5.0]])
def test_the_fitted_thrust_curve_is_the_best_increasing_curve(
    monkeypatch: pytest.MonkeyPatch, true: list[float]
) -> None:
    """The fit equals non-negative least squares for the thrust at zero throttle and the derivatives at both ends."""
    u = np.random.default_rng(3).uniform(0.0, 1.0, size=(200, 1))
    rows = np.stack([np.ones_like(u), u, u**2], axis=2)
    scale = 1e3  # standard deviation of a prior that hardly matters
    names = {f"motors.curve[{i}]": (start, scale) for i, start in enumerate((0.1, 1.0, 2.0))}
    k_0, k_1, k_2 = fitted_line(monkeypatch, rows, rows @ true, names).values
    basis = np.stack([np.ones_like(u), u - 0.5 * u**2, 0.5 * u**2], axis=2)
    expected, _ = scipy.optimize.nnls(basis.reshape(-1, 3), (rows @ true).ravel())
    np.testing.assert_allclose([k_0, k_1, k_1 + 2.0 * k_2], expected, atol=2e-3)
    assert min(k_0, k_1, k_1 + 2.0 * k_2) > -1e-9


def test_an_identified_inertia_satisfies_the_triangle_inequality(monkeypatch: pytest.MonkeyPatch) -> None:
    """The measured moments violate the inequality; the fit is the nearest inertia that satisfies it."""
    rows = np.tile(np.eye(3), (20, 1, 1))
    measured = np.tile([1.0, 1.0, 3.0], (20, 1))
    names = {f"inertia[{i}]": (start, 1e3) for i, start in enumerate((1.0, 1.0, 1.5))}
    result = fitted_line(monkeypatch, rows, measured, names).values
    # The violation I_z - I_x - I_y = 1 is distributed equally over the three moments. The lower limit of the second
    # moments adds a small error.
    np.testing.assert_allclose(result, [4.0 / 3.0, 4.0 / 3.0, 8.0 / 3.0], atol=0.03)
    assert result[0] + result[1] >= result[2]


def test_a_fit_that_diverges_is_refused_in_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    rows, measured = np.ones((5, 2, 1)), np.ones((5, 2))
    largest = PredictionNoise(np.array([100.0]), np.full(6, 1e-3), np.ones(6))
    monkeypatch.setattr(fitting, "_noise_of", lambda predictor, gains, chosen=None: largest)
    noise = PredictionNoise(np.ones(1), np.full(6, 1e-3), np.ones(6))
    with pytest.raises(InputError, match="^the fit diverged: "):
        fitting.fit(LinearPredictor(rows, measured), linear_parameters({"mass": (1.0, 1.0)}), noise)  # type: ignore[arg-type]


def test_a_step_to_parameters_with_a_diverging_model_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Squared errors overflow for θ > 1.2. The minimum is at 1, and the first Gauss-Newton step goes to 2."""

    class Diverging(LinearPredictor):
        def errors(self, parameters: np.ndarray, *_: object) -> tuple[np.ndarray, np.ndarray]:
            theta = parameters[:, 0]
            error = np.where(theta > 1.2, 1e200 * theta, np.sqrt(np.abs(1.0 - theta)) * np.sign(1.0 - theta))
            shape = (len(self.evaluated), 1, len(theta), len(self.windows))
            result = np.broadcast_to(error[None, None, :, None], shape)
            return result.copy(), np.zeros((1, len(theta), len(self.windows)))

    monkeypatch.setattr(fitting, "_noise_of", lambda predictor, gains, chosen=None: gains.noise)
    noise = PredictionNoise(np.ones(1), np.full(6, 1e-3), np.ones(6))
    parameters = linear_parameters({"mass": (0.0, 1e2)})
    result = fitting.fit(Diverging(np.ones((50, 4, 1)), np.ones((50, 4))), parameters, noise)  # type: ignore[arg-type]
    assert 0.5 < result.values[0] < 1.2


@pytest.mark.parametrize("finite", [True, False], ids=["errors too large", "one slope not finite"])
def test_a_search_that_begins_with_a_diverging_model_does_not_move(finite: bool) -> None:
    start = np.array([0.3, 0.2])

    class Diverging(LinearPredictor):
        def errors(self, parameters: np.ndarray, *_: object) -> tuple[np.ndarray, np.ndarray]:
            result, states = super().errors(parameters)
            if finite:
                return 1e200 * np.sign(result), states
            result[:, :, parameters[:, 1] > start[1]] = np.inf
            return result, states

    random = np.random.default_rng(1)
    predictor = Diverging(random.normal(size=(50, 4, 2)), random.normal(size=(50, 4)))
    parameters = linear_parameters({"mass": (0.5, 10.0), "linear_drag": (0.5, 10.0)})
    result = fitting._best_point(predictor, parameters, start, predictor.gains(start, UNIT_NOISE))  # type: ignore[arg-type]
    np.testing.assert_allclose(result.values, start)


class DriftingPredictor(LinearPredictor):
    """Stub of a predictor of a constant. The measured constant changes at the start of each round of the fit."""

    def __init__(self, changes: list[float]) -> None:
        super().__init__(np.ones((40, 5, 1)), np.zeros((40, 5)))
        self.changes, self.rounds = changes, 0

    def continue_windows(self, *_: object) -> None:
        if self.rounds < len(self.changes):
            self.target = self.target + self.changes[self.rounds]
        self.rounds += 1


@pytest.mark.parametrize(
    ("changes", "rounds"),
    [
        # A fit has at least three and at most eight rounds.
        ([], 3),
        ([1.0] * 20, 8),
        ([-1.0] * 20, 8),
        # The mean of 200 measurements has a standard deviation of 0.071; a fifth of this is 0.014.
        ([1.0, 1.0, 0.02, 0.02, 0.01], 6),
        ([-1.0, -1.0, -0.02, -0.02, -0.01], 6),
        ([-1.0, 0.01], 3),
    ],
)
def test_fitting_rounds_continue_while_an_estimate_changes(
    monkeypatch: pytest.MonkeyPatch, changes: list[float], rounds: int
) -> None:
    """The rounds end when the estimate changes by less than a fifth of its standard deviation."""
    monkeypatch.setattr(fitting, "_noise_of", lambda predictor, gains, chosen=None: gains.noise)
    predictor = DriftingPredictor(changes)
    noise = PredictionNoise(np.ones(1), np.full(6, 1e-3), np.ones(6))
    result = fitting.fit(predictor, linear_parameters({"mass": (0.0, 100.0)}), noise)  # type: ignore[arg-type]
    assert predictor.rounds == rounds
    assert result.values[0] == pytest.approx(sum(changes[: rounds - 1]), abs=1e-3)


@pytest.mark.parametrize(
    ("factors", "rounds"),
    [([0.9, 0.9, 0.9], 3), ([1.5, 1.5, 1.5, 1.5, 1.1], 5), ([0.5, 0.5, 0.7, 0.7, 0.9], 5), ([2.0] * 20, 8)],
)
def test_fitting_rounds_continue_while_a_disturbance_changes(
    monkeypatch: pytest.MonkeyPatch, factors: list[float], rounds: int
) -> None:
    """The rounds end when the logarithm of the disturbance changes by less than 0.2.

    All other axes of the disturbance do not change.
    """
    predictor = DriftingPredictor([])

    def noise_of(predictor: DriftingPredictor, gains: Gains, chosen: object = None) -> object:
        if chosen is not None:
            return gains.noise
        changed = gains.noise.disturbance.copy()
        changed[4] *= factors[min(predictor.rounds, len(factors) - 1)]
        return gains.noise._replace(disturbance=changed)

    monkeypatch.setattr(fitting, "_noise_of", noise_of)
    # The disturbance is already at its lower limit, so no smaller one is tried.
    monkeypatch.setattr(fitting, "_with_smaller_disturbance", lambda predictor, parameters, point, factors: point)
    noise = PredictionNoise(np.ones(1), np.ones(6), np.ones(6))
    result = fitting.fit(predictor, linear_parameters({"mass": (0.0, 100.0)}), noise)  # type: ignore[arg-type]
    assert predictor.rounds == rounds
    assert result.noise.disturbance[4] == pytest.approx(
        np.prod([factors[min(i, len(factors) - 1)] for i in range(rounds)])
    )


class WhiteningPredictor(LinearPredictor):
    """Predictor of a constant. The standard deviation of its errors is a function of the disturbing torque."""

    def __init__(self, mean: float, deviation: Callable[[float], float]) -> None:
        super().__init__(np.ones((40, 5, 1)), np.full((40, 5), mean))
        self.deviation = deviation
        self.filters: list[tuple[float, float]] = []

    def gains(self, values: np.ndarray, noise: PredictionNoise) -> Gains:
        self.filters.append((float(values[0]), float(noise.disturbance[3])))
        errors, _ = self.errors(values[None])
        whitening = np.full((*self.target.shape, 1, 1), 1.0 / self.deviation(noise.disturbance[3]))
        return EMPTY_GAINS._replace(whitening=whitening, errors=errors[:, :, 0], noise=noise)


def noise_with(torque: float) -> PredictionNoise:
    return PredictionNoise(np.ones(1), np.array([0.5, 0.5, 0.5, torque, torque, torque]), np.ones(6))


def point_at(
    predictor: LinearPredictor, parameters: list[Parameter], noise: PredictionNoise, **options: float
) -> fitting._Point:
    """Return the best parameters for a noise, from a search that starts at zero."""
    start = np.zeros(1)
    return fitting._best_point(predictor, parameters, start, predictor.gains(start, noise), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize(("best", "expected"), [(8.0, 8.0), (0.3, 8.0 * 0.2**2), (1e-9, 1e-3)])
def test_a_disturbance_is_divided_by_five_as_long_as_the_likelihood_rises(best: float, expected: float) -> None:
    """The disturbance is not reduced below its lower limit, and axes with the factor 1 keep their values."""
    predictor = WhiteningPredictor(0.0, lambda torque: np.exp(np.log(torque / best) ** 2))
    parameters = linear_parameters({"mass": (0.0, 1.0)})
    start = point_at(predictor, parameters, noise_with(8.0))
    actual = fitting._with_smaller_disturbance(predictor, parameters, start, (1.0, 1.0, 1.0, 0.2, 0.2, 0.2))  # type: ignore[arg-type]
    np.testing.assert_allclose(actual.noise.disturbance, [0.5] * 3 + [expected] * 3)
    assert (actual is start) == (best == 8.0)
    # The filter gains for the returned noise are computed only once.
    assert sum(torque == pytest.approx(expected) for _, torque in predictor.filters) == 1
    # The returned likelihood and gains were computed with the returned noise.
    deviation = predictor.deviation(expected)
    assert actual.likelihood == pytest.approx(-200.0 * np.log(deviation))
    np.testing.assert_allclose(actual.gains.whitening, 1.0 / deviation)


def test_parameters_are_not_refitted_if_the_disturbance_is_at_its_lower_limit() -> None:
    predictor = WhiteningPredictor(1.0, lambda torque: 1.0)
    parameters = linear_parameters({"mass": (0.0, 100.0)})
    noise = PredictionNoise(np.ones(1), np.array([0.5, 0.5, 0.5, 1e-3, 1e-3, 1e-3]), np.ones(6))
    start = point_at(predictor, parameters, noise)
    searches = len(predictor.filters)
    result = fitting._with_smaller_disturbance(predictor, parameters, start, (1.0, 1.0, 1.0, 0.2, 0.2, 0.2))  # type: ignore[arg-type]
    assert result is start
    assert len(predictor.filters) == searches


@pytest.mark.parametrize("scattered", [False, True])
def test_a_smaller_disturbance_may_become_likelier_only_after_a_refit(scattered: bool) -> None:
    """Without a refit of the parameters, the initial disturbance has the largest likelihood.

    After a refit, a fifth of this disturbance has a larger likelihood, unless the data scatter.
    """
    predictor = WhiteningPredictor(1.0, lambda torque: torque)
    parameters = linear_parameters({"mass": (0.0, 100.0)})
    start = point_at(predictor, parameters, noise_with(1.0))
    if scattered:
        predictor.target = 1.0 + np.tile([1.0, -1.0], 100).reshape(40, 5)
    start = start._replace(values=np.zeros(1), likelihood=-100.0)
    result = fitting._with_smaller_disturbance(predictor, parameters, start, (1.0, 1.0, 1.0, 0.2, 0.2, 0.2))  # type: ignore[arg-type]
    if scattered:
        assert result is start
    else:
        assert result.noise.disturbance[3] == 0.2
        assert result.values[0] == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(("ratio", "fits"), [(2.9, True), (3.1, False)])
def test_a_smaller_disturbance_is_fitted_only_if_the_search_may_reach_the_required_likelihood(
    ratio: float, fits: bool
) -> None:
    """The derivatives predict that a search increases the log-likelihood by 100. It may gain up to three times that."""
    predictor = WhiteningPredictor(1.0, lambda torque: 1.0)
    predictor.target = 1.0 + np.tile([0.3, -0.3], 100).reshape(40, 5)  # scatter that no parameter explains
    parameters, noise = linear_parameters({"mass": (0.0, 100.0)}), noise_with(1.0)
    needed = -109.0 + 100.0 * ratio
    result = point_at(predictor, parameters, noise, min_likelihood=needed)
    assert result.values[0] == pytest.approx(1.0 if fits else 0.0, abs=1e-3)
    assert result.likelihood == pytest.approx(-9.0 if fits else -109.0, abs=1e-3)


def test_a_search_evaluates_the_parameters_that_it_returns_only_once() -> None:
    """The result contains predictions that the search has computed, even if the search rejects its last step."""
    points: list[bytes] = []

    class Kinked(LinearPredictor):
        def errors(self, parameters: np.ndarray, *_: object) -> tuple[np.ndarray, np.ndarray]:
            points.append(parameters[0].tobytes())
            # The prediction errors grow steeply if the parameter exceeds 0.9, so the search rejects steps to 1.
            theta = np.where(parameters > 0.9, 0.9 + 30.0 * (parameters - 0.9), parameters)
            return super().errors(theta)

    predictor = Kinked(np.ones((40, 5, 1)), np.ones((40, 5)))
    parameters = linear_parameters({"mass": (0.0, 100.0)})
    result = point_at(predictor, parameters, UNIT_NOISE)
    assert points.count(result.values.tobytes()) == 1
    assert points[-1] != result.values.tobytes()
    errors, _ = predictor.errors(np.array([result.values]))
    np.testing.assert_allclose(result.errors, errors[:, 0, 0].T)


@pytest.mark.parametrize(("mean", "starts_again"), [(1.9, False), (2.1, True), (-1.9, False), (-2.1, True)])
@pytest.mark.parametrize("is_likelier", [True, False])
def test_a_search_that_ends_far_from_the_prior_starts_again_with_a_smaller_disturbance(
    monkeypatch: pytest.MonkeyPatch, mean: float, starts_again: bool, is_likelier: bool
) -> None:
    """A result is far from the prior if it is more than two prior standard deviations away from the prior mean.

    The search then starts again at the prior mean, and the fit with the larger likelihood is returned.
    """
    monkeypatch.setattr(fitting, "_noise_of", lambda predictor, gains, chosen=None: gains.noise)
    monkeypatch.setattr(fitting, "_with_smaller_disturbance", lambda predictor, parameters, point, factors: point)
    deviation = 0.01
    deviation_after_restart = deviation * (0.5 if is_likelier else 2.0)
    predictor = WhiteningPredictor(mean, lambda torque: deviation_after_restart if torque < 1.0 else deviation)
    result = fitting.fit(predictor, linear_parameters({"mass": (0.0, 1.0)}), noise_with(4.0))  # type: ignore[arg-type]
    assert result.values[0] == pytest.approx(mean, abs=1e-3)
    repeated = [(value, torque) for value, torque in predictor.filters if torque < 1.0]
    assert bool(repeated) == starts_again
    if starts_again:
        assert repeated[0] == (0.0, pytest.approx(0.05 * 4.0))
    assert result.noise.disturbance[3] == pytest.approx(0.2 if starts_again and is_likelier else 4.0)


@pytest.mark.parametrize("kind", ["force", "torque"])
def test_disturbing_forces_are_reduced_without_the_torques_and_vice_versa(
    monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    """The likelihood depends either on the forces or on the torques, and only these are reduced."""
    monkeypatch.setattr(fitting, "_noise_of", lambda predictor, gains, chosen=None: gains.noise)
    predictor, axes = WhiteningPredictor(0.0, lambda _: 1.0), slice(0, 3) if kind == "force" else slice(3, 6)
    filters = predictor.gains

    def gains(values: np.ndarray, noise: PredictionNoise) -> Gains:
        # The likelihood is largest for a disturbance of 0.04, for which the errors have the smallest standard
        # deviation.
        deviation = np.exp(np.sum(np.log(noise.disturbance[axes] / 0.04) ** 2))
        return filters(values, noise)._replace(whitening=np.full((40, 5, 1, 1), 1.0 / deviation))

    predictor.gains = gains  # type: ignore[method-assign]
    noise = PredictionNoise(np.ones(1), np.ones(6), np.ones(6))
    actual = fitting.fit(predictor, linear_parameters({"mass": (0.0, 1.0)}), noise).noise.disturbance  # type: ignore[arg-type]
    expected = np.ones(6)
    expected[axes] = 0.2**2
    np.testing.assert_allclose(actual, expected)


class QuadraticLikelihood:
    """Log-likelihood that is quadratic in the logarithms of the noise parameters. It records its calls.

    Args:
        best: (14,) logarithms of the noise parameters at the maximum, for two outputs and the disturbance.
        fraction: ratio of the returned information to the true one.

    Attributes:
        evaluated: logarithms for which the likelihood was evaluated, in order.
        differentiated: logarithms for which the derivatives were evaluated as well.
    """

    def __init__(self, best: np.ndarray, fraction: float = 1.0) -> None:
        self.best, self.fraction = best, fraction
        self.evaluated: list[np.ndarray] = []
        self.differentiated: list[np.ndarray] = []
        self.chosen = self.free = np.empty(0, dtype=int)

    def __call__(
        self, predictor: object, gains: object, logs: np.ndarray, chosen: np.ndarray, free: np.ndarray
    ) -> tuple[float, np.ndarray, np.ndarray]:
        if not any(logs is other for other in self.evaluated):
            self.evaluated.append(logs)
        if len(free):
            self.chosen, self.free = chosen, free
            self.differentiated.append(logs)
        missing = (self.best - logs)[self.free]
        return float(-50.0 * missing @ missing), 100.0 * missing[: len(free)], self.fraction * 100.0 * np.eye(len(free))


# The correlation time of the force along the thrust axis is short, since it is limited to 0.25 s.
INITIAL_NOISE = PredictionNoise(
    np.array([1e-2, 3e-2]), np.linspace(0.5, 1.0, 6), np.array([0.5, 0.6, 0.1, 0.8, 0.9, 1.0])
)
INITIAL_LOG_NOISE = np.log(np.concatenate(INITIAL_NOISE))


def noise_found(
    monkeypatch: pytest.MonkeyPatch,
    likelihood: QuadraticLikelihood,
    start: PredictionNoise = INITIAL_NOISE,
    *,
    frame: str = "world",
    windows: int = 3,
    rows: int = 10,
) -> np.ndarray:
    """Return the logarithms (14,) of the noise found by the search."""
    monkeypatch.setattr(fitting, "_likelihood_of", likelihood)
    predictor = SimpleNamespace(
        noise_groups=np.arange(14),
        evaluated=np.arange(rows + 5) >= 5,
        windows=range(windows),
        model=SimpleNamespace(frame=frame),
    )
    return np.log(np.concatenate(fitting._noise_of(predictor, EMPTY_GAINS._replace(noise=start))))  # type: ignore[arg-type]


def test_the_maximum_likelihood_noise_is_found_in_three_evaluations_if_the_likelihood_is_quadratic(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The search ends when the log-likelihood increases by less than 0.1."""
    best = INITIAL_LOG_NOISE + np.linspace(-0.7, 0.9, 14)
    likelihood = QuadraticLikelihood(best)
    np.testing.assert_allclose(noise_found(monkeypatch, likelihood), best, atol=1e-4)
    assert (len(likelihood.evaluated), len(likelihood.differentiated)) == (3, 2)
    # A search that begins at the maximum stays there.
    np.testing.assert_allclose(noise_found(monkeypatch, QuadraticLikelihood(INITIAL_LOG_NOISE)), INITIAL_LOG_NOISE)


def test_a_scoring_step_that_lowers_the_likelihood_is_shortened(monkeypatch: pytest.MonkeyPatch) -> None:
    """A full step is four times too long if the search uses a quarter of the true information."""
    best = INITIAL_LOG_NOISE + np.linspace(-0.7, 0.9, 14)
    likelihood = QuadraticLikelihood(best, fraction=0.25)
    actual = noise_found(monkeypatch, likelihood)
    assert np.all(np.abs(actual - best) < 0.5 * np.abs(INITIAL_LOG_NOISE - best))
    distances = [float(np.linalg.norm(each - best)) for each in likelihood.evaluated]
    assert distances[1] > 2.0 * distances[0]
    assert np.linalg.norm(actual - best) == pytest.approx(min(distances))
    assert len(likelihood.evaluated) == 6
    # Derivatives are computed only where a step begins: at the start, and after each step that increased the
    # likelihood.
    likelier = [i for i in range(6) if distances[i] == min(distances[: i + 1])]
    assert len(likelier) > 1
    expected = [likelihood.evaluated[i] for i in likelier if i < 5]
    np.testing.assert_array_equal(likelihood.differentiated, expected)


@pytest.mark.parametrize("likelihood", [-np.inf, np.nan])
def test_the_noise_is_unchanged_if_the_likelihood_is_not_finite(
    monkeypatch: pytest.MonkeyPatch, likelihood: float
) -> None:
    calls = []

    def not_finite(*arguments: object) -> tuple[float, np.ndarray, np.ndarray]:
        calls.append(arguments)
        return likelihood, np.full(14, np.nan), np.full((14, 14), np.nan)

    np.testing.assert_allclose(noise_found(monkeypatch, not_finite), INITIAL_LOG_NOISE)  # type: ignore[arg-type]
    assert len(calls) == 1


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_noise_parameters_change_by_at_most_a_factor_of_twelve_and_stay_inside_their_limits(
    monkeypatch: pytest.MonkeyPatch, direction: float
) -> None:
    """The limits are 1e-5 and 100 (noise), 1e-3 and 1e3 (disturbance), and 0.02 s and 20 s (correlation time).

    The upper limit is 0.25 s for a force along the thrust axis, because a force that lasts longer is an error of the
    thrust curve.
    """
    thrust = 8 + 2
    best = INITIAL_LOG_NOISE + 30.0 * direction
    expected = INITIAL_LOG_NOISE + 2.5 * direction
    expected[thrust] = np.log(0.25 if direction > 0.0 else 0.02)
    np.testing.assert_allclose(noise_found(monkeypatch, QuadraticLikelihood(best)), expected)
    noise = PredictionNoise(np.full(2, 2e-5), np.full(6, 2e-3), np.full(6, 0.04))
    limits = np.repeat([1e-5, 1e-3, 0.02], [2, 6, 6])
    if direction > 0.0:
        noise = PredictionNoise(np.full(2, 60.0), np.full(6, 500.0), np.full(6, 8.0))
        noise.correlation_time[2] = 0.1
        limits = np.repeat([100.0, 1e3, 20.0], [2, 6, 6])
        limits[thrust] = 0.25
    actual = np.exp(noise_found(monkeypatch, QuadraticLikelihood(best), noise))
    np.testing.assert_allclose(actual, limits)
    if direction > 0.0:
        # If disturbances act along the axes of the body, the limit of 0.25 s applies to the forces on all three axes.
        body_noise = PredictionNoise(noise.measured, noise.disturbance, np.full(6, 0.1))
        actual = np.exp(noise_found(monkeypatch, QuadraticLikelihood(best), body_noise, frame="body"))
        np.testing.assert_allclose(actual[8:], [0.25] * 3 + [0.1 * np.exp(2.5)] * 3)


def test_the_correlation_time_of_a_negligible_disturbance_is_not_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    disturbance = np.array([1.0, 1.005e-3, 1.0, 1.02e-3, 1e-3, 1.0])
    start = INITIAL_NOISE._replace(disturbance=disturbance)
    best = np.log(np.concatenate(start)) + 0.4
    likelihood = QuadraticLikelihood(best)
    result = noise_found(monkeypatch, likelihood, start)
    fixed = [8 + 1, 8 + 4]
    np.testing.assert_array_equal(likelihood.free, [i for i in range(14) if i not in fixed])
    np.testing.assert_allclose(np.delete(result, fixed), np.delete(best, fixed), atol=1e-4)
    np.testing.assert_allclose(result[fixed], best[fixed] - 0.4)


@pytest.mark.parametrize(
    ("windows", "rows", "num_windows"), [(1000, 100, 15), (1000, 1000, 5), (12, 100, 12), (3, 2000, 3)]
)
def test_noise_is_estimated_from_about_1500_measurements_over_the_whole_flight(
    monkeypatch: pytest.MonkeyPatch, windows: int, rows: int, num_windows: int
) -> None:
    likelihood = QuadraticLikelihood(INITIAL_LOG_NOISE)
    noise_found(monkeypatch, likelihood, windows=windows, rows=rows)
    assert len(likelihood.chosen) == num_windows
    assert (likelihood.chosen[0], likelihood.chosen[-1]) == (0, windows - 1)
    assert np.ptp(np.diff(likelihood.chosen)) <= 1


@pytest.mark.parametrize("delay", [None, 0, 2])
def test_derivatives_are_forward_differences_but_central_differences_for_a_delay(delay: int | None) -> None:
    """Forward differences of a quadratic function err by the step, and central differences are exact."""
    up = np.array([1e-3, 2e-3, 5e-3])
    point = np.array([2.0, -1.0, 0.5])
    sizes = np.random.default_rng(1).normal(size=(4, 5, 3))

    def squares(x: np.ndarray) -> np.ndarray:
        return sizes @ (x**2)

    moved = [point + step for step in np.diag(up)]
    reduced = point.copy()
    if delay is not None:
        reduced[delay] -= up[delay]
    values = np.stack([squares(each) for each in (point, *moved, reduced)], axis=2)
    expected = sizes * (2.0 * point + up)
    if delay is not None:
        expected[:, :, delay] -= sizes[:, :, delay] * up[delay]
    np.testing.assert_allclose(fitting._jacobian(values, up, delay), expected, rtol=1e-6, atol=1e-9)


class DelayedPredictor:
    """Predictor of two outputs, with errors and states that have a kink at a delay of one sample."""

    period, number = 0.01, 3

    def __init__(self) -> None:
        self.model = SimpleNamespace(delay_index=1)
        self.inputs = SimpleNamespace(period=self.period)
        self.evaluated = np.array([False, True, True])
        random = np.random.default_rng(7)
        self.outputs, self.states = random.normal(size=(3, 2, 4)), random.normal(size=(5, 4))
        self.gains = EMPTY_GAINS._replace(whitening=np.tile(np.diag([2.0, 10.0]), (3, 4, 1, 1)))

    def errors(self, parameters: np.ndarray, *_: object) -> tuple[np.ndarray, np.ndarray]:
        mass, delay = parameters.T
        size = 3.0 * mass + np.abs(delay - self.period) + 5.0 * (delay - self.period)
        return np.einsum("tmw,k->tmkw", self.outputs, size), np.einsum("rw,k->rkw", self.states, size)


def test_predictions_contain_derivatives_of_whitened_errors_and_states() -> None:
    """The outputs have a kink at a delay of one sample, with the one-sided derivatives 4 and 6.

    The central difference is 5.
    """
    predictor = DelayedPredictor()
    parameters = np.array([0.7, predictor.period])
    point = fitting._Point.at(predictor, np.array([0.7, 0.02]), parameters, predictor.gains)  # type: ignore[arg-type]
    white = np.einsum("m,tmw->wtm", [2.0, 10.0], predictor.outputs[1:]).reshape(4, 4)
    np.testing.assert_allclose(point.errors, 2.1 * white)
    np.testing.assert_allclose(point.jacobian, white[:, :, None] * [3.0, 5.0], rtol=1e-6)
    np.testing.assert_allclose(point.states, 2.1 * predictor.states)
    np.testing.assert_allclose(point.state_jacobian, predictor.states[:, None, :] * np.array([[3.0], [5.0]]), rtol=1e-6)
    # For delays longer than one sample, both one-sided derivatives are equal.
    longer_delay = parameters + np.array([0.0, 0.0051])
    point = fitting._Point.at(predictor, np.array([0.7, 0.02]), longer_delay, predictor.gains)  # type: ignore[arg-type]
    np.testing.assert_allclose(point.jacobian, white[:, :, None] * [3.0, 6.0], rtol=1e-6)


@pytest.mark.parametrize(
    ("value", "noise", "disturbance", "diverged"),
    [
        (1.0, 98.9, 989.0, False),
        (1.0, 99.1, 1.0, True),
        (1.0, 1.0, 991.0, True),
        (np.nan, 1.0, 1.0, True),
        (np.inf, 1.0, 1.0, True),
        (1.0, np.nan, 1.0, True),
    ],
)
def test_a_fit_has_diverged_if_a_value_is_not_finite_or_the_noise_is_near_its_limit(
    value: float, noise: float, disturbance: float, diverged: bool
) -> None:
    result = PredictionNoise(np.array([1.0, noise]), np.array([1.0] * 5 + [disturbance]), np.ones(6))
    values = np.array([0.5, value])
    if diverged:
        with pytest.raises(InputError, match="^the fit diverged: "):
            fitting._check_convergence(values, result)
    else:
        fitting._check_convergence(values, result)


def test_the_likelihood_counts_measurements_after_the_filter_has_settled() -> None:
    """The log-likelihood of independent errors e with standard deviation s is -Σ log s - ½ Σ (e / s)²."""
    deviations = np.array([0.5, 2.0])
    whitening = np.tile(np.diag(1.0 / deviations), (5, 3, 1, 1))
    whitening[:2] *= 100.0
    evaluated = np.arange(5) >= 2
    errors = np.random.default_rng(2).normal(size=(3, 3, 2))
    result = fitting._likelihood(
        SimpleNamespace(evaluated=evaluated), EMPTY_GAINS._replace(whitening=whitening), errors / deviations  # type: ignore[arg-type]
    )  # fmt: skip
    normal = scipy.stats.norm(scale=deviations)
    constant = 0.5 * np.log(2.0 * np.pi) * errors.size
    assert result == pytest.approx(normal.logpdf(errors).sum() + constant)


def test_the_variance_of_an_estimated_noise_parameter_is_the_inverse_of_its_information(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The information of all windows is added.

    Values of the same group have the same variance, and a value without information has a large variance.
    """
    groups = np.array([0, 0, 1, *([2] * 6), *([3] * 6)])
    information = np.diag([50.0, 200.0, 8.0, 0.0])
    information[0, 1] = information[1, 0] = 30.0
    calls = []

    def likelihood_of(predictor: object, gains: object, logs: np.ndarray, *given: np.ndarray) -> object:
        calls.append((logs, *given))
        return 0.0, np.zeros(4), information

    monkeypatch.setattr(fitting, "_likelihood_of", likelihood_of)
    predictor = SimpleNamespace(noise_groups=groups, windows=range(7))
    noise = PredictionNoise(np.array([1e-3, 1e-3, 0.5]), np.full(6, 2.0), np.full(6, 0.3))
    actual = fitting.noise_covariance(predictor, SimpleNamespace(noise=noise, gains=EMPTY_GAINS))  # type: ignore[arg-type]
    ((logs, windows, free),) = calls
    np.testing.assert_allclose(logs, np.log([1e-3, 0.5, 2.0, 0.3]))
    np.testing.assert_array_equal(windows, np.arange(7))
    np.testing.assert_array_equal(free, np.arange(4))
    expected = np.linalg.inv(information[:2, :2])
    np.testing.assert_allclose(actual[np.ix_([0, 2], [0, 2])], expected, rtol=1e-3)
    assert actual[0, 1] == actual[0, 0] == actual[1, 1]
    assert actual[3, 3] == pytest.approx(1.0 / 8.0, rel=1e-3)
    assert actual[-1, -1] >= 999.0


def test_the_disturbance_is_reduced_again_as_long_as_the_likelihood_increases(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two trials with smaller torques increase the likelihood, and no trial with smaller forces does.

    Smaller torques and forces are tried again in the fourth of eight rounds.
    """
    monkeypatch.setattr(fitting, "_noise_of", lambda predictor, gains, chosen=None: gains.noise)
    tried: list[tuple[float, ...]] = []

    def smaller(predictor: object, parameters: object, point: object, factors: tuple[float, ...]) -> object:
        tried.append(factors)
        improves = factors == fitting._TORQUE_REDUCTION and tried.count(factors) <= 2
        return point._replace(likelihood=point.likelihood + 1.0) if improves else point  # type: ignore[attr-defined]

    monkeypatch.setattr(fitting, "_with_smaller_disturbance", smaller)
    predictor = DriftingPredictor([1.0] * 20)
    noise = PredictionNoise(np.ones(1), np.ones(6), np.ones(6))
    fitting.fit(predictor, linear_parameters({"mass": (0.0, 100.0)}), noise)  # type: ignore[arg-type]
    assert predictor.rounds == 8
    torque, force = fitting._TORQUE_REDUCTION, fitting._FORCE_REDUCTION
    assert tried == [torque, force, torque, torque, torque, force]
