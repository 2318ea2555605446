"""How far a hovering vehicle strays: as its linear model predicts, and as fleets fly."""

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.analysis.tracking_error import believed_tracking_error, hover_error
from drake_quad.flight.simulation import simulate_samples

TURBULENCE = "{kind: dryden, level: light, intensity: 0.02, height: 3.048, airspeed: 3.0}"
STEADY = "{kind: steady, velocity: [0.1, 0.05, 0.0]}"
# Nothing is lost, drag is linear, and wind and noise are small: all that a linear model leaves out.
LINEAR = [
    "laboratory.command_link.loss_rate=0",
    "laboratory.motion_capture.position_noise=0.0001",
    "laboratory.motion_capture.attitude_noise=0.0004",
    "vehicle.quadratic_drag=0",
    f"laboratory.wind=[{STEADY}, {TURBULENCE}]",
    "route={kind: hover, position: [0, 0, 1], duration: 60}",
]


def flown(scenario, samples=24, settled=15.0):
    """(3,) mean and standard deviation of the error of hovers, and the standard errors of both."""
    flights = simulate_samples(scenario, range(samples))
    errors = []
    for flight in flights:
        state, reference = flight.record("state"), flight.record("reference")
        late = flight.time > settled
        errors.append([(getattr(state, row) - getattr(reference, row))[late] for row in "xyz"])
    error = np.array(errors)
    mean, power = error.mean(axis=(0, 2)), ((error - error.mean(axis=(0, 2))[:, None]) ** 2).mean(axis=2)
    deviation = np.sqrt(power.mean(axis=0))
    scatter = error.mean(axis=2).std(axis=0, ddof=1), power.std(axis=0, ddof=1) / (2.0 * deviation)
    return mean, deviation, *(each / np.sqrt(samples) for each in scatter)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "layer", "overrides"),
    [
        ("laboratory:nominal", "pd", []),
        ("laboratory:nominal", "indi", []),
        ("laboratory:nominal", "lqg", []),
        # Cameras and turbulence have several numbers in each of the control's ticks, a gyroscope more of them.
        ("laboratory:nominal", "pd", ["laboratory.motion_capture.velocity_drift=[0.01, 0.005, 0.002]"]),
        ("onboard", None, ["laboratory.autopilot.gyroscope_noise=0.01", "laboratory.autopilot.attitude_noise=0.0005"]),
    ],
)
def test_fleets_stray_as_far_as_the_linear_model_says(diagrams, name, layer, overrides):
    layers = [] if layer is None else [diagrams / "controllers" / f"designed/laboratory.yaml:{layer}"]
    scenario = load_scenario(name, [*LINEAR, *overrides], layers=layers)
    predicted = hover_error(scenario)
    mean, deviation, scatter_of_mean, scatter = flown(scenario)
    # Four standard errors, and two per cent. What noise makes it lean costs thrust, in the mean: some hundredths of a
    # millimetre.
    assert np.all(np.abs(mean - predicted.offset) < 4.0 * scatter_of_mean + 0.02 * np.abs(predicted.offset) + 5e-5)
    assert np.all(np.abs(deviation - predicted.deviation) < 4.0 * scatter + 0.02 * predicted.deviation)
    assert np.all(scatter < 0.1 * deviation)
    assert predicted.rms == pytest.approx(np.sqrt(np.sum(predicted.offset**2 + predicted.deviation**2)))


def test_what_makes_it_stray_adds_up(diagrams):
    def error(wind, noise):
        silent = ["laboratory.motion_capture.position_noise=0", "laboratory.motion_capture.attitude_noise=0"]
        return hover_error(load_scenario("laboratory:nominal", [*LINEAR, wind, *([] if noise else silent)]))

    neither = error("laboratory.wind=[]", noise=False)
    np.testing.assert_allclose(neither.deviation, 0.0, atol=1e-12)
    cameras, air = error("laboratory.wind=[]", noise=True), error(f"laboratory.wind=[{TURBULENCE}]", noise=False)
    both = error(f"laboratory.wind=[{TURBULENCE}]", noise=True)
    np.testing.assert_allclose(both.deviation**2, cameras.deviation**2 + air.deviation**2, rtol=1e-9)


def test_a_plan_allows_for_the_believed_vehicle_where_fans_blow_most(diagrams):
    def error(*overrides):
        return believed_tracking_error(load_scenario("laboratory:low_wind", overrides, layers=layer)).rms

    layer = [diagrams / "controllers/designed/laboratory.yaml:pd"]
    predicted = error()
    assert error("vehicle.mass={uniform: {min: 0.6, max: 0.7}}", "vehicle.centre_of_mass=[0.01, 0.0]") == predicted
    still = error("laboratory.wind=[]")
    assert still < 0.3 * predicted
    # At (0, 0, 1) their jets are not felt much.
    hover = hover_error(load_scenario("laboratory:low_wind", layers=layer)).rms
    assert hover < 0.9 * predicted


@pytest.mark.parametrize(
    ("name", "overrides", "message"),
    [
        (
            "laboratory:nominal",
            ["laboratory.wind=[{kind: gust, speed: 1.0, heading: 0.0, start: 1.0, rise_time: 0.5}]"],
            r"wind\.0",
        ),
        ("robustness", [], r"laboratory\.wind\.4 is a gust"),
        ("laboratory:nominal", ["laboratory.command_link.delay_ticks=9"], "not stable in hover"),
        (
            "laboratory:nominal",
            ["laboratory.wind=[{kind: steady, speed: {uniform: {min: 0, max: 1}}, heading: 0}]"],
            r"laboratory\.wind\.0\.speed is a distribution",
        ),
    ],
)
def test_what_cannot_be_predicted_is_refused(name, overrides, message):
    with pytest.raises(InputError, match=message):
        believed_tracking_error(load_scenario(name, overrides))
