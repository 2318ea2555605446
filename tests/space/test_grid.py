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

EMPTY_SPACE = Space((), radius=0.1)
# Each axis of this grid has a different spacing.
UNEVEN_BOUNDS = Box([0.3, -1.0, 2.0], [1.31, 0.02, 2.73])


def wall_at(x, thickness, **clearance):
    """Return a space with a wall across the unit cube, normal to X and centred at x."""
    wall = Cuboid((x, 0.5, 0.5), size=(thickness, 3.0, 3.0))
    return Space((Obstacle("wall", wall),), **clearance)


def indices(grid):
    """Return the indices (n, 3) of the points of a grid along its axes."""
    return np.stack(np.unravel_index(np.arange(len(grid.points)), grid.shape), axis=-1)


@pytest.mark.parametrize("most", [60, 1000, 2000, 5000, 100_000])
def test_a_grid_spans_its_bounds_with_as_many_points_as_allowed(most):
    grid = Grid.of(EMPTY_SPACE, UNEVEN_BOUNDS, max_points=most, min_spacing=0.05)
    assert len(grid.points) == np.prod(grid.shape) <= most
    expected = UNEVEN_BOUNDS.low + indices(grid) * (UNEVEN_BOUNDS.high - UNEVEN_BOUNDS.low) / (np.array(grid.shape) - 1)
    np.testing.assert_allclose(grid.points, expected, atol=1e-12)
    np.testing.assert_allclose(grid.steps, (UNEVEN_BOUNDS.high - UNEVEN_BOUNDS.low) / (np.array(grid.shape) - 1))
    assert grid.spacing == max(grid.steps)
    # A grid has the smallest allowed spacing, or nearly the largest allowed number of points.
    finest = tuple(np.ceil((UNEVEN_BOUNDS.high - UNEVEN_BOUNDS.low) / 0.05).astype(int) + 1)
    assert grid.shape == finest or len(grid.points) > 0.5 * most
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
    actual = [frozenset(pair) for one, other in grid.neighbours() for pair in zip(one.tolist(), other.tolist())]
    at = indices(grid)
    expected = {
        frozenset((i, j)) for i, j in itertools.combinations(range(len(at)), 2) if np.abs(at[i] - at[j]).max() == 1
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
    one, two, three = (np.linalg.norm(steps[:, :axes], axis=1) for axes in (1, 2, 3))
    return (first - second) * one + (second - third) * two + third * three


@pytest.mark.parametrize("most", [400, 3000])
def test_the_length_of_a_route_without_obstacles_is_the_sum_of_its_steps(most):
    """A route begins with a line to any grid point within 1.8 spacings, and continues from grid point to neighbour."""
    grid = Grid.of(EMPTY_SPACE, UNEVEN_BOUNDS, max_points=most, min_spacing=0.02)
    place = grid.points[len(grid.points) // 3] + 0.3 * grid.steps
    lengths, before = grid.route_lengths(place[None], 0.1)
    away = np.linalg.norm(grid.points - place, axis=1)
    near = np.flatnonzero(away <= 1.8 * grid.spacing)
    expected = np.min([away[point] + step_lengths(grid, point) for point in near], axis=0)
    np.testing.assert_allclose(lengths, expected)
    direct = before == -1
    np.testing.assert_array_equal(np.flatnonzero(direct), near)
    steps = np.abs(indices(grid)[~direct] - indices(grid)[before[~direct]])
    assert (steps.max(axis=1) == 1).all()


def tunnel(excess):
    """Return a grid along a straight tunnel with a square section, and the indices of its middle row.

    Args:
        excess: distance from the middle row to the walls minus the clearance, m.
    """
    clearance = 0.2
    spacing = 0.1
    aside = clearance + excess + 0.5
    solids = [Cuboid((0.5, sign * aside, 0.0), size=(3.0, 1.0, 3.0)) for sign in (-1.0, 1.0)]
    solids += [Cuboid((0.5, 0.0, sign * aside), size=(3.0, 3.0, 1.0)) for sign in (-1.0, 1.0)]
    space = Space(tuple(Obstacle(f"side {i}", solid) for i, solid in enumerate(solids)), radius=clearance)
    grid = Grid.of(space, Box([0.0, -0.2, -0.2], [1.0, 0.2, 0.2]), max_points=10_000, min_spacing=spacing)
    middle = np.flatnonzero(np.abs(grid.points[:, 1:]).max(axis=1) < 1e-9)
    return grid, middle[np.argsort(grid.points[middle, 0])]


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
    away, _ = grid.route_lengths(grid.points[:1], 0.2)
    np.testing.assert_allclose(np.diff(away[1:]), expected[1:])
    towards, _ = grid.route_lengths(grid.points[-1:], 0.2)
    np.testing.assert_allclose(-np.diff(towards[:-1]), expected[:-1])


@pytest.mark.parametrize("offset", np.linspace(0.001, 0.049, 13))
def test_no_route_leads_through_a_thin_wall_between_grid_points(offset):
    """The thickness of the wall is 1 cm, the spacing 5 cm, and the clearance 1 cm.

    Depending on the offset, neighbouring points on both sides of the wall keep the clearance, so only a check between
    the points detects the wall.
    """
    x = 0.45 + offset
    space = wall_at(x, 0.01, radius=0.01)
    grid = Grid.of(space, Box([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]), max_points=10_000, min_spacing=0.05)
    places = np.array([[[0.1, 0.5, 0.5]], [[0.9, 0.5, 0.5]]])
    lengths, before = grid.route_lengths(places[0], space.clearance)
    free = grid.nearest >= space.clearance
    ahead = grid.points[:, 0] < x
    across = any((free[one] & free[other] & (ahead[one] != ahead[other])).any() for one, other in grid.neighbours())
    assert across == (0.015 < offset < 0.035)
    assert np.isfinite(lengths[free & ahead]).all()
    assert (lengths[~ahead] == np.inf).all()
    assert grid.shortest_route(lengths, before, *places) is None


def test_a_step_past_an_edge_is_free_if_the_clearance_is_small():
    """A step with ends near a solid is free if its middle is free. The example passes the edge of a thin wall."""
    space = Space((Obstacle("wall", Cuboid((0.5, 0.175, 0.5), size=(0.01, 0.55, 3.0))),), radius=0.02)
    grid = Grid.of(space, Box([0.0, 0.0, 0.5], [1.0, 1.0, 0.5]), max_points=10_000, min_spacing=0.05)
    places = np.array([[[0.1, 0.1, 0.5]], [[0.9, 0.1, 0.5]]])
    lengths, before = grid.route_lengths(places[0], space.clearance)
    way = grid.shortest_route(lengths, before, *places)
    assert 0.45 < way[:, 1].max() < 0.6
    fine = np.concatenate([np.linspace(a, b, 40) for a, b in itertools.pairwise(way)])
    assert least_distances(space, fine).min() >= space.clearance - 1e-9


def test_a_route_uses_the_start_and_the_end_that_make_it_shortest():
    grid = Grid.of(EMPTY_SPACE, Box([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]), max_points=10_000, min_spacing=0.1)
    begins = np.array([[0.0, 0.0, 0.0], [0.33, 0.5, 0.5], [0.0, 1.0, 1.0]])
    ends = np.array([[1.0, 1.0, 0.0], [0.72, 0.5, 0.5], [1.0, 0.0, 1.0]])
    lengths, before = grid.route_lengths(begins, 0.1)
    way = grid.shortest_route(lengths, before, begins, ends)
    np.testing.assert_array_equal(way[[0, -1]], [begins[1], ends[1]])
    length = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
    assert 0.39 - 1e-9 <= length < 0.42
    # Each end is connected only to a grid point next to it.
    hops = np.linalg.norm(np.diff(way, axis=0), axis=1)
    assert (hops <= 1.8 * grid.spacing + 1e-9).all()


def test_a_route_begins_at_the_nearest_start_and_reaches_its_end_from_the_best_grid_point():
    """No other grid point near the end has a smaller sum of its route length and its distance to the end."""
    room = random_room(6)
    grid = Grid.of(room.space, room.bounds, max_points=20_000, min_spacing=0.08)
    reached = grid.points[np.isfinite(grid.route_lengths(room.places[:1], room.space.clearance)[0])]
    begins = reached[[0, len(reached) // 2, len(reached) - 1]]
    lengths, before = grid.route_lengths(begins, room.space.clearance)
    used = set()
    for end in reached[:: len(reached) // 25] + 0.3 * grid.spacing:
        way = grid.shortest_route(lengths, before, begins, end[None])
        away = np.linalg.norm(grid.points - end, axis=1)
        near = away <= 1.8 * grid.spacing
        (last,) = np.flatnonzero((grid.points == way[-2]).all(axis=1))
        assert near[last]
        assert lengths[last] + away[last] == pytest.approx(np.min(lengths[near] + away[near]))
        first = np.linalg.norm(begins - way[1], axis=1)
        np.testing.assert_array_equal(way[0], begins[first.argmin()])
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
        for found, expected in zip(
            grid.route_lengths(start, clearance, inside), new_grid.route_lengths(start, clearance, inside), strict=True
        ):
            np.testing.assert_array_equal(found, expected)
        lengths, _ = grid.route_lengths(start, clearance, inside)
        assert inside is None or (lengths[~inside] == np.inf).all()


def test_a_starting_point_is_connected_only_to_free_grid_points_nearby():
    space = wall_at(0.5, 0.3, radius=0.1)
    grid = Grid.of(space, Box([0.0, 0.0, 0.0], [1.0, 1.0, 1.0]), max_points=10_000, min_spacing=0.1)
    inside, beside = np.array([[0.5, 0.5, 0.5]]), np.array([[0.1, 0.5, 0.5]])
    lengths, _ = grid.route_lengths(inside, space.clearance)
    assert (lengths == np.inf).all()
    lengths, before = grid.route_lengths(beside, space.clearance)
    assert grid.shortest_route(lengths, before, beside, inside) is None


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


@pytest.mark.parametrize("place", REGIONS.values(), ids=REGIONS)
@pytest.mark.parametrize("distance", [0.0, 0.17])
def test_is_near_selects_the_points_within_a_distance_of_a_region(place, distance):
    points = np.random.default_rng(4).uniform(-0.4, 1.0, (3000, 3))
    if isinstance(place, Polytope):
        # Near edges, some points beyond the distance are included, since the faces are shifted outwards.
        region = HPolyhedron(place.normals, place.offsets)
        away = np.array([0.0 if region.PointInSet(p) else np.nan for p in points])
        beyond = (points @ place.normals.T - place.offsets).max(axis=1)
        away = np.where(np.isnan(away), beyond, away)
    else:
        away = np.linalg.norm(points - [place.nearest(point) for point in points], axis=1)
    np.testing.assert_array_equal(is_near(place, points, distance), away <= distance)
    if distance == 0.0:
        np.testing.assert_array_equal(is_near(place, points), away <= 0.0)
