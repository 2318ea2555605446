import numpy as np
import pytest

from drake_quad.reference.binding import bindings
from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.path_problem import Box, Limits
from drake_quad.reference.time_allocation import stretch_factor

RISE = minimum_snap([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]], [1.0, 3.0])


def test_the_top_speed_of_a_single_segment_binds_in_its_middle():
    limits = Limits(speed=2.1875)
    path = RISE.stretched(stretch_factor(RISE, limits))
    (binding,) = bindings(path, limits)
    assert (binding.what, binding.where, binding.segment) == ("speed", "", 0)
    assert binding.time == pytest.approx(2.0, abs=1e-6)


def test_both_acceleration_and_braking_bind():
    limits = Limits(speed=100.0, acceleration=1.0)
    path = RISE.stretched(stretch_factor(RISE, limits))
    found = bindings(path, limits)
    assert [binding.what for binding in found] == ["acceleration"] * 2
    middle = path.times.mean()
    np.testing.assert_allclose(middle - found[0].time, found[1].time - middle, atol=1e-6)


def test_a_wall_that_is_touched_between_the_waypoints_binds():
    path = minimum_snap([[0.0, 0.0], [1.0, 1.0], [2.0, 0.0]], [0.0, 1.0, 2.0])
    top = Box([-1.0, -1.0], [3.0, 1.0])
    found = bindings(path, Limits(), (top, None))
    # Turns back right at the waypoint, which is on both segments; the corridor is that of the first only.
    assert all((binding.what, binding.where) == ("corridor", "y max") for binding in found)
    assert bindings(path, Limits(), (Box([-1.0, -1.0], [3.0, 1.1]), None)) == []


def test_nothing_binds_below_the_limits():
    assert bindings(RISE, Limits(10.0, 10.0), (None,)) == []
