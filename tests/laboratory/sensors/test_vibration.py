"""Tests of the vibration that inertial sensors measure."""

import numpy as np
import pytest
import scipy
from sensor_series import series

from drake_quad import load_scenario
from drake_quad.laboratory.sensors.accelerometer import ACCELEROMETER
from drake_quad.laboratory.sensors.gyroscope import GYROSCOPE
from drake_quad.laboratory.sensors.sensor import with_errors
from drake_quad.laboratory.sensors.vibration import RotorAngles, Vibration, first_phases, next_phases
from drake_quad.scenario.layouts import rotors_of
from drake_quad.scenario.sensors.accelerometer import AccelerometerSettings
from drake_quad.scenario.sensors.gyroscope import GyroscopeSettings
from drake_quad.signals import RotorSpeed, State, VehicleAcceleration

AT_REST = State(*(0.0,) * 12)
# A vehicle in free fall, so that the accelerometer measures nothing but the vibration.
FALLING = VehicleAcceleration(0.0, 0.0, -9.81, 0.0, 0.0, 0.0)
# Settings of the vibration: unbalance of each rotor in kg m, thrust harmonics relative to the thrust, phases in rad.
VIBRATION = {
    "unbalance": [1e-6, 2e-6, 3e-6, 4e-6],
    "thrust_harmonics": [0.0, 0.02],
    "initial_phases": [0.1, 0.2, 0.3, 0.4],
}
CENTRE = [0.01, -0.02, 0.0]  # centre of mass of the vehicle, m
# Settings and sensor law of each type of sensor.
SENSOR_TYPES = {"accelerometer": (AccelerometerSettings, ACCELEROMETER), "gyroscope": (GyroscopeSettings, GYROSCOPE)}


def vehicle():
    return load_scenario(
        "hover", {"vehicle.centre_of_mass": CENTRE[:2], "vehicle.inertia": [0.006, 0.008, 0.012]}
    ).vehicle


def readings(kind, speeds, num_readings, vibration=VIBRATION, *, period, **settings):
    """Return the (T, 3) readings of a sensor in free fall, whose only error is the vibration.

    Args:
        kind: accelerometer or gyroscope.
        speeds: function that returns the rotor speeds at a reading, given its number.
        num_readings: number T of readings.
        vibration: settings of the vibration.
        period: time between readings, s.
        settings: further settings of the sensor.
    """
    model, law = SENSOR_TYPES[kind]
    sensor = model.model_validate({"kind": kind, "vibration": vibration, **settings})
    names = ["vibration", *(["bandwidth"] if "bandwidth" in settings else [])]
    parameters = with_errors(sensor.parameters(vehicle()), names)
    vibration = parameters.errors.vibration._replace(period=period)
    parameters = parameters._replace(errors=parameters.errors._replace(vibration=vibration))
    motion = (AT_REST, FALLING) if kind == "accelerometer" else (AT_REST,)
    return series(law, parameters, lambda k: (*motion, RotorSpeed(*speeds(k))), num_readings)[..., 0]


def amplitudes(signal):
    """Return the amplitudes of the frequencies 0, 1, ... Hz in one second of samples."""
    spectrum = 2.0 * np.abs(np.fft.rfft(signal)) / len(signal)
    spectrum[[0, -1]] *= 0.5
    return spectrum


@pytest.mark.parametrize(("bandwidth", "rate"), [(None, 400), (600.0, 400), (None, 2048)])
def test_vibration_appears_at_the_aliased_harmonics_of_the_rotor_speed(bandwidth, rate):
    """One rotor turns at 180 Hz. With 400 readings per second, its second harmonic at 360 Hz appears at 40 Hz.

    The filter acts before the sampling, so it attenuates the second harmonic like a signal of 360 Hz.
    """
    frequency = 180
    speed, gain = 2.0 * np.pi * frequency, {1: 1.0, 2: 1.0}
    settings = {"position": CENTRE} if bandwidth is None else {"position": CENTRE, "bandwidth": bandwidth}
    if bandwidth is not None:
        gain = {k: 1.0 / np.hypot(1.0, k * speed / bandwidth) for k in (1, 2)}
    measured = readings("accelerometer", lambda k: (0.0, speed, 0.0, 0.0), rate, period=1.0 / rate, **settings)
    fundamental, aliased = frequency, abs(2 * frequency - rate * round(2 * frequency / rate))
    assert aliased == (40 if rate == 400 else 360)
    body = vehicle()
    force = 2e-6 * speed**2
    spectra = np.array([amplitudes(measured[:, axis]) for axis in range(3)])
    for axis in (0, 1):
        assert spectra[axis, fundamental] == pytest.approx(gain[1] * force / body.mass, rel=1e-9)
    thrust = 0.02 * body.thrust_factor * speed**2
    assert spectra[2, aliased] == pytest.approx(gain[2] * thrust / body.mass, rel=1e-9)
    other_amplitudes = np.delete(spectra, [fundamental, aliased], axis=1)
    assert other_amplitudes.max() < 1e-9 * spectra.max()


def test_the_amplitude_at_the_centre_of_mass_is_the_force_divided_by_the_mass():
    """All rotors are in phase, so the acceleration of the centre of mass is Σ u_i Ω_i² / m."""
    speed, rate = 2.0 * np.pi * 90, 400
    vibration = {"unbalance": [1e-6, 0.0, 3e-6, 0.0]}
    measured = readings("accelerometer", lambda k: (speed,) * 4, rate, vibration, period=1.0 / rate, position=CENTRE)
    for axis in (0, 1):
        assert amplitudes(measured[:, axis])[90] == pytest.approx(4e-6 * speed**2 / vehicle().mass, rel=1e-12)
    np.testing.assert_allclose(measured[:, 2], 0.0, atol=1e-12)


def test_the_angular_acceleration_of_the_gyroscope_agrees_with_two_accelerometers():
    """The difference of two specific forces is α × r, and α is the derivative of the vibration of the gyroscope."""
    period, speeds = 1e-5, (1100.0, 1200.0, 1300.0, 1400.0)
    position = np.array([0.05, 0.03, -0.02])
    inner, outer = (
        readings("accelerometer", lambda k: speeds, 401, period=period, position=[*map(float, sensor_position)])
        for sensor_position in (CENTRE, CENTRE + position)
    )
    rates = readings("gyroscope", lambda k: speeds, 401, period=period)
    angular_acceleration = (rates[2:] - rates[:-2]) / (2.0 * period)
    expected = np.cross(angular_acceleration, position)
    np.testing.assert_allclose((outer - inner)[1:-1], expected, atol=2e-3 * np.abs(expected).max())


def test_the_periodic_thrust_of_a_rotor_turns_the_vehicle_about_its_centre_of_mass():
    """The amplitude of the rate is the torque divided by inertia and frequency. The rotor is not at the centre."""
    frequency, rate, body = 90, 400, vehicle()
    speed = 2.0 * np.pi * frequency
    vibration = {"thrust_harmonics": [0.03]}
    measured = readings("gyroscope", lambda k: (speed, 0.0, 0.0, 0.0), rate, vibration, period=1.0 / rate)
    rotor, *_ = rotors_of(body)
    force = 0.03 * rotor.thrust_factor * speed**2
    arms = rotor.y - CENTRE[1], rotor.x - CENTRE[0]
    for axis, (arm, inertia) in enumerate(zip(arms, body.inertia, strict=False)):
        assert amplitudes(measured[:, axis])[frequency] == pytest.approx(abs(arm) * force / (inertia * speed), rel=1e-9)
    np.testing.assert_allclose(measured[:, 2], 0.0, atol=1e-12)


@pytest.mark.parametrize("kind", SENSOR_TYPES)
def test_rotors_at_rest_cause_no_vibration(kind):
    measured = readings(kind, lambda k: (0.0,) * 4, 10, period=0.0025)
    np.testing.assert_allclose(measured, 0.0, atol=1e-12)


@pytest.mark.parametrize("kind", SENSOR_TYPES)
def test_the_filtered_vibration_agrees_with_a_filter_in_continuous_time(kind):
    """`scipy.signal.lsim` filters a densely sampled vibration. The first 8 time constants, a transient, are ignored."""
    period, speeds, bandwidth = 1e-5, (1100.0, 1200.0, 1300.0, 1400.0), 800.0
    unfiltered, filtered = (
        readings(kind, lambda k: speeds, 1200, period=period, **settings) for settings in ({}, {"bandwidth": bandwidth})
    )
    system = scipy.signal.StateSpace([[-bandwidth]], [[bandwidth]], [[1.0]], [[0.0]])
    for axis in range(3):
        _, expected, _ = scipy.signal.lsim(system, unfiltered[:, axis], period * np.arange(1200))
        size = np.abs(expected).max()
        np.testing.assert_allclose(filtered[1000:, axis], expected[1000:], atol=2e-3 * size)


def test_counter_rotating_rotors_of_equal_phase_shake_only_along_one_axis():
    """The unbalances of two rotors in opposite directions cancel along Y and add along X."""
    body = load_scenario("hover").vehicle
    sensor = AccelerometerSettings.model_validate(
        {"kind": "accelerometer", "period": 0.0025, "vibration": {"unbalance": [1e-6, 1e-6, 1e-6, 1e-6]}}
    )
    parameters = with_errors(sensor.parameters(body), ["vibration"])
    measured = series(ACCELEROMETER, parameters, lambda k: (AT_REST, FALLING, RotorSpeed(*(800.0,) * 4)), 200)[..., 0]
    assert np.abs(measured[:, 0]).max() == pytest.approx(4e-6 * 800.0**2 / body.mass, rel=0.01)
    np.testing.assert_allclose(measured[:, 1:], 0.0, atol=1e-12)


def test_the_phase_after_a_change_of_speed_agrees_with_the_exact_integral():
    """The speed approaches 400 rad/s from 300 rad/s with a time constant of T = 0.03 s."""
    lag, period = 0.03, 0.0025
    times = period * np.arange(200)
    speeds = 400.0 - 100.0 * np.exp(-times / lag)
    vibration = Vibration((None,) * 4, (), RotorAngles(*(0.0,) * 4), period)
    phases = first_phases(vibration, RotorSpeed(*(speeds[0],) * 4))
    for speed in speeds[1:]:
        phases = next_phases(vibration, phases, RotorSpeed(*(speed,) * 4))
    exact = 400.0 * times[-1] - 100.0 * lag * (1.0 - np.exp(-times[-1] / lag))
    error = np.angle(np.exp(1j * (phases.phase.rotor_3 - exact)))
    # The acceleration of the rotor decays from 100 / T to zero. By the Euler-Maclaurin formula, the error of the phase
    # is h²/12 times the change of this acceleration.
    assert error == pytest.approx(-(period**2) / 12.0 * 100.0 / lag, rel=0.01)
