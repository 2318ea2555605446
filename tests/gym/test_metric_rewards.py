"""Tests of rewards that contain metrics and requirements of a scenario."""

import copy

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from drake_quad import InputError, flight_metric, metric
from drake_quad.gym import QuadrotorEnv, QuadrotorVectorEnv, TrackingReward

ADDITIONAL_METRICS = {"largest_tilt": {"kind": "max", "of": "tilt"}, "time_in_tube": {"radius": 0.05}}
REQUIREMENTS = {
    "near": {"always": {"signal": "position_error", "below": 0.1}, "after": 0.2},
    "tilts": {"eventually": {"signal": "tilt", "above": 0.1}},
}
METRIC_WEIGHTS = {
    "largest_tilt": -2.0,
    "time_in_tube": 0.5,
    "near": 3.0,
    "tilts": 1.0,
    "rmse": -1.0,
    "mean_height": 1.5,
}


@pytest.fixture
def user_metrics():
    """Register two user-defined metrics."""

    @metric("m", over_time="mean")
    def mean_height(state):
        """Mean height."""
        return state.z

    @flight_metric("m")
    def last_height(flight):
        """Height at the end."""
        return flight["state"][-1, 2]


def task(additional=ADDITIONAL_METRICS, **options):
    """Return an environment of vehicles that crash or end after at most one second."""
    overrides = {
        "duration": 1.0,
        "metrics": {"start": 0.1, "additional": additional},
        "requirements": REQUIREMENTS,
        "crash.position_error": 0.3,
    }
    return QuadrotorVectorEnv("robustness", overrides, num_envs=6, action="rates", **options)


def zero_reward(step):
    """Return a reward of zero for each vehicle."""
    return 0.0 * step.time


@pytest.mark.long
@pytest.mark.usefixtures("user_metrics")
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_the_rewards_of_an_episode_add_up_to_the_weighted_metrics_of_its_flight(mode):
    """The metrics include user-defined ones and requirements. Later episodes of a vehicle are checked as well."""
    reward = TrackingReward(tracking=0.0, effort=0.0, variation=0.0, crash=0.0, metrics=METRIC_WEIGHTS)
    envs = task({**ADDITIONAL_METRICS, "mean_height": {}}, reward=reward, autoreset_mode=mode)
    envs.reset(seed=3)
    actions, total, episodes, crashes = np.random.default_rng(0), np.zeros(6), 0, 0
    for _ in range(220):
        _, rewards, terminations, truncations, infos = envs.step(actions.uniform(-0.5, 0.5, (6, 4)))
        total += rewards
        over = terminations | truncations
        for i in np.flatnonzero(over).tolist():
            metrics = {name: np.nan_to_num(infos["flight"][name][i]) for name in METRIC_WEIGHTS}
            assert total[i] == pytest.approx(sum(weight * metrics[name] for name, weight in METRIC_WEIGHTS.items()))
            assert metrics["largest_tilt"] > 0.0
            episodes, crashes = episodes + 1, crashes + int(terminations[i])
        total[over] = 0.0
    assert episodes > 12
    assert crashes > 0


@pytest.mark.long
def test_a_reward_function_reads_metrics_that_are_requested_by_name():
    transitions = []
    envs = task(reward=lambda step: transitions.append(step) or zero_reward(step), metrics=["largest_tilt", "near"])
    envs.reset(seed=1)
    copies = []
    for _ in range(15):
        envs.step(np.full((6, 4), 0.1))
        copies.append(copy.deepcopy(transitions[-1].metrics))
    # The metric window starts at 0.1 s, and the time window of the requirement at 0.2 s. A tick lasts 0.02 s.
    assert [np.isnan(each["largest_tilt"]).all() for each in copies] == [True] * 4 + [False] * 11
    assert [np.isnan(each["near"]).all() for each in copies] == [True] * 9 + [False] * 6
    tilts = [np.arccos(np.cos(each.state.roll) * np.cos(each.state.pitch)) for each in transitions[4:]]
    np.testing.assert_allclose([each["largest_tilt"] for each in copies[4:]], np.maximum.accumulate(tilts), atol=1e-7)
    for transition, values in zip(transitions, copies, strict=True):
        np.testing.assert_equal(transition.metrics, values)  # later steps do not change them


@pytest.mark.usefixtures("user_metrics")
def test_a_single_environment_computes_metrics_that_need_a_recorded_flight():
    env = QuadrotorEnv("hover", {"duration": 0.2, "metrics.additional.last_height": {}})
    env.reset(seed=0)
    over = False
    while not over:
        _, _, _, over, info = env.step(np.array([0.1, 0.0, 0.3]))
    assert info["flight"]["last_height"] == pytest.approx(env.flight()["state"][-1, 2], rel=1e-9)
    assert info["flight"]["last_height"] == pytest.approx(env.flight().metrics.last_height, rel=1e-12)


@pytest.mark.usefixtures("user_metrics")
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: task({"last_height": {}}),
            "last_height in metrics.additional is computed from a recorded flight; create the environment with"
            " record=True",
        ),
        (
            lambda: task({"last_height": {}}, record=True, metrics=["last_height"]),
            "the metric last_height is computed from a recorded flight, so it is not available during the flight",
        ),
        (lambda: task(metrics=["largest_tild"]), "there is no metric called 'largest_tild'; did you mean largest_tilt"),
        (
            lambda: task(reward=TrackingReward(metrics={"effort_x": -1.0})),
            "the metric effort_x is not available in this environment, which has no acceleration_command",
        ),
        (lambda: task(metrics="rmse"), "metrics is 'rmse', but must be a list of names"),
        (lambda: TrackingReward(metrics={"rmse": np.nan}), "metrics.rmse is nan, but must be a finite number"),
        (lambda: TrackingReward(metrics={"rmse": "x"}), "metrics.rmse is 'x', but must be a finite number"),
        (lambda: TrackingReward(metrics=["rmse"]), r"metrics is \['rmse'\], but must be a mapping from names"),
    ],
)
def test_metrics_that_cannot_be_part_of_a_reward_are_refused(make, message):
    with pytest.raises(InputError, match=message):
        make()


@pytest.mark.long
def test_an_infinite_metric_can_be_read_but_cannot_be_part_of_the_reward():
    """A settling time is infinite until the vehicle has settled."""
    settling = {"settling_time": {"radius": 1e-9}}
    transitions = []
    read = task(settling, reward=lambda step: transitions.append(step) or zero_reward(step), metrics=["settling_time"])
    rewarded = task(settling, reward=TrackingReward(metrics={"settling_time": -1.0}))
    for envs in (read, rewarded):
        envs.reset(seed=0)
        for _ in range(4):
            envs.step(np.zeros((6, 4)))
    read.step(np.zeros((6, 4)))
    assert np.isinf(transitions[-1].metrics["settling_time"]).all()
    with pytest.raises(InputError, match="the metric settling_time can be infinite during a flight"):
        rewarded.step(np.zeros((6, 4)))
