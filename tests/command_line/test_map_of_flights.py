"""Tests of the command `map` with `--vary`, which draws maps of flights over two fields."""

import numpy as np
import pytest

from drake_quad import load_scenario, simulate

VARIED = ("--vary", "initial.attitude.0", "-2", "2", "--vary", "initial.body_rates.0", "-4", "4")


def controllers(*names):
    return [word for name in names for word in ("--controller", f"controllers/designed/laboratory:{name}")]


@pytest.mark.long
@pytest.mark.usefixtures("blank_figures")
def test_a_map_of_flights_has_columns_for_each_controller(run, tmp_path):
    options = ["--size", 2, "--metric", "largest_tilt", "--set", "duration=1", "--output", tmp_path]
    result = run("map", "upset", *VARIED, *controllers("pd", "indi"), *options)
    assert result.returncode == 0
    lines = result.stdout.splitlines()
    assert lines[0].split("  ")[0] == "controller"
    assert [line.split()[0] for line in lines[1:3]] == ["pd", "indi"]
    assert [line.strip() for line in lines[-2:]] == [str(tmp_path / f"field_map.{suffix}") for suffix in ("csv", "png")]
    table = np.genfromtxt(tmp_path / "field_map.csv", delimiter=",", names=True, deletechars="", replace_space=" ")
    names = [f"{name}: {column}" for name in ("pd", "indi") for column in ("largest_tilt", "recovers", "crash_time")]
    assert list(table.dtype.names) == ["initial.attitude.0", "initial.body_rates.0", *names]
    np.testing.assert_allclose(table["initial.attitude.0"], [-1.0, 1.0, -1.0, 1.0])
    np.testing.assert_allclose(table["initial.body_rates.0"], [-2.0, -2.0, 2.0, 2.0])
    initial = {"attitude": [1.0, 0, 0], "body_rates": [2.0, 0, 0], "velocity": [0, 0, 0], "position": [0, 0, 0]}
    fields = {f"initial.{name}": value for name, value in {**initial, "rotor_speeds": [0.6] * 4}.items()}
    scenario = load_scenario("upset", {**fields, "duration": 1.0}, layers=["controllers/designed/laboratory:pd"])
    assert table["pd: largest_tilt"][3] == pytest.approx(simulate(scenario, sample=0).metrics.largest_tilt, rel=1e-5)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (VARIED[:4], "--vary is given 1 times, but a map has two axes; give it twice"),
        ([*VARIED, "--k-p", "0", "1"], "--k-p is an option of maps of gains; leave it out with --vary"),
        ([*VARIED, "--loop", "attitude"], "--loop is an option of maps of gains; leave it out with --vary"),
        ([*VARIED, "--metric", "height"], "--metric: height is not a metric of upset"),
        ([*VARIED[:4], "--vary", "initial.attitude.0", "-1", "1"], "both axes of the map are initial.attitude.0"),
        ([*VARIED[:4], "--vary", "initial.attitude.0", "1", "-1"], "initial.attitude.0"),
        ([*VARIED[:4], "--vary", "vehicle.masss", "1", "2"], "masss"),
        (controllers("pd", "indi"), "a map of gains has one controller; give --controller once"),
    ],
)
def test_invalid_axes_of_a_map_are_refused(run, tmp_path, arguments, message):
    result = run("map", "upset", *arguments, "--size", 2, "--output", tmp_path)
    assert result.returncode == 2
    assert message in result.stderr
    assert not [*tmp_path.iterdir()]
