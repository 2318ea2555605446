"""Tests of the errors of gyroscopes and accelerometers."""

import numpy as np
import pytest
import scipy
from sensor_series import series

from drake_quad import load_scenario
from drake_quad.laboratory.sensors.gyroscope import GYROSCOPE
from drake_quad.laboratory.sensors.sensor import with_errors
from drake_quad.scenario.quantities import any_nonzero
from drake_quad.scenario.sensors.accelerometer import AccelerometerSettings
from drake_quad.scenario.sensors.gyroscope import GyroscopeSettings
from drake_quad.signals import State

AT_REST = State(*(0.0,) * 12)


def gyroscope(**settings):
    """Return the parameters of a gyroscope, with the errors that the settings switch on."""
    sensor = GyroscopeSettings.model_validate({"kind": "gyroscope", **settings})
    parameters = sensor.parameters(load_scenario("hover").vehicle)
    names = [name for name in parameters.errors._fields if any_nonzero(getattr(sensor, name), getattr(sensor, name))]
    return with_errors(parameters, names)


def readings(num_readings, num_vehicles=1, seed=None, rates=None, **settings):
    """Return the (T, 3, N) readings of gyroscopes.

    Args:
        num_readings: number T of readings.
        num_vehicles: number N of vehicles.
        seed: seed of the noise; None without noise.
        rates: function that returns the body rates at a reading, given its number; the vehicles rest if not given.
        settings: settings of the gyroscope.
    """

    def signals(k):
        state = AT_REST if rates is None else AT_REST._replace(**dict(zip("pqr", rates(k), strict=True)))
        return state, None

    return series(GYROSCOPE, gyroscope(**settings), signals, num_readings, num_vehicles, seed)


def assert_allan_variance(measurements, num_samples, expected):
    """Assert that Allan variances are within four standard errors of their expectations.

    Args:
        measurements: (T, 3, N) readings, whose 3 N series are independent.
        num_samples: numbers of samples in an average.
        expected: function that returns the expected variance for such a number.
    """
    for m in num_samples:
        blocks = measurements[: len(measurements) // m * m].reshape(-1, m, 3 * measurements.shape[2]).mean(axis=1)
        estimates = 0.5 * np.mean(np.diff(blocks, axis=0) ** 2, axis=0)
        error = estimates.std() / np.sqrt(len(estimates))
        assert estimates.mean() == pytest.approx(expected(m), abs=4.0 * error), m
        assert error < 0.06 * expected(m)


def test_the_allan_deviation_of_white_noise_is_the_noise_density_divided_by_the_root_of_time():
    density, period = 2.4e-4, 0.0025
    measurements = readings(2048, 200, seed=0, noise_density=density, period=period)
    assert_allan_variance(measurements, (1, 4, 32, 128), lambda m: density**2 / (m * period))


def test_the_allan_deviation_of_the_bias_instability_is_that_of_a_gauss_markov_process():
    """The maximum of the curve, at 1.89 correlation times, is 0.617 standard deviations."""
    deviation, period, time = 3e-3, 0.01, 1.0

    def expected(m):
        x = m * period / time
        return 2.0 * deviation**2 / x * (1.0 - (3.0 - 4.0 * np.exp(-x) + np.exp(-2.0 * x)) / (2.0 * x))

    assert np.sqrt(expected(189.0)) == pytest.approx(0.617 * deviation, rel=1e-3)
    assert expected(189.0) > max(expected(170.0), expected(210.0))
    measurements = readings(3000, 200, seed=1, bias_instability=deviation, bias_time=time, period=period)
    assert_allan_variance(measurements, (20, 60, 189, 600), expected)


def test_the_allan_deviation_of_the_random_walk_grows_with_the_root_of_time():
    density, period = 1e-4, 0.02
    measurements = readings(2048, 200, seed=2, bias_random_walk=density, period=period)
    assert_allan_variance(measurements, (16, 64, 256), lambda m: density**2 * m * period / 3.0)
    # The walk starts at zero.
    assert measurements[0].std() == 0.0
    assert measurements[-1].std() == pytest.approx(density * np.sqrt(2047 * period), rel=0.1)


def test_the_bias_instability_is_stationary_from_the_first_reading_on():
    measurements = readings(40, 4000, seed=3, bias_instability=1e-2, bias_time=0.1, period=0.01)
    deviations = measurements.std(axis=(1, 2))
    np.testing.assert_allclose(deviations, 1e-2, rtol=4.0 / np.sqrt(2.0 * 12000))
    correlations = [np.mean(measurements[0] * measurements[k]) / 1e-4 for k in (1, 5, 20)]
    np.testing.assert_allclose(correlations, np.exp(-np.array([0.1, 0.5, 2.0])), atol=4.0 / np.sqrt(12000))


def test_the_low_pass_filter_agrees_with_an_independent_solution_of_its_differential_equation():
    """Both the filter and `scipy.signal.lsim` take the input as linear between its samples."""
    bandwidth, period, n = 31.0, 0.01, 100
    inputs = np.random.default_rng(4).normal(size=(n, 3))
    filtered = readings(n, rates=lambda k: inputs[k], bandwidth=bandwidth, period=period)[..., 0]
    for axis in range(3):
        system = scipy.signal.StateSpace([[-bandwidth]], [[bandwidth]], [[1.0]], [[0.0]])
        times = period * np.arange(n)
        _, expected, _ = scipy.signal.lsim(system, inputs[:, axis], times, X0=inputs[:1, axis])
        np.testing.assert_allclose(filtered[:, axis], expected, atol=1e-12)


def test_the_low_pass_filter_delays_a_ramp_by_the_inverse_of_its_bandwidth():
    bandwidth, period = 20.0, 0.05
    rows = readings(60, rates=lambda k: (k * period, 0.0, 0.0), bandwidth=bandwidth, period=period)[:, 0, 0]
    np.testing.assert_allclose(rows[-10:], period * np.arange(50, 60) - 1.0 / bandwidth, atol=1e-12)


def test_scale_misalignment_and_bias_apply_in_the_axes_of_the_sensor():
    rates, angles, scale = np.array([0.7, -0.4, 0.3]), (0.1, -0.2, 0.3), np.array([0.01, -0.02, 0.03])
    bias = np.array([0.011, 0.012, 0.013])
    rows = readings(1, rates=lambda k: rates, misalignment=list(angles), scale_error=[*scale], bias=[*bias])[0, :, 0]
    R_BS = scipy.spatial.transform.Rotation.from_euler("ZYX", angles[::-1])
    np.testing.assert_allclose(rows, (1.0 + scale) * R_BS.inv().apply(rates) + bias, atol=1e-12)


def test_readings_are_limited_to_the_full_scale_and_rounded_to_the_resolution():
    """The error of rounding is at most half a step. A reading beyond the full scale is the full scale."""
    true = np.linspace(-3.0, 3.0, 301)
    rows = readings(301, rates=lambda k: (true[k],) * 3, full_scale=2.0, resolution=0.25)[:, 1, 0]
    np.testing.assert_allclose(rows % 0.25, 0.0, atol=1e-12)
    inside = np.abs(true) < 1.9
    assert np.abs(rows - true)[inside].max() <= 0.125 + 1e-12
    assert (rows[true > 2.0] == 2.0).all()
    assert (rows[true < -2.0] == -2.0).all()


def test_the_bias_changes_linearly_while_the_sensor_warms_up():
    rows = readings(31, temperature_coefficient=[1e-3, -2e-3, 0.0], warm_up_rise=10.0, warm_up_time=0.2, period=0.01)[
        ..., 0
    ]
    fraction = np.minimum(np.arange(31) / 20.0, 1.0)
    np.testing.assert_allclose(rows, np.outer(fraction, [1e-2, -2e-2, 0.0]), atol=1e-12)


def test_values_of_data_sheets_in_g_or_degrees_are_reported_as_implausible():
    for settings, field in (
        (AccelerometerSettings, {"kind": "accelerometer", "full_scale": 16.0}),
        (GyroscopeSettings, {"kind": "gyroscope", "full_scale": 2000.0}),
        (GyroscopeSettings, {"kind": "gyroscope", "noise_density": 0.014}),
    ):
        (name,) = field.keys() - {"kind"}
        ranges = [each for each in settings.model_fields[name].metadata if hasattr(each, "explain_implausibility")]
        assert any(each.explain_implausibility(field[name], 0.01) for each in ranges), name
