"""Export of flights as MCAP files, whose messages Foxglove displays without configuration.

MCAP is a container format for robot logs. The messages are JSON, and the schemas are JSON Schema. Each flight has these
topics, where NAME is the name of the flight:

| topic | schema | content |
|---|---|---|
| `/NAME/tf` | `foxglove.FrameTransform` | transform from `world` (W) to `NAME/body` (B) |
| `/NAME/reference` | `foxglove.PoseInFrame` | desired position and yaw of the vehicle |
| `/NAME/scene` | `foxglove.SceneUpdate` | shapes of the vehicle, the reference and the path; a single message |
| `/NAME/log` | `foxglove.Log` | crash, if there is one |
| `/NAME/signals/SIGNAL` | `drake_quad.SIGNAL` | signal at every tick, with the names of its rows |

The time of a message is the simulated time, which starts at 0. The scenario is attached as YAML, so that it can be
simulated again. The names and types of the foxglove schemas are from the Foxglove SDK
(github.com/foxglove/foxglove-sdk, schemas/jsonschema). The schemas are reduced to the parts that are used.
"""

import heapq
import io
import json
import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from drake_quad.errors import InputError
from drake_quad.extras import import_extra
from drake_quad.files import write_atomically
from drake_quad.flight.flight import Flight
from drake_quad.flight.formats.flight_format import FORMATS, FlightFormat
from drake_quad.geometry.quaternion import Quaternion
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.layouts import rotors_of
from drake_quad.signals import SIGNALS, Reference, State, quantities, row_names

_NANOSECONDS_PER_SECOND = 10**9
_WORLD_FRAME = "world"  # name of the world frame W
# The dimensions of drawn arms and rotors are relative to the vehicle radius: the largest horizontal distance between a
# rotor and the centre of mass.
_ARM_WIDTH = 0.08  # vehicle radii
_ROTOR_WIDTH = 0.9  # vehicle radii
_ROTOR_HEIGHT = 0.06  # vehicle radii
_LINE_WIDTH = 2.0  # pixels
_LINE_STRIP_TYPE = 0  # Foxglove's code of the line type LINE_STRIP
_ERROR_LEVEL = 4  # Foxglove's code of the log level ERROR
# RGB colours of the vehicles and their paths, in the order of the flights. Plots use the same colours (palette of Okabe
# and Ito).
_COLORS = ((0.0, 0.45, 0.70), (0.84, 0.37, 0.0), (0.0, 0.62, 0.45), (0.80, 0.47, 0.65), (0.90, 0.62, 0.0))
_REFERENCE_COLOR = (0.5, 0.5, 0.5)  # RGB colour of the reference, and of all arms except the first one


class Message(NamedTuple):
    """Message of an MCAP file.

    Attributes:
        time: time of the flight, ns.
        topic: name of the topic.
        data: content, which is written as JSON.
    """

    time: int
    topic: str
    data: dict[str, Any]


def save_mcap(flights: Flight | Mapping[str, Flight], path: Path | str) -> Path:
    """Write flights as one MCAP file, and return its path.

    Args:
        flights: flights, keyed by their names in the file; or a single flight, which is named after its scenario.
        path: path of the file.

    Raises:
        InputError: if there is no flight.
        ImportError: if mcap is not installed; the extra `mcap` installs it.
        OSError: if the file cannot be written.
    """
    writer = import_extra("mcap.writer", "mcap").Writer
    named = {flights.scenario.name: flights} if isinstance(flights, Flight) else flights
    if not named:
        raise InputError("there is no flight to write")

    def write(target: Path) -> None:
        with target.open("wb") as stream:
            file = writer(stream)
            file.start(library="drake_quad")
            topics: dict[str, dict[str, Any]] = {}
            for name, flight in named.items():
                topics |= flight_topics(name, flight)
            schemas = {
                title: file.register_schema(title, "jsonschema", json.dumps(schema).encode())
                for title, schema in {schema["title"]: schema for schema in topics.values()}.items()
            }
            channels = {
                topic: file.register_channel(topic, "json", schemas[schema["title"]])
                for topic, schema in topics.items()
            }
            each = [flight_messages(name, flight, i) for i, (name, flight) in enumerate(named.items())]
            for count, message in enumerate(heapq.merge(*each, key=lambda message: message.time)):
                data = json.dumps(message.data, allow_nan=False).encode()
                file.add_message(channels[message.topic], message.time, data, message.time, count)
            for name, flight in named.items():
                file.add_attachment(0, 0, f"{name}/scenario.yaml", "application/yaml", _scenario_text(flight))
                metrics = {metric: f"{value:.12g}" for metric, value in flight.metrics._asdict().items()}
                file.add_metadata(f"{name}/metrics", metrics)
            file.finish()

    return write_atomically(Path(path), write)


def flight_topics(name: str, flight: Flight) -> dict[str, dict[str, Any]]:
    """Return the schemas of a flight's topics, keyed by topic."""
    topics = {
        f"/{name}/tf": FRAME_TRANSFORM,
        f"/{name}/reference": POSE_IN_FRAME,
        f"/{name}/scene": SCENE_UPDATE,
        f"/{name}/log": LOG,
    }
    return topics | {f"/{name}/signals/{signal}": signal_schema(signal, flight) for signal in flight}


def flight_messages(name: str, flight: Flight, number: int) -> Iterator[Message]:
    """Yield the messages of a flight, sorted by time.

    Args:
        name: name of the flight.
        flight: flight to convert.
        number: index of the flight in the file, which determines its colour.
    """
    times = [round(_NANOSECONDS_PER_SECOND * time) for time in flight.time.tolist()]
    state, reference = flight.record("state"), flight.record("reference")
    level: Any = np.zeros(len(times))
    poses = np.column_stack([state.x, state.y, state.z, *Quaternion.of(state.roll, state.pitch, state.yaw)]).tolist()
    desired = [reference.x, reference.y, reference.z, *Quaternion.of(level, level, reference.yaw)]
    desired_poses = np.column_stack(desired).tolist()
    signals = {signal: (_keys(signal, flight), values.tolist()) for signal, values in flight.items()}
    if times:
        yield Message(times[0], f"/{name}/scene", _scene(name, flight, _stamp(times[0]), number))
    for tick, time in enumerate(times):
        stamp = _stamp(time)
        pose = _pose(poses[tick])
        transform = {"timestamp": stamp, "parent_frame_id": _WORLD_FRAME, "child_frame_id": f"{name}/body"}
        transform |= {"translation": pose["position"], "rotation": pose["orientation"]}
        yield Message(time, f"/{name}/tf", transform)
        target = {"timestamp": stamp, "frame_id": _WORLD_FRAME, "pose": _pose(desired_poses[tick])}
        yield Message(time, f"/{name}/reference", target)
        for signal, (keys, values) in signals.items():
            row = [value if math.isfinite(value) else None for value in values[tick]]
            fields = dict(zip(keys, row, strict=True)) if keys else {"values": row}
            yield Message(time, f"/{name}/signals/{signal}", {"timestamp": stamp, **fields})
    if flight.metrics.crashed:
        time = max(round(_NANOSECONDS_PER_SECOND * flight.metrics.crash_time), times[-1] if times else 0)
        text = f"{name} {flight.crash}" + (f": {flight.cause}" if flight.cause else "")
        line = {"level": _ERROR_LEVEL, "message": text, "name": name, "file": "", "line": 0}
        yield Message(time, f"/{name}/log", {"timestamp": _stamp(time), **line})


def _keys(signal: str, flight: Flight) -> list[str]:
    """Return the row names of a signal; an empty list if the rows have no names."""
    return row_names(signal, flight[signal].shape[1]) if hasattr(SIGNALS[signal], "_fields") else []


def _scene(name: str, flight: Flight, stamp: dict[str, int], number: int) -> dict[str, Any]:
    """Return the scene: the shapes of the vehicle in B, and the lines of the reference and of the flown path in W."""
    rotors = rotors_of(flight.scenario.vehicle)
    positions = [np.array([rotor.x, rotor.y, rotor.z]) for rotor in rotors]
    size = max(math.hypot(rotor.x, rotor.y) for rotor in rotors)
    color = _COLORS[number % len(_COLORS)]
    common = {"frame_locked": True, "metadata": [], "lifetime": {"sec": 0, "nsec": 0}, "timestamp": stamp}
    disc, bar = _ROTOR_WIDTH * size, _ARM_WIDTH * size
    discs = [
        {
            "pose": _pose([*position.tolist(), 1.0, 0.0, 0.0, 0.0]),
            "size": {"x": disc, "y": disc, "z": _ROTOR_HEIGHT * size},
            "bottom_scale": 1.0,
            "top_scale": 1.0,
            "color": _color(color, 0.6),
        }
        for position in positions
    ]
    arms = [
        {
            "pose": _pose([*(position / 2).tolist(), *_rotation_about_z(math.atan2(position[1], position[0]))]),
            "size": {"x": float(np.linalg.norm(position)), "y": bar, "z": bar},
            "color": _color(_REFERENCE_COLOR if i else color),
        }
        for i, position in enumerate(positions)
    ]
    vehicle = {
        **common,
        "frame_id": f"{name}/body",
        "id": f"{name}/vehicle",
        **_primitives(cylinders=discs, cubes=arms),
    }
    lines = {
        f"{name}/reference": (_points(flight.record("reference")), _color(_REFERENCE_COLOR)),
        f"{name}/path": (_points(flight.record("state")), _color(color)),
    }
    line_entities = [
        {**common, "frame_id": _WORLD_FRAME, "id": identity, **_primitives(lines=[_line(points, color_of_line)])}
        for identity, (points, color_of_line) in lines.items()
    ]
    return {"deletions": [], "entities": [vehicle, *line_entities]}


def _points(record: State | Reference) -> np.ndarray:
    """Return the (ticks, 3) positions of a state or reference, m."""
    return np.column_stack([record.x, record.y, record.z])


def _primitives(**primitives: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    kinds = ("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models")
    return {kind: primitives.get(kind, []) for kind in kinds}


def _line(points: np.ndarray, color: dict[str, float]) -> dict[str, Any]:
    return {
        "type": _LINE_STRIP_TYPE,
        "pose": _pose([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]),
        "thickness": _LINE_WIDTH,
        "scale_invariant": True,
        "points": [dict(zip("xyz", point, strict=True)) for point in points.tolist()],
        "color": color,
        "colors": [],
        "indices": [],
    }


def _pose(numbers: list[float]) -> dict[str, dict[str, float]]:
    """Return the pose given by seven numbers: x, y, z (m) and the quaternion w, x, y, z."""
    x, y, z, *turn = numbers
    return {"position": {"x": x, "y": y, "z": z}, "orientation": dict(zip("wxyz", turn, strict=True))}


def _rotation_about_z(angle: float) -> list[float]:
    return [math.cos(angle / 2), 0.0, 0.0, math.sin(angle / 2)]


def _color(rgb: tuple[float, float, float], opacity: float = 1.0) -> dict[str, float]:
    return dict(zip("rgba", (*rgb, opacity), strict=True))


def _stamp(time: int) -> dict[str, int]:
    seconds, rest = divmod(time, _NANOSECONDS_PER_SECOND)
    return {"sec": seconds, "nsec": rest}


def _scenario_text(flight: Flight) -> bytes:
    text = io.StringIO()
    save_scenario(flight.scenario, text)
    return text.getvalue().encode()


def _object(title: str, properties: dict[str, Any]) -> dict[str, Any]:
    return {"title": title, "type": "object", "properties": properties, "required": [*properties]}


def _list(items: dict[str, Any] | None = None) -> dict[str, Any]:
    return {"type": "array", "items": items or {"type": "object"}}


def _numbers(title: str, names: str) -> dict[str, Any]:
    return _object(title, dict.fromkeys(names, _NUMBER))


_NUMBER, _INTEGER, _TEXT, _BOOLEAN = ({"type": kind} for kind in ("number", "integer", "string", "boolean"))
_TIME, _DURATION = (_object(title, {"sec": _INTEGER, "nsec": _INTEGER}) for title in ("time", "duration"))
_VECTOR = _numbers("foxglove.Vector3", "xyz")
_POINT = _numbers("foxglove.Point3", "xyz")
_QUATERNION = _numbers("foxglove.Quaternion", "xyzw")
_RGBA = _numbers("foxglove.Color", "rgba")
_POSE = _object("foxglove.Pose", {"position": _VECTOR, "orientation": _QUATERNION})
_CUBE = _object("foxglove.CubePrimitive", {"pose": _POSE, "size": _VECTOR, "color": _RGBA})
_CYLINDER = _object(
    "foxglove.CylinderPrimitive",
    {"pose": _POSE, "size": _VECTOR, "bottom_scale": _NUMBER, "top_scale": _NUMBER, "color": _RGBA},
)
_LINE = _object(
    "foxglove.LinePrimitive",
    {
        "type": _INTEGER,
        "pose": _POSE,
        "thickness": _NUMBER,
        "scale_invariant": _BOOLEAN,
        "points": _list(_POINT),
        "color": _RGBA,
        "colors": _list(_RGBA),
        "indices": _list(_INTEGER),
    },
)
_ENTITY = _object(
    "foxglove.SceneEntity",
    {
        "timestamp": _TIME,
        "frame_id": _TEXT,
        "id": _TEXT,
        "lifetime": _DURATION,
        "frame_locked": _BOOLEAN,
        "metadata": _list(_object("foxglove.KeyValuePair", {"key": _TEXT, "value": _TEXT})),
        "cubes": _list(_CUBE),
        "cylinders": _list(_CYLINDER),
        "lines": _list(_LINE),
        **{kind: _list() for kind in ("arrows", "spheres", "triangles", "texts", "models")},
    },
)
_DELETION = _object("foxglove.SceneEntityDeletion", {"timestamp": _TIME, "type": _INTEGER, "id": _TEXT})
SCENE_UPDATE = _object("foxglove.SceneUpdate", {"deletions": _list(_DELETION), "entities": _list(_ENTITY)})
FRAME_TRANSFORM = _object(
    "foxglove.FrameTransform",
    {
        "timestamp": _TIME,
        "parent_frame_id": _TEXT,
        "child_frame_id": _TEXT,
        "translation": _VECTOR,
        "rotation": _QUATERNION,
    },
)
POSE_IN_FRAME = _object("foxglove.PoseInFrame", {"timestamp": _TIME, "frame_id": _TEXT, "pose": _POSE})
LOG = _object(
    "foxglove.Log",
    {"timestamp": _TIME, "level": _INTEGER, "message": _TEXT, "name": _TEXT, "file": _TEXT, "line": _INTEGER},
)


def signal_schema(signal: str, flight: Flight) -> dict[str, Any]:
    """Return the message schema of a signal. Messages contain null in place of NaN and infinite values."""
    count, keys = flight[signal].shape[1], _keys(signal, flight)
    number = {"type": ["number", "null"]}
    if not keys:
        return _object(f"drake_quad.{signal}", {"timestamp": _TIME, "values": _list(number)})
    described = [
        {**number, "description": quantity.unit + (f", along {quantity.frame}" if quantity.frame else "")}
        for quantity in quantities(signal, count)
    ]
    return _object(f"drake_quad.{signal}", {"timestamp": _TIME, **dict(zip(keys, described, strict=True))})


FORMATS.append(
    FlightFormat(
        "mcap",
        "also write the flight as flight.mcap, for Foxglove",
        "flight.mcap",
        save_mcap,
        library=("mcap.writer", "mcap"),
    )
)
