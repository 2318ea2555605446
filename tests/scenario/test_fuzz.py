"""Fuzz tests: an input is either refused in one sentence, or a scenario that flies to its end or into a crash.

`make test` tries the same hundred cases each time. `make fuzz` tries ten thousand further cases.
"""

import copy
import functools
import itertools
import json
import math
import os
import re
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st

from drake_quad import InputError, load_scenario, simulate
from drake_quad.flight.mission import plan_route
from drake_quad.reference.polynomial_path import evaluate
from drake_quad.scenario.files.loading import load_mission

DIAGRAMS = Path(__file__).parents[2] / "diagrams"
NUM_CASES = os.environ.get("FUZZ_CASES")
MAX_READING_TIME = 2.0  # s of processor time for one input; a typical input takes a few hundredths of a second
MAX_MESSAGE_LENGTH = 300  # characters


def fuzz_settings(fraction):
    return settings(
        max_examples=round(fraction * int(NUM_CASES or 70)),
        derandomize=not NUM_CASES,
        database=None,
        print_blob=True,
        suppress_health_check=list(HealthCheck),
    )


EXAMPLE_ROUTES = [
    {"kind": "hover", "position": [0.0, 0.0, 1.0], "yaw": 0.5, "duration": 3.0},
    {"kind": "circle", "radius": 1.5, "height": 1.0, "laps": 1, "heading": "along_path"},
    {
        "kind": "waypoints",
        "waypoints": [
            [0.0, 0.0, 1.0],
            {"box": {"min": [1.0, -0.5, 1.0], "max": [1.2, 0.5, 1.5]}},
            {"sphere": {"centre": [2.0, 0.0, 1.0], "radius": 0.3}, "yaw": 1.0},
            {"point": [3.0, 0.0, 1.0], "stop": True},
        ],
        "heading": "waypoints",
        "times": {"kind": "heuristic"},
        "corridors": [None, {"min": [-1.0, -1.0, 0.0], "max": [4.0, 1.0, 3.0]}, None],
        "space": {"min": [-1.0, -2.0, 0.0], "max": [4.0, 2.0, 3.0]},
    },
    {
        "kind": "waypoints",
        "waypoints": [[0.0, 0.0, 1.0], [1.0, 0.0, 1.0]],
        "times": [0.0, 4.0],
        "heading": "along_path",
        "corridors": [
            {
                "min": [-1.0, -1.0, 0.0],
                "max": [2.0, 1.0, 2.0],
                "half_spaces": [
                    {"normal": [1.0, 1.0, 0.0], "point": [1.5, 0.0, 0.0]},
                    {"normal": [0.0, -3.0, 4.0], "point": [0.0, 0.0, 1.5]},
                ],
            }
        ],
    },
    {
        "kind": "waypoints",
        "waypoints": [[0.0, 0.0, 1.0], {"point": [1.0, 0.0, 1.0], "velocity": [0.5, 0.0, 0.0]}, [2.0, 0.0, 1.0]],
        "times": {"kind": "minimum_snap", "duration": 8.0},
        "top_acceleration": None,
    },
    {
        "kind": "trajectory",
        "knots": [{"time": 0.0, "position": [0.0, 0.0, 1.0]}, {"time": 4.0, "position": [1.0, 0.0, 1.0]}],
        "yaw_knots": [{"time": 0.0, "yaw": 0.0, "yaw_rate": 0.0}, {"time": 4.0, "yaw": 1.0}],
    },
    {
        "kind": "trajectory",
        "pieces": [
            {"duration": 2.0, "x": [0.0, 0.0, 0.375, -0.125], "y": [0.0], "z": [1.0], "yaw": [0.0, 0.1]},
            {"duration": 1.0, "x": [0.5], "y": [0.0, 0.0, 0.0, 0.1], "z": [1.0], "yaw": [0.2, 0.1]},
        ],
        "origin": [0.1, 0.2, 0.3],
        "time_scale": 1.5,
    },
]
EXAMPLE_WINDS = [
    {"kind": "gust", "speed": 1.0, "heading": 0.5, "start": 0.05, "rise_time": 1.0, "hold_time": 2.0},
    {"kind": "dryden", "level": "light", "height": 6.0, "airspeed": 2.0, "heading": 0.1},
]

EXAMPLE_SPACE = {
    "bounds": {"min": [-5.0, -5.0, -1.0], "max": [5.0, 5.0, 4.0]},
    "obstacles": {
        "beam": {"kind": "box", "centre": [2.0, 0.0, 2.0], "size": [0.1, 0.2, 0.3], "rotation": [0.1, 0.2, 0.3]},
        "pillar": {"kind": "cylinder", "centre": [1.6, 1.8, 1.0], "radius": 0.1, "height": 4.0},
        "ball": {"kind": "sphere", "centre": [9.0, 9.0, 9.0], "radius": 0.1},
        "rock": {"kind": "hull", "points": [[3.0, 0.0, 0.0], [4.0, 0.0, 0.0], [3.0, 1.0, 0.0], [3.0, 0.0, 1.0]]},
    },
    "margin": 0.1,
    "radius": 0.2,
    "tracking_error_factor": 2.0,
}


def dumped_scenario(spec, layers=()):
    return load_scenario(DIAGRAMS / spec, layers=layers).model_dump(mode="json")


def with_route_and_winds(spec, route):
    tree = dumped_scenario(spec)
    tree["laboratory"]["wind"] += copy.deepcopy(EXAMPLE_WINDS)
    tree["vehicle"]["rotor_failure"] = {"rotor": 2.0, "time": 0.04, "speed_factor": 0.5}
    return {**tree, "route": copy.deepcopy(route), "metrics": {"start": 0.0, "end": 1.0}}


def with_attitude_response(tree):
    tree["laboratory"]["autopilot"] = {"kind": "response", "natural_frequency": [6.0, 7.0, 3.0], "damping": [0.5] * 3}
    tree["control"]["position"]["feed_forward"] = "acceleration"
    return tree


@functools.cache
def base_scenarios():
    """Return scenarios that together contain every kind of route, wind, autopilot, controller and law, and every field.

    The scenarios are loaded on first use, so that the collection of tests does not load them.
    """
    scenarios = [
        dumped_scenario("figure_eight.yaml"),
        dumped_scenario("robustness.yaml"),
        *itertools.starmap(
            with_route_and_winds,
            zip(
                itertools.cycle(
                    ("laboratory.yaml:low_wind", "paper.yaml:low_wind_pd_t2fnn", "paper.yaml:low_wind_pd_t1fnn")
                ),
                EXAMPLE_ROUTES,
                strict=False,
            ),
        ),
        dumped_scenario("onboard.yaml"),
        with_attitude_response(dumped_scenario("onboard.yaml")),
        dumped_scenario("laboratory.yaml:low_wind", layers=[f"{DIAGRAMS}/controllers/lqg.yaml:lqg"]),
        dumped_scenario("laboratory.yaml:nominal", layers=[f"{DIAGRAMS}/controllers/mpc.yaml:mpc_short_of_thrust"]),
    ]
    scenarios[1]["space"] = copy.deepcopy(EXAMPLE_SPACE)
    scenarios[2]["control"]["position"] |= {"kind": "pid", "k_i": [0.1, 0.1, 0.1]}
    scenarios[3]["control"]["position"]["learning"] = {"kind": "gradient", "rate": 1.0}
    scenarios[4]["control"]["position"]["learning"] = {"kind": "sign", "rate": 1.0}
    scenarios[5]["vehicle"]["time_step"] = 0.0
    return scenarios


def yaml_of(value):
    """Return a value as YAML on one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)}: {yaml_of(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(yaml_of, value)) + "]"
    if isinstance(value, float) and not math.isfinite(value):
        return ".nan" if math.isnan(value) else ".inf" if value > 0.0 else "-.inf"
    return json.dumps(value)


def yaml_file(tree):
    """Return a scenario as YAML with one field per line."""
    fields = "".join(f"  {json.dumps(key)}: {yaml_of(value)}\n" for key, value in tree.items())
    return f"loop:\n{fields}" if fields else "loop: {}\n"


def paths_in(tree, path=()):
    yield path
    children = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, child in children:
        yield from paths_in(child, (*path, key))


def part_at(tree, path):
    for key in path:
        tree = tree[key]
    return tree


odd_numbers = st.one_of(
    st.sampled_from([0, 1, -1, 0.5, -0.0, 5e-324, 1e-300, 1e-12, 1e-9, 1e-4, 1e4, 86400, 1e9, 1.1e9, 1e300, 2**63]),
    st.floats(),
    st.integers(-(10**400), 10**400),
)
odd_texts = st.one_of(
    st.sampled_from(["", "pd", "x", "minimum_time", "a\nb", "\x1b[31m", "1e3", "nan", "x" * 2000]), st.text()
)
distributions = st.one_of(
    st.tuples(odd_numbers, odd_numbers).map(lambda ends: {"uniform": {"min": ends[0], "max": ends[1]}}),
    st.tuples(odd_numbers, odd_numbers).map(lambda ends: {"log_uniform": {"min": ends[0], "max": ends[1]}}),
    st.tuples(odd_numbers, odd_numbers).map(lambda bell: {"normal": {"mean": bell[0], "standard_deviation": bell[1]}}),
    st.dictionaries(
        st.sampled_from(["a", "b1", "", "1"]), st.one_of(st.floats(-1.0, 1.0), odd_numbers), max_size=3
    ).map(
        lambda shared: {"normal": {"mean": 1.0, "standard_deviation": 0.1, "min": 0.5, "max": 2.0, "shared": shared}}
    ),
    st.lists(odd_numbers, max_size=3).map(lambda numbers: {"choice": numbers}),
    st.sampled_from([{"uniform": {}}, {"normal": 1}, {"choice": "x"}, {"uniform": {"min": 0}, "choice": [1]}]),
)
odd_values = st.one_of(
    st.none(),
    st.booleans(),
    odd_numbers,
    odd_texts,
    distributions,
    st.lists(odd_numbers, max_size=4),
    st.dictionaries(odd_texts, odd_numbers, max_size=2),
    st.integers(1, 60).map(lambda levels: [json.loads("[" * levels + "]" * levels)]),
)


def values_near(number):
    """Return a Hypothesis strategy for multiples of a number, and for distributions around the number."""
    low, high = sorted((0.9 * number, 1.1 * number))
    distributions = [
        {"uniform": {"min": low, "max": high}},
        {"log_uniform": {"min": low, "max": high}},
        {"choice": [low, high]},
        {"normal": {"mean": number, "standard_deviation": 0.1, "min": low, "max": high}},
        {"normal": {"mean": number, "standard_deviation": 0.1, "min": low, "max": high, "shared": {"a": -0.8}}},
    ]
    powers = st.integers(-12, 12).map(lambda power: (number or 1.0) * 10.0**power)
    return st.one_of(powers, powers, powers, st.sampled_from([-number, 0, 2 * number, *distributions]))


def is_number(value):
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e100


@st.composite
def varied_trees(draw):
    """Draw a scenario in which only numbers differ, so that most scenarios can be flown."""
    tree = copy.deepcopy(draw(st.sampled_from(base_scenarios())))
    numbers = [number_path for number_path in paths_in(tree) if is_number(part_at(tree, number_path))]
    for path in draw(st.lists(st.sampled_from(numbers), min_size=1, max_size=5, unique=True)):
        parent = part_at(tree, path[:-1])
        parent[path[-1]] = copy.deepcopy(draw(values_near(parent[path[-1]])))
    return tree


@st.composite
def mutated_trees(draw):
    tree = copy.deepcopy(draw(st.sampled_from(base_scenarios())))
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from([each_path for each_path in paths_in(tree) if each_path] or [("name",)]))
        parent, last = part_at(tree, path[:-1]), path[-1]
        if last not in (parent if isinstance(parent, dict) else range(len(parent))):
            continue
        value = parent[last]
        match draw(st.sampled_from(["replace", "copy", "remove", "add", "rename"])):
            case "replace":
                parent[last] = copy.deepcopy(draw(odd_values))
            case "copy":
                parent[last] = copy.deepcopy(part_at(tree, draw(st.sampled_from(list(paths_in(tree))))))
            case "remove":
                del parent[last]
            case "add" if isinstance(parent, list):
                parent.insert(last, copy.deepcopy(value))
            case "add":
                parent[draw(odd_texts)] = copy.deepcopy(draw(odd_values))
            case "rename" if isinstance(parent, dict):
                parent[draw(odd_texts)] = parent.pop(last)
    return tree


def assert_is_a_sentence(error, *beginnings):
    message = str(error)
    assert message.isprintable(), message
    assert len(message) <= MAX_MESSAGE_LENGTH, message
    assert any(re.match(beginning, message) for beginning in beginnings), message


def result_or_none(load, *beginnings):
    """Return the result of a call, or None if it raises an error with a valid message."""
    start = time.process_time()
    try:
        return load()
    except InputError as error:
        event("refused")
        assert_is_a_sentence(error, *beginnings)
        return None
    finally:
        assert time.process_time() - start < MAX_READING_TIME


def numbers(value):
    """Yield all numbers of a scenario or a part of it."""
    if isinstance(value, float):
        yield value
    elif isinstance(value, dict):
        yield from itertools.chain.from_iterable(map(numbers, value.values()))
    elif isinstance(value, list | tuple):
        yield from itertools.chain.from_iterable(map(numbers, value))


def assert_numbers_are_valid(scenario):
    """Assert that every number is finite, and that quantities such as masses are positive."""
    assert all(math.isfinite(number) for number in numbers(scenario.model_dump()))
    for name in ("mass", "thrust_factor", "drag_factor", "arm_length", "rotor_time_constant", "max_rotor_speed"):
        value = getattr(scenario.vehicle, name)
        assert (value if isinstance(value, float) else value.extremes()[0]) > 0.0


def assert_flies_or_is_refused(scenario):
    """Assert that a scenario flies for a few ticks with finite numbers, or that a valid message explains why not."""
    assert_numbers_are_valid(scenario)
    ticks = 4 * max(scenario.periods.values())
    short = scenario.model_copy(update={"duration": min(ticks, scenario.duration or math.inf)})
    try:
        flight = simulate(short, sample=0)
    except InputError as error:
        event("loaded, but refused for a flight")
        assert_is_a_sentence(error, "")
        return
    event("crashed" if flight.metrics.crashed else "flown")
    assert all(np.isfinite(values).all() for values in flight.signals.values())
    assert flight.metrics.crashed or math.isfinite(flight.metrics.rmse)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Work in an empty folder during the tests, so that messages contain short paths, as for a user."""
    path = tmp_path_factory.mktemp("fuzz")
    previous_folder = Path.cwd()
    os.chdir(path)
    yield path
    os.chdir(previous_folder)


@pytest.mark.long
@given(tree=st.one_of(varied_trees(), mutated_trees()))
@fuzz_settings(0.5)
def test_a_mutated_scenario_flies_or_is_refused_in_one_sentence(folder, tree):
    Path("loop.yaml").write_text(yaml_file(tree), encoding="utf-8")
    scenario = result_or_none(lambda: load_scenario("loop.yaml"), r"loop\.yaml:\d+: ")
    if scenario is not None:
        assert_flies_or_is_refused(scenario)


SMALL_FILE = """\
%YAML 1.2
---
base: &base
  route: {kind: hover, duration: 1}
  control:
    position: {kind: pd, k_p: [1.0, 1.0, 1.0], k_d: [1, 1e0, 1.5]}
    attitude: &gains {k_p: [9.0, 9.0, 4.0], k_d: [6.0, 6.0, 3.0]}
loop: # "a comment"
  extends: [base]
  vehicle:
    mass: 0.7
    time_step: 0.01
    attitude_kinematics: 'exact'
  control: {attitude: *gains}
  laboratory: {wind: [{kind: steady, velocity: [1, 0, 0]}]}
"""
YAML_TAGS = [f"!!{name} " for name in ("bool", "float", "int", "null", "str", "map", "seq", "set", "binary", "omap")]
SPECIAL_CHARACTERS = list("\t\ufeff\0\r\n\x85\u2028\ud800!&*?:-|>#'\"{}[],~=@`\\_e.+")
AMBIGUOUS_SCALARS = [
    "0x",
    "0o7",
    "0b1",
    "1_0",
    "1:30",
    "2001-01-01",
    "yes",
    "null",
    ".inf",
    "1e400",
    "9999999999",
    "extends: ",
]
YAML_MARKS = [
    "<<: ",
    "<<: *base",
    "...",
    "---",
    ">-",
    "&gains ",
    "*gains",
    "*base",
    "%YAML 1.1",
    "%TAG ! x",
    "!<x> ",
    "? ",
]
snippets = st.one_of(
    st.sampled_from([*YAML_TAGS, *SPECIAL_CHARACTERS, *AMBIGUOUS_SCALARS, *YAML_MARKS]), st.text(max_size=4)
)


@st.composite
def mutated_texts(draw, text):
    for _ in range(draw(st.integers(1, 3))):
        start = draw(st.integers(0, len(text)))
        text = text[:start] + draw(snippets) + text[start + draw(st.integers(0, 5)) :]
    return text


@pytest.mark.slow
@given(text=mutated_texts(SMALL_FILE), odd_bytes=st.binary(max_size=3), fraction=st.floats(-2.0, 1.0))
@fuzz_settings(0.25)
def test_a_mutated_yaml_text_flies_or_is_refused_in_one_sentence(folder, text, odd_bytes, fraction):
    data = text.encode("utf-8", errors="surrogatepass")
    position = max(0, round(fraction * len(data)))
    Path("loop.yaml").write_bytes(data[:position] + odd_bytes + data[position:] if position else data)
    scenario = result_or_none(lambda: load_scenario("loop.yaml:loop"), r"loop\.yaml:\d+: ", r"loop\.yaml(:loop)?: ")
    if scenario is not None:
        assert_flies_or_is_refused(scenario)


cells = st.one_of(st.floats(-3.0, 3.0).map(str), st.sampled_from(["0", "1", " 2 ", "1.5", "-1"]))
odd_cells = st.one_of(odd_numbers.map(str), st.sampled_from(["", "nan", "1,2", '"', "#", "1_0", "٣", "x\0"]), odd_texts)


@st.composite
def tables(draw):
    columns = draw(st.sampled_from([["x", "y", "z"], ["time", "x", "y", "z"], ["Z", "x", "y", "yaw", "time"]]))
    rows = [[draw(cells) for _ in columns] for _ in range(draw(st.integers(0, 4)))]
    for number, row in enumerate(rows):
        if "time" in columns:
            row[columns.index("time")] = str(4 * number)
    rows.insert(0, columns)
    for _ in range(draw(st.integers(0, 2))):
        row = draw(st.sampled_from(rows))
        match draw(st.sampled_from(["change", "add", "remove", "comment", "drop"])):
            case "change" if row:
                row[draw(st.integers(0, len(row) - 1))] = draw(odd_cells)
            case "add":
                row.append(draw(odd_cells))
            case "remove" if row:
                row.pop()
            case "comment":
                row.insert(0, "# ")
            case "drop" if len(rows) > 1:
                rows.remove(row)
    return "\n".join(",".join(row) for row in rows)


@pytest.mark.slow
@given(text=st.one_of(tables(), tables().flatmap(mutated_texts)), name=st.sampled_from(["course", "-", "a b", "1"]))
@fuzz_settings(0.1)
def test_a_mutated_waypoint_table_is_planned_or_refused_in_one_sentence(folder, text, name):
    Path(f"{name}.csv").write_bytes(text.encode("utf-8", errors="surrogatepass"))
    options = [] if "time" in text else ["route.times=heuristic"]
    mission = result_or_none(lambda: load_mission(f"{name}.csv", options), rf"{name}\.csv(:\d+)?: ", "override ")
    if mission is not None:
        try:
            plan = plan_route(mission)
        except InputError as error:
            assert_is_a_sentence(error, "")
        else:
            event("planned")
            assert np.isfinite(evaluate(plan.path, np.linspace(*plan.path.times[[0, -1]], 50))).all()


def field_path(path):
    return ".".join(map(str, path))


known_paths = st.deferred(
    lambda: st.sampled_from([field_path(path) for seed in base_scenarios() for path in paths_in(seed) if path])
)
odd_assignments = st.one_of(
    st.tuples(known_paths, odd_values.map(yaml_of)).map("=".join),
    st.tuples(known_paths, st.text(max_size=6)).map("=".join),
    st.tuples(odd_texts, odd_values.map(yaml_of)).map("=".join),
    known_paths.flatmap(lambda path: mutated_texts(f"{path}=1.0")),
    odd_texts,
)


@st.composite
def scenarios_with_overrides(draw):
    """Draw a scenario and overrides, most of which change its numbers."""
    tree = draw(st.sampled_from(base_scenarios()))
    numbers = [path for path in paths_in(tree) if is_number(part_at(tree, path))]
    overrides = []
    for path in draw(st.lists(st.sampled_from(numbers), max_size=3)):
        overrides.append(f"{field_path(path)}={yaml_of(draw(values_near(part_at(tree, path))))}")
    odd = draw(st.lists(odd_assignments, min_size=0 if overrides else 1, max_size=1))
    return tree, [*overrides, *odd]


@pytest.mark.slow
@given(case=scenarios_with_overrides())
@fuzz_settings(0.15)
def test_random_overrides_fly_or_are_refused_in_one_sentence(folder, case):
    tree, overrides = case
    Path("loop.yaml").write_text(yaml_file(tree), encoding="utf-8")
    scenario = result_or_none(lambda: load_scenario("loop.yaml", overrides), "override ", r"loop\.yaml:\d+: ")
    if scenario is not None:
        assert_flies_or_is_refused(scenario)
