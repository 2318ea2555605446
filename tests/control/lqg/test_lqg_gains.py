"""Tests of the models and gains of linear-quadratic-Gaussian control, by python-control, SciPy and closed forms."""

import numpy as np
import pytest
import scipy.signal

from drake_quad.control.lqg.chains import (
    ChainNoise,
    Disturbances,
    SecondOrderResponse,
    attitude_model,
    discretise,
    discretise_noise,
    torque_model,
    vertical_model,
)
from drake_quad.control.lqg.design import (
    Timing,
    augment_with_delay,
    axis_loop,
    kalman_gain,
    regulator_gain,
)

DISTURBANCES = Disturbances(
    first=ChainNoise(deviation=0.3, time=0.25),
    second=ChainNoise(deviation=0.8, time=0.6),
    bias=ChainNoise(deviation=12.0, time=20.0),
    command_noise=2.0,
)
VERTICAL_DISTURBANCES = DISTURBANCES._replace(bias=None)
MODELS = {
    "torque": torque_model(0.04, DISTURBANCES),
    "attitude": attitude_model(SecondOrderResponse(natural_frequency=9.0, damping=0.6), DISTURBANCES),
    "vertical": vertical_model(0.07, VERTICAL_DISTURBANCES),
}
for_each_model = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
H = 0.01  # s, camera frame
TICK = 0.02  # s, control tick


@for_each_model
def test_a_discretised_model_matches_scipy(model):
    A, B = discretise(model.A, model.B, TICK)
    expected, forced, *_ = scipy.signal.cont2discrete((model.A, model.B, model.C, np.zeros((len(model.C), 1))), TICK)
    np.testing.assert_allclose(A, expected, atol=1e-12)
    np.testing.assert_allclose(B, forced, atol=1e-12)


@for_each_model
def test_discrete_noise_covariance_is_the_integral_of_propagated_white_noise(model):
    nodes, weights = np.polynomial.legendre.leggauss(20)
    parts = [discretise(model.A, model.B, 0.5 * TICK * (1.0 + node))[0] for node in nodes]
    expected = sum(0.5 * TICK * w * part @ model.Q @ part.T for w, part in zip(weights, parts, strict=True))
    np.testing.assert_allclose(discretise_noise(model.A, model.Q, TICK), expected, rtol=1e-9, atol=1e-12)


def test_discretised_noise_of_a_fast_mode_agrees_with_the_stationary_covariance():
    """The time constant of the fast mode is a thousandth of the period."""
    A, Q = np.array([[-2000.0, 500.0], [0.0, -1.0]]), np.diag([3.0, 0.5])
    P = scipy.linalg.solve_continuous_lyapunov(A, -Q)
    transition, _ = discretise(A, np.zeros((2, 1)), 0.5)
    np.testing.assert_allclose(discretise_noise(A, Q, 0.5), P - transition @ P @ transition.T, rtol=1e-9)


@for_each_model
def test_coloured_noise_has_the_given_deviation_and_time_constant(model):
    """The autocorrelations of first and second order are exp(-τ/T) and (1 + τ/T) exp(-τ/T)."""
    names = [*model.kind._fields]
    noisy = [i for i, name in enumerate(names) if name in ("first", "second", "second_rate", "bias")]
    A = model.A[np.ix_(noisy, noisy)]
    Q = discretise_noise(A, np.diag(np.diag(model.Q)[noisy]), H)
    P = scipy.linalg.solve_discrete_lyapunov(discretise(A, np.zeros((len(A), 1)), H)[0], Q)
    later = discretise(A, np.zeros((len(A), 1)), 0.2)[0] @ P
    decays = {"first": np.exp(-0.2 / 0.25), "second": (1.0 + 0.2 / 0.6) * np.exp(-0.2 / 0.6), "bias": np.exp(-0.01)}
    deviations = {"first": 0.3, "second": 0.8, "bias": 12.0}
    for index, i in enumerate(noisy):
        if names[i] in decays:
            assert P[index, index] == pytest.approx(deviations[names[i]] ** 2)
            assert later[index, index] == pytest.approx(deviations[names[i]] ** 2 * decays[names[i]])


@for_each_model
def test_filter_and_regulator_gains_match_python_control(model):
    import control

    A, _ = discretise(model.A, model.B, H)
    Q, R = discretise_noise(model.A, model.Q, H), np.diag([1e-6, 1e-3])[: len(model.C), : len(model.C)]
    # dlqe returns the prediction gain: A times the correction gain.
    expected, *_ = control.dlqe(A, np.eye(len(A)), model.C, Q, R)
    np.testing.assert_allclose(A @ kalman_gain(A, model.C, Q, R), expected, rtol=1e-6)
    over_tick = augment_with_delay(*discretise(model.A, model.B, TICK), 2)
    weight = np.diag(np.arange(1.0, len(over_tick[0]) + 1.0))
    expected, *_ = control.dlqr(*over_tick, weight, [[0.3]])
    gain, _ = regulator_gain(*over_tick, weight, np.eye(1) * 0.3)
    np.testing.assert_allclose(gain, expected, rtol=1e-6)


def test_the_kalman_gain_gives_the_smallest_error_variance():
    """If the gain is changed by 5 % in either direction, the error variance is larger."""
    model = MODELS["torque"]
    A, _ = discretise(model.A, model.B, H)
    Q, R = discretise_noise(model.A, model.Q, H), np.diag([1e-6, 2e-3])
    L = kalman_gain(A, model.C, Q, R)

    def variance(gain):
        corrected = np.eye(len(A)) - gain @ model.C
        P = scipy.linalg.solve_discrete_lyapunov(corrected @ A, corrected @ Q @ corrected.T + gain @ R @ gain.T)
        return P[0, 0]

    assert all(variance(factor * L) > variance(L) * (1.0 + 1e-6) for factor in (0.95, 1.05))


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_commands_in_transit_act_after_the_delay(delay):
    model = MODELS["vertical"]
    A, B = discretise(model.A, model.B, TICK)
    augmented = augment_with_delay(A, B, delay)
    commands = np.random.default_rng(0).normal(size=12)
    x, z = np.zeros((len(A), 1)), np.zeros((len(A) + delay, 1))
    for tick, u in enumerate(commands):
        x = A @ x + B * (commands[tick - delay] if tick >= delay else 0.0)
        z = augmented[0] @ z + augmented[1] * u
        np.testing.assert_allclose(z[: len(A)], x, atol=1e-14)
        np.testing.assert_array_equal(z[len(A) :].ravel(), np.r_[np.zeros(delay), commands[: tick + 1]][-delay or 99 :])


def test_the_equilibrium_thrust_is_the_position_gain_divided_by_the_outer_gain():
    """In equilibrium, a position deviation p causes the specific thrust -K_p p / k, where k is the outer gain."""
    timing = Timing(H, TICK, 2)
    for name, noise in (("torque", [1e-3, 0.02]), ("attitude", [1e-3, 0.02]), ("vertical", [1e-3])):
        model = MODELS[name]
        loop = axis_loop(model, timing, noise=np.array(noise), command_weight=1e-3)
        # In equilibrium, the state x and the command u satisfy K [x; u, u] + u = 0. If u commands an attitude or a
        # thrust, it equals the specific thrust s. If u commands a torque, it is zero.
        s, p = 1.0, 0.7
        u = 0.0 if name == "torque" else s
        rest = loop.K.position * p + loop.K.thrust * s + sum(loop.K_pending) * u + u
        if name == "torque":
            assert loop.outer_divisor == loop.K.thrust
        assert rest == pytest.approx(loop.K.position * p + loop.outer_divisor * s)
        (slope,) = model.A[[model.kind._fields.index("thrust" if name == "vertical" else "jerk")]]
        drive = model.B[model.kind._fields.index("thrust" if name == "vertical" else "jerk")].item()
        assert slope[model.kind._fields.index("thrust")] * s + drive * u == pytest.approx(0.0, abs=1e-12)


def test_the_shipped_design_gives_the_recorded_gains():
    """The gains that the search found were recorded with four digits."""
    lateral = torque_model(
        0.05, Disturbances(ChainNoise(0.01108, 0.25), ChainNoise(0.8325, 0.6), ChainNoise(16.6, 20.0), 3.296)
    )
    noise = np.array([1e-3, 0.001331 * 9.81])
    loop = axis_loop(lateral, Timing(H, TICK, 2), noise=noise, command_weight=9.049e-6)
    np.testing.assert_allclose(loop.K, [297.4, 210.8, 74.72, 16.23, 0.6492, 35.48, 70.04, 10.25, 2.112], rtol=1e-3)
    np.testing.assert_allclose(loop.K_pending, [0.2470, 0.2225], rtol=1e-3)
    position, _ = loop.L
    expected = [0.2795, 4.573, 0.0105, -0.475, -5.77, 0.0439, 41.98, 151.5, -1.237]
    np.testing.assert_allclose(position, expected, rtol=1e-2)
