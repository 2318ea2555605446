"""Tests of planning around obstacles: candidate routes, their corridors, and the choice of a route."""

import math

import numpy as np
import pytest
from rooms import random_room
from test_passage import Boxes

from drake_quad.errors import InputError
from drake_quad.reference.minimum_snap import snap_cost
from drake_quad.reference.path_problem import PathLimits, PathProblem
from drake_quad.reference.planner import FixedTimes, HeuristicTiming, MinimumSnapTiming, MinimumTimeTiming, plan_path
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.reference.regions import Box, Polytope, Sphere
from drake_quad.space import collision_free
from drake_quad.space.collision_free import (
    CollisionFreeRoute,
    check_waypoint_clearance,
    direct_route,
    plan_collision_free_path,
    with_bounds,
    with_corridors,
)
from drake_quad.space.grid import is_near
from drake_quad.space.regions import Regions
from drake_quad.space.shapes import Ball, Cuboid
from drake_quad.space.space import Obstacle, Space

LIMITS = PathLimits(speed=2.0, acceleration=2.0)  # m/s and m/s²
START = Box.point([0.5, 1.0, 1.0])
END = Box.point([3.5, 1.0, 1.0])
BOUNDS = Box([0.0, 0.0, 0.0], [4.0, 2.0, 2.0])  # m, room in which paths are planned


def space_of(*shapes, radius=0.2):
    return Space(tuple(Obstacle(f"solid_{i}", shape) for i, shape in enumerate(shapes)), radius=radius)


def test_adding_bounds_to_a_problem_changes_only_its_corridors():
    corridor = Box([-1.0, 0.5, 0.0], [5.0, 1.5, 3.0])
    derivatives = np.zeros((3, 3, 3))
    problem = PathProblem([START, END, START], derivatives=derivatives, corridors=[None, corridor], limits=LIMITS)
    actual = with_bounds(problem, BOUNDS)
    assert actual.corridors[0].equals(BOUNDS)
    assert actual.corridors[1].equals(Box([0.0, 0.5, 0.0], [4.0, 1.5, 2.0]))
    assert actual.waypoints == problem.waypoints
    assert actual.limits == LIMITS
    np.testing.assert_array_equal(actual.derivatives, derivatives)
    assert with_bounds(problem, None) is problem
    assert direct_route(problem).waypoints.tolist() == [0, 1, 2]


def test_corridors_and_waypoints_outside_the_bounds_are_rejected():
    outer_corridor = Box([0.0, 2.5, 0.0], [4.0, 3.0, 2.0])
    outer_waypoint = Box.point([3.5, 2.6, 1.0])
    with pytest.raises(InputError, match="corridor of segment 1 lies outside the bounds of the space, the box from"):
        with_bounds(
            PathProblem([START, Box([0, 0, 0], [4, 3, 2]), outer_waypoint], corridors=[None, outer_corridor]), BOUNDS
        )
    with pytest.raises(InputError, match=r"waypoint 1, \(3.5, 2.6, 1\) m, lies outside the bounds of the space"):
        with_bounds(PathProblem([START, outer_waypoint]), BOUNDS)


def test_a_waypoint_must_keep_the_clearance():
    space = space_of(Ball((3.5, 1.0, 1.5), radius=0.3), Ball((0.0, 0.0, 9.0)), radius=0.19)
    check_waypoint_clearance(space, PathProblem([START, END]))
    # The path passes a waypoint's region at a free point.
    check_waypoint_clearance(space, PathProblem([START, Box([3.4, 1.0, 1.3], [3.6, 1.0, 1.7])]))
    space_with_larger_clearance = space_of(Ball((0.0, 0.0, 9.0)), Ball((3.5, 1.0, 1.5), radius=0.3), radius=0.21)
    with pytest.raises(
        InputError, match=r"waypoint 1, \(3.5, 1, 1\) m, is 0.2 m from solid_1, but the clearance is 0.21 m"
    ):
        check_waypoint_clearance(space_with_larger_clearance, PathProblem([START, END]))


def test_the_regions_of_a_passage_become_corridors_and_given_waypoints_keep_their_derivatives():
    regions = Boxes(([0, 0, 0], [2, 1, 1]), ([1.5, 0, 0], [4, 1, 1]), ([3, 0, 0], [4, 3, 1]))
    first, middle, last = Box.point([0.2, 0.5, 0.5]), Box.point([3.2, 0.5, 0.5]), Box.point([3.5, 2.5, 0.5])
    derivatives = np.full((3, 3, 3), np.nan)
    derivatives[:, 0] = [[0.0, 0.0, 0.0], [1.0, 0.5, 0.0], [0.1, 0.2, 0.3]]
    corridor = Box([2.5, 0, 0], [4, 3, 0.8])
    problem = PathProblem([first, middle, last], derivatives=derivatives, corridors=[None, corridor], limits=LIMITS)
    route = with_corridors(problem, regions, ((0, 1), (1, 2)))
    assert route.waypoints.tolist() == [0, 2, 4]
    assert [route.problem.waypoints[i] for i in route.waypoints] == [first, middle, last]
    np.testing.assert_array_equal(route.problem.derivatives[route.waypoints], derivatives)
    assert np.isnan(route.problem.derivatives[[1, 3]]).all()
    assert route.problem.limits == LIMITS
    # Each corridor and each transition is a box, given by two of its corners.
    boxes = ([0, 0, 0], [2, 1, 1]), ([1.5, 0, 0], [4, 1, 1]), ([2.5, 0, 0], [4, 1, 0.8]), ([3, 0, 0], [4, 3, 0.8])
    handovers = ([1.5, 0, 0], [2, 1, 1]), ([3, 0, 0], [4, 1, 0.8])
    for actual, (low, high) in zip(
        (*route.problem.corridors, *route.problem.waypoints[1::2]), (*boxes, *handovers), strict=True
    ):
        axes = np.eye(3)
        np.testing.assert_allclose([-actual.support(-axis) for axis in axes], low, atol=1e-9)
        np.testing.assert_allclose([actual.support(axis) for axis in axes], high, atol=1e-9)


def detour(*corners):
    """Return a route through some points between the first and the last waypoint."""
    waypoints = [START, *map(Box.point, corners), END]
    return CollisionFreeRoute(PathProblem(waypoints, limits=LIMITS), np.array([0, len(waypoints) - 1]))


# The straight route has the shortest time and the minimum snap. The other routes pass 0.4 m to 1 m to the side.
DETOURS = [detour([2.0, 1.0 + offset, 1.0]) for offset in (0.5, 1.0, 0.4, 0.6, 0.9)] + [detour()]
# Timing method and limits of the path.
TIMINGS_AND_LIMITS = {
    "heuristic": (HeuristicTiming(), LIMITS),
    "shortest": (MinimumTimeTiming(), LIMITS),
    "least snap": (MinimumSnapTiming(4.0), LIMITS),
    "least snap without limits": (MinimumSnapTiming(4.0), PathLimits()),
    "given times": (FixedTimes((0.0, 4.0)), LIMITS),
    "given times without limits": (FixedTimes((0.0, 4.0)), PathLimits()),
}


@pytest.mark.parametrize(("timing", "limits"), TIMINGS_AND_LIMITS.values(), ids=TIMINGS_AND_LIMITS)
def test_the_best_of_all_routes_is_selected(monkeypatch, timing, limits):
    routes = [
        CollisionFreeRoute(PathProblem(route.problem.waypoints, limits=limits), route.waypoints) for route in DETOURS
    ]
    monkeypatch.setattr(collision_free, "_routes_around", lambda *_: routes)
    path, route = plan_collision_free_path(space_of(), BOUNDS, PathProblem([START, END], limits=limits), timing)
    assert route is routes[-1]
    assert path.duration == plan_path(route.problem, timing).duration
    # If the best route is removed, the next best is selected, regardless of its position in the list.
    for order in ([3, 1, 2, 4, 0], [2, 0, 1, 4], [1, 4, 2], [0, 2]):
        some = [routes[i] for i in order]
        monkeypatch.setattr(collision_free, "_routes_around", lambda *_, some=some: some)
        assert (
            plan_collision_free_path(space_of(), BOUNDS, PathProblem([START, END], limits=limits), timing)[1]
            is routes[2]
        )


def test_routes_that_cannot_be_planned_are_skipped(monkeypatch):
    """A flight of three metres in four seconds needs more than 0.1 m/s²."""
    straight, detour_route = DETOURS[-1], DETOURS[0]
    slow = CollisionFreeRoute(PathProblem([START, END], limits=PathLimits(acceleration=0.1)), np.array([0, 1]))
    monkeypatch.setattr(collision_free, "_routes_around", lambda *_: [slow, detour_route, straight])
    assert plan_collision_free_path(space_of(), BOUNDS, straight.problem, MinimumSnapTiming(4.0))[1] is straight
    monkeypatch.setattr(collision_free, "_routes_around", lambda *_: [slow])
    with pytest.raises(InputError, match="acceleration"):
        plan_collision_free_path(space_of(), BOUNDS, straight.problem, MinimumSnapTiming(4.0))


def test_times_between_given_times_are_proportional_to_the_lengths_of_the_legs():
    """One millimetre is added to each length, so that two waypoints at the same point have different times."""
    corners = [[0.5, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 1.5, 1.0], [3.0, 1.5, 1.0], [3.5, 1.5, 1.0], [3.5, 1.0, 1.0]]
    route = CollisionFreeRoute(PathProblem([Box.point(corner) for corner in corners]), np.array([0, 2, 5]))
    actual = collision_free._timing_for(route, FixedTimes((1.0, 3.0, 6.0)))
    np.testing.assert_allclose(actual.times, [1.0, 2.0, 3.0, 3.0 + 3.0 * 2.001 / 3.003, 6.0 - 3.0 * 0.501 / 3.003, 6.0])
    # Two waypoints at the same point are passed in succession.
    repeated_waypoint = CollisionFreeRoute(PathProblem([START, END, END]), np.array([0, 2]))
    times = collision_free._timing_for(repeated_waypoint, FixedTimes((0.0, 1.0))).times
    assert times[1] < times[2] == 1.0


GATES = {
    "box": Box([2.0, 0.2, 0.3], [2.0, 1.8, 1.7]),
    "sphere": Sphere([2.0, 1.4, 1.0], 0.29),
    "polytope": Polytope.from_box(Box([1.9, 0.2, 0.3], [2.1, 1.8, 1.7])),
}


@pytest.mark.slow
@pytest.mark.parametrize("gate", GATES.values(), ids=GATES)
def test_the_path_passes_a_gate_at_a_free_point(gate):
    """A wall closes the gate except for a gap on the left, which leaves 20 cm for the centre of mass."""
    space = space_of(Cuboid((2.0, 0.65, 1.0), size=(0.2, 1.4, 3.0)))
    problem = PathProblem([START, gate, END], limits=LIMITS)
    path, route = plan_collision_free_path(space, BOUNDS, problem, HeuristicTiming())
    passed_point = evaluate(path, [path.times[route.waypoints[1]]])[:, 0]
    np.testing.assert_allclose(
        passed_point, gate.nearest(passed_point) if not isinstance(gate, Polytope) else passed_point, atol=1e-6
    )
    assert not isinstance(gate, Polytope) or gate.contains(passed_point)
    points = evaluate(path, np.linspace(path.times[0], path.times[-1], 5000)).T
    assert space.nearest(points)[0].min() >= 0.2


@pytest.mark.parametrize("gate", GATES.values(), ids=GATES)
def test_a_gate_without_a_free_point_is_rejected(gate):
    wall = Cuboid((2.0, 1.0, 1.0), size=(0.3, 4.0, 3.0))
    with pytest.raises(
        InputError, match=r"waypoint 1, .* contains no point with a clearance of 0.2 m .*: solid_1 is too near"
    ):
        plan_collision_free_path(
            space_of(Ball((0.1, 0.1, 0.1), radius=0.01), wall),
            BOUNDS,
            PathProblem([START, gate, END]),
            HeuristicTiming(),
        )


@pytest.mark.long
def test_a_path_passes_two_gates_that_a_wall_divides_on_the_same_side_of_the_wall():
    """The shortest routes to and from the gate end on different sides of the wall, so the path leads around its end."""
    space = space_of(Cuboid((2.0, 0.9, 1.0), size=(0.1, 2.6, 4.0)), radius=0.1)
    bounds = Box([0.0, 0.0, 0.3], [4.0, 3.0, 1.7])
    gates = [Sphere(np.array([2.0, centre, 1.0]), 0.75) for centre in (1.0, 0.8)]
    path, route = plan_collision_free_path(
        space, bounds, PathProblem([START, *gates, END], limits=LIMITS), HeuristicTiming()
    )
    points = evaluate(path, np.linspace(path.times[0], path.times[-1], 5000)).T
    assert space.nearest(points)[0].min() >= 0.1
    for gate, passed_point in zip(gates, path.waypoints[route.waypoints[1:-1]], strict=True):
        assert np.linalg.norm(passed_point - gate.centre) <= gate.radius + 1e-6
    # The wall ends at y = 2.2 m.
    assert points[:, 1].max() > 2.3


def test_the_shortest_route_leads_through_the_piece_of_each_gate_on_its_side_of_the_wall():
    """A wall divides two gates. Start and end are on the right side of the wall, at y < 1."""
    space = space_of(Cuboid((2.0, 1.0, 1.0), size=(3.0, 0.1, 2.0)), radius=0.1)
    grid = collision_free.Grid.of(space, BOUNDS, max_points=2000, min_spacing=0.2)
    right, left = ([np.array([[x, y, 1.0]]) for x in (0.2, 1.4, 2.6, 3.8)] for y in (0.4, 1.6))
    problem = PathProblem([Box.point(points[0]) for points in right], limits=LIMITS)
    pieces = [right[:1], [right[1], left[1]], [left[2], right[2]], right[3:]]
    np.testing.assert_array_equal(collision_free._pieces_on_shortest_route(space, problem, grid, pieces), right)


def test_a_gate_with_almost_no_free_point_is_rejected_with_the_reason():
    """Two spheres leave a gap of 2 mm, and 21 points along 1 m have a spacing of 5 cm."""
    gate = Box([2.0, 0.5, 1.0], [2.0, 1.5, 1.0])
    balls = [Ball((2.0, 1.025 + side * (0.201 + 2.0), 1.0), radius=2.0) for side in (-1.0, 1.0)]
    with pytest.raises(InputError, match="contains almost no point with a clearance of 0.2 m"):
        plan_collision_free_path(space_of(*balls), BOUNDS, PathProblem([START, gate, END]), HeuristicTiming())


class RecordingRegions(Regions):
    """Regions that record their instances, the seeds of all regions, and the seeds that were already in a region."""

    instances = []  # noqa: RUF012

    def __init__(self, *arguments):
        super().__init__(*arguments)
        self.seeds, self.redundant_seeds = [], []
        self.instances.append(self)

    def grow(self, seed):
        if self.containing(seed[None]).any():
            self.redundant_seeds.append(seed)
        self.seeds.append(seed)
        return super().grow(seed)


@pytest.mark.long
def test_a_passage_is_selected_among_regions_that_cover_the_free_space(monkeypatch):
    """A waypoint is the seed of a region only if no region contains it yet."""
    monkeypatch.setattr(collision_free, "Regions", RecordingRegions)
    room = random_room(1)
    close_waypoint = room.endpoints[1] + [-0.02, 0.0, 0.0]
    problem = PathProblem([Box.point(position) for position in (*room.endpoints, close_waypoint)], limits=LIMITS)
    plan_collision_free_path(room.space, room.bounds, problem, HeuristicTiming())
    (regions,) = RecordingRegions.instances
    low, high = room.bounds.low, room.bounds.high
    points = np.random.default_rng(0).uniform(low, high, (5000, 3))
    free = points[room.space.nearest(points)[0] >= room.space.clearance + 1e-3]
    assert regions.containing(free).any(axis=0).mean() > 0.9
    np.testing.assert_array_equal(regions.seeds[:2], room.endpoints)
    assert not any(
        (seed == position).all() for seed in regions.redundant_seeds for position in (*room.endpoints, close_waypoint)
    )


def test_only_the_leg_with_a_corridor_has_its_routes_inside_the_corridor(monkeypatch):
    """Routes are searched from both ends of a leg. Two legs without a corridor share the search at their common end."""
    recorded = []

    def route_lengths(grid, positions, clearance, inside=None):
        recorded.append((positions[0].tolist(), inside))
        if len(recorded) == 5:
            raise StopIteration
        return np.zeros(len(grid.points)), np.full(len(grid.points), -1)

    monkeypatch.setattr(collision_free.Grid, "route_lengths", route_lengths)
    waypoints = [Box.point([x, 1.0, 1.0]) for x in (0.5, 1.5, 2.5, 3.5)]
    corridor = Box([2.0, 0.8, 0.8], [4.0, 1.2, 1.2])
    problem = PathProblem(waypoints, corridors=[None, None, corridor], limits=LIMITS)
    with pytest.raises(StopIteration):
        plan_collision_free_path(space_of(), BOUNDS, problem, HeuristicTiming())
    assert [point[0] for point, _ in recorded] == [0.5, 1.5, 2.5, 2.5, 3.5]
    assert [inside is None for _, inside in recorded] == [True, True, True, False, False]
    grid = collision_free.Grid.of(space_of(), BOUNDS, max_points=30_000, min_spacing=0.05)
    for _, inside in recorded[3:]:
        np.testing.assert_array_equal(inside, is_near(corridor, grid.points))


def test_snap_grows_with_the_seventh_power_of_the_speed():
    """Routes are therefore compared by their snap for the same duration."""
    path = plan_path(PathProblem([START, END], limits=LIMITS), HeuristicTiming())
    slower = plan_path(PathProblem([START, END]), FixedTimes((0.0, 2.0 * path.duration)))
    assert math.isclose(snap_cost(path).sum(), 2.0**7 * snap_cost(slower).sum(), rel_tol=1e-6)


def test_a_waypoint_must_keep_the_additional_clearance_that_regions_keep():
    """Regions are 10 µm farther from obstacles than the clearance, and a waypoint must be in one of them."""
    for beyond, is_accepted in ((2e-5, True), (5e-6, False)):
        space = space_of(Ball((3.5, 1.0, 1.7 + beyond), radius=0.5))
        if is_accepted:
            check_waypoint_clearance(space, PathProblem([START, END]))
        else:
            with pytest.raises(InputError, match="waypoint 1"):
                check_waypoint_clearance(space, PathProblem([START, END]))


def test_points_of_a_waypoint_region_are_a_grid_that_spans_it():
    """The 21 points along each axis are the corners of 20 cells."""
    low, high = np.array([1.0, 0.5, 0.2]), np.array([2.0, 2.5, 0.6])
    box = Box(low, high)
    for region in (box, Polytope.from_box(box), Sphere(low, 0.3)):
        points, diagonal = collision_free._points_in(region)
        ends = (low - 0.3, low + 0.3) if isinstance(region, Sphere) else (low, high)
        np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], ends, atol=1e-9)
        assert len(np.unique(points.round(9), axis=0)) == len(points) == 21**3
        assert diagonal == pytest.approx(np.linalg.norm((ends[1] - ends[0]) / 20.0))
    # A flat region has one layer of points, and a point has one point.
    assert len(collision_free._points_in(Box(low, [2.0, 2.5, 0.2]))[0]) == 21**2
    points, diagonal = collision_free._points_in(Box.point(low))
    assert points.tolist() == [low.tolist()]
    assert diagonal == 0.0


def test_free_points_of_a_waypoint_are_sorted_by_distance_from_its_middle():
    """A ball blocks one side of a spherical waypoint. Free points are in sphere and bounds, and away from the ball."""
    sphere = Sphere([3.5, 1.0, 1.0], 0.4)
    space = space_of(Ball((3.5, 1.0, 0.4), radius=0.3))
    bounds = Box([0.0, 0.0, 0.0], [4.0, 1.2, 2.0])
    points_of_start, points_of_sphere = collision_free._free_points(PathProblem([START, sphere]), space, bounds)
    np.testing.assert_array_equal(points_of_start, np.atleast_2d(START.centre).repeat(len(points_of_start), axis=0))
    distances = np.linalg.norm(points_of_sphere - sphere.centre, axis=1)
    assert (np.diff(distances) >= 0.0).all()
    assert 0.35 < distances.max() <= 0.4
    assert is_near(bounds, points_of_sphere).all()
    assert 1.15 < points_of_sphere[:, 1].max() <= 1.2
    assert space.nearest(points_of_sphere)[0].min() >= 0.2


def test_the_estimated_cost_of_a_straight_route_is_exact():
    """There is only one minimum-snap path from rest to rest along a straight segment for each duration."""
    straight = DETOURS[-1]
    timing = MinimumSnapTiming(4.0)
    for limits in (LIMITS, PathLimits()):
        route = CollisionFreeRoute(PathProblem(straight.problem.waypoints, limits=limits), straight.waypoints)
        expected = snap_cost(plan_path(route.problem, timing)).sum()
        assert collision_free._estimated_cost(route, timing) == pytest.approx(expected, rel=1e-6)
    assert (
        collision_free._estimated_cost(straight, MinimumTimeTiming())
        == plan_path(straight.problem, HeuristicTiming()).duration
    )


def test_routes_around_a_pillar_lead_past_both_of_its_sides():
    space = space_of(Cuboid((2.0, 1.1, 1.0), size=(0.4, 0.4, 3.0)))
    routes = collision_free._routes_around(space, BOUNDS, PathProblem([START, END], limits=LIMITS))
    corridors = {
        tuple((*region.offsets, *region.normals.ravel()) for region in route.problem.corridors) for route in routes
    }
    assert len(corridors) == len(routes) > 1
    sides = [np.mean([waypoint.centre[1] for waypoint in route.problem.waypoints[1:-1]]) > 1.1 for route in routes]
    # The route on the right side is shorter.
    assert not sides[0]
    assert any(sides)


def test_a_finer_grid_finds_a_route_that_a_coarse_grid_misses():
    """The gap leaves 1 cm for the centre of mass. It contains no point of the first grid, but one of the second.

    In the room of 1 m by 0.6 m by 0.4 m, the points have a spacing of 5 cm in the first grid and 3 cm in the second.
    """
    bounds = Box([0.0, 0.0, 0.0], [1.0, 0.6, 0.4])
    middle = 0.27
    sides = (
        Cuboid((0.5, middle - 0.055 - 0.5, 0.2), size=(0.02, 1.0, 2.0)),
        Cuboid((0.5, middle + 0.055 + 0.5, 0.2), size=(0.02, 1.0, 2.0)),
    )
    space = space_of(*sides, radius=0.05)
    problem = PathProblem([Box.point([0.2, 0.3, 0.2]), Box.point([0.8, 0.3, 0.2])], limits=LIMITS)
    for max_points, min_spacing, has_point_in_gap in ((30_000, 0.05, False), (400_000, 0.03, True)):
        grid = collision_free.Grid.of(space, bounds, max_points=max_points, min_spacing=min_spacing)
        free = grid.points[grid.nearest >= space.clearance]
        assert (np.abs(free[:, 0] - 0.5) < 0.03).any() == has_point_in_gap
    path, _ = plan_collision_free_path(space, bounds, problem, HeuristicTiming())
    points = evaluate(path, np.linspace(path.times[0], path.times[-1], 5000)).T
    assert space.nearest(points)[0].min() >= space.clearance


def test_candidate_routes_keep_the_additional_clearance_that_regions_keep(monkeypatch):
    """The additional clearance is 10 µm. A route through a point is at least as long as straight lines to both ends."""
    recorded = []
    route_lengths = collision_free.Grid.route_lengths

    def recording_lengths_from(grid, positions, clearance, inside=None):
        recorded.append(clearance)
        return route_lengths(grid, positions, clearance, inside)

    def recording_candidate_regions(regions, routes, points, lengths):
        recorded.append((points, lengths))
        raise StopIteration

    monkeypatch.setattr(collision_free.Grid, "route_lengths", recording_lengths_from)
    monkeypatch.setattr(collision_free, "candidate_regions", recording_candidate_regions)
    space = space_of(Ball((2.0, 1.0, 1.0), radius=0.3))
    with pytest.raises(StopIteration):
        plan_collision_free_path(space, BOUNDS, PathProblem([START, END], limits=LIMITS), HeuristicTiming())
    *clearances, (points, lengths) = recorded
    assert clearances == [space.clearance + 1e-5] * 2
    assert space.nearest(points)[0].min() >= space.clearance + 1e-5
    straight_lengths = sum(np.linalg.norm(points - waypoint.centre, axis=1) for waypoint in (START, END))
    assert (lengths >= straight_lengths - 1e-9).all()
    assert (lengths <= 2.5 * straight_lengths).all()


def test_the_message_distinguishes_blocked_waypoints_from_gaps_between_grid_points():
    """The points in a gate of 1 m have a spacing of 5 cm, so free space may be hidden between two of them."""
    gate = Box([2.0, 0.5, 1.0], [2.0, 1.5, 1.0])
    for short, words in ((0.024, "almost no point"), (0.026, "no point")):
        wall = Cuboid((2.2 - short + 0.1, 1.0, 1.0), size=(0.2, 4.0, 4.0))
        with pytest.raises(InputError, match=f"waypoint 1, .* contains {words} with a clearance of 0.2 m"):
            collision_free._free_points(PathProblem([START, gate, END]), space_of(wall), BOUNDS)


def test_free_points_keep_the_additional_clearance_that_regions_keep():
    for beyond, is_accepted in ((2e-5, True), (5e-6, False)):
        space = space_of(Ball((3.5, 1.0, 1.7 + beyond), radius=0.5))
        problem = PathProblem([START, END])
        if is_accepted:
            assert len(collision_free._free_points(problem, space, BOUNDS)) == 2
        else:
            with pytest.raises(InputError, match="waypoint 1, .* contains almost no point"):
                collision_free._free_points(problem, space, BOUNDS)
