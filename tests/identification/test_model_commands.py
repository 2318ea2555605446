"""Tests of the commands that drive the model: logged commands, or thrust and torque that the firmware allocates."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_quad import InputError, load_scenario, simulate
from drake_quad.identification.delays import total_delay
from drake_quad.identification.model import (
    LogModel,
    level_vehicle,
    thrust_of_fraction,
    with_commands,
)
from drake_quad.identification.results.vehicle_values import vehicle_value, with_vehicle_values
from drake_quad.logs.record import FlightRecord
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.scenario.motors import SpeedMotors
from drake_quad.signals import RotorSpeed
from drake_quad.vehicle.dynamics import rotor_action


@pytest.fixture(scope="module")
def flight(root):
    overrides = ["laboratory.command_link.loss_rate=0", "duration=3"]
    return simulate(load_scenario(root / "diagrams" / "laboratory.yaml:low_wind", overrides), compiled=True)


@pytest.fixture(scope="module")
def record(flight):
    wrench = flight["wrench"]
    return FlightRecord(
        "flown",
        flight.time,
        rotor_speed_command=flight["rotor_speed_command"],
        thrust_command=wrench[:, 0],
        torque_command=wrench[:, 1:4],
        wind=flight["wind"],
    )


@pytest.fixture(scope="module")
def responding(root):
    """Return the scenario of an autopilot, and a log of commands to the autopilot."""
    random = np.random.default_rng(2)
    commands = {"thrust_fraction": random.uniform(0.3, 0.6, 100), "attitude_command": random.normal(size=(100, 3))}
    return load_scenario(root / "diagrams" / "neural_fly.yaml:wind_8"), FlightRecord(
        "responding", 0.02 * np.arange(100), **commands
    )


@pytest.mark.slow
def test_thrust_and_torque_are_allocated_as_by_the_firmware(flight, record):
    """The link delays commands by two ticks. The parameters of the identified vehicle do not change the allocation."""
    wrench_alone = replace(record, rotor_speed_command=None)
    result = with_commands(wrench_alone, flight.scenario, flight.scenario).rotor_speed_command
    np.testing.assert_allclose(result[:-2], record.rotor_speed_command[2:], rtol=1e-9)
    lighter = with_vehicle_values(flight.scenario, {"thrust_factor": 2e-5})
    np.testing.assert_array_equal(with_commands(wrench_alone, lighter, flight.scenario).rotor_speed_command, result)


@pytest.mark.parametrize(("priority", "given"), [("roll_pitch", 0.1), ("thrust", 0.0)])
def test_the_firmware_reduces_the_component_without_priority(root, record, priority, given):
    """The command is a thrust beyond the rotors' limits together with a roll torque."""
    number = len(record.time)
    thrust, torque = np.full(number, 100.0), np.tile([0.1, 0.0, 0.0], (number, 1))
    wrench_alone = replace(record, rotor_speed_command=None, thrust_command=thrust, torque_command=torque)
    firmware = load_scenario(
        root / "diagrams" / "laboratory.yaml:low_wind", {"laboratory.allocation.priority": priority}
    )
    speeds = RotorSpeed(*with_commands(wrench_alone, firmware, firmware).rotor_speed_command.T)
    nominal = nominal_parameters(firmware)
    first = RotorSpeed(*(row[0] for row in speeds))
    assert rotor_action(first, nominal).wrench.tau_x == pytest.approx(given, abs=1e-9)
    assert max(first) == pytest.approx(nominal.max_rotor_speed)


def test_logged_motor_commands_have_priority_over_allocated_commands(flight, record, responding):
    assert with_commands(record, flight.scenario, flight.scenario) is record
    vehicle, log = responding
    result = with_commands(log, vehicle, vehicle)
    np.testing.assert_array_equal(result.motor_command, np.tile(log.thrust_fraction[:, None], 4))
    np.testing.assert_allclose(result.attitude_command, np.unwrap(log.attitude_command, axis=0))
    motors = np.random.default_rng(1).uniform(size=(len(log.time), 4))
    np.testing.assert_array_equal(
        with_commands(replace(log, motor_command=motors), vehicle, vehicle).motor_command, motors
    )


def test_throttles_follow_from_the_nominal_thrust_curve(responding, record):
    thrust = replace(record, rotor_speed_command=None, attitude_command=np.zeros((len(record.time), 3)))
    vehicle, _ = responding
    fractions = with_commands(thrust, vehicle, vehicle).motor_command
    k_0, k_1, k_2 = vehicle.nominal.motors.curve
    inside = ((fractions > 1e-6) & (fractions < 1.0 - 1e-6)).all(axis=1)
    total = np.sum(k_0 + k_1 * fractions + k_2 * fractions**2, axis=1)
    np.testing.assert_allclose(total[inside], record.thrust_command[inside], rtol=1e-9)
    assert inside.any()
    nominal = vehicle.nominal.model_copy(update={"motors": SpeedMotors(kind="speed")})
    with pytest.raises(InputError, match=f"{vehicle.name} has no nominal.motors; add nominal.motors with a"):
        with_commands(thrust, vehicle, vehicle.model_copy(update={"nominal": nominal}))


def test_a_thrust_fraction_is_relative_to_the_hover_thrust_fraction(responding):
    scenario, log = responding
    fractions, hover = np.linspace(0.1, 0.9, len(log.time)), np.full(len(log.time), 0.45)
    weight = scenario.nominal.mass * scenario.nominal.gravity
    with_fractions = replace(log, thrust_fraction=fractions, hover_thrust_fraction=hover)
    np.testing.assert_allclose(thrust_of_fraction(with_fractions, weight), weight * fractions / 0.45)
    throttles = with_commands(with_fractions, scenario, scenario).motor_command
    k_0, k_1, k_2 = scenario.nominal.motors.curve
    thrust = np.sum(k_0 + k_1 * throttles + k_2 * throttles**2, axis=1)
    inside = (throttles < 1.0 - 1e-6).all(axis=1)
    np.testing.assert_allclose(thrust[inside], (weight * fractions / 0.45)[inside])
    assert inside.sum() > 10
    with pytest.raises(InputError, match="hover_thrust_fraction of the log 'responding' is zero or negative"):
        thrust_of_fraction(replace(with_fractions, hover_thrust_fraction=0.0 * hover), weight)


def test_a_logged_torque_is_ignored_if_the_vehicle_has_an_attitude_response(responding, record):
    scenario, _ = responding
    number = len(record.time)
    with_attitudes = replace(record, rotor_speed_command=None, attitude_command=np.zeros((number, 3)))
    torque = np.tile([0.1, 0.2, 0.05], (number, 1))
    one, other = (
        with_commands(replace(with_attitudes, torque_command=each), scenario, scenario).motor_command
        for each in (None, torque)
    )
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("left_out", "message"),
    [
        (
            ("rotor_speed_command", "torque_command"),
            r"rotor_speed_command, or thrust_command and torque_command, but the log contains thrust_command, wind$",
        ),
        (("rotor_speed_command", "thrust_command"), "but the log contains torque_command, wind$"),
    ],
)
def test_a_log_without_commands_is_refused(flight, record, left_out, message):
    without = replace(record, **dict.fromkeys(left_out))
    with pytest.raises(InputError, match=message):
        with_commands(without, flight.scenario, flight.scenario)
    motors = replace(without, motor_command=np.zeros((len(record.time), 4)))
    with pytest.raises(InputError, match="the log has speeds|the log has throttles"):
        with_commands(motors, flight.scenario, flight.scenario)


def test_the_delay_of_a_scenario_is_the_sum_of_link_delay_and_frame_age(responding):
    assert total_delay(responding[0]) == pytest.approx(0.02 + 0.01)


def test_a_parameter_of_a_missing_effect_is_zero(flight):
    assert vehicle_value(flight.scenario, "rotor_aerodynamics.climb") == 0.0
    assert vehicle_value(flight.scenario, "linear_drag") == flight.scenario.vehicle.linear_drag
    assert (
        with_vehicle_values(flight.scenario, {"rotor_aerodynamics.climb": 0.1}).vehicle.rotor_aerodynamics.climb == 0.1
    )


def test_a_level_vehicle_responds_to_attitude_commands(flight):
    assert LogModel(level_vehicle(flight.scenario), ()).has_attitude_response


def test_measured_states_include_the_misalignment_of_markers(responding):
    """The states of a vehicle with an attitude response contain the rates of the angles.

    The kinematic matrix converts them to body rates.
    """
    scenario, _ = responding
    misalignment = [0.02, -0.03, 0.1]
    turned = load_scenario("neural_fly:wind_8", [f"laboratory.motion_capture.misalignment={misalignment}"])
    state = 0.4 * np.random.default_rng(3).normal(size=(12, 50))
    roll, pitch, _ = state[3:6]
    d_roll, d_pitch, d_yaw = state[9:12]
    rates = [
        d_roll - d_yaw * np.sin(pitch),
        d_pitch * np.cos(roll) + d_yaw * np.sin(roll) * np.cos(pitch),
        -d_pitch * np.sin(roll) + d_yaw * np.cos(roll) * np.cos(pitch),
    ]
    for vehicle, angles in ((scenario, [0.0, 0.0, 0.0]), (turned, misalignment)):
        measured = LogModel(vehicle, ()).measured_state(state.copy())
        expected = Rotation.from_euler("ZYX", state[5:2:-1].T) * Rotation.from_euler("ZYX", angles[::-1])
        np.testing.assert_allclose(measured[5:2:-1].T, expected.as_euler("ZYX"), atol=1e-9)
        np.testing.assert_allclose(measured[9:12], rates, atol=1e-9)
        np.testing.assert_array_equal(measured[[0, 1, 2, 6, 7, 8]], state[[0, 1, 2, 6, 7, 8]])
    assert scenario.laboratory.autopilot.models_vehicle
