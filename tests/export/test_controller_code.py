"""Tests that exported C code computes what the exported controller computes in simulation."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from exported_comparison import commands
from random_scenarios import scenario_of, structures

from drake_quad import InputError, draw_sample, load_scenario, simulate
from drake_quad.export.controller import export_controller
from drake_quad.exported.description import read_description
from drake_quad.exported.machines import CORES, CROSS_COMPILER, EMULATOR, HostMachine, code_size
from drake_quad.exported.system import exported_controller
from drake_quad.scenario.layouts import rotors_of

ROOT = Path(__file__).parents[2]
NUM_CASES = int(os.environ.get("FUZZ_CASES", 100)) // 100  # random scenarios
needs_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
needs_board = pytest.mark.skipif(
    shutil.which(CROSS_COMPILER) is None or shutil.which(EMULATOR) is None, reason="no cross-compiler or no QEMU"
)
WARNINGS = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Wshadow", "-Wconversion", "-Werror", "-ffp-contract=off")


def bits(values):
    return np.ascontiguousarray(values).view(np.uint64)


def asymmetric(name):
    return load_scenario(f"{ROOT}/tests/asymmetric.yaml:{name}")


@needs_compiler
@pytest.mark.long
@pytest.mark.parametrize("name", ["pid", "pd_t2fnn", "lqg", "lqg_on_board"])
def test_code_in_double_precision_equals_the_simulation_bit_for_bit(name, tmp_path):
    expected, actual = commands(asymmetric(name), tmp_path)
    assert (bits(actual) == bits(expected)).all()
    assert np.ptp(actual, axis=0).any()


@needs_compiler
@pytest.mark.slow
def test_code_of_random_controllers_equals_the_simulation_bit_for_bit(tmp_path):
    rng, hover = np.random.default_rng(71), load_scenario("hover").route
    for number, structure in enumerate(structures(rng, NUM_CASES)):
        scenario = draw_sample(scenario_of(structure, rng, tmp_path, duration=1.0), 0)
        # Some random vehicles cannot fly their random route, which does not matter for the code.
        scenario = scenario.model_copy(update={"route": hover})
        expected, actual = commands(scenario, tmp_path / str(number), num_steps=20)
        assert (bits(actual) == bits(expected)).all(), structure


@needs_compiler
@pytest.mark.long
def test_code_of_a_trained_policy_equals_the_simulation_bit_for_bit(tmp_path):
    scenario = load_scenario("hover", layers=["controllers/raptor:raptor"])
    expected, actual = commands(scenario, tmp_path, num_steps=10)
    assert (bits(actual) == bits(expected)).all()
    _, single = commands(scenario, tmp_path, precision="single", num_steps=10)
    assert single == pytest.approx(expected, rel=1e-3, abs=1e-4)


@needs_compiler
@pytest.mark.long
def test_code_in_single_precision_differs_from_the_simulation_only_by_rounding_errors(tmp_path):
    expected, actual = commands(asymmetric("lqg"), tmp_path, precision="single")
    largest = np.abs(expected).max(axis=0)
    assert (np.abs(actual - expected) < 1e-5 * largest).all()
    assert (actual != expected).any()


@needs_compiler
@pytest.mark.long
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("level", ["-O0", "-O3"])
def test_commands_do_not_depend_on_the_compiler_and_its_options(compiler, level, tmp_path):
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler}")
    export_controller(asymmetric("pd_t2fnn"), tmp_path)
    description = read_description(tmp_path)
    machines = [HostMachine(tmp_path), HostMachine(tmp_path, compiler=compiler, flags=(*WARNINGS, level))]
    rng = np.random.default_rng(5)
    states = [HostMachine.initial_state(tmp_path, description)] * 2
    for _ in range(30):
        inputs = rng.normal(scale=0.5, size=sum(description.inputs.values())).tobytes()
        steps = [machine.step(state, inputs) for machine, state in zip(machines, states)]
        assert steps[0] == steps[1]
        states = [state for state, _ in steps]


@needs_compiler
@pytest.mark.long
def test_a_flight_with_exported_code_equals_a_flight_with_the_controller(tmp_path):
    scenario = load_scenario("laboratory:nominal", ["duration=0.6", "metrics={start: 0, end: null}"])
    scenario = scenario.model_copy(update={"control": asymmetric("lqg").control})
    export_controller(scenario, tmp_path)
    expected = simulate(scenario)
    actual = simulate(scenario, control=exported_controller(tmp_path)())
    for name in ("state", "wrench", "rotor_speed"):
        assert (bits(actual[name]) == bits(expected[name])).all(), name


@needs_compiler
@needs_board
@pytest.mark.long
@pytest.mark.parametrize("core", CORES)
def test_an_emulated_microcontroller_equals_the_simulation_bit_for_bit(core, tmp_path):
    expected, actual = commands(asymmetric("lqg"), tmp_path, machine=f"qemu-{core}", num_steps=8)
    assert (bits(actual) == bits(expected)).all()


@needs_board
@pytest.mark.slow
def test_lqg_in_single_precision_takes_less_than_40_kilobytes(tmp_path):
    export_controller(asymmetric("lqg"), tmp_path, precision="single")
    assert 2_000 < code_size(tmp_path, "cortex-m4f") < 40_000


@needs_compiler
@needs_board
@pytest.mark.long
def test_a_network_of_two_layers_of_64_neurons_takes_less_than_100_kilobytes(tmp_path):
    rng, shapes = np.random.default_rng(8), [(64, 18), (64, 64), (4, 64)]
    arrays = {f"weights_{k}": rng.normal(scale=0.1, size=shape) for k, shape in enumerate(shapes)}
    arrays |= {f"biases_{k}": rng.normal(scale=0.1, size=rows) for k, (rows, _) in enumerate(shapes)}
    np.savez(tmp_path / "network.npz", **arrays, activation_0="tanh", activation_1="relu", activation_2="tanh")
    signals = ["position_error", "velocity_error", "rotation", "body_rates"]
    control = {"kind": "policy", "policy": str(tmp_path / "network.npz"), "action": {"kind": "rotor_speeds"}}
    scenario = load_scenario("hover", {"control": control | {"observation": {"signals": signals}}})
    expected, actual = commands(scenario, tmp_path, num_steps=5)
    assert (bits(actual) == bits(expected)).all()
    assert np.ptp(actual, axis=0).all()
    export_controller(scenario, tmp_path, precision="single")
    num_weights = sum(rows * columns + rows for rows, columns in shapes)
    assert 4 * num_weights < code_size(tmp_path, "cortex-m4f") < 100_000


@needs_compiler
def test_the_rotor_speeds_of_the_mixer_produce_the_wrench(tmp_path):
    scenario = load_scenario("hover")
    export_controller(scenario, tmp_path, mixer=True, name="autopilot")
    description = read_description(tmp_path)
    assert [*description.outputs] == ["wrench", "rotor_speed_command"]
    inputs = np.random.default_rng(6).normal(scale=0.05, size=sum(description.inputs.values()))
    _, outputs = HostMachine(tmp_path).step(HostMachine.initial_state(tmp_path, description), inputs.tobytes())
    wrench, speeds = np.split(np.frombuffer(outputs), [4])
    rotors = rotors_of(scenario.nominal)
    thrusts = np.multiply(rotors.thrust_factors, speeds**2)
    assert thrusts.sum() == pytest.approx(wrench[0], rel=1e-12)
    assert np.dot(thrusts, [rotor.y for rotor in rotors]) == pytest.approx(wrench[1], rel=1e-9)


def test_parameters_can_be_changed_between_steps(tmp_path):
    export_controller(load_scenario("hover"), tmp_path)
    header = (tmp_path / "controller.h").read_text()
    assert "controller_pd_gains_t position_pd_gains;" in header
    assert "extern const controller_parameters_t controller_default_parameters;" in header


def test_exported_code_names_the_system_that_each_call_computes(tmp_path):
    source = export_controller(load_scenario("hover"), tmp_path).files[1].read_text()
    for comment in (
        "position.pd: The PD law, eq (8) of the paper.",
        "thrust_vectoring: Thrust and attitude for a commanded acceleration, eq (7) of the paper.",
    ):
        assert f"    /* {comment} */\n" in source


def test_members_of_exported_structs_are_commented_with_their_meaning_and_unit(tmp_path):
    export_controller(load_scenario("hover"), tmp_path)
    header = (tmp_path / "controller.h").read_text()
    lines = {" ".join(line.split()) for line in header.splitlines()}
    assert "double mass; /* mass of the nominal vehicle, kg */" in lines
    assert "controller_per_axis_t k_p; /* gains on the position error, 1/s² */" in lines
    assert "double tan_max_tilt; /* tangent of the largest angle between thrust and vertical */" in lines


@pytest.mark.long
def test_exported_code_allocates_no_memory_and_has_no_global_variables(tmp_path):
    export_controller(asymmetric("pd_t2fnn"), tmp_path)
    source = (tmp_path / "controller.c").read_text()
    assert "alloc" not in source
    outside = [line for line in source.splitlines() if line and not line.startswith((" ", "}", "{", "/*", "#"))]
    variables = [line for line in outside if line.startswith("static ") and "(" not in line]
    assert variables
    assert all("const" in line for line in variables)


def test_the_opening_comment_names_scenario_version_and_licence(tmp_path):
    pid = "control.position={kind: pid, k_p: [6, 6, 9], k_d: [4, 4, 6], k_i: [1, 1, 2]}"
    export = export_controller(load_scenario("hover", [pid]), tmp_path)
    assert export.description.num_states > 0
    for file in export.files[:2]:
        opening = file.read_text().partition("*/")[0]
        assert "Controller of the scenario hover, exported by drake_quad" in opening
        assert export.description.scenario_sha256 in opening
        assert "BSD 3-Clause" in opening
        assert re.search(rf"state\s+\*? ?takes\s.*{8 * export.description.num_states + 4} bytes", opening, re.DOTALL)


def test_a_controller_without_formulas_is_refused_with_the_reason(tmp_path):
    scenario = load_scenario("laboratory:nominal", layers=["controllers/mpc:mpc"])
    with pytest.raises(InputError, match=r"^programme \(.*\) cannot be exported: it declares ports"):
        export_controller(scenario, tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_scenario_with_a_random_gain_is_refused(tmp_path):
    scenario = load_scenario("hover", ["control.position.k_p=[6, 6, {uniform: {min: 5, max: 7}}]"])
    with pytest.raises(
        InputError, match=r"control\.position\.k_p.* is a distribution, but exported code needs a fixed value"
    ):
        export_controller(scenario, tmp_path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"precision": "half"}, "precision is 'half'; it must be one of double, single"),
        ({"name": "my controller"}, "name is 'my controller'; it must be a C identifier"),
        ({"name": "double"}, "name is 'double'; it must be a C identifier"),
    ],
)
def test_invalid_options_are_refused(options, message, tmp_path):
    with pytest.raises(InputError, match=message):
        export_controller(load_scenario("hover"), tmp_path, **options)


@pytest.mark.parametrize("file", ["controller.h", "controller.c"])
def test_exported_code_replaces_only_exported_code(file, tmp_path):
    scenario = load_scenario("hover")
    exported = tmp_path / file
    exported.write_text("/* exported code goes here */\nint mine;\n")
    with pytest.raises(InputError, match=rf"{re.escape(str(exported))} was not exported by drake_quad"):
        export_controller(scenario, tmp_path)
    assert [*tmp_path.iterdir()] == [exported]
    exported.unlink()
    for seed in (6, 7):
        changed = scenario.model_copy(update={"seed": seed})
        assert export_controller(changed, tmp_path).description.scenario_sha256 in exported.read_text()


def test_a_controller_that_commands_an_attitude_has_no_mixer(tmp_path):
    with pytest.raises(InputError, match="commands an attitude"):
        export_controller(load_scenario("onboard"), tmp_path, mixer=True)


@pytest.mark.long
@needs_compiler
def test_the_reference_in_c_is_the_reference_of_the_plan(tmp_path):
    scenario = load_scenario("figure_eight", ["control.position.feed_forward=snap"])
    export_controller(scenario, tmp_path, reference=True)
    description = read_description(tmp_path)
    program = f"""
    #include <stdio.h>
    #include "controller.h"
    int main(void) {{
        double time;
        controller_inputs_t inputs = {{0}};
        while (scanf("%lf", &time) == 1) {{
            controller_reference(time, &inputs);
            const double *row = (const double *)&inputs;
            for (int i = 0; i < {sum(description.inputs.values())}; ++i) printf("%.17g ", row[i]);
        }}
        return 0;
    }}"""
    (tmp_path / "main.c").write_text(program)
    files = [str(tmp_path / name) for name in ("main.c", "controller.c")]
    subprocess.run(["cc", *WARNINGS, "-O1", "-o", str(tmp_path / "main"), *files, "-lm"], check=True)
    from drake_quad import plan_route

    plan = plan_route(scenario)
    times = np.linspace(0.0, plan.duration + 3.0, 200)
    text = "\n".join(map(str, times))
    output = subprocess.run([str(tmp_path / "main")], input=text, capture_output=True, text=True, check=True).stdout
    rows = np.array(output.split(), float).reshape(len(times), -1)[:, 12:]
    expected = np.array([plan.reference().value(time).ravel() for time in times])
    assert rows == pytest.approx(expected, abs=1e-9)
