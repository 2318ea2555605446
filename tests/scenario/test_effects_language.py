"""Tests that effects in the scenario language are off by default, and that mistakes are explained in one sentence."""

import re

import pytest

from drake_quad import InputError, load_scenario
from drake_quad.vehicle.effects import NO_EFFECTS

BATTERY = "voltage: 12.6, empty_voltage: 10.2, capacity: 1.3, resistance: 0.04, efficiency: 0.65"
THROTTLE_MOTORS = "{kind: throttle, curve: [0.1, 1.0, 2.8]}"


@pytest.fixture
def load(diagrams):
    return lambda *overrides: load_scenario(diagrams / "figure_eight.yaml", overrides)


def test_effects_are_off_by_default(load):
    assert load().vehicle.effects() == {}
    assert load().vehicle.effect_parameters() == NO_EFFECTS


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (
            ["vehicle.body_drag={linear: [0.1, -0.2, 0.3]}"],
            "vehicle.body_drag.linear.1 is -0.2, but must be at least 0",
        ),
        (
            ["vehicle.body_drag={centre: [0, 0, 0]}"],
            "vehicle.body_drag.centre is unknown; allowed are linear, quadratic",
        ),
        (["vehicle.ground_effect={rotor_radius: 0}"], "ground_effect.rotor_radius is 0, but must be larger than 0"),
        (["vehicle.rotor_aerodynamics={lift: -1}"], "rotor_aerodynamics.lift is -1, but must be at least 0"),
        (["vehicle.rotor_time_constant_down=0"], "rotor_time_constant_down is 0, but must be larger than 0"),
        (["vehicle.payload={mass: 0.1, time: 1, event: lost}"], "payload.event is 'lost', but must be"),
        (["vehicle.payload={mass: 0.1, time: -1, event: dropped}"], "payload.time is -1, but must be at least 0"),
        (
            [f"vehicle.battery={{{BATTERY.replace('10.2', '13')}}}"],
            "vehicle.battery.empty_voltage is 13, but must not be larger than voltage, 12.6",
        ),
        (
            [f"vehicle.battery={{{BATTERY.replace('10.2', '{normal: {mean: 9, standard_deviation: 0.1, min: 1}}')}}}"],
            "vehicle.battery.empty_voltage is .*, but must not be larger than voltage, 12.6",
        ),
        (
            [f"vehicle.battery={{{BATTERY.replace('12.6', '{uniform: {min: 10, max: 12.6}}')}}}"],
            "vehicle.battery.empty_voltage is 10.2, but must not be larger than voltage, 10",
        ),
        (
            [f"vehicle.battery={{{BATTERY.replace('0.65', '0')}}}"],
            "battery.efficiency is 0, but must be at least 0.01",
        ),
        (
            ["vehicle.slung_load={mass: 0.1, length: 1}", "vehicle.payload={mass: 0.1, time: 1, event: dropped}"],
            "vehicle.slung_load is .*, but must not be combined with a payload",
        ),
        ([f"vehicle.motors={THROTTLE_MOTORS}"], "vehicle.motors.kind is 'throttle', but must be speed as in nominal"),
        (
            [f"nominal.motors={THROTTLE_MOTORS}", "vehicle.motors={kind: speed}"],
            "vehicle.motors.kind is 'speed', but must be throttle as in nominal",
        ),
        (
            ["nominal.motors={kind: throttle, curve: [0.0227, -0.0119, 0.1284]}"],
            r"nominal.motors.curve is \[.*\], but must increase from throttle 0 to 1",
        ),
        (
            ["nominal.motors={kind: throttle, curve: [0, 4, -2.1]}"],
            r"nominal.motors.curve is \[.*\], but must increase from throttle 0 to 1",
        ),
        (
            ["nominal.motors={kind: throttle, curve: [0.1, 0, 0]}"],
            r"nominal.motors.curve is \[.*\], but must increase from throttle 0 to 1",
        ),
        (["vehicle.motors={kind: duty}"], "vehicle.motors.kind is 'duty', but must be"),
    ],
)
def test_invalid_effects_are_refused_with_a_reason_in_one_sentence(load, overrides, message):
    with pytest.raises(InputError) as refusal:
        load(*overrides)
    assert re.search(message, str(refusal.value)), str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_vehicle_has_the_nominal_motors_by_default(load):
    scenario = load(f"nominal.motors={THROTTLE_MOTORS}")
    assert scenario.vehicle.motors.curve == scenario.nominal.motors.curve == (0.1, 1.0, 2.8)
    with_own_motors = load(
        f"nominal.motors={THROTTLE_MOTORS}", "vehicle.motors={kind: throttle, curve: [0.02, -0.1, {choice: [2, 3]}]}"
    )
    assert with_own_motors.vehicle.motors.curve[:2] == (0.02, -0.1)


def test_the_empty_voltage_may_equal_the_smallest_full_voltage(load):
    full_voltage, empty_voltage = "{uniform: {min: 10.2, max: 12.6}}", "{uniform: {min: 9, max: 10.2}}"
    battery = BATTERY.replace("10.2", empty_voltage).replace("12.6", full_voltage)
    assert load(f"vehicle.battery={{{battery}}}").vehicle.battery.empty_voltage.uniform.max == 10.2
