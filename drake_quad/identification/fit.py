"""Estimation of parameters by prediction errors, and of the noise by maximum likelihood.

With the gains of the filter fixed, and with L_t the Cholesky factor of the covariance of the prediction errors e_t(θ),
the parameters are

    θ = argmin ½ Σ_t |L_t⁻¹ e_t(θ)|² + ½ Σ_i (θ_i - θ̄_i)² / s_i²,

where the prior has mean θ̄ and standard deviations s. SciPy's trust-region least squares finds them. The noise then
maximises the likelihood Σ_t -log det L_t - ½ |L_t⁻¹ e_t|², the gains are computed again, and the two steps are
repeated until θ converges.

The uncertainty of θ follows from blocks of windows (`drake_quad.identification.evidence`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy

from drake_quad.errors import InputError
from drake_quad.identification.evidence import Evidence, Uncertainty, jackknife, sums_over_blocks
from drake_quad.identification.parameters import Parameter
from drake_quad.identification.physical_limits import SearchVariables
from drake_quad.identification.prediction_errors import Gains, PredictionNoise, Predictor

# Step of the finite differences, relative to the scale of a parameter.
_RELATIVE_STEP = 1e-5
# Step of the central difference of the delay, in samples. The slope is discontinuous at each whole sample.
_DELAY_STEP = 0.5
_MAX_ROUNDS = 8
# The rounds end when each parameter moves by at most this share of its standard deviation, and each logarithm of the
# disturbance changes by at most the second value.
_CONVERGED_MOVE = 0.2
_CONVERGED_LOG_CHANGE = 0.2
_MAX_EVALUATIONS = 5
# Rounds from which on smaller disturbances are tried: at the beginning, and once the parameters are about right.
_TRIAL_ROUNDS = (1, 4)
# Factors of the disturbance that are tried, because scoring reduces a disturbance that is much too large only slowly.
_SMALLER_TORQUE = (1.0, 1.0, 1.0, 0.2, 0.2, 0.2)
_SMALLER_FORCE = (0.2, 0.2, 0.2, 1.0, 1.0, 1.0)
# A parameter this many standard deviations of the prior from its mean may be in a local minimum, in which a large
# disturbance replaces the vehicle. The search then starts again from the mean, with a smaller disturbance.
_MAX_PRIOR_DISTANCE = 2.0
_RESTART_DISTURBANCE = 0.05
# The model diverges if a whitened error is larger.
_MAX_WHITENED_ERROR = 1e6
# Approximate number of measurements from which the noise is estimated in each round.
_MAX_NOISE_SAMPLES = 1500
# Step of the finite differences of the logarithms of the noise.
_LOG_STEP = 1e-4
# Largest change of a logarithm of the noise in one round, a factor of 12.
_MAX_LOG_CHANGE = 2.5
_MAX_SCORING_STEPS = 5
_LIKELIHOOD_TOLERANCE = 0.1
_INITIAL_DAMPING = 1e-3
MIN_NOISE = 1e-5
"""Smallest standard deviation of a measurement, SI units."""
_MAX_NOISE = 100.0  # SI units
_MIN_DISTURBANCE = 1e-3  # m/s², rad/s²
NEGLIGIBLE_DISTURBANCE = 1.01 * _MIN_DISTURBANCE
"""Standard deviation of a disturbance, m/s² or rad/s², below which the fit needs none."""
_MAX_DISTURBANCE = 1e3  # m/s², rad/s²
_MIN_MEMORY = 0.02  # s
_MAX_MEMORY = 20.0  # s
# Limit of the memory of a force along the axes of B, s. A longer force along z is an error of the thrust curve. If the
# disturbance could absorb it, the level of the curve would follow from large motions of the rotors alone.
_MAX_THRUST_MEMORY = 0.25
# The fit diverged if the noise reaches this share of a limit.
_DIVERGED_SHARE = 0.99
# If there are fewer windows, they are divided into parts, so that their scatter can be estimated.
_MIN_EVIDENCE_PARTS = 60


class PredictionFit(NamedTuple):
    """Result of a fit.

    Attributes:
        values: (p,) estimates of the parameters.
        noise: estimated noise.
        gains: gains of the filter.
        slopes: (W, k, p) derivatives of the k whitened errors of each window, L⁻¹ ∂e/∂θ.
        errors: (W, k) whitened errors, L⁻¹ e.
        prior: (p,) information of the prior on each parameter.
    """

    values: np.ndarray
    noise: PredictionNoise
    gains: Gains
    slopes: np.ndarray
    errors: np.ndarray
    prior: np.ndarray

    def uncertainty(self, blocks: np.ndarray) -> Uncertainty:
        """Return the uncertainty of the parameters from blocks of adjacent windows.

        Args:
            blocks: (W,) block number of each window, from 0.
        """
        information, scores = _information_and_scores(self.slopes, self.errors)
        return jackknife(
            sums_over_blocks(information, blocks), sums_over_blocks(scores, blocks), prior=self.prior, adjacent=True
        )

    def evidence(self, names: Sequence[str], scales: Sequence[float], duration: float) -> Evidence:
        """Return the information of each window, or of parts of the windows if these are few.

        Args:
            names: (p,) names of the parameters.
            scales: (p,) usual errors of the prior means of the parameters.
            duration: duration of all windows together, s.
        """
        windows, size, count = self.slopes.shape
        samples = np.arange(size).reshape(-1, len(self.noise.measured))
        parts = np.array_split(samples, max(1, -(-_MIN_EVIDENCE_PARTS // windows)))
        rows = [part.ravel() for part in parts]
        pairs = [_information_and_scores(self.slopes[:, own], self.errors[:, own]) for own in rows]
        information, scores = (np.stack(each, axis=1) for each in zip(*pairs, strict=True))
        return Evidence(
            tuple(names),
            self.values,
            np.asarray(scales),
            information.reshape(-1, count, count),
            scores.reshape(-1, count),
            duration,
        )


def _information_and_scores(slopes: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the information (W, p, p) and the scores (W, p) of whitened errors."""
    return slopes.swapaxes(1, 2) @ slopes, np.einsum("wkp,wk->wp", slopes, errors)


def fit(
    predictor: Predictor, parameters: Sequence[Parameter], noise: PredictionNoise, start: np.ndarray | None = None
) -> PredictionFit:
    """Fit the parameters and the noise of a predictor.

    Args:
        predictor: predictor of the outputs.
        parameters: p parameters of the model of the predictor.
        noise: initial noise.
        start: (p,) initial parameters; by default the means of the priors.

    Raises:
        InputError: if the fit diverges.
    """
    mean = np.array([parameter.start for parameter in parameters])
    values = mean if start is None else start
    prior = np.array([parameter.scale**-2.0 for parameter in parameters])
    at = _Point.of(predictor, parameters, values, noise)
    untried: list[tuple[float, ...]] = []
    for number in range(1, _MAX_ROUNDS + 1):
        if number in _TRIAL_ROUNDS:
            untried = [_SMALLER_TORQUE, _SMALLER_FORCE]
        before, disturbance = at.values, at.noise.disturbance
        noise = _noise_of(predictor, predictor.gains(before, at.noise), at.noise)
        at = _Point.of(predictor, parameters, before, noise)
        for factors in list(untried):
            better = _with_smaller_disturbance(predictor, parameters, at, factors)
            if better is at:
                untried.remove(factors)
            at = better
        if number == 1 and np.any(np.abs(at.values - mean) > _MAX_PRIOR_DISTANCE / np.sqrt(prior)):
            smaller = _RESTART_DISTURBANCE * at.noise.disturbance
            other = _Point.of(predictor, parameters, mean, at.noise._replace(disturbance=smaller))
            if other.likelihood > at.likelihood:
                at = other
        predictor.continue_windows(at.states, at.state_slopes, at.values, at.gains)
        expected = np.linalg.inv(np.einsum("wkp,wkq->pq", at.slopes, at.slopes) + np.diag(prior))
        converged = np.all(np.abs(at.values - before) < _CONVERGED_MOVE * np.sqrt(np.diag(expected)))
        log_change = np.max(np.abs(np.log(at.noise.disturbance / disturbance)))
        if number > 2 and converged and log_change < _CONVERGED_LOG_CHANGE:
            break
    noise = _noise_of(predictor, at.gains, at.noise, np.arange(len(predictor.windows)))
    _check_convergence(at.values, noise)
    return PredictionFit(at.values, noise, at.gains, at.slopes, at.errors, prior)


def _with_smaller_disturbance(
    predictor: Predictor, parameters: Sequence[Parameter], at: "_Point", factors: Sequence[float]
) -> "_Point":
    """Multiply the disturbance by factors repeatedly, as long as the likelihood increases, and return the best point.

    The parameters are fitted again only when the likelihood no longer increases without a fit.
    """

    def smaller(noise: PredictionNoise) -> PredictionNoise:
        return noise._replace(disturbance=np.maximum(noise.disturbance * factors, _MIN_DISTURBANCE))

    noise, likelihood = at.noise, at.likelihood
    while np.any(smaller(noise).disturbance < noise.disturbance):
        gains = predictor.gains(at.values, smaller(noise))
        white = (gains.whitening @ gains.errors.transpose(0, 2, 1)[..., None])[predictor.counted]
        found = _likelihood(predictor, gains, white)
        if found <= likelihood:
            break
        noise, likelihood = smaller(noise), found
    if noise is not at.noise:
        at = _Point.of(predictor, parameters, at.values, noise)
    if parameters and np.any(smaller(noise).disturbance < noise.disturbance):
        other = _Point.of(predictor, parameters, at.values, smaller(noise))
        at = other if other.likelihood > at.likelihood else at
    return at


def _likelihood(predictor: Predictor, gains: Gains, white: np.ndarray) -> float:
    """Return the logarithm of the likelihood of the measurements, given the whitened errors, up to a constant."""
    factors = np.diagonal(gains.whitening[predictor.counted], axis1=-2, axis2=-1)
    return float(np.log(factors).sum() - 0.5 * np.sum(white**2))


def _check_convergence(values: np.ndarray, noise: PredictionNoise) -> None:
    """Reject a fit that diverged.

    Raises:
        InputError: if a parameter is not finite, or the model explains the log only with noise or a disturbance at its
            upper limit.
    """
    shares = np.append(noise.measured / _MAX_NOISE, noise.disturbance / _MAX_DISTURBANCE)
    if not np.all(np.isfinite(values)) or not np.all(shares < _DIVERGED_SHARE):
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
        states: (rows, W) states where the next windows start.
        state_slopes: (rows, p, W) derivatives of the states.
        likelihood: logarithm of the likelihood of the measurements.
    """

    values: np.ndarray
    noise: PredictionNoise
    gains: Gains
    errors: np.ndarray
    slopes: np.ndarray
    states: np.ndarray
    state_slopes: np.ndarray
    likelihood: float

    @classmethod
    def of(
        cls, predictor: Predictor, parameters: Sequence[Parameter], start: np.ndarray, noise: PredictionNoise
    ) -> "_Point":
        """Return the best parameters for a noise, with a filter that is linearised at the initial parameters."""
        gains = predictor.gains(start, noise)
        values = _least_squares(predictor, parameters, start, gains, noise)
        scales = np.array([parameter.scale for parameter in parameters])
        errors, slopes, states, state_slopes = _whitened(predictor, scales, values, gains, noise)
        return cls(values, noise, gains, errors, slopes, states, state_slopes, _likelihood(predictor, gains, errors))


def _least_squares(
    predictor: Predictor, parameters: Sequence[Parameter], start: np.ndarray, gains: Gains, noise: PredictionNoise
) -> np.ndarray:
    """Return the parameters (p,) with the least squares of whitened errors and of the distance to the prior."""
    if not parameters:
        return start
    mean, scale = (
        np.array([getattr(parameter, name) for parameter in parameters], dtype=float) for name in ("start", "scale")
    )
    weights, variables = np.diag(1.0 / scale), SearchVariables.of(parameters)

    known: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

    def at(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the residuals and their derivatives, which cost hardly more than the residuals alone."""
        if x.tobytes() not in known:
            known.clear()
            values = variables.inverse @ x
            errors, slopes, *_ = _whitened(predictor, scale, values, gains, noise)
            if np.all(np.abs(errors) < _MAX_WHITENED_ERROR) and np.all(np.isfinite(slopes)):
                residuals = np.concatenate([errors.ravel(), weights @ (values - mean)])
                own = np.vstack([slopes.reshape(-1, len(x)), weights])
                known[x.tobytes()] = _condensed(residuals, own @ variables.inverse)
            else:
                # The model diverges, and large residuals make the search reject the step.
                known[x.tobytes()] = np.full(len(x) + 1, _MAX_WHITENED_ERROR), np.zeros((len(x) + 1, len(x)))
        return known[x.tobytes()]

    found = scipy.optimize.least_squares(
        lambda x: at(x)[0],
        np.clip(variables.matrix @ start, variables.lower, variables.upper),
        jac=lambda x: at(x)[1],
        bounds=(variables.lower, variables.upper),
        x_scale=variables.scale,
        xtol=1e-5,
        ftol=1e-6,
        max_nfev=_MAX_EVALUATIONS,
    )
    return np.asarray(variables.inverse @ found.x)


def _condensed(residuals: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return p + 1 residuals and derivatives with the same normal equations and the same sum of squares.

    These determine the least-squares solution, and the search is much faster with few residuals.

    Args:
        residuals: (k,) residuals.
        slopes: (k, p) derivatives.
    """
    # The parameters are scaled, because the Cholesky factorisation squares the condition number.
    sizes = np.linalg.norm(slopes, axis=0)
    unit = slopes / sizes
    factor = np.linalg.cholesky(unit.T @ unit).T
    along = scipy.linalg.solve_triangular(factor, unit.T @ residuals, trans="T")
    across = np.sqrt(max(0.0, float(residuals @ residuals - along @ along)))
    return np.append(along, across), np.vstack([factor * sizes, np.zeros(len(factor))])


def _whitened_errors(
    predictor: Predictor, parameters: np.ndarray, gains: Gains, noise: PredictionNoise
) -> tuple[np.ndarray, np.ndarray]:
    """Return the whitened errors (W, k, K) for (K, p) parameters, and the states where the next windows start."""
    counted = predictor.counted
    found, states = predictor.errors(parameters, gains, noise)
    white = (gains.whitening[counted] @ found[counted].transpose(0, 3, 1, 2)).swapaxes(0, 1)
    return white.reshape(len(white), -1, len(parameters)), states


def _whitened(
    predictor: Predictor, scales: np.ndarray, parameters: np.ndarray, gains: Gains, noise: PredictionNoise
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return whitened errors and states, with their derivatives by finite differences.

    Args:
        predictor: predictor of the outputs.
        scales: (p,) scales of the parameters.
        parameters: (p,) parameters.
        gains: gains of the filter.
        noise: noise of the filter.

    Returns:
        (W, k) whitened errors, their (W, k, p) derivatives, the (rows, W) states where the next windows start, and
        their (rows, p, W) derivatives.
    """
    delay, up = predictor.model.delay_place, _RELATIVE_STEP * scales
    down = np.zeros(len(parameters))
    if delay is not None:
        up[delay] = down[delay] = _DELAY_STEP * predictor.inputs.period
    points = np.vstack([parameters, parameters + np.diag(up), parameters - down])
    errors, states = _whitened_errors(predictor, points, gains, noise)
    return (
        errors[:, :, 0],
        _slopes(errors, up, delay),
        states[:, 0],
        _slopes(states.swapaxes(1, 2), up, delay).swapaxes(1, 2),
    )


def _slopes(values: np.ndarray, up: np.ndarray, delay: int | None) -> np.ndarray:
    """Return derivatives (a, b, p) by forward differences, and by a central difference for the delay.

    Args:
        values: (a, b, 1 + p + 1) values at a point, with each parameter increased, and with the delay reduced.
        up: (p,) increases of the parameters.
        delay: index of the delay among the parameters; None if the delay is fixed.
    """
    found = (values[:, :, 1:-1] - values[:, :, :1]) / up
    if delay is not None:
        found[:, :, delay] = (values[:, :, 1 + delay] - values[:, :, -1]) / (2.0 * up[delay])
    return np.asarray(found)


def _noise_of(
    predictor: Predictor, gains: Gains, noise: PredictionNoise, chosen: np.ndarray | None = None
) -> PredictionNoise:
    """Return the maximum-likelihood noise by Fisher scoring of the logarithms of the noise parameters.

    Args:
        predictor: predictor of the outputs.
        gains: gains of the filter with the noise.
        noise: initial noise.
        chosen: indices of the windows that are used; by default some evenly spaced windows.
    """
    groups = predictor.noise_groups
    _, first = np.unique(groups, return_index=True)
    rows = int(np.sum(predictor.counted))
    windows, m = len(predictor.windows), len(noise.measured)
    if chosen is None:
        chosen = np.linspace(0, windows - 1, min(windows, max(5, _MAX_NOISE_SAMPLES // rows))).astype(int)
    logs = start = np.log(np.concatenate(noise))[first]
    smallest = np.repeat([MIN_NOISE, _MIN_DISTURBANCE, _MIN_MEMORY], [m, 6, 6])
    largest = np.repeat([_MAX_NOISE, _MAX_DISTURBANCE, _MAX_MEMORY], [m, 6, 6])
    along_thrust = slice(m + 6, m + 9) if predictor.model.frame == "body" else slice(m + 8, m + 9)
    largest[along_thrust] = _MAX_THRUST_MEMORY
    lower = np.maximum(np.log(smallest)[first], start - _MAX_LOG_CHANGE)
    upper = np.minimum(np.log(largest)[first], start + _MAX_LOG_CHANGE)
    # The memory of a negligible disturbance has no influence.
    fixed = (first >= m + 6) & (np.concatenate(noise)[first - 6] < NEGLIGIBLE_DISTURBANCE)
    free = np.flatnonzero(~fixed)
    best, score, information = _likelihood_of(predictor, gains, noise, logs, chosen, free)
    if not np.isfinite(best):
        return noise
    damping = 0.2 * _INITIAL_DAMPING
    for steps_left in reversed(range(_MAX_SCORING_STEPS)):
        step = np.linalg.solve(information + damping * np.diag(np.diag(information) + 1.0), score)
        trial = logs.copy()
        trial[free] = np.clip(logs[free] + step, lower[free], upper[free])
        # Many steps are rejected, so derivatives are computed only after a step is accepted and another one follows.
        likelihood, *_ = _likelihood_of(predictor, gains, noise, trial, chosen, free[:0])
        gained = likelihood - best
        if not gained > 0.0:
            damping *= 10.0
            continue
        logs, best, damping = trial, likelihood, 0.2 * damping
        if gained < _LIKELIHOOD_TOLERANCE or not steps_left:
            break
        _, score, information = _likelihood_of(predictor, gains, noise, logs, chosen, free)
    return PredictionNoise.of(np.exp(logs)[groups])


def noise_covariance(predictor: Predictor, fitted: PredictionFit) -> np.ndarray:
    """Return the covariance (m + 12, m + 12) of the errors of the logarithms of the noise.

    It is the inverse of the Fisher information. A noise parameter that the log does not determine has a large variance.
    """
    groups = predictor.noise_groups
    _, first = np.unique(groups, return_index=True)
    logs, windows = np.log(np.concatenate(fitted.noise))[first], np.arange(len(predictor.windows))
    numbers = np.arange(len(logs))
    _, _, information = _likelihood_of(predictor, fitted.gains, fitted.noise, logs, windows, numbers)
    return np.asarray(np.linalg.inv(information + _INITIAL_DAMPING * np.eye(len(logs)))[np.ix_(groups, groups)])


def _likelihood_of(
    predictor: Predictor, gains: Gains, own: PredictionNoise, logs: np.ndarray, chosen: np.ndarray, free: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return log-likelihood, score and information of a noise, to first order around a filter.

    Args:
        predictor: predictor of the outputs.
        gains: gains of the filter.
        own: noise of the filter.
        logs: (c,) logarithms of the noise, one for each group.
        chosen: indices of the windows that are used.
        free: (f,) indices of the logarithms for which score and information are returned.
    """
    points = np.vstack([logs, logs + _LOG_STEP * np.eye(len(logs))[free]])
    noises = [PredictionNoise.of(np.exp(point)[predictor.noise_groups]) for point in points]
    return noise_likelihood(*predictor.linearised_errors(gains, own, noises, chosen), _LOG_STEP)


def noise_likelihood(errors: np.ndarray, covariances: np.ndarray, step: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the log-likelihood of a noise with c parameters, its score (c,) and its Fisher information (c, c).

    With ∂e and ∂S the derivatives of the errors and of their covariance, both whitened, the score is
    Σ ½ eᵀ ∂S e - ½ tr ∂S - eᵀ ∂e, and the information Σ ½ tr ∂S ∂S + ∂eᵀ ∂e.

    Args:
        errors: (T, 1 + c, W, m) prediction errors with the noise, and with each of its parameters increased.
        covariances: (T, 1 + c, W, m, m) covariances of the errors.
        step: increase of the logarithm of each parameter.
    """
    factor = np.linalg.cholesky(covariances[:, 0])
    whitening = np.linalg.inv(factor)
    white = (whitening[:, None] @ errors[..., None])[..., 0]
    own = white[:, 0]
    likelihood = -np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum() - 0.5 * np.sum(own**2)
    slopes = (white[:, 1:] - white[:, :1]) / step
    changes = (
        whitening[:, None] @ (covariances[:, 1:] - covariances[:, :1]) @ whitening[:, None].swapaxes(-1, -2) / step
    )
    score = 0.5 * np.einsum("twi,tcwij,twj->c", own, changes, own, optimize=True)
    score -= 0.5 * np.einsum("tcwii->c", changes) + np.einsum("twi,tcwi->c", own, slopes)
    information = 0.5 * np.einsum("tawij,tbwij->ab", changes, changes, optimize=True)
    information += np.einsum("tawi,tbwi->ab", slopes, slopes, optimize=True)
    return float(likelihood), score, information
