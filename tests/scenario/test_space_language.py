"""Tests of spaces and obstacles in the scenario language."""

import struct

import numpy as np
import pytest
from ruamel.yaml import YAML

from drake_quad import InputError, load_scenario
from drake_quad.errors import InputWarning
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.paths import distributions_in, value_at
from drake_quad.space.shapes import transformed_points

ROOM_SCENARIO = """
room:
  extends: figure_eight
  space:
    bounds: {min: [-5, -5, 0], max: [5, 5, 3]}
    obstacles:
      pillar: {kind: cylinder, centre: [2.0, 0.5, 1.0], radius: 0.2, height: 2.0}
      beam: {kind: box, centre: [0, 0, 2], size: [1, 2, 0.1], rotation: [0, 0, 0.6]}
      ball: {kind: sphere, centre: [0, 1, 1], radius: 0.3}
      rock: {kind: hull, points: rock.obj, scale: 0.5, centre: [3, 3, 0], rotation: [0, 0, 1.5707963267948966]}
    margin: 0.1
smaller:
  extends: room
  space: {radius: 0.2, obstacles: {ball: {radius: 0.1}, new: {kind: sphere, centre: [0, 3, 1], radius: 0.3}}}
other_kind: {extends: room, space: {obstacles: {ball: {kind: box, centre: [0, 0, 1], size: [1, 1, 1]}}}}
"""
TETRAHEDRON_CORNERS = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
TETRAHEDRON_TRIANGLES = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]


def obj_mesh():
    inside = "v 0.1 0.1 0.1 1.0\n"
    vertices = "".join(f"v {x} {y} {z}\n" for x, y, z in TETRAHEDRON_CORNERS)
    return f"# a rock\n{vertices}{inside}vn 9 9 9\nf 1/1/1 2/2/2 3/3/3\n".encode()


def binary_stl_mesh():
    rows = [
        struct.pack("<12fH", 0, 0, 0, *np.ravel([TETRAHEDRON_CORNERS[i] for i in each]), 0)
        for each in TETRAHEDRON_TRIANGLES
    ]
    return b"solid".ljust(80) + struct.pack("<I", len(rows)) + b"".join(rows)


def text_stl_mesh():
    facets = (
        "facet normal 0 0 0\nouter loop\n"
        + "".join("vertex {} {} {}\n".format(*TETRAHEDRON_CORNERS[i]) for i in each)
        + "endloop\nendfacet\n"
        for each in TETRAHEDRON_TRIANGLES
    )
    return f"solid rock\n{''.join(facets)}endsolid rock\n".encode()


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rooms.yaml").write_text(ROOM_SCENARIO)
    (tmp_path / "rock.obj").write_bytes(obj_mesh())
    return tmp_path


def test_a_space_has_the_given_obstacles(folder):
    space = load_scenario(folder / "rooms.yaml:room").space
    flight_space = space.flight_space(0.25)
    assert flight_space.names == ("pillar", "beam", "ball", "rock")
    assert (flight_space.radius, flight_space.margin, flight_space.tracking) == (0.25, 0.1, 0.0)
    np.testing.assert_array_equal(
        [flight_space.bounds.low, flight_space.bounds.high], [[-5.0, -5.0, 0.0], [5.0, 5.0, 3.0]]
    )
    pillar, beam, ball, rock = (obstacle.shape for obstacle in flight_space.obstacles)
    assert (pillar.centre, pillar.radius, pillar.height) == ((2.0, 0.5, 1.0), 0.2, 2.0)
    assert (beam.centre, beam.size, beam.rotation) == ((0.0, 0.0, 2.0), (1.0, 2.0, 0.1), (0.0, 0.0, 0.6))
    assert (ball.centre, ball.radius) == ((0.0, 1.0, 1.0), 0.3)
    # A rotation about Z by 90° maps (x, y, z) to (-y, x, z).
    expected = [[3.0, 3.0, 0.0], [3.0, 3.5, 0.0], [2.5, 3.0, 0.0], [3.0, 3.0, 0.5]]
    np.testing.assert_allclose(sorted(rock.corners), sorted(expected), atol=1e-12)


def test_the_clearance_contains_the_predicted_error_times_tracking_error_factor(folder):
    space = load_scenario(folder / "rooms.yaml:room", "space.tracking_error_factor=3").space
    assert space.flight_space(0.25, 0.02).clearance == pytest.approx(0.25 + 0.1 + 0.06)


def test_obstacles_are_merged_by_name(folder):
    smaller = load_scenario(folder / "rooms.yaml:smaller").space.flight_space(0.25)
    assert smaller.names == ("pillar", "beam", "ball", "rock", "new")
    assert smaller.radius == 0.2
    assert smaller.obstacles[2].shape.radius == 0.1
    assert load_scenario(folder / "rooms.yaml:other_kind").space.obstacles["ball"].kind == "box"


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("rock.obj", obj_mesh()),
        ("binary.stl", binary_stl_mesh()),
        ("binary.stl", binary_stl_mesh() + b"bytes of an editor"),
        ("text.STL", text_stl_mesh()),
    ],
)
def test_the_corners_of_a_mesh_hull_become_the_obstacle(folder, name, data):
    (folder / name).write_bytes(data)
    path = folder / "rooms.yaml"
    path.write_text(ROOM_SCENARIO.replace("rock.obj", name))
    assert sorted(map(list, load_scenario(f"{path}:room").space.obstacles["rock"].points)) == sorted(
        TETRAHEDRON_CORNERS
    )


def test_a_saved_scenario_does_not_need_the_mesh(folder, tmp_path):
    scenario = load_scenario(folder / "rooms.yaml:smaller")
    path = tmp_path / "saved.yaml"
    with path.open("w") as file:
        save_scenario(scenario, file)
    (folder / "rock.obj").unlink()
    assert load_scenario(path) == scenario
    plain = tmp_path / "plain.yaml"
    with plain.open("w") as file:
        save_scenario(load_scenario("figure_eight"), file)
    (saved_fields,) = YAML(typ="safe").load(plain).values()
    assert "space" not in saved_fields


def test_fields_of_obstacles_have_paths(folder):
    scenario = load_scenario(folder / "rooms.yaml:room", "space.obstacles.ball.centre.1=1.5")
    assert value_at(scenario, "space.obstacles.ball.centre.1") == 1.5
    assert distributions_in(scenario) == {}
    assert "4 obstacles" in repr(scenario)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("obstacles.ball.radius=0", "obstacles.ball.radius is 0"),
        ("obstacles.ball.radius={uniform: {min: 1, max: 2}}", "must be a valid number"),
        ("obstacles.beam.size=[1, -1, 1]", "obstacles.beam.size.1 is -1"),
        ("obstacles.rock.points=[[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]", "the 4 points of a hull are in a plane"),
        # The corners are so far from the origin that rounding makes them equal.
        (
            "obstacles.rock={kind: hull, points: [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]],"
            " centre: [1e8, 1e8, 1e8], scale: 1e-9}",
            "the 4 points of a hull are in a plane",
        ),
        ("obstacles.rock.points=[[0, 0, 0]]", "must have at least 4 items, not 1"),
        ("obstacles.rock.points=no.obj", "space.obstacles.rock.points refers to no.obj, which does not exist"),
        ("obstacles.rock.points=rock.ply", "rock.ply: is a PLY mesh and cannot be read: convert it to .obj or .stl"),
        ("obstacles.two words={}", "the name of an obstacle must consist of letters"),
        ("obstacles.kind=3", "the name of an obstacle"),
        ("obstacles.x={kind: cone}", "must be one of 'box', 'cylinder', 'sphere', 'hull'"),
        ("obstacles=[1]", "must be a mapping of names to solids"),
        ("margin=-0.1", "space.margin is -0.1"),
        ("bounds.max.0=-6", "space.bounds.max.0 is -6, but must not be smaller than the same coordinate of min"),
        ("walls=3", "space.walls is unknown"),
    ],
)
def test_errors_in_obstacles_give_file_line_and_field(folder, monkeypatch, override, words):
    monkeypatch.chdir(folder)
    (folder / "rock.ply").touch()
    with pytest.raises(InputError, match="space|obj|ply") as error:
        load_scenario(folder / "rooms.yaml:room", f"space.{override}")
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"v 1 2\nv 3 four 5\n", "is incomplete, or not a mesh of the format"),
        (b"", "is incomplete, or not a mesh of the format"),
        (b"v 1 2 3\n", "at least 4 points"),
        (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n", "in a plane"),
        (b"v nan 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n", "finite"),
        (b"<?xml version='1.0'?>\n<robot name='x500'>", "describes a robot (URDF) and is not a mesh: give the mesh"),
        (b"<?xml version='1.0'?><!-- x --><sdf version='1.9'>", "describes a model or world (SDFormat) and is not a"),
        (b"<?xml version='1.0'?>\n<COLLADA xmlns='x'>", "is a Collada mesh and cannot be read: convert it to .obj"),
        (b"glTF\x02\x00", "is a glTF mesh and cannot be read"),
        (b"ply\r\nformat ascii 1.0\r\n", "is a PLY mesh and cannot be read"),
    ],
)
def test_an_invalid_mesh_is_refused(folder, data, words):
    (folder / "rock.obj").write_bytes(data)
    with pytest.raises(InputError, match=r"rock\.obj: ") as error:
        load_scenario(folder / "rooms.yaml:room")
    assert words in str(error.value)


def test_a_binary_mesh_that_was_cut_is_refused(folder):
    (folder / "rock.stl").write_bytes(binary_stl_mesh()[:-1])
    path = folder / "rooms.yaml"
    path.write_text(ROOM_SCENARIO.replace("rock.obj", "rock.stl"))
    with pytest.raises(InputError, match=r"rock\.stl: is incomplete, or not a mesh of the format"):
        load_scenario(f"{path}:room")


def test_a_comment_in_a_mesh_may_name_other_formats(folder):
    mesh = (folder / "rock.obj").read_bytes()
    (folder / "rock.obj").write_bytes(b"# from glTF, of <robot>, in short supply\n" + mesh)
    assert load_scenario(folder / "rooms.yaml:room").space.obstacles["rock"].points


@pytest.mark.parametrize(
    ("name", "words"),
    [
        (
            "drone.urdf",
            "describes a robot (URDF) and is not a mesh: give the mesh, box, cylinder or sphere of its collision",
        ),
        ("drone.sdf", "describes a model or world (SDFormat) and is not a mesh"),
        ("world.world", "describes a model or world (SDFormat)"),
        ("drone.usda", "describes a scene (USD) and is not a mesh"),
        ("drone.DAE", "is a Collada mesh and cannot be read: convert it to .obj or .stl, with Blender or MeshLab"),
        ("drone.glb", "is a glTF mesh"),
        ("drone.step", "is a CAD model and cannot be read: export it as .obj or .stl"),
        ("drone.txt", "is not a mesh that can be read: its name must end in .obj or .stl"),
    ],
)
def test_files_of_other_formats_are_refused_with_their_names(folder, name, words):
    (folder / name).write_bytes(b"anything")
    (folder / "rooms.yaml").write_text(ROOM_SCENARIO.replace("rock.obj", name))
    with pytest.raises(InputError) as error:
        load_scenario(folder / "rooms.yaml:room")
    assert f"{name}: {words}" in str(error.value)


MANY_CORNERS = [[float(np.cos(i)), float(np.sin(i)), float(i % 2)] for i in range(200)]


@pytest.mark.slow
def test_a_mesh_with_many_corners_is_replaced_by_a_simpler_enclosing_hull(folder):
    """The mesh may be a file or a list of points. A saved hull is loaded again unchanged."""
    (folder / "rock.obj").write_text("".join("v {} {} {}\n".format(*corner) for corner in MANY_CORNERS))
    with pytest.warns(
        InputWarning,
        match=r"rock.obj: its convex hull with 200 corners is replaced by an enclosing hull with 100 corners",
    ):
        rock = load_scenario(folder / "rooms.yaml:room").space.obstacles["rock"]
    assert len(rock.points) == 100
    solid = rock.shape()
    assert (
        solid.distances(
            transformed_points(MANY_CORNERS, centre=rock.centre, rotation=rock.rotation, scale=rock.scale)
        ).max()
        <= 0.0
    )
    hull_fields = {
        "kind": "hull",
        "points": rock.points,
        "centre": (3.0, 3.0, 0.0),
        "scale": 0.5,
        "rotation": rock.rotation,
    }
    assert load_scenario("figure_eight", {"space.obstacles.rock": hull_fields}).space.obstacles["rock"] == rock
    with pytest.warns(InputWarning, match=r"^obstacle of kind hull: its convex hull with 200 corners is replaced"):
        simplified_scenario = load_scenario(
            "figure_eight", {"space.obstacles.rock": {**hull_fields, "points": MANY_CORNERS}}
        )
    assert simplified_scenario.space.obstacles["rock"] == rock


def test_the_number_of_obstacles_is_limited_and_names_are_unique(folder):
    ball = {"kind": "sphere", "centre": [0.0, 0.0, 1.0], "radius": 0.1}
    with pytest.raises(InputError, match="must have at most 200 obstacles, not 201"):
        load_scenario("figure_eight", {"space.obstacles": {f"ball_{i}": ball for i in range(201)}})
    path = folder / "twice.yaml"
    path.write_text("a: {extends: figure_eight, space: {obstacles: {b: {}, b: {}}}}")
    with pytest.raises(InputError, match="'b' is already given"):
        load_scenario(path)


def test_a_mesh_file_that_is_too_large_is_refused(folder):
    with (folder / "rock.obj").open("r+b") as file:
        file.truncate(50_000_001)  # creates a sparse file, which needs no disk space
    with pytest.raises(InputError, match=r"rock\.obj: is too large: a mesh may have at most 50,000,000 bytes"):
        load_scenario(folder / "rooms.yaml:room")
