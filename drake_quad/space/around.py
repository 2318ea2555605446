"""A problem with obstacles as one with corridors: what the minimum-snap planner can hold a path to."""

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
from drake_quad.reference.planner import GivenTimes, Heuristic, LeastSnap, Shortest, Timing, plan_path
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.reference.regions import Box, Corridor, Sphere, WaypointRegion, intersection_of, overlap
from drake_quad.space.blocked import explain
from drake_quad.space.grid import Grid, is_near
from drake_quad.space.passage import Passage, chain, find_passage, other_passages, worth_a_look
from drake_quad.space.regions import SLACK, Regions
from drake_quad.space.space import Space

# Points of the grid that seeds regions, and its least spacing, m; where it shows no way, a finer one is tried.
_GRIDS = ((30_000, 0.05), (400_000, 0.03))
# Of a place that is not a point, so many points are looked at on each axis.
_POINTS = 21
# Pieces of a place that obstacles divide, the nearest to its middle first.
_MAX_PIECES = 4
# Passages beside the shortest, and all whose times are searched for: that takes most of a second for each.
_OTHERS, _MOST_SEARCHED = 12, 3
# Without limits ways are compared as with these.
_ANY_LIMITS = PathLimits(acceleration=1.0)


class WayAround(NamedTuple):
    """A way around obstacles.

    Attributes:
        problem: with the regions to fly through as corridors, and a waypoint anywhere between two of them.
        waypoints: (waypoints,) the numbers of the given places among those of the problem.
    """

    problem: PathProblem
    waypoints: np.ndarray


def straight_on(problem: PathProblem) -> WayAround:
    """Past obstacles that are not in the way."""
    return WayAround(problem, np.arange(len(problem.waypoints)))


def within(problem: PathProblem, bounds: Box | None) -> PathProblem:
    """A problem whose path stays in bounds, too.

    Raises:
        InputError: a corridor lies outside, or a waypoint.
    """
    if bounds is None:
        return problem
    corridors = [bounds if corridor is None else intersection_of(corridor, bounds) for corridor in problem.corridors]
    for i, corridor in enumerate(corridors):
        if corridor is None:
            raise InputError(f"the corridor of segment {i} lies outside the bounds of the space, {bounds} m")
    for i, place in enumerate(problem.waypoints):
        if not overlap(place, bounds):
            raise InputError(f"waypoint {i}, {place} m, lies outside the bounds of the space, {bounds} m")
    return PathProblem(problem.waypoints, derivatives=problem.derivatives, corridors=corridors, limits=problem.limits)


def plan_around(space: Space, bounds: Box, problem: PathProblem, timing: Timing) -> tuple[PolynomialPath, WayAround]:
    """Plans a path around obstacles; the same for the same arguments.

    Of several passages, that is taken whose path is best by the measure of its timing: the shortest time, or the least
    snap where the time is given.

    Args:
        space: the obstacles.
        bounds: for the centre of mass.
        problem: whose corridors, where it has any, hold here, too.
        timing: how the path's times are chosen.

    Raises:
        InputError: there is no such path, or none was found; the message says what is in the way.
    """
    ways = _ways_around(space, bounds, problem)
    if isinstance(timing, Shortest | LeastSnap) and len(ways) > _MOST_SEARCHED:
        # The shortest way in any case, and those that promise most.
        order = sorted(range(1, len(ways)), key=lambda i: _promise(ways[i], timing))[: _MOST_SEARCHED - 1]
        ways = [ways[i] for i in (0, *order)]
    tried = _planned(ways, timing)
    best = min(range(len(ways)), key=lambda i: tried[i][1])
    path, _ = tried[best]
    if isinstance(path, InputError):
        raise path
    return path, ways[best]


def _promise(way: WayAround, timing: Timing) -> float:
    """What a way may cost, from a path whose times are not searched for."""
    problem = way.problem
    if not problem.limits.by_order:
        problem = PathProblem(
            problem.waypoints, derivatives=problem.derivatives, corridors=problem.corridors, limits=_ANY_LIMITS
        )
    try:
        path = plan_path(problem, Heuristic())
    except InputError:
        return np.inf
    if not isinstance(timing, LeastSnap):
        return path.duration
    # Snap goes with the seventh power of the speed.
    return float(snap_cost(path).sum()) * (path.duration / timing.duration) ** 7


def _planned(ways: Sequence[WayAround], timing: Timing) -> list[tuple[PolynomialPath | InputError, float]]:
    """The paths of ways, and what they cost; why there is none, and infinity, where there is no path."""
    found: list[tuple[PolynomialPath | InputError, float]] = []
    for way in ways:
        try:
            path = plan_path(way.problem, _timing_of(way, timing))
        except InputError as error:
            found.append((error, np.inf))
        else:
            chosen = isinstance(timing, Shortest | Heuristic)
            found.append((path, path.duration if chosen else float(snap_cost(path).sum())))
    return found


def _timing_of(way: WayAround, timing: Timing) -> Timing:
    """The timing of a way: where times are given, what is between them is passed by the polyline's length."""
    if not isinstance(timing, GivenTimes):
        return timing
    steps = np.linalg.norm(np.diff(way.problem.representatives(), axis=0), axis=1)
    # Waypoints may be on one point.
    lengths = np.concatenate([[0.0], np.cumsum(steps + 1e-3)])
    return GivenTimes(tuple(np.interp(lengths, lengths[way.waypoints], timing.times).tolist()))


def _ways_around(space: Space, bounds: Box, problem: PathProblem) -> list[WayAround]:
    """Ways around obstacles, the shortest first."""
    free = _free_points(problem, space, bounds)
    for most, finest in _GRIDS:
        found = _ways(space, bounds, problem, Grid.of(space, bounds, most=most, finest=finest), free)
        if found:
            return found
    raise InputError(explain(space, bounds, problem))


def check_places(space: Space, problem: PathProblem) -> None:
    """Raises InputError if a waypoint that is a point is nearer to an obstacle than the clearance."""
    for i, place in enumerate(problem.waypoints):
        if isinstance(place, Box) and place.is_point:
            (distance,), (number,) = space.nearest(place.centre[np.newaxis])
            if distance < space.clearance + SLACK:
                raise InputError(
                    f"waypoint {i}, {place} m, is {distance:.3g} m from {space.names[number]}, but the clearance is"
                    f" {space.clearance:.3g} m ({space.clearance_in_words})"
                )


def _ways(space: Space, bounds: Box, problem: PathProblem, grid: Grid, places: Sequence[np.ndarray]) -> list[WayAround]:
    """Return the ways that a grid leads to, through any of the free points (k, 3) of each place, m."""
    found = _ways_through(space, bounds, problem, grid, places)
    if found:
        return found
    # If an obstacle divides a place, one leg may have ended in one piece of it and the next leg started in another.
    pieces = [_pieces(space, points) for points in places]
    chosen = _on_one_way(space, problem, grid, pieces) if max(map(len, pieces)) > 1 else None
    return [] if chosen is None else _ways_through(space, bounds, problem, grid, chosen, divided=True)


def _pieces(space: Space, points: np.ndarray) -> list[np.ndarray]:
    """Split the free points (k, 3) of a place, m, into pieces.

    In each piece, a free straight line joins the first point to any other.
    """
    pieces: list[np.ndarray] = []
    shares = np.linspace(0.0, 1.0, _POINTS)[:, np.newaxis, np.newaxis]
    while len(points) and len(pieces) < _MAX_PIECES:
        between = points[0] + shares * (points - points[0])
        distances = space.nearest(between.reshape(-1, 3))[0].reshape(len(shares), -1)
        is_joined = distances.min(axis=0) >= space.clearance
        is_joined[0] = True
        pieces.append(points[is_joined])
        points = points[~is_joined]
    return pieces


def _on_one_way(
    space: Space, problem: PathProblem, grid: Grid, pieces: Sequence[Sequence[np.ndarray]]
) -> list[np.ndarray] | None:
    """Return, for each place, the piece that is on the shortest way over a grid; None if there is no way.

    Args:
        space: obstacles.
        problem: problem with the places.
        grid: grid of free points of the space.
        pieces: free points (k, 3) of each piece of each place, m.
    """
    lengths, origins = np.zeros(len(pieces[0])), []
    for corridor, begins, ends in zip(problem.corridors, pieces[:-1], pieces[1:], strict=True):
        inside = None if corridor is None else is_near(corridor, grid.points)
        fields = [grid.lengths_from(points, space.clearance + SLACK, inside)[0] for points in begins]
        total = lengths[:, np.newaxis] + [[grid.shortest(field, points)[0] for points in ends] for field in fields]
        origins.append(total.argmin(axis=0))
        lengths = total.min(axis=0)
    if not np.isfinite(lengths).any():
        return None
    numbers = [int(lengths.argmin())]
    for origin in origins[::-1]:
        numbers.append(int(origin[numbers[-1]]))
    return [parts[number] for parts, number in zip(pieces, numbers[::-1], strict=True)]


def _ways_through(
    space: Space,
    bounds: Box,
    problem: PathProblem,
    grid: Grid,
    places: Sequence[np.ndarray],
    *,
    divided: bool = False,
) -> list[WayAround]:
    """Return the ways on which each leg leads from a free point of one place to a free point of the next.

    Args:
        space: obstacles.
        bounds: bounds of the centre of mass.
        problem: problem with the places.
        grid: grid of free points of the space.
        places: free points (k, 3) of each place, m.
        divided: True if the points are those of one piece of each place only. Each leg must then start and end in
            regions that contain such points.
    """
    clearance = space.clearance + SLACK
    free = grid.nearest >= clearance

    @functools.cache
    def field(number: int, leg: int | None) -> tuple[np.ndarray, np.ndarray]:
        corridor = None if leg is None else problem.corridors[leg]
        return grid.lengths_from(
            places[number], clearance, None if corridor is None else is_near(corridor, grid.points)
        )

    regions = Regions(space, bounds)
    for place in places:
        if not regions.holding(place).any():
            regions.grow(place[0])
    points = grid.points[free]
    regions.cover(points, grid.nearest[free])
    candidates = []
    for i, corridor in enumerate(problem.corridors):
        # Without a corridor the ways from a place are the same for both of its legs.
        leg = None if corridor is None else i
        (lengths, before), (onward, _) = field(i, leg), field(i + 1, leg)
        way = grid.way(lengths, before, places[i], places[i + 1])
        if way is None:
            return []
        candidates.append(worth_a_look(regions, chain(regions, way), points, (lengths + onward)[free]))
    ends = [regions.holding(points).any(axis=1) for points in places] if divided else None
    passage = find_passage(regions, candidates, problem.waypoints, problem.corridors, ends=ends)
    if passage is None:
        return []
    others = [each for each in other_passages(regions, places, problem.corridors, count=_OTHERS) if each != passage]
    ways = [with_corridors(problem, regions, passage)]
    for other in others:
        # What is common to a place and the regions around it may be nothing to speak of.
        with contextlib.suppress(InputError):
            ways.append(with_corridors(problem, regions, other))
    return ways


def _free_points(problem: PathProblem, space: Space, bounds: Box) -> list[np.ndarray]:
    """For each place its free points (k, 3), m, the nearest to its middle first; a point alone, or some on a grid.

    Raises:
        InputError: none of them is free.
    """
    found = []
    for i, (place, middle) in enumerate(zip(problem.waypoints, problem.representatives(), strict=True)):
        points, diagonal = _points_of(place)
        points = np.vstack([middle, points[is_near(place, points)]])
        distances, numbers = space.nearest(points)
        free = points[(distances >= space.clearance + SLACK) & is_near(bounds, points)]
        if not len(free):
            most = int(distances.argmax())
            room = "no room" if distances[most] + 0.5 * diagonal < space.clearance else "next to no room"
            raise InputError(
                f"waypoint {i}, {place} m, leaves {room} at {space.clearance:.3g} m from obstacles"
                f" ({space.clearance_in_words}): {space.names[numbers[most]]} is too near"
            )
        found.append(free[np.linalg.norm(free - middle, axis=1).argsort(kind="stable")])
    return found


def _points_of(place: WaypointRegion) -> tuple[np.ndarray, float]:
    """(n, 3) points on a grid over a place, m, and the diagonal of its cells, m."""
    match place:
        case Box():
            low, high = place.low, place.high
        case Sphere():
            low, high = place.centre - place.radius, place.centre + place.radius
        case _:
            around = Hyperrectangle.MaybeCalcAxisAlignedBoundingBox(HPolyhedron(place.normals, place.offsets))
            low, high = around.lb(), around.ub()
    axes = [np.linspace(a, b, _POINTS if b > a else 1) for a, b in zip(low, high, strict=True)]
    diagonal = float(np.linalg.norm([each[1] - each[0] for each in axes if len(each) > 1]))
    return np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3), diagonal


def with_corridors(problem: PathProblem, regions: Regions, passage: Passage) -> WayAround:
    """The problem with a passage's regions as corridors.

    Raises:
        InputError: a place and the regions around it have nothing to speak of in common.
    """
    places: list[WaypointRegion] = []
    corridors: list[Corridor] = []
    waypoints = []
    for place, leg, corridor in zip(problem.waypoints[:-1], passage, problem.corridors, strict=True):
        waypoints.append(len(places))
        inside = [_both(regions[number], corridor) for number in leg]
        handovers = [_both(one, other) for one, other in itertools.pairwise(inside)]
        places += [place, *handovers]
        corridors += inside
    waypoints.append(len(places))
    places.append(problem.waypoints[-1])
    derivatives = np.full((len(places), *problem.derivatives.shape[1:]), np.nan)
    derivatives[waypoints] = problem.derivatives
    inner = PathProblem(places, derivatives=derivatives, corridors=corridors, limits=problem.limits)
    return WayAround(inner, np.array(waypoints))


def _both(region: Corridor, corridor: Corridor | None) -> Corridor:
    found = region if corridor is None else intersection_of(region, corridor)
    assert found is not None, "seen to by the search"
    return found
