"""Tests that scenes of replays call Meshcat with the right objects, poses and motions."""

import json
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from pydrake.math import RigidTransform, RollPitchYaw

from drake_quad import load_scenario, simulate
from drake_quad.laboratory.wind.fans import Direction, Jet, Outlet
from drake_quad.signals import RotorSpeed, State, Wind
from drake_quad.space.shapes import Ball, Cuboid, convex_hull
from drake_quad.space.shapes import Cylinder as Pillar
from drake_quad.vehicle.rotors import Rotors
from drake_quad.visualization.positions import positions
from drake_quad.visualization.replay import page
from drake_quad.visualization.replay.page import draw_replay
from drake_quad.visualization.replay.page_data import page_data
from drake_quad.visualization.replay.scene import SceneRoom, draw_surroundings, look_at, reference_points
from drake_quad.visualization.replay.shapes import (
    ERROR_COLORS,
    Frame,
    draw_arrow,
    draw_fan,
    draw_quadrotor,
    draw_solid,
    draw_trail_piece,
    part_scale,
    quadrotor_mesh,
    rotation_angles,
    rotor_poses,
    tube,
    vehicle_pose,
    wind_arrow,
)
from drake_quad.visualization.style import AXIS_COLORS, BLUE, SKY


class Animation:
    """Stub of a Meshcat animation, which stores its keyframes by path and property."""

    def __init__(self, rate):
        self.rate, self.transforms, self.properties = rate, {}, {}

    def frames_per_second(self):
        return self.rate

    def set_repetitions(self, count):
        self.repetitions = count

    def SetTransform(self, frame, path, transform):
        self.transforms.setdefault(path, {})[frame] = transform

    def SetProperty(self, frame, path, name, value):
        self.properties.setdefault((path, name), {})[frame] = value


class Scene:
    """Replacement for Meshcat that stores all drawn objects by path."""

    def __init__(self):
        self.objects, self.colors, self.poses, self.properties = {}, {}, {}, {}
        self.lines, self.meshes, self.camera, self.published = {}, {}, None, False

    def SetObject(self, path, shape, rgba=None):
        self.objects[path], self.colors[path] = shape, rgba

    def SetTransform(self, path, transform, time_in_recording=None):
        self.poses[path] = transform

    def SetProperty(self, path, name, value, time_in_recording=None):
        self.properties[path, name] = value

    def HasPath(self, path):
        return any(f"{each}/".startswith(f"{path}/") for each in (*self.objects, *self.meshes, *self.poses))

    def Delete(self, path):
        for objects in (self.objects, self.meshes, self.poses):
            for each in [each for each in objects if f"{each}/".startswith(f"{path}/")]:
                del objects[each]

    def SetLine(self, path, points, width, rgba):
        self.lines[path], self.colors[path] = np.array(points), rgba

    def SetLineSegments(self, path, starts, ends, width, rgba):
        self.lines[path], self.colors[path] = np.stack([starts, ends]), rgba

    def SetTriangleMesh(self, path, vertices, faces, rgba):
        self.meshes[path], self.colors[path] = (np.array(vertices), np.array(faces)), rgba

    def PlotSurface(self, path, x, y, z, rgba):
        self.meshes[path], self.colors[path] = np.stack([x, y, z]), rgba

    def SetTriangleColorMesh(self, path, vertices, faces, colors):
        self.meshes[path], self.colors[path] = (np.array(vertices), np.array(faces)), np.array(colors)

    def SetCameraPose(self, position, target):
        self.camera = np.array(position), np.array(target)

    def StartRecording(self, rate, set_visualizations_while_recording):
        self.animation = Animation(rate)

    def get_mutable_recording(self):
        return self.animation

    def StopRecording(self):
        self.stopped = True

    def PublishRecording(self):
        self.published = True


X_LAYOUT = Rotors.x(length=0.2, width=0.3)  # m
FRAME = Frame(rotors=X_LAYOUT, roots=(np.zeros(3),) * 4)


def ends(box, pose):
    """Return the centres of the two small faces of a box, m."""
    half = 0.5 * box.width()
    return np.array([pose @ np.array([sign * half, 0.0, 0.0]) for sign in (-1.0, 1.0)])


def test_arms_begin_at_the_roots_of_the_frame():
    roots = tuple(np.array([0.02 * number, -0.01, 0.005]) for number in range(4))
    scene = Scene()
    draw_quadrotor(scene, "/v", Frame(rotors=X_LAYOUT, roots=roots), "black")
    for number, (root, rotor) in enumerate(zip(roots, X_LAYOUT, strict=True), start=1):
        drawn_ends = ends(scene.objects[f"/v/arm_{number}"], scene.poses[f"/v/arm_{number}"])
        np.testing.assert_allclose(drawn_ends, [root, [rotor.x, rotor.y, rotor.z]], atol=1e-9)


def test_the_parts_of_a_quadrotor_are_at_their_positions():
    scene = Scene()
    draw_quadrotor(scene, "/v", FRAME, "black")
    size = part_scale(X_LAYOUT)
    assert size == pytest.approx(min(np.hypot(0.1, 0.15) / 0.17, 1.0))
    for number, rotor in enumerate(X_LAYOUT, start=1):
        rotor_position = np.array([rotor.x, rotor.y, rotor.z])
        middle, tip = ends(scene.objects[f"/v/arm_{number}"], scene.poses[f"/v/arm_{number}"])
        np.testing.assert_allclose([middle, tip], [np.zeros(3), rotor_position], atol=1e-9)
        disc_position = rotor_position + np.array([0.0, 0.0, 0.035 * size])
        for part in ("rotor", "disc"):
            np.testing.assert_allclose(scene.poses[f"/v/{part}_{number}"].translation(), disc_position)
        motor = scene.objects[f"/v/motor_{number}"]
        middle = rotor_position + np.array([0.0, 0.0, 0.5 * motor.length()])
        np.testing.assert_allclose(scene.poses[f"/v/motor_{number}"].translation(), middle)
        assert motor.length() == pytest.approx(0.035 * size)
        blades, disc = scene.objects[f"/v/rotor_{number}/blades"], scene.objects[f"/v/disc_{number}"]
        assert blades.width() == pytest.approx(2.0 * disc.radius())
        # Propellers do not touch, and none is longer than 8 inches.
        assert disc.radius() == pytest.approx(min(0.1, 0.48 * 0.2))
        # Blades and discs that turn clockwise are blue, and the others are light blue.
        shade = to_rgb(BLUE if rotor.direction == -1.0 else SKY)
        for part, opacity in ((f"rotor_{number}/blades", 1.0), (f"disc_{number}", 0.2)):
            color = scene.colors[f"/v/{part}"]
            np.testing.assert_allclose([color.r(), color.g(), color.b(), color.a()], [*shade, opacity])
    # The two rotors in front are marked.
    assert {path for path in scene.objects if "nose" in path} == {"/v/nose_1", "/v/nose_4"}
    np.testing.assert_allclose(scene.poses["/v/nose_4"].translation(), [X_LAYOUT[3].x, X_LAYOUT[3].y, X_LAYOUT[3].z])
    assert scene.colors["/v/arm_1"] == scene.colors["/v/arm_4"] != scene.colors["/v/arm_2"]
    assert scene.objects["/v/hub"].radius() == pytest.approx(0.45 * disc.radius())


def test_poses_of_rotors_turn_about_their_axes():
    angles = np.array([0.1, -0.2, 0.3, 2.0])
    for pose, angle, rotor in zip(rotor_poses(X_LAYOUT, angles), angles, X_LAYOUT, strict=True):
        np.testing.assert_allclose(pose.rotation().matrix()[:2, 0], [np.cos(angle), np.sin(angle)])
        np.testing.assert_allclose(pose.translation()[:2], [rotor.x, rotor.y])
    speeds = RotorSpeed(100.0, 200.0, 300.0, 400.0)
    np.testing.assert_allclose(
        rotation_angles(X_LAYOUT, speeds, 0.02), 0.1 * 0.02 * np.array(speeds) * [rotor.direction for rotor in X_LAYOUT]
    )


def test_the_mesh_of_a_quadrotor_has_a_bar_to_each_rotor_and_a_disc_on_it():
    corners, triangles = (part.T for part in quadrotor_mesh(FRAME))
    assert triangles.max() == len(corners) - 1
    height = 0.035 * part_scale(X_LAYOUT)
    radius = 0.48 * 0.2
    for rotor in X_LAYOUT:
        disc_centre = np.array([rotor.x, rotor.y, rotor.z + height])
        distances = np.linalg.norm(corners - disc_centre, axis=1)
        assert np.isclose(distances, 0.0, atol=1e-9).sum() == 1
        rim = corners[np.isclose(distances, radius) & np.isclose(corners[:, 2], disc_centre[2])]
        assert len(rim) == 10
    a, b, c = (corners[triangles[:, i]] for i in range(3))
    areas = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    assert areas.min() > 0.0
    discs = np.isclose(a[:, 2], height) & np.isclose(b[:, 2], height) & np.isclose(c[:, 2], height)
    expected = 4 * 0.5 * 10 * radius**2 * np.sin(2.0 * np.pi / 10)
    assert areas[discs].sum() == pytest.approx(expected)
    # The bars lead from the centre to the rotors. They are closed surfaces of outward triangles with the right volume.
    bars = triangles[~discs]
    a, b, c = (corners[bars[:, i]] for i in range(3))
    enclosed = np.sum(np.cross(a, b) * c) / 6.0
    half = 0.009 * part_scale(X_LAYOUT)
    assert abs(enclosed) == pytest.approx(4.0 * 4.0 * half**2 * np.hypot(0.1, 0.15), rel=0.35)


JET = Jet(outlet=Outlet(1.0, 2.0, 0.5), direction=Direction(0.6, 0.0, 0.8), exit_speed=4.0, diameter=0.8)


def test_a_fan_blows_from_its_outlet_along_its_direction():
    scene = Scene()
    draw_fan(scene, "/fan", JET, 5.0)
    pose = scene.poses["/fan"]
    np.testing.assert_allclose(pose.translation(), JET.outlet)
    np.testing.assert_allclose(pose.rotation().matrix()[:, 2], JET.direction)
    housing = scene.objects["/fan/housing"]
    assert housing.radius() == 0.4
    # The front of the housing is the outlet.
    assert scene.poses["/fan/housing"].translation()[2] + 0.5 * housing.length() == pytest.approx(0.0)
    x, y, z = scene.meshes["/fan/jet"]
    assert (z.min(), z.max()) == pytest.approx((0.0, 5.0))
    np.testing.assert_allclose(np.hypot(x, y), np.maximum(0.4, 0.094 * z), atol=1e-9)
    assert not scene.properties["/fan/jet/<object>", "material.depthWrite"]
    # The surface of the jet is closed around its axis.
    np.testing.assert_allclose([x[:, 0], y[:, 0]], [x[:, -1], y[:, -1]], atol=1e-12)
    assert np.ptp(np.unwrap(np.arctan2(y, x), axis=1), axis=1) == pytest.approx(2.0 * np.pi)


@pytest.mark.parametrize(
    "shape",
    [
        Cuboid((1.0, 2.0, 3.0), (0.1, 0.2, 0.3), (0.4, 0.5, 0.6)),
        Pillar((1.0, 2.0, 3.0), (0.1, 0.2, 0.3), 0.2, 1.5),
        Ball((1.0, 2.0, 3.0), radius=0.7),
        convex_hull(np.random.default_rng(1).normal(size=(12, 3))),
    ],
)
def test_solids_are_drawn_by_their_triangles(shape):
    scene = Scene()
    draw_solid(scene, "/solid", shape)
    vertices, faces = scene.meshes["/solid"]
    np.testing.assert_allclose(vertices.T[faces.T], shape.triangles())


def test_the_arrow_of_the_wind_points_along_it():
    scene = Scene()
    draw_arrow(scene, "/arrow")
    x, y, z = scene.meshes["/arrow"]
    # The arrow has a shaft and a tip with a wider rim.
    np.testing.assert_allclose(x[:, 0], [0.0, 0.78, 0.78, 1.0])
    np.testing.assert_allclose(np.hypot(y, z), np.outer([0.012, 0.012, 0.045, 0.0], np.ones(x.shape[1])), atol=1e-12)
    state = State(1.0, 2.0, 3.0, *[0.0] * 9)
    pose, scale = wind_arrow(Wind(0.0, 3.0, -4.0), state)
    np.testing.assert_allclose(pose.rotation().matrix()[:, 0], [0.0, 0.6, -0.8])
    np.testing.assert_allclose(pose.translation(), [1.0, 2.0, 3.3])
    assert scale == pytest.approx([0.75, 0.75, 0.75])
    assert wind_arrow(Wind(20.0, 0.0, 0.0), state)[1] == pytest.approx([3.0, 1.0, 1.0])
    assert wind_arrow(Wind(0.0, 0.0, 0.0), state)[1] == pytest.approx([1e-3] * 3)


def test_a_tube_follows_its_points():
    turn = np.linspace(0.0, 3.0, 40)
    points = np.column_stack([np.cos(turn), np.sin(turn), turn])
    vertices, faces = tube(points, 0.05)
    rings = vertices.T.reshape(40, 3, 3)
    np.testing.assert_allclose(rings.mean(axis=1), points, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(rings - points[:, None], axis=2), 0.05)
    tangents = np.gradient(points, axis=0)
    np.testing.assert_allclose(np.einsum("nki,ni->nk", rings - points[:, None], tangents), 0.0, atol=1e-6)
    corners = [vertices.T[faces[i]] for i in range(3)]
    area = 0.5 * np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]), axis=1).sum()
    length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert area == pytest.approx(3.0 * np.sqrt(3.0) * 0.05 * length, rel=0.02)
    # The points of a tube may also go straight up, or be equal.
    up, _ = tube(np.column_stack([np.zeros(5), np.zeros(5), np.arange(5.0)]), 0.05)
    np.testing.assert_allclose(np.hypot(*up[:2]), 0.05)
    down, _ = tube(np.column_stack([np.zeros(5), np.zeros(5), -np.arange(5.0)]), 0.05)
    np.testing.assert_allclose(np.hypot(*down[:2]), 0.05)
    assert np.isfinite(tube(np.zeros((5, 3)), 0.05)[0]).all()


def test_a_trail_has_one_colour_or_the_colours_of_its_errors():
    scene = Scene()
    points = np.column_stack([np.arange(4.0), np.zeros(4), np.zeros(4)])
    draw_trail_piece(scene, "/a", points, "#FF0000", 0.5)
    assert (scene.colors["/a"].r(), scene.colors["/a"].g(), scene.colors["/a"].a()) == (1.0, 0.0, 0.7)
    np.testing.assert_allclose(np.hypot(*scene.meshes["/a"][0][1:]), 0.5 * 0.018)
    fractions = np.array([0.0, 0.3, 0.6, 1.0])
    draw_trail_piece(scene, "/b", points, fractions, 1.0)
    np.testing.assert_allclose(
        scene.colors["/b"].T.reshape(4, 3, 3), np.repeat(ERROR_COLORS(fractions)[:, None, :3], 3, axis=1)
    )


def test_a_pose_agrees_with_the_state():
    state = State(1.0, 2.0, 3.0, 0.1, -0.2, 0.3, *[0.0] * 6)
    expected = RigidTransform(RollPitchYaw(0.1, -0.2, 0.3), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(vehicle_pose(state).GetAsMatrix4(), expected.GetAsMatrix4())


def test_the_room_has_a_floor_edges_and_a_grid():
    scenario = load_scenario("hover")
    flight = simulate(load_scenario("hover", ["duration=0.1"]))
    scene = Scene()
    fan = "laboratory.wind=[{kind: fan, position: [-4.0, 0.3, 1.1], direction: [1, 0, 0], flow: 1.0, diameter: 0.6}]"
    windy = load_scenario("hover", [fan])
    flown = np.array([[0.5, 1.0, 1.2], [0.0, 99.0, 1.0]])
    room = draw_surroundings(scene, windy, flight.plan, flown)
    path = reference_points(flight.plan)
    margin = 4.0 * Frame.of(scenario.vehicle).max_rotor_distance
    # Flown positions are taken into account up to three metres from the path.
    low = np.minimum(path.min(axis=0), [0.0, 1.0, 1.0]) - margin
    high = np.maximum(path.max(axis=0), [0.5, path[0, 1] + 3.0, 1.2]) + margin
    np.testing.assert_allclose(room.low, [-4.0, low[1], 0.0])
    np.testing.assert_allclose(room.high, high)
    floor = scene.objects["/floor"]
    size = high - room.low
    assert (floor.width(), floor.depth()) == pytest.approx((size[0], size[1]))
    np.testing.assert_allclose(scene.poses["/floor"].translation()[:2], 0.5 * (room.low + high)[:2])
    edge_starts, edge_ends = np.moveaxis(scene.lines["/room/edges"], 2, 1)
    assert edge_starts.shape == (12, 3)
    lengths = np.sort(np.abs(edge_ends - edge_starts).max(axis=1))
    np.testing.assert_allclose(lengths, np.sort(np.repeat(size, 4)))
    assert ((np.abs(edge_ends - edge_starts) > 1e-9).sum(axis=1) == 1).all()
    assert len({tuple(sorted(map(tuple, pair.round(6)))) for pair in np.stack([edge_starts, edge_ends], axis=1)}) == 12
    edge_starts, edge_ends = np.moveaxis(scene.lines["/room/grid"], 2, 1)
    count = len(room.grid(0))
    np.testing.assert_allclose(edge_starts[:count, 0], room.grid(0))
    np.testing.assert_allclose(edge_ends[:count, :2], np.column_stack([room.grid(0), np.full(count, room.high[1])]))
    np.testing.assert_allclose(edge_starts[count:, 1], room.grid(1))
    np.testing.assert_allclose(edge_ends[count:, 0], room.high[0])
    for axis, begin in zip("xyz", (room.low, [high[0], room.low[1], 0.0], room.low), strict=True):
        start, stop = scene.lines[f"/room/{axis}"][:, :, 0]
        np.testing.assert_allclose(start, begin)
        i = "xyz".index(axis)
        np.testing.assert_allclose(stop, np.where(np.arange(3) == i, high, begin))
    # The jet of the fan is drawn up to a distance of `margin` beyond the end of the path.
    assert scene.meshes["/fan_1/jet"][2].max() == pytest.approx(max((path[:, 0] + 4.0).max() + margin, 1.0))
    np.testing.assert_allclose(scene.lines["/reference_path"].T, path, atol=1e-12)
    # The camera is above the scene and to its side.
    camera_position, target = scene.camera
    centre = 0.5 * (room.low + room.high)
    np.testing.assert_allclose(target[:2], centre[:2])
    assert camera_position[2] > target[2]
    extent = np.linalg.norm(room.high - room.low)
    np.testing.assert_allclose((camera_position - centre) / extent, [0.54, -0.25, 0.29])
    assert centre[2] - target[2] == pytest.approx(0.1 * extent)
    look_at(scene, np.zeros((1, 3)))
    np.testing.assert_allclose(scene.camera[0], 1.5 * np.array([0.54, -0.25, 0.29]))


@pytest.fixture(scope="module")
def flights():
    """Return two flights along the same reference: one in steady wind, and one that ends earlier."""
    wind = "laboratory.wind=[{kind: steady, velocity: [1.0, 0.5, 0.2]}]"
    return {
        "first one": simulate(load_scenario("figure_eight", ["duration=1.3", wind])),
        "other": simulate(load_scenario("figure_eight", ["duration=0.8"])),
    }


def test_a_replay_moves_its_objects_thirty_times_a_second(flights):
    scene = Scene()
    draw_replay(scene, flights)
    moved = scene.animation.transforms
    last_frame = 39
    for path, flight, last_own_frame in (("/first_one", flights["first one"], 39), ("/other", flights["other"], 24)):
        frames = moved[path]
        assert sorted(frames) == [*range(last_own_frame + 1), *([last_frame] if last_own_frame < last_frame else [])]
        for frame, pose in frames.items():
            # A frame shows the last tick up to its time.
            tick = np.flatnonzero(flight.time <= min(frame / 30.0, flight.time[-1]) + 1e-9)[-1]
            np.testing.assert_allclose(
                pose.GetAsMatrix4(), vehicle_pose(State(*flight["state"][tick])).GetAsMatrix4(), atol=1e-12
            )
        # Rotors keep turning from frame to frame.
        turned = [moved[f"{path}/rotor_1"][frame].rotation().matrix()[:2, 0] for frame in range(3)]
        np.testing.assert_allclose(turned[0], [1.0, 0.0])
        rotor = Frame.of(flight.scenario.vehicle).rotors[0]
        angle = 0.1 / 30.0 * rotor.direction * flight["rotor_speed"][0, 0]
        np.testing.assert_allclose(turned[1], [np.cos(angle), np.sin(angle)])
    # Only a flight whose wind does not come from fans has an arrow.
    arrow = moved["/first_one_wind"]
    assert "/other_wind" not in moved
    assert {"/first_one_wind/arrow", "/reference/point"} <= {*scene.objects, *scene.meshes}
    state, wind = (flights["first one"][name][0] for name in ("state", "wind"))
    pose, scale = wind_arrow(Wind(*wind), State(*state))
    np.testing.assert_allclose(arrow[0].GetAsMatrix4(), pose.GetAsMatrix4())
    assert scene.animation.properties["/first_one_wind/arrow", "scale"][0] == scale
    # The point shows the reference of the longer flight.
    reference = positions(flights["first one"].record("reference"))
    np.testing.assert_allclose(moved["/reference"][last_frame].translation(), reference[-1], atol=0.05)
    np.testing.assert_allclose(moved["/reference"][0].translation(), reference[0])
    assert scene.published
    assert scene.stopped
    assert scene.animation.repetitions == 1000


def test_a_trail_appears_piece_by_piece(flights):
    scene = Scene()
    draw_replay(scene, flights)
    properties = scene.animation.properties
    for path, flight in (("/first_one", flights["first one"]), ("/other", flights["other"])):
        pieces = [each for each, name in properties if each.startswith(f"{path}_trail") and name == "visible"]
        assert len(pieces) == int(np.ceil(flight.time[-1] / 0.25))
        for number, piece in enumerate(pieces):
            end = min(0.25 * (number + 1), flight.time[-1])
            frames = properties[piece, "visible"]
            assert frames[0] is False
            appears = min(frame for frame, visible in frames.items() if visible)
            assert appears == pytest.approx(30.0 * end, abs=1.0)
            assert frames[39] is True
            rings = scene.meshes[piece][0].T.reshape(5, 3, 3).mean(axis=1)
            flown_positions = positions(flight.record("state"))
            np.testing.assert_allclose(rings[-1], flown_positions[np.abs(flight.time - end).argmin()], atol=2e-2)
            np.testing.assert_allclose(
                rings[0], flown_positions[np.abs(flight.time - 0.25 * number).argmin()], atol=2e-2
            )


@pytest.mark.slow
def test_the_trail_of_a_flight_shorter_than_a_frame_is_invisible_at_first():
    scene = Scene()
    draw_replay(scene, {"short": simulate(load_scenario("figure_eight", ["duration=0.02"]))})
    assert scene.animation.properties["/short_trail/0", "visible"] == {0: False, 1: True}


def test_the_trail_of_a_single_flight_has_the_colours_of_its_errors(flights):
    scene = Scene()
    flight = flights["first one"]
    draw_replay(scene, {"alone": flight})
    colors = scene.colors["/alone_trail/3"].T[::3]
    ticks = np.searchsorted(flight.time, np.linspace(0.75, 1.0, 5) - 1e-9)
    fractions = flight.euclidean_error[ticks] / flight.euclidean_error.max()
    np.testing.assert_allclose(colors, ERROR_COLORS(fractions)[:, :3])


def test_crashed_vehicles_of_a_swarm_are_red(flights, monkeypatch, tmp_path):
    scene = Scene()
    scene.StaticHtml = lambda: "<html><body></body></html>"
    monkeypatch.setattr(page, "local_meshcat", lambda: scene)
    first, second = flights.values()
    crash = replace(second, metrics=second.metrics._replace(crash_time=0.7))
    groups = {"a b": [first, crash], "c": [first]}
    text = page.save_swarm(groups, tmp_path / "swarm.html").read_text(encoding="utf-8")
    assert scene.animation.rate == 10.0
    assert {path for path in scene.meshes if path.endswith("/body")} == {"/a_b/0/body", "/a_b/1/body", "/c/0/body"}
    crashed_color = scene.colors["/a_b/1/body"]
    assert (crashed_color.r(), crashed_color.g(), crashed_color.b(), crashed_color.a()) == pytest.approx(
        (0.8, 0.0, 0.0, 1.0)
    )
    assert len({(color.r(), color.g(), color.b()) for path, color in scene.colors.items() if "body" in path}) == 3
    # Trails have the colours of their vehicles, mixed with white.
    for path in ("/a_b", "/c"):
        body, trail = scene.colors[f"{path}/0/body"], scene.colors[f"{path}_trails/0"]
        assert body.a() == 0.6
        for part in ("r", "g", "b"):
            assert getattr(trail, part)() == pytest.approx(0.25 * getattr(body, part)() + 0.75, abs=3e-3)
    assert sorted(scene.animation.transforms["/c/0"]) == list(range(14))
    assert sorted(scene.animation.transforms["/a_b/1"]) == [*range(9), 13]
    np.testing.assert_allclose(scene.lines["/c_trails/0"].T[0], positions(first.record("state"))[0])
    reference = positions(first.record("reference"))[-1]
    np.testing.assert_allclose(scene.animation.transforms["/reference"][13].translation(), reference, atol=0.05)
    assert "3 flights, 1 crashed" in text
    assert "crashed</div>" in text
    assert 'max="1.300"' in text


def test_page_data_contain_errors_and_speeds_over_time(flights):
    """Errors in cm and speeds in m/s are given every 50 ms, with three digits."""
    room = SceneRoom(np.array([-1.0, -2.0, 0.0]), np.array([3.0, 2.0, 1.5]), 0.5, {"post": np.ones(3)})
    content = json.loads(
        page_data(
            {name: [flight] for name, flight in flights.items()},
            {"first one": "#1", "other": "#2"},
            {"first one": "/a", "other": "/b"},
            room,
        )
    )
    assert content["duration"] == pytest.approx(1.3)
    assert content["step"] == 0.05
    for curve, (name, flight) in zip(content["curves"], flights.items(), strict=True):
        assert (curve["name"], curve["color"]) == (name, {"first one": "#1", "other": "#2"}[name])
        assert len(curve["error"]) == 27
        state = flight.record("state")
        speed = np.linalg.norm([state.v_x, state.v_y, state.v_z], axis=0)
        for k, (error, drawn_speed) in enumerate(zip(curve["error"], curve["speed"], strict=True)):
            if 0.05 * k > flight.time[-1] + 1e-9:
                assert error is None
                continue
            tick = np.flatnonzero(flight.time <= 0.05 * k + 1e-9)[-1]
            assert error == pytest.approx(100.0 * flight.euclidean_error[tick], rel=5e-3, abs=1e-9)
            assert drawn_speed == pytest.approx(speed[tick], rel=5e-3, abs=1e-9)
        assert "low" not in curve
    size = Frame.of(flights["other"].scenario.vehicle).max_rotor_distance
    assert content["vehicles"] == [
        {"name": n, "path": p, "size": pytest.approx(size)} for n, p in (("first one", "/a"), ("other", "/b"))
    ]
    marks = content["marks"]
    label_distance = 0.04 * 4.0
    assert [(mark["text"], mark["color"], mark["at"]) for mark in marks[:3]] == [
        ("X (m)", AXIS_COLORS["x"], [pytest.approx(3.0), pytest.approx(-2.0 - label_distance), 0.0]),
        ("Y (m)", AXIS_COLORS["y"], [pytest.approx(3.0 + label_distance), pytest.approx(2.0), 0.0]),
        (
            "Z (m)",
            AXIS_COLORS["z"],
            [pytest.approx(-1.0), pytest.approx(-2.0 - label_distance), pytest.approx(1.5 + label_distance)],
        ),
    ]
    numbers = [mark["text"] for mark in marks if mark["color"] == AXIS_COLORS["x"]][1:]
    assert numbers == [f"{value:g}".replace("-", "−") for value in np.arange(-1.0, 3.1, 0.5)]
    assert marks[-1] == {"at": [1.0, 1.0, 1.0], "text": "post", "color": "#555555"}
    corners = [[x, y, z] for x in (-1.0, 3.0) for y in (-2.0, 2.0) for z in (0.0, 1.5)]
    assert sorted(content["frame"][:8]) == corners
    assert content["frame"][8:] == [mark["at"] for mark in marks]
