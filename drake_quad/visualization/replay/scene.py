"""Static parts of a scene: room, path of the reference, obstacles, fans and camera."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from pydrake.geometry import Box, Meshcat, MeshcatParams
from pydrake.math import RigidTransform

from drake_quad.process_settings import without_drake_remarks
from drake_quad.reference.plan import Plan
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.winds.source import jets
from drake_quad.visualization.replay.shapes import Frame, draw_fan, draw_solid, rgba
from drake_quad.visualization.style import AXIS_COLORS

# Margin of the room around the paths, relative to the distance from the vehicle's middle to its farthest rotor. The
# margin is 0.7 m for the vehicle of Kayacan and Maslim (2016).
_MARGIN_RATIO = 4.0
# Positions of the vehicle that are farther from the reference than this, m, do not enlarge the room.
_MAX_DISTANCE_FROM_REFERENCE = 3.0
# Width of the line along the reference path, pixels.
_LINE_WIDTH = 2.0
# Approximate number of grid lines along the longer side of the floor.
_NUM_GRID_LINES = 8
# Intensities of the lights of a Meshcat scene.
_LIGHT_INTENSITIES = {
    "AmbientLight": 2.2,
    "FillLight": 0.8,
    "SpotLight": 0.0,
    "PointLightNegativeX": 0.0,
    "PointLightPositiveX": 0.0,
}


class SceneRoom(NamedTuple):
    """Room that is drawn around a flight.

    Attributes:
        low: lower corner, (3,), m.
        high: upper corner, (3,), m.
        spacing: spacing of the grid, m.
        names: position of the name of each obstacle, (3,), m.
    """

    low: np.ndarray
    high: np.ndarray
    spacing: float
    names: Mapping[str, np.ndarray] = MappingProxyType({})

    @property
    def corners(self) -> np.ndarray:
        """Corners of the room, (8, 3), m."""
        return np.array(np.meshgrid(*zip(self.low, self.high, strict=True))).reshape(3, 8).T

    def grid(self, axis: int) -> np.ndarray:
        """Return the coordinates of the grid lines along an axis, m."""
        first, last = np.ceil(self.low[axis] / self.spacing - 1e-9), np.floor(self.high[axis] / self.spacing + 1e-9)
        coordinates: np.ndarray = np.round(self.spacing * np.arange(first, last + 1.0), 6) + 0.0
        return coordinates


def local_meshcat() -> Meshcat:
    """Start a Meshcat server that only this machine can reach, with an empty scene."""
    with without_drake_remarks():  # Drake would log the address, which is irrelevant for a page in a file
        meshcat = Meshcat(MeshcatParams(host="127.0.0.1", show_stats_plot=False))
    for name in ("/Axes", "/Grid"):
        meshcat.SetProperty(name, "visible", False)
    # The colours match the legend only if the light is diffuse.
    for light, intensity in _LIGHT_INTENSITIES.items():
        meshcat.SetProperty(f"/Lights/{light}/<object>", "intensity", intensity)
    for end in ("top", "bottom"):
        meshcat.SetProperty("/Background/<object>", f"{end}_color", [1.0, 1.0, 1.0])
    return meshcat


def draw_surroundings(
    meshcat: Meshcat,
    scenario: Scenario,
    plan: Plan,
    visited_positions: np.ndarray,
    *,
    other_plans: Sequence[Plan] = (),
) -> SceneRoom:
    """Draw floor, grid, room, paths of the references, obstacles and fans, and aim the camera at them.

    Args:
        meshcat: server that shows the scene.
        scenario: scenario of the flight.
        plan: plan of the reference.
        visited_positions: positions of the vehicles, (n, 3), m; empty if they are not known yet.
        other_plans: plans of other references in the same room.

    Returns:
        The room around the flight.
    """
    paths = [reference_points(each) for each in (plan, *other_plans)]
    path = np.vstack(paths)
    margin = _MARGIN_RATIO * Frame.of(scenario.vehicle).max_rotor_distance
    limits = path.min(axis=0) - _MAX_DISTANCE_FROM_REFERENCE, path.max(axis=0) + _MAX_DISTANCE_FROM_REFERENCE
    nearby = np.vstack([path, np.clip(visited_positions, *limits)])
    low, high = nearby.min(axis=0) - margin, nearby.max(axis=0) + margin
    fans = jets(scenario.laboratory.wind)
    outlets = [np.array(jet.outlet) for jet in fans]
    for outlet in outlets:
        low, high = np.minimum(low, outlet), np.maximum(high, outlet)
    space = scenario.flight_space()
    names = {}
    for obstacle in () if space is None else space.obstacles:
        draw_solid(meshcat, f"/obstacles/{obstacle.name}", obstacle.shape)
        # Only the part of an obstacle near the path enlarges the room, since a wall can be much longer than the path.
        extent = np.clip(obstacle.shape.extent(), *limits)
        low, high = np.minimum(low, extent[0]), np.maximum(high, extent[1])
        names[obstacle.name] = np.array([*extent.mean(axis=0)[:2], extent[1, 2]])
    low[2] = 0.0
    room = SceneRoom(low, high, round_spacing(float(np.max(high - low))), names)
    _draw_room(meshcat, room)
    for number, each in enumerate(paths, start=1):
        name = "/reference_path" if number == 1 else f"/reference_path_{number}"
        meshcat.SetLine(name, each.T, _LINE_WIDTH, rgba("0.45"))
    for number, (jet, outlet) in enumerate(zip(fans, outlets, strict=True), start=1):
        length = float(np.max((path - outlet) @ np.asarray(jet.direction))) + margin
        draw_fan(meshcat, f"/fan_{number}", jet, max(length, 1.0))
    look_at(meshcat, room.corners)
    return room


def round_spacing(length: float) -> float:
    """Return the spacing of grid lines, m, along a given length, m: 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length / _NUM_GRID_LINES))
    return float(
        next(power * each for each in (1.0, 2.0, 5.0, 10.0) if power * each >= length / _NUM_GRID_LINES * (1.0 - 1e-9))
    )


def look_at(meshcat: Meshcat, points: np.ndarray) -> None:
    """Aim the camera obliquely from above, so that points (n, 3), m, fill the view."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle, size = 0.5 * (low + high), max(float(np.linalg.norm(high - low)), 1.5)
    target = middle - [0.0, 0.0, 0.1 * size]  # leaves room for the overlay
    meshcat.SetCameraPose(middle + size * np.array([0.54, -0.25, 0.29]), target)


def reference_points(plan: Plan) -> np.ndarray:
    """Return points (n, 3) along the path of the reference, m."""
    start, end = plan.path.times[[0, -1]]
    times = np.linspace(start, end, max(int(20.0 * plan.duration), 2))
    points: np.ndarray = plan.derivative(0).vector_values(times).T
    return points


def has_wind_besides_fans(scenario: Scenario) -> bool:
    """Return whether a scenario has wind from sources other than fans, whose jets the scene shows."""
    return len(jets(scenario.laboratory.wind)) < len(scenario.laboratory.wind)


def _draw_room(meshcat: Meshcat, room: SceneRoom) -> None:
    """Draw floor and grid, the edges of the room, and the axes X, Y and Z along three edges."""
    low, high = room.low, room.high
    size, middle = high - low, 0.5 * (low + high)
    meshcat.SetObject("/floor", Box(size[0], size[1], 0.01), rgba("0.93"))
    meshcat.SetTransform("/floor", RigidTransform([middle[0], middle[1], -0.01]))
    along_y = [([x, low[1], 0.0], [x, high[1], 0.0]) for x in room.grid(0)]
    along_x = [([low[0], y, 0.0], [high[0], y, 0.0]) for y in room.grid(1)]
    _draw_segments(meshcat, "/room/grid", [*along_y, *along_x], "0.6")
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    edges = [(a, b) for a in range(8) for b in range(a, 8) if np.abs(corners[a] - corners[b]).sum() == 1]
    _draw_segments(
        meshcat, "/room/edges", [(low + corners[a] * size, low + corners[b] * size) for a, b in edges], "0.7"
    )
    # The axes lie on edges at the front or at the side of the room, as seen from the camera.
    for axis, start in zip("xyz", ([0, 0, 0], [1, 0, 0], [0, 0, 0]), strict=True):
        begin = low + np.array(start) * size
        end = np.where([axis == each for each in "xyz"], high, begin)
        _draw_segments(meshcat, f"/room/{axis}", [(begin, end)], AXIS_COLORS[axis])


def _draw_segments(meshcat: Meshcat, path: str, segments: Sequence[tuple[Any, Any]], color: str) -> None:
    starts, ends = (np.array([segment[i] for segment in segments], dtype=float).reshape(-1, 3).T for i in (0, 1))
    meshcat.SetLineSegments(path, starts, ends, 1.0, rgba(color))
