"""Tests of solids: distances, sizes, surfaces and volumes, by comparison with Drake's convex sets."""

import math

import numpy as np
import pytest
import scipy.spatial
from pydrake.math import RollPitchYaw
from pydrake.solvers import ClarabelSolver, MathematicalProgram

from drake_quad.errors import InputError
from drake_quad.framework.formulas import kernel
from drake_quad.framework.records import ROW
from drake_quad.space.shapes import Ball, Cuboid, Cylinder, convex_hull, transformed_points
from drake_quad.space.space import Obstacle, Space

CENTRE = (0.3, -0.7, 1.1)  # m
ROTATION = (0.4, -0.9, 2.0)  # rad: roll, pitch, yaw
HULL_POINTS = np.random.default_rng(5).normal(size=(30, 3))  # m
SHAPES = {
    "cuboid": Cuboid(CENTRE, ROTATION, (0.4, 1.2, 2.1)),
    "upright cuboid": Cuboid(CENTRE, size=(0.4, 1.2, 2.1)),
    "cylinder": Cylinder(CENTRE, ROTATION, 0.3, 1.7),
    "upright cylinder": Cylinder(CENTRE, radius=0.7, height=0.4),
    "ball": Ball(CENTRE, radius=0.6),
    "hull": convex_hull(HULL_POINTS),
    "tetrahedron": convex_hull([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.2, 0.3, 3.0]]),
    "hull of a box": convex_hull(Cuboid(CENTRE, ROTATION, (0.4, 1.2, 2.1)).corners()),
    "sliver": convex_hull([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0], [1.0, 1.0, 0.01]]),
}
each_shape = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)


def points_around(shape, count, seed=0):
    """Return random points inside and around a shape."""
    low, high = shape.extent()
    return np.random.default_rng(seed).uniform(low - 1.0, high + 1.0, (count, 3))


def distance_by_drake(shape, point):
    """Return the distance from a point to the shape's convex set in Drake."""
    program = MathematicalProgram()
    x = program.NewContinuousVariables(3)
    shape.convex_set().AddPointInSetConstraints(program, x)
    # The cone constraint |x - point| <= bound is more accurate than a quadratic cost.
    (bound,) = program.NewContinuousVariables(1)
    program.AddLorentzConeConstraint(np.eye(4), np.concatenate([[0.0], -point]), np.concatenate([[bound], x]))
    program.AddLinearCost(bound)
    solution = ClarabelSolver().Solve(program)
    assert solution.is_success()
    return np.linalg.norm(solution.GetSolution(x) - point)


@each_shape
def test_the_distance_outside_is_the_distance_to_the_projection(shape):
    points = points_around(shape, 60)
    for point, distance in zip(points, shape.distances(points), strict=True):
        assert max(0.0, distance) == pytest.approx(distance_by_drake(shape, point), abs=2e-6)
        assert (distance <= 0.0) == shape.convex_set().PointInSet(point, 1e-9)


@each_shape
def test_the_distance_inside_is_the_radius_of_the_largest_ball_within_the_solid(shape):
    """The expected distance is computed from the support function of the corners along the triangle normals."""
    corners = shape.triangles().reshape(-1, 3)
    normals = np.cross(*(shape.triangles()[:, [1, 2]] - shape.triangles()[:, [0]]).transpose(1, 0, 2))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = (corners @ normals.T).max(axis=0)
    points = np.vstack([points_around(shape, 2000), np.tile(shape.centre, (1, 1))])
    distances = shape.distances(points)
    inside = distances < 0.0
    assert inside.any()
    expected = (points[inside] @ normals.T - offsets).max(axis=1)
    # Triangles approximate the ball by polygons of 32 sides along latitudes and longitudes, so they lie inside the ball
    # by up to this distance.
    slack = (1.0 - math.cos(math.pi / 32.0) ** 2) * getattr(shape, "radius", 0.0) + 1e-8
    np.testing.assert_allclose(distances[inside], expected, atol=slack)


@each_shape
def test_a_distance_changes_no_faster_than_the_point_moves(shape):
    a, b = points_around(shape, 3000, seed=1), points_around(shape, 3000, seed=2)
    assert (np.abs(shape.distances(a) - shape.distances(b)) <= np.linalg.norm(a - b, axis=1) + 1e-9).all()


@each_shape
def test_the_distance_from_a_solid_to_its_corner_is_zero(shape):
    np.testing.assert_allclose(shape.distances(shape.triangles().reshape(-1, 3)), 0.0, atol=1e-8)


@each_shape
def test_distances_for_floats_and_in_machine_code_agree_with_arrays(shape):
    points = np.vstack([points_around(shape, 300), shape.triangles().reshape(-1, 3)[:20]])
    expected = shape.distances(points)
    np.testing.assert_allclose([shape.distance(*p) for p in points.tolist()], expected, rtol=1e-12, atol=1e-9)
    for is_single, tested_points in ((False, points), *((True, point[None]) for point in points[:20])):
        actual = np.full(len(tested_points), np.nan)
        kernel(shape.distance, (ROW, ROW, ROW), (ROW,), single_vehicle=is_single)(
            len(tested_points), 0.0, actual, *tested_points.T.copy()
        )
        np.testing.assert_allclose(actual, shape.distances(tested_points), rtol=1e-12, atol=1e-9)


@each_shape
def test_distances_are_at_least_their_lower_bound(shape):
    points = np.vstack([points_around(shape, 2000), shape.triangles().reshape(-1, 3)])
    bound = shape.distance_lower_bound(*points.T)
    assert bound is None or (shape.distances(points) >= bound).all()
    # Half of the hull's corners are near the surface of the ball, so the bound is not trivial.
    assert (bound is None) == (not hasattr(shape, "corners") or isinstance(shape, Cuboid))
    if bound is not None:
        assert (shape.distances(points) - bound).min() < 1e-6


@each_shape
def test_a_shape_is_within_its_extent_and_touches_it(shape):
    low, high = shape.extent()
    corners = shape.triangles().reshape(-1, 3)
    assert (corners >= low - 1e-9).all()
    assert (corners <= high + 1e-9).all()
    np.testing.assert_allclose(corners.min(axis=0), low, atol=0.02)
    np.testing.assert_allclose(corners.max(axis=0), high, atol=0.02)


@each_shape
def test_triangles_form_a_closed_surface_that_faces_outwards(shape):
    a, b, c = shape.triangles().transpose(1, 0, 2)
    volume = np.sum(np.cross(b - a, c - a) * (a - np.array(shape.centre))) / 6.0
    assert volume > 0.0
    np.testing.assert_allclose(np.cross(b - a, c - a).sum(axis=0), 0.0, atol=1e-8)


def test_volumes_agree_with_closed_forms():
    def volume(shape):
        a, b, c = shape.triangles().transpose(1, 0, 2)
        return np.sum(np.cross(b - a, c - a) * a) / 6.0

    assert volume(SHAPES["cuboid"]) == pytest.approx(0.4 * 1.2 * 2.1)
    assert volume(SHAPES["cylinder"]) == pytest.approx(math.pi * 0.3**2 * 1.7, rel=0.01)
    assert volume(SHAPES["ball"]) == pytest.approx(4.0 / 3.0 * math.pi * 0.6**3, rel=0.02)


def test_a_hull_of_a_box_has_its_faces_and_edges():
    hull = SHAPES["hull of a box"]
    assert (len(hull.corners), len(hull.normals), len(hull.edges), len(hull.facets)) == (8, 6, 12, 12)
    points = points_around(hull, 2000)
    np.testing.assert_allclose(hull.distances(points), SHAPES["cuboid"].distances(points), atol=1e-8)


def test_the_rotation_of_a_solid_is_given_as_roll_pitch_and_yaw():
    half = RollPitchYaw(np.array(ROTATION)).ToRotationMatrix().matrix() @ [0.2, 0.6, 1.05]
    assert SHAPES["cuboid"].distances([np.array(CENTRE) + half]) == pytest.approx(0.0, abs=1e-12)
    tip = RollPitchYaw(np.array(ROTATION)).ToRotationMatrix().matrix() @ [0.0, 0.0, 2.0]
    assert SHAPES["cylinder"].distances([np.array(CENTRE) + tip]) == pytest.approx(2.0 - 0.85)


def test_transformed_points_are_scaled_rotated_and_moved():
    cuboid = SHAPES["cuboid"]
    local_corners = Cuboid((0.0, 0.0, 0.0), size=cuboid.size).corners()
    np.testing.assert_allclose(
        transformed_points(0.5 * local_corners, centre=CENTRE, rotation=ROTATION, scale=2.0), cuboid.corners()
    )


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Cuboid(CENTRE, size=(1.0, 0.0, 1.0)), "the size of a solid is 0 m"),
        (lambda: Cylinder(CENTRE, radius=-1.0), "the radius of a solid is -1 m"),
        (lambda: Cylinder(CENTRE, height=math.inf), "the height of a solid is inf m"),
        (lambda: Ball((0.0, math.nan, 0.0)), "the centre of a solid must be three finite numbers"),
        (lambda: convex_hull(HULL_POINTS[:3]), "at least 4 points"),
        (lambda: convex_hull(HULL_POINTS * [1.0, 1.0, 0.0]), "in a plane"),
        (lambda: convex_hull([[0.0, 0.0, math.inf]] * 4), "finite"),
    ],
)
def test_invalid_solids_are_rejected(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_solids_have_unit_size_by_default():
    for solid, size in ((Cuboid(CENTRE), (1, 1, 1)), (Cylinder(CENTRE), (2, 2, 1)), (Ball(CENTRE), (2, 2, 2))):
        np.testing.assert_allclose(np.diff(solid.extent(), axis=0)[0], size)
        np.testing.assert_allclose(solid.extent().mean(axis=0), CENTRE)


def test_a_failure_of_qhull_is_reported(monkeypatch):
    def fail(points):
        raise scipy.spatial.QhullError("Qhull failed")

    monkeypatch.setattr(scipy.spatial, "ConvexHull", fail)
    with pytest.raises(InputError, match="no hull of 30 points was found"):
        convex_hull(HULL_POINTS)


def test_a_space_finds_the_nearest_obstacle():
    near, far = Ball((0.0, 0.0, 1.0), radius=0.5), Cuboid((3.0, 0.0, 1.0))
    space = Space((Obstacle("near", near), Obstacle("far", far)), radius=0.2, margin=0.1, tracking=0.05)
    distance, number = space.nearest([[1.0, 0.0, 1.0], [2.0, 0.0, 1.0]])
    np.testing.assert_allclose(distance, [0.5, 0.5])
    np.testing.assert_array_equal(number, [0, 1])
    assert space.clearance == pytest.approx(0.35)
    assert space.names == ("near", "far")
    distance, number = Space((), 0.2).nearest([[1.0, 0.0, 1.0]])
    assert (distance[0], number[0]) == (math.inf, -1)


@pytest.mark.parametrize("make", [Cuboid, Cylinder, Ball])
@pytest.mark.parametrize(("name", "index"), [("centre", 0), ("rotation", 1)])
def test_every_solid_needs_a_pose_of_three_finite_numbers(make, name, index):
    for invalid_value in ((0.0, math.nan, 0.0), (0.0, 1.0), (0.0, 0.0, 0.0, 1.0)):
        pose = [CENTRE, ROTATION]
        pose[index] = invalid_value
        with pytest.raises(InputError, match=f"the {name} of a solid must be three finite numbers"):
            make(*pose)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
@pytest.mark.parametrize("name", ["hull", "tetrahedron", "hull of a box"])
def test_distances_to_a_hull_are_proportional_to_its_size(name, scale):
    """The tolerance for a projection inside a face is relative to the size of the hull."""
    hull = SHAPES[name]
    points = points_around(hull, 300)
    larger = convex_hull(scale * np.array(hull.corners))
    np.testing.assert_allclose(larger.distances(scale * points), scale * hull.distances(points), atol=1e-9 * scale)


@pytest.mark.parametrize("distance", [(1e7, 0.0, 0.0), (0.0, 1e7, 0.0), (1e7, 1e7, 1e7)])
def test_a_hull_has_the_same_faces_far_from_the_origin(distance):
    """At a distance of 10,000 km from the origin, floating-point numbers have a resolution of nanometres."""
    hull = SHAPES["hull"]
    points = points_around(hull, 300)
    far = convex_hull(np.array(hull.corners) + distance)
    assert len(far.corners) == len(hull.corners)
    np.testing.assert_allclose(far.distances(points + distance), hull.distances(points), atol=1e-6)


def test_points_in_a_plane_are_rejected_as_a_hull():
    flat = HULL_POINTS * [1.0, 1.0, 0.0]
    for points in (flat + np.array([0.0, 0.0, 1.0]), transformed_points(flat, centre=CENTRE, rotation=ROTATION)):
        with pytest.raises(InputError, match="the 30 points of a hull are in a plane"):
            convex_hull(points)


def test_transformed_points_are_not_scaled_by_default():
    corners = SHAPES["cuboid"].corners()
    np.testing.assert_array_equal(transformed_points(corners), corners)
    np.testing.assert_allclose(transformed_points(corners, scale=3.0), 3.0 * corners)
    np.testing.assert_allclose(transformed_points(corners, centre=CENTRE), corners + CENTRE)


@pytest.mark.parametrize("invalid_size", [0.0, -1.0, math.inf, math.nan])
def test_every_size_of_a_solid_must_be_positive_and_finite(invalid_size):
    for make, words in (
        (lambda: Ball(CENTRE, radius=invalid_size), "radius"),
        (lambda: Cylinder(CENTRE, radius=invalid_size), "radius"),
        (lambda: Cylinder(CENTRE, height=invalid_size), "height"),
        *(
            (lambda i=i: Cuboid(CENTRE, size=tuple(np.where(np.arange(3) == i, invalid_size, 1.0))), "size")
            for i in range(3)
        ),
    ):
        with pytest.raises(
            InputError, match=f"the {words} of a solid is {invalid_size:g} m, but must be positive and finite"
        ):
            make()
