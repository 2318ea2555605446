"""Tests of the MCAP export, with the reader of the mcap library."""

import dataclasses
import json
import math
import sys

import jsonschema
import numpy as np
import pytest
from matplotlib.colors import to_rgb
from mcap.reader import make_reader
from pydrake.math import RollPitchYaw
from ruamel.yaml import YAML

from drake_quad import InputError, load_scenario, simulate
from drake_quad.flight.formats.mcap_file import flight_messages, save_mcap
from drake_quad.visualization.style import BLUE, GREEN, ORANGE, PURPLE, VERMILION

# Required fields of Foxglove's messages, from schemas/jsonschema of its SDK at commit ca8a1ce.
REQUIRED_FIELDS = {
    "foxglove.FrameTransform": {"timestamp", "parent_frame_id", "child_frame_id", "translation", "rotation"},
    "foxglove.PoseInFrame": {"timestamp", "frame_id", "pose"},
    "foxglove.SceneUpdate": {"deletions", "entities"},
    "foxglove.Log": {"timestamp", "level", "message", "name", "file", "line"},
}
ENTITY_FIELDS = {
    *("timestamp", "frame_id", "id", "lifetime", "frame_locked", "metadata"),
    *("arrows", "cubes", "spheres", "cylinders", "lines", "triangles", "texts", "models"),
}
CUBE_FIELDS = {"pose", "size", "color"}
CYLINDER_FIELDS = {"pose", "size", "bottom_scale", "top_scale", "color"}
LINE_FIELDS = {"type", "pose", "thickness", "scale_invariant", "points", "color", "colors", "indices"}


@pytest.fixture(scope="module")
def flights(diagrams):
    """Return a complete flight and a flight that crashes. The latter has a network and an asymmetric airframe."""
    turned = {"duration": 1.0, "route.yaw": 0.4}
    failing = {"duration": 2, "vehicle.rotor_failure": {"rotor": 2, "time": 0.2}}
    return {
        "whole": simulate(load_scenario(diagrams / "figure_eight.yaml", turned), compiled=True),
        "failing": simulate(load_scenario(diagrams / "paper.yaml:no_wind_pd_t2fnn", failing), compiled=True),
    }


@pytest.fixture(scope="module")
def path(flights, tmp_path_factory):
    return save_mcap(flights, tmp_path_factory.mktemp("mcap") / "flights.mcap")


@pytest.fixture(scope="module")
def messages(path):
    """Return times (ns) and contents of all messages by topic, and the schema of each topic."""
    contents, schemas, times = {}, {}, []
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False):
            assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
            assert message.publish_time == message.log_time
            schemas[channel.topic] = (schema.name, json.loads(schema.data))
            times.append(message.log_time)
            contents.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
    assert times == sorted(times)
    return contents, schemas


@pytest.mark.long
def test_each_signal_and_each_foxglove_display_has_a_topic(messages, flights):
    contents, _ = messages
    for name, flight in flights.items():
        topics = {f"/{name}/{each}" for each in ("tf", "reference", *(f"signals/{signal}" for signal in flight))}
        assert {topic: len(contents[topic]) for topic in topics} == dict.fromkeys(topics, len(flight.time))
    assert len(contents["/whole/scene"]) == len(contents["/failing/log"]) == 1
    assert "/whole/log" not in contents


def test_messages_match_their_schemas_and_have_the_required_fields_of_foxglove(messages):
    contents, schemas = messages
    for topic, (name, schema) in schemas.items():
        validator = jsonschema.Draft202012Validator(schema)
        for _, content in contents[topic][:: max(len(contents[topic]) // 5, 1)]:
            validator.validate(content)
        if name.startswith("foxglove"):
            assert schema["properties"].keys() == REQUIRED_FIELDS[name], name
    ((_, scene),) = contents["/failing/scene"]
    parts = [part for entity in scene["entities"] for part in entity["cubes"] + entity["cylinders"] + entity["lines"]]
    assert all(entity.keys() == ENTITY_FIELDS for entity in scene["entities"])
    assert len(parts) == 4 + 4 + 2
    assert all(part.keys() in (CUBE_FIELDS, CYLINDER_FIELDS, LINE_FIELDS) for part in parts)


def titles_of(schema, field=""):
    """Return the names and titles of all fields of a schema that are objects, including nested fields."""
    if schema["type"] == "array":
        return titles_of(schema["items"], field)
    inside = [pair for name, part in schema.get("properties", {}).items() for pair in titles_of(part, name)]
    return [(field, schema["title"]), *inside] if "title" in schema else inside


def test_parts_of_foxglove_schemas_have_their_titles(messages):
    _, schemas = messages
    titles = {pair for _, schema in schemas.values() for pair in titles_of(schema) if pair[0]}
    assert titles == {
        ("timestamp", "time"),
        ("lifetime", "duration"),
        *((field, "foxglove.Vector3") for field in ("position", "translation", "size")),
        *((field, "foxglove.Quaternion") for field in ("orientation", "rotation")),
        ("pose", "foxglove.Pose"),
        ("points", "foxglove.Point3"),
        *((field, "foxglove.Color") for field in ("color", "colors")),
        ("cubes", "foxglove.CubePrimitive"),
        ("cylinders", "foxglove.CylinderPrimitive"),
        ("lines", "foxglove.LinePrimitive"),
        ("metadata", "foxglove.KeyValuePair"),
        ("entities", "foxglove.SceneEntity"),
        ("deletions", "foxglove.SceneEntityDeletion"),
    }


def test_signals_are_written_with_the_names_of_their_components(messages, flights):
    contents, schemas = messages
    for name, flight in flights.items():
        state = flight.record("state")
        for tick, (time, content) in enumerate(contents[f"/{name}/signals/state"]):
            assert time == round(1e9 * flight.time[tick])
            stamp = {"sec": time // 10**9, "nsec": time % 10**9}
            assert content == {"timestamp": stamp} | {row: getattr(state, row)[tick] for row in state._fields}
    weights = np.array([content["values"] for _, content in contents["/failing/signals/weights"]])
    np.testing.assert_array_equal(weights, flights["failing"]["weights"])
    assert schemas["/whole/signals/wrench"][1]["properties"]["tau_x"]["description"] == "N m, along B"
    assert schemas["/whole/signals/wrench"][0] == "drake_quad.wrench"


def test_frames_have_the_poses_of_the_vehicle_and_its_reference(messages, flights):
    """The expected quaternion is computed by Drake; its sign is arbitrary."""
    contents, _ = messages
    for name, flight in flights.items():
        for tick in (0, len(flight.time) // 2, len(flight.time) - 1):
            _, transform = contents[f"/{name}/tf"][tick]
            assert (transform["parent_frame_id"], transform["child_frame_id"]) == ("world", f"{name}/body")
            assert [*transform["translation"].values()] == flight["state"][tick, :3].tolist()
            expected = RollPitchYaw(flight["state"][tick, 3:6]).ToQuaternion().wxyz()
            wxyz = np.array([transform["rotation"][axis] for axis in "wxyz"])
            np.testing.assert_allclose(wxyz * np.sign(wxyz @ expected), expected, atol=1e-14)
            _, reference_pose = contents[f"/{name}/reference"][tick]
            assert reference_pose["frame_id"] == "world"
            assert [*reference_pose["pose"]["position"].values()] == flight["reference"][tick, :3].tolist()
            half = 0.5 * flight.record("reference").yaw[tick]
            turn = {"w": np.cos(half), "x": 0.0, "y": 0.0, "z": np.sin(half)}
            assert reference_pose["pose"]["orientation"] == pytest.approx(turn)
    assert flights["whole"].record("reference").yaw[0] == pytest.approx(0.4)
    tilts = np.abs(flights["failing"]["state"][:, 3:5]).max()
    assert tilts > 0.3


def test_the_scene_has_rotors_in_the_body_frame_and_lines_in_the_world_frame(messages, flights):
    contents, _ = messages
    ((_, scene),) = contents["/whole/scene"]
    vehicle, reference, flown_path = scene["entities"]
    assert (vehicle["frame_id"], vehicle["frame_locked"]) == ("whole/body", True)
    rotor_positions = [[*disc["pose"]["position"].values()] for disc in vehicle["cylinders"]]
    arm = flights["whole"].scenario.vehicle.arm_length
    np.testing.assert_allclose(rotor_positions, [[arm, 0, 0], [0, -arm, 0], [-arm, 0, 0], [0, arm, 0]], atol=1e-15)
    for entity, signal in ((reference, "reference"), (flown_path, "state")):
        assert entity["frame_id"] == "world"
        points = [[*point.values()] for point in entity["lines"][0]["points"]]
        np.testing.assert_array_equal(points, flights["whole"][signal][:, :3])
    assert len({entity["id"] for entity in scene["entities"]}) == 3


def test_shapes_of_the_vehicle_never_expire_and_extend_from_the_centre_to_the_rotors(messages, flights):
    """Foxglove centres a box at its position. Line type 0 is LINE_STRIP, with a scale-invariant width in pixels."""
    contents, _ = messages
    colors = {}
    for name in flights:
        ((time, scene),) = contents[f"/{name}/scene"]
        assert time == 0
        vehicle, *lines = scene["entities"]
        for entity in scene["entities"]:
            assert entity["timestamp"] == entity["lifetime"] == {"sec": 0, "nsec": 0}
        for arm, disc in zip(vehicle["cubes"], vehicle["cylinders"], strict=True):
            turn, size = arm["pose"]["orientation"], arm["size"]
            heading = 2.0 * math.atan2(turn["z"], turn["w"])
            half = 0.5 * size["x"] * np.array([math.cos(heading), math.sin(heading), 0.0])
            middle, rotor = (np.array([*part["pose"]["position"].values()]) for part in (arm, disc))
            np.testing.assert_allclose(middle - half, 0.0, atol=1e-15)
            np.testing.assert_allclose(middle + half, rotor, atol=1e-15)
            assert (turn["x"], turn["y"], size["y"]) == (0.0, 0.0, size["z"])
            assert disc["pose"]["orientation"] == {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}
            assert disc["size"]["x"] == disc["size"]["y"] > disc["size"]["z"] > 0.0
            # Neighbouring discs do not overlap, and arms are thin.
            assert size["y"] < 0.25 * size["x"]
            assert size["y"] < disc["size"]["x"] < math.sqrt(2.0) * size["x"]
            assert disc["bottom_scale"] == disc["top_scale"] == 1.0
        drawn = [line for entity in lines for line in entity["lines"]]
        for line in drawn:
            assert (line["type"], line["scale_invariant"]) == (0, True)
            assert [*line["pose"]["position"].values(), *line["pose"]["orientation"].values()] == [0, 0, 0, 1, 0, 0, 0]
        front, *others = (arm["color"] for arm in vehicle["cubes"])
        reference, path = (line["color"] for line in drawn)
        assert front == path != reference
        assert others == [reference] * 3
        for color in (front, reference, *(disc["color"] for disc in vehicle["cylinders"])):
            assert 0.0 < color["a"] <= 1.0
            assert all(0.0 <= color[part] <= 1.0 for part in "rgb")
        colors[name] = path
    assert colors["whole"] != colors["failing"]


def test_flights_have_different_colors(flights):
    """Colours agree with the plots, as fractions of red, green and blue, and repeat after five flights."""
    colors = []
    for number in range(6):
        scene = next(flight_messages("whole", flights["whole"], number))
        (line,) = scene.data["entities"][-1]["lines"]
        colors.append(tuple(line["color"][part] for part in "rgba"))
    expected = [(*to_rgb(color), 1.0) for color in (BLUE, VERMILION, GREEN, PURPLE, ORANGE)]
    np.testing.assert_allclose(colors[:5], expected, atol=0.005)
    assert colors[5] == colors[0]


def test_a_crash_is_logged_as_an_error(messages, flights):
    ((time, content),) = messages[0]["/failing/log"]
    crash_time = flights["failing"].metrics.crash_time
    assert math.isclose(time, 1e9 * crash_time, abs_tol=1.0)
    assert (content["level"], content["message"]) == (4, f"failing crashed at {crash_time:.2f} s")
    # The message does not refer to a source file.
    assert (content["name"], content["file"], content["line"]) == ("failing", "", 0)


def test_the_attached_scenario_repeats_the_flight(path, flights, tmp_path):
    with path.open("rb") as stream:
        reader = make_reader(stream)
        attached = {each.name: each.data for each in reader.iter_attachments()}
        metrics = {each.name: each.metadata for each in reader.iter_metadata()}
    (tmp_path / "again.yaml").write_bytes(attached["failing/scenario.yaml"])
    assert load_scenario(tmp_path / "again.yaml") == flights["failing"].scenario
    assert YAML(typ="safe").load(attached["whole/scenario.yaml"].decode()).keys() == {"figure_eight"}
    assert float(metrics["whole/metrics"]["rmse"]) == pytest.approx(flights["whole"].metrics.rmse, rel=1e-11)


def test_the_topics_of_a_single_flight_have_the_name_of_its_scenario(flights, tmp_path):
    path = save_mcap(flights["whole"], tmp_path / "one.mcap")
    with path.open("rb") as stream:
        topics = {channel.topic.split("/")[1] for channel in make_reader(stream).get_summary().channels.values()}
    assert topics == {"figure_eight"}


def test_a_missing_flight_and_a_missing_library_are_reported(flights, tmp_path, monkeypatch):
    with pytest.raises(InputError, match="there is no flight to write"):
        save_mcap({}, tmp_path / "none.mcap")
    for module in ("mcap", "mcap.writer"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ImportError, match=r"^mcap is not installed; .*'drake_quad\[mcap\]'"):
        save_mcap(flights, tmp_path / "none.mcap")
    assert not [*tmp_path.iterdir()]


def test_non_finite_numbers_are_written_as_null(flights, tmp_path):
    flight = flights["whole"]

    def broken(signal):
        values = np.where(np.arange(len(flight.time))[:, np.newaxis] == 3, np.nan, flight[signal])
        return {"broken": dataclasses.replace(flight, signals={**flight.signals, signal: values})}

    with save_mcap(broken("wrench"), tmp_path / "flight.mcap").open("rb") as stream:
        messages = make_reader(stream).iter_messages(topics=["/broken/signals/wrench"])
        wrenches = [json.loads(message.data) for _, _, message in messages]
    assert [wrench["thrust"] is None for wrench in wrenches] == [tick == 3 for tick in range(len(flight.time))]
    with pytest.raises(ValueError, match="Out of range float values"):
        save_mcap(broken("state"), tmp_path / "frames.mcap")
    assert [file.name for file in tmp_path.iterdir()] == ["flight.mcap"]
