"""The regions to fly through: a shortest path in a graph of convex sets.

A way over a grid says which regions are worth a look: those that it leads through, and those that a way not much longer
does. Among them Drake searches the shortest polyline, the handover from region to region at a price.

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
from drake_quad.space.regions import NARROWEST, Regions

# Regions of a leg among which the graph is searched, those of its chain or more: it takes half a second for so many.
_MOST = 8
# What a handover costs, m of length: a path of fewer segments turns less.
_HANDOVER = 0.1
_ROUNDED_PATHS = 10
# Of the logarithm of the random numbers by which lengths are multiplied.
_SPREAD = 0.6
# Regions, and halvings of steps of a way, for one leg.
_LONGEST_CHAIN = 60


Passage = tuple[tuple[int, ...], ...]
"""For each leg from place to place, the numbers of the regions in the order in which they are flown."""


def chain(regions: Regions, way: np.ndarray) -> list[int]:
    """Regions that follow a way, each having something in common with the next; some are grown where none does.

    Args:
        regions: to choose from.
        way: (n, 3) points, free as the straight lines between them are, m.

    Returns:
        Their numbers; what was found until there if the way cannot be followed to its end.
    """
    points = [*way]
    chosen: list[int] = []
    for _ in range(_LONGEST_CHAIN):
        inside = regions.holding(np.array(points))
        steps = inside[:, :-1] & inside[:, 1:]
        # How many steps each region follows from here.
        follows = np.cumprod(steps, axis=1).sum(axis=1)
        best = next(
            (
                number
                for number in np.argsort(-follows, kind="stable").tolist()
                if follows[number] and (not chosen or (number != chosen[-1] and regions.common(chosen[-1], number)))
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
    places: Sequence[WaypointRegion],
    corridors: Sequence[Corridor | None],
    *,
    ends: Sequence[np.ndarray] | None = None,
) -> Passage | None:
    """Return the shortest passage; None if there is none.

    Args:
        regions: all regions.
        candidates: indices of the regions that each leg may use.
        places: (legs + 1) places to pass.
        corridors: corridor of each leg, which it must not leave; None for a leg without a corridor.
        ends: for each place, (regions,) flags of the regions in which a leg may start or end there; all of them if not
            given.
    """
    graph = GcsTrajectoryOptimization(3)
    # A place takes no time to pass; Drake wants a little.
    stops = [graph.AddRegions([_set(place)], 0, h_max=1e-6, name=f"place {i}") for i, place in enumerate(places)]
    kept = [_within(regions, numbers, corridor) for numbers, corridor in zip(candidates, corridors, strict=True)]
    if not all(kept):
        return None
    for leg, (numbers, corridor) in enumerate(zip(kept, corridors, strict=True)):
        pairs = [
            (i, j)
            for i, j in itertools.permutations(range(len(numbers)), 2)
            if _lead_to_each_other(regions, numbers[i], numbers[j], corridor)
        ]
        inside = [regions[n] if corridor is None else regions[n].intersection(corridor) for n in numbers]
        sets = [HPolyhedron(region.normals, region.offsets) for region in inside if region is not None]
        part = graph.AddRegions(sets, pairs, 1, name=f"leg {leg}")
        # Drake would find by linear programs which regions have a place, and gives up where one of them fails.
        first, last = (
            [n for n, region in enumerate(sets) if (ends is None or ends[i][numbers[n]]) and _has(region, places[i])]
            for i in (leg, leg + 1)
        )
        graph.AddEdges(stops[leg], part, edges_between_regions=[(0, n) for n in first])
        graph.AddEdges(part, stops[leg + 1], edges_between_regions=[(n, 0) for n in last])
    graph.AddPathLengthCost(1.0)
    convex = graph.graph_of_convex_sets()
    for edge in convex.Edges():
        edge.AddCost(_HANDOVER)
    options = GraphOfConvexSetsOptions()
    options.convex_relaxation, options.preprocessing, options.solver = True, True, ClarabelSolver()
    options.max_rounded_paths, options.rounding_seed = _ROUNDED_PATHS, 0
    with without_drake_remarks():
        _, result = graph.SolvePath(stops[0], stops[-1], options)
    if not result.is_success():
        return None
    edges = convex.GetSolutionPath(stops[0].Vertices()[0], stops[-1].Vertices()[0], result)
    legs: list[tuple[int, ...]] = []
    flown: list[int] = []
    for edge in edges:
        name, number = edge.v().name().split(": Region")
        if name.startswith("place"):
            legs.append(tuple(flown))
            flown = []
        else:
            flown.append(kept[len(legs)][int(number)])
    return tuple(legs)


def other_passages(
    regions: Regions,
    ends: Sequence[np.ndarray],
    corridors: Sequence[Corridor | None],
    *,
    count: int,
    seed: int = 0,
) -> list[Passage]:
    """Passages that are shortest from centre to centre, where every length is multiplied by a random number.

    The shortest polyline is not always the soonest flown: these are others to choose from.

    Args:
        regions: all.
        ends: for each of the legs + 1 places its free points (k, 3), m.
        corridors: that the legs must not leave, either; None for those without one.
        count: how many are drawn; those that are drawn twice come once.
        seed: of the random numbers.
    """
    from scipy.sparse.csgraph import dijkstra

    random = np.random.default_rng(seed)
    holding = [regions.holding(points) for points in ends]
    lengths = [_lengths(regions, holding[i : i + 2], ends[i : i + 2], corridor) for i, corridor in enumerate(corridors)]
    found: dict[Passage, None] = {}
    for _ in range(count):
        legs = []
        for known in lengths:
            factors = np.exp(_SPREAD * random.standard_normal(known.shape))
            before = dijkstra(known * factors, indices=len(known) - 2, return_predecessors=True)[1]
            leg, number = [], int(before[-1])
            while 0 <= number < len(regions):
                leg.append(number)
                number = int(before[number])
            legs.append(tuple(leg[::-1]))
        if all(legs):
            found[tuple(legs)] = None
    return list(found)


def _lengths(
    regions: Regions, holding: Sequence[np.ndarray], ends: Sequence[np.ndarray], corridor: Corridor | None
) -> np.ndarray:
    """From region to region by their centres and that of what they have in common, m; the last two are the ends."""
    count = len(regions)
    lengths = np.zeros((count + 2, count + 2))
    centres = np.array([regions[number].centre for number in range(count)])
    allowed = set(_within(regions, range(count), corridor))
    for i, j in itertools.combinations(sorted(allowed), 2):
        if _lead_to_each_other(regions, i, j, corridor):
            common = regions.common(i, j)
            assert common is not None
            length = np.linalg.norm(centres[[i, j]] - common.centre, axis=1).sum() + _HANDOVER
            lengths[i, j] = lengths[j, i] = length
    for end, (points, held) in enumerate(zip(ends, holding, strict=True)):
        for number in np.flatnonzero(held.any(axis=1)):
            if number in allowed:
                away = np.linalg.norm(points[held[number]] - centres[number], axis=1)
                length = float(away.min()) + _HANDOVER
                lengths[count + end, number] = lengths[number, count + end] = length
    return lengths


def _within(regions: Regions, numbers: Sequence[int], corridor: Corridor | None) -> list[int]:
    """The numbers of the regions that have something in common with a corridor."""
    return [number for number in numbers if corridor is None or _is_wide(regions[number].intersection(corridor))]


def _lead_to_each_other(regions: Regions, one: int, other: int, corridor: Corridor | None) -> bool:
    both = regions.common(one, other)
    return both is not None and (corridor is None or _is_wide(both.intersection(corridor)))


def _is_wide(region: Polytope | None) -> bool:
    return region is not None and region.radius > NARROWEST


def _has(region: HPolyhedron, place: WaypointRegion) -> bool:
    """Is there a point of the place in the region?"""
    if isinstance(place, Box) and place.is_point:
        return region.PointInSet(place.centre, 1e-9)
    return region.IntersectsWith(_set(place))


def _set(place: WaypointRegion) -> ConvexSet:
    if isinstance(place, Sphere):
        return Hyperellipsoid.MakeHypersphere(place.radius, place.centre)
    if isinstance(place, Polytope):
        return HPolyhedron(place.normals, place.offsets)
    return Point(place.centre) if place.is_point else Hyperrectangle(place.low, place.high)


def worth_a_look(regions: Regions, ways: Sequence[int], points: np.ndarray, lengths: np.ndarray) -> list[int]:
    """Numbers of the regions that a leg is searched in: those of its chain, then by the shortest way through each.

    Args:
        regions: all.
        ways: numbers of the chain.
        points: (n, 3) free points, m.
        lengths: (n,) of the shortest way over each, m.
    """
    holding = regions.holding(points)
    shortest = np.where(holding, lengths, np.inf).min(axis=1, initial=np.inf)
    chosen = list(dict.fromkeys(ways))
    for number in np.argsort(shortest, kind="stable").tolist():
        if len(chosen) >= _MOST or shortest[number] == np.inf:
            break
        if number not in chosen:
            chosen.append(number)
    return chosen
