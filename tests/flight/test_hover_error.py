"""Tests of the predicted position error in hover, by comparison with other flights and the linear model."""

from pathlib import Path

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight import hover_error as hover_error_module
from drake_quad.flight.hover_error import HOVER_TIME, SETTLING_TIME, HoverError, hover_error, nominal_tracking_error
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate_samples
from drake_quad.laboratory.metrics import Metrics
from drake_quad.linear.hover_covariance import linear_hover_error
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.statistics.interval import Interval

CONTROLLERS = Path(__file__).parent.parent.parent / "diagrams" / "controllers"
DESIGNED_CONTROLLER = CONTROLLERS / "designed" / "laboratory.yaml"
AXES = ("x", "y", "z")


def in_laboratory(layer, *overrides):
    return load_scenario("laboratory:nominal", overrides, layers=[CONTROLLERS / layer])


def hovering(layer, start, end):
    """Return `laboratory:nominal` with a flight in hover until `end` and metrics that begin at `start`, s."""
    route = f"route={{kind: hover, position: [0, 0, 1], duration: {end}}}"
    return in_laboratory(layer, route, f"metrics.start={start}", "seed=7")


def axis_errors(error):
    return np.array([getattr(error, axis).value for axis in AXES])


def half_widths(error):
    return np.array([0.5 * (getattr(error, axis).high - getattr(error, axis).low) for axis in AXES])


def root_mean_square(metrics):
    return np.sqrt([np.mean(getattr(metrics, f"rmse_{axis}") ** 2) for axis in AXES])


@pytest.mark.long
@pytest.mark.parametrize("layer", [f"designed/laboratory.yaml:{name}" for name in ("pid", "indi_fast", "lqg")])
def test_the_predicted_error_agrees_with_independent_flights(layer):
    """The error on each axis agrees to 10 % with later flights that use different random numbers."""
    error = hover_error(in_laboratory(layer))
    fleet = StudyFleet(hovering(layer, 40, 80), plan_route(hovering(layer, 40, 80)), 128)
    np.testing.assert_allclose(root_mean_square(fleet.fly(range(128))), axis_errors(error), rtol=0.1)
    assert np.all(half_widths(error) < 0.05 * axis_errors(error))


@pytest.mark.long
def test_the_error_of_a_learning_controller_is_predicted_for_the_same_time_span():
    error = hover_error(in_laboratory("designed/laboratory.yaml:pd_t2fnn"))
    fleet = StudyFleet(
        hovering("designed/laboratory.yaml:pd_t2fnn", SETTLING_TIME, HOVER_TIME),
        plan_route(hovering("designed/laboratory.yaml:pd_t2fnn", SETTLING_TIME, HOVER_TIME)),
        192,
    )
    np.testing.assert_allclose(root_mean_square(fleet.fly(range(192))), axis_errors(error), rtol=0.1)


@pytest.mark.long
def test_model_predictive_control_has_the_hover_error_of_its_regulator():
    metrics = [
        StudyFleet(
            hovering(f"designed/laboratory.yaml:{name}", 2.0, 8.0),
            plan_route(hovering(f"designed/laboratory.yaml:{name}", 2.0, 8.0)),
            8,
        ).fly(range(8))
        for name in ("mpc", "lqg")
    ]
    np.testing.assert_allclose(*map(root_mean_square, metrics), rtol=1e-3)


@pytest.mark.long
def test_the_hover_error_is_the_root_mean_square_of_recorded_position_errors():
    layer = "designed/laboratory.yaml:lqg"
    error = hover_error(in_laboratory(layer), seed=7)
    flights = simulate_samples(hovering(layer, 0, HOVER_TIME), range(error.num_hovers), compiled=True)
    offset = np.array([[flight.record("state")[i] - (0, 0, 1)[i] for i in range(3)] for flight in flights])
    settled_offset = offset[:, :, flights[0].time >= SETTLING_TIME]
    np.testing.assert_allclose(axis_errors(error), np.sqrt(np.mean(settled_offset**2, axis=(0, 2))), rtol=1e-9)
    assert error.rms.value == pytest.approx(np.sqrt(np.sum(axis_errors(error) ** 2)))
    assert error.rms.low < error.rms.value < error.rms.high


@pytest.mark.slow
@pytest.mark.parametrize("name", ["pd", "indi", "l1"])
def test_the_hover_error_in_small_noise_matches_the_linear_model(name):
    small = [
        "laboratory.motion_capture.position_noise=1e-5",
        "laboratory.motion_capture.attitude_noise=4e-5",
        "laboratory.command_link.loss_rate=0",
    ]
    scenario = in_laboratory(f"designed/laboratory.yaml:{name}", *small)
    error, linear = hover_error(scenario), linear_hover_error(scenario)
    # The half-width of a 95 % interval is two standard errors.
    assert np.all(np.abs(axis_errors(error) - np.hypot(*linear)) < 2.0 * half_widths(error))


@pytest.mark.long
def test_the_linear_model_underestimates_the_error_in_the_shipped_noise():
    """The linear model omits lost packets and nonlinear effects of the noise, such as a longer thrust vector."""
    layer = "designed/laboratory.yaml:indi"
    lossless = "laboratory.command_link.loss_rate=0"
    error, linear = hover_error(in_laboratory(layer, lossless)), linear_hover_error(in_laboratory(layer))
    x, y, z = axis_errors(error) / np.hypot(*linear)
    assert min(x, y) > 1.4
    assert z > 3.0
    assert np.all(axis_errors(hover_error(in_laboratory(layer)))[:2] > 2.0 * axis_errors(error)[:2])


@pytest.mark.long
def test_the_hover_error_depends_neither_on_the_seed_nor_on_the_time_step():
    layer = "designed/laboratory.yaml:pid"
    assert hover_error(in_laboratory(layer, "seed=3", "vehicle.time_step=0")) == hover_error(in_laboratory(layer))


@pytest.mark.slow
def test_the_hover_error_without_noise_is_the_offset_in_steady_wind():
    noiseless = ["laboratory.motion_capture.position_noise=0", "laboratory.motion_capture.attitude_noise=0"]
    wind = "laboratory.wind=[{kind: steady, velocity: [1, -0.5, 0]}]"
    scenario = in_laboratory("designed/laboratory.yaml:pd", *noiseless, wind)
    error = hover_error(scenario)
    np.testing.assert_allclose(axis_errors(error), np.abs(linear_hover_error(scenario).offset), rtol=1e-4, atol=1e-7)
    # Lost packets differ between flights. They affect only the settling of the vehicle if there is no noise.
    np.testing.assert_allclose(half_widths(error), 0.0, atol=1e-8)
    assert error.num_hovers == 64


@pytest.fixture
def stub_errors(monkeypatch):
    """Return a function that replaces simulated flights with given errors, and returns the list of flown samples.

    The given errors are a function of the axis and of an array (n,) of sample indices.
    """

    def install(error):
        flown_samples = []

        class Fleet:
            def __init__(self, *_):
                pass

            def fly(self, samples):
                flown_samples.extend(samples)
                x, y, z = (error(axis, np.array(samples)) for axis in AXES)
                distance = np.sqrt(x**2 + y**2 + z**2)
                metrics = Metrics(*[distance] * (len(Metrics._fields) - 1), np.full(len(samples), np.inf))
                return metrics._replace(rmse_x=x, rmse_y=y, rmse_z=z)

        monkeypatch.setattr(hover_error_module, "StudyFleet", Fleet)
        return flown_samples

    return install


@pytest.mark.parametrize("spread", [0.1, 0.6, 0.9])
def test_flights_are_simulated_until_the_half_width_is_a_twentieth_of_the_error_on_each_axis(stub_errors, spread):
    """The relative half-width of the RMS error along Z is proportional to 1 / √n for n flights."""

    def error(axis, samples):
        return np.sqrt(1.0 + np.where(samples % 2, spread, -spread) * (axis == "z"))

    flown_samples = stub_errors(error)
    prediction = hover_error(load_scenario("hover"))
    assert flown_samples == list(range(prediction.num_hovers))
    assert prediction.num_hovers == 64 * np.ceil((1.96 * 0.5 * spread / 0.05) ** 2 / 64)
    np.testing.assert_allclose(axis_errors(prediction), 1.0)


@pytest.mark.parametrize(("size", "num_flights"), [(1e-8, 64), (1e-5, 1024)])
def test_an_axis_with_only_rounding_errors_needs_no_further_flights(stub_errors, size, num_flights):
    stub_errors(lambda axis, samples: np.where(samples % 64 == 0, 8.0, 0.0) * (size if axis == "y" else 0.0))
    assert hover_error(load_scenario("hover")).num_hovers == num_flights


def test_vehicles_hover_at_nine_points_of_the_route_if_the_wind_depends_on_the_position(monkeypatch):
    positions = []

    def constant_error_at(scenario):
        assert scenario.space is None
        positions.append(scenario.route.position)
        size = 3.0 - abs(len(positions) - 4)
        return HoverError(*[Interval(size, size, size)] * 4, 64)

    monkeypatch.setattr(hover_error_module, "hover_error", constant_error_at)
    scenario = load_scenario("laboratory:low_wind")
    assert nominal_tracking_error(scenario).rms.value == 3.0
    path = plan_route(scenario).path
    expected = evaluate(path, np.linspace(path.times[0], path.times[-1], 9)).T
    np.testing.assert_allclose(positions, expected, atol=1e-12)
    positions.clear()
    nominal_tracking_error(load_scenario("laboratory:nominal"))
    assert positions == [(0.0, 0.0, 1.0)]


@pytest.mark.slow
def test_a_hover_that_crashes_has_no_predicted_error():
    scenario = load_scenario("laboratory:nominal", ["laboratory.command_link.delay_ticks=9"])
    with pytest.raises(InputError, match=r"64 of 64 flights of nominal crash, the first after \d+\.\d s"):
        hover_error(scenario)


@pytest.mark.long
def test_the_nominal_tracking_error_is_the_error_of_the_nominal_vehicle_in_the_strongest_wind():
    def error(*overrides):
        return nominal_tracking_error(load_scenario("laboratory:low_wind", overrides, layers=layer)).rms

    layer = [f"{DESIGNED_CONTROLLER}:pd"]
    predicted = error()
    assert error("vehicle.mass={uniform: {min: 0.6, max: 0.7}}", "vehicle.centre_of_mass=[0.01, 0.0]") == predicted
    without_wind = error("laboratory.wind=[]")
    assert without_wind.high < 0.4 * predicted.value
    # The jets of the fans are negligible at (0, 0, 1).
    hover = hover_error(load_scenario("laboratory:low_wind", layers=layer)).rms
    assert hover.high < 0.9 * predicted.value


@pytest.mark.parametrize(
    ("name", "overrides", "message"),
    [
        (
            "laboratory:nominal",
            ["laboratory.wind=[{kind: gust, speed: 1.0, heading: 0.0, start: 1.0, rise_time: 0.5}]"],
            r"wind\.0 is a gust, which depends on time; the tracking error can be predicted only",
        ),
        ("robustness", [], r"laboratory\.wind\.4 is a gust"),
        (
            "laboratory:nominal",
            ["laboratory.wind=[{kind: steady, speed: {uniform: {min: 0, max: 1}}, heading: 0}]"],
            r"laboratory\.wind\.0\.speed is a distribution",
        ),
    ],
)
def test_scenarios_whose_error_cannot_be_predicted_are_refused(name, overrides, message):
    with pytest.raises(InputError, match=message):
        nominal_tracking_error(load_scenario(name, overrides))
