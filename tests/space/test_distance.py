import numpy as np
import pytest

from drake_quad.reference.minimum_snap import minimum_snap
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.space.distance import nearest_approach
from drake_quad.space.shapes import Ball, Cuboid, Cylinder
from drake_quad.space.space import Obstacle, Space


@pytest.mark.parametrize("seed", range(5))
def test_nothing_between_samples_is_nearer(seed):
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
    found = nearest_approach(path, space)
    assert distances.min() - 1e-4 < found.distance <= distances.min() + 1e-5
    assert found.obstacle == space.names[numbers[distances.argmin()]]
    assert space.nearest(found.position[None])[0][0] == found.distance
    np.testing.assert_allclose(evaluate(path, [found.time])[:, 0], found.position, atol=1e-9)


def test_without_obstacles_there_is_no_approach():
    path = minimum_snap(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]), np.array([0.0, 1.0]))
    assert nearest_approach(path, Space((), radius=0.1)) is None
