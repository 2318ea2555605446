"""Comparison of the planner's regions and passage with the best of many random ones.

Random regions grow around random points instead of the points with the largest clearance. Random passages are the
shortest ones after lengths have been multiplied by random factors. The planner computes the fastest path through each
passage.
"""

import os

import numpy as np
import pytest
from rooms import random_room
from test_rooms import LIMITS

from drake_quad.errors import InputError
from drake_quad.reference.path_problem import PathProblem
from drake_quad.reference.planner import MinimumTimeTiming, plan_path
from drake_quad.reference.regions import Box
from drake_quad.space.collision_free import plan_collision_free_path, with_corridors
from drake_quad.space.grid import Grid
from drake_quad.space.passage import other_passages
from drake_quad.space.regions import SLACK, Regions

# `make passages` tries a hundred restarts in ten rooms. By default, ten restarts are tried in one room.
NUM_RESTARTS = int(os.environ.get("RESTARTS", "10"))
NUM_ROOMS = 10 if NUM_RESTARTS >= 100 else 1
# Seeds of the random rooms. A seed is omitted if its room has no route, or if the regions that grow around random
# points do not connect start and end.
ROOM_SEEDS = [1, 3, 7, 10, 11, 13, 14, 15, 17, 19][:NUM_ROOMS]
# Number of restarts, each with another random passage, that share a set of random regions.
_NUM_PASSAGES_PER_SET = 10


def durations_of_restarts(room, problem, count):
    """Return the flight durations (s) of the fastest paths through `count` random passages, one for each restart.

    Passages without a path are omitted.
    """
    grid = Grid.of(room.space, room.bounds, max_points=30_000, min_spacing=0.05)
    free = grid.nearest >= room.space.clearance + SLACK
    actual = []
    for start in range(0, count, _NUM_PASSAGES_PER_SET):
        random = np.random.default_rng([start, 27])
        regions = Regions(room.space, room.bounds)
        for endpoint in room.endpoints:
            regions.grow(endpoint)
        regions.cover(grid.points[free], random.uniform(size=int(free.sum())))
        ends = [endpoint[None] for endpoint in room.endpoints]
        for passage in other_passages(regions, ends, problem.corridors, count=_NUM_PASSAGES_PER_SET, seed=start):
            try:
                actual.append(
                    plan_path(with_corridors(problem, regions, passage).problem, MinimumTimeTiming()).duration
                )
            except InputError:
                continue
    return actual


@pytest.mark.long
@pytest.mark.parametrize("seed", ROOM_SEEDS)
def test_no_random_restart_finds_a_much_faster_path(seed):
    """The planned duration is at most 15 % above the best of all random restarts."""
    room = random_room(seed)
    problem = PathProblem([Box.point(endpoint) for endpoint in room.endpoints], limits=LIMITS)
    planned_duration = plan_collision_free_path(room.space, room.bounds, problem, MinimumTimeTiming())[0].duration
    durations = durations_of_restarts(room, problem, NUM_RESTARTS)
    assert durations
    best = min(durations)
    print(
        f"room {seed}: {planned_duration:.3f} s, the best of {len(durations)} {best:.3f} s,"
        f" ratio {planned_duration / best:.3f}"
    )
    assert planned_duration <= 1.15 * best
