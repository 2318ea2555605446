"""Tests that angles are in radians, and that an angle in degrees is refused with its value in radians."""

import math
import re

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from drake_quad import InputError, load_scenario
from drake_quad.flight.mission import plan_route
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario.distributions import Model
from drake_quad.scenario.files.loading import load_mission


def submodels(kind=Model):
    for each in kind.__subclasses__():
        yield each
        yield from submodels(each)


# These fields have no limit. The yaw of a trajectory may turn many times, and for waypoints only the change between two
# yaws is limited.
UNLIMITED_ANGLE_FIELDS = {("YawKnot", "yaw"), ("Waypoint", "yaw")}
ANGLE_FIELDS = sorted(
    {
        (model.__name__, name): field
        for model in submodels()
        for name, field in model.model_fields.items()
        if re.search(r"\(rad\)", field.description or "") and (model.__name__, name) not in UNLIMITED_ANGLE_FIELDS
    }.items(),
    key=lambda each: each[0],
)


@pytest.mark.parametrize(
    "field", [field for _, field in ANGLE_FIELDS], ids=[".".join(name) for name, _ in ANGLE_FIELDS]
)
def test_every_angle_of_the_language_is_refused_in_degrees(field):
    adapter = TypeAdapter(field.rebuild_annotation())
    for degrees in (90.0, [10.0, 20.0, -150.0]):
        with pytest.raises(ValidationError) as caught:
            adapter.validate_python(degrees)
        messages = " ".join(error["msg"] for error in caught.value.errors())
        if "degrees are" in messages:
            break
    assert re.search(r"must be in radians, at most [\d.]+ in magnitude; -?\d+ degrees are -?[\d.]+ rad", messages)


@pytest.mark.parametrize(
    ("override", "words"),
    [
        (
            "route.yaw=45",
            "route.yaw is 45, but must be in radians, at most 12.57 in magnitude; 45 degrees are 0.7854 rad",
        ),
        ("route.yaw={uniform: {min: 0, max: 90}}", "90 degrees are 1.571 rad"),
        ("route.yaw={normal: {mean: -90, standard_deviation: 0.1}}", "-90 degrees are -1.571 rad"),
        ("route.yaw={choice: [0, 20]}", "20 degrees are 0.3491 rad"),
        ("crash.tilt=80", "at most 1.571 in magnitude; 80 degrees are 1.396 rad"),
        ("laboratory.motion_capture.misalignment.1=5", "misalignment.1 is 5, .* 5 degrees are 0.08727 rad"),
    ],
)
def test_the_message_about_degrees_gives_the_value_in_radians(diagrams, override, words):
    with pytest.raises(InputError, match=re.escape(words).replace(r"\.\*", ".*")):
        load_scenario(diagrams / "hover.yaml", [override])


@pytest.mark.parametrize(
    "override",
    [
        "route.yaw=12.5",
        "route.yaw=-12.5",
        "route.yaw={normal: {mean: 0, standard_deviation: 0.3}}",
        "crash.tilt=1.5",
        "crash.tilt=null",
        "laboratory.motion_capture.misalignment=[0, -0.01, {normal: {mean: 0.01, standard_deviation: 0.02}}]",
        "laboratory.wind=[{kind: steady, speed: 1, heading: -6.3}]",
    ],
)
def test_angles_in_radians_are_accepted(diagrams, override):
    load_scenario(diagrams / "hover.yaml", [override])


def route_with_yaws(*yaws):
    waypoints = [{"point": [float(i), 0.0, 1.0], "yaw": yaw} for i, yaw in enumerate(yaws)]
    return {"route": {"kind": "waypoints", "heading": "waypoints", "waypoints": waypoints, "times": "heuristic"}}


def test_yaws_of_waypoints_may_add_up_to_several_turns(diagrams):
    yaws = [1.0 + math.pi / 2.0 * i for i in range(20)]
    mission = load_mission(diagrams / "hover.yaml", route_with_yaws(*yaws))
    plan = plan_route(mission)
    assert evaluate(plan.yaw, plan.yaw.times[-1:])[0, 0] == pytest.approx(yaws[-1])


@pytest.mark.parametrize(("yaws", "index"), [((0, 45, 90), 1), ((20, 21, 22), 0), ((12, 15, 19), 2)])
def test_yaws_of_waypoints_in_degrees_are_refused(diagrams, yaws, index):
    with pytest.raises(InputError, match=rf"route.waypoints.{index}.yaw is {yaws[index]}, .*degrees are"):
        load_mission(diagrams / "hover.yaml", route_with_yaws(*yaws))


def test_the_yaw_of_a_trajectory_may_turn_any_number_of_times(diagrams):
    """The test covers trajectories of knots, trajectories of pieces, and a circle."""
    knots = [{"time": 0.0, "position": [0.0, 0.0, 1.0]}, {"time": 60.0, "position": [1.0, 0.0, 1.0]}]
    yaw_knots = [{"time": 0.0, "yaw": 100.0, "yaw_rate": 1.0}, {"time": 60.0, "yaw": 160.0, "yaw_rate": 1.0}]
    load_mission(diagrams / "hover.yaml", {"route": {"kind": "trajectory", "knots": knots, "yaw_knots": yaw_knots}})
    piece = {"duration": 60.0, "x": [0.0], "y": [0.0], "z": [1.0], "yaw": [50.0, 1.0]}
    load_mission(diagrams / "hover.yaml", {"route": {"kind": "trajectory", "pieces": [piece]}})
    circle = {"kind": "circle", "laps": 9, "heading": "along_path"}
    plan = plan_route(load_mission(diagrams / "hover.yaml", {"route": circle}))
    assert np.ptp(evaluate(plan.yaw, plan.yaw.times)) > 4.0 * math.pi


def test_a_constant_yaw_of_a_trajectory_in_degrees_is_refused(diagrams):
    knots = [{"time": 0.0, "position": [0.0, 0.0, 1.0]}, {"time": 60.0, "position": [1.0, 0.0, 1.0]}]
    yaw_knots = [{"time": 0.0, "yaw": 90.0}, {"time": 60.0, "yaw": 90.0}]
    pieces = [{"duration": 30.0, "x": [0.0], "y": [0.0], "z": [1.0], "yaw": [-90.0, 0.0]}] * 2
    for fields, field in (
        ({"knots": knots, "yaw_knots": yaw_knots}, r"yaw_knots.0.yaw is 90.0"),
        ({"pieces": pieces}, r"pieces.0.yaw.0 is -90.0"),
    ):
        with pytest.raises(InputError, match=rf"route.{field}, .*degrees are"):
            load_mission(diagrams / "hover.yaml", {"route": {"kind": "trajectory", **fields}})
    yaw_knots[1]["yaw"] = 91.0
    load_mission(diagrams / "hover.yaml", {"route": {"kind": "trajectory", "knots": knots, "yaw_knots": yaw_knots}})
