"""Tests of the preparation of logs for the forward model: rates, windows, forces and initial noise."""

from dataclasses import replace

import numpy as np
import pytest

from drake_quad import InputError, Scenario, load_scenario
from drake_quad.identification import prepared_logs
from drake_quad.identification.parameters import DELAY
from drake_quad.identification.prediction_errors import FORCE, Output
from drake_quad.identification.prepared_logs import PreparedLogs, initial_noise, prepare, window_blocks
from drake_quad.logs.record import FlightRecord
from drake_quad.scenario.motors import SpeedMotors

POSE, IMU = ("position", "attitude"), ("body_rates", FORCE)
GRAVITY = 9.81  # m/s²


def log_of(seconds: float, *names: str, period: float = 0.01, **signals: np.ndarray) -> FlightRecord:
    """Return an airborne log with constant signals."""
    count = round(seconds / period)
    values = {name: np.zeros((count, 3)) for name in names}
    commands = {"rotor_speed_command": np.full((count, 4), 200.0)}
    return FlightRecord("log", period * np.arange(count), **{**values, **commands, **signals})


@pytest.fixture(scope="module")
def rotors() -> Scenario:
    return load_scenario("laboratory:low_wind")


@pytest.fixture(scope="module")
def attitudes() -> Scenario:
    return load_scenario("neural_fly:still")


@pytest.mark.parametrize(("period", "averaged"), [(0.001, 8), (0.002, 4), (0.004, 2), (0.005, 1), (0.02, 1)])
def test_logs_faster_than_125_hertz_are_averaged(rotors: Scenario, period: float, averaged: int) -> None:
    logs, _ = prepare([log_of(3.0, *POSE, period=period)], rotors)
    assert logs.period == pytest.approx(averaged * period)
    assert logs.averaging_period == (logs.period if averaged > 1 else 0.0)
    assert logs.records[0].motor_command is None
    (flying,) = logs.flying
    assert flying.all()
    assert len(flying) == len(logs.records[0].time)


def sizes_in_seconds(logs: PreparedLogs, *, horizon: bool = False) -> tuple[float, float, float]:
    sizes = logs.predictor((), logs.flying, for_forecast=horizon).sizes
    return tuple(logs.period * samples for samples in sizes)  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("seconds", "signals", "length"),
    [
        (30.0, POSE, 1.25),
        (30.0, IMU, 1.0),
        # There are at least fifteen windows, unless they would be shorter than half a second.
        (12.0, POSE, 0.75),
        (12.0, IMU, 0.75),
        (6.0, POSE, 0.5),
        (20.0, ("velocity", "attitude"), 1.25),
    ],
)
def test_windows_are_as_long_as_the_flight_allows(
    rotors: Scenario, seconds: float, signals: tuple[str, ...], length: float
) -> None:
    """The rotors first follow their commands for 0.4 s, then the filter settles for 0.4 s, then the window begins."""
    logs, _ = prepare([log_of(seconds, *signals)], rotors)
    assert sizes_in_seconds(logs) == pytest.approx((length, 0.4, 0.4))
    assert len(logs.predictor((), logs.flying).windows) == int((seconds - 0.4 - 0.01) / length + 1e-9)


@pytest.mark.parametrize(
    ("seconds", "signals", "length"),
    # A window is at most as long as an eighth of the held-out flight.
    [(30.0, POSE, 0.5), (30.0, IMU, 0.1), (3.2, POSE, 0.4), (1.6, POSE, 0.2), (1.6, IMU, 0.1)],
)
def test_forecasts_last_half_a_second_with_poses_and_a_tenth_without(
    rotors: Scenario, seconds: float, signals: tuple[str, ...], length: float
) -> None:
    logs, _ = prepare([log_of(seconds, *signals)], rotors)
    assert sizes_in_seconds(logs, horizon=True) == pytest.approx((length, min(0.4, length), 0.4))


def test_a_flight_of_three_windows_is_too_short(rotors: Scenario) -> None:
    """Four windows of 0.5 s, and 0.4 s before them, need 2.4 s."""
    enough, _ = prepare([log_of(2.42, *POSE)], rotors)
    assert len(enough.predictor((), enough.flying).windows) == 4
    short, _ = prepare([log_of(2.38, *POSE)], rotors)
    with pytest.raises(InputError, match=r"^the flight in the logs contains only 3 windows of 0.9 s in the air"):
        short.predictor((), short.flying)
    with pytest.raises(InputError, match=r"^the held-out part of the logs contains only 0 windows of .* in the air"):
        enough.predictor((), [np.zeros(len(enough.records[0].time), dtype=bool)], for_forecast=True)


@pytest.mark.parametrize(
    ("period", "split"), [(0.008, 1), (0.01, 1), (0.0104, 1), (0.0106, 2), (0.02, 2), (0.025, 3), (0.05, 5)]
)
def test_the_step_of_the_model_is_at_most_about_a_hundredth_of_a_second(
    rotors: Scenario, period: float, split: int
) -> None:
    logs, _ = prepare([log_of(200 * period, *POSE, period=period)], rotors)
    predictor = logs.predictor((), logs.flying, for_forecast=True)
    assert predictor.split == split
    assert predictor.inputs.period == pytest.approx(period / split)
    # The inputs extend beyond the window by at least a delay of 0.15 s plus one sample.
    assert predictor.inputs.margin * predictor.inputs.period >= 0.15 + period


def test_a_predictor_has_the_given_parameters_and_delay(rotors: Scenario) -> None:
    logs, _ = prepare([log_of(10.0, *POSE)], rotors)
    predictor = logs.predictor(("mass", DELAY), logs.flying)
    assert predictor.model.names == ("mass", DELAY)
    fixed = logs.predictor(("mass",), logs.flying, delay=0.2)
    np.testing.assert_array_equal(fixed.model.delays(np.ones((2, 1))), 0.2)
    assert fixed.inputs.margin * fixed.inputs.period >= 0.2
    assert logs.predictor(("rotor_aerodynamics.climb",), logs.flying).model.scenario.vehicle.rotor_aerodynamics
    # Disturbing forces are along the axes of the body if no poses are logged.
    board, _ = prepare([log_of(10.0, *IMU)], rotors)
    assert (predictor.model.frame, board.predictor((), board.flying).model.frame) == ("world", "body")


@pytest.mark.parametrize(("seconds", "blocks"), [(7.0, 13), (20.0, 15), (61.0, 15), (80.0, 20)])
def test_blocks_last_at_most_four_seconds_and_there_are_at_least_fifteen(
    rotors: Scenario, seconds: float, blocks: int
) -> None:
    """If there are few windows, each window is a block."""
    logs, _ = prepare([log_of(seconds, *POSE)], rotors)
    predictor = logs.predictor((), logs.flying)
    result = window_blocks(predictor)
    assert len(result) == len(predictor.windows)
    assert (result[0], result[-1]) == (0, blocks - 1)
    assert set(np.diff(result)) <= {0, 1}
    # The sizes of blocks differ by at most one window.
    assert np.ptp(np.bincount(result)) <= 1


def test_a_filter_initially_assumes_a_large_disturbance_with_a_short_correlation_time() -> None:
    """The initial noise differs from the noise of usual sensors by less than a factor of ten."""
    signals = ("position", "velocity", "attitude", "body_rates", FORCE)
    noise = initial_noise([Output(name, column) for name in signals for column in range(3)])
    usual = np.repeat([1e-3, 2e-2, 4e-3, 2e-2, 0.3], 3)
    assert np.all(np.abs(np.log10(noise.measured / usual)) < 1.0)
    # The force is a tenth of the weight; a moment-arm error of 1 mm causes the torque.
    assert np.all(noise.disturbance >= [0.1 * GRAVITY] * 3 + [1.0] * 3)
    assert np.all(noise.disturbance < 2.0 * GRAVITY)
    assert np.all(noise.correlation_time < 0.2)


@pytest.fixture
def log_with_residual_force() -> FlightRecord:
    """Return a log with the residual force of a level vehicle with a yaw of 90°."""
    angles = np.tile([0.0, 0.0, 0.5 * np.pi], (50, 1))
    force = np.tile([0.5, -1.0, 2.0], (50, 1))
    command = {"attitude_command": np.zeros((50, 3)), "rotor_speed_command": None}
    return log_of(1.0, period=0.02, attitude=angles, residual_force=force, **command)  # type: ignore[arg-type]


@pytest.mark.parametrize("kind", ["thrust", "share of hover", "share of full thrust"])
def test_a_residual_force_is_converted_with_the_commanded_thrust_from_the_logged_signals(
    attitudes: Scenario, log_with_residual_force: FlightRecord, kind: str
) -> None:
    vehicle = attitudes.vehicle
    fractions = np.linspace(0.3, 0.6, 50)
    k_0, k_1, k_2 = attitudes.nominal.motors.curve
    signals, thrust = {
        "thrust": ({"thrust_command": 40.0 * fractions}, 40.0 * fractions),
        "share of hover": (
            # The thrust fraction is used, and not the thrust factor of the data sheet.
            {"thrust_fraction": fractions, "hover_thrust_fraction": np.full(50, 0.4), "thrust_command": np.ones(50)},
            vehicle.mass * vehicle.gravity * fractions / 0.4,
        ),
        "share of full thrust": ({"thrust_fraction": fractions}, 4.0 * (k_0 + k_1 * fractions + k_2 * fractions**2)),
    }[kind]
    actual = prepared_logs._with_specific_force(replace(log_with_residual_force, **signals), attitudes).specific_force
    assert actual is not None
    expected = np.column_stack([np.full(50, -1.0), np.full(50, -0.5), 2.0 + thrust]) / vehicle.mass
    np.testing.assert_allclose(actual, expected, atol=1e-12)


def test_a_residual_force_is_ignored_if_the_commanded_thrust_is_unknown(
    attitudes: Scenario, log_with_residual_force: FlightRecord
) -> None:
    """A logged thrust fraction determines the commanded thrust only if the nominal vehicle has a thrust curve.

    A logged hover thrust fraction does not determine the commanded thrust.
    """

    def converted(record: FlightRecord, scenario: Scenario = attitudes) -> bool:
        return prepared_logs._with_specific_force(record, scenario) is not record

    fraction = replace(log_with_residual_force, thrust_fraction=np.full(50, 0.4))
    nominal = attitudes.nominal.model_copy(update={"motors": SpeedMotors(kind="speed")})
    assert converted(fraction)
    assert not converted(fraction, attitudes.model_copy(update={"nominal": nominal}))
    assert not converted(log_with_residual_force)
    assert not converted(replace(log_with_residual_force, hover_thrust_fraction=np.full(50, 0.4)))
    # The residual force is also ignored if a specific force is logged, or if no attitude is logged, since the axes of
    # the force are then unknown.
    assert not converted(replace(fraction, specific_force=np.zeros((50, 3))))
    assert not converted(replace(fraction, attitude=None))
    assert not converted(replace(fraction, residual_force=None))


def test_a_log_of_heights_is_modelled_with_a_vehicle_that_stays_level(rotors: Scenario, attitudes: Scenario) -> None:
    """Only the scenario of the model changes. The returned scenario, to which estimates are written, is unchanged."""
    logs, scenario = prepare([log_of(3.0, "position")], rotors)
    assert scenario is rotors
    assert logs.scenario.laboratory.autopilot.models_vehicle
    assert logs.outputs == [Output("position", 2)]
    np.testing.assert_array_equal(logs.records[0].attitude_command, 0.0)
    for signals in (("position", "attitude"), ("body_rates", FORCE)):
        logs, scenario = prepare([log_of(3.0, *signals)], rotors)
        assert logs.scenario is scenario is rotors
    # The response of an autopilot includes the time constants of the rotors.
    update = {"rotor_time_constant_down": 0.09}
    with_two_time_constants = attitudes.model_copy(update={"vehicle": attitudes.vehicle.model_copy(update=update)})
    command = {
        "attitude_command": np.zeros((300, 3)),
        "thrust_fraction": np.full(300, 0.4),
        "rotor_speed_command": None,
    }
    logs, scenario = prepare([log_of(3.0, "attitude", **command)], with_two_time_constants)  # type: ignore[arg-type]
    assert logs.scenario is scenario
    assert scenario.vehicle.rotor_time_constant_down is None
    assert not logs.has_motor_throttles


def test_the_allocation_of_the_firmware_may_come_from_another_scenario(rotors: Scenario) -> None:
    heavy = load_scenario("laboratory:low_wind", ["nominal.thrust_factor=8e-5"])
    wrench = {
        "thrust_command": np.full(300, 6.0),
        "torque_command": np.zeros((300, 3)),
        "rotor_speed_command": None,
    }
    log = log_of(3.0, *POSE, **wrench)  # type: ignore[arg-type]
    for nominal, factor in ((None, rotors.nominal.thrust_factor), (heavy, 8e-5)):
        logs, _ = prepare([log], rotors, nominal)
        np.testing.assert_allclose(logs.records[0].rotor_speed_command, np.sqrt(1.5 / factor))
