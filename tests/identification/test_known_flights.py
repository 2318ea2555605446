"""Simulated flights of known vehicles, which are used to check identification."""

import math

import numpy as np
import pytest

from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate
from drake_quad.identification import known_flights
from drake_quad.identification.known_flights import KNOWN, Checked, Task, check_batch, record_of, wandering
from drake_quad.identification.results.vehicle_numbers import number_of
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario.batch import draw_sample, middle_of
from drake_quad.scenario.paths import distributions_in


@pytest.mark.parametrize("kind", KNOWN)
def test_a_known_vehicle_wanders_evenly_in_time_and_never_returns(kind, diagrams):
    known = KNOWN[kind]
    scenario = middle_of(known.flown(diagrams))
    plan = plan_route(scenario)
    times = known.seconds * np.arange(41)
    np.testing.assert_allclose(plan.path.times, times, atol=1e-9)
    places = evaluate(plan.path, times).T
    yaws = evaluate(plan.yaw, times)[0]
    # Positions stay within these distances of a point at a height of 1.5 m, and yaws have both signs.
    for values, centre, size in (
        (*[places[:, 0]], 0.0, 1.2),
        (places[:, 1], 0.0, 1.2),
        (places[:, 2], 1.5, 0.4),
        (yaws, 0.0, 0.5),
    ):
        assert np.abs(values - centre).max() <= size + 1e-9
        assert np.ptp(values) > 1.7 * size
    apart = np.linalg.norm(places[:, None] - places, axis=2)
    assert apart[np.triu_indices(41, 1)].min() > 0.05
    assert {name.partition(".")[0] for name in distributions_in(known.flown(diagrams))} >= {"vehicle"}
    begun = known.begun_with(diagrams)
    assert number_of(begun, "rotor_time_constant") > 0.0
    assert begun.laboratory.autopilot.kind == scenario.laboratory.autopilot.kind


def test_waypoints_are_whole_millimetres_and_times_whole_microseconds():
    route = wandering(1.0 / 3.0)
    for waypoint in route["waypoints"]:
        for number in (*waypoint["point"], waypoint["yaw"]):
            assert number == round(number, 3)
    assert route["times"][:3] == [0.0, 0.333333, 0.666667]
    assert (route["top_speed"], route["top_acceleration"]) == (None, None)


@pytest.mark.parametrize("kind", KNOWN)
def test_the_log_of_a_flight_has_the_signals_of_a_laboratory(kind, diagrams):
    flight = simulate(middle_of(KNOWN[kind].flown(diagrams, ["duration=0.5"])), compiled=True)
    record = record_of(flight)
    seen = flight["measurement"]
    for name, columns in (
        ("position", slice(0, 3)),
        ("attitude", slice(3, 6)),
        ("velocity", slice(6, 9)),
        ("body_rates", slice(9, 12)),
    ):
        np.testing.assert_array_equal(getattr(record, name), seen[:, columns])
    if kind == "rotors":
        np.testing.assert_array_equal(record.rotor_speed_command, flight["rotor_speed_command"])
        assert record.thrust_share is None
    else:
        target = flight.record("attitude_target")
        np.testing.assert_array_equal(record.attitude_command, np.transpose(target[1:4]))
        # Each of the four rotors gives 14.27 N at full throttle.
        np.testing.assert_allclose(record.thrust_share, target[0] / 57.08)
        assert record.rotor_speed_command is None


@pytest.mark.slow
def test_identified_values_are_paired_with_the_true_ones(diagrams, monkeypatch):
    """Each sample has its own true values."""
    kept = []

    class Found:
        def __init__(self, record):
            kept.append(record)
            self.delay = (0.01, 0.002, 9.0)
            self.estimates = Estimates()

    class Estimates:
        names = ("thrust_factor", "inertia[1]")
        values = np.array([4e-5, 0.007])
        deviations = np.array([1e-6, 1e-4])
        degrees_of_freedom = np.array([9.0, 8.0])

    monkeypatch.setattr(known_flights.rotor_identification, "identify", lambda records, *_, **__: Found(records[0]))
    found = check_batch(Task("rotors", diagrams, ["duration=0.3"], [4, 7]))
    assert list(found) == [4, 7]
    own = KNOWN["rotors"].flown(diagrams, ["duration=0.3"])
    for sample, rows in found.items():
        flown = draw_sample(own, sample)
        assert rows[:2] == [
            Checked("thrust_factor", number_of(flown, "thrust_factor"), 4e-5, 1e-6, 9.0),
            Checked("inertia[1]", number_of(flown, "inertia[1]"), 0.007, 1e-4, 8.0),
        ]
        # Cameras deliver the state one frame of 10 ms late, and the command of a row was held over the 20 ms before.
        frames = flown.laboratory.motion_capture.latency_frames
        assert rows[2].name == known_flights.rotor_identification.DELAY
        assert math.isclose(rows[2].true, 0.01 * (1 + frames) - 0.02)
        assert rows[2][2:] == (0.01, 0.002, 9.0)
    assert len({rows[0].true for rows in found.values()}) == 2
