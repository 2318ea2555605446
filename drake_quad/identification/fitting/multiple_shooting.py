"""Parameters of a model from windows of a log, in each of which it starts from a state of its own.

In window w the model predicts what was measured from an initial state x_w and the parameters θ that all windows share.
With r_w the weighted residuals,

    min over θ, x_1 ... x_W of Σ_w |r_w(θ, x_w)|² + Σ_i ((θ_i - θ_i0) / σ_i)²

where the last sum are weak beliefs that keep what the log does not tell where it was. The
initial states are taken out window by window: with Q an orthonormal basis of J_x = ∂r/∂x, a window adds to the
equations of θ what is orthogonal to Q, P = 1 - Q Qᵀ (variable projection, G. H. Golub and V. Pereyra, 1973),

    Σ_w (P J_θ)ᵀ (P J_θ) δθ = -Σ_w (P J_θ)ᵀ P r

If the weights make residuals white, the covariance of θ is H⁻¹ with H = Σ_w (P J_θ)ᵀ (P J_θ). What a model leaves out
makes them correlated, within a window and from one to the next. The sandwich over B blocks of consecutive windows
allows for that, with s_b the sum of (P J_θ)ᵀ P r over block b, and H_b its part of H:

    Σ_b m_b m_bᵀ,   m_b = H^(-1/2) (1 - H^(-1/2) H_b H^(-1/2))^(-1/2) H^(-1/2) s_b

where the middle makes up for what the fit takes away of a block that it follows, so that the mean is right if the model
is (CR2 of R. M. Bell and D. F. McCaffrey, Survey Methodology 28, 2002). Its rank is B at most, and a flight has few
blocks: so the correlations are those of H⁻¹, and each variance is the larger one of the two. Intervals are of Student's
t. A number that few blocks tell has few degrees of freedom, with c_b the diagonal of H⁻¹ H_b H⁻¹ ν = (Σ c_b)² / Σ c_b²;
the larger of a variance of ν degrees and one that is known scatters about half as much as the first, or a third where
they are alike, so it has 2 ν of them, and B - 1 at most.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.identification.evidence import Evidence, Uncertainty, bias_reduced, effective_blocks, of_blocks

# Step of a difference, of the scale of a number.
_STEP = 1e-5
_MOST_DAMPING = 1e9
# Of the largest singular value, less of which is none: of states that nothing measures.
_NOTHING = 1e-9
# Of a parameter, what other blocks tell at least: one that a single block tells has no interval from blocks.
_FOLLOWED = 1e-6

# Of (K, p) parameters and (K, W, s) initial states it makes (K, W, m) weighted residuals.
Residuals = Callable[[np.ndarray, np.ndarray], np.ndarray]


class Problem(NamedTuple):
    """What is fitted.

    Attributes:
        residuals: of parameters and initial states.
        scales: (p,) of parameters: by how much they may well differ.
        state_scales: (s,) of initial states.
        believed: (p,) parameters before the log was seen.
        beliefs: (p,) standard deviation of that.
        least: (p,) below which parameters make no sense.
    """

    residuals: Residuals
    scales: np.ndarray
    state_scales: np.ndarray
    believed: np.ndarray
    beliefs: np.ndarray
    least: np.ndarray


class Slopes(NamedTuple):
    """Residuals at a point and their derivatives.

    Attributes:
        residuals: (W, m).
        to_parameters: (W, m, p).
        to_states: (W, m, s).
    """

    residuals: np.ndarray
    to_parameters: np.ndarray
    to_states: np.ndarray

    def projected(self) -> tuple[np.ndarray, np.ndarray]:
        """(W, m) residuals and (W, m, p) slopes without what initial states can explain."""
        basis, sizes, _ = np.linalg.svd(self.to_states, full_matrices=False)
        basis = basis * (sizes > _NOTHING * sizes[:, :1])[:, None, :]
        both = np.concatenate([self.residuals[:, :, None], self.to_parameters], axis=2)
        rest = both - basis @ (np.swapaxes(basis, 1, 2) @ both)
        return rest[:, :, 0], rest[:, :, 1:]


class Fit(NamedTuple):
    """Where the sum of squares is least.

    Attributes:
        parameters: (p,).
        states: (W, s).
        slopes: there.
        converged: whether the last step changed next to nothing.
    """

    parameters: np.ndarray
    states: np.ndarray
    slopes: Slopes
    converged: bool


def slopes_at(problem: Problem, parameters: np.ndarray, states: np.ndarray) -> Slopes:
    """Residuals and their derivatives, by forward differences of all numbers at once."""
    p, s = len(parameters), states.shape[1]
    steps = _STEP * np.concatenate([problem.scales, problem.state_scales])
    many, starts = np.tile(parameters, (1 + p + s, 1)), np.tile(states, (1 + p + s, 1, 1))
    for i in range(p):
        many[1 + i, i] += steps[i]
    for i in range(s):
        starts[1 + p + i, :, i] += steps[p + i]
    found = problem.residuals(many, starts)
    slopes = np.moveaxis((found[1:] - found[0]) / steps[:, None, None], 0, -1)
    return Slopes(found[0], slopes[:, :, :p], slopes[:, :, p:])


def fit(
    problem: Problem, parameters: np.ndarray, states: np.ndarray, *, iterations: int = 40, tolerance: float = 1e-6
) -> Fit:
    """Finds parameters and initial states by Levenberg's and Marquardt's method.

    Args:
        problem: that is solved.
        parameters: (p,) to begin with.
        states: (W, s) to begin with.
        iterations: at most.
        tolerance: a step that lessens the sum of squares by a smaller share is the last.
    """
    damping, done = 1e-3, False
    at = slopes_at(problem, parameters, states)
    cost = _cost(problem, parameters, at.residuals)
    for _ in range(iterations):
        while damping < _MOST_DAMPING:
            step, change = _step(problem, parameters, at, damping)
            new_parameters, new_states = np.maximum(parameters + step, problem.least), states + change
            with np.errstate(all="ignore"):
                residuals = problem.residuals(new_parameters[None], new_states[None])[0]
                new_cost = _cost(problem, new_parameters, residuals)
            if new_cost <= cost:
                break
            damping *= 5.0
        else:
            return Fit(parameters, states, at, True)
        done = cost - new_cost < tolerance * cost and damping < 1.0
        parameters, states, cost = new_parameters, new_states, new_cost
        at = slopes_at(problem, parameters, states)
        damping = max(0.1 * damping, 1e-9)
        if done:
            break
    return Fit(parameters, states, at, done)


def _cost(problem: Problem, parameters: np.ndarray, residuals: np.ndarray) -> float:
    return float(np.sum(residuals**2) + np.sum(((parameters - problem.believed) / problem.beliefs) ** 2))


def _step(problem: Problem, parameters: np.ndarray, at: Slopes, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """The step of parameters and of states; those are eliminated."""
    J, X = at.to_parameters * problem.scales, at.to_states * problem.state_scales
    r, p = at.residuals[:, :, None], J.shape[2]
    XX = np.swapaxes(X, 1, 2) @ X
    own = np.einsum("wii->wi", XX)
    A = XX + np.eye(X.shape[2]) * (damping * own + 1e-12 * own.max())[:, None, :]
    inside = np.linalg.solve(A, np.swapaxes(X, 1, 2) @ np.concatenate([J, r], axis=2))
    XJ = np.swapaxes(X, 1, 2) @ J
    relative = problem.scales / problem.beliefs
    JJ = np.einsum("wmi,wmj->ij", J, J) + np.diag(relative**2)
    Jr = np.einsum("wmi,wm->i", J, at.residuals) + relative * (parameters - problem.believed) / problem.beliefs
    H = JJ - np.einsum("wsi,wsj->ij", XJ, inside[:, :, :p])
    g = Jr - np.einsum("wsi,ws->i", XJ, inside[:, :, p])
    step = -np.linalg.solve(H + damping * np.diag(np.diag(JJ)), g)
    change = -(inside[:, :, p] + inside[:, :, :p] @ step)
    return step * problem.scales, change * problem.state_scales


def evidence(fitted: Fit, names: Sequence[str], scales: np.ndarray, seconds: float) -> Evidence:
    """What windows say of parameters, with initial states that follow.

    Args:
        fitted: the solution of a problem.
        names: (p,) of the parameters.
        scales: (p,) by how much they may well be off.
        seconds: of all windows, s.
    """
    residuals, J = fitted.slopes.projected()
    information, scores = np.swapaxes(J, 1, 2) @ J, np.einsum("wmi,wm->wi", J, residuals)
    return Evidence(tuple(names), fitted.parameters, scales, information, scores, seconds)


def uncertainty(problem: Problem, fitted: Fit, blocks: np.ndarray) -> Uncertainty:
    """How sure the parameters are.

    Args:
        problem: that was solved.
        fitted: its solution.
        blocks: (W,) number of the block that each window is in; at least two different ones.
    """
    residuals, J = fitted.slopes.projected()
    J = J * problem.scales
    inverse = np.linalg.inv(np.einsum("wmi,wmj->ij", J, J) + np.diag((problem.scales / problem.beliefs) ** 2))
    scores = np.einsum("wmi,wm->wi", J, residuals)
    _, which = np.unique(blocks, return_inverse=True)
    information = of_blocks(np.swapaxes(J, 1, 2) @ J, which)
    sandwich = bias_reduced(information, of_blocks(scores, which), inverse, least=_FOLLOWED)
    larger = np.sqrt(np.maximum(1.0, np.diag(sandwich) / np.diag(inverse))) * problem.scales
    freedom = np.minimum(2.0 * effective_blocks(information, inverse), len(information) - 1.0)
    model = inverse * np.outer(problem.scales, problem.scales)
    return Uncertainty(inverse * np.outer(larger, larger), freedom, model)
