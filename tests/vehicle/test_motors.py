"""Tests of throttles, time constants in both directions, the reaction torque and the battery."""

import numpy as np
import pytest
import scipy
from pydrake.systems.analysis import Simulator

from drake_quad.signals import Charge, RotorSpeed, Throttle, Wrench
from drake_quad.vehicle.allocation import RotorModel, allocate
from drake_quad.vehicle.battery import Battery, battery_load, rotor_power
from drake_quad.vehicle.dynamics import rotor_action
from drake_quad.vehicle.effects import Effects, ReactionTorque
from drake_quad.vehicle.motors import (
    SpinDown,
    ThrottleAllocation,
    ThrottleModel,
    ThrustCurve,
    allocate_throttle,
    nominal_rotor_speeds,
    rotor_speeds_of_throttles,
    throttle_from_thrust,
    thrust_from_throttle,
)
from drake_quad.vehicle.parameters import CentreOfMass, QuadrotorParameters
from drake_quad.vehicle.quadrotor import Quadrotor, QuadrotorConfig
from drake_quad.vehicle.rotors import Rotors

RISING_CURVES = [
    ThrustCurve(0.1, 1.0, 2.8),
    ThrustCurve(0.0, 0.0, 3.0),
    ThrustCurve(0.2, 4.0, 0.0),
    ThrustCurve(0.0, 4.0, -1.9),
]
# Eschmann, Albani and Loianno (arXiv 2404.07837) identified this curve. It falls before it rises.
CRAZYFLIE_THRUST_CURVE = ThrustCurve(0.0227, -0.0119, 0.1284)


@pytest.mark.parametrize("curve", RISING_CURVES)
def test_the_throttle_for_a_thrust_inverts_the_curve(curve):
    """A root finder agrees with the closed form over the whole curve."""
    for throttle in np.linspace(0.0, 1.0, 21).tolist():
        thrust = thrust_from_throttle(throttle, curve)
        assert thrust == pytest.approx(np.polyval(curve[::-1], throttle), rel=1e-14)
        assert throttle_from_thrust(thrust, curve) == pytest.approx(throttle, abs=1e-12)


def test_the_throttle_is_on_the_rising_branch_of_a_curve_that_falls_at_first():
    throttle = throttle_from_thrust(0.05, CRAZYFLIE_THRUST_CURVE)
    root = scipy.optimize.brentq(lambda u: np.polyval(CRAZYFLIE_THRUST_CURVE[::-1], u) - 0.05, 0.1, 1.0)
    assert throttle == pytest.approx(root, rel=1e-12)


def test_throttles_command_rotor_speeds_by_the_thrust_curve():
    """Throttles are clipped, NaN becomes zero, and a rotor with the mean thrust factor follows the curve."""
    curve = ThrustCurve(0.1, 1.0, 2.8)
    rotors = Rotors.plus().with_thrust_factors(4.0e-5, 4.1e-5, 4.2e-5, 4.3e-5)
    parameters = QuadrotorParameters(rotors=rotors)
    speeds = rotor_speeds_of_throttles(Throttle(0.5, -1.0, 7.0, np.nan), curve, parameters)
    np.testing.assert_allclose(np.square(speeds) * 4.15e-5, [0.1 + 0.5 + 0.7, 0.1, 3.9, 0.1], rtol=1e-12)


def test_allocated_throttles_produce_the_wrench(asymmetric_vehicle):
    """Rotors that follow the throttles produce the wrench if the model of the autopilot is exact."""
    b = 4.1e-5
    rotors = asymmetric_vehicle.rotors.with_thrust_factors(b, b, b, b)
    parameters = asymmetric_vehicle._replace(rotors=rotors, centre_of_mass=CentreOfMass())
    model = ThrottleModel.of(parameters, RISING_CURVES[0])
    wrench = Wrench(7.1, 0.05, -0.08, 0.003)
    command, shortfall = allocate_throttle(wrench, model)
    assert all(0.0 < throttle < 1.0 for throttle in command)
    assert shortfall == (0.0, 0.0, 0.0, 0.0)
    speeds = rotor_speeds_of_throttles(command, model.curve, parameters)
    np.testing.assert_allclose(rotor_action(speeds, parameters).wrench, wrench, rtol=1e-12)


def test_zero_and_full_throttle_limit_the_wrench():
    """The rotor speeds at zero and full throttle are inside the limits of the rotor speeds."""
    parameters = QuadrotorParameters(max_rotor_speed=1e4, min_rotor_speed=0.0)
    model = ThrottleModel.of(parameters, ThrustCurve(0.3, 1.0, 1.2))
    command, shortfall = allocate_throttle(Wrench(20.0, 0.0, 0.0, 0.0), model)
    np.testing.assert_allclose(command, 1.0, rtol=1e-12)
    assert shortfall.thrust == pytest.approx(20.0 - 4.0 * 2.5)
    command, shortfall = allocate_throttle(Wrench(0.5, 0.0, 0.0, 0.0), model)
    np.testing.assert_allclose(command, 0.0, atol=1e-12)
    assert shortfall.thrust == pytest.approx(0.5 - 4.0 * 0.3)


def test_rotor_speed_limits_also_apply_to_throttles(asymmetric_vehicle):
    rotors = RotorModel.of(asymmetric_vehicle)
    model = ThrottleModel.of(asymmetric_vehicle, ThrustCurve(0.0, 0.0, 100.0))
    for thrust in (0.1, 100.0):
        wrench = Wrench(thrust, 0.0, 0.0, 0.0)
        command, shortfall = allocate_throttle(wrench, model)
        expected = allocate(wrench, rotors)
        np.testing.assert_allclose(shortfall, expected.shortfall, rtol=1e-12)
        speeds = [np.sqrt(100.0 * throttle**2 / model.thrust_factor) for throttle in command]
        np.testing.assert_allclose(speeds, expected.rotor_speed_command, rtol=1e-12)


def test_an_autopilot_with_a_wrong_thrust_curve_must_command_other_rotor_speeds(asymmetric_vehicle):
    """`nominal_rotor_speeds` returns the commands with which the rotors actually turn at the given speeds."""
    vehicle = ThrottleModel.of(asymmetric_vehicle, ThrustCurve(0.2, 0.9, 3.3))
    nominal = ThrottleModel.of(QuadrotorParameters(), ThrustCurve(0.1, 1.1, 2.7))
    speeds = RotorSpeed(200.0, 210.0, 190.0, 205.0)
    commanded_speeds = nominal_rotor_speeds(speeds, vehicle, nominal)
    thrusts = nominal.thrust_factor * np.square(commanded_speeds)
    command = Throttle(*(throttle_from_thrust(thrust, nominal.curve) for thrust in thrusts))
    np.testing.assert_allclose(
        rotor_speeds_of_throttles(command, vehicle.curve, asymmetric_vehicle), speeds, rtol=1e-12
    )
    assert np.abs(np.subtract(commanded_speeds, speeds)).min() > 1.0


@pytest.mark.parametrize("paired", [False, True])
def test_the_system_throttle_allocation_agrees_with_its_formula(asymmetric_vehicle, paired):
    model = ThrottleModel.of(QuadrotorParameters() if paired else asymmetric_vehicle, RISING_CURVES[0])
    system = ThrottleAllocation(paired=paired, parameters=model)
    context = system.CreateDefaultContext()
    wrench = Wrench(6.0, 0.01, 0.02, 0.001)
    system.GetInputPort("wrench").FixValue(context, wrench)
    command, shortfall = allocate_throttle(wrench, model)
    output = system.get_output_port().Eval(context)
    np.testing.assert_allclose(output, [*command, *shortfall], rtol=1e-12, atol=1e-15)


def vehicle_and_context_after(effects, command, duration, time_step, parameters, initial=None):
    """Return a vehicle and its context after some time with a constant command."""
    config = QuadrotorConfig(parameters, effects=effects)
    vehicle = Quadrotor(time_step=time_step, effects=effects.names, parameters=config)
    simulator = Simulator(vehicle)
    context = simulator.get_mutable_context()
    if initial is not None and time_step > 0.0:
        vehicle.set_state(context, "rotor_speed", initial)
    elif initial is not None:
        state = vehicle.get_state(context, "continuous")
        vehicle.set_state(context, "continuous", state._replace(rotors=initial))
    port = "throttle_command" if effects.thrust_curve else "rotor_speed_command"
    vehicle.GetInputPort(port).FixValue(context, np.asarray(command, dtype=float))
    simulator.get_mutable_integrator().set_target_accuracy(1e-8)
    simulator.AdvanceTo(duration)
    simulator.AdvancePendingEvents()
    return vehicle, context


@pytest.mark.parametrize("time_step", [0.01, 0.0])
def test_rotors_speed_up_and_slow_down_with_different_time_constants(time_step):
    parameters = QuadrotorParameters(rotor_time_constant=0.03)
    effects = Effects(spin_down=SpinDown(0.08))
    initial, command = RotorSpeed(100.0, 280.0, 150.0, 200.0), [200.0, 150.0, 260.0, 90.0]
    vehicle, context = vehicle_and_context_after(effects, command, 0.05, time_step, parameters, initial)
    speeds = vehicle.GetOutputPort("rotor_speed").Eval(context)
    lags = np.array([0.03, 0.08, 0.03, 0.08])
    expected = command + (np.array(initial) - command) * np.exp(-0.05 / lags)
    np.testing.assert_allclose(speeds, expected, rtol=1e-6 if time_step == 0.0 else 1e-12)


@pytest.mark.parametrize("time_step", [0.01, 0.0])
def test_body_and_rotors_conserve_angular_momentum(time_step):
    """The sum of the angular momenta of body and rotors about z is constant if the rotors have no drag."""
    rotor_inertia = 2.0e-4
    parameters = QuadrotorParameters(rotor_inertia=rotor_inertia, rotors=Rotors.plus(drag_factor=1e-30))
    effects = Effects(reaction_torque=ReactionTorque(rotor_inertia), spin_down=SpinDown(0.09))
    initial, command = RotorSpeed(200.0, 200.0, 200.0, 200.0), [150.0, 250.0, 150.0, 250.0]
    vehicle, context = vehicle_and_context_after(effects, command, 0.2, time_step, parameters, initial)
    speeds = RotorSpeed(*vehicle.GetOutputPort("rotor_speed").Eval(context))
    *_, r = vehicle.GetOutputPort("state").Eval(context)
    residual = -speeds.rotor_1 + speeds.rotor_2 - speeds.rotor_3 + speeds.rotor_4
    assert residual > 150.0
    # The step integrates an exponential by Simpson's rule, whose error is of order h⁵.
    assert parameters.inertia.i_zz * r + rotor_inertia * residual == pytest.approx(
        0.0, abs=1e-5 * rotor_inertia * residual
    )


BATTERY = Battery(voltage=12.6, empty_voltage=10.2, capacity=0.05, resistance=0.04, efficiency=0.65)


def test_the_voltage_under_load_satisfies_the_circuit_equations():
    """The closed form agrees with a numerical solution of Kirchhoff's voltage law and the power balance."""
    for charge, power in ((0.0, 0.0), (0.01, 80.0), (0.04, 150.0)):
        voltage, current = battery_load(Charge(charge), power, BATTERY)
        open_circuit_voltage = np.interp(charge, [0.0, 0.05], [12.6, 10.2])

        def circuit(unknown, open_circuit_voltage=open_circuit_voltage, power=power):
            v, i = unknown
            return [v - open_circuit_voltage + 0.04 * i, 0.65 * v * i - power]

        np.testing.assert_allclose(
            [voltage, current], scipy.optimize.fsolve(circuit, [12.0, 5.0]), rtol=1e-9, atol=1e-9
        )
    assert battery_load(Charge(0.0), 0.0, BATTERY).voltage == 12.6


def test_an_overloaded_battery_delivers_its_maximum_power():
    voltage, _ = battery_load(Charge(0.0), 1e5, BATTERY)
    assert voltage == pytest.approx(6.3)
    assert battery_load(Charge(100.0), 10.0, BATTERY).voltage == pytest.approx(0.0, abs=1e-90)


@pytest.mark.slow
@pytest.mark.parametrize("time_step", [0.01, 0.0])
def test_the_rotors_discharge_the_battery(time_step):
    """The vehicle agrees with an independent integration of the charge and one rotor speed."""
    parameters = QuadrotorParameters(rotors=Rotors.plus(drag_factor=1.2e-6))
    vehicle, context = vehicle_and_context_after(Effects(battery=BATTERY), [240.0] * 4, 3.0, time_step, parameters)

    def derivative(_, y):
        speed_of_rotor, drawn_charge = y
        power = 4.0 * 1.2e-6 * speed_of_rotor**3 / 0.65
        open_circuit_voltage = 12.6 - 2.4 * drawn_charge / 0.05
        voltage = scipy.optimize.brentq(
            lambda v: v * (open_circuit_voltage - v) / 0.04 - power, 0.6 * open_circuit_voltage, open_circuit_voltage
        )
        return [(240.0 * voltage / 12.6 - speed_of_rotor) / 0.05, power / voltage / 3600.0]

    start = [np.sqrt(0.68 * 9.81 / 4.0 / 4.13e-5), 0.0]
    speed, drawn_charge = scipy.integrate.solve_ivp(derivative, (0.0, 3.0), start, rtol=1e-9, atol=1e-12).y[:, -1]
    assert speed < 230.0
    speeds = vehicle.GetOutputPort("rotor_speed").Eval(context)
    # A vehicle with time steps is less exact than one with a continuous state, because the voltage at the beginning of
    # a step is used for the whole step.
    np.testing.assert_allclose(speeds, speed, rtol=2e-4 if time_step else 1e-5)
    charge = vehicle.GetOutputPort("charge").Eval(context)
    np.testing.assert_allclose(charge, drawn_charge, rtol=1e-3 if time_step else 1e-5)


def test_rotor_power_is_torque_times_speed():
    speeds = RotorSpeed(100.0, 200.0, -50.0, 0.0)
    parameters = QuadrotorParameters(rotors=Rotors.plus(drag_factor=1e-6))
    assert rotor_power(speeds, parameters) == pytest.approx(1e-6 * (1e6 + 8e6 + 1.25e5))
