"""Tests of the Drake system that runs exported code."""

import json
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.framework import Context

from drake_quad import InputError, load_scenario, register_controller
from drake_quad.export.controller import export_controller
from drake_quad.exported import machines
from drake_quad.exported.description import DESCRIPTION_FILE, read_description
from drake_quad.exported.machines import (
    CROSS_COMPILER,
    EMULATOR,
    EmulatedBoard,
    HostMachine,
    compile_for_board,
    has_cross_compiler,
)
from drake_quad.exported.system import ExportedController, exported_controller
from drake_quad.scenario.layouts import rotors_of

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    result = tmp_path_factory.mktemp("exported")
    scenario = load_scenario("hover", ["control.position={kind: pid, k_p: [6, 6, 9], k_d: [4, 4, 6], k_i: [1, 1, 2]}"])
    export_controller(scenario, result)
    return result


def evaluated(system, measurement, reference):
    context = system.CreateDefaultContext()
    system.GetInputPort("measurement").FixValue(context, measurement)
    system.GetInputPort("reference").FixValue(context, reference)
    return system.GetOutputPort("wrench").Eval(context)


def test_vehicles_of_a_fleet_do_not_influence_each_other(folder):
    kind = exported_controller(folder)
    rng = np.random.default_rng(3)
    measurements, references = rng.normal(scale=0.1, size=(12, 2)), rng.normal(scale=0.1, size=(11, 2))
    fleet = evaluated(kind(num_vehicles=2), measurements.ravel(), references.ravel()).reshape(4, 2)
    for vehicle in range(2):
        alone = evaluated(kind(), measurements[:, vehicle], references[:, vehicle])
        np.testing.assert_array_equal(fleet[:, vehicle], alone)


def test_reading_the_output_does_not_change_the_state(folder):
    system = exported_controller(folder)()
    context: Context = system.CreateDefaultContext()
    system.GetInputPort("measurement").FixValue(context, np.full(12, 0.1))
    system.GetInputPort("reference").FixValue(context, np.zeros(11))
    before = context.get_discrete_state_vector().CopyToVector()
    system.GetOutputPort("wrench").Eval(context)
    np.testing.assert_array_equal(context.get_discrete_state_vector().CopyToVector(), before)


def test_the_kind_survives_pickling(folder):
    kind = register_controller(exported_controller(folder))
    assert re.fullmatch(r"exported\.controller_[0-9a-f]{8}", kind)
    scenario = load_scenario("hover", [f"control={{kind: {kind}}}"])
    restored = pickle.loads(pickle.dumps(scenario))
    assert restored.control.kind == kind
    assert restored.control.registration_option().startswith("--controller ")


def test_the_class_of_a_controller_has_the_docstring_of_its_base_class(folder):
    """`help` prints only the docstring of the class itself."""
    assert exported_controller(folder).__doc__ == ExportedController.__doc__


def test_code_whose_structs_differ_from_its_description_is_refused(folder, tmp_path):
    for file in folder.iterdir():
        shutil.copy(file, tmp_path)
    description = json.loads((tmp_path / DESCRIPTION_FILE).read_text())
    (tmp_path / DESCRIPTION_FILE).write_text(json.dumps(description | {"num_states": description["num_states"] + 1}))
    with pytest.raises(InputError, match="structs of controller.h differ from export.json"):
        HostMachine(tmp_path)


def test_code_that_does_not_compile_is_reported(folder, tmp_path):
    for file in folder.iterdir():
        shutil.copy(file, tmp_path)
    (tmp_path / "controller.c").write_text('#include "controller.h"\nint broken(')
    with pytest.raises(InputError, match="cannot compile .*controller.c"):
        exported_controller(tmp_path)


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"name": "x"}'])
def test_a_damaged_description_is_reported(text, tmp_path):
    (tmp_path / DESCRIPTION_FILE).write_text(text)
    with pytest.raises(InputError, match="export"):
        read_description(tmp_path)


def test_a_folder_without_exported_code_is_reported(tmp_path):
    with pytest.raises(InputError, match="contains no exported controller"):
        exported_controller(tmp_path)


def test_an_unknown_computer_is_reported(folder):
    with pytest.raises(InputError, match="machine 'abacus' does not exist; use host, qemu-cortex-m4f"):
        exported_controller(folder, "abacus")


def test_a_missing_compiler_is_reported(folder, monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(InputError, match="needs a C compiler"):
        HostMachine(folder)


@pytest.mark.skipif(shutil.which(CROSS_COMPILER) is None, reason="no cross-compiler")
def test_code_that_does_not_compile_for_a_core_is_reported_with_the_message_of_the_compiler(folder, tmp_path):
    for file in folder.iterdir():
        shutil.copy(file, tmp_path)
    (tmp_path / "controller.c").write_text('#include "controller.h"\nint broken(')
    with pytest.raises(InputError, match="cannot compile .*controller.c: .*error:"):
        compile_for_board(tmp_path, "cortex-m4f", tmp_path / "program")


def test_a_missing_cross_compiler_is_noticed(monkeypatch):
    assert has_cross_compiler() == (shutil.which(CROSS_COMPILER) is not None)
    monkeypatch.setenv("PATH", "")
    assert not has_cross_compiler()


@pytest.mark.slow
@pytest.mark.parametrize(("signal", "expected"), [("state", True), ("measurement", False)])
def test_a_controller_reads_the_true_state_if_its_code_has_this_input(tmp_path, signal, expected):
    scenario = load_scenario("hover", layers=["controllers/raptor:raptor"] if expected else [])
    export_controller(scenario, tmp_path)
    assert signal in read_description(tmp_path).inputs
    assert exported_controller(tmp_path)().reads_true_state == expected


FAKE_EMULATOR = """#!{python}
import sys
import time
with open("requests", "rb", buffering=0) as requests, open("responses", "wb", buffering=0) as responses:
    for count in (800, 80):
        request = requests.read({num_bytes})
        state, inputs = request[:{num_state_bytes}], request[{num_state_bytes}:]
        outputs = inputs[:{num_output_bytes}]
        # The response arrives in two parts.
        responses.write(outputs)
        time.sleep({delay})
        responses.write(state[::-1] + count.to_bytes(4, "little"))
sys.exit("the board has no more steps")
"""


@pytest.mark.slow
def test_a_board_exchanges_states_and_outputs_with_its_emulator(folder, tmp_path, monkeypatch):
    """Programs in Python stand in for the compiler and the emulator. A step of the board reverses the state."""
    description = read_description(folder)
    num_input_bytes, num_output_bytes = (8 * sum(ports.values()) for ports in (description.inputs, description.outputs))
    num_state_bytes = description.state_type.itemsize
    emulator = FAKE_EMULATOR.format(
        python=sys.executable,
        num_bytes=num_state_bytes + num_input_bytes,
        num_state_bytes=num_state_bytes,
        num_output_bytes=num_output_bytes,
        delay=0.6,  # s, longer than one wait for an answer
    )
    for name, program in ((CROSS_COMPILER, "#!/bin/sh\n"), (EMULATOR, emulator)):
        (tmp_path / name).write_text(program)
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    board = machines.EmulatedBoard(folder, "cortex-m4f")
    generator = np.random.default_rng(0)
    state, inputs = generator.bytes(num_state_bytes), generator.bytes(num_input_bytes)
    for _ in range(2):
        assert board.step(state, inputs) == (state[::-1], inputs[:num_output_bytes])
    # A count of the board's timer takes 40 ns, and an instruction takes 32 ns.
    assert board.max_instructions == 800 * 40 // 32
    with pytest.raises(RuntimeError, match=r"qemu-system-arm ended with status 1: the board has no more steps"):
        board.step(state, inputs)
    board.close()
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(board._requests)


def test_stopping_an_emulation_ends_its_process_and_frees_its_pipes_and_files():
    """A sleeping process stands in for the emulator."""
    process = subprocess.Popen(["sleep", "60"], stderr=subprocess.PIPE)
    pipes, directory = os.pipe(), tempfile.TemporaryDirectory()
    machines._stop(process, pipes, directory)
    assert process.returncode == -signal.SIGKILL
    assert process.stderr.closed
    for pipe in pipes:
        with pytest.raises(OSError, match="Bad file descriptor"):
            os.fstat(pipe)
    assert not Path(directory.name).exists()


@pytest.mark.slow
@pytest.mark.skipif(shutil.which(EMULATOR) is None or not has_cross_compiler(), reason="no emulator or cross-compiler")
def test_an_emulated_board_ends_with_the_process_that_started_it(folder):
    """The process is killed, so that it cannot stop the board."""
    description = read_description(folder)
    num_input_bytes = 8 * sum(description.inputs.values())
    program = (
        "import os, signal, sys\n"
        "from pathlib import Path\n"
        "from drake_quad.exported.machines import EmulatedBoard\n"
        "board = EmulatedBoard(Path(sys.argv[1]), 'cortex-m4f')\n"
        f"board.step(bytes({description.state_type.itemsize}), bytes({num_input_bytes}))\n"
        "print(board._process.pid, flush=True)\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ended = subprocess.run([sys.executable, "-c", program, folder], capture_output=True, text=True, check=False)
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    board, end = Path(f"/proc/{int(ended.stdout)}/exe"), time.monotonic() + 10.0
    while board.exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert not board.exists()


def test_programs_that_an_emulated_board_needs_are_reported_with_their_package(folder, monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(InputError, match="needs arm-none-eabi-gcc, .* install the package gcc-arm-none-eabi$"):
        EmulatedBoard(folder, "cortex-m4f")


def test_every_output_has_its_own_rows(tmp_path):
    export_controller(load_scenario("hover"), tmp_path, mixer=True)
    system = exported_controller(tmp_path)(num_vehicles=2)
    context = system.CreateDefaultContext()
    rng = np.random.default_rng(4)
    for index in range(system.num_input_ports()):
        port = system.get_input_port(index)
        port.FixValue(context, rng.normal(scale=0.05, size=port.size()))
    wrench, speeds = (system.GetOutputPort(name).Eval(context).reshape(4, 2) for name in system.description.outputs)
    rotors = rotors_of(load_scenario("hover").nominal)
    np.testing.assert_allclose(np.array(rotors.thrust_factors) @ speeds**2, wrench[0], rtol=1e-12)


def test_a_missing_c_file_is_reported(folder, tmp_path):
    copy = tmp_path / "code"
    shutil.copytree(folder, copy)
    name = read_description(copy).name
    (copy / f"{name}.c").unlink()
    with pytest.raises(InputError, match=rf"^cannot read .*{name}.c: no such file or directory$"):
        HostMachine(copy)
