"""Camera images of vehicles in flight as arrays, for environments that render every tick."""

from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d import proj3d

from drake_quad.geometry.axes import BodyAxes
from drake_quad.reference.plan import Plan
from drake_quad.scenario.layouts import rotors_of
from drake_quad.scenario.models import Scenario
from drake_quad.signals import Reference, State
from drake_quad.visualization.obstacles import draw_solids
from drake_quad.visualization.replay.scene import reference_points

# A frame has 480 by 360 pixels, which is enough for a video of a rollout.
_SIZE = (4.8, 3.6)  # inches
_DPI = 100.0  # pixels per inch
_FONT_SIZE = 8  # points
# A vehicle that is smaller than this fraction of the scene is enlarged to this fraction, so that it remains visible.
_MIN_VEHICLE_FRACTION = 0.05
# Fraction of the frame's width or height that the scene and its labels fill at most.
_MAX_FRAME_FRACTION = 0.97
# Number of tick marks along the longest side of the scene.
_NUM_TICK_MARKS = 6
_CIRCLE = np.linspace(0.0, 2.0 * np.pi, 25)  # rad, angles of the points of a drawn circle
_BODY_STYLE: dict[str, Any] = {"color": "0.1", "linewidth": 2.0, "solid_capstyle": "round"}
_NOSE_STYLE: dict[str, Any] = {"color": "tab:red", "linewidth": 1.6}
_DISC_STYLE: dict[str, Any] = {"color": "tab:blue", "linewidth": 1.6}
_TARGET_STYLE: dict[str, Any] = {"color": "tab:green", "marker": "o", "markersize": 5, "linestyle": "none"}


class Camera:
    """Camera that renders the room in which a plan is flown.

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
        arm_length = float(np.linalg.norm(self._arms[:, :2], axis=1).max())
        corners = [path.min(axis=0) - 3.0 * arm_length, path.max(axis=0) + 3.0 * arm_length]
        space = scenario.flight_space()
        if space is not None and space.obstacles:
            obstacle_corners = draw_solids(axes, space)
            corners = [np.minimum(corners[0], obstacle_corners[0]), np.maximum(corners[1], obstacle_corners[1])]
        low, high = np.array(corners)
        size = np.maximum(high - low, 0.3 * (high - low).max())
        middle = 0.5 * (low + high)
        for axis, name in enumerate("xyz"):
            getattr(axes, f"set_{name}lim")(middle[axis] - 0.5 * size[axis], middle[axis] + 0.5 * size[axis])
            getattr(axes, f"set_{name}label")(f"{name.upper()} (m)", fontsize=_FONT_SIZE, labelpad=1)
            num_marks = max(2, round(_NUM_TICK_MARKS * size[axis] / size.max()))
            getattr(axes, f"{name}axis").set_major_locator(MaxNLocator(num_marks))
        axes.tick_params(labelsize=_FONT_SIZE, pad=-1)
        _fit(axes, size, self._canvas)
        enlargement = max(1.0, _MIN_VEHICLE_FRACTION * size.max() / arm_length)
        self._arms = enlargement * self._arms
        self._radius = 0.45 * enlargement * arm_length
        self._axes = axes
        self._canvas.draw()
        self._background = self._canvas.copy_from_bbox(figure.bbox)
        self._projection = axes.get_proj()

    def frames(self, state: State, reference: Reference) -> tuple[np.ndarray, ...]:
        """Return an image of each of N vehicles, (height, width, 3) uint8, with a green dot at its reference.

        Args:
            state: states of the vehicles; each field is an array (N,).
            reference: references of the vehicles; each field is an array (N,).
        """
        rows = np.array([*state[:6], *reference[:3]]).T
        return tuple([self._frame(row) for row in rows])

    def _frame(self, row: np.ndarray) -> np.ndarray:
        x, y, z, roll, pitch, yaw, *target = row.tolist()
        self._canvas.restore_region(self._background)
        self._draw(np.array([target]), _TARGET_STYLE)
        if np.isfinite([x, y, z, roll, pitch, yaw]).all():
            axes = np.array(BodyAxes.of(roll, pitch, yaw))
            middle = np.array([x, y, z])
            front = 1.6 * self._radius * axes[0]
            for arm in self._arms @ axes:
                self._draw(np.array([middle, middle + arm]), _BODY_STYLE)
                disc = self._radius * (np.outer(np.cos(_CIRCLE), axes[0]) + np.outer(np.sin(_CIRCLE), axes[1]))
                self._draw(middle + arm + disc, _DISC_STYLE)
            self._draw(np.array([middle, middle + front]), _NOSE_STYLE)
        pixels: np.ndarray = np.asarray(self._canvas.buffer_rgba())[..., :3].copy()
        return pixels

    def _draw(self, points: np.ndarray, style: dict[str, Any]) -> None:
        across, up, _ = proj3d.proj_transform(*points.T, self._projection)
        line = Line2D(across, up, transform=self._axes.transData, **style)
        line.draw(self._canvas.get_renderer())


def _fit(axes: Any, size: np.ndarray, canvas: FigureCanvasAgg) -> None:
    """Scale a scene so that the scene and its labels fill the image, and centre the scene."""
    frame, zoom = axes.figure.bbox, 1.0
    # The size of the labels does not change with the zoom, so the fit is repeated until it converges.
    for _ in range(3):
        axes.set_box_aspect(tuple(size), zoom=zoom)
        canvas.draw()
        extent = axes.get_tightbbox()
        zoom *= _MAX_FRAME_FRACTION * min(frame.width / extent.width, frame.height / extent.height)
    across = (frame.x0 + frame.x1 - extent.x0 - extent.x1) / frame.width / 2.0
    up = (frame.y0 + frame.y1 - extent.y0 - extent.y1) / frame.height / 2.0
    axes.set_position((across, up, 1.0, 1.0))
