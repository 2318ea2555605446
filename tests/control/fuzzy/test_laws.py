"""Tests of learning laws, by comparison with matrix equations and with differential equations."""

import itertools
import math

import numpy as np
import pytest
import scipy

from drake_quad.control.fuzzy.inference import Antecedents, firing_strengths
from drake_quad.control.fuzzy.laws import CovarianceLaw, GradientLaw, LearningLimits, SignLaw, trace
from drake_quad.control.fuzzy.systems import LearningParameters, WeightLearning

TICK = 0.02  # s, period of a learning step


class Learner:
    """Network of n vehicles that learn a correction along x, with one law, from given firing strengths and signals."""

    def __init__(self, law, num_rules=9, n=1, *, limits=LearningLimits(), initial_weight=0.0, period=TICK):
        # The learning signal s_p is the rate of the error, since the slope λ is zero.
        parameters = LearningParameters(slope=0.0, law=law, limits=limits, initial_weight=initial_weight)
        self.learns_from = "feedback" if isinstance(law, SignLaw) else "surface"
        self.system = WeightLearning(
            num_vehicles=n,
            axes=("x",),
            num_rules=num_rules,
            learns_from=self.learns_from,
            period=period,
            parameters=parameters,
        )
        self.law, self.n = law, n
        self.begin()

    def begin(self):
        self.context = self.system.CreateDefaultContext()
        if self.learns_from == "surface":
            self._fix("error", np.zeros((3, self.n)))

    def _fix(self, name, rows):
        self.system.GetInputPort(name).FixValue(self.context, np.ravel(rows))

    def learn(self, firing, signal):
        """Learn for one period from firing strengths (R, n) and a signal (n,)."""
        self._fix("firing", firing)
        self._fix("error_rate" if self.learns_from == "surface" else "pd", [signal, 0.0 * signal, 0.0 * signal])
        self.context.SetDiscreteState(self.system.EvalUniquePeriodicDiscreteUpdate(self.context))

    @property
    def weights(self):
        """Return the current weights (R, n) of the R rules for n vehicles."""
        (rows,) = self.system.get_state(self.context, "weights")
        return np.reshape(rows, (-1, self.n))

    @property
    def memory(self):
        """Memory of the law (m, n)."""
        (rows,) = self.system.get_state(self.context, self.law.memory_name)
        return np.reshape(rows, (-1, self.n))

    @memory.setter
    def memory(self, rows):
        self.system.set_state(self.context, self.law.memory_name, (tuple(rows),))

    @property
    def P(self):
        """Covariances (n, R, R)."""
        return symmetric_matrices(self.memory)


def symmetric_matrices(memory):
    """Return the symmetric matrices (n, R, R) with the given upper triangles."""
    rows, n = memory.shape
    size = math.isqrt(2 * rows)
    P = np.zeros((n, size, size))
    i, j = np.triu_indices(size)
    P[:, i, j] = P[:, j, i] = memory.T
    return P


def upper_triangles(P):
    i, j = np.triu_indices(P.shape[-1])
    return P[:, i, j].T


def random_firing(rng, n):
    """Return random normalised firing strengths (9, n)."""
    return np.array(firing_strengths(rng.uniform(-1.2, 1.2, (2, n)), Antecedents()))


@pytest.mark.parametrize("n", [1, 3, 48, 200])
@pytest.mark.parametrize("size", [1, 2, 9, 12])
def test_a_tick_of_the_covariance_law_matches_the_matrix_equations(n, size):
    """Covariances and firing strengths are random, for one vehicle and for many."""
    rng = np.random.default_rng(n)
    half = rng.normal(size=(n, size, size))
    P, firing, signal = half @ half.transpose(0, 2, 1), rng.normal(size=(size, n)), rng.normal(size=n)
    learner = Learner(CovarianceLaw(0.8), size, n)
    learner.memory = upper_triangles(P)
    np.testing.assert_allclose(trace(tuple(upper_triangles(P))), np.trace(P, axis1=1, axis2=2), rtol=1e-12)
    learner.learn(firing, signal)
    g = np.einsum("nij,jn->in", P, firing)
    c = np.einsum("in,in->n", firing, g)
    expected = P - (TICK / (1.0 + TICK * c))[:, None, None] * np.einsum("in,jn->nij", g, g)
    np.testing.assert_allclose(learner.P, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(learner.weights, -0.8 * signal * g * np.log1p(TICK * c) / c, rtol=1e-11, atol=1e-13)


@pytest.mark.long
@pytest.mark.parametrize(
    ("initial", "n"), [(1e-2, 5), (1.0, 5), (1.0, 100), (1e2, 5), (1e4, 5), (1e6, 5)], ids=lambda value: f"{value:g}"
)
def test_the_covariance_stays_positive_definite_and_decreases(initial, n):
    """The inverse of the covariance grows by the integral of the outer products of the firing strengths."""
    rng = np.random.default_rng(1)
    law = CovarianceLaw(gain=1.0, initial_covariance=initial)
    learner, information = Learner(law, n=n), np.zeros((n, 9, 9))
    before = learner.P
    for _ in range(400):
        firing = random_firing(rng, n)
        learner.learn(firing, rng.normal(size=n))
        information += TICK * np.einsum("in,jn->nij", firing, firing)
        P = learner.P
        assert np.linalg.eigvalsh(P).min() > 0.0
        assert np.linalg.eigvalsh(before - P).min() > -1e-12 * initial
        before = P
    accumulated = np.linalg.inv(P) - np.eye(9) / initial
    tolerance = 1e-9 if initial <= 1e4 else 1e-7
    np.testing.assert_allclose(accumulated, information, atol=tolerance * np.abs(information).max())


def signals_at(t):
    """Return the firing strengths and the learning signal s_p at a time. The inputs move through all sets."""
    firing = np.array(firing_strengths((0.9 * math.sin(1.3 * t), 0.8 * math.cos(0.7 * t)), Antecedents()))
    return firing, math.sin(0.9 * t) + 0.3


@pytest.mark.long
def test_the_sampled_law_converges_to_the_differential_equations():
    """An integrator of order 8 solves eqs (16) and (17). Half the period gives half the error."""
    gain, initial, duration = 0.7, 20.0, 4.0

    def slope(t, y):
        P, (firing, surface) = y[9:].reshape(9, 9), signals_at(t)
        g = P @ firing
        return np.concatenate([-gain * surface * g, -np.outer(g, g).ravel()])

    start = np.concatenate([np.zeros(9), (initial * np.eye(9)).ravel()])
    exact = scipy.integrate.solve_ivp(slope, (0.0, duration), start, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    errors = []
    for period in (0.005, 0.0025, 0.00125):
        learner = Learner(CovarianceLaw(gain, initial), period=period)
        for tick in range(round(duration / period)):
            firing, surface = signals_at(tick * period)
            learner.learn(firing, np.array([surface]))
        errors.append(
            [np.abs(learner.weights[:, 0] - exact[:9]).max(), np.abs(learner.P[0] - exact[9:].reshape(9, 9)).max()]
        )
    for coarse, fine in itertools.pairwise(errors):
        np.testing.assert_allclose(np.array(coarse) / np.array(fine), 2.0, atol=0.1)
    assert errors[-1][0] < 0.01 * np.abs(exact[:9]).max()


@pytest.mark.parametrize("initial", [1.0, 1e6])
def test_one_long_tick_with_constant_inputs_equals_many_short_ticks(initial):
    """One tick of 0.64 s gives the same result as 64 ticks of 0.01 s."""
    rng = np.random.default_rng(5)
    firing, surface = random_firing(rng, 4), rng.normal(size=4)
    results = []
    for ticks in (1, 64):
        learner = Learner(CovarianceLaw(0.5, initial), n=4, period=0.64 / ticks)
        for _ in range(ticks):
            learner.learn(firing, surface)
        results.append((learner.weights, learner.memory))
    np.testing.assert_allclose(results[0][0], results[1][0], rtol=1e-8)
    np.testing.assert_allclose(results[0][1], results[1][1], rtol=1e-8, atol=1e-9 * initial)


@pytest.mark.long
def test_forgetting_keeps_the_covariance_bounded_and_away_from_zero():
    rng = np.random.default_rng(2)
    ticks, n = 2000, 60
    firing = np.stack([random_firing(rng, n) for _ in range(ticks)])
    traces = {}
    for forgetting in (1.0, 0.999, 0.9):
        learner, path = Learner(CovarianceLaw(1.0, 5.0, forgetting), n=n), []
        for w in firing:
            learner.learn(w, np.zeros(n))
            path.append(np.trace(learner.P, axis1=1, axis2=2).max())
        assert np.linalg.eigvalsh(learner.P).min() > 0.0
        assert max(path) <= 45.0 * (1.0 + 1e-12)
        traces[forgetting] = path[-1]
    assert 2.0 * traces[1.0] < traces[0.999] < traces[0.9]
    # The covariance grows back to its initial value, and stays there, while no rule fires.
    learner = Learner(CovarianceLaw(1.0, 5.0, 0.99))
    learner.memory = 1e-3 * learner.memory[:, 0]
    for _ in range(2500):
        learner.learn(np.full(9, 1e-9), np.zeros(1))
    assert np.trace(learner.P[0]) == pytest.approx(45.0, rel=1e-6)


def test_the_gradient_law_has_a_constant_covariance():
    rng = np.random.default_rng(4)
    firing, surface = random_firing(rng, 3), rng.normal(size=3)
    learner = Learner(GradientLaw(2.5), n=3)
    learner.learn(firing, surface)
    np.testing.assert_allclose(learner.weights, -TICK * 2.5 * firing * surface)


def test_under_the_sign_law_the_correction_changes_at_the_rate_alpha():
    rng = np.random.default_rng(4)
    law = SignLaw(rate=0.5, initial_slope=0.2)
    command = np.array([0.3, -0.4, 0.0])
    learner = Learner(law, n=3)
    firing = random_firing(rng, 3)
    learner.learn(firing, command)
    # The correction changes at the rate α against the sign of the command, for any firing strengths.
    np.testing.assert_allclose((firing * learner.weights).sum(axis=0), [-0.2 * TICK, 0.2 * TICK, 0.0], atol=1e-15)
    np.testing.assert_allclose(learner.memory[0], 0.2 + 2.0 * 0.5 * TICK * np.abs(command))


def test_weights_stay_within_the_learning_limits():
    rng = np.random.default_rng(6)
    firing = random_firing(rng, 2)

    def weights_after(law, limits, signal):
        learner = Learner(law, n=2, limits=limits, initial_weight=0.5)
        learner.learn(firing, np.array(signal))
        return learner.weights

    weights = weights_after(GradientLaw(100.0), LearningLimits(weight=0.6), [-5.0, 5.0])
    assert weights.max() == 0.6
    assert weights.min() == -0.6
    np.testing.assert_array_equal(weights_after(GradientLaw(1.0), LearningLimits(deadzone=0.1), [0.09, -0.09]), 0.5)
    np.testing.assert_allclose(
        weights_after(GradientLaw(1.0), LearningLimits(leakage=2.0), [0.0, 0.0]), 0.5 * math.exp(-2.0 * TICK)
    )


@pytest.mark.long
def test_a_constant_disturbance_is_learned_at_the_predicted_rate():
    """The error falls as t^(-K_D λ / k_P) for one rule with firing strength 1, because P = 1 / t."""
    k_p, k_d, slope, gain, h, disturbance = 2.0, 2.5, 1.0, 1.5, 0.02, 0.4
    learner = Learner(CovarianceLaw(gain, 1.0), 1, period=h)
    one = np.ones(1)
    A = np.array([[1.0, h], [0.0, 1.0]])
    B = np.array([0.5 * h * h, h])
    x, times, errors = np.zeros(2), [], []
    for tick in range(round(300.0 / h)):
        e, rate = -x
        command = k_p * e + k_d * rate - learner.weights[0, 0]
        learner.learn(one, np.array([rate + slope * e]))
        x = A @ x + B * (command + disturbance)
        if tick * h > 100.0:
            times.append(tick * h)
            errors.append(abs(e))
    exponent = np.polyfit(np.log(times), np.log(errors), 1)[0]
    assert exponent == pytest.approx(-gain * slope / k_p, rel=0.03)


@pytest.mark.parametrize("law", [CovarianceLaw(0.9, 3.0, 0.99), GradientLaw(0.7), SignLaw(0.3, 0.2)])
def test_a_vehicle_in_a_large_fleet_learns_like_a_single_vehicle(law):
    """Learning is limited by a dead zone and leakage, and by a limit of the weights that some vehicles reach."""
    n, limits, rng = 150, LearningLimits(weight=0.4, deadzone=0.1, leakage=0.3), np.random.default_rng(5)
    firing, signal = random_firing(rng, n), rng.normal(size=n)
    fleet, alone = Learner(law, n=n, limits=limits, period=0.5), Learner(law, limits=limits, period=0.5)
    for _ in range(3):
        fleet.learn(firing, signal)
    for i in range(n):
        alone.begin()
        for _ in range(3):
            alone.learn(firing[:, i], signal[[i]])
        np.testing.assert_allclose(fleet.weights[:, [i]], alone.weights, rtol=1e-10, atol=1e-12)
        if law.memory(9):
            np.testing.assert_allclose(fleet.memory[:, [i]], alone.memory, rtol=1e-10, atol=1e-12)
    assert 0 < np.sum(np.abs(fleet.weights) == 0.4) < fleet.weights.size


def test_learning_laws_have_unit_gains_and_no_limits_by_default():
    assert (CovarianceLaw(), GradientLaw(), SignLaw()) == ((1.0, 1.0, 1.0), (1.0,), (1.0, 0.0))
    assert LearningLimits() == (np.inf, 0.0, 0.0)
