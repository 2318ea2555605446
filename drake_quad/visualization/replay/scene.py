"""What stands still in a scene: the room, the path of the reference, fans and the camera."""

import logging

import numpy as np
from pydrake.geometry import Box, Meshcat, MeshcatParams
from pydrake.math import RigidTransform

from drake_quad.assembly.laboratory import jets
from drake_quad.reference.plan import Plan
from drake_quad.scenario import Scenario
from drake_quad.scenario.wind import Fan
from drake_quad.visualization.replay.shapes import draw_fan, rgba

# Room around what is flown, m.
_ROOM = 0.7
# Distance from the reference beyond which a vehicle leaves the room, m.
_FAR = 3.0
_LINE = 2.0
_LIGHTS = {
    "AmbientLight": 2.2,
    "FillLight": 0.8,
    "SpotLight": 0.0,
    "PointLightNegativeX": 0.0,
    "PointLightPositiveX": 0.0,
}


def local_meshcat() -> Meshcat:
    """Starts a Meshcat server that only this machine can reach, with an empty scene."""
    log = logging.getLogger("drake")
    level = log.level
    log.setLevel(logging.WARNING)  # a page that is only written needs no address
    meshcat = Meshcat(MeshcatParams(host="127.0.0.1", show_stats_plot=False))
    log.setLevel(level)
    for name in ("/Axes", "/Grid"):
        meshcat.SetProperty(name, "visible", False)
    # Light from everywhere, so that colours look like those of the legend.
    for light, intensity in _LIGHTS.items():
        meshcat.SetProperty(f"/Lights/{light}/<object>", "intensity", intensity)
    for end in ("top", "bottom"):
        meshcat.SetProperty("/Background/<object>", f"{end}_color", [1.0, 1.0, 1.0])
    return meshcat


def draw_surroundings(meshcat: Meshcat, scenario: Scenario, plan: Plan, flown: np.ndarray) -> None:
    """Draws floor, room, path of the reference and fans, and turns the camera to them.

    Args:
        meshcat: in which they are drawn.
        scenario: that is flown.
        plan: of the reference.
        flown: (n, 3) positions of vehicles, m.
    """
    path = reference_points(plan)
    near = np.vstack([path, np.clip(flown, path.min(axis=0) - _FAR, path.max(axis=0) + _FAR)])
    low, high = near.min(axis=0) - _ROOM, near.max(axis=0) + _ROOM
    fans = jets(scenario.laboratory.wind)
    outlets = [np.array(jet.outlet) for jet in fans]
    for outlet in outlets:
        low, high = np.minimum(low, outlet), np.maximum(high, outlet)
    low[2] = 0.0
    _draw_room(meshcat, low, high)
    if len(path) > 1:
        meshcat.SetLine("/reference_path", path.T, _LINE, rgba("0.45"))
    for number, (jet, outlet) in enumerate(zip(fans, outlets, strict=True), start=1):
        reach = float(np.max((path - outlet) @ np.asarray(jet.direction))) + _ROOM
        draw_fan(meshcat, f"/fan_{number}", jet, max(reach, 1.0))
    # Most of the way to the fans, so that they are in the picture without being its subject.
    look_at(meshcat, np.vstack([near, *(0.15 * near.mean(axis=0) + 0.85 * outlet for outlet in outlets)]))


def look_at(meshcat: Meshcat, path: np.ndarray) -> None:
    """Turns the camera so that (n, 3) points fill the view, seen from above and from the side."""
    low, high = path.min(axis=0), path.max(axis=0)
    middle, size = 0.5 * (low + high), max(float(np.linalg.norm(high - low)), 1.5)
    below = middle - [0.0, 0.0, 0.1 * size]  # leaves room for the overlay
    meshcat.SetCameraPose(middle + size * np.array([0.54, -0.25, 0.29]), below)


def reference_points(plan: Plan) -> np.ndarray:
    """(n, 3) points along the path of the reference, m."""
    times = np.linspace(0.0, plan.duration, max(int(20.0 * plan.duration), 2))
    points: np.ndarray = plan.derivative(0).vector_values(times).T
    return points


def wind_blows_elsewhere(scenario: Scenario) -> bool:
    """Is there wind in a scenario that does not come from fans, which are drawn?"""
    return any(not isinstance(source, Fan) for source in scenario.laboratory.wind)


def _draw_room(meshcat: Meshcat, low: np.ndarray, high: np.ndarray) -> None:
    size, middle = high - low, 0.5 * (low + high)
    meshcat.SetObject("/floor", Box(size[0], size[1], 0.01), rgba("0.85"))
    meshcat.SetTransform("/floor", RigidTransform([middle[0], middle[1], -0.01]))
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    edges = [(a, b) for a in range(8) for b in range(a, 8) if np.abs(corners[a] - corners[b]).sum() == 1]
    starts, ends = (low + corners[[edge[i] for edge in edges]] * size for i in (0, 1))
    meshcat.SetLineSegments("/room", starts.T, ends.T, 1.0, rgba("0.7"))
