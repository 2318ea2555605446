"""Tests of the predicted motion of tumbling vehicles whose commands are logged."""

import numpy as np
import pytest
from tumbling import degrees_apart, integrate_tumbles, random_tumbles

from drake_quad import load_scenario
from drake_quad.assembly.laboratory import vehicle_parameters
from drake_quad.identification.model import NUM_BODY, NUM_DISTURBANCE, LogModel, ModelFlight, WindowInputs
from drake_quad.identification.prediction_errors import Output, PredictionNoise, Predictor
from drake_quad.identification.windows import LogWindow, WindowSizes
from drake_quad.logs.record import FlightRecord

PERIOD = 0.01  # s, sampling period
DURATION = 1.0  # s, duration of each flight
COMMAND = np.array([196.0, 203.0, 199.0, 201.0])  # rad/s, speeds of the rotors


@pytest.fixture(scope="module")
def scenario(diagrams):
    """Return a scenario whose vehicle has three different moments of inertia, and drag."""
    overrides = ["vehicle.inertia=[0.0066, 0.0079, 0.0121]", "vehicle.linear_drag=0.1", "vehicle.quadratic_drag=0.02"]
    return load_scenario(diagrams / "figure_eight.yaml", overrides)


@pytest.fixture(scope="module")
def tumbles():
    """Return twelve tumbling motions in still air, with rotor speeds equal to the commands."""
    result = random_tumbles(12, seed=8)
    speeds = np.tile(COMMAND, (12, 1))
    return result._replace(speeds=speeds, commands=speeds, winds=np.zeros((12, 3)))


@pytest.fixture(scope="module")
def record():
    """Return a log with constant rotor speeds."""
    time = PERIOD * np.arange(400)
    return FlightRecord("tumbling", time, rotor_speed_command=np.tile(COMMAND, (400, 1)))


@pytest.fixture(scope="module")
def end(scenario, tumbles):
    """Return the positions and rotations at the end of tumbling motions of `DURATION`."""
    position, rotation, *_ = integrate_tumbles(vehicle_parameters(scenario.vehicle), tumbles, DURATION)
    return position, rotation


def test_the_model_of_a_predictor_follows_a_tumbling_vehicle(scenario, tumbles, record, end):
    vehicle = LogModel(scenario, ["mass"])
    sizes = WindowSizes(length=150, settle=0, warm_up=10)
    inputs = WindowInputs.of([record], vehicle, [LogWindow(0, 200)] * 12, sizes, split=1, max_delay=0.02)
    model = ModelFlight(vehicle, np.array([[scenario.vehicle.mass]]), inputs, sizes.warm_up)
    state = np.zeros((NUM_BODY + NUM_DISTURBANCE, 1, 12))
    state[:NUM_BODY, 0] = tumbles.states.T
    for _ in range(round(DURATION / PERIOD)):
        model.step(state)
    result = state[:NUM_BODY, 0].T
    assert degrees_apart(result[:, 3:6], end[1]).max() < 1e-3
    np.testing.assert_allclose(result[:, :3], end[0], atol=1e-5)


def test_a_predictor_follows_a_vehicle_that_rolls_over(diagrams):
    """The vehicle rolls at 3 rad/s with constant thrust.

    The roll is exactly 180° at one sample, so half of the perturbed roll angles at this sample wrap.
    """
    scenario = load_scenario(diagrams / "figure_eight.yaml")
    vehicle = LogModel(scenario, ["mass"])
    time = PERIOD * np.arange(200)
    roll = np.pi - 3.0 * (time - time[100])
    mass = scenario.vehicle.mass
    command = np.full((200, 4), 200.0)
    thrust = 4.0 * scenario.vehicle.thrust_factor * 200.0**2 / mass
    # The position is the double integral of gravity and of the specific thrust along (0, -sin(roll), cos(roll)).
    across, up = thrust * np.array([np.sin(roll) / 9.0, -np.cos(roll) / 9.0])
    position = np.column_stack([0.0 * time, across, up - 0.5 * scenario.vehicle.gravity * time**2])
    attitude = np.column_stack([np.arctan2(np.sin(roll), np.cos(roll)), 0.0 * time, 0.0 * time])
    record = FlightRecord("rolling", time, position=position, attitude=attitude, rotor_speed_command=command)
    outputs = [Output(signal, column) for signal in ("position", "attitude") for column in range(3)]
    predictor = Predictor(vehicle, [record], [LogWindow(0, 80)], WindowSizes(length=60, settle=50, warm_up=10), outputs)
    noise = PredictionNoise(np.repeat([1e-5, 1e-5], 3), np.full(6, 1e-3), np.ones(6))
    gains = predictor.gains(np.array([mass]), noise)
    assert np.abs(gains.transition).max() < 2.0
    assert np.abs(gains.errors[predictor.evaluated]).max() < 1e-5
