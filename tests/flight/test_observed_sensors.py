"""Tests of policies that observe the readings of sensors on board."""

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, simulate
from drake_quad.gym import QuadrotorVectorEnv
from drake_quad.linear.closed_loop import closed_loop
from drake_quad.linear.step_response import initial_response
from drake_quad.scenario.paths import with_values

SENSORS = [
    {"kind": "accelerometer", "period": 0.01, "noise_density": 1e-3},
    {"kind": "gyroscope", "period": 0.01, "bias": [0.3, 0.2, 0.1]},
    {"kind": "gyroscope", "period": 0.01, "bias": [1.0, 2.0, 3.0]},
    {"kind": "gnss", "period": 0.02, "fault": {"kind": "failed", "time": 0.05}},
]
SIGNALS = ["position_error", "gyroscope_2", "accelerometer", "gnss_valid", "gyroscope_valid"]
GAINS = np.array([[6.0, 0.0, 0.0], [0.0, 6.0, 0.0], [0.0, 0.0, 8.0]])
VELOCITY_GAIN = 4.0
MAX_ACCELERATION = 5.0  # m/s², acceleration that an action of 1 commands


@pytest.fixture
def scenario(tmp_path):
    """Return a hover with a linear network that reads the rates of a gyroscope in addition to the position."""
    signals = ["position_error", "velocity_error", "gyroscope", "gnss_valid"]
    weights = np.hstack([GAINS, VELOCITY_GAIN * np.eye(3), np.array([[0.0, -0.1, 0.0], [0.1, 0.0, 0.0], np.zeros(3)])])
    network = {"weights_0": np.hstack([weights, np.zeros((3, 1))]) / MAX_ACCELERATION, "biases_0": np.zeros(3)}
    np.savez(tmp_path / "net.npz", **network)
    (tmp_path / "mine.yaml").write_text(
        "mine:\n  extends: hover\n  control:\n    kind: policy\n    policy: net.npz\n    action: {kind: acceleration}\n"
        f"    observation: {{signals: [{', '.join(signals)}]}}\n"
        "    attitude: {k_p: [60, 60, 20], k_d: [12, 12, 8]}\n"
    )
    return load_scenario(tmp_path / "mine.yaml", {"laboratory.sensors": SENSORS, "duration": 1.0})


@pytest.mark.slow
def test_an_environment_observes_readings_of_numbered_sensors_and_their_validity():
    envs = QuadrotorVectorEnv(
        "hover",
        {"laboratory.sensors": SENSORS, "duration": 1.0},
        num_envs=2,
        action="attitude",
        observation={"signals": SIGNALS},
    )
    observation, _ = envs.reset(seed=3)
    assert observation.shape == (2, 3 + 3 + 3 + 1 + 1)
    np.testing.assert_allclose(observation[:, 3:6], [[1.0, 2.0, 3.0]] * 2, atol=1e-6)
    np.testing.assert_allclose(observation[:, 6:9], [[0.0, 0.0, 9.81]] * 2, atol=0.05)
    assert observation[0, 6] != observation[1, 6]  # each vehicle has its own noise
    np.testing.assert_array_equal(observation[:, 9:], np.ones((2, 2)))
    for _ in range(5):
        observation, *_ = envs.step(np.zeros((2, 4)))
    # The GNSS has failed. All readings of a gyroscope without a fault are valid.
    np.testing.assert_array_equal(observation[:, 9:], [[0.0, 1.0]] * 2)


@pytest.mark.slow
def test_wired_and_compiled_flights_of_a_policy_that_observes_sensors_are_equal(scenario):
    wired, compiled = (simulate(scenario, compiled=each) for each in (False, True))
    assert not compiled.metrics.crashed
    np.testing.assert_array_equal(wired.signals["observation"], compiled.signals["observation"])
    np.testing.assert_array_equal(wired.signals["state"], compiled.signals["state"])
    np.testing.assert_array_equal(compiled.signals["observation"][1:, 6:9], compiled.signals["gyroscope"][1:])


@pytest.mark.slow
def test_the_linear_model_of_hover_contains_the_observed_sensors(scenario):
    loop = closed_loop(scenario)
    assert np.abs(loop.system.poles()).max() < 1.0
    for row in ("x", "y", "roll"):
        response = initial_response(loop, {row: 1e-4}, duration=2.0)
        np.testing.assert_allclose(response.nonlinear, response.linear, atol=1e-7)
        assert np.abs(response.linear).max() > 0.5e-4


@pytest.mark.slow
def test_the_bias_of_an_observed_gyroscope_shifts_the_hover(scenario):
    """The network commands -0.1 b_y along X and 0.1 b_x along Y, which the position gain of 6 1/s² compensates."""
    flight = simulate(with_values(scenario, {"duration": 12.0}), compiled=True)
    x, y, *_ = flight.signals["state"][-1]
    assert (x, y) == pytest.approx((-0.1 * 0.2 / 6.0, 0.1 * 0.3 / 6.0), abs=1e-3)


@pytest.mark.parametrize(
    ("signals", "message"),
    [
        (["accelerometr"], r"signals\.0 is 'accelerometr', but must be position, .*action, or a signal of a sensor"),
        (["wind", "barometer"], r"signals\.1 is 'barometer', but must be a signal of a sensor in .*gyroscope_2"),
        (["gyroscope_3"], r"signals\.0 is 'gyroscope_3', but must be a signal of a sensor in laboratory\.sensors"),
        (["barometer_valid"], r"signals\.0 is 'barometer_valid', but must be a signal of a sensor"),
    ],
)
def test_signals_that_no_sensor_has_are_refused(signals, message):
    with pytest.raises(InputError, match=message):
        QuadrotorVectorEnv(
            "hover", {"laboratory.sensors": SENSORS}, action="attitude", observation={"signals": signals}
        )


def test_sensor_signals_are_refused_without_sensors():
    with pytest.raises(InputError, match=r"must be a signal of a sensor in laboratory\.sensors, which is empty"):
        QuadrotorVectorEnv("hover", action="attitude", observation={"signals": ["gyroscope"]})
