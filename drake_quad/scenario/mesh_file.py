"""The points of a mesh from an .obj or .stl file."""

from pathlib import Path

import numpy as np

from drake_quad.errors import InputError
from drake_quad.scenario.limits import MOST_CORNERS
from drake_quad.scenario.marked_tree import Mark, Tree
from drake_quad.scenario.reading import opened
from drake_quad.space.shapes import hull_of
from drake_quad.written_numbers import float_in

_MOST_BYTES = 50_000_000
# A binary .stl: 80 bytes and a count, then 12 numbers and 2 bytes for each triangle.
_HEAD = 84
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def mesh_points(path: Path) -> Tree:
    """Reads the corners of a mesh's convex hull as the list `points` of an obstacle, in the mesh's own axes and units.

    Args:
        path: of a Wavefront .obj file, or of an .stl file of text or binary.

    Raises:
        InputError: the file cannot be read, is no such mesh, is flat, or its hull has too many corners.
    """
    mark = Mark(str(path), 0)
    read = {".obj": _of_obj, ".stl": _of_stl}.get(path.suffix.lower())
    if read is None:
        raise InputError(f"{mark}: is not a mesh that can be read: its name must end in .obj or .stl")
    with opened(path) as file:
        data = file.read(_MOST_BYTES + 1)
    if len(data) > _MOST_BYTES:
        raise InputError(f"{mark}: is too large: a mesh may have {_MOST_BYTES:,} bytes")
    try:
        points = read(data)
    except (ValueError, IndexError):
        raise InputError(f"{mark}: is not a mesh of the form that its name says") from None
    try:
        corners = hull_of(points).corners
    except InputError as error:
        raise InputError(f"{mark}: {error}") from None
    if len(corners) > MOST_CORNERS:
        raise InputError(
            f"{mark}: the convex hull has {len(corners)} corners, but may have {MOST_CORNERS}: simplify the mesh"
        )
    return Tree.of(corners, mark)


def _of_obj(data: bytes) -> np.ndarray:
    """(n, 3): the numbers behind each `v`."""
    rows = (line.split() for line in data.decode("utf-8", "replace").splitlines())
    return np.array([[float_in(number) for number in row[1:4]] for row in rows if row and row[0] == "v"])


def _of_stl(data: bytes) -> np.ndarray:
    """(n, 3): of the triangles, or the numbers behind each `vertex`."""
    if len(data) >= _HEAD and len(data) == _HEAD + _TRIANGLE.itemsize * int.from_bytes(
        data[_HEAD - 4 : _HEAD], "little"
    ):
        triangles = np.frombuffer(data, _TRIANGLE, offset=_HEAD)
        return np.unique(triangles["corners"].reshape(-1, 3).astype(float), axis=0)
    rows = (line.split() for line in data.decode("utf-8", "replace").splitlines())
    return np.array([[float_in(number) for number in row[1:4]] for row in rows if row and row[0] == "vertex"])
