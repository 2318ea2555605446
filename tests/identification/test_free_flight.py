"""Tests of the detection of free flight in a log, and of predictions that begin at a take-off."""

from dataclasses import replace

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, simulate
from drake_quad.identification.validation.comparison import compare_with_log
from drake_quad.identification.validation.free_flight import FreeFlight, free_flight
from drake_quad.logs.record import FlightRecord

TIME = 0.01 * np.arange(1000)  # s
# Height of the vehicle, m. The vehicle is in the air from 2 to 8 s, and the ground is at 0.3 m.
HEIGHT = 0.3 + np.interp(TIME, [2.0, 3.0, 7.0, 8.0], [0.0, 1.0, 1.0, 0.0])
REFERENCE = 0.3 + np.interp(TIME, [1.0, 2.0, 6.8, 7.8], [0.0, 1.0, 1.0, 0.0])  # m, reference height
COMMAND = np.where((TIME > 1.0) & (TIME < 9.0), 0.6, 0.0)  # throttle


def record_of(height=HEIGHT, reference=REFERENCE, command=COMMAND):
    nothing = np.zeros_like(height)
    return FlightRecord(
        "log",
        0.01 * np.arange(len(height)),
        position=np.column_stack([nothing, nothing, height]),
        reference_position=np.column_stack([nothing, nothing, reference]),
        motor_command=None if command is None else np.tile(command[:, np.newaxis], (1, 4)),
    )


def test_in_free_flight_vehicle_and_reference_are_25_centimetres_above_the_ground():
    """The vehicle climbs through 0.55 m at 2.25 s, and its reference descends through 0.55 m at 7.55 s."""
    part = free_flight(record_of())
    np.testing.assert_allclose([0.01 * part.first, 0.01 * part.end], [2.25, 7.55], atol=0.011)
    # The vehicle leaves the ground at 2 s.
    assert 0.01 * part.lift_off == pytest.approx(2.0, abs=0.011)


@pytest.mark.parametrize("command", [None, np.full(1000, 0.6), np.zeros(1000)])
def test_a_log_whose_rotors_do_not_idle_at_either_end_is_in_the_air_throughout(command):
    assert free_flight(record_of(command=command)) == FreeFlight(0, 1000, None)


def test_a_log_may_begin_or_end_in_the_air():
    complete = free_flight(record_of())
    landing = free_flight(record_of(HEIGHT[400:], REFERENCE[400:], COMMAND[400:]))
    assert landing == FreeFlight(0, complete.end - 400, None)
    take_off = free_flight(record_of(HEIGHT[:500], REFERENCE[:500], COMMAND[:500]))
    assert take_off == FreeFlight(complete.first, 500, complete.lift_off)


@pytest.mark.parametrize("height", [np.full(1000, 0.3), 0.3 + 0.2 * (HEIGHT - 0.3)])
def test_a_vehicle_that_never_flies_is_refused(height):
    with pytest.raises(
        InputError, match="the vehicle of the log 'log' does not fly: .* never more than 0.25 m above the ground"
    ):
        free_flight(record_of(height))


def test_a_flight_has_at_least_two_samples():
    """Free flight is more than 0.25 m above the ground, which is at 0.3 m."""
    height = np.where((TIME > 2.0) & (TIME < 6.0), 0.55, 0.3)
    for count in (1, 2):
        height[300 : 300 + count] = 0.56
        if count == 2:
            assert free_flight(record_of(height, height)) == FreeFlight(300, 302, 200)
        else:
            with pytest.raises(InputError, match="does not fly"):
                free_flight(record_of(height, height))


@pytest.mark.parametrize("fraction", [0.49, 0.51])
def test_rotors_idle_below_half_of_the_median_command_of_the_samples_in_which_they_turn(fraction):
    """The rotors stand still for most of this log."""
    command = np.where((TIME > 1.0) & (TIME < 5.0), 0.6, 0.0)
    command[[0, -1]] = fraction * 0.6
    part = free_flight(record_of(command=command))
    assert (part == FreeFlight(0, 1000, None)) == (fraction > 0.5)


def test_lift_off_is_where_the_height_above_the_ground_exceeds_three_millimetres():
    height = HEIGHT.copy()
    height[150:200] = 0.3029
    assert free_flight(record_of(height)).lift_off >= 199
    height[150:201] = 0.3031
    assert free_flight(record_of(height)).lift_off == 149


def test_an_estimated_height_that_drifts_on_the_ground_does_not_hide_the_lift_off():
    """The rotors idle for a second, in which the estimated height rises by 2 cm. It stays constant until 2 s."""
    drifted = np.interp(TIME, [0.0, 1.0], [0.0, 0.02])
    result = free_flight(record_of(HEIGHT + drifted))
    assert 0.01 * result.lift_off == pytest.approx(2.0, abs=0.011)


@pytest.fixture(scope="module")
def take_off(diagrams):
    """Return a scenario, and the log of a take-off by setpoints after one second on the ground."""
    route = "route={kind: setpoints, setpoints: [[0, 0.2, 0.1, 0.05, 0], [0.0001, 0.2, 0.1, 0.8, 0],"
    route += " [1.5, 0.7, 0.1, 0.8, 0], [3, 0.7, -0.2, 0.9, 0]], last_hold: 1.5}"
    scenario = load_scenario(diagrams / "figure_eight.yaml", [route])
    flight = simulate(scenario, compiled=True)
    state, reference = flight.record("measurement"), flight.record("reference")
    command = flight["rotor_speed_command"]
    log = FlightRecord(
        "log",
        flight.time,
        position=np.column_stack([state.x, state.y, state.z]),
        reference_position=np.column_stack([reference.x, reference.y, reference.z]),
        rotor_speed_command=command,
    )
    ground = round(1.0 / log.period)

    def prefixed(values, first):
        return np.vstack([np.tile(first, (ground, 1)), values])

    lead = log.period * np.arange(ground)
    return scenario, FlightRecord(
        "log",
        np.append(lead, lead[-1] + log.period + log.time),
        position=prefixed(log.position, log.position[0]),
        reference_position=prefixed(log.reference_position, [0.0, 0.0, 0.0]),
        rotor_speed_command=prefixed(command, np.zeros(4)),
    )


def test_a_flight_with_a_take_off_is_predicted_from_its_lift_off(take_off):
    """The log was flown by the predicted vehicle. The time of the lift-off is known to a few samples only."""
    scenario, record = take_off
    result = compare_with_log(record, scenario, samples=1)
    assert 1.0 < result.time[0] < 1.6
    assert np.abs(result.logged_error).max() > 0.4
    rmse = result.predicted_statistics().rmse[0]
    np.testing.assert_allclose(rmse[:2], result.logged_statistics.rmse[:2], rtol=0.01)
    # If the prediction did not start at the vehicle's position, the error along z would be 2 cm.
    np.testing.assert_allclose(rmse[2], result.logged_statistics.rmse[2], rtol=0.4)
    np.testing.assert_allclose(result.predicted[0][-100:], result.logged_error[-100:], atol=5e-3)


@pytest.mark.slow
def test_the_flown_error_does_not_depend_on_the_rate_at_which_the_reference_is_logged(diagrams):
    """If the reference counted as constant for 0.2 s, a perfect vehicle would seem to have an error of up to 20 cm."""
    scenario = load_scenario(diagrams / "figure_eight.yaml")
    flight = simulate(scenario, compiled=True)
    state, reference = flight.record("measurement"), flight.record("reference")
    record = FlightRecord(
        "log",
        flight.time,
        position=np.column_stack([state.x, state.y, state.z]),
        reference_position=np.column_stack([reference.x, reference.y, reference.z]),
    )
    rows = np.searchsorted(record.time, 0.2 * np.floor(record.time / 0.2 + 1e-9) - 1e-9)
    slow = replace(record, reference_position=record.reference_position[rows], reference_period=0.2)
    fast, result = (compare_with_log(each, scenario, samples=1) for each in (record, slow))
    assert len(result.time) > 0.9 * len(fast.time)
    rows_in_fast = np.searchsorted(fast.time, result.time)
    np.testing.assert_allclose(result.logged_error, fast.logged_error[rows_in_fast], atol=4e-3)
    np.testing.assert_allclose(
        result.predicted_statistics().rmse[0, -1], fast.predicted_statistics().rmse[0, -1], rtol=0.1, atol=1e-3
    )


def test_samples_after_a_landing_are_not_compared(take_off):
    """The rotors are off after the landing, and the setpoint jumps, as in logs of a Crazyflie."""
    scenario, record = take_off
    after = 200
    end = record.time[-1] + record.period * np.arange(1, after + 1)
    landed = replace(
        record,
        time=np.append(record.time, end),
        position=np.vstack([record.position, np.tile([0.7, -0.2, 0.05], (after, 1))]),
        reference_position=np.vstack([record.reference_position, np.zeros((after, 3))]),
        rotor_speed_command=np.vstack([record.rotor_speed_command, np.zeros((after, 4))]),
    )
    result = compare_with_log(landed, scenario, samples=1)
    assert result.time[-1] == record.time[-1]
    np.testing.assert_array_equal(result.logged_error, compare_with_log(record, scenario, samples=1).logged_error)
