"""Planning around obstacles: a search for free corridors, within which the minimum-snap planner plans the path."""

import contextlib
import functools
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from pydrake.geometry.optimization import HPolyhedron, Hyperrectangle

from drake_quad.errors import InputError
from drake_quad.reference.minimum_snap import snap_cost
from drake_quad.reference.path_problem import PathLimits, PathProblem
from drake_quad.reference.planner import (
    FixedTimes,
    HeuristicTiming,
    MinimumSnapTiming,
    MinimumTimeTiming,
    Timing,
    plan_path,
)
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.reference.regions import Box, Corridor, Sphere, WaypointRegion, intersection_of, overlap
from drake_quad.space.blockage import explain_blockage
from drake_quad.space.grid import Grid, is_near
from drake_quad.space.passage import Passage, candidate_regions, find_passage, other_passages, region_chain
from drake_quad.space.regions import SLACK, Regions
from drake_quad.space.space import Space

# Largest number of points and smallest spacing (m) of the grids that provide seeds for regions. The second grid is
# tried if the first one contains no route.
_GRIDS = ((30_000, 0.05), (400_000, 0.03))
# Number of grid points along each axis at which a waypoint's region is checked for clearance.
_POINTS_PER_AXIS = 21
# Largest number of pieces that are considered if obstacles divide a waypoint's region. Pieces near the middle of the
# region come first.
_MAX_PIECES = 4
# Number of random draws, each of which yields an alternative to the shortest passage.
_NUM_OTHER_PASSAGES = 12
# Largest number of routes whose times are optimised. One optimisation takes almost a second.
_MAX_OPTIMISED_ROUTES = 3
# Arbitrary limits for the comparison of routes if the problem has no limits.
_ANY_LIMITS = PathLimits(acceleration=1.0)


class CollisionFreeRoute(NamedTuple):
    """Route around obstacles, as a planning problem with corridors.

    Attributes:
        problem: problem whose corridors are free of obstacles. Where two corridors meet, it has an additional waypoint
            in their intersection.
        waypoints: (waypoints,) indices of the original waypoints in the problem's list of waypoints.
    """

    problem: PathProblem
    waypoints: np.ndarray


def direct_route(problem: PathProblem) -> CollisionFreeRoute:
    """Return the route of a problem without additional waypoints or corridors, for use if no obstacle is in the way."""
    return CollisionFreeRoute(problem, np.arange(len(problem.waypoints)))


def with_bounds(problem: PathProblem, bounds: Box | None) -> PathProblem:
    """Add to a problem the constraint that the path stays within bounds.

    Raises:
        InputError: if a corridor or a waypoint lies outside the bounds.
    """
    if bounds is None:
        return problem
    corridors = [bounds if corridor is None else intersection_of(corridor, bounds) for corridor in problem.corridors]
    for i, corridor in enumerate(corridors):
        if corridor is None:
            raise InputError(f"the corridor of segment {i} lies outside the bounds of the space, {bounds} m")
    for i, region in enumerate(problem.waypoints):
        if not overlap(region, bounds):
            raise InputError(f"waypoint {i}, {region} m, lies outside the bounds of the space, {bounds} m")
    return PathProblem(problem.waypoints, derivatives=problem.derivatives, corridors=corridors, limits=problem.limits)


def plan_collision_free_path(
    space: Space, bounds: Box, problem: PathProblem, timing: Timing
) -> tuple[PolynomialPath, CollisionFreeRoute]:
    """Plan a path around obstacles. The result is deterministic.

    If there are several passages, the timing determines which path is best: the one with the shortest time, or the one
    with the smallest snap if the total time is given.

    Args:
        space: obstacles.
        bounds: bounds of the centre of mass.
        problem: waypoints, corridors, derivatives and limits of the path.
        timing: method that chooses the waypoint times.

    Returns:
        The path, and the route around obstacles with its corridors.

    Raises:
        InputError: if no path exists or is found. The message names the obstacles in the way.
    """
    routes = _routes_around(space, bounds, problem)
    if isinstance(timing, MinimumTimeTiming | MinimumSnapTiming) and len(routes) > _MAX_OPTIMISED_ROUTES:
        # The shortest route is always optimised, in addition to the routes with the lowest estimated cost.
        order = sorted(range(1, len(routes)), key=lambda i: _estimated_cost(routes[i], timing))[
            : _MAX_OPTIMISED_ROUTES - 1
        ]
        routes = [routes[i] for i in (0, *order)]
    results = _paths_and_costs(routes, timing)
    best = min(range(len(routes)), key=lambda i: results[i][1])
    path, _ = results[best]
    if isinstance(path, InputError):
        raise path
    return path, routes[best]


def _estimated_cost(route: CollisionFreeRoute, timing: Timing) -> float:
    """Estimate the cost of a route from a path with heuristic times, or return infinity if there is no path."""
    problem = route.problem
    if not problem.limits.by_order:
        problem = PathProblem(
            problem.waypoints, derivatives=problem.derivatives, corridors=problem.corridors, limits=_ANY_LIMITS
        )
    try:
        path = plan_path(problem, HeuristicTiming())
    except InputError:
        return np.inf
    if not isinstance(timing, MinimumSnapTiming):
        return path.duration
    # The integral of the squared snap is proportional to the seventh power of the speed.
    return float(snap_cost(path).sum()) * (path.duration / timing.duration) ** 7


def _paths_and_costs(
    routes: Sequence[CollisionFreeRoute], timing: Timing
) -> list[tuple[PolynomialPath | InputError, float]]:
    """Return the path and its cost for each route, or the error and infinity for a route without a path."""
    results: list[tuple[PolynomialPath | InputError, float]] = []
    for route in routes:
        try:
            path = plan_path(route.problem, _timing_for(route, timing))
        except InputError as error:
            results.append((error, np.inf))
        else:
            minimises_time = isinstance(timing, MinimumTimeTiming | HeuristicTiming)
            results.append((path, path.duration if minimises_time else float(snap_cost(path).sum())))
    return results


def _timing_for(route: CollisionFreeRoute, timing: Timing) -> Timing:
    """Return the timing for a route with additional waypoints.

    If the times of the original waypoints are fixed, the times of additional waypoints are interpolated linearly along
    the polyline through all waypoints.
    """
    if not isinstance(timing, FixedTimes):
        return timing
    steps = np.linalg.norm(np.diff(route.problem.representatives(), axis=0), axis=1)
    # The small increment keeps the lengths increasing if successive waypoints are equal.
    lengths = np.concatenate([[0.0], np.cumsum(steps + 1e-3)])
    return FixedTimes(tuple(np.interp(lengths, lengths[route.waypoints], timing.times).tolist()))


def _routes_around(space: Space, bounds: Box, problem: PathProblem) -> list[CollisionFreeRoute]:
    """Return routes around obstacles, the shortest route first.

    Raises:
        InputError: if no route is found.
    """
    free = _free_points(problem, space, bounds)
    for max_points, min_spacing in _GRIDS:
        routes = _routes(
            space, bounds, problem, Grid.of(space, bounds, max_points=max_points, min_spacing=min_spacing), free
        )
        if routes:
            return routes
    raise InputError(explain_blockage(space, bounds, problem))


def check_waypoint_clearance(space: Space, problem: PathProblem) -> None:
    """Raise InputError if a point waypoint is closer to an obstacle than the clearance."""
    for i, region in enumerate(problem.waypoints):
        if isinstance(region, Box) and region.is_point:
            (distance,), (number,) = space.nearest(region.centre[np.newaxis])
            if distance < space.clearance + SLACK:
                raise InputError(
                    f"waypoint {i}, {region} m, is {distance:.3g} m from {space.names[number]}, but the clearance is"
                    f" {space.clearance:.3g} m ({space.clearance_text})"
                )


def _routes(
    space: Space, bounds: Box, problem: PathProblem, grid: Grid, free_points: Sequence[np.ndarray]
) -> list[CollisionFreeRoute]:
    """Return routes on a grid that pass each waypoint at any of its free points, (k, 3) in m."""
    routes = _routes_through(space, bounds, problem, grid, free_points)
    if routes:
        return routes
    # If an obstacle divides a waypoint's region, one leg may end in one piece of the region while the next leg starts
    # in another piece. The legs are therefore searched again with only one piece for each waypoint.
    pieces = [_split_into_pieces(space, points) for points in free_points]
    nearest_pieces = _pieces_on_shortest_route(space, problem, grid, pieces) if max(map(len, pieces)) > 1 else None
    return [] if nearest_pieces is None else _routes_through(space, bounds, problem, grid, nearest_pieces, divided=True)


def _split_into_pieces(space: Space, points: np.ndarray) -> list[np.ndarray]:
    """Divide the free points of a waypoint, (k, 3) in m, into groups, called pieces.

    In each piece, the straight lines from the first point to all other points are free.
    """
    pieces: list[np.ndarray] = []
    fractions = np.linspace(0.0, 1.0, _POINTS_PER_AXIS)[:, np.newaxis, np.newaxis]
    while len(points) and len(pieces) < _MAX_PIECES:
        between = points[0] + fractions * (points - points[0])
        distances = space.nearest(between.reshape(-1, 3))[0].reshape(len(fractions), -1)
        is_joined = distances.min(axis=0) >= space.clearance
        is_joined[0] = True
        pieces.append(points[is_joined])
        points = points[~is_joined]
    return pieces


def _pieces_on_shortest_route(
    space: Space, problem: PathProblem, grid: Grid, pieces: Sequence[Sequence[np.ndarray]]
) -> list[np.ndarray] | None:
    """Return the piece of each waypoint through which the shortest route on the grid leads; None if there is no route.

    Args:
        space: obstacles.
        problem: problem with the waypoints.
        grid: grid of free points of the space.
        pieces: for each waypoint, the pieces into which `_split_into_pieces` divides its free points, (k, 3) in m.
    """
    lengths, origins = np.zeros(len(pieces[0])), []
    for corridor, begins, ends in zip(problem.corridors, pieces[:-1], pieces[1:], strict=True):
        inside = None if corridor is None else is_near(corridor, grid.points)
        fields = [grid.route_lengths(points, space.clearance + SLACK, inside)[0] for points in begins]
        total = lengths[:, np.newaxis] + [[grid.nearest_end(field, points)[0] for points in ends] for field in fields]
        origins.append(total.argmin(axis=0))
        lengths = total.min(axis=0)
    if not np.isfinite(lengths).any():
        return None
    numbers = [int(lengths.argmin())]
    for origin in origins[::-1]:
        numbers.append(int(origin[numbers[-1]]))
    return [parts[number] for parts, number in zip(pieces, numbers[::-1], strict=True)]


def _routes_through(
    space: Space,
    bounds: Box,
    problem: PathProblem,
    grid: Grid,
    free_points: Sequence[np.ndarray],
    *,
    divided: bool = False,
) -> list[CollisionFreeRoute]:
    """Return routes whose legs connect free points of successive waypoints.

    Args:
        space: obstacles.
        bounds: bounds of the centre of mass.
        problem: problem with the waypoints.
        grid: grid of free points of the space.
        free_points: free points (k, 3) of each waypoint, m.
        divided: True if an obstacle divides the free points of a waypoint, and `free_points` contains only one piece of
            them. Each leg must then start and end in convex regions that contain points of this piece.
    """
    clearance = space.clearance + SLACK
    free = grid.nearest >= clearance

    @functools.cache
    def field(number: int, leg: int | None) -> tuple[np.ndarray, np.ndarray]:
        corridor = None if leg is None else problem.corridors[leg]
        return grid.route_lengths(
            free_points[number], clearance, None if corridor is None else is_near(corridor, grid.points)
        )

    regions = Regions(space, bounds)
    for waypoint_points in free_points:
        if not regions.containing(waypoint_points).any():
            regions.grow(waypoint_points[0])
    points = grid.points[free]
    regions.cover(points, grid.nearest[free])
    candidates = []
    for i, corridor in enumerate(problem.corridors):
        # The legs before and after a waypoint share one search for routes from this waypoint. A leg with a corridor has
        # its own searches.
        leg = None if corridor is None else i
        (lengths, before), (onward, _) = field(i, leg), field(i + 1, leg)
        route = grid.shortest_route(lengths, before, free_points[i], free_points[i + 1])
        if route is None:
            return []
        candidates.append(candidate_regions(regions, region_chain(regions, route), points, (lengths + onward)[free]))
    ends = [regions.containing(points).any(axis=1) for points in free_points] if divided else None
    passage = find_passage(regions, candidates, problem.waypoints, problem.corridors, ends=ends)
    if passage is None:
        return []
    others = [
        other
        for other in other_passages(regions, free_points, problem.corridors, count=_NUM_OTHER_PASSAGES)
        if other != passage
    ]
    routes = [with_corridors(problem, regions, passage)]
    for other in others:
        # The solver can fail if the intersection of a waypoint's region with adjacent regions is too small.
        with contextlib.suppress(InputError):
            routes.append(with_corridors(problem, regions, other))
    return routes


def _free_points(problem: PathProblem, space: Space, bounds: Box) -> list[np.ndarray]:
    """Return the free points of each waypoint, (k, 3) in m, sorted by distance from the middle of its region.

    If a waypoint is a point, only this point is checked. Otherwise the points of a grid over its region are checked.

    Raises:
        InputError: if a waypoint has no free point.
    """
    free_points = []
    for i, (region, middle) in enumerate(zip(problem.waypoints, problem.representatives(), strict=True)):
        points, diagonal = _points_in(region)
        points = np.vstack([middle, points[is_near(region, points)]])
        distances, numbers = space.nearest(points)
        free = points[(distances >= space.clearance + SLACK) & is_near(bounds, points)]
        if not len(free):
            farthest = int(distances.argmax())
            count = "no point" if distances[farthest] + 0.5 * diagonal < space.clearance else "almost no point"
            raise InputError(
                f"waypoint {i}, {region} m, contains {count} with a clearance of {space.clearance:.3g} m"
                f" ({space.clearance_text}): {space.names[numbers[farthest]]} is too near"
            )
        free_points.append(free[np.linalg.norm(free - middle, axis=1).argsort(kind="stable")])
    return free_points


def _points_in(region: WaypointRegion) -> tuple[np.ndarray, float]:
    """Return the points of a grid that covers a waypoint's region, (n, 3) in m, and the diagonal of a cell, m."""
    match region:
        case Box():
            low, high = region.low, region.high
        case Sphere():
            low, high = region.centre - region.radius, region.centre + region.radius
        case _:
            around = Hyperrectangle.MaybeCalcAxisAlignedBoundingBox(HPolyhedron(region.normals, region.offsets))
            low, high = around.lb(), around.ub()
    axes = [np.linspace(a, b, _POINTS_PER_AXIS if b > a else 1) for a, b in zip(low, high, strict=True)]
    diagonal = float(np.linalg.norm([axis[1] - axis[0] for axis in axes if len(axis) > 1]))
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3), diagonal


def with_corridors(problem: PathProblem, regions: Regions, passage: Passage) -> CollisionFreeRoute:
    """Add the regions of a passage to a problem as corridors.

    Raises:
        InputError: if a waypoint and the regions before and after it have too small an intersection.
    """
    waypoint_regions: list[WaypointRegion] = []
    corridors: list[Corridor] = []
    waypoints = []
    for region, leg, corridor in zip(problem.waypoints[:-1], passage, problem.corridors, strict=True):
        waypoints.append(len(waypoint_regions))
        inside = [_intersection(regions[number], corridor) for number in leg]
        handovers = [_intersection(one, other) for one, other in itertools.pairwise(inside)]
        waypoint_regions += [region, *handovers]
        corridors += inside
    waypoints.append(len(waypoint_regions))
    waypoint_regions.append(problem.waypoints[-1])
    derivatives = np.full((len(waypoint_regions), *problem.derivatives.shape[1:]), np.nan)
    derivatives[waypoints] = problem.derivatives
    divided_problem = PathProblem(waypoint_regions, derivatives=derivatives, corridors=corridors, limits=problem.limits)
    return CollisionFreeRoute(divided_problem, np.array(waypoints))


def _intersection(region: Corridor, corridor: Corridor | None) -> Corridor:
    """Return the part of a region within a corridor."""
    intersection = region if corridor is None else intersection_of(region, corridor)
    assert intersection is not None, "checked by the search"
    return intersection
