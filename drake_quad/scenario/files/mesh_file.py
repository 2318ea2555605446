"""The points of a mesh from an .obj or .stl file."""

import codecs
import warnings
from pathlib import Path

import numpy as np

from drake_quad.errors import InputError, InputWarning
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.files.reading import read_bytes
from drake_quad.scenario.files.robot_files import ROBOT_KINDS
from drake_quad.scenario.limits import MOST_CORNERS
from drake_quad.space.simplification import surrounding
from drake_quad.written_numbers import float_in

_MOST_BYTES = 50_000_000
# A binary .stl: 80 bytes and a count, then 12 numbers and 2 bytes for each triangle.
_HEAD = 84
_ROBOT = "describes a {} and is not a mesh: give the mesh, box, cylinder or sphere of its collision element instead"
_CONVERTED = "is a {} and cannot be read: convert it to .obj or .stl, with Blender or MeshLab"
# Error messages for common other formats, by file suffix, by the first bytes of the file, and by an XML element near
# its start.
_SUFFIXES = {
    **{suffix: _ROBOT.format(kind) for suffix, kind in ROBOT_KINDS.items()},
    ".dae": _CONVERTED.format("Collada mesh"),
    **dict.fromkeys((".gltf", ".glb"), _CONVERTED.format("glTF mesh")),
    ".ply": _CONVERTED.format("PLY mesh"),
    ".off": _CONVERTED.format("OFF mesh"),
    ".fbx": _CONVERTED.format("FBX mesh"),
    ".3ds": _CONVERTED.format("3DS mesh"),
    **dict.fromkeys((".step", ".stp", ".iges", ".igs"), "is a CAD model and cannot be read: export it as .obj or .stl"),
}
_BEGINNINGS = {b"gltf": _SUFFIXES[".gltf"], b"ply\n": _SUFFIXES[".ply"], b"ply\r\n": _SUFFIXES[".ply"]}
_ELEMENTS = {b"<robot": _SUFFIXES[".urdf"], b"<sdf": _SUFFIXES[".sdf"], b"<collada": _SUFFIXES[".dae"]}
_NUM_SEARCHED_BYTES = 2_000  # enough to find the root element after an XML declaration and comments
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def mesh_points(path: Path) -> Tree:
    """Read the corners of a mesh's convex hull as the list `points` of an obstacle, in the mesh's own axes and units.

    A hull with too many corners is replaced by a simpler hull around it, see `surrounding`, with a warning.

    Args:
        path: path of a Wavefront .obj file, or of a text or binary .stl file.

    Raises:
        InputError: if the file cannot be read, has another format, contains a flat mesh, or has a hull that cannot be
            simplified.
    """
    mark = Mark(str(path), 0)
    suffix = path.suffix.lower()
    read = {".obj": _of_obj, ".stl": _of_stl}.get(suffix)
    if read is None:
        flaw = _SUFFIXES.get(suffix, "is not a mesh that can be read: its name must end in .obj or .stl")
        raise InputError(f"{mark}: {flaw}")
    data = read_bytes(path, _MOST_BYTES, f"a mesh may have {_MOST_BYTES:,} bytes")
    if flaw := _other_kind(data[:_NUM_SEARCHED_BYTES].lower()):
        raise InputError(f"{mark}: {flaw}")
    try:
        points = read(data)
    except (ValueError, IndexError):
        raise InputError(f"{mark}: is not a mesh of the format that its file name implies") from None
    try:
        hull = surrounding(points, MOST_CORNERS)
    except InputError as error:
        raise InputError(f"{mark}: {error}") from None
    if hull.is_simpler:
        warnings.warn(f"{mark}: {hull}", InputWarning, stacklevel=2)
    return Tree.of(hull.corners.tolist(), mark)


def _other_kind(beginning: bytes) -> str:
    """Return an error message for a file whose first bytes are those of another known format; empty otherwise."""
    known = [flaw for start, flaw in _BEGINNINGS.items() if beginning.startswith(start)]
    if beginning.removeprefix(codecs.BOM_UTF8).lstrip().startswith(b"<"):
        known += [flaw for element, flaw in _ELEMENTS.items() if element in beginning]
    return known[0] if known else ""


def _of_obj(data: bytes) -> np.ndarray:
    """Return the vertices (n, 3) of a Wavefront .obj file, which follow the keyword `v`."""
    rows = (line.split() for line in data.decode("utf-8", "replace").splitlines())
    return np.array([[float_in(number) for number in row[1:4]] for row in rows if row and row[0] == "v"])


def _of_stl(data: bytes) -> np.ndarray:
    """Return the vertices (n, 3) of a binary .stl file, or of a text file, where they follow the keyword `vertex`."""
    if len(data) >= _HEAD and len(data) == _HEAD + _TRIANGLE.itemsize * int.from_bytes(
        data[_HEAD - 4 : _HEAD], "little"
    ):
        triangles = np.frombuffer(data, _TRIANGLE, offset=_HEAD)
        return np.unique(triangles["corners"].reshape(-1, 3).astype(float), axis=0)
    rows = (line.split() for line in data.decode("utf-8", "replace").splitlines())
    return np.array([[float_in(number) for number in row[1:4]] for row in rows if row and row[0] == "vertex"])
