"""Tests that committed block drawings are current, and show the systems and connections of their diagrams."""

import re
import shutil
from pathlib import Path

import pytest

from drake_quad import load_scenario
from drake_quad.flight.mission import build_tracking_diagram
from drake_quad.scenario.batch import draw_sample
from drake_quad.visualization.block_drawing import digest, drawings, svg

ROOT = Path(__file__).parent.parent.parent
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
DRAWN_SCENARIOS = re.search(r"^DRAWN = ((?:.*\\\n)*.*)$", MAKEFILE, re.MULTILINE).group(1).replace("\\", " ").split()


# A drawing does not depend on the waypoints, and planning the whole path through the forest takes several seconds.
SHORT_ROUTES = {"forest": ["route.waypoints=[[-1, -2.7, 1.2], [1, -1.9, 1.4]]"]}


def drawings_of(spec):
    scenario = draw_sample(load_scenario(spec, SHORT_ROUTES.get(spec, [])), 0)
    return scenario.name, drawings(build_tracking_diagram(scenario))


@pytest.mark.long
@pytest.mark.parametrize("spec", DRAWN_SCENARIOS)
def test_committed_drawings_are_current(spec):
    name, current = drawings_of(spec)
    committed = {
        path.stem: re.search(r"<!-- ([0-9a-f]{64}) -->\n$", path.read_text(encoding="utf-8")).group(1)
        for path in (ROOT / "diagrams" / "drawings" / name).glob("*.svg")
    }
    assert committed == {path.replace("/", "_") or "loop": digest(text) for path, text in current.items()}, (
        "make figures draws them again"
    )


def test_every_scenario_file_has_a_drawing():
    assert {spec.partition(":")[0] for spec in DRAWN_SCENARIOS} == {
        path.stem for path in (ROOT / "diagrams").glob("*.yaml")
    }


def test_a_drawing_shows_systems_connections_and_sizes():
    _, current = drawings_of("paper:low_wind_pd_t2fnn")
    assert set(current) == {
        "",
        "reference",
        "control",
        "control/position",
        "control/network",
        "laboratory",
    }
    systems = dict(re.findall(r'^ +(s\d+) \[label="(\w+)', current[""], re.MULTILINE))
    edges = {
        (systems[start], systems[end]): label.split("\\n")
        for start, end, label in re.findall(r'(s\d+) -> (s\d+) \[label="([^"]*)"', current[""])
    }
    assert edges["control", "laboratory"] == ["wrench (4)"]
    assert edges["laboratory", "control"] == ["measurement (12)"]
    assert edges["laboratory", "monitor"] == ["shortfall (4)", "state (12)"]


def test_a_diagram_always_has_the_same_drawing():
    assert drawings_of("outdoor") == drawings_of("outdoor")


@pytest.mark.skipif(shutil.which("dot") is None, reason="no Graphviz on PATH; Debian's package is graphviz")
def test_graphviz_renders_every_drawing():
    for text in drawings_of("robustness")[1].values():
        assert svg(text).startswith("<svg")
