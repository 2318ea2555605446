"""Tests that the effect of wind on the vehicle agrees with calculations by hand, and that sources of wind add up."""

import math

import numpy as np
import pytest
import scipy
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import BasicVector, DiagramBuilder, LeafSystem

from drake_quad import InputError, load_scenario, simulate
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.laboratory.wind.fans import Direction, Jet, Outlet, jet_speed
from drake_quad.laboratory.wind.gust import Gust, GustParameters
from drake_quad.laboratory.wind.sine import SineParameters, SineWind
from drake_quad.laboratory.wind.wind import SteadyWind
from drake_quad.scenario.winds.source import jets
from drake_quad.signals import State, Wind
from drake_quad.vehicle.parameters import QuadrotorParameters
from drake_quad.vehicle.quadrotor import Quadrotor, QuadrotorConfig

MASS = 0.68  # kg
G = 9.81  # m/s²


def test_drag_balances_the_weight_at_terminal_velocity():
    """The drag c₁ v + c₂ v² equals m g - 4 b ω² if the rotors turn at idle speed."""
    parameters = QuadrotorParameters(linear_drag=0.2, quadratic_drag=0.01)
    vehicle = Quadrotor(parameters=QuadrotorConfig(parameters))
    simulator = Simulator(vehicle)
    context = simulator.get_mutable_context()
    vehicle.GetInputPort("rotor_speed_command").FixValue(context, np.zeros(4))
    simulator.AdvanceTo(30.0)
    sink_rate = -State(*vehicle.GetOutputPort("state").Eval(context)).v_z
    drag = MASS * G - 4.0 * 4.13e-5 * 60.0**2
    by_hand = (-0.2 + math.sqrt(0.2**2 + 4.0 * 0.01 * drag)) / (2.0 * 0.01)
    assert by_hand == pytest.approx(16.60, abs=0.01)
    assert sink_rate == pytest.approx(by_hand, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("velocity", [(4.0, 0.0, 0.0), (0.0, -3.0, 0.0), (1.5, 2.0, 0.0)])
def test_the_vehicle_leans_into_a_steady_wind(diagrams, velocity):
    """The tilt is atan(D / (m g)). The position error is D / (m k_P) downwind, since there is no integral action."""
    wind = f"laboratory.wind=[{{kind: steady, velocity: {list(velocity)}}}]"
    drag = ["vehicle.linear_drag=0.2", "vehicle.quadratic_drag=0.01"]
    long_flight = ["route.duration=40", "crash.position_error=20"]
    scenario = load_scenario(diagrams / "hover.yaml", [*long_flight, *drag, wind])
    flight, k_p = simulate(scenario), scenario.control.position.k_p[0]
    speed = math.hypot(*velocity)
    force = 0.2 * speed + 0.01 * speed**2
    direction = np.array(velocity) / speed
    state = State(*flight["state"][-1])
    displacement = np.array([state.x, state.y, state.z - 1.0])
    np.testing.assert_allclose(displacement, force / (MASS * k_p) * direction, atol=1e-3)
    thrust = math.hypot(MASS * G, force)
    assert math.sin(state.roll) == pytest.approx(force * direction[1] / thrust, rel=0.01, abs=1e-6)
    assert math.tan(state.pitch) == pytest.approx(-force * direction[0] / (MASS * G), rel=0.01, abs=1e-6)


def test_the_velocity_of_a_vehicle_in_a_gust_agrees_with_the_closed_form():
    """The equation m v' = c (w - v) of a level vehicle, with w = h (1 - cos(π t / d)) / 2, is solved by hand."""
    c, height, rise = 0.3, 4.0, 1.5
    parameters = QuadrotorParameters(linear_drag=c)
    builder = DiagramBuilder()
    vehicle = builder.AddNamedSystem("vehicle", Quadrotor(parameters=QuadrotorConfig(parameters)))
    gust = builder.AddNamedSystem("gust", Gust(parameters=GustParameters(Wind(height, 0.0, 0.0), 0.5, rise)))
    builder.Connect(gust.GetOutputPort("wind"), vehicle.GetInputPort("wind"))
    builder.ExportInput(vehicle.GetInputPort("rotor_speed_command"), "command")
    diagram = builder.Build()
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    hover = math.sqrt(MASS * G / (4.0 * 4.13e-5))
    diagram.get_input_port().FixValue(context, np.full(4, hover))
    a, w = c / MASS, math.pi / rise
    for time in (1.0, 2.0, 4.0):
        simulator.AdvanceTo(time)
        simulator.AdvancePendingEvents()
        velocity = vehicle.get_state(vehicle.GetMyContextFromRoot(context), "state").v_x

        def velocity_while_rising(t):
            part = (a * math.cos(w * t) + w * math.sin(w * t)) * a / (a * a + w * w)
            return 0.5 * height * (1.0 - part - math.exp(-a * t) * (1.0 - a * a / (a * a + w * w)))

        t = time - 0.5
        expected = (
            velocity_while_rising(t)
            if t < rise
            else height + (velocity_while_rising(rise) - height) * math.exp(-a * (t - rise))
        )
        assert velocity == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("n", [1, 3])
def test_a_sine_is_sampled_at_the_middle_of_a_step(n):
    offsets = np.arange(float(n)) if n > 1 else 0.0
    config = SineParameters(Wind(-2.4 + offsets, 0.5, 0.1), 1.3, 0.2 + offsets)
    wind = SineWind(num_vehicles=n, period=0.02, parameters=config)
    simulator = Simulator(wind)
    for tick in (0, 1, 57):
        simulator.AdvanceTo(0.02 * tick)
        simulator.AdvancePendingEvents()
        velocity = wind.get_output_port().Eval(simulator.get_context()).reshape(3, n)
        fraction = np.sin(1.3 * (0.02 * tick + 0.01) + 0.2 + offsets)
        np.testing.assert_allclose(
            velocity,
            fraction * np.array([-2.4 + offsets, 0.5 + 0 * offsets, 0.1 + 0 * offsets]).reshape(3, n),
            rtol=1e-12,
        )


def test_the_closed_form_of_the_velocity_in_a_gust_agrees_with_scipy():
    """The closed form was derived by hand."""
    c, height, rise = 0.3, 4.0, 1.5
    a, w = c / MASS, math.pi / rise
    solution = scipy.integrate.solve_ivp(
        lambda t, v: a * (0.5 * height * (1 - math.cos(w * t)) - v), (0.0, rise), [0.0], rtol=1e-10
    )
    part = (a * math.cos(w * rise) + w * math.sin(w * rise)) * a / (a * a + w * w)
    by_hand = 0.5 * height * (1.0 - part - math.exp(-a * rise) * (1.0 - a * a / (a * a + w * w)))
    assert solution.y[0, -1] == pytest.approx(by_hand, rel=1e-6)


@pytest.mark.slow
def test_sources_of_wind_add_up(diagrams):
    steady = "{kind: steady, velocity: [1, 0, 0]}"
    gust = "{kind: gust, velocity: [0, 2, 0], start: 0, rise_time: 0.5}"
    overrides = ["duration=2", f"laboratory.wind=[{steady}, {gust}, {steady}]"]
    flight = simulate(load_scenario(diagrams / "hover.yaml", overrides))
    np.testing.assert_allclose(flight["wind"][-1], [2.0, 2.0, 0.0], atol=1e-12)


@pytest.mark.slow
def test_turbulence_has_the_speed_and_heading_of_the_steady_wind_by_default(diagrams):
    steady = "{kind: steady, velocity: [0, 6, 0]}"
    winds = []
    for dryden in ("{kind: dryden}", f"{{kind: dryden, airspeed: 6, heading: {math.pi / 2}}}"):
        scenario = load_scenario(diagrams / "hover.yaml", ["duration=2", f"laboratory.wind=[{steady}, {dryden}]"])
        winds.append(simulate(scenario)["wind"])
    np.testing.assert_allclose(winds[0], winds[1], atol=1e-12)
    assert winds[0].std() > 0.1


def test_steady_wind_is_constant_and_can_differ_between_vehicles():
    system = SteadyWind(num_vehicles=2, parameters=Wind(0.7, np.array([-0.5, 1.5]), 0.3))
    context = system.CreateDefaultContext()
    for time in (0.0, 100.0):
        context.SetTime(time)
        np.testing.assert_array_equal(system.get_output_port().Eval(context), [0.7, 0.7, -0.5, 1.5, 0.3, 0.3])


@pytest.mark.slow
def test_wind_may_be_given_by_speed_and_heading(diagrams):
    sources = "[{{kind: steady, {0}}}, {{kind: gust, {1}, start: 0.1, rise_time: 0.2}}]"
    by_velocity = sources.format("velocity: [0.0, 2.0, 0.0]", "velocity: [-1.5, 0.0, 0.0]")
    by_speed = sources.format(f"speed: 2.0, heading: {0.5 * math.pi}", f"speed: 1.5, heading: {math.pi}")
    flights = [
        simulate(load_scenario(diagrams / "laboratory.yaml:nominal", ["duration=1", f"laboratory.wind={wind}"]))
        for wind in (by_velocity, by_speed)
    ]
    np.testing.assert_allclose(flights[0]["wind"], flights[1]["wind"], atol=1e-12)
    assert np.abs(flights[0]["wind"][-1]).max() > 1.9


@pytest.mark.parametrize(
    "motion", ["speed: 2.0", "heading: 1.0", "velocity: [1, 0, 0], speed: 1.0, heading: 0.0", "kind: steady"]
)
def test_wind_needs_either_a_velocity_or_a_speed_and_heading(diagrams, motion):
    wind = "{kind: steady}" if motion == "kind: steady" else f"{{kind: steady, {motion}}}"
    with pytest.raises(InputError, match="must have either a velocity or both speed and heading, not"):
        load_scenario(diagrams / "laboratory.yaml:nominal", [f"laboratory.wind=[{wind}]"])


class UserJets(LeafSystem):
    """User-defined wind without a state: the mean wind of jets at the position of each vehicle."""

    def __init__(self, jets, num_vehicles=1):
        super().__init__()
        self.jets = jets
        self.state = self.DeclareVectorInputPort("state", BasicVector(12 * num_vehicles))
        self.DeclareVectorOutputPort("velocity", BasicVector(3 * num_vehicles), self.set_velocity)

    def set_velocity(self, context, output):
        state = State(*self.state.Eval(context).reshape(12, -1))
        velocity = sum(jet_speed(state, jet)[0] * np.reshape(jet.direction, (3, 1)) for jet in self.jets)
        output.SetFromVector(velocity.ravel())


WITHOUT_TURBULENCE = ["duration=6", "laboratory.wind.0.turbulence=0", "laboratory.wind.1.turbulence=0"]


@pytest.mark.slow
def test_a_user_defined_wind_agrees_with_the_same_wind_of_a_scenario(diagrams):
    fans = load_scenario(diagrams / "laboratory.yaml:low_wind", WITHOUT_TURBULENCE)
    without_fans = load_scenario(diagrams / "laboratory.yaml:low_wind", [*WITHOUT_TURBULENCE[:1], "laboratory.wind=[]"])
    flights = [simulate(fans), simulate(without_fans, wind=UserJets(jets(fans.laboratory.wind)))]
    assert np.abs(flights[0]["wind"]).max() > 0.1
    for signal in ("wind", "state"):
        np.testing.assert_allclose(flights[0][signal][1:], flights[1][signal][1:], atol=1e-9)


@pytest.mark.long
def test_a_user_defined_wind_is_added_to_the_scenario_wind_in_single_flights_and_fleets(diagrams):
    steady = "laboratory.wind=[{kind: steady, velocity: [1.0, 0.0, 0.0]}]"
    mass = "vehicle.mass={uniform: {min: 0.6, max: 0.7}}"
    scenario = load_scenario(diagrams / "laboratory.yaml:nominal", ["duration=3", steady, mass])
    jet = Jet(Outlet(0.0, -3.0, 1.0), Direction(0.0, 1.0, 0.0), exit_speed=5.0, diameter=1.0)
    flight = simulate(scenario, sample=1, wind=UserJets([jet]))
    wind = flight.record("wind")
    np.testing.assert_allclose(wind.x[5:], 1.0, atol=1e-12)
    assert wind.y[5:].max() > 0.5
    user_systems = UserSystems(wind=lambda num_vehicles: UserJets([jet], num_vehicles))
    fleet = StudyFleet(scenario, plan_route(scenario), 2, user_systems=user_systems)
    # The second flight reuses the context of the first.
    for _ in range(2):
        assert fleet.fly([0, 1]).rmse[1] == pytest.approx(flight.metrics.rmse, rel=1e-9)
