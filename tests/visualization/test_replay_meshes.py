"""Tests of the surfaces of a replay, and of the title, the legend and the duration on its page."""

import json
import re
from collections import Counter
from itertools import combinations

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from test_scene import Scene

from drake_quad import load_scenario, simulate
from drake_quad.visualization.replay import page, scene, shapes


def area(corners, faces):
    """Return the area of a surface of triangles."""
    a, b, c = (np.asarray(corners)[[face[i] for face in faces]] for i in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


def rims(faces):
    """Return the edges that bound only one triangle."""
    edges = Counter(frozenset(pair) for face in faces for pair in combinations(face, 2))
    assert max(edges.values()) == 2
    assert all(len(edge) == 2 for edge in edges)
    return [edge for edge, count in edges.items() if count == 1]


@pytest.mark.parametrize("end", [[0.3, 0.0, 0.0], [0.1, -0.2, 0.0]])
def test_a_bar_is_a_box_that_is_open_at_its_start(end):
    start = np.array([0.05, 0.0, 0.1])
    end = start + end
    corners, faces = shapes._bar(start, end, 0.01)
    length = np.linalg.norm(end - start)
    assert area(corners, faces) == pytest.approx(4.0 * 0.02 * length + 0.02**2)
    # The open side of the bar has four corners, whose centre is the start of the bar.
    open_corners = corners[sorted(set().union(*rims(faces)))]
    np.testing.assert_allclose(open_corners.mean(axis=0), start)
    assert len(rims(faces)) == 4
    along = (corners - start) @ (end - start) / length
    np.testing.assert_allclose(np.sort(along), [0.0] * 4 + [length] * 4, atol=1e-12)


def test_a_tube_is_open_only_at_its_two_ends():
    points = np.stack([np.linspace(0.0, 1.0, 6), np.zeros(6), np.zeros(6)], axis=1)
    vertices, faces = shapes.tube(points, 0.1)
    # The cross section is a triangle inscribed in a circle of the given radius.
    assert area(vertices.T, faces.T) == pytest.approx(3.0 * 0.1 * np.sqrt(3.0))
    assert len(rims(map(tuple, faces.T))) == 6


def test_the_mesh_of_a_quadrotor_consists_of_four_bars_and_four_regular_decagons():
    frame = shapes.Frame.of(load_scenario("figure_eight").vehicle)
    corners, faces = (part.T for part in shapes.quadrotor_mesh(frame))
    radius = shapes._propeller_radius(frame.rotors)
    decagons = 4.0 * 10.0 * 0.5 * radius**2 * np.sin(2.0 * np.pi / 10.0)
    width = 2.0 * 0.009 * shapes.part_scale(frame.rotors)
    arms = sum(4.0 * width * np.hypot(rotor.x, rotor.y) + width**2 for rotor in frame.rotors)
    assert area(corners, faces) == pytest.approx(decagons + arms, rel=1e-3)


@pytest.fixture(scope="module")
def flight():
    return simulate(load_scenario("figure_eight", ["duration=0.4"]))


@pytest.fixture
def write_page(monkeypatch, tmp_path):
    """Return a function that writes a page without a server and returns its text."""
    stage = Scene()
    stage.StaticHtml = lambda: "<html><body>scene</body></html>"
    monkeypatch.setattr(page, "local_meshcat", lambda: stage)
    return lambda flights: page.save_replay(flights, tmp_path / "new" / "page.html").read_text(encoding="utf-8")


def test_the_page_of_a_single_flight_has_a_colour_bar_up_to_its_largest_error(flight, write_page):
    text = write_page({"a < b": flight})
    assert "<b>a &lt; b</b>" in text
    assert 'max="0.400"' in text
    assert text.endswith("</body></html>")
    bar = text[
        text.index("error along the trail: 0") : text.index("</b>") + text[text.index("</b>") :].index("cm</span>")
    ]
    colours = re.findall("#[0-9a-f]{6}", bar)
    assert len(colours) == 9
    np.testing.assert_allclose(
        [to_rgb(stop) for stop in colours], [shapes.ERROR_COLORS(i / 8.0)[:3] for i in range(9)], atol=3e-3
    )
    assert bar.endswith(f"{100.0 * flight.euclidean_error.max():.3g} ")
    page_data = json.loads(re.search(r"const data = (.*);", text).group(1))
    assert [each["name"] for each in page_data["curves"]] == ["a < b"]
    assert [each["path"] for each in page_data["vehicles"]] == ["/a___b"]


def test_the_page_of_several_flights_has_their_names_and_no_colour_bar(flight, write_page):
    text = write_page({"one": flight, "other": flight})
    assert "<b>one, other</b>" in text
    assert "error along the trail" not in text
    page_data = json.loads(re.search(r"const data = (.*);", text).group(1))
    colors = [each["color"] for each in page_data["curves"]]
    assert len(set(colors)) == 2


def test_a_server_is_local_and_its_scene_is_empty_and_white(monkeypatch):
    parameters = []

    class Server(Scene):
        def __init__(self, params):
            super().__init__()
            parameters.append(params)

    monkeypatch.setattr(scene, "Meshcat", Server)
    stage = scene.local_meshcat()
    (params,) = parameters
    assert params.host == "127.0.0.1"
    assert params.show_stats_plot is False
    assert stage.properties["/Axes", "visible"] is stage.properties["/Grid", "visible"] is False
    for end in ("top", "bottom"):
        assert stage.properties["/Background/<object>", f"{end}_color"] == [1.0, 1.0, 1.0]
    lights = {path: value for (path, name), value in stage.properties.items() if name == "intensity"}
    # Spot lights would make colours differ from the legend.
    assert {path for path, value in lights.items() if value > 0.0} == {
        "/Lights/AmbientLight/<object>",
        "/Lights/FillLight/<object>",
    }
    assert len(lights) == 5
