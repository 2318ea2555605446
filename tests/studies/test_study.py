"""Tests of studies in memory and of their files."""

import functools
import math
from types import SimpleNamespace

import numpy as np
import pytest
from pydantic import ValidationError

from drake_quad import InputError, load_scenario, read_study, run_monte_carlo
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.laboratory.metrics import Metrics
from drake_quad.scenario.batch import Batch
from drake_quad.studies.results_file import StoredRows
from drake_quad.studies.study import (
    Record,
    Study,
    check_draws,
    column_description,
    read_record,
    study_columns,
    study_rows,
)

REQUIRED_RECORD_FIELDS = "seed: 1\nduration: 2.0\nversions: []\ncolumns: {}\n"


@pytest.mark.parametrize(
    "text", ["- samples\n", "samples: 3\nseed: 1\nduration: 2.0\n", "seed\n", f"samples: '3'\n{REQUIRED_RECORD_FIELDS}"]
)
def test_a_file_that_is_not_a_record_is_refused(tmp_path, text):
    (tmp_path / "study.yaml").write_text(text)
    with pytest.raises(InputError, match="is not the record of a study"):
        read_record(tmp_path)


def test_a_study_read_from_files_has_a_simulated_time_of_zero(tmp_path):
    scenario = load_scenario("diagrams/hover.yaml", ["duration=0.1"])
    assert run_monte_carlo(scenario, 2, folder=tmp_path, num_workers=1).simulated_time > 0.0
    assert read_study(tmp_path).simulated_time == 0.0


@pytest.fixture
def two_masses():
    overrides = [
        "duration=0.1",
        "vehicle.mass={uniform: {min: 0.6, max: 0.7}}",
        "vehicle.linear_drag={choice: [0.1, 0.2]}",
    ]
    return load_scenario("diagrams/hover.yaml", overrides)


def metrics_of(crash_time):
    """Return metrics whose values are all different."""
    numbers = np.arange((len(Metrics._fields) - 1) * len(crash_time), dtype=float).reshape(-1, len(crash_time))
    return Metrics(*numbers, np.array(crash_time))


def test_a_study_contains_indices_drawn_values_and_metrics(two_masses):
    metrics, batch = metrics_of([math.inf, 0.04]), Batch.draw(two_masses, [3, 1])
    rows = study_rows(batch, metrics)
    columns = study_columns(two_masses)
    assert columns[:3] == ["sample", "vehicle.mass", "vehicle.linear_drag"]
    assert columns[3:] == [*Metrics._fields[:-1], "crashed", "crash_time"]
    expected = {"sample": [3.0, 1.0], "crashed": [0.0, 1.0], **batch.varying, **metrics._asdict()}
    for name, column in zip(columns, rows.T, strict=True):
        np.testing.assert_array_equal(column, expected[name])

    study = Study.from_rows(two_masses, 0.1, rows, failures={7: "late"}, simulated_time=0.14, invalid_lines=[5])
    assert study.samples.tolist() == [3, 1]
    assert list(study.parameters) == ["vehicle.mass", "vehicle.linear_drag"]
    np.testing.assert_array_equal(study.metrics, metrics)
    np.testing.assert_allclose(study.flight_time, [0.1, 0.04])
    assert (study.duration, study.failures, study.simulated_time, study.invalid_lines) == (0.1, {7: "late"}, 0.14, (5,))
    words = "<Study of hover: 2 samples, 1 crashed, 1 not flown; drawn fields: vehicle.mass, vehicle.linear_drag>"
    assert repr(study) == words
    hover = load_scenario("diagrams/hover.yaml", ["duration=0.1"])
    assert repr(Study.from_rows(hover, 0.1, study_rows(Batch.draw(hover, [0]), metrics_of([math.inf])))) == (
        "<Study of hover: 1 samples, 0 crashed; drawn fields: none>"
    )


def test_drawn_values_are_checked_to_the_precision_of_the_results_file(two_masses):
    """The file contains twelve digits.

    If a drawn value differs in the eleventh digit from the value that the seed gives, its row is invalid.
    """
    samples = [4, 0, 2]
    rows = study_rows(Batch.draw(two_masses, samples), metrics_of([math.inf] * 3))
    rows[0, 1] *= 1.0 + 5e-12
    rows[1, 2] *= 1.0 - 5e-11
    result = check_draws(two_masses, StoredRows(rows, np.array([2, 3, 5]), [4], 99))
    assert result.rows[:, 0].tolist() == [4.0, 2.0]
    assert (result.lines.tolist(), result.invalid_lines, result.end) == ([2, 5], [4, 3], 99)
    no_rows = StoredRows(rows[:0], np.array([], dtype=int), [2], 9)
    assert check_draws(two_masses, no_rows) is no_rows


def test_columns_have_descriptions(two_masses):
    assert column_description(two_masses, "sample") == "index of the sample"
    assert column_description(two_masses, "crashed") == "1 if the vehicle crashed, else 0"
    assert column_description(two_masses, "checksum").startswith("CRC-32 of the row and its study")
    assert column_description(two_masses, "rmse") == "metric (m)"
    assert "kg" in column_description(two_masses, "vehicle.mass")


def test_a_record_is_read_as_it_was_written(two_masses, tmp_path):
    """The record includes words that YAML 1.1 reads as booleans."""
    user_systems = UserSystems(wind=functools.partial(metrics_of), position_controller=SimpleNamespace)
    record = Record.of(two_masses.model_copy(update={"seed": 3}), 12, 0.1, user_systems, compiled=True)
    assert (record.samples, record.seed, record.duration, record.control) == (12, 3, 0.1, None)
    assert record.wind == f"{__name__}:metrics_of"
    assert record.position_controller == "types:SimpleNamespace"
    assert list(record.columns) == [*study_columns(two_masses), "checksum"]
    record = record.model_copy(update={"columns": {"sample": "yes", "on": "off"}})
    record.write(tmp_path / "study.yaml")
    assert read_record(tmp_path) == record
    assert "control" not in (tmp_path / "study.yaml").read_text().replace("position_controller", "")


def test_a_record_cannot_be_changed(tmp_path):
    (tmp_path / "study.yaml").write_text(f"samples: 3\n{REQUIRED_RECORD_FIELDS}")
    record = read_record(tmp_path)
    with pytest.raises(ValidationError, match="frozen"):
        record.samples = 4
    assert record.samples == 3


def test_a_missing_record_is_named(tmp_path):
    with pytest.raises(InputError, match=r"study\.yaml: cannot be read: no such file"):
        read_record(tmp_path)


def test_optional_fields_of_a_study_are_empty_by_default(two_masses):
    study = Study(two_masses, 0.1, np.array([0]), {}, metrics_of([math.inf]))
    assert (study.failures, study.simulated_time, study.invalid_lines) == ({}, 0.0, ())


def test_a_study_has_the_remarks_on_its_scenario():
    scenario = load_scenario("hover", {"vehicle.mass": {"uniform": {"min": 1.0, "max": 1.2}}})
    study = Study(scenario, 1.0, np.arange(2), {}, metrics_of([math.inf, 0.5]))
    (remark,) = study.remarks
    assert "use: mass 1.1 kg (nominal 0.68)" in remark
