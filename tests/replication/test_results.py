"""Tests of the files of the replication."""

import numpy as np

from drake_quad.laboratory.metrics import Metrics
from drake_quad.replication import results
from drake_quad.replication.measures import LegMetrics
from drake_quad.replication.published import CONTROLLERS, WINDS, Cell
from drake_quad.replication.results import (
    FAIR_CONTROLLERS,
    MAPPED_CONTROLLERS,
    read_experiment,
    select_cells,
    write_recorded,
)


def test_cells_are_sorted_by_wind():
    assert select_cells(("a", "b")) == [(wind, name) for wind in WINDS for name in ("a", "b")]
    assert select_cells(CONTROLLERS)[1] == Cell("no_wind", "pd_t1fnn")
    assert not set(FAIR_CONTROLLERS) & set(CONTROLLERS)
    assert set(MAPPED_CONTROLLERS) < set(CONTROLLERS)


def test_recorded_measures_are_read_as_they_were_written(tmp_path, monkeypatch):
    """The file contains the measures of each cell."""
    monkeypatch.setattr(results, "read_study", lambda folder: folder.relative_to(tmp_path).as_posix())
    monkeypatch.setattr(results, "load_sweep", lambda path, metrics: (path.relative_to(tmp_path).name, metrics))
    recorded = {
        cell: {"rmse": np.array([i, i + 0.5]), "effort_x": np.array([-1.0 * i, 2.0])}
        for i, cell in enumerate(select_cells(CONTROLLERS))
    }
    write_recorded(tmp_path / "recorded.csv", recorded)
    result = read_experiment(tmp_path)
    assert result.recorded.keys() == recorded.keys()
    for cell, columns in recorded.items():
        for name, values in columns.items():
            np.testing.assert_allclose(result.recorded[cell][name], values)
        assert result.cells[cell] == f"cells/{cell.scenario}"
    assert (result.noise, result.q) == (("noise.csv", Metrics), ("q.csv", Metrics))
    assert result.slopes == {wind: (f"slope_{wind}.csv", Metrics) for wind in WINDS}
    assert result.maps == {name: (f"map_{name}.csv", Metrics) for name in MAPPED_CONTROLLERS}
    assert result.legs == ("legs.csv", LegMetrics)
