"""Plot of a planned trajectory: path, speed, acceleration, snap and yaw, and the rotor speeds that it requires."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle
from pydrake.geometry.optimization import HPolyhedron, VPolytope

from drake_quad.planning.feasibility import plan_demand
from drake_quad.reference.feasibility import sample_times
from drake_quad.reference.path_problem import PathLimits
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.reference.regions import Box, Corridor, Polytope, Sphere, WaypointRegion
from drake_quad.space.space import Space
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.visualization.curves import dash_overlapping_curves
from drake_quad.visualization.obstacles import draw_obstacles
from drake_quad.visualization.style import (
    BLUE,
    GREEN,
    LEGEND_ABOVE,
    LIMIT,
    ORANGE,
    ROTOR_COLORS,
    TEXT_BACKGROUND,
    new_figure,
    use_style,
)

# Planes of the three views, each with the indices of its axes in (x, y, z): from above, and from two sides.
_VIEWS = ((0, 1), (0, 2), (1, 2))


def plot_plan(
    plan: Plan,
    parameters: QuadrotorParameters,
    *,
    limits: PathLimits | None = None,
    regions: Sequence[WaypointRegion] = (),
    corridors: Sequence[Corridor | None] = (),
    waypoints: np.ndarray | None = None,
    space: Space | None = None,
) -> Figure:
    """Plot the path in three views, and speed, acceleration, snap, yaw and rotor speeds over time.

    Args:
        plan: plan to draw.
        parameters: parameters of the vehicle, which determine the rotor speeds.
        limits: limits on speed and acceleration; None for no limits.
        regions: regions that the path must pass through.
        corridors: for each segment, the box or polytope in which it must stay; None for a segment without a corridor.
        waypoints: indices of the waypoints to draw and number, (n,); None for all.
        space: space with the obstacles; None for no obstacles.
    """
    times = sample_times(plan.path)
    with use_style():
        figure = new_figure(11.0, 8.5)
        columns = figure.add_gridspec(1, 2, width_ratios=[1.0, 1.25])
        views = columns[0].subgridspec(3, 1, height_ratios=[1.6, 1.0, 1.0])
        for i, view in enumerate(_VIEWS):
            axes = figure.add_subplot(views[i])
            if space is not None:
                draw_obstacles(axes, space, *view, clearance=True)
            drawn_waypoints = plan.waypoints if waypoints is None else plan.waypoints[waypoints]
            _draw_view(axes, view, drawn_waypoints, evaluate(plan.path, times), regions, corridors)
        rows = columns[1].subgridspec(5, 1)
        _draw_profiles([figure.add_subplot(rows[i]) for i in range(5)], plan, parameters, times, limits or PathLimits())
        figure.axes[0].set_title("Path, from above and from two sides")
        figure.align_ylabels(figure.axes[3:])
        return figure


def _draw_view(
    axes: Axes,
    view: tuple[int, int],
    waypoints: np.ndarray,
    position: np.ndarray,
    regions: Sequence[WaypointRegion],
    corridors: Sequence[Corridor | None],
) -> None:
    """Draw the path in a view, with its waypoints (n, 3), which are numbered in the view from above."""
    i, j = view
    low, high = position.min(axis=1), position.max(axis=1)
    margin = 0.25 + 0.1 * float((high - low).max())
    clip_box = Box(low - margin, high + margin)
    # A corridor of several segments is drawn once. Seen from the side, most corridors overlap, so they are not filled.
    opacity = 0.05 if j == 1 else 0.0
    drawn: list[Corridor] = []
    for corridor in corridors:
        if corridor is not None and not any(_same(corridor, other) for other in drawn):
            drawn.append(corridor)
            style: dict[str, object] = {"facecolor": (0.0, 0.0, 0.0, opacity), "edgecolor": "0.7", "linewidth": 0.8}
            axes.add_patch(_patch(corridor, clip_box, i, j, **style))
    for region in regions:
        if isinstance(region, Sphere):
            centre = (region.centre[i], region.centre[j])
            axes.add_patch(Circle(centre, region.radius, facecolor=to_rgba(ORANGE, 0.3), edgecolor=ORANGE))
        elif isinstance(region, Polytope) or not region.is_point:
            axes.add_patch(_patch(region, clip_box, i, j, facecolor=to_rgba(ORANGE, 0.3), edgecolor=ORANGE))
    axes.plot(position[i], position[j], color=BLUE)
    axes.plot(waypoints[:, i], waypoints[:, j], color="black", marker="o", markersize=3, linestyle="none")
    axes.plot(*waypoints[0, [i, j]], color=GREEN, marker="o", markersize=7, linestyle="none")
    if len(waypoints) <= 30 and j == 1:
        for point, numbers in _numbered_points(waypoints[:, [i, j]]):
            label_style: dict[str, Any] = {
                "xytext": (5, 5),
                "textcoords": "offset points",
                "fontsize": 8,
                "color": "0.35",
            }
            axes.annotate(numbers, point, bbox=TEXT_BACKGROUND, **label_style)
    letters = "XYZ"
    axes.set(xlabel=f"{letters[i]} (m)", ylabel=f"{letters[j]} (m)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.08)
    # The path of a hover is a point, so the range of the axes is enlarged.
    axes.update_datalim([waypoints[0, [i, j]] - 0.25, waypoints[0, [i, j]] + 0.25])


def _numbered_points(points: np.ndarray) -> list[tuple[tuple[float, float], str]]:
    """Return points (n, 2) with their numbers. Points that nearly coincide are merged into one with several numbers."""
    labels: list[tuple[np.ndarray, list[int]]] = []
    max_distance = 0.02 * float(np.ptp(points, axis=0).max())
    for number, point in enumerate(points):
        numbers_at_point = next(
            (numbers for other, numbers in labels if np.linalg.norm(point - other) <= max_distance), None
        )
        if numbers_at_point is None:
            labels.append((point, [number]))
        else:
            numbers_at_point.append(number)
    return [((float(x), float(y)), ", ".join(map(str, numbers))) for (x, y), numbers in labels]


def _same(one: Corridor, other: Corridor) -> bool:
    if isinstance(one, Box):
        return isinstance(other, Box) and one.equals(other)
    return isinstance(other, Polytope) and one.equals(other)


def _patch(region: Corridor, drawing: Box, i: int, j: int, **style: object) -> Rectangle | Polygon:
    if isinstance(region, Polytope):
        return Polygon(outline(region, drawing, i, j), **style)  # type: ignore[arg-type]
    size = region.high - region.low
    return Rectangle((region.low[i], region.low[j]), size[i], size[j], **style)  # type: ignore[arg-type]


def outline(region: Polytope, drawing: Box, i: int, j: int) -> np.ndarray:
    """Return the projection of a polytope onto a plane as a convex polygon (corners, 2), anticlockwise, m.

    Args:
        region: polytope with a volume.
        drawing: box to which the polytope is clipped; the result is empty for a polytope outside of the box.
        i: index of the axis that points to the right.
        j: index of the axis that points upwards.
    """
    solid = HPolyhedron(region.normals, region.offsets)
    if not solid.IsBounded():
        solid = solid.Intersection(HPolyhedron.MakeBox(drawing.low, drawing.high))
        if solid.IsEmpty():
            return np.empty((0, 2))
    corners = VPolytope(VPolytope(solid).vertices()[[i, j]]).GetMinimalRepresentation().vertices().T
    x, y = (corners - corners.mean(axis=0)).T
    return np.asarray(corners[np.argsort(np.arctan2(y, x))])


def _draw_profiles(
    profiles: Sequence[Axes], plan: Plan, parameters: QuadrotorParameters, times: np.ndarray, limits: PathLimits
) -> None:
    speed, acceleration, snap, yaw, rotors = profiles
    rows = (
        (speed, 1, "speed (m/s)", limits.speed),
        (acceleration, 2, "acceleration (m/s²)", limits.acceleration),
        (snap, 4, "snap (m/s⁴)", np.inf),
    )
    for axes, order, label, limit in rows:
        values = np.linalg.norm(evaluate(plan.path, times, order), axis=0)
        axes.plot(times, values, color=BLUE)
        top = float(values.max()) if values.max() > 1e-9 else 1.0
        if np.isfinite(limit):
            axes.axhline(limit, **LIMIT)
            top = max(top, limit)
        axes.set(ylabel=label, ylim=(0.0, 1.12 * top))
    yaw.plot(times, np.degrees(evaluate(plan.yaw, times)[0]), color=BLUE)
    yaw.set(ylabel="yaw (°)")
    low, high = yaw.get_ylim()
    if high - low < 20.0:
        yaw.set_ylim(0.5 * (low + high) - 10.0, 0.5 * (low + high) + 10.0)
    demand = plan_demand(plan, parameters, times).rotor_speed
    for (name, speeds), color in zip(demand._asdict().items(), ROTOR_COLORS, strict=True):
        rotors.plot(times, speeds, color=color, label=name.replace("_", " "))
    for limit in (parameters.min_rotor_speed, parameters.max_rotor_speed):
        rotors.axhline(limit, **LIMIT)
    rotors.set(xlabel="time (s)", ylabel="rotor speed (rad/s)", ylim=(0.0, 1.12 * parameters.max_rotor_speed))
    dash_overlapping_curves(rotors)
    rotors.legend(ncols=4, columnspacing=1.0, **LEGEND_ABOVE)
    for axes in profiles:
        axes.set_xlim(times[0], times[-1])
        for time in plan.path.times:
            axes.axvline(time, color="0.85", linewidth=0.7, zorder=0)
    for axes in profiles[:-1]:
        axes.tick_params(labelbottom=False)
    speed.set_title("Dotted lines: limits; vertical lines: times of the waypoints")
