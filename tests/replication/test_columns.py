import numpy as np
import pytest

from drake_quad import InputError
from drake_quad.files import read_table, write_table


def test_columns_come_back_as_they_were(tmp_path):
    written = {"name": ["a", "b,c"], "number": np.array([0.1, np.nan]), "count": [3, 4]}
    read = read_table(write_table(tmp_path / "table.csv", written))
    assert list(read) == list(written)
    assert read["name"].tolist() == ["a", "b,c"]
    np.testing.assert_array_equal(read["number"], written["number"])
    np.testing.assert_array_equal(read["count"], [3.0, 4.0])


@pytest.mark.parametrize("text", ["a,b\n1,2,3\n", "a,b\n1,2\n3\n", ""])
def test_what_is_no_table_is_refused(tmp_path, text):
    path = tmp_path / "table.csv"
    path.write_text(text)
    with pytest.raises(InputError, match="is not a table"):
        read_table(path)
    with pytest.raises(InputError, match="cannot be read"):
        read_table(tmp_path / "none.csv")
