"""Shapes of a scene, in metres: quadrotors, fans, tubes and arrows."""

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from pydrake.geometry import Box, Cylinder, Meshcat, Rgba, Sphere, SurfaceTriangle, TriangleSurfaceMesh
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from drake_quad.laboratory.wind.fans import SPREAD, Jet
from drake_quad.signals import RotorSpeed, State, Wind
from drake_quad.visualization.places import places
from drake_quad.visualization.style import BLUE, ORANGE, SKY, VERMILION

# A propeller of 8 inches, as on the paper's vehicle.
_PROPELLER = 0.1
_ARM, _BLADE = (0.022, 0.014), (0.018, 0.004)
# Height of the rotors above the middle of the arms.
_ROTOR_HEIGHT = 0.035
_FAN_DEPTH = 0.25
# Rotors turn at 200 rad/s, and at 30 frames a second would seem to stand still. They are shown slower by this factor.
_SLOW_MOTION = 0.1
# Length of the arrow for a wind of 1 m/s.
_WIND_SCALE = 0.15
# Time in which a vehicle leaves a piece of its trail, s.
TRAIL_PIECE = 0.25
_TRAIL = 0.018
ERRORS = colormaps["viridis"]
# Rotors 1 and 3 turn clockwise seen from above, 2 and 4 anticlockwise.
_SPINS = (-1.0, 1.0, -1.0, 1.0)
# Directions of the arms of rotors 1 to 4 in B, along x and y.
_ARMS = ((1.0, 0.0), (0.0, -1.0), (-1.0, 0.0), (0.0, 1.0))


def rgba(color: str, opacity: float = 1.0) -> Rgba:
    """A colour of Matplotlib, as Drake has it."""
    return Rgba(*to_rgb(color), opacity)


def rotor_poses(arm_length: float, angles: np.ndarray) -> list[RigidTransform]:
    """The poses of rotors 1 to 4 in B, turned by angles (rad)."""
    return [
        RigidTransform(RotationMatrix.MakeZRotation(angle), place)
        for place, angle in zip(_rotor_places(arm_length), angles, strict=True)
    ]


def turned_by(rotor_speed: RotorSpeed, time: float) -> np.ndarray:
    """(4,) angles (rad) by which the rotors are shown to turn in a time (s)."""
    return _SLOW_MOTION * time * np.array(rotor_speed) * _SPINS


def wind_arrow(wind: Wind, state: State) -> tuple[RigidTransform, list[float]]:
    """The pose and the scale of the arrow above a vehicle that shows the wind there."""
    speed = float(np.linalg.norm(wind))
    turn = RotationMatrix.MakeFromOneVector(np.array(wind), 0) if speed > 1e-6 else RotationMatrix()
    length = max(_WIND_SCALE * speed, 1e-3)
    return RigidTransform(turn, places(state) + np.array([0.0, 0.0, 0.3])), [length, min(length, 1.0), min(length, 1.0)]


def draw_trail_piece(meshcat: Meshcat, path: str, points: np.ndarray, shades: str | np.ndarray) -> None:
    """Draws a piece of a trail.

    Args:
        meshcat: in which it is drawn.
        path: of the piece in the scene.
        points: (n, 3) along it, m.
        shades: a colour, or (n,) errors as shares of the largest one.
    """
    vertices, faces = tube(points, _TRAIL)
    if isinstance(shades, str):
        meshcat.SetTriangleMesh(path, vertices, faces, rgba(shades, 0.7))
    else:
        meshcat.SetTriangleColorMesh(path, vertices, faces, np.repeat(ERRORS(shades)[:, :3], 3, axis=0).T)


def _rotor_places(arm_length: float) -> list[np.ndarray]:
    """The positions of rotors 1 to 4 in B, m."""
    return [np.array([arm_length * x, arm_length * y, _ROTOR_HEIGHT]) for x, y in _ARMS]


def draw_quadrotor(meshcat: Meshcat, path: str, arm_length: float, color: str) -> None:
    """Draws a quadrotor in the frame `path`; its rotors turn in the frames `path`/rotor_1 to `path`/rotor_4.

    Its front, rotor 1, is orange; the blades that turn clockwise are blue, the others light blue.
    """
    width, height = _ARM
    meshcat.SetObject(f"{path}/hub", Cylinder(0.045, 0.04), rgba(color))
    meshcat.SetObject(f"{path}/arm_y", Box(width, 2.0 * arm_length, height), rgba(color))
    for name, sign, shade in (("front", 1.0, ORANGE), ("back", -1.0, color)):
        meshcat.SetObject(f"{path}/{name}", Box(arm_length, width, height), rgba(shade))
        meshcat.SetTransform(f"{path}/{name}", RigidTransform([0.5 * sign * arm_length, 0.0, 0.0]))
    meshcat.SetObject(f"{path}/nose", Sphere(0.022), rgba(ORANGE))
    meshcat.SetTransform(f"{path}/nose", RigidTransform([arm_length, 0.0, 0.0]))
    for number, (place, spin) in enumerate(zip(_rotor_places(arm_length), _SPINS, strict=True), start=1):
        shade = BLUE if spin < 0.0 else SKY
        meshcat.SetObject(f"{path}/motor_{number}", Cylinder(0.014, _ROTOR_HEIGHT), rgba("0.25"))
        meshcat.SetTransform(f"{path}/motor_{number}", RigidTransform(place - [0.0, 0.0, 0.5 * _ROTOR_HEIGHT]))
        meshcat.SetObject(f"{path}/disc_{number}", Cylinder(_PROPELLER, 0.002), rgba(shade, 0.2))
        meshcat.SetTransform(f"{path}/disc_{number}", RigidTransform(place))
        meshcat.SetObject(f"{path}/rotor_{number}/blades", Box(2.0 * _PROPELLER, *_BLADE), rgba(shade))
        meshcat.SetTransform(f"{path}/rotor_{number}", RigidTransform(place))


def quadrotor_mesh(arm_length: float) -> TriangleSurfaceMesh:
    """A quadrotor as a single mesh of few triangles, for scenes with hundreds of them."""
    parts = [_bar(np.array([x, y, 0.0]) * arm_length) for x, y in _ARMS]
    angles = np.linspace(0.0, 2.0 * np.pi, 10, endpoint=False)
    rim = _PROPELLER * np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    fan = [(0, i + 1, (i + 1) % len(rim) + 1) for i in range(len(rim))]
    parts += [(place + np.vstack([np.zeros(3), rim]), fan) for place in _rotor_places(arm_length)]
    return _mesh(parts)


def draw_fan(meshcat: Meshcat, path: str, jet: Jet, reach: float) -> None:
    """Draws a fan and its jet, up to a reach (m) and out to the radius at which half of the speed is left."""
    meshcat.SetTransform(
        path, RigidTransform(RotationMatrix.MakeFromOneVector(np.array(jet.direction), 2), np.array(jet.outlet))
    )
    meshcat.SetObject(f"{path}/housing", Cylinder(0.5 * jet.diameter, _FAN_DEPTH), rgba("0.35"))
    meshcat.SetTransform(f"{path}/housing", RigidTransform([0.0, 0.0, -0.5 * _FAN_DEPTH]))
    lengths = np.linspace(0.0, reach, 9)
    radii = np.maximum(0.5 * jet.diameter, SPREAD * lengths)
    meshcat.SetObject(f"{path}/jet", _revolved(lengths, radii), rgba(SKY, 0.1))


def draw_arrow(meshcat: Meshcat, path: str) -> None:
    """Draws an arrow of 1 m along x, which can be scaled and turned."""
    meshcat.SetObject(path, _mesh([_bar(np.array([0.8, 0.0, 0.0]), 0.012), _tip()]), rgba(VERMILION))


def tube(points: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (3, 3 n) and triangles (3, m) of a tube of triangular section along (n, 3) points."""
    ahead = np.gradient(points, axis=0) + 1e-12
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    aside = np.cross(ahead, np.where(np.abs(ahead[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    up = np.cross(aside, ahead)
    corners = [np.cos(angle) * aside + np.sin(angle) * up for angle in np.pi * np.array([0.5, 7 / 6, 11 / 6])]
    vertices = (points[:, None] + radius * np.stack(corners, axis=1)).reshape(-1, 3)
    faces = []
    for i in range(len(points) - 1):
        for k in range(3):
            a, b = 3 * i + k, 3 * i + (k + 1) % 3
            faces += [(a, b, a + 3), (b, b + 3, a + 3)]
    return vertices.T, np.array(faces).T


def pose_of(state: State) -> RigidTransform:
    """The pose of a vehicle."""
    return RigidTransform(RollPitchYaw(state.roll, state.pitch, state.yaw), places(state))


def _bar(end: np.ndarray, half_width: float = 0.009) -> tuple[np.ndarray, list[tuple[int, int, int]]]:
    """Vertices and triangles of a flat bar from the origin."""
    aside = half_width * np.cross(end / np.linalg.norm(end), [0.0, 0.0, 1.0])
    lift = np.array([0.0, 0.0, half_width])
    corners = np.array([base + a + b for base in (0.0 * end, end) for a in (-aside, aside) for b in (-lift, lift)])
    faces = [
        (0, 1, 5),
        (0, 5, 4),
        (2, 6, 7),
        (2, 7, 3),
        (1, 3, 7),
        (1, 7, 5),
        (0, 4, 6),
        (0, 6, 2),
        (4, 5, 7),
        (4, 7, 6),
    ]
    return corners, faces


def _tip() -> tuple[np.ndarray, list[tuple[int, int, int]]]:
    """Vertices and triangles of the tip of an arrow along x."""
    angles = np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)
    rim = np.stack([0.78 * np.ones_like(angles), 0.045 * np.cos(angles), 0.045 * np.sin(angles)], axis=1)
    return np.vstack([[1.0, 0.0, 0.0], rim]), [(0, i + 1, (i + 1) % 8 + 1) for i in range(8)]


def _revolved(lengths: np.ndarray, radii: np.ndarray) -> TriangleSurfaceMesh:
    """A surface of revolution around z, with its radius at each length along z."""
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    vertices = np.concatenate(
        [np.column_stack([radius * ring, np.full(24, z)]) for z, radius in zip(lengths, radii, strict=True)]
    )
    faces = []
    for row in range(len(lengths) - 1):
        for i in range(24):
            a, b = 24 * row + i, 24 * row + (i + 1) % 24
            faces += [(a, b, a + 24), (b, b + 24, a + 24)]
    return _mesh([(vertices, faces)])


def _mesh(parts: Sequence[tuple[np.ndarray, list[tuple[int, int, int]]]]) -> TriangleSurfaceMesh:
    """A mesh of parts, each with its vertices and triangles, that is seen from both sides."""
    vertices, triangles, first = [], [], 0
    for corners, faces in parts:
        vertices += list(corners)
        for a, b, c in faces:
            triangles += [
                SurfaceTriangle(first + a, first + b, first + c),
                SurfaceTriangle(first + c, first + b, first + a),
            ]
        first += len(corners)
    return TriangleSurfaceMesh(triangles, vertices)
