"""Convex solids: distances from points, convex sets for Drake's optimisation, and triangles for display.

Distances (m) are exact, positive outside and negative inside. The same formulas accept floats, arrays with one value
for each vehicle of a fleet, and the symbols that the compiler of this library uses.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, reduce

import numpy as np
from numpy.typing import ArrayLike
from pydrake.geometry.optimization import CartesianProduct, ConvexSet, HPolyhedron, Hyperellipsoid, VPolytope
from pydrake.math import RollPitchYaw

from drake_quad.errors import InputError, short_repr
from drake_quad.framework.elementary import dot, maximum, minimum, sqrt, total, where
from drake_quad.signals import Row

Vector = tuple[float, float, float]
_ZERO_VECTOR = (0.0, 0.0, 0.0)
# Number of sides of the polygon that represents a circle in drawings.
_CIRCLE_SIDES = 32
# Distance from a face, relative to the size of the solid, up to which a projected point counts as a point of the face.
_RELATIVE_ROUNDING = 1e-12
# Largest coordinate and smallest size of a hull. Squares and products of such lengths neither overflow nor underflow.
_MAX_COORDINATE, _MIN_SIZE = 1e9, 1e-6  # m


@dataclass(frozen=True)
class _Posed:
    """Solid with a position and an orientation in W.

    Attributes:
        centre: centre of the solid, m.
        rotation: roll, pitch and yaw of the solid's axes in W, rad.
    """

    centre: Vector
    rotation: Vector = _ZERO_VECTOR

    @cached_property
    def axes(self) -> np.ndarray:
        """(3, 3) rotation matrix from W to the solid's frame, whose rows are the solid's axes in W."""
        if self.rotation == _ZERO_VECTOR:
            return np.eye(3)
        return np.asarray(RollPitchYaw(np.array(self.rotation)).ToRotationMatrix().matrix()).T

    def to_solid(self, x: Row, y: Row, z: Row) -> tuple[Row, Row, Row]:
        """Transform a point from W to the frame of the solid, m."""
        offset = (x - self.centre[0], y - self.centre[1], z - self.centre[2])
        return tuple(_product(axis, offset) for axis in self.axes.tolist())  # type: ignore[return-value]

    def _to_world(self, points: np.ndarray) -> np.ndarray:
        """Transform points (..., 3) from the solid's frame to W, m."""
        return np.asarray(points @ self.axes + self.centre)


class _Solid(_Posed, ABC):
    """Solid with a pose in W."""

    @abstractmethod
    def distance(self, x: Row, y: Row, z: Row) -> Row:
        """Return the distance from the surface to a point in W, m; negative inside."""

    def distance_lower_bound(self, x: Row, y: Row, z: Row) -> None:
        """Return None, since no lower bound is cheaper to compute than the distance itself."""

    def distances(self, points: ArrayLike) -> np.ndarray:
        """Return the (n,) distances of points (n, 3) from the surface, m; negative inside."""
        return np.asarray(self.distance(*np.asarray(points, dtype=float).T))


@dataclass(frozen=True)
class Cuboid(_Solid):
    """Box with any rotation.

    Attributes:
        size: length along each of its axes, m.

    Raises:
        InputError: if a number is not finite, or a length is not positive.
    """

    size: Vector = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        _check_pose(self)
        _check_positive("size", *self.size)

    def distance(self, x: Row, y: Row, z: Row) -> Row:
        """Return the distance from the surface to a point in W, m; negative inside."""
        excess = [abs(p) - 0.5 * size for p, size in zip(self.to_solid(x, y, z), self.size, strict=True)]
        outside = _norm([maximum(0.0, each) for each in excess])
        return outside + minimum(0.0, reduce(maximum, excess))

    def corners(self) -> np.ndarray:
        """Return the (8, 3) corners in W, m."""
        signs = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3, indexing="ij")).reshape(3, -1).T
        return self._to_world(signs * self.size)

    def convex_set(self) -> ConvexSet:
        """Return the solid as a convex set for Drake's optimisation."""
        middle, half = self.axes @ self.centre, 0.5 * np.array(self.size)
        return HPolyhedron(np.vstack([self.axes, -self.axes]), np.concatenate([middle + half, half - middle]))

    def triangles(self) -> np.ndarray:
        """Return the corners (12, 3, 3) of the triangles of the surface, m."""
        return convex_hull(self.corners()).triangles()

    def extent(self) -> np.ndarray:
        """Return the lowest and the highest corner (2, 3) of the axis-aligned bounding box, m."""
        corners = self.corners()
        return np.array([corners.min(axis=0), corners.max(axis=0)])


@dataclass(frozen=True)
class Cylinder(_Solid):
    """Cylinder, upright unless it is rotated.

    Attributes:
        radius: radius, m.
        height: height along the axis of the cylinder, m.

    Raises:
        InputError: if a number is not finite, or the radius or the height is not positive.
    """

    radius: float = 1.0
    height: float = 1.0

    def __post_init__(self) -> None:
        _check_pose(self)
        _check_positive("radius", self.radius)
        _check_positive("height", self.height)

    def distance(self, x: Row, y: Row, z: Row) -> Row:
        """Return the distance from the surface to a point in W, m; negative inside."""
        p_x, p_y, p_z = self.to_solid(x, y, z)
        excess = [_norm([p_x, p_y]) - self.radius, abs(p_z) - 0.5 * self.height]
        return _norm([maximum(0.0, each) for each in excess]) + minimum(0.0, reduce(maximum, excess))

    def convex_set(self) -> ConvexSet:
        """Return the solid as a convex set for Drake's optimisation."""
        disc = Hyperellipsoid.MakeHypersphere(self.radius, np.zeros(2))
        height = HPolyhedron.MakeBox([-0.5 * self.height], [0.5 * self.height])
        return CartesianProduct([disc, height], self.axes, -self.axes @ self.centre)

    def triangles(self) -> np.ndarray:
        """Return the corners (n, 3, 3) of triangles that approximate the surface, m; the corners are on the surface."""
        angles = 2.0 * math.pi * np.arange(_CIRCLE_SIDES) / _CIRCLE_SIDES
        rim = np.column_stack([self.radius * np.cos(angles), self.radius * np.sin(angles)])
        ends = [np.column_stack([rim, np.full(_CIRCLE_SIDES, sign * 0.5 * self.height)]) for sign in (-1.0, 1.0)]
        return convex_hull(self._to_world(np.vstack(ends))).triangles()

    def extent(self) -> np.ndarray:
        """Return the lowest and the highest corner (2, 3) of the axis-aligned bounding box, m."""
        along = self.axes[2]
        half = 0.5 * self.height * np.abs(along) + self.radius * np.sqrt(np.maximum(0.0, 1.0 - along**2))
        return np.array([self.centre - half, self.centre + half])


@dataclass(frozen=True)
class Ball(_Solid):
    """Ball-shaped obstacle.

    Attributes:
        radius: radius, m.

    Raises:
        InputError: if a number is not finite, or the radius is not positive.
    """

    radius: float = 1.0

    def __post_init__(self) -> None:
        _check_pose(self)
        _check_positive("radius", self.radius)

    def distance(self, x: Row, y: Row, z: Row) -> Row:
        """Return the distance from the surface to a point in W, m; negative inside."""
        return _norm(self.to_solid(x, y, z)) - self.radius

    def convex_set(self) -> ConvexSet:
        """Return the solid as a convex set for Drake's optimisation."""
        return Hyperellipsoid.MakeHypersphere(self.radius, np.array(self.centre))

    def triangles(self) -> np.ndarray:
        """Return the corners (n, 3, 3) of triangles that approximate the surface, m; the corners are on the surface."""
        up = np.linspace(-0.5 * math.pi, 0.5 * math.pi, _CIRCLE_SIDES // 2 + 1)[1:-1, None]
        around = 2.0 * math.pi * np.arange(_CIRCLE_SIDES) / _CIRCLE_SIDES
        belts = np.stack(np.broadcast_arrays(np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)), -1)
        points = np.vstack([belts.reshape(-1, 3), [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]])
        return convex_hull(self._to_world(self.radius * points)).triangles()

    def extent(self) -> np.ndarray:
        """Return the lowest and the highest corner (2, 3) of the axis-aligned bounding box, m."""
        return np.array(self.centre) + self.radius * np.array([[-1.0], [1.0]])


@dataclass(frozen=True)
class Hull:
    """Convex hull of points, which `convex_hull` constructs.

    Attributes:
        corners: corners of the hull, m.
        normals: outward unit normals n of the faces.
        offsets: offsets d of the faces, m. A point p is inside if n·p <= d for each face.
        edges: indices of the two corners of each edge.
        facets: indices of the three corners of each triangle of the surface.
    """

    corners: tuple[Vector, ...]
    normals: tuple[Vector, ...]
    offsets: tuple[float, ...]
    edges: tuple[tuple[int, int], ...]
    facets: tuple[tuple[int, int, int], ...]

    @property
    def centre(self) -> Vector:
        """Mean of the corners of the hull, m."""
        return tuple(np.mean(self.corners, axis=0).tolist())

    def distance(self, x: Row, y: Row, z: Row) -> Row:
        """Return the distance from the surface to a point in W, m; negative inside.

        The planes of the faces give a lower bound: no plane is farther from an outside point than the hull. If the
        projection of the point onto the farthest plane lies in the hull, it is the nearest point. Otherwise the nearest
        point is on an edge.
        """
        c_x, c_y, c_z = centre = self.centre
        p = (x - c_x, y - c_y, z - c_z)
        faces = [
            (normal, offset - _product(normal, centre))
            for normal, offset in zip(self.normals, self.offsets, strict=True)
        ]
        farthest: Row = -math.inf
        towards: tuple[Row, Row, Row] = faces[0][0]
        for normal, offset in faces:
            excess = _product(normal, p) - offset
            towards = where(excess > farthest, normal, towards)
            farthest = where(excess > farthest, excess, farthest)
        projected = tuple(each - farthest * n for each, n in zip(p, towards, strict=True))
        outside = reduce(maximum, [_product(normal, projected) - offset for normal, offset in faces])
        in_face = (outside <= self._face_tolerance) | (farthest <= 0.0)
        return where(in_face, farthest, sqrt(self._squared_edge_distance(p)))

    @cached_property
    def _face_tolerance(self) -> float:
        return _RELATIVE_ROUNDING * float(np.ptp(np.array(self.corners), axis=0).max())

    def _squared_edge_distance(self, p: tuple[Row, Row, Row]) -> Row:
        """Return the squared distance from the nearest edge to a point that is given relative to the centre, m²."""
        corners = np.array(self.corners) - self.centre
        min_squared: Row = math.inf
        squared = [_squared([each - c for each, c in zip(p, corner, strict=True)]) for corner in corners.tolist()]
        for first, second in self.edges:
            along = corners[second] - corners[first]
            length = float(np.linalg.norm(along))
            along /= length
            ahead = _product(along.tolist(), p) - float(along @ corners[first])
            # `step` is the distance from the first corner to the nearest point of the edge, m.
            step = minimum(length, maximum(0.0, ahead))
            min_squared = minimum(min_squared, squared[first] + step * (step - 2.0 * ahead))
        # Rounding can make the result slightly negative for a point on an edge.
        return maximum(0.0, min_squared)

    def distance_lower_bound(self, x: Row, y: Row, z: Row) -> Row:
        """Return a lower bound of the distance to a point in W: its distance from a ball that encloses the hull, m."""
        c_x, c_y, c_z = self.centre
        return _norm((x - c_x, y - c_y, z - c_z)) - self._bounding_radius

    @cached_property
    def _bounding_radius(self) -> float:
        """Radius of a ball around the centre that contains the hull, m, including an allowance for rounding."""
        return (1.0 + 1e-9) * float(np.linalg.norm(np.array(self.corners) - self.centre, axis=1).max())

    def distances(self, points: ArrayLike) -> np.ndarray:
        """Return the (n,) distances of points (n, 3) from the surface, m; negative inside."""
        return np.asarray(self.distance(*np.asarray(points, dtype=float).T))

    def convex_set(self) -> ConvexSet:
        """Return the solid as a convex set for Drake's optimisation."""
        return VPolytope(np.array(self.corners).T)

    def triangles(self) -> np.ndarray:
        """Return the corners (n, 3, 3) of the triangles of the surface, m."""
        return np.array(self.corners)[np.array(self.facets)]

    def extent(self) -> np.ndarray:
        """Return the lowest and the highest corner (2, 3) of the axis-aligned bounding box, m."""
        return np.array([np.min(self.corners, axis=0), np.max(self.corners, axis=0)])


Shape = Cuboid | Cylinder | Ball | Hull


def convex_hull(points: ArrayLike) -> Hull:
    """Return the convex hull of points (n, 3), m.

    Raises:
        InputError: there are fewer than four points, or they are not finite or lie in a plane.
    """
    # `scipy.spatial` is imported here, since flights around boxes do not need it.
    from scipy.spatial import ConvexHull, QhullError

    coordinates = np.asarray(points, dtype=float)
    if coordinates.ndim != 2 or coordinates.shape[1] != 3 or len(coordinates) < 4:
        raise InputError(f"a hull needs at least 4 points of 3 coordinates, not an array of shape {coordinates.shape}")
    if not (np.abs(coordinates) <= _MAX_COORDINATE).all():
        raise InputError(f"the coordinates of a hull must be finite, and at most {_MAX_COORDINATE:g} m")
    middle = coordinates.mean(axis=0)
    size = float(np.ptp(coordinates, axis=0).max())
    # A hull thinner than a millionth of its size counts as flat.
    if np.linalg.svd(coordinates - middle, compute_uv=False)[-1] <= 1e-6 * size:
        raise InputError(f"the {len(coordinates)} points of a hull are in a plane")
    if size < _MIN_SIZE:
        raise InputError(f"the hull has a size of {size:.2g} m, but must be larger than {_MIN_SIZE:g} m")
    try:
        hull = ConvexHull((coordinates - middle) / size)
    except QhullError as error:
        raise InputError(f"no hull of {len(coordinates)} points was found") from error
    corners = coordinates[hull.vertices]
    new_indices = np.empty(len(coordinates), dtype=int)
    new_indices[hull.vertices] = np.arange(len(corners))
    facets = new_indices[hull.simplices]
    a, b, c = corners[facets].transpose(1, 0, 2)
    is_inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    facets[is_inward, 1:] = facets[is_inward, :0:-1]
    # Triangles of the same face lie in the same plane, except for rounding.
    planes, face_of_facet = np.unique(np.round(hull.equations, 9), axis=0, return_inverse=True)
    normals = planes[:, :3] / np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    shared: dict[tuple[int, int], set[int]] = {}
    for (first, second, third), face in zip(facets.tolist(), np.ravel(face_of_facet).tolist(), strict=True):
        for edge in ((first, second), (second, third), (third, first)):
            shared.setdefault((min(edge), max(edge)), set()).add(face)
    return Hull(
        tuple(map(tuple, corners.tolist())),
        tuple(map(tuple, normals.tolist())),
        tuple((normals @ corners.T).max(axis=1).tolist()),
        tuple(sorted(edge for edge, faces in shared.items() if len(faces) > 1)),
        tuple(sorted(map(tuple, facets.tolist()))),
    )


def transformed_points(
    points: ArrayLike, *, centre: Vector = _ZERO_VECTOR, rotation: Vector = _ZERO_VECTOR, scale: float = 1.0
) -> np.ndarray:
    """Transform points (n, 3) from the frame of a solid to W, m.

    Args:
        points: (n, 3) points in the frame of the solid.
        centre: position of the solid's origin in W, m.
        rotation: roll, pitch and yaw of the solid, rad.
        scale: factor on the coordinates, applied first.
    """
    return _Posed(centre, rotation)._to_world(scale * np.asarray(points, dtype=float))


def _product(normal: Sequence[float], rows: Sequence[Row]) -> Row:
    """Return the scalar product of a constant vector and another vector, omitting multiplications by 0 or 1."""
    terms = [row if n == 1.0 else n * row for n, row in zip(normal, rows, strict=True) if n != 0.0]
    return total(terms)


def _squared(rows: Sequence[Row]) -> Row:
    return dot(rows, rows)


def _norm(rows: Sequence[Row]) -> Row:
    return sqrt(_squared(rows))


def _check_pose(solid: _Solid) -> None:
    """Raise InputError unless centre and rotation each are three finite numbers."""
    for name, numbers in (("centre", solid.centre), ("rotation", solid.rotation)):
        if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
            raise InputError(f"the {name} of a solid must be three finite numbers, not {short_repr(numbers)}")


def _check_positive(name: str, *values: float) -> None:
    """Raise InputError unless each size is positive and finite."""
    for value in values:
        if not 0.0 < value < math.inf:
            raise InputError(f"the {name} of a solid is {value:g} m, but must be positive and finite")
