"""Reading of mesh vertices from an .obj or .stl file."""

import codecs
import warnings
from pathlib import Path

import numpy as np

from drake_quad.errors import InputError, InputWarning
from drake_quad.number_parsing import parse_float
from drake_quad.scenario.files.marked_tree import Mark, Tree
from drake_quad.scenario.files.reading import read_bytes
from drake_quad.scenario.files.robot_files import ROBOT_KINDS
from drake_quad.scenario.limits import MAX_CORNERS
from drake_quad.space.simplification import simplified_hull

_MAX_MESH_BYTES = 50_000_000  # limits the time to read a file
# Header of a binary .stl file: 80 bytes, then the number of triangles. Each triangle has 12 numbers and 2 more bytes.
_STL_HEADER_BYTES = 84
_STL_COUNT = slice(80, _STL_HEADER_BYTES)  # bytes with the number of triangles
_ROBOT_MESSAGE = "describes a {} and is not a mesh: give the mesh, box, cylinder or sphere of its collision element"
_CONVERSION_MESSAGE = "is a {} and cannot be read: convert it to .obj or .stl, with Blender or MeshLab"
# Error messages for other common formats, by file suffix.
_ERRORS_BY_SUFFIX = {
    **{suffix: _ROBOT_MESSAGE.format(kind) for suffix, kind in ROBOT_KINDS.items()},
    ".dae": _CONVERSION_MESSAGE.format("Collada mesh"),
    **dict.fromkeys((".gltf", ".glb"), _CONVERSION_MESSAGE.format("glTF mesh")),
    ".ply": _CONVERSION_MESSAGE.format("PLY mesh"),
    ".off": _CONVERSION_MESSAGE.format("OFF mesh"),
    ".fbx": _CONVERSION_MESSAGE.format("FBX mesh"),
    ".3ds": _CONVERSION_MESSAGE.format("3DS mesh"),
    **dict.fromkeys((".step", ".stp", ".iges", ".igs"), "is a CAD model and cannot be read: export it as .obj or .stl"),
}
# Error message for each beginning of a file. The beginning is compared in lower case.
_ERRORS_BY_FIRST_BYTES = {
    b"gltf": _ERRORS_BY_SUFFIX[".gltf"],
    b"ply\n": _ERRORS_BY_SUFFIX[".ply"],
    b"ply\r\n": _ERRORS_BY_SUFFIX[".ply"],
}
# Error message for each root element of an XML file. The element is compared in lower case.
_ERRORS_BY_XML_ELEMENT = {
    b"<robot": _ERRORS_BY_SUFFIX[".urdf"],
    b"<sdf": _ERRORS_BY_SUFFIX[".sdf"],
    b"<collada": _ERRORS_BY_SUFFIX[".dae"],
}
_NUM_SEARCHED_BYTES = 2_000  # enough to find the root element after an XML declaration and comments
# Layout of a triangle in a binary .stl file.
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def mesh_points(path: Path) -> Tree:
    """Read the vertices of a mesh's convex hull as an obstacle's list `points`, in axes and units of the file.

    If the hull has too many vertices, a simpler hull that encloses it is used, with a warning; see `simplified_hull`.

    Args:
        path: path of a Wavefront .obj file, or of a text or binary .stl file.

    Raises:
        InputError: if the file cannot be read, has another format, contains a flat mesh, or has a hull that cannot be
            simplified.
    """
    file_mark = Mark(str(path), 0)
    suffix = path.suffix.lower()
    read = {".obj": _obj_vertices, ".stl": _stl_vertices}.get(suffix)
    if read is None:
        fault = _ERRORS_BY_SUFFIX.get(suffix, "is not a mesh that can be read: its name must end in .obj or .stl")
        raise InputError(f"{file_mark}: {fault}")
    data = read_bytes(path, _MAX_MESH_BYTES, f"a mesh may have at most {_MAX_MESH_BYTES:,} bytes")
    if fault := _other_format_error(data[:_NUM_SEARCHED_BYTES].lower()):
        raise InputError(f"{file_mark}: {fault}")
    try:
        points = read(data)
    except (ValueError, IndexError):
        points = np.empty((0, 3))
    if not points.size:
        raise InputError(f"{file_mark}: is incomplete, or not a mesh of the format that its file name implies")
    try:
        hull = simplified_hull(points, MAX_CORNERS)
    except InputError as error:
        raise InputError(f"{file_mark}: {error}") from None
    if hull.is_simpler:
        warnings.warn(f"{file_mark}: {hull}", InputWarning, stacklevel=2)
    return Tree.of(hull.corners.tolist(), file_mark)


def _other_format_error(beginning: bytes) -> str:
    """Return an error message if the first bytes of a file identify another known format; empty otherwise."""
    flaws = [flaw for start, flaw in _ERRORS_BY_FIRST_BYTES.items() if beginning.startswith(start)]
    if beginning.removeprefix(codecs.BOM_UTF8).lstrip().startswith(b"<"):
        flaws += [flaw for element, flaw in _ERRORS_BY_XML_ELEMENT.items() if element in beginning]
    return flaws[0] if flaws else ""


def _obj_vertices(data: bytes) -> np.ndarray:
    """Return the vertices (n, 3) of a Wavefront .obj file, which follow the keyword `v`."""
    rows = (line.split() for line in data.decode("utf-8", "replace").splitlines())
    return np.array([[parse_float(number) for number in row[1:4]] for row in rows if row and row[0] == "v"])


def _stl_vertices(data: bytes) -> np.ndarray:
    """Return the vertices (n, 3) of a binary .stl file, or of a text file in which they follow the keyword `vertex`."""
    size = _STL_HEADER_BYTES + _STL_TRIANGLE.itemsize * int.from_bytes(data[_STL_COUNT], "little")
    is_binary = len(data) >= _STL_HEADER_BYTES and (len(data) == size or b"vertex" not in data)
    if not is_binary:
        rows = (line.split() for line in data.decode("utf-8", "replace").splitlines())
        return np.array([[parse_float(number) for number in row[1:4]] for row in rows if row and row[0] == "vertex"])
    if len(data) < size:
        raise ValueError("the file ends before its last triangle")
    triangles = np.frombuffer(data[:size], _STL_TRIANGLE, offset=_STL_HEADER_BYTES)
    return np.unique(triangles["corners"].reshape(-1, 3).astype(float), axis=0)
