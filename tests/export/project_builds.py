"""Builds of exported projects against declarations of the published interfaces, and flights with these builds."""

import ctypes
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.systems.framework import LeafSystem

from drake_quad import exported_controller, simulate
from drake_quad.exported.description import read_description
from drake_quad.exported.machines import HostMachine

STUBS = Path(__file__).parent / "stubs"
WARNINGS = ("-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-fPIC")
# This warning reports computations in double precision, which are slow on many microcontrollers.
SINGLE_ONLY = ("-Wdouble-promotion",)
# Inline variables of the declarations must not be shared by the libraries of several tests.
CPP = ("c++", "-std=c++17", "-fno-gnu-unique")
LANGUAGES = {".c": ("cc", "-std=c99"), ".cpp": CPP, ".ino": (*CPP, "-x", "c++")}
needs_compilers = pytest.mark.skipif(not (shutil.which("cc") and shutil.which("c++")), reason="no C and C++ compilers")


def forwarding_headers(sources, stub, folder):
    """Replace each platform header that the sources include by a header that includes the file of declarations."""
    for source in sources:
        for name in re.findall(r'^#include [<"]([^>"]+)[>"]', source.read_text(), re.MULTILINE):
            local = (source.parent / name).exists()
            standard = re.fullmatch(r"(math|stdbool|stdint|string)\.h|chrono|cmath|memory", name)
            if not local and not standard:
                header = folder / name
                header.parent.mkdir(parents=True, exist_ok=True)
                header.write_text(f'#include "{STUBS / stub}"\n')


def objects_of(project, stub, driver, *, languages=None, options=(), macros=(), file_macros=None, unlinked=()):
    """Compile a project and a driver, and return the object files.

    Args:
        project: folder of the project.
        stub: file with declarations of the platform's interface.
        driver: source file that calls the project as the platform does.
        languages: compiler and options for each suffix of a source file, instead of those of this computer.
        options: options for all files.
        macros: options that define macros for the driver.
        file_macros: options that define macros for a file of the project, by the name of the file.
        unlinked: names of files whose object files are not returned.
    """
    languages = languages or LANGUAGES
    sources = [path for path in sorted(project.rglob("*")) if path.suffix in LANGUAGES]
    headers, objects = project / "platform", []
    forwarding_headers(sources, stub, headers)
    for source in [*sources, STUBS / driver]:
        output = project / f"{source.stem}.o"
        file_options = macros if source.name == driver else (file_macros or {}).get(source.name, ())
        folders = ["-I", str(headers), "-I", str(sources[0].parent), "-I", str(STUBS)]
        command = [
            *languages[source.suffix],
            *WARNINGS,
            *options,
            *file_options,
            *folders,
            "-c",
            "-o",
            str(output),
            str(source),
        ]
        subprocess.run(command, check=True)
        if source.name not in unlinked:
            objects.append(str(output))
    return objects


def library_of(project, stub, driver, **options):
    """Return the shared library of a project and a driver; the options are those of `objects_of`."""
    library = project / "project.so"
    objects = objects_of(project, stub, driver, **options)
    subprocess.run(["c++", "-shared", "-o", str(library), *objects, "-lm"], check=True)
    return ctypes.CDLL(str(library))


def call(library, seconds, inputs):
    """Return the command of a controller in a project at a time (s), given the inputs of the driver's `step`."""
    inputs, command = np.array(inputs, dtype=float), np.zeros(8)
    pointers = (each.ctypes.data_as(ctypes.c_void_p) for each in (inputs, command))
    library.step(ctypes.c_uint64(round(1e6 * seconds)), *pointers)
    return command


class Platform(LeafSystem):
    """System that runs a project's controller. A driver calls the project in place of the project's platform.

    Args:
        library: library of the project and the driver, with the driver's function `step`.
        period: period of the controller, s.
        encode: function that returns the inputs of `step`, given the measured state, the reference and its jerk.
        decode: function that returns the command of the controller, given that of `step`.
        output: name and number of components of the command.
    """

    def __init__(self, library, period, encode, decode, output=("wrench", 4)):
        super().__init__()
        self._library, self._period, self._steps = library, period, 0
        self._encode, self._decode = encode, decode
        for name, rows in (("measurement", 12), ("reference", 11), ("reference_jerk", 3)):
            self.DeclareVectorInputPort(name, rows)
        self.DeclareDiscreteState(1)
        self.DeclareVectorOutputPort(*output, self._calc)

    def _calc(self, context, output):
        step = round(context.get_time() / self._period)
        if step == self._steps:  # Drake evaluates the output once for each step
            self._steps += 1
            signals = [self.get_input_port(i).Eval(context) for i in range(3)]
            # The clock of a real platform is not zero at the first step of the controller.
            self._command = call(self._library, 1.0 + self._period * step, self._encode(*signals))
        output.SetFromVector(self._decode(self._command))


def assert_flight_as_exported(scenario, folder, system, *, unavailable=()):
    """Assert that a flight with a project equals a flight with the exported code alone.

    Args:
        scenario: scenario from which the code was exported.
        folder: folder with the exported code.
        system: `Platform` with the project.
        unavailable: components of the command that the platform cannot send, which are zero.
    """

    class Controller(exported_controller(folder)):
        def _stepped(self, context, *, as_output_step):
            state, outputs = super()._stepped(context, as_output_step=as_output_step)
            outputs[list(unavailable)] = 0.0
            return state, outputs

    expected, actual = simulate(scenario, control=Controller()), simulate(scenario, control=system)
    command = next(name for name in ("wrench", "attitude_target") if name in expected)
    np.testing.assert_allclose(actual[command], expected[command], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(actual["state"], expected["state"], rtol=1e-4, atol=1e-5)
    assert np.ptp(expected[command], axis=0)[:3].min() > 1e-6


def random_signals(seed, description):
    """Yield random signals with large angles: measured state, reference, its jerk, and all of them as one array."""
    rng = np.random.default_rng(seed)
    for _ in range(8):
        signals = {"measurement": rng.normal(size=12), "reference": rng.normal(size=11)}
        signals |= {"reference_jerk": rng.normal(size=3), "reference_snap": np.zeros(4)}
        signals["measurement"][3:6] = rng.uniform(-1.0, 1.0, 3) * [3.0, 1.4, 3.0]
        inputs = np.concatenate([signals[name] for name in description.inputs])
        yield *[*signals.values()][:3], inputs.astype(description.number_type)


def assert_commands_as_exported(folder, library, encode, decode, *, unavailable=()):
    """Assert that a project and the exported code compute the same commands from large random inputs.

    Args:
        folder: folder with the exported code.
        library: library of the project.
        encode: see `Platform`.
        decode: see `Platform`.
        unavailable: components of the command that the platform cannot send, which are zero.
    """
    description, machine = read_description(folder), HostMachine(folder)
    state = HostMachine.initial_state(folder, description)
    for number, (*signals, inputs) in enumerate(random_signals(1, description)):
        state, outputs = machine.step(state, inputs.tobytes())
        expected = np.frombuffer(outputs, description.number_type).astype(float)
        expected[list(unavailable)] = 0.0
        command = call(library, 1.0 + description.period * number, encode(*signals))
        np.testing.assert_allclose(decode(command), expected, rtol=1e-4, atol=1e-4)


def quaternion(angles):
    """Return the quaternion w, x, y, z of roll, pitch and yaw."""
    return RollPitchYaw(angles).ToQuaternion().wxyz()
