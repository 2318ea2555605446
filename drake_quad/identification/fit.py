"""Estimation of the parameters from prediction errors, and of the noise by maximum likelihood.

Let L_t be the Cholesky factor of the covariance of the prediction errors e_t(θ). The gains of the filter are fixed. The
parameters are then

    θ = argmin ½ Σ_t |L_t⁻¹ e_t(θ)|² + ½ Σ_i (θ_i - θ̄_i)² / s_i²,

where the prior has mean θ̄ and standard deviations s. The minimum is found by SciPy's trust-region least squares. The
noise is then estimated by maximising the log-likelihood Σ_t -log det L_t - ½ |L_t⁻¹ e_t|², and the gains are computed
again. These steps are repeated until θ converges.

The uncertainty of θ is computed from blocks of windows (`drake_quad.identification.evidence`).
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
# Step of the central difference for the delay, in samples. The derivative is discontinuous at each whole sample.
_DELAY_STEP = 0.5
_MAX_NUM_ROUNDS = 8  # largest number of rounds, each with a fit of the parameters and of the noise
# The fit has converged if no parameter and no standard deviation of the disturbance changes by more than these
# tolerances in one round.
_PARAMETER_TOLERANCE = 0.2  # change of a parameter, relative to its standard deviation
_LOG_DISTURBANCE_TOLERANCE = 0.2  # change of the logarithm of a standard deviation of the disturbance
_MAX_NUM_EVALUATIONS = 5  # largest number of evaluations of the residuals in one least-squares search
# A fit with a reduced disturbance is accepted only if it increases the log-likelihood. The derivatives at the start of
# the search predict how much the search can gain. The search is skipped if even this multiple of the predicted gain
# would be too small.
_MAX_GAIN_RATIO = 3.0
# Rounds of the fit in which smaller disturbing forces and torques are tried: at the start, and when the parameters have
# nearly converged.
_TRIAL_ROUNDS = (1, 4)
# Factors by which a trial multiplies the standard deviations of the disturbance (force along x, y, z, torque about x,
# y, z). The trials are needed because Fisher scoring needs many steps if the disturbance is far too large.
_TORQUE_REDUCTION = (1.0, 1.0, 1.0, 0.2, 0.2, 0.2)
_FORCE_REDUCTION = (0.2, 0.2, 0.2, 1.0, 1.0, 1.0)
# If a parameter is more than this many standard deviations of the prior away from the prior mean, the fit may be in a
# local minimum in which a large disturbance explains the motion. The search then starts again from the prior mean,
# with the disturbance multiplied by `_RESTART_DISTURBANCE_FACTOR`.
_MAX_PRIOR_DISTANCE = 2.0  # standard deviations of the prior
_RESTART_DISTURBANCE_FACTOR = 0.05  # factor on the standard deviations of the disturbance
# The model has diverged if a whitened error exceeds this limit.
_MAX_WHITENED_ERROR = 1e6
# Largest number of samples from which the noise is estimated in each round, unless five windows contain more.
_MAX_NOISE_SAMPLES = 1500
# Step of the finite differences with respect to the logarithms of the noise levels.
_LOG_STEP = 1e-4
# Largest change of the logarithm of a noise parameter in one round, which corresponds to a factor of 12.
_MAX_LOG_CHANGE = 2.5
_MAX_SCORING_STEPS = 5  # largest number of Fisher scoring steps in a round
_LIKELIHOOD_TOLERANCE = 0.1  # Fisher scoring ends when a step increases the log-likelihood by less than this
_INITIAL_DAMPING = 1e-3  # scale of the initial damping of Fisher scoring steps
_WEAK_PRIOR = 1e-3  # information added to each noise parameter, so that the total information is invertible
MIN_NOISE = 1e-5
"""Smallest estimated standard deviation of a measurement, in the SI unit of the signal."""
_MAX_NOISE = 100.0  # largest estimated standard deviation of a measurement, in the SI unit of the signal
_MIN_DISTURBANCE = 1e-3  # m/s² or rad/s², smallest estimated standard deviation of the disturbance
NEGLIGIBLE_DISTURBANCE = 1.01 * _MIN_DISTURBANCE
"""Standard deviation below which a disturbance is negligible, m/s² or rad/s²."""
_MAX_DISTURBANCE = 1e3  # m/s² or rad/s², largest estimated standard deviation of the disturbance
_MIN_CORRELATION_TIME = 0.02  # s, shortest correlation time of the disturbance
_MAX_CORRELATION_TIME = 20.0  # s, longest correlation time of the disturbance
# Largest correlation time of the disturbing force along Z, s. If the model resolves the force along the axes of B, this
# limit applies to all three axes. A force that lasts longer is attributed to the thrust curve. Otherwise, the
# disturbance would explain most errors of the curve, and only large changes of the rotor speeds would determine it.
_MAX_THRUST_CORRELATION_TIME = 0.25
# The fit has diverged if the noise or the disturbance exceeds this fraction of its upper limit.
_DIVERGENCE_RATIO = 0.99
# If there are fewer windows than this, each is divided into parts, so that the uncertainty is computed from many parts.
_MIN_NUM_PARTS = 60


class PredictionFit(NamedTuple):
    """Result of a fit.

    Attributes:
        values: (p,) estimates of the parameters.
        noise: estimated measurement noise and disturbance.
        gains: gains of the filter for these parameters.
        jacobian: (W, k, p) derivatives of the k whitened errors of each window, L⁻¹ ∂e/∂θ.
        errors: (W, k) whitened errors, L⁻¹ e.
        prior: (p,) information that the prior contains about each parameter.
    """

    values: np.ndarray
    noise: PredictionNoise
    gains: Gains
    jacobian: np.ndarray
    errors: np.ndarray
    prior: np.ndarray

    def uncertainty(self, blocks: np.ndarray) -> Uncertainty:
        """Return the uncertainty of the parameters from blocks of adjacent windows.

        Args:
            blocks: (W,) block number of each window, from 0.
        """
        information, scores = _information_and_scores(self.jacobian, self.errors)
        return jackknife(
            sums_over_blocks(information, blocks), sums_over_blocks(scores, blocks), prior=self.prior, adjacent=True
        )

    def evidence(self, names: Sequence[str], scales: Sequence[float], duration: float) -> Evidence:
        """Return the evidence of the windows about the parameters. If there are few windows, each is split into parts.

        Args:
            names: (p,) names of the parameters.
            scales: (p,) standard deviations of the prior.
            duration: duration of all windows together, s.
        """
        num_windows, num_errors, num_parameters = self.jacobian.shape
        samples = np.arange(num_errors).reshape(-1, len(self.noise.measured))
        parts = np.array_split(samples, max(1, -(-_MIN_NUM_PARTS // num_windows)))
        rows = [part.ravel() for part in parts]
        sums = [_information_and_scores(self.jacobian[:, part], self.errors[:, part]) for part in rows]
        information, scores = (np.stack(each, axis=1) for each in zip(*sums, strict=True))
        return Evidence(
            tuple(names),
            self.values,
            np.asarray(scales),
            information.reshape(-1, num_parameters, num_parameters),
            scores.reshape(-1, num_parameters),
            duration,
        )


def _information_and_scores(jacobian: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the Fisher information (W, p, p) and the scores (W, p) of W windows, given their whitened errors."""
    return jacobian.swapaxes(1, 2) @ jacobian, np.einsum("wkp,wk->wp", jacobian, errors)


def fit(
    predictor: Predictor, parameters: Sequence[Parameter], noise: PredictionNoise, start: np.ndarray | None = None
) -> PredictionFit:
    """Fit the parameters and the noise of a predictor.

    Args:
        predictor: predictor of the outputs.
        parameters: p parameters of the predictor's model.
        noise: initial noise.
        start: (p,) initial parameters; by default the means of the priors.

    Raises:
        InputError: if the fit diverges.
    """
    mean = np.array([parameter.start for parameter in parameters])
    prior = np.array([parameter.scale**-2.0 for parameter in parameters])
    values = mean if start is None else start
    point = _best_point(predictor, parameters, values, predictor.gains(values, noise))
    untried: list[tuple[float, ...]] = []
    for round_number in range(1, _MAX_NUM_ROUNDS + 1):
        if round_number in _TRIAL_ROUNDS:
            untried = [_TORQUE_REDUCTION, _FORCE_REDUCTION]
        previous = point
        noise = _noise_of(predictor, predictor.gains(point.values, point.noise))
        point = _best_point(predictor, parameters, point.values, predictor.gains(point.values, noise))
        for factors in list(untried):
            improved = _with_smaller_disturbance(predictor, parameters, point, factors)
            if improved is point:
                untried.remove(factors)
            point = improved
        if round_number == 1 and np.any(np.abs(point.values - mean) > _MAX_PRIOR_DISTANCE / np.sqrt(prior)):
            small = point.noise._replace(disturbance=_RESTART_DISTURBANCE_FACTOR * point.noise.disturbance)
            restarted = _best_point(predictor, parameters, mean, predictor.gains(mean, small))
            if restarted.likelihood > point.likelihood:
                point = restarted
        predictor.continue_windows(point.states, point.state_jacobian, point.values, point.gains)
        covariance = np.linalg.inv(np.einsum("wkp,wkq->pq", point.jacobian, point.jacobian) + np.diag(prior))
        tolerance = _PARAMETER_TOLERANCE * np.sqrt(np.diag(covariance))
        converged = np.all(np.abs(point.values - previous.values) < tolerance)
        log_change = np.max(np.abs(np.log(point.noise.disturbance / previous.noise.disturbance)))
        if round_number > 2 and converged and log_change < _LOG_DISTURBANCE_TOLERANCE:
            break
    noise = _noise_of(predictor, point.gains, np.arange(len(predictor.windows)))
    _check_convergence(point.values, noise)
    return PredictionFit(point.values, noise, point.gains, point.jacobian, point.errors, prior)


def _with_smaller_disturbance(
    predictor: Predictor, parameters: Sequence[Parameter], point: "_Point", factors: Sequence[float]
) -> "_Point":
    """Reduce the disturbance as long as the likelihood increases, and return the best point.

    Each step multiplies the disturbance by the factors, with fixed parameters. The parameters are then fitted for the
    best disturbance, and for the next smaller one. The fit with the higher likelihood is returned.
    """

    def reduced(noise: PredictionNoise) -> PredictionNoise:
        return noise._replace(disturbance=np.maximum(noise.disturbance * factors, _MIN_DISTURBANCE))

    def is_reducible(noise: PredictionNoise) -> bool:
        return bool(np.any(reduced(noise).disturbance < noise.disturbance))

    best, likelihood, smaller = point.gains, point.likelihood, None
    while is_reducible(best.noise):
        smaller = predictor.gains(point.values, reduced(best.noise))
        whitened = (smaller.whitening @ smaller.errors.transpose(0, 2, 1)[..., None])[predictor.evaluated]
        smaller_likelihood = _likelihood(predictor, smaller, whitened)
        if smaller_likelihood <= likelihood:
            break
        best, likelihood = smaller, smaller_likelihood
    if best is not point.gains:
        point, smaller = _best_point(predictor, parameters, point.values, best), None
    if parameters and is_reducible(best.noise):
        smaller = smaller or predictor.gains(point.values, reduced(best.noise))
        refitted = _best_point(predictor, parameters, point.values, smaller, min_likelihood=point.likelihood)
        point = refitted if refitted.likelihood > point.likelihood else point
    return point


def _likelihood(predictor: Predictor, gains: Gains, whitened: np.ndarray) -> float:
    """Return the log-likelihood of the measurements up to a constant, given their whitened errors."""
    factors = np.diagonal(gains.whitening[predictor.evaluated], axis1=-2, axis2=-1)
    return float(np.log(factors).sum() - 0.5 * np.sum(whitened**2))


def _check_convergence(values: np.ndarray, noise: PredictionNoise) -> None:
    """Reject a fit that diverged.

    Raises:
        InputError: if a parameter is not finite, or the noise or the disturbance is at its upper limit.
    """
    ratios = np.append(noise.measured / _MAX_NOISE, noise.disturbance / _MAX_DISTURBANCE)
    if not np.all(np.isfinite(values)) or not np.all(ratios < _DIVERGENCE_RATIO):
        raise InputError(
            "the fit diverged: the model of the vehicle explains the logs only with implausibly large noise or"
            " disturbances; check the units in the mapping, and the initial scenario"
        )


class _Point(NamedTuple):
    """Predictions with one set of parameters, and their derivatives.

    Attributes:
        values: (p,) parameters.
        gains: gains of the filter.
        errors: (W, k) whitened errors.
        jacobian: (W, k, p) derivatives of the errors with respect to the parameters.
        states: (components, W) state of each window at the sample where the next window starts.
        state_jacobian: (components, p, W) derivatives of the states with respect to the parameters.
        likelihood: log-likelihood of the measurements.
    """

    values: np.ndarray
    gains: Gains
    errors: np.ndarray
    jacobian: np.ndarray
    states: np.ndarray
    state_jacobian: np.ndarray
    likelihood: float

    @property
    def noise(self) -> PredictionNoise:
        """Noise parameters for which the gains of the Kalman filter were computed."""
        return self.gains.noise

    @classmethod
    def at(cls, predictor: Predictor, scales: np.ndarray, values: np.ndarray, gains: Gains) -> "_Point":
        """Return the predictions for given parameters, with their derivatives by finite differences.

        Args:
            predictor: predictor of the outputs.
            scales: (p,) scales of the parameters. The finite-difference steps are proportional to them.
            values: (p,) parameters.
            gains: gains of the filter.
        """
        delay_index, increases = predictor.model.delay_index, _RELATIVE_STEP * scales
        decreases = np.zeros(len(values))
        if delay_index is not None:
            increases[delay_index] = decreases[delay_index] = _DELAY_STEP * predictor.inputs.period
        points = np.vstack([values, values + np.diag(increases), values - decreases])
        # The model may diverge for parameters that the search tries. The search rejects values that are not finite.
        with np.errstate(over="ignore", invalid="ignore"):
            errors, states = predictor.errors(points, gains)
            evaluated = predictor.evaluated
            whitened = (gains.whitening[evaluated] @ errors[evaluated].transpose(0, 3, 1, 2)).swapaxes(0, 1)
            whitened = whitened.reshape(len(whitened), -1, len(points))
            return cls(
                values,
                gains,
                whitened[:, :, 0],
                _jacobian(whitened, increases, delay_index),
                states[:, 0],
                _jacobian(states.swapaxes(1, 2), increases, delay_index).swapaxes(1, 2),
                _likelihood(predictor, gains, whitened[:, :, 0]),
            )


class _Evaluation(NamedTuple):
    """Predictions for given parameters, with the p + 1 residuals of `_condensed` and their (p + 1, p) derivatives."""

    point: _Point
    residuals: np.ndarray
    slopes: np.ndarray


def _best_point(
    predictor: Predictor,
    parameters: Sequence[Parameter],
    start: np.ndarray,
    gains: Gains,
    *,
    min_likelihood: float = -np.inf,
) -> _Point:
    """Return the point that minimises the sum of the squared whitened errors and of the squared distance to the prior.

    The search is skipped if it is unlikely to reach a log-likelihood of `min_likelihood`; see `_MAX_GAIN_RATIO`.
    """
    prior_mean, scale = (
        np.array([getattr(parameter, name) for parameter in parameters], dtype=float) for name in ("start", "scale")
    )
    if not parameters:
        return _Point.at(predictor, scale, start, gains)
    weights, variables = np.diag(1.0 / scale), SearchVariables.of(parameters)
    evaluations: dict[bytes, _Evaluation] = {}

    def evaluate(x: np.ndarray) -> _Evaluation:
        """Return the residuals and their derivatives.

        Two evaluations are cached: the last one, since the next call is often for the same point, and the best one,
        since the search ends there.
        """
        if x.tobytes() not in evaluations:
            point = _Point.at(predictor, scale, variables.inverse @ x, gains)
            if np.all(np.abs(point.errors) < _MAX_WHITENED_ERROR) and np.all(np.isfinite(point.jacobian)):
                residuals = np.concatenate([point.errors.ravel(), weights @ (point.values - prior_mean)])
                stacked = np.vstack([point.jacobian.reshape(-1, len(x)), weights])
                condensed = _condensed(residuals, stacked @ variables.inverse)
            else:
                # The model has diverged. Large residuals make the search reject the step.
                condensed = np.full(len(x) + 1, _MAX_WHITENED_ERROR), np.zeros((len(x) + 1, len(x)))
            ordered = sorted(evaluations.items(), key=lambda item: float(np.sum(item[1].residuals ** 2)))
            evaluations.clear()
            evaluations.update(ordered[:1])
            evaluations[x.tobytes()] = _Evaluation(point, *condensed)
        return evaluations[x.tobytes()]

    first = np.clip(variables.matrix @ start, variables.lower, variables.upper)
    if np.isfinite(min_likelihood):
        point, residuals, _ = evaluate(first)
        # `residuals` are the p + 1 residuals that `_condensed` returns. If the prediction errors are linear in the
        # parameters, the fit reduces all of them to zero except the last, which does not depend on the parameters.
        predicted_gain = 0.5 * float(np.sum(residuals[:-1] ** 2))
        if point.likelihood + _MAX_GAIN_RATIO * predicted_gain < min_likelihood:
            return point
    solution = scipy.optimize.least_squares(
        lambda x: evaluate(x).residuals,
        first,
        jac=lambda x: evaluate(x).slopes,
        bounds=(variables.lower, variables.upper),
        x_scale=variables.scale,
        xtol=1e-5,
        ftol=1e-6,
        max_nfev=_MAX_NUM_EVALUATIONS,
    )
    return evaluate(solution.x).point


def _condensed(residuals: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Condense k residuals to p + 1 residuals that have the same least-squares solution.

    The normal equations and the sum of squares are unchanged. The search is much faster with few residuals.

    Args:
        residuals: (k,) residuals.
        jacobian: (k, p) derivatives with respect to the parameters.
    """
    # The columns are scaled, since the condition number of the normal equations is the square of the condition number
    # of the derivatives.
    norms = np.linalg.norm(jacobian, axis=0)
    normalised = jacobian / norms
    factor = np.linalg.cholesky(normalised.T @ normalised).T
    projected = scipy.linalg.solve_triangular(factor, normalised.T @ residuals, trans="T")
    remainder = np.sqrt(max(0.0, float(residuals @ residuals - projected @ projected)))
    return np.append(projected, remainder), np.vstack([factor * norms, np.zeros(len(factor))])


def _jacobian(values: np.ndarray, increases: np.ndarray, delay_index: int | None) -> np.ndarray:
    """Return derivatives (a, b, p) by forward differences, and by a central difference for the delay.

    Args:
        values: (a, b, 1 + p + 1) values of a function of the parameters, whose result is an (a, b) array: at a point,
            then with each parameter increased in turn, then with the delay reduced.
        increases: (p,) increases of the parameters.
        delay_index: index of the delay among the parameters; None if the delay is fixed.
    """
    jacobian = (values[:, :, 1:-1] - values[:, :, :1]) / increases
    if delay_index is not None:
        jacobian[:, :, delay_index] = (values[:, :, 1 + delay_index] - values[:, :, -1]) / (
            2.0 * increases[delay_index]
        )
    return np.asarray(jacobian)


def _noise_of(predictor: Predictor, gains: Gains, chosen: np.ndarray | None = None) -> PredictionNoise:
    """Return the maximum-likelihood noise, found by Fisher scoring in the logarithms of the noise parameters.

    Args:
        predictor: predictor of the outputs.
        gains: gains of the filter, for the noise at which the search starts.
        chosen: indices of the windows that are used; by default some evenly spaced windows.
    """
    noise, groups = gains.noise, predictor.noise_groups
    _, group_rows = np.unique(groups, return_index=True)
    num_counted = int(np.sum(predictor.evaluated))
    windows, m = len(predictor.windows), len(noise.measured)
    if chosen is None:
        chosen = np.linspace(0, windows - 1, min(windows, max(5, _MAX_NOISE_SAMPLES // num_counted))).astype(int)
    log_noise = start = np.log(np.concatenate(noise))[group_rows]
    smallest_noise = np.repeat([MIN_NOISE, _MIN_DISTURBANCE, _MIN_CORRELATION_TIME], [m, 6, 6])
    largest_noise = np.repeat([_MAX_NOISE, _MAX_DISTURBANCE, _MAX_CORRELATION_TIME], [m, 6, 6])
    along_thrust = slice(m + 6, m + 9) if predictor.model.frame == "body" else slice(m + 8, m + 9)
    largest_noise[along_thrust] = _MAX_THRUST_CORRELATION_TIME
    lower = np.maximum(np.log(smallest_noise)[group_rows], start - _MAX_LOG_CHANGE)
    upper = np.minimum(np.log(largest_noise)[group_rows], start + _MAX_LOG_CHANGE)
    # The correlation time of a negligible disturbance is fixed, since it has no influence.
    fixed = (group_rows >= m + 6) & (np.concatenate(noise)[group_rows - 6] < NEGLIGIBLE_DISTURBANCE)
    free = np.flatnonzero(~fixed)
    best, score, information = _likelihood_of(predictor, gains, log_noise, chosen, free)
    if not np.isfinite(best):
        return noise
    damping = 0.2 * _INITIAL_DAMPING
    for steps_left in reversed(range(_MAX_SCORING_STEPS)):
        step = np.linalg.solve(information + damping * np.diag(np.diag(information) + 1.0), score)
        trial = log_noise.copy()
        trial[free] = np.clip(log_noise[free] + step, lower[free], upper[free])
        # Many steps are rejected. Derivatives are therefore computed only after a step is accepted, and not after the
        # last step.
        likelihood, *_ = _likelihood_of(predictor, gains, trial, chosen, free[:0])
        gain = likelihood - best
        if not gain > 0.0:
            damping *= 10.0
            continue
        log_noise, best, damping = trial, likelihood, 0.2 * damping
        if gain < _LIKELIHOOD_TOLERANCE or not steps_left:
            break
        _, score, information = _likelihood_of(predictor, gains, log_noise, chosen, free)
    return PredictionNoise.of(np.exp(log_noise)[groups])


def noise_covariance(predictor: Predictor, fitted: PredictionFit) -> np.ndarray:
    """Return the error covariance (m + 12, m + 12) of the estimated logarithms of the noise parameters.

    This is the inverse of the Fisher information. A noise parameter that the logs do not identify has a large variance.
    """
    groups = predictor.noise_groups
    _, group_rows = np.unique(groups, return_index=True)
    log_noise, windows = np.log(np.concatenate(fitted.noise))[group_rows], np.arange(len(predictor.windows))
    all_groups = np.arange(len(log_noise))
    _, _, information = _likelihood_of(predictor, fitted.gains, log_noise, windows, all_groups)
    return np.asarray(np.linalg.inv(information + _WEAK_PRIOR * np.eye(len(log_noise)))[np.ix_(groups, groups)])


def _likelihood_of(
    predictor: Predictor, gains: Gains, log_noise: np.ndarray, chosen: np.ndarray, free: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the log-likelihood of noise parameters, its score and its Fisher information.

    Args:
        predictor: predictor of the outputs.
        gains: gains of the filter, for a noise close to the noise parameters.
        log_noise: (c,) logarithms of the noise parameters, one for each group in `predictor.noise_groups`.
        chosen: indices of the windows that are used.
        free: (f,) indices of the logarithms for which score and information are returned.
    """
    points = np.vstack([log_noise, log_noise + _LOG_STEP * np.eye(len(log_noise))[free]])
    noises = [PredictionNoise.of(np.exp(point)[predictor.noise_groups]) for point in points]
    return noise_likelihood(*predictor.linearised_errors(gains, noises, chosen), _LOG_STEP)


def noise_likelihood(errors: np.ndarray, covariances: np.ndarray, step: float) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the log-likelihood of a noise with c parameters, its score (c,), and its Fisher information (c, c).

    The score is Σ ½ eᵀ ∂S e - ½ tr ∂S - eᵀ ∂e, and the information is Σ ½ tr ∂S ∂S + ∂eᵀ ∂e. Here ∂e and ∂S are the
    whitened derivatives of the errors and of their covariance.

    Args:
        errors: (T, 1 + c, W, m) prediction errors with the given noise, then with each noise parameter increased in
            turn.
        covariances: (T, 1 + c, W, m, m) covariances of the errors in the same order.
        step: increase of the logarithm of each parameter.
    """
    factor = np.linalg.cholesky(covariances[:, 0])
    whitening = np.linalg.inv(factor)
    all_whitened = (whitening[:, None] @ errors[..., None])[..., 0]
    whitened = all_whitened[:, 0]
    likelihood = -np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum() - 0.5 * np.sum(whitened**2)
    jacobian = (all_whitened[:, 1:] - all_whitened[:, :1]) / step
    changes = (
        whitening[:, None] @ (covariances[:, 1:] - covariances[:, :1]) @ whitening[:, None].swapaxes(-1, -2) / step
    )
    score = 0.5 * np.einsum("twi,tcwij,twj->c", whitened, changes, whitened, optimize=True)
    score -= 0.5 * np.einsum("tcwii->c", changes) + np.einsum("twi,tcwi->c", whitened, jacobian)
    information = 0.5 * np.einsum("tawij,tbwij->ab", changes, changes, optimize=True)
    information += np.einsum("tawi,tbwi->ab", jacobian, jacobian, optimize=True)
    return float(likelihood), score, information
