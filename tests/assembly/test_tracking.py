"""Tests of the closed loop: physics, timing, fleets, scalar types and crashes."""

import math

import numpy as np
import pytest
from pydrake.autodiffutils import AutoDiffXd, ExtractGradient
from pydrake.systems.analysis import InitializeParams, ResetIntegratorFromFlags, Simulator, Simulator_
from pydrake.systems.framework import BasicVector, LeafSystem

from drake_quad import InputError, build_tracking_diagram, load_scenario, simulate
from drake_quad.assembly.recorder import read_recorder
from drake_quad.assembly.tracking import build_fleet_diagram
from drake_quad.control.position import PdGains, ProportionalDerivative, build_position_controller
from drake_quad.fleets.fleet_simulation import fly, read_metrics
from drake_quad.flight.mission import plan_route
from drake_quad.framework.wiring import subsystem
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.planning.duration import flight_duration
from drake_quad.scenario.batch import Batch
from drake_quad.signals import SIGNALS

# Signals of a loop without a network. A network adds more signals.
EXPORTED_SIGNALS = {
    "reference",
    "error",
    "error_rate",
    "pd",
    "correction",
    "acceleration_command",
    "attitude_command",
    "wrench",
    "measurement",
    "state",
    "rotor_speed",
    "rotor_speed_command",
    "shortfall",
    "wind",
    "crashed",
}


@pytest.fixture
def figure_eight(diagrams):
    return lambda *overrides: load_scenario(diagrams / "figure_eight.yaml", overrides)


@pytest.mark.slow
def test_the_rms_error_on_the_nominal_figure_eight_is_below_three_centimetres(figure_eight):
    flight = simulate(figure_eight())
    assert flight.metrics.rmse < 0.03
    assert not flight.metrics.crashed
    assert flight.metrics.saturated_fraction == 0.0
    # The recorder and the monitor measure the same flight.
    assert flight.metrics.rmse == pytest.approx(np.sqrt(np.mean(flight.euclidean_error**2)), rel=1e-12)
    reference = flight.record("reference")
    accelerations = np.column_stack([reference.a_x, reference.a_y, reference.a_z])
    np.testing.assert_allclose(flight["acceleration_command"], flight["pd"] + accelerations, atol=1e-12)


@pytest.mark.slow
def test_derivative_action_on_the_measurement_causes_an_error_proportional_to_the_velocity(figure_eight):
    """On a long straight line at constant velocity v, the error settles to (k_D / k_P) v."""
    line = figure_eight(
        "route={kind: waypoints, waypoints: [[0, 0, 1], [16, 12, 1]], times: [0, 100]}",
        "control.position.k_p=[0.5, 0.5, 4.0]",
        "control.position.k_d=[1.0, 1.0, 3.0]",
        "control.position.derivative=measurement",
        "control.position.feed_forward=none",
    )
    flight = simulate(line)
    cruise = (flight.time > 45.0) & (flight.time < 55.0)
    reference, state = flight.record("reference"), flight.record("state")
    error = np.array([reference.x - state.x, reference.y - state.y])[:, cruise]
    velocity = np.array([reference.v_x, reference.v_y])[:, cruise]
    assert np.linalg.norm(velocity, axis=0).min() > 0.3
    np.testing.assert_allclose(error, 2.0 * velocity, rtol=0.02)
    # On the figure eight, the error is about (k_D / k_P) v, which is metres instead of centimetres. It is larger in
    # curves, which are too fast for the bandwidth of this loop.
    gains_of_the_paper = [
        f"control.position.{line}" for line in ("k_p=[1, 1, 4]", "k_d=[1, 1, 3]", "feed_forward=none")
    ]
    lagging = simulate(figure_eight(*gains_of_the_paper, "control.position.derivative=measurement"))
    reference = lagging.record("reference")
    mean_speed = np.sqrt(np.mean(reference.v_x**2 + reference.v_y**2 + reference.v_z**2))
    assert 0.9 * mean_speed < lagging.metrics.rmse < 1.4 * mean_speed


@pytest.mark.long
def test_vehicles_with_a_time_step_and_with_a_continuous_state_agree_on_a_figure_eight(figure_eight):
    """RK4 with 10 ms steps agrees to 1e-6 m with an integrator that limits its error to 1e-10."""
    paths = []
    for time_step in (0.01, 0.0):
        scenario = figure_eight(f"vehicle.time_step={time_step}")
        diagram = build_tracking_diagram(scenario, record=True)
        simulator = Simulator(diagram)
        ResetIntegratorFromFlags(simulator, "runge_kutta5", 0.1).set_target_accuracy(1e-10)
        fly(simulator, plan_route(scenario).duration)
        _, signals = read_recorder(diagram.GetSubsystemByName("recorder"), simulator.get_context())
        paths.append(signals["state"][:, :3])
    assert len(paths[0]) > 1200
    assert np.linalg.norm(paths[0] - paths[1], axis=1).max() < 1e-6


@pytest.mark.long
def test_a_vehicle_with_a_time_step_flies_in_wind_like_a_vehicle_with_a_continuous_state(asymmetric):
    """The scenario has no rotor failure, since a failure within a time step would make the flights differ."""
    overrides = ["duration=3.5", "vehicle.rotor_failure=null"]
    stepping, continuous = (simulate(asymmetric("pid", *overrides, f"vehicle.time_step={h}")) for h in (0.01, 0.0))
    for rows, tolerance in ((slice(0, 3), 1e-6), (slice(3, 12), 1e-4)):
        np.testing.assert_allclose(stepping["state"][:, rows], continuous["state"][:, rows], rtol=0.0, atol=tolerance)


@pytest.mark.long
def test_each_vehicle_of_a_fleet_has_the_flight_of_a_single_vehicle(figure_eight):
    """Flights agree to 1e-9 m, even if another vehicle in the fleet has different gains and crashes."""
    scenario = figure_eight("crash.position_error=0.5")
    n = 3
    controller = scenario.control.position
    k_p, k_d = (
        PerAxis(*[np.array([gain, 20.0, gain]) for gain in gains]) for gains in (controller.k_p, controller.k_d)
    )
    structure = {"derivative": controller.derivative, "feeds_forward": controller.feed_forward != "none"}
    pd = ProportionalDerivative(num_vehicles=n, parameters=PdGains(k_p, k_d), **structure)
    position = build_position_controller(pd)
    fleet = build_tracking_diagram(scenario, n, position_controller=position)
    simulator = Simulator(fleet)
    duration = flight_duration(scenario, plan_route(scenario))
    fly(simulator, duration)
    context = simulator.get_context()
    metrics = read_metrics(fleet, context)
    np.testing.assert_array_equal(metrics.crashed, [False, True, False])
    assert 1.0 < metrics.crash_time[1] < duration

    alone = simulate(scenario, compiled=False)
    state = fleet.GetOutputPort("state").Eval(context).reshape(12, n)
    for i in (0, 2):
        np.testing.assert_allclose(state[:3, i], alone["state"][-1, :3], rtol=0.0, atol=1e-9)
        assert metrics.rmse[i] == pytest.approx(alone.metrics.rmse, rel=1e-9)


def test_a_flight_that_ends_in_a_crash_has_metrics(figure_eight):
    flight = simulate(figure_eight("control.position.k_p=[20, 20, 20]"))
    assert flight.metrics.crashed
    assert flight.time[-1] == flight.metrics.crash_time
    assert all(math.isfinite(value) for value in flight.metrics[:-1])


def test_a_crashed_vehicle_stays_where_it_crashed(figure_eight):
    """The monitor reports the crash to the laboratory, which stops the vehicle."""
    scenario = figure_eight("control.position.k_p=[20, 20, 20]")
    crash_time = simulate(scenario).metrics.crash_time
    diagram = build_tracking_diagram(scenario)
    simulator = Simulator(diagram)
    states = []
    for time in (crash_time - 0.01, crash_time + 0.01, crash_time + 1.0):
        simulator.AdvanceTo(time)
        simulator.AdvancePendingEvents()
        states.append(diagram.GetOutputPort("state").Eval(simulator.get_context()))
    assert (states[0] != states[1]).all()
    np.testing.assert_array_equal(states[1], states[2])


class NanController(LeafSystem):
    """Position controller that outputs NaN from 2 s on."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorInputPort("measurement", BasicVector(12))
        self.DeclareVectorInputPort("reference", BasicVector(11))
        self.DeclareVectorOutputPort("acceleration_command", BasicVector(3), self.calc)

    def calc(self, context, output):
        output.SetFromVector([0.0, 0.0, math.nan if context.get_time() >= 2.0 else 0.0])


def test_a_controller_that_outputs_nan_crashes_its_vehicle(figure_eight):
    flight = simulate(figure_eight("route={kind: hover}"), position_controller=NanController())
    assert flight.metrics.crash_time == pytest.approx(2.0)
    assert np.isfinite(flight["state"]).all()
    assert all(math.isfinite(value) for value in flight.metrics[:-1])


class HoverWrench(LeafSystem):
    """Control that always commands the weight."""

    def __init__(self):
        super().__init__()
        self.DeclareVectorInputPort("measurement", BasicVector(12))
        self.DeclareVectorInputPort("reference", BasicVector(11))
        self.DeclareVectorOutputPort(
            "wrench", BasicVector(4), lambda context, output: output.SetFromVector([6.6708, 0, 0, 0])
        )


def test_a_user_defined_control_needs_only_a_wrench_output(figure_eight):
    flight = simulate(figure_eight("route={kind: hover}"), control=HoverWrench())
    np.testing.assert_allclose(flight["state"][-1, :3], [0.0, 0.0, 1.0], atol=1e-9)
    assert "pd" not in flight.signals
    assert math.isnan(flight.metrics.effort_x)


def test_every_signal_of_the_loop_is_exported_and_recorded(figure_eight):
    """Each signal has one component for each field of its type in `SIGNALS`."""
    flight = simulate(figure_eight("duration=0.5"))
    assert set(flight.signals) == EXPORTED_SIGNALS
    diagram = build_tracking_diagram(figure_eight(), 2)
    assert {diagram.get_output_port(i).get_name() for i in range(diagram.num_output_ports())} == EXPORTED_SIGNALS
    for name in EXPORTED_SIGNALS:
        num_components = len(SIGNALS[name]._fields)
        assert flight[name].shape == (26, num_components)
        assert diagram.GetOutputPort(name).size() == 2 * num_components


@pytest.mark.slow
def test_a_loop_has_the_requested_parts(figure_eight):
    """No input of the loop is left unconnected.

    The noise comes from the random streams of the samples, or from Drake's random sources if requested. Every part has
    a name.
    """

    def parts_of(diagram):
        return {part.get_name() for part in diagram.GetSystems()}

    scenario = figure_eight("laboratory.motion_capture.position_noise=0.001")
    plan = plan_route(scenario)
    parts = {"reference", "control", "laboratory", "monitor"}
    for diagram_without_recorder in (
        build_tracking_diagram(scenario),
        build_fleet_diagram(Batch(scenario, (0,), {}), plan),
    ):
        assert diagram_without_recorder.get_name() == scenario.name
        assert diagram_without_recorder.num_input_ports() == 0
        assert parts_of(diagram_without_recorder) == parts
        assert "noise" in parts_of(diagram_without_recorder.GetSubsystemByName("laboratory"))
    recorded = build_tracking_diagram(scenario, record=True, drake_random=True)
    assert parts_of(recorded) == parts | {"recorder"}
    noise = [part for part in parts_of(recorded.GetSubsystemByName("laboratory")) if "noise" in part]
    assert noise == ["random_motion_capture.camera_noise"]


def test_vehicles_have_the_flights_of_the_given_samples(figure_eight):
    scenario = figure_eight("laboratory.motion_capture.position_noise=0.001")
    plan = plan_route(scenario)

    def numbers_of(diagram):
        context = diagram.CreateDefaultContext()
        return [context.get_numeric_parameter(i).CopyToVector() for i in range(context.num_numeric_parameter_groups())]

    for sample, samples in ((None, (0, 1)), (7, (7, 8))):
        scenario_of_sample = scenario.model_copy(update={"sample": sample})
        actual_numbers = numbers_of(build_tracking_diagram(scenario_of_sample, 2))
        for actual, expected in zip(
            actual_numbers, numbers_of(build_fleet_diagram(Batch(scenario, samples, {}), plan)), strict=True
        ):
            np.testing.assert_array_equal(actual, expected)


def test_an_injected_signal_is_added_to_the_command_before_the_command_link(figure_eight):
    scenario = figure_eight("route={kind: hover}")
    plan = plan_route(scenario)
    diagram = build_fleet_diagram(Batch(scenario, (0,), {}), plan, injects=True)
    context = diagram.CreateDefaultContext()
    injected = [0.5, 0.01, -0.02, 0.03]
    assert diagram.num_input_ports() == 1
    diagram.GetInputPort("injection").FixValue(context, injected)
    command = diagram.GetOutputPort("wrench").Eval(context)
    np.testing.assert_allclose(diagram.GetOutputPort("injected").Eval(context), command + injected, rtol=1e-12)
    link = diagram.GetSubsystemByName("laboratory").GetSubsystemByName("command_link")
    link_input = link.GetInputPort("wrench").Eval(link.GetMyContextFromRoot(context))
    np.testing.assert_allclose(link_input, command + injected, rtol=1e-12)


@pytest.mark.long
def test_signals_of_a_network_are_exported(asymmetric):
    """There are 36 weights: one for each of 12 rules on each of three axes."""
    flight = simulate(asymmetric("pd_t2fnn", "duration=0.5", "metrics.start=0"))
    assert set(flight.signals) == EXPORTED_SIGNALS | {"weights", "covariance_trace"}
    assert (flight["weights"].shape, flight["covariance_trace"].shape) == ((26, 36), (26, 3))


@pytest.mark.slow
def test_the_rotor_command_has_the_delays_of_the_camera_frame_and_of_the_command_link(figure_eight):
    """A control tick reads a camera frame that is 10 ms old, and the command link delays the command."""
    for ticks in (0, 1, 2):
        scenario = figure_eight(f"laboratory.command_link.delay_ticks={ticks}", "duration=2.0")
        flight = simulate(scenario)
        np.testing.assert_allclose(flight["measurement"][0], flight["state"][0], atol=1e-12)
        wrench, rotor_speeds = flight["wrench"], flight["rotor_speed_command"]
        thrust = 4.13e-5 * np.sum(rotor_speeds**2, axis=1)
        # The recorder samples a command one tick after the link has delivered it.
        np.testing.assert_allclose(thrust[ticks + 1 :], wrench[: -ticks - 1, 0], rtol=1e-9)
        np.testing.assert_allclose(thrust[: ticks + 1], 0.68 * 9.81, rtol=1e-9)


@pytest.mark.parametrize(("ticks", "frames"), [(0, 0), (1, 0), (2, 0), (1, 1), (1, 3)])
def test_the_rotor_command_responds_to_a_jump_of_the_state_after_the_delays_of_camera_and_link(
    figure_eight, ticks, frames
):
    """The expected delay consists of camera latency, link delay, and the 10 to 20 ms until a tick reads a frame."""
    scenario = figure_eight(
        "route={kind: hover}",
        f"laboratory.command_link.delay_ticks={ticks}",
        f"laboratory.motion_capture.latency_frames={frames}",
    )
    diagram = build_tracking_diagram(scenario)
    vehicle = diagram.GetSubsystemByName("laboratory").GetSubsystemByName("vehicle")
    delays = []
    for step in range(20, 60):
        simulator = Simulator(diagram)
        context = simulator.get_mutable_context()
        # The roll jumps 5 ms before the frame at `start`.
        start = 0.01 * step
        simulator.AdvanceTo(start - 0.005)
        vehicle_context = vehicle.GetMyMutableContextFromRoot(context)
        vehicle.set_state(vehicle_context, "state", vehicle.get_state(vehicle_context, "state")._replace(roll=0.1))
        time = start
        while np.ptp(diagram.GetOutputPort("rotor_speed_command").Eval(context)) < 1e-3:
            simulator.AdvanceTo(time)
            simulator.AdvancePendingEvents()
            time += 0.01
        delays.append(context.get_time() - start)
    # A control tick reads the camera frame before it, 10 ms earlier. A frame that is taken at a tick is therefore read
    # at the next tick, 20 ms later. A frame that is taken between two ticks is read 10 ms later.
    shortest_delay = 0.01 * (1 + frames) + 0.02 * ticks
    assert min(delays) == pytest.approx(shortest_delay, abs=1e-9)
    assert max(delays) == pytest.approx(shortest_delay + 0.01, abs=1e-9)
    assert np.mean(delays) == pytest.approx(shortest_delay + 0.005, abs=1e-9)


FAN = "{kind: fan, position: [0, -3, 0.5], direction: [0, 1, 0], flow: 3, diameter: 0.75}"
# The jet of this fan does not reach the vehicle and has no turbulence.
REMOTE_FAN = "{kind: fan, position: [0, 3, 0.5], direction: [0, 1, 0], flow: 3, diameter: 0.75, turbulence: 0}"
IMPERFECT_LABORATORY = [
    "vehicle.linear_drag=0.1",
    "vehicle.centre_of_mass=[0.002, 0.0]",
    "vehicle.battery_sag=0.02",
    "vehicle.rotor_failure={rotor: 2, time: 1.0, speed_factor: 0.95}",
    "laboratory.motion_capture={position_noise: 0.001, attitude_noise: 0.004, misalignment: [0.01, 0.01, 0.0],"
    " derivative_bandwidth: 40, dropout_rate: 0.05, latency_frames: 1}",
    "laboratory.command_link.loss_rate=0.05",
    "laboratory.wind=[{kind: steady, velocity: [0.5, 0, 0]}, {kind: dryden, level: light},"
    " {kind: gust, velocity: [0, 1, 0], start: 0.5, rise_time: 1},"
    f" {FAN}, {REMOTE_FAN}]",
]
CALM_LABORATORY = [f"laboratory.wind=[{REMOTE_FAN}]"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("overrides", "n"), [(IMPERFECT_LABORATORY, 1), (IMPERFECT_LABORATORY, 2), (CALM_LABORATORY, 2)]
)
def test_the_closed_loop_supports_automatic_differentiation(figure_eight, overrides, n):
    """The derivative of the state after 1.2 s with respect to one vehicle's gain agrees with a central difference."""
    scenario = figure_eight("duration=1.2", "control.position.k_p=[1.0, 1.0, 4.0]", *overrides)
    diagram = build_tracking_diagram(scenario, n)

    def set_gain(diagram, context, k_p):
        law = subsystem(diagram, ("control", "position", "pd"))
        law_context = law.GetMyMutableContextFromRoot(context)
        gains = law.get_parameter(law_context, "gains")
        x = k_p if n == 1 else np.array([k_p, *gains.k_p.x[1:]])
        law.set_parameter(law_context, "gains", gains._replace(k_p=gains.k_p._replace(x=x)))

    def final_state(k_p):
        simulator = Simulator(diagram)
        set_gain(diagram, simulator.get_mutable_context(), k_p)
        fly(simulator, 1.2)
        return diagram.GetOutputPort("state").Eval(simulator.get_context())

    converted = diagram.ToAutoDiffXd()
    context = converted.CreateDefaultContext()
    context.SetTimeStateAndParametersFrom(diagram.CreateDefaultContext())
    set_gain(converted, context, AutoDiffXd(1.0, [1.0]))
    simulator = Simulator_[AutoDiffXd](converted, context)
    simulator.AdvanceTo(1.2)
    simulator.AdvancePendingEvents()
    state = converted.GetOutputPort("state").Eval(context)
    gradient = ExtractGradient(np.asarray(state))[:, 0]
    step = 1e-5
    numeric = (final_state(1.0 + step) - final_state(1.0 - step)) / (2.0 * step)
    assert np.abs(numeric).max() > 1e-4
    np.testing.assert_allclose(gradient, numeric, atol=1e-8)


def test_a_flight_can_continue_in_another_simulator(figure_eight):
    """Initialization events must be suppressed, because they would restart turbulence and filters."""
    scenario = figure_eight("duration=4.0", *IMPERFECT_LABORATORY)
    diagram = build_tracking_diagram(scenario)
    first = Simulator(diagram)
    first.AdvanceTo(2.0)
    context = first.get_context().Clone()
    first.AdvanceTo(4.0)
    continued = Simulator(diagram, context)
    parameters = InitializeParams()
    parameters.suppress_initialization_events = True
    continued.Initialize(parameters)
    continued.AdvanceTo(4.0)
    states = [diagram.GetOutputPort("state").Eval(simulator.get_context()) for simulator in (first, continued)]
    np.testing.assert_array_equal(*states)


def test_a_distribution_is_refused_where_a_number_is_needed(figure_eight):
    scenario = figure_eight("vehicle.mass={uniform: {min: 0.6, max: 0.7}}")
    for use in (simulate, build_tracking_diagram):
        with pytest.raises(InputError, match="vehicle.mass is a distribution"):
            use(scenario)


def test_a_metrics_window_beyond_the_end_of_the_flight_is_refused(figure_eight):
    with pytest.raises(InputError, match=r"metrics.start is 30 s, but must be before the end of the flight at 25.38 s"):
        simulate(figure_eight("metrics.start=30"))


@pytest.mark.slow
@pytest.mark.parametrize("yaw", [1.0, 3.0])
def test_the_tracking_error_does_not_depend_on_the_yaw(figure_eight, yaw):
    flight_at_zero_yaw, flight_at_yaw = simulate(figure_eight()), simulate(figure_eight(f"route.yaw={yaw}"))
    assert flight_at_yaw.metrics.rmse == pytest.approx(flight_at_zero_yaw.metrics.rmse, rel=0.02)
    np.testing.assert_allclose(flight_at_yaw.record("state").yaw[-1], yaw, atol=0.01)
