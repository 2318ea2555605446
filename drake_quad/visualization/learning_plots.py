"""What a network is made of, and what it learns in a flight."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from drake_quad.control.fuzzy.inference import Antecedents, elliptic_membership, firing_strengths
from drake_quad.control.fuzzy.systems import places
from drake_quad.flight import Flight
from drake_quad.assembly.control import antecedents
from drake_quad.scenario.controllers import Type1Position, Type2Position
from drake_quad.visualization.style import BLUE, GREEN, PLATE, SHADING, VERMILION, new_figure, styled

# The pairs of exponents of the paper's Fig. 4.
PAPER_EXPONENTS = ((1.0, 1.0), (1.2, 0.8), (1.4, 0.6), (1.6, 0.4))
# Errors at which the secant gain is asked for, m, and how finely surfaces are drawn.
_ERRORS, _FINE = (0.001, 0.01, 0.05), 101


def plot_memberships(exponents: Sequence[tuple[float, float]] = PAPER_EXPONENTS) -> Figure:
    """Upper and lower memberships of a set around 0 of width 1, as in the paper's Fig. 4, a panel a pair (a1, a2)."""
    u = np.linspace(-1.2, 1.2, 481)
    with styled():
        figure = new_figure(2.3 * len(exponents), 2.5)
        row = figure.subplots(1, len(exponents), sharey=True, squeeze=False)[0]
        for axes, (a1, a2) in zip(row, exponents, strict=True):
            upper, lower = elliptic_membership(u, a1), elliptic_membership(u, a2)
            axes.fill_between(u, lower, upper, color=SHADING(0.5), linewidth=0)
            axes.plot(u, upper, color=BLUE, label="upper")
            axes.plot(u, lower, color=VERMILION, label="lower")
            axes.set(title=f"a1 = {a1:g}, a2 = {a2:g}", xlabel="(x - c) / d")
        row[0].set_ylabel("membership")
        row[-1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        return figure


def plot_own_memberships(flight: Flight) -> Figure:
    """Those of the paper's Fig. 4 and, if it is another pair, that of the flight's network."""
    sets = antecedents(_controller(flight))
    return plot_memberships(tuple(dict.fromkeys([*PAPER_EXPONENTS, (float(sets.a1), float(sets.a2))])))


def plot_learning(flight: Flight) -> Figure:
    """On each axis of the network: the signals of PD and network, the weights, and the trace of the covariance."""
    position = _controller(flight)
    count = len(position.axes)
    has_trace = "covariance_trace" in flight.signals
    with styled():
        figure = new_figure(4.6 * count, 6.6 if has_trace else 4.6)
        grid = figure.subplots(3 if has_trace else 2, count, sharex=True, sharey="row", squeeze=False)
        weights = _weights(flight)
        for column, (place, name) in enumerate(zip(places(position.axes), sorted(position.axes), strict=True)):
            signals, learned, *rest = grid[:, column]
            signals.plot(flight.time, flight["pd"][:, place], color=BLUE, linewidth=1.0, label="PD, τ_c")
            signals.plot(
                flight.time, -flight["correction"][:, place], color=VERMILION, linewidth=1.0, label="network, -τ_f"
            )
            signals.set_title(f"on {name.upper()}", loc="left")
            learned.plot(flight.time, weights[:, :, column], linewidth=1.0)
            if rest:
                rest[0].plot(flight.time, flight["covariance_trace"][:, column], color=GREEN)
                rest[0].set_ylim(bottom=0.0)
            grid[-1, column].set_xlabel("time (s)")
        grid[0, 0].set_ylabel("command (m/s²)")
        grid[0, 0].legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2)
        grid[1, 0].set_ylabel("weights F, one a rule (m/s²)")
        if has_trace:
            grid[2, 0].set_ylabel("trace of P (1/s)")
        return figure


def plot_surfaces(flight: Flight) -> Figure:
    """What the network adds to the command over error and rate, before and after the flight, and where the flight was.

    Shades are -τ_f; dots are the pairs of error and rate that the network met, a dot a tick.
    """
    position = _controller(flight)
    sets = antecedents(position)
    weights = _weights(flight)
    error = np.linspace(-1.05, 1.05, _FINE) / sets.error.scale
    rate = np.linspace(-1.05, 1.05, _FINE) / sets.rate.scale
    across, up = np.meshgrid(error, rate)
    firing = np.array(firing_strengths(across.ravel(), up.ravel(), sets))
    added = -np.einsum("tra,rn->tan", weights[[0, -1]], firing).reshape(2, -1, _FINE, _FINE)
    top = max(float(np.abs(added).max()), 1e-9)
    with styled():
        figure = new_figure(8.6, 3.6 * len(position.axes))
        grid = figure.subplots(len(position.axes), 2, sharex=True, sharey=True, squeeze=False)
        for row, (place, name) in enumerate(zip(places(position.axes), sorted(position.axes), strict=True)):
            for column, when in enumerate(("before", "after")):
                axes = grid[row, column]
                shades = axes.pcolormesh(
                    error, rate, added[column, row], cmap="RdBu_r", vmin=-top, vmax=top, rasterized=True
                )
                axes.plot(flight["error"][:, place], flight["error_rate"][:, place], ".", color="0.2", markersize=1.2)
                axes.set(title=f"on {name.upper()}, {when} the flight", xlim=error[[0, -1]], ylim=rate[[0, -1]])
                axes.grid(visible=False)
            grid[row, 0].set_ylabel("error rate (m/s)")
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
        (errors,) of the network, and of one with the same sets as triangles.
    """
    found = []
    for each in (sets, sets._replace(a1=1.0, a2=1.0)):
        rest = np.dot(firing_strengths(0.0, 0.0, each), weights)
        found.append(np.array([(np.dot(firing_strengths(float(e), 0.0, each), weights) - rest) / e for e in errors]))
    return found[0], found[1]


def plot_secant_gains(flight: Flight) -> Figure:
    """The gain with which the network answers an error at the end of the flight, over the size of the error."""
    position = _controller(flight)
    sets = antecedents(position)
    errors = np.geomspace(5e-4, 1.0 / sets.error.scale, 120)
    weights = _weights(flight)[-1]
    with styled():
        figure = new_figure(4.2 * weights.shape[1], 3.2)
        row = figure.subplots(1, weights.shape[1], sharey=True, squeeze=False)[0]
        for column, name in enumerate(sorted(position.axes)):
            own, triangles = (-gains for gains in secant_gains(sets, weights[:, column], tuple(errors)))
            _draw_gains(row[column], errors, own, triangles)
            row[column].set(title=f"on {name.upper()}, at rest", xlabel="error (m)")
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


def _weights(flight: Flight) -> np.ndarray:
    """(ticks, R, axes) weights."""
    return flight["weights"].reshape(len(flight.time), len(_controller(flight).axes), -1).swapaxes(1, 2)


def _controller(flight: Flight) -> Type1Position | Type2Position:
    position = flight.scenario.control.position
    if not isinstance(position, Type1Position | Type2Position):
        raise ValueError(f"a {position.kind} has no network")
    return position
