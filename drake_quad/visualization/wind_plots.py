"""Plot of the wind of a flight: the mean wind in space, and the wind at the vehicle over time."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from drake_quad.flight.flight import Flight
from drake_quad.laboratory.wind.fans import Jet, jet_speed
from drake_quad.scenario.winds.source import jets, steady_wind
from drake_quad.signals import State, Wind
from drake_quad.visualization.curves import dash_overlapping_curves
from drake_quad.visualization.positions import coordinates_by_axis
from drake_quad.visualization.style import (
    AXIS_COLORS,
    BLACK,
    LEGEND_ABOVE,
    REFERENCE,
    SKY,
    TEXT_BACKGROUND,
    new_figure,
    shading,
    use_style,
)

# Number of arrows along the longer side of a map.
_NUM_ARROWS = 30
# Number of arrows along each side of the plot of a uniform wind.
_NUM_UNIFORM_ARROWS = 4
# Sum of the widths of two maps side by side, inches.
_MAP_SIZE = 8.0
# Number of grid points of the wind speed along the longer side of a map.
_NUM_SHADES = 300
# Margin of the maps around path and fans, m.
_MARGIN = 0.7
# Air below this speed, m/s, counts as still. Maps of still air are not drawn.
_MAX_STILL_AIR_SPEED = 1e-3
_ORIGIN = State(*(0.0,) * len(State._fields))  # state at rest at the origin of W


class _Room(NamedTuple):
    """Region that the maps show.

    Attributes:
        low: lower end by axis, m.
        high: upper end by axis, m.
    """

    low: dict[str, float]
    high: dict[str, float]

    def length(self, axis: str) -> float:
        """Return the length along an axis, m."""
        return self.high[axis] - self.low[axis]


class _Plane(NamedTuple):
    """Plane that a map shows.

    Attributes:
        across: name of the axis of W that points to the right in the map.
        up: name of the axis of W that points upwards in the map.
        normal: name of the axis of W that is normal to the plane.
        level: coordinate of the plane on the normal axis, m.
    """

    across: str
    up: str
    normal: str
    level: float


class _Field(NamedTuple):
    """Mean wind in a plane.

    Attributes:
        across: horizontal coordinates in the map, (n,), m.
        up: vertical coordinates in the map, (m,), m.
        velocity: velocity of the air by axis, (m, n), m/s.
        speed: speed of the air, (m, n), m/s.
    """

    across: np.ndarray
    up: np.ndarray
    velocity: dict[str, np.ndarray]
    speed: np.ndarray


def plot_wind(flight: Flight) -> Figure:
    """Plot the mean wind, and the wind at the vehicle over time.

    The mean wind consists of steady wind and the jets of fans. If there are jets, maps show it in a horizontal and a
    vertical plane. Otherwise, the mean wind is uniform, and arrows and a title show its direction and speed. The wind
    at the vehicle includes gusts and turbulence.
    """
    fans, steady = jets(flight.scenario.laboratory.wind), steady_wind(flight.scenario.laboratory.wind)
    with use_style():
        if fans:
            return _plot_maps(flight, fans)
        if float(np.linalg.norm(steady)) > _MAX_STILL_AIR_SPEED:
            return _plot_uniform_wind(flight, steady)
        figure = new_figure(9.0, 2.6)
        _draw_series(figure.subplots(), flight)
        return figure


def _plot_maps(flight: Flight, fans: tuple[Jet, ...]) -> Figure:
    """Plot the mean wind in a horizontal plane, with X to the right and Y up, and in a vertical plane."""
    room = _room(flight, fans)
    # The planes pass through the first fan. The vertical plane contains the longer side of the region.
    outlet, is_tall = fans[0].outlet._asdict(), room.length("y") > room.length("x")
    long_axis, normal = ("y", "x") if is_tall else ("x", "y")
    planes = _Plane("x", "y", "z", outlet["z"]), _Plane(long_axis, "z", normal, outlet[normal])
    fields = [_mean_wind(flight, plane, room) for plane in planes]
    top = max(float(field.speed.max()) for field in fields)
    x, y, z = (room.length(axis) for axis in AXIS_COLORS)
    if is_tall:  # the horizontal plane is on the left, and the vertical plane is beside it
        scale = _MAP_SIZE / (x + y)
        figure = new_figure(1.8 + _MAP_SIZE, max(1.4 + scale * y, 3.0 + scale * z))
        grid = figure.add_gridspec(2, 2, width_ratios=[x, y], height_ratios=[z, max(y - z, 0.6 * z)])
        above, side, series = (figure.add_subplot(grid[place]) for place in (np.s_[:, 0], np.s_[0, 1], np.s_[1, 1]))
    else:
        figure = new_figure(9.0, 2.6 + 7.2 * (y + z) / x)
        above, side, series = figure.subplots(3, 1, height_ratios=[y / x, z / x, 0.22])
    for axes, plane, field in zip((above, side), planes, fields, strict=True):
        shades = _draw_map(axes, plane, field, top)
        _draw_flight(axes, plane, flight, fans)
    (side if is_tall else above).legend(ncols=2, **LEGEND_ABOVE)
    bar: dict[str, Any] = {"ax": above, "location": "bottom"} if is_tall else {"ax": [above, side], "fraction": 0.05}
    figure.colorbar(shades, label="mean wind speed (m/s)", pad=0.02, **bar)
    _draw_series(series, flight)
    return figure


def _plot_uniform_wind(flight: Flight, wind: Wind) -> Figure:
    """Plot a uniform wind as arrows beside the path, in the X-Y plane, or in X-Z if the wind is mainly vertical."""
    room = _room(flight, ())
    middle = {axis: 0.5 * (room.low[axis] + room.high[axis]) for axis in AXIS_COLORS}
    is_horizontal = float(np.hypot(wind.x, wind.y)) >= abs(wind.z)
    plane = _Plane("x", "y", "z", middle["z"]) if is_horizontal else _Plane("x", "z", "y", middle["y"])
    figure = new_figure(9.5, 3.8)
    (path, series) = figure.subplots(1, 2, width_ratios=[1.0, 1.5])
    across, up = (
        np.linspace(room.low[axis], room.high[axis], 2 * _NUM_UNIFORM_ARROWS + 1)[1::2]
        for axis in (plane.across, plane.up)
    )
    a, b = np.meshgrid(across, up)
    v_a, v_b = getattr(wind, plane.across), getattr(wind, plane.up)
    length = 0.7 * min(room.length(plane.across), room.length(plane.up)) / _NUM_UNIFORM_ARROWS
    arrows: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": float(np.hypot(v_a, v_b)) / length}
    path.quiver(a, b, v_a, v_b, pivot="middle", color=SKY, width=0.012, **arrows)
    _draw_flight(path, plane, flight, ())
    side = "From above" if is_horizontal else "From the side"
    path.set(xlabel=f"{plane.across.upper()} (m)", ylabel=f"{plane.up.upper()} (m)")
    path.set_title(side, loc="left")
    path.set_aspect("equal", adjustable="datalim")
    path.grid(visible=False)
    path.legend(ncols=2, **LEGEND_ABOVE)
    _draw_series(series, flight)
    dash_overlapping_curves(series)
    figure.suptitle(f"Uniform mean wind: {_direction_text(wind)}", x=0.01, ha="left", fontsize=11)
    return figure


def _direction_text(wind: Wind) -> str:
    """Return speed and direction of a wind as text, such as "5.0 m/s from 233° to 53° (0° is X, 90° is Y)"."""
    horizontal, parts = float(np.hypot(wind.x, wind.y)), []
    if horizontal > _MAX_STILL_AIR_SPEED:
        heading = round(float(np.degrees(np.arctan2(wind.y, wind.x)))) % 360
        parts.append(f"{horizontal:.1f} m/s from {(heading + 180) % 360}° to {heading}° (0° is X, 90° is Y)")
    if abs(wind.z) > _MAX_STILL_AIR_SPEED:
        parts.append(f"{abs(wind.z):.1f} m/s {'upwards' if wind.z > 0.0 else 'downwards'}")
    return " and ".join(parts)


def _room(flight: Flight, fans: tuple[Jet, ...]) -> _Room:
    """Return the region above the ground that contains both paths and all fans with a margin."""
    actual, reference = coordinates_by_axis(flight.record("state")), coordinates_by_axis(flight.record("reference"))
    finite = np.all([np.isfinite(actual[axis]) for axis in AXIS_COLORS], axis=0)  # a vehicle may have diverged
    ends = {
        axis: [*actual[axis][finite], *reference[axis], *(getattr(jet.outlet, axis) for jet in fans)]
        for axis in AXIS_COLORS
    }
    low = {axis: min(coordinates) - _MARGIN for axis, coordinates in ends.items()}
    low["z"] = max(low["z"], 0.0)
    return _Room(low, {axis: max(coordinates) + _MARGIN for axis, coordinates in ends.items()})


def _mean_wind(flight: Flight, plane: _Plane, room: _Room) -> _Field:
    """Return the mean wind in a plane."""
    spacing = max(room.length(plane.across), room.length(plane.up)) / _NUM_SHADES
    across, up = (np.arange(room.low[axis], room.high[axis], spacing) for axis in (plane.across, plane.up))
    a, b = np.meshgrid(across, up)
    position: Any = _ORIGIN._replace(**{plane.across: a, plane.up: b, plane.normal: np.full_like(a, plane.level)})
    steady = steady_wind(flight.scenario.laboratory.wind)
    velocity = {axis: np.full_like(a, getattr(steady, axis)) for axis in AXIS_COLORS}
    for jet in jets(flight.scenario.laboratory.wind):
        speed, _ = jet_speed(position, jet)
        for axis, part in velocity.items():
            part += speed * getattr(jet.direction, axis)
    return _Field(across, up, velocity, np.linalg.norm(list(velocity.values()), axis=0))


def _draw_map(axes: Axes, plane: _Plane, field: _Field, top: float) -> QuadMesh:
    """Draw the wind speed as colours, and the wind velocity as arrows where it is not negligible."""
    across, up, velocity, speed = field
    shades = axes.pcolormesh(across, up, speed, cmap=shading(), vmin=0.0, vmax=top, rasterized=True)
    step = _NUM_SHADES // _NUM_ARROWS
    thinned = slice(step // 2, None, step), slice(step // 2, None, step)
    is_windy = speed[thinned] > 0.03 * top
    a, b = (coordinate[thinned][is_windy] for coordinate in np.meshgrid(across, up))
    v_a, v_b = (velocity[axis][thinned][is_windy] for axis in (plane.across, plane.up))
    per_metre = top / (step * float(np.diff(across[:2]).item()))  # the longest arrow ends where the next begins
    axes.quiver(a, b, v_a, v_b, color="0.25", angles="xy", scale_units="xy", scale=per_metre, width=0.0016)
    axes.set(xlabel=f"{plane.across.upper()} (m)", ylabel=f"{plane.up.upper()} (m)")
    side = "From the side" if plane.up == "z" else "From above"
    axes.set_title(f"{side}: wind at {plane.normal.upper()} = {plane.level:.1f} m".replace("-", "−"), loc="left")
    axes.set_aspect("equal")
    axes.grid(visible=False)
    return shades


def _draw_flight(axes: Axes, plane: _Plane, flight: Flight, fans: tuple[Jet, ...]) -> None:
    """Draw the flown path and the reference, and the outlets of the fans as bars normal to their jets."""

    def coordinates(record: Any) -> tuple[Any, Any]:
        """Return the coordinates of a record along the axes of the plane."""
        return getattr(record, plane.across), getattr(record, plane.up)

    axes.plot(*coordinates(flight.record("reference")), label="reference", **REFERENCE)
    flown = coordinates(flight.record("state"))
    axes.plot(*flown, color=BLACK, linewidth=1.0, label="flown")
    axes.plot(flown[0][:1], flown[1][:1], "o", color=BLACK, markersize=3.0)  # otherwise a hover would be invisible
    for jet in fans:
        (x, y), (along_x, along_y), half = coordinates(jet.outlet), coordinates(jet.direction), 0.5 * jet.diameter
        bar = [x + half * along_y, x - half * along_y], [y - half * along_x, y + half * along_x]
        axes.plot(*bar, color="0.35", linewidth=4.0, solid_capstyle="butt")
        behind = (-16.0 * along_x, -12.0 * along_y)
        label: dict[str, Any] = {"xytext": behind, "textcoords": "offset points", "ha": "center", "va": "center"}
        axes.annotate("fan", (x, y), bbox=TEXT_BACKGROUND, **label)


def _draw_series(axes: Axes, flight: Flight) -> None:
    """Draw the wind at the vehicle over time."""
    wind = flight.record("wind")
    for axis, color in AXIS_COLORS.items():
        axes.plot(flight.time, getattr(wind, axis), color=color, linewidth=1.0, label=axis.upper())
    axes.set(xlabel="time (s)", ylabel="wind (m/s)")
    if float(np.abs(wind).max()) < _MAX_STILL_AIR_SPEED:
        axes.set_ylim(-1.0, 1.0)
    axes.set_title("At the vehicle", loc="left")
    axes.legend(ncols=3, **LEGEND_ABOVE)
