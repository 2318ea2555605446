"""Tests that the systems of a laboratory diagram are built with the parameters of the scenario."""

import math

import numpy as np
import pytest

from drake_quad import InputError, load_scenario
from drake_quad.assembly.laboratory import (
    build_monitor,
    jump_times,
    laboratory_recipes,
    vehicle_parameters,
    wind_period,
)
from drake_quad.flight.mission import plan_route
from drake_quad.framework.recipe import Recipe
from drake_quad.gym.task import environment_scenario
from drake_quad.laboratory.command_link import LinkParameters
from drake_quad.laboratory.flight_monitor import CrashLimits, Window
from drake_quad.laboratory.motion_capture import CameraParameters
from drake_quad.laboratory.wind.dryden import WIND_AT_20_FEET, Turbulence
from drake_quad.laboratory.wind.fans import Outlet
from drake_quad.laboratory.wind.gust import GustParameters
from drake_quad.laboratory.wind.sine import SineParameters, SineWind
from drake_quad.scenario.batch import Batch
from drake_quad.scenario.winds.source import steady_wind
from drake_quad.signals import Attitude, AttitudeTarget, BodyRates, Wind, Wrench
from drake_quad.vehicle.attitude_response import (
    AttitudeResponse,
    AttitudeResponseQuadrotor,
    DampingRatios,
    NaturalFrequencies,
)
from drake_quad.vehicle.autopilot import AutopilotParameters, Gyroscope, LoopGains, LoopRules, ThrustOnly
from drake_quad.vehicle.parameters import CentreOfMass, Inertia
from drake_quad.vehicle.quadrotor import HoverPose

FLIGHT_DURATION = 16.0  # s, for all recipes


def recipes_of(scenario, samples=(0,)):
    return laboratory_recipes(Batch.draw(scenario, samples), plan_route(scenario), FLIGHT_DURATION)


@pytest.fixture(scope="module")
def recipes(asymmetric):
    return recipes_of(asymmetric("pid"))


def test_the_vehicle_has_the_parameters_of_the_scenario(asymmetric, recipes):
    vehicle = asymmetric("pid").vehicle
    parameters = vehicle_parameters(vehicle)
    np.testing.assert_allclose(
        parameters.rotors.thrust_factors, [4.1492e-5, 4.018e-5, 4.1656e-5, 4.1205e-5], rtol=1e-12
    )
    assert parameters.centre_of_mass == CentreOfMass(-0.0003, 0.0008)
    assert parameters.inertia == Inertia(0.0071, 0.0079, 0.0131)
    for name in set(parameters._fields) - {"rotors", "centre_of_mass", "inertia"}:
        assert getattr(parameters, name) == getattr(vehicle, name)
    recipe = recipes["vehicle"]
    assert recipe.parameters.parameters == parameters
    assert recipe.structure == {"time_step": 0.01, "kinematics": "exact", "faulty": True, "effects": ()}


def test_a_fleet_with_a_rotor_position_that_allows_no_independent_yaw_torque_is_refused(diagrams):
    """If rotor 1 is at x = -0.3 m, yaw torque is a linear combination of thrust, roll torque and pitch torque."""
    corners = {(0.1, -0.1): "clockwise", (-0.1, -0.1): "anticlockwise", (-0.1, 0.1): "clockwise"}
    rotors = [f"{{position: [{x}, {y}, 0], turns: {turns}}}" for (x, y), turns in corners.items()]
    rotors.append("{position: [0.1, 0.1, 0], turns: anticlockwise}")
    layout = f"vehicle.layout={{kind: rotors, rotors: [{', '.join(rotors)}]}}"
    scenario = load_scenario(diagrams / "hover.yaml", [layout])
    batch, plan = Batch.draw(scenario, range(3)), plan_route(scenario)
    field = "vehicle.layout.rotors.rotor_1.position.0"
    fleet = batch.with_varying({field: np.array([0.1, 0.2, 0.3])})
    recipe = laboratory_recipes(fleet, plan, FLIGHT_DURATION)["vehicle"]
    np.testing.assert_array_equal(recipe.parameters.parameters.rotors.rotor_1.x, [0.1, 0.2, 0.3])
    words = "vehicle.layout cannot produce yaw torque without thrust, roll torque and pitch torque"
    with pytest.raises(InputError, match=words):
        laboratory_recipes(batch.with_varying({field: np.array([0.1, -0.3, 0.3])}), plan, FLIGHT_DURATION)


def test_the_battery_sags_over_the_whole_flight(recipes):
    faults = recipes["vehicle"].parameters.faults
    assert faults.battery_sag == pytest.approx(0.02 / FLIGHT_DURATION, rel=1e-15)
    assert (faults.failure_time, tuple(faults.failure_factor)) == (6.003, (1.0, 0.993, 1.0, 1.0))


@pytest.mark.parametrize(
    ("sag", "failure", "faulty"),
    [
        ("0", "null", False),
        ("0.0", "null", False),
        ("0.01", "null", True),
        ("{uniform: {min: 0.0, max: 0.01}}", "null", True),
        ("0", "{rotor: 1, time: 3}", True),
    ],
)
def test_the_vehicle_models_faults_if_the_battery_can_sag_or_a_rotor_fails(asymmetric, sag, failure, faulty):
    """A fault of 0 or 0.0 is absent. A distribution with nonzero values counts as a fault."""
    scenario = asymmetric("pid", f"vehicle.battery_sag={sag}", f"vehicle.rotor_failure={failure}")
    assert recipes_of(scenario)["vehicle"].structure["faulty"] == faulty


@pytest.mark.parametrize("rotor", [1, 2, 3, 4])
def test_the_rotor_with_the_given_number_fails(asymmetric, rotor):
    scenario = asymmetric("pid", f"vehicle.rotor_failure.rotor={rotor}")
    expected = np.ones(4)
    expected[rotor - 1] = 0.993
    np.testing.assert_array_equal(recipes_of(scenario)["vehicle"].parameters.faults.failure_factor, expected)


def test_each_vehicle_of_a_fleet_can_have_a_different_failing_rotor(asymmetric):
    scenario = asymmetric("pid", "vehicle.rotor_failure.rotor={choice: [1, 3, 4]}")
    batch = Batch.draw(scenario, range(30))
    failure_factors = laboratory_recipes(batch, plan_route(scenario), FLIGHT_DURATION)[
        "vehicle"
    ].parameters.faults.failure_factor
    failing_rotors = batch.varying["vehicle.rotor_failure.rotor"]
    assert set(failing_rotors) == {1.0, 3.0, 4.0}
    for rotor, factors in enumerate(failure_factors, start=1):
        np.testing.assert_array_equal(factors, np.where(failing_rotors == rotor, 0.993, 1.0))


def test_the_vehicle_starts_where_the_plan_starts(recipes):
    np.testing.assert_allclose(recipes["vehicle"].parameters.start, HoverPose(0.3, -0.2, 1.0, 0.4), atol=1e-12)


def test_allocation_and_link_use_the_nominal_parameters(recipes):
    allocation, link = recipes["allocation"].parameters, recipes["command_link"]
    # In a plus layout, all rotors produce thrust and yaw torque, rotors 2 and 4 produce roll torque, and rotors 1 and 3
    # produce pitch torque.
    per_thrust, per_tilt, per_yaw = 0.25 / 4.0e-5, 0.5 / (0.16 * 4.0e-5), 0.25 / 1.1e-6
    expected = [
        [per_thrust, 0.0, -per_tilt, per_yaw],
        [per_thrust, -per_tilt, 0.0, -per_yaw],
        [per_thrust, 0.0, per_tilt, per_yaw],
        [per_thrust, per_tilt, 0.0, -per_yaw],
    ]
    np.testing.assert_allclose(allocation.mixer, expected, rtol=1e-12)
    assert (allocation.min_speed, allocation.max_speed) == (194.0, 223.0)
    assert recipes["allocation"].structure == {"paired": True, "priority": "roll_pitch"}
    assert link.parameters == LinkParameters(1, 0.03, Wrench(pytest.approx(0.7 * 9.79), 0.0, 0.0, 0.0))
    assert link.structure == {"signal": "wrench", "period": 0.02, "longest_delay": 1, "loses_packets": True}


def test_the_cameras_have_the_errors_of_the_scenario(recipes):
    cameras = recipes["motion_capture"]
    assert cameras.parameters == CameraParameters(0.0012, 0.003, 0.03, Attitude(0.006, -0.009, 0.04), 70.0, 2)
    assert cameras.structure["period"] == 0.01


@pytest.mark.parametrize(
    ("override", "name", "expected"),
    [
        # The camera model is noisy unless both the position noise and the attitude noise are zero.
        ("position_noise=0", "noisy", True),
        ("attitude_noise=0.0", "noisy", True),
        ("dropout_rate=0", "loses_frames", False),
        ("dropout_rate={choice: [0.0, 0.1]}", "loses_frames", True),
        ("misalignment=[0, 0.0, 0]", "misaligned", False),
        ("misalignment=[0, 0, {normal: {mean: 0, standard_deviation: 0.1}}]", "misaligned", True),
        ("velocity_error=[0, 0.0, 0]", "velocity_scaled", False),
        ("velocity_error=[0, {uniform: {min: 0, max: 0.1}}, 0]", "velocity_scaled", True),
        ("velocity_drift=[0, 0.0, 0]", "drifts", False),
        ("velocity_drift=[0, {uniform: {min: 0, max: 0.1}}, 0]", "drifts", True),
        ("derivative_bandwidth=null", "filtered", False),
        ("derivative_bandwidth=70", "filtered", True),
        ("latency_frames=0", "longest_latency", 0),
        ("latency_frames={choice: [0, 3, 1]}", "longest_latency", 3),
    ],
)
def test_cameras_model_every_imperfection_that_a_sample_can_have(asymmetric, override, name, expected):
    """One diagram simulates all samples, so it models an imperfection if any sample can have it."""
    recipe = recipes_of(asymmetric("pid", f"laboratory.motion_capture.{override}"))["motion_capture"]
    assert recipe.structure[name] == expected
    # No noise is modelled if neither the position nor the attitude has noise.
    without_noise = ["laboratory.motion_capture.position_noise=0", "laboratory.motion_capture.attitude_noise=0"]
    assert not recipes_of(asymmetric("pid", *without_noise))["motion_capture"].structure["noisy"]


def test_every_source_of_wind_has_a_recipe(recipes):
    winds = {path.removeprefix("wind."): recipe for path, recipe in recipes.items() if path.startswith("wind.")}
    assert list(winds) == ["steady", "gust_0", "gust_1", "dryden_0", "dryden_1", "fans"]
    assert winds["steady"].parameters == Wind(0.7, -0.5, 0.3)
    assert winds["gust_0"].parameters == GustParameters(Wind(-1.5, 1.2, -0.6), 3.0, 0.8, 1.3)
    velocity, *times = winds["gust_1"].parameters
    assert velocity == pytest.approx(Wind(1.4 * math.cos(0.9), 1.4 * math.sin(0.9), 0.0))
    assert times == [9.0, 1.1, math.inf]
    # The steady wind is slower than 1 m/s, so the model assumes that turbulence passes the vehicle at 1 m/s.
    for name, level, fraction, height, airspeed, heading in (
        ("dryden_0", "light", 0.5, 4.0, 1.0, 0.7),
        ("dryden_1", "moderate", 0.1, 3.5, 3.0, -1.9),
    ):
        turbulence = Turbulence.at_low_altitude(
            height=height, wind_at_20_feet=fraction * WIND_AT_20_FEET[level], airspeed=airspeed
        )
        assert winds[name].parameters == (turbulence, heading)
    first, second = winds["fans"].parameters
    assert (first.outlet, second.outlet) == (Outlet(-2.5, -1.0, 0.9), Outlet(2.5, 1.5, 1.8))
    assert (first.turbulence, second.turbulence) == (0.2, 0.25)
    np.testing.assert_allclose(np.cross(second.direction, (-2.0, -1.5, -0.3)), 0.0, atol=1e-15)
    assert np.linalg.norm(second.direction) == pytest.approx(1.0)
    assert second.exit_speed == pytest.approx(4.0 * 1.9 / (math.pi * 0.6**2))
    assert all(recipe.structure == {"period": 0.01} for name, recipe in winds.items() if name != "steady")


@pytest.mark.parametrize(("step", "period"), [("0.005", 0.005), ("0", 0.01)])
def test_wind_is_held_over_a_time_step_or_over_a_camera_frame_if_the_state_is_continuous(asymmetric, step, period):
    scenario = asymmetric("pid", f"vehicle.time_step={step}")
    assert wind_period(scenario) == period
    assert recipes_of(scenario)["wind.gust_0"].structure == {"period": period}


def test_steady_winds_are_added_and_calm_air_adds_no_system_to_the_diagram(asymmetric):
    sources = "[{kind: steady, velocity: [1, 2, 3]}, {kind: steady, speed: 2.0, heading: 0.5}]"
    scenario = asymmetric("pid", f"laboratory.wind={sources}")
    total = Wind(1.0 + 2.0 * math.cos(0.5), 2.0 + 2.0 * math.sin(0.5), 3.0)
    assert recipes_of(scenario)["wind.steady"].parameters == pytest.approx(total)
    assert steady_wind(scenario.laboratory.wind) == pytest.approx(total)
    for calm in ("velocity: [0, 0.0, 0]", "speed: 0, heading: 0.7"):
        recipes = recipes_of(asymmetric("pid", f"laboratory.wind=[{{kind: steady, {calm}}}]"))
        assert not any(path.startswith("wind.") for path in recipes)
    drawn_speed = "laboratory.wind=[{kind: steady, speed: {choice: [0.0, 1.0]}, heading: 0.7}]"
    assert "wind.steady" in recipes_of(asymmetric("pid", drawn_speed))
    # The diagram contains a steady wind if the distribution of the scenario allows one, or if a vehicle of the batch
    # has one.
    calm = "laboratory.wind=[{kind: steady, speed: 0, heading: 0.7}]"
    for wind, speeds in ((drawn_speed, (0.0, 0.0)), (calm, (0.0, 1.5))):
        scenario = asymmetric("pid", wind)
        batch = Batch(scenario, (0, 1), {"laboratory.wind.0.speed": np.array(speeds)})
        steady = laboratory_recipes(batch, plan_route(scenario), FLIGHT_DURATION)["wind.steady"].parameters
        np.testing.assert_allclose(np.hypot(steady.x, steady.y), speeds, rtol=1e-12)


def test_a_time_step_may_not_exceed_two_and_a_half_time_constants_of_the_drag(asymmetric):
    """The time step may be at most 2.5 m / (c₁ + 2 c₂ |v|), where v is the largest possible wind velocity."""
    fans = sum(4.0 * flow / (math.pi * diameter**2) for flow, diameter in ((2.3, 0.8), (1.9, 0.6)))
    gusts = math.hypot(1.5, 1.2, 0.6) + 1.4
    airspeed = math.hypot(0.7, 0.5, 0.3) + gusts + fans
    max_drag = 2.5 * 0.74 / 0.01 - 2.0 * 0.02 * airspeed
    for fraction, fits in ((1.0 - 1e-9, True), (1.0 + 1e-9, False)):
        scenario = asymmetric("pid", f"vehicle.linear_drag={fraction * max_drag!r}")
        if fits:
            recipes_of(scenario)
        else:
            with pytest.raises(InputError, match="vehicle.time_step is 0.01 s, too long for drag with a time constant"):
                recipes_of(scenario)


def test_queues_are_long_enough_for_the_longest_delay_in_the_distribution(asymmetric):
    latencies = ["laboratory.motion_capture.latency_frames={choice: [3, 1, 2]}"]
    scenario = asymmetric("pid", *latencies, "laboratory.command_link.delay_ticks={choice: [0, 4, 1]}")
    recipes = recipes_of(scenario)
    assert recipes["motion_capture"].structure["longest_latency"] == 3
    assert recipes["command_link"].structure["longest_delay"] == 4


def test_turbulence_has_the_speed_and_direction_of_the_steady_wind_by_default(asymmetric):
    sources = "[{kind: steady, velocity: [1, 2, 3]}, {kind: steady, velocity: [1, -6, 0]}, {kind: dryden}]"
    scenario = asymmetric("pid", f"laboratory.wind={sources}")
    turbulence, heading = recipes_of(scenario)["wind.dryden_0"].parameters
    assert turbulence.airspeed == pytest.approx(math.sqrt(29.0))
    assert heading == pytest.approx(math.atan2(-4.0, 2.0))


def test_the_monitor_has_the_limits_and_the_window_of_the_scenario(asymmetric):
    def numbers_of(monitor):
        (update,) = monitor.updates
        limits, window = (
            next(read for read in update.computation.reads if isinstance(read, kind)) for kind in (CrashLimits, Window)
        )
        return limits, window, update.period

    scenario = asymmetric("pid", "crash={tilt: 1.1, position_error: 3.0, height: -0.2}")
    assert numbers_of(build_monitor(scenario, plan_route(scenario), 1)) == (
        CrashLimits(1.1, 3.0, -0.2),
        Window(1.0, 13.0),
        0.02,
    )
    without_end = asymmetric("pid", "metrics.end=null", "laboratory.command_link.period=0.04")
    assert numbers_of(build_monitor(without_end, plan_route(without_end), 1))[1:] == (Window(1.0, math.inf), 0.04)


@pytest.mark.slow
@pytest.mark.parametrize(("action", "gains"), [("rates", (0.0, 0.0, 0.0)), ("attitude", (6.0, 5.5, 2.8))])
def test_an_autopilot_that_takes_body_rates_has_no_attitude_loop(action, gains):
    scenario = load_scenario("onboard", ["laboratory.autopilot.k_attitude=[6, 5.5, 2.8]"])
    parameters = recipes_of(environment_scenario(scenario, action=action))["autopilot"].parameters
    assert parameters.k_attitude == gains


# For each imperfection: the field of the scenario, the system that models it, and the structural argument that
# enables it.
IMPERFECTIONS_OF_A_FLEET = [
    ("vehicle.battery_sag", "vehicle", "faulty"),
    *(
        (f"laboratory.motion_capture.{field}", "motion_capture", name)
        for field, name in (
            ("position_noise", "noisy"),
            ("attitude_noise", "noisy"),
            ("dropout_rate", "loses_frames"),
            ("misalignment.1", "misaligned"),
            ("velocity_error.2", "velocity_scaled"),
            ("velocity_drift.0", "drifts"),
        )
    ),
    ("laboratory.command_link.loss_rate", "command_link", "loses_packets"),
    ("laboratory.autopilot.gyroscope_noise", "autopilot", "noisy"),
    ("laboratory.autopilot.attitude_noise", "autopilot", "noisy"),
]


@pytest.fixture(scope="module")
def perfect_laboratory(asymmetric):
    """Return a scenario without the imperfections that a fleet may have, and its plan."""
    cameras = "position_noise: 0, attitude_noise: 0"
    scenario = asymmetric(
        "lqg_on_board",
        f"laboratory.motion_capture={{{cameras}, misalignment: [0, 0, 0], dropout_rate: 0, latency_frames: 2}}",
        "laboratory.command_link={delay_ticks: 1, loss_rate: 0}",
        "laboratory.autopilot={kind: attitude, period: 0.005, gyroscope_noise: 0, attitude_noise: 0}",
        "vehicle.battery_sag=0",
        "vehicle.rotor_failure=null",
    )
    return scenario, plan_route(scenario)


@pytest.mark.parametrize(("field", "part", "name"), IMPERFECTIONS_OF_A_FLEET)
def test_an_imperfection_is_modelled_if_any_vehicle_of_a_fleet_has_it(perfect_laboratory, field, part, name):
    """The scenario has no imperfection. The batch assigns an imperfection to one of its two vehicles."""
    scenario, plan = perfect_laboratory
    for values, is_modelled in (((0.0, 0.0), False), ((0.0, 0.01), True)):
        batch = Batch(scenario, (0, 1), {field: np.array(values)})
        assert laboratory_recipes(batch, plan, FLIGHT_DURATION)[part].structure[name] is is_modelled


def test_queues_are_long_enough_for_the_longest_delay_in_a_fleet(perfect_laboratory):
    scenario, plan = perfect_laboratory
    for delays, longest in (((0.0, 5.0), 5), ((0.0, 0.0), None)):
        varying = {
            field: np.array(delays)
            for field in ("laboratory.motion_capture.latency_frames", "laboratory.command_link.delay_ticks")
        }
        recipes = laboratory_recipes(Batch(scenario, (0, 1), varying), plan, FLIGHT_DURATION)
        assert recipes["motion_capture"].structure["longest_latency"] == (longest or 2)
        assert recipes["command_link"].structure["longest_delay"] == (longest or 1)


def test_the_link_to_an_autopilot_first_commands_hover_at_the_yaw_of_the_plan(perfect_laboratory):
    scenario, plan = perfect_laboratory
    link = laboratory_recipes(Batch(scenario, (0,), {}), plan, FLIGHT_DURATION)["command_link"]
    assert link.structure["signal"] == "attitude_target"
    hover = AttitudeTarget(pytest.approx(0.7 * 9.79), 0.0, 0.0, pytest.approx(0.4), 0.0, 0.0, 0.0)
    assert link.parameters == LinkParameters(1, 0.0, hover)


def test_an_autopilot_has_the_gains_and_the_gyroscope_of_the_scenario(asymmetric):
    autopilot = recipes_of(asymmetric("lqg_on_board", "laboratory.autopilot.attitude_noise=0.006"))["autopilot"]
    assert autopilot.structure == {"period": 0.005, "noisy": True, "rules": LoopRules()}
    assert autopilot.parameters == AutopilotParameters(
        LoopGains(6.3, 5.8, 2.9),
        LoopGains(14.0, 12.5, 9.5),
        Inertia(0.0065, 0.0085, 0.0126),
        Gyroscope(0.004, BodyRates(0.002, -0.003, 0.001)),
        0.006,
        Wrench(pytest.approx(0.7 * 9.79), 0.0, 0.0, 0.0),
    )


def test_an_identified_attitude_response_has_the_parameters_of_the_scenario(asymmetric):
    response = "{kind: response, natural_frequency: [8.0, 9.0, 3.0], damping: [0.7, 0.8, 1.1]}"
    recipes = recipes_of(asymmetric("lqg_on_board", f"laboratory.autopilot={response}", "vehicle.rotor_failure=null"))
    assert recipes["vehicle"].system is AttitudeResponseQuadrotor
    quadrotor, attitude_response = recipes["vehicle"].parameters
    assert attitude_response == AttitudeResponse(NaturalFrequencies(8.0, 9.0, 3.0), DampingRatios(0.7, 0.8, 1.1))
    assert quadrotor.start == pytest.approx(HoverPose(0.3, -0.2, 1.0, 0.4))
    assert recipes["autopilot"] == Recipe(ThrustOnly, {}, None)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("damping", [0.5, 1.6])
def test_a_time_step_may_not_exceed_two_and_a_half_time_constants_of_the_attitude_response(asymmetric, axis, damping):
    """The fastest decay rate of an angle is ω (ζ + √(ζ² - 1)), or ω ζ if the response is underdamped."""
    fastest_decay = damping + math.sqrt(max(damping**2 - 1.0, 0.0))
    for fraction, fits in ((1.0 - 1e-9, True), (1.0 + 1e-9, False)):
        frequency, damping_ratio = ["5.0"] * 3, ["0.9"] * 3
        frequency[axis], damping_ratio[axis] = repr(fraction * 2.5 / 0.005 / fastest_decay), repr(damping)
        response = (
            f"{{kind: response, natural_frequency: [{', '.join(frequency)}], damping: [{', '.join(damping_ratio)}]}}"
        )
        scenario = asymmetric("lqg_on_board", f"laboratory.autopilot={response}", "vehicle.rotor_failure=null")
        if fits:
            recipes_of(scenario)
        else:
            with pytest.raises(InputError, match="too long for an attitude response with a time constant of 0.002 s"):
                recipes_of(scenario)


def test_a_scenario_without_wind_sources_has_no_wind_recipes(asymmetric):
    scenario = asymmetric("pid", "laboratory.wind=[]")
    assert not any(path.startswith("wind.") for path in recipes_of(scenario))
    assert steady_wind(scenario.laboratory.wind) == Wind(0.0, 0.0, 0.0)


def test_a_sinusoidal_wind_has_the_velocity_frequency_and_phase_of_the_scenario(asymmetric):
    sine = "{kind: sine, speed: 1.5, heading: 0.9, frequency: 0.3, phase: 0.7}"
    recipe = recipes_of(asymmetric("pid", f"laboratory.wind=[{sine}]"))["wind.sine_0"]
    velocity = Wind(pytest.approx(1.5 * math.cos(0.9)), pytest.approx(1.5 * math.sin(0.9)), 0.0)
    assert recipe == Recipe(SineWind, {"period": 0.01}, SineParameters(velocity, 0.3, 0.7))


def test_force_jump_times_of_a_continuous_vehicle_are_sorted(asymmetric):
    payload = "{mass: 0.05, position: [0, 0, 0], inertia: [1e-5, 1e-5, 1e-5], time: 1.0, event: dropped}"
    scenario = asymmetric("pid", "vehicle.time_step=0", f"vehicle.payload={payload}")
    for times in ([6.003, 1.25], [1.25, 6.003], [8.0, 6.003]):
        varying = {"vehicle.payload.time": np.array(times), "vehicle.rotor_failure.time": np.array([2.5, 2.5])}
        assert jump_times(Batch(scenario, (0, 1), varying)) == tuple(sorted({*times, 2.5}))
    assert jump_times(Batch(asymmetric("pid"), (0,), {})) == ()
