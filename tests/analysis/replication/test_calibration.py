"""The declared numbers of diagrams/controllers/calibrated.yaml are those that the calibration gives."""

import pytest

from drake_quad import InputError, load_scenario
from drake_quad.analysis.comparison import fly_samples
from drake_quad.analysis.replication import calibration
from drake_quad.analysis.replication.calibration import HYPOTHESES, FreeNumber, calibrate, pd_gains
from drake_quad.analysis.replication.printed import Cell, table_ii


def load(cell, overrides=()):
    return load_scenario(f"diagrams/paper.yaml:{cell.scenario}", overrides)


@pytest.mark.parametrize("cell", [calibration.PD_CELL, calibration.NETWORK_CELL])
def test_the_calibrated_cells_are_met(cell):
    """Within 2 %, and by far: the error without wind hardly differs between samples."""
    assert fly_samples(load(cell), range(6)).rmse.mean() == pytest.approx(table_ii()[cell].rmse.mean, rel=0.003)


def test_a_fit_finds_the_declared_numbers(monkeypatch):
    """From limits close by, and without the predictions, which take most of the time."""
    table = {cell: line for cell, line in table_ii().items() if cell.wind == "no_wind"}
    monkeypatch.setattr(calibration, "table_ii", lambda: table)
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
