"""Tests that a table is equal after it has been written to a CSV file and read again."""

import numpy as np
import pytest

from drake_quad import InputError
from drake_quad.files import read_table, write_table


def test_columns_are_read_back_unchanged(tmp_path):
    columns = {"name": ["a", "b,c"], "number": np.array([0.1, np.nan]), "count": [3, 4]}
    read = read_table(write_table(tmp_path / "table.csv", columns))
    assert list(read) == list(columns)
    assert read["name"].tolist() == ["a", "b,c"]
    np.testing.assert_array_equal(read["number"], columns["number"])
    np.testing.assert_array_equal(read["count"], [3.0, 4.0])


@pytest.mark.parametrize("text", ["a,b\n1,2,3\n", "a,b\n1,2\n3\n", ""])
def test_files_that_are_not_tables_are_refused(tmp_path, text):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(InputError, match="is not a CSV table"):
        read_table(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_table(tmp_path / "none.csv")


def test_a_table_can_have_no_rows(tmp_path):
    path = write_table(tmp_path / "table.csv", {"a": [], "b": []})
    assert path.read_text() == "a,b\n"
    assert {name: values.tolist() for name, values in read_table(path).items()} == {"a": [], "b": []}


def test_numbers_are_written_exactly_and_nan_is_an_empty_cell(tmp_path):
    columns = {"a": np.array([0.1, np.nan, 1e-300]), "b": [1, np.int64(2), np.float64(0.3)], "c": ["x", "", "nan"]}
    path = write_table(tmp_path / "table.csv", columns)
    assert path.read_text() == "a,b,c\n0.1,1,x\n,2,\n1e-300,0.3,nan\n"
    with pytest.raises(ValueError, match="argument 2 is shorter"):
        write_table(tmp_path / "uneven.csv", {"a": [1, 2], "b": [1]})
