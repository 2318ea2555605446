"""Tests of barometer, magnetometer, satellite navigation, range finder, optical flow and ultra-wideband ranges."""

import numpy as np
import pytest
import scipy
from sensor_series import series

from drake_quad import load_scenario
from drake_quad.laboratory.sensors.barometer import BAROMETER
from drake_quad.laboratory.sensors.gnss import GNSS
from drake_quad.laboratory.sensors.magnetometer import MAGNETOMETER
from drake_quad.laboratory.sensors.optical_flow import OPTICAL_FLOW
from drake_quad.laboratory.sensors.range_finder import RANGE_FINDER
from drake_quad.laboratory.sensors.sensor import error_names, with_errors
from drake_quad.laboratory.sensors.uwb_range import UWB_RANGE
from drake_quad.scenario.quantities import any_nonzero
from drake_quad.scenario.sensors.sensor import SENSORS
from drake_quad.signals import RotorSpeed, State, Wind

HOVER = State(0.0, 0.0, 1.5, *(0.0,) * 9)  # at rest at a height of 1.5 m


def parameters_of(kind, **settings):
    """Return the parameters of a sensor on the vehicle of `hover`, with the errors that the settings switch on."""
    sensor = SENSORS.get(kind).model_validate({"kind": kind, **settings})
    parameters = sensor.parameters(load_scenario("hover").vehicle)
    names = [each for each in error_names(parameters) if any_nonzero(getattr(sensor, each), getattr(sensor, each))]
    return with_errors(parameters, names)


def rotation(state):
    """Return the rotation from B to W at the attitude of a state."""
    return scipy.spatial.transform.Rotation.from_euler("ZYX", [state.yaw, state.pitch, state.roll])


def random_state(seed):
    """Return a random state above the ground."""
    rows = np.random.default_rng(seed).uniform(-0.6, 0.6, 12)
    return State(*rows)._replace(z=1.5)


@pytest.mark.parametrize(
    ("kind", "settings", "deviation"),
    [
        ("magnetometer", {"field_noise": 2e-7}, 2e-7),
        ("range_finder", {"distance_noise": 0.01, "relative_noise": 0.02}, 0.01 + 0.02 * 1.5),
        ("optical_flow", {"flow_noise": 0.03}, 0.03),
        ("uwb_range", {"distance_noise": 0.1, "outlier_rate": 0.0}, 0.1),
    ],
)
def test_readings_have_white_noise_of_the_given_deviation(kind, settings, deviation):
    """Noise is independent between readings, components and vehicles. The tolerances are four standard errors."""
    law = SENSORS.get(kind).law
    signals = HOVER, *[None] * len(law.errors_that_read)
    readings = series(law, parameters_of(kind, **settings), lambda k: signals, 50, 400, seed=8)
    errors = readings - series(law, parameters_of(kind), lambda k: signals, 1)
    assert errors.std() == pytest.approx(deviation, rel=4.0 / np.sqrt(2.0 * errors.size))
    assert np.mean(errors[1:] * errors[:-1]) / deviation**2 == pytest.approx(0.0, abs=4.0 / np.sqrt(errors.size))
    assert np.mean(errors) == pytest.approx(0.0, abs=4.0 * deviation / np.sqrt(errors.size))


def test_the_magnetometer_yields_the_heading_for_any_tilt_and_declination():
    """Magnetic north is to the west of true north for a negative declination, that is, at a larger angle in W."""
    declination, inclination, north = -0.3, 1.1, 0.5 * np.pi
    parameters = parameters_of("magnetometer", declination=declination, inclination=inclination, strength=4.8e-5)
    for seed in range(5):
        state = random_state(seed)
        field = MAGNETOMETER.formula(parameters, None, state, None)
        levelled = rotation(state._replace(yaw=0.0)).apply(field)
        assert north - declination - np.arctan2(levelled[1], levelled[0]) == pytest.approx(state.yaw, abs=1e-12)
        assert levelled[2] == pytest.approx(-4.8e-5 * np.sin(inclination), rel=1e-12)
        assert np.linalg.norm(field) == pytest.approx(4.8e-5, rel=1e-12)
    assert north - declination > north


def test_hard_iron_soft_iron_and_motors_change_the_magnetic_field():
    """Readings lie on an ellipsoid around the hard-iron error. The motors add an error in proportion to torque."""
    iron = [0.1, -0.05, 0.02, 0.03, -0.04, 0.06]
    hard = np.array([1e-5, -2e-5, 3e-5])
    parameters = parameters_of("magnetometer", soft_iron=iron, hard_iron=[*hard], motor_interference=[1e-4, 0.0, 2e-4])
    matrix = np.eye(3)
    matrix += [[iron[0], iron[3], iron[4]], [iron[3], iron[1], iron[5]], [iron[4], iron[5], iron[2]]]
    speeds = RotorSpeed(200.0, 210.0, 220.0, 230.0)
    torque = load_scenario("hover").vehicle.drag_factor * sum(speed**2 for speed in speeds)
    for seed in range(5):
        disturbance = hard + torque * np.array([1e-4, 0.0, 2e-4])
        field = np.array(MAGNETOMETER.formula(parameters, None, random_state(seed), speeds)) - disturbance
        assert np.linalg.norm(np.linalg.solve(matrix, field)) == pytest.approx(5e-5, rel=1e-12)


def test_the_autocorrelation_of_the_position_drift_decays_with_the_given_correlation_time():
    deviations = np.array([1.0, 1.2, 2.0])
    parameters = parameters_of("gnss", position_drift=[*deviations], drift_time=2.0, period=0.1)
    errors = series(GNSS, parameters, lambda k: (HOVER,), 60, 3000, seed=0)[:, :3] - [[0.0], [0.0], [1.5]]
    for axis, deviation in enumerate(deviations):
        rows = errors[:, axis] / deviation
        np.testing.assert_allclose((rows**2).mean(axis=1), 1.0, atol=5.0 * np.sqrt(2.0 / 3000))
        correlations = [np.mean(rows[0] * rows[k]) for k in (1, 10, 40)]
        np.testing.assert_allclose(correlations, np.exp(-0.1 * np.array([1, 10, 40]) / 2.0), atol=4.0 / np.sqrt(3000))
    assert abs(np.corrcoef(errors[-1])[0, 1]) < 4.0 / np.sqrt(3000)


def test_multipath_jumps_at_random_and_is_constant_between_jumps():
    """The number of jumps is binomial with the probability 1 - exp(-h / T)."""
    parameters = parameters_of("gnss", multipath=[2.0, 2.0, 3.0], multipath_time=0.5, period=0.1)
    errors = series(GNSS, parameters, lambda k: (HOVER,), 101, 300, seed=1)[:, 0]
    fraction, n = np.mean(np.diff(errors, axis=0) != 0.0), 100 * 300
    probability = 1.0 - np.exp(-0.2)
    assert fraction == pytest.approx(probability, abs=4.0 * np.sqrt(probability / n))
    assert errors[-1].std() == pytest.approx(2.0, rel=0.2)


def test_the_antenna_moves_with_the_vehicle():
    """The velocity of the antenna is the derivative of its position."""
    state, lever = random_state(3), np.array([0.1, -0.2, 0.3])
    parameters = parameters_of("gnss", position=[*lever])
    fix = GNSS.formula(parameters, None, GNSS.memory.start(parameters, None, state), state)
    np.testing.assert_allclose(fix[:3], np.array(state[:3]) + rotation(state).apply(lever), atol=1e-12)
    step = 1e-6
    turns = scipy.spatial.transform.Rotation.from_rotvec(np.outer([-step, step], state[9:]))
    before, after = (rotation(state) * turns).apply(lever)
    speed = (after - before) / (2.0 * step)
    np.testing.assert_allclose(fix[3:], np.array(state[6:9]) + speed, atol=1e-8)


def test_the_noise_of_satellite_navigation_has_the_deviation_of_each_component():
    parameters = parameters_of("gnss", position_noise=[0.5, 0.6, 0.9], velocity_noise=[0.05, 0.06, 0.09])
    readings = series(GNSS, parameters, lambda k: (HOVER,), 50, 400, seed=2)
    np.testing.assert_allclose(readings.std(axis=(0, 2)), [0.5, 0.6, 0.9, 0.05, 0.06, 0.09], rtol=0.03)


def test_the_barometer_reads_low_in_wind_and_at_the_ground():
    """A pressure error of half of the dynamic pressure at 10 m/s lowers the reading by 0.5 v² / 2g = 2.55 m."""
    memory = BAROMETER.memory.start(parameters_of("barometer"), None, HOVER, None)
    windy = parameters_of("barometer", dynamic_pressure=0.5)
    state = HOVER._replace(v_x=6.0)
    (height,) = BAROMETER.formula(windy, None, memory, state, Wind(-4.0, 0.0, 0.0))
    assert height == pytest.approx(1.5 - 0.5 * 100.0 / (2.0 * 9.81), rel=1e-12)
    (height,) = BAROMETER.formula(windy, None, memory, state, Wind(6.0, 0.0, 0.0))
    assert height == pytest.approx(1.5, rel=1e-12)
    rising = HOVER._replace(v_y=2.0, v_z=3.0)
    (height,) = BAROMETER.formula(windy, None, memory, rising, Wind(0.0, 1.0, -1.0))
    assert height == pytest.approx(1.5 - 0.5 * (1.0 + 16.0) / (2.0 * 9.81), rel=1e-12)
    near_ground = parameters_of("barometer", ground_effect=2.0, ground_effect_length=0.4)
    heights = np.array([0.0, 0.4, 40.0])
    (read,) = BAROMETER.formula(near_ground, None, memory, HOVER._replace(z=heights), None)
    np.testing.assert_allclose(heights - read, [2.0, 2.0 / np.e, 0.0], atol=1e-12)


def test_the_barometer_has_noise_and_a_stationary_drift():
    parameters = parameters_of("barometer", height_noise=0.3, drift=0.4, drift_time=0.5, period=0.01, bias=2.0)
    errors = series(BAROMETER, parameters, lambda k: (HOVER, None), 30, 4000, seed=3)[:, 0] - 3.5
    np.testing.assert_allclose(errors.std(axis=1), 0.5, rtol=4.0 / np.sqrt(2.0 * 4000))
    assert np.mean(errors[0] * errors[25]) == pytest.approx(0.16 * np.exp(-0.5), abs=4.0 * 0.25 / np.sqrt(4000))


def test_the_range_finder_measures_along_the_axis_of_the_body():
    """At the tilt ϑ, the distance is the height over cos ϑ. Readings outside the range are missing."""
    parameters = parameters_of("range_finder", ground=0.25, min_distance=0.5, max_distance=2.0)
    for roll, pitch in ((0.0, 0.0), (0.5, 0.0), (0.3, -0.4)):
        (distance,), valid = RANGE_FINDER.formula(parameters, None, HOVER._replace(roll=roll, pitch=pitch))
        assert distance == pytest.approx(1.25 / (np.cos(roll) * np.cos(pitch)), rel=1e-12)
        assert valid
    heights = np.array([-0.5, 0.25, 0.74, 0.76, 2.24, 2.26])
    _, valid = RANGE_FINDER.formula(parameters, None, HOVER._replace(z=heights))
    np.testing.assert_array_equal(valid, [False, False, False, True, True, False])
    _, inverted = RANGE_FINDER.formula(parameters, None, HOVER._replace(roll=3.0))
    assert not inverted


def test_optical_flow_is_the_velocity_divided_by_the_height():
    parameters = parameters_of("optical_flow", max_flow=2.0)
    flow, valid = OPTICAL_FLOW.formula(parameters, None, HOVER._replace(v_x=0.6, v_y=-0.3))
    np.testing.assert_allclose(flow, [0.4, -0.2], rtol=1e-12)
    assert valid
    scaled, _ = OPTICAL_FLOW.formula(parameters_of("optical_flow", scale_error=0.1), None, HOVER._replace(v_x=0.6))
    assert scaled.x == pytest.approx(1.1 * 0.4, rel=1e-12)
    assert not OPTICAL_FLOW.formula(parameters, None, HOVER._replace(v_y=-3.1)).valid
    assert not OPTICAL_FLOW.formula(parameters, None, HOVER._replace(z=-1.0)).valid


def test_a_camera_on_a_lever_arm_measures_flow_if_the_vehicle_turns_in_place():
    """A camera in front of the yaw axis moves sideways, at the yaw rate times its distance from the axis."""
    turning_state = HOVER._replace(r=0.8, yaw=2.0)
    (x, y), _ = OPTICAL_FLOW.formula(parameters_of("optical_flow", position=[0.3, 0.0, 0.0]), None, turning_state)
    np.testing.assert_allclose([x, y], [0.0, 0.3 * 0.8 / 1.5], atol=1e-12)
    (x, y), _ = OPTICAL_FLOW.formula(parameters_of("optical_flow"), None, turning_state)
    assert (x, y) == (0.0, 0.0)


def test_optical_flow_is_the_motion_of_a_point_of_the_ground_in_the_image():
    """The expected motion of the point of the ground on the axis of the camera is computed by finite differences."""
    state, step = random_state(7), 1e-6
    flow, _ = OPTICAL_FLOW.formula(parameters_of("optical_flow"), None, state)
    down = rotation(state).apply([0.0, 0.0, -1.0])
    distance = -1.5 / down[2]
    point = np.array(state[:3]) + distance * down

    def in_image(time):
        turned = rotation(state) * scipy.spatial.transform.Rotation.from_rotvec(np.array(state[9:]) * time)
        x, y, z = turned.inv().apply(point - np.array(state[:3]) - np.array(state[6:9]) * time)
        return np.array([x, y]) / -z

    np.testing.assert_allclose(flow, -(in_image(step) - in_image(-step)) / (2.0 * step), atol=1e-8)


def test_ranges_to_four_anchors_yield_the_position_of_the_antenna():
    state, lever = random_state(9), np.array([0.05, 0.1, -0.02])
    anchors = np.array([[3.0, 0.0, 0.0], [0.0, 3.0, 0.5], [-3.0, -2.0, 2.0], [1.0, -1.0, 3.0]])
    readings = [
        UWB_RANGE.formula(parameters_of("uwb_range", anchor=[*anchor], position=[*lever]), None, state)
        for anchor in anchors
    ]
    distances = np.array([sample.reading.distance for sample in readings])
    # The differences of the squared distances are linear in the position.
    matrix = 2.0 * (anchors[1:] - anchors[0])
    squares = (anchors**2).sum(axis=1) - distances**2
    position = np.linalg.solve(matrix, squares[1:] - squares[0])
    np.testing.assert_allclose(position, np.array(state[:3]) + rotation(state).apply(lever), atol=1e-9)
    assert not UWB_RANGE.formula(parameters_of("uwb_range", max_distance=1.0), None, state).valid


def test_outliers_of_a_range_sensor_are_too_long_and_have_the_given_probability():
    """The mean error of an outlier is √(2/π) times `outlier_size`. Other readings are exact."""
    parameters = parameters_of("uwb_range", outlier_rate=0.05, outlier_size=0.6)
    errors = series(UWB_RANGE, parameters, lambda k: (HOVER,), 20, 2000, seed=5) - 1.5
    fraction, n = np.mean(errors > 0.0), errors.size
    assert fraction == pytest.approx(0.05, abs=4.0 * np.sqrt(0.05 / n))
    assert errors.min() == 0.0
    assert errors[errors > 0.0].mean() == pytest.approx(0.6 * np.sqrt(2.0 / np.pi), rel=0.1)
    certain = parameters_of("uwb_range", outlier_rate=1.0, outlier_size=0.6)
    assert (series(UWB_RANGE, certain, lambda k: (HOVER,), 5, 50, seed=6) > 1.5).all()
