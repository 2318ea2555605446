"""Tests that a compiled diagram has the same state and outputs as the original diagram at any time."""

import numpy as np
import pytest
from all_systems import DIAGRAMS
from compiled_comparison import assert_alike
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, EventStatus
from pydrake.systems.primitives import Sine, VectorLogSink, ZeroOrderHold

from drake_quad import InputError, build_tracking_diagram, load_scenario
from drake_quad.compilation.compile_diagram import compile_diagram, compiled_part
from drake_quad.flight.mission import plan_route
from drake_quad.framework.wiring import subsystem
from drake_quad.laboratory.laboratory import build_laboratory
from drake_quad.laboratory.wind.wind import build_wind


@pytest.fixture(scope="module")
def figure_eight(diagrams):
    """Return the figure-eight scenario and its plan."""
    scenario = load_scenario(diagrams / "figure_eight.yaml")
    return scenario, plan_route(scenario)


@pytest.fixture(scope="module")
def uncompiled(figure_eight):
    scenario, plan = figure_eight
    return build_tracking_diagram(scenario, plan=plan)


@pytest.fixture(scope="module")
def compiled(uncompiled):
    """Return the compiled diagram with a separate event for each tick."""
    return compile_diagram(uncompiled)


@pytest.fixture(scope="module")
def strided(uncompiled):
    """Return a compiled diagram that records its outputs and whose events simulate ten ticks each."""
    return compile_diagram(uncompiled, ticks=10, record=True)


def compiled_system_of(simulator):
    """Return the compiled system of a simulator's diagram, and its context."""
    system = compiled_part(simulator.get_system())
    return system, system.GetMyMutableContextFromRoot(simulator.get_mutable_context())


def state_of(context):
    groups = [context.get_discrete_state(i).CopyToVector() for i in range(context.num_discrete_state_groups())]
    return np.concatenate(groups)


def names_of(diagram):
    inputs = [diagram.get_input_port(i).get_name() for i in range(diagram.num_input_ports())]
    return inputs, [diagram.get_output_port(i).get_name() for i in range(diagram.num_output_ports())]


def assert_equal_at(uncompiled, compiled, context):
    """Assert that two simulators have equal states and outputs; `context` is a context of the original diagram."""
    diagram = uncompiled.get_system()
    system, part = compiled_system_of(compiled)
    context.SetTime(uncompiled.get_context().get_time())
    system.write(part, context)
    assert_alike(state_of(context), state_of(uncompiled.get_context()), "state")
    for name in names_of(diagram)[1]:
        expected = diagram.GetOutputPort(name).Eval(uncompiled.get_context())
        assert_alike(compiled.get_system().GetOutputPort(name).Eval(compiled.get_context()), expected, name)


# Each scenario consists of the name of a controller, the number of vehicles, and overrides.
COMPLETE_SCENARIOS = [
    ("pid", 1, ()),
    ("pd_t1fnn", 2, ("laboratory.motion_capture.period=0.02", "vehicle.time_step=0.005")),
]


@pytest.mark.long
@pytest.mark.parametrize(("name", "n", "overrides"), COMPLETE_SCENARIOS)
def test_state_and_outputs_agree_with_the_original_diagram_at_and_between_all_instants(asymmetric, name, n, overrides):
    uncompiled = build_tracking_diagram(asymmetric(name, *overrides), n)
    compiled = compile_diagram(uncompiled)
    assert compiled.get_name() == uncompiled.get_name()
    assert names_of(compiled) == names_of(uncompiled)
    simulators, context = [Simulator(uncompiled), Simulator(compiled)], uncompiled.CreateDefaultContext()
    for simulator in simulators:
        simulator.Initialize()
    for step in range(25):
        for simulator in simulators:
            simulator.AdvanceTo(0.005 * step)
        assert_equal_at(*simulators, context)
    for simulator in simulators:
        simulator.AdvancePendingEvents()
    assert_equal_at(*simulators, context)


def larger_diagram(laboratory):
    """Return a diagram with a laboratory for two vehicles; Drake's systems supply its inputs."""
    builder = DiagramBuilder()
    builder.AddNamedSystem("laboratory", laboratory)
    heavy = np.repeat([0.5, 0.01, 0.02, 0.005], 2)
    wrench = builder.AddNamedSystem("wrench", Sine(heavy, 3.0 + heavy, 0.3 + np.arange(8.0), True))
    crashed = builder.AddNamedSystem("crashed", Sine(np.zeros(2), np.ones(2), np.zeros(2), True))
    builder.Connect(wrench.get_output_port(0), laboratory.GetInputPort("wrench"))
    builder.Connect(crashed.get_output_port(0), laboratory.GetInputPort("crashed"))
    for name in ("measurement", "rotor_speed_command", "wind"):
        port = laboratory.GetOutputPort(name)
        hold = builder.AddNamedSystem(f"hold_{name}", ZeroOrderHold(0.02, port.size()))
        logs = [VectorLogSink(port.size(), 0.015), VectorLogSink(port.size(), 0.01)]
        for number, (log, source) in enumerate(zip(logs, (port, hold.get_output_port()), strict=True)):
            builder.Connect(source, builder.AddNamedSystem(f"log_{number}_{name}", log).get_input_port())
        builder.Connect(port, hold.get_input_port())
    return builder.Build()


def make_of(builder):
    return next(make for function, make in DIAGRAMS if function is builder)


@pytest.mark.long
def test_a_compiled_diagram_can_replace_a_subsystem_of_a_larger_one():
    """The logs of both diagrams are equal, including the initial wind."""
    logs = []
    for laboratory in (make_of(build_laboratory)(), compile_diagram(make_of(build_laboratory)())):
        diagram = larger_diagram(laboratory)
        simulator = Simulator(diagram)
        simulator.AdvanceTo(0.3)
        sinks = {system.get_name(): system for system in diagram.GetSystems() if isinstance(system, VectorLogSink)}
        logs.append({name: sink.FindLog(simulator.get_context()).data() for name, sink in sinks.items()})
    assert len(logs[0]) == 6
    for name, expected in logs[0].items():
        assert expected.shape[1] > 20
        assert_alike(logs[1][name], expected, name)


@pytest.mark.long
def test_the_compiled_diagram_has_the_inputs_of_the_original():
    """The order of the ports does not depend on which input is used first."""
    for function in (build_laboratory, build_wind):
        diagram = make_of(function)()
        compiled = compile_diagram(diagram)
        assert names_of(compiled) == names_of(diagram)
        for number in range(diagram.num_input_ports()):
            assert compiled.get_input_port(number).size() == diagram.get_input_port(number).size()


def test_state_and_parameters_are_copied_from_and_to_a_context_of_the_diagram(uncompiled, compiled):
    system = compiled_part(compiled)
    contexts = [uncompiled.CreateDefaultContext() for _ in range(2)]
    part = system.CreateDefaultContext()
    vehicle = subsystem(uncompiled, ("laboratory", "vehicle"))
    vehicle_context = vehicle.GetMyMutableContextFromRoot(contexts[0])
    vehicle.set_state(vehicle_context, "state", vehicle.get_state(vehicle_context, "state")._replace(x=0.7, r=-0.2))
    rng = np.random.default_rng(0)
    pd = subsystem(uncompiled, ("control", "position", "pd"))
    gains = pd.GetMyMutableContextFromRoot(contexts[0]).get_mutable_numeric_parameter(0)
    gains.SetFromVector(rng.uniform(1.0, 2.0, gains.size()))
    system.read(part, contexts[0])
    system.write(part, contexts[1])
    np.testing.assert_array_equal(state_of(contexts[1]), state_of(contexts[0]))
    for i in range(contexts[0].num_numeric_parameter_groups()):
        actual, expected = (context.get_numeric_parameter(i).CopyToVector() for context in reversed(contexts))
        np.testing.assert_array_equal(actual, expected)
    assert system.get_state(part, "laboratory.vehicle", "state") == vehicle.get_state(vehicle_context, "state")
    own_pd = pd.GetMyContextFromRoot(contexts[0])
    assert system.get_parameter(part, "control.position.pd", "gains") == pd.get_parameter(own_pd, "gains")


@pytest.mark.slow
def test_a_simulation_can_continue_from_any_state_with_any_parameters(uncompiled, compiled):
    """The test starts with a moving, heavier vehicle and lower gains."""
    simulators = [Simulator(uncompiled), Simulator(compiled)]
    context = simulators[0].get_mutable_context()
    vehicle, pd = (subsystem(uncompiled, path) for path in (("laboratory", "vehicle"), ("control", "position", "pd")))
    vehicle_context = vehicle.GetMyMutableContextFromRoot(context)
    vehicle.set_state(
        vehicle_context, "state", vehicle.get_state(vehicle_context, "state")._replace(x=0.2, v_y=0.3, yaw=0.4)
    )
    gains = pd.GetMyMutableContextFromRoot(context).get_mutable_numeric_parameter(0)
    gains.SetFromVector(0.8 * gains.CopyToVector())
    system, part = compiled_system_of(simulators[1])
    system.read(part, context)
    for time in (0.0, 0.1, 0.203):
        for simulator in simulators:
            simulator.AdvanceTo(time)
        assert_equal_at(*simulators, uncompiled.CreateDefaultContext())
    assert system.get_state(part, "laboratory.vehicle", "state").y > 0.02


def test_a_state_of_a_fleet_has_one_array_for_each_component(figure_eight):
    scenario, plan = figure_eight
    uncompiled = build_tracking_diagram(scenario, 3, plan=plan)
    system = compiled_part(compile_diagram(uncompiled, ticks=1))
    actual = system.get_state(system.CreateDefaultContext(), "laboratory.vehicle", "rotor_speed")
    vehicle = subsystem(uncompiled, ("laboratory", "vehicle"))
    expected = vehicle.get_state(vehicle.CreateDefaultContext(), "rotor_speed")
    assert expected[0].shape == (3,)
    np.testing.assert_array_equal(actual, expected)


def test_the_returned_state_is_a_copy(compiled):
    system = compiled_part(compiled)
    context = system.CreateDefaultContext()
    before = system.get_state(context, "laboratory.vehicle", "rotor_speed")
    context.get_mutable_discrete_state(0).SetFromVector(np.full(context.get_discrete_state(0).size(), 7.0))
    assert before != system.get_state(context, "laboratory.vehicle", "rotor_speed")
    assert before[0] > 100.0


@pytest.mark.parametrize("path", ["laboratory.nobody", "reference.trajectory", "laboratory"])
def test_reading_the_state_of_an_uncompiled_system_is_refused(compiled, path):
    system = compiled_part(compiled)
    context = system.CreateDefaultContext()
    for ask in (system.get_state, system.get_parameter):
        with pytest.raises(
            KeyError, match=f"{path} is not a compiled system; the compiled systems are .*laboratory.vehicle"
        ):
            ask(context, path, "state")


@pytest.mark.slow
def test_the_monitor_of_the_simulator_of_drake_observes_the_same_flight(uncompiled, compiled):
    """With the uncompiled and the compiled diagram, the monitor is called at equal times with equal states."""
    observed = []
    for diagram in (uncompiled, compiled):
        simulator = Simulator(diagram)
        states = []

        def observe(root, diagram=diagram, states=states):
            state = diagram.GetOutputPort("state").Eval(root)
            states.append([root.get_time(), *state])
            if root.get_time() > 0.175:
                return EventStatus.ReachedTermination(diagram, "far enough")
            return EventStatus.DidNothing()

        simulator.set_monitor(observe)
        simulator.AdvanceTo(1.0)
        observed.append(states)
    assert len(observed[0]) > 15
    assert_alike(observed[1], observed[0])


@pytest.mark.slow
@pytest.mark.parametrize("last", [0.0, 0.1, 0.2, 0.21])
def test_no_event_starts_after_the_end_of_the_simulation(strided, last):
    """An event that starts before or at the end of the simulation is simulated with all of its ticks."""
    simulators = [Simulator(strided) for _ in range(2)]
    system, part = compiled_system_of(simulators[0])
    system.set_end(part, last)
    logs = []
    for simulator in simulators:
        simulator.AdvanceTo(0.5)
        compiled_system, context = compiled_system_of(simulator)
        logs.append(compiled_system.log(context))
    ticks = round(last / 0.02 + 0.25) + 1 if last != 0.21 else 11
    assert all(len(values) == ticks for values in logs[0].values())
    assert all(len(values) == 30 for values in logs[1].values())
    for name, values in logs[0].items():
        np.testing.assert_array_equal(values, logs[1][name][:ticks])


def test_nothing_is_recorded_before_the_first_tick(strided):
    system, context = compiled_system_of(Simulator(strided))
    assert {name: values.shape for name, values in system.log(context).items()} == {
        name: (0, strided.GetOutputPort(name).size()) for name in names_of(strided)[1]
    }


def test_a_simulation_cannot_begin_between_two_events_if_each_event_simulates_several_ticks(strided):
    simulator = Simulator(strided)
    simulator.get_mutable_context().SetTime(0.1)
    with pytest.raises(InputError, match=r"cannot begin at 0.1 s, .* 10 ticks and .* 0.2 s apart"):
        simulator.AdvanceTo(0.3)
    simulator.get_mutable_context().SetTime(0.4)
    simulator.Initialize()


@pytest.mark.slow
def test_recorded_outputs_have_the_values_before_the_discrete_updates(uncompiled, strided, compiled):
    """Recorded values start at time zero, and do not depend on the number of ticks that an event simulates."""
    with_single_ticks = compile_diagram(uncompiled, record=True)
    logs = []
    for diagram in (strided, with_single_ticks):
        simulator = Simulator(diagram)
        simulator.AdvanceTo(0.39)
        system, part = compiled_system_of(simulator)
        assert system.tick == 0.02
        logs.append(system.log(part))
    assert logs[0].keys() == logs[1].keys() == set(names_of(uncompiled)[1])
    for name, values in logs[1].items():
        assert len(values) == 20
        np.testing.assert_array_equal(logs[0][name], values)
    # Between two ticks, all outputs keep the values of the first tick, except those of the moving vehicle.
    simulator = Simulator(uncompiled)
    simulator.AdvanceTo(0.3)
    assert_alike(logs[1]["wrench"][15], uncompiled.GetOutputPort("wrench").Eval(simulator.get_context()))


@pytest.mark.slow
def test_contexts_of_one_compiled_diagram_are_independent(strided):
    """Each simulation records its own outputs, and a cloned context continues independently."""
    simulators = [Simulator(strided) for _ in range(2)]
    for simulator, time in zip(simulators, (0.19, 0.39), strict=True):
        simulator.AdvanceTo(time)
    clone = simulators[0].get_context().Clone()
    Simulator(strided, clone)
    lengths = [
        len(compiled_system_of(simulator)[0].log(compiled_system_of(simulator)[1])["state"]) for simulator in simulators
    ]
    assert lengths == [10, 20]


REFUSED_SCENARIOS = [
    (
        ("vehicle.time_step=0",),
        {},
        r"^laboratory.vehicle, a Quadrotor, cannot be compiled: its state is continuous. ",
    ),
    (
        (),
        {"record": True},
        r"^recorder.log, a VectorLogSink\w*, cannot be compiled: it has no output ports, and its effect",
    ),
    (
        ("laboratory.motion_capture.position_noise=0.001",),
        {"drake_random": True},
        r"^laboratory.random_motion_capture.camera_noise, a RandomSource\w*, cannot be compiled: only .* a state$",
    ),
]


@pytest.mark.parametrize(("overrides", "options", "sentence"), REFUSED_SCENARIOS)
def test_the_message_about_a_system_that_cannot_be_compiled_names_the_system(
    diagrams, figure_eight, overrides, options, sentence
):
    scenario = load_scenario(diagrams / "figure_eight.yaml", overrides)
    uncompiled = build_tracking_diagram(scenario, plan=figure_eight[1], **options)
    with pytest.raises(InputError, match=sentence):
        compile_diagram(uncompiled)
