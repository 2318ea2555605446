"""How an estimator sees velocity, of made flights whose error of velocity is known."""

import numpy as np
import pytest
from scipy.signal import lfilter

from drake_quad.errors import InputError
from drake_quad.identification.flown_again.estimator import velocity_estimate
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
