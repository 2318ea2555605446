"""Samples put into a fleet that is there fly as in one that is built for them."""

import resource
from pathlib import Path

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from drake_quad import InputError, build_tracking_diagram, load_scenario, simulate
from drake_quad.flight import fly, read_metrics
from drake_quad.assembly.planning import plan_route
from drake_quad.flight.fleet import StudyFleet
from drake_quad.assembly.tracking import put_samples

ROBUSTNESS = "diagrams/robustness.yaml"
SHORT = ["duration=0.5"]


def scenario(*overrides, layers=()):
    return load_scenario(ROBUSTNESS, [*SHORT, *overrides], layers=layers)


def flown(study, samples):
    """The metrics of a fleet that is built for these samples, without putting anything into it."""
    diagram = build_tracking_diagram(study, len(samples), samples=samples)
    simulator = Simulator(diagram)
    fly(simulator, study.duration)
    return read_metrics(diagram, simulator.get_context())


CONTROLLERS = ["pd", "pid", "pd_t1fnn", "pd_t2fnn", "pd_feed_forward"]
SIGN = ["control.position.learning={kind: sign, rate: {uniform: {min: 0.5, max: 1.0}}}"]
NETWORK = [
    "control.position.network.a1={uniform: {min: 1.1, max: 1.5}}",
    "control.position.learning.initial_covariance={uniform: {min: 1.0, max: 6.0}}",
    "control.position.learning.initial_weight={uniform: {min: -0.1, max: 0.1}}",
    "vehicle.rotor_failure={rotor: {choice: [1, 2]}, time: 0.2, speed_factor: {uniform: {min: 0.8, max: 0.9}}}",
]


@pytest.mark.parametrize(
    ("overrides", "controller"),
    [*(([], name) for name in CONTROLLERS), (NETWORK, "pd_t2fnn"), (SIGN, "pd_t1fnn")],
)
def test_other_samples_fly_as_in_a_fleet_of_their_own(overrides, controller):
    """Bit for bit, with every kind of system and every number that may differ, also when they come second."""
    study = scenario(*overrides, layers=[f"diagrams/controllers/paper.yaml:{controller}"])
    fleet = StudyFleet(study, 3)
    for samples in ([7, 8, 9], [3, 1, 2], [7, 8, 9]):
        for found, expected in zip(fleet.fly(samples), flown(study, samples), strict=True):
            np.testing.assert_array_equal(found, expected)


def test_a_context_with_other_samples_is_the_default_one_of_their_fleet():
    """Every parameter, state and tape; also those that do not show in the metrics."""
    study = scenario(*NETWORK)
    plan = plan_route(study)
    first, second = range(4), [9, 8, 7, 6]
    diagrams = [build_tracking_diagram(study, 4, samples=samples, plan=plan) for samples in (first, second)]
    contexts = [diagram.CreateDefaultContext() for diagram in diagrams]
    put_samples(diagrams[0], contexts[0], study, second, plan)
    sizes = [
        (
            context.num_numeric_parameter_groups(),
            context.num_abstract_parameters(),
            context.num_discrete_state_groups(),
        )
        for context in contexts
    ]
    assert sizes[0] == sizes[1]
    assert sizes[0][0] > 10
    for i in range(sizes[0][0]):
        found, expected = (context.get_numeric_parameter(i).CopyToVector() for context in contexts)
        np.testing.assert_array_equal(found, expected)
    for i in range(sizes[0][2]):
        found, expected = (context.get_discrete_state(i).CopyToVector() for context in contexts)
        np.testing.assert_array_equal(found, expected)
    for i in range(sizes[0][1]):
        tapes = [context.get_abstract_parameter(i).get_value() for context in contexts]
        for found, expected in zip(*tapes, strict=True):
            np.testing.assert_array_equal(found.at(0.3), expected.at(0.3))


def test_the_size_of_a_fleet_does_not_matter():
    study = scenario()
    whole = StudyFleet(study, 70).fly(range(70))
    for size in (1, 7, 64):
        fleet = StudyFleet(study, size)
        for first in range(0, 70, size)[:3]:
            samples = range(first, min(first + size, 70))
            for found, expected in zip(fleet.fly(samples), whole, strict=True):
                np.testing.assert_allclose(found, expected[first : first + len(samples)], rtol=1e-9)


def test_a_batch_without_an_error_that_others_have_is_flown_in_the_same_diagram():
    """What a distribution can make zero, or as long as a delay can get, is there in every batch."""
    study = scenario(
        "laboratory.motion_capture.latency_frames={choice: [0, 2]}",
        "laboratory.command_link.delay_ticks={choice: [0, 2]}",
        "laboratory.motion_capture.dropout_rate={choice: [0.0, 0.1]}",
    )
    fleet = StudyFleet(study, 1)
    for sample in range(5):
        alone = simulate(study, sample=sample).metrics
        np.testing.assert_allclose([float(value[0]) for value in fleet.fly([sample])], alone, rtol=1e-9)


def test_a_fleet_flies_with_a_controller_of_the_user_s_own():
    from drake_quad.control.position import ProportionalDerivative, build_position_controller

    def stiff(num_vehicles):
        pd = ProportionalDerivative(num_vehicles=num_vehicles, k_p=(2.0, 2.0, 6.0), k_d=(2.0, 2.0, 3.5))
        return build_position_controller(pd)

    study = scenario()
    fleet = StudyFleet(study, 2, position_controller=stiff)
    for sample in (0, 5):
        alone = simulate(study, sample=sample, position_controller=stiff(1)).metrics
        assert fleet.fly([sample]).rmse[0] == pytest.approx(alone.rmse, rel=1e-9)


def test_too_many_samples_or_none_are_refused():
    fleet = StudyFleet(scenario(), 2)
    for samples in ([], [0, 1, 2]):
        with pytest.raises(ValueError, match="cannot fly"):
            fleet.fly(samples)


@pytest.mark.parametrize("override", ["route.radius={uniform: {min: 1.2, max: 1.4}}", "vehicle.time_step=0"])
def test_what_would_make_samples_depend_on_each_other_is_refused(override):
    with pytest.raises(InputError, match=override.partition("=")[0]):
        StudyFleet(scenario(override), 2)


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs Linux's /proc")
def test_batch_after_batch_takes_no_more_memory():
    """A diagram that was built for each, or a context, would be megabytes a time."""

    def resident():
        return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()

    fleet = StudyFleet(scenario(), 512)
    for batch in range(40):
        if batch == 10:
            before = resident()
        fleet.fly(range(512 * batch, 512 * (batch + 1)), duration=0.02)
    assert resident() - before < 5e6
