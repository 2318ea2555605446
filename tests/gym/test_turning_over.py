"""Tests of environments whose vehicles turn over."""

import numpy as np
import pytest
from tumbling import degrees_apart, rotations

from drake_quad import simulate
from drake_quad.gym import QuadrotorVectorEnv
from drake_quad.gym.rollout import action_source

pytestmark = pytest.mark.slow

# Yaw rates of the vehicles, rad/s. The first vehicle flips in a plane. The other vehicles pass a pitch of 90° at
# increasing distances.
YAW_RATES = np.array([0.0, 1e-9, 1e-3, 0.02, 0.05, 0.1, 0.3, 1.0])
FLIP_RATE = 6.0  # rad/s
NUM_TICKS = 40  # ticks of a flight
TASK_OVERRIDES = {
    "crash": {"tilt": None, "position_error": 1000.0, "height": -1000.0},
    "laboratory.motion_capture.derivative_bandwidth": 400.0,
    "duration": 0.02 * NUM_TICKS,
}


def actions():
    """Return actions (ticks, N, 4) that command a pitch rate of 6 rad/s for 0.6 s, and then zero."""
    commands = np.zeros((NUM_TICKS, len(YAW_RATES), 4))
    commands[:30, :, 2], commands[:30, :, 3] = FLIP_RATE / 10.0, YAW_RATES / 10.0
    return commands


def fly_flips(time_step):
    """Fly the flips in an environment with a given integration time step (s).

    Returns:
        The environment, the observations, and the transitions.
    """
    steps = []
    envs = QuadrotorVectorEnv(
        "figure_eight",
        {**TASK_OVERRIDES, "vehicle.time_step": time_step},
        num_envs=len(YAW_RATES),
        action={"kind": "rates", "max_rates": (10.0, 10.0, 10.0)},
        observation={"signals": ["rotation", "body_rates", "attitude"]},
        signals=["measurement"],
        reward=lambda step: steps.append(step) or step.time,
    )
    envs.reset(seed=0)
    observations = [envs.step(action)[0] for action in actions()]
    return envs, np.array(observations), steps


def states(steps, name="state"):
    """Return a signal with 12 components from the transitions of a flight, as an array (ticks, N, 12)."""
    return np.array([np.array(step.state if name == "state" else step.signals[name]).T for step in steps])


@pytest.fixture(scope="module")
def flips():
    return fly_flips(0.01)


@pytest.mark.long
def test_a_flip_is_the_same_with_an_eighth_of_the_default_time_step(flips):
    _, _, steps = flips
    _, _, finer = fly_flips(0.00125)
    coarse, fine = states(steps), states(finer)
    assert np.cos(coarse[-1, :, 3]).max() < -0.5, "all vehicles must have turned over"
    for one, other in zip(coarse, fine, strict=True):
        assert degrees_apart(one[:, 3:6], rotations(other[:, 3:6])).max() < 1e-3


def test_observations_of_a_flip_are_its_rotation_and_body_rates(flips):
    """The derivative filter is fast, so measured and true rates differ little while the rates are nearly constant."""
    _, observations, steps = flips
    truth, measured = states(steps), states(steps, "measurement")
    frame = states(steps, "measurement")[:, :, 3:6]
    matrices = rotations(frame.reshape(-1, 3)).as_matrix().reshape(NUM_TICKS, -1, 9)
    np.testing.assert_allclose(observations[:, :, :9], matrices, atol=1e-6)
    np.testing.assert_allclose(observations[:, :, 9:12], measured[:, :, 9:12], atol=1e-6)
    steady = slice(22, 30)
    assert np.abs(truth[steady, :, 10]).min() > 5.7
    assert np.abs(truth[steady, :, 4]).max() > np.radians(85.0)
    np.testing.assert_allclose(measured[steady, :, 9:12], truth[steady, :, 9:12], atol=0.12)


def test_the_environment_and_the_diagram_give_the_same_flip(flips):
    envs, _, steps = flips
    for vehicle in (0, 4):
        source = action_source(actions()[:, vehicle], 0.02)
        flight = simulate(envs.scenario, seed=vehicle, sample=0, policy=source, plan=envs.plan)
        actual = states(steps)[: len(flight.time) - 1, vehicle]
        np.testing.assert_allclose(actual, flight["state"][1:], rtol=0.0, atol=1e-9)
