"""Tests of responses that start at a displacement from the equilibrium: number of ticks and initial values."""

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.linear.closed_loop import closed_loop
from drake_quad.linear.step_response import initial_response
from drake_quad.scenario.hovering import nominal_hover


@pytest.fixture(scope="module")
def loop():
    return closed_loop(nominal_hover(load_scenario("diagrams/laboratory.yaml:nominal")))


@pytest.mark.parametrize(("duration", "ticks"), [(0.0, 1), (0.1, 6), (0.5, 26)])
def test_a_response_has_a_tick_at_its_start_and_at_its_end(loop, duration, ticks):
    response = initial_response(loop, {"x": 1e-4}, duration=duration)
    np.testing.assert_allclose(response.time, 0.02 * np.arange(ticks), atol=1e-12)
    assert response.linear.shape == response.nonlinear.shape == (ticks, 12)


def test_a_response_starts_at_the_displacement_given_for_each_state_component(loop):
    offset = {"y": 1e-3, "yaw": -2e-3, "v_z": 3e-3, "q": 4e-3}
    response = initial_response(loop, offset, duration=0.02)
    expected = np.zeros(12)
    expected[[1, 5, 8, 10]] = 1e-3, -2e-3, 3e-3, 4e-3
    np.testing.assert_allclose(response.linear[0], expected, atol=1e-15)
    np.testing.assert_allclose(response.nonlinear[0], expected, atol=1e-15)
    # After one tick, the height has changed by approximately the climb rate times the tick.
    assert response.linear[1, 2] == pytest.approx(0.02 * 3e-3, rel=0.1)
    assert response.nonlinear[1, 2] == pytest.approx(response.linear[1, 2], rel=1e-3)


def test_computing_a_response_does_not_change_the_loop(loop):
    before = loop.context.get_time()
    first = initial_response(loop, {"z": 1e-3}, duration=0.2)
    assert loop.context.get_time() == before
    np.testing.assert_array_equal(initial_response(loop, {"z": 1e-3}, duration=0.2).nonlinear, first.nonlinear)
