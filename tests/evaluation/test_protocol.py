"""Tests of the tuning protocol and of the files of designs."""

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.design.tuning import Budget, LoopLimit
from drake_quad.evaluation import experiment
from drake_quad.evaluation.designs import read_designs, write_designs
from drake_quad.evaluation.entries import controller_entries
from drake_quad.evaluation.experiment import (
    QUICK,
    EvaluationSizes,
    delay_flown,
    fly_family,
    fly_laps,
    single_vehicle_time,
)
from drake_quad.evaluation.families import FAMILIES, FIRST_EVALUATION_SAMPLE, LaboratoryFamily
from drake_quad.evaluation.protocol import design_family, previous_numbers, training_scenarios, tunable_entries
from drake_quad.evaluation.results import laboratory_with_laps
from drake_quad.scenario.paths import value_at
from drake_quad.studies.comparison import fly_samples


def test_training_and_evaluation_samples_are_disjoint():
    assert Budget().samples <= FIRST_EVALUATION_SAMPLE
    for family in FAMILIES.values():
        assert set(family.training_laboratories) <= family.laboratories.keys()
        assert family.windiest_laboratory in family.laboratories


@pytest.mark.parametrize("name", FAMILIES)
def test_every_tuned_parameter_is_a_field_of_the_scenario_with_its_controller(name, diagrams, tmp_path):
    family = FAMILIES[name]
    entries = {
        key: each
        for key, each in controller_entries(
            on_board=family.on_board, position_networks=family.position_networks
        ).items()
        if each.parameters
    }
    own = {key: each for key, each in entries.items() if each.base != "lqg"}
    path = write_designs(
        tmp_path / "designs.yaml", {key: each.geometric_mean() for key, each in own.items()}, comments={}
    )
    for key in ("pd", "disturbance_observer", "pd_t2fnn_adaptive", "indi_t2fnn"):
        (scenario, *_) = training_scenarios(diagrams, family, f"{path}:{key}", own[key])
        for parameter in own[key].parameters:
            for field in parameter.paths:
                assert parameter.low < value_at(scenario, field) < parameter.high
        assert scenario.control.network is None or own[key].base


def test_other_designs_in_a_file_are_not_changed(tmp_path):
    path = tmp_path / "designs.yaml"
    path.write_text("# By somebody.\nmine:\n  control: {kind: lqg}    # as it was\n", encoding="utf-8")
    write_designs(path, {"pd": {"control": {"gains": [1.5, 2.0], "kind": "pd"}}}, comments={"pd": "2 numbers"})
    write_designs(path, {"pd": {"control": {"gains": [2.5, 2.0], "kind": "pd"}}}, comments={"pd": "3 numbers"})
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# By somebody.\nmine:\n  control: {kind: lqg}    # as it was\n")
    assert text.count("numbers") == 1
    assert "\npd: # 3 numbers\n" in text.replace("pd:  ", "pd: ")
    assert "gains: [2.5, 2.0]" in text
    assert tuple(read_designs(path)) == ("mine", "pd")


def test_an_invalid_design_file_is_refused(tmp_path):
    path = tmp_path / "designs.yaml"
    path.write_text("- pd\n", encoding="utf-8")
    with pytest.raises(InputError, match="must contain a mapping from names to controllers"):
        read_designs(path)
    with pytest.raises(InputError, match="there is no tunable controller lqg"):
        tunable_entries(FAMILIES["outdoor"], tmp_path / "none.yaml", ["lqg"])


def test_a_network_requires_a_design_of_its_base_controller(tmp_path):
    path = write_designs(tmp_path / "designs.yaml", {"indi": {"control": {}}}, comments={})
    assert list(tunable_entries(FAMILIES["outdoor"], path, ["indi_t2fnn", "lqg_t2fnn"])) == ["indi_t2fnn"]


@pytest.fixture
def copied(diagrams, tmp_path):
    """Return a writable folder of diagrams with a small family."""
    folder = tmp_path / "diagrams"
    (folder / "controllers" / "designed").mkdir(parents=True)
    spec = f"{diagrams}/laboratory.yaml:low_wind"
    (folder / "mine.yaml").write_text(f"mine: {{extends: '{spec}', duration: 2.0}}\n", encoding="utf-8")
    return folder, LaboratoryFamily({"low wind": "mine.yaml"}, ("low wind",), "low wind")


def test_only_a_design_with_positive_parameters_is_a_starting_point_of_a_new_tuning(copied):
    folder, family = copied
    path = folder / "controllers" / "designed" / "mine.yaml"
    entry = controller_entries(on_board=False, position_networks=True)["pd"]
    design = entry.geometric_mean()
    assert previous_numbers(folder, family, path, "pd", entry) is None
    write_designs(path, {"pd": design}, comments={})
    expected = [(parameter.low * parameter.high) ** 0.5 for parameter in entry.parameters]
    assert previous_numbers(folder, family, path, "pd", entry) == pytest.approx(expected, rel=1e-3)
    # The search varies the logarithms of the parameters, so it cannot start from zero or from a distribution.
    for gain in (0.0, {"uniform": {"min": 1.0, "max": 2.0}}):
        design["control"]["position"]["k_d"][2] = gain
        write_designs(path, {"pd": design}, comments={})
        assert previous_numbers(folder, family, path, "pd", entry) is None


@pytest.mark.long
def test_tuned_designs_are_better_than_the_middle_of_their_ranges(copied, monkeypatch):
    """The search and the flights are real; the linear models, which take most of the time, are replaced."""
    monkeypatch.setattr(LoopLimit, "margin_ratios", lambda limit, scenario: np.ones(1))
    monkeypatch.setattr(experiment, "worst_margins", lambda scenario: (2.0, 0.05))
    folder, family = copied
    path = folder / "controllers" / "designed" / "mine.yaml"
    entries = tunable_entries(family, path, ["pd", "pd_t1fnn"])
    budget = Budget(rounds=2, candidates=16, samples=2, limit_evaluations=2, local_search_steps=4)
    designs = list(design_family(folder, "mine", family, entries, budget=budget))
    assert [each.name for each in designs] == ["pd", "pd_t1fnn"]
    assert tuple(read_designs(path)) == ("pd", "pd_t1fnn")
    assert list(path.parent.iterdir()) == [path]
    sizes = EvaluationSizes(samples=3, num_delay_samples=2, max_delay_frames=2)
    (laboratory, name, metrics), (_, _, traits), *_ = fly_family(folder, "mine", family, "pd", sizes)
    assert (laboratory, name, len(metrics.rmse)) == ("low wind", "pd", 3)
    assert (traits.sensitivity, traits.delay) == (2.0, 0.05)
    assert min(traits.fleet, traits.lone) > 0.0
    write_designs(path, {"middle": entries["pd"].geometric_mean()}, comments={})
    tuned, middle = (
        fly_samples(family.scenario(folder, "low wind", [f"{path}:{key}"]), range(2)) for key in ("pd", "middle")
    )
    assert tuned.rmse.mean() < middle.rmse.mean()


@pytest.mark.long
def test_one_frame_more_than_the_tolerated_delay_crashes(diagrams):
    stiff = ["control.attitude.k_p=[16, 16, 5.356]", "control.attitude.k_d=[6, 6, 3.5]", "duration=6"]
    scenario = load_scenario(diagrams / "laboratory.yaml:nominal", stiff)
    result = delay_flown(scenario, EvaluationSizes(num_delay_samples=2, max_delay_frames=25))
    assert 0.0 < result < 0.25
    frame = scenario.laboratory.motion_capture.period
    for crashes, frames in ((False, round(result / frame)), (True, round(result / frame) + 1)):
        overrides = [*stiff, f"laboratory.motion_capture.latency_frames={frames}"]
        again = load_scenario(diagrams / "laboratory.yaml:nominal", overrides)
        assert (delay_flown(again, EvaluationSizes(num_delay_samples=2, max_delay_frames=0)) < 0.0) is crashes
    assert single_vehicle_time(scenario) > 0.0


@pytest.mark.long
def test_laps_are_flown_with_and_without_a_network_with_position_input(diagrams, tmp_path):
    family = FAMILIES["laboratory"]
    entries = controller_entries(on_board=False, position_networks=True)
    (tmp_path / "controllers" / "designed").mkdir(parents=True)
    (tmp_path / "lab.yaml").write_text(f"lab: {{extends: '{diagrams}/laboratory.yaml:high_wind'}}\n", encoding="utf-8")
    designs = {name: entries[name].geometric_mean() for name in ("pd", "pd_t2fnn_map")}
    write_designs(tmp_path / "controllers" / "designed" / "mine.yaml", designs, comments={})
    own_family = family._replace(laboratories={"high wind": "lab.yaml"})
    result = list(fly_laps(tmp_path, "mine", own_family, ["pd", "pd_t2fnn_map"], QUICK))
    assert [each[:2] for each in result] == [
        (laboratory_with_laps(count), name) for name in ("pd", "pd_t2fnn_map") for count in (1, 2)
    ]
    assert all(len(metrics.rmse) == QUICK.num_lap_samples for _, _, metrics in result)
