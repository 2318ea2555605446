"""Tests that equivalent diagrams share the machine code of their events, and different diagrams do not."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import (
    ConstantVectorSource,
    Demultiplexer,
    Gain,
    Multiplexer,
    TrajectorySource,
    ZeroOrderHold,
)
from pydrake.trajectories import PiecewisePolynomial

from drake_quad.caching import ThreadSafeCache
from drake_quad.compilation import program
from drake_quad.compilation.compile_diagram import compile_diagram, compiled_part
from drake_quad.framework.broadcast import Broadcast
from drake_quad.framework.fleet_system import FleetSystem, fleet_system
from drake_quad.framework.records import ROW


def grown(x, factor, constant, value):
    return (x[0] + factor[0] * constant + value,)


def shrunk(x, factor, constant, value):
    return (x[0] - factor[0] * constant - value,)


def swapped(x, constant):
    return constant / (1.0 + x[0] * x[0])


@fleet_system(float)
class Growing(FleetSystem):
    """System with one state component, which a formula with a constant updates periodically."""

    def declare(
        self,
        *,
        formula=shrunk,
        constant=2.0,
        absent=0.0,
        period=0.01,
        unrestricted=False,
        at_start=True,
        parameters=1.0,
    ):
        value = self.input("value", layout=ROW, absent=absent)
        factor = self.parameter("factor", lambda number: (number,))
        x = self.state("x", lambda number: (0.5 * number,))
        reads = x, factor, constant, value
        self.update(period, formula, *reads, writes=[x], unrestricted=unrestricted, at_start=at_start)
        self.output("turned", swapped, x, constant, layout=ROW)
        self.state_output(x)


def diagram_of(n=1, *, hold=0.02, gain=3.0, connected=True, value=4.0, name="small", **structure):
    builder = DiagramBuilder()
    grows = builder.AddNamedSystem("grows", Growing(num_vehicles=n, **structure))
    held = builder.AddNamedSystem("hold", ZeroOrderHold(hold, n))
    factor = builder.AddNamedSystem("gain", Gain(gain, n))
    constant = builder.AddNamedSystem("constant", ConstantVectorSource(np.full(n, value)))
    builder.Connect(grows.GetOutputPort("x"), held.get_input_port())
    builder.Connect(held.get_output_port() if connected else constant.get_output_port(), factor.get_input_port())
    builder.Connect(factor.get_output_port(), grows.GetInputPort("value"))
    builder.ExportOutput(grows.GetOutputPort("x"), "x")
    builder.ExportOutput(grows.GetOutputPort("turned"), "turned")
    diagram = builder.Build()
    diagram.set_name(name)
    return diagram


@pytest.fixture
def new_loops(monkeypatch):
    """Empty the cache of events, and return a list to which the machine code of every new event is added."""
    monkeypatch.setattr(program, "_event_cache", ThreadSafeCache())
    loops, make = [], program.Loop

    def count(*args, **options):
        loops.append(make(*args, **options))
        return loops[-1]

    monkeypatch.setattr(program, "Loop", count)
    return loops


def compiled_outputs(diagram, **options):
    """Return the outputs of the compiled diagram after 0.055 s."""
    compiled = compile_diagram(diagram, **options)
    simulator = Simulator(compiled)
    simulator.AdvanceTo(0.055)
    return [compiled.GetOutputPort(name).Eval(simulator.get_context()) for name in ("x", "turned")]


def uncompiled_outputs(diagram):
    simulator = Simulator(diagram)
    simulator.AdvanceTo(0.055)
    return [diagram.GetOutputPort(name).Eval(simulator.get_context()) for name in ("x", "turned")]


def test_diagrams_that_differ_only_in_values_share_machine_code(new_loops):
    """The diagrams differ in parameters, initial state and name."""
    first = compiled_outputs(diagram_of())
    count = len(new_loops)
    assert count > 0
    other = diagram_of(parameters=0.7, value=-1.0, name="other")
    np.testing.assert_allclose(compiled_outputs(other), uncompiled_outputs(other), rtol=1e-12)
    assert len(new_loops) == count
    assert not np.array_equal(compiled_outputs(other), first)


def test_fleets_of_different_sizes_share_machine_code(new_loops):
    """The diagram has a multiplexer, a demultiplexer, and a trajectory that all vehicles share."""

    def fleet(n):
        builder = DiagramBuilder()
        reference = PiecewisePolynomial.FirstOrderHold([0.0, 1.0], np.array([[0.0, 1.0], [2.0, 0.0], [0.5, 3.0]]))
        source = builder.AddNamedSystem("source", TrajectorySource(reference))
        parts = builder.AddNamedSystem("parts", Demultiplexer([1, 2]))
        shared = builder.AddNamedSystem("shared", Broadcast(n, num_rows=1))
        grows = builder.AddNamedSystem("grows", Growing(num_vehicles=n))
        together = builder.AddNamedSystem("together", Multiplexer([n, n]))
        demultiplexer = builder.AddNamedSystem("apart", Demultiplexer([n, n]))
        factor = builder.AddNamedSystem("factor", Gain(0.5, n))
        builder.Connect(source.get_output_port(), parts.get_input_port())
        builder.Connect(parts.get_output_port(0), shared.get_input_port())
        builder.Connect(grows.GetOutputPort("x"), together.get_input_port(0))
        builder.Connect(shared.get_output_port(), together.get_input_port(1))
        builder.Connect(together.get_output_port(), demultiplexer.get_input_port())
        builder.Connect(demultiplexer.get_output_port(1), factor.get_input_port())
        builder.Connect(factor.get_output_port(), grows.GetInputPort("value"))
        builder.ExportOutput(grows.GetOutputPort("x"), "x")
        builder.ExportOutput(demultiplexer.get_output_port(1), "turned")
        diagram = builder.Build()
        diagram.set_name("fleet")
        return diagram

    counts = []
    for n in (3, 2, 17):
        np.testing.assert_allclose(compiled_outputs(fleet(n)), uncompiled_outputs(fleet(n)), rtol=1e-12)
        counts.append(len(new_loops))
    assert counts == counts[:1] * 3
    compiled_outputs(fleet(1))
    assert len(new_loops) > counts[0]


# Arguments of `diagram_of`, each of which changes the computations of the diagram.
DIAGRAM_DIFFERENCES = [
    {"formula": grown},
    {"constant": 2.5},
    {"absent": 0.25, "connected": False},
    {"period": 0.02},
    {"at_start": False},
    {"unrestricted": True},
    {"hold": 0.04},
    {"gain": 5.0},
    {"connected": False},
    {"n": 2},
    {"constant": -0.0},
]


@pytest.mark.parametrize("difference", DIAGRAM_DIFFERENCES, ids=" ".join)
def test_diagrams_with_different_computations_have_different_events(new_loops, difference):
    before = {"constant": 0.0} if difference.get("constant") == 0.0 else {}
    compiled_outputs(diagram_of(**before))
    count = len(new_loops)
    other = diagram_of(**difference)
    actual = compiled_outputs(other)
    assert len(new_loops) > count
    np.testing.assert_allclose(actual, uncompiled_outputs(other), rtol=1e-12)
    np.testing.assert_array_equal(np.signbit(actual), np.signbit(uncompiled_outputs(other)))


@pytest.mark.parametrize("first", [1, 2])
def test_diagrams_that_split_a_vector_differently_have_different_events(first):
    """The diagrams differ only in the output sizes of a demultiplexer."""
    builder = DiagramBuilder()
    grows = builder.AddNamedSystem("grows", Growing())
    parameters = builder.AddNamedSystem("numbers", ConstantVectorSource([1.0, 2.0, 3.0]))
    parts = builder.AddNamedSystem("parts", Demultiplexer([first, 3 - first]))
    builder.Connect(parameters.get_output_port(), parts.get_input_port())
    builder.ExportOutput(grows.GetOutputPort("x"), "x")
    builder.ExportOutput(parts.get_output_port(1), "second")
    compiled = compile_diagram(builder.Build())
    actual = compiled.GetOutputPort("second").Eval(compiled.CreateDefaultContext())
    np.testing.assert_array_equal(actual, [2.0, 3.0][first - 1 :])


@fleet_system(float)
class WithInitialParameters(FleetSystem):
    """System whose initial state is a list of numbers."""

    def declare(self, *, by):
        x = self.state("x", lambda _: (1.0,))
        self.initialize(lambda x, by: (x[0] + sum(by),), x, by, writes=[x])
        self.update(0.01, lambda x: (2.0 * x[0],), x, writes=[x])
        self.state_output(x)


def taken(x, factor, value):
    return (total(x, factor, value),)


def total(x, factor, value):
    return x[0] + factor[0] + value


@fleet_system(float)
class Selecting(FleetSystem):
    """System with two ports, two parameters and two states; its formula uses one of each."""

    def declare(self, *, value="one", factor="one", read="one", written="one"):
        inputs = {name: self.input(f"value_{name}", layout=ROW) for name in ("one", "two")}
        parameters = {
            name: self.parameter(f"factor_{name}", lambda _, i=i: (i,)) for name, i in (("one", 1.0), ("two", 2.0))
        }
        states = {name: self.state(f"x_{name}", lambda _, i=i: (i,)) for name, i in (("one", 10.0), ("two", 20.0))}
        reads = states[read], parameters[factor], inputs[value]
        self.update(0.01, taken, *reads, writes=[states[written]])
        self.output("shown", total, *reads, layout=ROW)
        for state in states.values():
            self.state_output(state)


def test_diagrams_that_differ_only_in_the_gain_of_one_component_have_different_results():
    """The two diagrams differ only in the gain of the second component."""
    for second in (5.0, 7.0):
        builder = DiagramBuilder()
        grows = builder.AddNamedSystem("grows", Growing())
        parameters = builder.AddNamedSystem("numbers", ConstantVectorSource([1.0, 2.0]))
        gain = builder.AddNamedSystem("gain", Gain([3.0, second]))
        builder.Connect(parameters.get_output_port(), gain.get_input_port())
        builder.ExportOutput(grows.GetOutputPort("x"), "x")
        builder.ExportOutput(gain.get_output_port(), "gained")
        compiled = compile_diagram(builder.Build())
        actual = compiled.GetOutputPort("gained").Eval(compiled.CreateDefaultContext())
        np.testing.assert_array_equal(actual, [3.0, 2.0 * second])


def test_diagrams_that_use_different_ports_of_the_same_kind_have_different_events():
    """All ports, parameters and states have different values, so the result reveals which of them the formula uses."""
    for choice in ({}, *({name: "two"} for name in ("value", "factor", "read", "written"))):
        builder = DiagramBuilder()
        chooses = builder.AddNamedSystem("chooses", Selecting(**choice))
        for name, number in (("one", 100.0), ("two", 200.0)):
            constant = builder.AddNamedSystem(name, ConstantVectorSource([number]))
            builder.Connect(constant.get_output_port(), chooses.GetInputPort(f"value_{name}"))
        for name in ("shown", "x_one", "x_two"):
            builder.ExportOutput(chooses.GetOutputPort(name), name)
        uncompiled = builder.Build()
        outputs = []
        for diagram in (uncompiled, compile_diagram(uncompiled)):
            simulator = Simulator(diagram)
            simulator.AdvanceTo(0.015)
            context = simulator.get_context()
            outputs.append([diagram.GetOutputPort(name).Eval(context).item() for name in ("shown", "x_one", "x_two")])
        assert outputs[0] == outputs[1], choice


def test_mutable_constants_are_never_shared():
    for by in ([1.0, 2.0], [5.0]):
        builder = DiagramBuilder()
        builder.ExportOutput(builder.AddNamedSystem("begins", WithInitialParameters(by=by)).GetOutputPort("x"), "x")
        diagram = builder.Build()
        for each in (diagram, compile_diagram(diagram)):
            simulator = Simulator(each)
            simulator.AdvanceTo(0.015)
            assert each.GetOutputPort("x").Eval(simulator.get_context()) == [4.0 * (1.0 + sum(by))]


def test_diagrams_with_different_options_of_compile_diagram_have_different_machine_code(new_loops):
    """However, diagrams with 3 and with 5 `ticks` share machine code, because it simulates one tick at a time."""
    counts = []
    for options in ({}, {"record": True}, {"ticks": 3}, {"ticks": 3, "record": True}, {"ticks": 3, "tick": 0.01}):
        compile_diagram(diagram_of(), **options)
        counts.append(len(new_loops))
    assert counts == sorted(set(counts))
    for options in ({"ticks": 5, "record": True}, {"record": True}):
        compile_diagram(diagram_of(), **options)
    assert len(new_loops) == counts[-1]


def test_events_that_were_removed_from_the_cache_are_compiled_again(new_loops, monkeypatch):
    monkeypatch.setattr(program, "_event_cache", ThreadSafeCache(2))
    diagram = diagram_of()
    first = compiled_outputs(diagram)
    assert len(program._event_cache) <= 2
    np.testing.assert_array_equal(compiled_outputs(diagram), first)


def test_tables_that_were_removed_from_the_cache_are_computed_again(monkeypatch):
    diagram = diagram_of()
    logs = []
    for max_entries in (256, 1):
        monkeypatch.setattr("drake_quad.compilation.compiled_system._MAX_TABLES", max_entries)
        compiled = compile_diagram(diagram, ticks=2, record=True)
        part = compiled_part(compiled)
        for _ in range(2):
            simulator = Simulator(compiled)
            simulator.AdvanceTo(3.0)
            logs.append(part.log(part.GetMyContextFromRoot(simulator.get_context()))["x"])
        assert len(part._tables) <= max_entries
    for log in logs[1:]:
        np.testing.assert_array_equal(log, logs[0])
