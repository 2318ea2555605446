"""Tests of systems that declare their computations as formulas."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd
from pydrake.common import RandomDistribution, cpp_template
from pydrake.symbolic import Expression, Variable
from pydrake.systems.analysis import Simulator, Simulator_
from pydrake.systems.framework import DiagramBuilder, DiagramBuilder_

from drake_quad import InputError
from drake_quad.framework.elementary import arctan2
from drake_quad.framework.fleet_system import TIME, FleetSystem, fleet_system
from drake_quad.framework.wiring import split_output, subsystem
from drake_quad.signals import Acceleration, PositionError, Row, Wind


class Gains(NamedTuple):
    k_p: Row = 2.0
    offset: Acceleration = Acceleration(0.0, 0.0, 0.0)


class Numbers(NamedTuple):
    gains: Gains = Gains()
    start: Row = 0.0


class Signals(NamedTuple):
    error: PositionError
    pd: Acceleration


class Uniform(NamedTuple):
    value: Row


def law(error, wind, gains, sign):
    wind_or_zero = wind if wind is not None else Wind(0.0, 0.0, 0.0)
    x, y, z = (sign * gains.k_p * e + o + w for e, o, w in zip(error, gains.offset, wind_or_zero, strict=True))
    return Signals(error, Acceleration(x, y, z))


def summed(total, error, time):
    return PositionError(*(part + e + 10.0 * time for part, e in zip(total, error, strict=True)))


def doubled(total):
    return Acceleration(2.0 * total.x, 2.0 * total.y, 2.0 * total.z)


@fleet_system(float, AutoDiffXd, Expression)
class Example(FleetSystem):
    """System with a memoryless control law and a sum of its inputs."""

    def declare(self, *, period=0.5, unrestricted=False, at_start=True, parameters=Numbers()):
        error, wind = self.input("error"), self.input("wind", absent=None)
        gains = self.parameter("gains", lambda parameters: parameters.gains)
        total = self.state("total", lambda parameters: PositionError(parameters.start, 0.0, 0.0))
        self.update(period, summed, total, error, TIME, writes=[total], unrestricted=unrestricted, at_start=at_start)
        self.output("correction", doubled, total)
        self.output("pd", lambda *reads: law(*reads).pd, error, wind, gains, -1.0)


@fleet_system(float, AutoDiffXd)
class Packed(FleetSystem):
    """System that has the output signals of `Example`, packed into a single output port."""

    def declare(self, *, parameters=Gains()):
        gains = self.parameter("gains", lambda gains: gains)
        self.packed_output("both", Signals, law, self.input("error"), None, gains, 1.0)


@fleet_system(float, AutoDiffXd)
class Falling(FleetSystem):
    """System with a continuous state."""

    def declare(self, *, parameters=Numbers()):
        error = self.continuous_state(lambda parameters: PositionError(parameters.start, 1.0, 2.0))
        self.derivative(
            lambda error, gains: PositionError(*(-gains.k_p * x for x in error)),
            error,
            self.parameter("gains", lambda n: n.gains),
        )
        self.output("error", lambda error: error, error)


@pytest.mark.parametrize("n", [1, 3, 11])
def test_outputs_are_computed_by_their_formulas(n):
    system = Example(num_vehicles=n)
    context = system.CreateDefaultContext()
    error, wind = np.random.default_rng(0).normal(size=(2, 3 * n))
    system.GetInputPort("error").FixValue(context, error)
    np.testing.assert_allclose(system.GetOutputPort("pd").Eval(context), -2.0 * error)
    # The formula receives None if the optional input port is not connected.
    system.GetInputPort("wind").FixValue(context, wind)
    np.testing.assert_allclose(system.GetOutputPort("pd").Eval(context), -2.0 * error + wind)
    system.set_parameter(context, "gains", Gains(np.arange(1.0, n + 1.0), Acceleration(0.0, 0.5, 0.0)))
    expected = -np.tile(np.arange(1.0, n + 1.0), 3) * error + wind + np.repeat([0.0, 0.5, 0.0], n)
    np.testing.assert_allclose(system.GetOutputPort("pd").Eval(context), expected)
    assert system.GetOutputPort("correction").Eval(context).size == 3 * n


@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize("scalar", [float, AutoDiffXd])
def test_a_required_input_that_is_not_connected_is_named_with_its_system(scalar, n):
    builder = DiagramBuilder_[scalar]()
    control = builder.AddNamedSystem("control", Example.template[scalar](num_vehicles=n))
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    message = "^the input port `error` of the Example control is not connected; connect it, or fix its value$"
    with pytest.raises(InputError, match=message):
        control.GetOutputPort("pd").Eval(control.GetMyContextFromRoot(context))
    with pytest.raises(InputError, match=message):
        Simulator_[scalar](diagram, context).AdvanceTo(0.5)


@pytest.mark.parametrize("n", [1, 4])
def test_formulas_for_scalar_types_other_than_float_run_in_python(n):
    system = Example(num_vehicles=n, parameters=Numbers(Gains(np.arange(1.0, n + 1.0) if n > 1 else 1.5)))
    context = system.CreateDefaultContext()
    error = np.arange(3.0 * n)
    system.GetInputPort("error").FixValue(context, error)
    expected = system.GetOutputPort("pd").Eval(context)
    converted = system.ToAutoDiffXd()
    context = converted.CreateDefaultContext()
    converted.GetInputPort("error").FixValue(context, np.array([AutoDiffXd(x, [1.0]) for x in error]))
    actual = converted.GetOutputPort("pd").Eval(context)
    np.testing.assert_allclose([x.value() for x in actual], expected)
    np.testing.assert_allclose(
        [x.derivatives()[0] for x in actual], -np.tile(np.arange(1.0, n + 1.0) if n > 1 else 1.5, 3)
    )
    if n == 1:
        symbolic = system.ToSymbolic()
        context = symbolic.CreateDefaultContext()
        x = Variable("x")
        symbolic.GetInputPort("error").FixValue(context, np.array([Expression(x)] * 3))
        assert symbolic.GetOutputPort("pd").Eval(context)[0].Evaluate({x: 2.0}) == -3.0


@pytest.mark.parametrize("n", [1, 3])
def test_updates_read_the_previous_state_and_the_time(n):
    system = Example(num_vehicles=n, parameters=Numbers(start=5.0))
    simulator = Simulator(system)
    context = simulator.get_mutable_context()
    system.GetInputPort("error").FixValue(context, np.ones(3 * n))
    simulator.AdvanceTo(0.75)
    # The updates at 0 s and at 0.5 s each add the error, which is 1, plus ten times the time of the update.
    total = system.get_state(context, "total")
    np.testing.assert_allclose(total.x, 5.0 + 2.0 + 5.0)
    np.testing.assert_allclose(total.z, 2.0 + 5.0)
    np.testing.assert_allclose(system.GetOutputPort("correction").Eval(context)[0], 24.0)


@pytest.mark.parametrize("unrestricted", [False, True])
def test_an_update_can_omit_time_zero(unrestricted):
    system = Example(at_start=False, unrestricted=unrestricted)
    simulator = Simulator(system)
    system.GetInputPort("error").FixValue(simulator.get_mutable_context(), np.ones(3))
    simulator.AdvanceTo(0.25)
    assert system.get_state(simulator.get_context(), "total").y == 0.0
    simulator.AdvanceTo(0.75)
    assert system.get_state(simulator.get_context(), "total").y == 6.0


def test_a_continuous_state_is_the_integral_of_its_derivative():
    for n in (1, 2):
        system = Falling(num_vehicles=n, parameters=Numbers(Gains(k_p=0.5), start=3.0))
        simulator = Simulator(system)
        simulator.AdvanceTo(1.0)
        actual = system.get_state(simulator.get_context(), "continuous")
        np.testing.assert_allclose(
            [actual.x, actual.y], np.multiply.outer([3.0, 1.0], np.squeeze([math.exp(-0.5)] * n)), rtol=1e-3
        )
        np.testing.assert_array_equal(system.GetOutputPort("error").Eval(simulator.get_context())[:n], actual.x)


def test_a_packed_output_is_split_into_its_signals():
    builder = DiagramBuilder()
    system = Packed(num_vehicles=2)
    ports = split_output(builder, "packed", system)
    builder.ExportInput(system.GetInputPort("error"), "error")
    for name, port in ports.items():
        builder.ExportOutput(port, name)
    diagram = builder.Build()
    context = diagram.CreateDefaultContext()
    diagram.GetInputPort("error").FixValue(context, np.arange(6.0))
    np.testing.assert_array_equal(diagram.GetOutputPort("error").Eval(context), np.arange(6.0))
    np.testing.assert_array_equal(diagram.GetOutputPort("pd").Eval(context), 2.0 * np.arange(6.0))
    assert subsystem(diagram, ("packed",)) is system


@pytest.mark.parametrize("n", [1, 3])
def test_a_reset_recomputes_parameters_and_states(n):
    rows = np.arange(1.0, n + 1.0) if n > 1 else 1.0
    parameters = Numbers(Gains(k_p=rows, offset=Acceleration(0.1, 0.2, 0.3)), start=-rows)
    new, reset = Example(num_vehicles=n, parameters=parameters), Example(num_vehicles=n)
    expected, context = new.CreateDefaultContext(), reset.CreateDefaultContext()
    reset.reset(context, parameters)
    for name in ("gains",):
        np.testing.assert_array_equal(
            np.hstack(reset.parameters[name].layout.flatten(reset.get_parameter(context, name))),
            np.hstack(new.parameters[name].layout.flatten(new.get_parameter(expected, name))),
        )
    np.testing.assert_array_equal(
        np.hstack(reset.get_state(context, "total")), np.hstack(new.get_state(expected, "total"))
    )


def test_outputs_depend_only_on_the_arguments_of_their_formula():
    system = Example()
    inputs, outputs = range(system.num_input_ports()), range(system.num_output_ports())
    feedthrough = {(i, o) for i in inputs for o in outputs if system.HasDirectFeedthrough(i, o)}
    pd = int(system.GetOutputPort("pd").get_index())
    assert feedthrough == {(0, pd), (1, pd)}


def test_random_inputs_have_a_distribution_and_a_period():
    @fleet_system(float)
    class WithRandomInput(FleetSystem):
        def declare(self):
            self.random_input("coin", Uniform, RandomDistribution.kUniform, period=0.1)

    system = WithRandomInput(num_vehicles=4)
    assert system.random_inputs["coin"] == (1, RandomDistribution.kUniform, 0.1)
    assert system.GetInputPort("coin").size() == 4


@pytest.mark.parametrize("n", [1, 3])
def test_an_output_that_reads_the_time_changes_with_it(n):
    @fleet_system(float, AutoDiffXd)
    class Clock(FleetSystem):
        def declare(self):
            self.output("wind", lambda time: Wind(time, 2.0 * time, 0.0), TIME)

    system = Clock(num_vehicles=n)
    context = system.CreateDefaultContext()
    for time in (0.0, 1.5, 4.0):
        context.SetTime(time)
        actual = system.GetOutputPort("wind").Eval(context).reshape(3, n)
        np.testing.assert_array_equal(actual, np.multiply.outer([time, 2.0 * time, 0.0], np.ones(n)))


@fleet_system(float, AutoDiffXd, Expression)
class Held(FleetSystem):
    """System whose only output is its state."""

    def declare(self, *, parameters=Numbers()):
        self.state_output(self.state("error", lambda parameters: PositionError(parameters.start, 1.0, -2.0)))


@pytest.mark.parametrize("n", [1, 3])
@pytest.mark.parametrize("scalar", [float, AutoDiffXd, Expression])
def test_a_state_output_has_all_components_of_the_state(n, scalar):
    system = Held(num_vehicles=n, parameters=Numbers(start=0.5))
    system = system if scalar is float else system.ToScalarType[scalar]()
    actual = system.get_output_port().Eval(system.CreateDefaultContext())
    values = [each if scalar is float else each.value() if scalar is AutoDiffXd else each.Evaluate() for each in actual]
    assert values == [0.5] * n + [1.0] * n + [-2.0] * n


def test_the_template_of_a_class_has_the_classes_for_all_scalar_types():
    assert Example.__name__ == Example.__qualname__ == "Example"
    assert Example.template[float] is Example
    system = Example.template[AutoDiffXd](num_vehicles=2)
    assert system.scalar is AutoDiffXd
    assert system.CreateDefaultContext().get_discrete_state(0).size() == 6


def test_drake_finds_the_modules_of_other_templates():
    assert cpp_template._get_module_from_stack.__module__ == "pydrake.common.cpp_template"


def angles(wind):
    return arctan2(wind.y, wind.x), arctan2(wind.z, wind.y), arctan2(wind.x, wind.z)


@fleet_system(float)
class InitializedAngles(FleetSystem):
    """System that computes angles by one formula, at initialization for its state, and in flight for its output."""

    def declare(self, *, parameters=Wind(0.0, 0.0, 0.0)):
        wind = self.parameter("wind", lambda wind: wind)
        state = self.state("error", lambda wind: PositionError(0.0, 0.0, 0.0))
        self.initialize(lambda wind: PositionError(*angles(wind)), wind, writes=[state])
        self.output("pd", lambda wind: Acceleration(*angles(wind)), wind)
        self.state_output(state)


def test_initial_values_are_bitwise_equal_to_the_same_formula_in_flight():
    winds = np.random.default_rng(5).normal(size=(3, 400))
    simulator = Simulator(InitializedAngles(400, parameters=Wind(*winds)))
    simulator.Initialize()
    context, system = simulator.get_context(), simulator.get_system()
    initial, now = (system.GetOutputPort(name).Eval(context) for name in ("error", "pd"))
    np.testing.assert_array_equal(initial, now)
