"""Tests of the command `compare-log` with logs of a Crazyflie whose controller is known."""

import csv
import re
from pathlib import Path
from types import SimpleNamespace

import pytest

from drake_quad import load_scenario, load_undesigned, read_log
from drake_quad.identification.validation import prediction

ROOT = Path(__file__).parents[2]
LOGS = Path("tests") / "data" / "crazyflie" / "crazyswarm2"
SCENARIO_FILE = Path("diagrams") / "crazyswarm2.yaml"


@pytest.fixture
def compare(run):
    """Return a function that runs the command `compare-log` and returns the exit status and the output."""
    return lambda *arguments: run("compare-log", *arguments)


@pytest.mark.long
def test_the_flown_error_is_within_the_predicted_interval(compare, tmp_path):
    """The flown error would be far outside if the scenario had no errors of the velocity estimate."""
    log, scenario = LOGS / "log100.xz", f"{SCENARIO_FILE}:log100"
    status, printed, _ = compare(log, scenario, "--samples", 40, "--output", tmp_path)
    assert status == 0
    verdict = r"^The measured RMSE, 3\.58 cm, is within the 95 % interval of 40 simulated flights, whose median is \d"
    assert re.search(verdict, printed, re.MULTILINE)
    assert re.search(
        r"^reference: \d+ pieces of degree 7, within 0\.\d\d mm of the logged positions$", printed, re.MULTILINE
    )
    with (tmp_path / "errors.csv").open(encoding="utf-8") as file:
        rows = {(row["error"], row["axis"]): row for row in csv.DictReader(file)}
    assert float(rows["rmse", "all"]["flown (m)"]) == pytest.approx(0.0358, abs=1e-4)
    assert float(rows["rmse", "y"]["low (m)"]) < 0.0348 < float(rows["rmse", "y"]["high (m)"])
    names = [Path(line.strip()).name for line in printed.split("wrote\n")[1].splitlines()]
    assert names == ["errors.csv", "comparison.png", "replay.html", "scenario.yaml"]
    assert (tmp_path / "comparison.png").stat().st_size > 10_000
    again = load_scenario(tmp_path / "scenario.yaml")
    assert (again.route.kind, again.metrics.start) == ("trajectory", 8.0)
    exact = [f"laboratory.motion_capture.velocity_{name}=[0, 0, 0]" for name in ("error", "drift")]
    given = [each for field in exact for each in ("--set", field)]
    status, printed, _ = compare(log, scenario, "--samples", 40, *given, "--output", tmp_path)
    assert re.search(
        r"is outside the 95 % interval of 40 simulated flights, whose median is \S+ cm \[1\.\d+, 2\.\d+\]\.", printed
    )


@pytest.mark.long
def test_a_crash_of_the_data_sheet_vehicle_is_reported(compare, tmp_path):
    """The rotors of the data sheet vehicle are slower than those that flew, and too slow for the controller gains."""
    status, printed, _ = compare(LOGS / "log08.xz", f"{SCENARIO_FILE}:sheet_08", "--samples", 1, "--output", tmp_path)
    assert status == 0
    assert re.search(r"^RMSE +all +5\.65 +crash +–$", printed, re.MULTILINE)
    assert "1 of 1 simulated flights crash" in printed
    assert "nan" not in printed


@pytest.mark.long
def test_a_vehicle_without_a_controller_is_compared_by_open_loop_predictions(compare, monkeypatch):
    """The filter keeps its initial noise. The true thrust factor predicts better than that of the data sheet."""
    monkeypatch.setattr(prediction, "fit", lambda predictor, parameters, noise: SimpleNamespace(noise=noise))
    mass, file = "nominal.mass=0.0375", "diagrams/vehicles/crazyflie.yaml"
    given = ["--set", mass, "--set", "vehicle.thrust_factor=3.025e-8"]
    status, printed, _ = compare(LOGS / "log100.xz", file, *given)
    assert status == 0
    assert printed.startswith("crazyflie has no controller; RMS errors of its open-loop predictions of log100:\n")
    error = 0.01 * float(re.search(r"^position +0\.2 s +(\S+) \[", printed, re.MULTILINE)[1])
    sheet = load_undesigned(ROOT / file, [mass])
    result = prediction.predict(read_log(ROOT / LOGS / "log100.xz"), {"data sheet": sheet}, horizons=(0.2,))
    assert error < 0.7 * result.rmse("position", "data sheet", 0.2).value


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none.xz", f"{SCENARIO_FILE}:log08"], "none.xz"),
        ([LOGS / "log08.xz", f"{SCENARIO_FILE}:log09"], "there is no scenario 'log09'"),
        ([LOGS / "log08.xz", f"{SCENARIO_FILE}:log08", "--samples", 0], "--samples is 0, but must be between 1 and"),
        (
            [LOGS / "log08.xz", f"{SCENARIO_FILE}:log08", "--start", 60],
            "the log 'log08' has fewer than two samples to compare",
        ),
        ([LOGS / "log08.xz", f"{SCENARIO_FILE}:log08", "--rest", -1], "--rest is -1, but must be between 0 and"),
    ],
)
def test_wrong_input_is_refused_with_one_sentence_and_exit_status_2(compare, tmp_path, arguments, message):
    status, printed, errors_printed = compare(*arguments, "--output", tmp_path / "out")
    assert (status, printed) == (2, "")
    errors = [line for line in errors_printed.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert message in errors[0]
