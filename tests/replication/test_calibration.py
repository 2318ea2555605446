"""Tests that the values in diagrams/controllers/calibrated.yaml are results of the calibration."""

import math
import re

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.replication import calibration
from drake_quad.replication.calibration import HYPOTHESES, FreeParameter, Hypothesis, calibrate, pd_gains
from drake_quad.replication.published import Cell, published_table
from drake_quad.studies.comparison import fly_samples


def load(cell, overrides=()):
    return load_scenario(f"diagrams/paper.yaml:{cell.scenario}", overrides)


@pytest.mark.slow
@pytest.mark.parametrize("cell", [calibration.PD_CELL, calibration.NETWORK_CELL])
def test_the_calibrated_cells_are_reproduced(cell):
    """The error without wind hardly differs between samples, so a tolerance of 2 % is sufficient."""
    assert fly_samples(load(cell), range(6)).rmse.mean() == pytest.approx(published_table()[cell].rmse.mean, rel=0.003)


@pytest.mark.slow
def test_a_fit_finds_the_shipped_values(monkeypatch):
    """To save time, the range of the search is narrow, and predictions are omitted."""
    table = {cell: line for cell, line in published_table().items() if cell.wind == "no_wind"}
    monkeypatch.setattr(calibration, "published_table", lambda: table)
    first = HYPOTHESES["measurement"]
    narrow_range = first._replace(
        pd=first.pd._replace(low=1.19, high=1.215), network=first.network._replace(low=1.94, high=2.01)
    )
    result = calibrate(narrow_range, load, 3)
    control = load(calibration.NETWORK_CELL).control
    position = control.position
    assert position.k_p[0] == pytest.approx(result.pd**2, rel=0.01)
    assert position.k_d[0] == pytest.approx(1.4 * result.pd, rel=0.01)
    assert control.network.learning.slope == pytest.approx(result.network, rel=0.01)
    assert result.errors[Cell("no_wind", "pd")].value == pytest.approx(0.972, abs=0.001)


def test_gains_have_the_declared_damping():
    overrides = dict(override.split("=") for override in pd_gains(1.3))
    k_p, k_d = (float(overrides[f"control.position.{name}.1"]) for name in ("k_p", "k_d"))
    assert k_d / (2.0 * k_p**0.5) == pytest.approx(0.7)
    assert k_p == pytest.approx(1.69)


@pytest.mark.slow
def test_an_impossible_fit_is_refused():
    stiff = FreeParameter("bandwidth of the PD (rad/s)", 1.8, 1.9, pd_gains)
    with pytest.raises(InputError, match="reproduces the mean error of 0.972 m"):
        calibrate(HYPOTHESES["measurement"]._replace(pd=stiff), load, 2)


def gains(k_p, k_d):
    return [f"control.position.{name}.{axis}={gain}" for name, gain in (("k_p", k_p), ("k_d", k_d)) for axis in (0, 1)]


@pytest.mark.parametrize(
    ("name", "fixed", "first", "second"),
    [
        (
            "measurement",
            [],
            (0.9, 1.6, gains(4.0, 2.8)),
            (0.5, 2.5, ["control.network.learning.slope=2.0"]),
        ),
        (
            "low_gain",
            ["control.position.derivative=tracking_error"],
            (0.35, 1.2, gains(4.0, 2.8)),
            (0.03, 30.0, ["control.network.learning.slope=1.0", "control.network.learning.initial_covariance=2.0"]),
        ),
        (
            "bias",
            ["control.position.derivative=tracking_error", *gains(1.44, 1.68)],
            (0.0, 0.005, ["vehicle.centre_of_mass=[2.0, 2.0]"]),
            (0.03, 30.0, ["control.network.learning.slope=1.0", "control.network.learning.initial_covariance=2.0"]),
        ),
    ],
)
def test_hypotheses_have_the_expected_fixed_and_free_parameters(name, fixed, first, second):
    """The test compares the limits of both parameters, and the overrides that set them to 2."""
    hypothesis = HYPOTHESES[name]
    assert hypothesis.overrides == fixed
    for free_parameter, expected in ((hypothesis.pd, first), (hypothesis.network, second)):
        assert (free_parameter.low, free_parameter.high, free_parameter.overrides(2.0)) == expected


def free_parameter(name, low=0.0, high=10.0):
    return FreeParameter(name, low, high, lambda value: [f"{name}={value!r}"])


def errors_of(levels):
    """Return a function in place of flights, which returns invented errors of a cell.

    The mean error is the level of the cell times the cubes of all free parameters.
    """

    def fly(scenario, num_samples, *, compiled):
        assert compiled
        cell, overrides = scenario
        free = dict(override.split("=") for override in overrides)
        assert free.pop("fixed") == "1"
        spread = np.linspace(-0.5, 0.5, num_samples)
        return levels[cell] * np.prod([float(value) ** 3 for value in free.values()]) + spread

    return fly


def test_two_parameters_are_fitted_in_turn_and_predict_the_other_cells(monkeypatch):
    """Errors are proportional to the cubes of both parameters; the PD's error depends only on the first."""
    assert (calibration.PD_CELL, calibration.NETWORK_CELL) == (("no_wind", "pd"), ("no_wind", "pd_t2fnn"))
    levels = {cell: 0.1 * (2.0 + index) for index, cell in enumerate(published_table())}
    monkeypatch.setattr(calibration, "_errors", errors_of(levels))
    free = Hypothesis("in proportion", ["fixed=1"], free_parameter("first"), free_parameter("second"))
    result = calibrate(free, lambda cell, overrides: (cell, overrides), 5)
    x_cubed = published_table()[calibration.PD_CELL].rmse.mean / levels[calibration.PD_CELL]
    y_cubed = published_table()[calibration.NETWORK_CELL].rmse.mean / levels[calibration.NETWORK_CELL] / x_cubed
    x, y = x_cubed ** (1.0 / 3.0), y_cubed ** (1.0 / 3.0)
    assert (result.hypothesis, result.pd, result.network) == (
        free,
        pytest.approx(x, rel=1e-3),
        pytest.approx(y, rel=1e-3),
    )
    assert list(result.errors) == list(published_table())
    for cell, error in result.errors.items():
        expected = levels[cell] * x_cubed * (1.0 if cell.controller == "pd" else y_cubed)
        assert error.value == pytest.approx(expected, rel=1e-2)
        # The interval is Student's for five values from -0.5 to 0.5 m around the mean.
        assert error.high - error.value == pytest.approx(2.776445 * np.std(np.linspace(-0.5, 0.5, 5), ddof=1) / 5**0.5)


@pytest.mark.parametrize(("low", "high"), [(2.0, 5.0), (0.1, 1.5)])
def test_a_parameter_range_that_cannot_reproduce_the_target_error_is_refused(low, high):
    free = FreeParameter("gain (1/s)", low, high, lambda value: value)
    words = (
        f"no gain (1/s) between {low:g} and {high:g} reproduces the mean error of 1.75 m: the error differs from the"
        f" target by {low - 1.75:+.3g} and {high - 1.75:+.3g} m at the ends"
    )
    with pytest.raises(InputError, match=re.escape(words)):
        calibration._fit(free, lambda value: np.full(3, value), 1.75)


@pytest.mark.slow
def test_a_crash_counts_as_an_infinite_error():
    crashing_overrides = ["duration=1", "crash.position_error=0.001"]
    assert calibration._errors(load(Cell("low_wind", "pd"), crashing_overrides), 2).tolist() == [math.inf] * 2
