"""Noise and trim of a log, beside what was put in."""

import numpy as np
import pytest

from drake_quad.identification.hover import delay_by_correlation, trim, white_noise
from drake_quad.identification.logs.record import FlightRecord

RNG = np.random.default_rng(8)
TIME = np.arange(3000) * 0.01
FLYING = (TIME > 8.0) & (TIME < 25.0)


@pytest.fixture(scope="module")
def record():
    def drawn(size):
        return RNG.normal(scale=size, size=(3000, 3))

    moving = np.where(FLYING & (TIME > 15.0), np.sin(TIME - 15.0), 0.0)[:, None]
    attitude = drawn(0.004) + np.array([0.02, -0.01, 0.5])
    attitude[:, 1] += 0.1 * moving[:, 0]
    command = np.roll(0.1 * moving, -12, axis=0) * [0.0, 1.0, 0.0]
    noise = np.where(FLYING[:, None], drawn(0.002), drawn(0.001))
    return FlightRecord(
        "made",
        TIME,
        position=moving * [1.0, 0.0, 0.0] + noise,
        velocity=moving * [1.0, 0.0, 0.0],
        attitude=attitude,
        body_rates=drawn(0.01),
        attitude_command=command,
        thrust_command=np.where(FLYING, 0.3, 0.0),
        torque_command=np.tile([1e-5, -2e-5, 0.0], (3000, 1)) + drawn(1e-6),
    )


def test_white_noise_is_found_at_rest_and_in_flight(record):
    noise = {each.signal: each for each in white_noise(record)}
    assert set(noise) == {"position", "attitude", "body_rates"}
    np.testing.assert_allclose(noise["position"].at_rest, 0.001, rtol=0.15)
    np.testing.assert_allclose(noise["position"].in_flight, 0.002, rtol=0.1)
    np.testing.assert_allclose(noise["attitude"].in_flight, 0.004, rtol=0.1)
    assert noise["attitude"].unit == "rad"


def test_a_log_that_begins_in_the_air_has_nothing_at_rest(record):
    noise = white_noise(record.part(slice(1000, 2300)))[0]
    assert np.isfinite(noise.in_flight).all()


def test_trim_is_the_mean_of_hover(record):
    found = trim(record)
    assert found["mean roll"].value == pytest.approx(0.02, abs=4.0 * found["mean roll"].deviation)
    assert found["mean pitch"].value == pytest.approx(-0.01, abs=1e-3)
    assert found["mean torque about y"].value == pytest.approx(-2e-5, rel=0.02)
    assert found["mean thrust"].value == pytest.approx(0.3)
    assert found["mean roll"].deviation < 5e-4
    moving = (TIME > 15.5) & (TIME < 17.0)
    assert trim(record.part(moving)) == {}


def test_the_attitude_is_behind_its_command(record):
    assert delay_by_correlation(record) == pytest.approx(0.12, abs=0.03)
    bare = FlightRecord("bare", TIME, attitude=record.attitude)
    assert delay_by_correlation(bare) is None
