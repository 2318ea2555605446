"""Tests that oversized scenarios are refused before they are parsed, and impossible times before the flight."""

import math
import os
import re

import numpy as np
import pytest
from ruamel.yaml.composer import Composer

from drake_quad import InputError, load_scenario, simulate
from drake_quad.flight.mission import plan_route
from drake_quad.framework.wiring import subsystem
from drake_quad.planning.duration import flight_duration
from drake_quad.scenario import limits
from drake_quad.scenario.files import library
from drake_quad.scenario.files.loading import Override, load_mission

MINIMAL_FIELDS = """\
  route: {kind: hover}
  control:
    position: {kind: pd, k_p: [1.0, 1.0, 1.0], k_d: [1.0, 1.0, 1.5]}
    attitude: {k_p: [9.0, 9.0, 4.0], k_d: [6.0, 6.0, 3.0]}
"""
SMALL_FILE = f"small:\n{MINIMAL_FIELDS}"


@pytest.fixture
def write(tmp_path):
    def writer(text, name="loop.yaml"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return writer


@pytest.fixture
def composed_nodes(monkeypatch):
    """Return a list to which the YAML composer appends an entry for each node."""
    counts = []
    compose = Composer.compose_node
    monkeypatch.setattr(Composer, "compose_node", lambda *arguments: counts.append(1) or compose(*arguments))
    return counts


def refusal(load, *arguments):
    with pytest.raises(InputError) as caught:
        load(*arguments)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) <= 300
    return message


def chain(levels, *, extends_twice=False):
    """Return a file of scenarios, each of which extends the previous one. The first is complete."""
    bases = [f"[s{i}, s{i}]" if extends_twice else f"s{i}" for i in range(levels)]
    return f"s0:\n{MINIMAL_FIELDS}" + "".join(f"s{i + 1}: {{extends: {base}}}\n" for i, base in enumerate(bases))


def test_a_scenario_extended_several_times_is_resolved_only_once(write, monkeypatch):
    calls = []
    with_layer = library.with_layer
    monkeypatch.setattr(library, "with_layer", lambda *trees: calls.append(1) or with_layer(*trees))
    scenario = load_scenario(f"{write(chain(18, extends_twice=True))}:s18")
    assert scenario.route.kind == "hover"
    assert len(calls) < 500


@pytest.mark.slow
def test_the_number_of_scenarios_that_a_scenario_extends_is_limited(write):
    path = write(chain(2000))
    assert load_scenario(f"{path}:s{limits.MAX_BASES}").control.position.k_d[2] == 1.5
    assert "extends too many scenarios; the limit is 100" in refusal(load_scenario, f"{path}:s{limits.MAX_BASES + 1}")
    assert "extends too many scenarios; the limit is 100" in refusal(load_scenario, f"{path}:s2000")
    wide = write(f"{SMALL_FILE}wide: {{extends: [{'small, ' * 101}]}}\n")
    assert "loop.yaml:6: extends too many" in refusal(load_scenario, f"{wide}:wide")


def test_circular_extensions_are_detected_after_other_scenarios_were_resolved(write):
    path = write("a: {extends: [b, c]}\nb: {route: {kind: hover}}\nc: {extends: [b, a]}\n")
    assert "loop.yaml:3: a extends itself" in refusal(load_scenario, f"{path}:a")


@pytest.mark.parametrize(
    "text",
    [
        f"{SMALL_FILE}# {'x' * 10_000_000}\n",
        f"{SMALL_FILE}  name: '{'x' * 10_000_000}'\n",
        f"{SMALL_FILE}  vehicle:\n" + "".join(f"    k{i}: 1\n" for i in range(300_000)),
        f"{SMALL_FILE}  duration:\n" + "    - 1\n" * 200_000,
        "é" * 300_000,
    ],
)
def test_a_file_that_is_too_large_is_not_parsed(write, monkeypatch, text):
    path = write(text)
    monkeypatch.setattr(library, "parse_document", None)
    words = "loop.yaml: is too large: a scenario and all that it extends may have at most 500,000 bytes"
    assert refusal(load_scenario, path).endswith(words)


def test_a_table_that_is_too_large_is_not_parsed(write, monkeypatch):
    path = write("0.001,0.002,1\n" * 100_000, "course.csv")
    monkeypatch.setattr(library, "parse_waypoint_table", None)
    assert "course.csv: is too large" in refusal(load_mission, path)


@pytest.mark.slow
def test_the_size_limit_includes_all_files_and_overrides(write):
    path = write("a: {extends: [b, c]}\nb: {extends: one.yaml}\nc: {extends: two.yaml}\n")
    write(f"{SMALL_FILE}# {'x' * 300_000}\n", "one.yaml")
    write(f"{SMALL_FILE}# {'x' * 100_000}\n", "two.yaml")
    load_scenario(f"{path}:a")
    assert "is too large: a scenario" in refusal(load_scenario, f"{path}:a", [f"seed=1 # {'x' * 100_000}"])
    write(f"{SMALL_FILE}# {'x' * 300_000}\n", "two.yaml")
    assert "two.yaml: is too large" in refusal(load_scenario, f"{path}:a")


@pytest.mark.long
@pytest.mark.parametrize(
    "value", ["[" + "1," * 200_000 + "]", "\n    k: 1" + "".join(f"\n    k{i}: 1" for i in range(30_000))]
)
def test_parsing_stops_at_the_limit_on_keys_and_values(write, composed_nodes, value):
    message = refusal(load_scenario, write(f"{SMALL_FILE}  vehicle: {value}\n"))
    assert "is too large: a scenario and all that it extends may have at most 30,000 keys and values" in message
    assert len(composed_nodes) <= limits.MAX_NODES


@pytest.mark.slow
def test_the_limit_on_keys_and_values_includes_all_files(write, composed_nodes, monkeypatch):
    monkeypatch.setattr(library, "MAX_NODES", 3000)
    numbers = ", ".join(["1.0"] * 1400)
    path = write("a: {extends: [one.yaml, two.yaml]}\n")
    for name in ("one.yaml", "two.yaml"):
        write(f"{SMALL_FILE}  vehicle: {{mass: {{choice: [{numbers}]}}}}\n", name)
    assert load_scenario(path).vehicle.mass.choice[0] == 1.0
    write(f"{SMALL_FILE}  vehicle: {{mass: {{choice: [{numbers}, {numbers}]}}}}\n", "two.yaml")
    composed_nodes.clear()
    assert "two.yaml:6: is too large" in refusal(load_scenario, path)
    # The last file is parsed a second time to find the line at which it exceeds the limit.
    assert len(composed_nodes) <= 2 * library.MAX_NODES


@pytest.mark.slow
@pytest.mark.parametrize("text", ["[" * 100_000, "{" * 100_000, "- " * 100_000, "? " * 100_000, "[" * 41 + "]" * 41])
def test_parsing_stops_at_the_limit_on_nesting(write, composed_nodes, text):
    assert "loop.yaml:1: is nested too deeply: a scenario may have at most 40 levels" in refusal(
        load_scenario, write(text)
    )
    assert len(composed_nodes) <= limits.MAX_LEVELS


# YAML list with nested aliases: each anchor contains ten aliases of the anchor before, so the list expands to 10⁵
# numbers.
NESTED_ALIASES = (
    "[&a [1], " + ", ".join(f"&{new} [{f'*{old}, ' * 10}]" for old, new in ("ab", "bc", "cd", "de", "ef")) + "]"
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("value", "words"),
    [
        ("&a [*a, *a]", "the alias *a must come after the value with its anchor"),
        (NESTED_ALIASES, "is too large"),
    ],
)
def test_aliases_that_multiply_or_contain_themselves_are_refused(write, value, words):
    assert words in refusal(load_scenario, write(f"{SMALL_FILE}  vehicle: {value}\n"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            f"{SMALL_FILE}  name: {'x' * 1001}\n",
            "loop.yaml:6: 'xxx.* is too long: a key or value may have at most 1,000 char",
        ),
        (f"{SMALL_FILE}  seed: 0x{'f' * 5000}\n", "loop.yaml:6: '0xfff.* is too long"),
        (f"{SMALL_FILE}  name: {'x' * 101}\n", "loop.yaml:6: name is 'xxx.*, but must have at most 100 characters"),
        (f"{SMALL_FILE}  vehicle: !!bool 3\n", "loop.yaml:6: '3' is not true or false"),
        (f"{SMALL_FILE}  vehicle: !!float x\n", "loop.yaml:6: 'x' is not a valid number"),
        (f"{SMALL_FILE}  vehicle: !!int ''\n", "loop.yaml:6: '' is not a valid number"),
        (
            f"{SMALL_FILE}  {'y' * 900}: 1\n",
            "loop.yaml:6: yyyyy.*yyy is unknown; allowed are name, route, .*, and 8 more",
        ),
        (
            f"{SMALL_FILE}  seed: 1\0\n",
            "loop.yaml:6: is not YAML: it contains the character '.x00'",
        ),
        ("a: {extends: x\\ny.yaml}", "loop.yaml:1: extends .*, which does not exist"),
        ('a: {extends: "x\\0y.yaml"}', "loop.yaml:1: extends .*, which does not exist"),
        (f"a: {{extends: {'x' * 900}.yaml}}", "loop.yaml:1: extends .*xxx.yaml, which does not exist"),
    ],
)
def test_errors_for_unusual_yaml_text_give_the_reason(write, text, words):

    assert re.search(words, refusal(load_scenario, write(text)))


def test_a_redefined_anchor_causes_no_warning(write):
    assert load_scenario(write(f"{SMALL_FILE}  seed: &a 1\n  duration: &a 2.0\n")).duration == 2.0


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("x" * 5000 + ".yaml", r"x\.\.\.x*\.yaml: cannot be read: file name too long"),
        ("a\0b.yaml", "b.yaml: cannot be read"),
        ("a\0b.csv", "b.csv: cannot be read"),
        ("a\nb.yaml", r"a\\nb.yaml: cannot be read: no such file"),
        (f"loop.yaml:{'x' * 5000}", "there is no scenario 'xxx.* in .*loop.yaml, which contains small"),
    ],
)
def test_errors_for_unusual_file_names_give_the_reason(write, monkeypatch, name, words):

    monkeypatch.chdir(write(SMALL_FILE).parent)
    assert re.search(words, refusal(load_scenario, name))


def test_devices_and_pipes_are_not_read(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    assert "pipe.yaml: cannot be read: it is not a file" in refusal(load_scenario, tmp_path / "pipe.yaml")
    (tmp_path / "endless.csv").symlink_to("/dev/zero")
    assert "endless.csv: cannot be read: it is not a file" in refusal(load_mission, tmp_path / "endless.csv")


def test_the_number_of_waypoints_is_limited(write):
    rows = [f"{i},0,1\n" for i in range(limits.MAX_WAYPOINTS)]
    assert len(load_mission(write("x,y,z\n" + "".join(rows), "course.csv")).route.waypoints) == limits.MAX_WAYPOINTS
    for header in ("x,y,z\n", ""):
        path = write(header + "".join([*rows, "0,0,1\n", "x,x,x\n"]), "course.csv")
        assert "1,000" in refusal(load_mission, path)
    points = "[[0, 0, 1], " + "[1, 0, 1], " * limits.MAX_WAYPOINTS + "]"
    text = SMALL_FILE.replace("{kind: hover}", f"{{kind: waypoints, waypoints: {points}}}")
    assert "must have at most 1000 items, not 1001" in refusal(load_scenario, write(text))


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("vehicle.mass=" + "1" * 5000, "is too long"),
        ("laboratory.wind." + "1" * 5000 + "=1", "laboratory.wind has no item 111.*; it is empty"),
        (
            "control.position.k_p." + "1" * 5000 + "=1",
            "control.position.k_p has no item 111.*; its items are .*k_p.0 to .*k_p.2",
        ),
        ("1" * 5000 + "=1", "is unknown; allowed are name"),
        ("vehicle." + "a." * 5000 + "b=1", "is nested too deeply: a scenario may have at most 40 levels"),
        ("vehicle.mass=" + "[" * 5000 + "]" * 5000, "is nested too deeply"),
        ("name=" + "x" * 5000, "is too long"),
        ("vehicle.mass=x\ny\n: 3", "is not YAML"),
        ('name="\\U00110000"', "is not YAML: found invalid Unicode character"),
        ("seed=" + "[1," * 30 + "1" + "]" * 30 + " # " + "x" * 600_000, "is too large"),
    ],
)
def test_errors_for_malformed_overrides_give_the_reason(write, override, words):

    message = refusal(load_scenario, write(SMALL_FILE), [override])
    assert re.match(f"override .*{words}", message)


def test_errors_name_the_source_of_an_override(write):
    path = write(SMALL_FILE)
    assert refusal(load_scenario, path, ["seed=-1"]).startswith("override seed=-1: seed is -1, but must be")
    assert refusal(load_scenario, path, [Override("seed=-1", "--seed -1")]).startswith("--seed -1: seed is -1, but")
    assert refusal(load_mission, path, ["seed=1"]) == (
        "override seed=1: a plan does not depend on seed, only on name, route, nominal, space"
    )
    assert refusal(load_mission, path, [Override("seed=1", "--set seed=1")]).startswith("--set seed=1: a plan does")


def test_errors_of_a_file_do_not_name_an_override(write):
    assert refusal(load_scenario, write("a: {route: {kind: hover}}\n"), ["seed=1"]) == (
        f"{write('a: {route: {kind: hover}}')}:1: control is missing; only `drake-quad plan` needs no control"
    )
    path = write("0,0,1\n1,0,1\n", "-.csv")
    assert "-.csv:1: name is '-', but must match" in refusal(load_mission, path, ["route.top_speed=1"])


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("laboratory.motion_capture.period=0.005", "vehicle.time_step is 0.01 by default, but must not be longer than"),
        ("laboratory.command_link.period=0.03", "laboratory.command_link.period is 0.03, but must be the shortest"),
        ("vehicle.time_step=0.02", "vehicle.time_step is 0.02, but must not be longer than the shortest period"),
        ("laboratory={motion_capture: {period: 0.03}}", "laboratory.motion_capture.period is 0.03, but must be the"),
        ("nominal={min_rotor_speed: 400}", "nominal.max_rotor_speed is 300.0 by default, but must be larger than"),
        ("vehicle={min_rotor_speed: 400}", "vehicle.min_rotor_speed is 400, but must be smaller than max_rotor_speed"),
    ],
)
def test_error_messages_show_the_value_of_a_field_even_if_it_is_the_default(write, override, words):
    assert words in refusal(load_scenario, write(SMALL_FILE), [override])


ATTITUDE_AUTOPILOT_OVERRIDE = "laboratory.autopilot={kind: attitude, k_attitude: [6, 6, 6], k_rate: [12, 12, 12]%s}"
RESPONSE_AUTOPILOT_OVERRIDE = (
    "laboratory.autopilot={kind: response, natural_frequency: [6, 6, 3], damping: [0.5, 0.5, 0.5]}"
)
NO_ATTITUDE_OVERRIDE = "control.attitude=null"
SHORT_STEP_OVERRIDE = "vehicle.time_step=0.0025"


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ([NO_ATTITUDE_OVERRIDE], "control.attitude is missing"),
        (
            [ATTITUDE_AUTOPILOT_OVERRIDE % ""],
            "control.attitude is .*, but must be left out, or null, since .* of kind attitude controls the attitude",
        ),
        (
            [RESPONSE_AUTOPILOT_OVERRIDE],
            "control.attitude is .*, but must be left out, or null, since .* of kind response",
        ),
        (
            [ATTITUDE_AUTOPILOT_OVERRIDE % "", NO_ATTITUDE_OVERRIDE, "control.position.feed_forward=snap"],
            "control.position.feed_forward is 'snap', but must be none or acceleration or jerk with",
        ),
        (
            [RESPONSE_AUTOPILOT_OVERRIDE, NO_ATTITUDE_OVERRIDE, "control.position.feed_forward=jerk"],
            "control.position.feed_forward is 'jerk', but must be none or acceleration with .* of kind response",
        ),
        (
            [ATTITUDE_AUTOPILOT_OVERRIDE % "", NO_ATTITUDE_OVERRIDE],
            "vehicle.time_step is 0.01 by default, but must not be longer than the shortest period, 0.0025 s"
            " of laboratory.autopilot.period",
        ),
        (
            [ATTITUDE_AUTOPILOT_OVERRIDE % ", period: 0.04", NO_ATTITUDE_OVERRIDE],
            "autopilot.period is 0.04, but must not be longer than the period of the command link, 0.02 s",
        ),
        (
            [ATTITUDE_AUTOPILOT_OVERRIDE % ", period: 0.004", NO_ATTITUDE_OVERRIDE, SHORT_STEP_OVERRIDE],
            "autopilot.period is 0.004, but must be the shortest period, 0.0025, times a power of two",
        ),
        (
            [RESPONSE_AUTOPILOT_OVERRIDE, NO_ATTITUDE_OVERRIDE, "vehicle.rotor_failure={rotor: 1, time: 2}"],
            "vehicle.rotor_failure is .*, but must be left out, since .* of kind response does not model it",
        ),
        (
            [RESPONSE_AUTOPILOT_OVERRIDE, NO_ATTITUDE_OVERRIDE, "vehicle.slung_load={mass: 0.05, length: 0.5}"],
            "vehicle.slung_load is .*, but must be left out, since .* of kind response does not model it",
        ),
        (
            [RESPONSE_AUTOPILOT_OVERRIDE, NO_ATTITUDE_OVERRIDE, "laboratory.autopilot.damping.1=0"],
            "autopilot.damping.1 is 0, but must be larger than 0",
        ),
        (
            ["laboratory.autopilot.kind=inav"],
            "autopilot.kind is 'inav', but must be one of 'ardupilot', 'attitude', 'betaflight', 'crazyflie_firmware'",
        ),
    ],
)
def test_the_attitude_must_be_controlled_either_on_the_ground_or_on_board(write, overrides, words):
    assert re.search(words, refusal(load_scenario, write(SMALL_FILE), overrides))


@pytest.mark.slow
def test_an_attitude_response_too_fast_for_the_time_step_is_refused(write):
    """The Runge-Kutta method is stable for steps up to 2.5 time constants. The faster pole is at ω (ζ + √(ζ² - 1))."""
    fast = "laboratory.autopilot={natural_frequency: [6, 100, 3], damping: [0.5, %s, 0.5]}"
    for damping, validation_error in (("1.4", False), ("1.5", True)):
        scenario = load_scenario(
            write(SMALL_FILE), [RESPONSE_AUTOPILOT_OVERRIDE, NO_ATTITUDE_OVERRIDE, fast % damping, "duration=0.1"]
        )
        if validation_error:
            words = "vehicle.time_step is 0.01 s, too long for an attitude response with a time constant of 0.0038 s"
            with pytest.raises(InputError, match=words):
                simulate(scenario)
        else:
            assert not simulate(scenario).metrics.crashed


TWO_WAYPOINTS_OVERRIDE = "route={kind: waypoints, waypoints: [[0, 0, 1], [1, 0, 1]], times:"
KNOTS_OVERRIDE = "route={kind: trajectory, knots: [{time: 0, position: [0, 0, 1]}, {time: %s, position: [1, 0, 1]}]}"
GUST_OVERRIDE = "laboratory.wind=[{kind: gust, velocity: [1, 0, 0], start: %s, rise_time: %s, hold_time: %s}]"
FAN_OVERRIDE = "laboratory.wind=[{kind: fan, position: [0, 0, 1], direction: %s, flow: 1, diameter: 1}]"


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("vehicle.time_step=9.313225746154786e-12", "vehicle.time_step is 9.3.*, but must be 0, or at least 0.0001"),
        ("vehicle.time_step=2", "vehicle.time_step is 2, but must be less than or equal to 1"),
        ("laboratory.motion_capture.period=1e-9", "motion_capture.period is 1e-09, but must be .* 0.0001"),
        ("laboratory.command_link.period=1e-9", "command_link.period is 1e-09, but must be .* 0.0001"),
        ("laboratory.command_link.period=1e9", "command_link.period is 10+.0, but must be less than or equal to 1"),
        ("duration=1e300", r"duration is 1e\+300, but must be less than or equal to 86400"),
        ("route.duration=1e300", r"route.duration is 1e\+300, but must be less than or equal to 86400"),
        ("route.duration=1e-300", "route.duration is 1e-300, but must be greater than or equal to 0.0001"),
        (f"{TWO_WAYPOINTS_OVERRIDE} [0, 1e9]}}", "route.times is .*, but must not exceed 86400"),
        (f"{TWO_WAYPOINTS_OVERRIDE} [0, 1e300]}}", r"route.times.1 is 1e\+300, but must be less"),
        (
            f"{TWO_WAYPOINTS_OVERRIDE} [0, 1e-300]}}",
            "route.times is .*, but must increase by at least 0.0001 s from one to the next",
        ),
        (
            f"{TWO_WAYPOINTS_OVERRIDE} {{kind: minimum_snap, duration: 1e-300}}}}",
            "route.times.duration is 1e-300, but must be greater",
        ),
        (KNOTS_OVERRIDE % "1e300", r"route.knots.1.time is 1e\+300, but must be less than or equal to 86400"),
        (KNOTS_OVERRIDE % "1e-300", r"route.knots.1.time is 1e-300, but must be at least 0.0001 s later than 0.0?"),
        (GUST_OVERRIDE % ("1e6", "1", "1"), r"wind.0.start is 1000000.0, but must be at least 0 and at most 86400"),
        (
            GUST_OVERRIDE % ("0", "1e-320", "1"),
            r"wind.0.rise_time is 1e-320, but must be at least 0.0001 and at most 86400",
        ),
        (GUST_OVERRIDE % ("0", "1", "1e6"), r"wind.0.hold_time is 1000000.0, but must be at least 0 and at most 86400"),
        (
            GUST_OVERRIDE % ("{uniform: {min: 0, max: 1e6}}", "1", "1"),
            r"wind.0.start is .*, but must be .* at most 86400",
        ),
        ("vehicle.rotor_failure={rotor: 1, time: 1e6}", "rotor_failure.time is 1000000.0, but must be .* 86400"),
        ("vehicle.rotor_time_constant=1e-320", "rotor_time_constant is 1e-320, but must be at least 0.0001"),
        ("metrics.start=1e6", "metrics.start is 1000000.0, but must be less than or equal to 86400"),
        ("metrics.end=1e6", "metrics.end is 1000000.0, but must be less than or equal to 86400"),
        (
            FAN_OVERRIDE % "[1e-320, 0, 0]",
            r"wind.0.direction is \[1e-320, 0, 0\], but must have a component whose magnitude is at least",
        ),
        (FAN_OVERRIDE % "[{choice: [1e-320, 1]}, 0, 0]", r"wind.0.direction is .*, but must have a component"),
        (
            FAN_OVERRIDE % "[1e200, 0, 0]",
            r"wind.0.direction.0 is 1e\+200, but must be less than or equal to 1000000000",
        ),
        ("vehicle.mass=1e-320", "vehicle.mass is 1e-320, but must be at least 1e-12"),
        ("vehicle.mass=1e300", r"vehicle.mass is 1e\+300, but must be less than or equal to 1000000000"),
        ("vehicle.mass={choice: [1, 1e300]}", r"vehicle.mass.choice.1 is 1e\+300, but must be less"),
        (
            "laboratory.wind=[" + "{kind: dryden}, " * 101 + "]",
            "laboratory.wind is .*must have at most 100 items",
        ),
    ],
)
def test_impossible_times_and_numbers_are_refused(write, override, words):

    assert re.search(words, refusal(load_scenario, write(SMALL_FILE), [override]))


SHORT_PERIOD_OVERRIDES = [f"{field}=0.001" for field in ("vehicle.time_step", "laboratory.command_link.period")]
SHORT_PERIOD_OVERRIDES += ["laboratory.motion_capture.period=0.001"]


@pytest.mark.parametrize(
    ("override", "field"),
    [
        ("duration=10001", "duration"),
        ("route.duration=10001", "route.duration"),
        (f"{TWO_WAYPOINTS_OVERRIDE} [0, 10001]}}", "route.times"),
        (f"{TWO_WAYPOINTS_OVERRIDE} {{kind: fixed, times: [0, 10001]}}}}", "route.times"),
        (f"{TWO_WAYPOINTS_OVERRIDE} {{kind: minimum_snap, duration: 10001}}}}", "route.times.duration"),
        (KNOTS_OVERRIDE % "10001", "route.knots.1.time"),
    ],
)
def test_a_flight_with_too_many_ticks_is_refused_when_it_is_loaded(write, override, field):
    message = refusal(load_scenario, write(SMALL_FILE), [*SHORT_PERIOD_OVERRIDES, override])
    assert message.startswith("override ")
    assert f" {field} is " in message
    assert message.endswith("but must be at most 10000 s, 10,000,000 times the shortest period")
    assert load_scenario(write(SMALL_FILE), [*SHORT_PERIOD_OVERRIDES, override.replace("10001", "10000")])


def test_a_flight_with_too_many_ticks_is_refused_after_planning(write):
    short_step = ["vehicle.time_step=0.0001"]
    short_step += [f"laboratory.{name}.period=0.0128" for name in ("command_link", "motion_capture")]
    scenario = load_scenario(write(SMALL_FILE), ["route={kind: circle, laps: 100, radius: 5}", *short_step])
    with pytest.raises(InputError, match=r"the flight would take .* s, but must take at most 1000 s, which is 10,000,"):
        flight_duration(scenario, plan_route(scenario))


def test_a_route_that_takes_longer_than_a_day_is_not_planned(write):
    slow = load_scenario(write(SMALL_FILE), ["route={kind: circle, top_speed: 1e-6}"])
    with pytest.raises(
        InputError, match="the route would take .* s within its limits, but a flight takes at most 86400 s"
    ):
        plan_route(slow)


def test_a_vehicle_with_infinite_states_has_crashed_and_records_only_finite_values(write):

    flight = simulate(load_scenario(write(SMALL_FILE), ["vehicle.centre_of_mass=[1e6, 0]", "duration=0.2"]))
    assert flight.metrics.crashed
    assert flight.time[-1] < flight.metrics.crash_time
    assert all(np.isfinite(values).all() for values in flight.signals.values())


def test_integration_with_euler_angles_stops_close_to_90_degrees_of_pitch(write):
    """Near this pitch, angles change by half a turn within 20 µs. The flight must not continue with wrong angles."""
    turns_over = ["vehicle.time_step=0", "crash={tilt: null, position_error: 100, height: -100}", "duration=0.2"]

    def set_flip(simulator):
        vehicle = subsystem(simulator.get_system(), ["laboratory", "vehicle"])
        context = vehicle.GetMyMutableContextFromRoot(simulator.get_mutable_context())
        state = vehicle.get_state(context, "continuous")
        body = state.body._replace(pitch=math.radians(85.0), q=6.0, r=1e-4)
        vehicle.set_state(context, "continuous", state._replace(body=body))

    with pytest.raises(
        InputError, match="changes too fast: .* near the singularity at a pitch of 90 degrees; set vehicle.time_step"
    ):
        simulate(load_scenario(write(SMALL_FILE), turns_over), prepare=set_flip)


def test_the_error_for_a_state_that_changes_too_fast_gives_the_reason(write):
    fast = ["vehicle={time_step: 0, inertia: [1e-12, 1e-12, 1e-12], centre_of_mass: [0.1, 0]}", "duration=0.2"]
    with pytest.raises(
        InputError, match="vehicle.time_step is 0, but from .* s on the continuous state changes too fast"
    ):
        simulate(load_scenario(write(SMALL_FILE), fast))


def test_the_limit_on_waypoints_includes_all_laps(diagrams):
    """A route with fifty laps of twenty waypoints reaches the limit of 1,000 waypoints."""
    points = ", ".join(f"{{point: [{i}, 0, 1]}}" for i in (*range(19), 0))
    route = f"route={{kind: waypoints, waypoints: [{points}]}}"
    assert load_scenario(diagrams / "hover.yaml", [route, "route.laps=50"]).route.laps == 50
    with pytest.raises(
        InputError, match="route.laps is 51, but must be smaller, since all laps together may have at most 1000"
    ):
        load_scenario(diagrams / "hover.yaml", [route, "route.laps=51"])
