"""How an estimator sees velocity, of made flights whose error of velocity is known."""

import numpy as np
import pytest
from scipy.signal import lfilter

from drake_quad.errors import InputError
from drake_quad.identification.flown_again.estimator import _share, velocity_estimate
from drake_quad.identification.force_identification import linear_drag
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.scenario import load_undesigned

PERIOD, SHARE, DRIFT, TIME = 0.004, 0.08, 0.03, 0.5
GRAVITY, MASS = 9.81, 0.0375


def made(seconds, *, noise=0.0, drift=DRIFT, speed=0.5):
    """A flight along x and back, whose velocity is seen too large, with an Ornstein-Uhlenbeck process beside."""
    random = np.random.default_rng(3)
    time = PERIOD * np.arange(round(seconds / PERIOD))
    decay = np.exp(-PERIOD / TIME)
    steps = drift * np.sqrt(1.0 - decay**2) * random.normal(size=(len(time), 3))
    wanders = lfilter([1.0], [1.0, -decay], steps, axis=0)
    rate = 2.0
    sine, cosine = (np.outer(each, [speed, 0.0, 0.0]) for each in (np.sin(rate * time), np.cos(rate * time)))
    return FlightRecord(
        "made",
        time,
        position=-cosine / rate + noise * random.normal(size=(len(time), 3)),
        velocity=(1.0 + SHARE) * sine + wanders,
        attitude=np.zeros((len(time), 3)),
        thrust_command=np.full(len(time), MASS * GRAVITY),
    )


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_share_drift_and_time_of_a_known_error_come_back(noise):
    found = velocity_estimate(made(240.0, noise=noise))
    assert abs(found.share[0].value - SHARE) < 3.0 * found.share[0].deviation
    assert found.share[0].deviation < 0.02
    assert [share.value for share in found.share[1:]] == [0.0, 0.0]
    # The mean of such a process over 0.1 s; of 240 independent times a deviation is known to 5 %.
    ratio = 0.1 / TIME
    seen = DRIFT * np.sqrt(2.0 * (ratio - 1.0 + np.exp(-ratio))) / ratio
    np.testing.assert_allclose(found.drift, seen, rtol=0.15)
    np.testing.assert_allclose(found.time, TIME, rtol=0.2)


def test_noise_of_the_position_is_no_drift():
    """1 mm in differences over 0.1 s is 14 mm/s, of which little is left."""
    found = velocity_estimate(made(240.0, noise=1e-3, drift=0.0))
    assert found.drift.max() < 3e-3


@pytest.mark.parametrize(("record", "words"), [(made(20.0, speed=0.0), "hovers"), (made(0.4), "is too short")])
def test_a_log_that_does_not_tell_is_refused(record, words):
    base = load_undesigned("diagrams/vehicles/crazyflie.yaml", [f"nominal.mass={MASS}"])
    with pytest.raises(InputError, match=words):
        velocity_estimate(record)
    with pytest.raises(InputError, match=words):
        linear_drag(record, base)


def swinging(amplitude, rate, *, flown=(0.5, 0.4, 0.0), share=(0.1, -0.05, 0.2), seconds=40.0, period=0.01):
    """Return a flight on two axes whose velocity has a scale error and a sinusoidal error.

    Args:
        amplitude: (3,) amplitude of the sinusoidal error, m/s.
        rate: angular frequency of the sinusoidal error, rad/s.
        flown: (3,) amplitude of the true velocity, m/s.
        share: (3,) scale error, relative to the true velocity.
        seconds: duration, s.
        period: sampling period, s.
    """
    time = 3.0 + period * np.arange(round(seconds / period))
    speed = np.stack([size * np.cos(each * time) for size, each in zip(flown, (2.0, 3.1, 1.0), strict=True)], axis=1)
    place = np.stack(
        [size / each * np.sin(each * time) for size, each in zip(flown, (2.0, 3.1, 1.0), strict=True)], axis=1
    )
    swing = np.outer(np.sin(rate * time), amplitude)
    return FlightRecord("swings", time, position=place, velocity=(1.0 + np.array(share)) * speed + swing)


def test_a_sinusoidal_error_is_estimated_with_its_size_and_correlation_time():
    """Averaging over 0.1 s scales it by sin(0.05 ω) / (0.05 ω). Its autocorrelation is 1/e after arccos(1/e) / ω."""
    rate = 7.0
    amplitude = np.array([0.03, 0.05, 0.02])
    found = velocity_estimate(swinging(amplitude, rate))
    np.testing.assert_allclose([share.value for share in found.share], [0.1, -0.05, 0.0], atol=2e-3)
    seen = amplitude / np.sqrt(2.0) * np.sin(0.05 * rate) / (0.05 * rate)
    np.testing.assert_allclose(found.drift, seen, rtol=0.02)
    assert found.time == pytest.approx(np.arccos(1.0 / np.e) / rate, abs=0.011)
    # An axis that was not flown has no scale error, and its uncertainty is that of the other axes.
    flown = [share.deviation for share in found.share[:2]]
    assert found.share[2].deviation == pytest.approx(np.mean(flown))
    # Without a sinusoidal error, the scale errors are exact.
    exact = velocity_estimate(swinging(np.zeros(3), rate))
    np.testing.assert_allclose([share.value for share in exact.share], [0.1, -0.05, 0.0], atol=2e-3)
    assert exact.drift.max() < 1e-3


def test_the_deviation_of_a_share_follows_from_the_scatter_of_half_second_blocks():
    random = np.random.default_rng(8)
    true, off = random.normal(size=(2, 300))
    blocks = np.repeat(np.arange(60), 5)
    share = _share(true, off, blocks)
    slope = np.linalg.lstsq(true[:, None], off, rcond=None)[0][0]
    assert share.value == pytest.approx(slope)
    left = (true * (off - slope * true)).reshape(60, 5).sum(axis=1)
    assert share.deviation == pytest.approx(np.sqrt(60.0 / 59.0 * np.sum(left**2)) / np.sum(true**2))


def test_white_position_noise_does_not_count_as_drift():
    """Position noise of 1 mm adds 14 mm/s to velocities over 0.1 s, and the drift does not contain it."""
    random = np.random.default_rng(9)
    record = swinging(np.array([0.03, 0.03, 0.03]), 7.0)
    noisy = FlightRecord(
        "noisy", record.time, position=record.position + 1e-3 * random.normal(size=(4000, 3)), velocity=record.velocity
    )
    quiet, loud = (velocity_estimate(each).drift for each in (record, noisy))
    np.testing.assert_allclose(loud, quiet, rtol=0.06)


def test_the_first_half_second_of_a_log_is_left_out():
    """An estimator may still be settling then."""
    record = swinging(np.array([0.03, 0.03, 0.03]), 7.0)
    velocity = record.velocity + np.where(record.time < 3.4, 0.5, 0.0)[:, None]
    position = record.position + np.where(record.time < 3.2, 0.1, 0.0)[:, None]
    whole = velocity_estimate(record)
    for signals in (
        {"position": record.position, "velocity": velocity},
        {"position": position, "velocity": record.velocity},
    ):
        settled = velocity_estimate(FlightRecord("settles", record.time, **signals))
        np.testing.assert_allclose(settled.drift, whole.drift, rtol=1e-6)
        np.testing.assert_allclose([s.value for s in settled.share], [s.value for s in whole.share], rtol=1e-9)
