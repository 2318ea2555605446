"""Tests that the linear model predicts the position error of simulated flights in hover."""

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.flight.simulation import simulate_samples
from drake_quad.linear.hover_covariance import linear_hover_error

TURBULENCE = "{kind: dryden, level: light, intensity: 0.02, height: 3.048, airspeed: 3.0}"
STEADY_WIND = "{kind: steady, velocity: [0.1, 0.05, 0.0]}"
# Overrides for a nearly linear loop: little wind and noise, no lost packets and no quadratic drag.
NEARLY_LINEAR_OVERRIDES = [
    "laboratory.command_link.loss_rate=0",
    "laboratory.motion_capture.position_noise=0.0001",
    "laboratory.motion_capture.attitude_noise=0.0004",
    "vehicle.quadratic_drag=0",
    f"laboratory.wind=[{STEADY_WIND}, {TURBULENCE}]",
    "route={kind: hover, position: [0, 0, 1], duration: 60}",
]


def hover_statistics(scenario, samples=24, settling_time=15.0):
    """Return the (3,) mean and standard deviation of the position error in hover, and the standard errors of both."""
    flights = simulate_samples(scenario, range(samples), compiled=True)
    errors = []
    for flight in flights:
        state, reference = flight.record("state"), flight.record("reference")
        settled = flight.time > settling_time
        errors.append([(getattr(state, row) - getattr(reference, row))[settled] for row in "xyz"])
    error = np.array(errors)
    mean = error.mean(axis=(0, 2))
    power = ((error - error.mean(axis=(0, 2))[:, None]) ** 2).mean(axis=2)
    deviation = np.sqrt(power.mean(axis=0))
    scatter = error.mean(axis=2).std(axis=0, ddof=1), power.std(axis=0, ddof=1) / (2.0 * deviation)
    return mean, deviation, *(each / np.sqrt(samples) for each in scatter)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "layer", "overrides"),
    [
        ("laboratory:nominal", "indi", []),
        ("laboratory:nominal", "lqg", []),
        # Cameras and turbulence draw several random numbers per control tick, and a gyroscope draws more.
        ("laboratory:nominal", "pd", ["laboratory.motion_capture.velocity_drift=[0.01, 0.005, 0.002]"]),
        ("onboard", None, ["laboratory.autopilot.gyroscope_noise=0.01", "laboratory.autopilot.attitude_noise=0.0005"]),
    ],
)
def test_position_errors_in_small_noise_match_the_linear_model(diagrams, name, layer, overrides):
    layers = [] if layer is None else [diagrams / "controllers" / f"designed/laboratory.yaml:{layer}"]
    scenario = load_scenario(name, [*NEARLY_LINEAR_OVERRIDES, *overrides], layers=layers)
    linear = linear_hover_error(scenario)
    mean, deviation, scatter_of_mean, scatter = hover_statistics(scenario)
    # The tolerance is four standard errors plus two per cent. Tilting reduces lift, which shifts the mean by a few
    # hundredths of a millimetre.
    assert np.all(np.abs(mean - linear.offset) < 4.0 * scatter_of_mean + 0.02 * np.abs(linear.offset) + 5e-5)
    assert np.all(np.abs(deviation - linear.deviation) < 4.0 * scatter + 0.02 * linear.deviation)
    assert np.all(scatter < 0.1 * deviation)
    assert linear.rms == pytest.approx(np.sqrt(np.sum(linear.offset**2 + linear.deviation**2)))


@pytest.mark.slow
def test_variances_due_to_independent_noise_sources_add_up(diagrams):
    def error(wind, noise):
        noiseless = ["laboratory.motion_capture.position_noise=0", "laboratory.motion_capture.attitude_noise=0"]
        return linear_hover_error(
            load_scenario("laboratory:nominal", [*NEARLY_LINEAR_OVERRIDES, wind, *([] if noise else noiseless)])
        )

    undisturbed = error("laboratory.wind=[]", noise=False)
    np.testing.assert_allclose(undisturbed.deviation, 0.0, atol=1e-12)
    cameras, air = error("laboratory.wind=[]", noise=True), error(f"laboratory.wind=[{TURBULENCE}]", noise=False)
    with_wind_and_noise = error(f"laboratory.wind=[{TURBULENCE}]", noise=True)
    np.testing.assert_allclose(with_wind_and_noise.deviation**2, cameras.deviation**2 + air.deviation**2, rtol=1e-9)


def test_the_linear_prediction_ignores_lost_packets_and_frames():
    error = linear_hover_error(load_scenario("laboratory:nominal"))
    lossy = ["laboratory.command_link.loss_rate=0.2", "laboratory.motion_capture.dropout_rate=0.1"]
    np.testing.assert_array_equal(linear_hover_error(load_scenario("laboratory:nominal", lossy)), error)


@pytest.mark.slow
def test_an_unstable_loop_is_refused():
    with pytest.raises(InputError, match="unstable in hover"):
        linear_hover_error(load_scenario("laboratory:nominal", ["laboratory.command_link.delay_ticks=9"]))
