"""Why there is no way, and what is in it."""

import itertools
from collections.abc import Sequence

import numpy as np

from drake_quad.reference.regions import Box
from drake_quad.space.grid import Grid
from drake_quad.space.space import Space

# Of the grids on which there is no way: their points, and least spacings, m.
_GRIDS = ((500_000, 0.05), (3_000_000, 0.02))
# Sets of so many obstacles are all tried before the fewest that a way crosses are taken.
_TRIED = 2


def explain(space: Space, bounds: Box, places: np.ndarray) -> str:
    """Says between which places there is no way, and which obstacles close it, in one sentence.

    That there is none is proved on a grid. Any way at the clearance passes, all along, within half a cell's diagonal of
    a point of the grid, and the next such point is that one or its neighbour. No distance changes faster than the
    place: these points are at the clearance less half the diagonal or farther. If such points do not lead from one
    place to the next, no way does. If they do, there may be a way yet.

    Args:
        space: the obstacles.
        bounds: for the centre of mass.
        places: (n, 3) to pass, free, m.
    """
    for most, finest in _GRIDS:
        grid = Grid.of(space, bounds, most=most, finest=finest)
        diagonal = float(np.linalg.norm(grid.steps))
        rooms = grid.rooms(grid.nearest >= space.clearance - 0.5 * diagonal)
        near = _near(grid, places, diagonal)
        for leg, ends in enumerate(itertools.pairwise(near)):
            if not _in_one_room(rooms, ends):
                return _sentence(space, leg, _closing(space, bounds, places[leg : leg + 2]))
    return (
        f"no way was found at {space.clearance:.3g} m from obstacles ({space.clearance_in_words}); there may be one"
        f" through gaps that leave the centre of mass less than {diagonal:.2g} m"
    )


def _sentence(space: Space, leg: int, sets: list[tuple[int, ...]]) -> str:
    between = f"there is no way from waypoint {leg} to waypoint {leg + 1} at {space.clearance:.3g} m from obstacles"
    if not sets:
        return f"{between} within the bounds of the space"
    ways_out = [_listed([space.names[number] for number in without]) for without in sets]
    return f"{between} ({space.clearance_in_words}); without {', or without '.join(ways_out)}, there would be one"


def _near(grid: Grid, places: np.ndarray, diagonal: float) -> list[np.ndarray]:
    """For each place the points of the grid that may be next to a way from it."""
    return [np.linalg.norm(grid.points - place, axis=1) <= 0.5 * diagonal + 1e-9 for place in places]


def _in_one_room(rooms: np.ndarray, ends: tuple[np.ndarray, np.ndarray]) -> bool:
    """Whether points that lead to each other, by the numbers (n,) of their rooms, are at both ends."""
    return bool(set(rooms[ends[0]].tolist()) & set(rooms[ends[1]].tolist()) - {0})


def _closing(space: Space, bounds: Box, places: np.ndarray) -> list[tuple[int, ...]]:
    """The smallest sets of obstacles without which there is a way on the grid; none if there is none without any.

    Sets of one and two are all tried; of larger ones there is one, of those that a way crosses which enters as few as
    may be.
    """
    most, finest = _GRIDS[0]
    grid = Grid.of(space, bounds, most=most, finest=finest)
    begin, end = _near(grid, places, float(np.linalg.norm(grid.steps)))
    every = range(len(space.obstacles))

    def connects(without: tuple[int, ...]) -> bool:
        left = [number for number in every if number not in without]
        free = grid.distances[:, left].min(axis=1, initial=np.inf) >= space.clearance
        return _in_one_room(grid.rooms(free), (begin, end))

    if not connects(tuple(every)):
        return []
    crossed = _crossed(grid, (begin, end), space.clearance)
    for count in range(1, min(_TRIED, len(crossed)) + 1):
        found = [without for without in itertools.combinations(every, count) if connects(without)]
        if found:
            return found
    return [crossed]


def _crossed(grid: Grid, ends: tuple[np.ndarray, np.ndarray], clearance: float) -> tuple[int, ...]:
    """The obstacles that a way crosses which is in as few of them as may be, each counted by the points inside."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import dijkstra

    blocked = grid.distances < clearance
    # To enter an obstacle costs most, to stay in one little, and all else next to nothing.
    rows, columns, costs = [], [], []
    for one, other in grid.neighbours():
        for begin, end in ((one, other), (other, one)):
            rows.append(begin)
            columns.append(end)
            costs.append(1e-6 + (blocked[end] & ~blocked[begin]).sum(axis=1))
    size = len(grid.points)
    graph = coo_matrix((np.concatenate(costs), (np.concatenate(rows), np.concatenate(columns))), (size, size)).tocsr()
    begins = np.flatnonzero(ends[0])
    found, before, _ = dijkstra(graph, indices=begins, min_only=True, return_predecessors=True)
    goals = np.flatnonzero(ends[1])
    number = int(goals[found[goals].argmin()])
    crossed: set[int] = set()
    while number >= 0:
        crossed |= set(np.flatnonzero(blocked[number]).tolist())
        number = int(before[number])
    return tuple(sorted(crossed))


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}" if names else ""
