"""Tests of the measures of a flight, computed from artificial signals."""

import math

import numpy as np
import pytest

from drake_quad import load_scenario
from drake_quad.flight.flight import Flight
from drake_quad.laboratory.metrics import Metrics
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.plan import Plan
from drake_quad.reference.routes import Leg
from drake_quad.replication.measures import EFFORTS, leg_metrics, measures

# The path goes along X and back at a height of 1 m, and takes 16 s; the legs begin at 0, 4, 8 and 12 s.
PATH = minimum_snap([[0.0, 0, 1], [1, 0, 1], [2, 0, 1], [1, 0, 1], [0, 0, 1]], [0.0, 4.0, 8.0, 12.0, 16.0])
PLAN = Plan.with_constant_yaw(PATH, legs=(Leg("rise", 0), Leg("climb", 1), Leg("circle", 2), Leg("straight", 3)))
TIME = 0.02 * np.arange(801)  # s


def flight(crash_time=math.inf, **signals):
    """Return a flight with the given signals, and otherwise the signals of a vehicle at rest."""
    sizes = {"acceleration_command": 3, "wrench": 4, "state": 12, "reference": 11}
    default_signals = {name: np.zeros((len(TIME), size)) for name, size in sizes.items()} | {
        "pd": np.ones((len(TIME), 3))
    }
    metrics = Metrics(*[0.0] * (len(Metrics._fields) - 1), crash_time)
    return Flight(load_scenario("diagrams/hover.yaml"), PLAN, TIME, default_signals | signals, metrics)


def pulses(*heights):
    """Return PD outputs on X and Y that are constant within each second."""
    pd = np.ones((len(TIME), 3))
    pd[:, 0:2] = np.array([(0.6 * height, -0.8 * height) for height in heights])[np.minimum(TIME.astype(int), 15)]
    return flight(pd=pd)


def test_measure_pd_fade_divides_the_last_quarter_by_the_quarter_after_the_rise():
    result = measures(pulses(*[9.0] * 4, *[2.0] * 4, *[7.0] * 4, *[0.5] * 4))
    # The quarters are 200 ticks long, from 4.00 s to 7.98 s and from 12.02 s to 16.00 s.
    assert result["pd_fade"] == pytest.approx(0.25)


def test_measure_pd_return_divides_the_pd_output_after_a_new_segment_by_that_before():
    """Only the segments from 8 and 12 s count. No segment precedes the first, and a climb precedes the second."""
    heights = [1.0] * 16
    heights[3], heights[4] = 50.0, 70.0
    heights[7], heights[11] = 2.0, 4.0
    heights[8], heights[12] = 6.0, 8.0
    assert measures(pulses(*heights))["pd_return"] == pytest.approx(math.sqrt((36.0 + 64.0) / (4.0 + 16.0)))


def test_the_path_error_is_the_distance_to_the_path():
    state = np.zeros((len(TIME), 12))
    state[:, 0] = np.linspace(0.0, 2.0, len(TIME))
    state[:, 1], state[:, 2] = 0.3, 1.4
    assert measures(flight(state=state))["path_error"] == pytest.approx(0.5, abs=1e-5)


def test_efforts_agree_with_their_definitions():
    rng = np.random.default_rng(0)
    command, pd, wrench = (rng.normal(loc=0.3, size=(len(TIME), rows)) for rows in (3, 3, 4))
    result = measures(flight(acceleration_command=command, pd=pd, wrench=wrench))
    for axis, (u, c, torque) in {
        "x": (command[:, 0], pd[:, 0], wrench[:, 2]),
        "y": (command[:, 1], pd[:, 1], wrench[:, 1]),
    }.items():
        expected = {
            "command_mean_square": np.mean(u**2),
            "command_rms": math.sqrt(np.mean(u**2)),
            "command_mean_size": np.mean(np.abs(u)),
            "command_variance": np.mean((u - u.mean()) ** 2),
            "command_peak": np.abs(u).max(),
            "command_step_square": np.mean((u[1:] - u[:-1]) ** 2),
            "command_step_size": np.mean(np.abs(u[1:] - u[:-1])),
            "pd_mean_square": np.mean(c**2),
            "pd_mean_size": np.mean(np.abs(c)),
            "torque_mean_square": np.mean(torque**2),
            "torque_mean_size": np.mean(np.abs(torque)),
        }
        assert expected.keys() == EFFORTS.keys()
        for name, value in expected.items():
            assert result[f"{name}_{axis}"] == pytest.approx(value), name


def test_measures_of_a_crash_are_nan():
    assert all(math.isnan(value) for value in measures(flight(crash_time=3.0)).values())
    assert np.isnan(leg_metrics([flight(crash_time=3.0)])).all()


def test_leg_metrics_are_computed_over_straight_and_curved_legs():
    """The legs from 4 s and 12 s are straight, the leg from 8 s is curved, and the rise is neither."""
    state, command = np.zeros((len(TIME), 12)), np.zeros((len(TIME), 3))
    leg = np.minimum(TIME // 4.0 + (TIME % 4.0 > 3.99), 3).astype(int)
    state[:, 0:3] = np.array([9.0, 0.3, 0.2, 0.4])[leg, np.newaxis] * [1.0, -2.0, 2.0]
    command[:, 0] = 0.01 * (np.arange(len(TIME)) % 2)
    command[:, 1] = -0.02 * (np.arange(len(TIME)) % 2)
    command[leg == 2] *= 5.0
    straight, curved, swing = (values[0] for values in leg_metrics([flight(state=state, acceleration_command=command)]))
    first, last = (leg == 1).sum(), (leg == 3).sum()
    assert straight == pytest.approx(3.0 * math.sqrt((first * 0.09 + last * 0.16) / (first + last)))
    assert curved == pytest.approx(0.6)
    assert swing == pytest.approx(0.03 / 0.02)
