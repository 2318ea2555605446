"""Tests of Sobol indices, for functions with known indices and for scenarios."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.studies import sobol_indices as module
from drake_quad.studies.sobol_indices import CRASHED, NOISE, sobol_indices

MASS_DISTRIBUTION = "vehicle.mass={normal: {mean: 0.68, standard_deviation: 0.02, min: 0.5}}"


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("hover", ["duration=0.3", MASS_DISTRIBUTION])


@pytest.fixture
def replace_flights(monkeypatch):
    """Return a function that replaces flights with a given formula.

    The arguments of the formula are three parameters and the noise, all in [0, 1].
    """

    def replace(function, crashed=lambda points: np.zeros(len(points), dtype=bool)):
        class Evaluator:
            names = ("a", "b", "c")

            def __init__(self, scenario, **options):
                pass

            def batches(self, points, noise):
                metrics = SimpleNamespace(rmse=function(points, noise[:, 0] / 2**31), crashed=crashed(points))
                yield np.arange(len(points)), metrics

        monkeypatch.setattr(module, "Evaluator", Evaluator)

    return replace


@pytest.mark.slow
def test_the_indices_of_ishigami_s_function_are_those_of_the_literature(scenario, replace_flights):
    """The indices are those of Saltelli et al., "Sensitivity Analysis" (2000), for a = 7 and b = 0.1."""

    def ishigami(points, noise):
        x, y, z = (math.pi * (2.0 * points - 1.0)).T
        return np.sin(x) + 7.0 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)

    replace_flights(ishigami)
    indices = {each.name: each for each in sobol_indices(scenario, "rmse", num_points=4096)}
    expected = {"a": (0.3139, 0.5576), "b": (0.4424, 0.4424), "c": (0.0, 0.2437), NOISE: (0.0, 0.0)}
    for name, (first_order, total) in expected.items():
        assert indices[name].first_order.value == pytest.approx(first_order, abs=0.01)
        assert indices[name].total.value == pytest.approx(total, abs=0.01)
        assert indices[name].total.low - 1e-9 <= total <= indices[name].total.high + 1e-9


def test_the_noise_has_indices_like_a_single_parameter(scenario, replace_flights):
    """The metric is the sum of a parameter and the noise. Each of them explains its own variance."""
    replace_flights(lambda points, noise: 2.0 * points[:, 0] + noise)
    first, second, *other_indices = sobol_indices(scenario, "rmse", num_points=1024)
    assert (first.name, second.name) == ("a", NOISE)
    assert first.total.value == pytest.approx(0.8, abs=0.01)
    assert second.total.value == pytest.approx(0.2, abs=0.01)
    assert all(abs(each.total.value) < 1e-9 for each in other_indices)


def test_sobol_indices_of_other_metrics_than_crashed_are_refused_if_a_flight_crashes(scenario, replace_flights):
    replace_flights(lambda points, noise: points[:, 1], crashed=lambda points: points[:, 2] > 0.8)
    first, *_ = sobol_indices(scenario, CRASHED, num_points=256)
    assert (first.name, first.total.value) == ("c", pytest.approx(1.0, abs=0.05))
    with pytest.raises(InputError, match=r"flights crashed, so the variance of rmse is not defined; use crashed as"):
        sobol_indices(scenario, "rmse", num_points=256)


@pytest.mark.parametrize(
    ("function", "words"),
    [
        (lambda points, noise: np.ones(len(points)), "rmse does not vary"),
        (lambda points, noise: np.where(points[:, 0] > 0.5, np.nan, 1.0), "rmse is not finite in every flight"),
    ],
)
def test_metrics_without_a_variance_are_refused(scenario, replace_flights, function, words):
    replace_flights(function)
    with pytest.raises(InputError, match=words):
        sobol_indices(scenario, "rmse", num_points=16)


@pytest.mark.parametrize(
    ("metric", "num_points", "words"),
    [
        ("rms", 16, "there is no metric called .rms.; did you mean rmse"),
        ("rmse", 100, "num_points is 100, but must be a power of two"),
        ("rmse", 4, "num_points is 4, but must be at least 8"),
    ],
)
def test_sobol_indices_are_refused_for_unknown_metrics_and_invalid_numbers_of_points(
    scenario, metric, num_points, words
):
    with pytest.raises(InputError, match=words):
        sobol_indices(scenario, metric, num_points=num_points)


@pytest.mark.slow
def test_the_mass_explains_most_of_the_height_error_of_a_hover(scenario):
    first, second = sobol_indices(scenario, "rmse_z", num_points=64)
    assert (first.name, second.name) == ("vehicle.mass", NOISE)
    assert first.total.value > 0.8
