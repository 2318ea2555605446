"""Tests that simplified convex hulls contain the original hulls and are not much larger."""

import math

import numpy as np
import pytest
import scipy
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from drake_quad.errors import InputError
from drake_quad.space import simplification
from drake_quad.space.shapes import convex_hull
from drake_quad.space.simplification import MAX_GROWTH, simplified_hull

MAX_CORNERS = 100  # largest number of corners of a simplified hull


def sphere(count, seed=0):
    points = np.random.default_rng(seed).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def drone(corners_per_disc, num_dome_points=0):
    """Return the vertices of a drone: a frame with four rotor guards and a dome.

    Args:
        corners_per_disc: number of points on the arc of one guard. Each point is on four guards and at two heights, so
            it adds eight corners to the hull.
        num_dome_points: number of vertices on the dome.
    """
    rotor_centres = [(x, y) for x in (-0.12, 0.12) for y in (-0.12, 0.12)]
    arc = np.linspace(0.0, 0.5 * math.pi, corners_per_disc)
    points = [
        [x + math.copysign(0.065 * math.cos(angle), x), y + math.copysign(0.065 * math.sin(angle), y), z]
        for x, y in rotor_centres
        for angle in arc
        for z in (-0.02, 0.03)
    ]
    inside = np.random.default_rng(0).uniform(-0.1, 0.1, (500, 3)) * [1.0, 1.0, 0.1]
    turns = 2.0 * math.pi * np.arange(num_dome_points) / max(num_dome_points, 1)
    dome = np.column_stack([0.03 * np.cos(turns), 0.03 * np.sin(turns), np.full(num_dome_points, 0.06)])
    return np.vstack([points, inside, dome])


# Vertices of a mesh, and the largest allowed growth of its hull relative to its size.
MESHES = {
    "sphere of 500": (sphere(500), 0.022),
    "sphere of 120": (sphere(120), 0.015),
    "flat ellipsoid": (sphere(400, 1) * [1.0, 1.0, 0.02], 0.03),
    "needle": (sphere(400, 2) * [1.0, 0.01, 0.01], 0.03),
    "needle as thin as a hull may be": (sphere(5000, 11) * [1.0, 1e-6, 1e-6], 0.03),
    "leaning ellipsoid": (sphere(400, 3) @ np.random.default_rng(3).normal(size=(3, 3)), 0.035),
    "far from the origin": (1e3 + 0.2 * sphere(150, 4), 0.02),
    "in coordinates of a map": (sphere(150, 4) + np.array([4.5e5, 5.3e6, 300.0]), 0.02),
    "in micrometres": (1e6 * sphere(150, 6), 0.02),
    "thin sheet in micrometres": (1e6 * sphere(150, 7) * [1.0, 1.0, 1e-4], 0.03),
    "in kilometres": (1e-4 * sphere(150, 8), 0.02),
    "prism": (np.array([[math.cos(a), math.sin(a), z] for a in np.arange(60) * math.pi / 30 for z in (-1, 1)]), 0.006),
    "cube of random points": (np.random.default_rng(5).uniform(size=(20_000, 3)), 0.006),
    "cone": (
        np.array([[0.0, 0.0, 2.0], *([math.cos(i), math.sin(i), 0.0] for i in range(300))]),
        0.004,
    ),
    "drone of 104 corners": (drone(13), 0.003),
    "drone of 213 corners": (drone(26, 5), 0.003),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("points", "most_growth"),
    [
        pytest.param(*mesh, id=name, marks=pytest.mark.long if name.startswith("needle as thin") else ())
        for name, mesh in MESHES.items()
    ],
)
def test_a_simplified_hull_contains_all_points_and_grows_by_little(points, most_growth):
    actual = simplified_hull(points, MAX_CORNERS)
    original, simplified = convex_hull(points), convex_hull(actual.corners)
    size = np.ptp(points, axis=0).max()
    assert (len(actual.corners), actual.replaced) == (MAX_CORNERS, len(original.corners))
    assert actual.is_simpler
    # No point is outside, for any size of the mesh.
    assert simplified.distances(points).max() <= 0.0
    normals, offsets = np.array(simplified.normals), np.array(simplified.offsets)
    assert (points @ normals.T - offsets).max() <= 0.0
    # The growth is the largest distance between the two hulls, which occurs at a corner of the new hull.
    assert actual.growth == pytest.approx(original.distances(actual.corners).max(), rel=1e-9)
    assert actual.growth <= most_growth * size <= MAX_GROWTH * size
    weights = np.random.default_rng(0).dirichlet(np.full(MAX_CORNERS, 0.1), 200)
    assert original.distances(weights @ actual.corners).max() <= actual.growth * (1.0 + 1e-9)


@pytest.mark.slow
def test_units_do_not_change_the_simplified_hull():
    points = sphere(150, 9)
    simplified = simplified_hull(points, MAX_CORNERS)
    for unit in (1e-6, 1e6):
        scaled = simplified_hull(unit * points, MAX_CORNERS)
        assert scaled.corners == pytest.approx(unit * simplified.corners, abs=1e-6 * unit)
        assert scaled.growth == pytest.approx(unit * simplified.growth, rel=1e-4)


def test_a_failure_of_the_solver_is_reported(monkeypatch):
    failed = scipy.optimize.OptimizeResult(x=None, status=4)
    monkeypatch.setattr(scipy.optimize, "linprog", lambda *_, **__: failed)
    with pytest.raises(InputError, match=r"^no enclosing hull with 100 corners was found for the convex hull with 103"):
        simplified_hull(sphere(103, 10), MAX_CORNERS)


def test_drone_meshes_of_the_tests_have_as_many_corners_as_real_meshes():
    for name, count in (("drone of 104 corners", 104), ("drone of 213 corners", 213)):
        assert len(convex_hull(MESHES[name][0]).corners) == count


@pytest.mark.slow
def test_the_growth_of_a_hull_is_the_largest_distance_of_its_corners_from_the_original_convex_set():
    points = sphere(130, 7) * [1.0, 0.5, 0.2]
    actual, hull = simplified_hull(points, MAX_CORNERS), convex_hull(points)
    corner = actual.corners[np.argmax(hull.distances(actual.corners))]
    program = MathematicalProgram()
    x = program.NewContinuousVariables(3)
    hull.convex_set().AddPointInSetConstraints(program, x)
    program.Add2NormSquaredCost(np.eye(3), corner, x)
    nearest = ClarabelSolver().Solve(program).GetSolution(x)
    assert actual.growth == pytest.approx(np.linalg.norm(corner - nearest), rel=1e-5)


def test_a_hull_with_few_corners_is_not_simplified():
    points = np.vstack([sphere(60), 0.1 * sphere(200, 1)])
    actual = simplified_hull(points, MAX_CORNERS)
    assert (actual.growth, actual.is_simpler) == (0.0, False)
    np.testing.assert_array_equal(actual.corners, convex_hull(points).corners)


def test_a_hull_that_would_grow_too_much_is_rejected():
    with pytest.raises(
        InputError, match=r"has 300 corners, and an enclosing hull with 8 corners would be larger by \d+ % of"
    ):
        simplified_hull(sphere(300), 8)
    with pytest.raises(InputError, match="in a plane"):
        simplified_hull(sphere(300) * [1.0, 1.0, 0.0], MAX_CORNERS)


def test_the_simplification_of_a_hull_is_described_in_one_sentence():
    actual = simplified_hull(drone(13), MAX_CORNERS)
    fraction = 100.0 * actual.growth / 0.37
    assert str(actual) == (
        f"its convex hull with 104 corners is replaced by an enclosing hull with 100 corners, larger by at most"
        f" {actual.growth:.3g}, {fraction:.2g} % of its size"
    )


@pytest.mark.parametrize("count", [8, 9, 100])
def test_a_hull_with_the_allowed_number_of_corners_is_not_simplified(count):
    points = sphere(count)
    actual = simplified_hull(points, count)
    assert (actual.growth, actual.is_simpler, actual.replaced) == (0.0, False, count)
    np.testing.assert_array_equal(actual.corners, convex_hull(points).corners)


def test_directions_are_evenly_spread_unit_vectors():
    """For n evenly spread points, each covers an area of 4 π / n, and none is far from its neighbours."""
    for count in (50, 500):
        directions = simplification._directions(count)
        np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
        side = math.sqrt(4.0 * math.pi / count)
        distances = np.linalg.norm(directions[:, None] - directions, axis=2) + 9.0 * np.eye(count)
        assert distances.min() > 0.7 * side
        gaps = np.linalg.norm(sphere(2000)[:, None] - directions, axis=2).min(axis=1)
        assert gaps.max() < side


def test_the_distance_from_a_flat_hull_is_the_distance_from_the_plane_or_line_of_its_corners():
    """The distance is correct for any size and position of the corners, and also for a hull with a volume."""
    points = sphere(40, 8)
    for size in (1e-4, 1.0, 1e4):
        for count, distances in (
            (1, np.linalg.norm(points, axis=1)),
            (2, np.linalg.norm(points[:, 1:], axis=1)),
            (3, np.abs(points[:, 2])),
            (4, np.abs(points[:, 2])),
        ):
            flat = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.5, 0.0], [-0.2, 0.7, 0.0]])[:count]
            offset = size * np.array([2.0, -3.0, 1.0])
            actual = simplification._distances_from_hull(size * points + offset, size * flat + offset)
            np.testing.assert_allclose(actual, size * distances, atol=1e-9 * size)
        solid = np.vstack([flat, [0.3, 0.2, -0.9]])
        hull = convex_hull(solid)
        expected = (points @ np.array(hull.normals).T - hull.offsets).max(axis=1)
        np.testing.assert_allclose(
            simplification._distances_from_hull(size * points, size * solid), size * expected, rtol=1e-6
        )


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_a_simplified_hull_grows_in_proportion_to_its_size(scale):
    points = sphere(120)
    actual, larger = simplified_hull(points, MAX_CORNERS), simplified_hull(scale * points, MAX_CORNERS)
    assert larger.growth == pytest.approx(scale * actual.growth, rel=1e-6)
    assert larger.size == pytest.approx(scale * np.ptp(points, axis=0).max())
    assert str(larger).endswith("% of its size")


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1e300, "finite, and at most 1e"),
        (np.inf, "finite, and at most 1e"),
        (1e-160, "a size of 2e-160 m"),
        (1e-300, "a size of"),
    ],
)
def test_points_of_extreme_size_are_refused(factor, words):
    points = np.random.default_rng(1).normal(size=(300, 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    with pytest.raises(InputError, match=words):
        simplified_hull(points * factor, 100)
