"""Tests of the results of a running study and of its folder."""

import math

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.studies import study_folder
from drake_quad.studies.results_file import StoredRows
from drake_quad.studies.study import read_record, read_study, study_columns, study_rows
from drake_quad.studies.study_folder import StudyRows, _difference
from drake_quad.studies.study_folder import open_study as open_any
from drake_quad.studies.worker_pool import Outcome


def open_study(*study, resume):
    return open_any(*study, compiled=True, resume=resume)


@pytest.fixture
def hover():
    return load_scenario("diagrams/hover.yaml", ["duration=2"])


def table(samples, crash_time=math.inf, value=0.5):
    """Return the rows of a results file for some samples of a scenario; all metrics have the same value."""
    columns = [np.full(len(samples), value)] * (len(Metrics._fields) - 1)
    batch = Batch.draw(load_scenario("diagrams/hover.yaml", ["duration=2"]), samples)
    return study_rows(batch, Metrics(*columns, np.full(len(samples), crash_time)))


def test_a_sample_counts_as_present_whatever_its_values(hover):
    """This includes samples whose metrics are NaN, because no tick was in the metric window."""
    rows = StudyRows(hover, 5, 2.0)
    assert (len(rows), [*rows.missing(5)], rows.saved) == (0, [0, 1, 2, 3, 4], "nothing was written")
    rows.add(Outcome([3, 1], table([3, 1], value=np.nan)))
    rows.add(Outcome([4], reason="unstable"))
    assert (len(rows), [*rows.missing(5)], rows.failures) == (2, [0, 2], {4: "unstable"})
    assert rows.rows[:, 0].tolist() == [1.0, 3.0]
    rows.add(Outcome([0], table([0])))
    rows.add(Outcome([2], reason="late"))
    study = rows.study()
    assert study.samples.tolist() == [0, 1, 3]
    assert list(study.failures.items()) == [(2, "late"), (4, "unstable")]
    assert (study.scenario, study.duration, study.invalid_lines) == (hover, 2.0, ())
    np.testing.assert_array_equal(study.metrics.rmse, [0.5, np.nan, np.nan])


def test_flown_time_counts_new_samples_until_end_or_crash(hover):
    result = StoredRows(table([1], crash_time=0.25), np.array([2]), [5, 3], 0)
    rows = StudyRows(hover, 5, 2.0, stored=result)
    assert (len(rows), [*rows.missing(5)], rows.study().simulated_time) == (1, [0, 2, 3, 4], 0.0)
    rows.add(Outcome([0, 4], table([0, 4], crash_time=0.75)))
    rows.add(Outcome([2], table([2])))
    assert rows.study().simulated_time == 3.5
    assert rows.study().invalid_lines == (3, 5)


def test_without_a_folder_nothing_is_written(hover):
    with open_study(None, hover, 3, 2.0, UserSystems(), resume=False) as rows:
        rows.add(Outcome([1], table([1])))
    assert (rows.num_samples, len(rows), rows.saved) == (3, 1, "nothing was written")


def test_the_rows_in_a_folder_are_sorted_at_the_end(hover, tmp_path):
    folder = tmp_path / "a" / "study"
    with open_study(folder, hover, 3, 2.0, UserSystems(wind=table), resume=False) as rows:
        assert read_record(folder).wind == f"{__name__}:table"
        rows.add(Outcome([2], table([2])))
        assert rows.saved == f"1 of 3 samples are in {folder / 'results.csv'}"
        assert len(read_study(folder).samples) == 1
        rows.add(Outcome([0], table([0])))
        lines = (folder / "results.csv").read_text().splitlines()
        assert [line.split(",")[0] for line in lines] == ["sample", "2", "0"]
    lines = (folder / "results.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in lines] == ["sample", "0", "2"]
    assert sorted(path.name for path in folder.iterdir()) == ["results.csv", "scenario.yaml", "study.yaml"]
    study = read_study(folder)
    assert (study.scenario, study.duration, read_record(folder).samples) == (hover, 2.0, 3)
    assert len(study_columns(hover)) == study.metrics.rmse.size + len(lines[0].split(",")) - 3


def test_failures_are_recorded_until_all_samples_have_flown(hover, tmp_path):
    with open_study(tmp_path, hover, 2, 2.0, UserSystems(), resume=False) as rows:
        rows.add(Outcome([1], reason="unstable"))
    assert (tmp_path / "failed.csv").read_text() == "sample,reason\n1,unstable\n"
    with open_study(tmp_path, hover, 2, 2.0, UserSystems(), resume=True) as rows:
        assert [*rows.missing(2)] == [0, 1]
        rows.add(Outcome([0, 1], table([0, 1])))
    assert not (tmp_path / "failed.csv").exists()


def test_a_study_can_be_enlarged_but_not_reduced(hover, tmp_path):
    with open_study(tmp_path, hover, 3, 2.0, UserSystems(), resume=True) as rows:
        rows.add(Outcome([2], table([2])))
    with open_study(tmp_path, hover, 3, 2.0, UserSystems(), resume=True) as rows:
        assert [*rows.missing(3)] == [0, 1]
    words = r"results\.csv already contains sample 2, so the study cannot be resumed with only 2 samples"
    with (
        pytest.raises(InputError, match=words),
        open_study(tmp_path, hover, 2, 2.0, UserSystems(), resume=True),
    ):
        pass
    assert read_record(tmp_path).samples == 3
    with open_study(tmp_path, hover, 9, 2.0, UserSystems(), resume=True) as rows:
        assert len(rows.missing(9)) == 8
    assert read_record(tmp_path).samples == 9


@pytest.mark.parametrize("name", ["position_controller", "control", "wind"])
def test_a_study_with_a_different_system_is_a_different_study(hover, tmp_path, name):
    with open_study(tmp_path, hover, 3, 2.0, UserSystems(**{name: table}), resume=False):
        pass
    words = rf"contains a different study: its {name} is {__name__}:table, not None"
    with (
        pytest.raises(InputError, match=words),
        open_study(tmp_path, hover, 3, 2.0, UserSystems(), resume=True),
    ):
        pass
    with open_study(tmp_path, hover, 3, 2.0, UserSystems(**{name: table}), resume=True):
        pass


def test_a_folder_with_another_scenario_is_refused(hover, tmp_path):
    other_scenario = hover.model_copy(update={"seed": 3})
    save_scenario(other_scenario, tmp_path / "scenario.yaml")
    words = r"scenario\.yaml is a different scenario and is not overwritten; choose another folder"
    with (
        pytest.raises(InputError, match=words),
        open_study(tmp_path, hover, 3, 2.0, UserSystems(), resume=False),
    ):
        pass
    with open_study(tmp_path, other_scenario, 3, 2.0, UserSystems(), resume=False):
        pass
    assert read_study(tmp_path).scenario == other_scenario


def test_scenario_and_record_are_written_before_the_first_row(hover, tmp_path, monkeypatch):
    """Therefore, a study that was interrupted at any time can be resumed."""

    def ended(path, form):
        raise KeyboardInterrupt

    monkeypatch.setattr(study_folder, "open_results", ended)
    with (
        pytest.raises(KeyboardInterrupt),
        open_study(tmp_path, hover, 3, 2.0, UserSystems(), resume=False),
    ):
        pass
    assert read_record(tmp_path).samples == 3
    assert load_scenario(tmp_path / "scenario.yaml") == hover


def test_a_study_without_its_record_cannot_be_resumed(hover, tmp_path):
    with open_study(tmp_path, hover, 3, 2.0, UserSystems(), resume=False):
        pass
    for name in ("study.yaml", "scenario.yaml"):
        text = (tmp_path / name).read_text()
        (tmp_path / name).unlink()
        words = rf"cannot be resumed: .*{name}"
        with (
            pytest.raises(InputError, match=words),
            open_study(tmp_path, hover, 3, 2.0, UserSystems(), resume=True),
        ):
            pass
        (tmp_path / name).write_text(text)
    with open_study(tmp_path, hover, 3, 2.0, UserSystems(), resume=True):
        pass
    # Each version is listed once, however often the study is resumed.
    assert len(read_record(tmp_path).versions) == 1


@pytest.mark.parametrize(
    ("old_value", "new_value", "words"),
    [
        ({"a": 1, "b": [1, 2]}, {"a": 1, "b": [1, 2]}, None),
        ({"a": 1, "b": 2}, {"a": 1, "b": 3}, "its b is 2, not 3"),
        ({"a": 1, "b": 2}, {"a": 4, "b": 3}, "its a is 1, not 4"),
        ({"a": {"b": [1, {"c": 5}]}}, {"a": {"b": [1, {"c": 6}]}}, "its a.b.1.c is 5, not 6"),
        ({"a": {"b": [7, 8]}}, {"a": {"b": [7]}}, "its a.b is [7, 8], not [7]"),
        ({"a": {"b": 1}}, {"a": {"c": 1}}, "its a is {'b': 1}, not {'c': 1}"),
        ({"a": [1]}, {"a": {"b": 1}}, "its a is [1], not {'b': 1}"),
        ({"a": {"b": 1}}, {"a": 1}, "its a is {'b': 1}, not 1"),
    ],
)
def test_the_first_difference_is_named_by_its_path(old_value, new_value, words):
    assert _difference(old_value, new_value) == words


def test_the_record_of_a_study_lists_each_kind_of_flown_diagram_once(hover, tmp_path):
    flown_kinds = []
    for compiled in (True, False, True):
        with open_any(tmp_path, hover, 3, 2.0, UserSystems(), compiled=compiled, resume=True):
            flown_kinds.append(read_record(tmp_path).flown)
    assert flown_kinds == [["compiled"], ["compiled", "wired"], ["wired", "compiled"]]
