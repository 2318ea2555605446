"""Tests that samples fly in a reused fleet as in a new fleet."""

import resource
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from drake_quad import InputError, load_scenario, simulate
from drake_quad.assembly.tracking import build_fleet_diagram, reset_fleet
from drake_quad.assembly.user_systems import UserSystems
from drake_quad.control.position import PdGains, ProportionalDerivative, build_position_controller
from drake_quad.fleets.fleet_simulation import fly, read_metrics
from drake_quad.fleets.study_fleet import StudyFleet
from drake_quad.flight.mission import plan_route
from drake_quad.flight.simulation import simulate_samples
from drake_quad.framework.wiring import subsystem
from drake_quad.geometry.per_axis import PerAxis
from drake_quad.scenario.batch import Batch


@pytest.fixture(scope="module")
def scenario(diagrams):
    """Return a function that loads 0.5 s of the robustness scenario with given overrides and controller."""

    def load(*overrides, controller=None):
        paper = diagrams / "controllers" / "paper.yaml"
        layers = [] if controller is None else [f"{paper}:{controller}"]
        return load_scenario(diagrams / "robustness.yaml", ["duration=0.5", *overrides], layers=layers)

    return load


def new_fleet_metrics(study, batch):
    """Return the metrics of a fleet that is built for a batch and not reset."""
    diagram = build_fleet_diagram(batch, plan_route(study))
    simulator = Simulator(diagram)
    fly(simulator, study.duration)
    return read_metrics(diagram, simulator.get_context())


SIGN_LAW = ["control.network.learning={kind: sign, rate: {uniform: {min: 0.5, max: 1.0}}}"]
NETWORK_OVERRIDES = [
    "control.network.a1={uniform: {min: 1.1, max: 1.5}}",
    "control.network.learning.initial_covariance={uniform: {min: 1.0, max: 6.0}}",
    "control.network.learning.initial_weight={uniform: {min: -0.1, max: 0.1}}",
    "vehicle.rotor_failure={rotor: {choice: [1, 2]}, time: 0.2, speed_factor: {uniform: {min: 0.8, max: 0.9}}}",
]
PD_GAINS = "k_p: [1.5, 1.6, 5.0], k_d: [2.0, 2.1, 3.2], feed_forward: snap"
TILT_RESPONSE = "response: {kind: tilt, lag: {uniform: {min: 0.05, max: 0.09}}}"
COMMANDED_RESPONSE = "response: {kind: commanded, lag: [{uniform: {min: 0.2, max: 0.3}}, 0.25, 0.07]}"
ESTIMATORS = [
    [
        f"control.position={{kind: indi, {PD_GAINS}, {TILT_RESPONSE},"
        " bandwidth: [2.0, {uniform: {min: 1.0, max: 3.0}}, 4.0]}",
        "control.attitude={kind: indi, k_p: [15.0, 15.0, 5.0], k_d: [6.5, 6.5, 3.4],"
        " lag: {uniform: {min: 0.05, max: 0.09}}, bandwidth: 1.0}",
    ],
    [
        f"control.position={{kind: l1, {PD_GAINS}, {COMMANDED_RESPONSE}, bandwidth: [1.0, 1.1, 1.2],"
        " adaptation: {uniform: {min: 0.5, max: 2.0}}}",
        "control.attitude={kind: geometric, k_p: [15.0, 15.0, 5.0], k_d: [6.5, 6.5, 3.4]}",
    ],
]


@pytest.mark.long
@pytest.mark.parametrize(
    ("overrides", "controller"),
    [
        ([], "pid"),
        (NETWORK_OVERRIDES, "pd_t2fnn"),
        (SIGN_LAW, "pd_t1fnn"),
        *((overrides, None) for overrides in ESTIMATORS),
    ],
)
def test_the_second_batch_of_a_fleet_flies_like_a_new_fleet(scenario, overrides, controller):
    """The scenarios contain every kind of system, and vary every parameter that may differ between samples.

    Results of uncompiled diagrams are equal to the last bit. After a reset of a compiled diagram, other code computes
    the first camera frame and the initial wind, and rounds some values differently.
    """
    study = scenario(*overrides, controller=controller)
    uncompiled, compiled = (
        StudyFleet(study, plan_route(study), 3, compiled=False),
        StudyFleet(study, plan_route(study), 3),
    )
    assert compiled.plan.path.times[-1] == plan_route(study).path.times[-1]
    # The fleet is compiled by default, and does not record signals.
    for fleet, is_compiled in ((uncompiled, False), (compiled, True)):
        assert fleet.simulation.compiled == is_compiled
        assert not fleet.simulation._diagram.HasSubsystemNamed("recorder")
    for samples in ([7, 8, 9], [3, 1, 2]):
        expected = new_fleet_metrics(study, Batch.draw(study, samples))
        for actual, desired in zip(uncompiled.fly(samples), expected, strict=True):
            np.testing.assert_array_equal(actual, desired)
        for actual, desired in zip(compiled.fly(samples), expected, strict=True):
            np.testing.assert_allclose(actual, desired, rtol=1e-12)


@pytest.mark.long
def test_vehicles_with_overridden_parameters_fly_like_a_new_fleet(scenario):
    """The overridden parameters are gains, an element of a list, and an integer number of ticks."""
    study = scenario("laboratory.command_link.delay_ticks={choice: [0, 2]}", controller="pd_t2fnn")
    varying = {
        "laboratory.command_link.delay_ticks": np.array([2.0, 0.0, 1.0]),
        "control.position.k_p.0": np.array([0.8, 1.0, 1.2]),
        "control.network.learning.gain": np.array([0.2, 0.5, 0.7]),
        "vehicle.mass": np.array([0.68, 0.7, 0.72]),
    }
    fleet, drawn = StudyFleet(study, plan_route(study), 3), Batch.draw(study, [5, 5, 2])
    varied = drawn.with_varying(varying)
    metrics = fleet.fly_batch(varied)
    for actual, expected in zip(metrics, new_fleet_metrics(study, varied), strict=True):
        np.testing.assert_array_equal(actual, expected)
    # Each vehicle flies like a single vehicle with the same parameters.
    for i in range(3):
        single = simulate(varied.vehicle_scenario(i), compiled=False).metrics
        np.testing.assert_allclose([float(value[i]) for value in metrics], single, rtol=1e-9)
    # The overridden parameters do not affect the next batch.
    for actual, expected in zip(fleet.fly_batch(drawn), new_fleet_metrics(study, drawn), strict=True):
        np.testing.assert_array_equal(actual, expected)


OPTIONAL_PARTS = {
    "laboratory.command_link.delay_ticks": [0.0, 1.0, 3.0],
    "laboratory.command_link.loss_rate": [0.0, 0.2, 0.4],
    "laboratory.motion_capture.latency_frames": [0.0, 2.0, 3.0],
    "laboratory.motion_capture.position_noise": [0.0, 0.01, 0.02],
    "laboratory.motion_capture.dropout_rate": [0.0, 0.2, 0.4],
    "laboratory.motion_capture.misalignment.1": [0.0, 0.02, -0.02],
    "laboratory.motion_capture.derivative_bandwidth": [20.0, 40.0, 60.0],
    "laboratory.wind.0.velocity.1": [0.0, 1.0, -1.0],
    "vehicle.battery_sag": [0.0, 0.1, 0.2],
}


@pytest.mark.slow
@pytest.mark.parametrize("path", OPTIONAL_PARTS)
def test_optional_parts_can_vary_only_if_the_diagram_was_built_with_them(diagrams, path):
    """A diagram without an optional part refuses parameters of this part instead of ignoring them."""
    calm = "laboratory.wind=[{kind: steady, velocity: [0.0, 0.0, 0.0]}]"
    ideal = load_scenario(diagrams / "figure_eight.yaml", ["duration=2", "vehicle.linear_drag=0.2", calm])
    varied = Batch.draw(ideal, [0, 0, 0]).with_varying({path: np.array(OPTIONAL_PARTS[path])})
    metrics = new_fleet_metrics(ideal, varied)
    single = [simulate(varied.vehicle_scenario(i), compiled=False).metrics.rmse for i in range(3)]
    assert len(set(single)) == 3
    np.testing.assert_allclose(metrics.rmse, single, rtol=1e-9)
    with pytest.raises((ValueError, RuntimeError), match="was built with|steady"):
        StudyFleet(ideal, plan_route(ideal), 3).fly_batch(varied)


def test_a_reset_context_equals_the_default_context_of_a_new_fleet(scenario):
    """All parameters, states and random numbers are compared, including those that do not affect metrics."""
    study = scenario(*NETWORK_OVERRIDES)
    plan = plan_route(study)
    first, second = Batch.draw(study, range(4)), Batch.draw(study, [9, 8, 7, 6])
    diagrams = [build_fleet_diagram(batch, plan) for batch in (first, second)]
    contexts = [diagram.CreateDefaultContext() for diagram in diagrams]
    reset_fleet(diagrams[0], contexts[0], second, plan)
    sizes = [(context.num_numeric_parameter_groups(), context.num_discrete_state_groups()) for context in contexts]
    assert sizes[0] == sizes[1]
    assert sizes[0][0] > 10
    for i in range(sizes[0][0]):
        actual, expected = (context.get_numeric_parameter(i).CopyToVector() for context in contexts)
        np.testing.assert_array_equal(actual, expected)
    for i in range(sizes[0][1]):
        actual, expected = (context.get_discrete_state(i).CopyToVector() for context in contexts)
        np.testing.assert_array_equal(actual, expected)


def test_a_context_is_completely_reset_after_a_flight(scenario):
    """The time, all states and the state of a user-defined system equal those of a new fleet."""
    study = scenario(*NETWORK_OVERRIDES)
    plan, batch = plan_route(study), Batch.draw(study, range(2))
    user_systems = UserSystems(position_controller=high_gain_controller).build(2)
    diagram = build_fleet_diagram(batch, plan, user_systems=user_systems)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    simulator.AdvanceTo(0.3)
    pd = subsystem(diagram, ("control", "position", "pd"))
    pd_context = pd.GetMyMutableContextFromRoot(context)
    pd.set_parameter(pd_context, "gains", PdGains(PerAxis(1.0, 1.0, 1.0), PerAxis(1.0, 1.0, 1.0)))
    reset_fleet(diagram, context, batch, plan, user_systems=user_systems)
    default_context = diagram.CreateDefaultContext()
    assert context.get_time() == 0.0
    for i in range(default_context.num_discrete_state_groups()):
        actual, expected = (each.get_discrete_state(i).CopyToVector() for each in (context, default_context))
        np.testing.assert_array_equal(actual, expected)
    np.testing.assert_array_equal(pd.get_parameter(pd_context, "gains").k_p.z, 6.0)


@pytest.mark.long
def test_metrics_do_not_depend_on_the_size_of_the_fleet(scenario):
    study = scenario(controller="pd")
    metrics = StudyFleet(study, plan_route(study), 70).fly(range(70))
    for size in (1, 7, 64):
        fleet = StudyFleet(study, plan_route(study), size)
        for first in range(0, 70, size)[:3]:
            samples = range(first, min(first + size, 70))
            for actual, expected in zip(fleet.fly(samples), metrics, strict=True):
                np.testing.assert_allclose(actual, expected[first : first + len(samples)], rtol=1e-9)


@pytest.mark.long
def test_batches_with_and_without_delays_and_dropouts_fly_in_the_same_diagram(scenario):
    """The diagram includes effects that are zero in some samples, and queues for the longest delay."""
    study = scenario(
        "laboratory.motion_capture.latency_frames={choice: [0, 2]}",
        "laboratory.command_link.delay_ticks={choice: [0, 2]}",
        "laboratory.motion_capture.dropout_rate={choice: [0.0, 0.1]}",
        controller="pd",
    )
    fleet = StudyFleet(study, plan_route(study), 1)
    for sample in range(5):
        single = simulate(study, sample=sample, compiled=False).metrics
        np.testing.assert_allclose([float(value[0]) for value in fleet.fly([sample])], single, rtol=1e-9)


def high_gain_controller(num_vehicles):
    """Return a user-defined position controller with high gains."""
    gains = PdGains(PerAxis(2.0, 2.0, 6.0), PerAxis(2.0, 2.0, 3.5))
    return build_position_controller(ProportionalDerivative(num_vehicles=num_vehicles, parameters=gains))


@pytest.mark.long
def test_a_fleet_can_fly_with_a_user_defined_controller(scenario):
    study = scenario()
    fleet = StudyFleet(study, plan_route(study), 2, user_systems=UserSystems(position_controller=high_gain_controller))
    for sample in (0, 5):
        single = simulate(study, sample=sample, position_controller=high_gain_controller(1)).metrics
        assert fleet.fly([sample]).rmse[0] == pytest.approx(single.rmse, rel=1e-9)


def test_a_batch_with_too_many_or_no_samples_is_refused(scenario):
    fleet = StudyFleet(scenario(), plan_route(scenario()), 2)
    for samples in ([], [0, 1, 2]):
        with pytest.raises(ValueError, match="cannot fly"):
            fleet.fly(samples)


@pytest.mark.parametrize("override", ["route.radius={uniform: {min: 1.2, max: 1.4}}", "vehicle.time_step=0"])
def test_a_route_with_a_distribution_and_a_continuous_state_are_refused(scenario, override):
    with pytest.raises(InputError, match=override.partition("=")[0]):
        StudyFleet(scenario(override), plan_route(scenario(override)), 2)


def test_a_recorded_fleet_refuses_a_route_with_a_distribution(scenario):
    with pytest.raises(InputError, match="route.radius is a distribution"):
        simulate_samples(scenario("route.radius={uniform: {min: 1.2, max: 1.4}}"), [0, 1])


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the test needs /proc of Linux")
def test_later_batches_of_a_fleet_need_no_additional_memory(scenario):
    """A new diagram or context for every batch would take several megabytes."""

    def resident():
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

    study = scenario(controller="pd")
    fleet = StudyFleet(study, plan_route(study), 512)
    for batch in range(40):
        if batch == 10:
            before = resident()
        fleet.fly(range(512 * batch, 512 * (batch + 1)), duration=0.02)
    assert resident() - before < 5e6
