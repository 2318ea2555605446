"""Tests of flights by comparison with an independent implementation in plain NumPy, in `tests/oracle`."""

import functools
from typing import get_args

import numpy as np
import pytest
from oracle.flight import fly

from drake_quad import simulate
from drake_quad.flight.simulation import simulate_samples
from drake_quad.vehicle.allocation import Priority

ATTITUDE_LOOP_ON_BOARD = [
    "control.attitude=null",
    "vehicle.time_step=0.005",
    "laboratory.autopilot={kind: attitude, period: 0.005, k_attitude: [5.0, 4.2, 2.1], k_rate: [11.0, 9.0, 6.0],"
    " gyroscope_noise: 0.01, gyroscope_bias: [0.01, -0.006, 0.008], attitude_noise: 0.002}",
]
ATTITUDE_RESPONSE = [
    "control.attitude=null",
    "vehicle.rotor_failure=null",
    "laboratory.autopilot={kind: response, natural_frequency: [6.8, 6.4, 3.1], damping: [0.5, 0.7, 1.1]}",
]
PRIORITIES = get_args(Priority)
PD_GAINS = "k_p: [1.3, 1.0, 5.0], k_d: [1.5, 1.3, 3.2]"
# Controller and overrides of each flight, by the features that the flight covers. The first two flights are long. Short
# flights cover the remaining features. Features that do not interact share a flight, because each flight is compiled.
FLIGHTS = {
    "pid": ("pid", []),
    "pd_t2fnn": ("pd_t2fnn", ["duration=14.2"]),
    "a sign learning law, three different periods, no link delay, no velocity filter": (
        "pd_t1fnn",
        [
            "duration=1.5",
            "vehicle.time_step=0.005",
            "laboratory.command_link={period: 0.04, delay_ticks: 0, loss_rate: 0.1}",
            "laboratory.motion_capture.derivative_bandwidth=null",
        ],
    ),
    "a gradient law, three ticks of link delay, small-angle kinematics, frames at the ticks": (
        "pd_t1fnn",
        [
            "duration=1.5",
            "control.network.learning={kind: gradient, rate: 0.4, slope: 1.7, leakage: 0.1, deadzone: 0.05}",
            "control.position.derivative=measurement",
            "control.position.feed_forward=none",
            "vehicle.attitude_kinematics=small_angle",
            "laboratory.command_link={delay_ticks: 3, loss_rate: 0}",
            "laboratory.motion_capture={period: 0.02, latency_frames: 0, dropout_rate: 0.0, derivative_bandwidth: 60}",
        ],
    ),
    "a network that learns from the feedback, with the inputs position, velocity and phase": (
        "pd_t2fnn",
        [
            "duration=2",
            "control.network.inputs={error_rate: null, y: {scale: 0.6, centres: [-1.0, 0.1, 1], widths: [1.2, 1, 1.3]},"
            " v_x: {scale: 0.9}, phase: {scale: 4.0, centres: [-0.7, 0.6, 1.9], widths: [1.2, 1.0, 1.4]}}",
            "control.network.lead=0.13",
            "control.network.learning={kind: gradient, signal: feedback, rate: 1.5, deadzone: 0.02}",
        ],
    ),
    **{
        f"rotors too weak for all parts of the wrench, priority {priority}": (
            "pid",
            [
                "duration=3",
                "nominal.min_rotor_speed=200",
                "nominal.max_rotor_speed=217",
                "vehicle.min_rotor_speed=201",
                "vehicle.max_rotor_speed=216",
                "laboratory.motion_capture.attitude_noise=0.01",
                f"laboratory.allocation.priority={priority}",
                "metrics.end=null",
            ],
        )
        for priority in PRIORITIES
    },
    "rotors at arbitrary positions, too weak for all parts of the wrench": (
        "pid",
        [
            "duration=3",
            "nominal.layout={kind: rotors, rotors: ["
            "{position: [0.14, -0.11, 0.02], turns: clockwise},"
            "{position: [-0.09, -0.13, 0.01], turns: anticlockwise, thrust_factor: 4.1e-5},"
            "{position: [-0.13, 0.10, 0.0], turns: clockwise, drag_factor: 1.2e-6},"
            "{position: [0.11, 0.14, 0.03], turns: anticlockwise}]}",
            "vehicle.layout={kind: rotors, rotors: ["
            "{position: [0.141, -0.111, 0.02], turns: clockwise},"
            "{position: [-0.091, -0.131, 0.01], turns: anticlockwise, thrust_factor: 4.05e-5},"
            "{position: [-0.129, 0.099, 0.0], turns: clockwise, drag_factor: 1.1e-6},"
            "{position: [0.109, 0.139, 0.03], turns: anticlockwise}]}",
            "nominal.min_rotor_speed=190",
            "nominal.max_rotor_speed=225",
            "vehicle.min_rotor_speed=190",
            "vehicle.max_rotor_speed=225",
            "laboratory.motion_capture.attitude_noise=0.012",
            "metrics.end=null",
        ],
    ),
    "a disturbance observer and geometric attitude control": (
        "pid",
        [
            "duration=1.6",
            f"control.position={{kind: disturbance_observer, {PD_GAINS}, feed_forward: snap, position_noise: 0.002,"
            " deviation: [0.3, 0.4, 0.2], time_constant: [0.5, 0.6, 0.7], response: {kind: commanded, delay_ticks: 2,"
            " lag: [0.25, 0.27, 0.06], feed_forward_lag: [0.07, 0.08, 0.05]}}",
            "control.attitude={kind: geometric, k_p: [17.0, 14.0, 5.0], k_d: [7.5, 6.8, 3.1], euler_sequence: zxy}",
        ],
    ),
    "geometric attitude control with an integral, filtered velocity with errors, an x layout": (
        "pid",
        [
            "duration=1.6",
            "nominal.layout={kind: x, length: 0.21, width: 0.24, rotor_1_turns: anticlockwise}",
            "vehicle.layout={kind: x, length: 0.212, width: 0.25, rotor_1_turns: anticlockwise}",
            "control.attitude={kind: geometric, k_p: [17.0, 14.0, 5.0], k_d: [7.5, 6.8, 3.1], k_i: [9.0, 6.0, 2.0],"
            " integral_limit: 0.1}",
            "laboratory.motion_capture.velocity_error=[0.1, -0.05, 0.2]",
            "laboratory.motion_capture.velocity_drift=[0.02, 0.0, 0.04]",
        ],
    ),
    "the firmware's Lee controller at a high rate, no link delay, velocity with scale error": (
        "pid",
        [
            "duration=1.4",
            "vehicle.time_step=0.0025",
            "laboratory.command_link={period: 0.005, delay_ticks: 0, loss_rate: 0}",
            "laboratory.motion_capture={period: 0.0025, velocity_error: [0.1, -0.05, 0.2]}",
            "control.position.integration=backward_euler",
            "control.position.feed_forward=jerk",
            "control.attitude={kind: geometric, k_p: [170.0, 140.0, 50.0], k_d: [24.0, 22.0, 12.0], k_i: [200.0, 100.0,"
            " 50.0], integration: backward_euler, euler_sequence: zxy, transport_term: false}",
        ],
    ),
    "L1 of the position and INDI of the attitude, with limits, unfiltered velocity with errors": (
        "pid",
        [
            "duration=1.6",
            "laboratory.motion_capture.derivative_bandwidth=null",
            "laboratory.motion_capture.velocity_error=[0.1, -0.05, 0.2]",
            "laboratory.motion_capture.velocity_drift=[0.03, 0.02, 0.01]",
            "laboratory.motion_capture.drift_time=0.4",
            f"control.position={{kind: l1, {PD_GAINS}, feed_forward: acceleration, adaptation: 2.5,"
            " bandwidth: [1.7, 2.1, 3.3], disturbance_limit: 0.4,"
            " response: {kind: commanded, delay_ticks: 0, lag: [0.25, 0.27, 0.06]}}",
            "control.attitude={kind: indi, k_p: [17.0, 14.0, 5.0], k_d: [7.5, 6.8, 3.1], lag: 0.08, bandwidth: 3.5,"
            " delay_ticks: 2, disturbance_limit: 0.15}",
        ],
    ),
    "INDI of position and attitude": (
        "pid",
        [
            "duration=1.6",
            f"control.position={{kind: indi, {PD_GAINS}, feed_forward: jerk, bandwidth: [2.7, 3.1, 4.3],"
            " response: {kind: commanded, lag: [0.25, 0.27, 0.06], feed_forward_lag: [0.07, 0.08, 0.05]}}",
            "control.attitude={kind: indi, k_p: [17.0, 14.0, 5.0], k_d: [7.5, 6.8, 3.1], lag: 0.08, bandwidth: 3.5,"
            " delay_ticks: 0}",
        ],
    ),
    "a network with lead time around INDI with the measured thrust direction": (
        "pd_t2fnn",
        [
            "duration=1.6",
            f"control.position={{kind: indi, {PD_GAINS}, feed_forward: snap, bandwidth: [2.7, 3.1, 4.3],"
            " response: {kind: tilt, delay_ticks: 2, lag: 0.07}}",
            "control.network.lead=0.17",
            "control.network.inputs={error: null, error_rate: null,"
            " x: {centres: [-1.0, 0.1, 1], widths: [1.2, 1, 1.3]}, z: {centres: [0.0, 1.1], widths: [1.2, 1.3]}}",
            "control.network.learning={kind: gradient, signal: feedback, rate: 1.5, weight_limit: 0.6}",
        ],
    ),
    "a disturbance observer with the measured thrust direction, and an autopilot": (
        "pid",
        [
            *ATTITUDE_LOOP_ON_BOARD,
            "duration=1.5",
            f"control.position={{kind: disturbance_observer, {PD_GAINS}, feed_forward: jerk, position_noise: 0.002,"
            " deviation: [0.3, 0.4, 0.2], time_constant: [0.5, 0.6, 0.7],"
            " response: {kind: tilt, delay_ticks: 0, lag: 0.07}}",
        ],
    ),
    "INDI of the position and an autopilot": (
        "pid",
        [
            *ATTITUDE_LOOP_ON_BOARD,
            "duration=1.5",
            f"control.position={{kind: indi, {PD_GAINS}, feed_forward: jerk, bandwidth: [2.7, 3.1, 4.3],"
            " response: {kind: commanded, delay_ticks: 1, lag: [0.25, 0.27, 0.06]}}",
        ],
    ),
    "an autopilot without noise at half the step rate, and a heading along the path": (
        "pd_t2fnn",
        [
            *ATTITUDE_LOOP_ON_BOARD,
            "duration=1.5",
            "vehicle.time_step=0.0025",
            "control.position.feed_forward=jerk",
            "laboratory.autopilot={gyroscope_noise: 0, attitude_noise: 0, k_rate: [9.0, 7.0, 5.0]}",
        ],
    ),
    "an identified attitude response": ("pid", [*ATTITUDE_RESPONSE, "duration=1.5"]),
    "an identified attitude response with small angles and unfiltered frames": (
        "pd_t1fnn",
        [
            *ATTITUDE_RESPONSE,
            "duration=1.5",
            "vehicle.attitude_kinematics=small_angle",
            "control.position.feed_forward=none",
            "laboratory.motion_capture.derivative_bandwidth=null",
        ],
    ),
    "an obstacle": (
        "pid",
        [
            "space={radius: 0.2, obstacles: {far: {kind: sphere, centre: [9, 9, 9], radius: 1}, near: {kind: cylinder,"
            " centre: [-1.1, 2.3, 0.9], rotation: [0.3, 0.2, 0], radius: 0.265, height: 4.0}}}",
        ],
    ),
    "a crash": ("pid", ["crash.position_error=0.5", "control.position.k_p.2=1.5", "control.position.k_i.2=0"]),
}


@pytest.fixture(scope="module")
def flight_named(asymmetric):
    """Return a function from a name in `FLIGHTS` to its flight; each flight is simulated only once."""

    def simulate_named(name):
        scenario, overrides = FLIGHTS[name]
        return simulate(asymmetric(scenario, *overrides))

    return functools.cache(simulate_named)


def assert_equal_flights(flight, signals, metrics):
    """Assert that signals and metrics agree to 1e-9 in their units."""
    assert flight.signals.keys() - {"crashed"} == signals.keys()
    for name, values in signals.items():
        np.testing.assert_allclose(flight[name], values, rtol=0.0, atol=1e-9, err_msg=name)
    flight_metrics = flight.metrics._asdict()
    assert flight_metrics.keys() == metrics.keys()
    for name, value in metrics.items():
        assert flight_metrics[name] == pytest.approx(value, rel=1e-9, abs=1e-12), name


@pytest.mark.long
@pytest.mark.parametrize("name", FLIGHTS)
def test_a_flight_equals_an_independent_implementation(flight_named, name):
    flight = flight_named(name)
    assert flight.metrics.crashed == (name in ("a crash", "an obstacle"))
    assert flight.obstacle_hit == ("near" if name == "an obstacle" else None)
    if name == "a crash":  # The horizontal error by itself is too small for a crash.
        reference, state = flight.record("reference"), flight.record("state")
        assert np.hypot(reference.x[-1] - state.x[-1], reference.y[-1] - state.y[-1]) < 0.5
    assert_equal_flights(flight, *fly(flight.scenario, flight.plan))


FLEET_DISTRIBUTIONS = [
    "duration=2",
    "vehicle.mass={uniform: {min: 0.68, max: 0.76}}",
    "nominal.layout={kind: x}",
    "vehicle.layout={kind: x, length: {uniform: {min: 0.22, max: 0.24}}, width: {uniform: {min: 0.22, max: 0.24}}}",
    "vehicle.thrust_factor_error.rotor_2={uniform: {min: -0.02, max: 0.0}}",
    "vehicle.battery_sag={uniform: {min: 0.0, max: 0.03}}",
    "vehicle.rotor_failure.rotor={choice: [1, 2, 3, 4]}",
    "vehicle.rotor_failure.time={uniform: {min: 0.0, max: 2.0}}",
    "laboratory.motion_capture.latency_frames={choice: [0, 1, 2, 3]}",
    "laboratory.motion_capture.misalignment.2={uniform: {min: -0.05, max: 0.05}}",
    "laboratory.command_link.delay_ticks={choice: [0, 1, 2]}",
    "laboratory.wind.1.start={uniform: {min: 0.0, max: 1.5}}",
    "laboratory.wind.5.flow={uniform: {min: 1.0, max: 3.0}}",
    "control.position.k_p.0={uniform: {min: 1.0, max: 1.5}}",
    "control.network.q={uniform: {min: 0.0, max: 1.0}}",
    "control.network.learning.slope={uniform: {min: 1.0, max: 2.0}}",
]


@pytest.mark.long
def test_each_flight_of_a_fleet_equals_an_independent_implementation(asymmetric):
    """Each vehicle has its own parameters, delays, wind and noise."""
    flights = simulate_samples(asymmetric("pd_t2fnn", *FLEET_DISTRIBUTIONS), [5, 0, 9])
    masses = {flight.scenario.vehicle.mass for flight in flights}
    delays = {flight.scenario.laboratory.command_link.delay_ticks for flight in flights}
    assert (len(masses), len(delays)) == (3, 2)
    for flight in flights:
        assert_equal_flights(flight, *fly(flight.scenario, flight.plan))


@pytest.mark.long
@pytest.mark.parametrize("name", ["pid", "pd_t2fnn"])
def test_signals_of_the_long_flights_take_both_signs_and_reach_their_limits(flight_named, name):
    """If a signal kept its sign or stayed below its limit, the comparison could miss an error."""
    flight = flight_named(name)
    steady = {"state": {"x", "y", "z"}, "wrench": {"thrust"}}
    if name == "pd_t2fnn":
        steady["state"].add("yaw")  # The yaw grows along the path of the figure eight.
    for signal in ("error", "error_rate", "acceleration_command", "wind", *steady):
        for row, values in flight.record(signal)._asdict().items():
            if row not in steady.get(signal, ()):
                assert values.min() < 0.0 < values.max(), (signal, row)
    limits, nominal = flight.scenario.control.thrust_vectoring, flight.scenario.nominal
    weight, attitude = nominal.mass * nominal.gravity, flight.record("attitude_command")
    thrust, upright = flight.record("wrench").thrust, np.cos(attitude.roll) * np.cos(attitude.pitch)
    assert np.arccos(upright).max() == pytest.approx(limits.max_tilt)
    assert (thrust * upright).min() == pytest.approx(limits.min_thrust * weight)
    assert thrust.max() == pytest.approx(limits.max_thrust * weight)
    learned = flight["correction" if name == "pid" else "weights"]
    control = flight.scenario.control
    limit = control.position.integral_limit if name == "pid" else control.network.learning.weight_limit
    assert (learned.min(), learned.max()) == (-limit, limit)
    assert 0.0 < np.mean(flight.record("shortfall").tau_z != 0.0) < 0.5
    if name == "pd_t2fnn":
        for signal, sets in control.network.inputs.specified.items():
            assert sets.scale * flight[signal].min() < sets.centres[0]
            assert sets.scale * flight[signal].max() > sets.centres[-1]


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in FLIGHTS if "too weak" in name])
def test_weak_rotors_reduce_each_part_of_the_wrench_at_some_ticks(flight_named, name):
    is_cut = flight_named(name)["shortfall"] != 0.0
    assert is_cut.any(axis=0).all()
    assert not is_cut.all(axis=0).any()


@pytest.mark.slow
@pytest.mark.parametrize("priority", PRIORITIES)
def test_weak_rotors_reach_both_speed_limits(flight_named, priority):
    flight = flight_named(f"rotors too weak for all parts of the wrench, priority {priority}")
    command = flight["rotor_speed_command"]
    vehicle = flight.scenario.vehicle
    assert (command.min(axis=0) < vehicle.min_rotor_speed).all()
    assert (command.max(axis=0) > vehicle.max_rotor_speed).all()
