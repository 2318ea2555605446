"""Images of vehicles in flight as arrays, for environments that render each tick."""

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import proj3d

from drake_quad.geometry.axes import BodyAxes
from drake_quad.planning.space import space_of
from drake_quad.reference.plan import Plan
from drake_quad.scenario.layouts import rotors_of
from drake_quad.scenario.models import Scenario
from drake_quad.signals import Reference, State
from drake_quad.visualization.obstacles import draw_solids
from drake_quad.visualization.replay.scene import reference_points

# Size in inches, resolution and font size give a frame of 480 by 360 pixels, as in videos of rollouts.
_SIZE, _DPI, _FONT = (4.8, 3.6), 100.0, 8
# A vehicle smaller than this share of the scene is enlarged to remain visible.
_MIN_VEHICLE_SHARE = 0.05
# Share of the frame that the scene fills with its labels.
_FRAME_SHARE = 0.97
# Largest number of tick marks along the longest side.
_MARKS = 6
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 25)
_BODY: dict[str, Any] = {"color": "0.1", "linewidth": 2.0, "solid_capstyle": "round"}
_FRONT: dict[str, Any] = {"color": "tab:red", "linewidth": 1.6}
_DISC: dict[str, Any] = {"color": "tab:blue", "linewidth": 1.6}
_TARGET: dict[str, Any] = {"color": "tab:green", "marker": "o", "markersize": 5, "linestyle": "none"}


class Camera:
    """Camera that shows the room in which a plan is flown.

    Args:
        scenario: scenario with the vehicle and the obstacles.
        plan: plan that is flown.
    """

    def __init__(self, scenario: Scenario, plan: Plan) -> None:
        figure = Figure(figsize=_SIZE, dpi=_DPI)
        self._canvas = FigureCanvasAgg(figure)
        axes: Any = figure.add_axes((0.0, 0.0, 1.0, 1.0), projection="3d")
        path = reference_points(plan)
        axes.plot(*path.T, color="0.6", linewidth=1.0)
        rotors = rotors_of(scenario.nominal)
        self._arms = np.array([[float(rotor.x), float(rotor.y), float(rotor.z)] for rotor in rotors])
        reach = float(np.linalg.norm(self._arms[:, :2], axis=1).max())
        corners = [path.min(axis=0) - 3.0 * reach, path.max(axis=0) + 3.0 * reach]
        space = space_of(scenario)
        if space is not None and space.obstacles:
            around = draw_solids(axes, space)
            corners = [np.minimum(corners[0], around[0]), np.maximum(corners[1], around[1])]
        low, high = np.array(corners)
        size = np.maximum(high - low, 0.3 * (high - low).max())
        middle = 0.5 * (low + high)
        for axis, name in enumerate("xyz"):
            getattr(axes, f"set_{name}lim")(middle[axis] - 0.5 * size[axis], middle[axis] + 0.5 * size[axis])
            getattr(axes, f"set_{name}label")(f"{name.upper()} (m)", fontsize=_FONT, labelpad=1)
            marks = max(2, round(_MARKS * size[axis] / size.max()))
            getattr(axes, f"{name}axis").set_major_locator(MaxNLocator(marks))
        axes.tick_params(labelsize=_FONT, pad=-1)
        _fit(axes, size, self._canvas)
        enlarged = max(1.0, _MIN_VEHICLE_SHARE * size.max() / reach)
        self._arms = enlarged * self._arms
        self._radius = 0.45 * enlarged * reach
        self._axes = axes
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)
        self._projection = axes.get_proj()

    def frames(self, state: State, reference: Reference) -> tuple[np.ndarray, ...]:
        """Return a frame of each of N vehicles, (height, width, 3) uint8, with a green dot at its reference.

        Args:
            state: states of the vehicles, with rows (N,).
            reference: references of the vehicles, with rows (N,).
        """
        rows = np.array([*state[:6], *reference[:3]]).T
        return tuple([self._frame(row) for row in rows])

    def _frame(self, row: np.ndarray) -> np.ndarray:
        x, y, z, roll, pitch, yaw, *target = row.tolist()
        self._canvas.restore_region(self._background)
        self._draw(np.array([target]), _TARGET)
        if np.isfinite([x, y, z, roll, pitch, yaw]).all():
            axes = np.array(BodyAxes.of(roll, pitch, yaw))
            middle = np.array([x, y, z])
            front = 1.6 * self._radius * axes[0]
            for arm in self._arms @ axes:
                self._draw(np.array([middle, middle + arm]), _BODY)
                disc = self._radius * (np.outer(np.cos(_CIRCLE), axes[0]) + np.outer(np.sin(_CIRCLE), axes[1]))
                self._draw(middle + arm + disc, _DISC)
            self._draw(np.array([middle, middle + front]), _FRONT)
        pixels: np.ndarray = np.asarray(self._canvas.buffer_rgba())[..., :3].copy()
        return pixels

    def _draw(self, points: np.ndarray, style: dict[str, Any]) -> None:
        across, up, _ = proj3d.proj_transform(*points.T, self._projection)
        line = Line2D(across, up, transform=self._axes.transData, **style)
        line.draw(self._canvas.get_renderer())


def _fit(axes: Any, size: np.ndarray, canvas: FigureCanvasAgg) -> None:
    """Scale a scene with its labels to fill its frame, and centre it."""
    frame, zoom = axes.figure.bbox, 1.0
    # Labels do not scale with the scene, so the fit is repeated.
    for _ in range(3):
        axes.set_box_aspect(tuple(size), zoom=zoom)
        canvas.draw()
        seen = axes.get_tightbbox()
        zoom *= _FRAME_SHARE * min(frame.width / seen.width, frame.height / seen.height)
    across = (frame.x0 + frame.x1 - seen.x0 - seen.x1) / frame.width / 2.0
    up = (frame.y0 + frame.y1 - seen.y0 - seen.y1) / frame.height / 2.0
    axes.set_position((across, up, 1.0, 1.0))
