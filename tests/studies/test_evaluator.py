"""Tests of the metrics of flights as a function of points of the unit cube."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import scipy

from drake_quad import InputError, load_scenario, run_monte_carlo, simulate
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.randomness.streams import parameter_numbers
from drake_quad.scenario.batch import Batch, coordinates
from drake_quad.scenario.correlation import shared_stream
from drake_quad.studies.evaluator import Evaluator
from drake_quad.studies.processes import Workers
from drake_quad.studies.worker_pool import ExecutorPool

CORRELATED_DISTRIBUTIONS = {
    "vehicle.mass": {"normal": {"mean": 0.7, "standard_deviation": 0.02, "min": 0.6, "max": 0.8, "shared": {"a": 0.8}}},
    "vehicle.linear_drag": {"uniform": {"min": 0.1, "max": 0.3}},
    "vehicle.centre_of_mass.0": {
        "normal": {"mean": 0.0, "standard_deviation": 0.001, "min": -0.01, "shared": {"a": -0.5}}
    },
    "duration": 1.0,
}


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("laboratory:low_wind", [{key: value} for key, value in CORRELATED_DISTRIBUTIONS.items()])


def points_of_samples(scenario, samples):
    """Return the points of the unit cube that correspond to samples of the study."""
    names = [name if name.startswith("shared ") else _stream(name) for name in coordinates(scenario)]
    return np.column_stack([parameter_numbers(scenario.seed, samples, name) for name in names])


def _stream(path):
    return path.replace(".0", "[0]")


def test_coordinates_are_the_drawn_fields_and_the_shared_variables(scenario):
    fields = "vehicle.mass", "vehicle.centre_of_mass.0", "vehicle.linear_drag"
    assert {*coordinates(scenario)} == {*fields, shared_stream("a")}


@pytest.mark.slow
def test_the_evaluator_has_the_metrics_of_a_study_with_the_same_random_numbers(scenario):
    study = run_monte_carlo(scenario, 7, num_workers=1)
    evaluator = Evaluator(scenario, num_vehicles=4)
    samples = [6, 0, 3, 2, 5]
    metrics = evaluator(points_of_samples(scenario, samples), samples)
    for name, values in metrics._asdict().items():
        assert np.array_equal(values, getattr(study.metrics, name)[samples], equal_nan=True), name
    assert evaluator.num_flights == 5


def test_a_coordinate_of_normal_space_is_the_normal_quantile(scenario):
    evaluator = Evaluator(scenario, num_vehicles=2)
    point = np.array([[0.2, 0.9, 0.5, 0.4]])
    normal = scipy.special.ndtri(point)
    assert evaluator.metrics_at_normal_points(normal, 3).rmse == pytest.approx(evaluator(point, 3).rmse, rel=1e-9)
    flight = simulate(evaluator.scenario_at(point[0], 3))
    assert flight.metrics.rmse == evaluator(point, [3]).rmse[0]


def test_a_shared_variable_moves_all_its_fields(scenario):
    low, high = (np.full((1, 4), 0.5) for _ in range(2))
    index = coordinates(scenario).index(shared_stream("a"))
    low[0, index], high[0, index] = 0.01, 0.99
    small, large = (Batch.at_points(scenario, point, [0]).varying for point in (low, high))
    assert small["vehicle.mass"] < 0.7 < large["vehicle.mass"]
    assert small["vehicle.centre_of_mass.0"] > 0.0 > large["vehicle.centre_of_mass.0"]
    assert small["vehicle.linear_drag"] == large["vehicle.linear_drag"] == pytest.approx(0.2)


def test_points_on_the_boundary_of_the_unit_cube_are_allowed(scenario):
    values = Batch.at_points(scenario, np.array([[0.0] * 4, [1.0] * 4]), [0, 0]).varying
    assert values["vehicle.mass"] == pytest.approx([0.6, 0.8])


@pytest.mark.parametrize(
    ("points", "noise", "message"),
    [
        (np.zeros((2, 3)), 0, r"points have the shape \(2, 3\), but must have \(n, 4\)"),
        (np.zeros(4), 0, r"must have \(n, 4\)"),
        (np.full((1, 4), 1.1), 0, "points must be between 0 and 1"),
        (np.full((1, 4), np.nan), 0, "points must be between 0 and 1"),
        (
            np.full((2, 4), 0.5),
            [1],
            "the noise seed must be a whole number, 2 whole numbers, or whole numbers of the shape \\(2, 1\\)",
        ),
        (np.full((1, 4), 0.5), 0.5, "the noise seed must be a whole number"),
        (np.full((1, 4), 0.5), -1, "the noise seed must be at least 0"),
    ],
)
def test_points_and_noise_seeds_of_wrong_shape_or_range_are_refused(scenario, points, noise, message):
    evaluator = Evaluator(scenario, num_vehicles=1)
    with pytest.raises(InputError, match=message):
        evaluator(points, noise)


def test_a_scenario_without_distributions_is_refused():
    with pytest.raises(InputError, match="hover contains no distribution, so there is nothing to vary"):
        Evaluator(load_scenario("hover"))


@pytest.mark.slow
def test_the_noise_is_the_same_if_each_period_uses_the_sample_of_the_whole_flight(scenario):
    with_one_period, with_many_periods = (
        Evaluator(scenario, num_vehicles=3),
        Evaluator(scenario, num_vehicles=3, noise_period=0.2),
    )
    points = np.full((3, len(with_one_period.names)), 0.4)
    assert with_many_periods.num_periods > 1
    np.testing.assert_array_equal(with_one_period(points, [4, 5, 6]), with_many_periods(points, [4, 5, 6]))


@pytest.mark.long
def test_flights_with_the_same_noise_until_a_period_are_equal_until_then(scenario):
    evaluator = Evaluator(scenario, num_vehicles=2, noise_period=0.2)
    point, numbers = np.full(len(evaluator.names), 0.4), np.arange(evaluator.num_periods)
    changed_numbers = numbers.copy()
    changed_numbers[1] = 99
    first, second = (simulate(evaluator.scenario_at(point, each), compiled=True) for each in (numbers, changed_numbers))
    differs = np.any(first["state"] != second["state"], axis=1)
    # The noise differs in the second noise period, which begins at 0.2 s, and acts through the camera and the
    # controller.
    assert 0.2 <= first.time[np.argmax(differs)] <= 0.3
    uncompiled = simulate(evaluator.scenario_at(point, changed_numbers), compiled=False)
    np.testing.assert_array_equal(uncompiled["state"], second["state"])
    metrics = evaluator(np.stack([point, point]), np.stack([numbers, changed_numbers]))
    assert metrics.rmse[1] == pytest.approx(second.metrics.rmse, rel=1e-12)


def test_a_noise_period_that_is_no_multiple_of_the_control_period_is_refused(scenario):
    with pytest.raises(InputError, match=r"noise.period is 0.0301 s, but must be a multiple of the period of"):
        Evaluator(scenario, num_vehicles=2, noise_period=0.0301)


def test_only_worker_processes_require_systems_that_can_be_pickled(scenario):
    """The threads of an executor share the systems."""
    systems = UserSystems(position_controller=lambda num_vehicles: None)
    with (
        Workers(1) as workers,
        pytest.raises(InputError, match="position_controller cannot be sent to worker processes"),
    ):
        Evaluator(scenario, user_systems=systems, pool=workers)
    with ThreadPoolExecutor(1) as executor:
        Evaluator(scenario, user_systems=systems, pool=ExecutorPool(executor, 1))


def test_points_of_normal_space_have_the_noise_0_by_default(scenario):
    evaluator = Evaluator(scenario, num_vehicles=2)
    points = np.zeros((1, 4))
    assert evaluator.metrics_at_normal_points(points).rmse == evaluator.metrics_at_normal_points(points, 0).rmse
    middle = np.full((1, 4), 0.5)
    assert evaluator(middle).rmse == evaluator(middle, 0).rmse != evaluator(middle, 1).rmse
