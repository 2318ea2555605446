"""Explanation for a missing route: the waypoints between which no route exists, and the obstacles that block it."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.regions import Box
from drake_quad.space.grid import Grid, is_near
from drake_quad.space.space import Space

# Largest number of points and smallest spacing (m) of the grids on which routes are searched.
_GRIDS = ((500_000, 0.05), (3_000_000, 0.02))
# The removal of each set of up to this number of obstacles is tried. If none of these removals opens a route, the
# explanation names one larger set, all of whose obstacles must be removed.
_MAX_SET_SIZE = 2


def explain_blockage(space: Space, bounds: Box, problem: PathProblem) -> str:
    """Explain in one sentence between which waypoints there is no route, and which obstacles block it.

    A grid can prove that there is no route. Each point of a route has a nearest grid point, at most half a cell
    diagonal away. The nearest grid points of successive route points are equal or neighbours. Their distance from
    obstacles is at least the clearance minus half the diagonal, and they are at most half the diagonal outside the
    corridor of the leg, if it has one. If no chain of such grid points connects two waypoints, there is no route
    between them. If a chain connects them, a route may still not exist.

    Args:
        space: obstacles.
        bounds: bounds of the centre of mass.
        problem: waypoints and corridors of the path.
    """
    legs = len(problem.corridors)
    for max_points, min_spacing in _GRIDS:
        search = _Search(Grid.of(space, bounds, max_points=max_points, min_spacing=min_spacing), problem, certain=False)
        free = search.grid.nearest >= space.clearance - search.half_diagonal
        for last in range(1, legs + 1):
            # Each leg by itself may have a route although the legs cannot be joined, because they pass through
            # different parts of a waypoint's region. Therefore, the route from waypoint 0 is also checked.
            for first in dict.fromkeys((last - 1, 0)):
                if not search.connects(free, first, last):
                    return _sentence(space, problem, first, last, _blocking_sets(space, bounds, problem, first, last))
    return (
        f"no route was found with a clearance of {space.clearance:.3g} m ({space.clearance_text}); a route may exist"
        f" through gaps that are narrower than {2.0 * search.half_diagonal:.2g} m for the centre of mass"
    )


class _BlockingSets(NamedTuple):
    """Sets of obstacles. The removal of any one of these sets opens a route on a grid.

    Attributes:
        sets: indices of the obstacles in each set.
        is_sure: True if the opened routes are free not only at the grid points, but also between them.
    """

    sets: list[tuple[int, ...]]
    is_sure: bool


class _Search:
    """Search for routes on a grid through the waypoints of a problem.

    Args:
        grid: grid of points of a space.
        problem: waypoints and corridors of the path.
        certain: True if all points must be in the corridors; False if they may be up to half a cell diagonal outside.
    """

    def __init__(self, grid: Grid, problem: PathProblem, *, certain: bool) -> None:
        self.grid = grid
        # Largest distance between a point and its nearest grid point, m.
        self.half_diagonal = 0.5 * float(np.linalg.norm(grid.steps)) + 1e-9
        self._near = [is_near(waypoint, grid.points, self.half_diagonal) for waypoint in problem.waypoints]
        tolerance = 0.0 if certain else self.half_diagonal
        self._inside = [
            None if corridor is None else is_near(corridor, grid.points, tolerance) for corridor in problem.corridors
        ]

    def connects(self, free: np.ndarray, first: int, last: int) -> bool:
        """Return whether free grid points connect two waypoints through all waypoints between them."""
        reached = self._near[first] & free
        components = None
        for leg in range(first, last):
            inside = self._inside[leg]
            if components is None or inside is not None or self._inside[leg - 1] is not None:
                components = self.grid.components(free if inside is None else free & inside)
            entered = np.unique(components[reached])
            reached = self._near[leg + 1] & np.isin(components, entered[entered > 0])
            if not reached.any():
                return False
        return True


def _sentence(space: Space, problem: PathProblem, first: int, last: int, blocking: _BlockingSets) -> str:
    """Return the sentence that names the unconnected waypoints and the obstacles in the way."""
    legs = [leg for leg in range(first, last) if problem.corridors[leg] is not None]
    corridors = (
        f" in the corridor{'s' if len(legs) > 1 else ''} of segment{'s' if len(legs) > 1 else ''} {_join_names(legs)}"
    )
    between = (
        f"there is no route from waypoint {first} to waypoint {last}{corridors if legs else ''}"
        f" with a clearance of {space.clearance:.3g} m"
    )
    if not blocking.sets:
        return f"{between} within the bounds of the space"
    remedies = [_join_names([space.names[number] for number in without]) for without in blocking.sets]
    would = "would" if blocking.is_sure else "may"
    return f"{between} ({space.clearance_text}); without {', or without '.join(remedies)}, there {would} be a route"


def _blocking_sets(space: Space, bounds: Box, problem: PathProblem, first: int, last: int) -> _BlockingSets:
    """Return the smallest sets of obstacles whose removal opens a route on the grid; empty if there is none.

    Sets whose removal certainly opens a route are preferred. A route is certain if its grid points are farther from the
    remaining obstacles than the clearance plus half a cell diagonal, because the lines between neighbouring points are
    then free, too.
    """
    max_points, min_spacing = _GRIDS[0]
    grid = Grid.of(space, bounds, max_points=max_points, min_spacing=min_spacing)
    every = tuple(range(len(space.obstacles)))

    for is_sure in (True, False):
        search = _Search(grid, problem, certain=is_sure)
        distance = space.clearance + (search.half_diagonal if is_sure else 0.0)

        def connects(without: tuple[int, ...], search: _Search = search, distance: float = distance) -> bool:
            remaining = [number for number in every if number not in without]
            return search.connects(grid.distances[:, remaining].min(axis=1, initial=np.inf) >= distance, first, last)

        if not connects(every):
            continue
        needed = every
        for number in every:
            fewer = tuple(each for each in needed if each != number)
            if connects(fewer):
                needed = fewer
        for count in range(1, min(_MAX_SET_SIZE, len(needed)) + 1):
            removable = [without for without in itertools.combinations(every, count) if connects(without)]
            if removable:
                return _BlockingSets(removable, is_sure)
        if needed:
            return _BlockingSets([needed], is_sure)
    return _BlockingSets([], False)


def _join_names(names: Sequence[object]) -> str:
    """Join names by commas, with "and" before the last one."""
    words = [str(name) for name in names]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""
