"""Tests of the estimation of logged flights, with a simulated flight as the log."""

import numpy as np
import pytest
from inertial_log import ACCELEROMETER, GYROSCOPE, simulated_log

from drake_quad import InputError
from drake_quad.estimation.covariance import InertialNoise
from drake_quad.identification.logged_estimate import errors_on_board, estimate_logged_flight
from drake_quad.logs.record import FlightRecord

# Noise of the inertial sensors, in SI units.
NOISE = InertialNoise(gyroscope=1e-3, accelerometer=0.01, gyroscope_walk=1e-5, accelerometer_walk=1e-4)
POSITION_NOISE = 0.003  # m


@pytest.fixture(scope="module")
def record():
    return simulated_log()


@pytest.mark.slow
def test_the_filter_finds_the_biases_and_its_errors_have_the_estimated_deviations(record):
    estimate = estimate_logged_flight(
        record, num_skipped=1, noise=NOISE, position_noise=POSITION_NOISE, attitude_noise=0.005
    )
    np.testing.assert_allclose(estimate.gyroscope_bias, GYROSCOPE["bias"], atol=0.003)
    np.testing.assert_allclose(estimate.accelerometer_bias, ACCELEROMETER["bias"], atol=0.03)
    settled = estimate.time > 4.0
    assert np.abs(estimate.errors.position[settled] / estimate.deviations[settled, 0:3]).max() < 3.0
    # The readings lag by one tick, 20 ms. The tolerance is a fifth of a tick.
    assert estimate.lag == pytest.approx(0.02, abs=0.004)


@pytest.mark.slow
def test_fewer_positions_give_larger_errors(record):
    errors = [
        estimate_logged_flight(record, num_skipped=skipped, noise=NOISE, position_noise=POSITION_NOISE).errors
        for skipped in (0, 24)
    ]
    settled = np.arange(len(record.time) - 1) > 200
    every_position, few_positions = (each.root_mean_squares(settled[: len(each.tilt)]) for each in errors)
    assert every_position[0] < few_positions[0]
    assert every_position[1] < few_positions[1]


def test_the_lag_of_an_estimate_from_on_board_is_removed(record):
    delayed = FlightRecord("late", record.time + 0.03, position=record.position + 0.002, attitude=record.attitude)
    errors, is_flying, lag = errors_on_board(record, delayed)
    assert lag == pytest.approx(0.03, abs=0.002)
    assert errors.root_mean_squares(is_flying)[0] == pytest.approx(0.002 * np.sqrt(3.0), rel=0.1)


@pytest.mark.parametrize("missing", ["position", "attitude", "body_rates", "specific_force"])
def test_a_log_without_a_required_signal_is_refused(record, missing):
    signals = {name: values for name, values in record.signals() if name != missing}
    with pytest.raises(InputError, match=f"does not contain {missing}, which an estimate needs"):
        estimate_logged_flight(FlightRecord("short", record.time, **signals))
