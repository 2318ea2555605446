"""Tests of the vector of a diagram's state."""

from typing import NamedTuple

import numpy as np
import pytest
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem

from drake_quad import build_tracking_diagram, load_scenario
from drake_quad.framework.fleet_system import FleetSystem, fleet_system
from drake_quad.framework.wiring import subsystem
from drake_quad.linear.context_vector import ContextVector, leaf_paths, port_rows, without_dots
from drake_quad.signals import Row


class Memory(LeafSystem):
    """System with two discrete groups, a continuous state and two groups of parameters."""

    def __init__(self, start):
        super().__init__()
        self.DeclareDiscreteState([start, start + 1.0])
        self.DeclareDiscreteState([start + 2.0])
        self.DeclareContinuousState(BasicVector([start + 3.0, start + 4.0]))
        self.DeclareNumericParameter(BasicVector([start + 5.0]))
        self.DeclareNumericParameter(BasicVector([start + 6.0, start + 7.0]))


class Pair(NamedTuple):
    x: Row
    y: Row


class Count(NamedTuple):
    number: Row


@fleet_system(float)
class NamedMemory(FleetSystem):
    """Fleet system with two named groups and parameters."""

    def declare(self, *, parameters=Count(0.0)):
        self.state("pd", lambda start: Pair(start.number, start.number + 1.0))
        self.state("count", lambda start: Count(start.number + 2.0))
        self.continuous_state(lambda start: Pair(start.number + 3.0, start.number + 4.0))
        self.parameter("gain", lambda start: Count(start.number + 5.0))
        self.parameter("offset", lambda start: Pair(start.number + 6.0, start.number + 7.0))


@pytest.fixture
def nested():
    """Return a diagram with the system "b", a subdiagram "inner" with "a", and a subdiagram "watcher" with "c"."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("b", Memory(100.0))
    for name, system in (("inner", ("a", NamedMemory(parameters=Count(200.0)))), ("watcher", ("c", Memory(300.0)))):
        part = DiagramBuilder()
        part.AddNamedSystem(*system)
        builder.AddNamedSystem(name, part.Build())
    return builder.Build()


def test_leaf_systems_are_found_by_path_without_excluded_subsystems(nested):
    assert set(leaf_paths(nested)) == {("b",), ("inner", "a"), ("watcher", "c")}
    assert set(leaf_paths(nested, excluded_systems=("watcher",))) == {("b",), ("inner", "a")}
    assert set(leaf_paths(nested, excluded_systems=("a", "b"))) == {("watcher", "c")}
    assert subsystem(nested, ("inner", "a")).get_name() == "a"
    assert subsystem(nested, ()) is nested


def test_elements_are_ordered_by_system_and_group(nested):
    layout = ContextVector(nested, excluded_systems=("watcher",))
    context = nested.CreateDefaultContext()
    assert layout.names == (
        *("b.group_0.0", "b.group_0.1", "b.group_1.0", "b.continuous.0", "b.continuous.1"),
        *("inner.a.pd.x", "inner.a.pd.y", "inner.a.count.number", "inner.a.continuous.x", "inner.a.continuous.y"),
    )
    np.testing.assert_array_equal(layout.read(nested, context), [*range(100, 105), *range(200, 205)])
    with_parameters = ContextVector(nested, excluded_systems=("watcher", "inner"), parameters=True)
    assert with_parameters.names == (
        *layout.names[:5],
        *("b.parameter_0.0", "b.parameter_1.0", "b.parameter_1.1"),
    )
    np.testing.assert_array_equal(with_parameters.read(nested, context), range(100, 108))
    named = ContextVector(nested, excluded_systems=("watcher", "b"), parameters=True)
    assert named.names == (
        *layout.names[5:],
        *("inner.a.gain.number", "inner.a.offset.x", "inner.a.offset.y"),
    )
    np.testing.assert_array_equal(named.read(nested, context), range(200, 208))


def test_element_names_of_a_fleet_contain_the_vehicle_number():
    builder = DiagramBuilder()
    builder.AddNamedSystem("a", NamedMemory(num_vehicles=2, parameters=Count(np.array([10.0, 20.0]))))
    diagram = builder.Build()
    layout = ContextVector(diagram)
    assert layout.names == (
        *("a.pd.x.0", "a.pd.x.1", "a.pd.y.0", "a.pd.y.1", "a.count.number.0", "a.count.number.1"),
        *("a.continuous.x.0", "a.continuous.x.1", "a.continuous.y.0", "a.continuous.y.1"),
    )
    numbers_read = layout.read(diagram, diagram.CreateDefaultContext())
    np.testing.assert_array_equal(numbers_read, [start + row for row in range(5) for start in (10.0, 20.0)])


def test_written_values_are_read_back_and_nothing_else_changes(nested):
    layout = ContextVector(nested, excluded_systems=("b",), parameters=True)
    full_vector = ContextVector(nested, parameters=True)
    context = nested.CreateDefaultContext()
    before = full_vector.read(nested, context)
    layout.write(nested, context, np.arange(16.0))
    np.testing.assert_array_equal(layout.read(nested, context), np.arange(16.0))
    np.testing.assert_array_equal(full_vector.read(nested, context), [*before[:8], *range(16)])


def test_the_vector_of_a_diagram_without_state_is_empty(nested):
    layout = ContextVector(nested, excluded_systems=("b", "inner", "watcher"))
    assert layout.read(nested, nested.CreateDefaultContext()).shape == (0,)


def test_port_components_are_named_after_the_fields_of_the_signal_or_numbered():
    assert port_rows("state", 12)[:4] == ("state.x", "state.y", "state.z", "state.roll")
    assert port_rows("wrench", 4)[0] == "wrench.thrust"
    assert port_rows("statement", 1) == ("statement.0",)
    assert port_rows("weather", 2) == ("weather.0", "weather.1")
    assert without_dots(["a.b.c", "d"]) == ["a_b_c", "d"]


def test_the_layout_is_the_same_in_every_scalar_type():
    """Conversion preserves names but not the order of systems, so the layout sorts systems by name."""
    diagram = build_tracking_diagram(load_scenario("diagrams/hover.yaml"))
    layout, converted = ContextVector(diagram, parameters=True), diagram.ToAutoDiffXd()
    context, root = diagram.CreateDefaultContext(), converted.CreateDefaultContext()
    layout.write(diagram, context, np.arange(float(len(layout.names))))
    root.SetTimeStateAndParametersFrom(context)
    parameters = layout.read(converted, root)
    assert [number.value() for number in parameters] == [*range(len(layout.names))]
    layout.write(converted, root, parameters[::-1])
    assert [number.value() for number in layout.read(converted, root)] == [*range(len(layout.names))][::-1]
