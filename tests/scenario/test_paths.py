"""Tests of the paths of fields in scenarios."""

import pytest

from drake_quad import InputError, load_scenario
from drake_quad.scenario.distributions import Distribution
from drake_quad.scenario.paths import distributions_in, join_path, leaves, map_leaves, split_path, value_at


@pytest.fixture(scope="module")
def scenario(diagrams):
    return load_scenario(diagrams / "robustness.yaml")


def test_every_value_is_found_at_its_path(scenario):
    values_by_path = dict(leaves(scenario))
    assert len(values_by_path) > 80
    for path, value in values_by_path.items():
        assert value_at(scenario, path) is value
    assert isinstance(values_by_path["vehicle.inertia.1"], Distribution)
    assert values_by_path["laboratory.wind.0.kind"] == "fan"


def test_distributions_in_finds_every_value_that_is_a_distribution(scenario):
    distributions = distributions_in(scenario)
    assert list(distributions) == [path for path, value in leaves(scenario) if isinstance(value, Distribution)]
    assert len(distributions) == 31


def test_unchanged_parts_of_a_scenario_are_not_copied(scenario):
    assert map_leaves(scenario, lambda path, value: value) is scenario
    changed_scenario = map_leaves(scenario, lambda path, value: 0.01 if path == "vehicle.inertia.1" else value)
    changed = [path for path, value in leaves(changed_scenario) if value is not dict(leaves(scenario))[path]]
    assert changed == ["vehicle.inertia.1"]
    assert changed_scenario.vehicle.inertia[1] == 0.01
    assert changed_scenario.laboratory is scenario.laboratory


def test_rotors_are_counted_from_1(scenario):
    paths = [path for path in dict(leaves(scenario)) if "thrust_factor_error" in path]
    assert paths == [f"vehicle.thrust_factor_error.rotor_{number}" for number in (1, 2, 3, 4)]
    assert join_path("a", "rotors", 2, "position", 0) == "a.rotors.rotor_3.position.0"
    assert split_path("a.rotors.rotor_3.position.0") == ["a", "rotors", "2", "position", "0"]
    assert value_at(scenario, "vehicle.thrust_factor_error.rotor_4") is scenario.vehicle.thrust_factor_error[3]
    for step in ("0", "1", "rotor_0", "rotor_5"):
        with pytest.raises(InputError, match="does not name a rotor; write rotor_1, rotor_2, rotor_3 or rotor_4"):
            value_at(scenario, f"vehicle.thrust_factor_error.{step}")


@pytest.mark.parametrize(
    "path", ["vehicle.weight", "vehicle.inertia.3", "vehicle.inertia[1]", "vehicle.mass.normal.mean", "", "name.0"]
)
def test_a_path_without_a_field_is_refused(scenario, path):
    with pytest.raises(InputError, match="the scenario has no field"):
        value_at(scenario, path)
