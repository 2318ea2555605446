"""Tests of linear models and gain design for an autopilot, modelled by its loops or an identified response."""

import re
import shlex
from argparse import ArgumentParser

import numpy as np
import pytest
import scipy
from ruamel.yaml import YAML
from tick_jacobian import jacobian_of_tick

from drake_quad import InputError, build_tracking_diagram, load_scenario, simulate
from drake_quad.command_line.design import add_design_options, design_options
from drake_quad.design.cascade import (
    attitude_plant,
    default_options,
    design_cascade,
    on_board_attitude_plant,
    on_board_options,
    position_plant,
    with_autopilot_gains,
    with_gains,
)
from drake_quad.design.gains import Proportional, ProportionalGain, Requirements, design_loop, pd_loop
from drake_quad.design.stability_map import linear_map, mapped_gains, mapped_plant, simulated_map, stability_map
from drake_quad.linear.closed_loop import PASSIVE_SYSTEMS, closed_loop, laboratory_plant, on_board_plant
from drake_quad.linear.context_vector import ContextVector
from drake_quad.linear.margins import margins
from drake_quad.linear.sampled_system import at_tick, linearize
from drake_quad.linear.step_response import initial_response
from drake_quad.scenario.hovering import at_rest, nominal_hover

RESPONSE_OVERRIDES = [
    "laboratory.autopilot={kind: response, natural_frequency: [6.8, 6.1, 3.0], damping: [0.45, 0.5, 0.7]}",
    "control.position.feed_forward=acceleration",
]
AUTOPILOT_OVERRIDES = {"attitude": [], "response": RESPONSE_OVERRIDES}
ASYMMETRIC_OVERRIDES = [
    "nominal.inertia=[0.0065, 0.0085, 0.0126]",
    "control.position={k_p: [1.2, 1.5, 5.5], k_d: [1.5, 1.7, 3.4]}",
]
ON_BOARD_GAINS = {"k_attitude": (5.0, 6.0, 4.0), "k_rate": (14.0, 12.0, 10.0)}  # 1/s, gains about x, y and z
# Overrides that add delays, a filter, wind, an asymmetric vehicle, and two vehicle steps per autopilot period.
IMPERFECT_OVERRIDES = [
    "vehicle={time_step: 0.00125, centre_of_mass: [0.0005, -0.0003]}",
    "laboratory.motion_capture={derivative_bandwidth: 60, latency_frames: 1, misalignment: [0.01, 0.02, 0.0]}",
    "laboratory.command_link.delay_ticks=2",
    "laboratory.wind=[{kind: steady, velocity: [1, 0.5, 0]},"
    " {kind: fan, position: [-2, 0, 1], direction: [1, 0, 0], flow: 2, diameter: 0.7, turbulence: 0}]",
]


@pytest.fixture(scope="module")
def onboard(diagrams):
    return lambda *overrides: load_scenario(diagrams / "onboard.yaml", overrides)


@pytest.mark.long
@pytest.mark.parametrize("kind", AUTOPILOT_OVERRIDES)
@pytest.mark.parametrize("overrides", [[], IMPERFECT_OVERRIDES])
def test_the_jacobian_of_a_loop_with_an_autopilot_matches_finite_differences(onboard, kind, overrides):
    """A control period has eight autopilot periods, and eight or sixteen time steps of the vehicle."""
    scenario = at_rest(onboard(*AUTOPILOT_OVERRIDES[kind], *overrides))
    diagram = build_tracking_diagram(scenario)
    context = at_tick(diagram, 0.08)
    system, _ = linearize(diagram, context, period=0.02, excluded_systems=PASSIVE_SYSTEMS)
    layout = ContextVector(diagram, excluded_systems=PASSIVE_SYSTEMS)
    numeric = jacobian_of_tick(diagram, context, layout, until=0.1)
    np.testing.assert_allclose(system.A, numeric, atol=1e-6)
    names = {"attitude": "laboratory.autopilot.wrench.tau_x", "response": "laboratory.vehicle.state.pitch_rate"}
    assert names[kind] in system.states
    assert "laboratory.command_link.attitude_target.roll" in system.states


@pytest.mark.slow
def test_the_plant_on_board_is_a_double_integrator_in_series_with_the_rotor_lag(onboard):
    """The expected response includes a zero-order hold over a period of the autopilot, and no delay."""
    h, lag = 0.0025, 0.05
    A = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -1.0 / lag]])
    B = np.array([[0.0], [0.0], [1.0 / lag]])
    hold = scipy.linalg.expm(np.block([[A, B], [np.zeros((1, 4))]]) * h)
    for time_step in (0.0025, 0.00125):
        full_plant = on_board_plant(onboard(*ASYMMETRIC_OVERRIDES, f"vehicle.time_step={time_step}"))
        assert full_plant.period == h
        for torque, angle, rate, inertia in (
            ("tau_x", "roll", "p", 0.0065),
            ("tau_y", "pitch", "q", 0.0085),
            ("tau_z", "yaw", "r", 0.0126),
        ):
            plant = full_plant.between([f"wrench.{torque}"], [f"state.{angle}", f"state.{rate}"])
            for frequency in (0.3, 10.0, 300.0):
                z = np.exp(1j * frequency * h)
                expected = np.linalg.solve(z * np.eye(3) - hold[:3, :3], hold[:3, 3])[:2]
                np.testing.assert_allclose(inertia * plant.response(np.array([z]))[0, :, 0], expected, rtol=1e-5)


def test_poles_of_the_yaw_loop_on_board_agree_with_the_whole_diagram(onboard):
    """Only the autopilot acts on the yaw. A tick has eight autopilot periods, so poles appear as eighth powers."""
    scenario = with_autopilot_gains(onboard(*ASYMMETRIC_OVERRIDES), ON_BOARD_GAINS)
    yaw_plant = on_board_plant(scenario).between(["wrench.tau_z"], ["state.yaw", "state.r"])
    yaw_plant = yaw_plant.connected().scaled(0.0126, "acceleration_command")
    outer = on_board_attitude_plant(yaw_plant, 10.0)
    assert (outer.inputs, outer.outputs) == (("rate_command",), ("state.yaw",))
    poles = outer.with_feedback(np.array([[4.0]])).poles() ** 8
    multipliers = closed_loop(nominal_hover(scenario)).system.poles()
    assert len(poles) == 3
    for pole in poles:
        assert np.abs(multipliers - pole).min() < 1e-6


def test_an_autopilot_of_kind_response_has_the_given_modes(onboard):
    """The modes of the yaw, on which no position loop acts, are exp(s h) with s = ω_n (-ζ ± i √(1 - ζ²))."""
    multipliers = closed_loop(nominal_hover(onboard(*RESPONSE_OVERRIDES))).system.poles()
    pole = np.exp(3.0 * 0.02 * complex(-0.7, np.sqrt(1.0 - 0.49)))
    assert np.abs(multipliers - pole).min() < 1e-9


@pytest.mark.parametrize("kind", AUTOPILOT_OVERRIDES)
def test_designed_poles_agree_with_the_whole_diagram(onboard, kind):
    """The poles of the position loops around an autopilot are Floquet multipliers of the whole diagram."""
    scenario = onboard(*AUTOPILOT_OVERRIDES[kind], *ASYMMETRIC_OVERRIDES)
    if kind == "attitude":
        scenario = with_autopilot_gains(scenario, ON_BOARD_GAINS)
    position, laboratory = scenario.control.position, laboratory_plant(scenario)
    plants = [position_plant(laboratory, scenario, "x", None), position_plant(laboratory, scenario, "y", None)]
    plants.append(attitude_plant(laboratory, scenario, "z"))
    multipliers = closed_loop(nominal_hover(scenario)).system.poles()
    for plant, k_p, k_d in zip(plants, position.k_p, position.k_d, strict=True):
        assert plant.outputs[1].startswith("measurement.v_")
        poles = plant.with_feedback(np.array([[k_p, k_d]])).poles()
        slow_poles = poles[np.abs(poles) > 0.1]
        assert len(slow_poles) >= 4
        for pole in slow_poles:
            assert np.abs(multipliers - pole).min() < 1e-6
    gain_map = stability_map(mapped_plant(scenario, "position"), np.array([1.2, 40.0]), np.array([1.5]))
    np.testing.assert_array_equal(gain_map.stable, [[True], [False]])


@pytest.mark.slow
def test_the_fastest_proportional_loop_within_its_margins_is_found(onboard):
    """Without the zero-order hold, k / (s (T s + 1)) has the phase margin 60° for ω T = tan 30° and k = ω √(1 + ω² T²).

    The hold adds a delay of h / 2.
    """
    plant = on_board_plant(onboard()).between(["wrench.tau_x"], ["state.p"]).connected().scaled(0.007, "a")
    design = design_loop(plant, Proportional(), Requirements(phase=60.0, gain=10.0), axis="roll rate")
    assert isinstance(design.gains, ProportionalGain)
    assert design.limits == ("phase margin",)
    assert 60.0 <= design.margins.phase < 60.05
    omega = design.margins.crossover
    assert np.arctan(omega * 0.05) + 0.5 * omega * 0.0025 == pytest.approx(np.radians(30.0), rel=2e-3)
    assert design.gains.k == pytest.approx(omega * np.hypot(1.0, 0.05 * omega), rel=1e-3)
    efforts = Proportional().efforts(plant)
    assert (efforts[0], efforts[-1]) == (pytest.approx(0.05), pytest.approx(np.pi / 0.0075))
    with pytest.raises(
        InputError, match=r"no gains of this family meet the requirements for p; closest result: phase margin: 8\d\.\d°"
    ):
        design_loop(plant, Proportional(), Requirements(phase=89.9, gain=10.0), axis="p")


@pytest.fixture(scope="module")
def designed(onboard):
    return design_cascade(onboard(), on_board=True)


@pytest.mark.long
def test_loops_on_board_have_their_margins_and_each_rate_loop_is_designed_before_its_attitude_loop(onboard, designed):
    angles = ("roll", "pitch", "yaw")
    assert list(designed.on_board) == [loop for angle in angles for loop in (f"{angle} rate", angle)]
    assert list(designed.loops) == ["z", "x", "y"]
    assert designed.all_loops == {**designed.on_board, **designed.loops}
    for name, loop in designed.all_loops.items():
        achieved = margins(pd_loop(loop.plant, loop.gains))
        phase, gain = (60.0, 10.0) if name in designed.on_board else (45.0, 6.0)
        assert achieved.phase >= phase
        assert achieved.gain >= gain
        assert loop.plant.period == (0.0025 if name in designed.on_board else 0.02)
        assert min(achieved.phase / phase, achieved.gain / gain) < 1.01
    assert designed.gains().keys() == {"position"}
    assert designed.autopilot_gains()["k_rate"] == [designed.on_board[f"{angle} rate"].gains.k for angle in angles]
    # The position loop is designed around the designed attitude loops, not around the loops of the scenario.
    slow_autopilot = with_autopilot_gains(onboard(), {"k_attitude": (2.0,) * 3, "k_rate": (6.0,) * 3})
    assert design_cascade(slow_autopilot, on_board=True).gains() == designed.gains()
    around_slow_autopilot = design_cascade(slow_autopilot)
    assert around_slow_autopilot.loops["x"].gains.k_p < designed.loops["x"].gains.k_p
    assert (around_slow_autopilot.on_board, around_slow_autopilot.autopilot_gains()) == ({}, {})


@pytest.mark.slow
def test_shipped_gains_are_the_result_of_the_command_that_their_file_names(root, onboard, designed):
    text = (root / "diagrams" / "gains" / "onboard.yaml").read_text(encoding="utf-8")
    command = shlex.split(re.match(r"# drake-quad (.*)\n", text).group(1))
    assert command == ["design", "onboard", "--on-board"]
    arguments = ArgumentParser()
    arguments.add_argument("scenario")
    add_design_options(arguments)
    options = design_options(arguments.parse_args(command[1:]), onboard())
    assert options == default_options(0.02) | on_board_options()
    saved_gains = YAML(typ="safe").load(text)["gains"]
    position = {"kind": "pd", "derivative": "tracking_error", "feed_forward": "jerk"} | designed.gains()["position"]
    assert saved_gains["control"] == {"kind": "cascade", "position": position}
    assert saved_gains["laboratory"] == {"autopilot": designed.autopilot_gains()}
    scenario = onboard()
    reproduced = with_autopilot_gains(with_gains(scenario, designed.gains()), designed.autopilot_gains())
    assert reproduced == scenario


def displacement_grows(scenario, row, duration):
    """Return whether a small displacement of the simulated diagram grows after the fast modes have decayed."""
    response = initial_response(closed_loop(scenario), {row: 1e-5}, duration=duration)
    column = ("x", "y", "z", "roll", "pitch", "yaw").index(row)
    _, _, third, last = [part.max() for part in np.array_split(np.abs(response.nonlinear[:, column]), 4)]
    return last > third


def with_position_scaled(scenario, factor, axes):
    position = scenario.control.position
    gains = {
        kind: [value * (factor if i in axes else 1.0) for i, value in enumerate(getattr(position, kind))]
        for kind in ("k_p", "k_d")
    }
    return with_gains(scenario, {"position": gains})


@pytest.mark.long
@pytest.mark.parametrize(
    ("kind", "row", "axes", "duration"), [("attitude", "z", (2,), 8.0), ("response", "x", (0, 1), 12.0)]
)
def test_flights_begin_to_oscillate_at_the_gain_limit_of_the_position_loop(onboard, kind, row, axes, duration):
    """A small displacement decays 2 % below the stability limit, and grows 2 % above the limit."""
    scenario = onboard(*AUTOPILOT_OVERRIDES[kind])
    loop = design_cascade(scenario).loops[row]
    resting = at_rest(nominal_hover(with_gains(scenario, design_cascade(scenario).gains())))
    factor = 10.0 ** (loop.margins.gain / 20.0)
    assert not displacement_grows(with_position_scaled(resting, 0.98 * factor, axes), row, duration)
    assert displacement_grows(with_position_scaled(resting, 1.02 * factor, axes), row, duration)


@pytest.mark.slow
@pytest.mark.parametrize("fraction", [0.98, 1.02])
def test_flights_begin_to_oscillate_at_the_gain_limit_of_the_yaw_loop_on_board(onboard, designed, fraction):
    """Flights and linear model agree on the gain limit within 2 %. The yaw loop includes the yaw rate loop."""
    factor = fraction * 10.0 ** (designed.on_board["yaw"].margins.gain / 20.0)
    resting = at_rest(nominal_hover(onboard()))
    gains = designed.autopilot_gains()
    roll, pitch, yaw = gains["k_attitude"]
    changed = with_autopilot_gains(resting, {**gains, "k_attitude": (roll, pitch, factor * yaw)})
    assert displacement_grows(changed, "yaw", 4.0) == (fraction > 1.0)


def test_at_rest_removes_the_noise_of_an_autopilot_and_nominal_hover_also_removes_its_bias(onboard):
    scenario = onboard("laboratory.autopilot={attitude_noise: 0.1, gyroscope_bias: [0.1, 0.2, 0.3]}")
    resting, nominal = (change(scenario).laboratory.autopilot for change in (at_rest, nominal_hover))
    assert resting == scenario.laboratory.autopilot.model_copy(update={"gyroscope_noise": 0.0, "attitude_noise": 0.0})
    assert nominal == resting.model_copy(update={"gyroscope_bias": (0.0, 0.0, 0.0)})


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (RESPONSE_OVERRIDES, "laboratory.autopilot is of kind response, which has no gains; use kind attitude"),
        (["vehicle.time_step=0"], "vehicle.time_step is 0 s, but must be positive for the design of loops on board"),
    ],
)
def test_loops_on_board_that_cannot_be_designed_are_refused(onboard, overrides, words):
    with pytest.raises(InputError, match=words):
        design_cascade(onboard(*overrides), on_board=True)


THROTTLE_OVERRIDES = [
    "nominal.motors={kind: throttle, curve: [0.1, 1.0, 2.8]}",
    "vehicle.motors={kind: throttle, curve: [0.11, 1.05, 2.6]}",
]


@pytest.mark.parametrize("motors", [[], THROTTLE_OVERRIDES], ids=["speed", "throttle"])
def test_poles_of_the_stability_map_agree_with_the_diagram_without_position_control(onboard, motors):
    """The stability map is for the actual vehicle, not the nominal one. A tick has eight autopilot periods."""
    actual = [
        *("vehicle.mass=0.75", "vehicle.inertia=[0.0071, 0.0079, 0.0131]", "vehicle.rotor_time_constant=0.04"),
        "control.position={k_p: [1e-7, 1e-7, 5.5], k_d: [1e-7, 1e-7, 3.4]}",
        "laboratory.autopilot.gyroscope_bias=[0, 0, 0]",
    ]
    scenario = onboard(*ASYMMETRIC_OVERRIDES, *actual, *motors)
    k_attitude, k_rate = np.array([5.0, 30.0]), np.array([8.0, 14.0, 22.0])
    gain_map = linear_map(scenario, "attitude", k_attitude, k_rate)
    np.testing.assert_array_equal(gain_map.stable, [[True] * 3, [False] * 3])
    plant = mapped_plant(scenario, "attitude")
    assert plant.period == 0.0025
    changed = with_autopilot_gains(scenario, {"k_attitude": (4.0, 5.0, 4.0), "k_rate": (12.0, 22.0, 10.0)})
    multipliers = closed_loop(changed).system.poles()
    poles = plant.with_feedback(np.array([[5.0 * 22.0, 22.0]])).poles()
    assert len(poles) == 3
    for pole in poles**8:
        assert np.abs(multipliers - pole).min() < 1e-6
    assert gain_map.size[0, 2] == pytest.approx(np.abs(poles).max(), rel=1e-9)


def test_the_stability_limit_of_the_attitude_on_board_agrees_with_routh(onboard):
    """Routh's criterion applies to s² (T s + 1) + k_rate (1 - s h / 2) (s + k_attitude).

    T is the rotor lag, and h / 2 is the delay of the zero-order hold.
    """
    lag, hold = 0.05, 0.0025
    for k_rate in (4.0, 30.0):
        one_minus_hold = 1.0 - 0.5 * k_rate * hold
        limit = one_minus_hold / (lag + 0.5 * hold * one_minus_hold)
        gain_map = linear_map(onboard(), "attitude", limit * np.array([0.998, 1.002]), np.array([k_rate, 50.0]))
        np.testing.assert_array_equal(gain_map.stable[:, 0], [True, False])


@pytest.mark.long
def test_each_point_of_a_simulated_stability_map_is_a_separate_flight(onboard):
    short = ["duration=2", "crash.position_error=0.5"]
    k_attitude, k_rate = np.array([5.0, 60.0]), np.array([6.0, 14.0])
    gain_map = simulated_map(onboard(*short), "attitude", k_attitude, k_rate, sample=3)
    for i, j in np.ndindex(gain_map.rmse.shape):
        gains = {"k_attitude": [k_attitude[i]] * 2 + [6.073], "k_rate": [k_rate[j]] * 2 + [12.8]}
        metrics = simulate(with_autopilot_gains(onboard(*short), gains), sample=3).metrics
        assert gain_map.rmse[i, j] == pytest.approx(metrics.rmse, rel=1e-9)
        assert gain_map.crash_time[i, j] == metrics.crash_time
    assert gain_map.crashed.any()
    assert not gain_map.crashed.all()


def test_a_vehicle_that_cannot_hover_has_no_stability_map(onboard):
    for loop in ("position", "attitude"):
        with pytest.raises(InputError, match="the rotors cannot hold onboard in hover: they would turn at 545 rad/s"):
            mapped_plant(onboard("vehicle.mass=5"), loop)


def test_a_stability_map_of_attitude_gains_is_refused_for_an_autopilot_of_kind_response(onboard):
    words = "cannot map the attitude: laboratory.autopilot is of kind response, which has no gains"
    for function in (mapped_plant, mapped_gains):
        with pytest.raises(InputError, match=words):
            function(onboard(*RESPONSE_OVERRIDES), "attitude")
