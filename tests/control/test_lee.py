"""Tests of geometric control, compared with NumPy implementations of the published law and the Crazyflie's firmware.

The law is that of T. Lee, M. Leok and N. H. McClamroch, "Geometric tracking control of a quadrotor UAV on SE(3)",
CDC 2010, with Z up. The firmware's law is `controller_lee.c` of bitcraze/crazyflie-firmware at 2a18fc2.
"""

import math

import numpy as np
import pytest
import scipy

from drake_quad import load_scenario, read_log, simulate
from drake_quad.control.attitude import AttitudeParameters
from drake_quad.control.geometric import geometric_law
from drake_quad.control.thrust_vectoring import ThrustLimits, VectoringParameters, vectored_thrust
from drake_quad.geometry.axes import BodyAxes
from drake_quad.geometry.per_axis import PerAngle
from drake_quad.signals import Acceleration, AngularAcceleration, Jerk, Reference, State

G = 9.81  # m/s²
MASS = 0.0325  # kg
INERTIA = np.array([16.571710e-6, 16.655602e-6, 29.261652e-6])  # kg m²
# The commands never reach these limits, so the law equals the published one.
VECTORING_PARAMETERS = VectoringParameters(MASS, G, ThrustLimits(tan_max_tilt=1e3, min_thrust=1e-6, max_thrust=1e3))
# Gains k_P in 1/s² and k_D in 1/s, and moments of inertia in kg m².
GAINS = AttitudeParameters(PerAngle(420.0, 430.0, 270.0), PerAngle(70.0, 69.0, 68.0), *INERTIA)
K_P = np.array(GAINS.k_p)
K_D = np.array(GAINS.k_d)


def rotation_of(roll, pitch, yaw):
    return scipy.spatial.transform.Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()


def rotation_error(R, R_d):
    """Return the rotation error ½ (R_dᵀ R - Rᵀ R_d)^∨ of an attitude R from the commanded attitude R_d."""
    skew = 0.5 * (R_d.T @ R - R.T @ R_d)
    return np.array([skew[2, 1], skew[0, 2], skew[1, 0]])


def commanded_rotation(force, yaw):
    """Return R_c = [b_2c x b_3c, b_2c, b_3c] with b_3c along the force and b_2c ∝ b_3c x (cos ψ, sin ψ, 0)."""
    b_3 = force / np.linalg.norm(force)
    b_2 = np.cross(b_3, [math.cos(yaw), math.sin(yaw), 0.0])
    b_2 /= np.linalg.norm(b_2)
    return np.column_stack([np.cross(b_2, b_3), b_2, b_3])


def rates_of(rotation, h=1e-6):
    """Return the body rates Ω with Ṙ = R Ω̂ at time zero, from finite differences of a rotation."""
    slope = rotation(0.0).T @ (rotation(h) - rotation(-h)) / (2.0 * h)
    return np.array([slope[2, 1], slope[0, 2], slope[1, 0]])


def random_inputs(rng):
    """Return a random state, reference, commanded acceleration and jerk of a fast vehicle."""
    attitude = [*rng.uniform(-1.2, 1.2, 2), rng.uniform(-3.0, 3.0)]
    measurement = State(*rng.normal(size=3), *attitude, *rng.normal(size=3), *rng.normal(0.0, 3.0, 3))
    reference = Reference(*rng.normal(size=9), rng.uniform(-3.0, 3.0), rng.uniform(-2.0, 2.0))
    return measurement, reference, Acceleration(*rng.uniform(-6.0, 6.0, 3)), Jerk(*rng.normal(0.0, 5.0, 3))


def vectored(drawn, sequence):
    measurement, reference, command, jerk = drawn
    return vectored_thrust(command, measurement, reference, jerk, None, VECTORING_PARAMETERS, True, sequence)


@pytest.mark.parametrize("seed", range(50))
def test_thrust_attitude_rates_and_torque_match_the_paper(seed):
    """The comparison covers random attitudes, headings and yaw rates."""
    drawn = measurement, reference, command, jerk = random_inputs(np.random.default_rng(seed))
    force = MASS * (np.add(command, [0.0, 0.0, G]))
    R = rotation_of(*measurement[3:6])
    Omega = np.array(measurement[9:12])
    vectored_command = vectored(drawn, "zxy")
    assert vectored_command.thrust.thrust == pytest.approx(max(force @ R[:, 2], 1e-6), abs=1e-13)
    R_c = commanded_rotation(force, reference.yaw)
    np.testing.assert_allclose(rotation_of(*vectored_command.attitude_command), R_c, atol=1e-14)

    def rotation(time):
        return commanded_rotation(force + MASS * time * np.array(jerk), reference.yaw + time * reference.yaw_rate)

    Omega_c = rates_of(rotation)
    np.testing.assert_allclose(vectored_command.body_rate_command, Omega_c, atol=1e-8)
    angular_acceleration = np.array([0.7, -0.4, 0.9])
    transported = np.cross(Omega, R.T @ R_c @ Omega_c) - R.T @ R_c @ angular_acceleration
    e_Omega = Omega - R.T @ R_c @ Omega_c
    torque = -INERTIA * (K_P * rotation_error(R, R_c) + K_D * e_Omega + transported) + np.cross(Omega, INERTIA * Omega)
    commanded = (
        vectored_command.attitude_command,
        vectored_command.body_rate_command,
        AngularAcceleration(*angular_acceleration),
    )
    np.testing.assert_allclose(geometric_law(measurement, *commanded, GAINS), torque, atol=1e-11)
    # The firmware omits the term J (ω x ω_r).
    firmware_torque = torque + INERTIA * np.cross(Omega, R.T @ R_c @ Omega_c)
    np.testing.assert_allclose(geometric_law(measurement, *commanded, GAINS, False), firmware_torque, atol=1e-11)


def heading_between(first, second):
    """Return the angle between two attitudes about their common z axis, rad."""
    turn = rotation_of(*first).T @ rotation_of(*second)
    np.testing.assert_allclose(turn[:, 2], [0.0, 0.0, 1.0], atol=1e-13)
    return math.atan2(turn[1, 0], turn[0, 0])


@pytest.mark.parametrize("seed", range(20))
def test_the_two_euler_sequences_give_the_same_thrust_and_different_headings(seed):
    """The headings differ by about the product of the tilts: 48 mrad at 2 m/s² forward and 3 m/s² to the right."""
    rng = np.random.default_rng(seed)
    measurement, reference, _, jerk = random_inputs(rng)
    turn = scipy.spatial.transform.Rotation.from_euler("Z", reference.yaw)
    for level, expected in (((2.0, -3.0), 0.048), ((-2.0, -3.0), -0.048), ((2.0, 0.0), 0.0), ((0.0, 3.0), 0.0)):
        command = Acceleration(*turn.apply([*level, 1.0]))
        one, other = (vectored((measurement, reference, command, jerk), each) for each in ("zyx", "zxy"))
        assert other.thrust.thrust == pytest.approx(one.thrust.thrust, abs=1e-13)
        angle = heading_between(one.attitude_command, other.attitude_command)
        assert angle == pytest.approx(expected, abs=1e-3 if expected else 1e-13)


class Firmware:
    """`controllerLee` in double precision, for a position setpoint with a yaw.

    Args:
        gains: Kpos_P, Kpos_D, Kpos_I, KR, Komega and KI, (3,) each.
        mass: mass of the vehicle, kg.
        J: (3,) moments of inertia, kg m².
        dt: period of the attitude control, s.
    """

    def __init__(self, gains, mass, J, dt):
        (self.Kp, self.Kd, self.Ki, self.KR, self.Kw, self.KI), self.mass, self.J, self.dt = gains, mass, J, dt
        self.i_error_pos, self.i_error_att = np.zeros(3), np.zeros(3)

    def __call__(self, state, reference):
        """Return thrust and torque (4,) for zero jerk and yaw rate."""
        pos_e, vel_e = reference[0:3] - state[0:3], reference[3:6] - state[6:9]
        self.i_error_pos = self.i_error_pos + self.dt * pos_e
        acc_d = np.add(reference[6:9], [0.0, 0.0, G])
        F_d = acc_d + self.Kd * vel_e + self.Kp * pos_e + self.Ki * self.i_error_pos
        R, omega = rotation_of(*state[3:6]), state[9:12]
        thrust = self.mass * F_d @ R[:, 2]
        R_des = commanded_rotation(F_d, reference[9])
        eR = rotation_error(R, R_des)
        self.i_error_att = self.i_error_att + self.dt * eR
        torque = -self.KR * eR - self.Kw * omega - self.KI * self.i_error_att
        return np.array([thrust, *(torque + np.cross(omega, self.J * omega))])


def simulated_flight(**overrides):
    """Simulate a flight at 500 Hz around an ellipse under a Lee controller, as in crazyswarm2.yaml, at constant yaw."""
    requested = {
        "control.position.feed_forward": "acceleration",
        "route": {
            "kind": "lissajous",
            "amplitude": [0.5, 0.5, 0.1],
            "phase": [0.0, 1.0, 0.3],
            "turns": [1, 1, 1],
            "period": 2.0,
            "laps": 1,
            "yaw": 0.8,
        },
        "duration": 1.2,
        "vehicle.centre_of_mass": [0.0004, -0.0003],
        # The loop oscillates and diverges if the rotors are as slow as in the data sheet.
        "vehicle.rotor_time_constant": 0.01,
        "vehicle.rotor_time_constant_down": None,
        # This is the thrust factor of the propellers in the flight log log145.
        "vehicle.thrust_factor": 2.8e-8,
        "crash.position_error": 10.0,
        "control.thrust_vectoring": {"max_tilt": 1.2, "min_thrust": 0.05, "max_thrust": 4.0},
        **overrides,
    }
    return simulate(load_scenario("crazyswarm2:sheet_145", requested), compiled=True)


def commanded_by_firmware(flight):
    """Return the (ticks, 4) wrenches that the firmware commands at the measurements and references of a flight."""
    control = flight.scenario.control
    nominal = flight.scenario.nominal
    inertia = np.array(nominal.inertia)
    attitude_gains = (getattr(control.attitude, name) for name in ("k_p", "k_d", "k_i"))
    gains = [np.array(getattr(control.position, name)) for name in ("k_p", "k_d", "k_i")]
    gains += [np.array(rows) * inertia for rows in attitude_gains]
    law = Firmware(gains, nominal.mass, inertia, flight.scenario.laboratory.command_link.period)
    return np.array([law(*rows) for rows in zip(flight["measurement"], flight["reference"], strict=True)])


@pytest.mark.slow
def test_wrenches_in_flight_agree_with_the_firmware():
    """The flight has no jerk feedforward. Both integrals are active, and the tilt is large."""
    flight = simulated_flight()
    assert not flight.metrics.crashed
    assert np.abs(flight["state"][:, 3:5]).max(axis=0).min() > 0.3
    expected = commanded_by_firmware(flight)
    np.testing.assert_allclose(flight["wrench"], expected, rtol=0.0, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("field", "value", "row"),
    [
        ("control.attitude.euler_sequence", "zyx", 3),
        ("control.attitude.integration", "forward_euler", 1),
        ("control.position.integration", "forward_euler", 0),
    ],
)
def test_every_firmware_option_is_needed_to_reproduce_its_wrenches(field, value, row):
    flight = simulated_flight(**{field: value})
    difference = np.abs(flight["wrench"] - commanded_by_firmware(flight)).max(axis=0)
    assert difference[row] > 1e-5


@pytest.mark.parametrize("log", ["08", "100", "145", "180"])
def test_logged_attitude_commands_have_a_level_y_axis_instead_of_the_reference_yaw(root, log):
    """The reference yaw is zero, so the commanded y axis is perpendicular to X. Logs are rounded to 0.5 mrad."""
    command = read_log(root / f"tests/data/crazyflie/crazyswarm2/log{log}.xz").attitude_command
    y_d = BodyAxes.of(*command.T).y
    assert np.abs(y_d.x).max() < 6e-4 < 4e-3 < np.abs(command[:, 2]).max()


def test_logged_torques_contain_no_transport_term(root):
    """The yaw torque of log100 follows the firmware's law without the transport term J (ω x ω_r)."""
    record = read_log(root / "tests/data/crazyflie/crazyswarm2/log100.xz")
    # KR, Kw and KI are from the firmware's source file, as in tests/identification/test_crazyswarm2.py.
    KR, Kw, KI = 0.008, 0.002, 0.024
    attitudes = zip(record.attitude, record.attitude_command, strict=True)
    error = np.array(
        [rotation_error(rotation_of(*attitude), rotation_of(*commanded))[2] for attitude, commanded in attitudes]
    )
    omega, omega_r = record.body_rates, record.body_rate_command
    error_integral = np.cumsum(error * np.gradient(record.time))
    gyroscopic = np.cross(omega, INERTIA * omega)[:, 2]
    torque = -KR * error - Kw * (omega - omega_r)[:, 2] - KI * error_integral + gyroscopic
    transport = (INERTIA * np.cross(omega, omega_r))[:, 2]
    logged = record.torque_command[:, 2]
    # The integral before the start of the log is unknown but constant, so it does not change the variance.
    without_transport, with_transport = (
        np.var(logged - each) / np.var(logged) for each in (torque, torque - transport)
    )
    assert without_transport < 0.003
    assert with_transport > 0.02
