"""The declared numbers of diagrams/controllers/calibrated.yaml are those that the calibration gives."""

import pytest

from drake_quad import InputError, load_scenario
from drake_quad.replication import calibration
from drake_quad.replication.calibration import HYPOTHESES, FreeNumber, calibrate, pd_gains
from drake_quad.replication.printed import Cell, printed_table
from drake_quad.studies.comparison import fly_samples


def load(cell, overrides=()):
    return load_scenario(f"diagrams/paper.yaml:{cell.scenario}", overrides)


@pytest.mark.parametrize("cell", [calibration.PD_CELL, calibration.NETWORK_CELL])
def test_the_calibrated_cells_are_met(cell):
    """Within 2 %, and by far: the error without wind hardly differs between samples."""
    assert fly_samples(load(cell), range(6)).rmse.mean() == pytest.approx(printed_table()[cell].rmse.mean, rel=0.003)


def test_a_fit_finds_the_declared_numbers(monkeypatch):
    """From limits close by, and without the predictions, which take most of the time."""
    table = {cell: line for cell, line in printed_table().items() if cell.wind == "no_wind"}
    monkeypatch.setattr(calibration, "printed_table", lambda: table)
    first = HYPOTHESES["measurement"]
    near = first._replace(
        pd=first.pd._replace(low=1.19, high=1.215), network=first.network._replace(low=1.94, high=2.01)
    )
    found = calibrate(near, load, 3)
    position = load(calibration.NETWORK_CELL).control.position
    assert position.k_p[0] == pytest.approx(found.pd**2, rel=0.01)
    assert position.k_d[0] == pytest.approx(1.4 * found.pd, rel=0.01)
    assert position.learning.slope == pytest.approx(found.network, rel=0.01)
    assert found.errors[Cell("no_wind", "pd")].value == pytest.approx(0.972, abs=0.001)


def test_gains_have_the_declared_damping():
    overrides = dict(override.split("=") for override in pd_gains(1.3))
    k_p, k_d = (float(overrides[f"control.position.{name}.1"]) for name in ("k_p", "k_d"))
    assert k_d / (2.0 * k_p**0.5) == pytest.approx(0.7)
    assert k_p == pytest.approx(1.69)


def test_what_cannot_be_fitted_is_said():
    stiff = FreeNumber("bandwidth of the PD (rad/s)", 1.8, 1.9, pd_gains)
    with pytest.raises(InputError, match="there is nothing to fit"):
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
            (0.5, 2.5, ["control.position.learning.slope=2.0"]),
        ),
        (
            "low_gain",
            ["control.position.derivative=tracking_error"],
            (0.35, 1.2, gains(4.0, 2.8)),
            (0.03, 30.0, ["control.position.learning.slope=1.0", "control.position.learning.initial_covariance=2.0"]),
        ),
        (
            "bias",
            ["control.position.derivative=tracking_error", *gains(1.44, 1.68)],
            (0.0, 0.005, ["vehicle.centre_of_mass=[2.0, 2.0]"]),
            (0.03, 30.0, ["control.position.learning.slope=1.0", "control.position.learning.initial_covariance=2.0"]),
        ),
    ],
)
def test_what_a_hypothesis_fixes_and_what_it_frees(name, fixed, first, second):
    """The limits of both numbers, and what sets them to 2."""
    hypothesis = HYPOTHESES[name]
    assert hypothesis.overrides == fixed
    for number, expected in ((hypothesis.pd, first), (hypothesis.network, second)):
        assert (number.low, number.high, number.overrides(2.0)) == expected
