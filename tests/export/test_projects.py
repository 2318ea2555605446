"""Tests of the projects around exported code, compiled against declarations of the published interfaces."""

import ctypes
import dataclasses
import importlib.util
import re
import shutil
import subprocess

import numpy as np
import pytest
from project_builds import (
    SINGLE_ONLY,
    Platform,
    assert_commands_as_exported,
    assert_flight_as_exported,
    call,
    library_of,
    needs_compilers,
    objects_of,
    quaternion,
)
from pydrake.common.eigen_geometry import Quaternion
from pydrake.math import RollPitchYaw, RotationMatrix
from pydrake.systems.framework import LeafSystem

from drake_quad import InputError, export_controller, exported_controller, load_scenario, simulate
from drake_quad.export.projects.project import ExportedCode
from drake_quad.export.projects.registered import PROJECTS, project_files
from drake_quad.exported.description import read_description
from drake_quad.exported.machines import CROSS_COMPILER, HostMachine
from drake_quad.planning.nominal import nominal_parameters
from drake_quad.vehicle.px4_units import torque_units

ONE_SECOND = ["duration=1", "metrics={start: 0, end: null}"]  # overrides for a flight of one second
# Scenarios for `exported`: name, overrides and controller. The controllers command a wrench, or an attitude target. The
# feed-forward does not use the snap of the reference, because no platform provides it.
WRENCH = ["figure_eight", [*ONE_SECOND, "control.position.feed_forward=jerk"]]
WRENCH_WITHOUT_JERK = ["figure_eight", [*ONE_SECOND, "control.position.feed_forward=acceleration"]]
WRENCH_OF_LQG = ["laboratory:nominal", ONE_SECOND, "controllers/lqg:lqg"]  # this controller has a state
ATTITUDE = ["onboard", ONE_SECOND]
ATTITUDE_WITHOUT_JERK = ["onboard", [*ONE_SECOND, "control.position.feed_forward=acceleration"]]
DISABLED, ABSOLUTE, VELOCITY = 0, 1, 2  # modes of the Crazyflie's setpoint
HALF_TURN = np.array([1.0, -1.0, -1.0])  # signs that convert north-west-up to north-east-down, and back
HOVER_THRUST = 0.375  # thrust command of PX4 in hover, relative to the largest command


def exported(folder, project, scenario, precision="single", **options):
    """Export a scenario with a project, and return the scenario and the folder of the project."""
    spec, overrides, *layers = scenario
    scenario = load_scenario(spec, overrides, layers=layers)
    export_controller(scenario, folder, precision=precision, name="mine", project=project, **options)
    return scenario, folder / project


def angles_of(wxyz):
    """Return roll, pitch and yaw of a quaternion in single precision."""
    return RollPitchYaw(Quaternion(np.asarray(wxyz) / np.linalg.norm(wxyz))).vector()


def crazyflie_inputs(measured, reference, jerk):
    w, *vector = quaternion(measured[3:6])
    rates = np.degrees(measured[9:])
    yaw = np.degrees(reference[9:11])
    return [*measured[:3], *measured[6:9], *vector, w, *rates, *reference[:9], *jerk, *yaw]


@needs_compilers
@pytest.mark.slow
def test_a_flight_with_the_crazyflie_project_equals_a_flight_with_the_exported_code(tmp_path):
    scenario, project = exported(tmp_path, "crazyflie", WRENCH)
    library = library_of(project, "crazyflie.h", "crazyflie_driver.c", options=SINGLE_ONLY)
    library.start()
    assert_commands_as_exported(tmp_path, library, crazyflie_inputs, lambda command: command[:4])
    library.set_modes(ABSOLUTE, DISABLED, ABSOLUTE)  # yaw as a quaternion
    assert_commands_as_exported(tmp_path, library, crazyflie_inputs, lambda command: command[:4])
    library.set_modes(ABSOLUTE, ABSOLUTE, DISABLED)
    system = Platform(library, 0.02, crazyflie_inputs, lambda command: command[:4])
    assert_flight_as_exported(scenario, tmp_path, system)


@needs_compilers
@pytest.mark.slow
def test_the_crazyflie_project_without_setpoints_holds_the_yaw_and_stops_the_motors(tmp_path):
    _, project = exported(tmp_path, "crazyflie", WRENCH)
    library = library_of(project, "crazyflie.h", "crazyflie_driver.c", options=SINGLE_ONLY)
    library.start()
    measured, reference = np.linspace(-1.0, 1.0, 12), np.linspace(-2.0, 1.0, 11)
    holding = crazyflie_inputs(measured, [*reference[:9], measured[5], reference[10]], np.ones(3))
    expected = call(library, 1.0, holding)
    library.set_modes(ABSOLUTE, DISABLED, DISABLED)
    np.testing.assert_allclose(
        call(library, 1.02, crazyflie_inputs(measured, reference, np.ones(3))), expected, rtol=1e-4
    )
    library.set_modes(DISABLED, ABSOLUTE, DISABLED)
    np.testing.assert_array_equal(call(library, 1.04, holding), 0.0)
    library.set_modes(ABSOLUTE, ABSOLUTE, DISABLED)
    other = crazyflie_inputs(measured, reference, np.zeros(3))
    command = call(library, 1.05, other)
    np.testing.assert_array_equal(call(library, 1.07, other), command)
    assert not np.allclose(command, expected), "the first step after the motors are enabled"


@needs_compilers
@pytest.mark.slow
def test_the_crazyflie_project_follows_velocity_setpoints_from_its_current_position(tmp_path):
    _, project = exported(tmp_path, "crazyflie", WRENCH)
    library = library_of(project, "crazyflie.h", "crazyflie_driver.c", options=SINGLE_ONLY)
    library.start()
    measured = np.array([3.0, -2.0, 1.0, 0.1, 0.2, 0.7, 0.3, 0.1, 0.0, 0.0, 0.0, 0.0])
    velocity, yaw = np.array([0.4, -0.2, 0.0]), [0.7, 0.0]

    def inputs(position, velocity):
        return crazyflie_inputs(measured, np.concatenate([position, velocity, np.zeros(3), yaw]), np.zeros(3))

    in_world = RotationMatrix(RollPitchYaw([0.0, 0.0, 0.7])).matrix() @ velocity
    expected = {
        name: call(library, 1.0, inputs(measured[:3], each))
        for name, each in {"world": velocity, "body": in_world, "none": 0.0 * velocity}.items()
    }
    other_position = np.array([0.0, 0.0, measured[2]])
    library.set_velocity_mode(VELOCITY, False)
    np.testing.assert_allclose(call(library, 1.02, inputs(other_position, velocity)), expected["world"], rtol=1e-5)
    library.set_velocity_mode(VELOCITY, True)
    np.testing.assert_allclose(
        call(library, 1.04, inputs(other_position, velocity)), expected["body"], rtol=1e-5, atol=1e-7
    )
    library.set_velocity_mode(DISABLED, False)
    np.testing.assert_allclose(call(library, 1.06, inputs(other_position, velocity)), expected["none"], rtol=1e-5)


@pytest.mark.skipif(shutil.which(CROSS_COMPILER) is None, reason="no cross-compiler")
@pytest.mark.slow
def test_the_crazyflie_project_compiles_for_its_microcontroller(tmp_path):
    _, project = exported(tmp_path, "crazyflie", ["bad_day:crazyflie", []])
    core = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
    objects_of(project, "crazyflie.h", "crazyflie_driver.c", languages={".c": (CROSS_COMPILER, "-std=c99", *core)})


def px4_library(project):
    return library_of(project, "px4.hpp", "px4_driver.cpp", options=SINGLE_ONLY, macros=["-DNAME_main=mine_main"])


def px4_inputs(measured, reference, jerk):
    """Return the inputs in PX4's frames, which differ by half a turn about x. Quaternions keep their w and x."""
    q = quaternion(measured[3:6]) * np.array([1.0, *HALF_TURN])
    vectors = [measured[:3], measured[6:9], measured[9:], reference[:3], reference[3:6], reference[6:9], jerk]
    position, velocity, rates, *setpoint = (vector * HALF_TURN for vector in vectors)
    return np.concatenate([position, velocity, q, rates, *setpoint, -reference[9:11]])


def px4_start(library, period):
    library.start.argtypes = [ctypes.c_float]
    assert library.start(HOVER_THRUST) == round(1e6 * period)
    library.engage(True)


@pytest.fixture(scope="module")
def px4_wrench_project(tmp_path_factory):
    """Return the library of a PX4 project that commands a wrench."""
    _, project = exported(tmp_path_factory.mktemp("px4"), "px4", WRENCH)
    library = px4_library(project)
    px4_start(library, 0.02)
    return library


@needs_compilers
@pytest.mark.long
def test_the_px4_project_commands_the_wrench_of_the_exported_code(tmp_path):
    scenario, project = exported(tmp_path, "px4", WRENCH)
    nominal = nominal_parameters(scenario)
    units = np.array([nominal.mass * nominal.gravity / HOVER_THRUST, *torque_units(nominal, HOVER_THRUST)])
    library = px4_library(project)
    px4_start(library, 0.02)
    assert any("class MineModule :" in file.read_text() for file in project.rglob("*_module.cpp"))

    def decode(command):
        return command[:4] * units * [-1.0, *HALF_TURN]

    assert_commands_as_exported(tmp_path, library, px4_inputs, decode)
    assert library.offboard_request() == 2, "thrust and torques"
    assert library.has_current_times()
    system = Platform(library, 0.02, px4_inputs, decode)
    assert_flight_as_exported(scenario, tmp_path, system)


@needs_compilers
@pytest.mark.long
def test_the_px4_project_commands_the_attitude_of_the_exported_code(tmp_path):
    """The attitude setpoint of PX4 contains a yaw rate, but no feed-forward of the other body rates."""
    scenario, project = exported(tmp_path, "px4", ATTITUDE)
    nominal = nominal_parameters(scenario)

    def decode(command):
        angles = angles_of(command[:4] * [1.0, *HALF_TURN])
        thrust = -command[4] / HOVER_THRUST * nominal.mass * nominal.gravity
        return [thrust, *angles, 0.0, 0.0, -command[5]]

    library = px4_library(project)
    px4_start(library, 0.02)
    assert_commands_as_exported(tmp_path, library, px4_inputs, decode, unavailable=[4, 5])
    assert library.offboard_request() == 1, "an attitude"
    assert library.has_current_times()
    system = Platform(library, 0.02, px4_inputs, decode, ("attitude_target", 7))
    assert_flight_as_exported(scenario, tmp_path, system, unavailable=[4, 5])


@needs_compilers
@pytest.mark.long
def test_the_px4_project_commands_only_in_offboard_mode_and_resets_its_controller_at_each_engagement(tmp_path):
    _, project = exported(tmp_path, "px4", WRENCH_OF_LQG)
    library = px4_library(project)
    px4_start(library, 0.01)
    rng = np.random.default_rng(3)
    inputs = [px4_inputs(rng.normal(size=12), rng.normal(size=11), rng.normal(size=3)) for _ in range(3)]
    commands = [[*call(library, 1.0 + 0.01 * number, inputs[number])] for number in range(3)]
    library.engage(False)
    call(library, 1.03, inputs[2])
    assert library.num_commands() == 3
    library.engage(True)
    assert [[*call(library, 1.04 + 0.01 * number, inputs[number])] for number in range(3)] == commands


@needs_compilers
@pytest.mark.long
def test_the_px4_project_requests_no_offboard_mode_without_valid_estimates(tmp_path):
    _, project = exported(tmp_path, "px4", WRENCH)
    library = px4_library(project)
    px4_start(library, 0.02)
    inputs = px4_inputs(np.zeros(12), np.zeros(11), np.zeros(3))
    old = [[0.0] * 3, *(300_000 * np.eye(3))]
    validity = [[True] * 4, *(np.eye(4) == 0.0)]
    cases = [(ages, validity[0]) for ages in old] + [(old[0], valid) for valid in validity[1:]]
    for number, (ages, valid) in enumerate(cases):
        ages, valid = np.array(ages, np.uint64), np.array(valid, np.bool_)
        library.degrade(ages.ctypes.data_as(ctypes.c_void_p), valid.ctypes.data_as(ctypes.c_void_p))
        call(library, 1.0 + 0.02 * number, inputs)
        assert library.offboard_request() == (2 if number == 0 else 0)
        assert library.num_commands() == 1


@needs_compilers
@pytest.mark.slow
def test_the_px4_project_holds_its_position_if_the_setpoint_is_nan(tmp_path):
    _, project = exported(tmp_path, "px4", WRENCH)
    library = px4_library(project)
    px4_start(library, 0.02)
    measured = np.array([1.0, 2.0, 3.0, 0.1, -0.2, 0.3, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0])
    without = px4_inputs(measured, np.full(11, np.nan), np.full(3, np.nan))
    holding = px4_inputs(measured, np.array([1.0, 2.0, 3.0, *[0.0] * 6, 0.3, 0.0]), np.zeros(3))
    np.testing.assert_allclose(call(library, 1.0, without), call(library, 1.02, holding), rtol=1e-5, atol=1e-7)


@needs_compilers
@pytest.mark.slow
def test_the_px4_project_ignores_setpoints_that_are_old_or_from_before_offboard_mode(tmp_path):
    _, project = exported(tmp_path, "px4", WRENCH)
    library = px4_library(project)
    px4_start(library, 0.02)
    rest = np.zeros(11)
    measured = [np.array([x, 2.0, 3.0, *[0.0] * 9]) for x in (1.0, 1.5)]
    at_rest = [px4_inputs(each, np.array([*each[:3], *[0.0] * 8]), np.zeros(3)) for each in measured]
    elsewhere = [px4_inputs(each, rest, np.zeros(3)) for each in measured]
    library.set_setpoint_age(ctypes.c_uint64(10_000))  # µs; the setpoint arrived before offboard mode was engaged
    held = call(library, 1.0, elsewhere[0])
    library.set_setpoint_age(ctypes.c_uint64(0))
    np.testing.assert_allclose(call(library, 1.02, at_rest[0]), held, rtol=1e-6)
    assert not np.allclose(call(library, 1.04, elsewhere[0]), held)
    library.set_setpoint_age(ctypes.c_uint64(510_000))
    held = call(library, 2.0, elsewhere[1])
    library.set_setpoint_age(ctypes.c_uint64(0))
    np.testing.assert_allclose(call(library, 2.02, at_rest[1]), held, rtol=1e-6)


@needs_compilers
@pytest.mark.slow
@pytest.mark.parametrize("row", [0, 4, 8, 11])
def test_the_px4_project_commands_nothing_if_an_estimate_is_not_a_number(row, px4_wrench_project):
    library = px4_wrench_project
    measured = np.zeros(12)
    before = library.num_commands()
    inputs = px4_inputs(measured, np.zeros(11), np.zeros(3))
    inputs[{0: 0, 4: 7, 8: 5, 11: 12}[row]] = np.nan
    call(library, 1.0, inputs)
    assert library.num_commands() == before


@needs_compilers
@pytest.mark.slow
def test_the_px4_project_flies_the_exported_route_from_its_current_position(tmp_path):
    scenario, project = exported(tmp_path, "px4", WRENCH, reference=True)
    library = px4_library(project)
    px4_start(library, 0.02)
    expected = simulate(scenario)
    offset = np.array([4.0, -5.0, 6.0])
    for number in range(3):
        signals = [expected[name][number].copy() for name in ("measurement", "reference")]
        signals[0][:3] += offset
        command = call(library, 1.0 + 0.02 * number, px4_inputs(*signals, np.full(3, np.nan)))
        weight = nominal_parameters(scenario).mass * nominal_parameters(scenario).gravity
        assert -command[0] / HOVER_THRUST * weight == pytest.approx(expected["wrench"][number, 0], rel=1e-5)


def ros2_library(project, attitude=0):
    main = {"mine_node.cpp": ["-Dmain=node_main"]}
    macros = [f"-DCOMMANDS_ATTITUDE={attitude}"]
    library = library_of(project, "ros2.hpp", "ros2_driver.cpp", macros=macros, file_macros=main)
    assert library.start() == 20000
    return library


def ros2_inputs(measured, reference, jerk):
    R_WB = RotationMatrix(RollPitchYaw(measured[3:6])).matrix()
    orientation, heading = quaternion(measured[3:6]), quaternion([0.0, 0.0, reference[9]])
    vectors = measured[:3], R_WB.T @ measured[6:9], orientation, measured[9:], reference[:9], heading, reference[10:]
    return np.concatenate(vectors)


@needs_compilers
@pytest.mark.long
@pytest.mark.parametrize("precision", ["single", "double"])
def test_the_ros2_project_commands_the_wrench_of_the_exported_code(precision, tmp_path):
    scenario, project = exported(tmp_path, "ros2", WRENCH_WITHOUT_JERK, precision)
    library = ros2_library(project)
    assert_commands_as_exported(tmp_path, library, ros2_inputs, lambda command: command[:4])
    system = Platform(library, 0.02, ros2_inputs, lambda command: command[:4])
    assert_flight_as_exported(scenario, tmp_path, system)


@needs_compilers
@pytest.mark.long
def test_the_ros2_project_commands_the_attitude_of_the_exported_code(tmp_path):
    scenario, project = exported(tmp_path, "ros2", ATTITUDE_WITHOUT_JERK)
    nominal = nominal_parameters(scenario)

    def decode(command):
        return [command[4] / 0.5 * nominal.mass * nominal.gravity, *angles_of(command[:4]), 0.0, 0.0, 0.0]

    library = ros2_library(project, 1)
    assert_commands_as_exported(tmp_path, library, ros2_inputs, decode, unavailable=[4, 5, 6])
    system = Platform(library, 0.02, ros2_inputs, decode, ("attitude_target", 7))
    assert_flight_as_exported(scenario, tmp_path, system, unavailable=[4, 5, 6])


@needs_compilers
@pytest.mark.long
def test_the_ros2_project_commands_nothing_without_recent_odometry(tmp_path):
    _, project = exported(tmp_path, "ros2", WRENCH_WITHOUT_JERK)
    library = ros2_library(project)
    library.tick(ctypes.c_uint64(0))
    assert library.num_commands() == 0
    level = np.array([0.0] * 6 + [1.0] + [0.0] * 6)
    library.send_odometry(level.ctypes.data_as(ctypes.c_void_p))
    library.tick(ctypes.c_uint64(100_000))
    library.tick(ctypes.c_uint64(250_000))
    level[3] = np.nan
    library.send_odometry(level.ctypes.data_as(ctypes.c_void_p))
    library.tick(ctypes.c_uint64(260_000))
    assert library.num_commands() == 1


@needs_compilers
@pytest.mark.long
def test_the_ros2_project_holds_its_first_position_until_a_reference_arrives(tmp_path):
    _, project = exported(tmp_path, "ros2", WRENCH_WITHOUT_JERK)
    library = ros2_library(project)
    first, later = (
        np.array([*hold_reference, 0.2, 0.1, 0.0, 0.1, -0.2, 0.3, 0.0, 0.0, 0.0]) for hold_reference in np.eye(3)[:2]
    )
    hold_reference, held = np.array([*first[:3], *[0.0] * 6, first[5], 0.0]), np.zeros(8)
    for measured in (first, later):
        odometry = ros2_inputs(measured, hold_reference, None)[:13].copy()
        library.send_odometry(odometry.ctypes.data_as(ctypes.c_void_p))
        library.tick(ctypes.c_uint64(0))
    library.read_command(held.ctypes.data_as(ctypes.c_void_p))
    np.testing.assert_allclose(call(library, 0.0, ros2_inputs(later, hold_reference, None)), held, rtol=1e-6)


@needs_compilers
@pytest.mark.slow
def test_the_python_project_equals_the_exported_code_bit_for_bit(tmp_path):
    scenario, project = exported(tmp_path, "python", ["figure_eight", ONE_SECOND], "double")
    subprocess.run(["make", "--silent"], cwd=project, check=True)
    python_module = module_of(project / "mine.py")
    controller, inputs = python_module.Controller(), python_module.Inputs()
    assert python_module.PERIOD == 0.02

    class System(LeafSystem):
        def __init__(self):
            super().__init__()
            self._steps = 0
            for name, _ in python_module.Inputs._fields_:
                self.DeclareVectorInputPort(name, ctypes.sizeof(getattr(inputs, name)) // 8)
            self.DeclareDiscreteState(1)
            self.DeclareVectorOutputPort("wrench", 4, self._calc)

        def _calc(self, context, output):
            if (
                round(context.get_time() / python_module.PERIOD) == self._steps
            ):  # Drake evaluates the output once for each step
                self._steps += 1
                for index, (name, _) in enumerate(python_module.Inputs._fields_):
                    signal, values = getattr(inputs, name), self.get_input_port(index).Eval(context)
                    for (field, _), value in zip(signal._fields_, values, strict=True):
                        setattr(signal, field, value)
                self._outputs = controller.step(inputs)
            wrench = self._outputs.wrench
            output.SetFromVector([getattr(wrench, field) for field, _ in wrench._fields_])

    expected = simulate(scenario, control=exported_controller(tmp_path)())
    actual = simulate(scenario, control=System())
    for name in actual:
        np.testing.assert_array_equal(actual[name], expected[name])


@needs_compilers
@pytest.mark.slow
def test_the_python_project_evaluates_the_reference_and_accepts_new_parameters(tmp_path):
    scenario, project = exported(tmp_path, "python", ["figure_eight", ONE_SECOND], "double", reference=True)
    subprocess.run(["make", "--silent"], cwd=project, check=True)
    python_module = module_of(project / "mine.py")
    first, second, inputs = python_module.Controller(), python_module.Controller(), python_module.Inputs()
    first.set_reference(0.5, inputs)
    reference = simulate(scenario)["reference"][25]
    values = [getattr(inputs.reference, name) for name, _ in inputs.reference._fields_]
    np.testing.assert_allclose(values, reference, atol=1e-12)
    second.parameters.position_pd_gains.k_p.x *= 2.0
    assert first.step(inputs).wrench.tau_y != second.step(inputs).wrench.tau_y


@needs_compilers
@pytest.mark.slow
def test_the_arduino_project_calls_the_controller_at_its_period(tmp_path):
    _, project = exported(tmp_path, "arduino", WRENCH)
    macros = ['-DHEADER="mine.h"', "-DINPUTS=mine_inputs_t", "-DOUTPUTS=mine_outputs_t"]
    library = library_of(
        project, "arduino.h", "arduino_driver.cpp", options=SINGLE_ONLY, macros=macros, unlinked=["board.cpp"]
    )
    description, machine = read_description(tmp_path), HostMachine(tmp_path)
    state = HostMachine.initial_state(tmp_path, description)
    rng, begin = np.random.default_rng(2), 2**32 - 50_000  # µs, so that the 32-bit clock overflows after 50 ms
    inputs = rng.normal(size=(6, sum(description.inputs.values()))).astype(np.float32)
    command = np.full(4, np.nan, np.float32)

    def run(microseconds, row):
        pointers = (each.ctypes.data_as(ctypes.c_void_p) for each in (inputs[row], command))
        library.run(ctypes.c_uint32(microseconds), *pointers)

    library.start(ctypes.c_uint32(begin))
    library.arm(True)
    for number in range(5):
        run(begin + 20_000 * number + 100, number)
        state, expected = machine.step(state, inputs[number].tobytes())
        assert command.tobytes() == expected
        run(begin + 20_000 * number + 10_000, 5)
        assert command.tobytes() == expected, "a step before the end of the period"
    assert library.num_late_steps() == 0
    run(begin + 20_000 * 7 + 100, 0)
    assert library.num_late_steps() == 1
    library.arm(False)
    run(begin + 20_000 * 9, 0)
    assert library.has_stopped()


def module_of(path):
    """Return the module in a file."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def hover_code(tmp_path_factory):
    """Export code for hover in single precision."""
    scenario = load_scenario("hover")
    export = export_controller(scenario, tmp_path_factory.mktemp("hover"), precision="single", name="mine")
    return ExportedCode(export.description, "", "", (), nominal_parameters(scenario), False)


SINGLE_PRECISION_PROJECTS = ["crazyflie", "px4", "arduino"]


@pytest.mark.parametrize(
    ("projects", "changes", "message"),
    [
        (["crazyflie"], {"name": "controller"}, "cannot use the name controller, since a header"),
        (SINGLE_PRECISION_PROJECTS, {"precision": "double"}, "needs --precision single"),
        (["crazyflie"], {"outputs": {"attitude_target": 7}}, "commands wrench, not attitude_target"),
        (["px4", "ros2"], {"outputs": {"wrench": 4, "rotor_speed_command": 4}}, "not wrench and rotor_speed_command"),
        (["crazyflie"], {"period": 0.0125}, "a period that is a whole number of milliseconds, not 0.0125 s"),
        (["px4", "ros2", "arduino"], {"period": 1.25e-5 / 3}, "a period that is a whole number of microseconds"),
        (
            ["crazyflie", "px4", "ros2"],
            {"inputs": {"measurement": 12, "gyroscope": 3}},
            "cannot provide the input gyroscope",
        ),
    ],
)
def test_code_that_does_not_fit_a_project_is_refused(hover_code, projects, changes, message):
    code = hover_code._replace(description=dataclasses.replace(hover_code.description, **changes))
    for project in projects:
        with pytest.raises(InputError, match=f"project {project} .*{message}"):
            project_files(project, code)


def test_an_unknown_project_is_refused(hover_code):
    with pytest.raises(InputError, match=f"project is 'kite'; it must be one of {', '.join(PROJECTS)}"):
        project_files("kite", hover_code)


def test_project_files_contain_no_placeholder_and_no_condition_of_a_template(hover_code):
    """A placeholder is a word such as `@NAME@`. A condition of a template would become `#if 0` or `#if 1`."""
    for project in PROJECTS:
        for path, text in project_files(project, hover_code).items():
            assert not re.search("@[A-Z_0-9]+@|#if !?[01]", path + text), (project, path)
            # Each #if of the C preprocessor has its #endif.
            assert len(re.findall("^#if", text, re.MULTILINE)) == len(re.findall("^#endif", text, re.MULTILINE))


def test_a_project_contains_only_the_template_lines_that_apply_to_its_code(hover_code):
    module = "src/modules/mine/mine_module.cpp"
    without_reference = project_files("px4", hover_code)[module]
    with_reference = project_files("px4", hover_code._replace(has_reference=True))[module]
    assert ("finite_or" in without_reference, "finite_or" in with_reference) == (True, False)
    assert ("mine_reference(" in without_reference, "mine_reference(" in with_reference) == (False, True)
    assert "#ifndef BOARD_H" in project_files("arduino", hover_code)["mine_sketch/board.h"]


def test_only_a_ros2_project_that_commands_an_attitude_depends_on_mavros(hover_code):
    description = hover_code.description
    for outputs, expected in (({"wrench": 4}, False), ({"attitude_target": 7}, True)):
        code = hover_code._replace(description=dataclasses.replace(description, outputs=outputs))
        files = project_files("ros2", code)
        dependent = [path for path in ("CMakeLists.txt", "package.xml") if "mavros_msgs" in files[path]]
        assert dependent == (["CMakeLists.txt", "package.xml"] if expected else [])
