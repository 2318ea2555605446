"""Replays in a real browser, if there is one."""

import re

import numpy as np
import pytest
from browser import CHROMIUM, Browser
from PIL import Image

from drake_quad import load_scenario, simulate
from drake_quad.flight import simulate_samples
from drake_quad.signals import RotorSpeed
from drake_quad.vehicle.rotors import Rotors
from drake_quad.visualization.replay.live import LiveView
from drake_quad.visualization.replay.page import save_replay, save_swarm
from drake_quad.visualization.replay.scene import local_meshcat
from drake_quad.visualization.replay.shapes import Frame, draw_quadrotor, quadrotor_mesh, rotor_poses, turned_by

needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on PATH; Debian's package is chromium")


@pytest.fixture(scope="module")
def flight():
    return simulate(load_scenario("diagrams/figure_eight.yaml", ["duration=8"]))


def watched(page, folder, names, moments):
    """Whether objects of a page are visible, where, and how they are turned, at moments of the flight (s).

    Also pictures at the first and the last of them. The page plays by itself, and goes on from where one stops it.
    """
    rows = ", ".join(
        f"((o) => [Number(o.visible), ...o.position.toArray(), ...o.quaternion.toArray()])"
        f"(viewer.scene_tree.find('{name}'.split('/')).object)"
        for name in names
    )
    told, pictures = [], []
    with Browser(page, folder / "profile") as browser:
        browser.wait_for("typeof viewer !== 'undefined' && viewer.animator.playing && viewer.animator.time > 0.2")
        for moment in moments:
            browser.value(f"scrub.value = {moment}; scrub.oninput();")
            browser.wait_for(f"clock.textContent === '{moment:.1f} s'")
            told.append(browser.value(f"[{rows}]"))
            if moment in (moments[0], moments[-1]):
                pictures.append(browser.screenshot(folder / f"{moment}.png"))
        assert browser.value("viewer.animator.playing") is False
        browser.value("play.click()")
        browser.wait_for(f"viewer.animator.time > {moments[-1]} + 0.2")
        assert browser.console == []
    return [np.array(rows) for rows in zip(*told, strict=True)], pictures


def at(flight, moments):
    """Where a flight is at some moments."""
    return flight["state"][np.searchsorted(flight.time, np.array(moments) - 1e-9), 0:3]


@pytest.mark.slow
@needs_chromium
def test_a_replay_plays_in_a_browser(flight, tmp_path):
    page = save_replay({"figure_eight": flight}, tmp_path / "replay.html")
    assert page.stat().st_size < 5_000_000
    names = ["figure_eight", "figure_eight/rotor_1", "figure_eight/rotor_2", "reference", "figure_eight_trail/10"]
    moments = [round(0.3 * k, 1) for k in range(1, 15)]
    (vehicle, rotor, other_rotor, reference, trail), pictures = watched(page, tmp_path, names, moments)
    assert np.ptp(vehicle[:, 1:4], axis=0).max() > 0.8
    np.testing.assert_allclose(vehicle[:, 1:4], at(flight, moments), atol=0.01)
    assert np.linalg.norm(vehicle[:, 1:4] - reference[:, 1:4], axis=1).max() < 0.1
    # Looks are too few to follow every turn.
    assert len(np.unique(rotor[:, 6].round(3))) > 5
    assert not np.allclose(rotor[:, 6], other_rotor[:, 6])
    # The piece from 2.5 to 2.75 s is not there at first, and then stays.
    np.testing.assert_array_equal(trail[:, 0], np.array(moments) > 2.75)
    early, late = (np.asarray(Image.open(picture).convert("L"), dtype=float) for picture in pictures)
    assert 20 < (np.abs(late - early) > 30.0).sum() < 0.1 * early.size


@pytest.mark.slow
@needs_chromium
def test_a_replay_can_be_opened_at_a_moment(flight, tmp_path):
    page = save_replay({"figure_eight": flight}, tmp_path / "replay.html")
    with Browser(page, tmp_path / "profile", fragment="#t=5.0") as browser:
        browser.wait_for("document.getElementById('clock')?.textContent === '5.0 s'")
        assert browser.value("viewer.animator.playing") is False
        place = browser.value("viewer.scene_tree.find(['figure_eight']).object.position.toArray()")
        assert browser.console == []
    assert place == pytest.approx(at(flight, 5.0), abs=0.01)


@pytest.mark.slow
@needs_chromium
def test_a_swarm_replays_its_crashes(tmp_path):
    flights = simulate_samples(load_scenario("diagrams/robustness.yaml", ["duration=5"]), range(20))
    failure = "vehicle.rotor_failure={rotor: 1, time: 1.0, speed_factor: 0.0}"
    crash = simulate(load_scenario("diagrams/figure_eight.yaml", [failure]))
    assert crash.metrics.crashed
    page = save_swarm({"all": [*flights, crash]}, tmp_path / "swarm.html")
    count = 1 + sum(bool(flight.metrics.crashed) for flight in flights)
    assert f"21 flights, {count} crashed" in page.read_text(encoding="utf-8")
    (first, last), _ = watched(page, tmp_path, ["all/0", "all/20"], [0.5, 1.5, 2.5, 4.5])
    assert np.ptp(first[:, 1:4], axis=0).max() > 0.3
    # What has crashed stays where it is.
    assert last[-1, 1:4] == pytest.approx(crash["state"][-1, 0:3], abs=1e-3)


@pytest.mark.slow
def test_a_page_needs_no_network_and_is_small(flight, tmp_path):
    page = save_replay({"one": flight, "two": flight}, tmp_path / "replay.html").read_text(encoding="utf-8")
    assert not re.search(r'<(script|link|img)[^>]* (src|href)="(?!data:)', page)
    swarm = save_swarm({"all": [flight] * 100}, tmp_path / "swarm.html")
    # 10 frames a second for 25 s take three times as much as these 8 s do beyond Meshcat's own 2.3 MB.
    assert 2.3e6 + 3.2 * (swarm.stat().st_size - 2.3e6) < 12e6


@pytest.mark.slow
def test_a_flight_is_shown_as_long_as_it_is_finite(tmp_path):
    flight = simulate(load_scenario("diagrams/outdoor.yaml", ["duration=1"]))
    flight["state"][-10:] = np.nan
    whole = save_replay({"diverged": flight}, tmp_path / "replay.html").read_text(encoding="utf-8")
    assert f'max="{flight.time[-11]:.3f}"' in whole
    assert save_swarm({"diverged": [flight, flight]}, tmp_path / "swarm.html").exists()
    short = simulate(load_scenario("diagrams/hover.yaml", ["duration=0.02"]))
    assert save_replay({"short": short}, tmp_path / "short.html").exists()


def test_rotors_1_and_3_turn_clockwise():
    plus = Rotors.plus()
    assert list(np.sign(turned_by(plus, RotorSpeed(*[200.0] * 4), 0.01))) == [-1.0, 1.0, -1.0, 1.0]
    front, right, back, left = (pose.translation() for pose in rotor_poses(plus, np.zeros(4)))
    assert (front[0], right[1], back[0], left[1]) == pytest.approx((0.17, -0.17, -0.17, 0.17))


def test_rotors_are_drawn_where_they_are():
    """An x that turns the other way: two arms in front, and propellers that do not touch."""
    rotors = Rotors.x(length=0.1, width=0.08, rotor_1_direction=1.0)
    places = np.array([pose.translation() for pose in rotor_poses(rotors, np.zeros(4))])
    np.testing.assert_allclose(places[:, :2], [[0.05, -0.04], [-0.05, -0.04], [-0.05, 0.04], [0.05, 0.04]])
    assert list(np.sign(turned_by(rotors, RotorSpeed(*[200.0] * 4), 0.01))) == [1.0, -1.0, 1.0, -1.0]
    meshcat = local_meshcat()
    frame = Frame(rotors, (np.zeros(3),) * 4)
    draw_quadrotor(meshcat, "/x", frame, "black")
    assert [meshcat.HasPath(f"/x/nose_{number}") for number in (1, 2, 3, 4)] == [True, False, False, True]
    corners = np.array(quadrotor_mesh(frame).vertices())
    assert np.abs(corners[:, 1]).max() < 0.04 + 0.5 * 0.08


def test_an_h_is_drawn_as_an_h():
    """Two bars from front to back and one across; an x with the same rotors has four arms from its middle."""
    layout = "nominal.layout={{kind: {}, length: 0.2, width: 0.3}}"
    frames = {
        kind: Frame.of(load_scenario("diagrams/hover.yaml", [layout.format(kind)]).vehicle) for kind in ("h", "x")
    }
    assert frames["h"].rotors == frames["x"].rotors
    assert not np.any(frames["x"].roots)
    np.testing.assert_array_equal(frames["h"].roots, [[0, -0.15, 0], [0, -0.15, 0], [0, 0.15, 0], [0, 0.15, 0]])
    meshcat = local_meshcat()
    for kind, frame in frames.items():
        draw_quadrotor(meshcat, f"/{kind}", frame, "black")
        arms = [meshcat.HasPath(f"/{kind}/{name}") for name in ("crossbar_1", "crossbar_2", "crossbar_3", "arm_4")]
        assert arms == [kind == "h", kind == "h", False, True]
        mesh = quadrotor_mesh(frame)
        corners = np.array(mesh.vertices())
        middles = np.array([corners[[part.vertex(i) for i in range(3)]].mean(axis=0) for part in mesh.triangles()])
        bars = middles[np.abs(middles[:, 2]) < 0.01]
        on_sides, across = np.abs(np.abs(bars[:, 1]) - 0.15) < 0.01, np.abs(bars[:, 0]) < 0.01
        assert (on_sides | across).all() == (kind == "h")


def test_a_live_view_shows_where_the_vehicle_is():
    scenario = load_scenario("diagrams/outdoor.yaml", ["duration=1"])
    meshcat = local_meshcat()
    assert meshcat.web_url().startswith("http://127.0.0.1:")

    def prepare(simulator):
        view = LiveView(meshcat, scenario, flight_plan)
        view.watch(simulator, 0.0)

    flight_plan = simulate(scenario).plan
    flight = simulate(scenario, prepare=prepare)
    assert meshcat.HasPath("/vehicle/rotor_4")
    assert meshcat.HasPath("/vehicle_wind/arrow")
    assert meshcat.HasPath("/vehicle_trail/2")
    assert flight.time[-1] == pytest.approx(1.0)
