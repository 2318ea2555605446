"""Tests of the command `drake-quad offboard`."""

import functools
import json
import socket

import pytest

from drake_quad import InputError, load_scenario
from drake_quad.command_line import offboard
from drake_quad.offboard.limits import Limits
from drake_quad.offboard.link import OffboardError, VehicleLink

pytest.importorskip("pymavlink", reason="the extra px4 is not installed")
from stand_in import HOP, SimulatedClock, StandInVehicle

SHORT = {**HOP, "waypoints": [{"point": [0, 0, 1]}, {"point": [0.05, 0, 1]}], "times": [0.0, 0.5]}


def run(monkeypatch, tmp_path, *options):
    """Run the command with a vehicle that hovers."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    clock = SimulatedClock()
    vehicle = StandInVehicle(port, clock=clock)
    monkeypatch.setattr(offboard, "VehicleLink", functools.partial(VehicleLink, clock=clock))
    overrides = ["--set", f"route={json.dumps(SHORT)}", "--set", "metrics={start: 0, end: null}"]
    arguments = ["onboard", *overrides, "--address", f"udpin:127.0.0.1:{port}", "--output", str(tmp_path), *options]
    try:
        offboard.main(offboard.options().parse_args(arguments))
    finally:
        vehicle.close()
    return vehicle


def test_a_flight_prints_its_phases_and_its_error(monkeypatch, tmp_path, capsys):
    vehicle = run(monkeypatch, tmp_path, "--send", "attitude", "--engage")
    words = capsys.readouterr().out
    for text in (
        "switching to OFFBOARD",
        "following the route for 0.5 s",
        "the route is complete",
        "RMSE",
        "thrust 0.",
    ):
        assert text in words
    assert vehicle.mode == "LOITER"
    assert (tmp_path / offboard.LOG).exists()
    assert load_scenario(tmp_path / "scenario.yaml").name == "onboard"


def test_a_dry_run_prints_no_error(monkeypatch, tmp_path, capsys):
    vehicle = run(monkeypatch, tmp_path, "--dry-run")
    words = capsys.readouterr().out
    assert "the route is complete" in words
    assert "RMSE" not in words
    assert vehicle.received == []


@pytest.mark.parametrize("fence", ["1 -1 -1 1 0 2", "-1 1 -1 1 nan 2"])
def test_a_fence_that_is_no_box_is_refused(tmp_path, fence):
    with pytest.raises(InputError, match="^--fence: the first number of each pair must be smaller than the second$"):
        offboard.main(offboard.options().parse_args(["onboard", "--output", str(tmp_path), "--fence", *fence.split()]))


def test_a_flight_that_ends_early_fails(monkeypatch, tmp_path):
    fast = ["--set", "route.waypoints.1.point=[1,0,1]", "--set", "route.times.1=2.0"]
    fence = ["--fence", "2", "3.5", "-9", "9", "0", "9"]
    with pytest.raises(InputError, match="leaves the geofence"):
        run(monkeypatch, tmp_path, "--engage", *fast, *fence)
    monkeypatch.setattr(Limits, "violation", lambda self, state, reference: "the test ends the flight")
    with pytest.raises(OffboardError, match="the flight ended early: the test ends the flight; the vehicle changed to"):
        run(monkeypatch, tmp_path, "--engage", *fast)
