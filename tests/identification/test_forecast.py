"""Tests of the fraction of the variance that a forecast explains, relative to motion at constant rates."""

from types import SimpleNamespace

import numpy as np
import pytest

from drake_quad.identification.forecast import forecast, output_name
from drake_quad.identification.prediction_errors import FORCE

PERIOD = 0.1  # s, sampling period
NUM_SETTLING_SAMPLES = 3  # samples before each forecast
NUM_FORECAST_SAMPLES = 6  # samples in each forecast
NUM_WINDOWS = 4  # windows of the log
NOISE = SimpleNamespace(measured=np.array([1e-3, 2e-3, 3e-3, 4e-3]))
# Signal and index of the axis of each output.
OUTPUTS = (("position", 1), ("attitude", 2), ("body_rates", 0), (FORCE, 2))


class Gains(SimpleNamespace):
    def _replace(self, **changes):
        return Gains(**{**vars(self), **changes})


@pytest.fixture
def predictor():
    """Return a stub of a predictor in windows of constant acceleration, with its last call and its data.

    The model misses a known fraction of the acceleration after the filter has settled.
    """
    random = np.random.default_rng(7)
    state = random.normal(size=(12, NUM_WINDOWS))
    time = PERIOD * np.arange(NUM_FORECAST_SAMPLES)[:, None]
    curved = random.normal(size=(4, NUM_WINDOWS)) * time[:, None] ** 2
    forecast_at_constant_rates = np.stack(
        [state[1] + time * state[7], state[5] + time * state[11], state[9] + 0.0 * time, 9.8 + 0.0 * time * state[0]], 1
    )
    measured = np.concatenate(
        [random.normal(size=(NUM_SETTLING_SAMPLES, 4, NUM_WINDOWS)), forecast_at_constant_rates + curved]
    )
    prediction_errors = np.zeros((NUM_SETTLING_SAMPLES + NUM_FORECAST_SAMPLES, 4, 1, NUM_WINDOWS))
    for i, fraction in enumerate((0.5, 0.1, 0.0, 1.0)):
        prediction_errors[NUM_SETTLING_SAMPLES:, i, 0] = fraction * curved[:, i]
    last_call = {}

    def errors(parameters, gains, return_state_at):
        last_call.update(parameters=parameters, gain=gains.gain, return_state_at=return_state_at)
        return prediction_errors, state[:, None]

    evaluated = np.arange(NUM_SETTLING_SAMPLES + NUM_FORECAST_SAMPLES) >= NUM_SETTLING_SAMPLES
    gains = Gains(gain=np.ones((NUM_SETTLING_SAMPLES + NUM_FORECAST_SAMPLES, 12, 4, NUM_WINDOWS)))
    stub = SimpleNamespace(
        gains=lambda parameters, noise: gains,
        errors=errors,
        measured=measured,
        evaluated=evaluated,
        period=PERIOD,
        outputs=OUTPUTS,
    )
    return stub, last_call, curved, state


def test_the_explained_variance_of_a_forecast_is_relative_to_a_motion_at_constant_rates(predictor):
    """The baseline has constant velocity, constant angular rates, constant body rates and the mean specific force."""
    stub, _, curved, state = predictor
    actual = forecast(stub, np.array([1.0, 2.0]), NOISE)
    explained = [output.explained_variance for output in actual]
    expected = [1.0 - 0.5**2, 1.0 - 0.1**2, 1.0]
    np.testing.assert_allclose(explained[:3], expected)
    force = stub.measured[NUM_SETTLING_SAMPLES:, 3]
    unexplained = np.sum(curved[:, 3] ** 2)
    assert explained[3] == pytest.approx(1.0 - unexplained / np.sum((force - force.mean()) ** 2))
    time = PERIOD * np.arange(NUM_FORECAST_SAMPLES)[:, None]
    np.testing.assert_allclose(actual[0].residual.T, 0.5 * curved[:, 0], atol=1e-12)
    np.testing.assert_allclose(actual[0].predicted.T, state[1] + time * state[7] + 0.5 * curved[:, 0])


def test_forecast_windows_are_adjacent_in_time(predictor):
    """The outputs have the units of their signals."""
    stub, *_ = predictor
    result = forecast(stub, np.array([1.0, 2.0]), NOISE)
    assert [output.name for output in result] == ["position y", "yaw", "body rate p", "specific force along z"]
    assert [output.unit for output in result] == ["m", "rad", "rad/s", "m/s²"]
    time = PERIOD * np.arange(NUM_FORECAST_SAMPLES)
    for i, output in enumerate(result):
        np.testing.assert_allclose(output.time, [time + time[-1] * window for window in range(NUM_WINDOWS)])
        np.testing.assert_array_equal(output.measured, stub.measured[NUM_SETTLING_SAMPLES:, i].T)
        assert output.deviation == NOISE.measured[i]


def test_a_forecast_ignores_measurements_after_the_filter_has_settled(predictor):
    stub, last_call, *_ = predictor
    forecast(stub, np.array([1.0, 2.0]), NOISE)
    np.testing.assert_array_equal(last_call["gain"][:NUM_SETTLING_SAMPLES], 1.0)
    np.testing.assert_array_equal(last_call["gain"][NUM_SETTLING_SAMPLES:], 0.0)
    assert last_call["return_state_at"] == NUM_SETTLING_SAMPLES
    np.testing.assert_array_equal(last_call["parameters"], [[1.0, 2.0]])


@pytest.mark.parametrize(
    ("signal", "column", "message"),
    [
        ("attitude", 0, "roll"),
        ("attitude", 2, "yaw"),
        ("body_rates", 1, "body rate q"),
        ("position", 2, "position z"),
        (FORCE, 1, "specific force along y"),
    ],
)
def test_forecast_outputs_are_named_by_signal_and_axis(signal, column, message):
    assert output_name(signal, column) == message
