"""Tests that tables of results are read back as they were written."""

import numpy as np
import pytest

from drake_quad.errors import InputError
from drake_quad.files import read_table
from drake_quad.reports.results import read_groups, write_groups, write_rows
from drake_quad.statistics.interval import Interval


def test_an_interval_is_written_to_three_columns(tmp_path):
    rows = [
        {"name": name, "rmse": Interval(value, value - 1.0, value + 2.0), "n": 3}
        for name, value in (("a", 1 / 3), ("b", 5.0))
    ]
    actual = read_table(write_rows(tmp_path / "rows.csv", rows))
    assert list(actual) == ["name", "rmse", "rmse_low", "rmse_high", "n"]
    for row, each in enumerate(rows):
        assert tuple(actual[name][row] for name in ("rmse", "rmse_low", "rmse_high")) == each["rmse"]
    assert read_table(write_rows(tmp_path / "rows.csv", rows, digits=3))["rmse"].tolist() == [0.333, 5.0]


def test_groups_are_read_back_in_their_order_with_their_columns(tmp_path):
    """Columns are identified by name, even if a group has them in another order. A group may have a single row."""
    groups = {
        ("b", "x"): {"time": np.array([0.1, 1 / 3]), "error": np.array([np.nan, np.inf])},
        ("a", "x"): {"error": np.array([3.0]), "time": np.array([4.0])},
        ("b", "y"): {"time": np.array([5.0]), "error": np.array([6.0])},
    }
    path = write_groups(tmp_path / "groups.csv", ("place", "name"), groups)
    assert list(read_table(path)) == ["place", "name", "time", "error"]
    actual = read_groups(path, ("place", "name"), ("error",))
    assert list(actual) == list(groups)
    for key, columns in groups.items():
        for name, values in columns.items():
            np.testing.assert_array_equal(actual[key][name], values)


def test_the_message_about_a_missing_column_names_it(tmp_path):
    path = write_groups(tmp_path / "groups.csv", ("place",), {("a",): {"time": [1.0]}})
    for keys, required in ((("place", "name"), ()), (("place",), ("name",))):
        with pytest.raises(InputError, match=r"groups.csv has no column name"):
            read_groups(path, keys, required)
