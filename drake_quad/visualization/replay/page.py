"""Replays of flights as a single page for any browser, without access to the internet."""

import html
from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
from matplotlib.colors import to_hex, to_rgb
from pydrake.geometry import Meshcat, MeshcatAnimation, Sphere
from pydrake.math import RigidTransform

from drake_quad.files import output_folder, write_text
from drake_quad.flight.flight import Flight
from drake_quad.signals import RotorSpeed, State, Wind
from drake_quad.visualization.places import places
from drake_quad.visualization.replay.scene import SceneRoom, draw_surroundings, local_meshcat, wind_blows_elsewhere
from drake_quad.visualization.replay.shapes import (
    ERRORS,
    TRAIL_PIECE,
    Frame,
    draw_arrow,
    draw_quadrotor,
    draw_trail_piece,
    pose_of,
    quadrotor_mesh,
    rgba,
    rotor_poses,
    shrunk,
    turned_by,
    wind_arrow,
)
from drake_quad.visualization.replay.story import story
from drake_quad.visualization.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION

FRAMES_PER_SECOND = 30.0
SWARM_FRAMES_PER_SECOND = 10.0
_BODIES = (BLACK, VERMILION, BLUE, GREEN, PURPLE, ORANGE, SKY)
_RED = "#CC0000"


def save_replay(flights: Mapping[str, Flight], path: Path | str) -> Path:
    """Write a page that replays flights of one reference together, each vehicle drawn in full.

    Args:
        flights: flights by their names on the page. The trail of a single flight is coloured by its error.
        path: path of the file, whose folder is created if necessary.

    Raises:
        InputError: the file cannot be written.
    """
    meshcat = local_meshcat()
    flights = {name: _seen(flight) for name, flight in flights.items()}
    room = draw_replay(meshcat, flights)
    vehicles = {name: f"/{_key(name)}" for name in flights}
    groups = {name: [flight] for name, flight in flights.items()}
    told = story(groups, _body_colors(flights), vehicles, room)
    legend = _color_bar(_top_error(flights)) if len(flights) == 1 else ""
    return _write(meshcat, path, ", ".join(flights), legend, _duration(flights.values()), told)


def draw_replay(meshcat: Meshcat, flights: Mapping[str, Flight]) -> SceneRoom:
    """Draw flights of one reference in a scene that can be played and scrubbed.

    Args:
        meshcat: server that shows the scene.
        flights: as for `save_replay`.

    Returns:
        The room around the flights.
    """
    flights = {name: _seen(flight) for name, flight in flights.items()}
    first = next(iter(flights.values()))
    room = draw_surroundings(meshcat, first.scenario, first.plan, _places(flights.values()))
    meshcat.StartRecording(FRAMES_PER_SECOND, set_visualizations_while_recording=False)
    animation = meshcat.get_mutable_recording()
    last, top = _last_frame(flights.values(), FRAMES_PER_SECOND), _top_error(flights)
    for name, color in _body_colors(flights).items():
        where, trail = f"/{_key(name)}", color if len(flights) > 1 else None
        _animate_vehicle(meshcat, animation, where, flights[name], color, last)
        _animate_trail(meshcat, animation, f"{where}_trail", flights[name], trail, top, last)
    _animate_reference(meshcat, animation, max(flights.values(), key=lambda flight: len(flight.time)), last)
    _publish(meshcat, animation)
    return room


def save_swarm(flights: Mapping[str, list[Flight]], path: Path | str) -> Path:
    """Write a page that replays many flights as simple shapes, with crashing vehicles in red.

    Args:
        flights: flights by the name of their controller; each controller has its own colour.
        path: as for `save_replay`.
    """
    meshcat = local_meshcat()
    flights = {name: [_seen(flight) for flight in group] for name, group in flights.items()}
    everyone = [flight for group in flights.values() for flight in group]
    room = draw_surroundings(meshcat, everyone[0].scenario, everyone[0].plan, _places(everyone))
    meshcat.StartRecording(SWARM_FRAMES_PER_SECOND, set_visualizations_while_recording=False)
    animation = meshcat.get_mutable_recording()
    colors = dict(zip(flights, (_BODIES[2 + i % 5] for i in range(len(flights))), strict=True))
    last = _last_frame(everyone, SWARM_FRAMES_PER_SECOND)
    for name, group in flights.items():
        for number, flight in enumerate(group):
            crashed = bool(flight.metrics.crashed)
            body = rgba(_RED) if crashed else rgba(colors[name], 0.6)
            where = f"/{_key(name)}/{number}"
            meshcat.SetTriangleMesh(f"{where}/body", *quadrotor_mesh(Frame.of(flight.scenario.vehicle)), body)
            for frame, tick in _frames(flight, SWARM_FRAMES_PER_SECOND, last):
                animation.SetTransform(frame, where, pose_of(State(*flight["state"][tick])))
            line = places(flight.record("state"))[:: max(len(flight.time) // 150, 1)].T
            shade = rgba(_RED) if crashed else rgba(_tint(colors[name]))
            meshcat.SetLine(f"/{_key(name)}_trails/{number}", np.ascontiguousarray(line), 1.0, shade)
    _animate_reference(meshcat, animation, max(everyone, key=lambda flight: len(flight.time)), last)
    _publish(meshcat, animation)
    crashes = sum(bool(flight.metrics.crashed) for flight in everyone)
    title = f"{len(everyone)} flights, {crashes} crashed"
    vehicles = {f"{name} {i}": f"/{_key(name)}/{i}" for name, group in flights.items() for i in range(len(group))}
    legend = f'<div><span style="color:{_RED}">●</span> crashed</div>' if crashes else ""
    return _write(meshcat, path, title, legend, _duration(everyone), story(flights, colors, vehicles, room))


def _seen(flight: Flight) -> Flight:
    """Return the part of a flight before its state is no longer finite."""
    finite = np.isfinite(flight["state"]).all(axis=1)
    if finite.all():
        return flight
    count = int(np.argmin(finite))
    signals = {name: values[:count] for name, values in flight.signals.items()}
    return replace(flight, time=flight.time[:count], signals=signals)


def _animate_vehicle(
    meshcat: Meshcat, animation: MeshcatAnimation, where: str, flight: Flight, color: str, last: int
) -> None:
    body = Frame.of(flight.scenario.vehicle)
    draw_quadrotor(meshcat, where, body, color)
    frames = _frames(flight, FRAMES_PER_SECOND, last)
    angles = np.zeros(4)
    for frame, tick in frames:
        animation.SetTransform(frame, where, pose_of(State(*flight["state"][tick])))
        for number, pose in enumerate(rotor_poses(body.rotors, angles), start=1):
            animation.SetTransform(frame, f"{where}/rotor_{number}", pose)
        angles += turned_by(body.rotors, RotorSpeed(*flight["rotor_speed"][tick]), 1.0 / FRAMES_PER_SECOND)
    if _blows_unseen(flight):
        draw_arrow(meshcat, f"{where}_wind/arrow")
        for frame, tick in frames:
            pose, scale = wind_arrow(Wind(*flight["wind"][tick]), State(*flight["state"][tick]))
            animation.SetTransform(frame, f"{where}_wind", pose)
            animation.SetProperty(frame, f"{where}_wind/arrow", "scale", scale)


def _blows_unseen(flight: Flight) -> bool:
    """Return whether a flight has wind that does not come from the fans of the scenario."""
    of_the_users = not flight.scenario.laboratory.wind and bool(flight["wind"].any())
    return of_the_users or wind_blows_elsewhere(flight.scenario)


def _animate_trail(
    meshcat: Meshcat, animation: MeshcatAnimation, where: str, flight: Flight, color: str | None, top: float, last: int
) -> None:
    """Draw the trail as pieces of a tube, each of which appears when the vehicle leaves it.

    Args:
        meshcat: server that shows the scene.
        animation: animation in which the pieces appear.
        where: path of the pieces in the scene.
        flight: flight with the trail.
        color: colour of the trail; None to colour it by the error.
        top: error at the end of the colour map, m.
        last: number of the last frame of the animation.
    """
    times = np.arange(0.0, flight.time[-1], TRAIL_PIECE)
    errors, path = flight.euclidean_error, places(flight.record("state"))
    size = shrunk(Frame.of(flight.scenario.vehicle).rotors)
    for number, start in enumerate(times):
        ticks = np.searchsorted(flight.time, np.linspace(start, min(start + TRAIL_PIECE, flight.time[-1]), 5) - 1e-9)
        piece = f"{where}/{number}"
        shades = color if color is not None else errors[ticks] / max(top, 1e-9)
        draw_trail_piece(meshcat, piece, path[ticks], shades, size)
        frame = max(round(flight.time[ticks[-1]] * FRAMES_PER_SECOND), 1)
        animation.SetProperty(0, piece, "visible", False)
        for shown in (frame, max(last, frame)):
            animation.SetProperty(shown, piece, "visible", True)


def _animate_reference(meshcat: Meshcat, animation: MeshcatAnimation, flight: Flight, last: int) -> None:
    size = shrunk(Frame.of(flight.scenario.vehicle).rotors)
    meshcat.SetObject("/reference/point", Sphere(size * 0.04), rgba("0.3", 0.8))
    path = places(flight.record("reference"))
    for frame, tick in _frames(flight, animation.frames_per_second(), last):
        animation.SetTransform(frame, "/reference", RigidTransform(path[tick]))


def _frames(flight: Flight, frames_per_second: float, last: int) -> list[tuple[int, int]]:
    """Return the numbers of the frames of a flight, each with the tick that it shows.

    The browser repeats a motion after its own last frame, so each motion has a frame at the end of the longest flight.
    """
    count = int(np.floor(flight.time[-1] * frames_per_second)) + 1
    ticks = np.searchsorted(flight.time, np.arange(count) / frames_per_second + 1e-9, side="right") - 1
    frames = list(enumerate(ticks.tolist()))
    return frames if count > last else [*frames, (last, frames[-1][1])]


def _duration(flights: Iterable[Flight]) -> float:
    """Return the duration of the longest flight, s."""
    return max(float(flight.time[-1]) for flight in flights)


def _last_frame(flights: Iterable[Flight], frames_per_second: float) -> int:
    return int(np.floor(_duration(flights) * frames_per_second))


def _top_error(flights: Mapping[str, Flight]) -> float:
    return max(float(flight.euclidean_error.max()) for flight in flights.values())


def _body_colors(names: Iterable[str]) -> dict[str, str]:
    return {name: _BODIES[i % len(_BODIES)] for i, name in enumerate(names)}


def _places(flights: Iterable[Flight]) -> np.ndarray:
    """Return the positions (n, 3) of all vehicles at all ticks, m."""
    return np.vstack([places(flight.record("state")) for flight in flights])


def _publish(meshcat: Meshcat, animation: MeshcatAnimation) -> None:
    animation.set_repetitions(1000)
    meshcat.StopRecording()
    meshcat.PublishRecording()


def _write(meshcat: Meshcat, path: Path | str, title: str, legend: str, duration: float, told: str) -> Path:
    target = Path(path)
    output_folder(target.parent)
    overlay = files(__package__).joinpath("overlay.html").read_text(encoding="utf-8")
    # The story is inserted last, so that no name in it is taken for a field.
    fields = {"title": html.escape(title), "legend": legend, "duration": f"{duration:.3f}", "story": told}
    for field, text in fields.items():
        overlay = overlay.replace(f"{{{field}}}", text, 1)
    return write_text(target, meshcat.StaticHtml().replace("</body>", f"{overlay}</body>"))


def _color_bar(top: float) -> str:
    stops = ", ".join(to_hex(ERRORS(x)) for x in np.linspace(0.0, 1.0, 9))
    return (
        '<span class="row"><span>trail: error 0</span>'
        f'<span style="width:110px;height:9px;background:linear-gradient(to right, {stops})"></span>'
        f"<span>{100.0 * top:.3g} cm</span></span>"
    )


def _tint(color: str) -> str:
    """Return a colour mixed with white, since lines cannot be transparent."""
    red, green, blue = (0.25 * each + 0.75 for each in to_rgb(color))
    return to_hex((red, green, blue))


def _key(name: str) -> str:
    """Return a name as a component of a path in Meshcat."""
    return "".join(letter if letter.isalnum() else "_" for letter in name)
