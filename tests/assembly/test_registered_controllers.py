"""Tests of Python controllers that are registered as kinds of the scenario language."""

import pickle
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest
from pydrake.systems.framework import BasicVector, LeafSystem

from drake_quad import (
    InputError,
    closed_loop,
    link_margins,
    load_scenario,
    register_controller,
    run_monte_carlo,
    simulate,
    simulate_samples,
)
from drake_quad.assembly.registered_controllers import _default_parameters
from drake_quad.framework.fleet_system import AutoDiffXd, FleetSystem, fleet_system
from drake_quad.scenario.files.saving import save_scenario
from drake_quad.scenario.position_controllers.controller import POSITION_CONTROLLERS
from drake_quad.signals import Acceleration, Reference, State, Wrench

SHORT_FLIGHT = "duration=0.5"
RANDOM_MASS = "vehicle.mass={uniform: {min: 0.6, max: 0.76}}"


class Gains(NamedTuple):
    k_p: float = 0.2
    k_d: float = 0.7


def pd_law(m: State, r: Reference, gains: Gains) -> Acceleration:
    return Acceleration(
        x=r.a_x + gains.k_d * (r.v_x - m.v_x) + gains.k_p * (r.x - m.x),
        y=r.a_y + gains.k_d * (r.v_y - m.v_y) + gains.k_p * (r.y - m.y),
        z=r.a_z + gains.k_d * (r.v_z - m.v_z) + gains.k_p * (r.z - m.z),
    )


@fleet_system(float, AutoDiffXd)
class Formula(FleetSystem):
    """A PD controller that declares its law as a formula."""

    def declare(self, *, parameters=Gains()):
        gains = self.parameter("gains", lambda parameters: parameters)
        self.output("acceleration_command", pd_law, self.input("measurement"), self.input("reference"), gains)


class Plain(LeafSystem):
    """PD controller with the law of `Formula`, written in plain NumPy."""

    def __init__(self, num_vehicles=1):
        super().__init__()
        n = num_vehicles
        self.measurement = self.DeclareVectorInputPort("measurement", BasicVector(12 * n))
        self.reference = self.DeclareVectorInputPort("reference", BasicVector(11 * n))
        self.DeclareVectorOutputPort("acceleration_command", BasicVector(3 * n), self.command)

    def command(self, context, output):
        m = State(*self.measurement.Eval(context).reshape(12, -1))
        r = Reference(*self.reference.Eval(context).reshape(11, -1))
        output.SetFromVector(np.ravel(pd_law(m, r, Gains())))


def level_wrench(m: State, r: Reference) -> Wrench:
    return Wrench(
        thrust=0.68 * (9.81 + (r.z - m.z) + 1.4 * (r.v_z - m.v_z)),
        tau_x=-0.007 * (50.0 * m.roll + 10.0 * m.p),
        tau_y=-0.007 * (50.0 * m.pitch + 10.0 * m.q),
        tau_z=0.012 * (4.0 * (r.yaw - m.yaw) - 4.0 * m.r),
    )


@fleet_system(float, AutoDiffXd)
class LevelControl(FleetSystem):
    """A complete control that commands the weight as thrust and levels the vehicle."""

    def declare(self):
        self.output("wrench", level_wrench, self.input("measurement"), self.input("reference"))


def with_position(kind: str, *overrides: str):
    return load_scenario(
        "laboratory:low_wind",
        [f"control.position={{kind: {kind}, feed_forward: none}}", "control.network=null", SHORT_FLIGHT, *overrides],
    )


@pytest.mark.slow
@pytest.mark.parametrize("system", [Formula, Plain])
def test_a_registered_position_controller_flies_as_if_it_were_passed_to_simulate(system) -> None:
    kind = register_controller(system)
    assert kind == f"{__name__}.{system.__name__}"
    registered = simulate(with_position(kind))
    given = simulate(with_position(kind).model_copy(), position_controller=system())
    np.testing.assert_allclose(registered.signals["state"], given.signals["state"], atol=1e-9)


@pytest.mark.slow
class MixedParameters(NamedTuple):
    gain: float = 1.0
    names: tuple[str, ...] = ()


class MixedSystem:
    def declare(self, *, parameters: MixedParameters = MixedParameters()) -> None:
        """Declare nothing."""


def test_only_parameters_that_are_plain_numbers_become_fields() -> None:
    assert _default_parameters(MixedSystem) is None
    assert _default_parameters(Formula) is not None


def test_a_registered_control_replaces_the_whole_cascade() -> None:
    kind = register_controller(LevelControl)
    scenario = load_scenario("laboratory:low_wind", [f"control={{kind: {kind}}}", SHORT_FLIGHT])
    registered = simulate(scenario)
    given = simulate(load_scenario("laboratory:low_wind", [SHORT_FLIGHT]), control=LevelControl())
    np.testing.assert_allclose(registered.signals["state"], given.signals["state"], atol=1e-9)
    assert scenario.control.contains_user_system()


@pytest.mark.long
def test_parameters_of_a_registered_formula_are_fields_that_may_be_distributions() -> None:
    kind = register_controller(Formula)
    registered = simulate(with_position(kind, "control.position.k_p=2.0"))
    given = simulate(with_position(kind), position_controller=Formula(parameters=Gains(k_p=2.0)))
    np.testing.assert_allclose(registered.signals["state"], given.signals["state"], atol=1e-9)
    drawn = with_position(kind, "control.position.k_p={uniform: {min: 0.2, max: 2.0}}")
    first, second = simulate_samples(drawn, range(2))
    assert first.scenario.control.position.k_p != second.scenario.control.position.k_p
    alone = simulate(first.scenario)
    np.testing.assert_allclose(alone.signals["state"], first.signals["state"], atol=1e-9)
    # A system in plain Python has no parameters in the scenario language.
    assert set(type(with_position(register_controller(Plain)).control.position).model_fields) == {
        "kind",
        "feed_forward",
    }


@pytest.mark.long
def test_a_registered_formula_has_a_linear_model_and_margins() -> None:
    kind = register_controller(Formula)
    scenario = load_scenario(
        "hover", [f"control.position={{kind: {kind}, feed_forward: none}}", "control.network=null"]
    )
    given = closed_loop(scenario, position_controller=Formula())
    np.testing.assert_allclose(closed_loop(scenario).system.A, given.system.A, atol=1e-12)
    assert link_margins(scenario)["tau_x"].sensitivity == pytest.approx(
        link_margins(scenario, position_controller=Formula())["tau_x"].sensitivity
    )


@pytest.mark.long
@pytest.mark.parametrize("system", [Formula, Plain])
def test_a_study_flies_a_registered_controller_in_fleets(system) -> None:
    scenario = with_position(register_controller(system), RANDOM_MASS)
    study = run_monte_carlo(scenario, 3, num_workers=1)
    errors_of_single_vehicles = [simulate(scenario, sample=sample).metrics.rmse for sample in range(3)]
    np.testing.assert_allclose(study.metrics.rmse, errors_of_single_vehicles, rtol=1e-9)


class IntegralController(Plain):
    """A controller whose integral is a discrete state in Drake."""

    def __init__(self, num_vehicles=1):
        super().__init__(num_vehicles)
        self.DeclareDiscreteState(3 * num_vehicles)
        self.DeclarePeriodicDiscreteUpdateEvent(0.02, 0.0, self.integrate)

    def integrate(self, context, state):
        error = self.reference.Eval(context).reshape(11, -1)[:3] - self.measurement.Eval(context).reshape(12, -1)[:3]
        state.set_value(context.get_discrete_state_vector().CopyToVector() + 0.02 * error.ravel())

    def command(self, context, output):
        super().command(context, output)
        integral = context.get_discrete_state_vector().CopyToVector()
        output.SetFromVector(output.CopyToVector() + 0.4 * integral)


@pytest.mark.long
def test_a_registered_controller_with_a_state_has_the_same_flight_uncompiled_compiled_and_in_studies() -> None:
    scenario = with_position(register_controller(IntegralController), "laboratory.wind=[]")
    uncompiled, compiled = (simulate(scenario, compiled=each) for each in (False, True))
    np.testing.assert_array_equal(compiled.signals["state"], uncompiled.signals["state"])
    without_integral = simulate(with_position(register_controller(Plain), "laboratory.wind=[]"))
    assert not np.allclose(compiled.signals["state"], without_integral.signals["state"], atol=1e-6)
    study = run_monte_carlo(with_position(register_controller(IntegralController), RANDOM_MASS), 3, num_workers=1)
    single = simulate(with_position(register_controller(IntegralController), RANDOM_MASS), sample=2, compiled=True)
    assert study.metrics.rmse[2] == pytest.approx(single.metrics.rmse, rel=1e-9)


class CountingController(Plain):
    """A controller that counts its calls in an attribute of its Python object."""

    def __init__(self, num_vehicles=1):
        super().__init__(num_vehicles)
        self.calls = 0

    def command(self, context, output):
        self.calls += 1
        output.SetFromVector(np.full(output.size(), 1e-3 * self.calls))


@pytest.mark.long
def test_a_study_refuses_a_registered_controller_that_keeps_state_in_its_python_object() -> None:
    scenario = with_position(register_controller(CountingController), RANDOM_MASS)
    with pytest.raises(InputError, match="must store all state in Drake's context, not in Python objects"):
        run_monte_carlo(scenario, 3, num_workers=1)


def test_a_worker_that_has_not_registered_a_controller_registers_it() -> None:
    """A scenario that is pickled for a worker contains the class of the system."""
    kind = register_controller(Formula)
    scenario = with_position(kind, "control.position.k_p=0.5")
    pickled = pickle.dumps(scenario)
    assert pickle.loads(pickled) == scenario
    POSITION_CONTROLLERS.remove(kind)
    controller = pickle.loads(pickled).control.position
    assert (controller.kind, controller.k_p, controller.system) == (kind, 0.5, Formula)
    assert POSITION_CONTROLLERS.get(kind) is type(controller)
    control = load_scenario("hover", [f"control={{kind: {register_controller(LevelControl)}}}"])
    assert pickle.loads(pickle.dumps(control)) == control


def test_a_saved_scenario_is_refused_until_its_controller_is_registered(tmp_path: Path) -> None:
    kind = register_controller(Formula)
    scenario = with_position(kind, "control.position.k_p=0.5")
    save_scenario(scenario, tmp_path / "mine.yaml")
    assert load_scenario(tmp_path / "mine.yaml") == scenario
    POSITION_CONTROLLERS.remove(kind)
    with pytest.raises(InputError, match=f"control.position.kind is '{kind}', which a Python file registers"):
        load_scenario(tmp_path / "mine.yaml")
    register_controller(Formula)
    assert load_scenario(tmp_path / "mine.yaml").control.position.k_p == 0.5


class Single(Plain):
    """A controller whose constructor does not accept a number of vehicles."""

    def __init__(self):
        super().__init__(1)


@pytest.mark.slow
def test_a_controller_for_a_single_vehicle_flies_alone_and_is_refused_for_a_fleet() -> None:
    scenario = with_position(register_controller(Single), RANDOM_MASS)
    assert (
        simulate(scenario, sample=0).metrics.rmse
        == simulate(scenario, sample=0, position_controller=Plain()).metrics.rmse
    )
    with pytest.raises(InputError, match="Single flies a single vehicle; for studies and fleets, its constructor must"):
        simulate_samples(scenario, range(2))
    with pytest.raises(InputError, match="Single flies a single vehicle"):
        run_monte_carlo(scenario, 3, num_workers=1)


class NeedsGain(Plain):
    """A controller whose constructor has an argument without default."""

    def __init__(self, gain, num_vehicles=1):
        super().__init__(num_vehicles)


class MisnamedPort(LeafSystem):
    """A system with a misspelt input port."""

    def __init__(self, num_vehicles=1):
        super().__init__()
        self.DeclareVectorInputPort("measurment", BasicVector(12 * num_vehicles))
        self.DeclareVectorInputPort("reference", BasicVector(11 * num_vehicles))
        self.DeclareVectorOutputPort("acceleration_command", BasicVector(3 * num_vehicles), lambda *_: None)


class OneVehiclePorts(Plain):
    """A controller that has ports for one vehicle, even if more vehicles are requested."""

    def __init__(self, num_vehicles=1):
        super().__init__(1)


@pytest.mark.parametrize(
    ("candidate", "message"),
    [
        (NeedsGain, "NeedsGain cannot be built: "),
        (MisnamedPort, "has the input port `measurment`, but may only have `measurement`, `reference`"),
        (OneVehiclePorts, "must have 12 elements for each of 2 vehicles, but has 12"),
        (Plain(), "a controller must be the class of a Drake system"),
        (SimpleNamespace, "has no output port `acceleration_command`, `wrench` or `attitude_target`"),
    ],
)
def test_registering_a_class_or_object_that_is_not_a_controller_is_refused(candidate, message: str) -> None:
    with pytest.raises(InputError) as caught:
        register_controller(candidate)
    assert message in str(caught.value)
