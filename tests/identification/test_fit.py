"""Covariances, degrees of freedom and noise, against closed forms and against leaving blocks out by hand."""

from types import SimpleNamespace

import numpy as np
import pytest
import scipy

from drake_quad.identification.fitting import prediction_error
from drake_quad.identification.evidence import jackknife, of_blocks
from drake_quad.identification.fitting.prediction_error import ParameterChoice, PredictionFit, scored
from drake_quad.identification.prediction_errors import Gains, PredictionNoise

NOTHING = Gains(*(np.empty(0) for _ in Gains._fields))
NO_NOISE = PredictionNoise(np.ones(1), np.ones(6), np.ones(6))


def line_fit(windows: int, samples: int, seed: int) -> tuple[PredictionFit, np.ndarray, np.ndarray]:
    """A least-squares fit of two parameters to windows of samples; its rows and values."""
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(windows, samples, 2)) * rng.uniform(0.5, 2.0, size=(windows, 1, 1))
    values = rows @ [1.0, -2.0] + rng.normal(size=(windows, 1)) + 0.3 * rng.normal(size=(windows, samples))
    found = np.linalg.lstsq(rows.reshape(-1, 2), values.ravel(), rcond=None)[0]
    # An error is measured minus predicted.
    return PredictionFit(found, NO_NOISE, NOTHING, -rows, values - rows @ found, 1), rows, values


def test_covariance_is_the_jackknife_over_blocks() -> None:
    """For a linear model one step of Gauss and Newton is exact: each block is left out by hand."""
    fitted, rows, values = line_fit(12, 7, seed=0)
    blocks = np.arange(12) // 3
    moves = []
    for b in range(4):
        kept = blocks != b
        found = np.linalg.lstsq(rows[kept].reshape(-1, 2), values[kept].ravel(), rcond=None)[0]
        moves.append(found - fitted.parameters)
    expected = 3 / 4 * np.array(moves).T @ np.array(moves)
    told = of_blocks(np.einsum("wkp,wkq->wpq", fitted.slopes, fitted.slopes), blocks)
    scores = of_blocks(np.einsum("wkp,wk->wp", fitted.slopes, fitted.errors), blocks)
    np.testing.assert_allclose(jackknife(told, scores).covariance, expected, rtol=1e-9)
    first, then = np.array(moves)[:-1], np.array(moves)[1:]
    expected += 3 / 4 * 0.5 * (first.T @ then + then.T @ first)
    np.testing.assert_allclose(fitted.covariance(blocks).covariance, expected, rtol=1e-9)


def test_what_a_window_gives_back_to_the_one_before_makes_intervals_shorter() -> None:
    """Of a mean, with errors n_k - 0.8 n_(k-1): its true deviation is a fifth of that of independent windows."""
    said, off = {}, []
    for seed in range(300):
        noise = np.random.default_rng(seed).normal(size=41)
        errors = (noise[1:] - 0.8 * noise[:-1])[:, None, None]
        off.append(errors.mean())
        information, scores = np.ones((40, 1, 1)), -(errors - errors.mean())[:, 0]
        for adjoining in (True, False):
            found = jackknife(information, scores, adjoining=adjoining)
            said.setdefault(adjoining, []).append(float(found.covariance[0, 0]))
    variance = float(np.mean(np.square(off)))
    assert np.mean(said[False]) > 20.0 * variance
    assert np.mean(said[True]) < 0.55 * np.mean(said[False])


def test_degrees_of_freedom_are_those_of_the_blocks_that_tell() -> None:
    """Of ten blocks alike nine; if only two of them tell a parameter, one."""
    slopes = np.zeros((10, 5, 2))
    slopes[:, :3, 0] = 1.0
    slopes[:2, 3:, 1] = 1.0
    fitted = PredictionFit(np.zeros(2), NO_NOISE, NOTHING, slopes, np.zeros((10, 5)), 1)
    found = fitted.covariance(np.arange(10)).degrees_of_freedom
    np.testing.assert_allclose(found, [9.0, 1.0])


@pytest.mark.slow
def test_intervals_of_correlated_errors_cover() -> None:
    """Errors that are shared by a window make intervals of independent samples far too short; these cover."""
    inside = 0
    for seed in range(400):
        fitted, *_ = line_fit(15, 6, seed)
        found = fitted.covariance(np.arange(15))
        reach = scipy.stats.t.ppf(0.975, found.degrees_of_freedom) * np.sqrt(np.diag(found.covariance))
        inside += np.sum(np.abs(fitted.parameters - [1.0, -2.0]) < reach)
    assert 0.93 < inside / 800 < 0.99


def test_score_and_information_are_those_of_normal_errors() -> None:
    """For e of variance s², by log s: score Σ e²/s² - 1, information 2 a sample."""
    rng = np.random.default_rng(1)
    errors, deviation, step = rng.normal(0.0, 2.0, size=(50, 1, 3, 1)), 1.5, 1e-4
    spreads = np.full((50, 2, 3, 1, 1), deviation**2)
    spreads[:, 1] *= np.exp(2.0 * step)
    found, score, information = scored(np.tile(errors, (1, 2, 1, 1)), spreads, step)
    squares = (errors / deviation) ** 2
    assert found == pytest.approx(-150 * np.log(deviation) - 0.5 * squares.sum())
    assert score[0] == pytest.approx((squares - 1.0).sum(), rel=1e-3)
    assert information[0, 0] == pytest.approx(300.0, rel=1e-3)


@pytest.mark.parametrize(("windows", "parts"), [(7, 9), (30, 2), (60, 1), (90, 1)])
def test_few_windows_are_taken_apart_into_sixty_parts_in_the_order_of_flight(windows: int, parts: int) -> None:
    """Samples of several outputs stay together, and all parts together say what the windows say."""
    fitted, _, _ = line_fit(windows, 24, seed=1)
    fitted = fitted._replace(noise=PredictionNoise(np.ones(2), np.ones(6), np.ones(6)))
    found = fitted.evidence(["a", "b"], np.array([1.0, 2.0]), 30.0)
    assert len(found.scores) == windows * parts
    pieces = [
        (rows, errors)
        for window, own in zip(fitted.slopes, fitted.errors, strict=True)
        for rows, errors in zip(
            np.array_split(window.reshape(12, 2, 2), parts), np.array_split(own.reshape(12, 2), parts), strict=True
        )
    ]
    for part, (rows, errors) in enumerate(pieces):
        np.testing.assert_allclose(found.information[part], np.einsum("kmp,kmq->pq", rows, rows))
        np.testing.assert_allclose(found.scores[part], np.einsum("kmp,km->p", rows, errors))
    assert (found.names, found.seconds) == (("a", "b"), 30.0)
    np.testing.assert_array_equal(found.values, fitted.parameters)
    np.testing.assert_array_equal(found.scales, [1.0, 2.0])


@pytest.mark.parametrize(
    ("moves", "rounds"),
    [
        ([9.0, 0.05], 3),
        ([9.0, 1.0, 0.5, 0.05], 4),
        ([9.0, 1.0, -1.0, -0.5, 0.05], 5),
        ([1.0] * 9, 6),
    ],
)
def test_rounds_end_when_no_parameter_moves_by_more_than_a_small_part_of_its_deviation(
    monkeypatch: pytest.MonkeyPatch, moves: list[float], rounds: int
) -> None:
    """The noise of the third round is the first that is estimated at parameters that go with it."""
    deviation, steps = 0.1, iter([*moves, *[0.0] * 9])

    def least_squares(predictor: object, choice: object, parameters: np.ndarray, *_: object) -> np.ndarray:
        return parameters + deviation * next(steps) * np.array([0.0, 1.0])

    slopes = np.eye(2)[None] / deviation
    monkeypatch.setattr(prediction_error, "_least_squares", least_squares)
    monkeypatch.setattr(prediction_error, "whitened", lambda *_: (np.zeros((1, 2)), slopes, None, None))
    monkeypatch.setattr(prediction_error, "_noise_of", lambda predictor, gains, noise: noise)
    predictor = SimpleNamespace(gains=lambda *_: NOTHING, hand_on=lambda *_: None)
    choice = ParameterChoice(np.zeros(2), np.ones(2), np.full(2, -9.0), np.full(2, 9.0))
    found = prediction_error.fit(predictor, choice, NO_NOISE)  # type: ignore[arg-type]
    assert found.rounds == rounds
    np.testing.assert_allclose(found.parameters, [0.0, deviation * sum(moves[:rounds])], atol=1e-12)
