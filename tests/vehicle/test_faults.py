"""Tests of vehicles with rotor faults, a sagging battery or a displaced centre of mass."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from drake_quad.signals import RotorSpeed, State, Wind
from drake_quad.vehicle.attitude_kinematics import RIGID_KINEMATICS
from drake_quad.vehicle.dynamics import hover_rotor_speeds, rotor_action
from drake_quad.vehicle.effects import NO_EFFECTS
from drake_quad.vehicle.faults import RotorFaults, SpeedFactors, speed_factors
from drake_quad.vehicle.parameters import CentreOfMass, QuadrotorParameters
from drake_quad.vehicle.quadrotor import Quadrotor, QuadrotorConfig
from drake_quad.vehicle.rotors import Rotors
from drake_quad.vehicle.stepping import VehicleState, quadrotor_derivatives

ASYMMETRIC_VEHICLE = QuadrotorParameters(
    mass=0.73,
    rotors=Rotors.plus().with_thrust_factors(4.3e-5, 4.0e-5, 4.2e-5, 3.9e-5),
    centre_of_mass=CentreOfMass(0.012, -0.007),
    linear_drag=0.2,
)


def vehicle_with_faults(faults, **structure):
    return Quadrotor(faulty=True, parameters=QuadrotorConfig(faults=faults), **structure)


def level_slope(speeds, parameters):
    """Return the derivative of the state of a level vehicle at rest whose rotors turn at their commanded speeds."""
    state, no_wind = VehicleState(State(*[0.0] * 12), speeds), Wind(0.0, 0.0, 0.0)
    slope = quadrotor_derivatives(state, speeds, no_wind, None, parameters, None, NO_EFFECTS, 0.0, RIGID_KINEMATICS)
    return slope.body, slope.rotors


def state_and_speeds_after(vehicle, command, duration):
    """Return the state and the rotor speeds of a vehicle after some time with a constant command."""
    simulator = Simulator(vehicle)
    context = simulator.get_mutable_context()
    vehicle.GetInputPort("rotor_speed_command").FixValue(context, np.asarray(command, dtype=float))
    simulator.AdvanceTo(duration)
    simulator.AdvancePendingEvents()
    return (vehicle.GetOutputPort(name).Eval(context) for name in ("state", "rotor_speed"))


def test_hover_speeds_balance_any_rotors_and_any_centre_of_mass():
    speeds = hover_rotor_speeds(ASYMMETRIC_VEHICLE)
    assert np.ptp(speeds) > 5.0
    body, rotors = level_slope(speeds, ASYMMETRIC_VEHICLE)
    np.testing.assert_allclose([*body, *rotors], 0.0, atol=1e-12)


def test_a_displaced_centre_of_mass_causes_a_torque():
    """Rotor 3 has the longer lever arm if the centre of mass is closer to rotor 1, so the nose drops."""
    parameters = QuadrotorParameters(centre_of_mass=CentreOfMass(0.01, 0.02))
    speeds = RotorSpeed(210.0, 190.0, 205.0, 195.0)
    thrusts = 4.13e-5 * np.square(speeds)
    x, y = np.array([0.17, 0.0, -0.17, 0.0]) - 0.01, np.array([0.0, -0.17, 0.0, 0.17]) - 0.02
    slope, _ = level_slope(speeds, parameters)
    np.testing.assert_allclose([slope.p, slope.q], [y @ thrusts / 0.007, -x @ thrusts / 0.007], rtol=1e-12)


def test_each_rotor_has_its_own_thrust_factor():
    wrench = rotor_action(RotorSpeed(*(100.0,) * 4), ASYMMETRIC_VEHICLE._replace(centre_of_mass=CentreOfMass())).wrench
    assert wrench.thrust == pytest.approx(1e4 * sum(ASYMMETRIC_VEHICLE.rotors.thrust_factors))
    assert wrench.tau_x == pytest.approx(0.17 * 1e4 * (3.9e-5 - 4.0e-5))
    assert wrench.tau_y == pytest.approx(0.17 * 1e4 * (4.2e-5 - 4.3e-5))


def test_speed_factors_combine_battery_and_failure():
    """A failure acts from the given time on. An empty battery stops all rotors, and no rotor turns backwards."""
    faults = RotorFaults(battery_sag=0.1, failure_time=4.0, failure_factor=SpeedFactors(0.9, 0.8, 0.7, 0.6))
    for time, factors in (
        (0.0, (1.0,) * 4),
        (3.999, (0.6001,) * 4),
        (4.0, (0.54, 0.48, 0.42, 0.36)),
        (20.0, (0.0,) * 4),
    ):
        assert speed_factors(faults, time) == pytest.approx(factors)
    assert speed_factors(RotorFaults(), 1e9) == (1.0,) * 4


@pytest.mark.parametrize("time_step", [0.01, 0.0])
def test_battery_sag_reduces_all_rotor_speeds_linearly_in_time(time_step):
    vehicle = vehicle_with_faults(RotorFaults(battery_sag=0.02), time_step=time_step)
    _, speeds = state_and_speeds_after(vehicle, [200.0] * 4, 5.0)
    # The rotors lag behind a command that decreases by 4 rad/s².
    np.testing.assert_allclose(speeds, 200.0 * (1.0 - 0.02 * 5.0) + 4.0 * 0.05, atol=0.03)


@pytest.mark.parametrize("time_step", [0.01, 0.0])
def test_a_rotor_fails_at_the_given_time(time_step):
    faults = RotorFaults(failure_time=0.5, failure_factor=SpeedFactors(rotor_3=0.25))
    vehicle = vehicle_with_faults(faults, time_step=time_step)
    _, speeds_before = state_and_speeds_after(vehicle, [200.0] * 4, 0.5)
    np.testing.assert_allclose(speeds_before, 200.0, atol=0.9)
    state, speeds_after = state_and_speeds_after(vehicle, [200.0] * 4, 0.55)
    expected = 50.0 + 150.0 * np.exp(-0.05 / 0.05)
    np.testing.assert_allclose(speeds_after, [200.0, 200.0, expected, 200.0], atol=0.5)
    # Rotor 3 is at -x, so the tail drops.
    assert State(*state).pitch < -0.01


def test_vehicles_of_a_fleet_have_individual_faults():
    faults = RotorFaults(
        battery_sag=np.array([0.0, 0.1]),
        failure_time=np.array([0.2, np.inf]),
        failure_factor=SpeedFactors(rotor_2=np.array([0.0, 1.0])),
    )
    _, speeds = state_and_speeds_after(vehicle_with_faults(faults, num_vehicles=2), [200.0] * 8, 1.0)
    for i in range(2):
        failure_factor = SpeedFactors(rotor_2=faults.failure_factor.rotor_2[i])
        faults_of_vehicle = RotorFaults(faults.battery_sag[i], faults.failure_time[i], failure_factor)
        _, expected = state_and_speeds_after(vehicle_with_faults(faults_of_vehicle), [200.0] * 4, 1.0)
        np.testing.assert_allclose(speeds.reshape(4, 2)[:, i], expected, rtol=1e-12)


def test_all_speed_factors_are_one_without_faults():
    assert RotorFaults() == (0.0, np.inf, (1.0, 1.0, 1.0, 1.0))
    assert speed_factors(RotorFaults(), 100.0) == (1.0, 1.0, 1.0, 1.0)
