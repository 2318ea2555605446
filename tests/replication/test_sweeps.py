"""Tests of the settings of the sweeps and of the fields that they set."""

import re

import numpy as np
import pytest

from drake_quad import load_scenario, simulate
from drake_quad.replication.published import CONTROLLERS
from drake_quad.replication.sweeps import (
    BEST_GAIN_RANGES,
    EXPONENTS,
    NOISE_LEVELS,
    NOISE_SETTINGS,
    Q_SETTINGS,
    Q_VALUES,
    SLOPE_SETTINGS,
    SLOPES,
    fly_legs,
    fly_settings,
    gain_settings,
    settings_batch,
)
from drake_quad.scenario.numbers import number_at

NETWORK = "control.network"


def test_exponents_of_the_sweeps_agree_with_table_ii():
    assert list(EXPONENTS) == ["pd_t1fnn", "pd_t2fnn", "pd_t2fnn_wide"]
    assert EXPONENTS["pd_t1fnn"] == (1.0, 1.0)
    for name in ("pd_t2fnn", "pd_t2fnn_wide"):
        a1, a2 = re.search(r"\((.*), (.*)\)", CONTROLLERS[name]).groups()
        assert EXPONENTS[name] == (float(a1), float(a2))


def test_sweeps_have_the_expected_settings():
    """The noise ranges up to 20 mm, q from 0 to 1, and λ around the calibrated 1.975 1/s."""
    assert NOISE_LEVELS == (0.0, 0.001, 0.005, 0.01, 0.02)
    assert Q_VALUES == (0.0, 0.25, 0.5, 0.75, 1.0)
    assert SLOPES == (1.0, 1.5, 1.75, 2.0, 2.25, 2.5, 3.0)
    for settings, name, values in ((NOISE_SETTINGS, "noise", NOISE_LEVELS), (Q_SETTINGS, "q", Q_VALUES)):
        assert list(settings) == [name, "a1", "a2"]
        rows = list(zip(*settings.values(), strict=True))
        assert rows == [(value, *exponents) for value in values for exponents in EXPONENTS.values()]
    assert {name: values.tolist() for name, values in SLOPE_SETTINGS.items()} == {"slope": list(SLOPES)}


@pytest.mark.parametrize(
    ("ranges", "k_p", "k_d"), [((), (0.3, 20.0), (0.3, 12.0)), ((BEST_GAIN_RANGES,), (2.5, 9.0), (1.0, 4.5))]
)
def test_gains_are_in_geometric_steps(ranges, k_p, k_d):
    result = gain_settings(3, *ranges)
    middle = [(low * high) ** 0.5 for low, high in (k_p, k_d)]
    expected = [(p, d) for p in (k_p[0], middle[0], k_p[1]) for d in (k_d[0], middle[1], k_d[1])]
    assert list(zip(result["k_p"], result["k_d"], strict=True)) == [pytest.approx(pair) for pair in expected]


def test_settings_are_written_to_their_fields_of_the_scenario():
    scenario = load_scenario("diagrams/paper.yaml:no_wind_pd_t2fnn")
    names = ("noise", "q", "a1", "a2", "k_p", "k_d", "slope")
    settings = {name: np.array([10.0 + index, 20.0 + index]) for index, name in enumerate(names)}
    batch = settings_batch(scenario, settings, [4, 0, 7])
    assert (len(batch), batch.samples) == (6, (4, 0, 7) * 2)
    for vehicle in range(6):
        varied = batch.vehicle_scenario(vehicle)
        position, network = varied.control.position, varied.control.network
        result = {
            "noise": [varied.laboratory.motion_capture.position_noise],
            **{name: [getattr(network, name)] for name in ("q", "a1", "a2")},
            **{name: getattr(position, name)[:2] for name in ("k_p", "k_d")},
            "slope": [network.learning.slope],
        }
        for name, values in settings.items():
            assert {*result[name]} == {values[vehicle // 3]}
        for name in ("k_p", "k_d"):
            assert getattr(position, name)[2] == number_at(scenario, f"control.position.{name}.2")


@pytest.mark.slow
def test_metrics_have_a_row_for_each_setting_and_a_column_for_each_sample():
    """Each metric equals the metric of a single flight of the sample with the gains of the setting."""
    scenario = load_scenario("diagrams/paper.yaml:low_wind_pd", ["duration=0.6"])
    settings = {"k_p": np.array([1.0, 3.0]), "k_d": np.array([1.5, 2.0])}
    result = fly_settings(scenario, settings, [4, 0, 7])
    assert result.rmse.shape == (2, 3)
    for row, (k_p, k_d) in enumerate(((1.0, 1.5), (3.0, 2.0))):
        gains = [
            f"control.position.{name}.{axis}={gain}" for name, gain in (("k_p", k_p), ("k_d", k_d)) for axis in (0, 1)
        ]
        single_scenario = load_scenario("diagrams/paper.yaml:low_wind_pd", ["duration=0.6", *gains])
        for column, sample in enumerate((4, 0, 7)):
            metrics = simulate(single_scenario, sample=sample, compiled=False).metrics
            np.testing.assert_allclose([values[row, column] for values in result], metrics, rtol=1e-9)


@pytest.mark.slow
def test_leg_metrics_have_a_row_for_each_setting():
    scenario = load_scenario("diagrams/paper.yaml:no_wind_pd", ["duration=13.5"])
    settings = {"k_p": np.array([1.4, 4.0]), "k_d": np.array([1.7, 3.0])}
    result = fly_legs(scenario, settings, [5, 1])
    assert all(values.shape == (2, 2) for values in result)
    (single_value,) = (values[0, 0] for values in fly_legs(scenario, {"k_p": [4.0], "k_d": [3.0]}, [1])[:1])
    assert result.straight[1, 1] == pytest.approx(single_value, rel=1e-9)
