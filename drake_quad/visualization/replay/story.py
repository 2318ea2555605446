"""Data of a replay page beside the scene: errors and speeds over time, names, and labels of the room."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from drake_quad.flight.flight import Flight
from drake_quad.visualization.curves import quantiles_over_flights
from drake_quad.visualization.replay.scene import SceneRoom
from drake_quad.visualization.replay.shapes import Frame
from drake_quad.visualization.style import AXES

# Largest number of instants in the plot, and smallest time step (s).
_INSTANTS, _SHORTEST = 800, 0.05
_OBSTACLE = "#555555"
# Quantiles at the ends of the band of many flights.
_BAND = (0.05, 0.95)


def story(
    groups: Mapping[str, Sequence[Flight]], colors: Mapping[str, str], vehicles: Mapping[str, str], room: SceneRoom
) -> str:
    """Return the data of a page as JSON.

    A group of several flights is summarised by the median over the vehicles in flight, and by the band from 5 to 95 %.

    Args:
        groups: flights by the name of the curve.
        colors: colour of each curve.
        vehicles: path of each vehicle in the scene by name, in the order of the flights.
        room: room that was drawn.
    """
    flights = [flight for group in groups.values() for flight in group]
    duration = max(float(flight.time[-1]) for flight in flights)
    step = max(_SHORTEST, duration / _INSTANTS)
    times = np.arange(0.0, duration + 1e-9, step)
    sizes = [Frame.of(flight.scenario.vehicle).reach for flight in flights]
    marks = _marks(room)
    told = {
        "duration": duration,
        "step": step,
        "curves": [{"name": name, "color": colors[name], **_curve(group, times)} for name, group in groups.items()],
        "vehicles": [
            {"name": name, "path": path, "size": size}
            for (name, path), size in zip(vehicles.items(), sizes, strict=True)
        ],
        "frame": [*np.round(room.seen, 3).tolist(), *(mark["at"] for mark in marks)],
        "marks": marks,
    }
    # A name must not close the script element that contains it.
    return json.dumps(told, separators=(",", ":"), allow_nan=False).replace("</", "<\\/")


def _curve(group: Sequence[Flight], times: np.ndarray) -> dict[str, Any]:
    """Return error (cm) with its band, speed (m/s), and times (s) and obstacles of crashes for a group of flights."""
    errors, speeds = np.full((2, len(group), len(times)), np.nan)
    for flight, error, speed in zip(group, errors, speeds, strict=True):
        there = times <= flight.time[-1] + 1e-9
        state = flight.record("state")
        ticks = np.searchsorted(flight.time, times[there] + 1e-9, side="right") - 1
        error[there] = 100.0 * flight.euclidean_error[ticks]
        speed[there] = np.sqrt(state.v_x**2 + state.v_y**2 + state.v_z**2)[ticks]
    crashed = sorted((f for f in group if f.metrics.crashed), key=lambda f: float(f.metrics.crash_time))
    low, middle, high = quantiles_over_flights(errors, (_BAND[0], 0.5, _BAND[1]))
    (speed,) = quantiles_over_flights(speeds, (0.5,))
    told: dict[str, Any] = {
        "crashes": [round(float(f.metrics.crash_time), 3) for f in crashed],
        "into": [f.touched for f in crashed],
        "error": _written(middle),
        "speed": _written(speed),
    }
    return told | ({"low": _written(low), "high": _written(high)} if len(group) > 1 else {})


def _written(values: np.ndarray) -> list[float | None]:
    """Return values with three digits; None for NaN."""
    return [float(f"{value:.3g}") if np.isfinite(value) else None for value in values]


def _marks(room: SceneRoom) -> list[dict[str, Any]]:
    """Return labels in metres along two edges of the floor and up one corner, and the names of obstacles."""
    low, high = room.low, room.high
    out = 0.04 * float(np.max(high - low))
    lines = {
        "x": lambda value: [value, low[1] - out, 0.0],
        "y": lambda value: [high[0] + out, value, 0.0],
        "z": lambda value: [low[0], low[1] - out, value],
    }
    names: list[dict[str, Any]] = []
    numbers: list[dict[str, Any]] = []
    for i, (axis, at) in enumerate(lines.items()):
        end, color = high[i] + (out if axis == "z" else 0.0), AXES[axis]
        names.append({"at": at(end), "text": f"{axis.upper()} (m)", "color": color})
        for value in room.grid(i):
            numbers.append({"at": at(value), "text": f"{value:g}".replace("-", "−"), "color": color})
    obstacles: list[dict[str, Any]] = [{"at": at, "text": name, "color": _OBSTACLE} for name, at in room.names.items()]
    # The order is a priority: if labels overlap, the page shows the first ones.
    return [mark | {"at": [round(float(each), 3) for each in mark["at"]]} for mark in names + numbers + obstacles]
