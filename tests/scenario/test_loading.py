"""Tests of scenario loading: accepted inputs, and messages of one sentence for refused inputs."""

import re
from io import StringIO

import numpy as np
import pytest
from ruamel.yaml import YAML

from drake_quad.errors import InputError
from drake_quad.scenario.files.loading import has_control, load_scenario, load_undesigned
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.layouts import rotors_of
from drake_quad.scenario.models import Scenario
from drake_quad.scenario.paths import distributions_in, value_at
from drake_quad.scenario.routes.route import ROUTES
from drake_quad.scenario.winds.source import WINDS

MINIMAL_FIELDS = """\
  route: {kind: hover}
  control:
    position: {kind: pd, k_p: [1.0, 1.0, 1.0], k_d: [1, 1e0, 1.5]}
    attitude: {k_p: [9.0, 9.0, 4.0], k_d: [6.0, 6.0, 3.0]}
"""


@pytest.fixture
def write(tmp_path):
    def writer(text, name="loop.yaml"):
        path = tmp_path / name
        path.write_text(text, encoding="utf-8")
        return path

    return writer


def refusal(write, text, *overrides):
    with pytest.raises(InputError) as caught:
        load_scenario(write(text), overrides)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_a_small_file_is_a_complete_scenario(write):
    scenario = load_scenario(write(f"small:\n{MINIMAL_FIELDS}"))
    assert scenario.name == "small"
    assert scenario.control.position.k_d == (1.0, 1.0, 1.5)
    assert scenario.vehicle.mass == 0.68


def test_a_file_with_several_scenarios_needs_a_name(write):
    path = write(f"one:\n{MINIMAL_FIELDS}two:\n{MINIMAL_FIELDS}")
    assert load_scenario(f"{path}:two").name == "two"
    with pytest.raises(InputError, match="several scenarios; choose one as .*:NAME from one, two"):
        load_scenario(path)
    with pytest.raises(InputError, match="no scenario 'three' in .*, which contains one, two"):
        load_scenario(f"{path}:three")


def test_extends_merges_deeply_and_later_layers_take_precedence(write):
    write(
        f"base:\n{MINIMAL_FIELDS}  vehicle: {{mass: 0.7, arm_length: 0.2}}\nlight: {{vehicle: {{mass: 0.5}}}}\n",
        "base.yaml",
    )
    path = write(
        "a: {extends: base.yaml:base, vehicle: {mass: 0.6}}\n"
        "b: {extends: [a, base.yaml:light], route: {kind: circle, radius: 2.0}}\n"
    )
    a, b = load_scenario(f"{path}:a"), load_scenario(f"{path}:b")
    assert (a.vehicle.mass, a.vehicle.arm_length) == (0.6, 0.2)
    assert (b.vehicle.mass, b.vehicle.arm_length) == (0.5, 0.2)
    assert (b.route.kind, b.route.radius) == ("circle", 2.0)


def test_another_kind_or_distribution_replaces_a_mapping_completely(write):
    path = write(
        f"base:\n{MINIMAL_FIELDS}  vehicle: {{mass: {{uniform: {{min: 0.6, max: 0.7}}}}}}\n"
        "a: {extends: base, route: {kind: circle}, vehicle: {mass: {choice: [0.5, 0.6]}}}\n"
        "b: {extends: base, vehicle: {mass: 0.68}}\n"
    )
    assert list(distributions_in(load_scenario(f"{path}:a"))) == ["vehicle.mass"]
    assert load_scenario(f"{path}:b").vehicle.mass == 0.68


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a: {extends: a}", "a extends itself"),
        ("a: {extends: b}\nb: {extends: a}", "extends itself"),
        ("a: {extends: nothing.yaml}", "extends .*nothing.yaml, which does not exist"),
        ("a: {extends: nothing}", "no scenario 'nothing'"),
        ("a: {extends: 3}", "extends must be FILE, FILE:NAME or NAME"),
        ("a: {extends: []}", "extends must be FILE, FILE:NAME or NAME"),
    ],
)
def test_errors_for_invalid_extensions_give_the_reason(write, text, words):
    with pytest.raises(InputError, match=words):
        load_scenario(f"{write(text)}:a")


def test_an_undesigned_scenario_needs_neither_route_nor_gains(write):
    spec = write("mine: {vehicle: {linear_drag: 0.2}, control: {position: {k_p: [2, 2, 2]}}}")
    scenario = load_undesigned(spec, ["vehicle.quadratic_drag=0.1"])
    assert (scenario.vehicle.linear_drag, scenario.vehicle.quadratic_drag, scenario.name) == (0.2, 0.1, "mine")
    assert (scenario.route.kind, scenario.control.position.k_p) == ("figure_eight", (2.0, 2.0, 2.0))
    with pytest.raises(InputError, match=r"route"):
        load_scenario(spec)
    with pytest.raises(InputError, match=r":1: vehicle.masss"):
        load_undesigned(write("mine: {vehicle: {masss: 0.2}}"))


def test_overrides_take_precedence_and_are_named_in_errors(write):
    text = f"a:\n{MINIMAL_FIELDS}"
    assert load_scenario(write(text), ["vehicle.mass=0.9"]).vehicle.mass == 0.9
    assert refusal(write, text, "vehicle.mass=-1") == (
        "override vehicle.mass=-1: vehicle.mass is -1, but must be larger than 0"
    )
    assert "must be field.path=value" in refusal(write, text, "vehicle.mass")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("  vehicle: {mas: 1.0}", "6: vehicle.mas is unknown; allowed are mass, inertia, .*; did you mean mass?"),
        ("  mass: 1.0", "6: mass is unknown; allowed are .*; did you mean nominal.mass or vehicle.mass[?]"),
        ("  vehicle: {rotor_failure: {rotor: 1}}", "6: vehicle.rotor_failure.time is missing"),
        ("  vehicle: {rotor_failure: {}}", "6: vehicle.rotor_failure.rotor is missing, and so is time"),
        ("  vehicle: {mass: heavy}", "6: vehicle.mass is 'heavy', but must be a valid number"),
        ("  vehicle: {mass: true}", "6: vehicle.mass is True, but must be a valid number"),
        ("  vehicle: {mass: '0.7'}", "6: vehicle.mass is '0.7', but must be a valid number"),
        ("  vehicle: {mass: .nan}", "6: vehicle.mass is nan, but must be a finite number"),
        ("  vehicle: {mass: -.inf}", "6: vehicle.mass is -inf, but must be a finite number"),
        ("  vehicle: {mass: -0.1}", "6: vehicle.mass is -0.1, but must be larger than 0"),
        ("  vehicle: {mass: 1, mass: 2}", "6: 'mass' is already given at .*:6"),
        ("  vehicle: [1]", "6: vehicle is .*, but must be a mapping of fields such as mass, inertia, .* more"),
        ("  vehicle: {layout: x}", r"6: vehicle.layout is 'x', .* as in {kind: x}; the kinds are plus, x, h, rotors"),
        ("  vehicle: {layout: y}", r"6: vehicle.layout is 'y', .* as in {kind: plus}; the kinds"),
        ("  vehicle: {layout: {length: 1}}", "6: vehicle.layout.kind is missing; the kinds are plus, x, h, rotors"),
        ("  vehicle: {layout: {kind: x, length: 1}}", "must have width and length, or neither of them"),
        ("  vehicle: {layout: {kind: pluss}}", "6: vehicle.layout.kind is 'pluss', .*; did you mean plus[?]"),
        ("  laboratory: {wind: [{kind: stedy}]}", "6: laboratory.wind.0.kind is 'stedy', .*; did you mean steady[?]"),
        (
            "  laboratory: {wind: [{kind: [steady]}]}",
            "6: laboratory.wind.0.kind is .*, but must be one of .*'steady'; did you mean steady[?]$",
        ),
        ("  laboratory: {wind: [{kind: 3}]}", "6: laboratory.wind.0.kind is 3, but must be one of .*'steady'$"),
        ("  laboratory: {allocation: {priority: thrus}}", "priority is 'thrus', .*; did you mean thrust[?]"),
        ("  vehicle:\n    inertia: [1, 2]", r"7: vehicle.inertia.2 is missing"),
        ("  vehicle: {max_rotor_speed: 50.0}", "6: vehicle.max_rotor_speed is 50.0, but must be larger than min_"),
        ("  vehicle: {mass: {uniform: {min: 2, max: 1}}}", "6: vehicle.mass.uniform.max is 1, but must be larger"),
        ("  vehicle: {mass: {uniform: {min: -1, max: 1}}}", "6: vehicle.mass is .*, but must be larger than 0"),
        ("  vehicle: {mass: {normal: {mean: 1, standard_deviation: 1}}}", "6: vehicle.mass is .* larger than 0"),
        (
            "  vehicle: {mass: {normal: {mean: 1, standard_deviation: 0.1, min: 1.1}}}",
            "6: vehicle.mass.normal.min is 1.1, but must not be larger than the mean, 1.0",
        ),
        (
            "  vehicle: {mass: {normal: {mean: 1, standard_deviation: 0.1, min: 0.5, max: 0.9}}}",
            "6: vehicle.mass.normal.max is 0.9, but must not be smaller than the mean, 1.0",
        ),
        ("  vehicle: {mass: {gauss: 1}}", "6: vehicle.mass is .*, but must be a number or one of the distributions"),
        ("  duration: 0", "6: duration is 0, but must be greater than or equal to 0.0001"),
        ("  seed: -1", "6: seed is -1, but must be greater than or equal to 0"),
        ("  seed: 1.5", "6: seed is 1.5, but must be a valid integer"),
        (
            "  laboratory: {motion_capture: {period: 0.015}}",
            "6: laboratory.motion_capture.period is 0.015, but must be",
        ),
        ("  laboratory: {command_link: {period: 0.03}}", "6: laboratory.command_link.period is 0.03, but must be"),
        ("  laboratory: {command_link: {delay_ticks: 0.5}}", "6: laboratory.command_link.delay_ticks is 0.5, but"),
        ("  metrics: {start: 5, end: 4}", "6: metrics.end is 4, but must be later than start"),
        ("  name: a/b", "6: name is 'a/b', but must match"),
        ("  vehicle: !!python/object:os.system {}", "6: the tag .* is not allowed"),
        ("  vehicle: &v {mass: *v}", r"6: is not YAML: the alias \*v must come after the value with its anchor"),
        ("  3: 4", "6: the name of a field must be text"),
        ("  vehicle: {mass: 0.7", "is not YAML"),
        ("\t- x", "is not YAML"),
    ],
)
def test_the_error_for_an_invalid_field_gives_file_line_and_allowed_values(write, line, message):
    with pytest.raises(InputError, match=message):
        load_scenario(write(f"a:\n{MINIMAL_FIELDS}{line}\n"))


FAN_FIELDS = "kind: fan, position: [0, 0, 1]"


@pytest.mark.parametrize(
    ("field", "message"),
    [
        ("motion_capture: {position_noise: -0.001}", "motion_capture.position_noise is -0.001, but must be at least 0"),
        (
            "motion_capture: {attitude_noise: {normal: {mean: 0.004, standard_deviation: -1}}}",
            "attitude_noise.normal.standard_deviation is -1, but must be greater than 0",
        ),
        (
            "motion_capture: {attitude_noise: {uniform: {min: 0.004, max: 0.001}}}",
            "attitude_noise.uniform.max is 0.001, but must be larger than min, 0.004",
        ),
        ("motion_capture: {dropout_rate: 1.2}", "dropout_rate is 1.2, but must be at least 0 and at most 1"),
        ("motion_capture: {derivative_bandwidth: 0}", "derivative_bandwidth is 0, but must be larger than 0"),
        ("motion_capture: {latency_frames: 0.5}", "latency_frames is 0.5, but must be a whole number from 0 to 50"),
        (
            "command_link: {delay_ticks: {uniform: {min: 0, max: 2}}}",
            "delay_ticks is .*, but must be a whole number from 0 to 50, or a choice of such numbers",
        ),
        ("command_link: {delay_ticks: {choice: [1, 2.5]}}", "delay_ticks is .*, but must be a whole number"),
        ("command_link: {loss_rate: -0.1}", "loss_rate is -0.1, but must be at least 0 and at most 1"),
        (
            f"wind: [{{{FAN_FIELDS}, direction: [1, 0, 0], flow: 2, diameter: 0}}]",
            r"wind.0.diameter is 0, but must be larger",
        ),
        (
            f"wind: [{{{FAN_FIELDS}, direction: [0, 0, 0], flow: 2, diameter: 1}}]",
            r"wind.0.direction is .* a component whose magnitude is at least",
        ),
        (f"wind: [{{{FAN_FIELDS}, direction: [1, 0, 0], diameter: 1}}]", r"wind.0.flow is missing"),
        (
            "wind: [{kind: breeze}]",
            f"wind.0.kind is 'breeze', but must be one of {str([*WINDS.members])[1:-1]}",
        ),
        (
            "wind: [{kind: dryden, level: mild}]",
            r"wind.0.level is 'mild', but must be 'light', 'moderate' or 'severe'",
        ),
        (
            f"wind: [{{{FAN_FIELDS}, direction: [{{choice: [0, 1]}}, 0, 0], flow: 2, diameter: 1}}]",
            r"wind.0.direction is .* must have a component whose magnitude is at least",
        ),
        ("wind: [{kind: dryden, height: 2}]", r"wind.0.height is 2, but must be at least 3.048 and at most 304.8"),
        ("wind: [{kind: dryden, airspeed: 0.3}]", r"wind.0.airspeed is 0.3, but must be at least 1"),
        ("wind: [{kind: steady, velocity: [1, 2]}]", r"wind.0.velocity.2 is missing"),
        (
            "wind: [{kind: gust, velocity: [1, 0, 0], start: 1, rise_time: 0}]",
            r"wind.0.rise_time is 0, but must be larger than 0",
        ),
    ],
)
def test_an_invalid_laboratory_is_refused_in_one_sentence(write, field, message):
    assert re.search(
        f"loop.yaml:6: laboratory.*{message}", refusal(write, f"a:\n{MINIMAL_FIELDS}  laboratory: {{{field}}}\n")
    )


@pytest.mark.parametrize(
    ("field", "message"),
    [
        (
            "rotor_failure: {rotor: 5, time: 1}",
            "vehicle.rotor_failure.rotor is 5, but must be a whole number from 1 to 4",
        ),
        (
            "rotor_failure: {rotor: 1, time: 1, speed_factor: 1}",
            "speed_factor is 1, but must be at least 0 and smaller",
        ),
        ("thrust_factor_error: [0, 0, 0]", r"vehicle.thrust_factor_error.rotor_4 is missing"),
        (
            "thrust_factor_error: [0, 0, 0, -1]",
            r"vehicle.thrust_factor_error.rotor_4 is -1, but must be larger than -1",
        ),
        ("centre_of_mass: [0, 0, 0]", r"vehicle.centre_of_mass is \[0, 0, 0\], but must have at most 2 items, not 3"),
        ("battery_sag: 1", "vehicle.battery_sag is 1, but must be at least 0 and smaller than 1"),
        (
            "max_rotor_speed: {uniform: {min: 50, max: 300}}",
            "vehicle.max_rotor_speed is .*, but must be larger than min_rotor_speed, 60",
        ),
    ],
)
def test_an_invalid_vehicle_is_refused_in_one_sentence(write, field, message):
    assert re.search(f"loop.yaml:6: .*{message}", refusal(write, f"a:\n{MINIMAL_FIELDS}  vehicle: {{{field}}}\n"))


def test_a_vehicle_has_the_nominal_parameters_by_default(write):
    text = f"a:\n{MINIMAL_FIELDS}  nominal: {{mass: 1.2, arm_length: 0.25}}\n  vehicle: {{mass: 1.3}}\n"
    scenario = load_scenario(write(text))
    assert (scenario.vehicle.mass, scenario.vehicle.arm_length, scenario.vehicle.gravity) == (1.3, 0.25, 9.81)
    assert refusal(write, text, "nominal.mass={choice: [1, 2]}").endswith("but must be a valid number")


def rotors(turns="clockwise anticlockwise clockwise anticlockwise", shift=0.0):
    """Return four rotors on the corners of a square as YAML, with the given directions of rotation."""
    corners = ((0.1, -0.1), (-0.1, -0.1), (-0.1, 0.1), (0.1, 0.1))
    rotor_texts = [
        f"{{position: [{x + shift}, {y}, 0], turns: {turn}}}"
        for (x, y), turn in zip(corners, turns.split(), strict=True)
    ]
    return f"{{kind: rotors, rotors: [{', '.join(rotor_texts)}]}}"


@pytest.mark.parametrize(
    ("airframe", "message"),
    [
        ("layout: {kind: y}", "layout.kind is 'y', but must be one of 'plus', 'x', 'h', 'rotors'"),
        ("layout: {kind: h, length: 0.2}", "layout.width is missing"),
        ("layout: {kind: x, width: 0.2}", "layout is .*, but must have length and width"),
        (
            "layout: {kind: x, rotor_1_turns: left}",
            "layout.rotor_1_turns is 'left', but must be 'clockwise' or 'anticlockwise'",
        ),
        (
            "arm_length: 0.2, layout: {kind: x, length: 0.2, width: 0.2}",
            "arm_length is 0.2, but must be 0.1414, which follows from the distances in the layout, or be left out",
        ),
        (
            "arm_length: 0.2, layout: {kind: plus, length: 0.3, width: 0.2}",
            "arm_length is 0.2, but must be 0.1 to 0.15, which follows from the distances in",
        ),
        (
            f"arm_length: 0.2, layout: {rotors()}",
            "arm_length is 0.2, but must be 0.1414, which follows from the distances",
        ),
        (
            f"layout: {rotors('clockwise clockwise clockwise clockwise')}",
            "layout is .*, but must produce thrust and all torques, but cannot produce yaw torque without thrust",
        ),
        (
            f"layout: {rotors('clockwise clockwise anticlockwise anticlockwise')}",
            "layout is .*, but must produce thrust and all torques, but cannot produce yaw torque without roll torque",
        ),
    ],
)
@pytest.mark.parametrize("vehicle", ["nominal", "vehicle"])
def test_an_invalid_layout_is_refused_in_one_sentence(write, airframe, message, vehicle):
    assert re.search(
        f"loop.yaml:6: {vehicle}.{message}", refusal(write, f"a:\n{MINIMAL_FIELDS}  {vehicle}: {{{airframe}}}\n")
    )


def test_the_nominal_vehicle_must_hover_and_have_no_distribution(write):
    text = f"a:\n{MINIMAL_FIELDS}  nominal: {{layout: {rotors(shift=0.2)}}}\n"
    assert "layout is" in (message := refusal(write, text))
    assert message.endswith("but must produce thrust without torque: rotor 1 would have to push down")
    distribution = "{uniform: {min: 0.1, max: 0.2}}"
    message = refusal(write, f"a:\n{MINIMAL_FIELDS}", f"nominal.layout={{kind: x, length: {distribution}, width: 0.2}}")
    assert message.endswith("but must be a number, since planner and controllers use it")
    vehicle = load_scenario(
        write(f"a:\n{MINIMAL_FIELDS}"), [f"vehicle.layout={{kind: x, length: {distribution}, width: 0.2}}"]
    ).vehicle
    assert [*distributions_in(vehicle)] == ["layout.length"]
    message = refusal(
        write,
        f"a:\n{MINIMAL_FIELDS}  vehicle: {{arm_length: {distribution}, layout: {{kind: h, length: 1, width: 1}}}}\n",
    )
    assert message.endswith("but must be left out, since the distances in the layout determine it")


def test_overrides_and_messages_number_rotors_in_the_same_way(write):
    text = f"a:\n{MINIMAL_FIELDS}  vehicle: {{thrust_factor_error: [0, 0, 0, 0], layout: {rotors()}}}\n"
    overrides = ["vehicle.thrust_factor_error.rotor_3=0.1", "vehicle.layout.rotors.rotor_2.position.0=-0.12"]
    vehicle = load_scenario(write(text), overrides).vehicle
    assert vehicle.thrust_factor_error == (0.0, 0.0, 0.1, 0.0)
    assert [rotor.position[0] for rotor in vehicle.layout.rotors] == [0.1, -0.12, -0.1, 0.1]
    message = refusal(write, text, "vehicle.layout.rotors.rotor_2.turns=up")
    assert "vehicle.layout.rotors.rotor_2.turns is 'up'" in message
    message = refusal(write, text, "vehicle.thrust_factor_error.1=0.1")
    assert message.endswith("does not name a rotor; write rotor_1, rotor_2, rotor_3 or rotor_4 instead of '1'")


def test_an_arm_length_may_be_given_if_it_agrees_with_the_layout(write):
    """A given arm length may differ by 1 % from the layout. A default arm length is ignored."""
    for arm in ("0.1414", "0.1425", "0.1401"):
        text = f"a:\n{MINIMAL_FIELDS}  nominal: {{arm_length: {arm}, layout: {{kind: x, length: 0.2, width: 0.2}}}}\n"
        assert load_scenario(write(text)).vehicle.layout.kind == "x"
    refusal(write, text.replace("0.1401", "0.1435"))
    refusal(write, text.replace("0.1401", "0.1395"))
    assert load_scenario(write(text.replace("arm_length: 0.1401, ", ""))).nominal.arm_length == 0.17


@pytest.mark.parametrize(
    ("nominal", "vehicle", "has_arm_length"),
    [
        ("layout: {kind: x, length: 0.2, width: 0.24}", "mass: 0.7", (False, False)),
        ("layout: {kind: plus, length: 0.2, width: 0.24}, arm_length: 0.11", "mass: 0.7", (False, False)),
        (f"layout: {rotors()}", "mass: 0.7", (False, False)),
        ("layout: {kind: x}, arm_length: 0.2", "layout: {kind: h, length: 0.2, width: 0.3}", (True, False)),
        ("layout: {kind: h, length: 0.2, width: 0.3}", "layout: {kind: plus}, arm_length: 0.21", (False, True)),
    ],
)
def test_a_saved_layout_with_rotor_distances_has_no_arm_length_and_the_same_rotors(
    write, tmp_path, nominal, vehicle, has_arm_length
):
    scenario = load_scenario(write(f"a:\n{MINIMAL_FIELDS}  nominal: {{{nominal}}}\n  vehicle: {{{vehicle}}}\n"))
    save_scenario(scenario, tmp_path / "saved.yaml")
    saved = YAML(typ="safe").load(tmp_path / "saved.yaml")["a"]
    assert ("arm_length" in saved["nominal"], "arm_length" in saved["vehicle"]) == has_arm_length
    loaded_scenario = load_scenario(tmp_path / "saved.yaml")
    assert loaded_scenario.model_dump() == scenario.model_dump()
    for name in ("nominal", "vehicle"):
        assert rotors_of(getattr(loaded_scenario, name)) == rotors_of(getattr(scenario, name))


def test_rotors_have_the_positions_of_their_layout(write):
    """Seen from above, rotors are numbered clockwise from the front. The arm of an x is half the diagonal."""

    def rotor_rows(airframe):
        nominal = load_scenario(write(f"a:\n{MINIMAL_FIELDS}  nominal: {{{airframe}}}\n")).nominal
        return np.array(rotors_of(nominal))

    plus, x = (
        rotor_rows("arm_length: 0.2"),
        rotor_rows("arm_length: 0.2, layout: {kind: x, rotor_1_turns: anticlockwise}"),
    )
    np.testing.assert_allclose(plus[:, :2], [[0.2, 0.0], [0.0, -0.2], [-0.2, 0.0], [0.0, 0.2]])
    np.testing.assert_allclose(x[:, :2], 0.2 * np.sqrt(0.5) * np.array([[1, -1], [-1, -1], [-1, 1], [1, 1]]))
    assert (list(plus[:, 3]), list(x[:, 3])) == ([-1.0, 1.0, -1.0, 1.0], [1.0, -1.0, 1.0, -1.0])
    h = rotor_rows("layout: {kind: h, length: 0.2, width: 0.3}")
    np.testing.assert_allclose(h[:, :2], [[0.1, -0.15], [-0.1, -0.15], [-0.1, 0.15], [0.1, 0.15]])
    measured = rotor_rows("layout: {kind: plus, length: 0.2, width: 0.3}")
    np.testing.assert_allclose(measured[:, :2], [[0.1, 0.0], [0.0, -0.15], [-0.1, 0.0], [0.0, 0.15]])
    free = rotor_rows(
        f"thrust_factor: 3e-5, layout: {rotors().replace('clockwise}', 'clockwise, drag_factor: 1e-6}', 1)}"
    )
    np.testing.assert_allclose(free[0], [0.1, -0.1, 0.0, -1.0, 3e-5, 1e-6])
    np.testing.assert_allclose(free[1], [-0.1, -0.1, 0.0, 1.0, 3e-5, 8.5e-7])


@pytest.mark.parametrize(
    ("nominal", "vehicle", "message"),
    [
        ("min_rotor_speed: 190", "max_rotor_speed: 150", "max_rotor_speed is 150, but must be larger than .*, 190"),
        ("max_rotor_speed: 250", "min_rotor_speed: 280", "min_rotor_speed is 280, but must be smaller than .*, 250"),
        ("min_rotor_speed: 10", "max_rotor_speed: 55", None),
    ],
)
def test_rotor_speed_limits_are_checked_after_missing_fields_were_taken_from_nominal(write, nominal, vehicle, message):
    text = f"a:\n{MINIMAL_FIELDS}  nominal: {{{nominal}}}\n  vehicle: {{{vehicle}}}\n"
    if message is None:
        assert load_scenario(write(text)).vehicle.min_rotor_speed == 10.0
    else:
        assert re.search(f"loop.yaml:7: vehicle.{message}", refusal(write, text))


@pytest.mark.parametrize(
    ("route", "message"),
    [
        (
            "{kind: oval}",
            f"2: route.kind is 'oval', but must be one of {str([*ROUTES.members])[1:-1]}",
        ),
        ("{radius: 1}", "2: route.kind is missing"),
        (
            "{kind: figure_eight, radius: 3.0}",
            "2: route.offset is 1.9 by default, but must be larger than the radius, 3.0",
        ),
        ("{kind: waypoints, waypoints: [[0, 0, 0]]}", "2: route.waypoints is .* at least 2 items"),
        ("{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], times: [1, 1]}", r"2: route.times is .* must increase"),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], times: [-1, 1]}",
            r"2: route.times is .*must not be negative",
        ),
        ("{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], times: [1]}", r"2: route.times is .*one time for each"),
        ("{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], times: []}", r"2: route.times is .*at least 1 item"),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], times: [0, x]}",
            r"2: route.times.1 is 'x', but must be a valid number",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], times: 5}",
            r"2: route.times is 5, but must be a mapping",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], times: {kind: fastest}}",
            r"2: route.times.kind is 'fastest', but must be one of 'fixed', 'heuristic'",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], times: {kind: minimum_snap, duration: 0}}",
            r"2: route.times.duration is 0, but must be greater than or equal to 0.0001",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], speed: 1}",
            r"2: route.speed is unknown; allowed are .*top_speed",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], top_speed: 0}",
            r"2: route.top_speed is 0, but must be larger than 0",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], top_speed: null, top_acceleration: null}",
            r"2: route.top_speed is None, but must be a number",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], corridors: [null, null]}",
            r"2: route.corridors is .* one corridor or null for each of the 1 segments",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], corridors: [{min: [0, 0, 2], max: [1, 1, 1]}]}",
            r"2: route.corridors.0.max.2 is 1, but must not be smaller",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], corridors: [{min: [0, 0, 0.5], max: [1, 1, 2]}]}",
            r"2: route cannot be flown: waypoint 0, .* lies outside the corridor of segment 0, .* 0.5 m apart on z",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], "
            "corridors: [{half_spaces: [{normal: [0, 0, 0], point: [0, 0, 2]}]}]}",
            r"2: route.corridors.0.half_spaces.0.normal is .*, but must not be zero",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], corridors: [{half_spaces: []}]}",
            r"2: route.corridors.0.half_spaces ",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], corridors: [{}]}",
            r"2: route.corridors.0 .*must have min and max, or half_spaces, or all three",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], corridors: [{min: [0, 0, 0]}]}",
            r"2: route.corridors.0.max is .*must be given, since a box needs both corners",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], corridors: [{half_spaces: "
            "[{normal: [1, 1, 0], point: [1, 0, 0]}, {normal: [-1, -1, 0], point: [2, 0, 0]}]}]}",
            r"2: route.corridors.0 is .*, but must have a volume, but its half-spaces have no point in common$",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], corridors: [{min: [0, 0, 0], max: [1, 1, 1], "
            "half_spaces: [{normal: [1, 1, 0], point: [-1, 0, 0]}]}]}",
            r"2: route.corridors.0 is .*, but its box and its half-spaces have no point in common$",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], corridors: [{half_spaces: "
            "[{normal: [1, 1, 0], point: [0, 0, 0]}, {normal: [-1, -1, 0], point: [0, 0, 0]}]}]}",
            r"2: route.corridors.0 is .*, but must have a volume, but its half-spaces have only a plane",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], "
            "corridors: [{half_spaces: [{normal: [0, 3, 4], point: [0, 0, 0.5]}]}]}",
            r"2: route cannot be flown: waypoint 1, .* lies outside the corridor of segment 0, .* 0.4 m apart",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], space: {min: [0, 0, 0], max: [1, 1, 0.5]}}",
            r"2: route cannot be flown: waypoint 1, .* lies outside",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], "
            "corridors: [{min: [0, 0, 0], max: [1, 1, 1]}], space: {min: [4, 4, 4], max: [5, 5, 5]}}",
            r"2: route cannot be flown: the corridor of segment 0 lies outside route.space",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], [0, 0, 1]], heading: waypoints}",
            r"2: route.heading is 'waypoints', but must not be `waypoints`, since no waypoint has a yaw",
        ),
        ("{kind: waypoints, waypoints: [[0, 0], [0, 0, 1]]}", r"2: route.waypoints.0.2 is missing"),
        ("{kind: waypoints, waypoints: [{box: {}}, [0, 0, 1]]}", r"2: route.waypoints.0.box.min is missing"),
        (
            "{kind: waypoints, waypoints: [{stop: true}, [0, 0, 1]]}",
            r"2: route.waypoints.0 is .*one of point, box and",
        ),
        (
            "{kind: waypoints, waypoints: [{point: [0, 0, 0], sphere: {centre: [0, 0, 0], radius: 1}}, [0, 0, 1]]}",
            r"2: route.waypoints.0 is .*not point and sphere",
        ),
        (
            "{kind: waypoints, waypoints: [{point: [0, 0, 0], stop: true, jerk: [0, 0, 0]}, [0, 0, 1]]}",
            r"2: route.waypoints.0 is .*must not have `stop` together with a velocity",
        ),
        (
            "{kind: waypoints, waypoints: [{point: [0, 0, 0], yaw: 1.0}, [0, 0, 1]]}",
            "2: route.heading is 'constant' by default, but must be `waypoints`, since yaws are given at waypoints",
        ),
        (
            "{kind: waypoints, waypoints: [[0, 0, 0], {point: [1, 1, 1], velocity: [3, 0, 0]}, [0, 0, 1]]}",
            "2: route cannot be flown: the velocity at waypoint 1 is 3 m/s, more than the limit of 2 m/s",
        ),
        ("{kind: waypoints, times: [0, 1]}", "2: route.waypoints is missing"),
        ("{kind: trajectory, knots: [{time: 0, position: [0, 0, 0]}]}", "2: route.knots is .* at least 2 items"),
        (
            "{kind: trajectory, knots: [{time: 1, position: [0, 0, 0]}, {time: 1, position: [0, 0, 1]}]}",
            r"2: route.knots.1.time is 1, but must be at least 0.0001 s later than 1",
        ),
        (
            "{kind: trajectory, knots: [{time: 0, position: [0, 0, 0]}, {time: 1, position: [0, 0, 1]}], "
            "yaw_knots: [{time: 0, yaw: 0}, {time: 2, yaw: 0}]}",
            r"2: route.yaw_knots.1.time is 2, but must be 1.0, the time of the last of `knots`",
        ),
    ],
)
def test_errors_for_invalid_routes_give_the_reason(write, route, message):
    text = f"a:\n{MINIMAL_FIELDS}".replace("{kind: hover}", route)
    with pytest.raises(InputError, match=f"loop.yaml:{message}"):
        load_scenario(write(text))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "contains no scenario"),
        ("3", "contains no scenario"),
        ("- 1", "contains no scenario"),
        ("a: 3", "scenario a must be a mapping"),
        ("a:", "scenario a must be a mapping"),
        (f"a:\n{MINIMAL_FIELDS}---\nb: 1", "is not YAML"),
        ("a: {route: {kind: hover}}", "control is missing; only `drake-quad plan` needs no control"),
        (
            "a: {extends: vehicles/crazyflie}",
            "has neither a route nor a control, so it describes only a vehicle; `drake-quad design`",
        ),
        ("a: {vehicle: {mass: -1}}", "has neither a route nor a control"),
        ("[" * 10_000, "is nested too deeply: a scenario may have at most 40 levels"),
    ],
)
def test_errors_for_invalid_files_give_the_reason(write, text, words):
    assert words in refusal(write, text)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("drone.urdf", "robot (URDF)"),
        ("drone.urdf.xacro", "robot (URDF)"),
        ("DRONE.SDF", "model or world (SDFormat)"),
        ("drone.xml", "robot (XML, such as MJCF)"),
        ("drone.usda", "scene (USD)"),
    ],
)
def test_the_error_for_a_robot_file_names_its_format(write, tmp_path, name, kind):
    words = re.escape(f"describes a {kind} and is not a scenario: write its mass, inertia and rotors into `nominal`")
    (tmp_path / name).write_text("<robot name='drone'/>")
    for spec in (tmp_path / name, f"{tmp_path / name}:drone", tmp_path / f"missing_{name}"):
        with pytest.raises(InputError, match=words):
            load_scenario(spec)
    with pytest.raises(InputError, match=rf"loop.yaml:1: extends '{name}', which {words}"):
        load_scenario(write(f"a: {{extends: [figure_eight, {name}]}}"))


def test_the_error_for_a_missing_or_binary_file_gives_the_reason(tmp_path):
    with pytest.raises(InputError, match="cannot be read: no such file"):
        load_scenario(tmp_path / "nothing.yaml")
    with pytest.raises(InputError, match="cannot be read"):
        load_scenario(tmp_path)
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="is not UTF-8 text"):
        load_scenario(tmp_path / "binary.yaml")


@pytest.mark.slow
def test_shipped_scenarios_load(diagrams):
    for path in diagrams.glob("*.yaml"):
        for name in YAML(typ="safe").load(path):
            assert isinstance(load_scenario(f"{path}:{name}"), Scenario)


def test_a_saved_scenario_is_unchanged_after_loading(diagrams, write):
    scenario = load_scenario(diagrams / "figure_eight.yaml", ["vehicle.mass={uniform: {min: 0.6, max: 0.7}}"])
    text = StringIO()
    YAML().dump({"again": scenario.model_dump(mode="json")}, text)
    assert load_scenario(write(text.getvalue())) == scenario


def test_a_vehicle_file_has_no_control(diagrams):
    assert not has_control(diagrams / "vehicles" / "crazyflie.yaml")
    assert has_control(diagrams / "figure_eight.yaml")
    assert has_control(f"{diagrams / 'laboratory.yaml'}:low_wind")  # the control is inherited
    with pytest.raises(InputError, match="cannot be read"):
        has_control(diagrams / "nothing.yaml")


@pytest.mark.parametrize(
    ("earlier_overrides", "item_overrides", "path", "expected"),
    [
        ([], ["vehicle.inertia.0=0.006"], "vehicle.inertia", (0.006, 0.007, 0.012)),
        (
            ["nominal.inertia=[0.008, 0.009, 0.01]"],
            ["vehicle.inertia.0=0.006"],
            "vehicle.inertia",
            (0.006, 0.009, 0.01),
        ),
        ([], ["nominal.inertia.1=0.006", "nominal.inertia.0=0.008"], "nominal.inertia", (0.008, 0.006, 0.012)),
        (["vehicle.inertia=[0.2, 0.2, 0.2]"], ["vehicle.inertia.0=0.1"], "vehicle.inertia", (0.1, 0.2, 0.2)),
        (
            [],
            ["vehicle.thrust_factor_error.rotor_2=0.1"],
            "vehicle.thrust_factor_error",
            (0.0, 0.1, 0.0, 0.0),
        ),
        ([], [{"vehicle.inertia": {0: 0.006, 2: 0.011}}], "vehicle.inertia", (0.006, 0.007, 0.011)),
        ([], ["route.position.2=2"], "route.position", (0.0, 0.0, 2.0)),
    ],
)
def test_an_override_can_give_a_single_item_of_a_list(diagrams, earlier_overrides, item_overrides, path, expected):
    """The other items keep their values from the file, or their defaults if the file gives no values."""
    assert value_at(load_scenario(diagrams / "hover.yaml", [*earlier_overrides, *item_overrides]), path) == expected


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (
            ["vehicle.inertia.3=0.006"],
            "^override vehicle.inertia.3=0.006: vehicle.inertia has no item 3; its items are",
        ),
        (["vehicle.inertia.01=0.006"], "vehicle.inertia has no item 01; its items are"),
        (["vehicle.inertia.١=0.006"], "vehicle.inertia is .*, but must be a list$"),
        (["vehicle.mass=-1", "vehicle.inertia.0=0.006"], "^override vehicle.mass=-1: vehicle.mass is -1"),
        (["metrics.window.0=1"], "metrics.window is unknown"),
        (
            ["vehicle.motors={kind: throttle, curve: {'1': 3}}"],
            "single items can only be given if the other items have",
        ),
        (
            [
                "laboratory.wind=[{kind: fan, position: [0, 0, 1], flow: 2, diameter: 1}]",
                "laboratory.wind.0.direction.1=1",
            ],
            r"laboratory.wind.0.direction is \{'1': 1\}, but must be a list; single items can only be given if",
        ),
    ],
)
def test_an_override_with_an_index_outside_the_list_is_refused(diagrams, overrides, words):
    with pytest.raises(InputError, match=words):
        load_scenario(diagrams / "hover.yaml", overrides)


IMPOSSIBLE_INERTIA = "I_zz, 0.03, is larger than I_xx + I_yy, 0.014 kg m²"


@pytest.mark.parametrize(
    ("override", "words"),
    [
        (
            "vehicle.inertia=[0.007, 0.007, 0.03]",
            f"vehicle.inertia is .* must belong to a rigid body: {IMPOSSIBLE_INERTIA}",
        ),
        (
            "nominal.inertia=[0.007, 0.007, 0.03]",
            f"nominal.inertia is .* must belong to a rigid body: {IMPOSSIBLE_INERTIA}",
        ),
        ("vehicle.inertia.2=0.03", f"vehicle.inertia is .*{IMPOSSIBLE_INERTIA}"),
        (
            "vehicle.inertia=[{uniform: {min: 0.003, max: 0.004}}, 0.002, {choice: [0.007, 0.008]}]",
            "must belong to a rigid body: for every draw, I_zz, 0.007, is larger than I_xx + I_yy, 0.006",
        ),
        (
            "vehicle.payload={mass: 0.1, inertia: [0.001, 0.004, 0.002], time: 1, event: dropped}",
            "vehicle.payload.inertia is .* rigid body: I_yy, 0.004, is larger than I_xx . I_zz, 0.003",
        ),
    ],
)
def test_impossible_moments_of_inertia_are_refused(diagrams, override, words):
    with pytest.raises(InputError, match=words.replace("+", r"\+")):
        load_scenario(diagrams / "hover.yaml", [override])


@pytest.mark.parametrize(
    "inertia",
    [
        "[0.0061, 0.0061, 0.0123]",
        "[0.007, 0.007, {normal: {mean: 0.013, standard_deviation: 0.001, min: 0.001}}]",
        "[{normal: {mean: 0.001, standard_deviation: 0.001, min: 0.0001}}, 0.007, 0.012]",
    ],
)
def test_possible_moments_of_inertia_are_accepted(diagrams, inertia):
    load_scenario(diagrams / "hover.yaml", [f"vehicle.inertia={inertia}"])


@pytest.mark.parametrize(
    ("field", "path"),
    [
        ("control: {policy: FILE}", "control.policy"),
        ("control: {network: {learned: FILE}}", "control.network.learned"),
        ("route: {kind: trajectory, pieces: FILE}", "route.pieces"),
        ("space: {obstacles: {rock: {kind: hull, points: FILE}}}", "space.obstacles.rock.points"),
    ],
)
def test_a_missing_file_is_reported_with_the_line_of_the_scenario(tmp_path, field, path):
    (tmp_path / "mine.yaml").write_text(f"a:\n  {field.replace('FILE', 'gone.xyz')}\n")
    with pytest.raises(InputError) as error:
        load_scenario(tmp_path / "mine.yaml")
    assert (
        str(error.value)
        == f"{tmp_path / 'mine.yaml'}:2: {path} refers to {tmp_path / 'gone.xyz'}, which does not exist"
    )
    (tmp_path / "gone.xyz").mkdir()
    with pytest.raises(InputError, match=r"mine.yaml:2: .*gone.xyz, which is not a file$"):
        load_scenario(tmp_path / "mine.yaml")
