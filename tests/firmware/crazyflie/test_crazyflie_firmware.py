"""Flights with the Crazyflie's firmware, or with a stand-in for its Python bindings if they are not installed."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from drake_quad import load_scenario, simulate, simulate_samples
from drake_quad.errors import InputError
from drake_quad.firmware.controller import FirmwareError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="firmware flies only on Linux")
STUB = Path(__file__).parent / "stub"


@pytest.fixture(params=["stub", "firmware"])
def bindings(request, monkeypatch):
    """Make the stand-in or, if they are installed, the real bindings importable."""
    if request.param == "stub":
        monkeypatch.syspath_prepend(str(STUB))
    elif importlib.util.find_spec("cffirmware") is None:
        pytest.skip("cffirmware is not installed; docs/how_to/fly_crazyflie_firmware.md says how to build it")
    return request.param


def scenario(mode="angle", overrides=None):
    hover = {"route": {"kind": "hover", "position": [0.0, 0.0, 1.0], "yaw": 0.7}, "duration": 4.0}
    layers = ["vehicles/crazyflie", f"firmware/crazyflie:{mode}"]
    return load_scenario("laboratory:nominal", [hover, overrides or {}], layers=layers)


@pytest.mark.long
@pytest.mark.usefixtures("bindings")
@pytest.mark.parametrize("mode", ["angle", "acro"])
def test_the_vehicle_hovers_and_flights_repeat(mode):
    flights = [simulate(scenario(mode)) for _ in range(2)]
    assert not flights[0].metrics.crashed
    assert flights[0].metrics.rmse < 0.02
    assert abs(flights[0].record("state").yaw[-1] - 0.7) < 0.02
    np.testing.assert_array_equal(flights[0]["state"], flights[1]["state"])


@pytest.mark.long
@pytest.mark.usefixtures("bindings")
def test_the_vehicle_follows_a_route_from_a_tilted_start():
    eight = {
        "route": {"kind": "figure_eight"},
        "duration": 12.0,
        "initial": {"attitude": [0.4, -0.3, 0.5], "body_rates": [1.0, 1.0, 0.5]},
    }
    flight = simulate(scenario(overrides=eight))
    assert not flight.metrics.crashed
    assert flight.euclidean_error[-100:].max() < 0.6


@pytest.mark.long
def test_each_vehicle_of_a_fleet_has_its_own_firmware(monkeypatch):
    monkeypatch.syspath_prepend(str(STUB))
    alone = simulate(scenario())
    first, second = simulate_samples(scenario(), range(2))
    np.testing.assert_array_equal(first["state"], alone["state"])
    assert not np.array_equal(first["state"], second["state"])


def test_a_plus_is_refused(monkeypatch):
    monkeypatch.syspath_prepend(str(STUB))
    plus = load_scenario("laboratory:nominal", layers=["vehicles/paper", "firmware/crazyflie:angle"])
    with pytest.raises(InputError, match="do not fit nominal.layout; choose a layout of kind x"):
        simulate(plus)


def test_missing_bindings_are_reported(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="^cffirmware is not installed; build it in a checkout"):
        simulate(scenario())


def test_bindings_that_fail_end_the_flight_with_their_last_output(tmp_path, monkeypatch):
    (tmp_path / "cffirmware.py").write_text("raise OSError('wrong architecture')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(FirmwareError, match="firmware ended with status 1; its last output was: OSError: wrong arch"):
        simulate(scenario())
