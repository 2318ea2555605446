"""Test of the command that estimates logged flights."""

import re
from dataclasses import replace

import numpy as np
import pytest

from drake_quad import load_scenario, simulate
from drake_quad.command_line import estimate
from drake_quad.logs.record import FlightRecord

BIAS = [0.02, -0.01, 0.03]  # rad/s, bias of the gyroscope


@pytest.fixture
def log(monkeypatch):
    """Replace the reader of logs by a function that returns the log of a simulated flight, and return this log."""
    sensors = [
        {"kind": "gyroscope", "period": 0.02, "noise_density": 1e-3, "bias": BIAS},
        {"kind": "accelerometer", "period": 0.02, "noise_density": 0.01},
    ]
    flight = simulate(load_scenario("hover", {"laboratory.sensors": sensors, "duration": 6.0}), compiled=True)
    state = np.array(flight.record("state"))
    record = FlightRecord(
        "hovering",
        np.array(flight.time),
        position=state[0:3].T,
        attitude=state[3:6].T,
        body_rates=np.array(flight.record("gyroscope")).T,
        specific_force=np.array(flight.record("accelerometer")).T,
    )
    monkeypatch.setattr(estimate, "read_log", lambda path, mapping: record)
    return record


@pytest.mark.slow
def test_the_errors_of_inertial_sensors_are_printed_and_saved_as_a_scenario(log, tmp_path, capsys):
    command = ["hovering.csv", "--attitude-noise", "0.001", "--position-noise", "0.001", "--output", str(tmp_path)]
    estimate.main(estimate.options().parse_args(command))
    printed = capsys.readouterr().out
    rows = re.findall(r"^hovering +gyroscope [xyz] +(\S+) ± \S+ rad/s/√Hz +(\S+) ± \S+ rad/s$", printed, re.MULTILINE)
    assert len(rows) == 3
    for (density, bias), true_bias in zip(rows, BIAS, strict=True):
        assert float(density) == pytest.approx(1e-3, rel=0.2)
        assert float(bias) == pytest.approx(true_bias, abs=5e-3)
    (path,) = tmp_path.glob("*.yaml")
    assert str(path) in printed
    extended = tmp_path / "mine.yaml"
    extended.write_text(f"mine: {{extends: [hover, {path.name}], duration: 1}}\n")
    gyroscope = load_scenario(str(extended)).laboratory.named_sensors["gyroscope"]
    assert gyroscope.bias == pytest.approx(BIAS, abs=5e-3)
    assert gyroscope.noise_density == pytest.approx(1e-3, rel=0.1)


@pytest.mark.slow
def test_a_log_with_irregular_samples_is_estimated_without_the_noise_of_its_sensors(log, monkeypatch, tmp_path, capsys):
    time = log.time + np.where(np.arange(len(log.time)) % 2, 0.006, 0.0)
    monkeypatch.setattr(estimate, "read_log", lambda path, mapping: replace(log, time=time))
    estimate.main(estimate.options().parse_args(["hovering.csv", "--output", str(tmp_path)]))
    output = capsys.readouterr()
    assert "root-mean-square errors in flight" in output.out
    assert "inertial sensors" not in output.out
    assert "cannot estimate the noise of the inertial sensors: only 0 samples of the log hovering" in output.err
    assert not [*tmp_path.glob("*.yaml")]
