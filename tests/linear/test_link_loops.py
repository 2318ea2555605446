"""Tests of the loops at the command link, by comparison with designed loops and with whole diagrams."""

from dataclasses import replace

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.design.cascade import attitude_plant
from drake_quad.design.gains import AxisPdGains, pd_loop
from drake_quad.linear.closed_loop import closed_loop, laboratory_plant
from drake_quad.linear.link_margins import link_loops
from drake_quad.linear.margins import frequencies, margins
from drake_quad.scenario.hovering import nominal_hover

ASYMMETRIC_OVERRIDES = [
    "nominal.mass=0.75",
    "nominal.inertia=[0.0065, 0.0085, 0.0126]",
    "control.position={k_p: [2.2, 2.6, 6.0], k_d: [1.6, 1.8, 3.7]}",
    "control.attitude={k_p: [12.5, 13.5, 5.2], k_d: [5.1, 5.6, 3.4]}",
]
OBSERVER_OVERRIDE = (
    "control.position={kind: disturbance_observer, k_p: [1.8, 2.0, 5.0], k_d: [1.9, 2.1, 3.7], feed_forward: snap,"
    " position_noise: 0.001, deviation: [0.05, 0.06, 0.04], time_constant: [1.0, 1.2, 1.4],"
    " response: {kind: tilt, lag: 0.06}}"
)


@pytest.fixture(scope="module")
def load_with_gains(diagrams):
    layers = [diagrams / "gains" / "laboratory.yaml"]
    return lambda *overrides: load_scenario(diagrams / "laboratory.yaml:nominal", overrides, layers=layers)


def loop_of_the_torque(laboratory, scenario, axis, outer, inner):
    """Return the expected torque loop: a PD controller of the tilt inside a PD controller of the position, eq (7)."""
    torque, tilt, rate, inertia, sign = {
        "x": ("tau_y", "pitch", "q", 0.0085, 1.0),
        "y": ("tau_x", "roll", "p", 0.0065, -1.0),
    }[axis]
    rows = [f"measurement.{name}" for name in (tilt, rate, axis, f"v_{axis}")]
    plant = laboratory.system.between([f"wrench.{torque}"], rows)
    k_p, k_d = (sign * gain / laboratory.specific_thrust for gain in outer)
    gains = inertia * np.array([[inner.k_p, inner.k_d, inner.k_p * k_p, inner.k_p * k_d]])
    return replace(plant, C=gains @ plant.C, D=gains @ plant.D, outputs=("loop",))


def link_loop(scenario, row):
    """Return the loop of a component of the command, with the nominal vehicle."""
    return link_loops(nominal_hover(scenario))[row]


def responses(loop):
    return loop.response(np.exp(1j * frequencies(loop.period, points=50) * loop.period)).ravel()


@pytest.mark.slow
def test_torque_loops_contain_attitude_and_position_and_the_thrust_loop_contains_the_height(load_with_gains):
    scenario = load_with_gains(*ASYMMETRIC_OVERRIDES)
    laboratory = laboratory_plant(scenario)
    position, attitude = scenario.control.position, scenario.control.attitude
    loops = link_loops(nominal_hover(scenario))
    for row, axis, i, tilt in (("tau_y", "x", 0, 1), ("tau_x", "y", 1, 0)):
        outer = AxisPdGains(position.k_p[i], position.k_d[i])
        expected = loop_of_the_torque(
            laboratory, scenario, axis, outer, AxisPdGains(attitude.k_p[tilt], attitude.k_d[tilt])
        )
        np.testing.assert_allclose(responses(loops[row]), responses(expected), rtol=1e-6)
    expected = pd_loop(attitude_plant(laboratory, scenario, "z"), AxisPdGains(6.0, 3.7))
    np.testing.assert_allclose(responses(loops["thrust"]), responses(expected), rtol=1e-6)


@pytest.mark.slow
def test_the_closed_loop_has_the_poles_of_the_diagram_with_an_estimator(load_with_gains):
    scenario = load_with_gains(*ASYMMETRIC_OVERRIDES, OBSERVER_OVERRIDE)
    multipliers = closed_loop(nominal_hover(scenario)).system.poles()
    loop = link_loop(scenario, "tau_y")
    poles = loop.with_feedback(np.eye(1)).poles()
    for pole in poles[np.abs(poles) > 0.1]:
        assert np.abs(multipliers - pole).min() < 1e-6


@pytest.mark.slow
def test_the_loop_becomes_unstable_at_the_delay_margin(load_with_gains):
    """The loop is stable with the largest number of delay ticks below the margin, and unstable with one more."""
    scenario = load_with_gains(*ASYMMETRIC_OVERRIDES, OBSERVER_OVERRIDE)
    loop = link_loop(scenario, "tau_x")
    ticks = int(margins(loop).delay / loop.period)
    assert ticks >= 3

    def largest_pole(extra_ticks):
        """Return the largest magnitude of a pole, with additional ticks of delay."""
        delayed = load_with_gains(
            *ASYMMETRIC_OVERRIDES, OBSERVER_OVERRIDE, f"laboratory.command_link.delay_ticks={1 + extra_ticks}"
        )
        return np.abs(closed_loop(nominal_hover(delayed)).system.poles()).max()

    assert largest_pole(ticks) < 1.0 < largest_pole(ticks + 1)


# Largest allowed peak sensitivity of each designed controller at the command link.
SENSITIVITY_LIMITS = {f"laboratory.yaml:{name}": 2.215 for name in ("pd", "pid", "disturbance_observer", "l1", "indi")}
SENSITIVITY_LIMITS |= {"priced.yaml:indi@3": 3.015}


@pytest.mark.long
@pytest.mark.parametrize("name", SENSITIVITY_LIMITS)
def test_the_shipped_controllers_meet_the_limits_on_sensitivity_and_delay(diagrams, name):
    """Sensitivity peak and delay margin are within their limits, on a lateral axis and on the vertical axis."""
    layers = [diagrams / "controllers" / "designed" / name]
    scenario = load_scenario(diagrams / "laboratory.yaml:nominal", layers=layers)
    sensitivity, delay = SENSITIVITY_LIMITS[name], 0.05
    loops = link_loops(nominal_hover(scenario))
    for row in ("tau_y", "thrust"):
        loop = loops[row]
        achieved = margins(loop)
        assert np.abs(loop.with_feedback(np.eye(1)).poles()).max() < 1.0
        assert achieved.sensitivity < sensitivity
        assert achieved.delay > delay
