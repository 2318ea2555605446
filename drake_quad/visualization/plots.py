"""Plots of one flight: path, position error, attitude and rotor speeds."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from drake_quad.files import output_folder
from drake_quad.flight.flight import Flight
from drake_quad.signals import Attitude
from drake_quad.visualization.curves import dash_overlapping_curves
from drake_quad.visualization.estimate_plots import plot_flown_estimate
from drake_quad.visualization.learning_plots import (
    plot_learning,
    plot_network_memberships,
    plot_secant_gains,
    plot_surfaces,
)
from drake_quad.visualization.leg_marks import leg_legend, number_legs, shade_legs
from drake_quad.visualization.obstacles import draw_obstacles, draw_solids
from drake_quad.visualization.panels import new_panels
from drake_quad.visualization.positions import positions
from drake_quad.visualization.style import (
    AXIS_COLORS,
    BLUE,
    LEGEND_ABOVE,
    LIMIT,
    REFERENCE,
    ROTOR_COLORS,
    VERMILION,
    Vector,
    new_figure,
    save_figures,
    use_style,
)
from drake_quad.visualization.wind_plots import plot_wind

# Coordinates of a label at a horizontal line: a fraction of the axis, and a value in data units.
_ANNOTATION: Any = {"xycoords": ("axes fraction", "data"), "textcoords": "offset points"}
# Smallest side of the three-dimensional view, relative to its longest side.
_MIN_SIDE_RATIO = 0.35
# Smallest side of a view of the path, m.
_MIN_SIDE = 0.5


def plot_path(flight: Flight) -> Figure:
    """Plot the flown path and the reference in three dimensions and from above."""
    actual, reference = positions(flight.record("state")).T, positions(flight.record("reference")).T
    with use_style():
        figure = new_figure(9.5, 4.8)
        space = figure.add_subplot(1, 2, 1, projection="3d")
        space.plot(*actual, color=BLUE)
        space.plot(*reference, **REFERENCE)
        space.scatter(*actual[:, :1], color=BLUE, marker="o", s=18)
        space.set(xlabel="X (m)", ylabel="Y (m)", zlabel="Z (m)", title="Path")
        space.yaxis.labelpad = 12.0
        points = np.hstack([actual, reference])
        points = points[:, np.isfinite(points).all(axis=0)]  # the state of a vehicle that has diverged is not finite
        flight_space = flight.scenario.flight_space()
        if flight_space is not None and flight_space.obstacles:
            points = np.hstack([points, draw_solids(space, flight_space).T])
        low, high = points.min(axis=1), points.max(axis=1)
        # The path of a hover is a point, and a flat view has no space for the numbers on its axes.
        extent = np.maximum(high - low, max(_MIN_SIDE_RATIO * float(np.max(high - low)), _MIN_SIDE))
        middle = 0.5 * (low + high)
        space.set(
            **{f"{axis}lim": (m - 0.5 * e, m + 0.5 * e) for axis, m, e in zip("xyz", middle, extent, strict=True)}
        )
        space.set_box_aspect(extent, zoom=0.8)
        for axis in (space.xaxis, space.yaxis, space.zaxis):
            axis.set_major_locator(MaxNLocator(3))
        figure.get_layout_engine().set(w_pad=0.2)  # type: ignore[union-attr,call-arg]
        plane = figure.add_subplot(1, 2, 2)
        draw_from_above(plane, flight)
        handles, _ = plane.get_legend_handles_labels()
        plane.legend(handles=[*handles, *leg_legend(flight.plan)], loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return figure


def draw_from_above(axes: Axes, flight: Flight) -> None:
    """Draw the flown path and the reference in the X-Y plane, with the numbers of the route's legs."""
    state, reference = flight.record("state"), flight.record("reference")
    flight_space = flight.scenario.flight_space()
    if flight_space is not None:
        draw_obstacles(axes, flight_space, 0, 1)
    axes.plot(state.x, state.y, color=BLUE, label="flown")
    axes.plot(reference.x, reference.y, label="reference", **REFERENCE)
    axes.plot(state.x[:1], state.y[:1], color=BLUE, marker="o", markersize=4, linestyle="none", label="start")
    number_legs(axes, flight.plan)
    if flight.metrics.crashed:
        crash: dict[str, Any] = {"color": VERMILION, "marker": "x", "markersize": 9, "markeredgewidth": 2}
        axes.plot(state.x[-1:], state.y[-1:], linestyle="none", label=flight.crash, **crash)
    axes.set(xlabel="X (m)", ylabel="Y (m)", title="From above")
    axes.margins(0.1)
    # The path of a hover is a point, so the range of the axes is enlarged.
    for end in (-0.5 * _MIN_SIDE, 0.5 * _MIN_SIDE):
        axes.update_datalim([(float(state.x[0]) + end, float(state.y[0]) + end)])
    axes.set_aspect("equal", adjustable="datalim")


def plot_errors(flight: Flight) -> Figure:
    """Plot the position error over time: its component on each axis, and its Euclidean norm."""
    state, reference = flight.record("state"), flight.record("reference")
    with new_panels(8.0, 4.8, 2, 1, sharex=True) as (figure, ((upper,), (lower,))):
        for axis, color in AXIS_COLORS.items():
            error = 100.0 * (getattr(reference, axis) - getattr(state, axis))
            upper.plot(flight.time, error, color=color, label=axis.upper())
        upper.set_ylabel("error (cm)")
        dash_overlapping_curves(upper)
        figure.suptitle("Position error, reference minus flown", x=0.01, ha="left", fontsize=10)
        figure.legend(*upper.get_legend_handles_labels(), loc="outside upper right", ncols=3)
        shade_legs(upper, flight.plan, float(flight.time[-1]))
        draw_error(lower, flight)
        return figure


def draw_error(axes: Axes, flight: Flight) -> None:
    """Draw the Euclidean position error over time, with a line at the RMSE."""
    axes.plot(flight.time, 100.0 * flight.euclidean_error, color="black")
    if np.isfinite(flight.metrics.rmse):
        rmse = 100.0 * flight.metrics.rmse
        axes.axhline(rmse, **LIMIT)
        coordinates = ("axes fraction", "data")
        axes.annotate(f"RMSE\n{rmse:.2f} cm", (1.01, rmse), xycoords=coordinates, va="center", annotation_clip=False)
    axes.set(xlabel="time (s)", ylabel="Euclidean error (cm)", ylim=(0.0, None))
    shade_legs(axes, flight.plan, float(flight.time[-1]))


def plot_attitude(flight: Flight) -> Figure:
    """Plot roll, pitch and yaw over time, with the commanded attitude if the controller commands one."""
    actual = flight.record("state")
    command = flight.record("attitude_command") if "attitude_command" in flight.signals else None
    with new_panels(8.0, 5.6, 3, 1, sharex=True) as (figure, grid):
        for (axes,), angle in zip(grid, Attitude._fields, strict=True):
            if command is not None:
                commanded = np.degrees(getattr(command, angle))
                axes.plot(flight.time, commanded, color=VERMILION, linewidth=1.0, label="commanded")
            axes.plot(flight.time, np.degrees(getattr(actual, angle)), color=BLUE, label="flown")
            dash_overlapping_curves(axes)
            axes.set(ylabel=f"{angle} (°)")
            low, high = axes.get_ylim()
            if high - low < 2.0:
                middle = 0.5 * (low + high)
                axes.set_ylim(middle - 1.0, middle + 1.0)
        figure.axes[0].set_title("Attitude", loc="left")
        figure.axes[0].legend(ncols=2, **LEGEND_ABOVE)
        figure.axes[-1].set_xlabel("time (s)")
        return figure


def plot_rotors(flight: Flight) -> Figure:
    """Plot the speed of each rotor over time in its own panel, and all speeds together with the limits of the rotors.

    The panels have the same axes. A black line shows the mean speed of the rotors.
    """
    limits = flight.scenario.vehicle.min_rotor_speed, flight.scenario.vehicle.max_rotor_speed
    speeds = flight.record("rotor_speed")
    with use_style():
        figure = new_figure(9.0, 6.0)
        grid = figure.add_gridspec(len(ROTOR_COLORS), 2, width_ratios=[3.2, 1.0])
        first = figure.add_subplot(grid[0, 0])
        panels = [
            first,
            *(figure.add_subplot(grid[i, 0], sharex=first, sharey=first) for i in range(1, len(ROTOR_COLORS))),
        ]
        for axes, (name, speed), color in zip(panels, speeds._asdict().items(), ROTOR_COLORS, strict=True):
            axes.plot(flight.time, speed, color=color, linewidth=1.0)
            axes.plot(flight.time, np.mean(speeds, axis=0), color="0.15", linewidth=0.8)
            axes.set_ylabel(f"{name.replace('_', ' ')} (rad/s)")
            axes.tick_params(labelbottom=axes is panels[-1])
        low, high = first.get_ylim()
        whole = figure.add_subplot(grid[:, 1])
        draw_rotor_speeds(whole, flight)
        for limit in limits:
            whole.axhline(limit, **LIMIT)
            for axes in panels:
                axes.axhline(limit, **LIMIT)
        first.set_ylim(low, high)
        first.set_title("Rotor speeds; black: mean of all rotors", loc="left")
        panels[-1].set_xlabel("time (s)")
        whole.set(title="With the limits", ylim=(0.0, 1.08 * limits[1]))
        for limit, name in zip(limits, ("min", "max"), strict=True):
            whole.annotate(f"{name} {limit:g}", (0.02, limit), (0, 2), **_ANNOTATION, va="bottom", fontsize=8.5)
        return figure


def draw_rotor_speeds(axes: Axes, flight: Flight) -> None:
    """Draw the speeds of the rotors over time."""
    speeds = flight.record("rotor_speed")._asdict()
    for (name, speed), color in zip(speeds.items(), ROTOR_COLORS, strict=True):
        axes.plot(flight.time, speed, color=color, label=name.replace("_", " "))
    axes.set(xlabel="time (s)", ylabel="rotor speed (rad/s)")
    dash_overlapping_curves(axes)


PLOTS: dict[str, Callable[[Flight], Figure]] = {
    "path": plot_path,
    "errors": plot_errors,
    "attitude": plot_attitude,
    "rotors": plot_rotors,
}


def save_plots(flight: Flight, folder: Path | str, *, vector: Vector | None = None) -> list[Path]:
    """Write all plots of a flight into a folder, and return the paths of the files.

    A plot of the wind is written if there is wind, a plot of the estimate if there is a state estimator, and plots of
    the learning if there is a network. The surfaces and the secant gains of a network are plotted if its inputs are
    error and error rate.

    Args:
        flight: flight to plot.
        folder: folder for the PNG files.
        vector: format of additional vector graphics; None for no vector graphics.

    Raises:
        InputError: if the folder cannot be written to.
    """
    target = output_folder(Path(folder))
    plots = dict(PLOTS)
    if flight.scenario.laboratory.wind or flight["wind"].any():
        plots["wind"] = plot_wind
    if flight.scenario.laboratory.estimator.integrates_sensors:
        plots["estimate"] = plot_flown_estimate
    network = flight.scenario.control.network
    if network is not None and "weights" in flight.signals:
        plots |= {"memberships": plot_network_memberships, "learning": plot_learning}
        if [*network.inputs.specified] == ["error", "error_rate"]:
            plots |= {"surfaces": plot_surfaces, "secant_gains": plot_secant_gains}
    return save_figures({name: plot(flight) for name, plot in plots.items()}, target, vector=vector)
