"""Tests of overrides as Python values, and of the text representation of scenarios."""

import json
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.scenario.files.layers import merge
from drake_quad.scenario.files.library import Library
from drake_quad.scenario.files.loading import load_mission, load_undesigned
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.files.override_mapping import override_trees
from drake_quad.scenario.files.shipped import shipped_scenarios
from drake_quad.scenario.regions import HalfSpace


@pytest.fixture
def load(diagrams):
    return lambda overrides: load_scenario(diagrams / "robustness.yaml", overrides)


@pytest.mark.parametrize(
    ("python_overrides", "assignments"),
    [
        ({"vehicle.mass": 0.7, "duration": 10}, ["vehicle.mass=0.7", "duration=10"]),
        ({"vehicle": {"mass": 0.7, "reaction_torque": True}}, ["vehicle.mass=0.7", "vehicle.reaction_torque=true"]),
        ({"vehicle.mass": np.float64(0.7), "seed": np.int64(3)}, ["vehicle.mass=0.7", "seed=3"]),
        ({"control.position.k_p": np.array([1.0, 2.0, 3.0])}, ["control.position.k_p=[1, 2, 3]"]),
        ({"control.position": {"k_p": (1, 2.5, 3)}}, ["control.position.k_p=[1, 2.5, 3]"]),
        (
            {"vehicle.inertia.1": 0.01, "vehicle.inertia.2": 0.013},
            ["vehicle.inertia.1=0.01", "vehicle.inertia.2=0.013"],
        ),
        ({"vehicle": {"inertia": {1: 0.01, "2": 0.013}}}, ["vehicle.inertia.1=0.01", "vehicle.inertia.2=0.013"]),
        ({"vehicle": {"thrust_factor_error": {"rotor_2": 0.01}}}, ["vehicle.thrust_factor_error.rotor_2=0.01"]),
        (
            {"vehicle.thrust_factor_error": [0, {"choice": [0.0, 0.1]}, 0, 0]},
            ["vehicle.thrust_factor_error=[0, {choice: [0, 0.1]}, 0, 0]"],
        ),
        ({"vehicle.mass": {"uniform": {"min": 0.6, "max": 0.7}}}, ["vehicle.mass={uniform: {min: 0.6, max: 0.7}}"]),
        ({"route": {"kind": "circle", "radius": 1}}, ["route={kind: circle, radius: 1}"]),
        ({"laboratory.command_link": {"delay_ticks": 1}}, ["laboratory.command_link.delay_ticks=1"]),
        ({"duration": None}, ["duration=null"]),
        ([{"duration": 3}, "vehicle.mass=0.7", {"duration": 4}], ["duration=4", "vehicle.mass=0.7"]),
        ("vehicle.mass=0.7", ["vehicle.mass=0.7"]),
        ({}, []),
    ],
)
def test_python_values_have_the_same_effect_as_yaml_text(load, python_overrides, assignments):
    assert load(python_overrides) == load(assignments)


def test_overrides_may_contain_parts_of_other_scenarios(load, diagrams):
    other_scenario = load_scenario(diagrams / "figure_eight.yaml", {"vehicle.mass": 0.66, "route.radius": 1.2})
    combined = load({"vehicle": other_scenario.vehicle, "route": other_scenario.route})
    assert (combined.vehicle.mass, combined.route) == (0.66, other_scenario.route)


@pytest.mark.slow
def test_every_shipped_value_can_be_given_as_a_mapping(load):
    """An override as a mapping has the same effect as the corresponding text, both field by field and as a whole."""
    empty = Tree({}, Mark("", 0))
    scenarios = [Library().find(name)[1].to_python() for name in shipped_scenarios()]
    for plain in (*scenarios, {"route": ROUTE}, load({"route": ROUTE}).model_dump(mode="json")):
        for fields in (plain, {"whole": plain}):
            assert reduce(merge, override_trees(fields, Library()), empty).to_python() == fields


CORRIDOR = {"half_spaces": [{"normal": [1.0, -1.0, 0.0], "point": [0.5, 0.0, 0.0]}]}
ROUTE = {"kind": "waypoints", "waypoints": [[0.0, 0.0, 1.0], [1.0, 1.0, 1.0]], "corridors": [CORRIDOR]}


def test_the_normal_of_a_half_space_is_not_a_normal_distribution(load):
    """A half-space has a field `normal`, which is also the name of a distribution."""
    scenario = load({"route": ROUTE})
    assert scenario == load("route=" + json.dumps(ROUTE))
    assert scenario.route.corridors[0].half_spaces[0].normal == (1.0, -1.0, 0.0)
    moved = load([{"route": ROUTE}, "route.corridors.0.half_spaces.0.point=[0.6, 0, 0]"])
    assert moved.route.corridors[0].half_spaces[0] == HalfSpace(normal=(1.0, -1.0, 0.0), point=(0.6, 0.0, 0.0))
    turned = load([{"route": ROUTE}, {"route.corridors.0.half_spaces.0": {"normal": [0.0, 0.0, -1.0]}}])
    assert turned.route.corridors[0].half_spaces[0] == HalfSpace(normal=(0.0, 0.0, -1.0), point=(0.5, 0.0, 0.0))
    corridor = {"half_spaces": [{"point": [0.5, 0.0, 0.0]}]}
    with pytest.raises(InputError, match=r"route\.corridors\.0\.half_spaces\.0\.normal is missing"):
        load({"route": {**ROUTE, "corridors": [corridor]}})


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"normal": {"mean": 0.7, "standard_deviation": 0.1, "min": 0.5}, "x": 3}, "vehicle.mass.x is unknown"),
        ({"normal": {"mean": 0.7}}, r"vehicle.mass.normal.standard_deviation is missing"),
        ({"normal": [1.0, 2.0]}, r"vehicle.mass.normal is \[1.0, 2.0\], but must be a mapping"),
        ({"choice": 3.0}, r"vehicle.mass.choice is 3.0, but must be a list"),
    ],
)
def test_errors_in_distributions_name_the_field(load, overrides, words):
    with pytest.raises(InputError, match=f"^override vehicle.mass: {words}"):
        load({"vehicle.mass": overrides})


def test_a_distribution_replaces_another_distribution_completely(load):
    for distribution in ({"uniform": {"min": 0.6, "max": 0.7}}, {"choice": [0.6, 0.7]}):
        assert isinstance(load("vehicle.mass=0.7").vehicle.mass, float)
        replaced = load(["vehicle.mass={log_uniform: {min: 0.6, max: 0.8}}", {"vehicle.mass": distribution}])
        assert replaced.vehicle.mass.model_dump(mode="json") == distribution


def test_an_override_may_name_a_file_by_a_pathlib_path(load):
    with pytest.raises(
        InputError,
        match="^override control.network.learned: control.network.learned refers to nowhere.yaml, which does not"
        " exist$",
    ):
        load({"control.network.learned": Path("nowhere.yaml")})


def test_missions_and_vehicles_accept_python_values(diagrams):
    assert load_mission(diagrams / "slalom.yaml", {"nominal": {"mass": 0.66}}).nominal.mass == 0.66
    assert load_undesigned(diagrams / "vehicles" / "paper.yaml", {"nominal.mass": 0.66}).nominal.mass == 0.66
    with pytest.raises(InputError, match=r"^override vehicle.mass: a plan does not depend on vehicle, only on name, "):
        load_mission(diagrams / "slalom.yaml", {"vehicle.mass": 0.66})


LIST_OF_ITSELF = []
LIST_OF_ITSELF.append(LIST_OF_ITSELF)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"vehicle.mass": -1}, r"^override vehicle.mass: vehicle.mass is -1, but must be larger than 0$"),
        ({"vehicle": {"mass": "0.7"}}, r"^override vehicle: vehicle.mass is '0.7', but must be a valid number$"),
        ({"vehicle.mas": 1}, r"^override vehicle.mas: vehicle.mas is unknown; .* did you mean mass\?$"),
        ({"vehicle.mass": np.nan}, r"vehicle.mass is nan, but must be a finite number$"),
        (
            {"vehicle.mass": 1j},
            r"^override vehicle.mass: 1j is a complex, but must be a number, text, list or mapping$",
        ),
        ({"vehicle.mass": {0.7}}, r"is a set, but"),
        ({"vehicle.inertia": LIST_OF_ITSELF}, r"^override vehicle.inertia: is nested too deeply: .* 40 levels$"),
        ({"vehicle.inertia": [0.0] * 40_000}, r"^override vehicle.inertia: is too large: .* 30,000 keys and values"),
        ({"vehicle.inertia": "x" * 2000}, r"is too long: a key or value may have at most 1,000 characters$"),
        ({"vehicle..mass": 1}, r"'vehicle..mass' must be the path of a field, as in vehicle.mass$"),
        ({("vehicle", "mass"): 1}, r"must be the path of a field"),
        ({"": 1}, r"must be the path of a field"),
        ({".".join(["a"] * 50): 1}, r"is nested too deeply"),
        ({"vehicle.thrust_factor_error.1": 0.1}, r"does not name a rotor; .*, rotor_3 or rotor_4 instead of '1'$"),
        ([3], r"^the override 3 must be a mapping or a text field.path=value$"),
        ("vehicle.mass", r"^override vehicle.mass: must be field.path=value, for example vehicle.mass=0.7$"),
    ],
)
def test_errors_for_invalid_python_values_give_the_reason(load, overrides, words):
    with pytest.raises(InputError, match=words):
        load(overrides)


def test_the_repr_of_a_scenario_is_one_line(load, diagrams):
    assert repr(load({"duration": 4})) == str(load({"duration": 4}))
    assert repr(load({"duration": 4})) == (
        "<Scenario robustness: route figure_eight, 4 s; vehicle of normal(0.68, 0.01, min=0.64, max=0.72) kg; control"
        " pd + type_2 network + attitude pd; wind: fan, fan, steady, dryden, gust; 31 distributions>"
    )
    onboard = load_scenario(diagrams / "onboard.yaml", {"vehicle.mass": {"choice": [0.6, 0.7]}})
    assert repr(onboard) == (
        "<Scenario onboard: route figure_eight; vehicle of choice(0.6, 0.7) kg; control pd; autopilot attitude; no"
        " wind; 1 distribution>"
    )
    layers = [diagrams / "controllers" / "lqg.yaml:lqg"]
    assert "; control lqg; " in repr(load_scenario(diagrams / "laboratory.yaml:nominal", layers=layers))
    slalom = load_mission(diagrams / "slalom.yaml")
    assert repr(slalom) == "<Mission slalom: route waypoints; nominal mass 0.68 kg>"


def test_distributions_have_short_representations(load):
    distributions = {
        "vehicle.linear_drag": {"uniform": {"min": 0.1, "max": 0.25}},
        "vehicle.quadratic_drag": {"log_uniform": {"min": 0.001, "max": 1}},
        "vehicle.mass": {"normal": {"mean": 0.7, "standard_deviation": 0.01, "min": 0.6, "shared": {"a": 0.5}}},
    }
    vehicle = load(distributions).vehicle
    assert repr(vehicle.linear_drag) == "uniform(0.1, 0.25)"
    assert str(vehicle.quadratic_drag) == "log_uniform(0.001, 1)"
    assert repr(vehicle.mass) == "normal(0.7, 0.01, min=0.6, shared={'a': 0.5})"
