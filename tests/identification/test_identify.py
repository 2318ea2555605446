"""Tests of the outputs, candidate parameters and error messages of an identification."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from drake_quad import InputError, load_scenario, load_undesigned, read_log
from drake_quad.identification import identifiability, prepared_logs
from drake_quad.identification import identify as module
from drake_quad.identification.evidence import Uncertainty
from drake_quad.identification.identify import identify
from drake_quad.identification.parameters import Parameter, parameters_of
from drake_quad.identification.prediction_errors import FORCE, Output, PredictionNoise
from drake_quad.identification.result import ForecastOutput
from drake_quad.logs.record import FlightRecord

PERIOD = 0.02  # s, sampling period
POSE_SIGNALS = ("position", "attitude")


def record(seconds, *names, **signals):
    """Return an airborne log with constant signals."""
    count = round(seconds / PERIOD)
    values = {name: np.zeros((count, 3)) for name in names}
    commands = {"rotor_speed_command": np.full((count, 4), 200.0)} | signals
    return FlightRecord("log", PERIOD * np.arange(count), **values, **commands)


@pytest.fixture(scope="module")
def rotors(root):
    return load_scenario(root / "diagrams" / "laboratory.yaml:low_wind")


@pytest.fixture(scope="module")
def attitudes(root):
    """Return a scenario with an autopilot whose closed attitude loop is modelled as a whole."""
    return load_scenario(root / "diagrams" / "neural_fly.yaml:still")


@pytest.mark.parametrize(
    ("logged", "predicted"),
    [
        (("position", "attitude", "velocity", "body_rates"), ("position", "attitude")),
        (("position", "attitude", "body_rates", FORCE), ("position", "attitude", "body_rates", FORCE)),
        (("body_rates", FORCE), ("body_rates", FORCE)),
        (("velocity", "attitude"), ("attitude", "velocity")),
        (("body_rates",), ("body_rates",)),
    ],
)
def test_measurements_are_predicted_and_derived_signals_are_not(logged, predicted):
    result = prepared_logs._outputs([record(1.0, *logged)], False)
    assert result == [Output(name, column) for name in predicted for column in range(3)]


def test_only_signals_that_all_logs_have_are_predicted():
    result = prepared_logs._outputs(
        [record(1.0, *POSE_SIGNALS, "body_rates", FORCE), record(1.0, "body_rates", FORCE)], False
    )
    assert {output.signal for output in result} == {"body_rates", FORCE}
    # An attitude that lags because an estimator computes it is not predicted, but the body rates of the gyroscope are.
    result = prepared_logs._outputs([record(1.0, *POSE_SIGNALS, "body_rates")], True)
    assert {output.signal for output in result} == {"position", "body_rates"}
    assert prepared_logs._outputs([record(1.0, "position")], False) == [Output("position", 2)]
    with pytest.raises(InputError, match="to identify a vehicle, logs need body_rates with specific_force, attitude"):
        prepared_logs._outputs([record(1.0, "specific_force")], False)


def test_a_vehicle_identified_from_throttles_has_throttle_motors(rotors):
    throttles = record(5.0, *POSE_SIGNALS, motor_command=np.full((250, 4), 0.5))
    logs, scenario = prepared_logs.prepare([throttles], rotors)
    assert logs.scenario.vehicle.motors.take_throttles
    assert scenario.vehicle.motors.take_throttles
    assert logs.has_motor_throttles
    logs, scenario = prepared_logs.prepare([record(5.0, *POSE_SIGNALS)], rotors)
    assert scenario is rotors


def test_the_voltage_of_the_thrust_curve_is_that_of_the_vehicle_or_else_the_median_in_flight(rotors):
    def voltage(scenario, **signals):
        logs, _ = prepared_logs.prepare([record(6.0, *POSE_SIGNALS, **signals)], scenario)
        return logs.voltage

    throttles = {"motor_command": np.full((300, 4), 0.5), "battery_voltage": np.linspace(12.0, 11.0, 300)}
    assert voltage(rotors, **throttles) == pytest.approx(11.5, abs=0.01)
    motors = "motors={kind: throttle, curve: [0.0, 1.0, 3.4]}"
    given = [f"nominal.{motors}", f"vehicle.{motors}", "vehicle.motors.voltage=12.3"]
    known = load_scenario("laboratory:low_wind", given)
    assert voltage(known, **throttles) == 12.3
    battery = "{voltage: 12.6, empty_voltage: 10.5, capacity: 0.2, resistance: 0.02, efficiency: 0.6}"
    full = load_scenario("laboratory:low_wind", [*given[:2], f"vehicle.battery={battery}"])
    assert voltage(full, **throttles) == 12.6
    assert voltage(rotors, motor_command=throttles["motor_command"]) is None
    assert voltage(rotors, battery_voltage=throttles["battery_voltage"]) is None


def test_the_specific_force_is_computed_from_the_residual_force_and_the_commanded_thrust(attitudes):
    """The residual is the force other than weight and commanded thrust, along the axes of W."""
    angles = np.tile([0.3, -0.2, 1.0], (5, 1))
    force = np.array([0.5, -1.0, 2.0])
    log = FlightRecord(
        "log",
        0.02 * np.arange(5),
        attitude=angles,
        residual_force=np.tile(force, (5, 1)),
        thrust_command=np.full(5, 20.0),
    )
    mass = attitudes.vehicle.mass
    (s_r, s_p, s_y), (c_r, c_p, c_y) = np.sin(angles[0]), np.cos(angles[0])
    yaw = np.array([[c_y, -s_y, 0.0], [s_y, c_y, 0.0], [0.0, 0.0, 1.0]])
    pitch = np.array([[c_p, 0.0, s_p], [0.0, 1.0, 0.0], [-s_p, 0.0, c_p]])
    roll = np.array([[1.0, 0.0, 0.0], [0.0, c_r, -s_r], [0.0, s_r, c_r]])
    expected = ((yaw @ pitch @ roll).T @ force + [0.0, 0.0, 20.0]) / mass
    np.testing.assert_allclose(
        prepared_logs._with_specific_force(log, attitudes).specific_force, np.tile(expected, (5, 1))
    )


def test_an_identification_without_logs_is_refused(rotors):
    with pytest.raises(InputError, match="no log is given; at least one is needed to identify a vehicle"):
        identify([], rotors)


def test_a_short_flight_is_refused(rotors):
    with pytest.raises(
        InputError, match=r"^the flight in the logs contains only 3 windows of .* in the air; at least 4"
    ):
        identify([record(2.0, *POSE_SIGNALS)], rotors, held_out_fraction=0.0)


@pytest.mark.parametrize(("signal", "rate"), [("position", "velocity"), ("attitude", "body_rates")])
def test_logs_with_a_constant_signal_whose_derivative_is_not_zero_are_refused(rotors, signal, rate):
    log = record(20.0, *POSE_SIGNALS, "velocity", "body_rates")
    frozen = replace(log, **{rate: np.full((len(log.time), 3), 0.2)})
    with pytest.raises(InputError, match=f"{signal} is constant although {rate} is not zero"):
        identify([frozen], rotors)


def test_logs_whose_signals_contradict_each_other_are_refused(root):
    log = read_log(root / "tests" / "data" / "crazyflie" / "crazyswarm2" / "log100.xz")
    wrong = replace(log, body_rates=log.body_rates * [1.0, -1.0, 1.0])
    with pytest.raises(InputError, match="in log100, body_rates .*the sign of body_rates looks wrong in y; correct"):
        identify([wrong], load_undesigned(log.vehicle))


def test_logs_with_different_sample_rates_are_refused(rotors):
    slow = FlightRecord("slow", 0.05 * np.arange(400), rotor_speed_command=np.full((400, 4), 200.0), **{
        name: np.zeros((400, 3)) for name in POSE_SIGNALS
    })  # fmt: skip
    with pytest.raises(InputError, match="identify from logs with the same sample rate"):
        identify([record(20.0, *POSE_SIGNALS), slow], rotors)


@pytest.mark.long
def test_a_flight_without_motion_identifies_only_the_thrust(rotors):
    """Nothing is divided by a variance of zero; a NumPy warning would fail the test."""
    vehicle = rotors.vehicle
    speed = np.sqrt(0.25 * vehicle.mass * vehicle.gravity / vehicle.thrust_factor)
    log = record(6.0, *POSE_SIGNALS, "body_rates", "velocity", rotor_speed_command=np.full((300, 4), speed))
    result = identify([log], rotors)
    assert result.estimates.value("thrust_factor") == pytest.approx(vehicle.thrust_factor, rel=1e-3)
    assert "thrust_factor" in result.estimates.identified
    assert {"inertia[0]", "inertia[1]", "rotor_time_constant"} <= {*result.estimates.not_identified}
    assert np.isfinite(result.estimates.intervals()).all()


def test_equations_without_a_solution_are_refused_in_one_sentence(monkeypatch):
    """Such equations arise if a gyroscope occasionally reads 10⁸ rad/s."""

    def fail(*_, **__):
        np.linalg.cholesky(np.zeros((2, 2)))

    monkeypatch.setattr(module, "_identified", fail)
    nothing = FlightRecord("log", np.array([0.0, 0.1]))
    with pytest.raises(
        InputError, match=r"^the logs cannot be fitted \(Matrix is not positive definite\): their values are impossible"
    ):
        identify([nothing], load_scenario("hover"))


THRUST_RATIO = 1.2  # thrust factor, relative to that of the base vehicle
LAG = 0.06  # s, time constant of the rotors
TRANSPORT_DELAY = 0.03  # s, delay of the rotor commands
HEIGHT_NOISE = 1e-3  # m, standard deviation of the logged height


def climbing(vehicle, seconds):
    """Return a log of heights and rotor speeds of a vehicle with a controlled height, simulated in steps of 1 ms.

    The rotors have `THRUST_RATIO` times the thrust factor of the vehicle. They follow their commands with the time
    constant `LAG`, after the delay `TRANSPORT_DELAY`.
    """
    random, step = np.random.default_rng(0), 1e-3
    count, steps_per_sample = round(seconds / PERIOD), round(PERIOD / step)
    hover = np.sqrt(0.25 * vehicle.mass * vehicle.gravity / (THRUST_RATIO * vehicle.thrust_factor))
    reference = 1.0 + 0.3 * np.sign(np.sin(2.8 * PERIOD * np.arange(count)))
    height, climb, speed, delay_steps = 1.0, 0.0, hover, round(TRANSPORT_DELAY / step)
    heights, commands = np.zeros(count), np.full(count * steps_per_sample + delay_steps, hover)
    for i in range(count):
        heights[i] = height
        fraction = 1.0 + (6.0 * (reference[i] - height) - 4.0 * climb) / vehicle.gravity
        commands[i * steps_per_sample + delay_steps : (i + 1) * steps_per_sample + delay_steps] = hover * np.sqrt(
            max(0.2, fraction)
        )
        for command in commands[i * steps_per_sample : (i + 1) * steps_per_sample]:
            before = speed
            speed = command + (speed - command) * np.exp(-step / LAG)
            acceleration = vehicle.gravity * ((0.5 * (before + speed) / hover) ** 2 - 1.0)
            height += step * climb + 0.5 * step**2 * acceleration
            climb += step * acceleration
    position = np.zeros((count, 3))
    position[:, 2] = heights + HEIGHT_NOISE * random.normal(size=count)
    speeds = np.tile(commands[delay_steps::steps_per_sample][:count, None], 4)
    return FlightRecord("climbing", PERIOD * np.arange(count), position=position, rotor_speed_command=speeds)


@pytest.mark.long
def test_heights_of_a_vehicle_that_climbs_and_descends_identify_thrust_lag_and_delay(rotors):
    """The log is from an independent simulation of one axis; the 95 % intervals contain its parameters."""
    calm = load_scenario("laboratory:low_wind", ["vehicle.linear_drag=0", "vehicle.quadratic_drag=0"])
    result = identify([climbing(calm.vehicle, 8.0)], calm)
    estimates = result.estimates
    low, high = np.transpose(estimates.intervals())
    for name, true in (
        ("thrust_factor", THRUST_RATIO * calm.vehicle.thrust_factor),
        ("rotor_time_constant", LAG),
        ("rotor_aerodynamics.climb", 0.0),
    ):
        index = estimates.names.index(name)
        assert name in estimates.identified
        assert low[index] < true < high[index], name
    assert abs(result.delay.value - TRANSPORT_DELAY) < result.delay.half_width < 0.1 * TRANSPORT_DELAY
    assert estimates.value("thrust_factor") == pytest.approx(THRUST_RATIO * calm.vehicle.thrust_factor, rel=1e-3)
    assert estimates.value("rotor_time_constant") == pytest.approx(LAG, rel=0.05)
    # 400 samples determine the noise to within 1 / √800.
    assert result.noise.measured == pytest.approx([HEIGHT_NOISE], rel=0.15)


def forecast_of(*explained):
    none = np.zeros((1, 2))
    names = [f"position {axis}" for axis in "xyz"]
    return [ForecastOutput(name, "m", none, none, none, each, 0.1) for name, each in zip(names, explained, strict=True)]


def test_a_vehicle_whose_forecast_is_no_better_than_persistence_is_refused():
    with pytest.raises(InputError, match=r"^cannot identify the vehicle: .* forecasts no output .* \(best: position y"):
        identifiability.check_forecast(forecast_of(-3.0, -0.1, np.nan))
    identifiability.check_forecast(forecast_of(-3.0, 0.1, np.nan))
    # If nothing moves, persistence is exact, and the forecast cannot be assessed.
    identifiability.check_forecast(forecast_of(np.nan, np.nan, np.nan))


def test_a_vehicle_whose_weight_is_carried_by_the_disturbance_is_refused(rotors):
    gravity = rotors.vehicle.gravity
    for fraction in (0.1, 0.2):
        noise = PredictionNoise(np.ones(3), np.array([9.0, 9.0, fraction * gravity, 1.0, 1.0, 1.0]), np.full(6, 20.0))
        if fraction < 0.15:
            identifiability.check_thrust(rotors, noise)
        else:
            with pytest.raises(InputError, match="a force of 20 % of the weight along z is unexplained"):
                identifiability.check_thrust(rotors, noise)


def test_a_parameter_with_a_wide_interval_or_at_a_limit_is_not_identified():
    parameters = [
        Parameter("thrust_factor", 3.0, 1.0, 0.1, 9.0),
        Parameter("linear_drag", 0.2, 0.2, 0.0),
        Parameter("inertia[0]", 0.01, 0.01, 1e-4, 1.0),
    ]
    values, deviations = np.array([3.1, 0.0, 0.002]), np.array([0.1, 0.01, 0.0015])
    uncertainty = Uncertainty(np.diag(deviations**2), np.full(3, 30.0), np.eye(3))
    result = identifiability.imprecise_parameters(parameters, values, uncertainty)
    assert "at the limit of what is physically possible" in result["linear_drag"]
    # The confidence interval of this positive parameter would extend below zero.
    assert "its 95 % interval is 0.0020 ± 0.0031" in result["inertia[0]"]
    assert set(result) == {"linear_drag", "inertia[0]"}


@pytest.mark.parametrize(("value", "is_identified"), [(0.05, True), (0.015, False)])
def test_a_wide_interval_that_is_far_from_the_initial_value_is_informative(value, is_identified):
    parameter = Parameter("body_drag.centre_of_pressure[2]", 0.0, 0.009)
    uncertainty = Uncertainty(np.array([[0.005**2]]), np.full(1, 30.0), np.eye(1))
    result = identifiability.imprecise_parameters([parameter], np.array([value]), uncertainty)
    assert (result == {}) == is_identified


def test_drag_below_the_disturbing_force_is_not_identified_and_the_reason_is_given(rotors):
    """The drag coefficient is 0.2 N s/m. The vehicle moves at 1 m/s in x and y, so the drag force is 0.2 N.

    The wind causes an acceleration of 0.1 or 0.3 m/s².
    """
    time = 0.02 * np.arange(50)
    measured = np.zeros((50, 3, 1))
    measured[:, :2, 0] = time[:, None]
    outputs = [Output("position", column) for column in range(3)]
    predictor = SimpleNamespace(outputs=outputs, measured=measured, evaluated=np.full(50, True), period=0.02)
    parameters = [Parameter("linear_drag", 0.1, 0.1, 0.0), Parameter("inertia[0]", 0.01, 0.01)]
    mass = rotors.vehicle.mass
    for force, is_below in ((0.1, False), (0.4, True)):
        noise = PredictionNoise(np.ones(3), np.full(6, force), np.ones(6))
        fitted = SimpleNamespace(noise=noise, values=np.array([0.2, 0.01]))
        actual = identifiability.parameters_below_disturbance(rotors, predictor, parameters, fitted)
        assert set(actual) == ({"linear_drag"} if is_below else set())
        if is_below:
            expected = f"the disturbing force, such as wind, is {mass * force:.2g} N, but the drag force is only 0.2 N"
            assert actual["linear_drag"] == expected


def test_an_angle_response_is_not_identified_if_the_angle_command_is_below_the_noise():
    commands = np.zeros((300, 3))
    commands[:, 0] = 0.2 * np.sin(np.arange(300))
    log = record(6.0, *POSE_SIGNALS, attitude_command=commands)
    logs = SimpleNamespace(
        outputs=[Output("attitude", column) for column in range(3)], records=[log], flying=[np.full(300, True)]
    )
    parameters = [Parameter(f"autopilot.damping[{i}]", 0.5, 0.5, 0.01, 5.0) for i in range(3)]
    noise = PredictionNoise(np.full(3, 4e-3), np.ones(6), np.ones(6))
    result = identifiability.unexcited_parameters(logs, parameters, SimpleNamespace(noise=noise))
    assert set(result) == {"autopilot.damping[1]", "autopilot.damping[2]"}
    assert result["autopilot.damping[1]"].startswith("the command of pitch varies by 0 rad, less than the noise")
    rates = SimpleNamespace(**{**vars(logs), "outputs": [Output("body_rates", 0)]})
    assert identifiability.unexcited_parameters(rates, parameters, SimpleNamespace(noise=noise)) == {}


def test_drag_is_compared_with_the_force_along_the_same_axis(rotors):
    """The speed is averaged over 0.1 s, so noise and vibration at 10 Hz do not increase it."""
    time = 0.02 * np.arange(200)
    outputs = [Output("position", column) for column in range(3)]
    names = ("linear_drag", "body_drag.linear[0]", "body_drag.linear[1]", "body_drag.quadratic[0]", "mass")
    parameters = [Parameter(name, 0.1, 0.1) for name in names]

    def parameters_below(position, force, *, outputs=outputs, first=0):
        predictor = SimpleNamespace(
            outputs=outputs, measured=position[:, :, None], evaluated=np.arange(200) >= first, period=0.02
        )
        noise = PredictionNoise(np.ones(3), np.array([*force, 1.0, 1.0, 1.0]), np.ones(6))
        fitted = SimpleNamespace(noise=noise, values=np.full(5, 0.2))
        return set(identifiability.parameters_below_disturbance(rotors, predictor, parameters, fitted))

    at_rest, moving = 0.0 * time, np.sin(2.0 * time)
    # The RMS speed of a sine with an amplitude of 2 m/s is √2 m/s. At 0.2 N s/m, the drag is 0.28 N.
    limit = 0.2 * np.sqrt(2.0) / rotors.vehicle.mass
    both = np.column_stack([moving, moving, at_rest])
    assert parameters_below(both, [0.9 * limit, 0.9 * limit, 99.0]) == set()
    assert parameters_below(both, [1.1 * limit, 0.9 * limit, 0.0]) == {"linear_drag", "body_drag.linear[0]"}
    assert parameters_below(both, [0.9 * limit, 1.1 * limit, 0.0]) == {"linear_drag", "body_drag.linear[1]"}
    vibration = np.column_stack([np.sin(20.0 * np.pi * time), moving, at_rest])
    assert parameters_below(vibration, [0.1 * limit, 0.1 * limit, 0.0]) == {"linear_drag", "body_drag.linear[0]"}
    # Motion while the filter settles is ignored. In logs without horizontal positions, no parameter is excluded.
    moving_at_start = np.where(time[:, None] < 2.0, both, both[100])
    assert parameters_below(moving_at_start, [0.5 * limit] * 3, first=100) == {
        "linear_drag",
        "body_drag.linear[0]",
        "body_drag.linear[1]",
    }
    assert parameters_below(both, [99.0] * 3, outputs=[Output("attitude", column) for column in range(3)]) == set()
    assert parameters_below(both[:, :1], [99.0] * 3, outputs=[Output("position", 2)]) == set()


def test_a_parameter_is_excited_if_its_command_varies_in_flight_in_at_least_one_log():
    def command(size, *, flying):
        values = np.zeros((300, 3))
        values[:, 1] = size * np.sin(np.arange(300))
        values[~flying] = 3.0 * np.arange(np.sum(~flying))[:, None]
        return record(6.0, *POSE_SIGNALS, attitude_command=values), flying

    all_samples, first_half = np.full(300, True), np.arange(300) < 150
    parameters = [Parameter("autopilot.natural_frequency[1]", 0.5, 0.5, 0.01, 5.0), Parameter("mass", 1.0, 1.0)]
    noise = PredictionNoise(np.array([1e-9, 1e-9, 1e-9, 1e-9, 4e-3, 1e-9]), np.ones(6), np.ones(6))
    outputs = [Output(name, column) for name in POSE_SIGNALS for column in range(3)]
    for sizes, flying, is_unexcited in (
        ([1e-3, 1e-2], [all_samples, all_samples], False),
        ([1e-2, 1e-3], [all_samples, all_samples], False),
        ([1e-3, 1e-3], [first_half, first_half], True),
        # A sine of amplitude a has the standard deviation a / √2.
        ([6e-3], [first_half], False),
        ([5e-3], [first_half], True),
        ([6e-3, 6e-3], [first_half, ~all_samples], False),
    ):
        records, masks = zip(*map(lambda size, usable: command(size, flying=usable), sizes, flying), strict=True)
        logs = SimpleNamespace(outputs=outputs, records=records, flying=masks)
        result = identifiability.unexcited_parameters(logs, parameters, SimpleNamespace(noise=noise))
        assert set(result) == ({"autopilot.natural_frequency[1]"} if is_unexcited else set()), sizes


@pytest.mark.parametrize(
    ("lower", "deviation", "identified"), [(0.0, 0.39, True), (0.0, 0.41, False), (0.1, 0.39, False)]
)
def test_an_identified_parameter_has_an_interval_narrower_than_its_prior_that_excludes_zero(
    lower, deviation, identified
):
    """The half-width is 2.04 standard deviations for 30 degrees of freedom."""
    parameters = [Parameter("inertia[0]", 1.0, 0.8, lower)]
    uncertainty = Uncertainty(np.array([[deviation**2]]), np.full(1, 30.0), np.eye(1))
    result = identifiability.imprecise_parameters(parameters, np.array([0.7]), uncertainty)
    assert (result == {}) == identified


def test_a_parameter_is_a_candidate_if_the_outputs_can_determine_it(rotors, attitudes):
    def names(scenario, *signals, has_motor_throttles=False):
        options = {"has_motor_throttles": has_motor_throttles, "delay": 0.01, "max_delay": 0.1}
        return {parameter.name for parameter in parameters_of(scenario, {*signals}, **options)}

    assert {"thrust_factor", "rotor_time_constant", "inertia[2]", "linear_drag", "delay"} <= names(
        rotors, *POSE_SIGNALS
    )
    # An accelerometer determines only the product of drag and velocity if no position is measured.
    assert "linear_drag" not in names(rotors, "body_rates", FORCE)
    # A log of heights determines no parameter of the rotation.
    assert names(rotors, "position") >= {"thrust_factor", "rotor_time_constant"}
    assert "inertia[0]" not in names(rotors, "position")
    behind = names(attitudes, *POSE_SIGNALS)
    assert {"autopilot.damping[0]", "motors.curve[0]", "motors.curve[1]"} <= behind
    assert not behind & {"inertia[0]", "motors.curve[2]"}


def test_positive_parameters_have_limits_around_their_value(rotors):
    options = {"has_motor_throttles": False, "delay": 0.01, "max_delay": 0.1}
    for parameter in parameters_of(rotors, {*POSE_SIGNALS}, **options):
        assert parameter.lower <= parameter.start <= parameter.upper
        if parameter.name.startswith(("inertia", "thrust_factor", "rotor_time_constant")):
            assert parameter.lower > 0.0
