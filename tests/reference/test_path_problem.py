"""Tests of path problems: their properties, and the checks of their input."""

import math

import numpy as np
import pytest

from drake_quad.errors import InputError
from drake_quad.reference.path_problem import Box, PathLimits, PathProblem, Sphere

WAYPOINTS = [Box.point(point) for point in ([0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 2.0, 0.0])]  # m

VELOCITY_ALONG_X = np.zeros((3, 3, 3))
VELOCITY_ALONG_X[1, 1] = [2.0, 0.0, 0.0]

PARTLY_GIVEN_VELOCITY = np.zeros((3, 3, 3))
PARTLY_GIVEN_VELOCITY[1, 0, 1] = np.nan


VELOCITY_ALONG_Y = np.zeros((3, 3, 3))
VELOCITY_ALONG_Y[1, 0] = [0.0, 3.0, 0.0]


def square_box(low, high):
    return Box(low, high)


def test_properties_of_a_box_agree_with_its_corners():
    box = Box([0.0, -2.0], [4.0, 1.0])
    np.testing.assert_array_equal(box.centre, [2.0, -0.5])
    np.testing.assert_array_equal(box.nearest(np.array([5.0, 0.0])), [4.0, 0.0])
    np.testing.assert_array_equal(box.nearest(np.array([1.0, -3.0])), [1.0, -2.0])
    assert box.equals(Box([0.0, -2.0], [4.0, 1.0]))
    assert not box.equals(Box([0.0, -2.0], [4.0, 2.0]))
    assert not box.equals(Box([0.0, -1.0], [4.0, 1.0]))
    assert not box.is_point
    assert not Box([0.0, 1.0], [0.0, 2.0]).is_point
    assert Box.point([0.0, 1.0]).is_point
    assert box.intersection(Box([5.0, 0.0], [6.0, 1.0])) is None
    assert str(box) == "the box from (0, -2) to (4, 1)"


def test_the_nearest_point_of_a_sphere_is_on_the_line_to_its_centre():
    sphere = Sphere([1.0, 1.0], 0.5)
    np.testing.assert_allclose(sphere.nearest(np.array([4.0, 5.0])), [1.3, 1.4])
    np.testing.assert_array_equal(sphere.nearest(np.array([1.2, 0.9])), [1.2, 0.9])


def test_a_problem_has_rest_at_both_ends_and_no_limits_by_default():
    problem = PathProblem(WAYPOINTS)
    np.testing.assert_array_equal(np.isnan(problem.derivatives).all(axis=(1, 2)), [False, True, False])
    assert not np.nan_to_num(problem.derivatives).any()
    assert (problem.corridors, problem.limits.by_order, problem.segments) == ((None, None), {}, 2)
    assert problem.is_time_scalable
    assert not PathProblem(WAYPOINTS, derivatives=VELOCITY_ALONG_X).is_time_scalable
    assert PathLimits(acceleration=3.0).by_order == {2: 3.0}
    assert PathLimits(speed=3.0).by_order == {1: 3.0}
    limited = PathProblem(
        WAYPOINTS,
        derivatives=VELOCITY_ALONG_X,
        corridors=[None, square_box([0, 0, 0], [3, 3, 3])],
        limits=PathLimits(4.0),
    )
    unlimited = limited.without_limits()
    assert unlimited.limits.by_order == {}
    assert unlimited.corridors == limited.corridors
    np.testing.assert_array_equal(unlimited.derivatives, VELOCITY_ALONG_X)


def test_the_first_and_the_last_waypoint_belong_to_only_one_corridor():
    corridors = [square_box([-1, -1, -1], [2, 1, 1]), square_box([1, -1, -1], [3, 3, 1])]
    regions = [Box([-5, 0, 0], [5, 0, 0]), WAYPOINTS[1], Box([0, 2, 0], [2.5, 2, 0])]
    problem = PathProblem(regions, corridors=corridors)
    np.testing.assert_array_equal([problem.allowed_box(0).low[0], problem.allowed_box(0).high[0]], [-1.0, 2.0])
    np.testing.assert_array_equal([problem.allowed_box(2).low[0], problem.allowed_box(2).high[0]], [1.0, 2.5])
    np.testing.assert_array_equal(problem.representatives()[[0, 2]], [[0.0, 0.0, 0.0], [1.25, 2.0, 0.0]])


def test_feasible_problems_are_accepted():
    """The examples are a velocity along a flat corridor, a velocity at its limit, and nested regions."""
    flat = square_box([2, 0, 0], [2, 2, 0])
    PathProblem(WAYPOINTS, derivatives=VELOCITY_ALONG_Y, corridors=[None, flat], limits=PathLimits(speed=3.0))
    PathProblem([WAYPOINTS[0], Box([-1e-7, -1, 0], [1e-7, 1, 0]), WAYPOINTS[2]])


def test_a_waypoint_may_lie_in_the_intersection_of_its_region_and_corridors():
    corridors = [square_box([-1, -1, -1], [2.5, 1, 1]), square_box([1, -0.5, -1], [3, 3, 1])]
    problem = PathProblem([WAYPOINTS[0], Box([1, -2, 0], [4, 2, 0]), WAYPOINTS[2]], corridors=corridors)
    np.testing.assert_array_equal(problem.allowed_box(1).low, [1.0, -0.5, 0.0])
    np.testing.assert_array_equal(problem.allowed_box(1).high, [2.5, 1.0, 0.0])
    np.testing.assert_array_equal(problem.representatives()[1], [2.5, 0.0, 0.0])
    free = PathProblem([WAYPOINTS[0], Sphere([1, 1, 1], 0.5), WAYPOINTS[2]])
    assert free.allowed_box(1) is None
    np.testing.assert_array_equal(free.representatives()[1], [1.0, 1.0, 1.0])


def test_a_problem_has_a_closed_form_only_if_it_has_points_and_no_corridors():
    assert PathProblem(WAYPOINTS).has_closed_form_path
    assert not PathProblem(WAYPOINTS, corridors=[None, square_box([0, 0, 0], [3, 3, 3])]).has_closed_form_path
    assert not PathProblem([WAYPOINTS[0], Sphere([1, 1, 1], 0.5)]).has_closed_form_path
    assert not PathProblem([WAYPOINTS[0], Box([2, 0, 0], [2, 1, 0])]).has_closed_form_path


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"waypoints": WAYPOINTS[:1]}, "two or more waypoints"),
        ({"waypoints": []}, "two or more waypoints"),
        ({"waypoints": [WAYPOINTS[0], Box.point([1.0])]}, "same dimension"),
        ({"waypoints": [[0.0, 0.0], [1.0, 1.0]]}, "must be a Box .Box.point for a point., a Sphere or a Polytope"),
        (
            {"waypoints": [WAYPOINTS[0], Box.point([1e-7, 0, 0])]},
            "waypoints 0 and 1 are 1e-07 m apart; make them equal",
        ),
        (
            {"waypoints": [WAYPOINTS[0], Box.point([1e150, 0, 0])]},
            "waypoint 1, .* is farther than 100000 m from the origin",
        ),
        ({"derivatives": np.full((3, 3, 3), np.inf)}, "must be finite on all axes or NaN on all axes"),
        ({"derivatives": PARTLY_GIVEN_VELOCITY}, "must be finite on all axes or NaN on all axes"),
        (
            {"derivatives": VELOCITY_ALONG_X, "corridors": [None, square_box([2, 0, 0], [2, 2, 0])]},
            "the derivatives given at waypoint 1 lead out of the corridor of segment 1",
        ),
        (
            {"derivatives": VELOCITY_ALONG_Y, "corridors": [square_box([0, 0, 0], [2, 0, 0]), None]},
            "the derivatives given at waypoint 1 lead out of the corridor of segment 0",
        ),
        ({"corridors": [None]}, "1 corridors for 2 segments"),
        ({"derivatives": np.zeros((2, 3, 3))}, "must have"),
        (
            {"corridors": [square_box([-1, -1, -1], [1.5, 1, 1]), None]},
            r"waypoint 1, \(2, 0, 0\) m, lies outside the corridor of segment 0.*0.5 m apart on x",
        ),
        (
            {"corridors": [square_box([0.5, -1, -1], [3, 1, 1]), None]},
            "waypoint 0, .* lies outside the corridor of segment 0",
        ),
        (
            {"corridors": [square_box([-1, -1, -1], [2, 1, 1]), square_box([2.25, -1, -1], [3, 3, 1])]},
            "corridors of segments 0 and 1 do not overlap: they are 0.25 m apart on x",
        ),
        (
            {
                "waypoints": [WAYPOINTS[0], Sphere([2, 0, 0], 0.2), WAYPOINTS[2]],
                "corridors": [square_box([-1, -1, -1], [3, 3, 1]), square_box([1, 1, -1], [3, 3, 1])],
            },
            "waypoint 1, the sphere of 0.2 m around .* lies outside the corridor of segment 1.*0.8 m apart on y",
        ),
        (
            {
                "waypoints": [WAYPOINTS[0], Sphere([2, 0.5, 0], 0.6), WAYPOINTS[2]],
                "corridors": [square_box([-1, -1, -1], [1.6, 3, 1]), square_box([1.6, 0.95, -1], [3, 3, 1])],
            },
            "waypoint 1, .* has no point where the corridors of segments 0 and 1 overlap",
        ),
        (
            {
                "waypoints": [WAYPOINTS[0], Sphere([2, 0, 0], 0.5), WAYPOINTS[2]],
                "corridors": [None, square_box([2.4, 0.4, 0], [3, 3, 0])],
            },
            r"corridor of segment 1, the box from \(2.4, 0.4, 0\) to \(3, 3, 0\) m$",
        ),
        (
            {
                "waypoints": [Box.point([0, 0, 0, 0]), Box.point([1, 0, 0, 0]), Box.point([2, 0, 0, 0])],
                "corridors": [square_box([-1, 0, 0, 1], [3, 0, 0, 2]), None],
            },
            "waypoint 0, .* they are 1 m apart on axis 3",
        ),
        (
            {"limits": PathLimits(speed=2.0), "derivatives": VELOCITY_ALONG_Y},
            "the velocity at waypoint 1 is 3 m/s, more than the limit of 2 m/s",
        ),
        (
            {"limits": PathLimits(acceleration=1.0), "derivatives": VELOCITY_ALONG_X},
            "the acceleration at waypoint 1 is 2 m/s², more than the limit of 1 m/s²",
        ),
    ],
)
def test_infeasible_problems_are_rejected_with_the_reason(arguments, words):
    with pytest.raises(InputError, match=words):
        PathProblem(**{"waypoints": WAYPOINTS, **arguments})


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: PathLimits(speed=0.0), "the speed limit is 0 m/s, but must be positive"),
        (lambda: PathLimits(acceleration=-1.0), "the acceleration limit is -1"),
        (lambda: PathLimits(speed=math.nan), "the speed limit is nan"),
        (lambda: Box([0, 0], [1, -1]), "is empty"),
        (lambda: Box([0, 0], [1, math.inf]), "not finite"),
        (lambda: Box([-math.inf, 0], [1, 1]), "not finite"),
        (lambda: Box([0, 0], [1]), "two corners of the same dimension"),
        (lambda: Sphere([0, 0], 0.0), "radius of a sphere is 0 m"),
        (lambda: Sphere([0, math.nan], 1.0), "must be finite"),
    ],
)
def test_invalid_parts_of_a_problem_are_rejected(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_the_initial_points_of_a_search_must_include_a_position_for_each_waypoint():
    with pytest.raises(InputError, match=r"the start has the shape \(2, 3\), but must have \(3, 3\)"):
        PathProblem(waypoints=WAYPOINTS, start=np.zeros((2, 3)))
