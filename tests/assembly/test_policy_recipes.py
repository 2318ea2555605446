"""Tests that a policy's actions and observations have the limits and scales of the scenario."""

import numpy as np
import pytest

from drake_quad import load_scenario, simulate
from drake_quad.gym.rollout import action_source
from drake_quad.gym.task import environment_scenario
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.scenario.files.loading import with_fields

# All rotors have different parameters, and no rotor is where a standard layout has one.
ROTORS = [
    {"position": [0.17, 0.03, 0.01], "turns": "clockwise", "thrust_factor": 4.1e-5, "drag_factor": 1.1e-6},
    {"position": [-0.02, -0.15, 0.02], "turns": "anticlockwise", "thrust_factor": 3.8e-5, "drag_factor": 1.0e-6},
    {"position": [-0.16, 0.01, 0.0], "turns": "clockwise", "thrust_factor": 4.2e-5, "drag_factor": 0.9e-6},
    {"position": [0.01, 0.19, 0.03], "turns": "anticlockwise", "thrust_factor": 3.9e-5, "drag_factor": 1.2e-6},
]
UNEVEN_VEHICLE = {
    "nominal": {
        "layout": {"kind": "rotors", "rotors": ROTORS},
        "min_rotor_speed": 60.0,
        "mass": 0.7,
        "inertia": [0.006, 0.008, 0.013],
    },
    "duration": 0.4,
}
ATTITUDE_GAINS = {"k_p": [8.0, 7.0, 3.0], "k_d": [4.0, 3.5, 2.0]}


def task_with(action, observation=None, **fields):
    scenario = load_scenario("hover", {**UNEVEN_VEHICLE, "control.attitude": ATTITUDE_GAINS, **fields})
    return environment_scenario(scenario, action=action, observation=observation or {"signals": ["position"]})


def simulate_actions(scenario, *actions):
    return simulate(scenario, policy=action_source(np.array(actions, dtype=float), 0.02))


@pytest.mark.parametrize(
    "action",
    [
        {"kind": "acceleration"},
        {"kind": "attitude", "min_thrust": 0.2, "max_thrust": 3.0},
        {"kind": "rates", "min_thrust": 0.3, "max_thrust": 2.6},
        {"kind": "rotor_speeds"},
        {"kind": "rotor_speeds", "order": [3, 1, 4, 2], "min_rotor_speed": 100.0},
    ],
    ids=lambda action: "_".join(str(each) for each in action.values() if not isinstance(each, list)),
)
def test_the_hovering_action_holds_the_nominal_vehicle_in_hover(action):
    scenario = task_with(action)
    hovering = scenario.control.action.hover_action(nominal_parameters(scenario))
    state = simulate_actions(scenario, hovering).record("state")
    for name in ("x", "y", "z", "roll", "pitch", "yaw"):
        row = getattr(state, name)
        np.testing.assert_allclose(row, row[0], rtol=0.0, atol=1e-9, err_msg=name)
    # A different action moves the vehicle.
    other_state = simulate_actions(scenario, np.array(hovering) + 0.1).record("state")
    assert abs(other_state.z[-1] - other_state.z[0]) > 0.01


def test_an_attitude_action_is_scaled_by_its_limits_of_tilt_and_yaw():
    scenario = task_with({"kind": "attitude", "max_tilt": 0.3, "max_yaw": 0.8})
    commanded = simulate_actions(scenario, [0.0, 0.5, -1.0, 0.25]).record("attitude_command")
    np.testing.assert_allclose([commanded.roll[1], commanded.pitch[1], commanded.yaw[1]], [0.15, -0.3, 0.2])


@pytest.mark.parametrize(("k_rate", "gains"), [(None, ATTITUDE_GAINS["k_d"]), ([9.0, 6.0, 5.0], [9.0, 6.0, 5.0])])
def test_body_rate_actions_are_tracked_with_the_given_gains(k_rate, gains):
    scenario = task_with({"kind": "rates", "max_rates": [2.0, 3.0, 1.0], "k_rate": k_rate})
    wrench = simulate_actions(scenario, [0.0, 0.5, -0.5, 1.0]).record("wrench")
    expected = np.multiply(UNEVEN_VEHICLE["nominal"]["inertia"], gains) * [1.0, -1.5, 1.0]
    np.testing.assert_allclose([row[0] for row in wrench[1:]], expected)


def test_the_observed_clearance_is_the_distance_between_vehicle_and_obstacle_surfaces():
    ball = {"kind": "sphere", "centre": [2.0, 1.0, 1.5], "radius": 0.4}
    far = {"kind": "sphere", "centre": [9.0, 1.0, 1.5], "radius": 0.4}
    space = {"obstacles": {"far": far, "ball": ball}}
    scenario = task_with({"kind": "acceleration"}, {"signals": ["clearance"]}, space=space)
    with_radius = with_fields(scenario, {"space": {**scenario.space.model_dump(mode="json"), "radius": 0.3}})
    flight = simulate_actions(with_radius, [0.5, 0.0, 0.0])
    measurement = flight.record("measurement")
    distance = np.linalg.norm(
        np.subtract([measurement.x, measurement.y, measurement.z], np.array([[2.0], [1.0], [1.5]])), axis=0
    )
    np.testing.assert_allclose(flight["observation"][:, 0], distance - 0.4 - 0.3, rtol=1e-12)


def test_a_policy_observes_the_reference_at_future_times():
    route = load_scenario("figure_eight", {"duration": 3.0})
    scenario = environment_scenario(route, observation={"signals": ["reference_ahead"], "ahead": [0.3, 1.1]})
    flight = simulate_actions(scenario, [0.1, 0.2, 0.0])
    observed, state = flight["observation"].reshape(-1, 2, 3), flight["measurement"][:, :3]
    for index, ticks in enumerate((15, 55)):
        reference = flight["reference"][ticks:, :3]
        np.testing.assert_allclose(observed[:-ticks, index], reference - state[:-ticks], rtol=0.0, atol=1e-9)
    assert np.ptp(observed[:, 1], axis=0).max() > 1.0


def test_an_acceleration_action_has_the_limits_of_thrust_vectoring():
    limits = {"max_tilt": 0.11, "min_thrust": 0.5, "max_thrust": 1.3}
    scenario = task_with({"kind": "acceleration"}, **{"control.thrust_vectoring": limits})
    commanded = simulate_actions(scenario, [1.0, 0.0, 0.0]).record("attitude_command")
    assert commanded.pitch.max() == pytest.approx(0.11)
