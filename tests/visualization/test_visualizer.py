"""Tests that the Meshcat visualizer shows poses, rotors, wind and trail in diagrams of plain Drake."""

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantVectorSource, LogVectorOutput
from test_replay_parts import Recording

from drake_quad import build_laboratory_diagram, build_tracking_diagram, load_scenario, plan_route
from drake_quad.scenario.batch import draw_sample
from drake_quad.signals import Reference, State
from drake_quad.visualization.replay.scene import local_meshcat
from drake_quad.visualization.replay.shapes import Frame
from drake_quad.visualization.replay.visualizer import QuadrotorVisualizer

HOVER = load_scenario("hover")
VEHICLE_STATE = State(1.0, -2.0, 3.0, 0.1, -0.2, 0.3, *6 * [0.0])  # position in m and attitude in rad, at rest


def shown_scene(time, scenario=HOVER, **constants):
    """Return a scene after the visualizer has shown constant signals until a given time, s."""
    builder, scene = DiagramBuilder(), Recording()
    visualizer = QuadrotorVisualizer.add_to_builder(builder, scene, scenario, name="mine")
    for name, value in constants.items():
        source = builder.AddSystem(ConstantVectorSource(np.array(value, dtype=float)))
        builder.Connect(source.get_output_port(), visualizer.GetInputPort(name))
    Simulator(builder.Build()).AdvanceTo(time)
    return scene


def test_only_the_vehicle_is_shown_if_only_the_state_is_connected():
    scene = shown_scene(0.1, state=VEHICLE_STATE)
    pose = scene.poses["/mine"]
    np.testing.assert_allclose(pose.translation(), [1.0, -2.0, 3.0])
    np.testing.assert_allclose(pose.rotation().matrix(), RollPitchYaw(0.1, -0.2, 0.3).ToRotationMatrix().matrix())
    assert all(path.startswith("/mine/") for path in scene.objects)


def test_rotors_turn_in_their_directions_at_a_tenth_of_their_speeds():
    speeds = np.array([10.0, 20.0, 30.0, 40.0])
    scene = shown_scene(0.5, state=VEHICLE_STATE, rotor_speed=speeds)
    for i, (rotor, speed) in enumerate(zip(Frame.of(HOVER.vehicle).rotors, speeds, strict=True), start=1):
        angle = 0.1 * rotor.direction * speed * 0.5
        turned = scene.poses[f"/mine/rotor_{i}"].rotation().matrix()
        np.testing.assert_allclose(turned[:2, 0], [np.cos(angle), np.sin(angle)], atol=1e-9)


def test_a_point_shows_the_reference_and_an_arrow_the_wind():
    reference = np.zeros(len(Reference._fields))
    reference[:3] = [4.0, 5.0, 6.0]
    scene = shown_scene(0.1, state=VEHICLE_STATE, reference=reference, wind=[0.0, 3.0, 4.0])
    np.testing.assert_allclose(scene.poses["/mine_reference"].translation(), [4.0, 5.0, 6.0])
    assert scene.objects["/mine_reference"].radius() < 0.25 * Frame.of(HOVER.vehicle).max_rotor_distance
    np.testing.assert_allclose(scene.poses["/mine_wind"].rotation().matrix()[:, 0], [0.0, 0.6, 0.8], atol=1e-12)
    # The arrow is 15 cm long for each m/s.
    assert scene.properties["/mine_wind/arrow", "scale"][0] == pytest.approx(0.75)


@pytest.mark.slow
def test_a_flight_is_shown_32_times_per_second_with_its_trail():
    scenario = load_scenario("figure_eight", ["laboratory.wind=[{kind: steady, velocity: [1, 0, 0]}]"])
    builder, scene = DiagramBuilder(), Recording()
    loop = builder.AddNamedSystem("loop", build_tracking_diagram(scenario))
    QuadrotorVisualizer.add_to_builder(builder, scene, scenario, loop, plan=plan_route(scenario))
    log = LogVectorOutput(loop.GetOutputPort("state"), builder, publish_period=1.0 / 32.0)
    diagram = builder.Build()
    simulator = Simulator(diagram)
    simulator.AdvanceTo(2.0)
    flown = log.FindLog(simulator.get_context()).data()[:3].T
    np.testing.assert_array_equal([pose.translation() for pose in scene.every["/vehicle"]], flown)
    assert len(flown) == 65
    trail = [scene.meshes[f"/vehicle_trail/{i}"][0] for i in range(8)]
    # The sections of a tube are triangles around the points of the path.
    section_centres = np.vstack([vertices.T.reshape(-1, 3, 3).mean(axis=1) for vertices in trail])
    assert np.linalg.norm(section_centres[:, None] - flown, axis=2).min(axis=1).max() < 1e-9
    np.testing.assert_allclose(section_centres[[0, -1]], flown[[0, 64]], atol=1e-9)
    assert {"/vehicle_wind/arrow", "/vehicle_reference", "/floor"} <= {*scene.objects, *scene.meshes}

    # A new simulation starts without the trail of the previous one.
    simulator.reset_context(diagram.CreateDefaultContext())
    simulator.Initialize()
    assert not scene.HasPath("/vehicle_trail")


@pytest.mark.parametrize(("wind", "has_arrow"), [("[]", False), ("[{kind: steady, velocity: [1, 0, 0]}]", True)])
def test_an_arrow_is_drawn_only_for_wind_that_is_not_drawn_as_jets(wind, has_arrow):
    scenario = load_scenario("hover", [f"laboratory.wind={wind}"])
    builder, laboratory = DiagramBuilder(), build_laboratory_diagram(scenario)
    builder.AddNamedSystem("laboratory", laboratory)
    visualizer = QuadrotorVisualizer.add_to_builder(builder, Recording(), scenario, laboratory)
    assert builder.IsConnectedOrExported(visualizer.GetInputPort("rotor_speed"))
    assert not builder.IsConnectedOrExported(visualizer.GetInputPort("reference"))
    assert builder.IsConnectedOrExported(visualizer.GetInputPort("wind")) == has_arrow


@pytest.mark.slow
@pytest.mark.parametrize("name", ["laboratory:low_wind", "outdoor"])
def test_a_watched_simulator_is_shown_from_the_start_after_each_restart(name):
    scenario, scene = load_scenario(name), Recording()
    diagram = build_tracking_diagram(scenario)
    simulator = Simulator(diagram)
    QuadrotorVisualizer(scene, scenario).watch(simulator)
    simulator.AdvanceTo(0.2)
    first = [pose.translation() for pose in scene.every.pop("/vehicle")]
    simulator.reset_context(diagram.CreateDefaultContext())
    simulator.AdvanceTo(0.2)
    np.testing.assert_array_equal([pose.translation() for pose in scene.every["/vehicle"]], first)
    # An arrow shows wind that does not come from fans. Fans are part of the scene of `low_wind`.
    assert ("/vehicle_wind/arrow" in scene.meshes) == (name == "outdoor")


def test_drake_names_the_state_port_if_it_is_not_connected():
    builder = DiagramBuilder()
    QuadrotorVisualizer.add_to_builder(builder, Recording(), HOVER)
    with pytest.raises(RuntimeError, match="state"):
        Simulator(builder.Build()).AdvanceTo(0.1)


def test_the_vehicle_of_the_sample_is_drawn():
    scenario = load_scenario("hover", ["sample=3", "vehicle.arm_length={choice: [0.1, 0.3]}"])
    scene = Recording()
    QuadrotorVisualizer(scene, scenario)
    arm_lengths = [np.hypot(*scene.poses[f"/vehicle/disc_{i}"].translation()[:2]) for i in (1, 2, 3, 4)]
    np.testing.assert_allclose(arm_lengths, draw_sample(scenario, 3).vehicle.arm_length)


@pytest.mark.slow
def test_an_existing_diagram_can_be_shown():
    """The scene is Drake's Meshcat.

    With steps of 10 ms, frames are 40 ms apart, the smallest multiple of 10 ms above 1/32 s.
    """
    scenario = load_scenario("outdoor", ["duration=1"])
    simulator = Simulator(build_tracking_diagram(scenario))
    meshcat, times = local_meshcat(), []
    assert meshcat.web_url().startswith("http://127.0.0.1:")
    visualizer = QuadrotorVisualizer(meshcat, scenario, plan_route(scenario))
    show = visualizer._show
    visualizer._show = lambda context: (times.append(context.get_time()), show(context))[1]
    visualizer.watch(simulator)
    simulator.AdvanceTo(0.8)
    np.testing.assert_allclose(times, np.arange(0.0, 0.81, 0.04), atol=1e-9)
    for path in ("/vehicle/rotor_4", "/vehicle_wind/arrow", "/vehicle_reference", "/vehicle_trail/1"):
        assert meshcat.HasPath(path)
