"""Plot of the wind of a flight: maps of the mean wind, and the wind at the vehicle over time."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from drake_quad.flight.flight import Flight
from drake_quad.laboratory.wind.fans import Jet, jet_speed
from drake_quad.scenario.winds.source import jets, steady_wind
from drake_quad.signals import State
from drake_quad.visualization.positions import coordinates_by_axis
from drake_quad.visualization.style import AXES, BLACK, REFERENCE, TEXT_BACKGROUND, new_figure, shading, styled

# Number of arrows along the width of a map.
_NUM_ARROWS = 30
# Number of grid points of the wind speed along the width of a map.
_NUM_SHADES = 300
# Margin of the maps around path and fans, m.
_MARGIN = 0.7
# Air below this speed, m/s, counts as still. Maps of still air are not drawn.
_MAX_STILL_AIR_SPEED = 1e-3
_ORIGIN = State(*(0.0,) * len(State._fields))


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
    """Plot the mean wind in a horizontal and in a vertical plane, and the wind at the vehicle over time.

    The maps show the mean wind: steady wind and the jets of fans. The wind at the vehicle includes gusts and
    turbulence.
    """
    fans = jets(flight.scenario.laboratory.wind)
    room = _room(flight, fans)
    # The planes pass through the first fan, or without fans through the middle of the region. Their longer side is
    # horizontal.
    middle = {axis: 0.5 * (room.low[axis] + room.high[axis]) for axis in AXES}
    if fans:
        middle = fans[0].outlet._asdict()
    long_axis, short_axis = ("y", "x") if room.length("y") > room.length("x") else ("x", "y")
    planes = _Plane(long_axis, short_axis, "z", middle["z"]), _Plane(long_axis, "z", short_axis, middle[short_axis])
    heights = [room.length(plane.up) / room.length(long_axis) for plane in planes]
    fields = [_mean_wind(flight, plane, room) for plane in planes]
    top = max(float(field.speed.max()) for field in fields)
    with styled():
        if top < _MAX_STILL_AIR_SPEED:
            figure = new_figure(9.0, 2.6)
            _draw_series(figure.subplots(), flight)
            return figure
        figure = new_figure(9.0, 2.6 + 7.2 * sum(heights))
        above, side, series = figure.subplots(3, 1, height_ratios=[*heights, 0.22])
        for axes, plane, field in zip((above, side), planes, fields, strict=True):
            shades = _draw_map(axes, plane, field, top)
            _draw_flight(axes, plane, flight, fans)
        if long_axis == "y":
            above.invert_yaxis()  # seen from above, X is to the right of Y
        above.legend(ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0))
        figure.colorbar(shades, ax=[above, side], label="mean wind speed (m/s)", pad=0.02, fraction=0.05)
        _draw_series(series, flight)
        return figure


def _room(flight: Flight, fans: tuple[Jet, ...]) -> _Room:
    """Return the region above the ground that contains both paths and all fans with a margin."""
    actual, reference = coordinates_by_axis(flight.record("state")), coordinates_by_axis(flight.record("reference"))
    finite = np.all([np.isfinite(actual[axis]) for axis in AXES], axis=0)  # a vehicle may have diverged
    ends = {
        axis: [*actual[axis][finite], *reference[axis], *(getattr(jet.outlet, axis) for jet in fans)] for axis in AXES
    }
    low = {axis: min(coordinates) - _MARGIN for axis, coordinates in ends.items()}
    low["z"] = max(low["z"], 0.0)
    return _Room(low, {axis: max(coordinates) + _MARGIN for axis, coordinates in ends.items()})


def _mean_wind(flight: Flight, plane: _Plane, room: _Room) -> _Field:
    """Return the mean wind in a plane."""
    spacing = room.length(plane.across) / _NUM_SHADES
    across, up = (np.arange(room.low[axis], room.high[axis], spacing) for axis in (plane.across, plane.up))
    a, b = np.meshgrid(across, up)
    position: Any = _ORIGIN._replace(**{plane.across: a, plane.up: b, plane.normal: np.full_like(a, plane.level)})
    steady = steady_wind(flight.scenario.laboratory.wind)
    velocity = {axis: np.full_like(a, getattr(steady, axis)) for axis in AXES}
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
    per_metre = top / (step * float(np.diff(across[:2]).item()))  # the longest arrow reaches to the next one
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
    axes.plot(*coordinates(flight.record("state")), color=BLACK, linewidth=1.0, label="flown")
    for jet in fans:
        (x, y), (along_x, along_y), half = coordinates(jet.outlet), coordinates(jet.direction), 0.5 * jet.diameter
        bar = [x + half * along_y, x - half * along_y], [y - half * along_x, y + half * along_x]
        axes.plot(*bar, color="0.35", linewidth=4.0, solid_capstyle="butt")
        label: dict[str, Any] = {"xytext": (-6, 0), "textcoords": "offset points", "ha": "right", "va": "center"}
        axes.annotate("fan", (x, y), bbox=TEXT_BACKGROUND, **label)


def _draw_series(axes: Axes, flight: Flight) -> None:
    """Draw the wind at the vehicle over time."""
    wind = flight.record("wind")
    for axis, color in AXES.items():
        axes.plot(flight.time, getattr(wind, axis), color=color, linewidth=1.0, label=axis.upper())
    axes.set(xlabel="time (s)", ylabel="wind (m/s)")
    if float(np.abs(wind).max()) < _MAX_STILL_AIR_SPEED:
        axes.set_ylim(-1.0, 1.0)
    axes.set_title("At the vehicle", loc="left")
    axes.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
