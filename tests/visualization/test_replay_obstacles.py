"""Tests that replays show and name obstacles, and report crashes into them."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from browser import CHROMIUM, Browser

from drake_quad import load_scenario, simulate
from drake_quad.visualization.replay.page import save_replay
from drake_quad.visualization.replay.page_data import page_data
from drake_quad.visualization.replay.scene import SceneRoom, draw_surroundings, local_meshcat, reference_points

POST = "post: {kind: cylinder, centre: [1.0, 0.5, 1.5], radius: 0.2, height: 3.0}"
WALL = "wall: {kind: box, centre: [-1.5, 0.0, 1.0], size: [0.2, 200.0, 2.0]}"
BALL = "ball: {kind: sphere, centre: [0.5, 0.0, 1.0], radius: 0.2}"


@pytest.fixture(scope="module")
def hover():
    space = f"space={{obstacles: {{{POST}, {WALL}}}}}"
    return simulate(load_scenario("hover", ["duration=1", space]))


@pytest.fixture(scope="module")
def crash():
    """Return a hover that a strong wind blows into an obstacle."""
    wind = ["vehicle.linear_drag=0.3", "laboratory.wind=[{kind: steady, velocity: [5, 0, 0]}]"]
    flight = simulate(load_scenario("hover", ["duration=4", f"space={{obstacles: {{{BALL}}}}}", *wind]))
    assert flight.obstacle_hit == "ball"
    return flight


@pytest.mark.slow
def test_the_room_contains_whole_obstacles_and_the_near_part_of_a_long_wall(hover):
    room = draw_surroundings(local_meshcat(), hover.scenario, hover.plan, reference_points(hover.plan))
    assert np.all(room.low <= [0.8, 0.3, 0.0])
    assert np.all(room.high >= [1.2, 0.7, 3.0])
    assert np.abs([room.low[1], room.high[1]]).max() == pytest.approx(3.0)
    np.testing.assert_allclose(room.names["post"], [1.0, 0.5, 3.0])


def test_page_data_name_the_obstacle_of_a_crash(hover):
    room = SceneRoom(np.zeros(3), np.ones(3), 0.2, {"post": np.array([1.0, 0.5, 3.0])})
    group = [
        replace(hover, metrics=hover.metrics._replace(crash_time=time), obstacle_hit=name)
        for time, name in ((0.8, "post"), (0.4, None), (0.2, "wall"))
    ]
    data = json.loads(page_data({"all": group}, {"all": "#000000"}, dict.fromkeys("abc", "/x"), room))
    assert data["curves"][0]["crashes"] == [0.2, 0.4, 0.8]
    assert data["curves"][0]["into"] == ["wall", None, "post"]
    assert data["marks"][-1] == {"at": [1.0, 0.5, 3.0], "text": "post", "color": "#555555"}


def test_page_data_contain_only_numbers_that_json_allows(hover):
    room = SceneRoom(np.zeros(3), np.ones(3), 0.2, {"post": np.array([np.nan, 0.5, 3.0])})
    with pytest.raises(ValueError, match="JSON"):
        page_data({"all": [hover]}, {"all": "#000000"}, {"a": "/x"}, room)


@pytest.mark.long
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on PATH; Debian's package is chromium")
def test_a_page_names_obstacles_and_the_one_crashed_into(crash, tmp_path):
    page = save_replay({"one": crash}, tmp_path / "replay.html")
    end = f"{crash.metrics.crash_time:.1f}"
    with Browser(page, tmp_path / "profile") as browser:
        browser.wait_for("typeof viewer !== 'undefined' && viewer.animator.playing && viewer.animator.time > 0.2")
        browser.value(f"scrub.value = {crash.time[-1]}; scrub.oninput();")
        browser.wait_for(f"key.textContent.includes('crashed into ball at {end} s')")
        browser.wait_for("[...labels.children].some((l) => l.textContent === 'ball' && l.style.display !== 'none')")
        assert browser.console == []
    assert re.search(r'"text":"ball"', page.read_text(encoding="utf-8"))
