"""Tests of the simulated flights of known vehicles with which identification is checked."""

import numpy as np
import pytest

from drake_quad.errors import InputError
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate
from drake_quad.identification import synthetic_flights
from drake_quad.identification.results.vehicle_values import vehicle_value
from drake_quad.identification.synthetic_flights import (
    SYNTHETIC_FLIGHTS,
    CheckedParameter,
    CheckTask,
    check_batch,
    random_waypoint_route,
    record_of,
)
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario.batch import draw_sample, median_scenario
from drake_quad.scenario.paths import distributions_in


@pytest.mark.parametrize("kind", SYNTHETIC_FLIGHTS)
def test_the_waypoints_of_a_known_flight_are_equally_spaced_in_time_and_never_repeat(kind, diagrams):
    known = SYNTHETIC_FLIGHTS[kind]
    scenario = median_scenario(known.simulated_scenario(diagrams))
    plan = plan_route(scenario)
    times = known.leg_duration * np.arange(41)
    np.testing.assert_allclose(plan.path.times, times, atol=1e-9)
    positions = evaluate(plan.path, times).T
    yaws = evaluate(plan.yaw, times)[0]
    # Positions stay within these distances from a point at a height of 1.5 m, and yaws have both signs.
    for values, centre, size in (
        (*[positions[:, 0]], 0.0, 1.2),
        (positions[:, 1], 0.0, 1.2),
        (positions[:, 2], 1.5, 0.4),
        (yaws, 0.0, 0.5),
    ):
        assert np.abs(values - centre).max() <= size + 1e-9
        assert np.ptp(values) > 1.7 * size
    distances = np.linalg.norm(positions[:, None] - positions, axis=2)
    assert distances[np.triu_indices(41, 1)].min() > 0.05
    assert {name.partition(".")[0] for name in distributions_in(known.simulated_scenario(diagrams))} >= {"vehicle"}
    initial = known.initial_scenario(diagrams)
    assert vehicle_value(initial, "rotor_time_constant") > 0.0
    assert initial.laboratory.autopilot.kind == scenario.laboratory.autopilot.kind


def test_waypoints_are_whole_millimetres_and_times_whole_microseconds():
    route = random_waypoint_route(1.0 / 3.0)
    for waypoint in route["waypoints"]:
        for number in (*waypoint["point"], waypoint["yaw"]):
            assert number == round(number, 3)
    assert route["times"][:3] == [0.0, 0.333333, 0.666667]
    assert (route["top_speed"], route["top_acceleration"]) == (None, None)


@pytest.mark.parametrize("kind", SYNTHETIC_FLIGHTS)
def test_the_log_of_a_flight_has_the_signals_of_a_laboratory(kind, diagrams):
    known = SYNTHETIC_FLIGHTS[kind]
    flight = simulate(median_scenario(known.simulated_scenario(diagrams, ["duration=0.5"])), compiled=True)
    record = record_of(flight, known.samples_per_row)
    every = slice(None, None, known.samples_per_row)
    pose = np.split(flight["measurement"], 4, axis=1)
    for name, rows in zip(("position", "attitude", "velocity", "body_rates"), pose, strict=True):
        np.testing.assert_array_equal(getattr(record, name), rows[every])
    if kind == "autopilot":
        target = flight["attitude_target"]
        thrust, angles, _ = np.split(target, [1, 4], axis=1)
        np.testing.assert_array_equal(record.attitude_command, angles)
        # Each of the four rotors gives 14.27 N at full throttle.
        np.testing.assert_allclose(record.thrust_fraction[:, None], thrust / 57.08)
        assert record.rotor_speed_command is None
    elif kind == "battery":
        np.testing.assert_array_equal(record.motor_command, flight["throttle_command"])
        # The voltage is below the full voltage by the current times 20 mΩ, and decreases with the charge.
        assert 12.0 < record.battery_voltage.min() < record.battery_voltage.max() < 12.6
        assert record.rotor_speed_command is None
    else:
        np.testing.assert_array_equal(record.rotor_speed_command, flight["rotor_speed_command"][every])
        assert record.thrust_fraction is None
    # A log has a row for each recorded sample by default.
    np.testing.assert_array_equal(record_of(flight).time, flight.time)
    assert record.period == pytest.approx({"slow_log": 0.01}.get(kind, flight.time[1] - flight.time[0]))


@pytest.mark.slow
def test_identified_values_are_paired_with_the_true_ones(diagrams, monkeypatch):
    """Each sample has its own true values, and parameters that are not identified are left out."""

    class Found:
        delay = (0.01, 0.002, "s", 9.0)

        class estimates:  # noqa: N801
            names = ("thrust_factor", "inertia[1]", "linear_drag")
            identified = names[:2]
            values = np.array([4e-5, 0.007, 0.1])
            deviations = np.array([1e-6, 1e-4, 0.1])
            degrees_of_freedom = np.array([9.0, 8.0, 3.0])

    calls = []

    def identify(records, nominal, **options):
        calls.append((records, nominal, options))
        return Found()

    monkeypatch.setattr(synthetic_flights, "identify", identify)
    result = check_batch(CheckTask("wind", diagrams, ["duration=0.3"], [4, 7]))
    assert list(result) == [4, 7]
    scenario = SYNTHETIC_FLIGHTS["wind"].simulated_scenario(diagrams, ["duration=0.3"])
    for sample, rows in result.items():
        true_scenario = draw_sample(scenario, sample)
        thrust, inertia, delay = rows
        assert thrust == CheckedParameter(
            "thrust_factor", vehicle_value(true_scenario, "thrust_factor"), 4e-5, 1e-6, 9.0
        )
        assert inertia == CheckedParameter("inertia[1]", vehicle_value(true_scenario, "inertia[1]"), 0.007, 1e-4, 8.0)
        # Cameras deliver the state one frame (10 ms) late. A row of the log contains the command that was applied
        # during the preceding 20 ms.
        frames = true_scenario.laboratory.motion_capture.latency_frames
        assert delay == CheckedParameter(
            synthetic_flights.DELAY, pytest.approx(0.01 * (1 + frames) - 0.02), 0.01, 0.002, 9.0
        )
    first, second = (rows[0].true for rows in result.values())
    assert first != second
    # Each flight is identified separately and without held-out flight, from the vehicle of the data sheet.
    for (record,), nominal, options in calls:
        assert record.time[-1] == pytest.approx(0.3, abs=0.021)
        assert nominal == SYNTHETIC_FLIGHTS["wind"].initial_scenario(diagrams)
        assert options == {"held_out_fraction": 0.0}


def test_the_identified_log_has_the_sample_rate_of_its_condition(diagrams, monkeypatch):
    """A slow log contains every fifth sample."""
    logs = []

    def identify(records, *_, **__):
        logs.extend(records)
        raise InputError("refused by this test")

    monkeypatch.setattr(synthetic_flights, "identify", identify)
    check_batch(CheckTask("slow_log", diagrams, ["duration=0.1"], [4]))
    assert logs[0].period == pytest.approx(0.01)


def test_a_flight_whose_log_is_refused_gives_no_parameters(diagrams, monkeypatch):
    def refuse(*_, **__):
        raise InputError("refused by this test")

    monkeypatch.setattr(synthetic_flights, "identify", refuse)
    assert check_batch(CheckTask("wind", diagrams, ["duration=0.3"], [4])) == {4: []}
