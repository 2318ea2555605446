"""Tests of the symmetry of flights: a rotation of the reference about Z rotates the flight.

In an ideal laboratory only gravity has a direction. A controller that follows the reference yaw therefore has the same
flight at every heading.
"""

import numpy as np
import pytest
from covering import covering

from drake_quad import load_scenario, simulate
from drake_quad.scenario.files.shipped import shipped_scenarios

NO_CAMERA_NOISE = {"position_noise": 0.0, "attitude_noise": 0.0}  # m and rad
IDEAL_ONBOARD = {
    "vehicle": {"linear_drag": 0.0, "quadratic_drag": 0.0},
    "laboratory": {
        "autopilot": {"gyroscope_noise": 0.0, "gyroscope_bias": [0.0, 0.0, 0.0]},
        "command_link": {"loss_rate": 0.0},
        "motion_capture": NO_CAMERA_NOISE,
    },
}
NEURAL_FLY_WITHOUT_WIND_AND_NOISE = {
    "metrics.start": 0.0,
    "laboratory": {"wind": [], "motion_capture": NO_CAMERA_NOISE},
}


def base_of(controller):
    """Return the scenario, the layers and the overrides with which a shipped controller is flown."""
    file, _, name = controller.partition(":")
    if name == "lqg_neural_fly":
        return "neural_fly:still", [], NEURAL_FLY_WITHOUT_WIND_AND_NOISE
    if name == "lqg_crazyflie_onboard":
        return "figure_eight", ["vehicles/crazyflie_onboard"], {}
    if name == "lqg_crazyflie":
        return "figure_eight", ["vehicles/crazyflie"], {}
    if name == "lqg_onboard" or file.endswith("onboard"):
        return "onboard", [], IDEAL_ONBOARD
    return "figure_eight", ["vehicles/racer"] if name == "raptor" else [], {}


def shipped_controllers():
    """Return the names of the shipped controllers, without variants that are designed for other laboratories."""
    names = [name for name in shipped_scenarios() if name.startswith(("controllers/", "gains/"))]
    # lee.yaml has no gains. Its law is tested with geometric attitude control.
    designed, laboratory = "controllers/designed/", "controllers/designed/laboratory:"
    return [name for name in names if name.startswith(laboratory) or not name.startswith((designed, "controllers/lee"))]


def structure_of(value):
    """Return the field names and the kinds of a part of a control, without its values."""
    if isinstance(value, dict):
        return tuple((name, structure_of(each)) for name, each in value.items())
    return value if isinstance(value, str) else value is not None


def features_of(controller):
    """Return the structure of each part of a controller, and the kinds of parts that it combines."""
    scenario, layers, overrides = base_of(controller)
    scenario = load_scenario(scenario, overrides, layers=[*layers, controller])
    control, autopilot = scenario.control.model_dump(), scenario.laboratory.autopilot.kind
    parts = {(name, structure_of(value)) for name, value in control.items()}
    position = control.get("position") or {}
    return parts | {(autopilot, control.get("kind"), position.get("kind"), control.get("network") is None)}


def states_of_flight(controller, turn, duration=0.8):
    """Return the states (ticks, 12) of a flight along a reference that is rotated about Z and whose velocity jumps."""
    scenario, layers, overrides = base_of(controller)
    route = {
        "kind": "lissajous",
        "centre": [0.0, 0.0, 1.0],
        "amplitude": [0.4 * np.cos(turn), 0.4 * np.sin(turn), 0.2],
        "turns": [1, 1, 1],
        "phase": [0.0, 0.0, 0.0],
        "period": 4.0,
        "laps": 1,
        "yaw": 0.3 + turn,
    }
    all_overrides = {**overrides, "route": route, "duration": duration}
    return simulate(load_scenario(scenario, all_overrides, layers=[*layers, controller]), compiled=False)["state"]


def rotated(states, angle):
    """Return states (ticks, 12) rotated about Z by an angle, rad."""
    rotated_states = states.copy()
    for x, y in ((0, 1), (6, 7)):
        rotated_states[:, x] = np.cos(angle) * states[:, x] - np.sin(angle) * states[:, y]
        rotated_states[:, y] = np.sin(angle) * states[:, x] + np.cos(angle) * states[:, y]
    rotated_states[:, 5] += angle
    return rotated_states


@pytest.mark.long
def test_shipped_controllers_have_the_same_flight_at_the_opposite_heading():
    """Other rotations would change the flight, since gains on X and Y may differ and networks act on each axis.

    If several controllers differ only in their gains, only one of them is flown.
    """
    for controller in covering({name: features_of(name) for name in shipped_controllers()}):
        expected = states_of_flight(controller, 0.0)
        assert np.abs(expected[:, 0]).max() > 0.003, controller
        states = states_of_flight(controller, np.pi)
        np.testing.assert_allclose(states, rotated(expected, np.pi), rtol=0.0, atol=1e-9, err_msg=controller)


@pytest.mark.long
@pytest.mark.parametrize(
    "controller",
    [
        "controllers/calibrated:pid",
        "controllers/designed/laboratory:geometric",
        "controllers/designed/laboratory:indi",
        "controllers/lqg:lqg_crazyflie_onboard",
        "controllers/mpc:mpc_short_of_thrust",
        "controllers/raptor:raptor",
        "gains/onboard",
    ],
)
def test_a_controller_with_equal_gains_on_x_and_y_has_the_same_flight_at_every_heading(controller):
    expected = states_of_flight(controller, 0.0)
    for angle in (-1.0, 12.0):
        np.testing.assert_allclose(states_of_flight(controller, angle), rotated(expected, angle), rtol=0.0, atol=1e-9)
