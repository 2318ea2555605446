"""Tests of every system: its `pydrake_system` block, scalar conversion, resets, defaults and unconnected inputs."""

import gc
import importlib
import importlib.metadata
import inspect
import pkgutil
import re
import weakref

import numpy as np
import pytest
from all_systems import DIAGRAMS, FLEET_SYSTEMS, SYSTEMS
from pydrake.autodiffutils import AutoDiffXd, ExtractValue
from pydrake.systems.analysis import Simulator_
from pydrake.systems.framework import Diagram

import drake_quad
from drake_quad import InputError
from drake_quad.control.lqg.system import LinearQuadraticGaussian
from drake_quad.framework.fleet_system import REQUIRED, FleetSystem
from drake_quad.laboratory.motion_capture import MotionCapture
from drake_quad.laboratory.sensors.sensor import Sensor
from drake_quad.randomness.noise import NoiseSource
from drake_quad.scenario.autopilots.attitude import AttitudeAutopilotSettings as AttitudeAutopilotModel
from drake_quad.scenario.models import Laboratory, Vehicle
from drake_quad.vehicle.autopilot import AttitudeAutopilot


def name_of(value):
    return getattr(value, "__name__", "")


systems = pytest.mark.parametrize(("documented", "make"), SYSTEMS, ids=name_of)
examples = pytest.mark.parametrize("example", FLEET_SYSTEMS, ids=lambda example: name_of(example.system))


def fleet_systems_of_the_package():
    """Return all classes of the package that have the decorator `fleet_system`."""
    modules = pkgutil.walk_packages(drake_quad.__path__, "drake_quad.")
    classes = [
        value
        for module in modules
        for value in contents(module.name)
        if inspect.isclass(value) and issubclass(value, FleetSystem) and hasattr(value, "template")
    ]
    return set(classes)


def contents(module):
    """Return the objects in a module; empty if the module needs an optional library that is not installed."""
    try:
        return vars(importlib.import_module(module)).values()
    except ImportError as error:
        assert "install it with: pip install 'drake_quad[learn]'" in str(error)
        return ()


def test_the_examples_include_every_system():
    assert {example.system for example in FLEET_SYSTEMS} == fleet_systems_of_the_package()
    assert {example.system for example in FLEET_SYSTEMS if example.has_all_ports} == fleet_systems_of_the_package()


def documented_ports(docstring):
    """Return the port names in the `pydrake_system` block of a docstring, by direction ("input" or "output")."""
    block = docstring.split(".. pydrake_system::")[1]
    ports = {}
    for direction in ("input", "output"):
        names = re.search(rf"{direction}_ports:\n((?:\s*- [\w.]+\n)+)", block)
        ports[direction] = re.findall(r"- ([\w.]+)", names.group(1)) if names else []
    return ports


def ports_of(system):
    return {
        "input": [system.get_input_port(i).get_name() for i in range(system.num_input_ports())],
        "output": [system.get_output_port(i).get_name() for i in range(system.num_output_ports())],
    }


@examples
def test_a_constructor_has_the_signature_of_its_declare_method(example):
    """help() and editors show this signature; otherwise they would show `*args, **kwargs`."""
    signature = inspect.signature(example.system)
    arguments = {} if example.parameters is None else {"parameters": example.parameters}
    bound = signature.bind(num_vehicles=example.num_vehicles, **example.structure, **arguments)
    bound.apply_defaults()
    assert ports_of(example.system(**bound.arguments)) == ports_of(example.make())
    with pytest.raises(TypeError):
        signature.bind(wings=2)


@systems
def test_the_pydrake_system_block_of_a_docstring_lists_all_ports(documented, make):
    assert documented_ports(documented.__doc__) == ports_of(make())


@examples
def test_the_pydrake_system_block_in_the_docstring_of_a_system_names_its_class(example):
    assert re.search(r"name: (\w+)", example.system.__doc__)[1] == example.system.__name__


@pytest.mark.parametrize(("documented", "make"), DIAGRAMS, ids=name_of)
def test_a_diagram_has_the_name_in_the_pydrake_system_block_of_its_docstring(documented, make):
    assert make().get_name() == re.search(r"name: (\w+)", documented.__doc__)[1]


def elements_of(context):
    """Return all numeric parameters and states of a context, as a list of vectors."""
    return [
        *(context.get_numeric_parameter(i).CopyToVector() for i in range(context.num_numeric_parameter_groups())),
        *(context.get_discrete_state(i).CopyToVector() for i in range(context.num_discrete_state_groups())),
        context.get_continuous_state_vector().CopyToVector(),
    ]


@systems
def test_systems_convert_to_autodiff_with_the_same_ports_and_defaults(documented, make):
    system = make()
    converted = system.ToScalarType[AutoDiffXd]()
    assert ports_of(converted) == ports_of(system)
    for i in range(system.num_output_ports()):
        assert converted.get_output_port(i).size() == system.get_output_port(i).size()
    context, converted_context = system.CreateDefaultContext(), converted.CreateDefaultContext()
    for actual, expected in zip(elements_of(converted_context), elements_of(context), strict=True):
        np.testing.assert_array_equal(ExtractValue(actual).ravel() if len(actual) else actual, expected)


ALL_EXAMPLES = [(example.system, example.make) for example in FLEET_SYSTEMS] + DIAGRAMS


@pytest.mark.parametrize(("documented", "make"), ALL_EXAMPLES, ids=name_of)
def test_autodiff_and_float_systems_compute_equal_outputs_and_states(documented, make):
    """All outputs and the state after a tick are compared, for random inputs and states."""
    system = make()
    converted = system.ToScalarType[AutoDiffXd]()
    contexts = system.CreateDefaultContext(), converted.CreateDefaultContext()
    rng = np.random.default_rng(0)
    for i in range(system.num_input_ports()):
        values = rng.uniform(0.1, 0.9, system.get_input_port(i).size())
        for each, context in zip((system, converted), contexts, strict=True):
            each.get_input_port(i).FixValue(context, values)
    for context in contexts:
        context.SetTime(1.2)
    if not isinstance(system, Diagram) and system.GetUniquePeriodicDiscreteUpdateAttribute():
        groups = range(contexts[0].num_discrete_state_groups())
        initial_states = [rng.uniform(0.1, 0.9, contexts[0].get_discrete_state(group).size()) for group in groups]
        for context in contexts:
            for group, values in zip(groups, initial_states, strict=True):
                context.SetDiscreteState(group, values)
        next_states = [
            each.EvalUniquePeriodicDiscreteUpdate(context)
            for each, context in zip((system, converted), contexts, strict=True)
        ]
        for group in groups:
            assert_equal_values(
                next_states[1].get_vector(group).CopyToVector(), next_states[0].get_vector(group).CopyToVector()
            )
        changed = [(next_states[0].get_vector(group).CopyToVector() != initial_states[group]).any() for group in groups]
        assert any(changed)
    for i in range(system.num_output_ports()):
        outputs = [each.get_output_port(i).Eval(context) for each, context in zip((system, converted), contexts)]
        assert_equal_values(outputs[1], outputs[0])


def assert_equal_values(with_derivatives, parameters):
    values = [getattr(value, "value", lambda value=value: value)() for value in with_derivatives]
    np.testing.assert_allclose(values, parameters, rtol=1e-12, atol=1e-12)


def overwrite(context):
    """Set all numeric parameters and states of a context to -7, which no example has."""

    def overwritten(vector):
        return np.array([type(element)(-7.0) for element in vector.CopyToVector()])

    for i in range(context.num_numeric_parameter_groups()):
        vector = context.get_mutable_numeric_parameter(i)
        vector.SetFromVector(overwritten(vector))
    for i in range(context.num_discrete_state_groups()):
        context.SetDiscreteState(i, overwritten(context.get_discrete_state(i)))
    if context.num_continuous_states():
        context.SetContinuousState(overwritten(context.get_continuous_state_vector()))


@examples
def test_a_context_that_is_reset_to_new_parameters_equals_the_context_of_a_new_system(example):
    """All parameters and states are overwritten before the reset, so the reset must set each of them."""
    parameters = example.other_parameters
    system, new_system = example.make(), example.make_with(parameters)
    context, expected = system.CreateDefaultContext(), new_system.CreateDefaultContext()
    overwrite(context)
    context.SetTime(3.0)
    system.reset(context, parameters)
    for actual, desired in zip(elements_of(context), elements_of(expected), strict=True):
        np.testing.assert_array_equal(actual, desired)
    # The reset changes the context, but not the system.
    for actual, desired in zip(
        elements_of(system.CreateDefaultContext()), elements_of(example.make().CreateDefaultContext()), strict=True
    ):
        np.testing.assert_array_equal(actual, desired)


@examples
def test_the_two_parameter_sets_of_an_example_differ_in_every_parameter(example):
    """If a parameter were equal in both sets, the test of resets could not detect that it is not reset."""
    parameter_sets = example.parameters, example.other_parameters
    contexts = [example.make_with(parameters).CreateDefaultContext() for parameters in parameter_sets]
    assert (contexts[0].num_numeric_parameter_groups() > 0) == bool(example.parameters)
    for i in range(contexts[0].num_numeric_parameter_groups()):
        first, second = (context.get_numeric_parameter(i).CopyToVector() for context in contexts)
        assert (first != second).all()


@examples
def test_an_autodiff_context_can_be_reset(example):
    system = example.make().ToScalarType[AutoDiffXd]()
    context, expected = (
        system.CreateDefaultContext(),
        example.make_with(example.other_parameters).CreateDefaultContext(),
    )
    overwrite(context)
    system.reset(context, example.other_parameters)
    for actual, desired in zip(elements_of(context), elements_of(expected), strict=True):
        np.testing.assert_array_equal(ExtractValue(actual).ravel() if len(actual) else actual, desired)


@examples
def test_parameters_and_states_are_copied_between_contexts_unchanged(example):
    """The records from `get_parameter` and `get_state` can be passed to `set_parameter` and `set_state`."""
    system, other_system = example.make(), example.make_with(example.other_parameters)
    context, source = system.CreateDefaultContext(), other_system.CreateDefaultContext()
    assert len(system.parameters) == context.num_numeric_parameter_groups()
    for name in system.parameters:
        record = other_system.get_parameter(source, name)
        system.set_parameter(context, name, record)
        assert type(record) is type(system.get_parameter(context, name))
    for name in system.states:
        system.set_state(context, name, other_system.get_state(source, name))
    for actual, desired in zip(elements_of(context), elements_of(source), strict=True):
        np.testing.assert_array_equal(actual, desired)


DRAKE_VERSION = tuple(map(int, importlib.metadata.version("drake").split(".")[:2]))


def parts_of(system):
    """Return a system and all its subsystems, recursively."""
    subsystems = system.GetSystems() if hasattr(system, "GetSystems") else []
    return [system, *(part for each in subsystems for part in parts_of(each))]


def evaluate_outputs(system, context):
    """Evaluate all outputs of a system with all inputs equal to 0.5."""
    for i in range(system.num_input_ports()):
        port = system.get_input_port(i)
        port.FixValue(context, [0.5] * port.size())
    for i in range(system.num_output_ports()):
        assert not np.isnan(system.get_output_port(i).Eval(context)).any()


@pytest.fixture(scope="module")
def frozen_objects():
    """Exempt all existing objects from garbage collection, which makes later collections fast."""
    gc.collect()
    gc.freeze()


@pytest.mark.slow
@pytest.mark.usefixtures("frozen_objects")
@pytest.mark.skipif(DRAKE_VERSION < (1, 56), reason="in earlier versions of Drake, callbacks keep their systems alive")
@systems
def test_a_deleted_system_leaves_no_garbage(documented, make):
    """The context, the AutoDiffXd copy and the subsystems must be deleted as well."""
    system = make()
    context = system.CreateDefaultContext()
    evaluate_outputs(system, context)
    converted = system.ToScalarType[AutoDiffXd]()
    alive = [weakref.ref(part) for each in (system, converted) for part in parts_of(each)]
    del system, context, converted
    gc.collect()
    remaining = [reference() for reference in alive]
    assert [type(part).__name__ for part in remaining if part is not None] == []


def loop_period(system, argument):
    """Return the default that the scenario language has for the period or time step of a system, s."""
    if system is AttitudeAutopilot:
        return AttitudeAutopilotModel.model_fields["period"].default
    if system in (MotionCapture, Sensor) or (system is LinearQuadraticGaussian and argument == "period"):
        return Laboratory().motion_capture.period
    is_simulated_motion = system.__module__.startswith(("drake_quad.laboratory.wind.", "drake_quad.vehicle."))
    return Vehicle().time_step if is_simulated_motion else Laboratory().command_link.period


@examples
def test_constructor_defaults_equal_those_of_the_scenario_language(example):
    """The test compares periods and time steps. It also compares parameters if each of their fields has a default."""
    system = example.system
    declared = inspect.signature(system.declare).parameters.values()
    defaults = {each.name: each.default for each in declared if each.default is not inspect.Parameter.empty}
    for name in ("period", "tick", "time_step"):
        if name in defaults:
            assert defaults[name] == loop_period(system, name), name
    for value in defaults.values():
        if hasattr(value, "_field_defaults") and value._field_defaults.keys() == {*value._fields}:
            assert value == type(value)()
    required = {each.name for each in declared} - {"self", *defaults}
    parameters = example.parameters._replace(indices=(5,)) if system is NoiseSource else example.parameters
    assert (
        system(**{name: {"parameters": parameters, **example.structure}[name] for name in required}).num_vehicles == 1
    )


@examples
def test_unconnected_inputs_count_as_zero(example, monkeypatch):
    absent_values = []
    original = FleetSystem.input

    def recording_input(system, name, **options):
        absent_values.append(options.get("absent"))
        return original(system, name, **options)

    monkeypatch.setattr(FleetSystem, "input", recording_input)
    example.make()
    assert not any(np.any(np.hstack(value) != 0.0) for value in absent_values if value not in (None, REQUIRED))


def evaluate_everything(system, context):
    """Evaluate all outputs of a system, and the time derivative or the state after a tick if it has them."""
    for i in range(system.num_output_ports()):
        system.get_output_port(i).Eval(context)
    if isinstance(system, FleetSystem) and "continuous" in system.states:
        system.EvalTimeDerivatives(context)
    if isinstance(system, FleetSystem) and system.updates:
        Simulator_[system.scalar](system, context.Clone()).AdvanceTo(system.updates[0].period)


@pytest.mark.long
@pytest.mark.parametrize("scalar", [float, AutoDiffXd], ids=["float", "autodiff"])
@examples
def test_an_unconnected_input_is_either_optional_or_named_in_the_error(example, scalar):
    """Otherwise a formula would fail with an error about None, which does not name the input."""
    system = example.make() if scalar is float else example.make().ToScalarType[scalar]()
    ports = [system.get_input_port(i) for i in range(system.num_input_ports())]
    for missing in ports:
        context = system.CreateDefaultContext()
        for port in ports:
            if port is not missing:
                port.FixValue(context, [0.5] * port.size())
        try:
            evaluate_everything(system, context)
        except InputError as error:
            name = f"the input port `{missing.get_name()}` of the {example.system.__name__}"
            assert re.fullmatch(rf"{name}( \w+)? is not connected; connect it, or fix its value", str(error))
