"""The wind of a flight: where it blows, and what the vehicle meets."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from drake_quad.flight import Flight
from drake_quad.laboratory.wind.fans import Jet
from drake_quad.assembly.laboratory import jets, steady_wind
from drake_quad.visualization.style import AXES, BLACK, PLATE, REFERENCE, SHADING, new_figure, styled

# Arrows and shades along a map, and what the map shows beyond path and fans, m.
_ARROWS, _SHADES, _MARGIN = 30, 300, 0.7
_NAMES = "XYZ"
# Air that is slower is still, m/s.
_STILL = 1e-3


class _Plane(NamedTuple):
    """A plane of W that is drawn: the axes across and up, and where it cuts the third one (m)."""

    across: int
    up: int
    third: int
    level: float


def plot_wind(flight: Flight) -> Figure:
    """The mean wind in a level and in an upright plane, and the wind at the vehicle over time.

    The maps show what is steady: fans and steady wind, if there are any. Gusts and turbulence are in the wind at the
    vehicle.
    """
    fans = jets(flight.scenario)
    places = np.vstack([flight["state"][:, 0:3], flight["reference"][:, 0:3], *[jet.position for jet in fans]])
    places = places[np.isfinite(places).all(axis=1)]  # a vehicle may have diverged
    low, high = places.min(axis=0) - _MARGIN, places.max(axis=0) + _MARGIN
    low[2] = max(low[2], 0.0)
    # Through the first fan, or through the middle of the path; the longer side lies across the page.
    middle = np.array(fans[0].position if fans else 0.5 * (low + high))
    long, short = (1, 0) if high[1] - low[1] > high[0] - low[0] else (0, 1)
    planes = _Plane(long, short, 2, middle[2]), _Plane(long, 2, short, middle[short])
    heights = [(high[plane.up] - low[plane.up]) / (high[long] - low[long]) for plane in planes]
    fields = [_mean_wind(flight, plane, low, high) for plane in planes]
    top = max(float(speed.max()) for *_, speed in fields)
    with styled():
        if top < _STILL:
            figure = new_figure(9.0, 2.6)
            _draw_series(figure.subplots(), flight)
            return figure
        figure = new_figure(9.0, 2.6 + 7.2 * sum(heights))
        above, side, series = figure.subplots(3, 1, height_ratios=[*heights, 0.22])
        for axes, plane, field in zip((above, side), planes, fields, strict=True):
            shades = _draw_map(axes, plane, field, top)
            _draw_flight(axes, plane, flight, fans)
        if long == 1:
            above.invert_yaxis()  # seen from above, X is to the right of Y
        above.legend(ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
        figure.colorbar(shades, ax=[above, side], label="mean wind speed (m/s)", pad=0.02, fraction=0.05)
        _draw_series(series, flight)
        return figure


def _mean_wind(flight: Flight, plane: _Plane, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, ...]:
    """Places across and up (m), the steady velocity (3, up, across) and speed (up, across) there, m/s."""
    spacing = (high[plane.across] - low[plane.across]) / _SHADES
    across = np.arange(low[plane.across], high[plane.across], spacing)
    up = np.arange(low[plane.up], high[plane.up], spacing)
    place = np.empty((3, up.size, across.size))
    place[plane.across], place[plane.up] = np.meshgrid(across, up)
    place[plane.third] = plane.level
    velocity = np.zeros_like(place) + np.reshape(steady_wind(flight.scenario), (3, 1, 1))
    for jet in jets(flight.scenario):
        velocity += jet.speed(place)[0] * np.reshape(jet.direction, (3, 1, 1))
    return across, up, velocity, np.linalg.norm(velocity, axis=0)


def _draw_map(axes: Axes, plane: _Plane, field: tuple[np.ndarray, ...], top: float) -> QuadMesh:
    """Shades of the speed, and arrows of the velocity where there is any to speak of."""
    across, up, velocity, speed = field
    shades = axes.pcolormesh(across, up, speed, cmap=SHADING, vmin=0.0, vmax=top, rasterized=True)
    every = _SHADES // _ARROWS
    thin = slice(every // 2, None, every), slice(every // 2, None, every)
    felt = speed[thin] > 0.03 * top
    a, b = (coordinate[thin][felt] for coordinate in np.meshgrid(across, up))
    v_a, v_b = (velocity[axis][thin][felt] for axis in (plane.across, plane.up))
    per_metre = top / (every * (across[1] - across[0]))  # the longest arrow reaches to the next one
    axes.quiver(a, b, v_a, v_b, color="0.25", angles="xy", scale_units="xy", scale=per_metre, width=0.0016)
    axes.set(xlabel=f"{_NAMES[plane.across]} (m)", ylabel=f"{_NAMES[plane.up]} (m)")
    axes.set_title(
        f"{'From the side' if plane.up == 2 else 'From above'}: wind at {_NAMES[plane.third]} = {plane.level:.1f} m",
        loc="left",
    )
    axes.set_aspect("equal")
    axes.grid(visible=False)
    return shades


def _draw_flight(axes: Axes, plane: _Plane, flight: Flight, fans: list[Jet]) -> None:
    """The paths, and the outlets of the fans as bars across their directions."""
    shown = [plane.across, plane.up]
    axes.plot(*flight["reference"][:, shown].T, label="reference", **REFERENCE)
    axes.plot(*flight["state"][:, shown].T, color=BLACK, linewidth=1.0, label="flown")
    for jet in fans:
        middle, direction = np.array(jet.position)[shown], np.array(jet.direction)[shown]
        half = 0.5 * jet.diameter * np.array([-direction[1], direction[0]])
        axes.plot(*np.column_stack([middle - half, middle + half]), color="0.35", linewidth=4.0, solid_capstyle="butt")
        axes.annotate(
            "fan",
            (middle[0], middle[1]),
            xytext=(-6, 0),
            textcoords="offset points",
            ha="right",
            va="center",
            bbox=PLATE,
        )


def _draw_series(axes: Axes, flight: Flight) -> None:
    for i, (name, color) in enumerate(AXES.items()):
        axes.plot(flight.time, flight["wind"][:, i], color=color, linewidth=1.0, label=name.upper())
    axes.set(xlabel="time (s)", ylabel="wind (m/s)")
    largest = float(np.abs(flight["wind"]).max())
    if largest < _STILL:
        axes.set_ylim(-1.0, 1.0)
    axes.set_title("At the vehicle", loc="left")
    axes.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
