"""Tests of policies that are functions in plain Python."""

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, run_monte_carlo, simulate
from drake_quad.gym import FunctionPolicy, QuadrotorVectorEnv

OBSERVATION = {"signals": ["position_error", "velocity_error"]}
# Matrix of a linear policy, from the errors of position and velocity to an acceleration.
GAINS = np.hstack([np.diag([0.3, 0.25, 0.4]), np.diag([0.4, 0.35, 0.5])])


def task():
    return QuadrotorVectorEnv("laboratory:low_wind", {"duration": 1.0}, observation=OBSERVATION).scenario


def act(observation):
    assert observation.dtype == np.float32
    return np.tanh(observation @ GAINS.T)


def make_policy(num_vehicles):
    return FunctionPolicy(task(), act, num_vehicles)


@pytest.mark.long
def test_a_function_policy_has_the_same_flights_in_environments_and_studies():
    scenario = task()
    envs = QuadrotorVectorEnv(scenario, num_envs=3)
    observations, _ = envs.reset(seed=0)
    for _ in range(50):
        observations, *_, infos = envs.step(act(observations))
    expected = infos["flight"]["rmse"]
    for compiled in (False, True):
        flight = simulate(scenario, policy=FunctionPolicy(scenario, act), compiled=compiled)
        np.testing.assert_allclose(flight.metrics.rmse, expected[0], rtol=1e-6)
        np.testing.assert_allclose(flight["action"], act(flight["observation"].astype(np.float32)), rtol=1e-6)
    study = run_monte_carlo(scenario, 5, num_workers=1, batch_size=3, policy=make_policy)
    single = simulate(scenario, sample=4, policy=FunctionPolicy(scenario, act))
    np.testing.assert_allclose(study.metrics.rmse[[0, 4]], [expected[0], single.metrics.rmse], rtol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize(
    "action",
    [
        *(np.zeros((1, 4)), np.zeros(3), [["a", 0.0, 0.0]], np.full((1, 4), np.nan)),
        *(np.full((1, 3), 1j), np.full((1, 3), "0.1"), np.full((1, 3), 2e6)),
    ],
    ids=["rows", "flat", "a", "rows of nan", "complex", "text", "huge"],
)
def test_actions_of_wrong_shape_or_type_are_refused(action):
    scenario = task()
    with pytest.raises(
        InputError,
        match=r"the policy must return an array \(1, 3\) of numbers .* at most 1,000,000, but returned .* at 0.00",
    ):
        simulate(scenario, policy=FunctionPolicy(scenario, lambda _: action))
    with pytest.raises(InputError, match="hover must be of kind policy"):
        FunctionPolicy(load_scenario("hover"), act)


@pytest.mark.long
@pytest.mark.parametrize(("value", "word"), [(np.nan, "nan"), (-np.inf, "infinite")])
@pytest.mark.parametrize(("kind", "rows"), [("acceleration", 3), ("attitude", 4), ("rates", 4), ("rotor_speeds", 4)])
def test_an_action_that_is_not_finite_ends_the_flight_at_its_tick(kind, rows, value, word):
    scenario = QuadrotorVectorEnv("figure_eight", {"duration": 0.4}, action=kind, observation=OBSERVATION).scenario
    for compiled in (False, True):
        num_calls = 0

        def act_until_failure(observation):
            nonlocal num_calls
            num_calls += 1
            action = np.zeros((len(observation), rows))
            action[:, 1] = value if num_calls > 10 else 0.0
            return action

        flight = simulate(scenario, policy=FunctionPolicy(scenario, act_until_failure), compiled=compiled)
        assert flight.metrics.crash_time == pytest.approx(0.2)
        assert flight.cause == f"policy returned {word} in row 2 of `action` at 0.20 s"
