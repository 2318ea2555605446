"""Tests of diagrams that contain compiled and uncompiled systems, by comparison with uncompiled diagrams."""

import numpy as np
import pytest
from compiled_comparison import assert_alike, assert_flights_alike, assert_metrics_alike
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Adder, DiscreteTimeDelay, FirstOrderLowPassFilter, ZeroOrderHold

from drake_quad import InputError, build_tracking_diagram, load_scenario, simulate
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.compilation.compile_diagram import as_compilable, compile_diagram, compiled_part
from drake_quad.compilation.placeholder import SystemPlaceholder
from drake_quad.control.position import PdGains, ProportionalDerivative, build_position_controller
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.laboratory.wind.wind import SteadyWind
from drake_quad.signals import Wind


@pytest.fixture(scope="module")
def scenario(diagrams):
    """Return a scenario with the first 0.5 s of the figure eight, in steady wind."""
    wind = "laboratory.wind=[{kind: steady, velocity: [1.0, -0.5, 0.2]}]"
    return load_scenario(diagrams / "figure_eight.yaml", ["duration=0.5", "vehicle.linear_drag=0.2", wind])


@pytest.fixture(scope="module")
def plan(scenario):
    return plan_route(scenario)


class UserPd(LeafSystem):
    """User-defined PD for N vehicles in plain Python."""

    def __init__(self, num_vehicles=1):
        super().__init__()
        self._num_vehicles = num_vehicles
        self._measurement = self.DeclareVectorInputPort("measurement", 12 * num_vehicles)
        self._reference = self.DeclareVectorInputPort("reference", 11 * num_vehicles)
        self.DeclareVectorOutputPort("acceleration_command", 3 * num_vehicles, self._show)

    def error(self, context):
        """Return the position errors (3 N,)."""
        return (
            self._reference.Eval(context)[: 3 * self._num_vehicles]
            - self._measurement.Eval(context)[: 3 * self._num_vehicles]
        )

    def pd(self, context):
        r, x = (port.Eval(context).reshape(-1, self._num_vehicles) for port in (self._reference, self._measurement))
        return (2.0 * (r[:3] - x[:3]) + 2.5 * (r[3:6] - x[6:9]) + r[6:9]).ravel()

    def _show(self, context, output):
        output.SetFromVector(self.pd(context) + 0.1 * np.sin(5.0 * context.get_time()))


class PdWithIntegral(UserPd):
    """PD with an integral that is updated periodically."""

    def __init__(self, num_vehicles=1, period=0.02):
        super().__init__(num_vehicles)
        self._integral = self.DeclareDiscreteState(3 * num_vehicles)
        self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._grow)
        self._period = period

    def _grow(self, context, values):
        before = context.get_discrete_state(self._integral).CopyToVector()
        values.get_mutable_vector(self._integral).SetFromVector(before + self._period * self.error(context))

    def _show(self, context, output):
        output.SetFromVector(self.pd(context) + 3.0 * context.get_discrete_state(self._integral).value())


class PdWithFilter(UserPd):
    """PD with a filter in continuous time."""

    def __init__(self, num_vehicles=1):
        super().__init__(num_vehicles)
        self.DeclareContinuousState(3 * num_vehicles)

    def DoCalcTimeDerivatives(self, context, derivatives):
        lag = self.error(context) - context.get_continuous_state_vector().CopyToVector()
        derivatives.get_mutable_vector().SetFromVector(8.0 * lag)

    def _show(self, context, output):
        output.SetFromVector(self.pd(context) + context.get_continuous_state_vector().CopyToVector())


class PdWithCounter(UserPd):
    """PD with an abstract state, which unrestricted updates change."""

    def __init__(self, num_vehicles=1):
        super().__init__(num_vehicles)
        self._seen = self.DeclareAbstractState(AbstractValue.Make([0, 0.0]))
        self.DeclarePeriodicUnrestrictedUpdateEvent(0.04, 0.0, self._count)

    def _count(self, context, state):
        count, total = context.get_abstract_state(self._seen).get_value()
        state.get_mutable_abstract_state(self._seen).set_value([count + 1, total + self.error(context)])

    def _show(self, context, output):
        count, total = context.get_abstract_state(self._seen).get_value()
        output.SetFromVector(self.pd(context) + total / (1 + count))


def integral_every_30_ms(num_vehicles=1):
    return PdWithIntegral(num_vehicles, period=0.03)


def integral_every_5_ms(num_vehicles=1):
    return PdWithIntegral(num_vehicles, period=0.005)


def two_in_series(make_second):
    """Return a function that builds a position controller from a PD and another system in series."""

    def make(num_vehicles=1):
        builder = DiagramBuilder()
        pd = builder.AddNamedSystem("pd", UserPd(num_vehicles))
        second = builder.AddNamedSystem("second", make_second(3 * num_vehicles))
        builder.Connect(pd.get_output_port(), second.get_input_port())
        for name in ("measurement", "reference"):
            builder.ExportInput(pd.GetInputPort(name), name)
        builder.ExportOutput(second.get_output_port(), "acceleration_command")
        return builder.Build()

    return make


with_a_filter = two_in_series(lambda size: FirstOrderLowPassFilter(0.05, size))
with_a_hold = two_in_series(lambda size: ZeroOrderHold(0.02, size))
with_a_delay = two_in_series(lambda size: DiscreteTimeDelay(0.01, 2, size))


class Cascade(LeafSystem):
    """Cascade for N hovering vehicles, with an optional integral in continuous time."""

    def __init__(self, num_vehicles=1, *, integrates=False):
        super().__init__()
        self._num_vehicles, self._integrates = num_vehicles, integrates
        self._measurement = self.DeclareVectorInputPort("measurement", 12 * num_vehicles)
        self._reference = self.DeclareVectorInputPort("reference", 11 * num_vehicles)
        self.DeclareVectorOutputPort("wrench", 4 * num_vehicles, self._show)
        if integrates:
            self.DeclareContinuousState(num_vehicles)

    def _rows(self, context):
        return (port.Eval(context).reshape(-1, self._num_vehicles) for port in (self._reference, self._measurement))

    def DoCalcTimeDerivatives(self, context, derivatives):
        if self._integrates:
            r, x = self._rows(context)
            derivatives.get_mutable_vector().SetFromVector(r[2] - x[2])

    def _show(self, context, output):
        r, x = self._rows(context)
        integral = context.get_continuous_state_vector().CopyToVector() if self._integrates else 0.0
        thrust = 0.69 * (9.81 + 5.0 * (r[2] - x[2]) + 3.0 * (r[5] - x[8]) + integral)
        torques = [-0.007 * (9.0 * x[3 + i] + 6.0 * x[9 + i]) for i in range(3)]
        output.SetFromVector(np.concatenate([thrust, *torques]))


def integrating_cascade(num_vehicles=1):
    return Cascade(num_vehicles, integrates=True)


class VaryingWind(LeafSystem):
    """Wind for N vehicles that depends on time and position, and on a state if a period (s) is given."""

    def __init__(self, num_vehicles=1, period=None):
        super().__init__()
        self._size = 3 * num_vehicles
        self._state = self.DeclareVectorInputPort("state", 12 * num_vehicles)
        self.DeclareVectorOutputPort("wind", self._size, self._show)
        self._remembers = period is not None
        if self._remembers:
            self._memory = self.DeclareDiscreteState(self._size)
            self.DeclarePeriodicDiscreteUpdateEvent(period, 0.0, self._remember)

    def _remember(self, context, values):
        before = context.get_discrete_state(self._memory).CopyToVector()
        values.get_mutable_vector(self._memory).SetFromVector(0.9 * before + self._state.Eval(context)[-self._size :])

    def _show(self, context, output):
        wind = np.cos(context.get_time()) + 0.5 * self._state.Eval(context)[: self._size]
        output.SetFromVector(wind + (context.get_discrete_state(self._memory).value() if self._remembers else 0.0))


def varying_wind_with_state(num_vehicles=1):
    return VaryingWind(num_vehicles, 0.02)


USER_SYSTEMS = {
    "position_controller": [
        UserPd,
        PdWithIntegral,
        integral_every_30_ms,
        integral_every_5_ms,
        PdWithFilter,
        PdWithCounter,
        with_a_filter,
        with_a_hold,
        with_a_delay,
    ],
    "control": [Cascade, integrating_cascade],
    "wind": [VaryingWind, varying_wind_with_state],
}
each_user_system = pytest.mark.parametrize(
    ("part", "make"),
    [(part, make) for part, makes in USER_SYSTEMS.items() for make in makes],
    ids=lambda value: getattr(value, "__name__", value),
)


@pytest.mark.slow
@each_user_system
def test_a_flight_with_a_user_defined_system_is_the_same_compiled_and_uncompiled(scenario, plan, part, make):
    flights = [simulate(scenario, plan=plan, compiled=compiled, **{part: make()}) for compiled in (True, False)]
    assert_flights_alike(*flights)
    assert not np.allclose(flights[0]["wrench"], simulate(scenario, plan=plan)["wrench"], rtol=1e-3)


@pytest.mark.slow
@each_user_system
def test_compiled_and_uncompiled_fleets_with_a_user_defined_system_have_the_same_flights(scenario, plan, part, make):
    """Each fleet simulates two batches of samples, and both fleets have the same results."""
    user_systems = UserSystems(**{part: make})
    fleets = [StudyFleet(scenario, plan, 5, user_systems=user_systems, compiled=compiled) for compiled in (True, False)]
    for samples in (range(5), [7, 8]):
        assert_metrics_alike(*(fleet.fly(samples, duration=0.2) for fleet in fleets))


@pytest.mark.slow
def test_a_placeholder_replaces_a_stateless_system_that_cannot_be_compiled_in_a_built_diagram(scenario, plan):
    """The compiled diagram contains the placeholder. The original diagram keeps the system, and can be simulated."""
    uncompiled = build_tracking_diagram(scenario, position_controller=UserPd(), wind=VaryingWind(), plan=plan)
    compiled = compile_diagram(uncompiled)
    placeholders = [system for system in compiled.GetSystems() if isinstance(system, SystemPlaceholder)]
    assert len(placeholders) == 2
    simulators = [Simulator(diagram) for diagram in (uncompiled, compiled)]
    for time in (0.0, 0.01, 0.02, 0.033, 0.2, 0.205):
        for simulator in simulators:
            simulator.AdvanceTo(time)
        for name in ("acceleration_command", "wind", "wrench", "state"):
            expected, actual = (each.get_system().GetOutputPort(name).Eval(each.get_context()) for each in simulators)
            assert_alike(actual, expected, f"{name} at {time} s")


@pytest.mark.parametrize("make", [PdWithIntegral, PdWithFilter, with_a_filter])
def test_a_built_diagram_with_a_stateful_system_that_cannot_be_compiled_is_refused(scenario, plan, make):
    uncompiled = build_tracking_diagram(scenario, position_controller=make(), plan=plan)
    with pytest.raises(InputError, match=r"^control\.position.*, a \w+, cannot be compiled: only .*a state$"):
        compile_diagram(uncompiled)


@pytest.mark.slow
def test_a_system_that_can_be_compiled_is_not_replaced_by_a_placeholder(scenario, plan):
    """A position controller that declares formulas becomes part of the compiled system."""
    gains = PdGains(PerAxis(2.0, 2.0, 6.0), PerAxis(2.0, 2.0, 3.5))
    pd = build_position_controller(ProportionalDerivative(parameters=gains))
    assert as_compilable(pd) is pd
    compiled = compile_diagram(build_tracking_diagram(scenario, position_controller=pd, plan=plan), ticks=10)
    assert list(compiled.GetSystems()) == [compiled_part(compiled)]


@pytest.mark.slow
def test_a_compiled_diagram_contains_the_system_behind_a_placeholder(scenario, plan):
    """`as_compilable` returns a placeholder for a diagram if one of the diagram's systems cannot be compiled."""
    for make in (UserPd, with_a_filter):
        user_system = make()
        placeholder = as_compilable(user_system)
        assert isinstance(placeholder, SystemPlaceholder)
        compiled = compile_diagram(
            build_tracking_diagram(scenario, position_controller=placeholder, plan=plan), ticks=10
        )
        assert user_system in list(compiled.GetSystems())


def test_a_placeholder_has_the_outputs_of_its_system():
    """The outputs are compared at two times with different inputs."""
    user_system = UserPd(2)
    placeholder = SystemPlaceholder(user_system)
    contexts = [system.CreateDefaultContext() for system in (user_system, placeholder)]
    for time in (0.0, 1.5):
        for name, size in (("measurement", 24), ("reference", 22)):
            for system, context in zip((user_system, placeholder), contexts, strict=True):
                system.GetInputPort(name).FixValue(context, time + np.arange(float(size)))
                context.SetTime(time)
        expected, actual = (
            system.GetOutputPort("acceleration_command").Eval(context)
            for system, context in zip((user_system, placeholder), contexts, strict=True)
        )
        np.testing.assert_array_equal(actual, expected)


class TimeScaling(LeafSystem):
    """System with two output rows, the product of input and time."""

    def __init__(self, size):
        super().__init__()
        first, second = (self.DeclareVectorInputPort(name, size) for name in ("first", "second"))

        def show(context, output):
            output.SetFromVector(first.Eval(context) + context.get_time() * second.Eval(context))

        self.DeclareVectorOutputPort("scaled", size, show)


def mixed_diagram():
    """Return a diagram of a zero-order hold and uncompiled systems, which are connected to each other and to inputs."""
    builder = DiagramBuilder()
    n = 2
    hold = builder.AddNamedSystem("hold", ZeroOrderHold(0.02, 3 * n))
    wind = builder.AddNamedSystem("steady", SteadyWind(num_vehicles=n, parameters=Wind(1.0, 2.0, 3.0)))
    first, second = (builder.AddNamedSystem(name, TimeScaling(3 * n)) for name in ("first", "second"))
    builder.ExportInput(second.GetInputPort("second"), "v")
    builder.ExportInput(first.GetInputPort("first"), "u")
    builder.Connect(wind.get_output_port(), first.GetInputPort("second"))
    builder.Connect(first.get_output_port(), second.GetInputPort("first"))
    adder = builder.AddNamedSystem("adder", Adder(4, 3 * n))
    builder.Connect(second.get_output_port(), adder.get_input_port(0))
    builder.ConnectInput("u", adder.get_input_port(1))
    builder.Connect(wind.get_output_port(), adder.get_input_port(2))
    builder.ExportInput(adder.get_input_port(3), "w")
    builder.Connect(adder.get_output_port(), hold.get_input_port())
    builder.ExportOutput(first.get_output_port(), "first")
    builder.ExportOutput(hold.get_output_port(), "held")
    builder.ExportOutput(adder.get_output_port(), "sum")
    diagram = builder.Build()
    diagram.set_name("hand_in_hand")
    return diagram


@pytest.mark.parametrize("ticks", [None, 3])
def test_uncompiled_systems_can_be_connected_to_each_other_and_to_inputs_of_the_diagram(ticks):
    diagrams = [mixed_diagram(), compile_diagram(mixed_diagram(), ticks=ticks)]
    simulators = [Simulator(diagram) for diagram in diagrams]
    for diagram, simulator in zip(diagrams, simulators, strict=True):
        assert [diagram.get_input_port(i).get_name() for i in range(3)] == ["v", "u", "w"]
        for number, name in enumerate("vuw"):
            diagram.GetInputPort(name).FixValue(simulator.get_mutable_context(), number + np.arange(6.0))
    for time in (0.0, 0.011, 0.02, 0.041):
        for simulator in simulators:
            simulator.AdvanceTo(time)
        for name in ("first", "held", "sum"):
            expected, actual = (each.get_system().GetOutputPort(name).Eval(each.get_context()) for each in simulators)
            assert_alike(actual, expected, f"{name} at {time} s")


def test_the_message_about_an_unconnected_input_names_the_input():
    compiled = compile_diagram(mixed_diagram())
    context = compiled.CreateDefaultContext()
    for name in "uv":
        compiled.GetInputPort(name).FixValue(context, np.zeros(6))
    np.testing.assert_array_equal(compiled.GetOutputPort("held").Eval(context), np.zeros(6))
    with pytest.raises(InputError, match="the input port `w` of the CompiledSystem .*compiled is not connected"):
        compiled.GetOutputPort("sum").Eval(context)
