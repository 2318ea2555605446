"""Tests of the margins of any controller at the command link, by comparison with designs and with flights."""

import functools
import itertools

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.assembly.control import build_control, control_recipes
from drake_quad.design.cascade import design_cascade, with_gains
from drake_quad.flight.mission import plan_route
from drake_quad.linear.closed_loop import closed_loop, loop_with_injection
from drake_quad.linear.link_margins import fast_link_margins, joint_disk_margin, link_loops, link_margins
from drake_quad.linear.step_response import initial_response
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.controls.mpc import MpcControl
from drake_quad.scenario.hovering import at_rest, nominal_hover
from drake_quad.signals import AttitudeTarget, Wrench

pytestmark = pytest.mark.slow
TICK = 0.02  # s


@pytest.fixture(scope="module")
def laboratory(diagrams):
    def load(controller=None, *overrides):
        layers = [f"{diagrams}/controllers/{controller}"] if controller else []
        return load_scenario(f"{diagrams}/laboratory.yaml:nominal", overrides, layers=layers)

    return load


@pytest.fixture(scope="module")
def asymmetric_lqg(asymmetric):
    return asymmetric("lqg", "laboratory.wind=[]", "laboratory.motion_capture.dropout_rate=0")


def displacement_grows(scenario, row, duration):
    """Return whether a small displacement of the simulated diagram grows after the fast modes have decayed."""
    response = initial_response(closed_loop(scenario), {row: 1e-6}, duration=duration)
    column = ("x", "y", "z", "roll", "pitch", "yaw").index(row)
    _, _, third, last = [part.max() for part in np.array_split(np.abs(response.nonlinear[:, column]), 4)]
    return last > third


@pytest.mark.long
def test_thrust_and_yaw_loops_have_their_designed_margins(laboratory):
    """A design breaks the loop at the commanded acceleration, which the command link carries for thrust and yaw."""
    scenario = laboratory()
    designed = design_cascade(scenario)
    margins_by_signal = link_margins(with_gains(nominal_hover(scenario), designed.gains()))
    for name, axis in (("thrust", "z"), ("tau_z", "yaw")):
        np.testing.assert_allclose(margins_by_signal[name], designed.loops[axis].margins, rtol=1e-4)


@pytest.mark.long
def test_the_joint_disk_margin_of_decoupled_loops_is_the_smallest_disk_margin_of_a_single_loop(laboratory):
    scenario = nominal_hover(laboratory())
    smallest = min(margins.disk for margins in link_margins(scenario).values())
    assert joint_disk_margin(scenario).disk == pytest.approx(smallest, rel=2e-3)


@pytest.mark.long
def test_the_joint_disk_margin_is_at_most_that_of_each_loop_and_its_gain_changes_keep_the_loop_stable(asymmetric_lqg):
    joint = joint_disk_margin(asymmetric_lqg)
    assert joint.disk <= 1.001 * min(margins.disk for margins in link_margins(asymmetric_lqg).values())
    factor = 10.0 ** (0.99 * joint.gain / 20.0)
    loop = loop_with_injection(asymmetric_lqg).system
    rows = range(4)
    loop = loop.between([f"injection.{row}" for row in rows], [f"injected.{row}" for row in rows])
    for signs in itertools.product((-1.0, 1.0), repeat=4):
        # The control sends C x. An offset of (f - 1) C x multiplies it by the gain f.
        closed = loop.A + loop.B @ np.diag(factor ** np.array(signs) - 1.0) @ loop.C
        assert np.abs(np.linalg.eigvals(closed)).max() < 1.0


def test_the_margins_at_the_command_link_of_an_autopilot_are_those_of_the_position_loops(diagrams):
    """The link transmits roll and pitch angles, which the position loops command. The yaw is controlled on board."""
    scenario = load_scenario(f"{diagrams}/onboard.yaml")
    designed = design_cascade(scenario)
    margins_by_signal = link_margins(with_gains(nominal_hover(scenario), designed.gains()))
    assert [*margins_by_signal] == [*AttitudeTarget._fields[:4]]
    assert margins_by_signal["yaw"] is None
    # The feedforward body rates depend only on the reference, so they do not affect the loops.
    np.testing.assert_allclose(margins_by_signal["pitch"], designed.loops["x"].margins, rtol=1e-3)
    np.testing.assert_allclose(margins_by_signal["roll"], designed.loops["y"].margins, rtol=1e-3)


@pytest.mark.long
@pytest.mark.parametrize("replaced_part", ["control", "position_controller"])
def test_a_user_s_control_has_the_margins_of_the_same_control_in_a_scenario(laboratory, replaced_part):
    """The gains of the replaced control have no influence."""
    scenario = laboratory("paper.yaml:pd")
    batch = Batch.draw(scenario, [0])
    control = build_control(scenario, control_recipes(batch, plan_route(scenario)), 1)
    gains = ["control.position.k_p=[1, 1, 5]"]
    if replaced_part == "control":
        gains.append("control.attitude.k_p=[25, 25, 6]")
    margins_by_signal, expected = (
        link_margins(laboratory("paper.yaml:pd", *gains), **{replaced_part: control}),
        link_margins(scenario),
    )
    assert [*margins_by_signal] == [*Wrench._fields]
    for name in Wrench._fields:
        np.testing.assert_allclose(margins_by_signal[name], expected[name], rtol=1e-6)


@pytest.mark.long
def test_a_loop_transfer_function_with_unit_feedback_has_poles_of_the_whole_closed_loop(asymmetric_lqg):
    """The slow poles of each loop of `link_loops` are compared with those of `closed_loop`."""
    scenario = asymmetric_lqg
    poles = closed_loop(scenario).system.poles()
    for loop in link_loops(scenario).values():
        closed = loop.with_feedback(np.eye(1)).poles()
        slow = closed[np.abs(closed) > 0.7]
        assert len(slow) > 4
        assert all(np.abs(poles - pole).min() < 1e-5 for pole in slow)


CONTROLLER_FILES = ("lqg.yaml:lqg", "paper.yaml:pd")


@pytest.fixture(scope="module")
def margins_of(laboratory):
    return functools.cache(lambda controller: link_margins(laboratory(controller)))


@pytest.mark.long
def test_model_predictive_control_has_the_margins_of_its_regulator(laboratory, margins_of):
    """In hover no limit is active, with or without a corridor."""
    lqg = laboratory("lqg.yaml:lqg")
    corridor = {"kind": "tube", "half_width": (0.02, 0.02, 0.02)}
    mpc = MpcControl(**dict(lqg.control) | {"kind": "mpc", "corridor": corridor})
    margins_by_signal = link_margins(lqg.model_copy(update={"control": mpc}))
    for name, expected in margins_of("lqg.yaml:lqg").items():
        np.testing.assert_allclose(margins_by_signal[name], expected, rtol=1e-6)


@pytest.mark.parametrize("controller", CONTROLLER_FILES)
def test_fast_link_margins_agrees_with_link_margins(laboratory, margins_of, controller):
    fast = fast_link_margins(laboratory(controller))
    exact = [*margins_of(controller).values()]
    np.testing.assert_allclose(fast.sensitivity, [margins.sensitivity for margins in exact], rtol=2e-5)
    np.testing.assert_allclose(fast.delay, [margins.delay for margins in exact], rtol=2e-4)


def test_fast_link_margins_is_accurate_for_a_crossover_below_half_a_radian_per_second(laboratory):
    """The height loop has its crossover at 0.4 rad/s."""
    scenario = laboratory("paper.yaml:pd", "control.position={k_p: [1.6, 1.6, 0.05], k_d: [1.9, 1.9, 0.4]}")
    exact = link_margins(scenario)["thrust"]
    fast = fast_link_margins(scenario)
    assert 0.3 < exact.crossover < 0.5
    assert fast.sensitivity[0] == pytest.approx(exact.sensitivity, rel=2e-5)
    assert fast.delay[0] == pytest.approx(exact.delay, rel=2e-4)


@pytest.mark.long
@pytest.mark.parametrize("controller", CONTROLLER_FILES)
def test_flights_diverge_at_the_delay_margin_within_a_tick(laboratory, margins_of, controller):
    margins_by_signal = margins_of(controller)
    ticks = int(min(margins.delay for margins in margins_by_signal.values()) / TICK)
    assert ticks >= 2
    for extra_ticks, diverges in ((ticks, False), (ticks + 1, True)):
        scenario = at_rest(laboratory(controller, f"laboratory.command_link.delay_ticks={1 + extra_ticks}"))
        assert any(displacement_grows(scenario, row, 12.0) for row in ("y", "z", "yaw")) == diverges


@pytest.mark.long
@pytest.mark.parametrize(
    ("controller", "signal", "side"),
    [
        ("lqg.yaml:lqg", "tau_x", "gain"),
        ("lqg.yaml:lqg", "tau_y", "gain_reduction"),
        ("paper.yaml:pd", "tau_y", "gain"),
        ("paper.yaml:pd", "tau_x", "gain_reduction"),
    ],
)
def test_flights_diverge_at_the_gain_margin_within_two_percent(laboratory, margins_of, controller, signal, side):
    """Dividing a moment of inertia by a factor increases the gain by this factor.

    No rigid body has these moments of inertia, so the scenario is changed after its validation.
    """
    sign = 1.0 if side == "gain" else -1.0
    limit = 10.0 ** (sign * getattr(margins_of(controller)[signal], side) / 20.0)

    def diverges(factor):
        inertia = {"tau_x": 0.007, "tau_y": 0.007, "tau_z": 0.012}
        inertia[signal] /= factor
        scenario = laboratory(controller)
        vehicle = scenario.vehicle.model_copy(update={"inertia": tuple(inertia.values())})
        scenario = scenario.model_copy(update={"vehicle": vehicle})
        return displacement_grows(at_rest(scenario), {"tau_x": "roll", "tau_y": "pitch"}[signal], 16.0)

    assert not diverges(limit * (1.0 - 0.02 * sign))
    assert diverges(limit * (1.0 + 0.02 * sign))


def test_margins_of_an_unstable_loop_and_transfer_functions_of_a_periodic_loop_are_refused(laboratory):
    with pytest.raises(InputError, match="the loop of nominal is unstable in hover .its largest pole has magnitude 1"):
        link_margins(laboratory("lqg.yaml:lqg", "laboratory.command_link.delay_ticks=6"))
    with pytest.raises(InputError, match=r"has no transfer function, since some of its periods are longer than 0.02 s"):
        link_loops(laboratory(None, "laboratory.motion_capture.period=0.04"))
