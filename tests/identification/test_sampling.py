"""Commands between samples, clocks that drift, and estimates that depend on the bandwidth of a log."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_quad.identification.evidence import Uncertainty
from drake_quad.identification.logs.consistency import clock_shifts
from drake_quad.identification.logs.record import FlightRecord
from drake_quad.identification.parameters import Parameter
from drake_quad.identification.sampling import (
    SlowFit,
    fast_command_remarks,
    fast_command_share,
    on_one_clock,
    with_bandwidth,
)

PERIOD = 0.01
TIME = PERIOD * np.arange(4000)
# Shift in each part of two seconds, s.
DRIFT = 0.015 * np.where(np.arange(20) % 4 < 2, 1.0, -1.0)


def rolling(shifts, *, lost=()):
    """Return a log that rolls and pitches, whose attitude is shifted in each part of two seconds.

    Args:
        shifts: (20,) by how much the attitude is behind, s.
        lost: signals that are not logged.
    """
    shift = np.repeat(shifts, len(TIME) // 20)

    def angles(time):
        return np.stack([0.3 * np.sin(7.0 * time), 0.2 * np.sin(5.0 * time + 1.0), 0.1 * np.sin(time)], axis=1)

    step = 1e-4
    before, after = (Rotation.from_euler("ZYX", angles(TIME + side * step)[:, ::-1]) for side in (-0.5, 0.5))
    signals = {
        "position": np.zeros((len(TIME), 3)),
        "attitude": angles(TIME - shift),
        "body_rates": (before.inv() * after).as_rotvec() / step,
        "specific_force": np.tile([0.0, 0.0, 9.81], (len(TIME), 1)),
        "motor_command": np.full((len(TIME), 4), 0.5),
    }
    return FlightRecord("rolling", TIME, **{name: each for name, each in signals.items() if name not in lost})


def shifts_of(record):
    return clock_shifts(dict(record.signals()), record.time)


@pytest.mark.parametrize("shift", [0.0, 0.03])
def test_a_constant_shift_is_the_same_in_all_parts(shift):
    """Body rates that lag the attitude have a positive shift, and here the attitude lags the body rates."""
    found = shifts_of(rolling(np.full(20, shift)))
    assert len(found) >= 18
    np.testing.assert_allclose(found, -shift, atol=1e-3)


def test_clocks_that_drift_leave_the_sensors_on_board_alone():
    drifting = rolling(DRIFT)
    np.testing.assert_allclose(np.std(shifts_of(drifting)), np.std(DRIFT), rtol=0.2)
    (kept,), (remark,) = on_one_clock([drifting])
    assert {*kept.names} == {"body_rates", "specific_force", "motor_command"}
    assert kept.period == pytest.approx(0.03)
    assert "not synchronised; position, velocity and attitude are left out" in remark


def test_a_constant_shift_is_no_drift():
    record = rolling(np.full(20, 0.03))
    assert on_one_clock([record]) == ([record], [])


def test_without_an_accelerometer_a_drift_is_only_remarked():
    record = rolling(DRIFT, lost=("specific_force",))
    kept, (remark,) = on_one_clock([record])
    assert kept == [record]
    assert remark.endswith("their clocks are not synchronised")


def test_the_share_of_fast_commands_is_that_of_white_and_of_smooth_commands():
    random = np.random.default_rng(2)
    still = rolling(np.zeros(20))
    white = replace(still, motor_command=0.5 + 0.1 * random.normal(size=(len(TIME), 4)))
    smooth = replace(still, motor_command=0.5 + 0.1 * np.sin(np.outer(TIME, [3.0, 4.0, 5.0, 6.0])))
    assert fast_command_share(white) == pytest.approx(0.5, abs=0.03)
    assert fast_command_share(smooth) < 0.01
    # A thrust that all rotors have in common does not turn the vehicle.
    common = replace(smooth, motor_command=smooth.motor_command + 0.1 * random.normal(size=(len(TIME), 1)))
    assert fast_command_share(common) < 0.01
    assert fast_command_share(replace(still, motor_command=None)) == 0.0
    (remark,) = fast_command_remarks([smooth, white])
    assert remark.startswith(("rolling: 50% of the power", "rolling: 49% of the power"))


def test_an_interval_contains_the_estimate_of_another_bandwidth_if_it_differs_by_more_than_chance():
    """By a difference of 3.5 where variances are 1 and 1.5, the variance grows by 3.5² - 0.5.

    A third of the period distorts by an eighth of the difference.
    """
    parameters = [Parameter("linear_drag", 1.0, 1.0), Parameter("thrust_factor", 1.0, 1.0)]
    own = np.array([[1.0, 0.5], [0.5, 1.0]])
    uncertainty = Uncertainty(own, np.full(2, np.inf), own)
    slow = SlowFit(np.array([4.0, 2.0]), np.array([1.5, 1.5]), 0.03)
    found, (remark,) = with_bandwidth(uncertainty, parameters, np.array([0.5, 1.0]), slow, 0.01)
    expected = 1.0 + 3.5**2 - 0.5 + (3.5 / 8.0) ** 2
    assert found.covariance[0, 0] == pytest.approx(expected)
    assert found.covariance[1, 1] == pytest.approx(1.0 + (1.0 / 8.0) ** 2)
    # Correlations stay.
    assert found.covariance[0, 1] == pytest.approx(0.5 * np.sqrt(expected * (1.0 + 1.0 / 64.0)))
    assert remark == (
        "linear_drag depends on the bandwidth of the log: it is 0.5 at samples of 10 ms, and 4 at 30 ms; the interval"
        " contains both"
    )
