"""Plots of a fuzzy network: its memberships, and what it learns in a flight."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drake_quad.assembly.control import antecedents
from drake_quad.control.fuzzy.inference import Antecedents, elliptic_membership, firing_strengths
from drake_quad.flight import Flight
from drake_quad.scenario.controllers import Type1Position, Type2Position
from drake_quad.visualization.style import BLUE, GREEN, PLATE, VERMILION, new_figure, shading, styled

# The pairs of exponents of the paper's Fig. 4.
PAPER_EXPONENTS = ((1.0, 1.0), (1.2, 0.8), (1.4, 0.6), (1.6, 0.4))
# Errors at which the secant gain is written, m, and points along each side of a surface.
_ERRORS, _FINE = (0.001, 0.01, 0.05), 101


def plot_memberships(exponents: Sequence[tuple[float, float]] = PAPER_EXPONENTS) -> Figure:
    """Plots the upper and lower memberships of a set around 0 of width 1, as in the paper's Fig. 4.

    Args:
        exponents: the pairs (a1, a2), each with a panel of its own.
    """
    u: Any = np.linspace(-1.2, 1.2, 481)
    with styled():
        figure = new_figure(2.3 * len(exponents), 2.5)
        row = figure.subplots(1, len(exponents), sharey=True, squeeze=False)[0]
        for axes, (a1, a2) in zip(row, exponents, strict=True):
            upper, lower = elliptic_membership(u, a1), elliptic_membership(u, a2)
            axes.fill_between(u, lower, upper, color=shading()(0.5), linewidth=0)
            axes.plot(u, upper, color=BLUE, label="upper")
            axes.plot(u, lower, color=VERMILION, label="lower")
            axes.set(title=f"a1 = {a1:g}, a2 = {a2:g}", xlabel="(x - c) / d")
        row[0].set_ylabel("membership")
        row[-1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return figure


def plot_own_memberships(flight: Flight) -> Figure:
    """Plots the memberships of the paper's Fig. 4, and those of the flight's network if its exponents are others."""
    sets = antecedents(_controller(flight))
    return plot_memberships(tuple(dict.fromkeys([*PAPER_EXPONENTS, (float(sets.a1), float(sets.a2))])))


def plot_learning(flight: Flight) -> Figure:
    """Plots, for each axis of the network, what PD and network command, the weights, and the covariance's trace."""
    axes_learned = _axes(flight)
    count, has_trace = len(axes_learned), "covariance_trace" in flight.signals
    pd, correction, weights = flight.record("pd"), flight.record("correction"), _weights(flight)
    with styled():
        figure = new_figure(4.6 * count, 6.6 if has_trace else 4.6)
        grid = figure.subplots(3 if has_trace else 2, count, sharex=True, sharey="row", squeeze=False)
        for (commanded, learned, *_), axis in zip(grid.T, axes_learned, strict=True):
            commanded.plot(flight.time, getattr(pd, axis), color=BLUE, linewidth=1.0, label="PD, τ_c")
            network = -getattr(correction, axis)
            commanded.plot(flight.time, network, color=VERMILION, linewidth=1.0, label="network, -τ_f")
            commanded.set_title(f"on {axis.upper()}", loc="left")
            learned.plot(flight.time, weights[axis], linewidth=1.0)
        if has_trace:
            for lower, trace in zip(grid[2], flight.record("covariance_trace"), strict=True):
                lower.plot(flight.time, trace, color=GREEN)
                lower.set_ylim(bottom=0.0)
        for lowest in grid[-1]:
            lowest.set_xlabel("time (s)")
        grid[0, 0].set_ylabel("command (m/s²)")
        grid[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
        grid[1, 0].set_ylabel("weights F, one a rule (m/s²)")
        if has_trace:
            grid[2, 0].set_ylabel("trace of P (1/s)")
        return figure


def plot_surfaces(flight: Flight) -> Figure:
    """Plots what the network adds to the command over error and rate, before and after the flight.

    Shades are -τ_f; each dot is a pair of error and rate that the network met at a tick.
    """
    axes_learned, sets = _axes(flight), antecedents(_controller(flight))
    met, met_rate = flight.record("error"), flight.record("error_rate")
    error = np.linspace(-1.05, 1.05, _FINE) / sets.error.scale
    rate = np.linspace(-1.05, 1.05, _FINE) / sets.rate.scale
    across, up = (each.ravel() for each in np.meshgrid(error, rate))
    firing = _firing(across, up, sets)
    added = {axis: -(weights[[0, -1]] @ firing).reshape(2, _FINE, _FINE) for axis, weights in _weights(flight).items()}
    top = max(*(float(np.abs(each).max()) for each in added.values()), 1e-9)
    with styled():
        figure = new_figure(8.6, 3.6 * len(axes_learned))
        grid = figure.subplots(len(axes_learned), 2, sharex=True, sharey=True, squeeze=False)
        for row, axis in zip(grid, axes_learned, strict=True):
            for axes, surface, when in zip(row, added[axis], ("before", "after"), strict=True):
                shades = axes.pcolormesh(error, rate, surface, cmap="RdBu_r", vmin=-top, vmax=top, rasterized=True)
                axes.plot(getattr(met, axis), getattr(met_rate, axis), ".", color="0.2", markersize=1.2)
                axes.set(title=f"on {axis.upper()}, {when} the flight", xlim=error[[0, -1]], ylim=rate[[0, -1]])
                axes.grid(visible=False)
            row[0].set_ylabel("error rate (m/s)")
        for axes in grid[-1]:
            axes.set_xlabel("error (m)")
        figure.colorbar(shades, ax=grid, label="what the network adds, -τ_f (m/s²)", fraction=0.04)
        return figure


def secant_gains(
    sets: Antecedents, weights: np.ndarray, errors: Sequence[float] = _ERRORS
) -> tuple[np.ndarray, np.ndarray]:
    """The secant gains (τ_f(e, 0) - τ_f(0, 0)) / e of a network and of its type-1 counterpart, 1/s².

    An elliptic set has no derivative at its centre, so that there is no gain at e = 0.

    Args:
        sets: antecedents of the network.
        weights: (R,) of its rules, m/s².
        errors: e, m.

    Returns:
        (errors,) gains of the network, and of a network with the same sets as triangles.
    """
    found = []
    for each in (sets, sets._replace(a1=1.0, a2=1.0)):
        at_rest = np.zeros(1)
        rest = weights @ _firing(at_rest, at_rest, each)
        across = np.array(errors, dtype=float)
        found.append((weights @ _firing(across, 0.0 * across, each) - rest) / across)
    return found[0], found[1]


def plot_secant_gains(flight: Flight) -> Figure:
    """Plots the gain with which the network answers an error at the end of the flight, over the size of the error."""
    sets, weights = antecedents(_controller(flight)), _weights(flight)
    errors = np.geomspace(5e-4, 1.0 / sets.error.scale, 120)
    with styled():
        figure = new_figure(4.2 * len(weights), 3.2)
        row = figure.subplots(1, len(weights), sharey=True, squeeze=False)[0]
        for axes, (axis, learned) in zip(row, weights.items(), strict=True):
            own, triangles = (-gains for gains in secant_gains(sets, learned[-1], tuple(errors)))
            _draw_gains(axes, errors, own, triangles)
            axes.set(title=f"on {axis.upper()}, at rest", xlabel="error (m)")
        row[0].set_ylabel("secant gain of -τ_f (1/s²)")
        row[0].legend(loc="best")
        return figure


def _draw_gains(axes: Axes, errors: np.ndarray, own: np.ndarray, triangles: np.ndarray) -> None:
    axes.semilogx(errors, own, color=VERMILION, label="the network")
    axes.semilogx(errors, triangles, color=BLUE, linestyle="--", label="the same with triangles")
    for error in _ERRORS:
        gain = float(np.interp(error, errors, own))
        axes.plot(error, gain, "o", color=VERMILION, markersize=4)
        axes.annotate(f"{gain:.2f}", (error, gain), xytext=(0, 6), textcoords="offset points", fontsize=8, bbox=PLATE)


def _firing(error: Any, rate: Any, sets: Antecedents) -> np.ndarray:
    """(R, n) firing strengths at n pairs of error and rate."""
    return np.array(firing_strengths(error, rate, sets))


def _axes(flight: Flight) -> list[str]:
    """The axes of a flight's network, in the order of its signals."""
    return sorted(_controller(flight).axes)


def _weights(flight: Flight) -> dict[str, np.ndarray]:
    """(ticks, R) weights for each axis of a flight's network."""
    axes = _axes(flight)
    return dict(zip(axes, np.split(flight["weights"], len(axes), axis=1), strict=True))


def _controller(flight: Flight) -> Type1Position | Type2Position:
    position = getattr(flight.scenario.control, "position", flight.scenario.control)
    if not isinstance(position, Type1Position | Type2Position):
        raise ValueError(f"a {position.kind} has no network")
    return position
