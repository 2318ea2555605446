"""Tests in random rooms: the planner finds a path, or an independent search confirms that there is none."""

import hashlib
import os
import subprocess
import sys

import numpy as np
import pytest
from rooms import Room, Search, least_distances, random_room

from drake_quad.errors import InputError
from drake_quad.reference.path_problem import PathLimits, PathProblem
from drake_quad.reference.planner import HeuristicTiming, MinimumSnapTiming, MinimumTimeTiming
from drake_quad.reference.polynomial_path import evaluate, peak_norm
from drake_quad.reference.regions import Box
from drake_quad.space.collision_free import plan_collision_free_path
from drake_quad.space.shapes import Cuboid
from drake_quad.space.space import Obstacle, Space

# `make rooms` plans a hundred rooms. By default only three are planned. Room 4 has no route, and room 1 is planned with
# minimum snap.
ROOM_SEEDS = range(int(os.environ["ROOMS"])) if "ROOMS" in os.environ else (1, 2, 4)
LIMITS = PathLimits(speed=2.0, acceleration=2.0)  # m/s and m/s²


def plan(room, timing):
    problem = PathProblem([Box.point(endpoint) for endpoint in room.endpoints], limits=LIMITS)
    return plan_collision_free_path(room.space, room.bounds, problem, timing)[0]


def keeps_clearance(room, path):
    """Return whether a path keeps the clearance at 10,000 points, up to rounding errors."""
    points = evaluate(path, np.linspace(path.times[0], path.times[-1], 10_000)).T
    inside = (points >= room.bounds.low - 1e-6).all() and (points <= room.bounds.high + 1e-6).all()
    return inside and least_distances(room.space, points).min() >= room.space.clearance


@pytest.mark.long
@pytest.mark.parametrize("seed", ROOM_SEEDS)
def test_the_planner_finds_a_path_through_a_random_room_unless_the_room_is_blocked(seed):
    room = random_room(seed)
    timing = (HeuristicTiming(), MinimumSnapTiming(12.0), *[HeuristicTiming()] * 7, MinimumTimeTiming())[seed % 10]
    try:
        path = plan(room, timing)
    except InputError as error:
        assert "no route" in str(error)
        search = Search(room)
        assert search.shortest() is None
        if "a route may exist" not in str(error):
            assert search.is_surely_blocked() or Search(room, 0.02).is_surely_blocked()
    else:
        assert keeps_clearance(room, path)
        np.testing.assert_allclose(path.waypoints[[0, -1]], room.endpoints, atol=1e-9)


def room_with_wall(*solids):
    """Return a room that a wall divides. The wall consists of cuboids, given by centre and size."""
    obstacles = tuple(Obstacle(f"wall_{i}", Cuboid(centre, size=size)) for i, (centre, size) in enumerate(solids))
    space = Space(obstacles, radius=0.15, margin=0.05)
    return Room(space, Box([0.2, 0.2, 0.2], [3.8, 2.8, 1.8]), np.array([[0.7, 1.4, 1.0], [3.3, 1.4, 1.0]]))


# Parts (centre and size) of a 10 cm thick wall in the middle of a room. Each case is named after the opening in the
# wall and the route through it.
WALLS_WITH_OPENINGS = {
    "a door on the left": [((2.0, 1.2, 1.0), (0.1, 2.4, 2.0))],
    "a door on the right": [((2.0, 1.8, 1.0), (0.1, 2.4, 2.0))],
    "over a beam": [((2.0, 1.5, 0.7), (0.1, 3.0, 1.4))],
    "under a beam": [((2.0, 1.5, 1.4), (0.1, 3.0, 1.2))],
    "a window": [
        ((2.0, 0.9, 1.0), (0.1, 1.8, 2.0)),
        ((2.0, 2.75, 1.0), (0.1, 0.5, 2.0)),
        ((2.0, 2.15, 0.3), (0.1, 0.8, 0.6)),
        ((2.0, 2.15, 1.75), (0.1, 0.8, 0.5)),
    ],
    "the nearer of two doors": [((2.0, 1.3, 1.0), (0.1, 1.2, 2.0))],
}


# All passages are planned with the fastest timing, and one of them also with each of the other timings.
PASSAGE_TIMINGS = [
    *((name, HeuristicTiming()) for name in WALLS_WITH_OPENINGS),
    ("over a beam", MinimumTimeTiming()),
    ("a door on the left", MinimumSnapTiming(8.0)),
]


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "timing"), PASSAGE_TIMINGS, ids=lambda each: each if isinstance(each, str) else type(each).__name__
)
def test_the_path_uses_the_same_opening_as_the_shortest_route(name, timing):
    room = room_with_wall(*WALLS_WITH_OPENINGS[name])
    path = plan(room, timing)
    assert keeps_clearance(room, path)
    for order, limit in LIMITS.by_order.items():
        assert peak_norm(path, order) <= limit + 1e-9
    route = Search(room).shortest()
    points = evaluate(path, np.linspace(path.times[0], path.times[-1], 2000)).T
    crossed, expected = (each[np.abs(each[:, 0] - 2.0).argmin()] for each in (points, route))
    # Both paths pass through the same opening, so they are on the same side of the wall's middle.
    between = crossed + np.linspace(0.0, 1.0, 200)[:, None] * (expected - crossed)
    between[:, 0] = 2.0
    assert least_distances(room.space, between).min() > 0.0


@pytest.mark.long
def test_a_room_has_the_same_plan_in_another_process():
    path = plan(random_room(2), HeuristicTiming())
    digest = hashlib.sha256(path.times.tobytes() + path.coefficients.tobytes()).hexdigest()
    text = (
        "import hashlib, test_rooms as t\n"
        "path = t.plan(t.random_room(2), t.HeuristicTiming())\n"
        "print(hashlib.sha256(path.times.tobytes() + path.coefficients.tobytes()).hexdigest())\n"
    )
    folder = __file__.rpartition("/")[0]
    other_process = subprocess.run([sys.executable, "-c", text], cwd=folder, capture_output=True, text=True, check=True)
    assert other_process.stdout.strip() == digest
