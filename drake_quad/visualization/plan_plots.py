"""A plot of a plan: where it goes, how it gets there, and what it asks of the rotors."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from drake_quad.planning import plan_demand
from drake_quad.reference.feasibility import sample_times
from drake_quad.reference.path_problem import Box, Limits, Sphere
from drake_quad.reference.plan import Plan
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.visualization.style import BLUE, GREEN, LIMIT, ORANGE, ROTORS, new_figure, styled

# The horizontal plane and the two vertical ones, by the indices of their axes.
_VIEWS = ((0, 1), (0, 2), (1, 2))


def plot_plan(
    plan: Plan,
    parameters: QuadrotorParameters,
    *,
    limits: Limits | None = None,
    places: Sequence[Box | Sphere] = (),
    corridors: Sequence[Box | None] = (),
) -> Figure:
    """The path from three sides, and speed, acceleration, snap and rotor speeds over time with their limits.

    Args:
        plan: to draw.
        parameters: of the vehicle that is to fly it.
        limits: on speed and acceleration, if it has any.
        places: to pass, if there is more to see of them than the points that the plan passes.
        corridors: (segments) of the path, if it has any.
    """
    times = sample_times(plan.path)
    with styled():
        figure = new_figure(11.0, 7.5)
        grid = figure.add_gridspec(12, 2, width_ratios=[1.0, 1.25])
        for rows, view in zip((slice(0, 6), slice(6, 9), slice(9, 12)), _VIEWS, strict=True):
            axes = figure.add_subplot(grid[rows, 0])
            _draw_view(axes, view, plan, evaluate(plan.path, times), places, corridors)
        profiles = [figure.add_subplot(grid[3 * i : 3 * i + 3, 1]) for i in range(4)]
        _draw_profiles(profiles, plan, parameters, times, limits or Limits())
        figure.axes[0].set_title("Path, from above and from two sides")
        return figure


def _draw_view(
    axes: Axes,
    view: tuple[int, int],
    plan: Plan,
    position: np.ndarray,
    places: Sequence[Box | Sphere],
    corridors: Sequence[Box | None],
) -> None:
    i, j = view
    # The same box for several segments is drawn once.
    drawn: list[Box] = []
    for corridor in corridors:
        if corridor is not None and not any(_same(corridor, box) for box in drawn):
            drawn.append(corridor)
            axes.add_patch(_rectangle(corridor, i, j, facecolor=(0.0, 0.0, 0.0, 0.05), edgecolor="0.7", linewidth=0.8))
    for place in places:
        if isinstance(place, Sphere):
            centre = (place.centre[i], place.centre[j])
            axes.add_patch(Circle(centre, place.radius, facecolor=to_rgba(ORANGE, 0.3), edgecolor=ORANGE))
        elif (place.low < place.high).any():
            axes.add_patch(_rectangle(place, i, j, facecolor=to_rgba(ORANGE, 0.3), edgecolor=ORANGE))
    axes.plot(position[i], position[j], color=BLUE)
    waypoints = plan.waypoints
    axes.plot(waypoints[:, i], waypoints[:, j], color="black", marker="o", markersize=3, linestyle="none")
    axes.plot(*waypoints[0, [i, j]], color=GREEN, marker="o", markersize=7, linestyle="none")
    if len(waypoints) <= 30 and j == 1:
        for number, point in enumerate(waypoints):
            axes.annotate(str(number), point[[i, j]], (4, 4), textcoords="offset points", fontsize=8, color="0.35")
    names = "XYZ"
    axes.set(xlabel=f"{names[i]} (m)", ylabel=f"{names[j]} (m)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.06)


def _same(one: Box, other: Box) -> bool:
    return bool((one.low == other.low).all() and (one.high == other.high).all())


def _rectangle(box: Box, i: int, j: int, **style: object) -> Rectangle:
    size = box.high - box.low
    return Rectangle((box.low[i], box.low[j]), size[i], size[j], **style)  # type: ignore[arg-type]


def _draw_profiles(
    profiles: Sequence[Axes], plan: Plan, parameters: QuadrotorParameters, times: np.ndarray, limits: Limits
) -> None:
    speed, acceleration, snap, rotors = profiles
    rows = (
        (speed, 1, "speed (m/s)", limits.speed),
        (acceleration, 2, "acceleration (m/s²)", limits.acceleration),
        (snap, 4, "snap (m/s⁴)", np.inf),
    )
    for axes, order, label, limit in rows:
        values = np.linalg.norm(evaluate(plan.path, times, order), axis=0)
        axes.plot(times, values, color=BLUE)
        top = max(float(values.max()), 1e-9)
        if np.isfinite(limit):
            axes.axhline(limit, **LIMIT)
            top = max(top, limit)
        axes.set(ylabel=label, ylim=(0.0, 1.12 * top))
    demand = plan_demand(plan, parameters, times).rotor_speed
    for i, color in enumerate(ROTORS):
        rotors.plot(times, demand[i], color=color, linewidth=1.1, label=f"rotor {i + 1}")
    for limit in (parameters.min_rotor_speed, parameters.max_rotor_speed):
        rotors.axhline(limit, **LIMIT)
    rotors.set(xlabel="time (s)", ylabel="rotor speed (rad/s)", ylim=(0.0, 1.12 * parameters.max_rotor_speed))
    rotors.legend(ncols=4, loc="lower right", handlelength=1.2, columnspacing=1.0)
    for axes in profiles:
        axes.set_xlim(times[0], times[-1])
        for time in plan.path.times:
            axes.axvline(time, color="0.85", linewidth=0.7, zorder=0)
    for axes in profiles[:-1]:
        axes.tick_params(labelbottom=False)
    speed.set_title("Limits dotted; vertical lines where waypoints are passed")
