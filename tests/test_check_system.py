"""Tests that `check_system` accepts the systems of the package, and names the rule that a faulty system breaks."""

import functools
import math

import numpy as np
import pytest
from all_systems import FLEET_SYSTEMS, SENSOR_EXAMPLES
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem

from drake_quad.framework.broadcast import Broadcast
from drake_quad.framework.elementary import sqrt
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.framework.records import rows_layout
from drake_quad.framework.symbols import Symbol
from drake_quad.randomness.noise import NoiseSource
from drake_quad.testing import check_system

TWO_COMPONENTS = rows_layout(2)
ALL_RULES = ("names", "ports", "context", "vehicles", "numbers", "derivatives", "compiled")
# `check_system` varies the number of vehicles. This is impossible for a broadcast, whose input has one vehicle, and for
# a noise source, which has one vehicle per sample. Examples with parameters for exactly two vehicles are left out, too.
UNCHECKED_SYSTEMS = (Broadcast, NoiseSource)
EXAMPLES = [
    example
    for example in [*FLEET_SYSTEMS, *SENSOR_EXAMPLES]
    if example.system not in UNCHECKED_SYSTEMS and not any(np.ndim(number) for number in example.flat_parameters)
]


@pytest.mark.long
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.system.__name__)
def test_every_system_of_the_package_passes_check_system(example):
    """The rule "compiled" does not apply to systems with a continuous state or an optimisation problem."""
    rules = check_system(lambda n: example._replace(num_vehicles=n).make())
    assert rules in (ALL_RULES, ALL_RULES[:-1])
    assert (rules == ALL_RULES) == example.is_compiled


def system_with(law, **options):
    """Return the class of a system with input u and output y = law(u), which have two components each."""

    @fleet_system(float, AutoDiffXd)
    class CustomSystem(FleetSystem):
        def declare(self):
            self.output("y", law, self.input("u", layout=TWO_COMPONENTS), layout=TWO_COMPONENTS, **options)

    return CustomSystem


def doubled(u):
    return 2.0 * u[0], 2.0 * u[1]


def nan_for_some_inputs(u):
    return sqrt(u[0] - 1.0), u[1]


def different_with_derivatives(u):
    return u[0] * (1.0 if isinstance(u[0], Symbol | float) else 1.5), u[1]


class PlainSystem(LeafSystem):
    """System in plain Python whose output is y = law(u), where u is an array (2, N)."""

    def __init__(self, num_vehicles=1, law=np.sin, rows=2):
        super().__init__()
        self._count = num_vehicles
        self._law = law
        self._port = self.DeclareVectorInputPort("u", BasicVector(2 * num_vehicles))
        self.DeclareVectorOutputPort("y", BasicVector(rows * num_vehicles), self._write)

    def _write(self, context, output):
        output.SetFromVector(np.ravel(self._law(self._port.Eval(context).reshape(-1, self._count))))


class CountingSystem(PlainSystem):
    """System that breaks the rule "context": its output depends on how often it has been evaluated."""

    def __init__(self, num_vehicles=1):
        self._calls = 0
        super().__init__(num_vehicles, self._counted)

    def _counted(self, rows):
        self._calls += 1
        return rows + 1e-9 * self._calls


class RememberingSystem(PlainSystem):
    """System that breaks the rule "context": it stores each output outside the context, by the time."""

    def _write(self, context, output):
        if not hasattr(self, "_stored"):
            self._stored = {}
        values = np.ravel(self._port.Eval(context))
        output.SetFromVector(self._stored.setdefault(context.get_time(), values))


def test_check_system_accepts_compiled_systems_python_systems_and_diagrams():
    assert check_system(system_with(doubled)) == ALL_RULES
    assert check_system(PlainSystem) == ALL_RULES[:5]

    def two_in_series(num_vehicles, make_second=system_with(doubled)):
        builder = DiagramBuilder()
        makes = system_with(doubled), make_second
        first, second = (builder.AddSystem(make(num_vehicles=num_vehicles)) for make in makes)
        builder.Connect(first.get_output_port(), second.get_input_port())
        builder.ExportInput(first.get_input_port(), "u")
        builder.ExportOutput(second.get_output_port(), "y")
        return builder.Build()

    assert check_system(two_in_series) == ALL_RULES
    assert check_system(functools.partial(two_in_series, make_second=PlainSystem)) == ALL_RULES[:5]


def controller_with(*inputs, output="acceleration_command"):
    """Return a function from a number of vehicles to a controller in plain Python with the given port names."""

    def make(num_vehicles):
        system = LeafSystem()
        for name in inputs:
            system.DeclareVectorInputPort(name, BasicVector(12 * num_vehicles))
        size = 3 * num_vehicles
        system.DeclareVectorOutputPort(output, BasicVector(size), lambda _, output: output.SetFromVector([0.0] * size))
        return system

    return make


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (controller_with("measurment", "reference"), "called `measurment`; did you mean measurement[?]"),
        (controller_with("u"), "called `u`; they connect measurement, reference, reference_jerk, reference_snap"),
        (controller_with("reference", output="accel_command"), "called `accel_command`; did you mean acceleration_com"),
        (controller_with("stat", output="wnd"), "called `stat`; did you mean state[?]"),
        (controller_with("state", output="winds"), "called `winds`; did you mean wind[?]"),
    ],
)
def test_the_message_about_an_unknown_port_suggests_the_most_similar_name(make, words):
    with pytest.raises(AssertionError, match=f"^names: flights connect no port {words}"):
        check_system(make)


def test_port_names_that_resemble_no_signal_are_accepted():
    assert check_system(controller_with("position", output="estimate")) == ALL_RULES[:5]
    assert check_system(controller_with("measurement", output="error_rate")) == ALL_RULES[:5]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda n: PlainSystem(1), "ports: `u` has 2 elements for 3 vehicles, but must have 6"),
        (
            lambda n: PlainSystem(n, rows=n, law=lambda rows: rows[:1].repeat(n, axis=0)),
            "ports: `y` has 9 .* must have 3",
        ),
        (CountingSystem, "context: `y` differs by .* after other inputs"),
        (RememberingSystem, "context: `y` differs by .* after other inputs"),
        (
            lambda n: PlainSystem(n, law=lambda rows: rows - rows.mean(axis=1, keepdims=True)),
            "vehicles: `y` differs by",
        ),
        (
            lambda n: PlainSystem(n, law=lambda rows: rows.T.reshape(2, -1)),
            "vehicles: `y` differs by .* if vehicle 0 is",
        ),
        (system_with(nan_for_some_inputs), "numbers: `y` is NaN"),
        (lambda n: PlainSystem(n, law=lambda rows: np.where(rows > 0.5, math.nan, rows)), "numbers: `y` is NaN"),
        (system_with(different_with_derivatives), "derivatives: `y` differs by .* with AutoDiffXd"),
    ],
)
def test_the_message_names_the_rule_that_a_system_breaks(make, words):
    with pytest.raises(AssertionError, match=words):
        check_system(make)
