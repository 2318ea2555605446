"""Tests of paths in corridors that are polytopes with faces in any direction."""

import itertools

import numpy as np
import pytest

from drake_quad.errors import InputError
from drake_quad.reference.path_problem import PathLimits, PathProblem
from drake_quad.reference.planner import FixedTimes, HeuristicTiming, MinimumSnapTiming, MinimumTimeTiming, plan_path
from drake_quad.reference.polynomial_path import evaluate, evaluate_at, peak_norm
from drake_quad.reference.regions import Box, Polytope

LIMITS = PathLimits(speed=2.0, acceleration=0.7)  # m/s and m/s²
TIMINGS = [FixedTimes((0.0, 5.0, 10.0, 15.0)), MinimumSnapTiming(15.0), HeuristicTiming(), MinimumTimeTiming()]
WAYPOINTS = np.array([[0, 0, 1], [3, 0.2, 1.2], [3.2, 3, 1.5], [0, 3.5, 1.0]])  # m
BOXES_AROUND_LEGS = [Box(np.minimum(a, b) - 0.25, np.maximum(a, b) + 0.25) for a, b in itertools.pairwise(WAYPOINTS)]
NUM_SAMPLES = 10_000  # points at which a path is checked


def rotation(seed):
    matrix, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return matrix * np.linalg.det(matrix)


def rotated_polytope(box, matrix):
    """Return a rotated box as a polytope."""
    faces = Polytope.from_box(box)
    return Polytope(faces.normals @ matrix.T, faces.offsets)


def planned(points, corridors, timing):
    return plan_path(PathProblem([Box.point(point) for point in points], corridors=corridors, limits=LIMITS), timing)


def positions(path):
    return evaluate(path, np.linspace(path.times[0], path.times[-1], 1000)).T


def farthest_beyond(path, corridors):
    """Return the largest violation of a corridor at dense samples of a path, m."""
    s = np.linspace(0.0, 1.0, NUM_SAMPLES)
    return max(
        float((evaluate_at(path, np.full(NUM_SAMPLES, i), s) @ corridor.normals.T - corridor.offsets).max())
        for i, corridor in enumerate(corridors)
    )


@pytest.mark.parametrize("timing", TIMINGS, ids=lambda timing: type(timing).__name__)
def test_a_box_given_as_a_polytope_gives_the_same_plan(timing):
    boxes = planned(WAYPOINTS, BOXES_AROUND_LEGS, timing)
    polytopes = planned(WAYPOINTS, [Polytope.from_box(box) for box in BOXES_AROUND_LEGS], timing)
    assert polytopes.duration == pytest.approx(boxes.duration, rel=1e-6)
    np.testing.assert_allclose(positions(polytopes), positions(boxes), atol=1e-5)


@pytest.mark.parametrize("timing", TIMINGS, ids=lambda timing: type(timing).__name__)
def test_rotating_a_problem_rotates_its_plan(timing):
    matrix = rotation(1)
    boxes = planned(WAYPOINTS, BOXES_AROUND_LEGS, timing)
    rotated = planned(WAYPOINTS @ matrix.T, [rotated_polytope(box, matrix) for box in BOXES_AROUND_LEGS], timing)
    assert rotated.duration == pytest.approx(boxes.duration, rel=1e-6)
    np.testing.assert_allclose(positions(rotated), positions(boxes) @ matrix.T, atol=1e-5)


def chain(seed):
    """Return a problem whose corridors are 3 to 6 random polytopes around the legs of a random route."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(3, 7))
    waypoints = np.cumsum(rng.normal(size=(count + 1, 3)) * [2.0, 2.0, 0.7], axis=0)
    corridors = []
    for a, b in itertools.pairwise(waypoints):
        normals = rng.normal(size=(int(rng.integers(6, 16)), 3))
        normals /= np.linalg.norm(normals, axis=1)[:, np.newaxis]
        support = np.maximum(normals @ a, normals @ b)
        box = Box(np.minimum(a, b) - 1.0, np.maximum(a, b) + 1.0)
        corridors.append(Polytope(normals, support + rng.uniform(0.1, 0.4, len(support))).intersection(box))
    regions = [Box.point(waypoints[0])]
    regions += [a.intersection(b) for a, b in itertools.pairwise(corridors)]
    return PathProblem([*regions, Box.point(waypoints[-1])], corridors=corridors, limits=LIMITS)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    "timing",
    [HeuristicTiming(), MinimumSnapTiming(30.0), MinimumTimeTiming()],
    ids=lambda timing: type(timing).__name__,
)
def test_a_path_stays_in_its_polytopes_at_all_times(timing, seed):
    problem = chain(seed)
    path = plan_path(problem, timing)
    largest = max(corridor.size for corridor in problem.corridors)
    assert farthest_beyond(path, problem.corridors) <= 1e-6 * largest


def test_a_flat_polytope_is_rejected():
    flat = Polytope([[1, 1, 0], [-1, -1, 0]], [0, 0])
    with pytest.raises(InputError, match=r"corridor of segment 0, .* is flat; give it an extent, or use a box"):
        PathProblem([Box.point([0, 0, 0]), Box.point([1, -1, 0])], corridors=[flat])


def test_the_error_for_a_waypoint_outside_a_polytope_gives_the_distance():
    half_space = Polytope([[3, 4, 0]], [0])
    with pytest.raises(InputError, match="waypoint 1, .* lies outside the corridor of segment 0, .* 0.6 m apart"):
        PathProblem([Box.point([0, 0, 0]), Box.point([1, 0, 0])], corridors=[half_space])


@pytest.mark.long
@pytest.mark.parametrize(
    ("segments", "timing"), [(25, HeuristicTiming()), (10, MinimumTimeTiming())], ids=["25 heuristic", "10 shortest"]
)
def test_a_path_stays_in_a_long_chain_of_polytopes(segments, timing):
    """The polytopes are cells of a zigzag, with a waypoint in the intersection of consecutive polytopes."""
    random = np.random.default_rng(segments)
    points = np.column_stack([np.arange(segments + 1.0), random.uniform(-0.6, 0.6, (segments + 1, 2))])
    cells = []
    for one, other in itertools.pairwise(points):
        along = (other - one) / np.linalg.norm(other - one)
        sides = np.linalg.svd(along[None])[2][1:]
        normals = np.vstack([along, -along, sides, -sides])
        offsets = np.vstack([sides, -sides]) @ one + random.uniform(0.1, 0.3, 4)
        cells.append(Polytope(normals, [along @ other + 0.15, -along @ one + 0.15, *offsets]))
    joints = [one.intersection(other) for one, other in itertools.pairwise(cells)]
    regions = [Box.point(points[0]), *joints, Box.point(points[-1])]
    limits = PathLimits(speed=2.0, acceleration=2.0)
    path = plan_path(PathProblem(regions, corridors=cells, limits=limits), timing)
    assert farthest_beyond(path, cells) < 1e-6
    assert peak_norm(path, 1) <= 2.0 + 1e-9
    assert peak_norm(path, 2) <= 2.0 + 1e-9
