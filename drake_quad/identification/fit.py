"""Parameters by the smallest errors of prediction, the noise by its likelihood, and honest intervals.

With L_t the Cholesky factor of the covariance that the filter expects of its errors e_t(θ), and its gains held,

    θ = argmin ½ Σ_t |L_t⁻¹ e_t(θ)|²

by SciPy's trust-region least squares. Then the noise is that of the largest likelihood
Σ_t -log det L_t - ½ |L_t⁻¹ e_t|², the gains are computed anew, and so on until θ rests.

How far θ is off is told by blocks of windows (`drake_quad.identification.evidence`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError
from drake_quad.identification.evidence import Evidence, Uncertainty, jackknife, of_blocks
from drake_quad.identification.parameters import Parameter
from drake_quad.identification.physical_limits import SearchVariables
from drake_quad.identification.prediction_errors import Gains, PredictionNoise, Predictor

# Steps of differences, of a parameter's scale; and of the delay, in samples, over which it is taken to both sides,
# since the slope has a jump at every sample.
_STEP = 1e-5
_DELAY_STEP = 0.5
# Iterations between parameters and noise, at most, and of how many deviations the parameters may still move.
_MAX_ROUNDS = 8
_RESTS = 0.2
_NOISE_RESTS = 0.2  # change of the logarithm of the disturbance
_MAX_EVALUATIONS = 5
# Factors of the disturbance that are tried, since scoring shrinks one that is much too large only slowly.
_QUIETER_TURNING = (1.0, 1.0, 1.0, 0.2, 0.2, 0.2)
_QUIETER_FORCE = (0.2, 0.2, 0.2, 1.0, 1.0, 1.0)
# A parameter that is so many deviations of its prior from the mean may be in a local minimum, in which a large
# disturbance does what the vehicle should. The search then starts again from the mean, with a smaller disturbance.
_MAX_SURPRISE = 4.0
_RESTART_ROUND, _RESTART_DISTURBANCE = 2, 0.05
_DIVERGED = 1e6  # a whitened error that is larger is that of a model that diverges
# Measurements that the noise is estimated from in a round, at most; steps of differences of the logarithms of its
# numbers, how far they may go in a round, and in how many steps, until the likelihood gains no more than so much.
_NOISE_SAMPLES = 1500
_NOISE_STEP = 1e-4
_REACH = 2.5
_SCORINGS = 6
_GAINED = 0.1
_DAMPING = 1e-3
# Limits of its numbers, in their SI units: of what is measured, of disturbances and their memories (s).
MIN_NOISE = 1e-5  # smallest standard deviation of a measurement, SI units
_LEAST = MIN_NOISE, 1e-3, 0.02
_MOST = 100.0, 1e3, 20.0
_AT_LIMIT = 0.99  # share of a limit
_NEGLIGIBLE = 1.01  # times its lower limit, below which a disturbance is negligible
# And of the memory of a force along the axes of B, s. One that lasts longer is an error of the thrust curve. Where it
# could be taken for a disturbance, the level of the curve would be that which suits the rotors' large motions best.
_FORGOTTEN = 0.25
# Parts of windows, at least, that show how much what they say differs.
_PIECES = 60


class PredictionFit(NamedTuple):
    """What came out.

    Attributes:
        values: (p,) estimates of the parameters.
        noise: of measurement and disturbance.
        gains: of the filter.
        slopes: (W, k, p) L⁻¹ ∂e/∂θ, of k whitened errors in each window.
        errors: (W, k) L⁻¹ e.
        rounds: between parameters and noise.
        prior: (p,) information of the prior on each parameter.
    """

    values: np.ndarray
    noise: PredictionNoise
    gains: Gains
    slopes: np.ndarray
    errors: np.ndarray
    rounds: int
    prior: np.ndarray

    def covariance(self, blocks: np.ndarray) -> Uncertainty:
        """Return the uncertainty of the parameters, from (W,) numbers of blocks of windows, counted from 0."""
        information, scores = _information_and_scores(self.slopes, self.errors)
        own = of_blocks(information, blocks), of_blocks(scores, blocks)
        return jackknife(*own, prior=self.prior, adjoining=True)

    def evidence(self, names: Sequence[str], scales: Sequence[float], seconds: float) -> Evidence:
        """What windows say; if they are few, parts of them.

        Args:
            names: (p,) of the parameters.
            scales: (p,) by how much they may well be off.
            seconds: of all windows, s.
        """
        windows, size, count = self.slopes.shape
        measured = len(self.noise.measured)
        parts = np.array_split(np.arange(size).reshape(-1, measured), max(1, -(-_PIECES // windows)))
        told = [_information_and_scores(self.slopes[:, part.ravel()], self.errors[:, part.ravel()]) for part in parts]
        information, scores = (np.stack(each, axis=1) for each in zip(*told, strict=True))
        return Evidence(
            tuple(names),
            self.values,
            np.asarray(scales),
            information.reshape(-1, count, count),
            scores.reshape(-1, count),
            seconds,
        )


def _information_and_scores(slopes: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(W, p, p) information and (W, p) scores of whitened errors."""
    return slopes.swapaxes(1, 2) @ slopes, np.einsum("wkp,wk->wp", slopes, errors)


def fit(
    predictor: Predictor, parameters: Sequence[Parameter], noise: PredictionNoise, start: np.ndarray | None = None
) -> PredictionFit:
    """Fit the parameters and the noise of a predictor.

    Args:
        predictor: predictor of the outputs.
        parameters: p parameters of its model.
        noise: initial noise.
        start: (p,) initial parameters; by default the means of the priors.
    """
    mean = np.array([parameter.start for parameter in parameters])
    values = mean if start is None else start
    prior = np.array([parameter.deviation**-2.0 for parameter in parameters])
    at = _Point.of(predictor, parameters, values, noise)
    quieter = [_QUIETER_TURNING, _QUIETER_FORCE]
    for number in range(1, _MAX_ROUNDS + 1):
        before, disturbance = at.values, at.noise.disturbance
        noise = _noise_of(predictor, predictor.gains(before, at.noise), at.noise)
        at = _Point.of(predictor, parameters, before, noise)
        for factors in list(quieter):
            better = _quieter(predictor, parameters, at, factors)
            if better is at:
                quieter.remove(factors)
            at = better
        if number == _RESTART_ROUND and np.any(np.abs(at.values - mean) > _MAX_SURPRISE / np.sqrt(prior)):
            quiet = at.noise._replace(disturbance=_RESTART_DISTURBANCE * at.noise.disturbance)
            other = _Point.of(predictor, parameters, mean, quiet)
            if other.likelihood > at.likelihood:
                at = other
        predictor.hand_on(at.states, at.moves, at.values, at.gains)
        expected = np.linalg.inv(np.einsum("wkp,wkq->pq", at.slopes, at.slopes) + np.diag(prior))
        rests = np.all(np.abs(at.values - before) < _RESTS * np.sqrt(np.diag(expected)))
        settled = np.max(np.abs(np.log(at.noise.disturbance / disturbance))) < _NOISE_RESTS
        if number > 2 and rests and settled:
            break
    noise = _noise_of(predictor, at.gains, at.noise, np.arange(len(predictor.windows)))
    _check_convergence(at.values, noise)
    return PredictionFit(at.values, noise, at.gains, at.slopes, at.errors, number, prior)


def _quieter(predictor: Predictor, parameters: Sequence[Parameter], at: "_Point", factors: Sequence[float]) -> "_Point":
    """Return the point with the disturbance multiplied by the factors as often as the likelihood grows.

    As long as it grows for the same parameters, these need not be fitted again.
    """

    def quieter(noise: PredictionNoise) -> PredictionNoise:
        return noise._replace(disturbance=np.maximum(noise.disturbance * factors, _LEAST[1]))

    noise, likelihood = at.noise, at.likelihood
    while np.any(quieter(noise).disturbance < noise.disturbance):
        gains = predictor.gains(at.values, quieter(noise))
        white = (gains.whitening @ gains.errors.transpose(0, 2, 1)[..., None])[predictor.counted]
        found = _likelihood(predictor, gains, white)
        if found <= likelihood:
            break
        noise, likelihood = quieter(noise), found
    if noise is not at.noise:
        at = _Point.of(predictor, parameters, at.values, noise)
    if parameters and np.any(quieter(noise).disturbance < noise.disturbance):
        other = _Point.of(predictor, parameters, at.values, quieter(noise))
        at = other if other.likelihood > at.likelihood else at
    return at


def _likelihood(predictor: Predictor, gains: Gains, white: np.ndarray) -> float:
    """Return the logarithm of the likelihood of the measurements, given the whitened errors, up to a constant."""
    factors = np.diagonal(gains.whitening[predictor.counted], axis1=-2, axis2=-1)
    return float(np.log(factors).sum() - 0.5 * np.sum(white**2))


def _check_convergence(values: np.ndarray, noise: PredictionNoise) -> None:
    """Refuse a fit that diverged.

    Raises:
        InputError: if a parameter is not finite, or the model explains the log only with noise or a disturbance at its
            upper limit.
    """
    largest = np.append(noise.measured / _MOST[0], noise.disturbance / _MOST[1])
    if not np.all(np.isfinite(values)) or not np.all(largest < _AT_LIMIT):
        raise InputError(
            "the fit diverged: the vehicle explains the logs only with a disturbance or with noise beyond any limit;"
            " check the units in the mapping and the vehicle to begin with"
        )


class _Point(NamedTuple):
    """Best parameters for a noise, and the predictions with them.

    Attributes:
        values: (p,) parameters.
        noise: noise.
        gains: gains of the filter.
        errors: (W, k) whitened errors.
        slopes: (W, k, p) derivatives of the errors.
        states: states where the next windows begin.
        moves: derivatives of the states.
        likelihood: logarithm of the likelihood of the measurements.
    """

    values: np.ndarray
    noise: PredictionNoise
    gains: Gains
    errors: np.ndarray
    slopes: np.ndarray
    states: np.ndarray
    moves: np.ndarray
    likelihood: float

    @classmethod
    def of(
        cls, predictor: Predictor, parameters: Sequence[Parameter], start: np.ndarray, noise: PredictionNoise
    ) -> "_Point":
        gains = predictor.gains(start, noise)
        values = _least_squares(predictor, parameters, start, gains, noise)
        scales = np.array([parameter.scale for parameter in parameters])
        errors, slopes, states, moves = whitened(predictor, scales, values, gains, noise)
        return cls(values, noise, gains, errors, slopes, states, moves, _likelihood(predictor, gains, errors))


def _least_squares(
    predictor: Predictor, parameters: Sequence[Parameter], start: np.ndarray, gains: Gains, noise: PredictionNoise
) -> np.ndarray:
    if not parameters:
        return start
    mean, scale, deviation = (
        np.array([getattr(parameter, name) for parameter in parameters], dtype=float)
        for name in ("start", "scale", "deviation")
    )
    weights, variables = np.diag(1.0 / deviation), SearchVariables.of(parameters)

    known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return residuals and slopes, which cost hardly more than residuals alone."""
        if x.tobytes() not in known:
            known.clear()
            values = variables.inverse @ x
            errors, slopes, *_ = whitened(predictor, scale, values, gains, noise)
            if np.all(np.abs(errors) < _DIVERGED) and np.all(np.isfinite(slopes)):
                residuals = np.concatenate([errors.ravel(), weights @ (values - mean)])
                own = np.vstack([slopes.reshape(-1, len(x)), weights])
                known[x.tobytes()] = _condensed(residuals, own @ variables.inverse)
            else:
                # The model diverges; the search refuses such a step.
                known[x.tobytes()] = np.full(len(x) + 1, _DIVERGED), np.zeros((len(x) + 1, len(x)))
        return known[x.tobytes()]

    found = scipy.optimize.least_squares(
        lambda x: at(x)[0],
        np.clip(variables.matrix @ start, variables.least, variables.most),
        jac=lambda x: at(x)[1],
        bounds=(variables.least, variables.most),
        x_scale=variables.scale,
        xtol=1e-5,
        ftol=1e-6,
        max_nfev=_MAX_EVALUATIONS,
    )
    return np.asarray(variables.inverse @ found.x)


def _condensed(residuals: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return p + 1 residuals and their slopes with the same squares and products as many residuals.

    A search for the least squares depends on nothing else, and takes a fraction of the time with them.
    """
    # Parameters of unit size: Cholesky's method squares the condition number.
    sizes = np.linalg.norm(slopes, axis=0)
    unit = slopes / sizes
    factor = np.linalg.cholesky(unit.T @ unit).T
    along = scipy.linalg.solve_triangular(factor, unit.T @ residuals, trans="T")
    across = np.sqrt(max(0.0, float(residuals @ residuals - along @ along)))
    return np.append(along, across), np.vstack([factor * sizes, np.zeros(len(factor))])


def _whitened_errors(
    predictor: Predictor, parameters: np.ndarray, gains: Gains, noise: PredictionNoise
) -> tuple[np.ndarray, np.ndarray]:
    """(W, k, K) of what counts, for (K, p) parameters, and the states where the next window begins."""
    counted = predictor.counted
    found, states = predictor.errors(parameters, gains, noise)
    white = (gains.whitening[counted] @ found[counted].transpose(0, 3, 1, 2)).swapaxes(0, 1)
    return white.reshape(len(white), -1, len(parameters)), states


def whitened(
    predictor: Predictor, scales: np.ndarray, parameters: np.ndarray, gains: Gains, noise: PredictionNoise
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(W, k) whitened errors and their (W, k, p) derivatives; the states where the next window begins and theirs."""
    delay, up = predictor.model.delay_place, _STEP * scales
    down = np.zeros(len(parameters))
    if delay is not None:
        up[delay] = down[delay] = _DELAY_STEP * predictor.inputs.period
    points = np.vstack([parameters, parameters + np.diag(up), (parameters - down)])
    errors, states = _whitened_errors(predictor, points, gains, noise)
    return (
        errors[:, :, 0],
        _slopes(errors, up, delay),
        states[:, 0],
        _slopes(states.swapaxes(1, 2), up, delay).swapaxes(1, 2),
    )


def _slopes(values: np.ndarray, up: np.ndarray, delay: int | None) -> np.ndarray:
    """(a, b, p) derivatives of (a, b, 1 + p + 1) values: at a point, with each parameter more, and with less delay."""
    found = (values[:, :, 1:-1] - values[:, :, :1]) / up
    if delay is not None:
        found[:, :, delay] = (values[:, :, 1 + delay] - values[:, :, -1]) / (2.0 * up[delay])
    return np.asarray(found)


def _noise_of(
    predictor: Predictor, gains: Gains, noise: PredictionNoise, chosen: np.ndarray | None = None
) -> PredictionNoise:
    """The noise of the largest likelihood, by Fisher's scoring of the logarithms of its numbers.

    With ∂e, ∂S the derivatives of errors and of their covariance, whitened, the score is
    Σ ½ eᵀ ∂S e - ½ tr ∂S - eᵀ ∂e, and the information Σ ½ tr ∂S ∂S + ∂eᵀ ∂e.
    """
    alike = predictor.alike
    _, first = np.unique(alike, return_index=True)
    rows = int(np.sum(predictor.counted))
    windows, m = len(predictor.windows), len(noise.measured)
    if chosen is None:
        chosen = np.linspace(0, windows - 1, min(windows, max(5, _NOISE_SAMPLES // rows))).astype(int)
    logs = start = np.log(np.concatenate(noise))[first]
    lower = np.maximum(np.log(np.repeat(_LEAST, [m, 6, 6]))[first], start - _REACH)
    most = np.repeat(_MOST, [m, 6, 6])
    if predictor.model.frame == "body":
        most[m + 6 : m + 9] = _FORGOTTEN
    upper = np.minimum(np.log(most)[first], start + _REACH)
    # The memory of a disturbance that is next to nothing has no influence.
    gone = (first >= m + 6) & (np.concatenate(noise)[first - 6] < _NEGLIGIBLE * _LEAST[1])
    free = np.flatnonzero(~gone)
    best, damping = -np.inf, _DAMPING
    score, information = np.zeros(len(free)), np.eye(len(free))
    trial = logs
    for _ in range(_SCORINGS):
        found, *slopes = _noise_slopes(predictor, gains, noise, trial, chosen, free)
        gained, best_before = found - best, best
        if gained > 0.0:
            logs, best, damping = trial, found, 0.2 * damping
            score, information = slopes
        else:
            damping *= 10.0
        step = np.linalg.solve(information + damping * np.diag(np.diag(information) + 1.0), score)
        trial = logs.copy()
        trial[free] = np.clip(logs[free] + step, lower[free], upper[free])
        if 0.0 < gained < _GAINED and np.isfinite(best_before):
            break
    return PredictionNoise.of(np.exp(logs)[alike])


def noise_covariance(predictor: Predictor, fitted: PredictionFit) -> np.ndarray:
    """(m + 12, m + 12) covariance of the errors of the noise's numbers, over their product: of their logarithms.

    It is the inverse of the information, if the model is right; what the log does not tell has a large one.
    """
    alike = predictor.alike
    _, first = np.unique(alike, return_index=True)
    logs, windows = np.log(np.concatenate(fitted.noise))[first], np.arange(len(predictor.windows))
    all_numbers = np.arange(len(logs))
    _, _, information = _noise_slopes(predictor, fitted.gains, fitted.noise, logs, windows, all_numbers)
    return np.asarray(np.linalg.inv(information + _DAMPING * np.eye(len(logs)))[np.ix_(alike, alike)])


def _noise_slopes(
    predictor: Predictor, gains: Gains, own: PredictionNoise, logs: np.ndarray, chosen: np.ndarray, free: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """What `scored` says of a noise of some logarithms, around the filter of another noise, for the free numbers."""
    points = np.vstack([logs, logs + _NOISE_STEP * np.eye(len(logs))[free]])
    noises = [PredictionNoise.of(np.exp(point)[predictor.alike]) for point in points]
    return scored(*predictor.expected(gains, own, noises, chosen), _NOISE_STEP)


def scored(errors: np.ndarray, spreads: np.ndarray, step: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Log-likelihood of a noise, its score and its information.

    Args:
        errors: (T, 1 + c, W, m) of the noise, and of such as are a step off it in each of c numbers.
        spreads: (T, 1 + c, W, m, m) covariances that are expected of them.
        step: the step.
    """
    factor = np.linalg.cholesky(spreads[:, 0])
    whitening = np.linalg.inv(factor)
    white = (whitening[:, None] @ errors[..., None])[..., 0]
    own = white[:, 0]
    found = -np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum() - 0.5 * np.sum(own**2)
    slopes = (white[:, 1:] - white[:, :1]) / step
    wider = whitening[:, None] @ (spreads[:, 1:] - spreads[:, :1]) @ whitening[:, None].swapaxes(-1, -2) / step
    score = 0.5 * np.einsum("twi,tcwij,twj->c", own, wider, own, optimize=True)
    score -= 0.5 * np.einsum("tcwii->c", wider) + np.einsum("twi,tcwi->c", own, slopes)
    information = 0.5 * np.einsum("tawij,tbwij->ab", wider, wider, optimize=True)
    information += np.einsum("tawi,tbwi->ab", slopes, slopes, optimize=True)
    return float(found), score, information
