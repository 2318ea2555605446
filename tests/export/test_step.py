"""Tests of the C function that advances a diagram, on diagrams of Drake's systems."""

import ctypes
import itertools
import shutil
import subprocess

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Adder, Gain, TrajectorySource, ZeroOrderHold
from pydrake.trajectories import PiecewisePolynomial

from drake_quad import InputError
from drake_quad.export.diagram_code import diagram_code
from drake_quad.framework.c_code import DOUBLE
from drake_quad.framework.fleet_system import FleetSystem, fleet_system
from drake_quad.framework.records import ROW, Row
from drake_quad.framework.wiring import append, build
from drake_quad.signals import Acceleration


def holds(*periods):
    """Return a diagram of zero-order holds in series.

    The output of the diagram is the sum of the outputs of all holds, where the second one is negated.
    """
    builder = DiagramBuilder()
    systems = [builder.AddNamedSystem(f"hold_{i}", ZeroOrderHold(period, 2)) for i, period in enumerate(periods)]
    builder.ExportInput(systems[0].get_input_port(), "command")
    for before, after in itertools.pairwise(systems):
        builder.Connect(before.get_output_port(), after.get_input_port())
    ports = [system.get_output_port() for system in systems]
    ports[1] = append(builder, "negated", Gain(-1.0, 2), ports[1])
    builder.ExportOutput(append(builder, "total", Adder(len(ports), 2), *ports), "total")
    return build(builder, "holds")


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("periods", [(0.01, 0.02, 0.04), (0.04, 0.02, 0.01), (0.01, 0.03, 0.02)])
def test_systems_with_several_periods_advance_as_in_drake(periods, tmp_path):
    diagram = holds(*periods)
    code = diagram_code(diagram, name="holds", outputs=["total"], output_period=0.02, precision=DOUBLE)
    (tmp_path / "holds.h").write_text(code.header)
    (tmp_path / "holds.c").write_text(code.source)
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-o", "holds.so", "holds.c"]
    subprocess.run(command, cwd=tmp_path, check=True)
    library = ctypes.CDLL(str(tmp_path / "holds.so"))
    state = ctypes.create_string_buffer(8 * code.interface.num_states + 8)
    library.holds_init(state)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    rng = np.random.default_rng(8)
    outputs = np.full(2, np.nan)
    for step in range(13):
        command = rng.normal(size=2)
        diagram.get_input_port().FixValue(context, command)
        expected = diagram.get_output_port().Eval(context).copy()
        before = outputs.copy()
        library.holds_step(
            state, None, command.ctypes.data_as(ctypes.c_void_p), outputs.ctypes.data_as(ctypes.c_void_p)
        )
        np.testing.assert_array_equal(outputs, expected if step % 2 == 0 else before)
        simulator.AdvanceTo((step + 1) * code.interface.period)


def test_only_unused_arguments_are_marked_as_unused():
    code = diagram_code(holds(0.01, 0.02), name="holds", outputs=["total"], output_period=0.02, precision=DOUBLE)
    assert "(void)parameters;" in code.source
    assert "inputs->" in code.source
    assert "(void)inputs;" not in code.source


def test_periods_that_are_no_multiples_of_each_other_are_refused():
    with pytest.raises(InputError, match=r"hold_1 cannot be exported: 0.025 s is not a multiple of 0.01 s"):
        diagram_code(holds(0.01, 0.025), name="holds", outputs=["total"], output_period=0.02, precision=DOUBLE)


def test_a_system_with_callbacks_instead_of_formulas_is_refused():
    builder = DiagramBuilder()
    system = LeafSystem()
    builder.AddNamedSystem("mine", system)
    system.DeclareVectorOutputPort("total", 1, lambda context, output: None)
    builder.ExportOutput(system.get_output_port(), "total")
    with pytest.raises(InputError, match="mine .* cannot be exported: only systems that declare formulas"):
        diagram_code(build(builder, "own"), name="own", outputs=["total"], output_period=0.02, precision=DOUBLE)


def mine(memory: Acceleration) -> Acceleration:
    return memory._replace(x=2.0 * memory.x)


def next_mine_memory(memory: Acceleration) -> Acceleration:
    return memory._replace(x=memory.x + 3.0)


def doubled_x(memory: Acceleration) -> Row:
    return 2.0 * memory.x


@fleet_system(float)
class Counter(FleetSystem):
    """System with formulas `mine` and `next_mine_memory`, names that two variables of the C code also have."""

    def declare(self) -> None:
        memory = self.state("memory", lambda _: Acceleration(1.0, 0.0, 0.0))
        self.output("acceleration_command", mine, memory)
        self.output("number", doubled_x, memory, layout=ROW)
        self.update(0.02, next_mine_memory, memory, writes=[memory])


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("port", ["acceleration_command", "number"])
def test_formulas_may_return_a_record_or_a_row_and_have_the_same_name_as_a_variable_in_the_c_code(port, tmp_path):
    builder = DiagramBuilder()
    builder.AddNamedSystem("mine", Counter())
    builder.ExportOutput(builder.GetSubsystemByName("mine").GetOutputPort(port), "total")
    code = diagram_code(build(builder, "own"), name="own", outputs=["total"], output_period=0.02, precision=DOUBLE)
    (tmp_path / "own.h").write_text(code.header)
    (tmp_path / "own.c").write_text(code.source)
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-shared", "-fPIC", "-o", "own.so", "own.c"]
    subprocess.run(command, cwd=tmp_path, check=True)
    library = ctypes.CDLL(str(tmp_path / "own.so"))
    state, outputs = ctypes.create_string_buffer(8 * code.interface.num_states + 8), np.zeros(3)
    library.own_init(state)
    for expected in (2.0, 8.0, 14.0):
        library.own_step(state, None, None, outputs.ctypes.data_as(ctypes.c_void_p))
        assert outputs[0] == expected


def test_a_system_whose_output_is_a_given_trajectory_is_refused():
    builder = DiagramBuilder()
    path = PiecewisePolynomial.FirstOrderHold([0.0, 1.0], [[0.0, 1.0]])
    total = append(builder, "total", Adder(2, 1), *[append(builder, "given", TrajectorySource(path))] * 2)
    builder.ExportOutput(append(builder, "held", ZeroOrderHold(0.01, 1), total), "total")
    with pytest.raises(InputError, match="given cannot be exported: its output is a given trajectory over time"):
        diagram_code(build(builder, "own"), name="own", outputs=["total"], output_period=0.02, precision=DOUBLE)
