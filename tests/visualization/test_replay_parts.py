"""Tests that drawn parts are no larger than their vehicle, and that trails, rotors and frames match the flight."""

from dataclasses import replace

import numpy as np
import pytest
from pydrake.geometry import Cylinder, Sphere
from test_scene import FRAME, X_LAYOUT, Scene, flights  # noqa: F401 - a fixture

from drake_quad import load_scenario, simulate
from drake_quad.visualization.positions import positions
from drake_quad.visualization.replay import page
from drake_quad.visualization.replay.shapes import Frame, draw_quadrotor


class Recording(Scene):
    """Scene that also keeps all poses of an object, and the settings of its recording."""

    def __init__(self):
        super().__init__()
        self.every = {}

    def SetTransform(self, path, transform, time_in_recording=None):
        super().SetTransform(path, transform, time_in_recording)
        self.every.setdefault(path, []).append(transform)

    def StartRecording(self, rate, set_visualizations_while_recording):
        super().StartRecording(rate, set_visualizations_while_recording)
        self.shows_while_recording = set_visualizations_while_recording

    def StaticHtml(self):
        return "<html><body></body></html>"


def test_no_part_is_larger_than_its_vehicle():
    scene = Scene()
    draw_quadrotor(scene, "/v", FRAME, "black")
    max_rotor_distance, disc = FRAME.max_rotor_distance, scene.objects["/v/disc_1"].radius()
    for part in scene.objects.values():
        if isinstance(part, Sphere):
            assert part.radius() < 0.25 * max_rotor_distance
        elif isinstance(part, Cylinder):
            assert part.radius() <= disc
            assert part.length() < 0.25 * max_rotor_distance
    assert scene.objects["/v/motor_1"].radius() < 0.25 * disc
    # Arms begin in the middle of the vehicle.
    assert len([path for path in scene.objects if "arm" in path]) == len(X_LAYOUT)


def test_a_scene_is_not_updated_while_it_is_recorded_and_its_parts_have_suitable_sizes(flights, monkeypatch, tmp_path):  # noqa: F811
    scene = Recording()
    page.draw_replay(scene, flights)
    assert not scene.shows_while_recording
    max_rotor_distance = Frame.of(flights["other"].scenario.vehicle).max_rotor_distance
    assert scene.objects["/reference/point"].radius() < 0.25 * max_rotor_distance
    scene = Recording()
    monkeypatch.setattr(page, "local_meshcat", lambda: scene)
    page.save_swarm({"one": [*flights.values()]}, tmp_path / "swarm.html")
    assert not scene.shows_while_recording
    # Trails of short flights contain all points; trails of long flights contain a few hundred.
    for number, flight in enumerate(flights.values()):
        np.testing.assert_array_equal(scene.lines[f"/one_trails/{number}"].T, positions(flight.record("state")))
    flight = flights["other"]
    signals = {name: np.repeat(rows, 8, axis=0) for name, rows in flight.signals.items()}
    time = np.linspace(0.0, flight.time[-1], 8 * len(flight.time))
    page.save_swarm({"one": [replace(flight, time=time, signals=signals)]}, tmp_path / "swarm.html")
    trail_points = scene.lines["/one_trails/0"].T
    assert 150 <= len(trail_points) < 300
    np.testing.assert_array_equal(
        trail_points, positions(flight.record("state")).repeat(8, axis=0)[:: len(time) // 150]
    )


def test_a_flight_is_shown_until_its_state_is_not_finite(flights):  # noqa: F811
    flight = flights["other"]
    assert page._before_divergence(flight) is flight
    state = flight["state"].copy()
    state[20:, 3] = np.nan
    shown_flight = page._before_divergence(replace(flight, signals={**flight.signals, "state": state}))
    np.testing.assert_array_equal(shown_flight.time, flight.time[:20])
    assert {len(rows) for rows in shown_flight.signals.values()} == {20}


@pytest.mark.parametrize(("wind", "has_arrow"), [("[]", False), ("[{kind: steady, velocity: [1, 0, 0]}]", True)])
def test_wind_is_shown_by_an_arrow_unless_fans_show_it(wind, has_arrow):
    scenario = load_scenario("hover", ["duration=0.1", f"laboratory.wind={wind}"])
    flight = simulate(scenario)
    assert page._has_undrawn_wind(flight) == has_arrow
    gust = np.ones_like(flight["wind"])
    assert page._has_undrawn_wind(replace(flight, signals={**flight.signals, "wind": gust}))
