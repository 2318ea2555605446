"""Convex solids: how far a point is from their surface, and the sets and triangles that they are to others.

A distance (m) is exact: positive outside, negative inside, and the same formula serves floats, the arrays of a fleet
and the symbols of which machine code is made.
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

from drake_quad.errors import InputError, shown
from drake_quad.framework.elementary import dot, maximum, minimum, sqrt, total, where
from drake_quad.signals import Row

Vector = tuple[float, float, float]
_LEVEL = (0.0, 0.0, 0.0)
# Sides of what is drawn for a circle.
_SIDES = 32
# A point that was projected onto a face lies in it by floating point, m per m of size.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class _Placed:
    """Frame of a solid in W.

    Attributes:
        centre: of the solid, m.
        rotation: roll, pitch and yaw of the solid's axes in W, rad.
    """

    centre: Vector
    rotation: Vector = _LEVEL

    @cached_property
    def axes(self) -> np.ndarray:
        """(3, 3), rows are the solid's axes in W: they turn a vector of W into one of the solid's frame."""
        if self.rotation == _LEVEL:
            return np.eye(3)
        return np.asarray(RollPitchYaw(np.array(self.rotation)).ToRotationMatrix().matrix()).T

    def within(self, x: Row, y: Row, z: Row) -> tuple[Row, Row, Row]:
        """A point of W in the frame of the solid, m."""
        offset = (x - self.centre[0], y - self.centre[1], z - self.centre[2])
        return tuple(_product(axis, offset) for axis in self.axes.tolist())  # type: ignore[return-value]

    def _outside(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the solid's frame in W."""
        return np.asarray(points @ self.axes + self.centre)


class _Solid(_Placed, ABC):
    """A solid somewhere in W."""

    @abstractmethod
    def distance(self, x: Row, y: Row, z: Row) -> Row:
        """Return the distance of a point of W from the surface, m; negative inside."""

    def distance_lower_bound(self, x: Row, y: Row, z: Row) -> None:
        """None: nothing that the distance is not below costs less."""

    def distances(self, points: ArrayLike) -> np.ndarray:
        """How far points (n, 3) are from the surface: (n,), m."""
        return np.asarray(self.distance(*np.asarray(points, dtype=float).T))


@dataclass(frozen=True)
class Cuboid(_Solid):
    """A box with any rotation.

    Attributes:
        size: along its axes, m.

    Raises:
        InputError: a number is not finite, or a size not positive.
    """

    size: Vector = (1.0, 1.0, 1.0)

    def __post_init__(self) -> None:
        _check_pose(self)
        _check_positive("size", *self.size)

    def distance(self, x: Row, y: Row, z: Row) -> Row:
        """How far a point of W is from the surface, m; negative inside."""
        beyond = [abs(p) - 0.5 * size for p, size in zip(self.within(x, y, z), self.size, strict=True)]
        outside = _norm([maximum(0.0, each) for each in beyond])
        return outside + minimum(0.0, reduce(maximum, beyond))

    def corners(self) -> np.ndarray:
        """(8, 3), m."""
        signs = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3, indexing="ij")).reshape(3, -1).T
        return self._outside(signs * self.size)

    def convex_set(self) -> ConvexSet:
        """The same, for Drake's optimisation."""
        middle, half = self.axes @ self.centre, 0.5 * np.array(self.size)
        return HPolyhedron(np.vstack([self.axes, -self.axes]), np.concatenate([middle + half, half - middle]))

    def triangles(self) -> np.ndarray:
        """(12, 3, 3), corners of the surface's triangles, m."""
        return hull_of(self.corners()).triangles()

    def extent(self) -> np.ndarray:
        """(2, 3), lowest and highest corner of the axis-aligned box around it, m."""
        corners = self.corners()
        return np.array([corners.min(axis=0), corners.max(axis=0)])


@dataclass(frozen=True)
class Cylinder(_Solid):
    """A cylinder, upright unless it is rotated.

    Attributes:
        radius: m.
        height: along its own Z, m.

    Raises:
        InputError: a number is not finite, or radius or height not positive.
    """

    radius: float = 1.0
    height: float = 1.0

    def __post_init__(self) -> None:
        _check_pose(self)
        _check_positive("radius", self.radius)
        _check_positive("height", self.height)

    def distance(self, x: Row, y: Row, z: Row) -> Row:
        """How far a point of W is from the surface, m; negative inside."""
        p_x, p_y, p_z = self.within(x, y, z)
        beyond = [_norm([p_x, p_y]) - self.radius, abs(p_z) - 0.5 * self.height]
        return _norm([maximum(0.0, each) for each in beyond]) + minimum(0.0, reduce(maximum, beyond))

    def convex_set(self) -> ConvexSet:
        """The same, for Drake's optimisation."""
        disc = Hyperellipsoid.MakeHypersphere(self.radius, np.zeros(2))
        height = HPolyhedron.MakeBox([-0.5 * self.height], [0.5 * self.height])
        return CartesianProduct([disc, height], self.axes, -self.axes @ self.centre)

    def triangles(self) -> np.ndarray:
        """(n, 3, 3), corners of the surface's triangles, whose corners lie on it, m."""
        angles = 2.0 * math.pi * np.arange(_SIDES) / _SIDES
        rim = np.column_stack([self.radius * np.cos(angles), self.radius * np.sin(angles)])
        ends = [np.column_stack([rim, np.full(_SIDES, sign * 0.5 * self.height)]) for sign in (-1.0, 1.0)]
        return hull_of(self._outside(np.vstack(ends))).triangles()

    def extent(self) -> np.ndarray:
        """(2, 3), lowest and highest corner of the axis-aligned box around it, m."""
        along = self.axes[2]
        half = 0.5 * self.height * np.abs(along) + self.radius * np.sqrt(np.maximum(0.0, 1.0 - along**2))
        return np.array([self.centre - half, self.centre + half])


@dataclass(frozen=True)
class Ball(_Solid):
    """A ball.

    Attributes:
        radius: m.

    Raises:
        InputError: a number is not finite, or the radius not positive.
    """

    radius: float = 1.0

    def __post_init__(self) -> None:
        _check_pose(self)
        _check_positive("radius", self.radius)

    def distance(self, x: Row, y: Row, z: Row) -> Row:
        """How far a point of W is from the surface, m; negative inside."""
        return _norm(self.within(x, y, z)) - self.radius

    def convex_set(self) -> ConvexSet:
        """The same, for Drake's optimisation."""
        return Hyperellipsoid.MakeHypersphere(self.radius, np.array(self.centre))

    def triangles(self) -> np.ndarray:
        """(n, 3, 3), corners of the surface's triangles, whose corners lie on it, m."""
        up = np.linspace(-0.5 * math.pi, 0.5 * math.pi, _SIDES // 2 + 1)[1:-1, None]
        around = 2.0 * math.pi * np.arange(_SIDES) / _SIDES
        belts = np.stack(np.broadcast_arrays(np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)), -1)
        points = np.vstack([belts.reshape(-1, 3), [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]])
        return hull_of(self._outside(self.radius * points)).triangles()

    def extent(self) -> np.ndarray:
        """(2, 3), lowest and highest corner of the axis-aligned box around it, m."""
        return np.array(self.centre) + self.radius * np.array([[-1.0], [1.0]])


@dataclass(frozen=True)
class Hull:
    """The convex hull of points; made by `hull_of`.

    Attributes:
        corners: of the hull, m.
        normals: of its faces, unit, outward.
        offsets: of its faces, m: a point p is inside where n·p <= d for each.
        edges: numbers of the two corners of each edge.
        facets: numbers of the three corners of each triangle of its surface.
    """

    corners: tuple[Vector, ...]
    normals: tuple[Vector, ...]
    offsets: tuple[float, ...]
    edges: tuple[tuple[int, int], ...]
    facets: tuple[tuple[int, int, int], ...]

    @property
    def centre(self) -> Vector:
        """The mean of the corners, m."""
        return tuple(np.mean(self.corners, axis=0).tolist())

    def distance(self, x: Row, y: Row, z: Row) -> Row:
        """Return the distance of a point in W from the surface, m; negative inside.

        For a point outside, no plane of a face is farther away than the hull. If the projection of the point onto the
        farthest plane is in the hull, it is the nearest point. Otherwise the nearest point is on an edge.
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
            beyond = _product(normal, p) - offset
            towards = where(beyond > farthest, normal, towards)
            farthest = where(beyond > farthest, beyond, farthest)
        projected = tuple(each - farthest * n for each, n in zip(p, towards, strict=True))
        outside = reduce(maximum, [_product(normal, projected) - offset for normal, offset in faces])
        in_face = (outside <= self._tolerance) | (farthest <= 0.0)
        return where(in_face, farthest, sqrt(self._to_edges_squared(p)))

    @cached_property
    def _tolerance(self) -> float:
        return _ROUNDING * float(np.ptp(np.array(self.corners), axis=0).max())

    def _to_edges_squared(self, p: tuple[Row, Row, Row]) -> Row:
        """The squared distance to the nearest edge of a point relative to the centre, m²."""
        corners = np.array(self.corners) - self.centre
        least: Row = math.inf
        squared = [_squared([each - c for each, c in zip(p, corner, strict=True)]) for corner in corners.tolist()]
        for first, second in self.edges:
            along = corners[second] - corners[first]
            length = float(np.linalg.norm(along))
            along /= length
            ahead = _product(along.tolist(), p) - float(along @ corners[first])
            # From the first corner to the nearest point of the edge.
            step = minimum(length, maximum(0.0, ahead))
            least = minimum(least, squared[first] + step * (step - 2.0 * ahead))
        # Rounding may leave less than nothing on an edge.
        return maximum(0.0, least)

    def distance_lower_bound(self, x: Row, y: Row, z: Row) -> Row:
        """How far a point of W is from a ball around the hull, m: the distance is not below it."""
        c_x, c_y, c_z = self.centre
        return _norm((x - c_x, y - c_y, z - c_z)) - self._reach

    @cached_property
    def _reach(self) -> float:
        """The radius of the ball around the centre that holds the hull, m, whatever is rounded."""
        return (1.0 + 1e-9) * float(np.linalg.norm(np.array(self.corners) - self.centre, axis=1).max())

    def distances(self, points: ArrayLike) -> np.ndarray:
        """How far points (n, 3) are from the surface: (n,), m."""
        return np.asarray(self.distance(*np.asarray(points, dtype=float).T))

    def convex_set(self) -> ConvexSet:
        """The same, for Drake's optimisation."""
        return VPolytope(np.array(self.corners).T)

    def triangles(self) -> np.ndarray:
        """(n, 3, 3), corners of the surface's triangles, m."""
        return np.array(self.corners)[np.array(self.facets)]

    def extent(self) -> np.ndarray:
        """(2, 3), lowest and highest corner of the axis-aligned box around it, m."""
        return np.array([np.min(self.corners, axis=0), np.max(self.corners, axis=0)])


Shape = Cuboid | Cylinder | Ball | Hull


def hull_of(points: ArrayLike) -> Hull:
    """Return the convex hull of points (n, 3), m.

    Raises:
        InputError: there are fewer than four points, or they are not finite or lie in a plane.
    """
    # Nobody waits for SciPy's geometry who flies around boxes.
    from scipy.spatial import ConvexHull, QhullError

    found = np.asarray(points, dtype=float)
    if found.ndim != 2 or found.shape[1] != 3 or len(found) < 4:
        raise InputError(f"a hull needs at least 4 points of 3 coordinates, not an array of shape {found.shape}")
    if not np.isfinite(found).all():
        raise InputError("the points of a hull must be finite")
    middle = found.mean(axis=0)
    size = float(np.ptp(found, axis=0).max())
    # Thinner than a millionth of its size is flat.
    if np.linalg.svd(found - middle, compute_uv=False)[-1] <= 1e-6 * size:
        raise InputError(f"the {len(found)} points of a hull are in a plane")
    try:
        hull = ConvexHull((found - middle) / size)
    except QhullError as error:
        raise InputError(f"no hull of {len(found)} points was found") from error
    corners = found[hull.vertices]
    places = np.empty(len(found), dtype=int)
    places[hull.vertices] = np.arange(len(corners))
    facets = places[hull.simplices]
    a, b, c = corners[facets].transpose(1, 0, 2)
    is_inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    facets[is_inward, 1:] = facets[is_inward, :0:-1]
    # Triangles of one face have one plane, but for rounding.
    planes, face_of = np.unique(np.round(hull.equations, 9), axis=0, return_inverse=True)
    normals = planes[:, :3] / np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    shared: dict[tuple[int, int], set[int]] = {}
    for (first, second, third), face in zip(facets.tolist(), np.ravel(face_of).tolist(), strict=True):
        for edge in ((first, second), (second, third), (third, first)):
            shared.setdefault((min(edge), max(edge)), set()).add(face)
    return Hull(
        tuple(map(tuple, corners.tolist())),
        tuple(map(tuple, normals.tolist())),
        tuple((normals @ corners.T).max(axis=1).tolist()),
        tuple(sorted(edge for edge, faces in shared.items() if len(faces) > 1)),
        tuple(sorted(map(tuple, facets.tolist()))),
    )


def placed(points: ArrayLike, *, centre: Vector = _LEVEL, rotation: Vector = _LEVEL, scale: float = 1.0) -> np.ndarray:
    """Points (n, 3) of a solid's own frame in W (m): scaled, turned by roll, pitch and yaw (rad), moved to a centre."""
    return _Placed(centre, rotation)._outside(scale * np.asarray(points, dtype=float))


def _product(normal: Sequence[float], rows: Sequence[Row]) -> Row:
    """The product of a known vector and rows, without what is multiplied by nothing or by one."""
    terms = [row if n == 1.0 else n * row for n, row in zip(normal, rows, strict=True) if n != 0.0]
    return total(terms)


def _squared(rows: Sequence[Row]) -> Row:
    return dot(rows, rows)


def _norm(rows: Sequence[Row]) -> Row:
    return sqrt(_squared(rows))


def _check_pose(solid: _Solid) -> None:
    for name, numbers in (("centre", solid.centre), ("rotation", solid.rotation)):
        if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
            raise InputError(f"the {name} of a solid must be three finite numbers, not {shown(numbers)}")


def _check_positive(name: str, *values: float) -> None:
    for value in values:
        if not 0.0 < value < math.inf:
            raise InputError(f"the {name} of a solid is {value:g} m, but must be positive and finite")
