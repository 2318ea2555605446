"""Tests of compiled diagrams with all types of declarations and with Drake's systems."""

import re
from typing import NamedTuple

import numpy as np
import pytest
from compiled_comparison import assert_alike
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import (
    Adder,
    ConstantValueSource,
    ConstantVectorSource,
    Demultiplexer,
    Gain,
    Multiplexer,
    PassThrough,
    Sine,
    TrajectorySource,
    ZeroOrderHold,
)
from pydrake.trajectories import PiecewisePolynomial

from drake_quad import InputError
from drake_quad.compilation.compile_diagram import compile_diagram, compiled_part
from drake_quad.framework.broadcast import Broadcast
from drake_quad.framework.elementary import exp, where
from drake_quad.framework.fleet_system import TIME, CurrentTick, FleetSystem, fleet_system
from drake_quad.framework.records import layout_of
from drake_quad.laboratory.wind.wind import SteadyWind
from drake_quad.signals import Row, Wind


class Pair(NamedTuple):
    a: Row
    b: Row


PAIR_LAYOUT = layout_of(Pair)


def counted(memory, inputs, by, time, tick):
    return Pair(memory.a + by * inputs.a + time, inputs.b + tick.pair + where(tick.second, 0.5, 0.0))


def initial(memory, by, time):
    return Pair(memory.a + exp(by), memory.b + time + 1.0)


def updated_pair(memory, inputs, by):
    return Pair(memory.a - inputs.b, by * memory.b)


def after_tick(steps, memory):
    return Pair(steps.a + 1.0, steps.b + memory.a)


@fleet_system(float)
class Counter(FleetSystem):
    """System with every type of declaration that a FleetSystem supports."""

    def declare(self, *, period=0.02, step=0.01, at_start=False, tick=0.02, parameters=0.25):
        inputs = self.input("inputs", layout=PAIR_LAYOUT, absent=Pair(0.1, 0.2))
        by = self.parameter("by", lambda by: Pair(by, 2.0 * by))
        memory = self.state("memory", lambda by: Pair(by, 1.0))
        steps = self.state("steps", lambda _: Pair(0.0, 0.5))
        self.initialize(lambda memory, by, time: initial(memory, by.a, time), memory, by, TIME, writes=[memory])
        reads = memory, inputs, by, TIME, CurrentTick(tick)
        self.update(
            period,
            lambda m, inputs, by, *time_and_tick: counted(m, inputs, by.b, *time_and_tick),
            *reads,
            writes=[memory],
        )
        self.update(step, after_tick, steps, memory, writes=[steps], unrestricted=True, at_start=at_start)
        self.output("mixed", lambda m, s, by: updated_pair(m, s, by.a), memory, inputs, by, layout=PAIR_LAYOUT)
        self.state_output(memory)
        self.state_output(steps)


def uncompiled_and_compiled(connect, **options):
    """Return the signals of an uncompiled and a compiled diagram, given a function that adds systems to a builder."""
    builder = DiagramBuilder()
    for name, port in connect(builder).items():
        builder.ExportOutput(port, name)
    diagram = builder.Build()
    diagram.set_name("small")
    return diagram, compile_diagram(diagram, **options)


def assert_same_ports(uncompiled, compiled, times=(0.0, 0.007, 0.01, 0.02, 0.033, 0.04, 0.041, 0.1)):
    simulators = [Simulator(diagram) for diagram in (uncompiled, compiled)]
    for simulator in simulators:
        simulator.Initialize()
    for time in times:
        for simulator in simulators:
            simulator.AdvanceTo(time)
        for number in range(uncompiled.num_output_ports()):
            expected, actual = (
                simulator.get_system().get_output_port(number).Eval(simulator.get_context()) for simulator in simulators
            )
            assert_alike(actual, expected, f"{uncompiled.get_output_port(number).get_name()} at {time} s")


def counters(builder, n, **structure):
    """Connect two counters in a loop with a zero-order hold, and return the exported ports."""
    one = builder.AddNamedSystem("one", Counter(num_vehicles=n, **structure))
    two = builder.AddNamedSystem("two", Counter(num_vehicles=n, parameters=0.5 + np.arange(n) if n > 1 else 0.7))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.04, 2 * n))
    builder.Connect(one.GetOutputPort("mixed"), two.GetInputPort("inputs"))
    builder.Connect(two.GetOutputPort("mixed"), hold.get_input_port())
    builder.Connect(hold.get_output_port(), one.GetInputPort("inputs"))
    return {
        f"{name}.{port}": system.GetOutputPort(port)
        for name, system in (("one", one), ("two", two))
        for port in ("mixed", "memory", "steps")
    }


# Keyword arguments of `Counter`.
COUNTER_STRUCTURES = [
    {},
    {"at_start": True},  # adds an unrestricted update at time zero
    {"period": 0.03, "tick": 0.03},  # period of the discrete update and of its ticks, s
    {"step": 0.02},  # period of the unrestricted update, s
]


@pytest.mark.parametrize("structure", COUNTER_STRUCTURES)
@pytest.mark.parametrize("n", [1, 3])
def test_every_type_of_declaration_can_be_compiled(n, structure):
    """The formulas use ticks and the time. There are initial, periodic and unrestricted updates."""
    assert_same_ports(*uncompiled_and_compiled(lambda builder: counters(builder, n, **structure)))


@pytest.mark.parametrize("tick", [None, 0.02, 0.01])
@pytest.mark.parametrize("structure", COUNTER_STRUCTURES)
def test_events_of_several_ticks_give_the_results_of_single_ticks(structure, tick):
    """Some of the diagrams have an unrestricted update at time zero, before all other updates.

    If a tick is shorter than the longest period, several events take turns.
    """
    logs = []
    for ticks in (None, 5):
        _, compiled = uncompiled_and_compiled(
            lambda builder: counters(builder, 3, **structure), ticks=ticks, tick=tick, record=True
        )
        simulator = Simulator(compiled)
        part = compiled_part(compiled)
        simulator.AdvanceTo(10.5 * part.tick)
        logs.append(part.log(part.GetMyContextFromRoot(simulator.get_context())))
    for name, values in logs[0].items():
        assert len(values) == 11
        assert_alike(logs[1][name][:11], values, name)


def test_shared_values_are_computed_only_for_the_instants_of_an_event(monkeypatch):
    """The two events of a cycle take turns, so each of them has every second tick."""
    _, compiled = uncompiled_and_compiled(lambda builder: counters(builder, 2), ticks=1, tick=0.02)
    part, times = compiled_part(compiled), {}
    table = part.program.table

    def recorded_table(shared, event_times):
        times.setdefault(id(shared), []).append(event_times[:, 0])
        return table(shared, event_times)

    monkeypatch.setattr(part.program, "table", recorded_table)
    Simulator(compiled).AdvanceTo(0.2)
    # The first table belongs to the initialization.
    _, *recurring = [each for (each,) in times.values()]
    assert [each[:3].tolist() for each in recurring] == [[0.0, 0.04, 0.08], [0.02, 0.06, 0.1]]


@pytest.mark.parametrize("tick", [0.005, 0.015, 0.01, 0.04])
def test_ticks_can_have_any_period(tick):
    """The tick is shorter or longer than the periods of all events."""
    assert_same_ports(*uncompiled_and_compiled(lambda builder: counters(builder, 2, tick=tick)))


TRAJECTORY = PiecewisePolynomial.FirstOrderHold([0.0, 0.05, 0.1], [[0.0, 1.0, 0.5], [2.0, 1.0, 3.0]])


def drake_systems(builder, n):
    """Connect all supported systems of Drake to a counter."""
    counter = builder.AddNamedSystem("counter", Counter(num_vehicles=n))
    memory, steps = counter.GetOutputPort("memory"), counter.GetOutputPort("steps")
    constant = builder.AddNamedSystem("constant", ConstantVectorSource(np.arange(2.0 * n) - 1.0))
    adder = builder.AddNamedSystem("adder", Adder(3, 2 * n))
    gain = builder.AddNamedSystem("gain", Gain(np.repeat([2.0, -0.3], n)))
    passed = builder.AddNamedSystem("passed", PassThrough(2 * n))
    both = builder.AddNamedSystem("both", Multiplexer([2 * n, 2 * n]))
    parts = builder.AddNamedSystem("parts", Demultiplexer([n, 3 * n]))
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.02, 3 * n))
    reference = builder.AddNamedSystem("reference", TrajectorySource(TRAJECTORY))
    tripled = builder.AddNamedSystem("tripled", Gain(3.0, 2))
    fleet = builder.AddNamedSystem("fleet", Broadcast(num_vehicles=n, num_rows=2))
    builder.Connect(reference.get_output_port(), tripled.get_input_port())
    builder.Connect(tripled.get_output_port(), fleet.get_input_port())
    for number, port in enumerate((memory, constant.get_output_port(), fleet.get_output_port())):
        builder.Connect(port, adder.get_input_port(number))
    for source, target in ((adder, gain), (gain, passed), (passed, counter)):
        builder.Connect(source.get_output_port(), target.get_input_port())
    builder.Connect(steps, both.get_input_port(0))
    builder.Connect(gain.get_output_port(), both.get_input_port(1))
    builder.Connect(both.get_output_port(), parts.get_input_port())
    builder.Connect(parts.get_output_port(1), hold.get_input_port())
    ports = {"sum": adder, "gain": gain, "passed": passed, "both": both, "held": hold, "reference": fleet}
    return {
        **{name: system.get_output_port() for name, system in ports.items()},
        "part": parts.get_output_port(0),
        "rest": parts.get_output_port(1),
    }


@pytest.mark.parametrize("n", [1, 3])
def test_supported_drake_systems_can_be_compiled(n):
    uncompiled, compiled = uncompiled_and_compiled(lambda builder: drake_systems(builder, n))
    assert list(compiled.GetSystems()) == [compiled_part(compiled)]
    assert_same_ports(uncompiled, compiled)


def refused(connect):
    with pytest.raises(InputError) as caught:
        uncompiled_and_compiled(connect, record=True)
    return str(caught.value)


def test_a_gain_that_differs_between_vehicles_is_refused():
    def connect(builder):
        counter = builder.AddNamedSystem("counter", Counter(num_vehicles=2))
        gain = builder.AddNamedSystem("gain", Gain(np.array([1.0, 2.0, 3.0, 4.0])))
        builder.Connect(counter.GetOutputPort("memory"), gain.get_input_port())
        return {"gain": gain.get_output_port()}

    assert refused(connect) == "gain cannot be compiled: its gain differs from vehicle to vehicle"


def test_a_zero_order_hold_with_an_offset_is_refused():
    def connect(builder):
        counter = builder.AddNamedSystem("counter", Counter())
        hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.02, 2, 0.005))
        builder.Connect(counter.GetOutputPort("memory"), hold.get_input_port())
        return {"held": hold.get_output_port()}

    assert refused(connect).startswith("hold, a ZeroOrderHold, cannot be compiled: ")


def test_an_output_with_only_some_vehicles_of_the_fleet_is_refused():
    def connect(builder):
        counter = builder.AddNamedSystem("counter", Counter(num_vehicles=2))
        parts = builder.AddNamedSystem("parts", Demultiplexer(4, 1))
        builder.Connect(counter.GetOutputPort("memory"), parts.get_input_port())
        return {"first": parts.get_output_port(0)}

    assert refused(connect) == "parts cannot be compiled: an output contains only some vehicles of the fleet"


class HasTextPort(LeafSystem):
    """System with a vector-valued port and a port for text."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort("vector", 1, lambda context, output: None)
        self.DeclareAbstractOutputPort("text", lambda: AbstractValue.Make(""), lambda context, output: None)


@pytest.mark.parametrize(
    "make", [lambda: ConstantValueSource(AbstractValue.Make("")), HasTextPort], ids=["all", "some"]
)
def test_a_port_that_is_not_vector_valued_is_refused(make):
    def connect(builder):
        builder.AddNamedSystem("counter", Counter())
        return {"text": builder.AddNamedSystem("text", make()).get_output_port(0)}

    assert re.match(r"text, a \w+, cannot be compiled or combined with compiled systems: ", refused(connect))


@fleet_system(float)
class DrakeMethodCounter(FleetSystem):
    """System with an update that is declared by a method of Drake instead of a formula."""

    def declare(self, event):
        self.memory = self.state("memory", lambda _: Pair(1.0, 2.0))
        self.state_output(self.memory)
        if event == "Periodic":
            self.DeclarePeriodicDiscreteUpdateEvent(0.02, 0.0, self.change)
        elif event == "PerStep":
            self.DeclarePerStepDiscreteUpdateEvent(self.change)
        else:
            self.DeclareInitializationDiscreteUpdateEvent(self.change)

    def change(self, context, values):
        """Add one to the state."""
        values.get_mutable_vector(0).SetFromVector(context.get_discrete_state(0).CopyToVector() + 1.0)


@pytest.mark.parametrize("event", ["Periodic", "PerStep", "Initialization"])
def test_a_system_with_an_event_that_is_declared_by_a_method_of_drake_is_refused(event):
    def connect(builder):
        builder.AddNamedSystem("counter", Counter())
        return {"memory": builder.AddNamedSystem("own", DrakeMethodCounter(event=event)).get_output_port()}

    assert refused(connect).startswith(
        "own, a DrakeMethodCounter, cannot be compiled: it declares ports, states or events directly with"
        " Drake's methods. It "
    )


@pytest.mark.parametrize(
    ("make", "part"),
    [
        (None, "the input port u"),
        (lambda: ConstantVectorSource(np.ones(3)), "parameters 0 of source"),
        (lambda: Sine(np.ones(3), np.ones(3), np.ones(3), True), "output 0 of source"),
    ],
    ids=["input", "parameter", "output"],
)
def test_a_system_for_another_number_of_vehicles_is_refused(make, part):
    def connect(builder):
        builder.AddNamedSystem("counter", Counter(num_vehicles=2))
        passed = builder.AddNamedSystem("passed", PassThrough(3))
        if make is None:
            builder.ExportInput(passed.get_input_port(), "u")
        else:
            port = builder.AddNamedSystem("source", make()).get_output_port(0)
            builder.Connect(port, passed.get_input_port())
        return {"passed": passed.get_output_port()}

    assert refused(connect) == f"{part} cannot be compiled: it has 3 elements, not a multiple of 2 vehicles"


def test_a_diagram_without_periodic_events_is_refused():
    def connect(builder):
        wind = builder.AddNamedSystem("steady", SteadyWind(parameters=Wind(1.0, 2.0, 3.0)))
        return {"wind": wind.get_output_port()}

    assert refused(connect) == "small cannot be compiled: it has no periodic events"


def test_a_diagram_without_a_fleet_or_with_fleets_of_different_sizes_is_refused():
    def two(builder):
        return {
            f"{n}": builder.AddNamedSystem(f"counter_{n}", Counter(num_vehicles=n)).GetOutputPort("memory")
            for n in (2, 3)
        }

    def none(builder):
        return {"value": builder.AddNamedSystem("constant", ConstantVectorSource([1.0])).get_output_port()}

    assert refused(two) == "small cannot be compiled: its systems have different numbers of vehicles: [2, 3]"
    assert refused(none) == "small cannot be compiled: it contains no FleetSystem"


@pytest.mark.parametrize(
    ("period", "sentence"),
    [
        (0.015, "hold cannot be compiled: its period, 0.015 s, is not a multiple of 0.01 s"),
        (0.67, "small cannot be compiled: the least common multiple of its periods is too long, 1.34 s"),
    ],
)
def test_periods_without_a_short_common_multiple_are_refused(period, sentence):
    def connect(builder):
        counter = builder.AddNamedSystem("counter", Counter())
        hold = builder.AddNamedSystem("hold", ZeroOrderHold(period, 2))
        builder.Connect(counter.GetOutputPort("memory"), hold.get_input_port())
        return {"held": hold.get_output_port()}

    assert refused(connect) == sentence


def test_a_tick_that_does_not_divide_the_least_common_multiple_of_the_periods_is_refused():
    with pytest.raises(
        InputError, match=r"^small cannot be compiled with ticks of 0.03 s: .* multiple of 0.01 s, .* divide 0.04 s, "
    ):
        uncompiled_and_compiled(lambda builder: counters(builder, 1), tick=0.03)
