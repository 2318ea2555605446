"""Tests of grids: their points, routes over their points, and their connected components."""

import itertools

import numpy as np
import pytest
from pydrake.geometry.optimization import HPolyhedron
from rooms import least_distances, random_room
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from drake_quad.reference.regions import Box, Polytope, Sphere
from drake_quad.space.grid import Grid, is_near
from drake_quad.space.shapes import Cuboid
from drake_quad.space.space import Obstacle, Space

EMPTY_SPACE = Space((), radius=0.1)  # m
# Each axis of this grid has a different spacing.
UNEVEN_BOUNDS = Box([0.3, -1.0, 2.0], [1.31, 0.02, 2.73])


def wall_at(x, thickness, **clearance):
    """Return a space with a wall across the unit cube, normal to X and centred at x."""
    wall = Cuboid((x, 0.5, 0.5), size=(thickness, 3.0, 3.0))
    return Space((Obstacle("wall", wall),), **clearance)


def indices(grid):
    """Return the indices (n, 3), along the three axes, of the n points of a grid."""
    return np.stack(np.unravel_index(np.arange(len(grid.points)), grid.shape), axis=-1)


@pytest.mark.parametrize("max_points", [60, 1000, 2000, 5000, 100_000])
def test_a_grid_spans_its_bounds_with_as_many_points_as_allowed(max_points):
    grid = Grid.of(EMPTY_SPACE, UNEVEN_BOUNDS, max_points=max_points, min_spacing=0.05)
    assert len(grid.points) == np.prod(grid.shape) <= max_points
    expected = UNEVEN_BOUNDS.low + indices(grid) * (UNEVEN_BOUNDS.high - UNEVEN_BOUNDS.low) / (np.array(grid.shape) - 1)
    np.testing.assert_allclose(grid.points, expected, atol=1e-12)
    np.testing.assert_allclose(grid.steps, (UNEVEN_BOUNDS.high - UNEVEN_BOUNDS.low) / (np.array(grid.shape) - 1))
    assert grid.spacing == max(grid.steps)
    # A grid has the smallest allowed spacing, or nearly the largest allowed number of points.
    finest = tuple(np.ceil((UNEVEN_BOUNDS.high - UNEVEN_BOUNDS.low) / 0.05).astype(int) + 1)
    assert grid.shape == finest or len(grid.points) > 0.5 * max_points
    assert grid.spacing <= 0.05 or grid.shape != finest


def test_a_grid_of_a_flat_space_has_one_layer():
    grid = Grid.of(EMPTY_SPACE, Box([0.0, 0.0, 1.0], [1.0, 0.5, 1.0]), max_points=1000, min_spacing=0.1)
    assert grid.shape == (11, 6, 1)
    np.testing.assert_allclose(grid.steps, [0.1, 0.1, 0.0])
    np.testing.assert_array_equal(grid.points[:, 2], 1.0)


def test_distances_of_a_grid_are_distances_to_its_obstacles():
    room = random_room(2)
    grid = Grid.of(room.space, room.bounds, max_points=3000, min_spacing=0.05)
    outside = grid.nearest > 0.0
    np.testing.assert_allclose(grid.nearest[outside], least_distances(room.space, grid.points)[outside], atol=1e-9)
    assert grid.distances.shape == (len(grid.points), len(room.space.obstacles))
    np.testing.assert_array_equal(grid.distances.min(axis=1), grid.nearest)
    empty = Grid.of(EMPTY_SPACE, room.bounds, max_points=3000, min_spacing=0.05)
    assert (empty.nearest == np.inf).all()
    assert empty.distances.shape == (len(empty.points), 0)


def test_each_pair_of_neighbours_is_found_once():
    grid = Grid.of(EMPTY_SPACE, Box([0.0, 0.0, 0.0], [0.3, 0.2, 0.4]), max_points=1000, min_spacing=0.1)
    actual = [frozenset(pair) for first, second in grid.neighbours() for pair in zip(first.tolist(), second.tolist())]
    grid_indices = indices(grid)
    expected = {
        frozenset((i, j))
        for i, j in itertools.combinations(range(len(grid_indices)), 2)
        if np.abs(grid_indices[i] - grid_indices[j]).max() == 1
    }
    assert len(actual) == len(expected)
    assert set(actual) == expected


def step_lengths(grid, start):
    """Return the lengths (n,) of the shortest routes from one point to all points, with steps in 26 directions.

    A shortest route has as many steps as possible along three axes, then along two axes, then along one axis.
    """
    counts = np.abs(indices(grid) - indices(grid)[start])
    order = np.argsort(-counts, axis=1)
    first, second, third = np.take_along_axis(counts, order, axis=1).T
    steps = grid.steps[order]
    along_one_axis, along_two_axes, along_three_axes = (np.linalg.norm(steps[:, :axes], axis=1) for axes in (1, 2, 3))
    return (first - second) * along_one_axis + (second - third) * along_two_axes + third * along_three_axes


@pytest.mark.parametrize("max_points", [400, 3000])
def test_the_length_of_a_route_without_obstacles_is_the_sum_of_its_steps(max_points):
    """A route begins with a line to any grid point within 1.8 spacings, and continues from grid point to neighbour."""
    grid = Grid.of(EMPTY_SPACE, UNEVEN_BOUNDS, max_points=max_points, min_spacing=0.02)
    position = grid.points[len(grid.points) // 3] + 0.3 * grid.steps
    lengths, predecessors = grid.route_lengths(position[None], 0.1)
    distances = np.linalg.norm(grid.points - position, axis=1)
    neighbours = np.flatnonzero(distances <= 1.8 * grid.spacing)
    expected = np.min([distances[point] + step_lengths(grid, point) for point in neighbours], axis=0)
    np.testing.assert_allclose(lengths, expected)
    direct = predecessors == -1
    np.testing.assert_array_equal(np.flatnonzero(direct), neighbours)
    steps = np.abs(indices(grid)[~direct] - indices(grid)[predecessors[~direct]])
    assert (steps.max(axis=1) == 1).all()


def tunnel(excess):
    """Return a grid along a straight tunnel with a square section, and the indices of its middle row.

    Args:
        excess: distance from the middle row to the walls minus the clearance, m.
    """
    clearance = 0.2
    spacing = 0.1
    wall_offset = clearance + excess + 0.5
    solids = [Cuboid((0.5, sign * wall_offset, 0.0), size=(3.0, 1.0, 3.0)) for sign in (-1.0, 1.0)]
    solids += [Cuboid((0.5, 0.0, sign * wall_offset), size=(3.0, 3.0, 1.0)) for sign in (-1.0, 1.0)]
    space = Space(tuple(Obstacle(f"side {i}", solid) for i, solid in enumerate(solids)), radius=clearance)
    grid = Grid.of(space, Box([0.0, -0.2, -0.2], [1.0, 0.2, 0.2]), max_points=10_000, min_spacing=spacing)
    middle_row = np.flatnonzero(np.abs(grid.points[:, 1:]).max(axis=1) < 1e-9)
    return grid, middle_row[np.argsort(grid.points[middle_row, 0])]


@pytest.mark.parametrize(("excess", "factor"), [(1e-9, 2.0), (0.025, 1.8), (0.05, 1.0 + 0.1 / 0.15)])
def test_lengths_are_doubled_at_the_smallest_clearance_and_increased_less_at_larger_clearances(excess, factor):
    """Only the middle row is free, so all steps of the route have the same clearance."""
    grid, row = tunnel(excess)
    clearance = grid.space.clearance
    assert (grid.nearest >= clearance).sum() == len(row) == 11
    lengths, _ = grid.route_lengths(grid.points[row[:1]], clearance)
    # The first two points are directly connected to the starting point.
    np.testing.assert_allclose(lengths[row[1]], 0.1)
    np.testing.assert_allclose(np.diff(lengths[row[1:]]), 0.1 * factor, rtol=1e-6)


def test_the_cost_of_a_step_depends_on_the_smaller_clearance_of_its_ends():
    """The route leads straight away from a wall, so the clearance increases with each step."""
    space = wall_at(-0.31, 0.2, radius=0.2)
    grid = Grid.of(space, Box([0.0, 0.0, 0.0], [1.0, 0.0, 0.0]), max_points=100, min_spacing=0.1)
    expected = 0.1 * (1.0 + 0.1 / (0.1 + 0.01 + 0.1 * np.arange(10)))
    lengths_from_wall, _ = grid.route_lengths(grid.points[:1], 0.2)
    np.testing.assert_allclose(np.diff(lengths_from_wall[1:]), expected[1:])
    lengths_to_wall, _ = grid.route_lengths(grid.points[-1:], 0.2)
    np.testing.assert_allclose(-np.diff(lengths_to_wall[:-1]), expected[:-1])


@pytest.mark.parametrize("offset", np.linspace(0.001, 0.049, 13))
def test_no_route_leads_through_a_thin_wall_between_grid_points(offset):
    """The thickness of the wall is 1 cm, the spacing 5 cm, and the clearance 1 cm.

    Depending on the offset, neighbouring points on both sides of the wall keep the clearance, so only a check between
    the points detects the wall.
    """
    x = 0.45 + offset
    space = wall_at(x, 0.01, radius=0.01)
    grid = Grid.of(space, Box([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]), max_points=10_000, min_spacing=0.05)
    endpoints = np.array([[[0.1, 0.5, 0.5]], [[0.9, 0.5, 0.5]]])
    lengths, predecessors = grid.route_lengths(endpoints[0], space.clearance)
    free = grid.nearest >= space.clearance
    is_before_wall = grid.points[:, 0] < x
    has_free_pair_across = any(
        (free[first] & free[second] & (is_before_wall[first] != is_before_wall[second])).any()
        for first, second in grid.neighbours()
    )
    assert has_free_pair_across == (0.015 < offset < 0.035)
    assert np.isfinite(lengths[free & is_before_wall]).all()
    assert (lengths[~is_before_wall] == np.inf).all()
    assert grid.shortest_route(lengths, predecessors, *endpoints) is None


def test_a_step_past_an_edge_is_free_if_the_clearance_is_small():
    """A step with ends near a solid is free if its middle is free. The example passes the edge of a thin wall."""
    space = Space((Obstacle("wall", Cuboid((0.5, 0.175, 0.5), size=(0.01, 0.55, 3.0))),), radius=0.02)
    grid = Grid.of(space, Box([0.0, 0.0, 0.5], [1.0, 1.0, 0.5]), max_points=10_000, min_spacing=0.05)
    endpoints = np.array([[[0.1, 0.1, 0.5]], [[0.9, 0.1, 0.5]]])
    lengths, predecessors = grid.route_lengths(endpoints[0], space.clearance)
    route = grid.shortest_route(lengths, predecessors, *endpoints)
    assert 0.45 < route[:, 1].max() < 0.6
    fine = np.concatenate([np.linspace(a, b, 40) for a, b in itertools.pairwise(route)])
    assert least_distances(space, fine).min() >= space.clearance - 1e-9


def test_a_route_uses_the_start_and_the_end_that_make_it_shortest():
    grid = Grid.of(EMPTY_SPACE, Box([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]), max_points=10_000, min_spacing=0.1)
    starts = np.array([[0.0, 0.0, 0.0], [0.33, 0.5, 0.5], [0.0, 1.0, 1.0]])
    ends = np.array([[1.0, 1.0, 0.0], [0.72, 0.5, 0.5], [1.0, 0.0, 1.0]])
    lengths, predecessors = grid.route_lengths(starts, 0.1)
    route = grid.shortest_route(lengths, predecessors, starts, ends)
    np.testing.assert_array_equal(route[[0, -1]], [starts[1], ends[1]])
    length = np.linalg.norm(np.diff(route, axis=0), axis=1).sum()
    assert 0.39 - 1e-9 <= length < 0.42
    # Each end is connected only to a grid point next to it.
    steps = np.linalg.norm(np.diff(route, axis=0), axis=1)
    assert (steps <= 1.8 * grid.spacing + 1e-9).all()


def test_a_route_begins_at_the_nearest_start_and_reaches_its_end_from_the_best_grid_point():
    """No other grid point near the end has a smaller sum of its route length and its distance to the end."""
    room = random_room(6)
    grid = Grid.of(room.space, room.bounds, max_points=20_000, min_spacing=0.08)
    reached = grid.points[np.isfinite(grid.route_lengths(room.endpoints[:1], room.space.clearance)[0])]
    starts = reached[[0, len(reached) // 2, len(reached) - 1]]
    lengths, predecessors = grid.route_lengths(starts, room.space.clearance)
    used = set()
    for end in reached[:: len(reached) // 25] + 0.3 * grid.spacing:
        route = grid.shortest_route(lengths, predecessors, starts, end[None])
        distances = np.linalg.norm(grid.points - end, axis=1)
        is_neighbour = distances <= 1.8 * grid.spacing
        (last,) = np.flatnonzero((grid.points == route[-2]).all(axis=1))
        assert is_neighbour[last]
        assert lengths[last] + distances[last] == pytest.approx(np.min(lengths[is_neighbour] + distances[is_neighbour]))
        first = np.linalg.norm(starts - route[1], axis=1)
        np.testing.assert_array_equal(route[0], starts[first.argmin()])
        assert first.min() <= 1.8 * grid.spacing
        used.add(int(first.argmin()))
    assert used == {0, 1, 2}


def test_route_lengths_do_not_depend_on_earlier_legs_on_the_same_grid():
    """The legs have different corridors and clearances."""
    space, bounds = wall_at(0.5, 0.1, radius=0.1), Box([0.0, 0.0, 0.0], [1.0, 1.0, 1.0])
    grid = Grid.of(space, bounds, max_points=10_000, min_spacing=0.1)
    start, low = np.array([[0.1, 0.5, 0.5]]), grid.points[:, 2] < 0.55
    for clearance, inside in ((0.1, None), (0.1, low), (0.2, None), (0.2, low), (0.1, None)):
        new_grid = Grid.of(space, bounds, max_points=10_000, min_spacing=0.1)
        for result, expected in zip(
            grid.route_lengths(start, clearance, inside), new_grid.route_lengths(start, clearance, inside), strict=True
        ):
            np.testing.assert_array_equal(result, expected)
        lengths, _ = grid.route_lengths(start, clearance, inside)
        assert inside is None or (lengths[~inside] == np.inf).all()


def test_a_starting_point_is_connected_only_to_free_grid_points_nearby():
    space = wall_at(0.5, 0.3, radius=0.1)
    grid = Grid.of(space, Box([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]), max_points=10_000, min_spacing=0.1)
    inside, outside = np.array([[0.5, 0.5, 0.5]]), np.array([[0.1, 0.5, 0.5]])
    lengths, _ = grid.route_lengths(inside, space.clearance)
    assert (lengths == np.inf).all()
    lengths, predecessors = grid.route_lengths(outside, space.clearance)
    assert grid.shortest_route(lengths, predecessors, outside, inside) is None


def test_connected_components_agree_with_a_graph_of_free_points():
    random = np.random.default_rng(3)
    grid = Grid.of(EMPTY_SPACE, Box([0.0, 0.0, 0.0], [0.7, 0.5, 0.6]), max_points=1000, min_spacing=0.1)
    free = random.uniform(size=len(grid.points)) < 0.12
    pairs = np.concatenate([np.stack(pair) for pair in grid.neighbours()], axis=1)
    pairs = pairs[:, free[pairs].all(axis=0)]
    size = len(grid.points)
    expected = connected_components(coo_matrix((np.ones(pairs.shape[1]), tuple(pairs)), (size, size)), directed=False)[
        1
    ]
    rooms = grid.components(free)
    assert (rooms[~free] == 0).all()
    assert (rooms[free] > 0).all()
    assert len(set(rooms[free])) > 3
    same = rooms[free][:, None] == rooms[free]
    np.testing.assert_array_equal(same, expected[free][:, None] == expected[free])


BOX = Box([0.1, 0.2, 0.3], [0.6, 0.5, 0.4])
REGIONS = {
    "box": BOX,
    "point": Box.point([0.4, 0.3, 0.2]),
    "sphere": Sphere([0.4, 0.3, 0.2], 0.25),
    "polytope": Polytope.from_box(BOX),
    "tetrahedron": Polytope([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [2.0, 2.0, 2.0]], [0, 0, 0, 1.2]),
}


@pytest.mark.parametrize("region", REGIONS.values(), ids=REGIONS)
@pytest.mark.parametrize("distance", [0.0, 0.17])
def test_is_near_selects_the_points_within_a_distance_of_a_region(region, distance):
    points = np.random.default_rng(4).uniform(-0.4, 1.0, (3000, 3))
    if isinstance(region, Polytope):
        # Near edges, some points beyond the distance are included, since the faces are shifted outwards.
        polyhedron = HPolyhedron(region.normals, region.offsets)
        distances = np.array([0.0 if polyhedron.PointInSet(p) else np.nan for p in points])
        beyond = (points @ region.normals.T - region.offsets).max(axis=1)
        distances = np.where(np.isnan(distances), beyond, distances)
    else:
        distances = np.linalg.norm(points - [region.nearest(point) for point in points], axis=1)
    np.testing.assert_array_equal(is_near(region, points, distance), distances <= distance)
    if distance == 0.0:
        np.testing.assert_array_equal(is_near(region, points), distances <= 0.0)
