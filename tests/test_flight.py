import csv

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, simulate
from drake_quad.visualization.plots import PLOTS, save_plots


@pytest.fixture(scope="module")
def flight():
    from pathlib import Path

    path = Path(__file__).parent.parent / "diagrams" / "figure_eight.yaml"
    return simulate(load_scenario(path, ["duration=3.0"]))


def test_saved_files_hold_the_flight(flight, tmp_path):
    arrays, table, scenario = flight.save(tmp_path / "deep" / "folder")
    with np.load(arrays) as loaded:
        np.testing.assert_array_equal(loaded["time"], flight.time)
        for name, values in flight.signals.items():
            np.testing.assert_array_equal(loaded[name], values)
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(flight.time) == 151
    np.testing.assert_allclose([float(row["state.z (m)"]) for row in rows], flight["state"][:, 2], rtol=1e-8)
    assert load_scenario(scenario) == flight.scenario
    assert sorted(path.name for path in arrays.parent.iterdir()) == ["flight.csv", "flight.npz", "scenario.yaml"]


def test_a_saved_scenario_flies_the_same_again(flight, tmp_path):
    again = simulate(load_scenario(flight.save(tmp_path)[2]))
    np.testing.assert_array_equal(again["state"], flight["state"])


def test_a_folder_that_cannot_be_written(flight, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="output folder .*file cannot be written"):
        flight.save(tmp_path / "file")


def test_progress_is_told_to_the_end(diagrams):
    told = []
    simulate(load_scenario(diagrams / "hover.yaml", ["duration=2.5"]), progress=lambda *now: told.append(now))
    assert told == [(1.0, 2.5), (2.0, 2.5), (2.5, 2.5)]


def test_plots_label_every_axis_with_a_unit(flight, tmp_path):
    assert [path.name for path in save_plots(flight, tmp_path)] == [f"{name}.png" for name in PLOTS]
    for plot in PLOTS.values():
        for axes in plot(flight).axes:
            labels = [axes.get_xlabel(), axes.get_ylabel()]
            shared = [label for label in labels if label]
            assert all("(" in label for label in shared)


def test_path_plot_shows_the_flown_path_and_the_reference(flight):
    _, plane = PLOTS["path"](flight).axes
    drawn = {line.get_label(): line.get_xydata() for line in plane.get_lines()}
    np.testing.assert_array_equal(drawn["flown"], flight["state"][:, :2])
    np.testing.assert_array_equal(drawn["reference"], flight["reference"][:, :2])
