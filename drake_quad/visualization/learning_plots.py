"""Plots of a fuzzy network: its memberships, and what it learns in a flight."""

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from drake_quad.control.fuzzy.inference import Antecedents, elliptic_membership, firing_strengths
from drake_quad.flight.flight import Flight
from drake_quad.scenario.networks.network import Network
from drake_quad.visualization.panels import new_panels
from drake_quad.visualization.style import (
    ABOVE,
    BLACK,
    BLUE,
    GREEN,
    ORANGE,
    PLATE,
    PURPLE,
    SKY,
    VERMILION,
    shading,
)

# Pairs of exponents in Fig. 4 of the paper.
PAPER_EXPONENTS = ((1.0, 1.0), (1.2, 0.8), (1.4, 0.6), (1.6, 0.4))
# Errors (m) at which the secant gain is labelled, and number of points along each side of a surface.
_ERRORS, _FINE = (0.001, 0.01, 0.05), 101
# A curve of a weight has a colour for the set of the first input and a line style for the set of the second.
_COLORS = (BLUE, BLACK, VERMILION, GREEN, PURPLE, ORANGE, SKY)
_STYLES: tuple[Any, ...] = ("--", "-", ":", "-.", (0, (6, 1, 1, 1, 1, 1)), (0, (8, 3)), (0, (1, 3)))
_INPUTS = {"error": "error", "error_rate": "rate"}


def plot_memberships(exponents: Sequence[tuple[float, float]] = PAPER_EXPONENTS) -> Figure:
    """Plot the upper and lower memberships of a set around 0 of width 1, as in Fig. 4 of the paper.

    Args:
        exponents: pairs (a1, a2); each pair has its own panel.
    """
    u: Any = np.linspace(-1.2, 1.2, 481)
    with new_panels(2.3 * len(exponents), 2.5, 1, len(exponents), sharey=True) as (figure, (row,)):
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
    """Plot the memberships of Fig. 4 of the paper, and of the network of a flight if its exponents differ."""
    sets = _network(flight).antecedents()
    return plot_memberships(tuple(dict.fromkeys([*PAPER_EXPONENTS, (float(sets.a1), float(sets.a2))])))


def plot_learning(flight: Flight) -> Figure:
    """Plot the commands of PD and network, the weights, and the trace of the covariance, for each axis."""
    axes_learned = _axes(flight)
    count, has_trace = len(axes_learned), "covariance_trace" in flight.signals
    pd, correction, weights = flight.record("pd"), flight.record("correction"), _weights(flight)
    num_rows = 3 if has_trace else 2
    with new_panels(4.6 * count, 0.6 + 2.0 * num_rows, num_rows, count, sharex=True, sharey="row") as (figure, grid):
        for (commanded, learned, *_), axis in zip(grid.T, axes_learned, strict=True):
            commanded.plot(flight.time, getattr(pd, axis), color=BLUE, linewidth=1.0, label="PD, τ_c")
            network = -getattr(correction, axis)
            commanded.plot(flight.time, network, color=VERMILION, linewidth=1.0, label="network, -τ_f")
            commanded.set_title(f"on {axis.upper()}", loc="left")
            for weight, style in zip(weights[axis].T, _rules(_network(flight)), strict=True):
                learned.plot(flight.time, weight, linewidth=1.1, **style)
        if has_trace:
            for lower, trace in zip(grid[2], flight.record("covariance_trace"), strict=True):
                lower.plot(flight.time, trace, color=GREEN)
                lower.set_ylim(bottom=0.0)
        for lowest in grid[-1]:
            lowest.set_xlabel("time (s)")
        grid[0, 0].set_ylabel("command (m/s²)")
        grid[0, 0].legend(ncols=2, **ABOVE)
        grid[1, -1].legend(
            handles=_rule_key(_network(flight)), loc="upper left", bbox_to_anchor=(1.0, 1.0), title="sets of a rule"
        )
        grid[1, 0].set_ylabel("weights F, one a rule (m/s²)")
        if has_trace:
            grid[2, 0].set_ylabel("trace of P (1/s)")
        return figure


def _rules(network: Network) -> list[dict[str, Any]]:
    """Return the label, colour and line style of each rule; the label has the centres of its sets."""
    first, *others = [sets.centres for sets in network.inputs.given.values()]
    return [
        {"label": ", ".join(f"{centre:g}" for centre in (of_first, *rest)), "color": color, "linestyle": style}
        for of_first, color in zip(first, itertools.cycle(_COLORS))
        for rest, style in zip(itertools.product(*others), itertools.cycle(_STYLES))
    ]


def _rule_key(network: Network) -> list[Line2D]:
    """Return legend handles with a colour for each set of the first input, and a style for each of the second.

    With more than two inputs, a style stands for a combination of sets of all inputs but the first.
    """
    (name, sets), *others = network.inputs.given.items()
    handles = [
        Line2D([], [], color=_COLORS[i % len(_COLORS)], label=f"{_INPUTS.get(name, name)} at {_at(centre)}")
        for i, centre in enumerate(sets.centres)
    ]
    if len(others) == 1:
        ((second, sets),) = others
        handles += [
            Line2D([], [], color="0.3", linestyle=style, label=f"{_INPUTS.get(second, second)} at {_at(centre)}")
            for style, centre in zip(_STYLES, sets.centres, strict=False)
        ]
    return handles


def _at(centre: float) -> str:
    """Return the centre of a set, in units of the scaled input, as text."""
    return f"{centre:+g}".replace("-", "−") if centre else "0"


def plot_surfaces(flight: Flight) -> Figure:
    """Plot the contribution of the network to the command over error and rate, before and after the flight.

    Shades are -τ_f. Each dot is a pair of error and rate that occurred at a tick.
    """
    axes_learned, sets = _axes(flight), _network(flight).antecedents()
    met, met_rate = flight.record("error"), flight.record("error_rate")
    error, rate = (np.linspace(-1.05, 1.05, _FINE) / each.scale for each in sets.inputs)
    across, up = (each.ravel() for each in np.meshgrid(error, rate))
    firing = _firing(across, up, sets)
    added = {axis: -(weights[[0, -1]] @ firing).reshape(2, _FINE, _FINE) for axis, weights in _weights(flight).items()}
    top = max(*(float(np.abs(each).max()) for each in added.values()), 1e-9)
    count = len(axes_learned)
    with new_panels(8.6, 3.6 * count, count, 2, sharex=True, sharey=True) as (figure, grid):
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
    """Return the secant gains (τ_f(e, 0) - τ_f(0, 0)) / e of a network and of its type-1 counterpart, 1/s².

    An elliptic set has no derivative at its centre, so the gain at e = 0 does not exist.

    Args:
        sets: antecedents of the network.
        weights: weights of its rules, (R,), m/s².
        errors: errors e, m.

    Returns:
        The gains (errors,) of the network, and of a network with triangular sets of the same centres and widths.
    """
    found = []
    for each in (sets, sets._replace(a1=1.0, a2=1.0)):
        at_rest = np.zeros(1)
        rest = weights @ _firing(at_rest, at_rest, each)
        across = np.array(errors, dtype=float)
        found.append((weights @ _firing(across, 0.0 * across, each) - rest) / across)
    return found[0], found[1]


def plot_secant_gains(flight: Flight) -> Figure:
    """Plot the secant gain of the network at the end of the flight over the size of the error."""
    sets, weights = _network(flight).antecedents(), _weights(flight)
    errors = np.geomspace(5e-4, 1.0 / sets.inputs[0].scale, 120)
    with new_panels(4.2 * len(weights), 3.2, 1, len(weights), sharey=True) as (figure, (row,)):
        for axes, (axis, learned) in zip(row, weights.items(), strict=True):
            own, triangles = (-gains for gains in secant_gains(sets, learned[-1], tuple(errors)))
            _draw_gains(axes, errors, own, triangles)
            axes.set(title=f"on {axis.upper()}, at rest", xlabel="error (m)")
        row[0].set_ylabel("secant gain of -τ_f (1/s²)")
        figure.legend(*row[0].get_legend_handles_labels(), loc="outside upper center", ncols=2)
        return figure


def _draw_gains(axes: Axes, errors: np.ndarray, own: np.ndarray, triangles: np.ndarray) -> None:
    axes.semilogx(errors, own, color=VERMILION, label="the network")
    axes.semilogx(errors, triangles, color=BLUE, linestyle="--", label="the same with triangles")
    for error in _ERRORS:
        gain = float(np.interp(error, errors, own))
        axes.plot(error, gain, "o", color=VERMILION, markersize=4)
        axes.annotate(f"{gain:.2f}", (error, gain), (0, 6), textcoords="offset points", fontsize=8, bbox=PLATE)


def _firing(error: Any, rate: Any, sets: Antecedents) -> np.ndarray:
    """Return the firing strengths (R, n) at n pairs of error and rate."""
    return np.array(firing_strengths((error, rate), sets))


def _axes(flight: Flight) -> list[str]:
    """Return the axes of a flight's network, in the order of its signals."""
    return sorted(_network(flight).axes)


def _weights(flight: Flight) -> dict[str, np.ndarray]:
    """Return the weights (ticks, R) of a flight's network by axis."""
    axes = _axes(flight)
    return dict(zip(axes, np.split(flight["weights"], len(axes), axis=1), strict=True))


def _network(flight: Flight) -> Network:
    network = flight.scenario.control.network
    if network is None:
        raise ValueError("the flight has no network")
    return network
