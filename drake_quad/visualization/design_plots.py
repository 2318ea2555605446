"""Plots of a gain design: Bode, Nyquist, root locus and step responses."""

import math
from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.figure import Figure

from drake_quad.design.cascade import CascadeDesign
from drake_quad.design.gains import LoopDesign, pd_loop
from drake_quad.linear.closed_loop import ClosedLoop
from drake_quad.linear.margins import frequencies
from drake_quad.linear.step_response import initial_response
from drake_quad.signals import State
from drake_quad.visualization.panels import new_panels
from drake_quad.visualization.style import BLACK, BLUE, LIMIT, TEXT_BACKGROUND, VERMILION

# Titles of the drawn loops. Roll and y are left out, because they are mirror images of pitch and x.
_LOOP_TITLES = {"pitch": "attitude (pitch)", "x": "position (x)"}
# Titles of the drawn loops if no attitude loop is designed, because the autopilot controls the attitude.
_LOOP_TITLES_WITH_AUTOPILOT = {"z": "height (z)", "x": "position (x)"}
# Steps of the reference: name of the state component, amplitude in SI units, and label of the axis.
_STEPS = (("x", 0.5, "x (m)"), ("z", 0.5, "z (m)"), ("yaw", 0.5, "yaw (rad)"))


def _titles_of_drawn_loops(loops: Mapping[str, LoopDesign]) -> dict[str, str]:
    """Return the titles of the two drawn loops, by axis."""
    return _LOOP_TITLES if loops.keys() >= _LOOP_TITLES.keys() else _LOOP_TITLES_WITH_AUTOPILOT


def plot_bode(design: CascadeDesign) -> Figure:
    """Plot gain and phase of two loops over frequency, with their stability margins.

    The loops are those of pitch and x, or of z and x if an autopilot controls the attitude.
    """
    import control

    loops = design.all_loops
    with new_panels(9.0, 5.4, 2, 2, sharex="col", sharey="row") as (figure, grid):
        for column, (axis, title) in enumerate(_titles_of_drawn_loops(loops).items()):
            panels, (omega, response) = grid[:, [column]], _response(loops[axis])
            # The response of a state-space model in python-control depends on whether slycot is installed.
            loop = control.frd(response, omega, dt=loops[axis].plant.period, smooth=True, sysname=axis)
            control.bode_plot(loop, ax=panels, dB=True, display_margins=True, color=BLUE, title="")
            upper, lower = panels[:, 0]
            margins, delay = upper.get_title().partition(": ")[2], loops[axis].margins.delay
            upper.set_title(f"{title}, delay margin {1e3 * delay:.0f} ms\n{margins}", fontsize=8.5)
            upper.set(ylim=(-60.0, 60.0))
            lower.set(ylim=(-360.0, -90.0), xlim=(0.02, math.pi / loop.dt))
        return figure


def plot_nyquist(design: CascadeDesign) -> Figure:
    """Plot the Nyquist curves of the loops in `plot_bode`, with the disk around -1 that the disk margin excludes."""
    loops = design.all_loops
    with new_panels(9.0, 4.5, 1, 2) as (figure, (row,)):
        for axes, (axis, title) in zip(row, _titles_of_drawn_loops(loops).items(), strict=True):
            loop = loops[axis]
            _, response = _response(loop)
            axes.plot(response.real, response.imag, color=BLUE, label="L")
            angles = np.linspace(0.0, 2.0 * np.pi, 200)
            axes.plot(np.cos(angles), np.sin(angles), label="|L| = 1", **LIMIT)
            # On the real axis, the disk of margin α extends from -(1 + α/2) / (1 - α/2) to -(1 - α/2) / (1 + α/2).
            low = (1.0 - 0.5 * loop.margins.disk) / (1.0 + 0.5 * loop.margins.disk)
            middle, radius = -0.5 * (low + 1.0 / low), 0.5 * (1.0 / low - low)
            axes.fill(
                middle + radius * np.cos(angles),
                radius * np.sin(angles),
                color="0.9",
                label=f"disk margin {loop.margins.disk:.2f}",
            )
            axes.plot(-1.0, 0.0, marker="+", color=VERMILION, markersize=10, markeredgewidth=2.0, linestyle="none")
            axes.set(xlabel="Re L", ylabel="Im L", title=title, xlim=(-3.0, 1.2), ylim=(-2.1, 2.1))
            axes.set_aspect("equal")
            axes.legend(loc="upper left")
        return figure


def plot_root_locus(design: CascadeDesign) -> Figure:
    """Plot the root locus of the position loop, whose two gains are multiplied by a common factor."""
    loop = design.loops["x"]
    plant, period = loop.plant, loop.plant.period
    factors = np.concatenate([[0.0], np.geomspace(0.01, 30.0, 1500)])  # factors by which both gains are multiplied
    gain_row = np.array([loop.gains])
    poles = np.linalg.eigvals(plant.A - factors[:, np.newaxis, np.newaxis] * (plant.B @ gain_row @ plant.C))
    limit_factor = 10.0 ** (loop.margins.gain / 20.0)
    with new_panels(7.0, 5.2) as (figure, axes):
        s = _continuous(poles, period)
        axes.plot(s.real.ravel(), s.imag.ravel(), ".", color="0.7", markersize=1.5)
        for factor, color, marker, label in (
            (0.0, BLACK, "x", "open loop"),
            (1.0, BLUE, "s", "as designed"),
            (limit_factor, VERMILION, "o", f"limit of stability, × {limit_factor:.2f}"),
        ):
            if not math.isfinite(factor):
                continue
            roots = _continuous(plant.with_feedback(factor * gain_row).poles(), period)
            axes.plot(roots.real, roots.imag, marker, color=color, label=label, markerfacecolor="none", markersize=7)
        critical_poles = _continuous(plant.with_feedback(limit_factor * gain_row).poles(), period)
        critical = critical_poles[np.nanargmin(np.abs(critical_poles.real))] if math.isfinite(limit_factor) else 0.0
        limit = max(4.0 * loop.margins.bandwidth, 1.2 * abs(critical.imag))
        for damping in (0.3, 0.5, 0.7):
            x = -damping / math.sqrt(1.0 - damping**2) * limit
            axes.plot(
                [0.0, x, np.nan, 0.0, x], [0.0, limit, np.nan, 0.0, -limit], color="0.85", linewidth=0.8, zorder=0
            )
            axes.annotate(f"ζ {damping:g}", (0.93 * x, 0.93 * limit), color="0.45", fontsize=8.5, bbox=TEXT_BACKGROUND)
        axes.axvline(0.0, color="0.4", linewidth=0.8)
        axes.set(
            xlabel="Re s (1/s)",
            ylabel="Im s (1/s)",
            title="Poles of the position loop, s = log(z) / tick, both gains multiplied by 0 to 30",
            xlim=(-1.3 * limit, 0.4 * limit),
            ylim=(-limit, limit),
        )
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=3)
        return figure


def plot_steps(loop: ClosedLoop) -> Figure:
    """Plot the responses of the nonlinear diagram and of its linear model to reference steps in x, z and yaw."""
    slowest = -math.log(np.abs(loop.system.poles()).max()) / loop.system.period
    duration = min(max(5.0 / slowest, 4.0), 20.0)
    with new_panels(9.0, 3.4, 1, 3) as (figure, (panels,)):
        for axes, (row, size, label) in zip(panels, _STEPS, strict=True):
            response = initial_response(loop, {row: -size}, duration=duration)
            diagram, model = (getattr(State(*rows.T), row) for rows in (response.nonlinear, response.linear))
            axes.plot(response.time, diagram + size, color=BLUE, label="diagram")
            axes.plot(response.time, model + size, "--", color=VERMILION, label="linear model")
            axes.axhline(size, **LIMIT)
            axes.set(xlabel="time (s)", ylabel=label, title=f"step in {row}")
            low, high = axes.get_ylim()
            axes.set_ylim(low, max(high, 1.06 * size))
        figure.legend(*axes.get_legend_handles_labels(), loc="outside lower right", ncols=2)
        return figure


DESIGN_PLOTS: dict[str, Callable[[CascadeDesign], Figure]] = {
    "bode": plot_bode,
    "nyquist": plot_nyquist,
    "root_locus": plot_root_locus,
}


def _continuous(poles: np.ndarray, period: float) -> np.ndarray:
    """Return poles in continuous time, s = log(z) / period; NaN for poles near z = 0, which belong to delay lines."""
    return np.asarray(np.log(np.where(np.abs(poles) > 1e-6, poles, np.nan).astype(complex)) / period)


def _response(design: LoopDesign) -> tuple[np.ndarray, np.ndarray]:
    """Return frequencies, rad/s, and the loop transfer function L at each frequency."""
    grid = frequencies(design.plant.period)
    return grid, pd_loop(design.plant, design.gains).response(np.exp(1j * grid * design.plant.period))[:, 0, 0]
