"""Tests of the vector environment: its Gymnasium interface, and the flights of its vehicles."""

import copy
import itertools

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env, data_equivalence
from gymnasium.utils.env_match import check_environments_match
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as wrappers

from drake_quad import InputError, load_scenario, simulate
from drake_quad.gym import QuadrotorEnv, QuadrotorVectorEnv, TrackingReward
from drake_quad.gym.rollout import action_source
from drake_quad.laboratory.metrics import Metrics

# A task in which observations and actions differ between vehicles, and many vehicles crash early.
TASK = {
    "scenario": "robustness",
    "overrides": {"duration": 1.5, "control": load_scenario("laboratory:low_wind").control},
}
ACTION_TYPES = ("acceleration", "attitude", "rates", "rotor_speeds")


def envs_of(n, **options):
    return QuadrotorVectorEnv(**TASK, num_envs=n, **{"action": "rates", **options})


def flown_with(**functions):
    envs = envs_of(2, **functions)
    return rollout(envs, [np.zeros((2, 4))], 0)


def random_actions(envs, seed, steps, size=0.5):
    shape = steps, envs.num_envs, envs.single_action_space.shape[0]
    return np.random.default_rng(seed).uniform(-size, size, shape)


def rollout(envs, actions, seed):
    """Return the results of a reset and of one step with each of the actions."""
    observed, infos = envs.reset(seed=seed)
    steps = [(observed, infos)]
    for action in actions:
        steps.append(envs.step(action))
    return steps


def columns(steps, index):
    return np.array([step[index] for step in steps])


@pytest.mark.long
@pytest.mark.parametrize("action", ACTION_TYPES)
def test_each_vehicle_flies_as_in_the_simulator_of_drake(action):
    """State and reference agree within 1e-9 at every tick of every episode, and observations within 1e-6."""
    observation = {
        "signals": ["position_error", "velocity_error", "rotation", "body_rates", "action", "wind"],
        "history": 2,
    }
    transitions = []
    envs = envs_of(
        9,
        action=action,
        observation=observation,
        signals=["rotor_speed"],
        reward=lambda step: transitions.append(step) or step.time,
    )
    actions = random_actions(envs, 3, 190, 0.9 if action == "acceleration" else 0.4)
    steps = rollout(envs, actions, seed=11)
    terminated_and_truncated = [columns(steps[1:], index) for index in (2, 3)]
    ended = terminated_and_truncated[0] | terminated_and_truncated[1]
    episodes = 0
    for vehicle in (0, 4, 8):  # machine code simulates vehicles 0 to 7 in one vector register, and vehicle 8 in another
        first, sample = 0, 0
        for last in [*np.flatnonzero(ended[:, vehicle]), len(actions) - 1]:
            flown_actions = actions[first : last + 1, vehicle]
            flight = simulate(
                envs.scenario,
                seed=11 + vehicle,
                sample=sample,
                policy=action_source(flown_actions, 0.02),
                plan=envs.plan,
                until=0.02 * len(flown_actions),
            )
            for name in ("state", "reference", "rotor_speed"):
                actual = [
                    np.array(getattr(step, name, None) or step.signals[name])[:, vehicle]
                    for step in transitions[first : last + 1]
                ]
                np.testing.assert_allclose(actual[: len(flight.time) - 1], flight[name][1:], rtol=0.0, atol=1e-9)
            actual = [step[0][vehicle] for step in steps[first + 1 : last + 2]]
            np.testing.assert_allclose(actual[: len(flight.time) - 1], flight["observation"][1:], rtol=1e-6, atol=1e-6)
            initial = steps[first][0][vehicle]
            np.testing.assert_allclose(initial, flight["observation"][0], rtol=1e-6, atol=1e-6)
            if last < len(actions) - 1 or ended[last, vehicle]:
                assert terminated_and_truncated[0][last, vehicle] == flight.metrics.crashed
                info = steps[last + 1][4]["flight"]
                assert ("effort_x" in info) == (action == "acceleration")
                for field in info.keys() & {*Metrics._fields}:
                    np.testing.assert_allclose(info[field][vehicle], getattr(flight.metrics, field), rtol=1e-9)
                episodes += 1
            # The step after the last step of an episode resets the vehicle.
            first, sample = last + 2, sample + 1
    assert episodes > 3
    # No vehicle crashes this early if actions are accelerations.
    assert terminated_and_truncated[0][:, [0, 4, 8]].any() == (action != "acceleration")


@pytest.mark.long
def test_a_rollout_is_reproducible_and_vehicles_are_independent():
    envs = envs_of(12)
    actions = random_actions(envs, 0, 120)
    one, repeated = (rollout(each, actions, seed=5) for each in (envs, envs_of(12)))
    for first, second in zip(one, repeated, strict=True):
        assert data_equivalence(first, second, exact=True)
    partial = rollout(envs_of(3), actions[:, 4:7], seed=9)
    for complete_step, partial_step in zip(one, partial, strict=True):
        for index in range(4 if len(partial_step) == 5 else 1):
            np.testing.assert_array_equal(complete_step[index][4:7], partial_step[index])
    other = rollout(envs, actions, seed=6)
    assert not np.array_equal(one[60][0], other[60][0])


@pytest.mark.long
def test_vehicles_can_have_individual_seeds_and_resets():
    envs = envs_of(4, autoreset_mode=AutoresetMode.DISABLED)
    initial, _ = envs.reset(seed=[7, 8, 20, 21])
    np.testing.assert_array_equal(initial[:2], envs_of(2).reset(seed=7)[0])
    np.testing.assert_array_equal(initial[2:], envs_of(2).reset(seed=np.int64(20))[0])
    for action in random_actions(envs, 0, 3):
        before, *_ = envs.step(action)
    mask = np.array([False, True, False, True])
    observed, infos = envs.reset(options={"reset_mask": mask}, seed=[None, 8, None, None])
    assert infos == {}
    np.testing.assert_array_equal(observed[~mask], before[~mask])
    np.testing.assert_array_equal(observed[1], initial[1])
    assert [envs.episode(i) for i in range(4)] == [(7, 0), (8, 0), (20, 0), (21, 1)]
    after, *_ = envs.step(np.zeros((4, 4)))
    assert (after != observed).any(axis=1).all()
    # A reset without a seed starts the next episode of all vehicles.
    envs.reset()
    assert [envs.episode(i).sample for i in range(4)] == [1, 1, 1, 2]


@pytest.mark.long
def test_episodes_without_a_seed_get_a_random_seed():
    one, other = (envs_of(2).reset()[0] for _ in range(2))
    assert not np.array_equal(one, other)
    first, second = (QuadrotorEnv("robustness") for _ in range(2))
    assert not np.array_equal(first.reset()[0], second.reset()[0])
    envs = envs_of(3)
    envs.reset(seed=[None, 5, None])
    seeds = [envs.episode(i).seed for i in range(3)]
    assert seeds[1] == 5
    assert len(set(seeds)) == 3
    # Equal seeds are very unlikely, because the range of random seeds is large.
    drawn_seeds = set()
    for _ in range(12):
        envs.has_begun = False
        envs.reset()
        drawn_seeds.add(envs.episode(0).seed)
    assert len(drawn_seeds) == 12
    # Generators with the same seed give the same random seeds.
    second = envs_of(3)
    second.np_random = np.random.default_rng(3)
    other = envs_of(3)
    other.np_random = np.random.default_rng(3)
    np.testing.assert_array_equal(second.reset()[0], other.reset()[0])


@pytest.mark.long
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_vehicles_reset_according_to_the_autoreset_mode(mode):
    """In both modes, episodes have the same first and last observations and the same rewards."""
    n = 3
    envs, single_envs = (
        envs_of(n, autoreset_mode=mode),
        [envs_of(1, autoreset_mode=AutoresetMode.DISABLED) for _ in range(n)],
    )
    actions = random_actions(envs, 2, 160)
    assert envs.metadata["autoreset_mode"] is mode
    observed, _ = envs.reset(seed=3)
    initial_observations = [each.reset(seed=3 + i)[0][0] for i, each in enumerate(single_envs)]
    np.testing.assert_array_equal(observed, initial_observations)
    over, crashes, cuts = np.zeros(n, dtype=bool), 0, 0
    for action in actions:
        observed, rewards, terminations, truncations, infos = envs.step(action)
        for i, each in enumerate(single_envs):
            if mode is AutoresetMode.NEXT_STEP and over[i]:
                expected, _ = each.reset()
                np.testing.assert_array_equal(observed[i], expected[0])
                assert (rewards[i], terminations[i], truncations[i]) == (0.0, False, False)
                continue
            last, reward, terminated, truncated, info = each.step(action[i : i + 1])
            assert (rewards[i], terminations[i], truncations[i]) == (reward[0], terminated[0], truncated[0])
            if not (terminated[0] or truncated[0]):
                np.testing.assert_array_equal(observed[i], last[0])
                continue
            crashes, cuts = crashes + terminated[0], cuts + truncated[0]
            assert infos["_flight"][i]
            assert infos["flight"]["rmse"][i] == info["flight"]["rmse"][0]
            if mode is AutoresetMode.SAME_STEP:
                np.testing.assert_array_equal(infos["final_obs"][i], last[0])
                assert infos["final_info"]["flight"]["rmse"][i] == info["flight"]["rmse"][0]
                last, _ = each.reset()
            np.testing.assert_array_equal(observed[i], last[0])
        over = terminations | truncations
        assert ("flight" in infos) == over.any()
        if over.any():
            np.testing.assert_array_equal(infos["_flight"], over)
            masks = [infos["flight"][f"_{name}"] for name in ("rmse", "obstacle")]
            if mode is AutoresetMode.SAME_STEP:
                masks += [infos["_final_obs"], infos["_final_info"]]
                assert [each is not None for each in infos["final_obs"]] == over.tolist()
            np.testing.assert_array_equal(masks, [over] * len(masks))
    assert crashes
    assert cuts


@pytest.mark.long
def test_the_number_of_episodes_is_unlimited():
    """The test flies many more episodes than are computed in advance."""
    scenario = load_scenario("robustness", {"duration": 0.04})
    envs = QuadrotorVectorEnv(scenario, num_envs=2, autoreset_mode=AutoresetMode.SAME_STEP)
    observed = [envs.reset(seed=3)[0]]
    for _ in range(200):
        actual, _, terminations, truncations, _ = envs.step(np.zeros((2, 3)))
        if truncations.all():
            observed.append(actual)
        assert not terminations.any()
    assert len(observed) == 101
    for vehicle, sample in ((0, 0), (1, 31), (0, 32), (1, 33), (0, 64), (1, 100)):
        flight = simulate(envs.scenario, seed=3 + vehicle, sample=sample, policy=action_source(np.zeros((2, 3)), 0.02))
        np.testing.assert_allclose(observed[sample][vehicle], flight["observation"][0], rtol=1e-6, atol=1e-6)
        assert envs.episode(vehicle) == (3 + vehicle, 100)


def test_a_flight_is_truncated_at_its_end():
    envs = QuadrotorVectorEnv("hover", {"duration": 0.1}, num_envs=2, autoreset_mode=AutoresetMode.DISABLED)
    envs.reset(seed=0)
    ends = [envs.step(np.zeros((2, 3)))[2:4] for _ in range(7)]
    assert [bool(cut.all()) for _, cut in ends] == [False] * 4 + [True] * 3
    assert not any(crashed.any() for crashed, _ in ends)


@pytest.mark.parametrize("mode", AutoresetMode)
def test_a_flight_that_terminates_in_its_last_tick_is_not_truncated(mode):
    """A truncation ends an episode for a reason outside the task, so no step both terminates and truncates it."""

    def high(step):
        return (step.time > 0.09) & (np.arange(3) == 1)

    envs = QuadrotorVectorEnv("hover", {"duration": 0.1}, num_envs=3, terminates=high, autoreset_mode=mode)
    envs.reset(seed=0)
    ends = [envs.step(np.zeros((3, 3)))[2:4] for _ in range(5)]
    assert not np.any(ends[:-1])
    terminations, truncations = ends[-1]
    assert terminations.tolist() == [False, True, False]
    assert truncations.tolist() == [True, False, True]


@pytest.mark.slow
def test_an_environment_keeps_attitude_control_and_the_limits_of_thrust_vectoring():
    tilted = {"control.thrust_vectoring.max_tilt": 0.3, "control.attitude.k_p": [5.0, 6.0, 7.0]}
    scenario = load_scenario("figure_eight", tilted)
    control = QuadrotorVectorEnv(scenario).scenario.control
    assert control.thrust_vectoring == scenario.control.thrust_vectoring
    assert control.attitude == scenario.control.attitude
    assert control.action.kind == "acceleration"
    # Actions that are rotor speeds need no attitude controller.
    assert QuadrotorVectorEnv(scenario, action="rotor_speeds").scenario.control.attitude is None


@pytest.mark.long
def test_environments_pass_the_checks_of_gymnasium():
    with pytest.warns(UserWarning, match="infinity|spec"):
        check_env(QuadrotorEnv("robustness", TASK["overrides"], action="rates", render_mode="rgb_array"))
    check_environments_match(*(QuadrotorEnv(action=action) for action in ("rates", "rates")), 40)


@pytest.mark.slow
def test_environments_are_registered_and_wrapped():
    env = gymnasium.make("drake_quad/Track-v0", scenario="hover", action="attitude")
    assert isinstance(env.unwrapped, QuadrotorEnv)
    env.reset(seed=0)
    env.step(env.action_space.sample())
    envs = gymnasium.make_vec("drake_quad/Track-v0", num_envs=6, scenario="hover", overrides={"duration": 0.2})
    assert isinstance(envs.unwrapped, QuadrotorVectorEnv)
    envs = wrappers.RecordEpisodeStatistics(wrappers.NormalizeObservation(envs))
    envs.reset(seed=0)
    for _ in range(10):
        observed, _, _, truncations, infos = envs.step(np.zeros(envs.action_space.shape, dtype=np.float32))
    assert truncations.all()
    assert envs.observation_space.contains(observed.astype(np.float32))
    np.testing.assert_array_equal(infos["episode"]["l"], 10)
    assert (infos["flight"]["rmse"] < 0.01).all()


@pytest.mark.slow
@pytest.mark.parametrize("action", [{"kind": "acceleration", "frame": "reference_heading"}, "attitude", "rates"])
def test_the_task_does_not_depend_on_the_heading_if_observations_rotate_with_it(action):
    observation = {"signals": ["position_error", "velocity_error", "rotation", "body_rates", "action"]}
    steps = []
    for yaw in (0.0, 2.0):
        envs = QuadrotorVectorEnv(
            "hover",
            {"route.yaw": yaw, "duration": 0.6},
            num_envs=2,
            action=action,
            observation={**observation, "frame": "reference_heading"},
        )
        steps.append(rollout(envs, random_actions(envs, 0, 25), 0))
    for index, selected in ((0, slice(None)), (1, slice(1, None))):
        one, other = (columns(each[selected], index) for each in steps)
        assert np.ptp(one, axis=0).max() > 0.01
        np.testing.assert_allclose(other, one, rtol=0.0, atol=1e-6)


@pytest.mark.long
def test_the_observation_and_action_spaces_match_the_scenario():
    envs = envs_of(3, action={"kind": "acceleration", "max_acceleration": [3, 3, 3]}, observation={"history": 4})
    assert envs.single_observation_space.shape == (4 * (3 + 3 + 9 + 3 + 3 + 3),)
    assert envs.action_space.shape == (3, 3)
    assert envs.metadata["render_fps"] == 50
    observed, *_ = rollout(envs, random_actions(envs, 0, 1), 0)[1]
    assert observed.dtype == np.float32
    assert envs.observation_space.contains(observed)
    # If a scenario has a policy, its environment has the observations and actions of the policy.
    raptor = load_scenario("figure_eight", layers=["controllers/raptor:raptor_plus"])
    assert QuadrotorVectorEnv(raptor).single_observation_space.shape == (22,)


@pytest.mark.slow
def test_reward_and_termination_can_be_user_defined_functions():
    def is_far(step):
        return step.position_error > 0.5

    def downwind(step):
        assert step.signals["wind"].x.shape == (4,)
        np.testing.assert_array_equal(step.signals["state"], step.state)
        np.testing.assert_array_equal(step.time, 0.02 * (len(distances) + 1))
        return -step.signals["wind"].x

    envs = envs_of(
        4, reward=downwind, terminates=is_far, signals=["wind", "state"], autoreset_mode=AutoresetMode.DISABLED
    )
    envs.reset(seed=1)
    distances = []
    for action in random_actions(envs, 1, 70):
        _, rewards, terminations, *_ = envs.step(action)
        state, reference = envs._fleet.output_record("state"), envs._fleet.output_record("reference")
        distances.append(np.linalg.norm(np.subtract(reference[:3], state[:3]), axis=0))
        np.testing.assert_allclose(rewards, -envs._fleet.output_record("wind").x)
        np.testing.assert_array_equal(terminations, distances[-1] > 0.5)
    assert (np.array(distances) > 0.5).any()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["wind", "rotor_speed", "measurement"])
def test_transitions_contain_the_requested_signals(name):
    transitions = []
    envs = envs_of(2, signals=[name], reward=lambda step: transitions.append(step.signals) or np.zeros(2))
    envs.reset(seed=0)
    envs.step(np.zeros((2, 4)))
    (signals,) = transitions
    assert [*signals] == [name]
    np.testing.assert_array_equal(signals[name], envs._fleet.output_record(name))
    flight = simulate(envs.scenario, seed=0, sample=0, policy=action_source(np.zeros((1, 4)), 0.02), until=0.02)
    np.testing.assert_allclose(np.array(signals[name])[:, 0], flight[name][1], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("n", [1, 8, 9])
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_later_steps_do_not_change_a_transition(n, mode):
    transitions, copies = [], []

    def reward(step):
        transitions.append(step)
        copies.append(copy.deepcopy(step))
        return np.zeros(n)

    envs = envs_of(n, reward=reward, signals=["wind"], autoreset_mode=mode)
    ended = columns(rollout(envs, random_actions(envs, 2, 120), seed=1)[1:], 2)
    assert ended[:-1].any()
    for step, before in zip(transitions, copies, strict=True):
        assert data_equivalence(tuple(step), tuple(before), exact=True)
    assert any((one.state.z != other.state.z).any() for one, other in itertools.pairwise(transitions))


@pytest.mark.long
@pytest.mark.parametrize("mask", [None, [False, True, True]])
def test_a_reset_clears_the_list_of_ended_episodes(mask):
    envs = envs_of(3, action="rotor_speeds")
    options = None if mask is None else {"reset_mask": np.array(mask)}
    envs.reset(seed=4)
    while not envs.step(-np.ones((3, 4)))[2].all():
        pass
    initial = [envs.episode(i).sample for i in range(3)]
    envs.reset(seed=9, options=options)
    action = np.full((3, 4), 0.1)
    observed, rewards, *_ = envs.step(action)
    second = envs_of(3, action="rotor_speeds")
    second.reset(seed=9)
    expected, expected_rewards, *_ = second.step(action)
    new = np.ones(3, dtype=bool) if mask is None else np.array(mask)
    np.testing.assert_array_equal(observed[new], expected[new])
    np.testing.assert_array_equal(rewards[new], expected_rewards[new])
    assert (rewards[~new] == 0.0).all()
    assert [envs.episode(i).sample for i in range(3)] == [0 if new[i] else initial[i] + 1 for i in range(3)]


@pytest.mark.slow
def test_the_last_action_before_the_first_step_is_the_hover_action():
    """The thrust in hover is the weight, and actions range from 0.5 to 1.75 times the weight."""
    transitions = []
    action = {"kind": "attitude", "min_thrust": 0.5, "max_thrust": 1.75}
    envs = envs_of(2, action=action, reward=lambda step: transitions.append(step.last_action) or np.zeros(2))
    envs.reset(seed=1)
    envs.step(np.full((2, 4), 0.1))
    envs.reset(options={"reset_mask": np.array([False, True])})
    envs.step(np.zeros((2, 4)))
    np.testing.assert_allclose(transitions, [[[-0.2, 0.0, 0.0, 0.0]] * 2, [[0.1] * 4, [-0.2, 0.0, 0.0, 0.0]]])


@pytest.mark.slow
def test_the_tracking_reward_follows_its_formula():
    reward = TrackingReward(tracking=2.0, length=0.5, effort=0.1, variation=0.2, crash=7.0, obstacle=3.0)
    transitions = []
    distant_ball, ball = ({"kind": "sphere", "centre": [x, 0, -0.5], "radius": 0.2} for x in (9, 0))
    envs = QuadrotorVectorEnv(
        "figure_eight",
        {"space.obstacles.aside": distant_ball, "space.obstacles.ball": ball, "space.margin": 0.0},
        plan=QuadrotorVectorEnv("figure_eight").plan,
        num_envs=2,
        reward=lambda step: transitions.append(step) or reward(step),
        autoreset_mode=AutoresetMode.DISABLED,
    )
    envs.reset(seed=0)
    last = np.zeros((2, 3))
    for k in range(60):
        action = np.array([[0.0, 0.0, -0.1 * (k % 3)], [0.1, 0.2, 5.0]])
        _, rewards, terminations, _, infos = envs.step(action)
        step = transitions[-1]
        a, b = np.clip(action, -1.0, 1.0), np.clip(last, -1.0, 1.0)
        np.testing.assert_array_equal(step.last_action, last)
        expected = 2.0 * np.exp(-step.position_error / 0.5) - 0.1 * (a**2).sum(1) - 0.2 * ((a - b) ** 2).sum(1)
        np.testing.assert_allclose(rewards, expected - terminations * 7.0 - 3.0 * (step.obstacle_hit == 2))
        last = action
        if terminations.any():
            break
    assert terminations.tolist() == [True, False]
    assert infos["flight"]["obstacle"].tolist() == [2, 0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: envs_of(0), "num_envs is 0, but must be at least 1"),
        (lambda: envs_of(2, render_mode="human"), "render_mode is 'human', but must be None or one of"),
        (lambda: envs_of(2, action="magic"), "control.action.kind is 'magic', but must be one of"),
        (lambda: envs_of(2, observation={"history": 0}), "control.observation.history is 0"),
        (lambda: envs_of(2, signals=["swing"]), "'swing' is not a signal of this scenario; its signals are reference"),
        (lambda: QuadrotorVectorEnv("nowhere"), "nowhere"),
        (
            lambda: QuadrotorVectorEnv(load_scenario("hover"), {"duration": 1}),
            "overrides apply only to a scenario that is loaded by file or name",
        ),
        (
            lambda: QuadrotorVectorEnv("hover", {"laboratory.motion_capture.period": 0.04}),
            "must repeat in every tick of 0.02 s, but repeat only every 0.04 s",
        ),
        (lambda: envs_of(2).step(np.zeros((2, 4))), "must be reset before its first step"),
        (lambda: rollout(envs_of(2), [np.zeros((2, 3))], 0), r"the shape \(2, 3\), but must have \(2, 4\)"),
        (lambda: rollout(envs_of(2), [np.full((2, 4), [[0.0], [np.nan]])], 0), "the action of vehicle 1 is .nan, nan"),
        (lambda: envs_of(2).reset(seed=-1), "seed is -1, but must be from 0 to 9223372036854775805"),
        (lambda: envs_of(2).reset(seed=[1, 2, 3]), "3 seeds are given, but there are 2 vehicles"),
        (
            lambda: envs_of(2).reset(seed=0, options={"reset_mask": np.array([True, False])}),
            "must be True for all vehicles at the first reset",
        ),
        (lambda: envs_of(2).reset(seed=0, options={"reset_mask": [1, 0]}), "reset_mask must contain 2 Booleans"),
        (lambda: flown_with(reward=lambda step: step.observation), r"reward must return 2 numbers, but returned array"),
        (lambda: flown_with(reward=lambda step: None), "reward must return 2 numbers, but returned None"),
        (lambda: flown_with(reward=lambda step: [0.0, np.nan]), "finite numbers, but returned nan for vehicle 1"),
        (lambda: flown_with(terminates=lambda step: False), "terminates must return 2 numbers, but returned False"),
        (lambda: envs_of(2, signals=["wind", "wind"]), "signals contains wind twice"),
        (lambda: envs_of(2.5), "num_envs is 2.5, but must be a whole number, at least 1"),
        (lambda: envs_of(True), "num_envs is True, but must be a whole number"),
        (
            lambda: envs_of(2, autoreset_mode="never"),
            "autoreset_mode is 'never', but must be one of NextStep",
        ),
        (lambda: envs_of(2, plan=3), "plan is 3, but must be a Plan"),
        (lambda: envs_of(2, reward=None), "reward is None, but must be a function of a Transition"),
        (lambda: envs_of(2, reward=lambda: 0.0), r"reward is <lambda>\(\), but must be a function of a Transition"),
        (lambda: envs_of(2, terminates=1), "terminates is 1, but must be a function of a Transition"),
        (lambda: envs_of(2).reset(seed=1.5), "seed is 1.5, but must be a whole number"),
        (lambda: envs_of(2).reset(seed="a"), "seed is 'a', but must be a whole number"),
        (lambda: envs_of(2).reset(seed=[1.5, 2]), "seed is 1.5, but must be a whole number"),
        (lambda: QuadrotorEnv("hover").reset(seed=-3), "seed is -3, but must be from 0"),
        (lambda: rollout(envs_of(2), ["up"], 0), "actions are 'up', but must be an array of real numbers"),
        (lambda: rollout(envs_of(2), [[[0.0], [0.0, 1.0]]], 0), "must be an array of real numbers"),
        (lambda: rollout(envs_of(2), [np.full((2, 4), "0.1")], 0), "must be an array of real numbers"),
        (lambda: rollout(envs_of(2), [np.full((2, 4), 0.1 + 0.1j)], 0), "must be an array of real numbers"),
        (lambda: rollout(envs_of(2), [np.full((2, 4), None)], 0), "must be an array of real numbers"),
        (
            lambda: rollout(envs_of(2), [np.full((2, 4), [[0.0], [-1e308]])], 0),
            "at most 1,000,000, but the action of",
        ),
        (lambda: QuadrotorEnv("hover").step([0.0, 0.0, 1j]), "must be an array of real numbers"),
        (lambda: flown_with(reward=lambda step: 1j * step.time), r"reward must return 2 numbers, but returned array"),
        (lambda: flown_with(terminates=lambda step: ["", "x"]), r"terminates must return 2 numbers, but returned \["),
        (lambda: envs_of(2, action=5), "action is 5, but must be the name of an action type, or a mapping of fields"),
        (lambda: envs_of(2, action=["rates"]), r"action is \['rates'\], but must be the name"),
        (lambda: envs_of(2, observation=5), "control.observation is 5, but must be a mapping"),
        (lambda: envs_of(2, signals="wind"), "signals is 'wind', but must be a list of names"),
        (lambda: envs_of(2, signals=None), "signals is None, but must be a list of names"),
        (lambda: QuadrotorVectorEnv("hover", 5), "the override 5 must be a mapping"),
        (lambda: envs_of(2, record=True).flight(2), "vehicle is 2, but must be from 0 to 1"),
        (lambda: envs_of(2).episode(-1), "vehicle is -1, but must be from 0 to 1"),
        (lambda: envs_of(2, render_mode="rgb_array").render(), "must be reset before it is rendered"),
        (lambda: TrackingReward(length=0.0), "length is 0.0, but must be larger than 0"),
        (lambda: TrackingReward(effort=np.inf), "effort is inf, but must be a finite number"),
        (lambda: envs_of(2).flight(), "actions are not recorded"),
        (lambda: QuadrotorEnv("hover").flight(), "vehicle 0 has not flown yet"),
    ],
)
def test_invalid_arguments_are_reported_in_a_sentence(make, message):
    with pytest.raises(InputError, match=message):
        make()
