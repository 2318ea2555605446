"""Driven by the commands of a log, the vehicle flies as it flew."""

from dataclasses import replace

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, simulate
from drake_quad.framework.elementary import sin_cos
from drake_quad.geometry.kinematics import small_rotation
from drake_quad.identification.model import (
    OpenLoop,
    Starts,
    commands_of,
    delay_of,
    level_vehicle,
    thrust_by_share,
    with_level_commands,
)
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.results.vehicle_numbers import number_of, with_numbers
from drake_quad.planning.believed import nominal_parameters
from drake_quad.scenario.motors import SpeedMotors
from drake_quad.signals import Attitude, RotorSpeed
from drake_quad.vehicle.dynamics import rotor_action


@pytest.fixture(scope="module")
def flight(root):
    """A flight in wind of a vehicle with drag along its axes and a lag downwards of its own."""
    overrides = (
        "duration=4",
        "vehicle.body_drag={linear: [0.1, 0.2, 0.05], centre_of_pressure: [0.0, 0.0, 0.02]}",
        "vehicle.rotor_time_constant_down=0.08",
        "laboratory.wind=[{kind: steady, velocity: [2.0, 1.0, 0.5]}]",
        "laboratory.command_link.loss_rate=0",
    )
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
    """A flight behind an autopilot, whose commands take a tick of 20 ms."""
    scenario = load_scenario(root / "diagrams" / "neural_fly.yaml:wind_8", ["laboratory.command_link.loss_rate=0"])
    flight = simulate(scenario, compiled=True)
    target = flight["attitude_target"]
    commands = {"thrust_share": target[:, 0] / (4 * 14.27), "attitude_command": target[:, 1:4]}
    return flight, FlightRecord("responding", flight.time, **commands, wind=flight["wind"])


# A flight records what is held at a tick before the link brings what holds from then on.
RECORDED = -0.02
STARTS = Starts(np.array([60, 100, 133]), 40)


def test_rotor_commands_fly_a_vehicle_where_it_flew(flight, record):
    loop = OpenLoop(flight.scenario, record, delay=RECORDED)
    flown = loop.fly(STARTS, flight["state"][STARTS.samples][None], every=20)
    assert flown.shape == (3, 1, 3, 12)
    for part, steps in enumerate((0, 20, 40)):
        np.testing.assert_allclose(flown[part, 0], flight["state"][STARTS.samples + steps], atol=2e-5)


def test_an_autopilot_with_its_delay_flies_a_vehicle_where_it_flew(responding):
    flight, record = responding
    state = flight["state"][STARTS.samples]
    loop = OpenLoop(flight.scenario, record, delay=0.02)
    flown = loop.fly(STARTS, rates_of_angles(state)[None])
    np.testing.assert_allclose(loop.shown(flown[0, 0]), state, atol=1e-12)
    error = loop.shown(flown[-1, 0]) - flight["state"][STARTS.samples + 40]
    late = OpenLoop(flight.scenario, record, delay=0.03).fly(STARTS, rates_of_angles(state)[None])[-1, 0]
    assert np.abs(error[:, 3:6]).max() < 1e-6
    assert np.abs(late[:, 3:6] - flight["state"][STARTS.samples + 40, 3:6]).max() > 1e-3


def rates_of_angles(state):
    """States with rates of the angles in the place of body rates: the inverse of eq (2)."""
    found = state.copy()
    roll, pitch = state[:, 3], state[:, 4]
    (s_r, c_r), (s_p, c_p) = sin_cos(roll), sin_cos(pitch)
    across = state[:, 10] * s_r + state[:, 11] * c_r
    found[:, 9] = state[:, 9] + s_p / c_p * across
    found[:, 10] = state[:, 10] * c_r - state[:, 11] * s_r
    found[:, 11] = across / c_p
    back = small_rotation(Attitude(*found[:, 9:12].T), Attitude(roll, pitch, state[:, 5]))
    np.testing.assert_allclose(np.stack(back, axis=1), state[:, 9:12], atol=1e-12)
    return found


def test_a_delay_of_one_sample_is_commands_a_sample_later(flight, record):
    states = flight["state"][STARTS.samples][None]
    delayed = OpenLoop(flight.scenario, record, delay=0.02).fly(STARTS, states)
    later = np.concatenate([record.rotor_speed_command[:1], record.rotor_speed_command[:-1]])
    shifted = OpenLoop(flight.scenario, replace(record, rotor_speed_command=later)).fly(STARTS, states)
    np.testing.assert_allclose(delayed, shifted, atol=1e-9)
    half = OpenLoop(flight.scenario, record, delay=0.01).fly(STARTS, states)
    assert np.abs(half[-1] - delayed[-1]).max() > 1e-5


def test_many_numbers_at_once_fly_as_each_alone(flight, record):
    loop = OpenLoop(flight.scenario, record)
    states = flight["state"][STARTS.samples]
    numbers = {
        "mass": np.array([0.6, 0.7]),
        "inertia[1]": np.array([0.006, 0.009]),
        "thrust_factor_error[2]": np.array([0.0, 0.05]),
    }
    both = loop.fly(STARTS, np.stack([states, states]), numbers)
    for i in range(2):
        own = with_numbers(flight.scenario, {name: values[i] for name, values in numbers.items()})
        alone = OpenLoop(own, record, believed=flight.scenario).fly(STARTS, states[None])
        np.testing.assert_allclose(both[:, i], alone[:, 0], atol=1e-12)
    assert np.abs(both[-1, 0] - both[-1, 1]).max() > 0.01


def test_states_that_are_given_stay_as_they_are(flight, record):
    states = flight["state"][STARTS.samples][None]
    before = states.copy()
    OpenLoop(flight.scenario, record).fly(STARTS, states)
    np.testing.assert_array_equal(states, before)


def test_thrust_and_torque_go_through_the_allocation_of_the_firmware(flight, record):
    wrench_alone = replace(record, rotor_speed_command=None)
    commands = commands_of(wrench_alone, flight.scenario, flight.scenario)
    np.testing.assert_allclose(commands.rotors[:-2], record.rotor_speed_command[2:], rtol=1e-9)
    lighter = with_numbers(flight.scenario, {"thrust_factor": 2e-5})
    same = commands_of(wrench_alone, lighter, flight.scenario)
    np.testing.assert_array_equal(same.rotors, commands.rotors)


@pytest.mark.parametrize(("priority", "given"), [("roll_pitch", 0.1), ("thrust", 0.0)])
def test_the_firmware_gives_up_the_part_without_priority(root, record, priority, given):
    """The command is a thrust beyond the rotors' limits together with a roll torque."""
    number = len(record.time)
    thrust, torque = np.full(number, 100.0), np.tile([0.1, 0.0, 0.0], (number, 1))
    wrench_alone = replace(record, rotor_speed_command=None, thrust_command=thrust, torque_command=torque)
    overrides = {"laboratory.allocation.priority": priority}
    firmware = load_scenario(root / "diagrams" / "laboratory.yaml:low_wind", overrides)
    speeds = commands_of(wrench_alone, firmware, firmware).rotors[0]
    believed = nominal_parameters(firmware)
    assert rotor_action(RotorSpeed(*speeds), believed).wrench.tau_x == pytest.approx(given, abs=1e-9)
    assert speeds.max() == pytest.approx(believed.max_rotor_speed)


def test_a_log_s_own_commands_drive_the_vehicle_as_speeds_or_throttles(flight, record, responding):
    found = commands_of(record, flight.scenario, flight.scenario)
    assert (found.throttles, found.attitude) == (False, None)
    np.testing.assert_array_equal(found.rotors, record.rotor_speed_command)
    assert not commands_of(replace(record, rotor_speed_command=None), flight.scenario, flight.scenario).throttles
    vehicle, log = responding[0].scenario, responding[1]
    found = commands_of(log, vehicle, vehicle)
    assert found.throttles
    np.testing.assert_array_equal(found.rotors, np.tile(log.thrust_share[:, None], 4))
    np.testing.assert_allclose(found.attitude, np.unwrap(log.attitude_command, axis=0))
    motors = np.random.default_rng(1).uniform(size=(len(log.time), 4))
    found = commands_of(replace(log, motor_command=motors), vehicle, vehicle)
    assert found.throttles
    np.testing.assert_array_equal(found.rotors, motors)


def test_throttles_need_the_motors_that_the_firmware_believes(responding, record):
    """The thrust is divided among motors with the believed thrust curve."""
    thrust = replace(record, rotor_speed_command=None, attitude_command=np.zeros((len(record.time), 3)))
    vehicle = responding[0].scenario
    commands = commands_of(thrust, vehicle, vehicle)
    assert commands.throttles
    k_0, k_1, k_2 = vehicle.nominal.motors.curve
    shares = commands.rotors
    inside = ((shares > 1e-6) & (shares < 1.0 - 1e-6)).all(axis=1)
    total = np.sum(k_0 + k_1 * shares + k_2 * shares**2, axis=1)
    np.testing.assert_allclose(total[inside], record.thrust_command[inside], rtol=1e-9)
    assert inside.any()
    nominal = vehicle.nominal.model_copy(update={"motors": SpeedMotors(kind="speed")})
    with pytest.raises(InputError, match=f"{vehicle.name} has no nominal.motors; add them, since throttles follow"):
        commands_of(thrust, vehicle, vehicle.model_copy(update={"nominal": nominal}))


def test_what_drives_no_vehicle_is_refused(flight, record):
    without = replace(record, rotor_speed_command=None, torque_command=None)
    with pytest.raises(InputError, match="no commands that drive the vehicle .*: it needs rotor_speed_command"):
        OpenLoop(flight.scenario, without)
    motors = replace(without, motor_command=np.zeros((len(record.time), 4)))
    with pytest.raises(InputError, match="motors: {kind: throttle}"):
        OpenLoop(flight.scenario, motors)


def test_the_delay_of_a_scenario_is_that_of_link_and_cameras(responding):
    scenario = responding[0].scenario
    assert delay_of(scenario) == pytest.approx(0.02 + 0.01)
    assert delay_of(scenario, 2.5) == pytest.approx(0.05 + 0.01)


def test_a_number_of_an_effect_that_is_off_is_zero(flight):
    assert number_of(flight.scenario, "rotor_aerodynamics.climb") == 0.0
    assert number_of(flight.scenario, "body_drag.linear[1]") == 0.2
    assert with_numbers(flight.scenario, {"rotor_aerodynamics.climb": 0.1}).vehicle.rotor_aerodynamics.climb == 0.1


def test_a_payload_is_there_from_the_beginning_whenever_it_is_dropped(root, record):
    """Windows of a log have no clock of their own: the vehicle is as at the beginning of a flight.

    Level at rest, it falls with the weight of both, and drag that is nothing yet.
    """
    dropped = "vehicle.payload={{mass: 0.2, position: [0.0, 0.0, -0.05], time: {}, event: dropped}}"
    starts, states = Starts(np.array([60, 100]), 1), np.zeros((1, 2, 12))
    soon, late, never = (
        OpenLoop(load_scenario(root / "diagrams" / "laboratory.yaml:low_wind", overrides), record).fly(starts, states)
        for overrides in ([dropped.format(0.5)], [dropped.format(99.0)], [])
    )
    np.testing.assert_array_equal(soon, late)
    # The thrust is the same, and its acceleration goes with one over the mass.
    mass, gravity = number_of(load_scenario("laboratory:low_wind"), "mass"), 9.81
    with_payload, alone = (after[-1, 0, :, 8] / record.period + gravity for after in (soon, never))
    np.testing.assert_allclose(with_payload * (mass + 0.2), alone * mass, rtol=1e-2)


def test_the_thrust_of_a_share_is_that_of_the_share_of_hover(responding, record):
    flight, log = responding
    shares = np.linspace(0.1, 0.9, len(log.time))
    hover = np.full(len(log.time), 0.45)
    scenario = flight.scenario
    weight = scenario.nominal.mass * scenario.nominal.gravity
    told = replace(log, thrust_share=shares, hover_share=hover)
    np.testing.assert_allclose(thrust_by_share(told, weight), weight * shares / 0.45)
    throttles = commands_of(told, scenario, scenario).rotors
    k_0, k_1, k_2 = scenario.nominal.motors.curve
    total = np.sum(k_0 + k_1 * throttles + k_2 * throttles**2, axis=1)
    inside = (throttles < 1.0 - 1e-6).all(axis=1)
    np.testing.assert_allclose(total[inside], (weight * shares / 0.45)[inside])
    assert inside.sum() > 10
    # Without a share of hover, a share of thrust is a throttle.
    throttles = commands_of(replace(told, hover_share=None), scenario, scenario).rotors
    np.testing.assert_array_equal(throttles, np.tile(shares[:, None], 4))
    # Motor commands come first.
    motors = np.tile([0.1, 0.2, 0.3, 0.4], (len(log.time), 1))
    np.testing.assert_array_equal(commands_of(replace(told, motor_command=motors), scenario, scenario).rotors, motors)


def test_a_torque_behind_an_autopilot_does_not_turn_the_vehicle(responding, record):
    flight, _ = responding
    scenario = flight.scenario
    number = len(record.time)
    told = replace(record, rotor_speed_command=None, attitude_command=np.zeros((number, 3)))
    torque = np.tile([0.1, 0.2, 0.05], (number, 1))
    one, other = (commands_of(replace(told, torque_command=each), scenario, scenario).rotors for each in (None, torque))
    np.testing.assert_array_equal(one, other)


def test_a_vehicle_that_is_taken_for_level_stays_level(flight, record):
    """Whatever its rotors do, and wherever it leaned before, it levels off without swinging over."""
    level = level_vehicle(flight.scenario)
    log = with_level_commands(record)
    np.testing.assert_array_equal(log.attitude_command, np.zeros((len(record.time), 3)))
    starts = Starts(np.array([60]), 100)
    body = np.zeros((1, 1, 12))
    body[..., 3:6] = 0.2
    angles = OpenLoop(level, log).fly(starts, body)[:, 0, 0, 3:6]
    assert (np.diff(angles, axis=0) <= 1e-12).all()
    assert (angles >= -1e-12).all()
    np.testing.assert_allclose(angles[-1], 0.0, atol=1e-6)


def test_commands_before_a_log_are_as_at_its_first_sample_and_integrals_are_exact(flight):
    """Means over steps of commands that hold until the next sample, for any delay, on an uneven clock."""
    random = np.random.default_rng(6)
    time = np.cumsum(random.uniform(0.005, 0.03, 60))
    speeds = random.uniform(150.0, 250.0, (60, 4))
    loop = OpenLoop(flight.scenario, FlightRecord("log", time, rotor_speed_command=speeds))
    period = loop._record.period
    ends = np.append(time, time[-1] + period)
    fine = np.linspace(ends[10] - 0.5 * period, ends[12], 20_001)
    held = speeds[np.clip(np.searchsorted(ends, fine, side="right") - 1, 0, 59)]
    expected = np.trapezoid(held, fine, axis=0)
    found = loop._integrated(fine[-1:]) - loop._integrated(fine[:1])
    np.testing.assert_allclose(found[0], expected, rtol=1e-3)
    # Before the log, and behind its end.
    first = loop._integrated(time[:1]) - loop._integrated(time[:1] - 0.4)
    np.testing.assert_allclose(first[0], 0.4 * speeds[0])
    behind = loop._integrated(ends[-1:] + 0.3) - loop._integrated(ends[-1:])
    np.testing.assert_allclose(behind[0], 0.3 * speeds[-1])
    # Steps in two parts have the lengths of their samples, and the means of the commands.
    steps = loop._steps(np.array([20, 57]), np.arange(5), 2, np.array([0.0, 0.004]))
    assert steps.commands.shape == (5, 2, 4, 2, 2)
    for w, start in enumerate((20, 57)):
        for k in range(5):
            sample = min(start + k, 59)
            length = (ends[sample + 1] - ends[sample]) / 2.0
            assert steps.lengths[k, w] == pytest.approx(length)
            for part in range(2):
                for d, delay in enumerate((0.0, 0.004)):
                    ends_of_part = ends[sample] + length * np.array([part, part + 1]) - delay
                    low, high = loop._integrated(ends_of_part)
                    np.testing.assert_allclose(steps.commands[k, part, :, d, w], (high - low) / length)
            np.testing.assert_allclose(steps.commands[k, 0, :, 0, w], speeds[sample])


def test_motors_that_take_throttles_are_only_spoken_of_where_these_are_logged(flight, record):
    without = replace(record, rotor_speed_command=None, torque_command=None)
    with pytest.raises(InputError, match=r"or thrust_command and torque_command, and has thrust_command, wind$"):
        OpenLoop(flight.scenario, without)


def test_an_autopilot_needs_a_thrust_and_no_torque(responding):
    flight, log = responding
    with pytest.raises(InputError, match=r"it needs motor_command, or thrust_command, and has attitude_command, wind$"):
        OpenLoop(flight.scenario, replace(log, thrust_share=None))
