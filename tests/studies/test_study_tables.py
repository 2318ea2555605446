"""Tests of studies as tables of pandas and Parquet, and of folders of studies."""

import math
import sys

import numpy as np
import pandas as pd
import pytest

from drake_quad import InputError, load_scenario, read_studies, read_study, run_monte_carlo
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario.batch import Batch
from drake_quad.statistics.estimates import proportion_interval
from drake_quad.studies.study import Study, study_columns, study_rows
from drake_quad.studies.summary import crash_text, obstacle_table

SCENARIO_FIELDS = {
    "duration": 0.1,
    "vehicle.mass": {"uniform": {"min": 0.6, "max": 0.7}},
    "laboratory.command_link.delay_ticks": {"choice": [0, 1]},
    "vehicle.thrust_factor_error": [0.0, {"uniform": {"min": -0.01, "max": 0.01}}, 0.0, 0.0],
}


@pytest.fixture(scope="module")
def scenario(diagrams):
    return load_scenario(diagrams / "hover.yaml", SCENARIO_FIELDS)


@pytest.fixture(scope="module")
def study(scenario):
    """Return a study of three samples, of which the second crashed."""
    batch = Batch.draw(scenario, [1, 3, 4])
    numbers = np.arange(3.0 * (len(Metrics._fields) - 1)).reshape(-1, 3)
    numbers[2, 2] = math.nan
    rows = study_rows(batch, Metrics(*numbers, np.array([math.inf, 0.04, math.inf])))
    return Study.from_rows(scenario, 0.1, rows, failures={2: "too fast"})


def test_a_pandas_table_has_a_row_for_each_sample_and_columns_for_drawn_fields_and_metrics(study, scenario):
    frame = study.to_frame()
    assert frame.index.name == "sample"
    assert frame.index.tolist() == [1, 3, 4]
    assert ["sample", *frame.columns] == study_columns(scenario)
    np.testing.assert_array_equal(frame["vehicle.mass"], study.parameters["vehicle.mass"])
    for name in Metrics._fields[:-1]:
        np.testing.assert_array_equal(frame[name], getattr(study.metrics, name), err_msg=name)
    assert frame["crashed"].dtype == bool
    assert frame["crashed"].tolist() == [False, True, False]
    np.testing.assert_array_equal(frame["crash_time"], [math.nan, 0.04, math.nan])
    assert frame[~frame.crashed]["rmse"].mean() == pytest.approx(np.mean(study.metrics.rmse[[0, 2]]))


def test_a_study_counts_crashes_into_each_obstacle():
    ball = {"kind": "sphere", "centre": [0.0, 0.0, 5.0], "radius": 0.1}
    scenario = load_scenario("hover", {"space.obstacles": {"near": ball, "far": ball}})
    metrics = Metrics(*np.ones((len(Metrics._fields) - 1, 4)), np.array([math.inf, 0.04, 0.06, 0.08]))
    study = Study.from_rows(scenario, 0.1, study_rows(Batch.draw(scenario, range(4)), metrics, np.array([0, 2, 0, 2])))
    assert study.crashes_by_obstacle == {"near": 0, "far": 2}
    assert [study.hit_obstacle_name(index) for index in range(4)] == [None, "far", None, "far"]
    frame = study.to_frame()
    assert ["sample", *frame.columns] == study_columns(scenario)
    assert frame["obstacle"].isna().tolist() == [True, False, True, False]
    assert frame["obstacle"].dropna().tolist() == ["far", "far"]
    crashed, touched = (proportion_interval(count, 4).percent() for count in (3, 2))
    assert crash_text(study) == f"3 crashed, {crashed}; 2 of them into obstacles, {touched}"
    ((name, count, fraction),) = obstacle_table(study).rows
    assert (name, count) == ("far", "2")
    assert fraction == touched


@pytest.mark.slow
def test_the_obstacles_of_crashes_are_saved(tmp_path):
    space = {"obstacles": {"pillar": {"kind": "cylinder", "centre": [0.4, 0.0, 1.0], "radius": 0.13, "height": 1.0}}}
    changed = {"space": space, "duration": 0.4, "laboratory.wind": [{"kind": "steady", "velocity": [3.0, 0.0, 0.0]}]}
    scenario = load_scenario("hover", {**changed, "vehicle.linear_drag": {"uniform": {"min": 0.0, "max": 1.0}}})
    study = run_monte_carlo(scenario, 6, folder=tmp_path / "study", num_workers=1)
    assert 0 < study.crashes_by_obstacle["pillar"] < 6
    loaded_study = read_study(tmp_path / "study")
    np.testing.assert_array_equal(loaded_study.obstacle_hit, study.obstacle_hit)
    np.testing.assert_array_equal(loaded_study.obstacle_hit > 0, loaded_study.metrics.crashed)


def test_a_pandas_table_has_units_and_attributes(study):
    attributes = study.to_frame().attrs
    units = attributes["units"]
    assert units["vehicle.mass"] == "kg"
    assert units["vehicle.thrust_factor_error.rotor_2"] == "1"
    assert (units["rmse"], units["variation_z"], units["crashed"]) == ("m", "m/s³", "")
    assert [*units] == [*study.to_frame().columns]
    assert attributes["failures"] == {"2": "too fast"}
    assert (attributes["scenario"], attributes["duration"]) == ("hover", 0.1)


def test_a_pandas_table_read_from_parquet_is_unchanged(study, tmp_path):
    path = study.to_parquet(tmp_path / "results.parquet")
    frame, loaded_frame = study.to_frame(), pd.read_parquet(path)
    pd.testing.assert_frame_equal(loaded_frame, frame)
    assert loaded_frame.attrs == frame.attrs
    assert [each.name for each in tmp_path.iterdir()] == ["results.parquet"]


def test_a_failed_parquet_write_leaves_no_file(study, tmp_path):
    (tmp_path / "results.parquet").mkdir()
    with pytest.raises(OSError, match="results.parquet"):
        study.to_parquet(tmp_path / "results.parquet")
    assert [each.name for each in tmp_path.iterdir()] == ["results.parquet"]


@pytest.mark.parametrize(("library", "table"), [("pandas", "to_frame"), ("pyarrow", "to_parquet")])
def test_a_library_that_is_missing_is_named_with_its_extra(study, tmp_path, monkeypatch, library, table):
    monkeypatch.setitem(sys.modules, library, None)
    arguments = [tmp_path / "results.parquet"] if table == "to_parquet" else []
    with pytest.raises(ImportError, match=rf"^{library} is not installed; .*'drake_quad\[tables\]'") as error:
        getattr(study, table)(*arguments)
    assert not isinstance(error.value, InputError)


@pytest.fixture(scope="module")
def folders(scenario, tmp_path_factory):
    """Return a folder with two studies and another file. One of the studies has failed samples."""
    parent = tmp_path_factory.mktemp("controllers")
    for name, seed in (("pd", 0), ("indi", 1)):
        run_monte_carlo(scenario, 2, seed, folder=parent / name, num_workers=1)
    (parent / "indi" / "failed.csv").write_text("sample,reason\n7,it was late\n", encoding="utf-8")
    (parent / "distribution.png").write_bytes(b"")
    return parent


@pytest.mark.parametrize("file", ["", "results.csv", "scenario.yaml", "study.yaml"])
def test_a_study_is_read_from_its_folder_and_from_any_file_in_it(folders, file):
    assert read_study(folders / "indi" / file).scenario.seed == 1


def test_a_study_is_read_from_its_parent_folder_if_this_contains_no_other_study(folders, tmp_path):
    (tmp_path / "alone").symlink_to(folders / "pd")
    (tmp_path / "notes").mkdir()
    result = read_study(tmp_path)
    assert result.samples.tolist() == [0, 1]
    assert [*read_studies(tmp_path)] == ["alone"]


def test_samples_that_could_not_be_flown_are_read(folders):
    assert read_study(folders / "indi").failures == {7: "it was late"}
    assert read_study(folders / "pd").failures == {}


def test_read_studies_names_each_study_after_its_folder(folders):
    result = read_studies(folders)
    assert {name: study.scenario.seed for name, study in result.items()} == {"indi": 1, "pd": 0}
    assert [*read_studies(folders / "pd")] == ["pd"]
    with pytest.raises(
        InputError, match="contains 2 studies, indi, pd; read one of these folders, or read all .* read_studies"
    ):
        read_study(folders)


def test_a_path_that_is_not_a_study_is_refused_with_what_it_contains(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty is not the folder of a study, .* results.csv, .*; it is empty"):
        read_study(tmp_path / "empty")
    (tmp_path / "comparison.csv").write_text("a\n1\n")
    with pytest.raises(InputError, match="is not the folder of a study, .*; it contains comparison.csv, empty"):
        read_studies(tmp_path)
    with pytest.raises(InputError, match=r"comparison.csv is not the folder of a study, .*; it is another file"):
        read_study(tmp_path / "comparison.csv")
    with pytest.raises(InputError, match="nowhere does not exist"):
        read_study(tmp_path / "nowhere")


def test_a_damaged_table_of_failures_is_an_input_error(scenario, tmp_path):
    run_monte_carlo(scenario, 1, folder=tmp_path, num_workers=1)
    for text in ("sample,why\n1,x\n", "sample,reason\nfirst,x\n", "sample,reason\n1\n"):
        (tmp_path / "failed.csv").write_text(text, encoding="utf-8")
        with pytest.raises(InputError, match="failed.csv"):
            read_study(tmp_path)


def test_a_resumed_study_deletes_its_outdated_parquet_file(scenario, tmp_path):
    run_monte_carlo(scenario, 1, folder=tmp_path, num_workers=1).to_parquet(tmp_path / "results.parquet")
    run_monte_carlo(scenario, 2, folder=tmp_path, num_workers=1, resume=True)
    assert not (tmp_path / "results.parquet").exists()
