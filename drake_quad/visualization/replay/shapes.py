"""Shapes in a scene: quadrotors, obstacles, fans, trails and arrows."""

import functools
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_rgb
from pydrake.geometry import Box, Cylinder, Meshcat, Rgba, Sphere
from pydrake.math import RigidTransform, RollPitchYaw, RotationMatrix

from drake_quad.laboratory.wind.fans import SPREAD, Jet
from drake_quad.scenario.layouts import rotors_of
from drake_quad.signals import RotorSpeed, State, Wind
from drake_quad.space.shapes import Shape
from drake_quad.vehicle.rotors import Rotors
from drake_quad.visualization.positions import positions
from drake_quad.visualization.style import BLUE, ORANGE, SKY, VERMILION

# Smallest distance from the middle of a vehicle to its rotors, m, for which motors and arms are drawn at full size. The
# value is that of the vehicle of Kayacan and Maslim (2016). The parts of smaller vehicles are scaled down.
_FULL_SIZE_ROTOR_DISTANCE = 0.17
# Radius of an 8-inch propeller, m, as on the vehicle of Kayacan and Maslim (2016). Smaller propellers are drawn if
# rotors are close to each other.
_MAX_PROPELLER_RADIUS = 0.1
_ARM_SECTION = (0.022, 0.014)  # m, width and height
_BLADE_SECTION = (0.018, 0.004)  # m, width and height
# Height of the rotors above the centre line of the arms, m.
_ROTOR_HEIGHT = 0.035
_FAN_DEPTH = 0.25  # m, length of the housing of a fan
# Speed of the drawn rotors relative to the real rotors, which turn at 200 rad/s, too fast for 30 frames per second.
_ROTATION_FACTOR = 0.1
# Length of a wind arrow per wind speed, m per m/s.
_ARROW_LENGTH_PER_SPEED = 0.15
# Flight time along one piece of a trail, s.
TRAIL_PIECE_DURATION = 0.25
_TRAIL_RADIUS = 0.018  # m
ERROR_COLORS = colormaps["viridis"]
# The arm of a rotor has the colour of the front if the rotor is at least this far in front of the centre, relative to
# the foremost rotor.
_MIN_FRONT_FRACTION = 0.5
# Largest radius of a propeller, relative to the smallest distance between two rotors. Propellers touch at 0.5.
_MAX_RADIUS_RATIO = 0.48


class Frame(NamedTuple):
    """Airframe of a quadrotor for drawing.

    Attributes:
        rotors: rotors 1 to 4.
        roots: point in B, (3,), m, at which the arm of each rotor begins: the centre, or an end of the crossbar of an H
            frame.
    """

    rotors: Rotors
    roots: tuple[np.ndarray, ...]

    @classmethod
    def of(cls, vehicle: Any) -> "Frame":
        """Return the airframe of a vehicle: two side bars and a crossbar for an H frame, else four arms."""
        rotors = rotors_of(vehicle)
        sides = [rotor.y if vehicle.layout.has_side_bars else 0.0 for rotor in rotors]
        return cls(rotors, tuple(np.array([0.0, side, 0.0]) for side in sides))

    @property
    def max_rotor_distance(self) -> float:
        """Horizontal distance of the farthest rotor from the middle, m."""
        return max(float(np.hypot(rotor.x, rotor.y)) for rotor in self.rotors)

    @property
    def crossbars(self) -> list[np.ndarray]:
        """Ends of the crossbar of an H frame, each (3,), m; empty for other layouts."""
        return [np.array(end) for end in dict.fromkeys(map(tuple, self.roots)) if any(end)]


def rgba(color: str, opacity: float = 1.0) -> Rgba:
    """Convert a Matplotlib colour to a Drake colour."""
    return Rgba(*to_rgb(color), opacity)


def rotor_poses(rotors: Rotors, angles: np.ndarray) -> list[RigidTransform]:
    """Return the poses of rotors 1 to 4 in B, rotated by angles (4,), rad."""
    return [
        RigidTransform(RotationMatrix.MakeZRotation(angle), position)
        for position, angle in zip(_rotor_positions(rotors), angles, strict=True)
    ]


def rotation_angles(rotors: Rotors, rotor_speed: RotorSpeed, time: float) -> np.ndarray:
    """Return the angles (4,), rad, by which the drawn rotors turn during a time, s."""
    return _ROTATION_FACTOR * time * np.array(rotor_speed) * [rotor.direction for rotor in rotors]


def wind_arrow(wind: Wind, state: State) -> tuple[RigidTransform, list[float]]:
    """Return the pose and the scale of the arrow that shows the wind above a vehicle."""
    speed = float(np.linalg.norm(wind))
    rotation = RotationMatrix.MakeFromOneVector(np.array(wind), 0) if speed > 1e-6 else RotationMatrix()
    length = max(_ARROW_LENGTH_PER_SPEED * speed, 1e-3)
    return RigidTransform(rotation, positions(state) + np.array([0.0, 0.0, 0.3])), [
        length,
        min(length, 1.0),
        min(length, 1.0),
    ]


def draw_trail_piece(meshcat: Meshcat, path: str, points: np.ndarray, shades: str | np.ndarray, size: float) -> None:
    """Draw a piece of a trail.

    Args:
        meshcat: server that shows the scene.
        path: path of the piece in the scene.
        points: points along the piece, (n, 3), m.
        shades: colour of the piece, or position errors (n,) relative to the error at the upper end of the colour map.
        size: scale of the vehicle, from `part_scale`.
    """
    vertices, faces = tube(points, size * _TRAIL_RADIUS)
    if isinstance(shades, str):
        meshcat.SetTriangleMesh(path, vertices, faces, rgba(shades, 0.7))
    else:
        meshcat.SetTriangleColorMesh(path, vertices, faces, np.repeat(ERROR_COLORS(shades)[:, :3], 3, axis=0).T)


def part_scale(rotors: Rotors) -> float:
    """Return the scale at which motors, arms and trail of a vehicle are drawn, at most 1."""
    return min(max(float(np.hypot(rotor.x, rotor.y)) for rotor in rotors) / _FULL_SIZE_ROTOR_DISTANCE, 1.0)


@functools.cache
def _rotor_positions(rotors: Rotors) -> tuple[np.ndarray, ...]:
    """Return the positions at which rotors 1 to 4 are drawn in B, m."""
    height = part_scale(rotors) * _ROTOR_HEIGHT
    return tuple([np.array([rotor.x, rotor.y, rotor.z + height]) for rotor in rotors])


def _propeller_radius(rotors: Rotors) -> float:
    """Return the radius with which the propellers are drawn, m."""
    pairs = combinations(_rotor_positions(rotors), 2)
    return min(_MAX_PROPELLER_RADIUS, _MAX_RADIUS_RATIO * min(float(np.linalg.norm(a - b)) for a, b in pairs))


def draw_quadrotor(meshcat: Meshcat, path: str, frame: Frame, color: str) -> None:
    """Draw a quadrotor at a path of the scene, with its rotors at `path`/rotor_1 to `path`/rotor_4.

    The front is orange. Blades that turn clockwise are blue, and the others are light blue.
    """
    rotors, middle, size = frame.rotors, np.zeros(3), part_scale(frame.rotors)
    height = size * _ROTOR_HEIGHT
    radius, foremost = _propeller_radius(rotors), max(rotor.x for rotor in rotors)
    meshcat.SetObject(f"{path}/hub", Cylinder(0.45 * radius, size * 0.04), rgba(color))
    for number, end in enumerate(frame.crossbars, start=1):
        _draw_arm(meshcat, f"{path}/crossbar_{number}", middle, end, color, size)
    for number, (rotor, position) in enumerate(zip(rotors, _rotor_positions(rotors), strict=True), start=1):
        foot = position - [0.0, 0.0, height]
        in_front = rotor.x > 0.0 and rotor.x >= _MIN_FRONT_FRACTION * foremost
        _draw_arm(meshcat, f"{path}/arm_{number}", frame.roots[number - 1], foot, ORANGE if in_front else color, size)
        if in_front:
            meshcat.SetObject(f"{path}/nose_{number}", Sphere(size * 0.022), rgba(ORANGE))
            meshcat.SetTransform(f"{path}/nose_{number}", RigidTransform(foot))
        shade = BLUE if rotor.direction < 0.0 else SKY
        meshcat.SetObject(f"{path}/motor_{number}", Cylinder(size * 0.014, height), rgba("0.25"))
        meshcat.SetTransform(f"{path}/motor_{number}", RigidTransform(position - [0.0, 0.0, 0.5 * height]))
        meshcat.SetObject(f"{path}/disc_{number}", Cylinder(radius, size * 0.002), rgba(shade, 0.2))
        meshcat.SetTransform(f"{path}/disc_{number}", RigidTransform(position))
        meshcat.SetObject(
            f"{path}/rotor_{number}/blades", Box(2.0 * radius, *(size * each for each in _BLADE_SECTION)), rgba(shade)
        )
        meshcat.SetTransform(f"{path}/rotor_{number}", RigidTransform(position))


def _draw_arm(meshcat: Meshcat, path: str, start: np.ndarray, end: np.ndarray, color: str, size: float) -> None:
    """Draw an arm between two points in B, unless the points coincide."""
    difference = end - start
    length = float(np.linalg.norm(difference))
    if length > 0.0:
        meshcat.SetObject(path, Box(length, *(size * each for each in _ARM_SECTION)), rgba(color))
        rotation = RotationMatrix.MakeFromOneVector(difference, 0)
        meshcat.SetTransform(path, RigidTransform(rotation, 0.5 * (start + end)))


def quadrotor_mesh(frame: Frame) -> tuple[np.ndarray, np.ndarray]:
    """Return a quadrotor as a mesh of few triangles, for scenes with hundreds of vehicles.

    Returns:
        The vertices (3, n), m, and the triangles (3, m).
    """
    rotors, middle = frame.rotors, np.zeros(3)
    feet = [np.array([rotor.x, rotor.y, rotor.z]) for rotor in rotors]
    bars = [*((middle, end) for end in frame.crossbars), *zip(frame.roots, feet, strict=True)]
    parts = [_bar(start, end, 0.009 * part_scale(rotors)) for start, end in bars if np.hypot(*(end - start)[:2]) > 0.0]
    angles = np.linspace(0.0, 2.0 * np.pi, 10, endpoint=False)
    rim_points = _propeller_radius(rotors) * np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    fan = [(0, i + 1, (i + 1) % len(rim_points) + 1) for i in range(len(rim_points))]
    parts += [(position + np.vstack([np.zeros(3), rim_points]), fan) for position in _rotor_positions(rotors)]
    offsets = np.cumsum([0, *(len(corners) for corners, _ in parts)])
    triangles = [offset + np.array(faces) for offset, (_, faces) in zip(offsets, parts, strict=False)]
    return np.vstack([corners for corners, _ in parts]).T, np.vstack(triangles).T


def draw_fan(meshcat: Meshcat, path: str, jet: Jet, length: float) -> None:
    """Draw a fan and its jet. The jet is drawn up to the radius at which the wind speed is half of its maximum.

    Args:
        meshcat: server that shows the scene.
        path: path of the fan in the scene.
        jet: jet of the fan.
        length: length of the drawn jet, m.
    """
    meshcat.SetTransform(
        path, RigidTransform(RotationMatrix.MakeFromOneVector(np.array(jet.direction), 2), np.array(jet.outlet))
    )
    meshcat.SetObject(f"{path}/housing", Cylinder(0.5 * jet.diameter, _FAN_DEPTH), rgba("0.35"))
    meshcat.SetTransform(f"{path}/housing", RigidTransform([0.0, 0.0, -0.5 * _FAN_DEPTH]))
    lengths = np.linspace(0.0, length, 9)
    x, y, z = _surface_of_revolution(lengths, np.maximum(0.5 * jet.diameter, SPREAD * lengths))
    meshcat.PlotSurface(f"{path}/jet", x, y, z, rgba(SKY, 0.13))
    # If the jet wrote to the depth buffer, it would hide trails inside and behind it that are drawn later.
    meshcat.SetProperty(f"{path}/jet/<object>", "material.depthWrite", False)


def draw_solid(meshcat: Meshcat, path: str, shape: Shape) -> None:
    """Draw an obstacle in Meshcat."""
    corners = shape.triangles().reshape(-1, 3)
    meshcat.SetTriangleMesh(path, corners.T, np.arange(len(corners)).reshape(-1, 3).T, rgba("0.6"))


def draw_arrow(meshcat: Meshcat, path: str) -> None:
    """Draw an arrow of 1 m along x, which an animation can scale and rotate."""
    y, z, x = _surface_of_revolution(np.array([0.0, 0.78, 0.78, 1.0]), np.array([0.012, 0.012, 0.045, 0.0]))
    meshcat.PlotSurface(path, x, y, z, rgba(VERMILION))


def tube(points: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices (3, 3 n) and triangles (3, m) of a tube with a triangular section along points (n, 3)."""
    forward = np.gradient(points, axis=0) + 1e-12
    forward /= np.linalg.norm(forward, axis=1, keepdims=True)
    sideways = np.cross(forward, np.where(np.abs(forward[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]]))
    sideways /= np.linalg.norm(sideways, axis=1, keepdims=True)
    up = np.cross(sideways, forward)
    corners = [np.cos(angle) * sideways + np.sin(angle) * up for angle in np.pi * np.array([0.5, 7 / 6, 11 / 6])]
    vertices = (points[:, None] + radius * np.stack(corners, axis=1)).reshape(-1, 3)
    faces = []
    for i in range(len(points) - 1):
        for k in range(3):
            a, b = 3 * i + k, 3 * i + (k + 1) % 3
            faces += [(a, b, a + 3), (b, b + 3, a + 3)]
    return vertices.T, np.array(faces).T


def vehicle_pose(state: State) -> RigidTransform:
    """Return the pose of a vehicle in W."""
    return RigidTransform(RollPitchYaw(state.roll, state.pitch, state.yaw), positions(state))


def _bar(start: np.ndarray, end: np.ndarray, half_width: float) -> tuple[np.ndarray, list[tuple[int, int, int]]]:
    """Return the vertices and triangles of a flat bar between two points."""
    sideways = half_width * np.cross((end - start) / np.linalg.norm(end - start), [0.0, 0.0, 1.0])
    lift = np.array([0.0, 0.0, half_width])
    corners = np.array([base + a + b for base in (start, end) for a in (-sideways, sideways) for b in (-lift, lift)])
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


def _surface_of_revolution(lengths: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the coordinates x, y and z of a surface of revolution around the z axis, with a radius at each height."""
    angles = np.linspace(0.0, 2.0 * np.pi, 25)
    x, y = (np.outer(radii, turned(angles)) for turned in (np.cos, np.sin))
    return x, y, np.outer(lengths, np.ones_like(angles))
