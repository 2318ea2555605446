"""Parts of a replay are no larger than their vehicle, and its trails, rotors and rates are those of the flight."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pydrake.geometry import Cylinder, Sphere
from test_scene import FRAME, X_LAYOUT, Scene, flights  # noqa: F401 - a fixture

from drake_quad import load_scenario, simulate
from drake_quad.scenario.batch import draw_sample
from drake_quad.visualization.places import places
from drake_quad.visualization.replay import page
from drake_quad.visualization.replay.live import LiveView
from drake_quad.visualization.replay.shapes import Frame, draw_quadrotor


class Recording(Scene):
    """A scene that also keeps all poses of an object, and how it is recorded."""

    def __init__(self):
        super().__init__()
        self.every = {}

    def SetTransform(self, path, transform):
        super().SetTransform(path, transform)
        self.every.setdefault(path, []).append(transform)

    def StartRecording(self, rate, set_visualizations_while_recording):
        super().StartRecording(rate, set_visualizations_while_recording)
        self.shows_while_recording = set_visualizations_while_recording

    def StaticHtml(self):
        return "<html><body></body></html>"


def test_no_part_of_a_vehicle_is_larger_than_it():
    scene = Scene()
    draw_quadrotor(scene, "/v", FRAME, "black")
    reach, disc = FRAME.reach, scene.objects["/v/disc_1"].radius()
    for part in scene.objects.values():
        if isinstance(part, Sphere):
            assert part.radius() < 0.25 * reach
        elif isinstance(part, Cylinder):
            assert part.radius() <= disc
            assert part.length() < 0.25 * reach
    assert scene.objects["/v/motor_1"].radius() < 0.25 * disc
    # Arms begin in the middle.
    assert len([path for path in scene.objects if "arm" in path]) == len(X_LAYOUT)


def test_a_recording_shows_nothing_until_it_is_played_and_has_a_small_point(flights, monkeypatch, tmp_path):  # noqa: F811
    scene = Recording()
    page.draw_replay(scene, flights)
    assert not scene.shows_while_recording
    reach = Frame.of(flights["other"].scenario.vehicle).reach
    assert scene.objects["/reference/point"].radius() < 0.25 * reach
    scene = Recording()
    monkeypatch.setattr(page, "local_meshcat", lambda: scene)
    page.save_swarm({"one": [*flights.values()]}, tmp_path / "swarm.html")
    assert not scene.shows_while_recording
    # Trails of short flights have all of their points, and those of long ones a few hundred.
    for number, flight in enumerate(flights.values()):
        np.testing.assert_array_equal(scene.lines[f"/one_trails/{number}"].T, places(flight.record("state")))
    flight = flights["other"]
    signals = {name: np.repeat(rows, 8, axis=0) for name, rows in flight.signals.items()}
    time = np.linspace(0.0, flight.time[-1], 8 * len(flight.time))
    page.save_swarm({"one": [replace(flight, time=time, signals=signals)]}, tmp_path / "swarm.html")
    shown = scene.lines["/one_trails/0"].T
    assert 150 <= len(shown) < 300
    np.testing.assert_array_equal(shown, places(flight.record("state")).repeat(8, axis=0)[:: len(time) // 150])


def test_a_flight_is_seen_until_any_of_its_numbers_is_not_finite(flights):  # noqa: F811
    flight = flights["other"]
    assert page._seen(flight) is flight
    state = flight["state"].copy()
    state[20:, 3] = np.nan
    seen = page._seen(replace(flight, signals={**flight.signals, "state": state}))
    np.testing.assert_array_equal(seen.time, flight.time[:20])
    assert {len(rows) for rows in seen.signals.values()} == {20}


def test_a_live_view_turns_the_rotors_and_shows_the_sample_that_is_flown():
    scenario = load_scenario("hover", ["duration=0.2", "sample=3", "vehicle.arm_length={choice: [0.1, 0.3]}"])
    drawn = draw_sample(scenario, 3)
    plan = simulate(scenario).plan
    scene = Recording()
    view = LiveView(scene, scenario, plan)
    frame = Frame.of(drawn.vehicle)
    reaches = [np.hypot(*scene.poses[f"/vehicle/disc_{i}"].translation()[:2]) for i in (1, 2, 3, 4)]
    np.testing.assert_allclose(reaches, [np.hypot(rotor.x, rotor.y) for rotor in frame.rotors])
    assert scene.objects["/reference/point"].radius() < 0.25 * frame.reach
    asked = []
    simulator = SimpleNamespace(
        get_system=lambda: "a diagram", set_target_realtime_rate=asked.append, set_monitor=asked.append
    )
    view.watch(simulator, 0.5)
    assert asked == [0.5, view._show]
    scene = Recording()
    flight = simulate(scenario, prepare=lambda simulator: LiveView(scene, scenario, plan).watch(simulator, 0.0))
    speeds = flight["rotor_speed"][0]
    for i, (rotor, speed) in enumerate(zip(frame.rotors, speeds, strict=True), start=1):
        # The first pose is that in which it is drawn; in a thirtieth of a second it turns at a tenth of its speed.
        _, first, *_ = scene.every[f"/vehicle/rotor_{i}"]
        angle = 0.1 * rotor.direction * speed / 30.0
        np.testing.assert_allclose(first.rotation().matrix()[:2, 0], [np.cos(angle), np.sin(angle)], atol=1e-9)


@pytest.mark.parametrize(("wind", "blows"), [("[]", False), ("[{kind: steady, velocity: [1, 0, 0]}]", True)])
def test_wind_is_shown_by_an_arrow_where_it_blows(wind, blows):
    scenario = load_scenario("hover", ["duration=0.1", f"laboratory.wind={wind}"])
    flight, scene = simulate(scenario), Recording()
    assert page._blows_unseen(flight) == blows
    LiveView(scene, scenario, flight.plan)
    assert ("/vehicle_wind/arrow" in scene.objects) == blows
    gust = np.ones_like(flight["wind"])
    assert page._blows_unseen(replace(flight, signals={**flight.signals, "wind": gust}))
