"""Tests of initial estimates that differ from the true state."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_quad import closed_loop, load_scenario, simulate, simulate_samples
from drake_quad.scenario.batch import draw_sample

BIAS = [0.02, -0.01, 0.03]  # rad/s
ROTATION = [0.05, -0.1, 0.2]  # rad, along the axes of W
SENSORS = [
    {"kind": "gyroscope", "period": 0.005, "noise_density": 1e-4, "bias": BIAS},
    {"kind": "accelerometer", "period": 0.005, "noise_density": 1e-3},
    {"kind": "gnss", "period": 0.01, "position_noise": [0.02] * 3, "velocity_noise": [0.02] * 3},
    {"kind": "magnetometer", "period": 0.01, "field_noise": 1e-7},
]
INITIAL_ESTIMATE = {
    "position_error": [0.5, -0.4, 0.3],
    "velocity_error": [0.1, 0.2, -0.3],
    "rotation_error": ROTATION,
    "gyroscope_bias": BIAS,
}
ESTIMATORS = {
    "error_state_filter": {"initial_deviation": {"position": 0.5, "velocity": 0.3, "attitude": 0.2}},
    "complementary_filter": {},
}


def scenario_with(kind, initial_estimate, **overrides):
    estimator = {"kind": kind, **ESTIMATORS[kind], "initial_estimate": initial_estimate}
    laboratory = {"laboratory.sensors": SENSORS, "laboratory.estimator": estimator, "vehicle.time_step": 0.005}
    return load_scenario("hover", {**laboratory, "duration": 15.0, **overrides})


@pytest.mark.slow
@pytest.mark.parametrize("kind", ESTIMATORS)
def test_the_first_estimate_has_the_given_errors_which_the_filter_corrects(kind):
    flight = simulate(scenario_with(kind, INITIAL_ESTIMATE), compiled=True)
    measured, true = flight.signals["measurement"], flight.signals["state"]
    np.testing.assert_allclose(measured[0, :3] - true[0, :3], INITIAL_ESTIMATE["position_error"])
    np.testing.assert_allclose(measured[0, 6:9] - true[0, 6:9], INITIAL_ESTIMATE["velocity_error"])
    rotation = Rotation.from_euler("xyz", measured[0, 3:6]) * Rotation.from_euler("xyz", true[0, 3:6]).inv()
    np.testing.assert_allclose(rotation.as_rotvec(), ROTATION, atol=1e-9)
    # The estimated bias is the true one, so the first measured body rates have no error.
    np.testing.assert_allclose(measured[1, 9:], true[1, 9:], atol=0.02)
    assert not flight.metrics.crashed
    errors = measured[-1] - true[-1]
    assert np.abs(errors[:3]).max() < 0.1
    assert np.abs(errors[3:6]).max() < 0.05


@pytest.mark.slow
def test_each_sample_has_its_own_initial_error():
    distribution = {"normal": {"mean": 0.0, "standard_deviation": 0.4}}
    scenario = scenario_with("error_state_filter", {"position_error": [distribution, 0.0, 0.1]}, duration=0.1)
    flights = simulate_samples(scenario, range(3), compiled=True)
    drawn = [draw_sample(scenario, i).laboratory.estimator.initial_estimate.position_error[0] for i in range(3)]
    errors = [flight.signals["measurement"][0, :3] - flight.signals["state"][0, :3] for flight in flights]
    np.testing.assert_allclose(errors, np.column_stack([drawn, np.zeros(3), np.full(3, 0.1)]), atol=1e-12)
    assert len({*drawn}) == 3


@pytest.mark.slow
def test_the_linear_model_does_not_depend_on_the_initial_estimate():
    exact, erroneous = (closed_loop(scenario_with("complementary_filter", each)) for each in ({}, INITIAL_ESTIMATE))
    np.testing.assert_array_equal(exact.system.A, erroneous.system.A)
