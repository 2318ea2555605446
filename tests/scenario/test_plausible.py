"""Tests that values in a wrong unit cause a remark, and that values of vehicles from 20 g to 20 kg do not."""

import math
import re
from pathlib import Path

import numpy as np
import pytest
from random_scenarios import scenario_of, structures

from drake_quad import load_scenario, load_undesigned
from drake_quad.flight.remarks import flight_remarks
from drake_quad.scenario.files.documents import parse_document
from drake_quad.scenario.files.shipped import shipped_scenarios
from drake_quad.scenario.paths import mappings_in
from drake_quad.scenario.plausible import Plausible, numbers_in

TESTS_FOLDER = Path(__file__).parent.parent
# Planning the whole route through the forest takes several seconds, so the tests fly a part of it.
SHORT_ROUTES = {"forest": ["route.waypoints=[[-1, -2.7, 1.2], [1, -1.9, 1.4]]"]}


def questions(scenario):
    return [remark for remark in flight_remarks(scenario) if "implausible" in remark]


BATTERY_MAPPING = {"voltage": 12.6, "empty_voltage": 9.9, "capacity": 2200, "resistance": 0.02, "efficiency": 0.6}
FAN_MAPPING = {"kind": "fan", "position": [0, 5, 1], "direction": [0, 1, 0], "flow": 2.5, "diameter": 0.75}


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("vehicle.rotor_time_constant", 50.0, "is 50 s, which is implausible; 50 ms are 0.05 s"),
        ("vehicle.rotor_time_constant", {"uniform": {"min": 0.03, "max": 80.0}}, "80 ms are 0.08 s"),
        ("vehicle.rotor_time_constant_down", 50.0, "50 ms are 0.05 s"),
        ("laboratory.command_link.delay_ticks", 20, "a delay of 0.4 s, .* so 20 ms would be 1"),
        ("laboratory.motion_capture.latency_frames", {"choice": [0, 40]}, "a delay of 0.4 s, .* 40 ms would be 4"),
        ("laboratory.motion_capture.position_noise", 1.0, "1 mm is 0.001 m"),
        ("laboratory.motion_capture.attitude_noise", 0.5, "0.5 degrees are 0.008727 rad"),
        ("nominal.mass", 680.0, "680 g are 0.68 kg"),
        ("nominal.arm_length", 170.0, "170 mm are 0.17 m"),
        ("nominal.gravity", 1.0, "1 g is 9.807 m/s²"),
        ("nominal.max_rotor_speed", 24_000.0, "24000 rpm are 2513 rad/s"),
        ("nominal.max_rotor_speed", 2865.0, "203 times the weight, .*2865 rpm are 300 rad/s"),
        ("nominal.inertia", [7.0, 7.0, 12.0], "inertia.0 is 7 kg m², .* 7 g m² are 0.007 kg m²"),
        ("nominal.inertia", [7e4, 7e4, 1.2e5], "70000 g cm² are 0.007 kg m²"),
        ("nominal.inertia", [7e-7, 7e-7, 1.2e-6], "is 7e-07 kg m², which is implausible for a mass of 0.68"),
        ("nominal.drag_factor", 8.5e-4, "20.6 m times the thrust factor"),
        ("nominal.rotor_inertia", 0.04, "rotor_inertia is 0.04 kg m²"),
        ("vehicle.thrust_factor_error", [2.0, 0.0, 0.0, 0.0], "rotor_1 is 2, which is implausible; 2 % are 0.02"),
        ("vehicle.centre_of_mass", [0.0, -3.0], r"centre_of_mass.1 is -3 m, .* -3 mm are -0.003 m"),
        ("vehicle.battery", BATTERY_MAPPING, "2200 mA h are 2.2 A h"),
        ("vehicle.slung_load", {"mass": 100.0, "length": 0.8}, "100 g are 0.1 kg"),
        ("laboratory.wind", [FAN_MAPPING | {"flow": 9000}], "9000 m³/h are 2.5 m³/s"),
        ("laboratory.wind", [{"kind": "steady", "speed": 90, "heading": 0}], "90 km/h are 25 m/s"),
        ("laboratory.sensors", [{"kind": "magnetometer", "strength": 48}], "48 µT are 4.8e-05 T"),
        ("laboratory.sensors", [{"kind": "gyroscope", "full_scale": 2000}], "2000 °/s are 34.91 rad/s"),
        ("control.thrust_vectoring.max_thrust", 180.0, "180 % are 1.8"),
        ("control.attitude",
         {"kind": "indi", "k_p": [9, 9, 9], "k_d": [4, 4, 4], "lag": 70, "bandwidth": 1, "delay_ticks": 20},
         "lag is 70 s, which is implausible; 70 ms are 0.07 s"),
    ],
)  # fmt: skip
def test_a_remark_on_a_value_in_a_wrong_unit_names_its_likely_unit(path, value, words):
    scenario = load_scenario("hover", {path: value})
    assert any(re.search(words, question) for question in questions(scenario)), questions(scenario)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("vehicle.battery_sag=5", "5 % are 0.05"),
        ("laboratory.motion_capture.dropout_rate=2", "at most 1; 2 % are 0.02"),
        ("control.thrust_vectoring.min_thrust=30", "30 % are 0.3"),
        ("vehicle.rotor_failure={rotor: 1, time: 1, speed_factor: 50}", "50 % are 0.5"),
    ],
)
def test_a_fraction_in_percent_is_refused_and_the_message_converts_it(override, words):
    with pytest.raises(ValueError, match=words):
        load_scenario("hover", [override])


def test_a_wrong_nominal_mass_causes_only_one_remark():
    """The vehicle takes its mass from `nominal`, and a wrong mass also makes the inertia implausible."""
    assert questions(load_scenario("hover", {"nominal.mass": 680.0})) == [
        "nominal.mass is 680 kg, which is implausible; 680 g are 0.68 kg"
    ]
    assert len(questions(load_scenario("hover", {"nominal.mass": 680.0, "vehicle.mass": 700.0}))) == 2


def test_correlations_and_small_standard_deviations_cause_no_remark():
    normal = {"mean": 9.8, "standard_deviation": 0.001, "min": 9.7, "shared": {"place": 0.9}}
    assert [*numbers_in({"normal": normal})] == [9.8, 0.001, 9.7]
    assert questions(load_scenario("hover", {"vehicle.gravity": {"normal": normal}})) == []


@pytest.mark.long
@pytest.mark.parametrize("spec", [each for each in shipped_scenarios() if "/" not in each or "vehicles/" in each])
def test_no_shipped_scenario_or_vehicle_has_an_implausible_value(spec):
    if spec.startswith("controllers/"):
        return
    assert questions(load_undesigned(spec, SHORT_ROUTES.get(spec, []))) == []


ASYMMETRIC_VEHICLES = parse_document((TESTS_FOLDER / "asymmetric.yaml").read_text("utf-8"), "").tree.value


@pytest.mark.parametrize("name", [*ASYMMETRIC_VEHICLES])
def test_no_scenario_of_the_tests_has_an_implausible_value(name):
    assert questions(load_undesigned(TESTS_FOLDER / f"asymmetric.yaml:{name}")) == []


@pytest.mark.parametrize("mass", [0.02, 0.1, 0.5, 2.0, 7.0, 20.0])
def test_no_vehicle_between_20_g_and_20_kg_has_an_implausible_value(mass):
    """All vehicles have the same shape and density, so lengths are proportional to the cube root of the mass.

    They have the same rotor tip speed, and a thrust-to-weight ratio of 1.5 or 16.
    """
    nominal = load_undesigned("vehicles/hummingbird").nominal
    size = (mass / nominal.mass) ** (1.0 / 3.0)
    top_speed = nominal.max_rotor_speed / size
    for ratio in (1.5, 16.0):
        thrust_factor = ratio * mass * 9.81 / (4.0 * top_speed**2)
        vehicle = {
            "mass": mass,
            "arm_length": nominal.arm_length * size,
            "inertia": [each * size**5 for each in nominal.inertia],
            "rotor_inertia": nominal.rotor_inertia * size**5,
            "thrust_factor": thrust_factor,
            "drag_factor": thrust_factor * size * nominal.drag_factor / nominal.thrust_factor,
            "min_rotor_speed": nominal.min_rotor_speed / size,
            "max_rotor_speed": top_speed,
        }
        scenario = load_scenario("hover", {"nominal": vehicle, "vehicle.rotor_time_constant": 0.0125 * size})
        assert questions(scenario) == []


def test_values_of_shipped_scenarios_are_implausible_in_a_wrong_unit():
    """If a value is written in the unit with which its unit is often confused, it is outside the plausible range."""
    implausible = set()
    for spec in ("robustness", "neural_fly:wind_8", "laboratory:high_wind", "vehicles/hummingbird"):
        for _, mapping in mappings_in(load_undesigned(spec)):
            for name, field in type(mapping).model_fields.items():
                for condition in field.metadata:
                    if isinstance(condition, Plausible) and condition.upper < math.inf:
                        values = [abs(value) / condition.factor for value in numbers_in(getattr(mapping, name))]
                        if condition.explain_implausibility(max(values, default=0.0), 0.02):
                            implausible.add(name)
    assert implausible >= {
        *("mass", "arm_length", "centre_of_mass", "rotor_time_constant", "rotor_time_constant_down", "lag"),
        *("position_noise", "attitude_noise", "misalignment", "thrust_factor_error", "flow", "diameter", "max_thrust"),
    }


@pytest.mark.long
def test_no_random_scenario_of_the_tests_has_an_implausible_value(tmp_path):
    rng = np.random.default_rng(3)
    for structure in structures(rng, 40):
        assert questions(scenario_of(structure, rng, tmp_path, duration=1.0)) == []
