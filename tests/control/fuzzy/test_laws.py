"""Laws of learning, against matrices and differential equations."""

import itertools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from drake_quad.control.fuzzy.inference import Antecedents, firing_strengths
from drake_quad.control.fuzzy.laws import CovarianceLaw, GradientLaw, Limits, SignLaw
from drake_quad.control.fuzzy.laws import LEARNING, covariance_times, subtract_square, trace

H = 0.02


def square(memory, size):
    """(n, R, R) matrices of upper triangles."""
    n = memory.shape[1]
    P = np.zeros((n, size, size))
    rows, columns = np.triu_indices(size)
    P[:, rows, columns] = P[:, columns, rows] = memory.T
    return P


def triangles(P):
    rows, columns = np.triu_indices(P.shape[-1])
    return np.ascontiguousarray(P[:, rows, columns].T)


def started(law, num_rules, n):
    """Weights and memory at the beginning."""
    memory = np.array([np.broadcast_to(row, n) for row in law.memory(num_rules)], dtype=float).reshape(-1, n)
    return np.zeros((num_rules, n)), memory


def learn(law, limits, weights, memory, firing, signal, period):
    """Learning on X alone by a law that is the same for all vehicles, from a signal as it is."""
    parameters = np.array([0.0, *law, *limits])[:, None]
    signals = np.zeros((3, len(signal)))
    signals[0] = signal
    arrays = [array.ravel() for array in (weights, memory, firing, signals, signals)]
    assert np.shares_memory(arrays[0], weights)
    LEARNING[law.__class__](*arrays, parameters, np.array([0]), len(firing), period)


def strengths(rng, n):
    """(9, n) firing strengths somewhere."""
    return np.array(firing_strengths(rng.uniform(-1.2, 1.2, n), rng.uniform(-1.2, 1.2, n), Antecedents()))


@pytest.mark.parametrize("n", [1, 3, 47, 48, 200])
@pytest.mark.parametrize("size", [1, 2, 9, 12])
def test_the_triangle_is_the_matrix(n, size):
    """For few channels and for many, which are computed in different orders."""
    rng = np.random.default_rng(n)
    half = rng.normal(size=(n, size, size))
    P, g, factor = half @ half.transpose(0, 2, 1), rng.normal(size=(size, n)), rng.uniform(0.1, 1.0, n)
    memory = triangles(P)
    np.testing.assert_allclose(covariance_times(memory, g, 0, n), np.einsum("nij,jn->in", P, g), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(trace(memory, size), np.trace(P, axis1=1, axis2=2), rtol=1e-12)
    subtract_square(memory, g, factor, 0)
    expected = P - factor[:, None, None] * np.einsum("in,jn->nij", g, g)
    np.testing.assert_allclose(square(memory, size), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("initial", [1e-2, 1.0, 1e2, 1e4, 1e6])
@pytest.mark.parametrize("n", [5, 100])
def test_the_covariance_stays_one(initial, n):
    """Positive definite and decreasing, and its inverse is the sum of all that was seen."""
    rng = np.random.default_rng(1)
    law = CovarianceLaw(gain=1.0, initial_covariance=initial)
    weights, memory = started(law, 9, n)
    information = np.zeros((n, 9, 9))
    before = square(memory, 9)
    for _ in range(400):
        firing = strengths(rng, n)
        learn(law, Limits(), weights, memory, firing, rng.normal(size=n), H)
        information += H * np.einsum("in,jn->nij", firing, firing)
        P = square(memory, 9)
        assert np.linalg.eigvalsh(P).min() > 0.0
        assert np.linalg.eigvalsh(before - P).min() > -1e-12 * initial
        before = P
    seen = np.linalg.inv(P) - np.eye(9) / initial
    tolerance = 1e-9 if initial <= 1e4 else 1e-7
    np.testing.assert_allclose(seen, information, atol=tolerance * np.abs(information).max())


def signals(t):
    """A firing strength, which moves through the sets, and s_p at a time."""
    firing = np.array(firing_strengths(0.9 * math.sin(1.3 * t), 0.8 * math.cos(0.7 * t), Antecedents()))
    return firing, math.sin(0.9 * t) + 0.3


def test_the_sampled_law_converges_to_the_differential_equations():
    """(16) and (17) by an integrator of order 8: half the period, half the error."""
    gain, initial, duration = 0.7, 20.0, 4.0

    def slope(t, y):
        P, (firing, surface) = y[9:].reshape(9, 9), signals(t)
        g = P @ firing
        return np.concatenate([-gain * surface * g, -np.outer(g, g).ravel()])

    start = np.concatenate([np.zeros(9), (initial * np.eye(9)).ravel()])
    exact = solve_ivp(slope, (0.0, duration), start, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    errors = []
    for period in (0.005, 0.0025, 0.00125):
        law = CovarianceLaw(gain, initial)
        weights, memory = started(law, 9, 1)
        for tick in range(round(duration / period)):
            firing, surface = signals(tick * period)
            learn(law, Limits(), weights, memory, firing[:, None], np.array([surface]), period)
        errors.append(
            [np.abs(weights[:, 0] - exact[:9]).max(), np.abs(square(memory, 9)[0] - exact[9:].reshape(9, 9)).max()]
        )
    for coarse, fine in itertools.pairwise(errors):
        np.testing.assert_allclose(np.array(coarse) / np.array(fine), 2.0, atol=0.1)
    assert errors[-1][0] < 0.01 * np.abs(exact[:9]).max()


@pytest.mark.parametrize("initial", [1.0, 1e6])
def test_while_nothing_changes_a_tick_is_exact(initial):
    """One long period is as good as many short ones."""
    rng = np.random.default_rng(5)
    firing, surface = strengths(rng, 4), rng.normal(size=4)
    found = []
    for ticks in (1, 64):
        law = CovarianceLaw(0.5, initial)
        weights, memory = started(law, 9, 4)
        for _ in range(ticks):
            learn(law, Limits(), weights, memory, firing, surface, 0.64 / ticks)
        found.append((weights, memory))
    np.testing.assert_allclose(found[0][0], found[1][0], rtol=1e-8)
    np.testing.assert_allclose(found[0][1], found[1][1], rtol=1e-8, atol=1e-9 * initial)


def test_forgetting_keeps_the_covariance_alive_and_bounded():
    rng = np.random.default_rng(2)
    ticks, n = 2000, 60
    traces = {}
    for forgetting in (1.0, 0.999, 0.9):
        law = CovarianceLaw(1.0, 5.0, forgetting)
        weights, memory = started(law, 9, n)
        path = []
        for _ in range(ticks):
            learn(law, Limits(), weights, memory, strengths(rng, n), np.zeros(n), H)
            path.append(trace(memory, 9).max())
        assert np.linalg.eigvalsh(square(memory, 9)).min() > 0.0
        assert max(path) <= 45.0 * (1.0 + 1e-12)
        traces[forgetting] = path[-1]
    assert 2.0 * traces[1.0] < traces[0.999] < traces[0.9]
    # Where nothing fires, it grows back to what it was, and stays there.
    law = CovarianceLaw(1.0, 5.0, 0.99)
    weights, memory = started(law, 9, 1)
    memory *= 1e-3
    for _ in range(5000):
        learn(law, Limits(), weights, memory, np.full((9, 1), 1e-9), np.zeros(1), H)
    assert trace(memory, 9)[0] == pytest.approx(45.0, rel=1e-6)


def test_the_gradient_law_is_a_constant_covariance():
    rng = np.random.default_rng(4)
    firing, surface = strengths(rng, 3), rng.normal(size=3)
    weights, memory = started(GradientLaw(2.5), 9, 3)
    learn(GradientLaw(2.5), Limits(), weights, memory, firing, surface, H)
    np.testing.assert_allclose(weights, -H * 2.5 * firing * surface)


def test_the_sign_law():
    rng = np.random.default_rng(4)
    law = SignLaw(rate=0.5, initial_slope=0.2)
    command = np.array([0.3, -0.4, 0.0])
    weights, memory = started(law, 9, 3)
    firing = strengths(rng, 3)
    learn(law, Limits(), weights, memory, firing, command, H)
    # WᵀΔF is the change of the correction: by α against the command, whatever the strengths.
    np.testing.assert_allclose((firing * weights).sum(axis=0), [-0.2 * H, 0.2 * H, 0.0], atol=1e-15)
    np.testing.assert_allclose(memory[0], 0.2 + 2.0 * 0.5 * H * np.abs(command))


def test_limits():
    rng = np.random.default_rng(6)
    firing = strengths(rng, 2)
    weights = np.full((9, 2), 0.5)
    none = np.empty((0, 2))
    learn(GradientLaw(100.0), Limits(weight=0.6), weights, none, firing, np.array([-5.0, 5.0]), H)
    assert weights.max() == 0.6
    assert weights.min() == -0.6
    weights = np.full((9, 2), 0.5)
    learn(GradientLaw(1.0), Limits(deadzone=0.1), weights, none, firing, np.array([0.09, -0.09]), H)
    np.testing.assert_array_equal(weights, 0.5)
    learn(GradientLaw(1.0), Limits(leakage=2.0), weights, none, firing, np.zeros(2), H)
    np.testing.assert_allclose(weights, 0.5 * math.exp(-2.0 * H))


def test_a_constant_disturbance_is_learned_at_the_predicted_rate():
    """One rule, W = 1, on a double integrator: e falls as t^(-K_D λ / k_P), as P = 1 / t makes it."""
    k_p, k_d, slope, gain, h, disturbance = 2.0, 2.5, 1.0, 1.5, 0.02, 0.4
    law = CovarianceLaw(gain, 1.0)
    weights, memory = started(law, 1, 1)
    one = np.ones((1, 1))
    A = np.array([[1.0, h], [0.0, 1.0]])
    B = np.array([0.5 * h * h, h])
    x, times, errors = np.zeros(2), [], []
    for tick in range(round(600.0 / h)):
        e, rate = -x
        command = k_p * e + k_d * rate - weights[0, 0]
        learn(law, Limits(), weights, memory, one, np.array([rate + slope * e]), h)
        x = A @ x + B * (command + disturbance)
        if tick * h > 100.0:
            times.append(tick * h)
            errors.append(abs(e))
    exponent = np.polyfit(np.log(times), np.log(errors), 1)[0]
    assert exponent == pytest.approx(-gain * slope / k_p, rel=0.03)


@pytest.mark.parametrize("law", [CovarianceLaw(0.9, 3.0, 0.99), GradientLaw(0.7), SignLaw(0.3, 0.2)])
def test_a_vehicle_learns_as_it_would_alone_wherever_it_is_in_a_large_fleet(law):
    """On X, with a dead zone, a leakage and a limit that some are at."""
    n, limits, rng = 150, Limits(weight=0.4, deadzone=0.1, leakage=0.3), np.random.default_rng(5)
    firing, signal, (weights, memory) = strengths(rng, n), rng.normal(size=n), started(law, 9, n)
    lone = [[array[:, [i]].copy() for array in (weights, memory, firing)] for i in range(n)]
    for _ in range(3):
        learn(law, limits, weights, memory, firing, signal, 0.5)
    for i, (own_weights, own_memory, own_firing) in enumerate(lone):
        for _ in range(3):
            learn(law, limits, own_weights, own_memory, own_firing, signal[[i]], 0.5)
        np.testing.assert_allclose(weights[:, [i]], own_weights, rtol=1e-10, atol=1e-12)
        np.testing.assert_allclose(memory[:, [i]], own_memory, rtol=1e-10, atol=1e-12)
    assert 0 < np.sum(np.abs(weights) == 0.4) < weights.size


def test_laws_that_are_told_nothing():
    """Unit gains, and no limits."""
    assert (CovarianceLaw(), GradientLaw(), SignLaw()) == ((1.0, 1.0, 1.0), (1.0,), (1.0, 0.0))
    assert Limits() == (np.inf, 0.0, 0.0)
