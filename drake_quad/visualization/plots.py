"""Plots of one flight: path, errors, attitude and rotors."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from drake_quad.files import output_folder
from drake_quad.flight import Flight
from drake_quad.signals import Attitude
from drake_quad.visualization.learning_plots import (
    plot_learning,
    plot_own_memberships,
    plot_secant_gains,
    plot_surfaces,
)
from drake_quad.visualization.leg_marks import leg_names, number_legs, shade_legs
from drake_quad.visualization.places import places
from drake_quad.visualization.style import (
    AXES,
    BLUE,
    LIMIT,
    REFERENCE,
    ROTORS,
    VERMILION,
    Vector,
    new_figure,
    save_figures,
    styled,
)
from drake_quad.visualization.wind_plots import plot_wind


def plot_path(flight: Flight) -> Figure:
    """Plots the flown path and the reference, in space and seen from above."""
    flown, wanted = places(flight.record("state")).T, places(flight.record("reference")).T
    with styled():
        figure = new_figure(9.5, 4.8)
        space = figure.add_subplot(1, 2, 1, projection="3d")
        space.plot(*flown, color=BLUE)
        space.plot(*wanted, **REFERENCE)
        space.scatter(*flown[:, :1], color=BLUE, marker="o", s=18)
        space.set(xlabel="X (m)", ylabel="Y (m)", zlabel="Z (m)", title="Path")
        space.yaxis.labelpad = 12.0
        # A hover has no extent; half a metre is shown then.
        extent = np.maximum(np.ptp(np.hstack([flown, wanted]), axis=1), 0.5)
        space.set_box_aspect(extent, zoom=0.85)
        for axis in (space.xaxis, space.yaxis, space.zaxis):
            axis.set_major_locator(MaxNLocator(3))
        plane = figure.add_subplot(1, 2, 2)
        draw_from_above(plane, flight)
        handles, _ = plane.get_legend_handles_labels()
        plane.legend(handles=[*handles, *leg_names(flight.plan)], loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return figure


def draw_from_above(axes: Axes, flight: Flight) -> None:
    """Draws the flown path and the reference in the X-Y plane, with the numbers of the legs."""
    state, reference = flight.record("state"), flight.record("reference")
    axes.plot(state.x, state.y, color=BLUE, label="flown")
    axes.plot(reference.x, reference.y, label="reference", **REFERENCE)
    axes.plot(state.x[:1], state.y[:1], color=BLUE, marker="o", markersize=4, linestyle="none", label="start")
    number_legs(axes, flight.plan)
    if flight.metrics.crashed:
        crash: dict[str, Any] = {"color": VERMILION, "marker": "x", "markersize": 9, "markeredgewidth": 2}
        label = f"crashed at {flight.metrics.crash_time:.2f} s"
        axes.plot(state.x[-1:], state.y[-1:], linestyle="none", label=label, **crash)
    axes.set(xlabel="X (m)", ylabel="Y (m)", title="From above")
    axes.margins(0.1)
    axes.set_aspect("equal", adjustable="datalim")


def plot_errors(flight: Flight) -> Figure:
    """Plots the position error over time, on each axis and as its Euclidean norm."""
    state, reference = flight.record("state"), flight.record("reference")
    with styled():
        figure = new_figure(8.0, 4.8)
        upper, lower = figure.subplots(2, 1, sharex=True)
        for axis, color in AXES.items():
            error = 100.0 * (getattr(reference, axis) - getattr(state, axis))
            upper.plot(flight.time, error, color=color, label=axis.upper())
        upper.set(ylabel="error (cm)", title="Position error, reference minus flown")
        upper.legend(ncols=3, loc="upper right")
        shade_legs(upper, flight.plan, float(flight.time[-1]), height=0.02)
        draw_error(lower, flight)
        return figure


def draw_error(axes: Axes, flight: Flight) -> None:
    """Draws the Euclidean position error over time, and its RMSE."""
    axes.plot(flight.time, 100.0 * flight.euclidean_error, color="black")
    if np.isfinite(flight.metrics.rmse):
        rmse = 100.0 * flight.metrics.rmse
        axes.axhline(rmse, **LIMIT)
        beside = ("axes fraction", "data")
        axes.annotate(f"RMSE\n{rmse:.2f} cm", (1.01, rmse), xycoords=beside, va="center", annotation_clip=False)
    axes.set(xlabel="time (s)", ylabel="Euclidean error (cm)", ylim=(0.0, None))
    shade_legs(axes, flight.plan, float(flight.time[-1]), height=0.02)


def plot_attitude(flight: Flight) -> Figure:
    """Plots roll, pitch and yaw over time, beside what was commanded if the control commands an attitude."""
    flown = flight.record("state")
    wanted = flight.record("attitude_command") if "attitude_command" in flight.signals else None
    with styled():
        figure = new_figure(8.0, 5.6)
        for axes, angle in zip(figure.subplots(3, 1, sharex=True), Attitude._fields, strict=True):
            if wanted is not None:
                commanded = np.degrees(getattr(wanted, angle))
                axes.plot(flight.time, commanded, color=VERMILION, linewidth=1.0, label="commanded")
            axes.plot(flight.time, np.degrees(getattr(flown, angle)), color=BLUE, label="flown")
            axes.set(ylabel=f"{angle} (°)")
            low, high = axes.get_ylim()
            if high - low < 2.0:
                middle = 0.5 * (low + high)
                axes.set_ylim(middle - 1.0, middle + 1.0)
        figure.axes[0].set_title("Attitude")
        figure.axes[0].legend(ncols=2, loc="upper right")
        figure.axes[-1].set_xlabel("time (s)")
        return figure


def plot_rotors(flight: Flight) -> Figure:
    """Plots the rotor speeds over time, close up and within the whole range between the rotors' limits."""
    limits = flight.scenario.vehicle.min_rotor_speed, flight.scenario.vehicle.max_rotor_speed
    with styled():
        figure = new_figure(8.0, 4.4)
        close, whole = figure.subplots(1, 2, width_ratios=[3.0, 1.0])
        for axes in (close, whole):
            draw_rotor_speeds(axes, flight)
        low, high = close.get_ylim()
        for limit in limits:
            whole.axhline(limit, **LIMIT)
            close.axhline(limit, **LIMIT)
        close.set(ylim=(low, high), ylabel="rotor speed (rad/s)", title="Rotor speeds")
        close.legend(ncols=4, loc="upper center", handlelength=1.2, columnspacing=1.0)
        whole.set(title="between the limits", ylabel="", ylim=(0.0, 1.08 * limits[1]))
        for limit, name in zip(limits, ("idle", "top"), strict=True):
            whole.annotate(f"{name} {limit:g}", (flight.time[0], limit), va="bottom", fontsize=8.5)
        return figure


def draw_rotor_speeds(axes: Axes, flight: Flight) -> None:
    """Draws the speeds of the rotors over time."""
    speeds = flight.record("rotor_speed")._asdict()
    for (name, speed), color in zip(speeds.items(), ROTORS, strict=True):
        axes.plot(flight.time, speed, color=color, linewidth=1.1, label=name.replace("_", " "))
    axes.set(xlabel="time (s)", ylabel="rotor speed (rad/s)")


PLOTS: dict[str, Callable[[Flight], Figure]] = {
    "path": plot_path,
    "errors": plot_errors,
    "attitude": plot_attitude,
    "rotors": plot_rotors,
}


def save_plots(flight: Flight, folder: Path | str, *, vector: Vector | None = None) -> list[Path]:
    """Draws all plots of a flight into a folder and returns the files.

    A flight without wind has no plot of wind, and one without a network none of learning; surfaces and gains are drawn
    of networks that look at error and rate, as the paper's.

    Args:
        flight: to plot.
        folder: for a PNG of each plot.
        vector: a format in which each plot is written besides, for print.

    Raises:
        InputError: the folder cannot be written.
    """
    target = output_folder(Path(folder))
    plots = dict(PLOTS)
    if flight.scenario.laboratory.wind or flight["wind"].any():
        plots["wind"] = plot_wind
    network = flight.scenario.control.network
    if network is not None and "weights" in flight.signals:
        plots |= {"memberships": plot_own_memberships, "learning": plot_learning}
        if [*network.inputs.given] == ["error", "error_rate"]:
            plots |= {"surfaces": plot_surfaces, "secant_gains": plot_secant_gains}
    return save_figures({name: plot(flight) for name, plot in plots.items()}, target, vector=vector)
