"""Tests of the smallest distance between a path and obstacles, by comparison with dense samples."""

import numpy as np
import pytest
from scipy.spatial import KDTree

from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.space.distance import NearestApproach, nearest_approach
from drake_quad.space.shapes import Ball, Cuboid, Cylinder
from drake_quad.space.space import Obstacle, Space


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_approach_also_considers_points_between_samples(seed):
    random = np.random.default_rng(seed)
    waypoints = random.uniform(-2.0, 2.0, (5, 3))
    path = minimum_snap(waypoints, np.cumsum([0.0, *random.uniform(0.5, 2.0, 4)]))
    shapes = (
        Ball(tuple(random.uniform(-3.0, 3.0, 3)), radius=0.2),
        Cuboid(tuple(random.uniform(-3.0, 3.0, 3)), (0.3, 0.2, 0.1), (0.1, 0.5, 1.0)),
        Cylinder(tuple(random.uniform(-3.0, 3.0, 3)), radius=0.1, height=2.0),
    )
    space = Space(tuple(Obstacle(f"solid_{i}", shape) for i, shape in enumerate(shapes)), radius=0.1)
    times = np.linspace(path.times[0], path.times[-1], 200_001)
    distances, numbers = space.nearest(evaluate(path, times).T)
    actual = nearest_approach(path, space)
    assert distances.min() - 1e-4 < actual.distance <= distances.min() + 1e-5
    assert actual.obstacle == space.names[numbers[distances.argmin()]]
    assert space.nearest(actual.position[None])[0][0] == actual.distance
    np.testing.assert_allclose(evaluate(path, [actual.time])[:, 0], actual.position, atol=1e-9)


def test_there_is_no_nearest_approach_if_there_are_no_obstacles():
    path = minimum_snap(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.array([0.0, 1.0]))
    assert nearest_approach(path, Space((), radius=0.1)) is None


def rest_to_rest(length, duration):
    """Return a straight path along X that begins and ends at rest, and is fastest half-way."""
    return minimum_snap(np.array([[0.0, 0.0, 0.0], [length, 0.0, 0.0]]), np.array([3.0, 3.0 + duration]))


@pytest.mark.parametrize("fraction", [0.1, 0.3, 0.5, 0.7, 0.9])
def test_an_obstacle_at_the_end_of_a_piece_is_not_missed(fraction):
    """The nearest obstacle is at the end of a piece, and another obstacle is closer to the middle of a piece.

    The algorithm first cuts the path into 32 pieces of equal duration, so two pieces meet in the middle of the path.
    The pieces are longest there, because the path is fastest. The first ball is at this point. The second ball is
    farther from the path, but closer to the middle of its piece than the first ball is to the middle of any piece.
    """
    path = rest_to_rest(8.0, 4.0)
    speed = evaluate(path, [5.0], 1)[0, 0]
    half = speed * path.durations[0] / 64.0
    middle_of_piece = evaluate(path, [3.0 + 4.0 * 20.5 / 32.0])[:, 0]
    nearest_ball = Obstacle("first", Ball((4.0, 0.01, 0.0), radius=0.001))
    other_ball = Obstacle("decoy", Ball((middle_of_piece[0], fraction * half + 0.001, 0.0), radius=0.001))
    actual = nearest_approach(path, Space((other_ball, nearest_ball), radius=0.1))
    assert actual.obstacle == "first"
    assert actual.distance == pytest.approx(0.009, abs=1e-5)
    assert actual.time == pytest.approx(5.0, abs=1e-2)


@pytest.mark.parametrize("seed", range(20))
def test_the_nearest_of_many_small_obstacles_is_found(seed):
    """There are 60 balls at random positions around a path with random waypoints and durations."""
    random = np.random.default_rng([3, seed])
    path = minimum_snap(random.uniform(-5.0, 5.0, (4, 3)), np.cumsum([0.0, *random.uniform(0.3, 2.0, 3)]))
    positions = evaluate(path, random.uniform(path.times[0], path.times[-1], 60)).T + random.normal(size=(60, 3)) * 0.3
    balls = [Obstacle(str(i), Ball(tuple(position), radius=0.01)) for i, position in enumerate(positions.tolist())]
    actual = nearest_approach(path, Space(tuple(balls), radius=0.1))
    samples = evaluate(path, np.linspace(path.times[0], path.times[-1], 20_001)).T
    assert actual.distance <= KDTree(positions).query(samples)[0].min() - 0.01 + 1e-5
    distance, number = KDTree(positions).query(actual.position)
    assert actual.distance == pytest.approx(distance - 0.01)
    assert actual.obstacle == str(number)


def test_a_nearest_approach_is_printed_on_one_line():
    approach = NearestApproach(-0.2, 1.234, np.array([0.5, -1.25, 2.0]), "pillar")
    assert str(approach) == "0 m from pillar at 1.23 s, (0.5, -1.25, 2) m"
    assert str(approach._replace(distance=0.1234)).startswith("0.123 m from pillar")


def test_the_nearest_approach_of_a_path_that_stays_at_one_point_is_this_point():
    """On such a path, all points of a piece coincide."""
    path = minimum_snap(np.array([[1.0, 2.0, 3.0]] * 2), np.array([0.0, 2.0]))
    actual = nearest_approach(path, Space((Obstacle("ball", Ball((1.0, 2.0, 4.0), radius=0.25)),), radius=0.1))
    assert actual.distance == pytest.approx(0.75)
    np.testing.assert_allclose(actual.position, [1.0, 2.0, 3.0])
