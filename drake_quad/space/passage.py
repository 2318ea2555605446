"""Search for the convex regions through which a path leads, as a shortest path in a graph of convex sets.

Routes on a grid determine the candidate regions. These are the regions through which the shortest or a slightly longer
route leads. Among all polylines through these regions, Drake finds the shortest, with a cost for each transition from
one region to the next.

T. Marcucci, M. Petersen, D. von Wrangel and R. Tedrake, "Motion planning around obstacles with convex optimization",
Science Robotics 8 (84), 2023.
"""

import itertools
from collections.abc import Sequence

import numpy as np
from pydrake.geometry.optimization import (
    ConvexSet,
    GraphOfConvexSetsOptions,
    HPolyhedron,
    Hyperellipsoid,
    Hyperrectangle,
    Point,
)
from pydrake.planning import GcsTrajectoryOptimization
from pydrake.solvers import ClarabelSolver

from drake_quad.process_settings import without_drake_remarks
from drake_quad.reference.regions import Box, Corridor, Polytope, Sphere, WaypointRegion
from drake_quad.space.regions import MIN_COMMON_RADIUS, Regions

# Largest number of candidate regions for a leg. All regions of the leg's chain are candidates, even if they exceed this
# number. With eight candidates, the search takes half a second.
_MAX_CANDIDATES = 8
# Cost of a transition to another region, m. It favours paths with fewer segments, which have fewer turns.
_TRANSITION_COST = 0.1
# Largest number of paths that Drake tries when it rounds the solution of the convex relaxation.
_MAX_ROUNDED_PATHS = 10
# Standard deviation of the logarithm of the random factors by which the lengths between regions are multiplied.
_LOG_FACTOR_DEVIATION = 0.6
# Largest number of iterations that build the chain of regions along the route of a leg. Each iteration adds a region to
# the chain, or halves a straight step of the route that lies in no region.
_MAX_CHAIN_LENGTH = 60


Passage = tuple[tuple[int, ...], ...]
"""For each leg from one waypoint to the next, the indices of the regions in the order of the path."""


def region_chain(regions: Regions, route: np.ndarray) -> list[int]:
    """Return a chain of regions that covers a route. Successive regions intersect.

    If no existing region continues the chain, a new region is grown.

    Args:
        regions: existing regions.
        route: (n, 3) free points that are connected by free straight lines, m.

    Returns:
        Indices of the regions in the chain. The chain is incomplete if the route cannot be covered up to its end.
    """
    points = [*route]
    chosen: list[int] = []
    for _ in range(_MAX_CHAIN_LENGTH):
        inside = regions.containing(np.array(points))
        steps = inside[:, :-1] & inside[:, 1:]
        # For each region, this is the number of successive steps of the route, counted from the current point, that lie
        # in the region.
        follows = np.cumprod(steps, axis=1).sum(axis=1)
        best = next(
            (
                number
                for number in np.argsort(-follows, kind="stable").tolist()
                if follows[number]
                and (not chosen or (number != chosen[-1] and regions.intersection(chosen[-1], number)))
            ),
            None,
        )
        if best is not None:
            chosen.append(best)
            points = points[int(follows[best]) :]
            if len(points) == 1:
                return chosen
        else:
            middle = 0.5 * (points[0] + points[1])
            regions.grow(middle)
            points.insert(1, middle)
    return chosen


def find_passage(
    regions: Regions,
    candidates: Sequence[Sequence[int]],
    waypoints: Sequence[WaypointRegion],
    corridors: Sequence[Corridor | None],
    *,
    ends: Sequence[np.ndarray] | None = None,
) -> Passage | None:
    """Return the shortest passage, or None if no passage exists.

    Args:
        regions: all regions.
        candidates: indices of the regions that each leg may use.
        waypoints: (legs + 1) regions of the waypoints.
        corridors: corridor that each leg must not leave, or None for a leg without a corridor.
        ends: for each waypoint, a mask (regions,) of the regions in which a leg may start or end there. By default, all
            regions.
    """
    graph = GcsTrajectoryOptimization(3)
    # Passing a waypoint takes no time, but Drake requires a positive upper limit.
    stops = [
        graph.AddRegions([_convex_set(waypoint)], 0, h_max=1e-6, name=f"waypoint {i}")
        for i, waypoint in enumerate(waypoints)
    ]
    allowed_regions = [
        _regions_in_corridor(regions, numbers, corridor)
        for numbers, corridor in zip(candidates, corridors, strict=True)
    ]
    if not all(allowed_regions):
        return None
    for leg, (numbers, corridor) in enumerate(zip(allowed_regions, corridors, strict=True)):
        pairs = [
            (i, j)
            for i, j in itertools.permutations(range(len(numbers)), 2)
            if _are_connected(regions, numbers[i], numbers[j], corridor)
        ]
        inside = [regions[n] if corridor is None else regions[n].intersection(corridor) for n in numbers]
        sets = [HPolyhedron(region.normals, region.offsets) for region in inside if region is not None]
        part = graph.AddRegions(sets, pairs, 1, name=f"leg {leg}")
        # Drake itself would find the regions that contain a waypoint by linear programs, but it raises an error if one
        # of them fails.
        first, last = (
            [
                n
                for n, region in enumerate(sets)
                if (ends is None or ends[i][numbers[n]]) and _intersects(region, waypoints[i])
            ]
            for i in (leg, leg + 1)
        )
        graph.AddEdges(stops[leg], part, edges_between_regions=[(0, n) for n in first])
        graph.AddEdges(part, stops[leg + 1], edges_between_regions=[(n, 0) for n in last])
    graph.AddPathLengthCost(1.0)
    graph_of_sets = graph.graph_of_convex_sets()
    for edge in graph_of_sets.Edges():
        edge.AddCost(_TRANSITION_COST)
    options = GraphOfConvexSetsOptions()
    options.convex_relaxation, options.preprocessing, options.solver = True, True, ClarabelSolver()
    options.max_rounded_paths, options.rounding_seed = _MAX_ROUNDED_PATHS, 0
    with without_drake_remarks():
        _, result = graph.SolvePath(stops[0], stops[-1], options)
    if not result.is_success():
        return None
    edges = graph_of_sets.GetSolutionPath(stops[0].Vertices()[0], stops[-1].Vertices()[0], result)
    legs: list[tuple[int, ...]] = []
    passed: list[int] = []
    for edge in edges:
        name, number = edge.v().name().split(": Region")
        if name.startswith("waypoint"):
            legs.append(tuple(passed))
            passed = []
        else:
            passed.append(allowed_regions[len(legs)][int(number)])
    return tuple(legs)


def other_passages(
    regions: Regions,
    ends: Sequence[np.ndarray],
    corridors: Sequence[Corridor | None],
    *,
    count: int,
    seed: int = 0,
) -> list[Passage]:
    """Return alternative passages, each of which is the shortest one for randomly scaled lengths between regions.

    The shortest polyline does not always lead to the fastest path, so alternatives are also tried.

    Args:
        regions: all regions.
        ends: free points (k, 3) of each waypoint, m. There is one waypoint more than legs.
        corridors: corridor of each leg, which it must not leave; None for a leg without a corridor.
        count: number of random draws. Passages that are drawn repeatedly are returned once.
        seed: seed of the random numbers.
    """
    from scipy.sparse.csgraph import dijkstra

    random = np.random.default_rng(seed)
    containing = [regions.containing(points) for points in ends]
    lengths = [
        _distance_matrix(regions, containing[i : i + 2], ends[i : i + 2], corridor)
        for i, corridor in enumerate(corridors)
    ]
    passages: dict[Passage, None] = {}
    for _ in range(count):
        legs = []
        for matrix in lengths:
            factors = np.exp(_LOG_FACTOR_DEVIATION * random.standard_normal(matrix.shape))
            predecessors = dijkstra(matrix * factors, indices=len(matrix) - 2, return_predecessors=True)[1]
            leg, number = [], int(predecessors[-1])
            while 0 <= number < len(regions):
                leg.append(number)
                number = int(predecessors[number])
            legs.append(tuple(leg[::-1]))
        if all(legs):
            passages[tuple(legs)] = None
    return list(passages)


def _distance_matrix(
    regions: Regions, containing: Sequence[np.ndarray], ends: Sequence[np.ndarray], corridor: Corridor | None
) -> np.ndarray:
    """Return a matrix of transition lengths between regions, m; zero means that there is no transition.

    The length of a transition is measured from centre to centre through the centre of the intersection, and includes
    the transition cost. The last two rows and columns are the start and the end of the leg.
    """
    count = len(regions)
    lengths = np.zeros((count + 2, count + 2))
    centres = np.array([regions[number].centre for number in range(count)])
    allowed = set(_regions_in_corridor(regions, range(count), corridor))
    for i, j in itertools.combinations(sorted(allowed), 2):
        if _are_connected(regions, i, j, corridor):
            intersection = regions.intersection(i, j)
            assert intersection is not None
            length = np.linalg.norm(centres[[i, j]] - intersection.centre, axis=1).sum() + _TRANSITION_COST
            lengths[i, j] = lengths[j, i] = length
    for end, (points, contains) in enumerate(zip(ends, containing, strict=True)):
        for number in np.flatnonzero(contains.any(axis=1)):
            if number in allowed:
                distances = np.linalg.norm(points[contains[number]] - centres[number], axis=1)
                length = float(distances.min()) + _TRANSITION_COST
                lengths[count + end, number] = lengths[number, count + end] = length
    return lengths


def _regions_in_corridor(regions: Regions, numbers: Sequence[int], corridor: Corridor | None) -> list[int]:
    """Return the indices of the regions whose intersection with a corridor is wide enough for a path."""
    return [number for number in numbers if corridor is None or _is_wide(regions[number].intersection(corridor))]


def _are_connected(regions: Regions, one: int, other: int, corridor: Corridor | None) -> bool:
    """Return whether a path within a corridor can cross from one region to another."""
    intersection = regions.intersection(one, other)
    return intersection is not None and (corridor is None or _is_wide(intersection.intersection(corridor)))


def _is_wide(region: Polytope | None) -> bool:
    """Return whether an intersection exists and is wide enough for a transition."""
    return region is not None and region.radius > MIN_COMMON_RADIUS


def _intersects(region: HPolyhedron, waypoint: WaypointRegion) -> bool:
    """Return whether a region and a waypoint have a common point."""
    if isinstance(waypoint, Box) and waypoint.is_point:
        return region.PointInSet(waypoint.centre, 1e-9)
    return region.IntersectsWith(_convex_set(waypoint))


def _convex_set(waypoint: WaypointRegion) -> ConvexSet:
    """Convert the region of a waypoint to a Drake convex set."""
    if isinstance(waypoint, Sphere):
        return Hyperellipsoid.MakeHypersphere(waypoint.radius, waypoint.centre)
    if isinstance(waypoint, Polytope):
        return HPolyhedron(waypoint.normals, waypoint.offsets)
    return Point(waypoint.centre) if waypoint.is_point else Hyperrectangle(waypoint.low, waypoint.high)


def candidate_regions(regions: Regions, chain: Sequence[int], points: np.ndarray, lengths: np.ndarray) -> list[int]:
    """Return the indices of a leg's candidate regions: first those of its chain, then those on short routes.

    Args:
        regions: all regions.
        chain: indices of the regions of the leg's chain.
        points: (n, 3) free points, m.
        lengths: (n,) weighted length of the shortest route through each point, m.
    """
    containing = regions.containing(points)
    shortest = np.where(containing, lengths, np.inf).min(axis=1, initial=np.inf)
    chosen = list(dict.fromkeys(chain))
    for number in np.argsort(shortest, kind="stable").tolist():
        if len(chosen) >= _MAX_CANDIDATES or shortest[number] == np.inf:
            break
        if number not in chosen:
            chosen.append(number)
    return chosen
