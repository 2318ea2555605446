"""A problem with obstacles as one with corridors: what the minimum-snap planner can hold a path to."""

import contextlib
import functools
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.reference.minimum_snap import snap_cost
from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.planner import GivenTimes, Heuristic, Shortest, Timing, plan_path
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.reference.regions import Box, Corridor, Place, Sphere, common, touch
from drake_quad.space.blocked import explain
from drake_quad.space.grid import Grid
from drake_quad.space.passage import Passage, chain, find_passage, other_passages, worth_a_look
from drake_quad.space.regions import SLACK, Regions
from drake_quad.space.space import Space

# Points of the grid that seeds regions, and its least spacing, m; where it shows no way, a finer one is tried.
_GRIDS = ((30_000, 0.05), (400_000, 0.03))
# Passages beside the shortest, and all whose time is shortened: that takes most of a second for each.
_OTHERS, _MOST_SHORTENED = 12, 4


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
    return WayAround(problem, np.arange(len(problem.places)))


def within(problem: PathProblem, bounds: Box | None) -> PathProblem:
    """A problem whose path stays in bounds, too.

    Raises:
        InputError: a corridor lies outside, or a waypoint.
    """
    if bounds is None:
        return problem
    corridors = [bounds if corridor is None else common(corridor, bounds) for corridor in problem.corridors]
    for i, corridor in enumerate(corridors):
        if corridor is None:
            raise InputError(f"the corridor of segment {i} lies outside the bounds of the space, {bounds} m")
    for i, place in enumerate(problem.places):
        if not touch(place, bounds):
            raise InputError(f"waypoint {i}, {place} m, lies outside the bounds of the space, {bounds} m")
    return PathProblem(problem.places, derivatives=problem.derivatives, corridors=corridors, limits=problem.limits)


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
    if isinstance(timing, Shortest) and len(ways) > _MOST_SHORTENED:
        quick = _planned(ways, Heuristic())
        # The shortest way in any case, and those that promise most.
        order = sorted(range(1, len(ways)), key=lambda i: quick[i][1])[: _MOST_SHORTENED - 1]
        ways = [ways[i] for i in (0, *order)]
    tried = _planned(ways, timing)
    best = min(range(len(ways)), key=lambda i: tried[i][1])
    path, _ = tried[best]
    if path is None:
        plan_path(ways[best].problem, _timing_of(ways[best], timing))
        raise AssertionError("it raises")
    return path, ways[best]


def _planned(ways: Sequence[WayAround], timing: Timing) -> list[tuple[PolynomialPath | None, float]]:
    """The paths of ways, and what they cost; None and infinity where there is no path."""
    found: list[tuple[PolynomialPath | None, float]] = []
    for way in ways:
        try:
            path = plan_path(way.problem, _timing_of(way, timing))
        except InputError:
            found.append((None, np.inf))
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
    for most, finest in _GRIDS:
        grid = Grid.of(space, bounds, most=most, finest=finest)
        places = _free_places(problem, space, grid)
        found = _ways(space, bounds, problem, grid, places)
        if found:
            return found
    raise InputError(explain(space, bounds, places))


def check_places(space: Space, problem: PathProblem) -> None:
    """Raises InputError if a waypoint that is a point is nearer to an obstacle than the clearance."""
    for i, place in enumerate(problem.places):
        if isinstance(place, Box) and place.is_point:
            (distance,), (number,) = space.nearest(place.centre[np.newaxis])
            if distance < space.clearance + SLACK:
                raise InputError(
                    f"waypoint {i}, {place} m, is {distance:.3g} m from {space.names[number]}, but the clearance is"
                    f" {space.clearance:.3g} m ({space.clearance_in_words})"
                )


def _ways(space: Space, bounds: Box, problem: PathProblem, grid: Grid, places: np.ndarray) -> list[WayAround]:
    """Those that a grid leads to, through free points (n, 3) of the places, m."""
    clearance = space.clearance + SLACK
    free = grid.nearest >= clearance

    @functools.cache
    def field(number: int, leg: int | None) -> tuple[np.ndarray, np.ndarray]:
        corridor = None if leg is None else problem.corridors[leg]
        return grid.lengths_from(
            places[number], clearance, None if corridor is None else _inside(corridor, grid.points)
        )

    regions = Regions(space, bounds)
    for place in places:
        if not regions.holding(place[np.newaxis]).any():
            regions.grow(place)
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
    passage = find_passage(regions, candidates, problem.places, problem.corridors)
    if passage is None:
        return []
    others = [each for each in other_passages(regions, places, problem.corridors, count=_OTHERS) if each != passage]
    ways = [_with_corridors(problem, regions, passage)]
    for other in others:
        # What is common to a place and the regions around it may be nothing to speak of.
        with contextlib.suppress(InputError):
            ways.append(_with_corridors(problem, regions, other))
    return ways


def _free_places(problem: PathProblem, space: Space, grid: Grid) -> np.ndarray:
    """(n, 3) a free point of each place, m.

    Raises:
        InputError: no point of the grid in a place is free.
    """
    points = problem.representatives()
    distances, numbers = space.nearest(points)
    for i, place in enumerate(problem.places):
        if distances[i] < space.clearance + SLACK:
            inside = grid.points[(grid.nearest >= space.clearance + SLACK) & _inside(place, grid.points)]
            if not len(inside):
                raise InputError(
                    f"waypoint {i}, {place} m, leaves no room at {space.clearance:.3g} m from obstacles"
                    f" ({space.clearance_in_words}): {space.names[numbers[i]]} is too near"
                )
            points[i] = inside[np.linalg.norm(inside - points[i], axis=1).argmin()]
    return points


def _inside(place: Place, points: np.ndarray) -> np.ndarray:
    """(n,) whether points (n, 3), m, are in a place."""
    match place:
        case Box():
            return np.asarray(((place.low <= points) & (points <= place.high)).all(axis=1))
        case Sphere():
            return np.asarray(np.linalg.norm(points - place.centre, axis=1) <= place.radius)
    return np.asarray((points @ place.normals.T <= place.offsets).all(axis=1))


def _with_corridors(problem: PathProblem, regions: Regions, passage: Passage) -> WayAround:
    """The problem with a passage's regions as corridors."""
    places: list[Place] = []
    corridors: list[Corridor] = []
    waypoints = []
    for place, leg, corridor in zip(problem.places[:-1], passage, problem.corridors, strict=True):
        waypoints.append(len(places))
        inside = [_both(regions[number], corridor) for number in leg]
        handovers = [_both(one, other) for one, other in itertools.pairwise(inside)]
        places += [place, *handovers]
        corridors += inside
    waypoints.append(len(places))
    places.append(problem.places[-1])
    derivatives = np.full((len(places), *problem.derivatives.shape[1:]), np.nan)
    derivatives[waypoints] = problem.derivatives
    inner = PathProblem(places, derivatives=derivatives, corridors=corridors, limits=problem.limits)
    return WayAround(inner, np.array(waypoints))


def _both(region: Corridor, corridor: Corridor | None) -> Corridor:
    found = region if corridor is None else common(region, corridor)
    assert found is not None, "seen to by the search"
    return found
