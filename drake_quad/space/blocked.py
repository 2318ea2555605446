"""Why there is no way, and what is in it."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.regions import Box
from drake_quad.space.grid import Grid, is_near
from drake_quad.space.space import Space

# Of the grids on which there is no way: their points, and least spacings, m.
_GRIDS = ((500_000, 0.05), (3_000_000, 0.02))
# Sets of so many obstacles are all tried; of larger ones there is one that cannot do without any of its obstacles.
_TRIED = 2


def explain(space: Space, bounds: Box, problem: PathProblem) -> str:
    """Says between which waypoints there is no way, and which obstacles close it, in one sentence.

    That there is none is proved on a grid. Any way at the clearance passes, all along, within half a cell's diagonal of
    a point of the grid, and the next such point is that one or its neighbour. No distance changes faster than the
    place: these points are at the clearance less half the diagonal or farther, and no farther than half the diagonal
    from the corridor of the leg, if it has one. If such points do not lead from one waypoint to the next, no way does.
    If they do, there may be a way yet.

    Args:
        space: the obstacles.
        bounds: for the centre of mass.
        problem: whose waypoints are to be passed in its corridors.
    """
    legs = len(problem.corridors)
    for most, finest in _GRIDS:
        search = _Search(Grid.of(space, bounds, most=most, finest=finest), problem, certain=False)
        free = search.grid.nearest >= space.clearance - search.reach
        for last in range(1, legs + 1):
            # Each leg may be open, and not where the one before ends.
            for first in dict.fromkeys((last - 1, 0)):
                if not search.leads(free, first, last):
                    return _sentence(space, problem, first, last, _closing(space, bounds, problem, first, last))
    return (
        f"no way was found at {space.clearance:.3g} m from obstacles ({space.clearance_in_words}); there may be one"
        f" through gaps that leave the centre of mass less than {2.0 * search.reach:.2g} m"
    )


class _Closing(NamedTuple):
    """Sets of obstacles without which there is a way on a grid, and whether one is sure between its points, too."""

    sets: list[tuple[int, ...]]
    is_sure: bool


class _Search:
    """Ways over a grid's points through the waypoints of a problem.

    Args:
        grid: of a space.
        problem: whose waypoints are to be passed in its corridors.
        certain: whether all points must be in the corridors, and not only next to them.
    """

    def __init__(self, grid: Grid, problem: PathProblem, *, certain: bool) -> None:
        self.grid = grid
        # From any place to the nearest point of the grid, m.
        self.reach = 0.5 * float(np.linalg.norm(grid.steps)) + 1e-9
        self._near = [is_near(place, grid.points, self.reach) for place in problem.waypoints]
        beside = 0.0 if certain else self.reach
        self._inside = [
            None if corridor is None else is_near(corridor, grid.points, beside) for corridor in problem.corridors
        ]

    def leads(self, free: np.ndarray, first: int, last: int) -> bool:
        """Whether free points lead from a waypoint, by those between, to another."""
        reached = self._near[first] & free
        rooms = None
        for leg in range(first, last):
            inside = self._inside[leg]
            if rooms is None or inside is not None or self._inside[leg - 1] is not None:
                rooms = self.grid.rooms(free if inside is None else free & inside)
            entered = np.unique(rooms[reached])
            reached = self._near[leg + 1] & np.isin(rooms, entered[entered > 0])
            if not reached.any():
                return False
        return True


def _sentence(space: Space, problem: PathProblem, first: int, last: int, closing: _Closing) -> str:
    legs = [leg for leg in range(first, last) if problem.corridors[leg] is not None]
    corridors = (
        f" in the corridor{'s' if len(legs) > 1 else ''} of segment{'s' if len(legs) > 1 else ''} {_listed(legs)}"
    )
    between = (
        f"there is no way from waypoint {first} to waypoint {last}{corridors if legs else ''}"
        f" at {space.clearance:.3g} m from obstacles"
    )
    if not closing.sets:
        return f"{between} within the bounds of the space"
    ways_out = [_listed([space.names[number] for number in without]) for without in closing.sets]
    would = "would" if closing.is_sure else "may"
    return f"{between} ({space.clearance_in_words}); without {', or without '.join(ways_out)}, there {would} be one"


def _closing(space: Space, bounds: Box, problem: PathProblem, first: int, last: int) -> _Closing:
    """The smallest sets of obstacles without which there is a way on the grid; none if there is none without any.

    Those are preferred without which there is a way for certain: over points that are farther from what is left by half
    a cell's diagonal, so that all between neighbours is free.
    """
    most, finest = _GRIDS[0]
    grid = Grid.of(space, bounds, most=most, finest=finest)
    every = tuple(range(len(space.obstacles)))

    for is_sure in (True, False):
        search = _Search(grid, problem, certain=is_sure)
        distance = space.clearance + (search.reach if is_sure else 0.0)

        def leads(without: tuple[int, ...], search: _Search = search, distance: float = distance) -> bool:
            left = [number for number in every if number not in without]
            return search.leads(grid.distances[:, left].min(axis=1, initial=np.inf) >= distance, first, last)

        if not leads(every):
            continue
        needed = every
        for number in every:
            fewer = tuple(each for each in needed if each != number)
            if leads(fewer):
                needed = fewer
        for count in range(1, min(_TRIED, len(needed)) + 1):
            found = [without for without in itertools.combinations(every, count) if leads(without)]
            if found:
                return _Closing(found, is_sure)
        if needed:
            return _Closing([needed], is_sure)
    return _Closing([], False)


def _listed(names: Sequence[object]) -> str:
    words = [str(name) for name in names]
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""
