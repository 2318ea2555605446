"""Tests of the check that the rotors can fly a path."""

import numpy as np
import pytest

from drake_quad.errors import InputError
from drake_quad.flight.mission import plan_route
from drake_quad.planning.feasibility import plan_demand
from drake_quad.reference.feasibility import first_violation, sample_times
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.plan import Plan
from drake_quad.scenario.files.loading import load_scenario
from drake_quad.vehicle.parameters import QuadrotorParameters

PAPER_VEHICLE = QuadrotorParameters()  # vehicle of Kayacan and Maslim (2016)
CLIMBING_PATH = minimum_snap([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]], [0.0, 2.0])  # 1 m upwards in 2 s


def check(path, **limits):
    limits = {"min_rotor_speed": 60.0, "max_rotor_speed": 300.0, **limits}
    times = sample_times(path)
    return first_violation(
        times, np.array(plan_demand(Plan.with_constant_yaw(path), PAPER_VEHICLE, times).rotor_speed), **limits
    )


def test_a_climb_violates_the_rotor_limit_where_its_acceleration_is_too_large():
    """In vertical flight, the rotor speeds are √(m (g + a) / 4b), so their limit also limits the acceleration."""
    assert check(CLIMBING_PATH) is None
    peak = 7.51319 * 1.0 / 2.0**2
    speed = np.sqrt(0.68 * (9.81 + 0.99 * peak) / (4.0 * 4.13e-5))
    violation = check(CLIMBING_PATH, max_rotor_speed=speed)
    # The acceleration of a rest-to-rest segment peaks at s = (5 - √5) / 10.
    assert violation.time == pytest.approx(2.0 * (5.0 - np.sqrt(5.0)) / 10.0, abs=0.05)
    assert violation.rotor == 1
    assert violation.speed > speed == violation.limit
    assert check(CLIMBING_PATH, max_rotor_speed=1.01 * speed) is None


def test_a_rotor_speed_below_the_idle_speed_is_a_violation():
    violation = check(CLIMBING_PATH, min_rotor_speed=190.0)
    assert violation.speed < 190.0
    assert violation.time > 1.0
    assert "rotor 1 would have to turn at" in str(violation)


def test_the_first_violation_has_the_earliest_time_and_the_lowest_rotor_number():
    times, speeds = np.array([0.0, 0.5, 1.0]), np.full((4, 3), 100.0)
    speeds[2, 1], speeds[3, 1], speeds[0, 2] = 250.0, 40.0, 300.0
    limits = {"min_rotor_speed": 50.0, "max_rotor_speed": 200.0}
    assert first_violation(times, speeds, **limits) == (0.5, 3, 250.0, 200.0)
    speeds[2, 1] = 100.0
    assert first_violation(times, speeds, **limits) == (0.5, 4, 40.0, 50.0)
    assert first_violation(times, np.full((4, 3), 50.0), **limits) is None
    assert first_violation(times, np.full((4, 3), 200.0), **limits) is None


def test_short_segments_have_as_many_samples_as_long_ones():
    times = sample_times(minimum_snap([[0.0], [1.0], [2.0]], [1.0, 1.1, 9.0]))
    assert (times[0], times[-1]) == (1.0, 9.0)
    assert (np.diff(times) >= 0.0).all()
    for start, end in ((1.0, 1.1), (1.1, 9.0)):
        within = times[(times >= start) & (times <= end)]
        np.testing.assert_allclose(np.diff(within).max(), (end - start) / 63.0)


def test_a_route_that_the_rotors_cannot_fly_is_rejected(diagrams):
    scenario = load_scenario(diagrams / "figure_eight.yaml", ["route.top_acceleration=40", "route.top_speed=50"])
    with pytest.raises(
        InputError, match=r"cannot fly this route: at \d+\.\d+ s rotor \d would have to turn at \d+ rad/s"
    ):
        plan_route(scenario)
