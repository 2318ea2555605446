"""Tests of the default reward of environments."""

import numpy as np
import pytest

from drake_quad.gym.rewards import TrackingReward, Transition, has_crashed
from drake_quad.signals import Reference, State


def step(error=0.0, action=0.0, last_action=0.0, crashed=False, obstacle_hit=0):
    """Return a transition of one vehicle with four actions."""
    state = State(*np.zeros((12, 1)))
    reference = Reference(*np.zeros((11, 1)))._replace(x=np.array([error]))
    return Transition(
        np.zeros((1, 3)), np.full((1, 4), action), np.full((1, 4), last_action), state, reference, np.zeros(1),
        np.array([crashed]), np.array([obstacle_hit]), {}, {}, {},
    )  # fmt: skip


def test_errors_of_decimetres_and_crashes_dominate_the_default_reward():
    """Actions of magnitude 1 cost little compared with the reward of 1 for exact tracking. A crash costs 10."""
    reward = TrackingReward()
    assert reward(step()) == 1.0
    assert reward(step(error=0.3)) == pytest.approx(np.exp(-1.0))
    assert reward(step(action=1.0, last_action=1.0)) == pytest.approx(1.0 - 4 * 0.01)
    assert reward(step(action=0.0, last_action=1.0)) == pytest.approx(1.0 - 4 * 0.05)
    assert reward(step(crashed=True)) == pytest.approx(-9.0)
    # A crash into an obstacle has no additional cost by default.
    assert reward(step(crashed=True, obstacle_hit=1)) == pytest.approx(-9.0)
    assert TrackingReward(obstacle=2.0)(step(crashed=True, obstacle_hit=1)) == pytest.approx(-11.0)
    assert has_crashed(step(crashed=True)).tolist() == [True]
    assert has_crashed(step()).tolist() == [False]


def test_a_tracking_reward_accepts_a_length_below_one_metre():
    assert TrackingReward(length=0.01)(step(error=0.01)) == pytest.approx(np.exp(-1.0))


def test_rewards_with_metrics_can_be_elements_of_sets():
    assert len({TrackingReward(metrics={"peak_error": 1.0}), TrackingReward(metrics={"peak_error": 1.0})}) == 1
