"""Tests of the comparison of logged and predicted flights, with logs that this library simulates."""

import math
from dataclasses import replace

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, simulate
from drake_quad.identification.validation.comparison import (
    AXES,
    ErrorStatistics,
    LogComparison,
    compare_with_log,
    flights_to_compare,
    on_route,
)
from drake_quad.identification.validation.reference import LoggedReference, logged_reference
from drake_quad.logs.record import FlightRecord

ROUTE = (
    "route={kind: waypoints, waypoints: [[0, 0, 1], [0.6, 0.2, 1.2], [0, 0.5, 1], [0, 0, 1]], times: [0, 1.5, 3, 4.5],"
    " top_speed: null, top_acceleration: null}"
)
RANDOM_MASS = "vehicle.mass={uniform: {min: 0.6, max: 0.76}}"
REST_DURATION = 2.0  # s, hover before the log


@pytest.fixture(scope="module")
def scenario(diagrams):
    return load_scenario(diagrams / "figure_eight.yaml", [ROUTE])


@pytest.fixture(scope="module")
def uncertain(diagrams):
    return load_scenario(diagrams / "figure_eight.yaml", [ROUTE, RANDOM_MASS])


def record_of(flight, begin=0.0):
    """Return the log of a flight's measurements from time `begin` (s) on. The clock of the log begins at zero."""
    state, reference = flight.record("measurement"), flight.record("reference")
    columns = {
        "position": (state.x, state.y, state.z),
        "velocity": (state.v_x, state.v_y, state.v_z),
        "attitude": (state.roll, state.pitch, state.yaw),
        "body_rates": (state.p, state.q, state.r),
        "reference_position": (reference.x, reference.y, reference.z),
        "reference_velocity": (reference.v_x, reference.v_y, reference.v_z),
    }
    mask = flight.time >= begin
    return FlightRecord(
        "log", flight.time[mask] - begin, **{name: np.column_stack(rows)[mask] for name, rows in columns.items()}
    )


@pytest.fixture(scope="module")
def log_of_flight(scenario):
    """Return the log of a flight whose route is a logged reference after an initial rest, as in a prediction."""
    begun = logged_reference(record_of(simulate(scenario, compiled=True)), rest=REST_DURATION)
    return record_of(simulate(on_route(scenario, begun), compiled=True), REST_DURATION)


def test_error_statistics_are_computed_for_each_axis_and_for_the_distance():
    """Errors of 3 along x and 4 along y give a distance of 5. The statistic `largest` is the 95th percentile."""
    figures = ErrorStatistics.of(np.array([[3.0, 4.0, 0.0], [-3.0, 4.0, 0.0]]))
    np.testing.assert_allclose(figures.rmse, [3.0, 4.0, 0.0, 5.0])
    np.testing.assert_allclose(figures.mean, [0.0, 4.0, 0.0, 5.0])
    np.testing.assert_allclose(figures.largest, [3.0, 4.0, 0.0, 5.0])
    steps = np.zeros((101, 3))
    steps[:, 2] = -np.arange(101.0)
    np.testing.assert_allclose(ErrorStatistics.of(steps).largest, [0.0, 0.0, 95.0, 95.0])


def test_the_true_vehicle_predicts_the_position_errors_of_the_log(scenario, log_of_flight):
    """Predicted and logged errors differ slightly, because the route is only fitted to the logged reference.

    The acceleration of the route is fed forward.
    """
    result = compare_with_log(log_of_flight, scenario, samples=1, rest=REST_DURATION)
    assert result.predicted.shape == (1, *result.logged_error.shape)
    assert np.abs(result.logged_error).max() > 0.02
    np.testing.assert_allclose(result.predicted[0], result.logged_error, atol=1e-3)


def test_errors_are_evaluated_from_the_first_motion_of_the_reference_or_from_the_given_start(scenario, log_of_flight):
    result = compare_with_log(log_of_flight, scenario, samples=1, rest=REST_DURATION)
    distances = np.linalg.norm(log_of_flight.reference_position - log_of_flight.reference_position[0], axis=1)
    first = np.searchsorted(log_of_flight.time, result.time[0])
    assert distances[first] <= 0.01 < distances[first + 1]
    assert result.time[-1] == log_of_flight.time[-1]
    assert compare_with_log(log_of_flight, scenario, samples=1, rest=REST_DURATION, start=2.0).time[0] == pytest.approx(
        2.0, abs=0.02
    )
    with pytest.raises(InputError, match="the log 'log' has fewer than two samples to compare from 99 s on"):
        compare_with_log(log_of_flight, scenario, samples=1, start=99.0)


def test_samples_equal_those_of_a_study_for_any_batch_size(uncertain, log_of_flight, monkeypatch):
    monkeypatch.setattr("drake_quad.identification.validation.comparison._BATCH_SIZE", 3)
    reports = []
    result = compare_with_log(
        log_of_flight, uncertain, samples=7, rest=REST_DURATION, progress=lambda *done: reports.append(done)
    )
    assert reports == [(3, 7), (6, 7), (7, 7)]
    for sample in (0, 4, 6):
        flight = simulate(result.scenario, sample=sample, compiled=True)
        z = np.interp(result.time + REST_DURATION, flight.time, flight.record("measurement").z)
        np.testing.assert_allclose(result.target[:, 2] - result.predicted[sample, :, 2], z, atol=1e-9)
    heights = result.predicted[:, -1, 2]
    assert len(np.unique(heights)) == 7
    assert result.varies


def test_flights_without_random_parameters_do_not_vary(scenario, log_of_flight):
    assert not compare_with_log(log_of_flight, scenario, samples=3, rest=REST_DURATION).varies


def test_the_log_of_a_sample_is_within_the_predicted_interval_and_that_of_another_vehicle_outside(
    scenario, uncertain, log_of_flight
):
    result = compare_with_log(log_of_flight, uncertain, samples=40, rest=REST_DURATION)
    assert result.within("rmse")[[2, 3]].all()
    median, low, high = result.interval("rmse")
    assert (low <= median).all()
    assert (median <= high).all()
    heavy = scenario.model_copy(update={"vehicle": scenario.vehicle.model_copy(update={"mass": 0.95})})
    log = record_of(simulate(on_route(heavy, result.reference), compiled=True), REST_DURATION)
    assert not compare_with_log(log, uncertain, samples=40, rest=REST_DURATION).within("rmse")[3]


def comparison_of(logged_error, predicted):
    """Return a comparison that contains only errors."""
    nothing = LoggedReference(None, 0.0, 0.0, 0.0)
    time = np.arange(float(len(logged_error)))
    return LogComparison(None, None, nothing, None, time, np.zeros_like(logged_error), logged_error, predicted)


def test_a_crash_is_an_infinite_error():
    errors = np.ones((40, 5, 3)) * np.arange(1.0, 41.0)[:, None, None]
    errors[:2, 3:] = np.nan
    result = comparison_of(np.full((5, 3), 20.0), errors)
    assert result.crashes == 2
    median, low, high = result.interval("rmse")
    assert (low[0], high[0]) == (4.0, math.inf)
    assert 20.0 < median[0] < 24.0
    assert result.within("rmse").tolist() == [True] * len(AXES)


def test_the_sample_with_the_median_error_is_chosen():
    errors = np.ones((5, 2, 3)) * np.array([5.0, 1.0, 4.0, 2.0, 3.0])[:, None, None]
    assert comparison_of(np.zeros((2, 3)), errors).median_sample() == 4
    # If the number of samples is even, the sample with the smaller of the two middle errors is chosen.
    assert comparison_of(np.zeros((2, 3)), errors[:4]).median_sample() == 3
    assert comparison_of(np.zeros((2, 3)), errors[:1]).median_sample() == 0
    # The error is the norm over all axes. If several samples have the same error, the first of them is chosen.
    sideways = errors * [1.0, 0.0, 0.0]
    np.testing.assert_array_equal(comparison_of(np.zeros((2, 3)), sideways[[2, 2, 0, 1]]).median_sample(), 0)


def test_metrics_of_a_prediction_cover_the_whole_log(scenario, log_of_flight):
    window = scenario.metrics.model_copy(update={"start": 1.0, "first_lap": 1, "end": 2.0})
    given = scenario.model_copy(update={"metrics": window, "duration": 3.0})
    reference = logged_reference(log_of_flight, rest=REST_DURATION)
    for start in (REST_DURATION, -1.5):
        result = on_route(given, reference._replace(start=start))
        assert (result.metrics.start, result.metrics.first_lap, result.metrics.end) == (max(start, 0.0), None, None)
        assert result.duration is None
        assert result.route is reference.route


def test_flown_and_predicted_flights_share_the_clock_of_the_log(uncertain, log_of_flight):
    result = compare_with_log(log_of_flight, uncertain, samples=3, rest=REST_DURATION)
    flights = flights_to_compare(result)
    assert list(flights) == ["flown", "predicted"]
    log, predicted = flights.values()
    np.testing.assert_array_equal(log["state"][:, :3], log_of_flight.position[: len(log.time)])
    np.testing.assert_array_equal(log["state"][:, 3:6], log_of_flight.attitude[: len(log.time)])
    assert (log.time[0], predicted.time[0]) == (0.0, pytest.approx(0.0, abs=1e-9))
    # The predicted flight is the sample with the median error. Both flights show measured states and the same
    # reference.
    flight = simulate(result.scenario, sample=result.median_sample(), compiled=True)
    np.testing.assert_array_equal(predicted["state"], flight["measurement"][flight.time >= REST_DURATION])
    np.testing.assert_allclose(log["reference"][:, :3], log_of_flight.reference_position[: len(log.time)], atol=1e-3)
    np.testing.assert_allclose(log["reference"][:, 3:6], log_of_flight.reference_velocity[: len(log.time)], atol=1e-2)
    # Rotor speeds that are not logged are replaced by the predicted ones at the same time.
    speeds = np.array([np.interp(log.time + REST_DURATION, flight.time, speed) for speed in flight["rotor_speed"].T]).T
    np.testing.assert_allclose(log["rotor_speed"], speeds)
    assert log["wind"].shape == (len(log.time), 3)
    assert not log["wind"].any()
    assert log.metrics.crash_time == math.inf
    assert np.isnan(log.metrics.rmse)


def test_states_that_are_not_logged_are_shown_at_rest_and_level(uncertain, log_of_flight):
    """Logged rotor speeds are shown unchanged."""
    without_attitude = replace(log_of_flight, attitude=None, body_rates=None)
    result = compare_with_log(without_attitude, uncertain, samples=1, rest=REST_DURATION)
    state = flights_to_compare(result)["flown"]["state"]
    np.testing.assert_array_equal(state[:, :3], log_of_flight.position)
    np.testing.assert_array_equal(state[:, 6:9], log_of_flight.velocity)
    assert not state[:, 3:6].any()
    assert not state[:, 9:].any()
    speeds = np.tile([201.0, 202.0, 203.0, 204.0], (len(log_of_flight.time), 1))
    turning = replace(result, record=replace(without_attitude, rotor_speed=speeds))
    np.testing.assert_array_equal(flights_to_compare(turning)["flown"]["rotor_speed"], speeds)


@pytest.mark.slow
def test_a_log_is_replayed_to_its_end_even_if_the_prediction_crashes(scenario, log_of_flight):
    """One predicted vehicle crashes during the log, and another before the log begins."""
    for crash, expected in ((0.05, ["flown", "predicted"]), (1e-9, ["flown"])):
        limits = scenario.crash.model_copy(update={"position_error": crash})
        low_limit_scenario = scenario.model_copy(
            update={"crash": limits, "vehicle": slightly_heavier(scenario.vehicle)}
        )
        actual = compare_with_log(log_of_flight, low_limit_scenario, samples=1, rest=REST_DURATION)
        assert actual.crashes == 1
        flights = flights_to_compare(actual)
        assert list(flights) == expected
        np.testing.assert_array_equal(flights["flown"]["state"][:, :3], log_of_flight.position)


def slightly_heavier(vehicle):
    """Return the vehicle with 1 % more mass, so that it flies slightly lower."""
    return vehicle.model_copy(update={"mass": 1.01 * vehicle.mass})


def test_a_vehicle_without_a_time_step_is_refused(diagrams, log_of_flight):
    continuous = load_scenario(diagrams / "figure_eight.yaml", [ROUTE, "vehicle.time_step=0"])
    with pytest.raises(InputError, match="vehicle.time_step is 0"):
        compare_with_log(log_of_flight, continuous)


def test_a_log_without_positions_is_refused(scenario, log_of_flight):
    with pytest.raises(InputError, match="lacks position; it has reference_position"):
        compare_with_log(
            FlightRecord("a", log_of_flight.time, reference_position=log_of_flight.reference_position), scenario
        )
