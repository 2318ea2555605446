"""Tests of the message that explains a missing route: unconnected waypoints and blocking obstacles."""

import pytest

from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.regions import Box
from drake_quad.space.blockage import explain_blockage
from drake_quad.space.shapes import Cuboid
from drake_quad.space.space import Obstacle, Space

# The room is 2 m by 1 m by 1 m. Its bounds keep the clearance of 0.1 m from its walls.
BOUNDS = Box([0.1, 0.1, 0.1], [1.9, 0.9, 0.9])
CLEARANCE_PATTERN = r"with a clearance of 0\.1 m"
LEFT_WAYPOINT = Box.point([0.3, 0.5, 0.5])
MIDDLE_WAYPOINT = Box.point([1.0, 0.5, 0.5])
RIGHT_WAYPOINT = Box.point([1.7, 0.5, 0.5])


def wall(x, low=0.0, high=1.0):
    """Return a wall across the room at x, between the given sides (m) and as high as the room."""
    return Cuboid((x, 0.5 * (low + high), 0.5), size=(0.06, high - low, 1.0))


def explanation_of(walls, waypoints=(LEFT_WAYPOINT, RIGHT_WAYPOINT), corridors=None, bounds=BOUNDS):
    """Return the explanation for a room with some named walls."""
    space = Space(tuple(Obstacle(name, shape) for name, shape in walls.items()), radius=0.07, margin=0.03)
    return explain_blockage(space, bounds, PathProblem(waypoints, corridors=corridors))


# Walls by name, and part of the expected message.
BLOCKED_ROOMS = {
    "one wall": ({"a": wall(1.0)}, "without a, there would be a route"),
    "one of two walls, since the other has a gap": (
        {"a": wall(0.7, high=0.3), "b": wall(1.3)},
        "without b, there would be",
    ),
    "both of two": ({"a": wall(0.7), "b": wall(1.3)}, "without a and b, there would be a route"),
    "all of three": (
        {"a": wall(0.6), "b": wall(1.0), "c": wall(1.4)},
        "without a, b and c, there would be a route",
    ),
    "either half": (
        {"a": wall(1.0, high=0.5), "b": wall(1.0, low=0.5)},
        "without a, or without b, there would be a route",
    ),
    "two walls and one of two halves": (
        {"a": wall(0.5), "b": wall(0.9), "c": wall(1.3, high=0.45), "d": wall(1.3, low=0.55)},
        "without a, b and d, there would be a route",
    ),
    "a wall and either half of another": (
        {"a": wall(0.7), "b": wall(1.3, high=0.45), "c": wall(1.3, low=0.55)},
        "without a and b, or without a and c, there would be a route",
    ),
}


@pytest.mark.parametrize(("walls", "expected"), BLOCKED_ROOMS.values(), ids=BLOCKED_ROOMS)
def test_the_smallest_sets_of_obstacles_that_block_all_routes_are_named(walls, expected):
    """All sets of one or two obstacles are named. If only larger sets block the routes, one of them is named."""
    message = explanation_of(walls)
    assert message.startswith(
        "there is no route from waypoint 0 to waypoint 1 with a clearance of 0.1 m (radius 0.07 + "
    )
    assert expected in message


def test_the_message_prefers_obstacles_whose_removal_certainly_opens_a_route():
    """Removal of the first wall leaves a gap as wide as the grid spacing, 5 cm, so a route is not certain."""
    sides = {"left": wall(1.3, high=0.375), "right": wall(1.3, low=0.625)}
    message = explanation_of({"a": wall(0.7), **sides})
    assert message.endswith("without a and left, or without a and right, there would be a route")
    # A gap of 30 cm certainly allows a route.
    sides = {"left": wall(1.3, high=0.25), "right": wall(1.3, low=0.75)}
    assert explanation_of({"a": wall(0.7), **sides}).endswith("without a, there would be a route")


def test_a_corridor_between_grid_points_may_contain_a_route():
    """A corridor 2 cm wide contains no grid point."""
    for low, verb in ((0.51, "may"), (0.49, "would")):
        corridor = Box([0.0, low, 0.0], [2.0, low + 0.02, 1.0])
        message = explanation_of({"a": wall(1.0)}, [Box.point([x, low + 0.01, 0.5]) for x in (0.3, 1.7)], [corridor])
        assert message.endswith(f"without a, there {verb} be a route")


def test_a_gap_too_narrow_for_any_grid_is_reported_with_its_width():
    """The gap is 1 mm wide, and the diagonal of a cell of the finest grid is 2 cm √3, which is 3.5 cm."""
    gap = {"left": wall(1.0, high=0.3995), "right": wall(1.0, low=0.6005)}
    message = explanation_of(gap)
    assert message.startswith(
        "no route was found with a clearance of 0.1 m (radius 0.07 + margin 0.03); a route may exist"
    )
    assert message.endswith("through gaps that are narrower than 0.035 m for the centre of mass")
    # A gap that is 5 cm too narrow is always recognised as closed. A gap that is 1 mm too narrow is not.
    assert "there is no route" in explanation_of({"left": wall(1.0, high=0.425), "right": wall(1.0, low=0.575)})


def test_the_blocked_leg_is_named():
    message = explanation_of({"a": wall(1.4)}, (LEFT_WAYPOINT, MIDDLE_WAYPOINT, RIGHT_WAYPOINT))
    assert message.startswith("there is no route from waypoint 1 to waypoint 2 with a clearance of")
    message = explanation_of({"a": wall(0.7)}, (LEFT_WAYPOINT, MIDDLE_WAYPOINT, RIGHT_WAYPOINT))
    assert message.startswith("there is no route from waypoint 0 to waypoint 1 with a clearance of")


def test_two_legs_can_be_blocked_in_combination_although_each_leg_alone_has_a_route():
    """A wall divides the region of the middle waypoint. One leg ends in one part, the next begins in the other part."""
    gate = Box([0.9, 0.2, 0.5], [1.1, 0.8, 0.5])
    across = Cuboid((1.0, 0.5, 0.5), size=(2.0, 0.06, 1.0))
    below, above = Box.point([0.3, 0.2, 0.5]), Box.point([1.7, 0.8, 0.5])
    message = explanation_of({"a": across}, (below, gate, above))
    assert message.startswith("there is no route from waypoint 0 to waypoint 2 with a clearance of")
    assert "without a, there would be a route" in message
    assert "no route was found" in explanation_of({"a": across}, (below, gate, Box.point([1.7, 0.2, 0.5])))


def test_the_message_names_a_corridor_only_if_the_segment_of_this_corridor_is_blocked():
    """The wall leaves a gap outside the corridor, so it blocks only the segment that has the corridor."""
    walls = {"a": wall(1.0, high=0.5)}
    corridor = Box([0.0, 0.0, 0.0], [2.0, 0.5, 1.0])
    waypoints = (Box.point([0.3, 0.3, 0.5]), Box.point([1.7, 0.3, 0.5]), Box.point([0.3, 0.3, 0.5]))
    assert "no route was found" in explanation_of(walls, waypoints)
    message = explanation_of(walls, waypoints, [None, corridor])
    assert message.startswith(
        "there is no route from waypoint 1 to waypoint 2 in the corridor of segment 1 with a clearance of 0.1 m"
    )
    assert message.endswith("without a, there would be a route")
    message = explanation_of(walls, waypoints, [corridor, None])
    assert message.startswith(
        "there is no route from waypoint 0 to waypoint 1 in the corridor of segment 0 with a clearance of 0.1 m"
    )


def test_the_message_names_both_corridors_that_are_blocked_in_combination():
    """The middle waypoint can only be reached on one side of a wall, and only be left on the other side."""
    across = Cuboid((1.0, 0.5, 0.5), size=(1.0, 0.06, 1.0))
    gate = Box([1.0, 0.2, 0.5], [1.0, 0.8, 0.5])
    lower, upper = Box([0.0, 0.0, 0.0], [2.0, 0.5, 1.0]), Box([0.0, 0.5, 0.0], [2.0, 1.0, 1.0])
    waypoints = (Box.point([0.3, 0.2, 0.5]), gate, Box.point([1.7, 0.8, 0.5]))
    message = explanation_of({"a": across}, waypoints, [lower, upper])
    assert message.startswith(
        "there is no route from waypoint 0 to waypoint 2 in the corridors of segments 0 and 1 with a clearance of"
    )
    assert "without a, there would be a route" in message


def test_the_message_names_the_bounds_if_they_alone_block_all_routes():
    """The second waypoint is outside the bounds, so no obstacle is named."""
    message = explanation_of(
        {"a": wall(1.0)}, (LEFT_WAYPOINT, RIGHT_WAYPOINT), bounds=Box([0.1, 0.1, 0.1], [1.2, 0.9, 0.9])
    )
    assert message.startswith("there is no route from waypoint 0 to waypoint 1 with a clearance of 0.1 m")
    assert message.endswith("within the bounds of the space")


@pytest.mark.parametrize("backwards", [False, True])
def test_a_leg_without_a_corridor_may_leave_the_corridor_of_its_neighbour(backwards):
    """A wall closes the room on the left. One leg stays in a corridor on one side, and the other leads around it."""
    corridor = Box([0.0, 0.0, 0.0], [0.7, 0.45, 1.0])
    waypoints = [Box.point([0.3, 0.3, 0.5]), Box.point([0.5, 0.3, 0.5]), Box.point([1.7, 0.3, 0.5])]
    corridors = [corridor, None]
    if backwards:
        waypoints, corridors = waypoints[::-1], corridors[::-1]
    message = explanation_of({"a": wall(1.0, high=0.5)}, waypoints, corridors)
    assert message.startswith("no route was found")


def test_the_message_names_only_the_obstacle_that_blocks_the_way():
    """Only one of ten obstacles blocks the way. Pairs that contain this obstacle are not named."""
    harmless_boxes = {f"b{i}": Cuboid((0.5 + 0.01 * i, 0.15, 0.15), size=(0.02, 0.02, 0.02)) for i in range(9)}
    message = explanation_of({**harmless_boxes, "a": wall(1.0)})
    assert message.endswith("without a, there would be a route")
