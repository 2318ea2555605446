"""Tests of convex regions: balls, polytopes, nearest points and intersections."""

import itertools

import numpy as np
import pytest

from drake_quad.errors import InputError
from drake_quad.reference.regions import Box, Polytope, intersection_of

# The incircle of a right triangle with legs of 3 m and 4 m has the radius (3 + 4 - 5) / 2 = 1 m.
TRIANGLE = Polytope([[-1, 0], [0, -2], [4, 3]], [0, 0, 12])
BOX = Box([-1.0, 0.5, 2.0], [3.0, 1.0, 2.5])


def random_polytope(rng, faces):
    normals = rng.normal(size=(faces, 3))
    return Polytope(normals, np.linalg.norm(normals, axis=1) * rng.uniform(0.3, 2.0, faces))


def test_the_largest_ball_in_a_right_triangle_is_its_incircle():
    np.testing.assert_allclose(TRIANGLE.centre, [1.0, 1.0], atol=1e-9)
    assert TRIANGLE.radius == pytest.approx(1.0)
    assert not TRIANGLE.is_flat
    np.testing.assert_allclose(np.linalg.norm(TRIANGLE.normals, axis=1), 1.0)
    assert str(TRIANGLE) == "the polytope of 3 faces around (1, 1)"


def test_an_unbounded_polytope_is_described_without_a_centre():
    assert str(Polytope([[1.0, -1.0, 0.0]], [0.5])) == "the unbounded polytope of 1 face"
    assert str(Polytope([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]], [1.0, 1.0])) == "the unbounded polytope of 2 faces"


def test_a_box_converted_to_a_polytope_is_the_same_region():
    polytope = Polytope.from_box(BOX)
    corners = np.array(list(itertools.product(*zip(BOX.low, BOX.high, strict=True))))
    assert all(abs(polytope.max_violation(corner)) <= 1e-12 for corner in corners)
    assert (polytope.faces, polytope.size) == (6, pytest.approx(4.0))
    for position in np.random.default_rng(0).uniform(-4.0, 4.0, (50, 3)):
        np.testing.assert_allclose(polytope.nearest(position), BOX.nearest(position), atol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_the_plane_through_the_nearest_point_separates_it_from_the_polytope(seed):
    """If n is the point nearest to p, no point of the polytope lies beyond the plane through n normal to p - n."""
    rng = np.random.default_rng(seed)
    polytope = random_polytope(rng, 12)
    position = 20.0 * rng.normal(size=3)
    nearest = polytope.nearest(position)
    normal = position - nearest
    assert polytope.max_violation(nearest) == pytest.approx(0.0, abs=1e-6)
    if np.isfinite(farthest := polytope.support(normal)):
        assert farthest == pytest.approx(float(normal @ nearest), rel=1e-5)
    inside = 0.2 * rng.uniform(-1.0, 1.0, 3) / np.sqrt(3.0)
    assert polytope.nearest(inside) is inside


@pytest.mark.parametrize("seed", range(10))
def test_an_intersection_contains_the_points_that_both_regions_contain(seed):
    rng = np.random.default_rng(seed)
    one, other, box = random_polytope(rng, 7), random_polytope(rng, 9), Box([-0.5, -0.4, -0.3], [0.8, 0.7, 0.6])
    for both, parts in (
        (one.intersection(other), (one, other)),
        (intersection_of(box, one), (one, Polytope.from_box(box))),
    ):
        for position in rng.uniform(-2.0, 2.0, (500, 3)):
            assert both.max_violation(position) == pytest.approx(
                max(part.max_violation(position) for part in parts), abs=1e-12
            )


def test_separate_regions_have_no_intersection():
    separate = Polytope([[-4, -3]], [-12.1])
    assert TRIANGLE.intersection(separate) is None
    assert TRIANGLE.intersection(Box([3.0, 4.0], [5.0, 5.0])) is None
    assert TRIANGLE.intersection(TRIANGLE).equals(TRIANGLE)


def test_the_intersection_of_two_regions_is_computed_only_once():
    other = Box([0.0, 0.0], [2.0, 1.0])
    assert TRIANGLE.intersection(other) is TRIANGLE.intersection(other)


def test_touching_polytopes_have_a_flat_intersection():
    joint = TRIANGLE.intersection(Polytope([[-4, -3]], [-12]))
    assert joint.is_flat
    assert joint.contains(np.array([1.5, 2.0]))
    assert not joint.contains(np.array([1.5, 1.99]))


def test_the_support_of_a_polytope_is_infinite_in_unbounded_directions():
    wedge = Polytope([[1, 0, 0], [-1, 0, 0], [0, 1, 1]], [2, 1, 0])
    assert wedge.support(np.array([1.0, 0.0, 0.0])) == pytest.approx(2.0)
    assert wedge.support(np.array([0.0, 0.0, 1.0])) == np.inf
    assert wedge.size == pytest.approx(3.0)
    assert Polytope([[0, 0, 1]], [5]).size == 1.0
    assert wedge.contains(wedge.centre)
    assert wedge.radius == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("normals", "offsets", "words"),
    [
        ([[1, 0], [-1, 0]], [0, -1], "2 faces is empty"),
        ([[1, 0], [-1, 1], [0, -1]], [0, 0, -1], "3 faces is empty"),
        ([[1, 0], [0, 0]], [0, 1], "not zero"),
        ([[1, np.nan]], [0], "finite"),
        ([[1, 0]], [np.inf], "finite"),
        ([[1, 0]], [0, 1], "one offset for each normal"),
        ([], [], "one offset for each normal"),
    ],
)
def test_invalid_regions_are_rejected(normals, offsets, words):
    with pytest.raises(InputError, match=words):
        Polytope(normals, offsets)
