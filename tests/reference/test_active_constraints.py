"""Tests of the list of limits and walls that are active along a path."""

import numpy as np
import pytest

from drake_quad.reference.active_constraints import active_constraints
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.path_problem import Box, PathLimits
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.reference.time_allocation import stretch_factor

RISING_PATH = minimum_snap([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]], [1.0, 3.0])  # 2 m upwards from 1 s to 3 s


def test_the_speed_limit_is_active_in_the_middle_of_a_rest_to_rest_segment():
    limits = PathLimits(speed=2.1875)
    path = RISING_PATH.scaled_in_time(stretch_factor(RISING_PATH, limits))
    (binding,) = active_constraints(path, limits)
    assert (binding.quantity, binding.location, binding.segment) == ("speed", "", 0)
    assert binding.time == pytest.approx(2.0, abs=1e-6)


def test_the_acceleration_limit_is_active_when_speeding_up_and_braking():
    limits = PathLimits(speed=100.0, acceleration=1.0)
    path = RISING_PATH.scaled_in_time(stretch_factor(RISING_PATH, limits))
    actual = active_constraints(path, limits)
    assert [binding.quantity for binding in actual] == ["acceleration"] * 2
    middle = path.times.mean()
    np.testing.assert_allclose(middle - actual[0].time, actual[1].time - middle, atol=1e-6)


def test_a_wall_that_is_touched_between_waypoints_is_active():
    path = minimum_snap([[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]], [0.0, 1.0, 2.0])
    top = Box([-1.0, -1.0], [3.0, 1.0])
    actual = active_constraints(path, PathLimits(), (top, None))
    # The path turns back at the waypoint between two segments. Only the first segment has a corridor.
    assert all((binding.quantity, binding.location) == ("corridor", "y max") for binding in actual)
    assert active_constraints(path, PathLimits(), (Box([-1.0, -1.0], [3.0, 1.1]), None)) == []


def test_no_constraint_is_active_on_a_path_below_the_limits():
    assert active_constraints(RISING_PATH, PathLimits(10.0, 10.0), (None,)) == []


def test_active_constraints_are_sorted_by_time_and_name_their_segments():
    """The zigzag starts at 1 s. It turns back at walls on its first and third segments, and is fastest in between."""
    times = [1.0, 2.5, 3.0, 5.0]
    path = minimum_snap([[0.0, 0.0], [0.0, 1.0], [0.0, -1.0], [1.0, 0.0]], times)
    samples = np.linspace(1.0, 5.0, 40_001)
    y, speed = evaluate(path, samples)[1], np.linalg.norm(evaluate(path, samples, 1), axis=0)
    highest, lowest, fastest = int(np.argmax(y)), int(np.argmin(y)), int(np.argmax(speed))
    corridors = tuple(Box([-9.0, y.min()], [9.0, y.max()]) for _ in range(3))
    actual = active_constraints(path, PathLimits(speed=speed.max()), corridors)
    expected = sorted([
        (samples[highest], "corridor", "y max"), (samples[lowest], "corridor", "y min"), (samples[fastest], "speed", "")
    ])  # fmt: skip
    assert [(binding.quantity, binding.location) for binding in actual] == [
        (quantity, location) for _, quantity, location in expected
    ]
    np.testing.assert_allclose([binding.time for binding in actual], [time for time, *_ in expected], atol=1e-3)
    assert [binding.segment for binding in actual] == [0, 1, 2]


@pytest.mark.parametrize(("fraction", "count"), [(0.9995, 1), (1.0008, 1), (1.0015, 0)])
def test_a_limit_is_active_if_the_path_comes_within_a_thousandth_of_it(fraction, count):
    assert len(active_constraints(RISING_PATH, PathLimits(speed=2.1875 * fraction))) == count
    top = minimum_snap([[0.0, 0.0], [0.2, 1.0], [0.3, 0.0]], [0.0, 1.0, 2.2])
    highest = evaluate(top, np.linspace(0.0, 2.2, 22_001))[1].max()
    roof = highest + 2.0 * (fraction - 1.0)
    assert len(active_constraints(top, PathLimits(), [Box([-0.5, roof - 2.0], [1.0, roof])] * 2)) == count
