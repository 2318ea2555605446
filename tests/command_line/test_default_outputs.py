"""Tests that a command does not overwrite default outputs that were written for another input."""

import argparse
from pathlib import Path

import pytest

from drake_quad import InputError, load_scenario, save_scenario
from drake_quad.command_line import searches
from drake_quad.command_line.default_outputs import Origin, reserve
from drake_quad.command_line.identify import output_file
from drake_quad.command_line.main import COMMANDS, command_module
from drake_quad.command_line.options import resolve_output_folder
from drake_quad.scenario.files.loading import load_undesigned

VEHICLE_FILE = """
drone:
  nominal:
    {{layout: {{kind: x}}, arm_length: 0.17, mass: {mass}, inertia: [0.007, 0.007, 0.012], rotor_inertia: 2.6e-5,
     thrust_factor: 4.13e-5, drag_factor: 8.5e-7, min_rotor_speed: 50.0, max_rotor_speed: 300.0}}
"""


@pytest.fixture
def reserve_folder(tmp_path, monkeypatch):
    """Return a function that reserves the output folder of a command for a vehicle file, and returns the folder.

    The vehicle in the file is called `drone`.
    """
    monkeypatch.chdir(tmp_path)

    def call(file, mass=None, *, output=None):
        path = Path(file)
        path.parent.mkdir(parents=True, exist_ok=True)
        if mass is not None:
            path.write_text(VEHICLE_FILE.format(mass=mass), encoding="utf-8")
        arguments = argparse.Namespace(scenario=file, output=output, default_output=Path("out/gains"))
        return resolve_output_folder(arguments, load_undesigned(file))

    return call


def test_a_folder_of_another_vehicle_with_the_same_name_is_not_overwritten(reserve_folder):
    assert reserve_folder("a/mine.yaml", 0.6) == Path("out/gains/drone")
    with pytest.raises(InputError) as caught:
        reserve_folder("b/mine.yaml", 0.8)
    assert str(caught.value) == (
        "out/gains/drone was written for a/mine.yaml:drone, not for b/mine.yaml:drone; choose another --output"
    )
    assert reserve_folder("b/mine.yaml", output=Path("there")) == Path("there")


def test_a_folder_is_reused_for_an_edited_vehicle_and_for_the_same_vehicle_in_another_file(reserve_folder):
    reserve_folder("a/mine.yaml", 0.6)
    reserve_folder("a/mine.yaml", 0.7)
    reserve_folder("copies/mine.yaml", 0.7)
    with pytest.raises(InputError, match="was written for copies/mine.yaml:drone"):
        reserve_folder("a/mine.yaml", 0.8)


def test_a_scenario_that_a_command_wrote_has_the_same_output_folder_as_the_input_of_that_command(reserve_folder):
    """The folder stays the same if the vehicle is edited and the command writes the scenario again."""
    for mass in (0.6, 0.7):
        folder = reserve_folder("a/mine.yaml", mass)
        save_scenario(load_undesigned("a/mine.yaml"), folder / "scenario.yaml")
        assert reserve_folder("out/gains/drone/scenario.yaml") == folder
    with pytest.raises(InputError, match="was written for a/mine.yaml:drone"):
        reserve_folder("b/mine.yaml", 0.9)


def test_a_folder_without_a_readable_record_may_be_used(reserve_folder):
    folder = Path("out/gains/drone")
    folder.mkdir(parents=True)
    reserve_folder("a/mine.yaml", 0.6)
    (folder / ".input").write_bytes(b"\xff")
    assert reserve_folder("b/mine.yaml", 0.8) == folder
    (folder / ".input").unlink()
    assert reserve_folder("a/mine.yaml", 0.6) == folder


def test_a_vehicle_that_is_identified_from_another_log_of_the_same_name_is_not_overwritten(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def identified(log, **given):
        arguments = argparse.Namespace(**({"log": [Path(log)], "output": None, "name": None} | given))
        path = output_file(arguments, "flight.yaml")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("vehicle", encoding="utf-8")
        return path

    assert identified("a/flight.csv") == identified("a/flight.csv") == Path("out/identified/flight.yaml")
    with pytest.raises(
        InputError, match="out/identified/flight.yaml was written for a/flight.csv, not for b/flight.csv"
    ):
        identified("b/flight.csv")
    assert identified("b/flight.csv", name="flight") == Path("out/identified/flight.yaml")
    assert identified("b/flight.csv", output=Path("mine.yaml")) == Path("mine.yaml")


def test_a_comparison_with_another_log_of_the_same_name_is_not_overwritten(tmp_path):
    scenario, other = (
        Origin.of_scenario("hover", load_scenario("hover", changes)) for changes in ([], ["nominal.mass=0.7"])
    )
    first, second = Origin.of_file(Path("a/flight.csv")), Origin.of_file(Path("b/flight.csv"))
    for origins in ((scenario, first), (other, first)):
        reserve(tmp_path / "flight_hover", origins)
    with pytest.raises(InputError, match="not for .*b/flight.csv"):
        reserve(tmp_path / "flight_hover", (scenario, second))


def test_every_default_folder_that_is_named_after_a_scenario_is_reserved():
    """A command that does not call `resolve_output_folder` could overwrite the results of another input."""
    for command in COMMANDS:
        module = command_module(command)
        if "default_output" in vars(module.options())["_defaults"]:
            source = Path(module.__file__).read_text(encoding="utf-8")
            if "open_search(arguments, " in source:
                source += Path(searches.__file__).read_text(encoding="utf-8")
            assert "resolve_output_folder(arguments, " in source
            assert "default_output /" not in source
