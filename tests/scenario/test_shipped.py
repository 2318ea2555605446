"""Tests that names of shipped scenarios do not depend on the working directory."""

import pytest

from drake_quad import InputError, load_scenario
from drake_quad.scenario.files.library import is_shipped
from drake_quad.scenario.files.loading import load_undesigned
from drake_quad.scenario.files.shipped import shipped_file, shipped_folder, shipped_names, shipped_scenarios


def test_shipped_names_do_not_depend_on_the_working_directory(diagrams, tmp_path, monkeypatch):
    expected = load_scenario(diagrams / "laboratory.yaml:high_wind")
    monkeypatch.chdir(tmp_path)
    assert load_scenario("laboratory:high_wind") == expected
    assert load_scenario("figure_eight").name == "figure_eight"
    assert (
        load_undesigned("vehicles/hummingbird").vehicle
        == load_undesigned(diagrams / "vehicles/hummingbird.yaml").vehicle
    )
    pd = load_scenario("laboratory:high_wind", layers=["controllers/paper:pd"])
    assert pd == load_scenario(diagrams / "laboratory.yaml:high_wind", layers=[diagrams / "controllers/paper.yaml:pd"])


@pytest.mark.slow
def test_every_shipped_scenario_loads_by_its_name(diagrams):
    assert {shipped_file(name).resolve() for name in shipped_names()} == {*diagrams.rglob("*.yaml")}
    assert shipped_folder() == diagrams
    for name in shipped_scenarios():
        if not name.startswith(("controllers/", "gains/")):
            load_undesigned(name)
        assert is_shipped(name)


def test_a_file_can_extend_a_shipped_scenario(tmp_path):
    (tmp_path / "mine.yaml").write_text(
        "a: {extends: ['laboratory:low_wind', gains/laboratory]}\nhover: {extends: a}\n"
    )
    layered = load_scenario("laboratory:low_wind", layers=["gains/laboratory"])
    assert load_scenario(tmp_path / "mine.yaml:a").control == layered.control
    # In `extends`, a name without a file refers to a scenario in the same file, if the file contains one of this name.
    assert load_scenario(tmp_path / "mine.yaml:hover").route == layered.route
    (tmp_path / "other.yaml").write_text(
        "mine: {extends: hover}\nfaulty: {extends: laboratory}\nmore: {extends: nowhere}\n"
    )
    assert load_scenario(tmp_path / "other.yaml:mine").route == load_scenario("hover").route
    with pytest.raises(InputError, match="other.yaml:2: .*laboratory.yaml contains several scenarios"):
        load_scenario(tmp_path / "other.yaml:faulty")
    with pytest.raises(
        InputError, match="other.yaml:3: there is no scenario 'nowhere' in .*other.yaml, which contains mine, "
    ):
        load_scenario(tmp_path / "other.yaml:more")


def test_a_file_or_folder_of_the_same_name_does_not_hide_a_shipped_scenario(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hover").mkdir()
    assert load_scenario("hover").route.kind == "hover"


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        (
            "laboratry:nominal",
            "'laboratry:nominal' is neither a file nor a shipped scenario; did you mean laboratory?",
        ),
        (
            "quite_different",
            "is neither a file nor a shipped scenario; `drake-quad scenarios` lists the shipped scenarios",
        ),
        ("../diagrams/hover", "is neither a file nor a shipped scenario"),
        ("mine.py:Mine", "is neither .*; a controller in Python is given by --controller mine.py:Mine"),
        ("laboratory:windy", "no scenario 'windy' in .*laboratory.yaml, which contains nominal, low_wind, high_wind"),
        ("laboratory", "laboratory.yaml contains several scenarios; choose one as laboratory:NAME from nominal"),
        ("laboratory:", "laboratory.yaml contains several scenarios; choose one as laboratory:NAME from nominal"),
        ("hover.yml", "hover.yml: cannot be read: no such file"),
    ],
)
def test_the_error_for_a_missing_scenario_suggests_similar_names(spec, words):
    with pytest.raises(InputError, match=words):
        load_scenario(spec)


@pytest.mark.parametrize("base", ["laboratry:nominal", "vehicles/race", "laboratory:windy"])
def test_the_error_for_a_missing_scenario_in_extends_gives_its_line(tmp_path, base):
    path = tmp_path / "mine.yaml"
    path.write_text(f"a: {{extends: '{base}'}}\n")
    with pytest.raises(InputError, match=rf"mine.yaml:1: .*{base.split(':')[-1]}"):
        load_scenario(path)


def test_the_missing_suffix_of_a_python_file_is_suggested(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("")
    with pytest.raises(InputError, match=r"'mine:SlidingMode' is neither .*; did you mean mine\.py:SlidingMode\?"):
        load_scenario("mine:SlidingMode")
