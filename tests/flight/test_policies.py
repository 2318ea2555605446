"""Tests of policies as controllers: compared with equal control laws and with the package of a published policy."""

import csv

import numpy as np
import pytest
from compiled_comparison import assert_flights_alike, assert_flown_alike
from pydrake.systems.framework import LeafSystem

from drake_quad import InputError, load_scenario, run_monte_carlo, save_scenario, simulate
from drake_quad.control.policy.network import evaluate_network
from drake_quad.gym.rollout import action_source
from drake_quad.gym.task import environment_scenario
from drake_quad.reference.plan import Plan
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.files.loading import with_fields

K_P = np.array([1.2, 0.9, 4.0])  # 1/s²
K_D = np.array([1.5, 1.3, 3.1])  # 1/s
ACTION_LIMIT = np.array([4.0, 5.0, 6.0])  # m/s²


def with_policy(scenario, arrays, folder, **control):
    """Return a scenario whose policy is the network with the given weights and biases."""
    np.savez(folder / "net.npz", **arrays)
    fields = {"kind": "policy", "policy": str(folder / "net.npz"), **control}
    names = ("attitude", "thrust_vectoring")
    other_parts = {name: getattr(scenario.control, name).model_dump(mode="json") for name in names}
    if control["action"]["kind"] == "rotor_speeds":
        del other_parts["attitude"]
    path = folder / "scenario.yaml"
    save_scenario(scenario, path)
    return load_scenario(path, {"control": {**other_parts, **fields}})


@pytest.fixture
def pd(diagrams):
    """Return a scenario with a PD, wind and noise."""
    scenario = load_scenario(
        diagrams / "laboratory.yaml:low_wind", {"duration": 4.0, "vehicle.mass": 0.7}, layers=["gains/laboratory"]
    )
    fields = {**scenario.control.model_dump(mode="json"), "network": None}
    fields["position"] = {"kind": "pd", "k_p": K_P, "k_d": K_D, "derivative": "tracking_error", "feed_forward": "none"}
    return with_fields(scenario, {"control": fields})


@pytest.mark.long
def test_a_policy_network_with_the_gains_of_a_pd_flies_like_the_pd(pd, tmp_path):
    """The rest of the cascade, the wind and the noise are the same in both flights."""
    weights = np.hstack([np.diag(K_P / ACTION_LIMIT), np.diag(K_D / ACTION_LIMIT)])
    arrays = {"weights_0": weights, "biases_0": np.zeros(3)}
    observation = {"signals": ["position_error", "velocity_error"]}
    policy = with_policy(
        pd, arrays, tmp_path, action={"kind": "acceleration", "max_acceleration": ACTION_LIMIT}, observation=observation
    )
    flight, expected = simulate(policy), simulate(pd)
    for name in ("state", "wrench", "acceleration_command", "attitude_command"):
        np.testing.assert_allclose(flight[name], expected[name], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(flight.metrics.rmse, expected.metrics.rmse, rtol=1e-9)


def random_policy(action, folder):
    """Return robustness.yaml with a random policy, which has memory and history, for a given kind of actions."""
    rng = np.random.default_rng(4)
    rows = 3 if action == "acceleration" else 4
    observation = {
        "signals": ["reference_ahead", "rotation", "body_rates", "rotor_speed", "wind", "clearance", "action"],
        "ahead": [0.1, 0.4],
        "frame": "heading" if action == "attitude" else "reference_heading",
        "history": 2,
    }
    action_fields = {"kind": action} | ({"frame": "reference_heading"} if action == "acceleration" else {})
    size = 2 * (6 + 9 + 3 + 4 + 3 + 1 + rows)
    arrays = {
        "weights_0": 0.1 * rng.normal(size=(6, size)),
        "biases_0": np.zeros(6),
        "activation_0": np.array("silu"),
        "weights_input_1": rng.normal(size=(9, 6)),
        "biases_input_1": rng.normal(size=9),
        "weights_hidden_1": rng.normal(size=(9, 3)),
        "biases_hidden_1": rng.normal(size=9),
        "weights_2": 0.05 * rng.normal(size=(rows, 3)),
        "biases_2": 0.05 * rng.normal(size=rows),
        "limit": np.array(3.0),
    }
    overrides = {"duration": 0.8, "control": load_scenario("laboratory:low_wind").control}
    overrides["route.heading"] = "along_path"
    overrides["space"] = {"obstacles": {"ball": {"kind": "sphere", "centre": [3.0, 0.0, 1.0], "radius": 0.2}}}
    scenario = load_scenario("robustness", overrides)
    return with_policy(scenario, arrays, folder, action=action_fields, observation=observation)


@pytest.mark.long
@pytest.mark.parametrize("action", ["attitude", "rates", "rotor_speeds", "acceleration"])
def test_a_policy_has_the_same_flight_compiled_and_uncompiled(action, tmp_path):
    assert_flown_alike(Batch.draw(random_policy(action, tmp_path), range(10)))


@pytest.mark.long
def test_a_policy_has_the_same_flight_alone_and_in_a_study(tmp_path):
    policy = random_policy("acceleration", tmp_path)
    alone = simulate(policy, sample=7, compiled=False)
    study = run_monte_carlo(policy, 10, num_workers=1)
    np.testing.assert_allclose(study.metrics.rmse[7], alone.metrics.rmse, rtol=1e-9)


@pytest.mark.parametrize("vehicle", ["paper", "crazyflie", "racer"])
def test_rotor_speed_actions_are_the_commanded_rotor_speeds(vehicle, diagrams):
    scenario = load_scenario("hover", {"duration": 0.4}, layers=[f"vehicles/{vehicle}"])
    task = environment_scenario(scenario, action={"kind": "rotor_speeds", "order": [3, 1, 4, 2]})
    actions = np.random.default_rng(2).uniform(-0.9, 0.9, (20, 4))
    flight = simulate(task, policy=action_source(actions, 0.02))
    low, high = scenario.nominal.min_rotor_speed, scenario.nominal.max_rotor_speed
    speeds = low + 0.5 * (actions[:, np.argsort([2, 0, 3, 1])] + 1.0) * (high - low)
    # The recorder logs the output of the link at the previous tick, and the link delays commands by one tick.
    commands = flight["rotor_speed_command"][2:]
    assert len(commands) > 5
    np.testing.assert_allclose(commands, speeds[: len(commands)], rtol=1e-9)


def test_body_rates_are_tracked_on_board_at_any_attitude(diagrams):
    task = environment_scenario(load_scenario("onboard", {"duration": 0.6}), action="rates")
    actions = np.tile([0.0, 0.1, -0.05, 0.2], (30, 1))
    flight = simulate(task, policy=action_source(actions, 0.02))
    state = flight.record("state")
    commanded_rates = actions[0, 1:] * [6.0, 6.0, 3.0]
    np.testing.assert_allclose([state.p[-1], state.q[-1], state.r[-1]], commanded_rates, atol=0.08)
    assert abs(state.roll[-1]) > 0.2
    # The same autopilot can also track attitudes.
    level = environment_scenario(load_scenario("onboard", {"duration": 0.6}), action="attitude")
    tilting_flight = simulate(level, policy=action_source(actions, 0.02)).record("state")
    np.testing.assert_allclose([tilting_flight.roll[-1], tilting_flight.pitch[-1]], [0.06, -0.03], atol=0.02)


def test_body_rates_are_tracked_by_the_ground_station():
    task = environment_scenario(load_scenario("hover", {"duration": 1.0}), action="rates")
    actions = np.tile([0.0, 0.1, -0.05, 0.2], (50, 1))
    state = simulate(task, policy=action_source(actions, 0.02)).record("state")
    np.testing.assert_allclose([state.p[-1], state.q[-1], state.r[-1]], [0.6, -0.3, 0.6], atol=0.03)


@pytest.fixture(scope="module")
def raptor():
    return load_scenario("figure_eight", layers=["controllers/raptor:raptor"]).control.policy.network()


def test_raptor_has_the_same_actions_as_the_package_foundation_policy(raptor):
    """The inputs are random. `foundation_policy` observes position and velocity errors with the opposite sign."""
    package = pytest.importorskip("foundation_policy")
    policy = package.Raptor()
    policy.reset()
    sign = np.repeat([-1.0, 1.0, -1.0, 1.0], [3, 9, 3, 7])
    memory = raptor.memory
    for inputs in np.random.default_rng(0).normal(size=(40, 22)):
        step = evaluate_network(raptor, (sign * inputs).tolist(), memory)
        memory = step.memory
        np.testing.assert_allclose(step.output, policy.evaluate_step(inputs[None])[0], rtol=1e-5, atol=1e-5)


def test_raptor_flies_as_in_the_simulator_in_which_it_was_trained(root):
    """In the recorded flight in tests/data/raptor, a Crazyflie returns to its setpoint from an initial offset."""
    with (root / "tests/data/raptor/l2f.csv").open(encoding="utf-8") as file:
        expected = np.array([[float(cell) for cell in row.values()] for row in csv.DictReader(file)])
    vehicle = {
        "layout": {"kind": "x", "length": 0.06506, "width": 0.06506, "rotor_1_turns": "anticlockwise"},
        "mass": 0.0319,
        "inertia": [1.68e-5, 1.68e-5, 2.98e-5],
        "thrust_factor": 1.983e-8,
        "drag_factor": 1.398e-10,
        "min_rotor_speed": 0.0,
        "max_rotor_speed": 2431.0,
        "rotor_inertia": 0.0,
    }
    overrides = {"nominal": vehicle, "vehicle.rotor_time_constant": 0.05}
    scenario = load_scenario("figure_eight", overrides, layers=["controllers/raptor:raptor"])

    def prepare(simulator):
        system = simulator.get_system().GetSubsystemByName("laboratory").GetSubsystemByName("vehicle")
        context = system.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        state = system.get_state(context, "state")
        system.set_state(context, "state", state._replace(x=0.3, y=-0.2, z=0.1))

    flight = simulate(scenario, plan=Plan.hover([0.0, 0.0, 0.0], duration=3.0), prepare=prepare, until=2.9)
    actual = flight["state"][::10]
    assert len(actual) == len(expected) == 30
    # The training simulator uses single precision, and the table has seven digits.
    np.testing.assert_allclose(actual[:, :3], expected[:, 1:4], atol=2e-6)
    np.testing.assert_allclose(actual[:, 6:9], expected[:, 13:16], atol=5e-6)
    np.testing.assert_allclose(actual[:, 9:12], expected[:, 16:19], atol=5e-5)
    np.testing.assert_allclose(flight["action"][::10].clip(-1.0, 1.0), expected[:, 19:], atol=2e-5)
    assert np.linalg.norm(actual[-1, :3]) < 0.1 < np.linalg.norm(actual[0, :3])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "layers", "max_rmse"),
    [
        ("figure_eight", ["controllers/raptor:raptor_plus"], 0.06),
        ("figure_eight", ["vehicles/hummingbird", "controllers/raptor:raptor_plus"], 0.12),
        ("figure_eight", ["vehicles/crazyflie", "controllers/raptor:raptor"], 0.25),
        ("figure_eight", ["vehicles/racer", "controllers/raptor:raptor"], 0.12),
    ],
    ids=["paper", "hummingbird", "crazyflie", "racer"],
)
def test_the_foundation_policy_flies_the_vehicles_of_the_library(scenario, layers, max_rmse):
    flight = simulate(load_scenario(scenario, layers=layers), compiled=True)
    assert not flight.metrics.crashed
    assert flight.metrics.rmse < max_rmse


# Largest yaw offset in hover, rad. RAPTOR settles 0.4 to 10 mrad from the commanded yaw, depending on the vehicle.
MAX_YAW_OFFSET = 0.015


@pytest.mark.parametrize("yaw", [-np.pi / 2, 0.0, np.pi / 2, np.pi, 12.0])
def test_the_foundation_policy_follows_the_reference_yaw(yaw):
    """The controller `raptor_plus` rotates the axes by 45°, because the training vehicles had an X layout."""
    hover = load_scenario("hover", {"route.yaw": yaw, "duration": 4.0}, layers=["controllers/raptor:raptor_plus"])
    flight = simulate(hover, compiled=True)
    assert not flight.metrics.crashed
    assert flight.metrics.rmse < 0.03
    assert flight.record("state").yaw[-1] == pytest.approx(yaw, abs=MAX_YAW_OFFSET)


@pytest.mark.slow
@pytest.mark.parametrize("layers", [["raptor_plus"], ["vehicles/crazyflie", "raptor"]], ids=["plus", "x"])
def test_the_foundation_policy_follows_a_yaw_along_the_path(layers):
    layers[-1] = f"controllers/raptor:{layers[-1]}"
    flight = simulate(load_scenario("figure_eight", {"route.heading": "along_path"}, layers=layers), compiled=True)
    assert not flight.metrics.crashed
    yaw_error = flight.record("state").yaw - flight.record("reference").yaw
    # The policy does not observe the yaw rate. The yaw turns by more than half a turn in each direction.
    assert np.ptp(flight.record("reference").yaw) > np.pi
    assert np.abs(yaw_error).max() < 0.3
    assert abs(yaw_error[-1]) < MAX_YAW_OFFSET


def test_a_user_defined_policy_needs_a_control_of_kind_policy():
    with pytest.raises(InputError, match="a policy requires a scenario with control of kind policy"):
        simulate(load_scenario("hover"), policy=action_source(np.zeros((2, 3)), 0.02))
    task = environment_scenario("hover")
    with pytest.raises(InputError, match="the port .* of policy must have 3 elements, but has 4"):
        simulate(task, policy=action_source(np.zeros((2, 4)), 0.02))
    with pytest.raises(InputError, match="control.policy of hover is missing"):
        simulate(task)


@pytest.mark.long
def test_a_policy_in_plain_python_flies_like_a_network(tmp_path):
    """The user's system computes `action` from `observation`, in uncompiled and compiled diagrams."""

    class PlainPolicy(LeafSystem):
        def __init__(self):
            super().__init__()
            observation = self.DeclareVectorInputPort("observation", 6)

            def act(context, output):
                output.SetFromVector(0.1 * observation.Eval(context)[:3] + 0.05 * observation.Eval(context)[3:])

            self.DeclareVectorOutputPort("action", 3, act)

    hover = load_scenario("figure_eight", {"duration": 2.0})
    task = environment_scenario(hover, observation={"signals": ["position_error", "velocity_error"]})
    uncompiled, compiled = (simulate(task, policy=PlainPolicy(), compiled=compiled) for compiled in (False, True))
    assert_flights_alike(compiled, uncompiled)
    arrays = {"weights_0": np.hstack([0.1 * np.eye(3), 0.05 * np.eye(3)]), "biases_0": np.zeros(3)}
    network = with_policy(
        hover,
        arrays,
        tmp_path,
        action={"kind": "acceleration"},
        observation={"signals": ["position_error", "velocity_error"]},
    )
    np.testing.assert_allclose(simulate(network)["state"], uncompiled["state"], atol=1e-9)
