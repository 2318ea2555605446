"""Replay of flights as a single HTML page, which needs no access to the internet."""

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
from drake_quad.reference.polynomial_path import PolynomialPath
from drake_quad.signals import RotorSpeed, State, Wind
from drake_quad.visualization.positions import positions
from drake_quad.visualization.replay.page_data import page_data
from drake_quad.visualization.replay.scene import SceneRoom, draw_surroundings, has_wind_besides_fans, local_meshcat
from drake_quad.visualization.replay.shapes import (
    ERROR_COLORS,
    TRAIL_PIECE_DURATION,
    Frame,
    draw_arrow,
    draw_quadrotor,
    draw_trail_piece,
    part_scale,
    quadrotor_mesh,
    rgba,
    rotation_angles,
    rotor_poses,
    vehicle_pose,
    wind_arrow,
)
from drake_quad.visualization.style import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY, VERMILION

FRAMES_PER_SECOND = 30.0
"""Frames per second of the animation of a few flights."""
SWARM_FRAMES_PER_SECOND = 10.0
"""Frames per second of the animation of a swarm."""
_BODY_COLORS = (BLACK, VERMILION, BLUE, GREEN, PURPLE, ORANGE, SKY)
_RED = "#CC0000"


def save_replay(flights: Mapping[str, Flight], path: Path | str) -> Path:
    """Write a page that replays several flights in the same room together, with detailed vehicles.

    Args:
        flights: flights by their names on the page. The trail of a single flight is coloured by its position error.
        path: path of the file, whose folder is created if necessary.

    Raises:
        InputError: if the file cannot be written.
    """
    meshcat = local_meshcat()
    flights = {name: _before_divergence(flight) for name, flight in flights.items()}
    room = draw_replay(meshcat, flights)
    vehicles = {name: f"/{_path_component(name)}" for name in flights}
    groups = {name: [flight] for name, flight in flights.items()}
    data = page_data(groups, _body_colors(flights), vehicles, room)
    legend = _color_bar(_top_error(flights)) if len(flights) == 1 else ""
    return _write_page(meshcat, path, ", ".join(flights), legend, _duration(flights.values()), data)


def draw_replay(meshcat: Meshcat, flights: Mapping[str, Flight]) -> SceneRoom:
    """Draw flights in the same room in a Meshcat scene, with an animation that can be played and scrubbed.

    Returns:
        The room that is drawn around the flights.
    """
    flights = {name: _before_divergence(flight) for name, flight in flights.items()}
    references = _flights_with_different_plans(flights.values())
    first, *others = references
    positions_of_all = _all_positions(flights.values())
    plans = [each.plan for each in others]
    room = draw_surroundings(meshcat, first.scenario, first.plan, positions_of_all, other_plans=plans)
    meshcat.StartRecording(FRAMES_PER_SECOND, set_visualizations_while_recording=False)
    animation = meshcat.get_mutable_recording()
    last, top = _last_frame(flights.values(), FRAMES_PER_SECOND), _top_error(flights)
    for name, color in _body_colors(flights).items():
        scene_path, trail = f"/{_path_component(name)}", color if len(flights) > 1 else None
        _animate_vehicle(meshcat, animation, scene_path, flights[name], color, last)
        _animate_trail(meshcat, animation, f"{scene_path}_trail", flights[name], trail, top, last)
    for number, each in enumerate(references, start=1):
        name = "/reference" if number == 1 else f"/reference_{number}"
        _animate_reference(meshcat, animation, each, last, name)
    _publish(meshcat, animation)
    return room


def _flights_with_different_plans(flights: Iterable[Flight]) -> list[Flight]:
    """Return the longest flight of each plan, in the order of the plans."""
    found: list[Flight] = []
    for flight in flights:
        equal = (k for k, each in enumerate(found) if _are_equal(each.plan.path, flight.plan.path))
        k = next(equal, None)
        if k is None:
            found.append(flight)
        elif len(flight.time) > len(found[k].time):
            found[k] = flight
    return found


def _are_equal(first: PolynomialPath, second: PolynomialPath) -> bool:
    return np.array_equal(first.times, second.times) and np.array_equal(first.coefficients, second.coefficients)


def save_swarm(flights: Mapping[str, list[Flight]], path: Path | str) -> Path:
    """Write a page that replays many flights together, with simplified vehicles. Vehicles that crash are red.

    Args:
        flights: flights by the name of their controller; each controller has its own colour.
        path: path of the file, whose folder is created if necessary.

    Raises:
        InputError: if the file cannot be written.
    """
    meshcat = local_meshcat()
    flights = {name: [_before_divergence(flight) for flight in group] for name, group in flights.items()}
    all_flights = [flight for group in flights.values() for flight in group]
    room = draw_surroundings(meshcat, all_flights[0].scenario, all_flights[0].plan, _all_positions(all_flights))
    meshcat.StartRecording(SWARM_FRAMES_PER_SECOND, set_visualizations_while_recording=False)
    animation = meshcat.get_mutable_recording()
    colors = dict(zip(flights, (_BODY_COLORS[2 + i % 5] for i in range(len(flights))), strict=True))
    last = _last_frame(all_flights, SWARM_FRAMES_PER_SECOND)
    for name, group in flights.items():
        for index, flight in enumerate(group):
            crashed = bool(flight.metrics.crashed)
            body = rgba(_RED) if crashed else rgba(colors[name], 0.6)
            scene_path = f"/{_path_component(name)}/{index}"
            meshcat.SetTriangleMesh(f"{scene_path}/body", *quadrotor_mesh(Frame.of(flight.scenario.vehicle)), body)
            for frame, tick in _frames(flight, SWARM_FRAMES_PER_SECOND, last):
                animation.SetTransform(frame, scene_path, vehicle_pose(State(*flight["state"][tick])))
            line = positions(flight.record("state"))[:: max(len(flight.time) // 150, 1)].T
            shade = rgba(_RED) if crashed else rgba(_tint(colors[name]))
            meshcat.SetLine(f"/{_path_component(name)}_trails/{index}", np.ascontiguousarray(line), 1.0, shade)
    _animate_reference(meshcat, animation, max(all_flights, key=lambda flight: len(flight.time)), last, "/reference")
    _publish(meshcat, animation)
    crashes = sum(bool(flight.metrics.crashed) for flight in all_flights)
    title = f"{len(all_flights)} flights, {crashes} crashed"
    vehicles = {
        f"{name} {i}": f"/{_path_component(name)}/{i}" for name, group in flights.items() for i in range(len(group))
    }
    legend = f'<div><span style="color:{_RED}">●</span> crashed</div>' if crashes else ""
    return _write_page(meshcat, path, title, legend, _duration(all_flights), page_data(flights, colors, vehicles, room))


def _before_divergence(flight: Flight) -> Flight:
    """Return the part of a flight before the first state that is NaN or infinite."""
    finite = np.isfinite(flight["state"]).all(axis=1)
    if finite.all():
        return flight
    count = int(np.argmin(finite))
    signals = {name: values[:count] for name, values in flight.signals.items()}
    return replace(flight, time=flight.time[:count], signals=signals)


def _animate_vehicle(
    meshcat: Meshcat, animation: MeshcatAnimation, scene_path: str, flight: Flight, color: str, last: int
) -> None:
    body = Frame.of(flight.scenario.vehicle)
    draw_quadrotor(meshcat, scene_path, body, color)
    frames = _frames(flight, FRAMES_PER_SECOND, last)
    angles = np.zeros(4)
    for frame, tick in frames:
        animation.SetTransform(frame, scene_path, vehicle_pose(State(*flight["state"][tick])))
        for number, pose in enumerate(rotor_poses(body.rotors, angles), start=1):
            animation.SetTransform(frame, f"{scene_path}/rotor_{number}", pose)
        angles += rotation_angles(body.rotors, RotorSpeed(*flight["rotor_speed"][tick]), 1.0 / FRAMES_PER_SECOND)
    if _has_undrawn_wind(flight):
        draw_arrow(meshcat, f"{scene_path}_wind/arrow")
        for frame, tick in frames:
            pose, scale = wind_arrow(Wind(*flight["wind"][tick]), State(*flight["state"][tick]))
            animation.SetTransform(frame, f"{scene_path}_wind", pose)
            animation.SetProperty(frame, f"{scene_path}_wind/arrow", "scale", scale)


def _has_undrawn_wind(flight: Flight) -> bool:
    """Return whether a flight has wind from sources other than fans, whose jets the scene shows."""
    has_wind_in_python = not flight.scenario.laboratory.wind and bool(flight["wind"].any())
    return has_wind_in_python or has_wind_besides_fans(flight.scenario)


def _animate_trail(
    meshcat: Meshcat,
    animation: MeshcatAnimation,
    scene_path: str,
    flight: Flight,
    color: str | None,
    top: float,
    last: int,
) -> None:
    """Draw the trail of a vehicle as pieces of a tube, each of which appears when the vehicle has flown along it.

    Args:
        meshcat: server that shows the scene.
        animation: animation in which the pieces appear.
        scene_path: path of the pieces in the scene.
        flight: flight with the trail.
        color: colour of the trail; None to colour it by the position error.
        top: error at the upper end of the colour map, m.
        last: number of the last frame of the animation.
    """
    times = np.arange(0.0, flight.time[-1], TRAIL_PIECE_DURATION)
    errors, path = flight.euclidean_error, positions(flight.record("state"))
    size = part_scale(Frame.of(flight.scenario.vehicle).rotors)
    for number, start in enumerate(times):
        ticks = np.searchsorted(
            flight.time, np.linspace(start, min(start + TRAIL_PIECE_DURATION, flight.time[-1]), 5) - 1e-9
        )
        piece = f"{scene_path}/{number}"
        shades = color if color is not None else errors[ticks] / max(top, 1e-9)
        draw_trail_piece(meshcat, piece, path[ticks], shades, size)
        frame = max(round(flight.time[ticks[-1]] * FRAMES_PER_SECOND), 1)
        animation.SetProperty(0, piece, "visible", False)
        for shown in (frame, max(last, frame)):
            animation.SetProperty(shown, piece, "visible", True)


def _animate_reference(meshcat: Meshcat, animation: MeshcatAnimation, flight: Flight, last: int, name: str) -> None:
    size = part_scale(Frame.of(flight.scenario.vehicle).rotors)
    meshcat.SetObject(f"{name}/point", Sphere(size * 0.04), rgba("0.3", 0.8))
    path = positions(flight.record("reference"))
    for frame, tick in _frames(flight, animation.frames_per_second(), last):
        animation.SetTransform(frame, name, RigidTransform(path[tick]))


def _frames(flight: Flight, frames_per_second: float, last: int) -> list[tuple[int, int]]:
    """Return the number of each frame in the animation of a flight, with the tick that the frame shows.

    The browser repeats each motion after the last frame of this motion. All motions must repeat together, so each
    motion has a frame at the end of the longest flight.
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
    return {name: _BODY_COLORS[i % len(_BODY_COLORS)] for i, name in enumerate(names)}


def _all_positions(flights: Iterable[Flight]) -> np.ndarray:
    """Return the positions (n, 3) of all vehicles at all ticks, m."""
    return np.vstack([positions(flight.record("state")) for flight in flights])


def _publish(meshcat: Meshcat, animation: MeshcatAnimation) -> None:
    animation.set_repetitions(1000)
    meshcat.StopRecording()
    meshcat.PublishRecording()


def _write_page(meshcat: Meshcat, path: Path | str, title: str, legend: str, duration: float, data: str) -> Path:
    target = Path(path)
    output_folder(target.parent)
    overlay = files(__package__).joinpath("overlay.html").read_text(encoding="utf-8")
    # The data are inserted last, so that a name in the data is not mistaken for a placeholder.
    fields = {"title": html.escape(title), "legend": legend, "duration": f"{duration:.3f}", "data": data}
    for field, text in fields.items():
        overlay = overlay.replace(f"{{{field}}}", text, 1)
    return write_text(target, meshcat.StaticHtml().replace("</body>", f"{overlay}</body>"))


def _color_bar(top: float) -> str:
    stops = ", ".join(to_hex(ERROR_COLORS(x)) for x in np.linspace(0.0, 1.0, 9))
    return (
        '<span class="row"><span>error along the trail: 0</span>'
        f'<span style="width:110px;height:9px;background:linear-gradient(to right, {stops})"></span>'
        f"<span>{100.0 * top:.3g} cm</span></span>"
    )


def _tint(color: str) -> str:
    """Return a colour mixed with white, which replaces transparency, since Meshcat's lines are opaque."""
    red, green, blue = (0.25 * each + 0.75 for each in to_rgb(color))
    return to_hex((red, green, blue))


def _path_component(name: str) -> str:
    """Return a name as a component of a Meshcat path, with an underscore for each special character."""
    return "".join(letter if letter.isalnum() else "_" for letter in name)
