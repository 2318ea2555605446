"""Vehicles are found again in the logs of their simulated flights, and published ones in the logs of real flights."""

from pathlib import Path

import numpy as np
import pytest
import scipy

from drake_quad.errors import InputError
from drake_quad.flight.simulation import simulate_samples
from drake_quad.identification.model import DELAY, LogModel
from drake_quad.identification.prediction_errors import Output, PredictionNoise, Predictor
from drake_quad.identification.windows import WindowSizes, cut
from drake_quad.identification.logs.reading import read_log
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.results.held_out import hold_out
from drake_quad.identification.identify import identify
from drake_quad.scenario.files.loading import load_scenario
from drake_quad.scenario.models import Scenario

LABORATORY = "diagrams/laboratory.yaml"
# Over its whole lap in each direction, at changing yaw: each number is excited.
WAYPOINTS = [
    (0.0, 0.0, 1.5, 0.0),
    (0.6, 0.5, 1.8, 0.5),
    (0.2, 1.2, 1.3, -0.4),
    (-0.7, 0.6, 1.6, 0.3),
    (-0.2, -0.6, 1.9, -0.5),
    (0.7, -1.0, 1.4, 0.4),
    (0.5, 0.3, 1.2, -0.2),
    (-0.4, 0.9, 1.7, 0.5),
    (-0.8, -0.2, 1.5, -0.3),
    (0.0, -0.8, 1.2, 0.4),
    (0.3, 0.1, 1.6, -0.5),
    (0.0, 0.0, 1.5, 0.0),
]
ROUTE = (
    "route={kind: waypoints, heading: waypoints, top_speed: null, top_acceleration: null, times: ["
    + ", ".join(f"{1.1 * i:g}" for i in range(len(WAYPOINTS)))
    + "], waypoints: ["
    + ", ".join(f"{{point: [{x}, {y}, {z}], yaw: {yaw}}}" for x, y, z, yaw in WAYPOINTS)
    + "]}"
)
OWN = (
    "vehicle.inertia=[0.0062, 0.0081, 0.0133]",
    "vehicle.thrust_factor=3.9e-5",
    "vehicle.rotor_time_constant=0.061",
    "vehicle.linear_drag=0.16",
    "vehicle.centre_of_mass=[0.003, -0.002]",
)
TRUTH = {
    "thrust_factor": 3.9e-5,
    "rotor_time_constant": 0.061,
    "inertia[0]": 0.0062,
    "inertia[1]": 0.0081,
    "inertia[2]": 0.0133,
    "centre_of_mass[0]": 0.003,
    "centre_of_mass[1]": -0.002,
    "linear_drag": 0.16,
    "laboratory.motion_capture.position_noise": 0.001,
    "laboratory.motion_capture.attitude_noise": 0.004,
}
# Cameras show the vehicle 10 ms late, and the command of a row of flight.csv was held over the 20 ms before it.
LATE = 0.01 - 0.02


def flown(scenario: Scenario, sample: int = 0) -> FlightRecord:
    """The record of a simulated flight, as its flight.csv has it."""
    (flight,) = simulate_samples(scenario, [sample], compiled=True)
    seen = flight.signals["measurement"]
    return FlightRecord(
        f"flight {sample}",
        flight.time,
        position=seen[:, :3],
        attitude=seen[:, 3:6],
        velocity=seen[:, 6:9],
        body_rates=seen[:, 9:],
        rotor_speed_command=flight.signals["rotor_speed_command"],
    )


def test_the_vehicle_that_flew_foresees_its_flight() -> None:
    """Without noise and wind, with its own numbers and its delay, a filter that hardly corrects is right to 0.1 mm."""
    quiet = ("laboratory.motion_capture.position_noise=0", "laboratory.motion_capture.attitude_noise=0")
    scenario = load_scenario(f"{LABORATORY}:nominal", [ROUTE, *OWN, *quiet])
    record = flown(scenario)
    sizes = WindowSizes(length=100, settle=50, warm_up=25)
    windows = cut([record], [record.time > 1.0], sizes)
    outputs = [Output(signal, column) for signal in ("position", "attitude") for column in range(3)]
    vehicle = FlownVehicle(scenario.vehicle, [(DELAY,)], "rotor_speed_command", kind="world")
    predictor = Predictor(vehicle, [record], windows, sizes, outputs, split=4)
    noise = PredictionNoise(np.repeat([1e-4, 1e-4], 3), np.full(6, 1e-3), np.ones(6))
    foreseen = {}
    for delay in (LATE, 0.0):
        gains = predictor.gains(np.array([delay]), noise)
        foreseen[delay] = np.abs(gains.errors[predictor.counted]).max(axis=(0, 2))
    assert np.all(foreseen[LATE] < 1e-4)
    assert np.max(foreseen[0.0]) > 3e-3


@pytest.mark.slow
def test_a_vehicle_is_found_again_in_wind_and_noise() -> None:
    """From a quarter of a minute: each number within 4 standard deviations, and each of them told to a few per cent."""
    record = flown(load_scenario(f"{LABORATORY}:low_wind", [ROUTE, *OWN]))
    found = identify([record], load_scenario(f"{LABORATORY}:low_wind"), share=0.0)
    estimates = found.estimates
    assert set(estimates.names) == set(TRUTH) - {"linear_drag"}
    for name, value, deviation in zip(estimates.names, estimates.values, estimates.deviations, strict=True):
        assert abs(value - TRUTH[name]) < 4.0 * deviation, name
    assert estimates.value("inertia[0]") == pytest.approx(TRUTH["inertia[0]"], rel=0.02)
    assert estimates.value("thrust_factor") == pytest.approx(TRUTH["thrust_factor"], rel=0.01)
    assert estimates.value("rotor_time_constant") == pytest.approx(TRUTH["rotor_time_constant"], rel=0.15)
    assert found.delay is not None
    assert found.delay.value == pytest.approx(LATE, abs=0.004)
    np.testing.assert_allclose(found.noise.measured, np.repeat([0.001, 0.004], 3), rtol=0.1)
    assert set(estimates.not_seen) == {"mass", "drag_factor", "linear_drag", "quadratic_drag"}
    assert "what disturbs" in estimates.not_seen["linear_drag"]


@pytest.mark.slow
def test_what_hover_does_not_tell_is_said() -> None:
    """Without rotors that are told anything, drag has no interval worth the name; the thrust of hover has."""
    hover = "route={kind: hover, position: [0, 0, 1.5], duration: 15}"
    quiet = ("laboratory.motion_capture.position_noise=1e-5", "laboratory.motion_capture.attitude_noise=1e-5")
    record = flown(load_scenario(f"{LABORATORY}:nominal", [hover, *quiet]))
    found = identify([record], load_scenario(f"{LABORATORY}:low_wind"), share=0.0).estimates
    assert "thrust_factor" in found.names
    assert "linear_drag" in found.not_seen
    assert "linear_drag" not in found.names


def crazyflie() -> Scenario:
    """The vehicle of the logs before it is identified: its weighed mass, its layout, and the data sheet's numbers."""
    return load_scenario(
        "diagrams/hover.yaml",
        [
            "nominal.mass=0.027",
            "nominal.layout={kind: x, length: 0.056, width: 0.056, rotor_1_turns: anticlockwise}",
            "nominal.motors={kind: throttle, curve: [0.0, 0.0, 0.14]}",
            "nominal.min_rotor_speed=0",
            "nominal.max_rotor_speed=5000",
            "vehicle.motors={kind: throttle, curve: [0.0, 0.0, 0.14]}",
            "vehicle.body_drag={linear: [0.0147, 0.0147, 0.0128], centre_of_pressure: [0, 0, 0.005]}",
            "vehicle.rotor_time_constant=0.06",
            "vehicle.rotor_time_constant_down=0.07",
        ],
        layers=["diagrams/vehicles/crazyflie.yaml"],
    )


@pytest.mark.slow
def test_the_published_crazyflie_is_found_again() -> None:
    """arXiv 2404.07837, of the same logs by another method: lag, inertia about x and y, thrust curve.

    Of ten stretches that are held out, the interval of each number holds in nine at least.
    """
    logs = sorted(Path("tests/data/crazyflie/arpl").glob("log*"))
    found = identify([read_log(path) for path in logs], crazyflie(), share=0.0)
    estimates = found.estimates
    held = hold_out(found.evidence)
    assert {*estimates.names} | {DELAY} <= held.keys()
    assert min(each.covered for each in held.values()) >= 9
    # Its flights differ: with the error of the mean alone they would hold far less often.
    assert estimates.variation is not None
    elsewhere = estimates.elsewhere()
    assert elsewhere.deviations[0] > 1.5 * estimates.deviations[0]
    lag = 0.5 * (estimates.value("rotor_time_constant") + estimates.value("rotor_time_constant_down"))
    assert lag == pytest.approx(0.072, abs=0.005)
    assert estimates.value("inertia[0]") == pytest.approx(1.029e-5, rel=0.2)
    assert estimates.value("inertia[1]") == pytest.approx(1.105e-5, rel=0.2)
    places = [estimates.names.index(f"motors.curve[{i}]") for i in range(3)]
    covariance = estimates.covariance[np.ix_(places, places)]
    reach = scipy.stats.t.ppf(0.975, estimates.degrees_of_freedom[places].min())  # type: ignore[index]
    for throttle in (0.3, 0.4, 0.5, 0.6, 0.7, 0.85):
        powers = throttle ** np.arange(3.0)
        published, value = powers @ [0.0227, -0.0119, 0.1284], powers @ estimates.values[places]
        assert abs(value - published) < reach * np.sqrt(powers @ covariance @ powers)
        assert value == pytest.approx(published, rel=0.08 if throttle < 0.4 else 0.05)


def test_logs_that_tell_nothing_are_refused() -> None:
    """One sentence each."""
    base = load_scenario(f"{LABORATORY}:low_wind")
    time, zeros = 0.01 * np.arange(2000), np.zeros((2000, 3))
    commands = np.full((2000, 4), 0.5)
    with pytest.raises(InputError, match="no log to identify"):
        identify([], base)
    with pytest.raises(InputError, match="its motors are told"):
        identify([FlightRecord("a", time, attitude=zeros, position=zeros, motor_command=commands)], base)
    with pytest.raises(InputError, match="body_rates and specific_force, or position and attitude"):
        identify([FlightRecord("a", time, position=zeros, rotor_speed_command=200.0 * commands)], base)
    short = FlightRecord(
        "a", time[:200], position=zeros[:200], attitude=zeros[:200], rotor_speed_command=400.0 * commands[:200]
    )
    with pytest.raises(InputError, match="0 stretches of 1.5 s"):
        identify([short], base)
