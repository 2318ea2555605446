"""Tests of the projects around exported code, compiled against declarations of the published interfaces."""

import ctypes
import dataclasses
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from pydrake.math import RollPitchYaw
from pydrake.systems.framework import LeafSystem

from drake_quad import InputError, export_controller, exported_controller, load_scenario, simulate
from drake_quad.export.projects import project_files
from drake_quad.exported.machines import CROSS_COMPILER

STUBS = Path(__file__).parent / "crazyflie_stubs"
STRICT = ("-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror", "-Wdouble-promotion")


class Attitude(ctypes.Structure):
    _fields_ = [("timestamp", ctypes.c_uint32), *((name, ctypes.c_float) for name in ("roll", "pitch", "yaw"))]


class Point(ctypes.Structure):
    _fields_ = [("timestamp", ctypes.c_uint32), *((name, ctypes.c_float) for name in "xyz")]


class Quaternion(ctypes.Structure):
    _fields_ = [(name, ctypes.c_float) for name in "xyzw"]


class Sensors(ctypes.Structure):
    _fields_ = [("acc", ctypes.c_float * 3), ("gyro", ctypes.c_float * 3)]


class State(ctypes.Structure):
    _fields_ = [
        ("attitude", Attitude),
        ("quaternion", Quaternion),
        ("position", Point),
        ("velocity", Point),
        ("acc", Point),
    ]


class Setpoint(ctypes.Structure):
    _fields_ = [
        ("attitude", Attitude),
        ("rate", Attitude),
        ("quaternion", Quaternion),
        ("position", Point),
        ("velocity", Point),
        ("acceleration", Point),
        ("jerk", Point),
        ("mode", ctypes.c_int * 7),
    ]


class Control(ctypes.Structure):
    _fields_ = [("wrench", ctypes.c_float * 4), ("mode", ctypes.c_int)]


class Firmware(LeafSystem):
    """The project in the loop: signals are converted to the units of the firmware, which calls the project."""

    def __init__(self, library, period):
        super().__init__()
        self._library, self._calls, self._period = library, 0, period
        self._control = Control()
        for name, rows in (("measurement", 12), ("reference", 11), ("reference_jerk", 3)):
            self.DeclareVectorInputPort(name, rows)
        self.DeclareDiscreteState(4)
        self.DeclareVectorOutputPort("wrench", 4, self._calc)
        library.controllerOutOfTreeInit()

    def _calc(self, context, output):
        step = round(context.get_time() / self._period)
        if step == self._calls:  # Drake evaluates the output once for each step
            self._calls += 1
            self._call(context, step)
        output.SetFromVector(self._control.wrench[:])

    def _call(self, context, step):
        measured, reference, jerk = (self.get_input_port(i).Eval(context) for i in range(3))
        w, x, y, z = RollPitchYaw(measured[3:6]).ToQuaternion().wxyz()
        degrees = np.degrees(measured[3:6]) * [1.0, -1.0, 1.0]
        state = State(
            Attitude(0, *degrees), Quaternion(x, y, z, w), Point(0, *measured[:3]), Point(0, *measured[6:9]), Point()
        )
        sensors = Sensors((0.0, 0.0, 1.0), tuple(np.degrees(measured[9:])))
        setpoint = Setpoint(
            Attitude(0, 0.0, 0.0, np.degrees(reference[9])),
            Attitude(0, 0.0, 0.0, np.degrees(reference[10])),
            Quaternion(),
            *(Point(0, *reference[first : first + 3]) for first in (0, 3, 6)),
            Point(0, *jerk),
            (1, 1, 1, 1, 1, 1, 0),
        )
        milliseconds = round(1000.0 * self._period * step)
        arguments = (ctypes.byref(each) for each in (self._control, setpoint, sensors, state))
        self._library.controllerOutOfTree(*arguments, ctypes.c_uint32(milliseconds))


def sources(folder):
    return [str(folder / "crazyflie" / "src" / name) for name in ("app.c", "mine.c")]


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.slow
def test_the_crazyflie_project_flies_as_the_exported_code(tmp_path):
    """The code has no snap in the firmware, so the controller that is compared uses none."""
    options = ["duration=1", "metrics={start: 0, end: null}", "control.position.feed_forward=jerk"]
    scenario = load_scenario("figure_eight", options)
    export_controller(scenario, tmp_path, precision="single", name="mine", project="crazyflie")
    library = tmp_path / "project.so"
    stub = tmp_path / "stub.c"
    stub.write_text('#include <stdint.h>\n#include "task.h"\nvoid vTaskDelay(uint32_t ticks) { (void)ticks; }\n')
    command = ["cc", *STRICT, "-shared", "-fPIC", "-I", str(STUBS), "-I", str(tmp_path), "-o", str(library)]
    subprocess.run([*command, *sources(tmp_path), str(stub), "-lm"], check=True)
    expected = simulate(scenario, control=exported_controller(tmp_path)())
    found = simulate(scenario, control=Firmware(ctypes.CDLL(str(library)), 0.02))
    np.testing.assert_allclose(found["wrench"], expected["wrench"], rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(found["state"], expected["state"], rtol=1e-4, atol=1e-5)
    assert np.abs(expected["wrench"][:, 1:]).max(axis=0).min() > 1e-6


@pytest.mark.skipif(shutil.which(CROSS_COMPILER) is None, reason="no cross-compiler")
@pytest.mark.slow
def test_the_crazyflie_project_compiles_for_its_microcontroller(tmp_path):
    export_controller(
        load_scenario("bad_day:crazyflie"), tmp_path, precision="single", name="mine", project="crazyflie"
    )
    core = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
    for source in sources(tmp_path):
        command = [CROSS_COMPILER, *STRICT, *core, "-I", str(STUBS), "-c", "-o", str(tmp_path / "object.o"), source]
        subprocess.run(command, check=True)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "controller"}, "needs another name than controller, which is a header of the firmware"),
        ({"precision": "double"}, "needs single precision"),
        ({"outputs": {"attitude_target": 7}}, "needs a controller that commands a wrench, not attitude_target"),
        ({"period": 0.0125}, "needs a period of whole milliseconds, not 0.0125 s"),
        ({"inputs": {"measurement": 12, "gyroscope": 3}}, "cannot provide the input gyroscope"),
    ],
)
def test_code_that_does_not_fit_the_crazyflie_is_refused(changes, message, tmp_path):
    export = export_controller(load_scenario("hover"), tmp_path, precision="single", name="mine")
    with pytest.raises(InputError, match=message):
        project_files("crazyflie", dataclasses.replace(export.description, **changes))
    with pytest.raises(InputError, match="project is 'kite'; it must be one of crazyflie"):
        project_files("kite", export.description)
