"""Which parts of a record are used, and how it is made coarser."""

import numpy as np
import pytest

from drake_quad.identification.fitting.windows import (
    Cut,
    Window,
    airborne,
    coarser,
    cut,
    held_out,
    pieces,
    steep_remarks,
)
from drake_quad.identification.logs.record import FlightRecord

PERIOD = 0.01


def record(seconds: float = 20.0, **signals: np.ndarray) -> FlightRecord:
    """A record of hover."""
    count = round(seconds / PERIOD)
    command = np.full((count, 4), 0.5)
    return FlightRecord("hover", PERIOD * np.arange(count), **({"motor_command": command} | signals))


def test_a_second_after_take_off_and_before_landing_is_left_out() -> None:
    """Rotors stand still for the first 5 s and the last 5 s; half a second is the mean's, one the margin."""
    command = np.full((2000, 4), 0.5)
    command[:500] = command[1500:] = 0.0
    flying = np.flatnonzero(airborne(record(motor_command=command)))
    assert flying[0] == pytest.approx(600, abs=5)
    assert flying[-1] == pytest.approx(1400, abs=5)
    assert np.all(np.diff(flying) == 1)


def test_a_short_cut_of_the_throttle_is_still_flight() -> None:
    """A quarter of a second without thrust is a manoeuvre."""
    command = np.full((2000, 4), 0.5)
    command[1000:1025] = 0.0
    assert airborne(record(motor_command=command))[900:1100].all()


def test_a_second_around_a_collision_is_left_out() -> None:
    """Five times the weight across the rotors is no flight."""
    force = np.tile([0.0, 0.0, 9.81], (2000, 1))
    force[1000, 0] = 50.0
    flying = airborne(record(specific_force=force))
    assert not flying[900:1101].any()
    assert flying[[899, 1101]].all()


def test_windows_lie_one_after_another_and_none_spans_a_gap() -> None:
    """A gap of 0.1 s after sample 500 begins another piece; what settles must fit, too."""
    base = record(10.0)
    time = base.time + np.where(np.arange(1000) > 500, 0.1, 0.0)
    broken = FlightRecord("gap", time, motor_command=base.motor_command)
    assert pieces(broken)[[500, 501]].tolist() == [0, 1]
    found = cut([broken], [np.ones(1000, dtype=bool)], Cut(length=100, settle=50, warm_up=0))
    assert found == [Window(0, start) for start in (50, 150, 250, 350, 551, 651, 751, 851)]


def test_windows_use_flight_only() -> None:
    """Sample 130 is no flight: no window, nor what settles before it, holds it."""
    usable = np.ones(1000, dtype=bool)
    usable[130] = False
    found = cut([record(10.0)], [usable], Cut(length=100, settle=20, warm_up=0))
    assert [start for _, start in found][:2] == [20, 151]


def test_the_last_third_of_the_flight_is_held_out() -> None:
    """Of 600 samples in the air the last 200."""
    flying = np.zeros(1000, dtype=bool)
    flying[100:700] = True
    assert np.flatnonzero(held_out(flying, 1.0 / 3.0)).tolist() == list(range(500, 700))


def test_angles_wrap_in_a_coarser_record() -> None:
    """The vehicle turns steadily; the mean of angles on both sides of ±180° is not 0°."""
    yaw = 0.7 * PERIOD * np.arange(2000.0)
    angles = np.column_stack([np.zeros(2000), np.zeros(2000), np.arctan2(np.sin(yaw), np.cos(yaw))])
    few = coarser(record(attitude=angles), 4)
    assert few.attitude is not None
    turn = np.exp(1j * (few.attitude[:, 2] - 0.7 * few.time))
    np.testing.assert_allclose(turn, 1.0, atol=1e-9)
    assert np.abs(few.attitude).max() <= np.pi


def test_a_second_around_a_steep_pitch_is_left_out_and_reported() -> None:
    """Roll and yaw are noise near a pitch of 90°."""
    angles = np.zeros((2000, 3))
    angles[1000:1020, 1] = np.radians(-80.0)
    steep = record(attitude=angles)
    flying = airborne(steep)
    assert not flying[900:1120].any()
    assert flying[[899, 1120]].all()
    (sentence,) = steep_remarks([record(), steep])
    assert sentence.startswith("the log 'hover' pitches beyond 75 degrees for 0.2 s, which are left out")


def test_a_coarser_record_has_commands_until_the_next_sample_and_measurements_around_it() -> None:
    """A ramp stays the ramp at its samples; a held command is in the mean over what follows."""
    ramp = np.arange(2000.0)
    tilted = record(motor_command=np.tile(ramp[:, None], 4), specific_force=np.tile(ramp[:, None], 3))
    for step in (4, 5):
        few = coarser(tilted, step)
        samples = few.time / PERIOD
        assert few.specific_force is not None
        assert few.motor_command is not None
        np.testing.assert_allclose(few.specific_force[:, 0], samples, atol=1e-9)
        np.testing.assert_allclose(few.motor_command[:, 0], samples + 0.5 * (step - 1), atol=1e-9)
        np.testing.assert_allclose(np.diff(samples), step, atol=1e-9)
