"""Tests that connections between systems are found through nested diagrams."""

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, ConstantVectorSource, Gain

from drake_quad.compilation.topology import ExportedPort, Port, Topology


def named(builder, name, system):
    return builder.AddNamedSystem(name, system)


@pytest.fixture(scope="module")
def topology():
    """Return the topology of a gain in two nested diagrams, and an adder outside of them.

    u ──┬──▶ outer( inner( gain ) ──▶ twice ) ──┐
        └──────────────────────────────▶ adder ◀┘ ◀── constant
    """
    inner = DiagramBuilder()
    gain = named(inner, "gain", Gain(2.0, 3))
    inner.ExportInput(gain.get_input_port(), "in")
    inner.ExportOutput(gain.get_output_port(), "out")
    outer = DiagramBuilder()
    inside, twice = named(outer, "inner", inner.Build()), named(outer, "twice", Gain(2.0, 3))
    outer.ExportInput(inside.get_input_port(), "in")
    outer.Connect(inside.get_output_port(), twice.get_input_port())
    outer.ExportOutput(twice.get_output_port(), "twice")
    outer.ExportOutput(inside.get_output_port(), "once")
    builder = DiagramBuilder()
    nested, adder = named(builder, "outer", outer.Build()), named(builder, "adder", Adder(4, 3))
    constant = named(builder, "constant", ConstantVectorSource([1.0, 2.0, 3.0]))
    builder.ExportInput(nested.get_input_port(), "u")
    builder.ConnectInput("u", adder.get_input_port(1))
    builder.Connect(nested.GetOutputPort("twice"), adder.get_input_port(0))
    builder.Connect(constant.get_output_port(), adder.get_input_port(3))
    builder.ExportOutput(adder.get_output_port(), "sum")
    builder.ExportOutput(nested.GetOutputPort("once"), "once")
    return Topology(builder.Build())


def test_the_path_of_a_leaf_system_begins_with_the_names_of_its_diagrams(topology):
    assert list(topology.leaves) == ["outer.inner.gain", "outer.twice", "adder", "constant"]


def test_the_source_of_an_input_is_a_leaf_output_or_a_port_of_the_diagram(topology):
    u = ExportedPort("u", 3)
    assert topology.sources("outer.inner.gain") == [u]
    assert topology.sources("outer.twice") == [Port("outer.inner.gain", 0)]
    assert topology.sources("adder") == [Port("outer.twice", 0), u, None, Port("constant", 0)]
    assert topology.sources("constant") == []


def test_the_source_of_an_exported_output_is_a_leaf_output(topology):
    assert topology.outputs == {"sum": Port("adder", 0), "once": Port("outer.inner.gain", 0)}
