"""Tests of laws that estimate disturbances, by comparison with other implementations and published results."""

import math

import numpy as np
import pytest
import scipy

from drake_quad.control.disturbance.laws import (
    AdaptiveLaw,
    AxisMeasurement,
    DifferencedMemory,
    IncrementalLaw,
    KalmanLaw,
    ModelIncrement,
)
from drake_quad.control.disturbance.response import AxisCommand, lag_step, response_step

H = 0.02  # s, control tick


def test_a_lag_and_its_integrals_solve_the_differential_equation():
    lag, before, target = 0.07, 1.3, -0.4
    slope = np.array([[0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, -1.0 / lag, 1.0 / lag], [0.0] * 4])
    distance, speed, after, _ = scipy.linalg.expm(H * slope) @ [0.0, 0.0, before, target]
    assert lag_step(before, target, lag, H) == pytest.approx((after, speed, distance), rel=1e-12)


def test_the_response_to_feed_forward_has_a_separate_lag():
    after, speed, distance = response_step(AxisCommand(0.3, -0.2), AxisCommand(1.1, 0.7), AxisCommand(0.2, 0.05), H)
    one, other = lag_step(0.3, 1.1, 0.2, H), lag_step(-0.2, 0.7, 0.05, H)
    assert after == (one.after, other.after)
    assert (speed, distance) == pytest.approx((one.speed + other.speed, one.distance + other.distance))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("deviation", "time_constant", "noise"), [(0.3, 0.5, 1e-3), (1.7, 60.0, 0.02), (0.01, 2.0, 0.1)]
)
def test_the_kalman_gain_matches_python_control(deviation, time_constant, noise):
    """python-control's `dlqe` returns the prediction gain A L. It requires the discrete-time noise covariance."""
    import control

    law = KalmanLaw.of(deviation=deviation, time_constant=time_constant, position_noise=noise, period=H)
    slope = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / time_constant]])
    A = scipy.linalg.expm(H * slope)

    def noise_rate(s):
        column = scipy.linalg.expm(s * slope)[:, 2]
        return 2.0 * deviation**2 / time_constant * np.outer(column, column)

    Q, _ = scipy.integrate.quad_vec(noise_rate, 0.0, H)
    AL, _, poles = control.dlqe(A, np.eye(3), np.array([[1.0, 0.0, 0.0]]), Q, [[noise**2]])
    np.testing.assert_allclose(A @ law.gain, AL.ravel(), rtol=1e-6)
    assert np.abs(poles).max() < 1.0


def test_the_kalman_filter_is_faster_for_less_noise_and_larger_disturbances():
    parameters = {"deviation": 0.3, "time_constant": 0.5, "position_noise": 1e-3, "period": H}
    gain = KalmanLaw.of(**parameters).gain.disturbance
    assert KalmanLaw.of(**parameters | {"position_noise": 1e-2}).gain.disturbance < gain
    assert KalmanLaw.of(**parameters | {"deviation": 1.0}).gain.disturbance > gain
    # The gain depends only on the ratio of disturbance to noise.
    tenfold = KalmanLaw.of(**parameters | {"deviation": 3.0, "position_noise": 1e-2})
    np.testing.assert_allclose(tenfold.gain, KalmanLaw.of(**parameters).gain, rtol=1e-9)


def estimates(law, disturbances, accelerations, *, start=0.0):
    """Return the estimates of a law at the end of each tick, for v' = a + d with constant a and d, without noise."""
    position, velocity, memory, values = start, 0.0, law.initial_memory(start), []
    for a, d in zip(accelerations, disturbances, strict=True):
        memory = law.correct(memory, AxisMeasurement(position, velocity), H)
        memory = law.predict(memory, ModelIncrement(H * a, 0.5 * H * H * a), H)
        position += H * velocity + 0.5 * H * H * (a + d)
        velocity += H * (a + d)
        values.append(law.correct(memory, AxisMeasurement(position, velocity), H).disturbance)
    return np.array(values)


RNG = np.random.default_rng(0)
MODELLED_ACCELERATIONS = RNG.normal(size=60)  # m/s², one for each tick


def test_l1_agrees_with_the_published_continuous_time_law():
    """SciPy integrates the state predictor. As in the papers, the adaptation acts only at the ticks."""
    a_s, bandwidth, disturbances = 7.0, 3.0, RNG.normal(size=60)
    sigma, filtered, v, v_hat, expected = 0.0, 0.0, 0.0, 0.0, []
    for a, d in zip(MODELLED_ACCELERATIONS, disturbances, strict=True):

        def slope(_, state, a=a, d=d, sigma=sigma):
            v, v_hat = state
            return [a + d, a + sigma - a_s * (v_hat - v)]

        v, v_hat = scipy.integrate.solve_ivp(slope, (0.0, H), (v, v_hat), rtol=1e-10, atol=1e-12).y[:, -1]
        # σ̂(kT) = -Φ⁻¹(T) μ(kT), Φ = A_s⁻¹ (exp(A_s T) - 1), μ = exp(A_s T) ṽ(kT), with A_s = -a_s
        sigma = -math.exp(-a_s * H) * (v_hat - v) / ((math.exp(-a_s * H) - 1.0) / -a_s)
        filtered += (1.0 - math.exp(-bandwidth * H)) * (sigma - filtered)
        expected.append(filtered)
    np.testing.assert_allclose(
        estimates(AdaptiveLaw(a_s, bandwidth), disturbances, MODELLED_ACCELERATIONS), expected, atol=1e-8
    )


def test_l1_with_slow_predictor_and_fast_filter_estimates_the_last_disturbance():
    disturbances = RNG.normal(size=60)
    np.testing.assert_allclose(
        estimates(AdaptiveLaw(1e-9, 1e9), disturbances, MODELLED_ACCELERATIONS), disturbances, atol=1e-6
    )


@pytest.mark.parametrize("frequency", [0.7, 2.0, 9.0])
def test_l1_compensates_the_disturbance_after_a_low_pass_filter(frequency):
    """The command is u = -C(s) d with C(i Ω) = ω / (i Ω + ω) for fast ticks and a slow predictor."""
    bandwidth, h = 2.0, 1e-3
    law, time = AdaptiveLaw(1e-6, bandwidth), h * np.arange(20_000)
    memory, velocities, values = law.initial_memory(0.0), (1.0 - np.cos(frequency * time)) / frequency, []
    for velocity in velocities:
        memory = law.correct(memory, AxisMeasurement(0.0, velocity), h)
        values.append(memory.disturbance)
    waves = np.column_stack([np.sin(frequency * time), np.cos(frequency * time)])[10_000:]
    (in_phase, ahead), *_ = np.linalg.lstsq(waves, np.array(values)[10_000:], rcond=None)
    assert complex(in_phase, ahead) == pytest.approx(bandwidth / (1j * frequency + bandwidth), abs=0.01)


def test_indi_filters_the_acceleration_difference_with_a_butterworth_filter():
    bandwidth, disturbances = 6.0, RNG.normal(size=60)
    numerator, denominator = scipy.signal.butter(2, bandwidth, analog=True)
    # The state-space form is used because the numerator of the transfer function is small compared with rounding
    # errors.
    model = scipy.signal.tf2ss(numerator, denominator)
    _, expected, _ = scipy.signal.dlsim(
        scipy.signal.cont2discrete(model, H, method="zoh"), np.append(disturbances, 0.0)
    )
    np.testing.assert_allclose(
        estimates(IncrementalLaw(bandwidth), disturbances, MODELLED_ACCELERATIONS), expected.ravel()[1:], atol=1e-9
    )


def test_indi_is_an_incremental_pi_on_a_linear_plant():
    """INDI is Δu = K h e / h - Δv / h for any disturbance if the filter is fast and the plant has no lag.

    This is the result of P. Acquatella B., W. van Ekeren and Q. P. Chu, "PI(D) tuning for flight control systems via
    INDI", IFAC 2017.
    """
    K, desired, disturbances = 4.0, 1.0, 0.3 + RNG.normal(size=60)
    law = IncrementalLaw(1e6)
    memory, v, speeds = law.initial_memory(0.0), 0.0, []
    for d in disturbances:
        memory = law.correct(memory, AxisMeasurement(0.0, v), H)
        u = K * (desired - v) - memory.disturbance
        memory = law.predict(memory, ModelIncrement(H * u, 0.5 * H * H * u), H)
        v += H * (u + d)
        speeds.append(v)
    k_p, k_i, u, v, before, expected = 1.0 / H, K / H, 0.0, 0.0, 0.0, []
    for d in disturbances:
        e = desired - v
        u += k_i * H * e + k_p * (e - (desired - before))
        before = v
        v += H * (u + d)
        expected.append(v)
    np.testing.assert_allclose(speeds, expected, rtol=1e-9)


@pytest.mark.parametrize(
    "law",
    [
        KalmanLaw.of(deviation=1.0, time_constant=1e4, position_noise=1e-3, period=H),
        AdaptiveLaw(1e-6, 5.0),
        IncrementalLaw(5.0),
    ],
    ids=lambda law: type(law).__name__,
)
def test_a_constant_disturbance_is_estimated_for_any_command(law):
    disturbances = np.full(400, -0.7)
    assert estimates(law, disturbances, RNG.normal(size=400), start=3.0)[-1] == pytest.approx(-0.7, abs=1e-3)


def test_the_kalman_filter_predicts_the_decay_of_a_disturbance():
    law = KalmanLaw.of(deviation=1.0, time_constant=0.5, position_noise=1e-3, period=H)
    memory = law.initial_memory(0.0)._replace(disturbance=1.0)
    for _ in range(25):
        memory = law.predict(memory, ModelIncrement(0.0, 0.0), H)
    # d = exp(-t / T), v = T (1 - d), p = T (t - v) after t = T.
    fraction = math.exp(-1.0)
    assert memory == pytest.approx((0.5 * (0.5 - 0.5 * (1.0 - fraction)), 0.5 * (1.0 - fraction), fraction), rel=1e-12)


def test_memories_of_l1_and_indi_are_zero_at_rest():
    assert (
        AdaptiveLaw(1.0, 2.0).initial_memory(7.0)
        == IncrementalLaw(2.0).initial_memory(7.0)
        == DifferencedMemory(0.0, 0.0, 0.0, 0.0)
    )
