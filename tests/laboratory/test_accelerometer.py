"""Tests of the accelerometer, and of samples, noise and latency of any sensor."""

from typing import Annotated, NamedTuple

import numpy as np
import pytest
import scipy
from noise_feed import feed_noise
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import LogVectorOutput, TrajectorySource
from pydrake.trajectories import PiecewisePolynomial

from drake_quad.framework.fleet_system import FleetSystem
from drake_quad.laboratory.sensors.accelerometer import (
    ACCELEROMETER,
    AccelerometerParameters,
    SensorPosition,
    SpecificForce,
    specific_force,
)
from drake_quad.laboratory.sensors.sensor import Sensor, SensorLaw
from drake_quad.randomness.streams import Samples, StreamKind
from drake_quad.signals import Number, Quantity, State, VehicleAcceleration
from drake_quad.vehicle.parameters import Inertia, QuadrotorParameters
from drake_quad.vehicle.quadrotor import Quadrotor, QuadrotorConfig

GRAVITY = 9.7  # m/s²
# No gyroscopic torque turns this vehicle, since its moments of inertia are equal and its rotors have no inertia. Idle
# rotors do not turn.
SYMMETRIC_VEHICLE = QuadrotorParameters(
    inertia=Inertia(0.01, 0.01, 0.01), rotor_inertia=0.0, gravity=GRAVITY, min_rotor_speed=0.0
)
SENSOR_POSITION = np.array([0.11, -0.07, 0.05])  # m


def readings(parameters, state, speeds, duration=0.2, position=(0.0, 0.0, 0.0)):
    """Return the (T, 3, N) readings of accelerometers in flights with constant rotor speeds, and the (T, 12, N) states.

    Args:
        parameters: parameters of the vehicles.
        state: (12, N) states at the beginning.
        speeds: (4, N) speeds of the rotors during the whole flight, rad/s.
        duration: duration of the flights, s.
        position: position of the sensors in B, m.
    """
    num_vehicles = np.shape(state)[1]
    builder = DiagramBuilder()
    config = QuadrotorConfig(parameters)
    vehicle = builder.AddNamedSystem("vehicle", Quadrotor(num_vehicles, time_step=0.001, parameters=config))
    config = AccelerometerParameters(SensorPosition(*position), parameters.gravity)
    sensor = Sensor(num_vehicles, name="accelerometer", law=ACCELEROMETER, period=0.001, parameters=config)
    builder.AddNamedSystem("accelerometer", sensor)
    for name in ACCELEROMETER.reads:
        builder.Connect(vehicle.GetOutputPort(name), sensor.GetInputPort(name))
    logs = [
        LogVectorOutput(system.GetOutputPort(name), builder, publish_period=0.001)
        for system, name in ((sensor, "accelerometer"), (vehicle, "state"))
    ]
    diagram = builder.Build()
    simulator = Simulator(diagram)
    vehicle_context = vehicle.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    vehicle.set_state(vehicle_context, "state", State(*state))
    vehicle.set_state(vehicle_context, "rotor_speed", type(vehicle.get_state(vehicle_context, "rotor_speed"))(*speeds))
    vehicle.GetInputPort("rotor_speed_command").FixValue(vehicle_context, np.ravel(speeds))
    simulator.AdvanceTo(duration)
    measurements, states = (log.FindLog(simulator.get_context()).data().T for log in logs)
    return measurements.reshape(-1, 3, num_vehicles), states.reshape(-1, 12, num_vehicles)


def hovering_speed(parameters, thrust_per_weight=1.0):
    (rotor, *_) = parameters.rotors
    return np.sqrt(0.25 * thrust_per_weight * parameters.mass * parameters.gravity / rotor.thrust_factor)


def test_the_reading_at_rest_is_g_upwards():
    """In hover, the reading is g along z. For a vehicle at rest in any attitude, it is g upwards, expressed in B."""
    hover = np.zeros((12, 2))
    measurements, _ = readings(
        SYMMETRIC_VEHICLE, hover, np.full((4, 2), hovering_speed(SYMMETRIC_VEHICLE)), position=SENSOR_POSITION
    )
    np.testing.assert_allclose(measurements, np.broadcast_to([[0.0], [0.0], [GRAVITY]], measurements.shape), atol=1e-12)
    for roll, pitch, yaw in np.random.default_rng(0).uniform(-1.5, 1.5, (5, 3)):
        state = State(0.0, 0.0, 0.0, roll, pitch, yaw, *(0.0,) * 6)
        force = specific_force(state, VehicleAcceleration(*(0.0,) * 6), SensorPosition(*SENSOR_POSITION), GRAVITY)
        rotation = scipy.spatial.transform.Rotation.from_euler("ZYX", [yaw, pitch, roll])
        np.testing.assert_allclose(force, rotation.inv().apply([0.0, 0.0, GRAVITY]), atol=1e-12)


def test_the_reading_in_free_fall_is_the_centripetal_acceleration():
    """A body without thrust rotates. The reading is 0 at the centre of mass and ω × (ω × r) at the position r."""
    state = np.zeros((12, 2))
    state[3:6], state[6:9] = [[0.3], [-0.4], [1.0]], [[1.0], [2.0], [3.0]]
    rates = np.array([[0.0, 2.0], [0.0, -1.5], [0.0, 3.0]])
    state[9:12] = rates
    measurements, states = readings(SYMMETRIC_VEHICLE, state, np.zeros((4, 2)))
    np.testing.assert_allclose(np.diff(states[1:, 8], axis=0), -0.001 * GRAVITY, rtol=1e-9)
    np.testing.assert_allclose(measurements, 0.0, atol=1e-12)
    off_centre_measurements, _ = readings(SYMMETRIC_VEHICLE, state, np.zeros((4, 2)), position=SENSOR_POSITION)
    centripetal = np.cross(rates.T, np.cross(rates.T, SENSOR_POSITION)).T
    np.testing.assert_allclose(
        off_centre_measurements, np.broadcast_to(centripetal, off_centre_measurements.shape), atol=1e-9
    )


def test_the_reading_in_a_coordinated_turn_is_the_thrust_divided_by_mass():
    """The vehicle has the roll φ, the speed v and the yaw rate -g tan φ / v, so the reading is g / cos φ along z.

    No torque acts on the vehicle, so it flies an exact circle of the radius v² / (g tan φ).
    """
    bank, speed = np.array([0.4, -0.8]), np.array([3.0, 5.0])
    yaw_rate = -GRAVITY * np.tan(bank) / speed
    state = np.zeros((12, 2))
    state[3], state[6] = bank, speed
    rates = np.array([0.0 * bank, np.sin(bank) * yaw_rate, np.cos(bank) * yaw_rate])
    state[9:12] = rates
    thrust = np.tile(hovering_speed(SYMMETRIC_VEHICLE, 1.0 / np.cos(bank)), (4, 1))
    measurements, states = readings(SYMMETRIC_VEHICLE, state, thrust, duration=1.0)
    np.testing.assert_allclose(states[:, 2], 0.0, atol=1e-9)
    radius = speed**2 / (GRAVITY * np.tan(bank))
    np.testing.assert_allclose(
        np.hypot(states[:, 0], states[:, 1] + radius), np.broadcast_to(np.abs(radius), (1001, 2))
    )
    expected = np.array([0.0 * bank, 0.0 * bank, GRAVITY / np.cos(bank)])
    np.testing.assert_allclose(measurements, np.broadcast_to(expected, measurements.shape), atol=1e-9)
    off_centre_measurements, _ = readings(SYMMETRIC_VEHICLE, state, thrust, position=SENSOR_POSITION)
    centripetal = np.cross(rates.T, np.cross(rates.T, SENSOR_POSITION)).T
    np.testing.assert_allclose(
        off_centre_measurements, np.broadcast_to(expected + centripetal, off_centre_measurements.shape), atol=1e-9
    )


def test_the_reading_follows_the_motion_of_the_sensor():
    """For motions p(t), R(t), the reading is R' (d²/dt² (p + R r) + g Z), here computed by second differences."""
    rng = np.random.default_rng(3)
    path, angle_path = rng.uniform(-1.0, 1.0, (2, 3, 4))

    def pose(time):
        position, angles = (np.polyval(rows.T, time) for rows in (path, angle_path))
        return position, angles, scipy.spatial.transform.Rotation.from_euler("ZYX", angles[::-1])

    def difference(function, step, order):
        before, now, after = (function(time) for time in (-step, 0.0, step))
        return (after - before) / (2.0 * step) if order == 1 else (before - 2.0 * now + after) / step**2

    _, angles, now = pose(0.0)

    def body_rates(time):
        nearby = [now.inv() * pose(time + end)[2] for end in (-1e-4, 1e-4)]
        return (nearby[0].inv() * nearby[1]).as_rotvec() / 2e-4

    velocity = difference(lambda time: pose(time)[0], 1e-4, 1)
    state = State(*pose(0.0)[0], *angles, *velocity, *body_rates(0.0))
    acceleration = difference(lambda time: pose(time)[0], 1e-4, 2)
    angular_acceleration = difference(body_rates, 1e-3, 1)
    reading = specific_force(
        state, VehicleAcceleration(*acceleration, *angular_acceleration), SensorPosition(*SENSOR_POSITION), GRAVITY
    )
    sensor_acceleration = difference(lambda time: pose(time)[0] + pose(time)[2].apply(SENSOR_POSITION), 1e-4, 2)
    np.testing.assert_allclose(reading, now.inv().apply(sensor_acceleration + np.array([0.0, 0.0, GRAVITY])), atol=1e-4)


def test_readings_have_the_given_bias_and_white_noise():
    """Each vehicle has its own bias and noise. The noise is independent between axes, readings and vehicles."""
    noise, n = np.array([0.1, 0.2]), 2000
    config = AccelerometerParameters(bias=SpecificForce(np.array([0.5, -1.0]), 2.0, 3.0), noise=noise)
    sensor = Sensor(2, name="accelerometer", law=ACCELEROMETER, noisy=True, parameters=config)
    builder = DiagramBuilder()
    builder.AddNamedSystem("accelerometer", sensor)
    feed_noise(builder, sensor, StreamKind.NOISE, Samples(2, [0, 1]))
    log = LogVectorOutput(sensor.GetOutputPort("accelerometer"), builder, publish_period=0.01)
    simulator = Simulator(builder.Build())
    sensor_context = sensor.GetMyMutableContextFromRoot(simulator.get_mutable_context())
    for name in ACCELEROMETER.reads:
        port = sensor.GetInputPort(name)
        port.FixValue(sensor_context, np.zeros(port.size()))
    simulator.AdvanceTo(0.01 * n)
    readings_of_log = log.FindLog(simulator.get_context()).data().T.reshape(-1, 3, 2)[1:]
    bias = [[0.5, -1.0], [2.0, 2.0], [3.0 + 9.81, 3.0 + 9.81]]
    errors = (readings_of_log - bias) / noise
    # Means, covariances and products of successive readings are within five standard errors.
    np.testing.assert_allclose(errors.mean(axis=0), 0.0, atol=5.0 / np.sqrt(n))
    error_rows = errors.reshape(n, 6)
    np.testing.assert_allclose(error_rows.T @ error_rows / n, np.eye(6), atol=5.0 * np.sqrt(2.0 / n))
    np.testing.assert_allclose(error_rows[1:].T @ error_rows[:-1] / n, 0.0, atol=5.0 / np.sqrt(n))


class Altitude(NamedTuple):
    """Reading of an altimeter: the height above the origin of W."""

    height: Annotated[float, Quantity("m", "W")]


class AltimeterParameters(NamedTuple):
    """Parameters of an altimeter without errors."""

    latency_samples: Number = 0.0


ALTIMETER = SensorLaw(Altitude, lambda config, noise, state: Altitude(state.z), ("state",))


@pytest.mark.parametrize("latency", [0, 1, 3])
def test_a_reading_arrives_a_whole_number_of_periods_after_its_sample(latency):
    """The output is the initial reading until the first reading arrives."""
    state = PiecewisePolynomial.FirstOrderHold([0.0, 10.0], np.array([[1.0] * 12, [11.0] * 12]).T)
    builder = DiagramBuilder()
    source = builder.AddSystem(TrajectorySource(state))
    config = AltimeterParameters(float(latency))
    sensor: FleetSystem = Sensor(name="altimeter", law=ALTIMETER, period=0.02, longest_latency=3, parameters=config)
    builder.AddSystem(sensor)
    builder.Connect(source.get_output_port(), sensor.GetInputPort("state"))
    log = LogVectorOutput(sensor.GetOutputPort("altimeter"), builder, publish_period=0.005)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(0.5)
    log_data = log.FindLog(simulator.get_context())
    ticks = np.ceil(np.round(log_data.sample_times() / 0.02, 6)) - 1 - latency
    np.testing.assert_allclose(log_data.data().ravel(), 1.0 + 0.02 * np.maximum(ticks, 0.0), atol=1e-12)
