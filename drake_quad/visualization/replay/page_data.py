"""Data of a replay page in addition to the scene: errors and speeds over time, names, and labels of the room."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drake_quad.flight.flight import Flight
from drake_quad.visualization.curves import quantiles_over_flights
from drake_quad.visualization.replay.scene import SceneRoom
from drake_quad.visualization.replay.shapes import Frame
from drake_quad.visualization.style import AXIS_COLORS

# Largest number of instants in the plot.
_MAX_INSTANTS = 800
# Smallest time step of the plot, s.
_MIN_TIME_STEP = 0.05
_OBSTACLE_COLOR = "#555555"
# Quantiles at the lower and upper edges of the band over many flights.
_BAND_QUANTILES = (0.05, 0.95)


def page_data(
    groups: Mapping[str, Sequence[Flight]], colors: Mapping[str, str], vehicles: Mapping[str, str], room: SceneRoom
) -> str:
    """Return the data of a page as JSON.

    The curve of several flights is the median over the vehicles still in flight, with a band from the 5 % to the 95 %
    quantile.

    Args:
        groups: flights of each curve, by the name of the curve.
        colors: colour of each curve.
        vehicles: path of each vehicle in the scene by name, in the order of the flights.
        room: room that is drawn around the flights.
    """
    flights = [flight for group in groups.values() for flight in group]
    duration = max(float(flight.time[-1]) for flight in flights)
    step = max(_MIN_TIME_STEP, duration / _MAX_INSTANTS)
    times = np.arange(0.0, duration + 1e-9, step)
    sizes = [Frame.of(flight.scenario.vehicle).max_rotor_distance for flight in flights]
    marks = _marks(room)
    data = {
        "duration": duration,
        "step": step,
        "curves": [{"name": name, "color": colors[name], **_curve(group, times)} for name, group in groups.items()],
        "vehicles": [
            {"name": name, "path": path, "size": size}
            for (name, path), size in zip(vehicles.items(), sizes, strict=True)
        ],
        "frame": [*np.round(room.corners, 3).tolist(), *(mark["at"] for mark in marks)],
        "marks": marks,
    }
    # A name that contains "</script>" would end the script if it had no backslash.
    return json.dumps(data, separators=(",", ":"), allow_nan=False).replace("</", "<\\/")


def _curve(group: Sequence[Flight], times: np.ndarray) -> dict[str, Any]:
    """Return the curves of a group of flights in the panel, at given times.

    Returns:
        `error`: median error of the flights, cm.
        `speed`: median speed, m/s.
        `low` and `high`: edges of the band of errors, cm; only for several flights.
        `crashes`: time of each crash, s.
        `into`: name of the obstacle that the vehicle hit in each crash; None if it hit no obstacle.
    """
    errors, speeds = np.full((2, len(group), len(times)), np.nan)
    for flight, error, speed in zip(group, errors, speeds, strict=True):
        in_flight = times <= flight.time[-1] + 1e-9
        state = flight.record("state")
        ticks = np.searchsorted(flight.time, times[in_flight] + 1e-9, side="right") - 1
        error[in_flight] = 100.0 * flight.euclidean_error[ticks]
        speed[in_flight] = np.sqrt(state.v_x**2 + state.v_y**2 + state.v_z**2)[ticks]
    crashed = sorted((f for f in group if f.metrics.crashed), key=lambda f: float(f.metrics.crash_time))
    low, middle, high = quantiles_over_flights(errors, (_BAND_QUANTILES[0], 0.5, _BAND_QUANTILES[1]))
    (speed,) = quantiles_over_flights(speeds, (0.5,))
    curve: dict[str, Any] = {
        "crashes": [round(float(f.metrics.crash_time), 3) for f in crashed],
        "into": [f.obstacle_hit for f in crashed],
        "error": _rounded(middle),
        "speed": _rounded(speed),
    }
    return curve | ({"low": _rounded(low), "high": _rounded(high)} if len(group) > 1 else {})


def _rounded(values: np.ndarray) -> list[float | None]:
    """Return values with three significant digits; None for NaN, which JSON does not support."""
    return [float(f"{value:.3g}") if np.isfinite(value) else None for value in values]


def _marks(room: SceneRoom) -> list[dict[str, Any]]:
    """Return the labels of the room: coordinates along two edges of the floor and one vertical edge, and obstacles."""
    low, high = room.low, room.high
    offset = 0.04 * float(np.max(high - low))
    lines = {
        "x": lambda value: [value, low[1] - offset, 0.0],
        "y": lambda value: [high[0] + offset, value, 0.0],
        "z": lambda value: [low[0], low[1] - offset, value],
    }
    titles: list[dict[str, Any]] = []
    numbers: list[dict[str, Any]] = []
    for i, (axis, position_at) in enumerate(lines.items()):
        end, color = high[i] + (offset if axis == "z" else 0.0), AXIS_COLORS[axis]
        titles.append({"at": position_at(end), "text": f"{axis.upper()} (m)", "color": color})
        for value in room.grid(i):
            numbers.append({"at": position_at(value), "text": f"{value:g}".replace("-", "−"), "color": color})
    obstacles: list[dict[str, Any]] = [
        {"at": position_at, "text": name, "color": _OBSTACLE_COLOR} for name, position_at in room.names.items()
    ]
    # If labels overlap, the page shows only the first one, so the labels are in the order of their priority.
    return [mark | {"at": [round(float(each), 3) for each in mark["at"]]} for mark in titles + numbers + obstacles]
