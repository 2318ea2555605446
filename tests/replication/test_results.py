"""What the replication leaves in its folder."""

import numpy as np

from drake_quad.files import read_table
from drake_quad.replication.printed import CONTROLLERS, WINDS, Cell
from drake_quad.replication.results import FAIR, MAPPED, cells_of, write_recorded


def test_recorded_samples_stand_in_rows_even_a_single_one(tmp_path):
    recorded = {Cell("low_wind", "pd"): {"pd_fade": np.array([0.5]), "effort_x": np.array([np.nan])}}
    found = read_table(write_recorded(tmp_path / "one.csv", recorded))
    assert list(found) == ["wind", "controller", "sample", "pd_fade", "effort_x"]
    assert (found["wind"][0], found["controller"][0], found["sample"][0]) == ("low_wind", "pd", 0.0)
    np.testing.assert_array_equal([found["pd_fade"], found["effort_x"]], [[0.5], [np.nan]])
    recorded[Cell("no_wind", "pd")] = {"effort_x": np.array([1.0, 2.0]), "pd_fade": np.array([3.0, 4.0])}
    found = read_table(write_recorded(tmp_path / "more.csv", recorded))
    assert found["wind"].tolist() == ["low_wind", "no_wind", "no_wind"]
    np.testing.assert_array_equal(found["sample"], [0.0, 0.0, 1.0])
    np.testing.assert_array_equal(found["pd_fade"], [0.5, 3.0, 4.0])
    np.testing.assert_array_equal(found["effort_x"], [np.nan, 1.0, 2.0])


def test_cells_are_told_wind_by_wind():
    assert cells_of(("a", "b")) == [(wind, name) for wind in WINDS for name in ("a", "b")]
    assert cells_of(CONTROLLERS)[1] == Cell("no_wind", "pd_t1fnn")
    assert not set(FAIR) & set(CONTROLLERS)
    assert set(MAPPED) < set(CONTROLLERS)
