"""Tests of PID loops and filters by comparison with closed forms."""

import math

import numpy as np
import pytest
import scipy.signal

from drake_quad.pid.filters import EMPTY_FILTER, butterworth, filter_step, first_order
from drake_quad.pid.loop import Derivative, Integral, LastMeasurement, Memory, Terms, pid

PERIOD = 0.01  # s, tick of the loop


def run(terms, setpoints, measurements, k_p=0.0, **options):
    """Return the outputs of a PID loop at consecutive ticks."""
    memory, outputs = Memory.of(terms), []
    for setpoint, measured in zip(setpoints, measurements, strict=True):
        output, memory = pid(setpoint, measured, k_p, terms, memory, PERIOD, **options)
        outputs.append(output)
    return np.array(outputs)


@pytest.mark.parametrize("make", [butterworth, first_order])
def test_a_filter_halves_the_power_at_its_bandwidth_and_has_unit_dc_gain(make):
    bandwidth, period = 2.0 * np.pi * 20.0, 1e-4 if make is first_order else 0.002
    b_0, b_1, b_2, a_1, a_2 = make(bandwidth, period)
    _, response = scipy.signal.freqz([b_0, b_1, b_2], [1.0, a_1, a_2], [0.0, bandwidth * period])
    np.testing.assert_allclose(np.abs(response), [1.0, np.sqrt(0.5)], rtol=1e-2 if make is first_order else 1e-9)


def test_the_second_order_filter_agrees_with_scipy():
    b_0, b_1, b_2, a_1, a_2 = butterworth(2.0 * np.pi * 30.0, 0.002)
    b, a = scipy.signal.butter(2, 30.0, fs=500.0)
    np.testing.assert_allclose([b_0, b_1, b_2], b, rtol=1e-12)
    np.testing.assert_allclose([1.0, a_1, a_2], a, rtol=1e-12)
    samples, state, actual = np.random.default_rng(1).normal(size=40), EMPTY_FILTER, []
    for sample in samples:
        output, state = filter_step(sample, butterworth(2.0 * np.pi * 30.0, 0.002), state)
        actual.append(output)
    np.testing.assert_allclose(actual, scipy.signal.lfilter(b, a, samples), rtol=1e-10)


@pytest.mark.parametrize(("first", "offset"), [(False, 0), (True, 1)])
def test_a_saturated_integral_leaves_its_limit_at_once(first, offset):
    ticks = np.arange(60)
    errors = np.where(ticks < 40, 2.0, -2.0)
    actual = run(Terms(Integral(3.0, 1.5)), errors, np.zeros(60), integrates_first=first)
    growth = 3.0 * 2.0 * PERIOD
    np.testing.assert_allclose(actual[:20], growth * (ticks[:20] + offset), atol=1e-12)
    assert actual[35] == pytest.approx(1.5)
    assert actual[41 - offset] == pytest.approx(1.5 - growth), "the integral must not wind up"
    np.testing.assert_allclose(run(Terms(Integral(3.0, 1.5)), -errors, np.zeros(60), integrates_first=first), -actual)


def test_the_growth_of_an_integral_decreases_with_the_squared_error():
    for error, fraction in [(0.5, 1.0 - 0.25**2), (1.0, 0.75), (2.0, 0.0), (3.0, 0.0)]:
        actual = run(Terms(Integral(3.0, 9.0, 2.0)), [error] * 2, [0.0] * 2)
        assert actual[1] == pytest.approx(3.0 * fraction * error * PERIOD)


def test_a_derivative_is_the_rate_of_the_measurement_and_not_of_the_setpoint():
    ramp = 0.4 * PERIOD * np.arange(200)
    terms = Terms(derivative=Derivative(2.0))
    np.testing.assert_allclose(run(terms, np.zeros(200), 1.0 + ramp), [0.0] + [-2.0 * 0.4] * 199, atol=1e-12)
    np.testing.assert_allclose(run(terms, np.arange(200.0), np.ones(200)), 0.0)
    slow = run(Terms(derivative=Derivative(2.0, butterworth(30.0, PERIOD))), np.zeros(200), ramp)
    assert 0.0 > slow[1] > -0.1
    assert slow[-1] == pytest.approx(-0.8, rel=1e-6)


def test_angle_errors_are_wrapped():
    turn = Terms(derivative=Derivative(1.0))
    actual = run(turn, [3.0, 3.0], [-3.1, 3.1], k_p=2.0, is_angle=True)
    assert actual[0] == pytest.approx(2.0 * (6.1 - math.tau))
    assert actual[1] == pytest.approx(-0.2 - (6.2 - math.tau) / PERIOD)


def test_the_setpoint_is_fed_forward_and_the_output_is_limited():
    assert run(Terms(k_ff=0.5), [3.0], [2.0], k_p=2.0) == pytest.approx(3.5)
    np.testing.assert_allclose(run(Terms(limit=0.7), [3.0, -3.0], [2.0, 2.0], k_p=2.0), [0.7, -0.7])


def test_the_state_of_a_pid_loop_contains_only_the_states_of_its_terms():
    assert Memory.of(None) == Memory.of(Terms(k_ff=1.0, limit=1.0)) == Memory()
    assert Memory.of(Terms(Integral(1.0, 1.0))) == Memory(integral=0.0)
    assert Memory.of(Terms(derivative=Derivative(1.0))) == Memory(measured=LastMeasurement(0.0, 0.0))
