"""Tests of the labels and shapes of blocks and connections in the drawing of a small diagram."""

import re
from itertools import pairwise

import pytest
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import Adder, Demultiplexer, Gain, Integrator, PassThrough

from drake_quad.visualization.block_drawing import digest, drawings


def inner_diagram(name, *systems):
    """Return a chain of systems, with an input port and an output port."""
    builder = DiagramBuilder()
    for system in systems:
        builder.AddSystem(system)
    for first, second in pairwise(systems):
        builder.Connect(first.get_output_port(), second.get_input_port())
    builder.ExportInput(systems[0].get_input_port(), "command")
    builder.ExportOutput(systems[-1].get_output_port(), "thrust")
    diagram = builder.Build()
    diagram.set_name(name)
    return diagram


def named(system, name):
    system.set_name(name)
    return system


@pytest.fixture(scope="module")
def drawings_by_path():
    """Return a loop of an adder, a motor and a splitter, with a diagram that wraps a single system."""
    builder = DiagramBuilder()
    adder = builder.AddNamedSystem("sum", Adder(2, 3))
    motor = builder.AddSystem(inner_diagram("motor", named(Gain(2.0, 3), "gain"), named(Integrator(3), "integrator")))
    wrapper = builder.AddSystem(inner_diagram("wrapper", named(PassThrough(3), "inside")))
    splitter = builder.AddNamedSystem("splitter", Demultiplexer([1, 2]))
    builder.Connect(adder.get_output_port(), motor.get_input_port())
    builder.Connect(motor.get_output_port(), splitter.get_input_port())
    builder.Connect(motor.get_output_port(), adder.get_input_port(0))
    builder.Connect(motor.get_output_port(), wrapper.get_input_port())
    builder.ExportInput(adder.get_input_port(1), "offset")
    builder.ExportOutput(wrapper.get_output_port(), "seen")
    builder.ExportOutput(splitter.get_output_port(0), "first")
    builder.ExportOutput(splitter.get_output_port(1), "others")
    diagram = builder.Build()
    diagram.set_name("small")
    return drawings(diagram)


def test_a_diagram_of_a_single_system_has_no_separate_drawing(drawings_by_path):
    assert list(drawings_by_path) == ["", "motor"]
    assert 'label="small"' in drawings_by_path[""]
    assert 'label="motor"' in drawings_by_path["motor"]


def test_blocks_show_their_name_and_their_class_if_it_differs(drawings_by_path):
    nodes = dict(re.findall(r"^ +([sio]\d+) \[(.*)\];$", drawings_by_path[""], re.MULTILINE))
    assert nodes["s0"] == 'label="sum\\nAdder"'
    # A block whose inside is shown in another drawing has a double outline.
    assert nodes["s1"] == 'label="motor", peripheries=2, fillcolor="#DCE9F5"'
    assert nodes["s2"] == 'label="wrapper"'
    # A splitter is a bar without a label.
    assert nodes["s3"].startswith('label="", shape=box')
    assert nodes["i0"].startswith('label="offset", shape=plaintext')
    assert nodes["o2"].startswith('label="seen", shape=plaintext')
    assert nodes["o3"].startswith('label="first\\nothers", shape=plaintext')
    inside = dict(re.findall(r"^ +(s\d+) \[(.*)\];$", drawings_by_path["motor"], re.MULTILINE))
    assert inside == {"s0": 'label="gain"', "s1": 'label="integrator"'}


def test_connections_are_ordered_and_labelled_with_signal_and_size(drawings_by_path):
    edges = re.findall(r'^ +(\w+) -> (\w+) \[label="(.*)"\];$', drawings_by_path[""], re.MULTILINE)
    assert edges == [
        ("i0", "s0", "(3)"),
        ("s0", "s1", "sum (3)"),
        ("s1", "s0", "thrust (3)"),
        ("s1", "s2", "thrust (3)"),
        ("s1", "s3", "thrust (3)"),
        ("s2", "o2", ""),
        ("s3", "o3", ""),
    ]


def test_the_digest_changes_with_the_drawing(drawings_by_path):
    assert digest(drawings_by_path[""]) == digest(str(drawings_by_path[""]))
    assert len({digest(text) for text in (*drawings_by_path.values(), drawings_by_path[""] + " ")}) == 3
