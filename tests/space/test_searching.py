"""Tests of the parts of the search for a route: grid, regions, chains of regions, and passages."""

import itertools

import numpy as np
import pytest
from rooms import least_distances, random_room
from test_rooms import plan, room_with_wall

from drake_quad.errors import InputError
from drake_quad.reference.planner import HeuristicTiming
from drake_quad.reference.regions import Box, Polytope
from drake_quad.space.grid import Grid
from drake_quad.space.passage import candidate_regions, find_passage, region_chain
from drake_quad.space.regions import MIN_COMMON_RADIUS, SLACK, Regions
from drake_quad.space.shapes import Cuboid
from drake_quad.space.space import Obstacle, Space

WALL_WITH_DOOR = ((2.0, 1.2, 1.0), (0.1, 2.4, 2.0))  # centre and size of a wall, m; the door is beside it


def grid_of(room):
    return Grid.of(room.space, room.bounds, max_points=30_000, min_spacing=0.05)


def test_a_route_over_an_empty_grid_is_nearly_straight():
    bounds = Box([0.0, 0.0, 0.0], [2.0, 1.0, 1.0])
    grid = Grid.of(Space((), radius=0.1), bounds, max_points=30_000, min_spacing=0.05)
    begin, end = np.array([[0.11, 0.12, 0.13]]), np.array([[1.87, 0.12, 0.13]])
    lengths, predecessors = grid.route_lengths(begin, 0.1)
    route = grid.shortest_route(lengths, predecessors, begin, end)
    np.testing.assert_allclose(route[[0, -1]], [begin[0], end[0]])
    assert 1.76 <= np.linalg.norm(np.diff(route, axis=0), axis=1).sum() < 1.8
    corner = np.abs(grid.points - [2.0, 1.0, 1.0]).sum(axis=1).argmin()
    straight = np.linalg.norm(grid.points[corner] - begin[0])
    # Routes in 26 directions are at most 1.13 times as long as a straight line.
    assert straight <= lengths[corner] < 1.14 * straight


def test_there_is_no_route_through_a_wall_or_outside_the_allowed_points():
    closed_room = room_with_wall(((2.0, 1.5, 1.0), (0.1, 3.0, 2.0)))
    begin, end = closed_room.endpoints[:1], closed_room.endpoints[1:]
    grid = grid_of(closed_room)
    lengths, predecessors = grid.route_lengths(begin, closed_room.space.clearance)
    assert grid.shortest_route(lengths, predecessors, begin, end) is None
    door = room_with_wall(WALL_WITH_DOOR)
    grid = grid_of(door)
    lengths, predecessors = grid.route_lengths(begin, door.space.clearance)
    route = grid.shortest_route(lengths, predecessors, begin, end)
    fine = np.concatenate([np.linspace(a, b, 30) for a, b in itertools.pairwise(route)])
    assert least_distances(door.space, fine).min() >= door.space.clearance - 1e-9
    inside = grid.points[:, 1] < 2.0
    lengths, predecessors = grid.route_lengths(begin, door.space.clearance, inside)
    assert grid.shortest_route(lengths, predecessors, begin, end) is None


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_region_contains_its_seed_and_keeps_the_clearance(seed):
    room, random = random_room(seed), np.random.default_rng(seed)
    regions = Regions(room.space, room.bounds)
    grid = grid_of(room)
    regions.cover(grid.points[grid.nearest >= room.space.clearance + 1e-4], random.uniform(size=len(grid.points)))
    points = room.bounds.low + random.uniform(size=(40_000, 3)) * (room.bounds.high - room.bounds.low)
    is_covered = regions.containing(points).any(axis=0)
    assert 0.2 < is_covered.mean() < 1.0
    assert least_distances(room.space, points[is_covered]).min() >= room.space.clearance
    free = points[least_distances(room.space, points) >= room.space.clearance + 1e-3]
    number = regions.grow(free[0])
    assert regions.containing(free[:1], [number])[0, 0]
    # The regions must cover 95 % of the free points.
    assert regions.containing(free).any(axis=0).mean() > 0.9


def test_the_region_chain_covers_the_grid_route_and_the_passage_leads_through_the_door_in_a_wall():
    room = room_with_wall(WALL_WITH_DOOR)
    grid, (begin, end) = grid_of(room), room.endpoints[:, None]
    lengths, predecessors = grid.route_lengths(begin, room.space.clearance)
    lengths_to_end, _ = grid.route_lengths(end, room.space.clearance)
    route = grid.shortest_route(lengths, predecessors, begin, end)
    regions = Regions(room.space, room.bounds)
    numbers = region_chain(regions, route)
    assert regions.containing(route, numbers).any(axis=0).all()
    for first, second in itertools.pairwise(numbers):
        assert regions.intersection(first, second).radius > MIN_COMMON_RADIUS
    candidates = candidate_regions(regions, numbers, grid.points, lengths + lengths_to_end)
    assert set(numbers) <= set(candidates)
    waypoints = [Box.point(endpoint) for endpoint in room.endpoints]
    (leg,) = find_passage(regions, [candidates], waypoints, [None])
    assert regions.containing(begin, [leg[0]]).all()
    assert regions.containing(end, [leg[-1]]).all()
    for first, second in itertools.pairwise(leg):
        assert regions.intersection(first, second) is not None
    closed_corridor = Box([0.0, 0.0, 0.0], [4.0, 1.8, 2.0])
    assert find_passage(regions, [candidates], waypoints, [closed_corridor]) is None


@pytest.mark.long
def test_the_message_names_all_obstacles_that_must_be_removed():
    """Only the removal of all three consecutive walls opens a route. A box next to them is not named."""
    walls = [((x, 1.5, 1.0), (0.1, 3.0, 2.0)) for x in (1.4, 2.0, 2.6)]
    room = room_with_wall(*walls, ((2.0, 2.6, 0.3), (0.4, 0.2, 0.2)))
    with pytest.raises(InputError) as refusal:
        plan(room, HeuristicTiming())
    message = str(refusal.value)
    assert "no route" in message
    assert "without wall_0, wall_1 and wall_2, there would be a route" in message


def test_a_seed_on_the_bounds_is_in_its_region_despite_rounding():
    """Faces are shifted outwards and inwards by the clearance. Rounding errors can move them inside the bounds.

    If a region did not contain its seed, the search would grow regions around this seed indefinitely.
    """
    random = np.random.default_rng(0)
    for _ in range(20):
        low = random.uniform(-2.0, 0.0, 3)
        bounds = Box(low, low + random.uniform(1.0, 3.0, 3))
        regions = Regions(Space((), radius=random.uniform(0.05, 0.2)), bounds)
        corners = np.array(list(itertools.product(*zip(bounds.low, bounds.high, strict=True))))
        regions.cover(corners, np.ones(len(corners)))
        assert len(regions) == 1
        assert regions.containing(corners).all()


def test_a_region_reaches_to_the_bounds_and_to_the_increased_clearance_from_a_wall():
    space = Space((Obstacle("wall", Cuboid((1.5, 0.0, 0.0), size=(1.0, 9.0, 9.0))),), radius=0.2)
    bounds = Box([-1.0, -1.1, -1.2], [2.0, 1.3, 1.4])
    regions = Regions(space, bounds)
    region = regions[regions.grow(np.array([0.3, 0.0, 0.1]))]
    axes = np.eye(3)
    np.testing.assert_allclose([-region.support(-axis) for axis in axes], bounds.low, atol=1e-6)
    np.testing.assert_allclose([region.support(axis) for axis in axes], [1.0 - 0.2 - SLACK, 1.3, 1.4], atol=1e-8)


def test_a_region_always_contains_the_free_point_around_which_it_grows():
    """Later IRIS iterations can lose a seed in a corner between obstacles. In this case only one iteration is used."""
    room = random_room(1)
    grid = grid_of(room)
    free = np.flatnonzero(grid.nearest >= room.space.clearance + SLACK)
    by_clearance = free[np.argsort(grid.nearest[free])]
    regions = Regions(room.space, room.bounds)
    for seed in grid.points[by_clearance[:8]]:
        assert regions.containing(seed[None], [regions.grow(seed)]).all()


class SmallRegions(Regions):
    """Regions that contain only a box of 10 cm around their seeds."""

    def __init__(self):
        super().__init__(Space((), radius=0.1), Box([-99.0] * 3, [99.0] * 3))
        self.seeds = []

    def grow(self, seed):
        self.seeds.append(seed.tolist())
        self._regions.append(Polytope.from_box(Box(seed - 0.1, seed + 0.1)))
        return len(self) - 1


@pytest.mark.parametrize(("count", "grown"), [(19, 19), (20, 19), (39, 38), (60, 40)])
def test_regions_grow_around_the_points_with_the_largest_clearance_until_most_points_are_covered(count, grown):
    """Growth ends at 40 regions, or when at most 5 % of the points are uncovered. Each region covers one point."""
    points = np.arange(count)[:, None] * np.ones(3)
    distances = np.random.default_rng(count).permutation(count).astype(float)
    regions = SmallRegions()
    regions.cover(points, distances)
    assert regions.seeds == points[np.argsort(-distances)][:grown].tolist()
    # Points that a region already contains are not seeds.
    other_regions = SmallRegions()
    other_regions.grow(points[0])
    other_regions.cover(points, distances)
    assert other_regions.seeds.count(points[0].tolist()) == 1
