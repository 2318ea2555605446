"""Tests of the noise and the biases of inertial sensors in a log."""

from dataclasses import replace

import numpy as np
import pytest
from inertial_log import ACCELEROMETER, GYROSCOPE, PERIOD, simulated_log

from drake_quad import InputError
from drake_quad.estimation.covariance import InertialNoise
from drake_quad.identification.inertial_errors import inertial_errors
from drake_quad.identification.logged_estimate import estimate_logged_flight

# White noise of the simulated sensors, without a random walk of the biases.
NOISE = InertialNoise(GYROSCOPE["noise_density"], ACCELEROMETER["noise_density"], 1e-6, 1e-6)


@pytest.fixture(scope="module")
def record():
    return simulated_log()


@pytest.fixture(scope="module")
def estimate(record):
    return estimate_logged_flight(record, noise=NOISE, position_noise=1e-3, attitude_noise=1e-3)


@pytest.mark.slow
def test_noise_densities_and_biases_of_a_simulated_log_are_in_their_intervals(record, estimate):
    for sensor, true in zip(inertial_errors(record, estimate), (GYROSCOPE, ACCELEROMETER), strict=True):
        for density in sensor.noise_density:
            assert density.value == pytest.approx(true["noise_density"], abs=density.half_width)
            assert density.half_width < 0.2 * density.value
        for bias, true_bias in zip(sensor.bias, true["bias"], strict=True):
            assert bias.value == pytest.approx(true_bias, abs=1.5 * bias.half_width)
        assert sensor.settings()["period"] == PERIOD


def test_a_slow_motion_adds_no_noise(record, estimate):
    """A parabola with a constant second difference of 2e-4 is added to the readings."""
    ramp = 1e-4 * np.arange(len(record.time))[:, None] ** 2
    moving = replace(record, specific_force=record.specific_force + ramp)
    before, after = inertial_errors(record, estimate)[1], inertial_errors(moving, estimate)[1]
    for old, new in zip(before.noise_density, after.noise_density, strict=True):
        assert new.value == pytest.approx(old.value, rel=1e-3)


def test_larger_innovations_than_expected_widen_the_intervals_of_the_biases(record, estimate):
    doubtful = estimate._replace(innovations=np.full_like(estimate.innovations, 3.0))
    for old, new in zip(inertial_errors(record, estimate), inertial_errors(record, doubtful), strict=True):
        expected = 3.0 / np.sqrt(max(1.0, estimate.mean_squared_innovation))
        for before, after in zip(old.bias, new.bias, strict=True):
            assert after.deviation == pytest.approx(expected * before.deviation)
        assert new.noise_density == old.noise_density


def test_a_log_with_irregular_samples_is_refused(record, estimate):
    time = record.time + np.where(np.arange(len(record.time)) % 2, 0.3 * PERIOD, 0.0)
    with pytest.raises(InputError, match=r"only 0 samples of the log simulated are in flight and have a constant"):
        inertial_errors(replace(record, time=time), estimate)
