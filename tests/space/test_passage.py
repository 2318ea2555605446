"""Tests of chains, the regions that cover a given route, and of passages, the regions through which a path leads.

Passages are compared with an enumeration of all passages in small mazes of boxes.
"""

import itertools

import numpy as np
import pytest
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from drake_quad.reference.regions import Box, Polytope, Sphere
from drake_quad.space import passage
from drake_quad.space.passage import candidate_regions, find_passage, other_passages, region_chain
from drake_quad.space.regions import Regions
from drake_quad.space.space import Space

# Cost of a transition from one region to the next, m.
TRANSITION_COST = 0.1


class Boxes(Regions):
    """Substitute for `Regions` with boxes as regions. Growing a region adds a box of 60 cm around the seed."""

    def __init__(self, *boxes):
        super().__init__(Space((), radius=0.1), Box([-99.0] * 3, [99.0] * 3))
        self._regions = [Polytope.from_box(Box(*box)) for box in boxes]

    def grow(self, seed):
        self._regions.append(Polytope.from_box(Box(seed - 0.3, seed + 0.3)))
        return len(self) - 1


def shortest_polyline(regions, legs, waypoints, corridors):
    """Return the length (m) of the shortest polyline with one straight piece in each region, or None."""
    program = MathematicalProgram()
    corners = [program.NewContinuousVariables(3) for _ in range(sum(map(len, legs)) + 1)]
    numbers = [number for leg in legs for number in leg]
    within = [corridor for leg, corridor in zip(legs, corridors, strict=True) for _ in leg]
    for number, corridor, ends in zip(numbers, within, itertools.pairwise(corners), strict=True):
        for end in ends:
            region = regions[number]
            program.AddLinearConstraint(region.normals, np.full(region.faces, -np.inf), region.offsets, end)
            if corridor is not None:
                program.AddBoundingBoxConstraint(corridor.low, corridor.high, end)
        (length,) = program.NewContinuousVariables(1)
        rows = np.vstack([np.zeros((1, 6)), np.hstack([np.eye(3), -np.eye(3)])])
        program.AddLorentzConeConstraint(
            np.hstack([rows, [[1.0], [0.0], [0.0], [0.0]]]), np.zeros(4), np.concatenate([*ends, [length]])
        )
        program.AddLinearCost(length)
    for waypoint, corner in zip(waypoints, np.cumsum([0, *map(len, legs)]), strict=True):
        if isinstance(waypoint, Sphere):
            program.AddLorentzConeConstraint(
                np.vstack([np.zeros((1, 3)), np.eye(3)]),
                np.concatenate([[waypoint.radius], -waypoint.centre]),
                corners[corner],
            )
        else:
            program.AddBoundingBoxConstraint(waypoint.low, waypoint.high, corners[corner])
    result = ClarabelSolver().Solve(program)
    return result.get_optimal_cost() if result.is_success() else None


def costs_of_all(regions, waypoints, corridors, longest=4):
    """Return the costs of all possible passages, m. A cost is the length of a polyline plus its transition costs."""
    orders = [order for count in range(1, longest + 1) for order in itertools.permutations(range(len(regions)), count)]
    chains = [order for order in orders if all(regions.intersection(i, j) for i, j in itertools.pairwise(order))]
    possible = [
        [each for each in chains if shortest_polyline(regions, [each], waypoints[i : i + 2], [corridor]) is not None]
        for i, corridor in enumerate(corridors)
    ]
    costs = {}
    for legs in itertools.product(*possible):
        length = shortest_polyline(regions, legs, waypoints, corridors)
        if length is not None:
            # Each leg has transitions from its waypoint to a region, between regions, and to the next waypoint.
            costs[legs] = length + TRANSITION_COST * sum(len(leg) + 1 for leg in legs)
    return costs


# Four boxes, one on each side of a pillar, overlap at the corners.
BOXES_AROUND_PILLAR = (
    ([0, 0, 0], [4, 1, 1]),
    ([0, 3, 0], [4, 4, 1]),
    ([0, 0, 0], [1, 4, 1]),
    ([3, 0, 0], [4, 4, 1]),
)
START = Box.point([0.5, 2.1, 0.5])
END = Box.point([3.5, 2.3, 0.5])
# Corners of the boxes, waypoints, and the corridor of each leg.
MAZES = {
    "around a pillar": (BOXES_AROUND_PILLAR, [START, END], [None]),
    "the other way around it": (BOXES_AROUND_PILLAR, [Box.point([0.5, 1.8, 0.5]), Box.point([3.5, 1.9, 0.5])], [None]),
    "to a box": (BOXES_AROUND_PILLAR, [START, Box([3.2, 0.2, 0.5], [3.6, 0.2, 0.5])], [None]),
    "to a sphere": (BOXES_AROUND_PILLAR, [START, Sphere([3.5, 0.4, 0.5], 0.3)], [None]),
    "in a corridor": (BOXES_AROUND_PILLAR, [START, END], [Box([0, 0, 0], [4, 2.6, 1])]),
    "there and back": (BOXES_AROUND_PILLAR, [START, END, Box.point([2.0, 0.5, 0.5])], [None, None]),
    "back in a corridor": (
        BOXES_AROUND_PILLAR,
        [START, END, Box.point([2.0, 0.5, 0.5])],
        [None, Box([0, 0, 0], [4, 2.5, 1])],
    ),
    "a short cut of many boxes": (
        (
            ([0, 0, 0], [1, 1, 1]),
            ([0.9, 0, 0], [2, 1, 1]),
            ([1.9, 0, 0], [3, 1, 1]),
            ([0, 0, 0], [1, 1, 2.5]),
            ([0, 0, 1.25], [3, 1, 2.5]),
            ([2.5, 0, 0], [3, 1, 2.5]),
        ),
        [Box.point([0.5, 0.5, 0.9]), Box.point([2.6, 0.5, 0.9])],
        [None],
    ),
    # The route along the top is 8 cm longer, but has one transition between boxes less, which saves 10 cm.
    "a detour with fewer transitions": (
        (
            ([0, 0, 0], [0.8, 1, 1]),
            ([0.7, 0, 0], [1.5, 1, 1]),
            ([1.4, 0, 0], [2.2, 1, 1]),
            ([2.1, 0, 0], [3, 1, 1]),
            ([0, 0, 0], [1, 1, 2]),
            ([0.9, 0, 1.18], [2.2, 1, 2]),
            ([2.1, 0, 0], [3, 1, 2]),
        ),
        [Box.point([0.5, 0.5, 0.98]), Box.point([2.6, 0.5, 0.98])],
        [None],
    ),
}


@pytest.mark.parametrize(("boxes", "waypoints", "corridors"), MAZES.values(), ids=MAZES)
def test_the_selected_passage_has_the_lowest_cost_of_all(boxes, waypoints, corridors):
    regions = Boxes(*boxes)
    actual = find_passage(regions, [range(len(regions))] * len(corridors), waypoints, corridors)
    costs = costs_of_all(regions, waypoints, corridors)
    assert costs[actual] == pytest.approx(min(costs.values()), abs=1e-5)


def test_a_passage_uses_only_candidate_regions():
    """If the bottom box is excluded, the route leads along the longer top. If both are excluded, there is no route."""
    regions = Boxes(*BOXES_AROUND_PILLAR)
    assert find_passage(regions, [[0, 1, 2, 3]], [START, Box.point([3.5, 1.3, 0.5])], [None]) == ((2, 0, 3),)
    assert find_passage(regions, [[3, 1, 2]], [START, Box.point([3.5, 1.3, 0.5])], [None]) == ((2, 1, 3),)
    assert find_passage(regions, [[3, 2]], [START, END], [None]) is None


def test_regions_that_hardly_overlap_are_not_connected():
    """The intersection of two regions, and its part inside a corridor, must contain a ball with a radius of 1 mm."""
    for overlap, is_connected in ((0.0015, False), (0.0025, True)):
        regions = Boxes(([0, 0, 0], [1 + overlap, 1, 1]), ([1, 0, 0], [2, 1, 1]))
        waypoints = [Box.point([0.5, 0.5, 0.5]), Box.point([1.5, 0.5, 0.5])]
        assert (regions.intersection(0, 1) is not None) == is_connected
        assert (regions.intersection(1, 0) is not None) == is_connected
        assert find_passage(regions, [[0, 1]], waypoints, [None]) == (((0, 1),) if is_connected else None)
        ends = [waypoint.centre[None] for waypoint in waypoints]
        assert other_passages(regions, ends, [None], count=3) == ([((0, 1),)] if is_connected else [])
    regions = Boxes(([0, 0, 0], [1.5, 1, 1]), ([1, 0, 0], [2, 1, 1]))
    for height, is_connected in ((0.0015, False), (0.0025, True)):
        corridor = Box([0, 0, 0], [2, 1, height])
        waypoints = [Box.point([0.5, 0.5, 0.0]), Box.point([1.7, 0.5, 0.0])]
        assert find_passage(regions, [[0, 1]], waypoints, [corridor]) == (((0, 1),) if is_connected else None)
        ends = [waypoint.centre[None] for waypoint in waypoints]
        assert other_passages(regions, ends, [corridor], count=3) == ([((0, 1),)] if is_connected else [])


@pytest.mark.parametrize("waypoints", [[START, END], [START, END, Box.point([2.0, 0.5, 0.5])]])
def test_random_passages_are_feasible(waypoints):
    regions = Boxes(*BOXES_AROUND_PILLAR)
    corridors = [None] * (len(waypoints) - 1)
    actual = other_passages(regions, [waypoint.centre[None] for waypoint in waypoints], corridors, count=30)
    assert len(actual) == len(set(actual)) > 1
    assert set(actual) <= set(costs_of_all(regions, waypoints, corridors))


def test_random_passages_differ_only_if_their_lengths_are_similar():
    """Two routes around a square are equally long, and both are found. If one becomes longer, it is not found."""
    regions = Boxes(*BOXES_AROUND_PILLAR)
    ends = [np.array([[0.5, 2.0, 0.5]]), np.array([[3.5, 2.0, 0.5]])]
    assert set(other_passages(regions, ends, [None], count=12)) == {((2, 0, 3),), ((2, 1, 3),)}
    # The centre of the bottom box is so far away that the route through it is 40 m long. The route along the top is 5 m
    # long.
    far = Boxes(([0, -40, 0], [4, 1, 1]), *BOXES_AROUND_PILLAR[1:])
    assert other_passages(far, ends, [None], count=12) == [((2, 1, 3),)]
    assert other_passages(far, ends, [Box([0, 0, 0], [4, 2.5, 1])], count=12) == [((2, 0, 3),)]
    assert other_passages(far, ends, [Box([0, 1.5, 0], [4, 2.5, 1])], count=12) == []


def test_passage_lengths_include_the_distance_from_a_waypoint_to_the_centre_of_its_region():
    """Two large boxes each contain both ends. The distances from an end to the centres determine which box is used."""
    regions = Boxes(([0, 0, 0], [4, 1, 1]), ([-50, -1, -50], [50, 99, 50]))
    ends = [np.array([[0.5, 0.5, 0.5]]), np.array([[2.0, 0.5, 0.5], [3.5, 0.5, 0.5]])]
    assert other_passages(regions, ends, [None], count=12) == [((0,),)]
    # Only the larger box contains this new end.
    ends[1] = np.array([[2.0, 4.0, 0.5]])
    assert {leg[-1] for (leg,) in other_passages(regions, ends, [None], count=12)} == {1}


def test_a_chain_of_regions_uses_the_box_that_covers_the_longest_part_of_the_route():
    regions = Boxes(
        ([0, 0, 0], [1.2, 1, 1]), ([0, 0, 0], [2.2, 1, 1]), ([2, 0, 0], [4, 1, 1]), ([1.5, 0, 0], [2.5, 1, 1])
    )
    route = np.column_stack([np.arange(0.1, 4.0, 0.2), np.full(20, 0.5), np.full(20, 0.5)])
    assert region_chain(regions, route) == [1, 2]
    assert region_chain(regions, route[::-1]) == [2, 1]
    assert len(regions) == 4


def test_new_regions_are_grown_where_existing_regions_do_not_cover_the_route():
    """The gap between the two existing boxes is 0.8 m wide."""
    regions = Boxes(([0, 0, 0], [1, 1, 1]), ([1.8, 0, 0], [3, 1, 1]))
    route = np.array(
        [[0.5, 0.5, 0.5], [0.9, 0.5, 0.5], [1.3, 0.5, 0.5], [1.7, 0.5, 0.5], [1.9, 0.5, 0.5], [2.5, 0.5, 0.5]]
    )
    actual = region_chain(regions, route)
    assert (actual[0], actual[-1]) == (0, 1)
    assert len(regions) > 2
    for first, second in itertools.pairwise(actual):
        assert first != second
        assert regions.intersection(first, second) is not None
    assert regions.containing(route, actual).any(axis=0).all()


def test_candidate_regions_are_the_chain_of_the_leg_and_then_regions_on_the_shortest_routes():
    boxes = [([i, 0, 0], [i + 1.0, 1, 1]) for i in range(12)]
    regions = Boxes(*boxes)
    points = np.column_stack([np.arange(24) / 2 + 0.25, np.full(24, 0.5), np.full(24, 0.5)])
    lengths = np.random.default_rng(1).permutation(24).astype(float)
    lengths[10:12] = np.inf
    shortest = {i: lengths[2 * i : 2 * i + 2].min() for i in range(12)}
    chosen = candidate_regions(regions, [5, 3, 5], points, lengths)
    other_regions = sorted(set(shortest) - {3, 5}, key=shortest.get)
    assert chosen == [5, 3, *other_regions[:6]]
    # The shortest route does not lead through the other boxes.
    lengths[4:] = np.inf
    assert sorted(candidate_regions(regions, [5, 3], points, lengths)) == [0, 1, 3, 5]
    assert candidate_regions(regions, list(range(12)), points, lengths) == list(range(12))


@pytest.mark.parametrize("seed", range(6))
def test_without_random_factors_passages_are_the_shortest_between_the_centres_of_regions(monkeypatch, seed):
    """The cost is the length of a route through the centres of regions and intersections, plus transition costs."""
    monkeypatch.setattr(passage, "_LOG_FACTOR_DEVIATION", 0.0)
    random = np.random.default_rng([5, seed])
    low = random.uniform(0.0, 2.0, (6, 3))
    regions = Boxes(*((begin, begin + size) for begin, size in zip(low, random.uniform(0.8, 2.0, (6, 3)), strict=True)))
    ends = [regions[number].centre + 0.3 * random.uniform(-1.0, 1.0, (3, 3)) for number in (0, 3, 5)]

    def cost_to_end(number, points):
        contained_points = points[regions.containing(points, [number])[0]]
        return np.linalg.norm(contained_points - regions[number].centre, axis=1).min(initial=np.inf) + TRANSITION_COST

    def transition_cost(first, second):
        common = regions.intersection(first, second).centre
        return sum(np.linalg.norm(regions[number].centre - common) for number in (first, second)) + TRANSITION_COST

    legs = []
    for begin, end in itertools.pairwise(ends):
        costs = {
            order: cost_to_end(order[0], begin)
            + cost_to_end(order[-1], end)
            + sum(transition_cost(*pair) for pair in itertools.pairwise(order))
            for count in range(1, 7)
            for order in itertools.permutations(range(6), count)
            if all(regions.intersection(*pair) is not None for pair in itertools.pairwise(order))
        }
        best = min(costs, key=costs.get)
        legs.append(best if np.isfinite(costs[best]) else ())
    expected = [tuple(legs)] if all(legs) else []
    assert other_passages(regions, ends, [None, None], count=2) == expected


def test_a_leg_starts_in_a_region_that_intersects_the_waypoint_within_the_corridor():
    """The upper box intersects the waypoint only outside the corridor."""
    regions = Boxes(([0, 2, 0], [4, 3, 1]), ([0, 0, 0], [4, 2.2, 1]))
    gate, end = Box([0.5, 0.2, 0.5], [0.5, 2.9, 0.5]), Box.point([3.5, 2.4, 0.5])
    # Its upper face rises from y = 1 m at x = 0 to 3 m at x = 4 m.
    rising = Polytope([[-0.5, 1.0, 0.0]], [1.0]).intersection(Polytope.from_box(Box([0, 0, 0], [4, 4, 1])))
    assert find_passage(regions, [[0, 1]], [gate, end], [rising]) == ((1, 0),)
    assert find_passage(regions, [[0, 1]], [gate, end], [None]) == ((0,),)
