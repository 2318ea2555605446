"""Plots of a fuzzy network: membership functions, learned weights, and the correction that the network commands."""

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
    BLACK,
    BLUE,
    GREEN,
    LEGEND_ABOVE,
    ORANGE,
    PURPLE,
    SKY,
    TEXT_BACKGROUND,
    VERMILION,
    shading,
)

# Pairs of exponents (a1, a2) in Fig. 4 of Kayacan and Maslim (2016).
PAPER_EXPONENTS = ((1.0, 1.0), (1.2, 0.8), (1.4, 0.6), (1.6, 0.4))
_LABELLED_ERRORS = (0.001, 0.01, 0.05)  # m, position errors at which a plot states the secant gain of the network
# Number of points along each side of a surface.
_NUM_SURFACE_POINTS = 101
# In a plot of the weights, the colour shows the fuzzy set of the first input, and the line style shows the fuzzy set of
# the second input.
_COLORS = (BLUE, BLACK, VERMILION, GREEN, PURPLE, ORANGE, SKY)
_STYLES: tuple[Any, ...] = ("--", "-", ":", "-.", (0, (6, 1, 1, 1, 1, 1)), (0, (8, 3)), (0, (1, 3)))
_INPUT_LABELS = {"error": "error", "error_rate": "rate"}


def plot_memberships(exponents: Sequence[tuple[float, float]] = PAPER_EXPONENTS) -> Figure:
    """Plot the upper and lower membership functions of a set with centre 0 and width 1, as in Fig. 4 of the paper.

    Args:
        exponents: pairs (a1, a2), one for each panel.
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


def plot_network_memberships(flight: Flight) -> Figure:
    """Plot the membership functions of Fig. 4 of the paper, and those of the network of a flight.

    Equal membership functions are plotted only once.
    """
    sets = _network_of(flight).antecedents()
    figure = plot_memberships(tuple(dict.fromkeys([*PAPER_EXPONENTS, (float(sets.a1), float(sets.a2))])))
    _title(figure, "Membership functions of type-2 fuzzy sets with centre c and width d")
    return figure


def _title(figure: Figure, text: str) -> None:
    """Write a title above all panels of a figure."""
    figure.suptitle(text, x=0.01, ha="left", fontsize=11)


def plot_learning(flight: Flight) -> Figure:
    """Plot the commands of PD controller and network, the weights, and the trace of the covariance, on each axis."""
    axes_learned = _axes_of(flight)
    count, has_trace = len(axes_learned), "covariance_trace" in flight.signals
    pd, correction, weights = flight.record("pd"), flight.record("correction"), _weights_by_axis(flight)
    num_rows = 3 if has_trace else 2
    with new_panels(4.6 * count, 0.6 + 2.0 * num_rows, num_rows, count, sharex=True, sharey="row") as (figure, grid):
        for (command_axes, weight_axes, *_), axis in zip(grid.T, axes_learned, strict=True):
            command_axes.plot(flight.time, getattr(pd, axis), color=BLUE, linewidth=1.0, label="PD, τ_c")
            network = -getattr(correction, axis)
            command_axes.plot(flight.time, network, color=VERMILION, linewidth=1.0, label="network, -τ_f")
            command_axes.set_title(f"on {axis.upper()}", loc="left")
            for weight, style in zip(weights[axis].T, _rules(_network_of(flight)), strict=True):
                weight_axes.plot(flight.time, weight, linewidth=1.1, **style)
        if has_trace:
            for trace_axes, trace in zip(grid[2], flight.record("covariance_trace"), strict=True):
                trace_axes.plot(flight.time, trace, color=GREEN)
                trace_axes.set_ylim(bottom=0.0)
        for axes in grid[-1]:
            axes.set_xlabel("time (s)")
        grid[0, 0].set_ylabel("command (m/s²)")
        grid[0, 0].legend(ncols=2, **LEGEND_ABOVE)
        grid[1, -1].legend(
            handles=_rule_legend(_network_of(flight)),
            loc="upper left",
            bbox_to_anchor=(1.0, 1.0),
            title="fuzzy sets of a rule",
        )
        grid[1, 0].set_ylabel("weights F (m/s²)")
        if has_trace:
            grid[2, 0].set_ylabel("trace of P (1/s)")
        _title(figure, "Learning of the fuzzy network: commands, weights of the rules, and covariance P of the weights")
        return figure


def _rules(network: Network) -> list[dict[str, Any]]:
    """Return the label, colour and line style of each rule. The label lists the centres of the rule's fuzzy sets."""
    first, *others = [sets.centres for sets in network.inputs.specified.values()]
    return [
        {"label": ", ".join(f"{centre:g}" for centre in (of_first, *rest)), "color": color, "linestyle": style}
        for of_first, color in zip(first, itertools.cycle(_COLORS))
        for rest, style in zip(itertools.product(*others), itertools.cycle(_STYLES))
    ]


def _rule_legend(network: Network) -> list[Line2D]:
    """Return legend handles with the colour of each set of the first input, and the line style for the second input.

    If the network has more than two inputs, the legend contains only colours, since a line style then stands for a
    combination of sets.
    """
    (name, sets), *others = network.inputs.specified.items()
    handles = [
        Line2D([], [], color=_COLORS[i % len(_COLORS)], label=f"{_INPUT_LABELS.get(name, name)} at {_signed(centre)}")
        for i, centre in enumerate(sets.centres)
    ]
    if len(others) == 1:
        ((second, sets),) = others
        handles += [
            Line2D(
                [], [], color="0.3", linestyle=style, label=f"{_INPUT_LABELS.get(second, second)} at {_signed(centre)}"
            )
            for style, centre in zip(_STYLES, sets.centres, strict=False)
        ]
    return handles


def _signed(centre: float) -> str:
    """Return the centre of a fuzzy set, in units of the scaled input, as text with its sign."""
    return f"{centre:+g}".replace("-", "−") if centre else "0"


def plot_surfaces(flight: Flight) -> Figure:
    """Plot the command of the network over error and error rate, before and after the flight.

    Colours show -τ_f. Each dot shows error and error rate at a tick of the flight.
    """
    axes_learned, sets = _axes_of(flight), _network_of(flight).antecedents()
    error_signal, rate_signal = flight.record("error"), flight.record("error_rate")
    error, rate = (np.linspace(-1.05, 1.05, _NUM_SURFACE_POINTS) / each.scale for each in sets.inputs)
    errors, rates = (each.ravel() for each in np.meshgrid(error, rate))
    firing = _firing_at(errors, rates, sets)
    contribution = {
        axis: -(weights[[0, -1]] @ firing).reshape(2, _NUM_SURFACE_POINTS, _NUM_SURFACE_POINTS)
        for axis, weights in _weights_by_axis(flight).items()
    }
    top = max(*(float(np.abs(each).max()) for each in contribution.values()), 1e-9)
    count = len(axes_learned)
    with new_panels(8.6, 3.6 * count, count, 2, sharex=True, sharey=True) as (figure, grid):
        for row, axis in zip(grid, axes_learned, strict=True):
            for axes, surface, moment in zip(row, contribution[axis], ("before", "after"), strict=True):
                shades = axes.pcolormesh(error, rate, surface, cmap="RdBu_r", vmin=-top, vmax=top, rasterized=True)
                axes.plot(getattr(error_signal, axis), getattr(rate_signal, axis), ".", color="0.2", markersize=1.2)
                axes.set(title=f"on {axis.upper()}, {moment} the flight", xlim=error[[0, -1]], ylim=rate[[0, -1]])
                axes.grid(visible=False)
            row[0].set_ylabel("error rate (m/s)")
        for axes in grid[-1]:
            axes.set_xlabel("error (m)")
        figure.colorbar(shades, ax=grid, label="command of the network, -τ_f (m/s²)", fraction=0.04)
        _title(figure, "Command of the fuzzy network for each error and error rate; dots: ticks of the flight")
        return figure


def secant_gains(
    sets: Antecedents, weights: np.ndarray, errors: Sequence[float] = _LABELLED_ERRORS
) -> tuple[np.ndarray, np.ndarray]:
    """Return the secant gains (τ_f(e, 0) - τ_f(0, 0)) / e of a network and of its type-1 counterpart, 1/s².

    An elliptic membership function has no derivative at the centre, so the gain at e = 0 does not exist.

    Args:
        sets: antecedents of the network.
        weights: weights of the rules, (R,), m/s².
        errors: errors e, m.

    Returns:
        The gains (errors,) of the network, and of a network with triangular sets of the same centres and widths.
    """
    gains = []
    for antecedents in (sets, sets._replace(a1=1.0, a2=1.0)):
        zero = np.zeros(1)
        output_at_zero = weights @ _firing_at(zero, zero, antecedents)
        error_array = np.array(errors, dtype=float)
        gains.append((weights @ _firing_at(error_array, 0.0 * error_array, antecedents) - output_at_zero) / error_array)
    return gains[0], gains[1]


def plot_secant_gains(flight: Flight) -> Figure:
    """Plot the secant gain of the network over the position error, at the end of the flight."""
    sets, weights = _network_of(flight).antecedents(), _weights_by_axis(flight)
    errors = np.geomspace(5e-4, 1.0 / sets.inputs[0].scale, 120)
    with new_panels(4.2 * len(weights), 3.2, 1, len(weights), sharey=True) as (figure, (row,)):
        for axes, (axis, learned) in zip(row, weights.items(), strict=True):
            gains_of_network, gains_of_triangles = (-gains for gains in secant_gains(sets, learned[-1], tuple(errors)))
            _draw_gains(axes, errors, gains_of_network, gains_of_triangles)
            axes.set(title=f"on {axis.upper()}, at rest", xlabel="error (m)")
        row[0].set_ylabel("secant gain of -τ_f (1/s²)")
        figure.legend(*row[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
        _title(figure, "Command of the fuzzy network per error, at the end of the flight")
        return figure


def _draw_gains(axes: Axes, errors: np.ndarray, gains_of_network: np.ndarray, gains_of_triangles: np.ndarray) -> None:
    axes.semilogx(errors, gains_of_network, color=VERMILION, label="network of the flight")
    axes.semilogx(errors, gains_of_triangles, color=BLUE, linestyle="--", label="same network with triangular sets")
    for error in _LABELLED_ERRORS:
        gain = float(np.interp(error, errors, gains_of_network))
        axes.plot(error, gain, "o", color=VERMILION, markersize=4)
        axes.annotate(
            f"{gain:.2f}", (error, gain), (0, 6), textcoords="offset points", fontsize=8, bbox=TEXT_BACKGROUND
        )


def _firing_at(error: Any, rate: Any, sets: Antecedents) -> np.ndarray:
    """Return the firing strengths (R, n) at n pairs of error and rate."""
    return np.array(firing_strengths((error, rate), sets))


def _axes_of(flight: Flight) -> list[str]:
    """Return the axes of a flight's network, in the order of its signals."""
    return sorted(_network_of(flight).axes)


def _weights_by_axis(flight: Flight) -> dict[str, np.ndarray]:
    """Return the weights (ticks, R) of a flight's network by axis."""
    axes = _axes_of(flight)
    return dict(zip(axes, np.split(flight["weights"], len(axes), axis=1), strict=True))


def _network_of(flight: Flight) -> Network:
    network = flight.scenario.control.network
    if network is None:
        raise ValueError("the scenario of this flight has no network")
    return network
