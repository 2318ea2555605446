"""Tests of replays in a real browser, if one is installed."""

import itertools
import json
import re
from dataclasses import replace

import numpy as np
import pytest
from browser import CHROMIUM, Browser
from matplotlib.transforms import Bbox
from PIL import Image

from drake_quad import load_scenario, simulate
from drake_quad.flight.simulation import simulate_samples
from drake_quad.signals import RotorSpeed
from drake_quad.vehicle.rotors import Rotors
from drake_quad.visualization.positions import positions
from drake_quad.visualization.replay.page import save_replay, save_swarm
from drake_quad.visualization.replay.page_data import page_data
from drake_quad.visualization.replay.scene import SceneRoom, local_meshcat, reference_points, round_spacing
from drake_quad.visualization.replay.shapes import Frame, draw_quadrotor, quadrotor_mesh, rotation_angles, rotor_poses

needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on PATH; Debian's package is chromium")


@pytest.fixture(scope="module")
def flight():
    return simulate(load_scenario("diagrams/figure_eight.yaml", ["duration=8"]))


def watch_replay(page, folder, names, moments):
    """Return the visibility, position and attitude of objects on a page at the given times of the flight (s).

    Also return pictures at the first and the last time. The replay starts automatically, and is resumed after the pause
    for each time.
    """
    rows = ", ".join(
        f"((o) => [Number(o.visible), ...o.position.toArray(), ...o.quaternion.toArray()])"
        f"(viewer.scene_tree.find('{name}'.split('/')).object)"
        for name in names
    )
    poses, pictures = [], []
    with Browser(page, folder / "profile") as browser:
        browser.wait_for("typeof viewer !== 'undefined' && viewer.animator.playing && viewer.animator.time > 0.2")
        for moment in moments:
            browser.value(f"scrub.value = {moment}; scrub.oninput();")
            browser.wait_for(f"clock.textContent === '{moment:.1f} s'")
            poses.append(browser.value(f"[{rows}]"))
            if moment in (moments[0], moments[-1]):
                pictures.append(browser.screenshot(folder / f"{moment}.png"))
        assert browser.value("viewer.animator.playing") is False
        browser.value("play.click()")
        browser.wait_for(f"viewer.animator.time > {moments[-1]} + 0.2")
        assert browser.console == []
    return [np.array(rows) for rows in zip(*poses, strict=True)], pictures


def positions_at(flight, moments):
    """Return the positions of a flight at the given times."""
    return flight["state"][np.searchsorted(flight.time, np.array(moments) - 1e-9), 0:3]


@pytest.mark.long
@needs_chromium
def test_a_replay_plays_in_a_browser(flight, tmp_path):
    page = save_replay({"figure_eight": flight}, tmp_path / "replay.html")
    assert page.stat().st_size < 5_000_000
    names = ["figure_eight", "figure_eight/rotor_1", "figure_eight/rotor_2", "reference", "figure_eight_trail/10"]
    moments = [round(0.3 * k, 1) for k in range(1, 15)]
    (vehicle, rotor, other_rotor, reference, trail), pictures = watch_replay(page, tmp_path, names, moments)
    assert np.ptp(vehicle[:, 1:4], axis=0).max() > 0.8
    np.testing.assert_allclose(vehicle[:, 1:4], positions_at(flight, moments), atol=0.01)
    assert np.linalg.norm(vehicle[:, 1:4] - reference[:, 1:4], axis=1).max() < 0.1
    # The times are too far apart to count the revolutions of the rotors.
    assert len(np.unique(rotor[:, 6].round(3))) > 5
    assert not np.allclose(rotor[:, 6], other_rotor[:, 6])
    # The piece of the trail from 2.5 to 2.75 s is invisible at first. Once it has appeared, it stays.
    np.testing.assert_array_equal(trail[:, 0], np.array(moments) > 2.75)
    first_picture, last_picture = (np.asarray(Image.open(picture).convert("L"), dtype=float) for picture in pictures)
    assert 20 < (np.abs(last_picture - first_picture) > 30.0).sum() < 0.1 * first_picture.size


@pytest.mark.long
@needs_chromium
def test_a_replay_can_be_opened_at_a_given_time(flight, tmp_path):
    page = save_replay({"figure_eight": flight}, tmp_path / "replay.html")
    with Browser(page, tmp_path / "profile", fragment="#t=5.0") as browser:
        browser.wait_for("document.getElementById('clock')?.textContent === '5.0 s'")
        assert browser.value("viewer.animator.playing") is False
        position = browser.value("viewer.scene_tree.find(['figure_eight']).object.position.toArray()")
        assert browser.console == []
    assert position == pytest.approx(positions_at(flight, 5.0), abs=0.01)


def open_replay(page, folder, fragment="#t=3.0"):
    """Open a page in a browser, wait until the replay shows the time in the fragment (s), and return the browser."""
    browser = Browser(page, folder / "profile", fragment=fragment)
    browser.wait_for(f"document.getElementById('clock')?.textContent === '{float(fragment[3:]):.1f} s'")
    return browser


def resize(browser, width, height):
    """Resize the window, and wait until the scene has its size."""
    browser.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
    browser.wait_for(
        f"viewer.renderer.domElement.clientWidth === {width} && document.getElementById('errors').clientWidth > 0"
        f" && viewer.renderer.domElement.clientHeight + overlay.offsetHeight === {height}"
    )


def on_screen(browser, points):
    """Return the coordinates (n, 3) of world points in the view; each is between -1 and 1 for a visible point."""
    rows = [[x, z, -y] for x, y, z in np.asarray(points, dtype=float).tolist()]
    return np.array(
        browser.value(
            f"{json.dumps(rows)}.map((p) => viewer.camera.position.clone().set(...p).project(viewer.camera).toArray())"
        )
    )


@pytest.mark.long
@needs_chromium
@pytest.mark.parametrize(
    ("spec", "overrides"),
    [
        ("crazyswarm2.yaml:log08", ["duration=4"]),
        ("laboratory.yaml:high_wind", ["duration=4"]),
        (
            "figure_eight.yaml",
            ["route={kind: waypoints, waypoints: [[0, 0, 1], [40, 5, 12], [20, -40, 6]], top_speed: 4}", "duration=4"],
        ),
    ],
    ids=["crazyflie", "with fans", "forty metres"],
)
def test_the_camera_frames_everything(spec, overrides, tmp_path):
    """The path, the vehicle and the axis labels are centred in the view and fill it, also on a phone."""
    flight = simulate(load_scenario(f"diagrams/{spec}", overrides), sample=0)
    page = save_replay({"one": flight}, tmp_path / "replay.html")
    text = page.read_text(encoding="utf-8")
    path = np.vstack([reference_points(flight.plan), positions(flight.record("state"))])
    with open_replay(page, tmp_path) as browser:
        for width, height in ((880, 560), (360, 640)):
            resize(browser, width, height)
            browser.value("reset.click()")
            across = on_screen(browser, path)
            assert np.abs(across).max() < 1.0
            frame = on_screen(browser, json.loads(re.search(r'"frame":(\[\[.*?\]\])', text).group(1)))[:, :2]
            low, high = frame.min(axis=0), frame.max(axis=0)
            # The scene fills the view in one direction, except for a margin of 6 % of the view on each side.
            assert high.max() < 0.881
            assert low.min() > -0.881
            assert np.max(np.minimum(high, -low)) > 0.879
        # The axis labels are at their positions and do not overlap.
        texts = browser.value(
            "[...labels.children].filter((l) => l.style.display !== 'none')"
            ".map((l) => [l, l.getBoundingClientRect()])"
            ".map(([l, box]) => [l.textContent, box.left, box.top, box.right, box.bottom])"
        )
        assert {"X (m)", "Y (m)", "Z (m)"} <= {text for text, *_ in texts}
        height = browser.value("viewer.renderer.domElement.clientHeight")
        for mark in json.loads(re.search(r'"marks":(\[\{.*?\}\])', text).group(1)):
            if mark["text"].endswith("(m)"):
                x, y, _ = on_screen(browser, [mark["at"]])[0]
                left, top, right, bottom = next(box for name, *box in texts if name == mark["text"])
                centre = (0.5 * (left + right), 0.5 * (top + bottom))
                assert centre == pytest.approx((180.0 * (1.0 + x), 0.5 * height * (1.0 - y)), abs=1.0)
        # The jets of fans do not hide trails.
        jet = "viewer.scene_tree.find(['fan_1', 'jet', '<object>']).object.material.depthWrite"
        assert "laboratory" not in spec or browser.value(jet) is False
        assert len(texts) >= 6
        boxes = [Bbox([[a, b], [c, d]]) for _, a, b, c, d in texts]
        assert not any(a.overlaps(b) for a, b in itertools.combinations(boxes, 2))
        assert all(box.x0 >= 0 and box.x1 <= 360 and box.y0 >= 0 for box in boxes)
        assert browser.console == []


@pytest.mark.long
@needs_chromium
def test_the_panel_shows_error_and_speed_and_a_click_on_its_plot_sets_the_time(flight, tmp_path):
    page = save_replay({"first": flight, "second": flight}, tmp_path / "replay.html")
    with open_replay(page, tmp_path) as browser:
        resize(browser, 880, 560)
        # The panel shows the values of the flight.
        tick = np.searchsorted(flight.time, 3.0 - 1e-9)
        error, speed = 100.0 * flight.euclidean_error[tick], np.linalg.norm(flight["state"][tick, 6:9])
        panel_text = browser.value("document.querySelector('#key .now').textContent")
        result = re.fullmatch(r"error ([\d.]+) cm, ([\d.]+) m/s", panel_text)
        assert [float(each) for each in result.groups()] == pytest.approx([error, speed], abs=0.05)
        # A click on the plot sets the time of the replay. The time axis begins 44 px from the left and ends 8 px from
        # the right.
        box = browser.value("(({left, top, width}) => [left, top, width])(errors.getBoundingClientRect())")
        x, y = box[0] + 44 + 0.75 * (box[2] - 52), box[1] + 40
        for kind in ("mousePressed", "mouseReleased"):
            browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)
        browser.wait_for(f"Math.abs(viewer.animator.time - {0.75 * flight.time[-1]}) < 0.02")
        position = positions_at(flight, browser.value("viewer.animator.time"))
        # The key F makes the camera follow the first vehicle, which is then close and in the middle of the view.
        for key in ("f", "+", "+"):
            browser.call("Input.dispatchKeyEvent", type="keyDown", key=key, text=key)
        browser.wait_for("viewer.animator.mixer.timeScale === 5")
        browser.wait_for("follow.value === '/first'")
        assert np.abs(on_screen(browser, [position])[0, :2]).max() < 0.05
        distance_following = browser.value("viewer.camera.position.distanceTo(viewer.controls.target)")
        browser.call("Input.dispatchKeyEvent", type="keyDown", key="r", text="r")
        browser.wait_for("follow.value === ''")
        assert browser.value("viewer.camera.position.distanceTo(viewer.controls.target)") > 2.0 * distance_following
        assert browser.console == []


@pytest.mark.long
@needs_chromium
def test_the_replay_of_a_swarm_counts_crashes_and_stops_crashed_vehicles(tmp_path):
    flights = simulate_samples(load_scenario("diagrams/robustness.yaml", ["duration=5"]), range(20))
    failure = "vehicle.rotor_failure={rotor: 1, time: 1.0, speed_factor: 0.0}"
    crash = simulate(load_scenario("diagrams/figure_eight.yaml", [failure]))
    assert crash.metrics.crashed
    page = save_swarm({"all": [*flights, crash]}, tmp_path / "swarm.html")
    count = 1 + sum(bool(flight.metrics.crashed) for flight in flights)
    assert f"21 flights, {count} crashed" in page.read_text(encoding="utf-8")
    (first, last), _ = watch_replay(page, tmp_path, ["all/0", "all/20"], [0.5, 1.5, 2.5, 4.5])
    assert np.ptp(first[:, 1:4], axis=0).max() > 0.3
    # A crashed vehicle stays where it is.
    assert last[-1, 1:4] == pytest.approx(crash["state"][-1, 0:3], abs=1e-3)


@pytest.mark.slow
def test_a_page_needs_no_internet_connection_and_is_smaller_than_12_megabytes(flight, tmp_path):
    page = save_replay({"one": flight, "two": flight}, tmp_path / "replay.html").read_text(encoding="utf-8")
    assert not re.search(r'<(script|link|img)[^>]* (src|href)="(?!data:)', page)
    swarm = save_swarm({"all": [flight] * 100}, tmp_path / "swarm.html")
    # Meshcat itself takes 2.3 MB. The remaining size grows with the duration: a full flight of 25 s needs 3.2 times as
    # much as these 8 s.
    assert 2.3e6 + 3.2 * (swarm.stat().st_size - 2.3e6) < 12e6


@pytest.mark.long
def test_a_flight_is_shown_until_its_state_is_not_finite(tmp_path):
    flight = simulate(load_scenario("diagrams/outdoor.yaml", ["duration=1"]))
    flight["state"][-10:] = np.nan
    page_text = save_replay({"diverged": flight}, tmp_path / "replay.html").read_text(encoding="utf-8")
    assert f'max="{flight.time[-11]:.3f}"' in page_text
    assert save_swarm({"diverged": [flight, flight]}, tmp_path / "swarm.html").exists()
    short = simulate(load_scenario("diagrams/hover.yaml", ["duration=0.02"]))
    assert save_replay({"short": short}, tmp_path / "new" / "folder" / "short.html").exists()


def test_page_data_contain_the_median_of_many_flights(tmp_path):
    """Five flights have errors of 1 to 5 cm, and the last of them crashes in the middle."""
    flight = simulate(load_scenario("diagrams/hover.yaml", ["duration=2"]))
    group = []
    for number in range(1, 6):
        signals = {name: values.copy() for name, values in flight.signals.items()}
        signals["state"][:, :3] = signals["reference"][:, :3] + [0.01 * number, 0.0, 0.0]
        group.append(replace(flight, signals=signals))
    half = len(flight.time) // 2
    crash = flight.metrics._replace(crash_time=1.0)
    signals = {name: values[:half] for name, values in group[-1].signals.items()}
    group[-1] = replace(group[-1], time=flight.time[:half], signals=signals, metrics=crash)
    room = SceneRoom(np.zeros(3), np.ones(3), 0.2)
    data = json.loads(page_data({"</script>": group}, {"</script>": "#000000"}, dict.fromkeys("abcde", "/x"), room))
    (curve,) = data["curves"]
    assert [curve[name][5] for name in ("low", "error", "high")] == pytest.approx([1.2, 3.0, 4.8])
    assert [curve[name][-2] for name in ("low", "error", "high")] == pytest.approx([1.15, 2.5, 3.85])
    assert curve["crashes"] == [1.0]
    assert curve["name"] == "</script>"


@pytest.mark.parametrize(("length", "spacing"), [(0.9, 0.2), (4.0, 0.5), (8.1, 2.0), (42.0, 10.0)])
def test_the_spacing_of_a_grid_is_a_round_number(length, spacing):
    room = SceneRoom(np.full(3, -0.5 * length), np.full(3, 0.5 * length), round_spacing(length))
    assert room.spacing == pytest.approx(spacing)
    assert room.grid(0)[[0, -1]] == pytest.approx(np.array([-1, 1]) * spacing * np.floor(0.5 * length / spacing))


def test_rotors_1_and_3_turn_clockwise():
    plus = Rotors.plus()
    assert list(np.sign(rotation_angles(plus, RotorSpeed(*[200.0] * 4), 0.01))) == [-1.0, 1.0, -1.0, 1.0]
    front, right, rear, left = (pose.translation() for pose in rotor_poses(plus, np.zeros(4)))
    assert (front[0], right[1], rear[0], left[1]) == pytest.approx((0.17, -0.17, -0.17, 0.17))


def test_rotors_are_drawn_at_their_positions():
    """In an X layout with reversed rotors, two arms point forward, and the propellers do not touch."""
    rotors = Rotors.x(length=0.1, width=0.08, rotor_1_direction=1.0)
    positions = np.array([pose.translation() for pose in rotor_poses(rotors, np.zeros(4))])
    np.testing.assert_allclose(positions[:, :2], [[0.05, -0.04], [-0.05, -0.04], [-0.05, 0.04], [0.05, 0.04]])
    assert list(np.sign(rotation_angles(rotors, RotorSpeed(*[200.0] * 4), 0.01))) == [1.0, -1.0, 1.0, -1.0]
    meshcat = local_meshcat()
    frame = Frame(rotors, (np.zeros(3),) * 4)
    draw_quadrotor(meshcat, "/x", frame, "black")
    assert [meshcat.HasPath(f"/x/nose_{number}") for number in (1, 2, 3, 4)] == [True, False, False, True]
    corners = quadrotor_mesh(frame)[0].T
    assert np.abs(corners[:, 1]).max() < 0.04 + 0.5 * 0.08


def test_an_h_frame_is_drawn_with_its_crossbar():
    """An H frame has two side bars and a crossbar; an X frame with the same rotors has four arms from its centre."""
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
        corners, triangles = (part.T for part in quadrotor_mesh(frame))
        triangle_centres = corners[triangles].mean(axis=1)
        bars = triangle_centres[np.abs(triangle_centres[:, 2]) < 0.01]
        on_sides, across = np.abs(np.abs(bars[:, 1]) - 0.15) < 0.01, np.abs(bars[:, 0]) < 0.01
        assert (on_sides | across).all() == (kind == "h")
