"""Tests of flights as mappings and tables, and of saving and reading them."""

import pickle
import sys

import numpy as np
import pytest

from drake_quad import InputError, Scenario, load_scenario, read_flight, simulate
from drake_quad.reference.plan import Plan
from drake_quad.signals import quantities, row_names


@pytest.fixture(scope="module")
def flight(diagrams):
    overrides = {"duration": 1.0, "route": {"heading": "along_path", "laps": 2}}
    return simulate(load_scenario(diagrams / "figure_eight.yaml", overrides), compiled=True)


@pytest.fixture(scope="module")
def folder(flight, tmp_path_factory):
    target = tmp_path_factory.mktemp("flight")
    flight.save(target)
    return target


def test_a_flight_is_a_mapping_of_its_signals(flight):
    assert [*flight] == [*flight.keys()] == [*flight.signals]
    assert len(flight) == len(flight.signals)
    assert "state" in flight
    assert "weights" not in flight
    assert flight.get("weights") is None
    for name, values in flight.items():
        assert values is flight.signals[name] is flight[name]
    assert flight
    assert flight == flight
    assert {flight: 1}[flight] == 1
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(flight))["state"], flight["state"])


@pytest.mark.slow
def test_a_data_frame_has_a_row_for_each_tick_and_a_column_for_each_component_of_a_signal(flight):
    frame = flight.to_frame()
    assert frame.index.name == "time"
    np.testing.assert_array_equal(frame.index, flight.time)
    names = [f"{name}.{row}" for name, values in flight.items() for row in row_names(name, values.shape[1])]
    assert [*frame.columns] == names
    np.testing.assert_array_equal(frame["state.pitch"], flight.record("state").pitch)
    np.testing.assert_array_equal(frame["rotor_speed.rotor_3"], flight["rotor_speed"][:, 2])
    units, frames = frame.attrs["units"], frame.attrs["frames"]
    assert [units["state.pitch"], units["wrench.tau_x"], units["error.z"]] == ["rad", "N m", "m"]
    assert [frames["state.pitch"], frames["wrench.tau_x"], frames["error.z"]] == ["", "B", "W"]
    assert [*units.values()] == [each.unit for name in flight for each in quantities(name, flight[name].shape[1])]


def test_the_message_about_missing_pandas_names_the_extra_that_installs_it(flight, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"^pandas is not installed; .*'drake_quad\[tables\]'"):
        flight.to_frame()


@pytest.mark.parametrize("file", ["", "flight.npz", "flight.csv", "scenario.yaml", "metrics.csv"])
def test_a_saved_flight_is_read_back_unchanged(flight, folder, file):
    read_back = read_flight(folder / file)
    assert (read_back.scenario, read_back.metrics, read_back.compiled) == (flight.scenario, flight.metrics, True)
    np.testing.assert_array_equal(read_back.time, flight.time)
    assert [*read_back] == [*flight]
    for name in flight:
        np.testing.assert_array_equal(read_back[name], flight[name])
    for part in ("path", "yaw"):
        for actual, expected in zip(getattr(read_back.plan, part), getattr(flight.plan, part), strict=True):
            np.testing.assert_array_equal(actual, expected)
    assert (read_back.plan.legs, read_back.plan.laps) == (flight.plan.legs, flight.plan.laps)
    assert len(read_back.plan.laps) == 3
    assert read_back.plan.legs
    assert repr(read_back) == repr(flight)


def test_a_saved_flight_that_crashed_is_read_back(diagrams, tmp_path):
    scenario = load_scenario(diagrams / "hover.yaml", {"vehicle.rotor_failure": {"rotor": 1, "time": 0.1}})
    flight = simulate(scenario, compiled=True)
    flight.save(tmp_path)
    assert read_flight(tmp_path).metrics == flight.metrics
    assert flight.metrics.crashed


def test_the_route_of_a_saved_flight_without_a_plan_is_planned_again(flight, folder, tmp_path):
    """Files of earlier versions contain no plan."""
    flight.save(tmp_path)
    with np.load(folder / "flight.npz") as loaded:
        np.savez(tmp_path / "flight.npz", **{name: loaded[name] for name in ("time", *flight)})
    again = read_flight(tmp_path)
    np.testing.assert_allclose(again.plan.path.coefficients, flight.plan.path.coefficients, atol=1e-12)
    assert not again.compiled


def test_folders_without_a_flight_and_damaged_files_are_refused(flight, tmp_path):
    with pytest.raises(InputError, match="is not the folder of a flight, which contains flight.npz"):
        read_flight(tmp_path)
    flight.save(tmp_path)
    arrays = {"time": flight.time, **flight.signals}
    for damage in (b"", b"PK\x03\x04 and no more", b"\x93NUMPY"):
        (tmp_path / "flight.npz").write_bytes(damage)
        with pytest.raises(InputError, match="flight.npz is damaged, or is not the file of a flight"):
            read_flight(tmp_path)
    with (tmp_path / "flight.npz").open("wb") as file:
        np.save(file, flight.time)
    with pytest.raises(InputError, match="flight.npz is damaged, or is not the file of a flight"):
        read_flight(tmp_path)
    for damaged in ({"colour": flight.time}, {"state": flight["state"][:-1]}, {"state": np.array("x", dtype=object)}):
        np.savez(tmp_path / "flight.npz", **{**arrays, **damaged})
        with pytest.raises(InputError, match="flight.npz"):
            read_flight(tmp_path)
    np.savez(tmp_path / "flight.npz", **arrays)
    (tmp_path / "metrics.csv").write_text("rmse\n1.0\n")
    with pytest.raises(InputError, match="metrics.csv is not the table of a flight's metrics"):
        read_flight(tmp_path)
    assert isinstance(flight.scenario, Scenario)


def test_a_user_defined_plan_is_saved_and_read_back(diagrams, tmp_path):
    """The plan differs from the plan of the scenario's route."""
    plan = Plan.hover([1.0, 2.0, 3.0], duration=0.5, yaw=0.4)
    simulate(load_scenario(diagrams / "hover.yaml", {"duration": 0.5}), plan=plan).save(tmp_path)
    again = read_flight(tmp_path).plan
    assert again.waypoints[0].tolist() == [1.0, 2.0, 3.0]
    assert (again.initial_yaw, again.legs) == (0.4, plan.legs)
