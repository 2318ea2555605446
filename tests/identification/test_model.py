"""Tests of the model that predicts a log: disturbances, specific force, rotors, and the delay of commands."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from drake_quad import load_scenario
from drake_quad.assembly.laboratory import vehicle_parameters
from drake_quad.identification.model import (
    DELAY,
    MISALIGNMENT,
    NUM_BODY,
    NUM_DISTURBANCE,
    Disturbance,
    LogModel,
    ModelFlight,
    ModelParameters,
    Span,
    WindowInputs,
    relative_voltage,
    rotors_after,
    specific_force,
    steady_rotor_speed,
    step,
)
from drake_quad.identification.results.vehicle_values import with_throttles
from drake_quad.identification.windows import LogWindow, WindowSizes
from drake_quad.logs.record import FlightRecord
from drake_quad.signals import Attitude, RotorSpeed, State, Throttle, Wind

PERIOD = 0.01  # s, sampling period
# Position (m), roll, pitch and yaw (rad), velocity (m/s), and body rates (rad/s).
STATE = State(1.0, -2.0, 3.0, 0.4, -0.5, 1.2, 0.6, -0.3, 0.2, 1.1, -0.7, 0.4)
SPEEDS = RotorSpeed(190.0, 204.0, 197.0, 211.0)  # rad/s
# Specific force (m/s²) along x, y, z, angular acceleration (rad/s²) about x, y, z, and constant specific force (m/s²)
# along x, y.
DISTURBANCE = Disturbance(0.3, -0.8, 0.5, 2.0, -3.0, 1.5, 0.2, -0.4)
NO_DISTURBANCE = Disturbance(*(0.0,) * NUM_DISTURBANCE)
LEVEL = Attitude(0.0, 0.0, 0.0)  # rad
STILL = Wind(0.0, 0.0, 0.0)  # m/s


@pytest.fixture(scope="module")
def scenario():
    overrides = [
        "vehicle.inertia=[0.0066, 0.0079, 0.0121]",
        "vehicle.linear_drag=0.1",
        "vehicle.rotor_time_constant_down=0.09",
    ]
    return load_scenario("laboratory:low_wind", overrides)


@pytest.fixture(scope="module")
def model_parameters(scenario):
    return ModelParameters(vehicle_parameters(scenario.vehicle), scenario.vehicle.effect_parameters(), None)


def in_world():
    """Return the rotation from B to W at the attitude of `STATE`."""
    return Rotation.from_euler("ZYX", [STATE.yaw, STATE.pitch, STATE.roll])


@pytest.mark.parametrize("kind", ["world", "body"])
def test_a_disturbance_adds_constant_accelerations_to_a_step(model_parameters, kind):
    """In a step of duration h, an acceleration a displaces the vehicle by a h²/2.

    The disturbance acts along the axes of W, or along the initial axes of the body.
    """
    h = 0.02
    undisturbed, disturbed = (
        np.array(step(STATE, SPEEDS, SPEEDS, LEVEL, STILL, d, Span(h, 1.0), model_parameters, kind)[0])
        for d in (NO_DISTURBANCE, DISTURBANCE)
    )
    force = np.array([DISTURBANCE.x + DISTURBANCE.constant_x, DISTURBANCE.y + DISTURBANCE.constant_y, DISTURBANCE.z])
    if kind == "body":
        force = in_world().apply(force)
    change = disturbed - undisturbed
    np.testing.assert_allclose(change[:3], 0.5 * h**2 * force, atol=1e-12)
    np.testing.assert_allclose(change[3:6], 0.0, atol=1e-12)
    np.testing.assert_allclose(change[6:9], h * force, atol=1e-12)
    np.testing.assert_allclose(change[9:], h * np.array([DISTURBANCE.p, DISTURBANCE.q, DISTURBANCE.r]), atol=1e-12)


@pytest.mark.parametrize("kind", ["world", "body"])
def test_specific_force_is_the_acceleration_relative_to_free_fall(model_parameters, kind):
    """The expected value is computed in body axes from the change of velocity in a very short step."""
    h = 1e-6
    after = step(STATE, SPEEDS, SPEEDS, LEVEL, STILL, DISTURBANCE, Span(h, 1.0), model_parameters, kind)[0]
    acceleration = (np.array(after[6:9]) - np.array(STATE[6:9])) / h
    expected = in_world().inv().apply(acceleration + np.array([0.0, 0.0, model_parameters.parameters.gravity]))
    np.testing.assert_allclose(
        specific_force(STATE, SPEEDS, SPEEDS, STILL, DISTURBANCE, Span(h, 1.0), model_parameters, kind),
        expected,
        atol=1e-4,
    )


def test_rotors_follow_their_commands_with_different_lags_up_and_down(scenario, model_parameters):
    """A first-order lag leaves exp(-h/T) of the difference after a step of any length."""
    vehicle, h = scenario.vehicle, 0.03
    command = RotorSpeed(220.0, 180.0, 240.0, 150.0)
    result = np.array(rotors_after(SPEEDS, command, Span(h, 1.0), model_parameters))
    for before, target, after in zip(SPEEDS, command, result, strict=True):
        lag = vehicle.rotor_time_constant if target > before else vehicle.rotor_time_constant_down
        assert after == pytest.approx(target + (before - target) * np.exp(-h / lag))
    np.testing.assert_allclose(
        result,
        step(STATE, SPEEDS, command, LEVEL, STILL, NO_DISTURBANCE, Span(h, 1.0), model_parameters, "world")[1],
    )
    assert steady_rotor_speed(command, Span(h, 1.0), model_parameters) == pytest.approx(command)


def test_constant_throttles_give_the_thrust_of_the_curve(scenario):
    vehicle = with_throttles(scenario).vehicle
    model_parameters = ModelParameters(vehicle_parameters(vehicle), vehicle.effect_parameters(), None)
    throttles = Throttle(0.3, 0.4, 0.5, 0.6)
    k_0, k_1, k_2 = vehicle.motors.curve
    thrusts = vehicle.thrust_factor * np.square(steady_rotor_speed(throttles, Span(PERIOD, 1.0), model_parameters))
    fractions = np.array(throttles)
    np.testing.assert_allclose(thrusts, k_0 + k_1 * fractions + k_2 * fractions**2)


@pytest.mark.parametrize("throttles", [True, False])
def test_rotor_speeds_are_proportional_to_the_voltage(scenario, throttles):
    vehicle = (with_throttles(scenario) if throttles else scenario).vehicle
    model_parameters = ModelParameters(vehicle_parameters(vehicle), vehicle.effect_parameters(), None)
    command = Throttle(0.3, 0.4, 0.5, 0.6) if throttles else SPEEDS
    full, low = (
        np.array(steady_rotor_speed(command, Span(PERIOD, voltage), model_parameters)) for voltage in (1.0, 0.9)
    )
    np.testing.assert_allclose(low, 0.9 * full)


@pytest.mark.slow
def test_the_voltage_is_averaged_over_a_tenth_of_a_second_and_divided_by_the_thrust_curve_voltage(scenario):
    """The average of a ramp is the ramp itself. Averaging divides the variance of noise by the number of samples."""
    random = np.random.default_rng(0)
    time = PERIOD * np.arange(2000)
    ramp = 12.0 - 0.02 * time
    log = FlightRecord("log", time, battery_voltage=ramp + 0.1 * random.normal(size=2000))
    model = LogModel(with_throttles(scenario), (), voltage=12.0)
    result = relative_voltage(log, model)
    inside = slice(50, -50)
    error = (12.0 * result - ramp)[inside]
    assert abs(error.std() / (0.1 / np.sqrt(11)) - 1.0) < 0.1
    # The voltage also matters to rotors that are commanded by speed, if the vehicle has a battery.
    np.testing.assert_array_equal(relative_voltage(log, LogModel(scenario, (), voltage=12.0)), result)
    for record, other in ((log, LogModel(scenario, ())), (uneven_record(), model)):
        np.testing.assert_array_equal(relative_voltage(record, other), 1.0)


def uneven_record():
    """Return a log with a gap. All commands differ, so a command shows from which sample it was taken."""
    steps = np.full(200, PERIOD)
    steps[60] = 0.5
    steps[61] = 0.013
    time = np.concatenate([[0.0], np.cumsum(steps)])[:-1]
    number = np.arange(200.0)
    return FlightRecord("log", time, rotor_speed_command=60.0 + 0.8 * number[:, None] + 10.0 * np.arange(4))


@pytest.mark.parametrize("split", [1, 2, 3])
def test_inputs_contain_the_commands_and_steps_of_each_window(scenario, split):
    """The test finds the expected values step by step, with `split` steps per sample."""
    log = uneven_record()
    windows, sizes = [LogWindow(0, 40), LogWindow(0, 70), LogWindow(0, 199)], WindowSizes(length=6, settle=3, warm_up=2)
    inputs = WindowInputs.of([log], LogModel(scenario, ()), windows, sizes, split=split, max_delay=0.025)
    assert inputs.period == pytest.approx(PERIOD / split)
    # The inputs extend beyond the window by the longest delay in whole steps, plus two steps.
    assert inputs.margin == int(np.ceil(0.025 * split / PERIOD)) + 2
    count = split * (2 + 3 + 6)
    assert inputs.commands.shape == (count + 2 * inputs.margin, 7, 3)
    assert inputs.spans.shape == (count, 2, 3)
    np.testing.assert_array_equal(inputs.spans[:, 1], 1.0)
    for w, (_, start) in enumerate(windows):
        for k in range(-inputs.margin, count + inputs.margin):
            # Half a step before a sample, the command of the previous sample still applies.
            sample = min(max(start - 5 + k // split, 0), 199)
            np.testing.assert_array_equal(inputs.commands[k + inputs.margin, :4, w], log.rotor_speed_command[sample])
            if 0 <= k < count:
                step_after = log.time[sample + 1] - log.time[sample] if sample < 199 else log.period
                assert inputs.spans[k, 0, w] == pytest.approx(min(step_after, 3.0 * PERIOD) / split)


def test_inputs_contain_the_wind_and_the_voltage_of_each_record(scenario):
    """The wind of the scenario is used if no wind is logged. The period is the median over all records."""
    steady = load_scenario("laboratory:low_wind", ["laboratory.wind=[{kind: steady, velocity: [1.0, -2.0, 0.5]}]"])
    vehicle = LogModel(with_throttles(steady), (), voltage=12.0)
    random = np.random.default_rng(4)
    wind, throttles = random.normal(size=(100, 3)), random.uniform(0.3, 0.6, size=(100, 4))
    records = [
        FlightRecord("windy", PERIOD * np.arange(100), motor_command=throttles, wind=wind),
        FlightRecord("still", 1.02 * PERIOD * np.arange(100), motor_command=throttles[::-1]),
        FlightRecord(
            "low", 0.98 * PERIOD * np.arange(100), motor_command=throttles, battery_voltage=np.full(100, 11.4)
        ),
    ]
    sizes = WindowSizes(length=6, settle=3, warm_up=2)
    windows = [LogWindow(0, 40), LogWindow(1, 50), LogWindow(2, 60)]
    inputs = WindowInputs.of(records, vehicle, windows, sizes, split=2, max_delay=0.0)
    assert (inputs.period, inputs.margin) == (pytest.approx(0.5 * PERIOD), 2)
    samples = np.repeat(np.arange(35, 46), 2)
    np.testing.assert_array_equal(inputs.wind[:, :, 0], wind[samples])
    np.testing.assert_allclose(inputs.wind[:, :, 1:], np.tile([[1.0], [-2.0], [0.5]], (22, 1, 2)))
    np.testing.assert_allclose(inputs.spans[:, 0], np.tile(0.5 * PERIOD * np.array([1.0, 1.02, 0.98]), (22, 1)))
    np.testing.assert_allclose(inputs.spans[:, 1], np.tile([1.0, 1.0, 0.95], (22, 1)))
    np.testing.assert_array_equal(inputs.commands[2:-2, :4, 1], throttles[::-1][samples + 10])
    np.testing.assert_array_equal(inputs.commands[:, 4:], 0.0)


def test_an_attitude_response_has_the_commanded_attitude_among_its_inputs():
    responding = load_scenario("neural_fly:still")
    vehicle = LogModel(responding, ())
    angles = np.random.default_rng(4).normal(size=(100, 3))
    log = FlightRecord("log", PERIOD * np.arange(100), motor_command=np.full((100, 4), 0.5), attitude_command=angles)
    sizes = WindowSizes(length=6, settle=3, warm_up=2)
    inputs = WindowInputs.of([log], vehicle, [LogWindow(0, 40)], sizes, split=1, max_delay=0.0)
    np.testing.assert_array_equal(inputs.commands[:, 4:, 0], angles[33:48])
    assert (vehicle.has_attitude_response, vehicle.takes_throttles, vehicle.command_signal) == (
        True,
        True,
        "motor_command",
    )
    result = vehicle.physical_parameters(np.ones((1, 0))).response
    autopilot = responding.laboratory.autopilot
    assert tuple(result.frequencies if hasattr(result, "frequencies") else result[0]) == autopilot.natural_frequency
    assert tuple(result[1]) == autopilot.damping


@pytest.mark.parametrize("named", [(), MISALIGNMENT[:2], MISALIGNMENT[1:], MISALIGNMENT])
def test_the_measured_attitude_includes_the_marker_misalignment_of_its_parameter_set(named):
    """An angle that is not a parameter has the value of the scenario."""
    misalignment = (0.03, -0.05, 0.2)
    misaligned = load_scenario("laboratory:low_wind", [f"laboratory.motion_capture.misalignment={[*misalignment]}"])
    vehicle = LogModel(misaligned, ["mass", *named])
    random = np.random.default_rng(6)
    angles = 0.1 * random.normal(size=(3, len(named)))
    log = FlightRecord("log", PERIOD * np.arange(60), rotor_speed_command=np.full((60, 4), 200.0))
    sizes = WindowSizes(length=5, settle=0, warm_up=0)
    inputs = WindowInputs.of([log], vehicle, [LogWindow(0, 20)] * 2, sizes, split=1, max_delay=0.0)
    flight = ModelFlight(vehicle, np.column_stack([np.full(3, 0.7), angles]), inputs, 0)
    state = np.zeros((NUM_BODY + NUM_DISTURBANCE, 3, 2))
    state[3:6] = 0.5 * random.normal(size=(3, 3, 2))
    actual = flight.measured_attitude(state)
    for k in range(3):
        frame = [
            angles[k, named.index(name)] if name in named else misalignment[i] for i, name in enumerate(MISALIGNMENT)
        ]
        for w in range(2):
            expected = Rotation.from_euler("ZYX", state[5:2:-1, k, w]) * Rotation.from_euler("ZYX", frame[::-1])
            np.testing.assert_allclose(actual[::-1, k, w], expected.as_euler("ZYX"), atol=1e-9)
    # If the markers are aligned with the body, the measured attitude is that of the body.
    aligned = LogModel(load_scenario("laboratory:low_wind"), ["mass"])
    flight = ModelFlight(aligned, np.full((3, 1), 0.7), inputs, 0)
    np.testing.assert_array_equal(flight.measured_attitude(state), state[3:6])


def test_rotors_begin_in_equilibrium_and_follow_the_commands_of_the_warm_up(scenario):
    """Rotor speeds start at the command before the warm-up, and follow with a first-order lag over each step."""
    log = uneven_record()
    sizes = WindowSizes(length=5, settle=3, warm_up=7)
    inputs = WindowInputs.of([log], LogModel(scenario, ()), [LogWindow(0, 65)], sizes, split=1, max_delay=0.02)
    model = ModelFlight(LogModel(scenario, ["mass"]), np.array([[1.0]]), inputs, 7)
    expected = log.rotor_speed_command[55].copy()
    for sample in range(55, 62):
        duration = min(log.time[sample + 1] - log.time[sample], 3.0 * PERIOD)
        target = log.rotor_speed_command[sample]
        expected = target + (expected - target) * np.exp(-duration / scenario.vehicle.rotor_time_constant)
    np.testing.assert_allclose(model._rotors.reshape(4, -1)[:, 0], expected)
    assert model._span[0, 0, 0] == pytest.approx(log.time[63] - log.time[62])


@pytest.mark.parametrize("delay", [-0.013, 0.0, 0.004, 0.01, 0.0175])
def test_a_command_delayed_by_a_fraction_of_a_sample_is_a_weighted_mean_of_two(scenario, delay):
    """If the commands form a ramp, the weighted mean is the command at the time one delay earlier."""
    time = PERIOD * np.arange(200)
    ramp = np.tile((150.0 + 10.0 * time)[:, None], 4)
    log = FlightRecord("log", time, rotor_speed_command=ramp)
    sizes = WindowSizes(length=5, settle=3, warm_up=20)
    vehicle = LogModel(scenario, ["mass", DELAY])
    windows = [LogWindow(0, 100), LogWindow(0, 130)]
    inputs = WindowInputs.of([log], vehicle, windows, sizes, split=1, max_delay=0.02)
    assert vehicle.delay_index == 1
    # Each set of parameters has its own delay.
    model = ModelFlight(vehicle, np.array([[0.7, 0.0], [0.7, delay], [0.9, delay]]), inputs, 20)
    for w, start in enumerate((97, 127)):
        command = model._command[:4, :, w]
        np.testing.assert_allclose(command[:, 0], 150.0 + 10.0 * time[start])
        np.testing.assert_allclose(command[:, 1:], 150.0 + 10.0 * (time[start] - delay))
    state = np.zeros((NUM_BODY + NUM_DISTURBANCE, 3, 2))
    state[2] = 5.0
    model.step(state)
    np.testing.assert_allclose(model._command[:4, 1, 0], 150.0 + 10.0 * (time[98] - delay))
    # A heavier vehicle falls more.
    assert (state[8, 2] < state[8, 1]).all()
    fixed_delay = LogModel(scenario, ["mass"], delay=0.03)
    assert fixed_delay.delay_index is None
    np.testing.assert_array_equal(fixed_delay.delays(np.ones((4, 1))), np.full(4, 0.03))


@pytest.mark.parametrize("kind", ["world", "body"])
def test_machine_code_gives_the_steps_and_specific_forces_of_the_formulas(scenario, model_parameters, kind):
    """The formulas are evaluated separately for each set of parameters and each window."""
    log = FlightRecord("log", PERIOD * np.arange(50), rotor_speed_command=np.tile(SPEEDS, (50, 1)))
    vehicle = LogModel(scenario, ["mass"], frame=kind)
    sizes = WindowSizes(length=5, settle=0, warm_up=3)
    inputs = WindowInputs.of([log], vehicle, [LogWindow(0, 30)] * 2, sizes, split=1, max_delay=0.02)
    air = Wind(*inputs.wind[0, :, 0])
    masses = np.array([[0.5], [0.8]])
    model = ModelFlight(vehicle, masses, inputs, 3)
    states = np.random.default_rng(1).normal(scale=0.3, size=(NUM_BODY + NUM_DISTURBANCE, 2, 2))
    result, forces = states.copy(), model.specific_force(states)
    model.step(result)
    for k, (mass,) in enumerate(masses):
        with_mass = model_parameters._replace(parameters=model_parameters.parameters._replace(mass=mass))
        for w in range(2):
            body, disturbance = State(*states[:NUM_BODY, k, w]), Disturbance(*states[NUM_BODY:, k, w])
            np.testing.assert_allclose(
                result[:NUM_BODY, k, w],
                step(body, SPEEDS, SPEEDS, LEVEL, air, disturbance, Span(PERIOD, 1.0), with_mass, kind)[0],
                atol=1e-9,
            )
            np.testing.assert_allclose(
                forces[:, k, w],
                specific_force(body, SPEEDS, SPEEDS, air, disturbance, Span(PERIOD, 1.0), with_mass, kind),
                atol=1e-9,
            )
    np.testing.assert_array_equal(result[NUM_BODY:], states[NUM_BODY:])


@pytest.mark.parametrize("base", ["laboratory:low_wind", "neural_fly:still"])
def test_machine_code_applies_the_voltage_of_each_step_to_throttles(base):
    """The scenarios are a rigid body with throttle motors, and an attitude response."""
    scenario = with_throttles(load_scenario(base))
    vehicle = LogModel(scenario, ["mass"], voltage=12.0)
    random = np.random.default_rng(2)
    throttles, angles = random.uniform(0.3, 0.7, size=(50, 4)), 0.3 * random.normal(size=(50, 3))
    voltages = np.linspace(12.0, 10.0, 50)
    log = FlightRecord(
        "log", PERIOD * np.arange(50), motor_command=throttles, attitude_command=angles, battery_voltage=voltages
    )
    sizes = WindowSizes(length=5, settle=0, warm_up=3)
    inputs = WindowInputs.of([log], vehicle, [LogWindow(0, 30)], sizes, split=1, max_delay=0.0)
    mass = scenario.vehicle.mass
    model = ModelFlight(vehicle, np.array([[mass]]), inputs, 3)
    states = random.normal(scale=0.3, size=(NUM_BODY + NUM_DISTURBANCE, 1, 1))
    body, disturbance = State(*states[:NUM_BODY, 0, 0]), Disturbance(*states[NUM_BODY:, 0, 0])
    rotors = RotorSpeed(*model._rotors.copy())
    model_parameters = LogModel(scenario, ()).physical_parameters(np.ones((1, 0)))
    span, command, air = Span(PERIOD, voltages[30] / 12.0), Throttle(*throttles[30]), Wind(*inputs.wind[3, :, 0])
    expected = specific_force(body, rotors, command, air, disturbance, span, model_parameters, "world")
    np.testing.assert_allclose(model.specific_force(states)[:, 0, 0], np.ravel(expected), atol=1e-9)
    attitude = Attitude(*angles[30]) if vehicle.has_attitude_response else LEVEL
    body_after, rotors_after = step(body, rotors, command, attitude, air, disturbance, span, model_parameters, "world")
    model.step(states)
    np.testing.assert_allclose(states[:NUM_BODY, 0, 0], np.ravel(body_after), atol=1e-9)
    np.testing.assert_allclose(model._rotors, np.ravel(rotors_after), atol=1e-9)
    # After a step, the model flight contains the commands of the next sample.
    np.testing.assert_allclose(model._command[:4, 0, 0], throttles[31])


def test_a_payload_is_attached_throughout_all_windows():
    """The time at which the payload is dropped is ignored, since windows of a log have no clock."""
    payload = "vehicle.payload={{mass: 0.2, position: [0.02, 0.0, -0.05], time: {}, event: dropped}}"
    dropped_early, dropped_late, without_payload = (
        ModelParameters(vehicle_parameters(each.vehicle), each.vehicle.effect_parameters(), None)
        for each in (
            load_scenario("laboratory:low_wind", overrides)
            for overrides in ([payload.format(0.5)], [payload.format(99.0)], [])
        )
    )
    for formula in (
        lambda each: step(STATE, SPEEDS, SPEEDS, LEVEL, STILL, DISTURBANCE, Span(0.1, 1.0), each, "world")[0],
        lambda each: specific_force(STATE, SPEEDS, SPEEDS, STILL, DISTURBANCE, Span(0.1, 1.0), each, "world"),
    ):
        np.testing.assert_array_equal(formula(dropped_early), formula(dropped_late))
        assert np.abs(np.subtract(formula(dropped_early), formula(without_payload))).max() > 1e-3
