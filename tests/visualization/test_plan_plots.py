"""Tests of outlines of convex regions in drawings of a plan."""

import numpy as np

from drake_quad.reference.regions import Box, Polytope
from drake_quad.visualization.plan_plots import outline

DRAWING_BOX = Box([-5.0, -5.0, -5.0], [5.0, 5.0, 5.0])  # m


def area(corners):
    x, y = corners.T
    return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))


def test_the_outline_of_an_octahedron_is_its_middle_square():
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = outline(Polytope(signs, np.full(8, 10.0)), DRAWING_BOX, 0, 2)
    assert corners.shape == (4, 2)
    np.testing.assert_allclose(np.sort(np.abs(corners), axis=1), [[0.0, 10.0]] * 4, atol=1e-6)
    assert abs(area(corners) - 200.0) < 1e-5


def test_an_unbounded_polytope_is_clipped_to_the_drawing():
    half = Polytope([[1, 1, 0]], [0])
    assert abs(area(outline(half, DRAWING_BOX, 0, 1)) - 50.0) < 1e-5
    assert abs(area(outline(half, DRAWING_BOX, 0, 2)) - 100.0) < 1e-5
    assert len(outline(Polytope([[-1, 0, 0]], [-6]), DRAWING_BOX, 0, 1)) == 0
