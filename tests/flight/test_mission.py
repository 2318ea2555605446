"""Tests of the laboratory and the vehicle of a scenario as parts of plain Drake diagrams."""

import re

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem
from pydrake.systems.primitives import Linearize

from drake_quad import (
    InputError,
    build_laboratory_diagram,
    build_tracking_diagram,
    build_vehicle,
    load_scenario,
    plan_route,
)
from drake_quad.reference.source import build_reference
from drake_quad.signals import Reference, State, Wrench


class Cascade(LeafSystem):
    """PD cascade for small angles in plain Python."""

    def __init__(self, num_vehicles=1):
        super().__init__()
        self.measurement = self.DeclareVectorInputPort("measurement", BasicVector(12 * num_vehicles))
        self.reference = self.DeclareVectorInputPort("reference", BasicVector(11 * num_vehicles))
        self.DeclareVectorOutputPort("wrench", BasicVector(4 * num_vehicles), self.command)

    def command(self, context, output):
        m = State(*self.measurement.Eval(context).reshape(12, -1))
        r = Reference(*self.reference.Eval(context).reshape(11, -1))
        a_x, a_y, a_z = (
            e + 1.4 * v for e, v in ((r.x - m.x, r.v_x - m.v_x), (r.y - m.y, r.v_y - m.v_y), (r.z - m.z, r.v_z - m.v_z))
        )
        wrench = Wrench(
            0.68 * (9.81 + a_z),
            0.007 * (50.0 * (-a_y / 9.81 - m.roll) - 10.0 * m.p),
            0.007 * (50.0 * (a_x / 9.81 - m.pitch) - 10.0 * m.q),
            0.012 * (4.0 * (r.yaw - m.yaw) - 4.0 * m.r),
        )
        output.SetFromVector(np.ravel(wrench))


@pytest.mark.slow
@pytest.mark.parametrize("num_vehicles", [1, 3])
def test_a_manually_connected_loop_flies_exactly_like_the_tracking_diagram(num_vehicles):
    """Wind, noise and lost packets are the same, so the flights are bitwise equal."""
    scenario = load_scenario("laboratory:low_wind", ["sample=5", "seed=7"])
    builder = DiagramBuilder()
    reference = builder.AddSystem(build_reference(plan_route(scenario), num_vehicles=num_vehicles))
    control = builder.AddSystem(Cascade(num_vehicles))
    laboratory = builder.AddSystem(build_laboratory_diagram(scenario, num_vehicles))
    builder.Connect(reference.GetOutputPort("reference"), control.GetInputPort("reference"))
    builder.Connect(control.GetOutputPort("wrench"), laboratory.GetInputPort("wrench"))
    builder.Connect(laboratory.GetOutputPort("measurement"), control.GetInputPort("measurement"))
    builder.ExportOutput(laboratory.GetOutputPort("state"), "state")
    loops = [builder.Build(), build_tracking_diagram(scenario, num_vehicles, control=Cascade(num_vehicles))]
    states = []
    for loop in loops:
        simulator = Simulator(loop)
        simulator.AdvanceTo(2.0)
        states.append(loop.GetOutputPort("state").Eval(simulator.get_context()).copy())
    np.testing.assert_array_equal(*states)
    assert np.linalg.norm(states[0].reshape(12, -1)[6:9], axis=0).min() > 0.1


@pytest.mark.parametrize(
    ("name", "overrides", "distinct_port"),
    [
        ("hover", [], "wrench"),
        ("onboard", [], "attitude_target"),
        ("hover", ["vehicle.slung_load={mass: 0.05, length: 0.5}"], "swing"),
    ],
)
def test_the_docstring_of_the_laboratory_lists_its_ports_and_their_sizes(name, overrides, distinct_port):
    text = build_laboratory_diagram.__doc__
    rows = {}
    for names, number in re.findall(r"(`[^()]+) \((\d+)\s+rows?[):,]", text):
        rows |= {port: int(number) for port in re.findall(r"`(\w+)`", names)}
    laboratory = build_laboratory_diagram(load_scenario(name, overrides), num_vehicles=2)
    ports = [laboratory.get_input_port(i) for i in range(laboratory.num_input_ports())]
    ports += [laboratory.get_output_port(i) for i in range(laboratory.num_output_ports())]
    sizes = {port.get_name(): port.size() for port in ports}
    assert sizes == {port: 2 * rows[port] for port in sizes}
    assert distinct_port in sizes


def test_the_vehicle_of_a_scenario_obeys_newton_and_hovers_at_the_start_of_its_route():
    scenario = load_scenario(
        "hover", ["vehicle.time_step=0", "vehicle.mass=0.8", "nominal.mass=0.7", "route.position=[1, 2, 3]"]
    )
    vehicle = build_vehicle(scenario)
    context = vehicle.CreateDefaultContext()
    factor, mass, gravity = scenario.vehicle.thrust_factor, scenario.vehicle.mass, scenario.vehicle.gravity
    hover = np.sqrt(mass * gravity / (4.0 * factor))
    command = vehicle.GetInputPort("rotor_speed_command")
    command.FixValue(context, np.full(4, hover))
    state = State(*vehicle.GetOutputPort("state").Eval(context))
    np.testing.assert_allclose([state.x, state.y, state.z], [1.0, 2.0, 3.0])
    rates = vehicle.EvalTimeDerivatives(context).CopyToVector()
    np.testing.assert_allclose(rates, np.zeros(16), atol=1e-12)
    # Rotors that turn 10 % faster exert 21 % more thrust.
    speeds = 1.1 * vehicle.GetOutputPort("rotor_speed").Eval(context)
    context.SetContinuousState([*state, *speeds])
    rates = State(*vehicle.EvalTimeDerivatives(context).CopyToVector()[:12])
    assert rates.v_z == pytest.approx(0.21 * gravity)
    # The tilted thrust accelerates the vehicle by g per radian of pitch in the linear model of a hover.
    context.SetContinuousState([*state, *np.full(4, hover)])
    plant = Linearize(vehicle, context, command.get_index(), vehicle.GetOutputPort("state").get_index())
    fields = State._fields
    assert plant.A()[fields.index("v_x"), fields.index("pitch")] == pytest.approx(gravity)
    assert plant.A()[fields.index("v_y"), fields.index("roll")] == pytest.approx(-gravity)


def test_diagrams_of_scenarios_with_distributions_are_refused():
    uncertain = load_scenario("hover", ["vehicle.mass={uniform: {min: 0.6, max: 0.7}}"])
    for build in (build_laboratory_diagram, build_vehicle, build_tracking_diagram):
        with pytest.raises(InputError, match=r"vehicle\.mass"):
            build(uncertain)


def test_random_sources_of_drake_can_replace_the_noise_of_a_sample():
    scenario = load_scenario("laboratory:nominal")
    laboratory = build_laboratory_diagram(scenario, drake_random=True)
    names = {type(system).__name__ for system in laboratory.GetSystems()}
    assert "RandomSource" in names
    assert "NoiseSource" not in names


def test_the_message_about_a_scenario_with_distributions_names_the_function_that_draws_a_sample():
    with pytest.raises(InputError, match=r"is a distribution, .* draw_sample\(scenario, 0\) in Python"):
        build_vehicle(load_scenario("robustness"))
