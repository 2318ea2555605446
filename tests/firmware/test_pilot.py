"""Tests of the inputs of Betaflight against direct formulas."""

import math

import numpy as np
import pytest

from drake_quad.firmware.pilot import PilotParameters, StickPilot, flight_controller_input, motor_command
from drake_quad.laboratory.sensors.accelerometer import SpecificForce
from drake_quad.signals import AttitudeTarget, BodyRates, State, VehicleAcceleration
from drake_quad.testing import check_system
from drake_quad.vehicle.motors import ThrustCurve

PILOT = PilotParameters(8.0, 3.0, 1.5e-6, 2000.0, 9.81)
STATE = State(1.0, 2.0, 30.0, 0.1, -0.2, 3.0, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
REST = VehicleAcceleration(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
TARGET = AttitudeTarget(6.0, 0.3, 0.1, -3.0, 0.01, 0.02, 0.03)


def input_of(mode="angle", follows_attitude=True, gyroscope=None, accelerometer=None):
    return flight_controller_input(TARGET, STATE, REST, gyroscope, accelerometer, PILOT, mode, follows_attitude)


def test_angle_mode_commands_the_angles_and_steers_the_yaw_through_the_shorter_way():
    result = input_of()
    assert (result.roll, result.pitch) == (TARGET.roll, TARGET.pitch)
    assert result.yaw_rate == pytest.approx(TARGET.r + 3.0 * (2.0 * math.pi - 6.0))


def test_acro_mode_commands_rates_that_follow_the_attitude():
    result = input_of(mode="acro")
    assert result.roll == pytest.approx(TARGET.p + 8.0 * (0.3 - 0.1))
    assert result.pitch == pytest.approx(TARGET.q + 8.0 * (0.1 + 0.2))


def test_acro_mode_passes_commanded_rates_on():
    result = input_of(mode="acro", follows_attitude=False)
    assert (result.roll, result.pitch, result.yaw_rate) == (TARGET.p, TARGET.q, TARGET.r)


def test_readings_of_sensors_replace_exact_values():
    exact = input_of()
    assert (exact.p, exact.q, exact.r) == (STATE.p, STATE.q, STATE.r)
    force = np.array([exact.f_x, exact.f_y, exact.f_z])
    assert np.linalg.norm(force) == pytest.approx(9.81)
    assert exact.f_x == pytest.approx(9.81 * math.sin(0.2))  # nose up, so the specific force points forward
    measured = input_of(gyroscope=BodyRates(7.0, 8.0, 9.0), accelerometer=SpecificForce(4.0, 5.0, 6.0))
    assert measured[:6] == (7.0, 8.0, 9.0, 4.0, 5.0, 6.0)
    assert measured[6:] == exact[6:]


def test_the_pressure_is_that_of_the_standard_atmosphere():
    """ISO 2533 gives 100,966 Pa at 30 m: 101,325 Pa times (1 - 0.0065 K/m · 30 m / 288.15 K)^5.2559."""
    assert input_of().pressure == pytest.approx(101_325.0 * (1.0 - 0.0065 * 30.0 / 288.15) ** 5.2559, abs=0.3)


def test_the_motor_command_produces_the_thrust():
    command = motor_command(6.0, PILOT)
    assert 4.0 * 1.5e-6 * (2000.0 * command) ** 2 == pytest.approx(6.0)
    curve = ThrustCurve(0.1, 2.0, 3.0)
    command = motor_command(6.0, PILOT._replace(curve=curve))
    assert 0.1 + 2.0 * command + 3.0 * command**2 == pytest.approx(1.5)
    assert motor_command(-1.0, PILOT) == 0.0


@pytest.mark.parametrize("mode", ["angle", "acro"])
def test_the_pilot_obeys_the_rules_of_systems(mode):
    assert "derivatives" in check_system(lambda n: StickPilot(num_vehicles=n, mode=mode, parameters=PILOT))
